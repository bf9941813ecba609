//! Between the network's numbers and physical ones: normalisation of the inputs, targets, and decoding of the outputs.

use drex_core::Pose;
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::GraspSample;
use crate::data::GRAVITY_M_S2;
use crate::weights::SCALARS;

/// tanh reaches its ends only at infinity, but demonstrations often lie on a joint limit: the output interval is this much wider than
/// the limits, and what exceeds them is clamped.
pub(crate) const STRETCH: f64 = 1.02;

/// The force stays within this factor of the grip force per weight seen in training.
const FORCE_MARGIN: f64 = 2.0;

/// Masses beyond this factor of those seen in training are refused.
pub(crate) const MASS_MARGIN: f64 = 10.0;

/// Coefficients of friction beyond this factor of those seen in training are refused.
pub(crate) const FRICTION_MARGIN: f64 = 3.0;

/// Numbers taken from the training samples (never from those held out).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Normalisation {
    /// Scale of points and wrist, lever of angles, m.
    pub length_m: f64,
    /// Lightest object seen, kg.
    pub least_mass_kg: f64,
    /// Heaviest object seen, kg.
    pub most_mass_kg: f64,
    /// Least coefficient of friction seen.
    pub least_friction: f64,
    /// Largest coefficient of friction seen.
    pub most_friction: f64,
    /// Least grip force seen, over weight and times friction.
    #[serde(rename = "least_squeeze")]
    pub least_grip_force: f64,
    /// maximum grip force seen, over weight and times friction.
    #[serde(rename = "most_squeeze")]
    pub most_grip_force: f64,
}

impl Normalisation {
    pub fn new<'a>(samples: impl Iterator<Item = &'a GraspSample>, length_m: f64) -> Self {
        let none = (f64::INFINITY, 0.0_f64);
        let (mut mass, mut friction, mut grip_force) = (none, none, none);
        for s in samples {
            for (range, value) in
                [(&mut mass, s.mass_kg), (&mut friction, s.friction), (&mut grip_force, grip_force_ratio(s))]
            {
                *range = (range.0.min(value), range.1.max(value));
            }
        }
        Self {
            length_m,
            least_mass_kg: mass.0,
            most_mass_kg: mass.1,
            least_friction: friction.0,
            most_friction: friction.1,
            least_grip_force: grip_force.0,
            most_grip_force: grip_force.1,
        }
    }

    /// Whether numbers read from a file can be used.
    pub fn is_sound(&self) -> bool {
        let ordered = |least: f64, most: f64| least > 0.0 && least <= most && most.is_finite() && least.is_normal();
        (1e-3..=10.0).contains(&self.length_m)
            && ordered(self.least_mass_kg, self.most_mass_kg)
            && ordered(self.least_friction, self.most_friction)
            && ordered(self.least_grip_force, self.most_grip_force)
    }

    /// What joins the points after pooling: mass, friction, and the height of the object's centre above the table over the length.
    pub fn scalars(&self, mass_kg: f64, friction: f64, table_m: f64) -> [f32; SCALARS] {
        let mass = within(mass_kg, self.least_mass_kg, self.most_mass_kg);
        let friction = within(friction, self.least_friction, self.most_friction);
        [mass as f32, friction as f32, (table_m / self.length_m) as f32]
    }

    /// Centre and half width of the interval of ln(grip force · friction / weight) that the network can express.
    pub fn log_ratio_interval(&self) -> (f64, f64) {
        let (a, b) = (self.least_grip_force.ln(), self.most_grip_force.ln());
        ((a + b) / 2.0, (b - a) / 2.0 + FORCE_MARGIN.ln())
    }

    /// Grip force in N from the network's output, mass and friction: m g / μ · exp(c + h tanh o).
    pub fn grip_force_n(&self, output: f64, mass_kg: f64, friction: f64) -> f64 {
        let (centre, half) = self.log_ratio_interval();
        mass_kg * GRAVITY_M_S2 / friction * (centre + half * output.tanh()).exp()
    }

    /// The logarithm that stands for a grip force, kept inside what the network can express.
    pub fn log_ratio(&self, grip_force_n: f64, mass_kg: f64, friction: f64) -> f64 {
        let (centre, half) = self.log_ratio_interval();
        let log = (grip_force_n * friction / (mass_kg * GRAVITY_M_S2)).ln();
        log.clamp(centre - 0.98 * half, centre + 0.98 * half)
    }
}

/// -1 at the least and 1 at the largest value of the training data, linear in the logarithm, constant outside. So outside the data the
/// grip force keeps its last ratio and goes on in proportion to the mass and to one over the friction.
fn within(value: f64, least: f64, most: f64) -> f64 {
    let (a, b) = (least.ln(), most.ln());
    if b - a < 1e-9 {
        return 0.0;
    }
    (2.0 * (value.ln() - a) / (b - a) - 1.0).clamp(-1.0, 1.0)
}

/// Grip force times friction over weight of a demonstration, a number near one: two opposed contacts need m g / μ in sum. The geometry of
/// the grasp fixes it; mass and friction drop out as long as torque limits do not bind.
pub(crate) fn grip_force_ratio(sample: &GraspSample) -> f64 {
    sample.grip_force_n * sample.friction / (sample.mass_kg * GRAVITY_M_S2)
}

/// Centre and half width of each joint's interval, rad.
pub(crate) fn joint_intervals(limits: &[(f64, f64)]) -> Vec<(f64, f64)> {
    limits.iter().map(|(a, b)| ((a + b) / 2.0, (b - a) / 2.0)).collect()
}

