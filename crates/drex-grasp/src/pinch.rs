//! Pinches of an object nobody has shown how to hold: opposed points of its surface, hand configurations in which the thumb faces the
//! fingers, and fingers that close until they touch. Candidates are many and cheap; the evaluation at the end decides.

use drex_core::{Object, Pose, SignedDistance, SurfacePoint};
use drex_robot::{Finger, Robot};
use nalgebra::{Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::{ContactOptions, EvaluationOptions, Grasp, GraspError, GraspOrigin, HandSurface, Result};

/// Points of the surface from which opposite ones are searched.
const SURFACE_POINTS: usize = 3000;
/// Configurations kept, and tried to find them.
const CONFIGURATIONS: usize = 400;
const DRAWS: usize = 6000;
/// Widths between thumb and fingers that a configuration may have, m.
const WIDTH_M: (f64, f64) = (0.02, 0.11);
/// Least opposition of the closing directions of thumb and fingers: minus the cosine of their angle.
const OPPOSITION: f64 = 0.6;
/// The surface at the other end of a line faces along it at least by this: the cosine.
const ALIGNED: f64 = 0.8;
/// Steps of the way through the object, at most.
const MARCH_STEPS: usize = 200;
/// How far a finger may go to touch, m, and steps on the way.
const REACH_M: f64 = 0.03;
const STEPS: usize = 16;
/// Damping of a step, m.
const REGULAR_M: f64 = 0.01;
/// How deep closing presses, m.
const PRESS_M: f64 = 0.0003;

/// A configuration in which thumb and fingers face each other.
struct Configuration {
    joints: Vec<f64>,
    /// From the fingers' tips to the thumb's, base frame, unit, and its length.
    axis: Unit<Vector3<f64>>,
    width_m: f64,
    middle: Point3<f64>,
}

/// Pinches between opposite points of the surface, from `candidates` that are looked at, in their order. The same for any number of threads.
///
/// # Errors
/// If the hand has no thumb, finger or collision shapes, or the object's friction is none.
pub fn pinch_grasps(object: &Object, robot: &Robot, candidates: usize, seed: u64) -> Result<Vec<Grasp>> {
    if !(object.friction > 0.0 && object.friction.is_finite()) {
        return Err(GraspError::value(format!("friction {}", object.friction), "give a positive number"));
    }
    let within = |limits: Option<(f64, f64)>| limits.is_none_or(|(lo, hi)| lo <= hi && (hi - lo).is_finite());
    if let Some(joint) = robot.joints.iter().find(|j| !within(j.limits)) {
        return Err(GraspError::value(
            format!("joint {} of {} has the limits {:?}", joint.name, robot.name, joint.limits),
            "give a finite range in the hand's model, or none",
        ));
    }
    let hand = HandSurface::new(robot, ContactOptions::default().spacing_m)?;
    let limits = EvaluationOptions::synthesised();
    let configurations = configurations(robot, &hand, seed)?;
    let pairs = pairs(&*object.geometry, &object.surface_points(SURFACE_POINTS, seed), object.friction, seed);
    let search = Search { robot, hand: &hand, object, limits: &limits };
    let found: Vec<Option<Grasp>> = (0..candidates)
        .into_par_iter()
        .map(|i| {
            // One stream per candidate, so that threads do not matter.
            let mut random = ChaCha8Rng::seed_from_u64(seed.wrapping_add(1 + i as u64));
            random.set_stream(1);
            let grasp = match pairs.is_empty() {
                true => None,
                false => search.candidate(&pairs[random.random_range(0..pairs.len())], &configurations, &mut random)?,
            };
            Ok(grasp.map(|g| Grasp { origin: GraspOrigin::Pinch, source: i, ..g }))
        })
        .collect::<Result<_>>()?;
    Ok(found.into_iter().flatten().collect())
}

/// Two opposed points of the surface, object frame.
struct Pair {
    first: Point3<f64>,
    second: Point3<f64>,
}

/// Pairs of points whose normals face away from each other, found by going straight through the object.
fn pairs(object: &dyn SignedDistance, surface: &[SurfacePoint], friction: f64, seed: u64) -> Vec<Pair> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Vec::new();
    for sample in surface {
        // A direction inside the friction cone.
        let lean = (friction.atan() * 0.7) * random.random_range(0.0..1.0_f64).sqrt();
        let heading = direction(&mut random);
        let Some(axis) = sample.normal.cross(&heading).try_normalize(1e-6) else { continue };
        let inward = UnitQuaternion::from_axis_angle(&Unit::new_unchecked(axis), lean) * -sample.normal;
        let Some(second) = through(object, &sample.point, &inward) else { continue };
        let there = object.signed_distance(&second).gradient;
        let width = (second - sample.point).norm();
        if there.dot(&inward) > ALIGNED && width < WIDTH_M.1 {
            out.push(Pair { first: sample.point, second });
        }
    }
    out
}

