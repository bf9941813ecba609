//! How good predictions are: errors on grasps held out, the same of simple rules, and what each mode stands for.

use drex_core::Pose;

use crate::data::GRAVITY_M_S2;
use crate::metric::{grasp_distance_m, joint_rms_rad};
use crate::norm::{grip_force_ratio, wrist_numbers, wrist_pose};
use crate::policy::Scene;
use crate::split::{Split, Stream, random, shuffle};
use crate::{Baselines, Dataset, GraspErrors, GraspPolicy, GraspSample, ModeReport, PredictedGrasp, Result};

/// Random choices of demonstrations that the baseline averages over.
const DRAWS: usize = 32;

/// What the policy proposes for each of these samples, modes in their own order. The network runs once per object.
pub(crate) fn proposals(
    policy: &GraspPolicy,
    scenes: &[Scene],
    data: &Dataset,
    samples: &[usize],
) -> Result<Vec<Vec<PredictedGrasp>>> {
    let mut found = vec![Vec::new(); samples.len()];
    for (object, scene) in scenes.iter().enumerate() {
        let own: Vec<usize> = (0..samples.len()).filter(|&i| data.samples[samples[i]].object == object).collect();
        let mut loads: Vec<(f64, f64)> = Vec::new();
        let mut asks = Vec::new();
        for &i in &own {
            let sample = &data.samples[samples[i]];
            let load = (sample.mass_kg, sample.friction);
            asks.push(loads.iter().position(|l| *l == load).unwrap_or(loads.len()));
            if asks.last() == Some(&loads.len()) {
                loads.push(load);
            }
        }
        if loads.is_empty() {
            continue;
        }
        let answers = policy.propose(scene, &loads)?;
        for (&i, ask) in own.iter().zip(asks) {
            found[i] = answers[ask].clone();
        }
    }
    Ok(found)
}

/// Mean errors of the proposal nearest to each sample; none for no samples.
pub(crate) fn grasp_errors(
    samples: &[&GraspSample],
    length_m: f64,
    propose: impl Fn(usize) -> Vec<PredictedGrasp>,
) -> Option<GraspErrors> {
    let mut sum =
        GraspErrors { distance_m: 0.0, joint_rms_rad: 0.0, wrist_m: 0.0, wrist_rad: 0.0, force_relative: 0.0 };
    let mut count = 0.0;
    for (i, sample) in samples.iter().enumerate() {
        let proposals = propose(i);
        let distance = |p: &PredictedGrasp| {
            grasp_distance_m((&p.joints, &p.object_from_base), (&sample.joints, &sample.object_from_base), length_m)
        };
        let Some(nearest) = proposals.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))) else { continue };
        let (a, b) = (&nearest.object_from_base, &sample.object_from_base);
        sum.distance_m += distance(nearest);
        sum.joint_rms_rad += joint_rms_rad(&nearest.joints, &sample.joints);
        sum.wrist_m += (a.translation.vector - b.translation.vector).norm();
        sum.wrist_rad += a.rotation.angle_to(&b.rotation);
        sum.force_relative += (nearest.grip_force_n / sample.grip_force_n - 1.0).abs();
        count += 1.0;
    }
    (count > 0.0).then(|| GraspErrors {
        distance_m: sum.distance_m / count,
        joint_rms_rad: sum.joint_rms_rad / count,
        wrist_m: sum.wrist_m / count,
        wrist_rad: sum.wrist_rad / count,
        force_relative: sum.force_relative / count,
    })
}

/// Mean over the samples of the logarithm of their density, joints alone and with the wrist; none for no samples.
pub(crate) fn log_densities(
    policy: &GraspPolicy,
    samples: &[&GraspSample],
    proposals: &[Vec<PredictedGrasp>],
) -> Option<(f64, f64)> {
    let mean = |wrist: bool| {
        let of = |(s, p): (&&GraspSample, &Vec<PredictedGrasp>)| {
            policy.log_density_of(p, &s.joints, wrist.then_some(&s.object_from_base))
        };
        samples.iter().zip(proposals).map(of).sum::<f64>() / samples.len() as f64
    };
    (!samples.is_empty()).then(|| (mean(false), mean(true)))
}

