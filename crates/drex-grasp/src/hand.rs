//! The hand's surface as points, sampled once and reused for many poses.

use std::collections::BTreeMap;

use drex_core::{Pose, SdfSample, SignedDistance};
use drex_robot::{Finger, Robot, Shape};
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::{GraspError, Result};

/// Points on the collision shapes of every link of a hand.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct HandSurface {
    /// One entry per link of the robot, in its order.
    pub links: Vec<LinkSurface>,
    /// The fingers, as the model found them.
    pub fingers: Vec<Finger>,
    /// Per link, the finger that it belongs to.
    pub finger_of_link: Vec<Option<usize>>,
    /// Distance between neighbouring points, metres.
    pub spacing_m: f64,
    /// The closed shapes of the links that can be inside each other.
    shapes: Vec<LinkShape>,
}

/// A collision shape of a link, and the links that can be inside it.
#[derive(Debug, Clone)]
struct LinkShape {
    link: usize,
    link_from_shape: Pose,
    distance: ShapeDistance,
    others: Vec<usize>,
}

/// The distance from a shape, in the shape's frame.
#[derive(Debug, Clone)]
struct ShapeDistance(Shape);

impl SignedDistance for ShapeDistance {
    /// Without a gradient, which nobody asks for here.
    fn signed_distance(&self, point: &Point3<f64>) -> SdfSample {
        SdfSample { distance_m: self.0.signed_distance(point), gradient: Vector3::zeros() }
    }
}

/// Two links inside each other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SelfCollision {
    /// Names of the links.
    pub links: (String, String),
    /// Depth, mm.
    pub depth_mm: f64,
}

/// Points on one link, in patches with a ball around each, so that far patches are skipped whole.
#[derive(Debug, Clone, Default)]
pub struct LinkSurface {
    samples: Vec<Sample>,
    patches: Vec<Patch>,
    ball: Ball,
}

/// A point and its outward unit normal, link frame.
type Sample = (Point3<f64>, Vector3<f64>);

/// A run of samples and the ball around them.
#[derive(Debug, Clone)]
struct Patch {
    samples: std::ops::Range<usize>,
    ball: Ball,
}

/// A ball in the link's frame, metres.
#[derive(Debug, Clone, Copy)]
struct Ball {
    center: Point3<f64>,
    radius_m: f64,
}

impl Default for Ball {
    fn default() -> Self {
        Self { center: Point3::origin(), radius_m: 0.0 }
    }
}

/// Edge of the cells that make patches, metres.
const PATCH_M: f64 = 0.012;

impl HandSurface {
    /// Samples every collision shape of `robot` at about `spacing_m`.
    ///
    /// # Errors
    /// If the spacing is not positive or the robot has no collision shape at all.
    pub fn new(robot: &Robot, spacing_m: f64) -> Result<Self> {
        Self::with_fingers(robot, robot.fingers(), spacing_m)
    }

    /// The same with fingers that somebody else found, such as those that a mapping file names.
    ///
    /// # Errors
    /// As [`HandSurface::new`].
    pub fn with_fingers(robot: &Robot, fingers: Vec<Finger>, spacing_m: f64) -> Result<Self> {
        if !(spacing_m > 1e-5 && spacing_m.is_finite()) {
            return Err(GraspError::value(
                format!("a sample spacing of {spacing_m} m"),
                "give millimetres, such as 0.003",
            ));
        }
        let links: Vec<LinkSurface> =
            (0..robot.links.len()).map(|l| LinkSurface::new(&robot.surface_samples(l, spacing_m))).collect();
        if links.iter().all(|l| l.samples().is_empty()) {
            return Err(GraspError::Robot(format!(
                "\"{}\" has no collision shapes; load a model that has them",
                robot.name
            )));
        }
        let mut finger_of_link = vec![None; robot.links.len()];
        for (index, finger) in fingers.iter().enumerate() {
            for &link in &finger.links {
                finger_of_link[link] = Some(index);
            }
        }
        let shape = |(link, geom): (usize, &drex_robot::Geom)| LinkShape {
            link,
            link_from_shape: geom.link_from_geom,
            distance: ShapeDistance(geom.shape.clone()),
            others: (0..robot.links.len()).filter(|&other| other != link && robot.may_collide(link, other)).collect(),
        };
        let shapes = robot.collision_geoms().filter(|(_, geom)| geom.shape.is_closed()).map(shape).collect();
        Ok(Self { links, fingers, finger_of_link, spacing_m, shapes })
    }

    /// Index of the thumb among the fingers, if the model has one.
    pub fn thumb(&self) -> Option<usize> {
        self.fingers.iter().position(|f| f.is_thumb)
    }

    /// Lowest height of each link's points over the plane `up · x = 0`, in the frame of `link_poses`, metres; infinite for
    /// links without points.
    pub fn lowest(&self, link_poses: &[Pose], up: &Vector3<f64>) -> Vec<f64> {
        let each = self.links.iter().zip(link_poses);
        each.map(|(link, pose)| link.lowest(pose, up, f64::INFINITY).map_or(f64::INFINITY, |l| l.1)).collect()
    }

    /// How deep each link is inside the object, metres, negative for gaps; minus infinity for links without points or with a gap
    /// of more than `exact_within_m`.
    pub fn depths(&self, link_poses: &[Pose], object: &dyn SignedDistance, exact_within_m: f64) -> Vec<f64> {
        let each = self.links.iter().zip(link_poses);
        each.map(|(link, pose)| link.nearest(pose, object, exact_within_m).map_or(f64::NEG_INFINITY, |n| -n.1))
            .collect()
    }

