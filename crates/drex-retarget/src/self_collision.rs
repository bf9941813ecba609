//! What keeps the hand from hitting itself while it is solved: points on every collision shape against the exact distance of the others.

use drex_core::Pose;
use drex_robot::{Geom, Link, Robot, Shape};
use nalgebra::{Point3, Translation3, Vector3};

/// Links keep this distance from each other while a hand is solved, metres: about what the points on the shapes miss.
pub(crate) const CLEARANCE_M: f64 = 0.0015;
/// Distance between the points on a shape, metres.
const SPACING_M: f64 = 0.007;
/// A round shape reaches at most this far beyond its points, m.
const COVERED_M: f64 = 0.001;
/// A box thinner than twice this is a plate, m.
const PLATE_M: f64 = 0.004;
/// Step of the numeric normal, metres.
const NORMAL_STEP_M: f64 = 1e-7;

/// The collision shapes of a robot as a search sees them.
#[derive(Debug, Clone)]
pub(crate) struct CollisionShapes {
    shapes: Vec<CollisionShape>,
    /// Ball around the shapes of each link: centre in the link, radius; and their range.
    links: Vec<(Point3<f64>, f64, std::ops::Range<usize>)>,
    /// Links that can hit each other.
    pairs: Vec<(usize, usize)>,
}

#[derive(Debug, Clone)]
struct CollisionShape {
    shape: Shape,
    link_from_shape: Pose,
    center: Point3<f64>,
    radius_m: f64,
    /// The shape is within these of the origin of its own frame, m.
    half: Vector3<f64>,
    /// In the link's frame.
    points: Vec<Point3<f64>>,
    /// Distance of each from the centre, m.
    reach: Vec<f64>,
}

/// Where two links are nearest to each other, or deepest in each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LinkProximity {
    /// The link with the point and the link with the shape.
    pub(crate) links: (usize, usize),
    /// Object frame.
    pub(crate) point: Point3<f64>,
    /// Outward normal of the shape at the point, object frame.
    pub(crate) normal: Vector3<f64>,
    /// Negative inside.
    pub(crate) distance_m: f64,
}

impl CollisionShapes {
    /// Thin plates reach to the middle of their link, so that there is one way out of them, outwards; what an evaluation measures are the shapes as they
    /// are ([`drex_grasp::HandSurface::self_collision`]).
    pub(crate) fn new(robot: &Robot) -> Self {
        let mut shapes: Vec<CollisionShape> = Vec::new();
        let mut links = Vec::new();
        for link in &robot.links {
            let start = shapes.len();
            let closed = link.geoms.iter().filter(|g| g.collides() && g.shape.is_closed());
            shapes.extend(closed.map(|g| {
                let (shape, link_from_shape) = filled(g, link);
                CollisionShape::new(shape, link_from_shape)
            }));
            let all: Vec<Point3<f64>> = shapes[start..].iter().flat_map(|p| p.points.iter().copied()).collect();
            let (center, radius_m) = ball(&all);
            links.push((center, radius_m, start..shapes.len()));
        }
        let shaped: Vec<usize> = (0..links.len()).filter(|&l| !links[l].2.is_empty()).collect();
        let mut pairs = Vec::new();
        for (k, &a) in shaped.iter().enumerate() {
            pairs.extend(shaped[k + 1..].iter().filter(|&&b| robot.may_collide(a, b)).map(|&b| (a, b)));
        }
        Self { shapes, links, pairs }
    }

    /// Pairs of links that come closer than `within_m`, each with its nearest point.
    pub(crate) fn proximities(&self, links: &[Pose], within_m: f64, found: &mut Vec<LinkProximity>) {
        found.clear();
        let centers: Vec<Point3<f64>> = self.links.iter().zip(links).map(|(l, pose)| pose * l.0).collect();
        // Placed when their link is first needed.
        let mut placed: Vec<Option<Placed>> = vec![None; self.shapes.len()];
        for &(a, b) in &self.pairs {
            let ((_, ra, pa), (_, rb, pb)) = (&self.links[a], &self.links[b]);
            if far(&centers[a], &centers[b], ra + rb + within_m) {
                continue;
            }
            for (link, range) in [(a, pa), (b, pb)] {
                if placed[range.start].is_none() {
                    for i in range.clone() {
                        placed[i] = Some(self.shapes[i].placed(&links[link]));
                    }
                }
            }
            let mut best: Option<(f64, usize, bool, Point3<f64>)> = None;
            for i in pa.clone() {
                for k in pb.clone() {
                    let (p, r) = (&self.shapes[i], &self.shapes[k]);
                    let (Some(at), Some(rt)) = (&placed[i], &placed[k]) else { continue };
                    let limit = best.map_or(within_m, |b| b.0);
                    if far(&at.center, &rt.center, p.radius_m + r.radius_m + limit) {
                        continue;
                    }
                    let of_p = r.shape.signed_distance(&(rt.shape_from_object * at.center));
                    if of_p > p.radius_m + limit {
                        continue;
                    }
                    let of_r = p.shape.signed_distance(&(at.shape_from_object * rt.center));
                    if of_r > r.radius_m + limit {
                        continue;
                    }
                    if let Some((d, point)) = p.nearest_to(r, &links[a], rt, of_p, limit) {
                        best = Some((d, k, true, point));
                    }
                    let limit = best.map_or(within_m, |b| b.0);
                    if let Some((d, point)) = r.nearest_to(p, &links[b], at, of_r, limit) {
                        best = Some((d, i, false, point));
                    }
                }
            }
            if let Some((distance_m, shape, point_on_a, point)) = best
                && let Some(at) = &placed[shape]
            {
                let links = if point_on_a { (a, b) } else { (b, a) };
                found.push(LinkProximity { links, point, normal: self.shapes[shape].normal(at, &point), distance_m });
            }
        }
    }
}