/// Where a ray that enters at `from` leaves the object.
fn through(object: &dyn SignedDistance, from: &Point3<f64>, direction: &Vector3<f64>) -> Option<Point3<f64>> {
    let mut way = 0.002;
    for _ in 0..MARCH_STEPS {
        let distance = object.signed_distance(&(from + direction * way)).distance_m;
        if distance > -1e-5 {
            return (way > 0.004).then(|| from + direction * way);
        }
        way += (-distance).max(2e-4);
        if way > 2.0 * WIDTH_M.1 {
            return None;
        }
    }
    None
}

/// Configurations in which thumb and fingers close towards each other.
fn configurations(robot: &Robot, hand: &HandSurface, seed: u64) -> Result<Vec<Configuration>> {
    let Some(thumb) = hand.thumb() else {
        return Err(GraspError::Robot(format!("\"{}\" has no thumb; name one in the model", robot.name)));
    };
    let others: Vec<usize> = (0..hand.fingers.len()).filter(|&f| f != thumb).collect();
    if others.is_empty() {
        return Err(GraspError::Robot(format!("\"{}\" has no finger besides the thumb", robot.name)));
    }
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(2);
    let mut out = Vec::new();
    let mut rest = vec![0.0; robot.dof()];
    robot.clamp_to_limits(&mut rest);
    let middle = robot.mid_range();
    for _ in 0..DRAWS {
        let mut q = rest.clone();
        // All fingers curl alike, with small differences; the thumb goes anywhere.
        let curl: Vec<f64> = (0..4).map(|_| random.random_range(0.0..1.3)).collect();
        for (index, finger) in hand.fingers.iter().enumerate() {
            for (k, &j) in finger.joints.iter().enumerate() {
                let (low, high) = robot.joints[j].limits.unwrap_or((rest[j] - 1.0, rest[j] + 1.0));
                q[j] = if index == thumb {
                    random.random_range(low..=high)
                } else {
                    let part = curl[k.min(3)] + random.random_range(-0.1..0.1);
                    rest[j] + part * (middle[j] - rest[j])
                };
            }
        }
        robot.clamp_to_limits(&mut q);
        let poses = robot.forward_kinematics(&q, &Pose::identity());
        let tip = |f: &Finger| poses[f.tip_link] * f.tip_point;
        let closing = |f: &Finger| {
            let (linear, _) = robot.jacobian(&poses, f.tip_link, &tip(f));
            let curl = nalgebra::DVector::from_fn(robot.dof(), |j, _| {
                if f.joints.contains(&j) {
                    (middle[j] - rest[j]).signum() * f64::from(u8::from(middle[j] != rest[j]))
                } else {
                    0.0
                }
            });
            (linear * curl).try_normalize(1e-9)
        };
        let tips: Vector3<f64> =
            others.iter().map(|&f| tip(&hand.fingers[f]).coords).sum::<Vector3<f64>>() / others.len() as f64;
        let across = tip(&hand.fingers[thumb]).coords - tips;
        let Some(axis) = Unit::try_new(across, 1e-6) else { continue };
        let mean = others.iter().filter_map(|&f| closing(&hand.fingers[f])).sum::<Vector3<f64>>();
        let Some(mean) = mean.try_normalize(1e-9) else { continue };
        let width_m = across.norm();
        if (WIDTH_M.0..WIDTH_M.1 + 0.04).contains(&width_m) && mean.dot(&axis) > OPPOSITION {
            let thumb_tip = tip(&hand.fingers[thumb]);
            out.push(Configuration {
                joints: q,
                axis,
                width_m,
                middle: nalgebra::center(&thumb_tip, &Point3::from(tips)),
            });
            if out.len() == CONFIGURATIONS {
                break;
            }
        }
    }
    Ok(out)
}

/// A hand whose fingers are moved onto an object.
pub(crate) struct Search<'a> {
    pub robot: &'a Robot,
    pub hand: &'a HandSurface,
    pub object: &'a Object,
    pub limits: &'a EvaluationOptions,
}

