//! Many grasps from one demonstration: the object's symmetries, and noise that is solved again.

mod symmetry;

use std::f64::consts::TAU;

use drex_core::stats::normal_pair;
use drex_core::{Object, Pose};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::grasp::{FrameContext, GraspHand, GraspOptions, GraspRetargeting, evaluate, single};
use crate::levenberg_marquardt::HandState;
use crate::{Error, GraspFrame, Result, TargetHand};
pub use symmetry::symmetries;

/// Options of [`augment`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AugmentOptions {
    /// The rules of an accepted grasp.
    pub grasp: GraspOptions,
    /// Standard deviation of the wrist's shift, m.
    pub shift_m: f64,
    /// Standard deviation of the wrist's turn about the object's centre of mass, rad.
    pub turn_rad: f64,
    /// Standard deviation of every joint angle, rad.
    pub joint_rad: f64,
    /// A rotation of the object is a symmetry if it moves its surface by at most this, m: grasps are solved again after it.
    pub symmetry_tolerance_m: f64,
    /// Whether the contacts have to be in force closure.
    pub force_closure: bool,
    /// Grasps that differ by less than this are one: wrist, m and rad, every joint, rad.
    pub duplicate: (f64, f64, f64),
    /// Give up after this many attempts for every grasp that is asked for.
    pub attempts_per_grasp: usize,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for AugmentOptions {
    fn default() -> Self {
        Self {
            grasp: GraspOptions::default(),
            shift_m: 0.01,
            turn_rad: 0.15,
            joint_rad: 0.05,
            symmetry_tolerance_m: 0.004,
            force_closure: true,
            duplicate: (0.003, 0.05, 0.05),
            attempts_per_grasp: 8,
            seed: 0,
        }
    }
}

/// One grasp made from a demonstration.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AugmentedGrasp {
    /// The grasp, measured; its joint distance and wrist shift are those to the frame that it came from.
    pub grasp: GraspFrame,
    /// Index of the frame of the sequence that it came from.
    pub source_frame: usize,
    /// Index of the object's symmetry, 0 for none; see [`symmetries`].
    pub symmetry: usize,
    /// By how much the wrist was shifted before it was solved again, mm.
    pub noise_shift_mm: f64,
    /// By how much the wrist was turned before it was solved again, rad.
    pub noise_turn_rad: f64,
}

/// Grasps made from one demonstration, and the effort.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Augmentation {
    /// The grasps, all accepted, none twice.
    pub grasps: Vec<AugmentedGrasp>,
    /// Rotations of the object about its centre of mass that map it onto itself, the identity first.
    pub symmetries: Vec<UnitQuaternion<f64>>,
    /// Number of initial guesses that were solved.
    pub attempts: usize,
    /// Number of attempts that kept the rules, duplicates included.
    pub accepted: usize,
}

/// Initial guesses that are solved at once.
const BATCH: usize = 64;

