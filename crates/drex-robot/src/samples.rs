//! Points with normals, evenly over the collision shapes of a link.

use std::f64::consts::PI;

use drex_core::TriMesh;
use nalgebra::{Point3, Unit, Vector3};

use crate::model::{Geom, Robot, Shape};

/// A point that another shape of the link covers by more than this is not on the link's surface, m.
const COVERED: f64 = 1e-6;
/// No shape gets more points than this, however fine the spacing.
const MOST_POINTS: usize = 200_000;
/// Turn from one point of a spiral to the next that spreads points evenly over a disc or a ball.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

type Sample = (Point3<f64>, Vector3<f64>);

impl Robot {
    /// Points and outward unit normals on the collision shapes of `link`, in the link frame, about `spacing_m` apart.
    ///
    /// Points inside another closed collision shape of the same link are left out. The same link and spacing give the
    /// same points in the same order. Empty for a link without collision shapes or a spacing that is not positive.
    pub fn surface_samples(&self, link: usize, spacing_m: f64) -> Vec<Sample> {
        let Some(link) = self.links.get(link) else { return Vec::new() };
        let geoms: Vec<&Geom> = link.geoms.iter().filter(|g| g.collides()).collect();
        let closed: Vec<bool> = geoms.iter().map(|g| g.shape.is_closed()).collect();
        let mut samples = Vec::new();
        for (i, geom) in geoms.iter().enumerate() {
            let covered = |p: &Point3<f64>| {
                geoms.iter().enumerate().any(|(k, other)| {
                    k != i
                        && closed[k]
                        && other.shape.signed_distance(&other.link_from_geom.inverse_transform_point(p)) < -COVERED
                })
            };
            samples.extend(
                geom.shape
                    .surface_samples(spacing_m)
                    .into_iter()
                    .map(|(p, n)| (geom.link_from_geom * p, geom.link_from_geom * n))
                    .filter(|(p, _)| !covered(p)),
            );
        }
        samples
    }
}

impl Shape {
    /// Points and outward unit normals on the surface, in the shape's frame, about `spacing_m` apart; none for a plane.
    pub fn surface_samples(&self, spacing_m: f64) -> Vec<Sample> {
        if spacing_m.is_nan() || spacing_m <= 0.0 {
            return Vec::new();
        }
        match self {
            Self::Plane => Vec::new(),
            Self::Sphere { radius } => {
                ball(count(4.0 * PI * radius * radius, spacing_m)).map(|n| (Point3::from(n * *radius), n)).collect()
            }
            Self::Capsule { radius, half_length } => {
                let mut samples: Vec<Sample> = ball(count(4.0 * PI * radius * radius, spacing_m))
                    .map(|n| (Point3::from(n * *radius + Vector3::z() * half_length.copysign(n.z)), n))
                    .collect();
                samples.extend(side(*radius, *half_length, spacing_m));
                samples
            }
            Self::Cylinder { radius, half_length } => {
                let mut samples: Vec<Sample> = side(*radius, *half_length, spacing_m).collect();
                let n = count(PI * radius * radius, spacing_m);
                for end in [-1.0, 1.0] {
                    samples.extend((0..n).map(|i| {
                        let r = radius * ((i as f64 + 0.5) / n as f64).sqrt();
                        let (sin, cos) = (i as f64 * GOLDEN_ANGLE).sin_cos();
                        (Point3::new(r * cos, r * sin, end * half_length), Vector3::z() * end)
                    }));
                }
                samples
            }
            Self::Box { half } => (0..3).flat_map(|axis| box_faces(half, axis, spacing_m)).collect(),
            Self::Ellipsoid { radii } => {
                // Points of the unit ball stretch unevenly: take enough for the longest radii.
                let longest = radii.max();
                ball(count(4.0 * PI * longest * longest, spacing_m))
                    .filter_map(|u| {
                        let normal = Unit::try_new(u.component_div(radii), 1e-12)?;
                        Some((Point3::from(u.component_mul(radii)), normal.into_inner()))
                    })
                    .collect()
            }
            Self::Mesh(mesh) => on_triangles(mesh, spacing_m),
        }
    }
}