impl Search<'_> {
    fn candidate(
        &self,
        pair: &Pair,
        configurations: &[Configuration],
        random: &mut ChaCha8Rng,
    ) -> Result<Option<Grasp>> {
        let across = pair.first - pair.second;
        let width = across.norm();
        // The skin is some millimetres thick, and the fingers have to close yet.
        let fitting: Vec<&Configuration> =
            configurations.iter().filter(|p| (width + 0.01..width + 0.05).contains(&p.width_m)).collect();
        if fitting.is_empty() {
            return Ok(None);
        }
        let configuration = fitting[random.random_range(0..fitting.len())];
        let (Some(to), Some(turn)) =
            (Unit::try_new(across, 1e-9), UnitQuaternion::rotation_between(&configuration.axis, &across))
        else {
            return Ok(None);
        };
        let roll = UnitQuaternion::from_axis_angle(&to, random.random_range(0.0..std::f64::consts::TAU));
        let rotation = roll * turn;
        let middle = nalgebra::center(&pair.first, &pair.second);
        let object_from_base = Pose::from_parts(Translation3::from(middle - rotation * configuration.middle), rotation);
        // Nearly all of the hand over the table, before anything is solved.
        let q = configuration.joints.clone();
        let poses = self.robot.forward_kinematics(&q, &object_from_base);
        if self.height_m(&poses) < -0.01 || self.depth(&poses) > 0.01 {
            return Ok(None);
        }
        self.touching(q, object_from_base)
    }

    /// The grasp with every finger that is near the surface moved onto it; `None` if that holds nothing.
    pub(crate) fn touching(&self, mut q: Vec<f64>, object_from_base: Pose) -> Result<Option<Grasp>> {
        for finger in &self.hand.fingers {
            self.close(finger, &mut q, &object_from_base);
        }
        let poses = self.robot.forward_kinematics(&q, &object_from_base);
        let height_m = self.height_m(&poses);
        if height_m < self.limits.min_table_clearance_m || self.depth(&poses) > self.limits.max_penetration_m {
            return Ok(None);
        }
        Grasp::new(self.robot, q, object_from_base).screened(self.hand, self.object, self.robot, self.limits)
    }

    /// Height of the lowest point of the hand over the table, metres.
    fn height_m(&self, poses: &[Pose]) -> f64 {
        let table = self.object.table();
        self.hand.lowest(poses, &table.up).into_iter().fold(f64::INFINITY, f64::min) - table.height_m
    }

    /// Deepest point of the hand in the object, m; zero or less if there is none.
    fn depth(&self, poses: &[Pose]) -> f64 {
        self.hand.depths(poses, &*self.object.geometry, 0.0).into_iter().fold(f64::NEG_INFINITY, f64::max)
    }

    /// Moves a finger's nearest point onto the surface, by damped least squares within the joint limits.
    fn close(&self, finger: &Finger, q: &mut [f64], object_from_base: &Pose) {
        for _ in 0..STEPS {
            let poses = self.robot.forward_kinematics(q, object_from_base);
            let mut nearest: Option<(usize, usize, f64)> = None;
            for &link in &finger.links {
                let limit = nearest.map_or(REACH_M, |n| n.2);
                if let Some((index, distance)) =
                    self.hand.links[link].nearest(&poses[link], &*self.object.geometry, limit)
                {
                    nearest = Some((link, index, distance));
                }
            }
            let Some((link, index, distance)) = nearest else { return };
            if (-2.0 * PRESS_M..0.0).contains(&distance) {
                return;
            }
            let point = poses[link] * self.hand.links[link].samples()[index].0;
            let Some(outward) = self.object.geometry.signed_distance(&point).gradient.try_normalize(1e-9) else {
                return;
            };
            let (linear, _) = self.robot.jacobian(&poses, link, &point);
            let j = linear.select_columns(&finger.joints);
            let way = -(distance + PRESS_M).clamp(-0.005, 0.005);
            let normal = &j * j.transpose() + Matrix3::identity() * (REGULAR_M * REGULAR_M);
            let Some(solved) = normal.cholesky().map(|c| c.solve(&(outward * way))) else { return };
            let change = j.transpose() * solved;
            // Undo what the damping takes, so that the point arrives.
            let moved = (&j * &change).dot(&outward) / way;
            let scale = if moved > 0.2 { 1.0 / moved } else { 1.0 };
            for (k, &joint) in finger.joints.iter().enumerate() {
                q[joint] += scale * change[k];
            }
            self.robot.clamp_to_limits(q);
        }
    }
}