/// At most `count` grasps from the accepted frames of a sequence, in the object's frame. The same for any number of threads.
///
/// Each attempt takes the next accepted frame, turns it by the next symmetry of the object, adds noise, and solves it again as a
/// single frame. Rejected and repeated grasps are left out.
///
/// # Errors
/// If no frame of the sequence was accepted, or an option makes no sense.
pub fn augment(
    sequence: &GraspRetargeting,
    target: &TargetHand,
    object: &Object,
    options: &AugmentOptions,
    count: usize,
) -> Result<Augmentation> {
    check(options)?;
    let sources: Vec<usize> = (0..sequence.frames.len())
        .filter(|&i| {
            sequence.frames[i].is_accepted() && (sequence.frames[i].evaluation.force_closure || !options.force_closure)
        })
        .collect();
    if sources.is_empty() {
        return Err(Error::value(
            "no frame of the sequence holds the object by the rules",
            "look at the verdicts of its frames, or loosen the limits",
        ));
    }
    let hand = GraspHand::new(target)?;
    let symmetries = symmetries(object, options.symmetry_tolerance_m);
    let mut out = Augmentation { grasps: Vec::new(), symmetries, attempts: 0, accepted: 0 };
    let most = count.saturating_mul(options.attempts_per_grasp);
    while out.grasps.len() < count && out.attempts < most {
        let batch = out.attempts..(out.attempts + BATCH).min(most);
        let solved: Vec<Option<AugmentedGrasp>> = batch
            .clone()
            .into_par_iter()
            .map(|attempt| {
                let source = sources[attempt % sources.len()];
                let symmetry = attempt / sources.len() % out.symmetries.len();
                perturb(&hand, object, &sequence.frames[source], out.symmetries[symmetry], options, attempt).map(
                    |found| {
                        found.map(|(grasp, (noise_shift_mm, noise_turn_rad))| AugmentedGrasp {
                            grasp,
                            source_frame: source,
                            symmetry,
                            noise_shift_mm,
                            noise_turn_rad,
                        })
                    },
                )
            })
            .collect::<Result<_>>()?;
        out.attempts = batch.end;
        for grasp in solved.into_iter().flatten() {
            out.accepted += 1;
            if out.grasps.len() < count && !out.grasps.iter().any(|g| same(&g.grasp, &grasp.grasp, options.duplicate)) {
                out.grasps.push(grasp);
            }
        }
    }
    Ok(out)
}

/// One attempt.
fn perturb(
    hand: &GraspHand<'_>,
    object: &Object,
    source: &GraspFrame,
    symmetry: UnitQuaternion<f64>,
    options: &AugmentOptions,
    attempt: usize,
) -> Result<Option<(GraspFrame, (f64, f64))>> {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    rng.set_stream(attempt as u64);
    let mut normal = || normal_pair(rng.random(), TAU * rng.random::<f64>())[0];
    let center = object.center_of_mass().coords;
    let about = |turn: UnitQuaternion<f64>| Pose::from_parts(Translation3::from(center - turn * center), turn);
    let turned = HandState {
        object_from_base: about(symmetry) * source.grasp.object_from_base,
        q: source.grasp.joints_rad.clone(),
    };
    let shift = Vector3::from_fn(|_, _| normal()) * options.shift_m;
    let turn = Vector3::from_fn(|_, _| normal()) * options.turn_rad;
    let moved = Translation3::from(shift) * about(UnitQuaternion::from_scaled_axis(turn));
    let mut start = HandState { object_from_base: moved * turned.object_from_base, q: turned.q.clone() };
    start.q.iter_mut().for_each(|q| *q += normal() * options.joint_rad);
    hand.target.robot.clamp_to_limits(&mut start.q);
    let target_weights: Vec<f64> = source.fingers.iter().map(|f| f64::from(u8::from(f.takes_part))).collect();
    let planned = single(hand, object, &start, target_weights, &options.grasp);
    let context = FrameContext { reference: &turned, t_s: source.t_s, before: None, up: None };
    let grasp = evaluate(hand, object, &planned, &context, &options.grasp)?;
    let good = grasp.is_accepted() && (grasp.evaluation.force_closure || !options.force_closure);
    Ok(good.then(|| (grasp, (1e3 * shift.norm(), turn.norm()))))
}

fn same(a: &GraspFrame, b: &GraspFrame, (shift_m, turn_rad, joint_rad): (f64, f64, f64)) -> bool {
    let (p, r) = (&a.grasp.object_from_base, &b.grasp.object_from_base);
    (p.translation.vector - r.translation.vector).norm() < shift_m
        && p.rotation.angle_to(&r.rotation) < turn_rad
        && a.grasp.joints_rad.iter().zip(&b.grasp.joints_rad).all(|(x, y)| (x - y).abs() < joint_rad)
}

fn check(options: &AugmentOptions) -> Result<()> {
    let all = [options.shift_m, options.turn_rad, options.joint_rad, options.symmetry_tolerance_m];
    if all.iter().all(|v| *v >= 0.0 && v.is_finite()) {
        return Ok(());
    }
    Err(Error::value(
        format!("noise and tolerance of the augmentation are {all:?}"),
        "give lengths and angles of zero or more",
    ))
}
