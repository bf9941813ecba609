//! Wrist poses to start from: all around the object, at all rolls, above the table.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::residuals::Problem;
use crate::levenberg_marquardt::HandState;

/// Approach directions may point upwards by at most this much (sine of the angle): a hand from below is in the table.
const STEEPEST_FROM_BELOW: f64 = 0.25;
/// The middle between thumb and fingers is put within this fraction of the half extents about the centre.
const OFFSET: f64 = 0.7;
/// Irrational steps of a six-dimensional low-discrepancy sequence (Roberts' R6: powers of 1/1.1127756842787055).
const STEPS: [f64; 6] = [
    0.898_653_712_628_699,
    0.807_578_495_221_377,
    0.725_733_412_978_697_4,
    0.652_183_025_943_172_6,
    0.586_086_697_577_992_3,
    0.526_688_987_007_406_4,
];

/// As many starts as the options ask for, spread evenly.
pub(crate) fn initial_guesses(problem: &Problem<'_>) -> Vec<HandState> {
    let mut rng = ChaCha8Rng::seed_from_u64(problem.options.seed);
    let shift: [f64; 6] = std::array::from_fn(|_| rng.random());
    let frame = HandFrame::new(problem);
    let (lo, hi) = problem.bounds;
    let (center, half) = (nalgebra::center(&lo, &hi), (hi - lo) / 2.0);
    let up = problem.table.up.into_inner();
    (0..problem.options.initial_guesses)
        .map(|i| {
            let u: [f64; 6] = std::array::from_fn(|k| (shift[k] + (i + 1) as f64 * STEPS[k]).fract());
            // Approach: uniform over the part of the sphere that points down or level.
            let z = STEEPEST_FROM_BELOW - u[0] * (1.0 + STEEPEST_FROM_BELOW);
            let flat = (1.0 - z * z).max(0.0).sqrt();
            let (s, c) = (std::f64::consts::TAU * u[1]).sin_cos();
            let (e1, e2) = level_axes(&up);
            let approach = up * z + (e1 * c + e2 * s) * flat;
            let roll = std::f64::consts::TAU * u[2];
            let offset = Vector3::from_fn(|k, _| OFFSET * half[k] * (2.0 * u[3 + k] - 1.0));
            HandState {
                object_from_base: frame.placed(&(center + offset), &approach, roll),
                q: problem.recorded.joints.clone(),
            }
        })
        .collect()
}

/// The hand's own grasp frame, in the base's frame: the middle between the tips, and approach and opposition axes.
struct HandFrame {
    middle: Point3<f64>,
    /// Columns: approach, opposition (thumb to fingers), their cross product.
    axes: Matrix3<f64>,
}

impl HandFrame {
    fn new(problem: &Problem<'_>) -> Self {
        let hand = problem.hand;
        let poses = hand.robot.forward_kinematics(&problem.recorded.joints, &Isometry3::identity());
        let tips = hand.tips(&poses);
        let thumb = tips[hand.thumb];
        let others: Vec<Vector3<f64>> =
            tips.iter().enumerate().filter(|(i, _)| *i != hand.thumb).map(|(_, p)| p.coords).collect();
        let fingers = Point3::from(others.iter().sum::<Vector3<f64>>() / others.len().max(1) as f64);
        let middle = nalgebra::center(&thumb, &fingers);
        let (palm, normal) = hand.palm(&poses);
        let oppose = (fingers - thumb).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        // The hand comes along the palm's normal, mixed with the way from the palm to the tips.
        let toward = (middle - palm).try_normalize(1e-6).unwrap_or(normal) + normal;
        let approach =
            (toward - oppose * oppose.dot(&toward)).try_normalize(1e-6).unwrap_or_else(|| level_axes(&oppose).0);
        Self { middle, axes: Matrix3::from_columns(&[approach, oppose, approach.cross(&oppose)]) }
    }

    /// The base's pose that puts the middle at `at`, the approach axis along `approach`, rolled by `roll` about it.
    fn placed(&self, at: &Point3<f64>, approach: &Vector3<f64>, roll: f64) -> Isometry3<f64> {
        let (e1, e2) = level_axes(approach);
        let (s, c) = roll.sin_cos();
        let oppose = e1 * c + e2 * s;
        let target = Matrix3::from_columns(&[*approach, oppose, approach.cross(&oppose)]);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(target * self.axes.transpose()));
        Isometry3::from_parts(Translation3::from(at.coords - rotation * self.middle.coords), rotation)
    }
}

/// Two unit vectors at right angles to `axis` and each other, right-handed with it.
fn level_axes(axis: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let e1 = axis.cross(&Vector3::ith(axis.iamin(), 1.0)).normalize();
    (e1, axis.cross(&e1))
}
