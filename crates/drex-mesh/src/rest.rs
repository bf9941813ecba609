//! How an object comes to rest on a plane: the faces of its convex hull it can stand on, and how probable each is.
//!
//! Quasi-static, after Goldberg, Mirtich, Zhuang, Craig, Carlisle and Canny, "Part pose statistics: estimators and
//! experiments" (1999): let go in a random orientation, the object lands on the face of its hull that the vertical
//! through its centre of mass meets, which has the probability (solid angle of the face seen from the centre) / 4π. If
//! the centre is not above that face, it rolls over the nearest edge to the next face, and so on; the centre sinks with
//! every roll, so the chain ends.

use nalgebra::{Point2, Point3, Unit, UnitQuaternion, Vector3};
use serde::Serialize;

use drex_core::{Pose, TriMesh};

use crate::topology::{NONE, Topology, ends};
use crate::{Error, Result};
use drex_core::mesh::convex_hull;

/// Settings of [`stable_poses`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RestOptions {
    /// Facets of the hull whose corners lie within this of a facet's plane belong to that face, as a share of the
    /// diagonal of the bounding box.
    pub flat_share: f64,
    /// Faces to stand on whose directions differ by no more than this are one pose, radians: the foot of a scan is
    /// ragged, and the object rocks between its bumps.
    pub same_pose_rad: f64,
    /// An object rolls on from a face on which a slope of this would tip it, radians, if it sinks by that: soft contacts and
    /// the corners of a tessellated round side are no better.
    pub least_tipping_rad: f64,
}

impl Default for RestOptions {
    fn default() -> Self {
        Self { flat_share: 1e-4, same_pose_rad: 2.0_f64.to_radians(), least_tipping_rad: 1.0_f64.to_radians() }
    }
}

/// A pose in which an object rests on the plane z = 0.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RestPose {
    /// Lowest point at z = 0, centre of mass above the origin.
    #[serde(serialize_with = "pose_fields")]
    pub world_from_mesh: Pose,
    /// Probability of ending in this pose when let go in a random orientation.
    pub probability: f64,
    /// Outward normal of the supporting face in the mesh's frame: points down in this pose.
    #[serde(serialize_with = "direction_fields")]
    pub support_normal_in_mesh: Unit<Vector3<f64>>,
    /// How far the centre of mass can move sideways before the object tips, metres.
    pub tipping_margin_m: f64,
    /// Height of the centre of mass over the plane, metres.
    pub rest_height_m: f64,
}

impl RestPose {
    /// The slope at which the object tips, radians: atan(margin / height).
    pub fn tipping_angle_rad(&self) -> f64 {
        self.tipping_margin_m.atan2(self.rest_height_m)
    }
}

/// The poses in which the convex hull of `points` rests stably on a plane, the most probable first; probabilities sum
/// to 1.
///
/// `points` are the corners of the object (of its mesh, or of its collision pieces for what a simulator does) and
/// `center_of_mass` its centre, both in the mesh's frame, metres.
///
/// # Errors
/// If the points have no volume or the centre of mass is not inside their hull.
pub fn stable_poses(
    points: &[Point3<f64>],
    center_of_mass: &Point3<f64>,
    options: &RestOptions,
) -> Result<Vec<RestPose>> {
    let body = Body::new(points, center_of_mass, options)?;
    let mut probability = vec![0.0; body.faces.len()];
    for (start, face) in body.faces.iter().enumerate() {
        probability[body.rolls_to(start)] += face.solid_angle / (4.0 * std::f64::consts::PI);
    }
    let mut ends: Vec<usize> = (0..body.faces.len()).filter(|&f| probability[f] > 0.0).collect();
    ends.sort_by(|&i, &j| probability[j].total_cmp(&probability[i]).then(i.cmp(&j)));
    let total: f64 = probability.iter().sum();

    let mut poses = Vec::new();
    while let Some(&first) = ends.first() {
        let direction = body.faces[first].normal;
        let (same, others): (Vec<usize>, Vec<usize>) =
            ends.iter().partition(|&&f| body.faces[f].normal.angle(&direction) <= options.same_pose_rad);
        // Among the bumps of a ragged foot the object ends on the lowest.
        let lowest = same
            .iter()
            .copied()
            .fold(first, |best, f| if body.faces[f].height < body.faces[best].height { f } else { best });
        let share = same.iter().map(|&f| probability[f]).sum::<f64>() / total;
        poses.push(body.pose(lowest, &-body.faces[lowest].normal, share, options.same_pose_rad));
        ends = others;
    }
    poses.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    Ok(poses)
}

