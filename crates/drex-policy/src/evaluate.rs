//! How good predictions are: errors on grasps held out, the same of simple rules, and what each mode stands for.

use drex_core::Pose;

use crate::data::GRAVITY_M_S2;
use crate::metric::{grasp_distance_m, joint_rms_rad};
use crate::norm::{squeeze_per_weight, wrist_numbers, wrist_pose};
use crate::split::{Split, Stream, random, shuffle};
use crate::{
    Baselines, Dataset, GraspErrors, GraspPolicy, GraspSample, ModeReport, PredictedGrasp, Result, TrainOptions,
};

/// Random choices of demonstrations that the baseline averages over.
const DRAWS: usize = 32;

/// Mean errors of the proposal nearest to each sample; none for no samples.
pub(crate) fn grasp_errors(
    samples: &[&GraspSample],
    length_m: f64,
    propose: impl Fn(&GraspSample) -> Vec<PredictedGrasp>,
) -> Option<GraspErrors> {
    let mut sum =
        GraspErrors { distance_m: 0.0, joint_rms_rad: 0.0, wrist_m: 0.0, wrist_rad: 0.0, force_relative: 0.0 };
    let mut count = 0.0;
    for sample in samples {
        let proposals = propose(sample);
        let distance = |p: &PredictedGrasp| {
            grasp_distance_m((&p.joints, &p.object_from_palm), (&sample.joints, &sample.object_from_palm), length_m)
        };
        let Some(nearest) = proposals.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))) else { continue };
        let (a, b) = (&nearest.object_from_palm, &sample.object_from_palm);
        sum.distance_m += distance(nearest);
        sum.joint_rms_rad += joint_rms_rad(&nearest.joints, &sample.joints);
        sum.wrist_m += (a.translation.vector - b.translation.vector).norm();
        sum.wrist_rad += a.rotation.angle_to(&b.rotation);
        sum.force_relative += (nearest.squeeze_n / sample.squeeze_n - 1.0).abs();
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

/// Errors of the simple rules on the grasps held out; none if there are none.
pub(crate) fn baselines(data: &Dataset, split: &Split, modes: usize, options: &TrainOptions) -> Option<Baselines> {
    let held_out: Vec<&GraspSample> = split.held_out.iter().flatten().map(|&s| &data.samples[s]).collect();
    let recalled: Vec<Recalled<'_>> = split.train.iter().filter_map(|g| Recalled::new(data, g)).collect();
    let recall = |chosen: &[usize]| {
        grasp_errors(&held_out, options.length_m, |s| chosen.iter().map(|&i| recalled[i].at(s.mass_kg)).collect())
    };
    let mean = mean_demonstration(data, split);
    let mean = grasp_errors(&held_out, options.length_m, |_| vec![mean.clone()]);
    let mut order: Vec<usize> = (0..recalled.len()).collect();
    let nearest = recall(&order);
    let mut draws = Vec::new();
    let mut random = random(options.seed, Stream::Baseline);
    for _ in 0..DRAWS {
        shuffle(&mut order, &mut random);
        draws.extend(recall(&order[..modes.min(order.len())]));
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

/// What each mode of the policy stands for at the middle of the masses.
pub(crate) fn mode_reports(policy: &GraspPolicy, data: &Dataset, split: &Split) -> Result<Vec<ModeReport>> {
    let mut masses: Vec<f64> = split.train.iter().flatten().map(|&s| data.samples[s].mass_kg).collect();
    masses.sort_by(f64::total_cmp);
    let Some(&mass) = masses.get(masses.len() / 2) else { return Ok(Vec::new()) };
    let modes = policy.predict(&data.points, mass)?;
    let mut reports: Vec<ModeReport> = modes
        .iter()
        .map(|m| ModeReport { weight: m.weight, nearest_demonstration_rad: f64::INFINITY, demonstrations: 0 })
        .collect();
    for sample in split.train.iter().filter_map(|g| g.first()).map(|&s| &data.samples[s]) {
        let mut nearest = (0, f64::INFINITY);
        for (i, mode) in modes.iter().enumerate() {
            reports[i].nearest_demonstration_rad =
                reports[i].nearest_demonstration_rad.min(joint_rms_rad(&mode.joints, &sample.joints));
            let (a, b) = ((&*mode.joints, &mode.object_from_palm), (&*sample.joints, &sample.object_from_palm));
            let distance = grasp_distance_m(a, b, policy.card.normalisation.length_m);
            if distance < nearest.1 {
                nearest = (i, distance);
            }
        }
        if let Some(report) = reports.get_mut(nearest.0) {
            report.demonstrations += 1;
        }
    }
    Ok(reports)
}

/// A training grasp as a prediction: its mean squeeze per weight, times the weight.
struct Recalled<'a> {
    sample: &'a GraspSample,
    ratio: f64,
}

impl<'a> Recalled<'a> {
    fn new(data: &'a Dataset, grasp: &[usize]) -> Option<Self> {
        let sample = &data.samples[*grasp.first()?];
        let ratio = grasp.iter().map(|&s| squeeze_per_weight(&data.samples[s])).sum::<f64>() / grasp.len() as f64;
        Some(Self { sample, ratio })
    }

    fn at(&self, mass_kg: f64) -> PredictedGrasp {
        PredictedGrasp {
            joints: self.sample.joints.clone(),
            object_from_palm: self.sample.object_from_palm,
            squeeze_n: self.ratio * mass_kg * GRAVITY_M_S2,
            weight: 1.0,
        }
    }
}

/// The mean of the training grasps (rotations averaged by their first two columns) with the mean squeeze.
fn mean_demonstration(data: &Dataset, split: &Split) -> PredictedGrasp {
    let samples: Vec<&GraspSample> = split.train.iter().flatten().map(|&s| &data.samples[s]).collect();
    let mean =
        |of: &dyn Fn(&GraspSample) -> f64| samples.iter().map(|s| of(s)).sum::<f64>() / samples.len().max(1) as f64;
    let wrist: [f64; 9] = std::array::from_fn(|i| mean(&|s| wrist_numbers(&s.object_from_palm, 1.0)[i]));
    let pose: Pose = wrist_pose(&wrist, 1.0);
    PredictedGrasp {
        joints: (0..data.joint_names.len()).map(|j| mean(&|s| s.joints[j])).collect(),
        object_from_palm: pose,
        squeeze_n: mean(&|s| s.squeeze_n),
        weight: 1.0,
    }
}
