//! What is there where a hand knows an object from a scan and itself from a model.

use std::f64::consts::TAU;
use std::sync::Arc;

use drex_core::mesh::convex_hull;
use drex_core::{ConvexPart, Object};
use drex_robot::{ActuatorKind, Robot};
use nalgebra::{Point2, Point3, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::{Error, Result};

/// Waves of the error of a surface, and their lengths, metres.
const WAVES: usize = 6;
const WAVELENGTHS_M: std::ops::RangeInclusive<f64> = 0.03..=0.12;
/// Height above the table from which on the surface is off by all of that, metres: the underside is what stands on the table.
const UNDERSIDE_M: f64 = 0.01;
/// What is lower than this above the table stands on it, and how far a centre of mass stays from the edge of that, metres.
const FLAT_M: f64 = 2e-4;
const EDGE_M: f64 = 0.002;
/// How often a centre of mass that would be beyond it is brought nearer by half.
const HALVINGS: i32 = 4;

/// How far hand and object may be from what a plan knows of them. [`Trial::mismatched`](crate::Trial::mismatched) draws one of each.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Mismatch {
    /// How far points of the object's surface are off, root mean square, m: by smooth waves of 30 to 120 mm.
    pub surface_m: f64,
    /// Farthest that the centre of mass is off, m. The object still stands where it did: what rolls is off along its axis and in height alone, what stands
    /// on a few points, such as the foot of a scan, in height alone.
    pub centre_m: f64,
    /// Part by which dry friction of each joint and gains of each drive are off at most.
    pub joint_share: f64,
    /// How long after the joints were read the command that comes of it acts, s.
    pub latency_s: f64,
}

impl Default for Mismatch {
    /// What a bench may have: 1.2 mm, 10 mm, a fifth, 20 ms.
    fn default() -> Self {
        Self { surface_m: 1.2e-3, centre_m: 0.010, joint_share: 0.2, latency_s: 0.02 }
    }
}

impl Mismatch {
    /// None at all: start from here to have one alone.
    pub const NONE: Self = Self { surface_m: 0.0, centre_m: 0.0, joint_share: 0.0, latency_s: 0.0 };

    pub(crate) fn check(&self) -> Result<()> {
        let Self { surface_m, centre_m, joint_share, latency_s } = *self;
        let demands = [
            ("surface_m", surface_m, (0.0..=0.01).contains(&surface_m)),
            ("centre_m", centre_m, (0.0..=0.1).contains(&centre_m)),
            ("joint_share", joint_share, (0.0..1.0).contains(&joint_share)),
            ("latency_s", latency_s, (0.0..=0.2).contains(&latency_s)),
        ];
        match demands.into_iter().find(|d| !d.2) {
            Some((name, value, _)) => {
                Err(Error::value(format!("mismatch {name} is {value}"), "start from Mismatch::default()"))
            }
            None => Ok(()),
        }
    }

    /// The object with another surface and another centre of mass.
    pub(crate) fn object(&self, known: &Object, random: &mut ChaCha8Rng) -> Object {
        let mut object = known.clone();
        if self.surface_m > 0.0 {
            let waves = Waves::drawn(self.surface_m, random);
            let table = known.table();
            let moved = |c: &Point3<f64>| {
                let height_m = table.up.dot(&c.coords) - table.height_m;
                c + waves.at(c) * (height_m / UNDERSIDE_M).clamp(0.0, 1.0)
            };
            let part = |p: &ConvexPart| {
                let moved: Vec<Point3<f64>> = p.corners().iter().map(moved).collect();
                // What is so thin that its corners now lie in a plane is what it was.
                convex_hull(&moved).map_or_else(|_| p.clone(), ConvexPart::of_hull)
            };
            object.convex_parts = Arc::new(known.convex_parts.iter().map(part).collect());
        }
        let off = self.off_centre(&object, random);
        object.mass_properties.center_of_mass += object.world_from_object.inverse_transform_vector(&off);
        object
    }