/// The pose in which an object ends that is let go just above the plane with `up_in_mesh` pointing up, turned about
/// the vertical as little as possible. Its probability is 1.
///
/// # Errors
/// As [`stable_poses`]; also if `up_in_mesh` has no direction.
pub fn settled_pose(
    points: &[Point3<f64>],
    center_of_mass: &Point3<f64>,
    up_in_mesh: &Vector3<f64>,
    options: &RestOptions,
) -> Result<RestPose> {
    let up = Unit::try_new(*up_in_mesh, 1e-9)
        .filter(|u| u.iter().all(|c| c.is_finite()))
        .ok_or_else(|| Error::value("the up direction has no length", "give a direction such as 0 0 1"))?;
    let body = Body::new(points, center_of_mass, options)?;
    let last = body.rolls_to(body.met_by(&-up));
    Ok(body.pose(last, &up, 1.0, options.same_pose_rad))
}

/// A face of the hull: facets in one plane.
struct Face {
    normal: Vector3<f64>,
    /// Distance of the centre of mass from the plane.
    height: f64,
    /// Seen from the centre of mass.
    solid_angle: f64,
    vertices: Vec<u32>,
    /// Its border: the ends of each edge and the face behind it.
    border: Vec<([u32; 2], usize)>,
}

struct Body {
    hull: TriMesh,
    center: Point3<f64>,
    faces: Vec<Face>,
    least_slope: f64,
}

impl Body {
    fn new(points: &[Point3<f64>], center: &Point3<f64>, options: &RestOptions) -> Result<Self> {
        let hull = convex_hull(points)?;
        let facets = hull.faces.len();
        let scaled: Vec<Vector3<f64>> = (0..facets)
            .map(|f| {
                let [a, b, c] = hull.triangle(f);
                (b - a).cross(&(c - a))
            })
            .collect();
        let topology = Topology::new(&hull);
        let diagonal = hull.bounds().map_or(0.0, |(lo, hi)| (hi - lo).norm());
        let planes = group_by_plane(&hull, &scaled, &topology, options.flat_share.max(0.0) * diagonal);

        let mut faces: Vec<Face> = planes
            .seeds
            .iter()
            .map(|&seed| {
                let normal = scaled[seed].try_normalize(0.0).unwrap_or_else(Vector3::z);
                let height = normal.dot(&(hull.triangle(seed)[0] - center));
                Face { normal, height, solid_angle: 0.0, vertices: Vec::new(), border: Vec::new() }
            })
            .collect();
        for f in 0..facets {
            let own = planes.of_facet[f];
            faces[own].solid_angle += solid_angle(&hull.triangle(f).map(|p| p - center));
            faces[own].vertices.extend(hull.faces[f]);
            for half in 3 * f..3 * f + 3 {
                let partner = topology.partner[half];
                if partner != NONE && planes.of_facet[partner as usize / 3] != own {
                    let (a, b) = ends(&hull, half as u32);
                    faces[own].border.push(([a, b], planes.of_facet[partner as usize / 3]));
                }
            }
        }
        if let Some(face) = faces.iter().find(|f| !(f.height > 0.0)) {
            return Err(Error::value(
                format!("the centre of mass lies {:.3e} m outside of the convex hull", -face.height),
                "check the mass properties: the centre of a body lies inside its hull",
            ));
        }
        Ok(Self { hull, center: *center, faces, least_slope: options.least_tipping_rad.max(0.0).tan() })
    }