    /// The deepest pair of links of `robot` inside each other at these poses; `None` if all are out of each other.
    pub fn self_collision(&self, robot: &Robot, link_poses: &[Pose]) -> Option<SelfCollision> {
        let mut deepest: Option<(usize, usize, f64)> = None;
        for shape in &self.shapes {
            let shape_from_frame = (link_poses[shape.link] * shape.link_from_shape).inverse();
            for &other in &shape.others {
                let limit_m = deepest.map_or(0.0, |d| d.2);
                let shape_from_other = shape_from_frame * link_poses[other];
                if let Some((_, distance_m)) = self.links[other].nearest(&shape_from_other, &shape.distance, limit_m) {
                    deepest = Some((shape.link, other, distance_m));
                }
            }
        }
        let name = |link: usize| robot.links[link].name.clone();
        deepest.map(|(a, b, distance_m)| SelfCollision { links: (name(a), name(b)), depth_mm: -1e3 * distance_m })
    }
}

impl LinkSurface {
    /// Patches of these points and outward unit normals (link frame, metres).
    pub fn new(samples: &[(Point3<f64>, Vector3<f64>)]) -> Self {
        let mut cells: BTreeMap<[i64; 3], Vec<Sample>> = BTreeMap::new();
        for s in samples {
            // Saturates for points that are not finite; no robot model has them.
            let cell = [0, 1, 2].map(|k| (s.0[k] / PATCH_M).floor() as i64);
            cells.entry(cell).or_default().push(*s);
        }
        let mut surface = Self { ball: Ball::around(samples), ..Self::default() };
        for members in cells.into_values() {
            let start = surface.samples.len();
            surface.patches.push(Patch { samples: start..start + members.len(), ball: Ball::around(&members) });
            surface.samples.extend(members);
        }
        surface
    }

    /// The points with their outward unit normals, link frame.
    pub fn samples(&self) -> &[(Point3<f64>, Vector3<f64>)] {
        &self.samples
    }

    /// Centre (link frame) and radius of a ball around all points, metres.
    pub fn ball(&self) -> (Point3<f64>, f64) {
        (self.ball.center, self.ball.radius_m)
    }

    /// The point nearest to (or deepest in) the object, if its signed distance is below `limit_m`: index and distance.
    ///
    /// Exact for true distances, which change by no more than the way travelled.
    pub fn nearest(&self, object_from_link: &Pose, object: &dyn SignedDistance, limit_m: f64) -> Option<(usize, f64)> {
        let mut best = (None, limit_m);
        self.visit(
            object_from_link,
            object,
            &mut |i, point, best_so_far| {
                let d = object.signed_distance(point).distance_m;
                if d < best_so_far {
                    best = (Some(i), d);
                }
                best.1
            },
            limit_m,
        );
        best.0.map(|i| (i, best.1))
    }

    /// The points within `limit_m`: index and what the object says there.
    pub fn within(
        &self,
        object_from_link: &Pose,
        object: &dyn SignedDistance,
        limit_m: f64,
    ) -> Vec<(usize, SdfSample)> {
        let mut list = Vec::new();
        self.visit(
            object_from_link,
            object,
            &mut |i, point, limit| {
                let s = object.signed_distance(point);
                if s.distance_m <= limit {
                    list.push((i, s));
                }
                limit
            },
            limit_m,
        );
        list
    }

    /// Lowest point along `up` (object frame): its height over the object's origin and its index, if it is below `limit_m`.
    pub fn lowest(&self, object_from_link: &Pose, up: &Vector3<f64>, limit_m: f64) -> Option<(usize, f64)> {
        let origin = object_from_link.translation.vector.dot(up);
        let up = object_from_link.rotation.inverse() * up;
        let height = |p: &Point3<f64>| origin + p.coords.dot(&up);
        let mut best = (None, limit_m);
        if height(&self.ball.center) - self.ball.radius_m >= limit_m {
            return None;
        }
        for patch in &self.patches {
            if height(&patch.ball.center) - patch.ball.radius_m < best.1 {
                for i in patch.samples.clone() {
                    let h = height(&self.samples[i].0);
                    if h < best.1 {
                        best = (Some(i), h);
                    }
                }
            }
        }
        best.0.map(|i| (i, best.1))
    }

    /// Calls `take` (index, point in the object's frame, limit so far → new limit) for the points of all patches that may have
    /// one below the limit.
    fn visit(
        &self,
        object_from_link: &Pose,
        object: &dyn SignedDistance,
        take: &mut dyn FnMut(usize, &Point3<f64>, f64) -> f64,
        mut limit_m: f64,
    ) {
        let beyond = |ball: &Ball, limit: f64| {
            object.signed_distance(&(object_from_link * ball.center)).distance_m - ball.radius_m > limit
        };
        if self.samples.is_empty() || beyond(&self.ball, limit_m) {
            return;
        }
        for patch in &self.patches {
            if !beyond(&patch.ball, limit_m) {
                for i in patch.samples.clone() {
                    limit_m = take(i, &(object_from_link * self.samples[i].0), limit_m);
                }
            }
        }
    }
}

impl Ball {
    /// Centre of the bounding box and the furthest point from it.
    fn around(samples: &[Sample]) -> Self {
        let Some(first) = samples.first() else { return Self::default() };
        let (lo, hi) = samples.iter().fold((first.0, first.0), |(lo, hi), (p, _)| (lo.inf(p), hi.sup(p)));
        let center = nalgebra::center(&lo, &hi);
        Self { center, radius_m: samples.iter().map(|(p, _)| (p - center).norm()).fold(0.0, f64::max) }
    }
}
