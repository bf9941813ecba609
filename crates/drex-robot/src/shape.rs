//! What shapes can be asked: mass properties, signed distance, a triangle mesh.

use std::f64::consts::PI;

use drex_core::mesh::nearest_on_triangle;
use drex_core::{MassProperties, TriMesh};
use nalgebra::{Matrix3, Point3, Vector3};

use crate::closed;
use crate::model::Shape;

impl Shape {
    /// Mass, centre of mass and inertia in the shape's frame at uniform density; `None` for a plane or a shape
    /// without volume.
    ///
    /// Exact for the primitives and for a closed mesh. An open mesh bounds no solid: its convex hull stands in for it
    /// (see [`Shape::is_closed`]).
    pub fn mass_properties(&self, density_kg_m3: f64) -> Option<MassProperties> {
        let symmetric = |volume: f64, moments_per_mass: Vector3<f64>| {
            let mass_kg = volume * density_kg_m3;
            MassProperties {
                mass_kg,
                center_of_mass: Point3::origin(),
                inertia: Matrix3::from_diagonal(&(moments_per_mass * mass_kg)),
            }
        };
        match self {
            Self::Plane => None,
            Self::Sphere { radius: r } => Some(symmetric(4.0 / 3.0 * PI * r.powi(3), Vector3::repeat(0.4 * r * r))),
            Self::Box { half: h } => {
                let s = h.component_mul(h) / 3.0;
                Some(symmetric(8.0 * h.product(), Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y)))
            }
            Self::Ellipsoid { radii: a } => {
                let s = a.component_mul(a) / 5.0;
                Some(symmetric(4.0 / 3.0 * PI * a.product(), Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y)))
            }
            Self::Cylinder { radius: r, half_length: h } => {
                let across = r * r / 4.0 + h * h / 3.0;
                Some(symmetric(2.0 * PI * r * r * h, Vector3::new(across, across, 0.5 * r * r)))
            }
            Self::Capsule { radius: r, half_length: h } => {
                // Cylinder plus two half balls, each with its centre 3r/8 beyond the end of the cylinder.
                let (cylinder, ball) = (2.0 * PI * r * r * h, 4.0 / 3.0 * PI * r.powi(3));
                let volume = cylinder + ball;
                let along = cylinder * 0.5 * r * r + ball * 0.4 * r * r;
                let across = cylinder * (r * r / 4.0 + h * h / 3.0) + ball * (0.4 * r * r + h * h + 0.75 * h * r);
                Some(symmetric(volume, Vector3::new(across, across, along) / volume))
            }
            Self::Mesh(mesh) => {
                if self.is_closed() {
                    solid(mesh, density_kg_m3)
                } else {
                    solid(&drex_core::mesh::convex_hull(&mesh.vertices).ok()?, density_kg_m3)
                }
            }
        }
        .filter(|m| m.mass_kg > 0.0)
    }

    /// Whether the shape bounds a solid. A mesh does if every edge is used as often in one direction as in the other,
    /// vertices within a millionth of its extent counting as one, but for openings too small to hide a hundredth of
    /// its volume.
    pub fn is_closed(&self) -> bool {
        match self {
            Self::Mesh(mesh) => closed::is_closed(mesh),
            Self::Plane => false,
            _ => true,
        }
    }

    /// Distance from `point` (in the shape's frame) to the surface, negative inside, m.
    ///
    /// Exact for sphere, capsule, cylinder, box, plane and mesh (a mesh must be closed for the sign to mean anything;
    /// its cost is one pass over all faces). For an ellipsoid it is the first-order value f/|∇f| of its level
    /// function, exact on the surface.
    pub fn signed_distance(&self, point: &Point3<f64>) -> f64 {
        let p = point.coords;
        match self {
            Self::Plane => p.z,
            Self::Sphere { radius } => p.norm() - radius,
            Self::Capsule { radius, half_length } => {
                let beyond = p.z - p.z.clamp(-half_length, *half_length);
                Vector3::new(p.x, p.y, beyond).norm() - radius
            }
            Self::Cylinder { radius, half_length } => {
                let (out, up) = (p.xy().norm() - radius, p.z.abs() - half_length);
                out.max(up).min(0.0) + out.max(0.0).hypot(up.max(0.0))
            }
            Self::Box { half } => {
                let d = p.abs() - half;
                d.max().min(0.0) + d.map(|c| c.max(0.0)).norm()
            }
            Self::Ellipsoid { radii } => {
                let k = p.component_div(radii).norm();
                let slope = p.component_div(&radii.component_mul(radii)).norm();
                if slope > 0.0 { k * (k - 1.0) / slope } else { -radii.min() }
            }
            Self::Mesh(mesh) => {
                let nearest = (0..mesh.faces.len())
                    .map(|f| (nearest_on_triangle(point, &mesh.triangle(f)) - point).norm_squared())
                    .fold(f64::INFINITY, f64::min)
                    .sqrt();
                if winding_number(mesh, point) > 0.5 { -nearest } else { nearest }
            }
        }
    }

    /// The surface as triangles, outward, with `segments` (at least 3) around a circle; `None` for a plane.
    pub fn to_mesh(&self, segments: usize) -> Option<TriMesh> {
        let n = segments.max(3);
        match self {
            Self::Plane => None,
            Self::Mesh(mesh) => Some((**mesh).clone()),
            Self::Box { half } => Some(box_mesh(half)),
            Self::Sphere { radius } => Some(lathe(&arc(*radius, 0.0, n), n)),
            Self::Ellipsoid { radii } => {
                let mut mesh = lathe(&arc(1.0, 0.0, n), n);
                mesh.vertices.iter_mut().for_each(|v| v.coords.component_mul_assign(radii));
                Some(mesh)
            }
            Self::Capsule { radius, half_length } => Some(lathe(&arc(*radius, *half_length, n), n)),
            Self::Cylinder { radius: r, half_length: h } => Some(lathe(&[(0.0, -h), (*r, -h), (*r, *h), (0.0, *h)], n)),
        }
    }
}

