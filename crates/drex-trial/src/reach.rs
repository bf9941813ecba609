//! How the fingers open before a grasp and close onto the object, and from where the hand comes.

use drex_core::{Pose, SignedDistance};
use drex_grasp::HandSurface;
use drex_robot::{Finger, Robot};
use nalgebra::{Matrix3, Point3, Vector3};

/// Fingers nearer to the object than this take part in a grasp, m.
const TAKES_PART_M: f64 = 0.008;
/// How far the fingertips open, and how far into the object they are commanded to close, m.
const OPEN_M: f64 = 0.022;
const CLOSE_M: f64 = 0.012;
/// Part of the way from open to closed at which the grasp is passed: all at the same speed.
const GRASP_AT: f64 = OPEN_M / (OPEN_M + CLOSE_M);
/// Steps of a finger's way, and the damping of each, m.
const STEPS: usize = 12;
const REGULAR_M: f64 = 0.01;
/// From how far the hand comes, m, and points of that way that are looked at.
const RETREAT_M: f64 = 0.12;
const RETREAT_STEPS: usize = 6;

/// Joint angles before and after a grasp, rad, and the way to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Reach {
    /// With the fingers off the object.
    pub open: Vec<f64>,
    /// With the fingers at the object.
    pub grasp: Vec<f64>,
    /// What closing fingers are commanded: inside the object.
    pub closed: Vec<f64>,
    /// Where the hand comes from, relative to the grasp, world, m.
    pub retreat: Vector3<f64>,
}

/// The nearest point of a finger to the object.
struct Near {
    link: usize,
    /// Link frame.
    point: Point3<f64>,
    /// Out of the object, object frame.
    outward: Vector3<f64>,
}

impl Reach {
    /// Angle of a joint on the way from open (0) through the grasp to closed (1).
    pub(crate) fn at(&self, joint: usize, s: f64) -> f64 {
        let (open, grasp, closed) = (self.open[joint], self.grasp[joint], self.closed[joint]);
        if s < GRASP_AT {
            open + (grasp - open) * s / GRASP_AT
        } else {
            grasp + (closed - grasp) * (s - GRASP_AT) / (1.0 - GRASP_AT)
        }
    }
}

/// Plans opening, closing and approach of a grasp: `joints` in rad, model order, `object_from_base` where the hand's base is, `object` the
/// distance to the object in its own frame, `world_from_object` with z up and the table at 0.
pub(crate) fn plan(
    robot: &Robot,
    surface: &HandSurface,
    joints: &[f64],
    object_from_base: &Pose,
    object: &dyn SignedDistance,
    world_from_object: &Pose,
) -> Reach {
    let near: Vec<Option<Near>> =
        surface.fingers.iter().map(|f| nearest(robot, surface, f, joints, object_from_base, object)).collect();
    let moved = |way: f64| {
        let mut q = joints.to_vec();
        for (finger, near) in surface.fingers.iter().zip(&near) {
            if let Some(near) = near {
                move_finger(robot, finger, near, &mut q, object_from_base, way);
            }
        }
        q
    };
    let open = moved(OPEN_M);
    let retreat = retreat(robot, surface, &open, object_from_base, object, world_from_object);
    Reach { closed: moved(-CLOSE_M), grasp: joints.to_vec(), open, retreat }
}

fn nearest(
    robot: &Robot,
    surface: &HandSurface,
    finger: &Finger,
    q: &[f64],
    object_from_base: &Pose,
    object: &dyn SignedDistance,
) -> Option<Near> {
    let poses = robot.forward_kinematics(q, object_from_base);
    let mut best: Option<(f64, Near)> = None;
    for &link in &finger.links {
        let limit = best.as_ref().map_or(TAKES_PART_M, |b| b.0);
        if let Some((index, distance)) = surface.links[link].nearest(&poses[link], object, limit) {
            let point = surface.links[link].samples()[index].0;
            let outward = object.signed_distance(&(poses[link] * point)).gradient.try_normalize(1e-9)?;
            best = Some((distance, Near { link, point, outward }));
        }
    }
    best.map(|b| b.1)
}

/// Moves a finger so that its point goes `way` outwards (inwards if negative), by damped least squares, within the joint limits.
fn move_finger(robot: &Robot, finger: &Finger, near: &Near, q: &mut [f64], object_from_base: &Pose, way: f64) {
    for _ in 0..STEPS {
        let poses = robot.forward_kinematics(q, object_from_base);
        let (linear, _) = robot.jacobian(&poses, near.link, &(poses[near.link] * near.point));
        let j = linear.select_columns(&finger.joints);
        let normal = &j * j.transpose() + Matrix3::identity() * (REGULAR_M * REGULAR_M);
        let Some(solved) = normal.cholesky().map(|c| c.solve(&(near.outward * (way / STEPS as f64)))) else { return };
        let change = j.transpose() * solved;
        for (k, &joint) in finger.joints.iter().enumerate() {
            q[joint] += change[k];
        }
        robot.clamp_to_limits(q);
    }
}

/// The first of some directions from which the open hand comes without touching, else the one that touches least.
fn retreat(
    robot: &Robot,
    surface: &HandSurface,
    open: &[f64],
    object_from_base: &Pose,
    object: &dyn SignedDistance,
    world_from_object: &Pose,
) -> Vector3<f64> {
    let poses = robot.forward_kinematics(open, object_from_base);
    let back = robot.palm_link().zip(robot.palm_normal()).map(|(palm, normal)| -(poses[palm].rotation * normal));
    let up = world_from_object.rotation.inverse() * Vector3::z();
    let mut candidates = vec![up];
    if let Some(back) = back {
        candidates.push(back);
        candidates.extend((up + back).try_normalize(1e-6));
    }
    let floor = -world_from_object.translation.z;
    let mut best = (f64::INFINITY, up);
    for direction in candidates {
        let mut worst = f64::NEG_INFINITY;
        for i in 1..=RETREAT_STEPS {
            let away = nalgebra::Translation3::from(direction * (RETREAT_M * i as f64 / RETREAT_STEPS as f64));
            let moved: Vec<Pose> = poses.iter().map(|p| away * p).collect();
            let depth = surface.depths(&moved, object, 0.0).into_iter().fold(f64::NEG_INFINITY, f64::max);
            let lowest = surface.lowest(&moved, &up).into_iter().fold(f64::INFINITY, f64::min);
            worst = worst.max(depth).max(floor - lowest);
        }
        if worst <= 0.0 {
            best = (worst, direction);
            break;
        }
        if worst < best.0 {
            best = (worst, direction);
        }
    }
    world_from_object.rotation * best.1 * RETREAT_M
}