    /// How far the centre of mass is off, world, m: no farther to the side than the object stands as it did.
    fn off_centre(&self, object: &Object, random: &mut ChaCha8Rng) -> Vector3<f64> {
        let drawn = self.centre_m * random.random::<f64>().cbrt() * direction(random);
        let pose = object.world_from_object;
        let corners: Vec<Point3<f64>> = object.corners().map(|c| pose * c).collect();
        let lowest = corners.iter().map(|c| c.z).fold(f64::INFINITY, f64::min);
        let stands: Vec<Point2<f64>> = corners.iter().filter(|c| c.z < lowest + FLAT_M).map(|c| c.xy()).collect();
        let centre = pose * object.mass_properties.center_of_mass;
        let brought = |share: f64| Vector3::new(share * drawn.x, share * drawn.y, drawn.z);
        let mut nearer = (0..HALVINGS).map(|k| brought(0.5_f64.powi(k)));
        nearer.find(|d| over(&stands, &(centre + d).xy())).unwrap_or_else(|| brought(0.0))
    }

    /// The hand with other friction and other gains in each of its joints.
    pub(crate) fn hand(&self, known: &Arc<Robot>, random: &mut ChaCha8Rng) -> Arc<Robot> {
        if self.joint_share == 0.0 {
            return known.clone();
        }
        let mut part = || random.random_range(1.0 - self.joint_share..1.0 + self.joint_share);
        let mut hand = (**known).clone();
        hand.joints.iter_mut().for_each(|j| j.friction_loss *= part());
        for a in &mut hand.actuators {
            if let ActuatorKind::Position { kp, kv } = &mut a.kind {
                let part = part();
                (*kp, *kv) = (*kp * part, *kv * part);
            }
        }
        Arc::new(hand)
    }
}

/// Smooth waves that move the points of a surface.
struct Waves(Vec<(Vector3<f64>, Vector3<f64>, f64)>);

impl Waves {
    fn drawn(rms_m: f64, random: &mut ChaCha8Rng) -> Self {
        // The mean square of a sine is a half.
        let height_m = rms_m / (0.5 * WAVES as f64).sqrt();
        let wave = |_| {
            let along = direction(random) * (TAU / random.random_range(WAVELENGTHS_M));
            (along, height_m * direction(random), random.random_range(0.0..TAU))
        };
        Self((0..WAVES).map(wave).collect())
    }

    /// How far a point is moved, m.
    fn at(&self, point: &Point3<f64>) -> Vector3<f64> {
        self.0.iter().map(|(along, by, phase)| by * (along.dot(&point.coords) + phase).sin()).sum()
    }
}

/// A direction, all equally likely.
fn direction(random: &mut ChaCha8Rng) -> Vector3<f64> {
    let z = random.random_range(-1.0..1.0_f64);
    let (sin, cos) = random.random_range(0.0..TAU).sin_cos();
    let r = (1.0 - z * z).sqrt();
    Vector3::new(r * cos, r * sin, z)
}

/// Whether a point is over what an object stands on, with room on all sides.
fn over(stands: &[Point2<f64>], point: &Point2<f64>) -> bool {
    // Some of it lies beyond the point in every direction.
    (0..32).all(|k| {
        let (sin, cos) = (TAU * f64::from(k) / 32.0).sin_cos();
        stands.iter().any(|p| (p.x - point.x) * cos + (p.y - point.y) * sin > EDGE_M)
    })
}