/// How many points an area gets.
fn count(area: f64, spacing: f64) -> usize {
    ((area / (spacing * spacing)).ceil() as usize).clamp(1, MOST_POINTS)
}

/// Unit vectors on a spiral from pole to pole.
fn ball(n: usize) -> impl Iterator<Item = Vector3<f64>> {
    (0..n).map(move |i| {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
        let r = (1.0 - z * z).max(0.0).sqrt();
        let (sin, cos) = (i as f64 * GOLDEN_ANGLE).sin_cos();
        Vector3::new(r * cos, r * sin, z)
    })
}

/// The round side of a cylinder.
fn side(radius: f64, half_length: f64, spacing: f64) -> impl Iterator<Item = Sample> {
    let around = count(2.0 * PI * radius * spacing, spacing).clamp(3, 4096);
    let along = count(2.0 * half_length * spacing, spacing).min(MOST_POINTS / around);
    (0..along * around).map(move |k| {
        let (row, column) = (k / around, k % around);
        // Every other row is turned by half a step.
        let angle = 2.0 * PI * (column as f64 + 0.5 * (row % 2) as f64) / around as f64;
        let n = Vector3::new(angle.cos(), angle.sin(), 0.0);
        let z = half_length * ((2 * row + 1) as f64 / along as f64 - 1.0);
        (Point3::from(n * radius + Vector3::z() * z), n)
    })
}

/// Both faces of a box across `axis`.
fn box_faces(half: &Vector3<f64>, axis: usize, spacing: f64) -> Vec<Sample> {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let cells = |k: usize| ((2.0 * half[k] / spacing).ceil() as usize).clamp(1, 400);
    let (nu, nv) = (cells(u), cells(v));
    let center = |i: usize, n: usize, k: usize| half[k] * ((2 * i + 1) as f64 / n as f64 - 1.0);
    [-1.0, 1.0]
        .into_iter()
        .flat_map(|sign| (0..nu * nv).map(move |k| (sign, k / nv, k % nv)))
        .map(|(sign, i, j)| {
            let mut p = Vector3::zeros();
            p[axis] = sign * half[axis];
            p[u] = center(i, nu, u);
            p[v] = center(j, nv, v);
            let mut n = Vector3::zeros();
            n[axis] = sign;
            (Point3::from(p), n)
        })
        .collect()
}

/// Points on triangles in proportion to their area: what one triangle lacks for a point counts for the next.
fn on_triangles(mesh: &TriMesh, spacing: f64) -> Vec<Sample> {
    let area_per_point = (spacing * spacing).max(mesh.area() / MOST_POINTS as f64);
    let mut samples = Vec::new();
    let mut owed = 0.5;
    let mut largest: Option<(f64, Sample)> = None;
    for f in 0..mesh.faces.len() {
        let [a, b, c] = mesh.triangle(f);
        let cross = (b - a).cross(&(c - a));
        let Some(normal) = cross.try_normalize(1e-300) else { continue };
        let area = 0.5 * cross.norm();
        if largest.is_none_or(|(most, _)| area > most) {
            largest = Some((area, (Point3::from((a.coords + b.coords + c.coords) / 3.0), normal)));
        }
        owed += area / area_per_point;
        while owed >= 1.0 {
            owed -= 1.0;
            // Roberts' additive sequence in two dimensions.
            let k = samples.len() as f64;
            let (mut s, mut t) =
                ((0.3 + k * 0.754_877_666_246_692_8).fract(), (0.2 + k * 0.569_840_290_998_053_3).fract());
            if s + t > 1.0 {
                (s, t) = (1.0 - s, 1.0 - t);
            }
            samples.push((a + (b - a) * s + (c - a) * t, normal));
        }
    }
    // A mesh smaller than the spacing has one point.
    if samples.is_empty() {
        samples.extend(largest.map(|(_, sample)| sample));
    }
    samples
}