/// Translation over length and the first two columns of the rotation (Zhou et al. 2019): nine numbers without a jump anywhere on SO(3).
pub(crate) fn wrist_numbers(pose: &Pose, length_m: f64) -> [f64; 9] {
    let t = pose.translation.vector / length_m;
    let r = pose.rotation.to_rotation_matrix();
    let (a, b) = (r.matrix().column(0), r.matrix().column(1));
    [t.x, t.y, t.z, a[0], a[1], a[2], b[0], b[1], b[2]]
}

/// The pose that [`wrist_numbers`] came from; the columns are made orthonormal by Gram-Schmidt. Where they are parallel
/// or zero, some rotation.
pub(crate) fn wrist_pose(numbers: &[f64; 9], length_m: f64) -> Pose {
    let [x, y, z, a, b, c, d, e, f] = *numbers;
    let first = Vector3::new(a, b, c).try_normalize(1e-12).unwrap_or_else(Vector3::x);
    let second = Vector3::new(d, e, f);
    let second = (second - first * first.dot(&second)).try_normalize(1e-12).unwrap_or_else(|| {
        // Any direction across the first: the axis along which it has its smallest component cannot be parallel to it.
        let axis = Vector3::ith(first.iamin(), 1.0);
        (axis - first * first.dot(&axis)).normalize()
    });
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[first, second, first.cross(&second)]));
    Isometry3::from_parts((Vector3::new(x, y, z) * length_m).into(), UnitQuaternion::from_rotation_matrix(&rotation))
}

/// What the last layer must say for its output to be this grasp: the inverse of the decoding, cut short of infinity.
/// `pose` is the palm in the network's frame.
pub(crate) fn outputs_for(limits: &[(f64, f64)], sample: &GraspSample, pose: &Pose, norm: &Normalisation) -> Vec<f32> {
    let inverse_tanh = |v: f64| v.clamp(-0.999, 0.999).atanh();
    let mut out = Vec::new();
    for (&angle, (middle, half)) in sample.joints.iter().zip(joint_intervals(limits)) {
        let part = if half > 0.0 { (angle - middle) / (half * STRETCH) } else { 0.0 };
        out.push(inverse_tanh(part) as f32);
    }
    out.extend(wrist_numbers(pose, norm.length_m).map(|v| v as f32));
    let (middle, half) = norm.log_ratio_interval();
    out.push(inverse_tanh((grip_force_ratio(sample).ln() - middle) / half) as f32);
    out.push(0.0);
    out.extend(sample.contacts.iter().map(|c| if *c { 1.0 } else { -1.0 }));
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn norm() -> Normalisation {
        Normalisation {
            length_m: 0.1,
            least_mass_kg: 0.1,
            most_mass_kg: 0.4,
            least_friction: 0.25,
            most_friction: 1.0,
            least_grip_force: 2.0,
            most_grip_force: 3.0,
        }
    }

    #[test]
    fn force_is_proportional_to_mass_over_friction_and_bounded() {
        let n = norm();
        assert!((n.grip_force_n(0.3, 0.4, 0.5) / n.grip_force_n(0.3, 0.1, 1.0) - 8.0).abs() < 1e-12);
        let unit = 0.2 * GRAVITY_M_S2 / 0.5;
        for output in [-1e30, -3.0, 0.0, 3.0, 1e30] {
            let ratio = n.grip_force_n(output, 0.2, 0.5) / unit;
            assert!((2.0 / 2.0 - 1e-9..=3.0 * 2.0 + 1e-9).contains(&ratio), "{ratio}");
        }
        let log = n.log_ratio(2.4 * unit, 0.2, 0.5);
        assert!((log - 2.4f64.ln()).abs() < 1e-12);
        assert!(n.log_ratio(1e9, 0.2, 0.5).exp() < 6.0);
    }

    #[test]
    fn inputs_span_the_data_and_stop_there() {
        let n = norm();
        let mass = |m: f64| n.scalars(m, 0.5, 0.0)[0];
        assert_eq!(mass(0.1), -1.0);
        assert!(mass(0.2).abs() < 1e-6);
        assert_eq!((mass(0.4), mass(4.0)), (1.0, 1.0));
        let one = Normalisation { most_mass_kg: 0.1, ..n };
        assert_eq!(one.scalars(0.3, 0.25, 0.05), [0.0, -1.0, 0.5]);
    }

    proptest! {
        #[test]
        fn wrist_numbers_round_trip(t in prop::array::uniform3(-1.0..1.0), axis in prop::array::uniform3(-3.0..3.0)) {
            let pose = Isometry3::new(Vector3::from(t), Vector3::from(axis));
            let back = wrist_pose(&wrist_numbers(&pose, 0.1), 0.1);
            prop_assert!((back.translation.vector - pose.translation.vector).norm() < 1e-12);
            prop_assert!(back.rotation.angle_to(&pose.rotation) < 1e-7);
        }

        #[test]
        fn any_nine_numbers_give_a_rotation(numbers in prop::array::uniform9(-2.0..2.0)) {
            let r = wrist_pose(&numbers, 0.1).rotation.to_rotation_matrix();
            prop_assert!((r.matrix().determinant() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn degenerate_columns_give_a_rotation() {
        for numbers in [[0.0; 9], [0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, -1.0, 0.0]] {
            let r = wrist_pose(&numbers, 0.1).rotation;
            assert!((r.norm() - 1.0).abs() < 1e-12);
        }
    }
}
