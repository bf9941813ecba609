//! Training of a proposal network: rates of a Poisson process, and the changes from prototypes to grasps.

use std::ops::ControlFlow;

use burn::tensor::activation::relu;
use burn::tensor::{Device, Int, Tensor, TensorData};
use drex_core::Pose;
use drex_core::stats::{normal_pair, upper_median};
use nalgebra::{Point3, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::network::{HandCard, ProposalNetwork};
use super::prototypes::{Prototype, medoids, nearest};
use super::scene::{PATCH, SCALARS, Scene};
use super::weights::{Layout, at};
use super::{GraspedObject, LABELLED_KG, LabelledGrasp};
use crate::adam::Adam;
use crate::data::GRAVITY_M_S2;
use crate::net::{device, tensor, values};
use crate::{Error, Result};

/// How far a place is from where a grasp touches for half of it to count, and beyond which none of it does, metres.
const NEAR_M: f64 = 0.01;
const FAR_M: f64 = 0.02;
/// Places from which prototypes are found.
const FOR_PROTOTYPES: usize = 20_000;
/// Share of scenes that one camera sees; the others are seen from all sides.
const ONE_VIEW: f64 = 0.5;
/// Standard deviation of the noise of points, at most, metres.
const NOISE_M: f64 = 0.002;
/// Frictions that are drawn, and masses: the labelled ones, and between them.
const FRICTION: [f64; 2] = [0.2, 1.0];
/// Weight of the changes beside the rates.
const CHANGES: f32 = 0.1;
/// Changes larger than this, in their units, count no more than in proportion.
const HUBER: f32 = 1.0;

/// How a network is trained.
#[derive(Debug, Clone, PartialEq)]
pub struct ProposalOptions {
    /// Prototypes of grasps.
    pub prototypes: usize,
    /// Steps of the optimiser.
    pub steps: usize,
    /// Scenes of a step.
    pub scenes: usize,
    /// Places that are looked at in each.
    pub places: usize,
    /// Learning rate at the start; it falls to zero as a cosine.
    pub learning_rate: f64,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for ProposalOptions {
    fn default() -> Self {
        Self { prototypes: 256, steps: 6000, scenes: 8, places: 24, learning_rate: 1e-3, seed: 0 }
    }
}

/// How training stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProposalProgress {
    /// Steps that are done.
    pub step: usize,
    /// Mean of minus the log-likelihood of what was found at a place, up to a constant, since the last time.
    pub rates: f64,
    /// Mean loss of the changes.
    pub changes: f64,
}

/// Trains a network on grasps of many objects. The same data, options and seed give the same network with any number of threads.
///
/// # Errors
/// If there are no grasps, an object is none of this hand's, or the build has no backend.
pub fn train(
    objects: &[GraspedObject],
    hand: HandCard,
    options: &ProposalOptions,
    watch: &mut dyn FnMut(ProposalProgress) -> ControlFlow<()>,
) -> Result<ProposalNetwork> {
    check(objects, &hand)?;
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    let (prototypes, shapes) = prototypes(objects, options.prototypes, &mut random);
    let untried = share_held(objects);
    let layout = Layout { joints: hand.joint_names.len(), prototypes: prototypes.len() };
    let mut arrays = layout.initial(options.seed);
    arrays[at::RATE + 1].fill(START_LOG_RATE);
    let mut adam = Adam::new(&arrays);
    let device = device()?.autodiff();
    let (mut rates, mut changes, mut since) = (0.0, 0.0, 0);
    for step in 0..options.steps {
        let scenes: Vec<Example> = (0..options.scenes)
            .into_par_iter()
            .map(|i| {
                let mut random = ChaCha8Rng::seed_from_u64(options.seed);
                random.set_stream(1 + (step * options.scenes + i) as u64);
                Example::draw(objects, untried, &prototypes, &shapes, options.places, &mut random)
            })
            .collect();
        let (losses, gradients) =
            gradients(&layout, &arrays, &Batch::of(&scenes, prototypes.len(), layout.change()), &device)?;
        if !(losses.rates + losses.changes).is_finite() {
            let learning_rate = options.learning_rate;
            return Err(Error::Diverged { epoch: step, loss: f64::from(losses.rates + losses.changes), learning_rate });
        }
        let left = 0.5 * (1.0 + (std::f64::consts::PI * step as f64 / options.steps as f64).cos());
        adam.step(&mut arrays, &gradients, options.learning_rate * left);
        (rates, changes, since) = (rates + f64::from(losses.rates), changes + f64::from(losses.changes), since + 1);
        if (step + 1) % 100 == 0 || step + 1 == options.steps {
            let n = f64::from(since);
            let go_on = watch(ProposalProgress { step: step + 1, rates: rates / n, changes: changes / n });
            (rates, changes, since) = (0.0, 0.0, 0);
            if go_on.is_break() {
                break;
            }
        }
    }
    let counts = (objects.len(), objects.iter().map(|o| o.grasps.len()).sum());
    Ok(ProposalNetwork::new(hand, prototypes, arrays, counts, options.seed))
}

/// Logarithm of the rate at the start: nearly everywhere nothing was found.
const START_LOG_RATE: f32 = -5.0;

fn check(objects: &[GraspedObject], hand: &HandCard) -> Result<()> {
    let refuse = |what: String, remedy: &str| {
        Err(Error::Dataset { hand: hand.name.clone(), sample: None, joint: None, what, remedy: remedy.to_owned() })
    };
    let joints = hand.joint_names.len();
    if hand.joint_limits_rad.len() != joints {
        return refuse(
            format!("{joints} joints and {} limits", hand.joint_limits_rad.len()),
            "give a limit for each joint",
        );
    }
    let keys = objects.iter().flat_map(|o| &o.grasps).next().map_or(0, |g| g.key_points.len());
    if keys == 0 {
        return refuse("no object has a grasp".into(), "search with more candidates, or give other objects");
    }
    for object in objects {
        let whole = |g: &&LabelledGrasp| {
            let labels = g.least_friction.len() == LABELLED_KG.len() && g.grip_force_n.len() == LABELLED_KG.len();
            g.joints_rad.len() == joints && g.key_points.len() == keys && labels
        };
        let seen = |v: &Vec<u16>| v.iter().all(|i| usize::from(*i) < object.points.len());
        if object.points.len() < PATCH || !object.views.iter().all(seen) || object.grasps.iter().any(|g| !whole(&g)) {
            let what = format!("\"{}\" has too few points, or views or grasps that do not fit", object.name);
            return refuse(what, "make its grasps again for this hand");
        }
    }
    Ok(())
}

/// Share of the grasps that held of those that were tried, in hundredths: what one counts that nobody has tried.
fn share_held(objects: &[GraspedObject]) -> f32 {
    let tried: Vec<bool> = objects.iter().flat_map(|o| &o.grasps).filter_map(|g| g.held).collect();
    let held = tried.iter().filter(|h| **h).count();
    (100.0 * held as f32 / tried.len().max(1) as f32).round() / 100.0
}

/// The points that tell grasps apart, in a frame.
fn shape(grasp: &LabelledGrasp, anchor: &Pose) -> Vec<f32> {
    let from = anchor.inverse();
    let key = |p: &[f32; 3]| (from * Point3::from(p.map(f64::from))).coords;
    grasp.key_points.iter().flat_map(|p| <[f64; 3]>::from(key(p)).map(|v| v as f32)).collect()
}

/// Prototypes of the grasps of all objects, with the points that tell them apart in the frame of their place.
fn prototypes(objects: &[GraspedObject], count: usize, random: &mut ChaCha8Rng) -> (Vec<Prototype>, Vec<Vec<f32>>) {
    let scenes: Vec<(Scene, &GraspedObject)> =
        objects.par_iter().filter(|o| !o.grasps.is_empty()).map(|o| (Scene::new(&o.points_m()), o)).collect();
    let mut all: Vec<(&LabelledGrasp, Pose)> = Vec::new();
    for _ in 0..FOR_PROTOTYPES {
        let (scene, object) = &scenes[random.random_range(0..scenes.len())];
        let grasp = &object.grasps[random.random_range(0..object.grasps.len())];
        if grasp.contacts.is_empty() {
            continue;
        }
        let contact = grasp.contacts[random.random_range(0..grasp.contacts.len())];
        all.push((grasp, scene.frame(&Point3::from(contact.map(f64::from)))));
    }
    let points: Vec<Vec<f32>> = all.iter().map(|(g, anchor)| shape(g, anchor)).collect();
    let chosen = medoids(&points, count, random);
    let shapes: Vec<Vec<f32>> = chosen.iter().map(|i| points[*i].clone()).collect();
    let of: Vec<usize> = points.par_iter().map(|p| nearest(p, &shapes)).collect();
    let ratios = |g: &LabelledGrasp| -> Vec<f64> {
        let needed = g.least_friction.iter().zip(&g.grip_force_n).zip(LABELLED_KG);
        needed.filter_map(|((mu, n), m)| Some(f64::from((*n)? * (*mu)?) / (m * GRAVITY_M_S2))).collect()
    };
    let prototype = |(k, i): (usize, &usize)| {
        let (grasp, anchor) = &all[*i];
        let like = all.iter().zip(&of).filter(|(_, c)| **c == k).flat_map(|((g, _), _)| ratios(g));
        Prototype {
            joints: grasp.joints_rad.iter().map(|q| f64::from(*q)).collect(),
            anchor_from_base: anchor.inverse() * grasp.world_from_base,
            force_ratio: upper_median(like).unwrap_or(1.0),
        }
    };
    (chosen.iter().enumerate().map(prototype).collect(), shapes)
}

/// What is seen of an object from some places, and what was found there.
struct Example {
    patches: Vec<f32>,
    scalars: Vec<f32>,
    /// Place, prototype, how many were found.
    counts: Vec<(usize, usize, f32)>,
    /// Place, prototype, how much it counts, what has to be changed.
    changes: Vec<(usize, usize, f32, Vec<f32>)>,
}

impl Example {
    fn draw(
        objects: &[GraspedObject],
        untried: f32,
        prototypes: &[Prototype],
        shapes: &[Vec<f32>],
        places: usize,
        random: &mut ChaCha8Rng,
    ) -> Self {
        let object = &objects[random.random_range(0..objects.len())];
        let mass_kg = LABELLED_KG[random.random_range(0..LABELLED_KG.len())];
        let friction = random.random_range(FRICTION[0]..FRICTION[1]);
        let mut points = object.points_m();
        if !object.views.is_empty() && random.random_bool(ONE_VIEW) {
            let view = &object.views[random.random_range(0..object.views.len())];
            if view.len() >= PATCH {
                points = view.iter().map(|i| points[usize::from(*i)]).collect();
            }
        }
        let noise_m = random.random_range(0.0..NOISE_M);
        let mut normal = || -> Vector3<f64> {
            let mut draw =
                || normal_pair(random.random_range(0.0..1.0), std::f64::consts::TAU * random.random_range(0.0..1.0))[0];
            noise_m * Vector3::new(draw(), draw(), draw())
        };
        points.iter_mut().for_each(|p| *p += normal());
        let scene = Scene::new(&points);
        let mut anchors = scene.anchors();
        while anchors.len() > places.max(1) {
            anchors.swap_remove(random.random_range(0..anchors.len()));
        }
        let mut example = Self { patches: Vec::new(), scalars: Vec::new(), counts: Vec::new(), changes: Vec::new() };
        for (place, anchor) in anchors.iter().enumerate() {
            scene.patch(anchor, &mut example.patches);
            scene.scalars(anchor, mass_kg, friction, &mut example.scalars);
            let at = Point3::from(anchor.translation.vector);
            for grasp in object.grasps.iter().filter(|g| g.carries(mass_kg, friction)) {
                let away = grasp.touches().map(|c| (c - at).norm()).fold(f64::INFINITY, f64::min);
                let held = grasp.held.map_or(untried, |h| if h { 1.0 } else { 0.0 });
                if away > FAR_M || held == 0.0 {
                    continue;
                }
                let near = (-std::f64::consts::LN_2 * (away / NEAR_M).powi(2)).exp() as f32;
                let count = near * held * grasp.stands_for;
                let prototype = nearest(&shape(grasp, anchor), shapes);
                let change =
                    prototypes[prototype].change_to(&grasp.joints_rad, &(anchor.inverse() * grasp.world_from_base));
                example.counts.push((place, prototype, count));
                example.changes.push((place, prototype, count, change));
            }
        }
        example
    }
}

/// Examples as the network takes them.
struct Batch {
    patches: Vec<f32>,
    scalars: Vec<f32>,
    /// Places x prototypes.
    counts: Vec<f32>,
    places: Vec<i32>,
    prototypes: Vec<i32>,
    weights: Vec<f32>,
    changes: Vec<f32>,
}

impl Batch {
    fn of(examples: &[Example], prototypes: usize, width: usize) -> Self {
        let mut batch = Self {
            patches: Vec::new(),
            scalars: Vec::new(),
            counts: Vec::new(),
            places: Vec::new(),
            prototypes: Vec::new(),
            weights: Vec::new(),
            changes: Vec::new(),
        };
        let mut first = 0;
        for example in examples {
            let places = example.scalars.len() / SCALARS;
            batch.patches.extend(&example.patches);
            batch.scalars.extend(&example.scalars);
            batch.counts.resize((first + places) * prototypes, 0.0);
            for (place, prototype, count) in &example.counts {
                batch.counts[(first + place) * prototypes + prototype] += count;
            }
            for (place, prototype, weight, change) in &example.changes {
                batch.places.push((first + place) as i32);
                batch.prototypes.push(*prototype as i32);
                batch.weights.push(*weight);
                batch.changes.extend(change);
            }
            first += places;
        }
        if batch.places.is_empty() {
            // Nothing was found anywhere: a change that does not count.
            batch.places.push(0);
            batch.prototypes.push(0);
            batch.weights.push(0.0);
            batch.changes.resize(width, 0.0);
        }
        batch
    }
}

/// Means over what is looked at.
struct Losses {
    rates: f32,
    changes: f32,
}

/// Losses, and the derivatives of both together with respect to every array.
fn gradients(layout: &Layout, arrays: &[Vec<f32>], batch: &Batch, device: &Device) -> Result<(Losses, Vec<Vec<f32>>)> {
    let shapes = layout.arrays();
    let parameters: Vec<Tensor<2>> =
        shapes.iter().zip(arrays).map(|((_, s), v)| tensor(v.clone(), *s, device).require_grad()).collect();
    let (features, log_rates) = places(&parameters, &batch.patches, &batch.scalars, device);
    let count = batch.scalars.len() / SCALARS;
    let found = tensor(batch.counts.clone(), [count, layout.prototypes], device);
    let rates = (log_rates.clone().exp() - found * log_rates).sum() / count as f32;
    let predicted = changes(&parameters, features, &batch.places, &batch.prototypes, device);
    let error = predicted - tensor(batch.changes.clone(), [batch.places.len(), layout.change()], device);
    // Pseudo-Huber: a square near zero, in proportion far from it.
    let error = ((error.clone() * error / (HUBER * HUBER) + 1.0).sqrt() - 1.0) * (HUBER * HUBER);
    let weights = tensor(batch.weights.clone(), [batch.weights.len(), 1], device);
    let total = batch.weights.iter().sum::<f32>().max(1e-6);
    let moved = (error * weights).sum() / total;
    let first = |t: &Tensor<1>| Ok::<f32, Error>(values(t.clone().detach())?[0]);
    let losses = Losses { rates: first(&rates)?, changes: first(&moved)? };
    let mut gradients = (rates + moved * CHANGES).backward();
    let gradient = |p: &Tensor<2>| p.grad_remove(&mut gradients).map(values);
    let found: Vec<Vec<f32>> = parameters
        .iter()
        .map(gradient)
        .map(|g| g.unwrap_or_else(|| Err(Error::Backend { what: "a weight has no gradient".into() })))
        .collect::<Result<_>>()?;
    Ok((losses, found))
}

/// As [`Forward::places`](super::forward::Forward::places), rows for columns.
fn places(p: &[Tensor<2>], patches: &[f32], scalars: &[f32], device: &Device) -> (Tensor<2>, Tensor<2>) {
    let weight = |i: usize| p[i].clone();
    let count = scalars.len() / SCALARS;
    let mut x = tensor(patches.to_vec(), [count * PATCH, 3], device);
    for layer in at::POINT {
        x = relu(x.matmul(weight(layer)) + weight(layer + 1));
    }
    let width = x.dims()[1];
    let x: Tensor<3> = x.reshape([count, PATCH, width]);
    let most: Tensor<2> = x.clone().max_dim(1).reshape([count, width]);
    let mean: Tensor<2> = x.mean_dim(1).reshape([count, width]);
    let scalars = tensor(scalars.to_vec(), [count, SCALARS], device);
    let x = most.matmul(weight(at::FROM_MAX))
        + mean.matmul(weight(at::FROM_MEAN))
        + scalars.matmul(weight(at::FROM_SCALARS));
    let x = relu(x + weight(at::PLACE_BIAS));
    let features = relu(x.matmul(weight(at::PLACE2)) + weight(at::PLACE2 + 1));
    let log_rates = features.clone().matmul(weight(at::RATE)) + weight(at::RATE + 1);
    (features, log_rates)
}

/// As [`Forward::changes`](super::forward::Forward::changes), rows for columns.
fn changes(p: &[Tensor<2>], features: Tensor<2>, places: &[i32], prototypes: &[i32], device: &Device) -> Tensor<2> {
    let weight = |i: usize| p[i].clone();
    let rows = |of: Tensor<2>, at: &[i32]| {
        let at: Tensor<1, Int> = Tensor::from_data(TensorData::new(at.to_vec(), [at.len()]), device);
        of.select(0, at)
    };
    let of_place = rows(features.matmul(weight(at::CHANGE_OF_PLACE)), places);
    let x = relu(of_place + rows(weight(at::CHANGE_OF_PROTOTYPE), prototypes));
    let x = relu(x.matmul(weight(at::CHANGE2)) + weight(at::CHANGE2 + 1));
    x.matmul(weight(at::CHANGE3)) + weight(at::CHANGE3 + 1)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::super::forward::Forward;
    use super::*;

    #[test]
    fn both_ways_through_the_network_agree() {
        let layout = Layout { joints: 3, prototypes: 7 };
        let arrays = layout.initial(5);
        let wave = |n: usize, step: f32| (0..n).map(|i| (i as f32 * step).sin()).collect::<Vec<f32>>();
        let (patches, scalars) = (wave(4 * PATCH * 3, 0.37), wave(4 * SCALARS, 1.1));
        let forward = Forward::new(&layout, &arrays);
        let found = forward.places(&patches, &scalars);
        let pairs = [(0, 3), (2, 6), (3, 0)];
        let changed = forward.changes(&found.features, &pairs);
        let device = device().unwrap();
        let parameters: Vec<Tensor<2>> =
            layout.arrays().iter().zip(&arrays).map(|((_, s), v)| tensor(v.clone(), *s, &device)).collect();
        let (features, log_rates) = places(&parameters, &patches, &scalars, &device);
        let moved = changes(&parameters, features, &[0, 2, 3], &[3, 6, 0], &device);
        let near = |a: &[f32], b: &[f32]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4);
        assert!(near(found.log_rates.as_slice(), &values(log_rates).unwrap()));
        assert!(near(changed.as_slice(), &values(moved).unwrap()));
        assert!(changed.iter().any(|v| v.abs() > 1e-3) && found.log_rates.iter().any(|v| v.abs() > 1e-2));
    }
}