/// Whether every number is finite.
pub(crate) fn is_finite(body: &MassProperties) -> bool {
    body.mass_kg.is_finite() && body.center_of_mass.iter().chain(body.inertia.iter()).all(|v| v.is_finite())
}

/// Exact properties of a closed mesh, whichever way it is wound.
fn solid(mesh: &TriMesh, density_kg_m3: f64) -> Option<MassProperties> {
    mesh.mass_properties(density_kg_m3).ok().or_else(|| {
        let faces = mesh.faces.iter().map(|f| [f[0], f[2], f[1]]).collect();
        TriMesh { vertices: mesh.vertices.clone(), faces }.mass_properties(density_kg_m3).ok()
    })
}

/// How often the mesh goes around the point: 1 inside, 0 outside (van Oosterom and Strackee, 1983).
fn winding_number(mesh: &TriMesh, p: &Point3<f64>) -> f64 {
    let solid_angle: f64 = (0..mesh.faces.len())
        .map(|f| {
            let [a, b, c] = mesh.triangle(f).map(|v| v - p);
            let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
            let denominator = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
            2.0 * a.dot(&b.cross(&c)).atan2(denominator)
        })
        .sum();
    solid_angle / (4.0 * PI)
}

/// Outline (distance from z, height) from bottom to top of a ball whose halves are drawn apart by `half_length`.
fn arc(radius: f64, half_length: f64, segments: usize) -> Vec<(f64, f64)> {
    let quarter = segments.div_ceil(4).max(2);
    let half = |sign: f64| {
        (0..=quarter).map(move |i| {
            let angle = 0.5 * PI * i as f64 / quarter as f64;
            (radius * angle.cos(), sign * (half_length + radius * angle.sin()))
        })
    };
    let mut outline: Vec<_> = half(-1.0).collect();
    outline.reverse();
    outline.extend(half(1.0).skip(usize::from(half_length == 0.0)));
    if let Some(first) = outline.first_mut() {
        first.0 = 0.0;
    }
    if let Some(last) = outline.last_mut() {
        last.0 = 0.0;
    }
    outline
}

/// The surface that an outline (distance from z, height), bottom to top, first and last on the axis, sweeps about z.
fn lathe(outline: &[(f64, f64)], segments: usize) -> TriMesh {
    let mut mesh = TriMesh::default();
    let inner = &outline[1..outline.len() - 1];
    for &(r, z) in inner {
        for k in 0..segments {
            let angle = 2.0 * PI * k as f64 / segments as f64;
            mesh.vertices.push(Point3::new(r * angle.cos(), r * angle.sin(), z));
        }
    }
    let at = |ring: usize, k: usize| (ring * segments + k % segments) as u32;
    for ring in 1..inner.len() {
        for k in 0..segments {
            mesh.faces.push([at(ring - 1, k), at(ring - 1, k + 1), at(ring, k + 1)]);
            mesh.faces.push([at(ring - 1, k), at(ring, k + 1), at(ring, k)]);
        }
    }
    let (bottom, top) = (mesh.vertices.len() as u32, mesh.vertices.len() as u32 + 1);
    mesh.vertices.push(Point3::new(0.0, 0.0, outline[0].1));
    mesh.vertices.push(Point3::new(0.0, 0.0, outline[outline.len() - 1].1));
    for k in 0..segments {
        mesh.faces.push([bottom, at(0, k + 1), at(0, k)]);
        mesh.faces.push([top, at(inner.len() - 1, k), at(inner.len() - 1, k + 1)]);
    }
    mesh
}

fn box_mesh(half: &Vector3<f64>) -> TriMesh {
    let corner = |i: usize, bit: usize| if i >> bit & 1 == 1 { half[bit] } else { -half[bit] };
    let vertices = (0..8).map(|i| Point3::new(corner(i, 0), corner(i, 1), corner(i, 2))).collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    TriMesh { vertices, faces: quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect() }
}