/// A shape in the object's frame.
#[derive(Debug, Clone)]
struct Placed {
    center: Point3<f64>,
    shape_from_object: Pose,
}

impl CollisionShape {
    fn new(shape: Shape, link_from_shape: Pose) -> Self {
        let mut points: Vec<Point3<f64>> = shape.surface_samples(SPACING_M).into_iter().map(|s| s.0).collect();
        if let (Shape::Box { .. }, Some(mesh)) = (&shape, shape.to_mesh(3)) {
            points.extend(mesh.vertices);
        }
        let half =
            points.iter().fold(Vector3::zeros(), |m: Vector3<f64>, p| m.sup(&p.coords.abs())).add_scalar(COVERED_M);
        points.iter_mut().for_each(|p| *p = link_from_shape * *p);
        let (center, radius_m) = ball(&points);
        let reach = points.iter().map(|p| (p - center).norm()).collect();
        Self { shape, link_from_shape, center, radius_m, half, points, reach }
    }

    fn placed(&self, link: &Pose) -> Placed {
        Placed { center: link * self.center, shape_from_object: (link * self.link_from_shape).inverse() }
    }

    /// The point of this shape nearest to the shape of `other`, if nearer than `limit_m`; `center_m` is how far this one's centre is.
    fn nearest_to(
        &self,
        other: &Self,
        own: &Pose,
        placed: &Placed,
        center_m: f64,
        limit_m: f64,
    ) -> Option<(f64, Point3<f64>)> {
        let shape_from_own = placed.shape_from_object * own;
        let mut best = (limit_m, None);
        let (turn, shift) = (shape_from_own.rotation.to_rotation_matrix(), shape_from_own.translation.vector);
        for (p, reach) in self.points.iter().zip(&self.reach) {
            if center_m - reach > best.0 {
                continue;
            }
            let local = turn * p.coords + shift;
            if (local.abs() - other.half).max() > best.0 {
                continue;
            }
            let d = other.shape.signed_distance(&Point3::from(local));
            if d < best.0 {
                best = (d, Some(*p));
            }
        }
        best.1.map(|p| (best.0, own * p))
    }

    /// Gradient of the shape's distance at a point of the object's frame.
    fn normal(&self, placed: &Placed, point: &Point3<f64>) -> Vector3<f64> {
        let local = placed.shape_from_object * point;
        let slope = Vector3::from_fn(|k, _| {
            let step = Vector3::ith(k, NORMAL_STEP_M);
            self.shape.signed_distance(&(local + step)) - self.shape.signed_distance(&(local - step))
        });
        placed.shape_from_object.rotation.inverse() * slope.try_normalize(1e-12).unwrap_or_else(Vector3::z)
    }
}

/// A plate drawn out to the middle of its link; other shapes as they are.
fn filled(geom: &Geom, link: &Link) -> (Shape, Pose) {
    let same = (geom.shape.clone(), geom.link_from_geom);
    let Shape::Box { mut half } = geom.shape else { return same };
    let thin = half.imin();
    if half[thin] > PLATE_M {
        return same;
    }
    let corners: Vec<Point3<f64>> = link
        .geoms
        .iter()
        .filter(|g| g.collides())
        .filter_map(|g| g.shape.to_mesh(8).map(|m| (g.link_from_geom, m.vertices)))
        .flat_map(|(pose, vertices)| vertices.into_iter().map(move |v| pose * v))
        .collect();
    let middle = geom.link_from_geom.inverse_transform_point(&ball(&corners).0);
    let inward = middle[thin];
    if inward.abs() <= half[thin] {
        return same;
    }
    let mut shift = Vector3::zeros();
    shift[thin] = inward.signum() * 0.5 * (inward.abs() - half[thin]);
    half[thin] = 0.5 * (inward.abs() + half[thin]);
    (Shape::Box { half }, geom.link_from_geom * Translation3::from(shift))
}

fn far(a: &Point3<f64>, b: &Point3<f64>, limit: f64) -> bool {
    (a - b).norm_squared() > limit * limit
}

/// Centre of the bounding box and the furthest point from it.
pub(crate) fn ball(points: &[Point3<f64>]) -> (Point3<f64>, f64) {
    let Some(first) = points.first() else { return (Point3::origin(), 0.0) };
    let (lo, hi) = points.iter().fold((*first, *first), |(lo, hi), p| (lo.inf(p), hi.sup(p)));
    let center = nalgebra::center(&lo, &hi);
    (center, points.iter().map(|p| (p - center).norm()).fold(0.0, f64::max))
}
