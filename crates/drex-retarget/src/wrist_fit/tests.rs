//! Derivatives of the residuals against finite differences, and where the pads are.

use std::sync::Arc;

use drex_core::{MassProperties, Object, SdfSample, SignedDistance, SolidGeometry, TablePlane};
use drex_robot::Robot;
use nalgebra::{DVector, Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};

use super::residuals::{Problem, Stage, View, linearised, residuals};
use super::{HandModel, WristFitOptions};
use crate::levenberg_marquardt::HandState;
use crate::self_collision::CLEARANCE_M;

/// An ellipsoid's distance to first order: smooth, with curvature.
struct Ball;
impl SignedDistance for Ball {
    fn signed_distance(&self, p: &Point3<f64>) -> SdfSample {
        SdfSample { distance_m: p.coords.norm() - 0.04, gradient: p.coords.normalize() }
    }
}

impl SolidGeometry for Ball {
    fn exact(&self) -> &dyn SignedDistance {
        self
    }

    fn bounding_box(&self) -> (Point3<f64>, Point3<f64>) {
        let corner = Point3::new(0.04, 0.04, 0.04);
        (-corner, corner)
    }
}

#[test]
fn the_derivatives_are_those_of_the_residuals() {
    for name in ["leap_right", "allegro_right"] {
        let robot = Robot::bundled(name).unwrap();
        let options = WristFitOptions::default();
        let hand = HandModel::new(&robot, &options).unwrap();
        let body = MassProperties { mass_kg: 0.2, center_of_mass: Point3::origin(), inertia: Matrix3::identity() };
        let mut object = Object::of_parts(Vec::new(), body);
        object.geometry = Arc::new(Ball);
        let table = TablePlane { up: Vector3::z_axis(), height_m: -0.04 };
        let (mut checked, mut met) = (0, 0);
        for k in 0..24 {
            let a = f64::from(k);
            // Every other hand has its joints anywhere, so that its links meet.
            let anywhere = |j: usize| {
                let (lo, hi) = robot.joints[j].limits.unwrap();
                lo + (hi - lo) * (0.618 * f64::from(k) + 0.755 * j as f64).fract()
            };
            let q = if k % 2 == 0 { robot.mid_range() } else { (0..robot.dof()).map(anywhere).collect() };
            let recorded = hand.recorded_within(&q, 0.15).unwrap();
            let rough = Problem {
                hand: &hand,
                object: &object,
                table,
                bounds: Ball.bounding_box(),
                options: &options,
                recorded: &recorded,
                stage: Stage::Rough,
            };
            let mut close = Vec::new();
            hand.shapes.proximities(&robot.forward_kinematics(&q, &Isometry3::identity()), CLEARANCE_M, &mut close);
            met += close.len();
            let turn = UnitQuaternion::from_euler_angles(1.3 * a, 0.7 * a, 2.1 * a);
            let grasp_center = robot.grasp_center().unwrap();
            // Off to one side: the field has no derivative at the ball's centre.
            let at = 0.11 * Vector3::new((3.0 * a).sin(), (2.0 * a).cos(), a.sin()).normalize();
            let pose = Isometry3::from_parts(Translation3::from(at - turn * grasp_center.coords), turn);
            let state = HandState { object_from_base: pose, q: recorded.joints.clone() };
            for stage in [Stage::Rough, Stage::Final { fingers: 0b1111 }] {
                checked += check(&Problem { stage, ..rough }, &state);
            }
        }
        assert!(checked > 2000, "{name}: only {checked} entries could be compared");
        assert!(met > 5, "{name}: links meet in {met} places");
    }
}

/// Compares every column where the set of active points stays the same; returns how many entries were compared.
fn check(problem: &Problem<'_>, state: &HandState) -> usize {
    let stage = problem.stage;
    let (r, j) = linearised(problem, state, &View::new(problem, state));
    // Curvature is a difference over 2 mm, a percent off 3 cm from the ball's centre and useless at it.
    let pads = problem.hand.pads[0].len();
    if stage != Stage::Rough && r.iter().take(pads).any(|gap_mm| *gap_mm < -10.0) {
        return 0;
    }
    let h = 1e-6;
    let mut compared = 0;
    for column in 0..j.ncols() {
        let step = |sign: f64| {
            let mut s = DVector::zeros(j.ncols());
            s[column] = sign * h;
            let next = state.moved(&s, &problem.object.center_of_mass(), &problem.recorded.intervals);
            residuals(problem, &next, &View::new(problem, &next), None)
        };
        let (plus, minus) = (step(1.0), step(-1.0));
        if plus.len() != r.len() || minus.len() != r.len() {
            continue;
        }
        // In the rough stage the shares of the balance move with the gaps and are held fixed for the derivative.
        let rows = if stage == Stage::Rough { pads } else { r.len() };
        for row in 0..rows {
            // A kink (another point became the nearest) shows as different slopes on both sides.
            let (left, right) = ((r[row] - minus[row]) / h, (plus[row] - r[row]) / h);
            let size = left.abs().max(right.abs()).max(j.row(row).amax()).max(1.0);
            if (left - right).abs() < 1e-3 * size {
                let numeric = 0.5 * (left + right);
                assert!(
                    (numeric - j[(row, column)]).abs() < 2e-2 * size,
                    "row {row} column {column}: {numeric} against {} in {stage:?}",
                    j[(row, column)]
                );
                compared += 1;
            }
        }
    }
    compared
}

#[test]
fn pads_are_on_the_palmar_side_of_every_finger() {
    for name in ["leap_right", "allegro_right"] {
        let robot = Robot::bundled(name).unwrap();
        let hand = HandModel::new(&robot, &WristFitOptions::default()).unwrap();
        let mut straight = vec![0.0; robot.dof()];
        robot.clamp_to_limits(&mut straight);
        let poses = robot.forward_kinematics(&straight, &Isometry3::identity());
        let (_, palm) = hand.palm(&poses);
        for (finger, pad) in hand.fine.fingers.iter().zip(&hand.pads[1]) {
            let normals: Vec<Vector3<f64>> =
                pad.parts.iter().flat_map(|(l, part)| part.samples().iter().map(|s| poses[*l] * s.1)).collect();
            assert!(normals.len() > 20, "{name} {}", finger.name);
            let mean = normals.iter().sum::<Vector3<f64>>() / normals.len() as f64;
            // Straight fingers look where the palm looks; the thumb is elsewhere.
            assert!(finger.is_thumb || mean.dot(&palm) > 0.5, "{name} {}: {mean}", finger.name);
        }
    }
}
