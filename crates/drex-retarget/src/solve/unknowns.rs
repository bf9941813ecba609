//! What is solved for: joints in a box, the joints that follow them, a base that may float.

use drex_core::Pose;
use drex_robot::Robot;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Unknowns of a floating base: translation, then rotation about the base's origin, both along the source frame's axes.
pub(crate) const BASE: usize = 6;

/// A hand: the base's pose in the source frame and the joint vector.
#[derive(Debug, Clone)]
pub(crate) struct State {
    /// `source_from_base`.
    pub(crate) base: Pose,
    /// Model order.
    pub(crate) q: Vec<f64>,
}

/// Which coordinates are solved for.
#[derive(Debug, Clone)]
pub(crate) struct Unknowns {
    /// Lowest and highest value of each joint unknown.
    pub(crate) bounds: Vec<(f64, f64)>,
    /// Joint whose coordinate each joint unknown is.
    pub(crate) joints: Vec<usize>,
    /// Per joint of the model, the unknown that moves it: coordinate = factor · unknown + offset.
    pub(crate) couplings: Vec<Option<JointCoupling>>,
    /// Whether the base is unknown too; its six come after the joints.
    pub(crate) floating: bool,
    /// Unknowns that are left alone for now.
    pub(crate) held: Vec<bool>,
}

/// coordinate = factor · unknown + offset; factor 1 and offset 0 but for coupled (`mimic`) joints.
#[derive(Debug, Clone, Copy)]
pub(crate) struct JointCoupling {
    pub(crate) unknown: usize,
    pub(crate) factor: f64,
    pub(super) offset: f64,
}

impl Unknowns {
    /// The joints marked in `solved_for`; a joint that follows another (`mimic`) stands for the one that it follows.
    pub(crate) fn new(robot: &Robot, solved_for: &[bool], floating: bool) -> Self {
        let leaders: Vec<_> = (0..robot.dof()).map(|j| leader(robot, j)).collect();
        let mut unknowns = Self {
            bounds: Vec::new(),
            joints: Vec::new(),
            couplings: vec![None; robot.dof()],
            floating,
            held: Vec::new(),
        };
        for j in 0..robot.dof() {
            if (0..robot.dof()).any(|k| solved_for[k] && leaders[k].0 == j) {
                unknowns.joints.push(j);
                unknowns.bounds.push((f64::NEG_INFINITY, f64::INFINITY));
            }
        }
        for (j, &(lead, factor, offset)) in leaders.iter().enumerate() {
            let Some(unknown) = unknowns.joints.iter().position(|&l| l == lead) else { continue };
            unknowns.couplings[j] = Some(JointCoupling { unknown, factor, offset });
            // A follower's limits bind its leader.
            if let Some((lo, hi)) = robot.joints[j].limits
                && factor != 0.0
            {
                let ends = [(lo - offset) / factor, (hi - offset) / factor];
                let bounds = &mut unknowns.bounds[unknown];
                let (low, high) = (bounds.0.max(ends[0].min(ends[1])), bounds.1.min(ends[0].max(ends[1])));
                if low <= high {
                    *bounds = (low, high);
                }
            }
        }
        unknowns.held = vec![false; unknowns.len()];
        unknowns
    }

    /// Number of unknowns.
    pub(crate) fn len(&self) -> usize {
        self.joints.len() + if self.floating { BASE } else { 0 }
    }

    /// Puts unknown `k` (a joint) at `value`, and the joints that follow it.
    pub(crate) fn set(&self, k: usize, value: f64, q: &mut [f64]) {
        for (coordinate, drive) in q.iter_mut().zip(&self.couplings) {
            if let Some(d) = drive
                && d.unknown == k
            {
                *coordinate = d.factor * value + d.offset;
            }
        }
    }

    /// `to` = `from` after `step`, joints within their bounds.
    pub(crate) fn step(&self, from: &State, step: &[f64], to: &mut State) {
        to.q.copy_from_slice(&from.q);
        for (k, (&j, &(lo, hi))) in self.joints.iter().zip(&self.bounds).enumerate() {
            let value = (from.q[j] + step[k]).max(lo).min(hi);
            if self.couplings.len() == self.joints.len() {
                to.q[j] = value;
            } else {
                self.set(k, value, &mut to.q);
            }
        }
        to.base = from.base;
        if self.floating {
            let n = self.joints.len();
            let turn = |axis: usize| UnitQuaternion::from_axis_angle(&Vector3::ith_axis(axis), step[n + 3 + axis]);
            let translation = from.base.translation.vector + Vector3::new(step[n], step[n + 1], step[n + 2]);
            let mut rotation = turn(0) * turn(1) * turn(2) * from.base.rotation;
            rotation.renormalize();
            to.base = Isometry3::from_parts(Translation3::from(translation), rotation);
        }
    }
}

/// The joint that moves joint `j`, with the factor and the offset of the coupling.
fn leader(robot: &Robot, j: usize) -> (usize, f64, f64) {
    let (mut at, mut factor, mut offset) = (j, 1.0, 0.0);
    // Couplings in a circle end after as many steps as there are joints.
    for _ in 0..robot.dof() {
        let Some(m) = robot.joints[at].mimic else { break };
        offset += factor * m.offset;
        factor *= m.multiplier;
        at = m.joint;
    }
    (at, factor, offset)
}