    /// Where the chain of rolls that starts on a face ends.
    fn rolls_to(&self, start: usize) -> usize {
        let mut at = start;
        while let Some(next) = self.next(at) {
            // The centre sinks; where rounding denies it, the object is as good as at rest.
            if !(self.faces[next].height < self.faces[at].height) {
                break;
            }
            at = next;
        }
        at
    }

    /// The face that the object rolls onto from this one, if its centre of mass is not well above it.
    fn next(&self, at: usize) -> Option<usize> {
        let plane = self.plane(at);
        if margin(&self.outline(&plane, &[at])) > self.least_slope * self.faces[at].height {
            return None;
        }
        // Over the nearest edge; two edges that meet in the nearest corner: over the one it is farther beyond.
        let nearness = |ends: &[u32; 2]| {
            let [a, b] = ends.map(|v| plane.project(&self.hull.vertices[v as usize]));
            let along = b - a;
            let t = (-a.coords.dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
            let beyond = a.coords.perp(&along) / along.norm();
            ((a + along * t).coords.norm(), beyond)
        };
        let mut best: Option<(f64, f64, usize)> = None;
        let tie = 1e-9 * self.faces[at].height;
        for (edge, neighbour) in &self.faces[at].border {
            let (distance, beyond) = nearness(edge);
            let better = best.is_none_or(|(d, b, _)| distance < d - tie || (distance <= d + tie && beyond < b));
            if better && distance.is_finite() {
                best = Some((distance, beyond, *neighbour));
            }
        }
        best.map(|(_, _, neighbour)| neighbour)
    }

    /// The face that a ray from the centre of mass leaves through.
    fn met_by(&self, direction: &Vector3<f64>) -> usize {
        let reach = |f: usize| {
            let towards = self.faces[f].normal.dot(direction);
            if towards > 0.0 { self.faces[f].height / towards } else { f64::INFINITY }
        };
        (0..self.faces.len()).fold(0, |best, f| if reach(f) < reach(best) { f } else { best })
    }

    fn plane(&self, face: usize) -> Plane {
        let n = self.faces[face].normal;
        let u = n.cross(&Vector3::ith(n.iamin(), 1.0)).normalize();
        Plane { center: self.center, u, v: n.cross(&u) }
    }

    /// Convex outline of faces in a plane, counter-clockwise seen from below, with the centre of mass as the origin.
    fn outline(&self, plane: &Plane, faces: &[usize]) -> Vec<Point2<f64>> {
        let vertices = faces.iter().flat_map(|&f| &self.faces[f].vertices);
        outline(vertices.map(|&v| plane.project(&self.hull.vertices[v as usize])).collect())
    }

    /// The pose on `face`, reached with `up` up. Faces within `same_pose_rad` of it belong to the foot, whose outline decides
    /// the tipping margin.
    fn pose(&self, face: usize, up: &Vector3<f64>, probability: f64, same_pose_rad: f64) -> RestPose {
        let normal = Unit::new_unchecked(self.faces[face].normal);
        let foot: Vec<usize> =
            (0..self.faces.len()).filter(|&f| self.faces[f].normal.angle(&normal) <= same_pose_rad).collect();
        // First `up` up, then the little turn that brings the face down.
        let rough = turn(up, &Vector3::z());
        let rotation = turn(&(rough * -normal.into_inner()), &Vector3::z()) * rough;
        let lowest = self.hull.vertices.iter().map(|v| (rotation * v).z).fold(f64::INFINITY, f64::min);
        let c = rotation * self.center;
        RestPose {
            world_from_mesh: Pose::from_parts(Vector3::new(-c.x, -c.y, -lowest).into(), rotation),
            probability,
            support_normal_in_mesh: normal,
            tipping_margin_m: margin(&self.outline(&self.plane(face), &foot)),
            rest_height_m: c.z - lowest,
        }
    }
}

struct Plane {
    center: Point3<f64>,
    u: Vector3<f64>,
    v: Vector3<f64>,
}

impl Plane {
    fn project(&self, p: &Point3<f64>) -> Point2<f64> {
        let d = p - self.center;
        Point2::new(self.u.dot(&d), self.v.dot(&d))
    }
}

struct Planes {
    /// The facet whose plane each face has.
    seeds: Vec<usize>,
    of_facet: Vec<usize>,
}

/// Facets grow into faces from the largest one on: neighbours join whose corners lie in its plane within `flat_m`.
fn group_by_plane(hull: &TriMesh, scaled: &[Vector3<f64>], topology: &Topology, flat_m: f64) -> Planes {
    let mut order: Vec<usize> = (0..scaled.len()).collect();
    order.sort_by(|&i, &j| scaled[j].norm().total_cmp(&scaled[i].norm()).then(i.cmp(&j)));
    let mut planes = Planes { seeds: Vec::new(), of_facet: vec![usize::MAX; scaled.len()] };
    for seed in order {
        if planes.of_facet[seed] != usize::MAX {
            continue;
        }
        let own = planes.seeds.len();
        planes.seeds.push(seed);
        planes.of_facet[seed] = own;
        let Some(normal) = scaled[seed].try_normalize(0.0) else { continue };
        let origin = hull.triangle(seed)[0];
        let mut open = vec![seed];
        while let Some(f) = open.pop() {
            for half in 3 * f..3 * f + 3 {
                let partner = topology.partner[half];
                if partner == NONE {
                    continue;
                }
                let g = partner as usize / 3;
                let flat = hull.triangle(g).iter().all(|p| normal.dot(&(p - origin)).abs() <= flat_m);
                if planes.of_facet[g] == usize::MAX && flat {
                    planes.of_facet[g] = own;
                    open.push(g);
                }
            }
        }
    }
    planes
}

/// Solid angle of a triangle seen from the origin (Van Oosterom and Strackee 1983), positive when it faces away.
fn solid_angle([a, b, c]: &[Vector3<f64>; 3]) -> f64 {
    let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
    let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * a.dot(&b.cross(c)).atan2(below)
}

/// The shortest turn from one direction to another; for opposite ones a half turn about a horizontal axis.
pub(crate) fn turn(from: &Vector3<f64>, to: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(from, to).unwrap_or_else(|| {
        let sideways = to.cross(&Vector3::ith(to.iamin(), 1.0));
        UnitQuaternion::from_axis_angle(&Unit::new_normalize(sideways), std::f64::consts::PI)
    })
}

/// Convex hull of points in the plane, counter-clockwise (Andrew 1979).
fn outline(mut points: Vec<Point2<f64>>) -> Vec<Point2<f64>> {
    points.sort_by(|p, q| p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)));
    points.dedup();
    let mut chain: Vec<Point2<f64>> = Vec::new();
    for pass in 0..2 {
        let start = chain.len();
        for p in &points {
            while chain.len() >= start + 2 {
                let (a, b) = (chain[chain.len() - 2], chain[chain.len() - 1]);
                if (b - a).perp(&(p - b)) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(*p);
        }
        chain.pop();
        if pass == 0 {
            points.reverse();
        }
    }
    chain
}

/// How far inside a convex outline the origin lies, negative outside (then to the line farthest away).
fn margin(outline: &[Point2<f64>]) -> f64 {
    let n = outline.len();
    if n < 3 {
        return f64::NEG_INFINITY;
    }
    let inside = |k: usize| {
        let (a, b) = (outline[k], outline[(k + 1) % n]);
        a.coords.perp(&(b - a)) / (b - a).norm()
    };
    (0..n).map(inside).fold(f64::INFINITY, f64::min)
}

fn pose_fields<S: serde::Serializer>(pose: &Pose, s: S) -> std::result::Result<S::Ok, S::Error> {
    use serde::ser::SerializeStruct;
    let (position, quaternion) = drex_core::pose::to_wxyz(pose);
    let mut fields = s.serialize_struct("Pose", 2)?;
    fields.serialize_field("position_m", &position)?;
    fields.serialize_field("quaternion_wxyz", &quaternion)?;
    fields.end()
}

fn direction_fields<S: serde::Serializer>(d: &Unit<Vector3<f64>>, s: S) -> std::result::Result<S::Ok, S::Error> {
    Serialize::serialize(&<[f64; 3]>::from(d.into_inner()), s)
}