/// A uniformly distributed direction (Marsaglia 1972).
fn direction(random: &mut impl Rng) -> Vector3<f64> {
    loop {
        let v = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0_f64));
        let n = v.norm();
        if (0.1..1.0).contains(&n) {
            return v / n;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball around the origin, radius in metres.
    struct Ball(f64);

    impl SignedDistance for Ball {
        fn signed_distance(&self, point: &Point3<f64>) -> drex_core::SdfSample {
            let r = point.coords.norm();
            let gradient = point.coords.try_normalize(1e-12).unwrap_or_else(Vector3::x);
            drex_core::SdfSample { distance_m: r - self.0, gradient }
        }
    }

    #[test]
    fn pairs_lie_across_the_object_within_the_friction_cone() {
        let ball = Ball(0.03);
        let surface: Vec<SurfacePoint> = (0..500)
            .map(|i| {
                let (sin, cos) = f64::from(i).sin_cos();
                let normal = Vector3::new(cos, sin, 0.0);
                SurfacePoint { point: Point3::from(normal * ball.0), normal }
            })
            .collect();
        let leans: Vec<f64> = pairs(&ball, &surface, 0.5, 0)
            .iter()
            .map(|p| {
                assert!((p.second.coords.norm() - ball.0).abs() < 2e-4);
                (p.second - p.first).angle(&-p.first.coords)
            })
            .collect();
        let widest = leans.iter().copied().fold(0.0, f64::max);
        // Within 0.7 of the cone, and over all of that.
        assert!(leans.len() > 400 && widest <= 0.7 * 0.5_f64.atan() + 1e-9, "{} pairs, {widest}", leans.len());
        assert!(widest > 0.6 * 0.5_f64.atan());
    }

    #[test]
    fn fingers_curl_and_close_towards_the_thumb() {
        // The last hand cannot open as far as zero.
        for (name, least) in
            [("leap_right", f64::NEG_INFINITY), ("allegro_right", f64::NEG_INFINITY), ("leap_right", 0.2)]
        {
            let mut robot = Robot::bundled(name).unwrap();
            for limits in robot.joints.iter_mut().filter_map(|j| j.limits.as_mut()).filter(|l| l.1 > 1.0) {
                limits.0 = limits.0.max(least);
            }
            let hand = HandSurface::new(&robot, 0.006).unwrap();
            let (thumb, middle) = (hand.thumb().unwrap(), robot.mid_range());
            let mut rest = vec![0.0; robot.dof()];
            robot.clamp_to_limits(&mut rest);
            let configurations = configurations(&robot, &hand, 3).unwrap();
            assert!(configurations.len() > 50, "{name}: {}", configurations.len());
            for p in &configurations {
                let mut moved = Vector3::zeros();
                for (_, finger) in hand.fingers.iter().enumerate().filter(|(f, _)| *f != thumb) {
                    let mut curled = p.joints.clone();
                    for &j in &finger.joints {
                        let way = middle[j] - rest[j];
                        if way != 0.0 {
                            let part = (p.joints[j] - rest[j]) / way;
                            assert!((-0.1..1.4).contains(&part), "{name}: {part} of the way to the middle");
                            curled[j] += 1e-6 * way.signum();
                        }
                    }
                    let tip =
                        |q: &[f64]| robot.forward_kinematics(q, &Pose::identity())[finger.tip_link] * finger.tip_point;
                    moved += (tip(&curled) - tip(&p.joints)).normalize();
                }
                assert!(moved.normalize().dot(&p.axis) > OPPOSITION - 1e-3, "{name}");
                assert!((WIDTH_M.0..WIDTH_M.1 + 0.04).contains(&p.width_m));
            }
        }
    }

    #[test]
    fn a_joint_without_limits_is_drawn_a_radian_either_way() {
        let mut robot = Robot::bundled("leap_right").unwrap();
        let free = robot.require_joint("th_axl").unwrap();
        robot.joints[free].limits = None;
        let hand = HandSurface::new(&robot, 0.006).unwrap();
        let drawn: Vec<f64> = configurations(&robot, &hand, 1).unwrap().iter().map(|p| p.joints[free]).collect();
        let (low, high) = drawn.iter().fold((0.0_f64, 0.0_f64), |(l, h), q| (l.min(*q), h.max(*q)));
        assert!((-1.0..-0.5).contains(&low) && (0.5..1.0).contains(&high), "{low} to {high} rad");
    }
}