/// Where what is drawn with a seed begins.
pub(crate) fn random(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed ^ 0x6d69_736d_6174_6368)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use drex_core::{MassProperties, Pose};
    use nalgebra::Matrix3;

    use super::*;

    /// A prism of 24 sides that stands on its end or, turned, lies on one of its sides.
    fn prism(pose: Pose) -> Object {
        let corner = |k: usize| {
            let (sin, cos) = (TAU * (k as f64 + 0.5) / 24.0).sin_cos();
            Point3::new(0.03 * cos, 0.03 * sin, if k < 24 { -0.05 } else { 0.05 })
        };
        let hull = convex_hull(&(0..48).map(corner).collect::<Vec<_>>()).unwrap();
        let properties =
            MassProperties { mass_kg: 0.2, center_of_mass: Point3::origin(), inertia: Matrix3::identity() * 1e-4 };
        Object::of_parts(vec![ConvexPart::of_hull(hull)], properties).with_rest_pose(pose).at_world_origin()
    }

    #[test]
    fn the_surface_is_off_by_as_much_as_is_asked_for_and_the_underside_is_what_it_was() {
        let known = prism(Pose::identity());
        let corners = |o: &Object| o.corners().map(|c| o.world_from_object * c).collect::<Vec<_>>();
        let mut mismatch = Mismatch::NONE;
        mismatch.surface_m = 1e-3;
        let (mut sum, mut n) = (0.0, 0.0);
        for seed in 0..200 {
            let off = mismatch.object(&known, &mut random(seed));
            for c in corners(&off) {
                let nearest = corners(&known).into_iter().map(|k| (c - k).norm()).fold(f64::INFINITY, f64::min);
                if c.z < 1e-9 {
                    assert!(nearest < 1e-12, "{nearest}");
                } else {
                    (sum, n) = (sum + nearest * nearest, n + 1.0);
                }
            }
            assert_eq!(off.mass_properties, known.mass_properties);
        }
        let rms = f64::sqrt(sum / n);
        assert!((rms - 1e-3).abs() < 1e-4, "{rms}");
    }

    #[test]
    fn the_centre_of_mass_is_where_the_object_stands_as_it_did() {
        let mut mismatch = Mismatch::NONE;
        mismatch.centre_m = 0.01;
        let offsets = |pose| -> Vec<Vector3<f64>> {
            let known = prism(pose);
            let centre = |o: &Object| o.world_from_object * o.center_of_mass();
            (0..200).map(|seed| centre(&mismatch.object(&known, &mut random(seed))) - centre(&known)).collect()
        };
        let upright = offsets(Pose::identity());
        assert!(upright.iter().all(|o| o.norm() < 0.01));
        assert!(upright.iter().filter(|o| o.x.abs() > 4e-3).count() > 20);
        // Lying, it stands on a side 7.8 mm wide, and rolls where the centre is beyond it.
        let lying = offsets(Pose::rotation(Vector3::x() * std::f64::consts::FRAC_PI_2));
        assert!(lying.iter().all(|o| o.x.abs() < 0.5 * 7.84e-3 - EDGE_M + 1e-4), "rolls");
        assert!(lying.iter().filter(|o| o.y.abs() > 4e-3).count() > 20);
    }

    #[test]
    fn a_hand_is_off_by_its_share_at_most_and_every_seed_has_its_own() {
        for name in ["leap_right", "allegro_right"] {
            let known = Arc::new(Robot::bundled(name).unwrap());
            let mut mismatch = Mismatch::NONE;
            mismatch.joint_share = 0.2;
            let of = |seed| mismatch.hand(&known, &mut random(seed));
            let (one, another) = (of(1), of(2));
            assert_ne!(one.joints[3].friction_loss, another.joints[3].friction_loss);
            for (j, known) in one.joints.iter().zip(&known.joints) {
                assert!((j.friction_loss / known.friction_loss - 1.0).abs() <= 0.2);
            }
            for (a, known) in one.actuators.iter().zip(&known.actuators) {
                let (ActuatorKind::Position { kp, .. }, ActuatorKind::Position { kp: known, .. }) =
                    (a.kind, known.kind)
                else {
                    panic!("{name} has no position drives")
                };
                assert!(kp != known && (kp / known - 1.0).abs() <= 0.2);
            }
        }
    }
}