/// Errors of the simple rules on the grasps held out; none if there are none. `poses` are the palms in the network's frame.
pub(crate) fn baselines(
    policy: &GraspPolicy,
    data: &Dataset,
    split: &Split,
    scenes: &[Scene],
    poses: &[Pose],
) -> Option<Baselines> {
    let length_m = policy.card.normalisation.length_m;
    let held_out: Vec<&GraspSample> = split.held_out.iter().flatten().map(|&s| &data.samples[s]).collect();
    let recalled: Vec<Recalled<'_>> = split.train.iter().filter_map(|g| Recalled::new(data, poses, g)).collect();
    let recall = |chosen: &[usize]| {
        let at = |i: usize| chosen.iter().map(|&c| recalled[c].at(held_out[i], &scenes[held_out[i].object])).collect();
        grasp_errors(&held_out, length_m, at)
    };
    let mean = mean_demonstration(data, poses, split);
    let mean = grasp_errors(&held_out, length_m, |i| {
        let mut grasp = mean.clone();
        let network_from_object = scenes[held_out[i].object].frame.network_from_object;
        grasp.object_from_base = network_from_object.inverse() * grasp.object_from_base;
        vec![grasp]
    });
    let mut order: Vec<usize> = (0..recalled.len()).collect();
    let nearest = recall(&order);
    let mut draws = Vec::new();
    let mut random = random(policy.card.training.seed, Stream::Baseline);
    for _ in 0..DRAWS {
        shuffle(&mut order, &mut random);
        draws.extend(recall(&order[..policy.modes().min(order.len())]));
    }
    let over = |of: fn(&GraspErrors) -> f64| draws.iter().map(of).sum::<f64>() / draws.len().max(1) as f64;
    let drawn = GraspErrors {
        distance_m: over(|e| e.distance_m),
        joint_rms_rad: over(|e| e.joint_rms_rad),
        wrist_m: over(|e| e.wrist_m),
        wrist_rad: over(|e| e.wrist_rad),
        force_relative: over(|e| e.force_relative),
    };
    mean.zip(nearest).map(|(mean_demonstration, nearest_demonstration)| Baselines {
        mean_demonstration,
        random_demonstrations: drawn,
        nearest_demonstration,
    })
}

/// What each mode of the policy stands for (weights are means over the training grasps), most probable first.
pub(crate) fn mode_reports(
    policy: &GraspPolicy,
    data: &Dataset,
    split: &Split,
    scenes: &[Scene],
) -> Result<Vec<ModeReport>> {
    let first: Vec<usize> = split.train.iter().filter_map(|g| g.first().copied()).collect();
    let proposed = proposals(policy, scenes, data, &first)?;
    let mut reports: Vec<ModeReport> = (0..policy.modes())
        .map(|k| ModeReport {
            weight: proposed.iter().filter_map(|p| p.get(k)).map(|g| g.weight).sum::<f64>() / first.len().max(1) as f64,
            nearest_demonstration_rad: f64::INFINITY,
            demonstrations: 0,
        })
        .collect();
    for (&s, modes) in first.iter().zip(&proposed) {
        let sample = &data.samples[s];
        let mut nearest = (0, f64::INFINITY);
        for (i, mode) in modes.iter().enumerate() {
            reports[i].nearest_demonstration_rad =
                reports[i].nearest_demonstration_rad.min(joint_rms_rad(&mode.joints, &sample.joints));
            let (a, b) = ((&*mode.joints, &mode.object_from_base), (&*sample.joints, &sample.object_from_base));
            let distance = grasp_distance_m(a, b, policy.card.normalisation.length_m);
            if distance < nearest.1 {
                nearest = (i, distance);
            }
        }
        if let Some(report) = reports.get_mut(nearest.0) {
            report.demonstrations += 1;
        }
    }
    reports.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    Ok(reports)
}

/// A training grasp as a prediction: its mean plain grip force, at another mass and friction, at the same place about another object.
struct Recalled<'a> {
    sample: &'a GraspSample,
    network_from_base: Pose,
    grip_force: f64,
}

impl<'a> Recalled<'a> {
    fn new(data: &'a Dataset, poses: &[Pose], grasp: &[usize]) -> Option<Self> {
        let first = *grasp.first()?;
        let grip_force = grasp.iter().map(|&s| grip_force_ratio(&data.samples[s])).sum::<f64>() / grasp.len() as f64;
        Some(Self { sample: &data.samples[first], network_from_base: poses[first], grip_force })
    }

    fn at(&self, wanted: &GraspSample, scene: &Scene) -> PredictedGrasp {
        PredictedGrasp {
            joints: self.sample.joints.clone(),
            object_from_base: scene.frame.network_from_object.inverse() * self.network_from_base,
            contacts: self.sample.contacts.iter().map(|c| f64::from(u8::from(*c))).collect(),
            grip_force_n: self.grip_force * wanted.mass_kg * GRAVITY_M_S2 / wanted.friction,
            weight: 1.0,
        }
    }
}

/// The mean of the training grasps (rotations averaged by their first two columns) with the mean grip force; the palm in the network's frame.
fn mean_demonstration(data: &Dataset, poses: &[Pose], split: &Split) -> PredictedGrasp {
    let samples: Vec<usize> = split.train.iter().flatten().copied().collect();
    let mean = |of: &dyn Fn(usize) -> f64| samples.iter().map(|&s| of(s)).sum::<f64>() / samples.len().max(1) as f64;
    let wrist: [f64; 9] = std::array::from_fn(|i| mean(&|s| wrist_numbers(&poses[s], 1.0)[i]));
    PredictedGrasp {
        joints: (0..data.joint_names.len()).map(|j| mean(&|s| data.samples[s].joints[j])).collect(),
        object_from_base: wrist_pose(&wrist, 1.0),
        contacts: (0..data.fingers.len())
            .map(|f| mean(&|s| f64::from(u8::from(data.samples[s].contacts[f]))))
            .collect(),
        grip_force_n: mean(&|s| data.samples[s].grip_force_n),
        weight: 1.0,
    }
}
