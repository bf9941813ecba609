//! Shapes made ready for contact: everything in the frame of the body, computed once.

use std::sync::Arc;

use drex_core::Pose;
use nalgebra::{Matrix3, Vector3};

use super::feature::{Frame, Plane};
use crate::{ConvexPolyhedron, Error, Result, SdfShape, Shape, SurfacePoints};

/// A geom ready for contact.
#[derive(Debug, Clone)]
pub(crate) struct CollisionGeom {
    pub kind: Kind,
    /// A ball around it, in the frame of the body; of infinite radius for a plane.
    pub center: Vector3<f64>,
    pub radius: f64,
}

/// What it is, in the frame of the body.
#[derive(Debug, Clone)]
pub(crate) enum Kind {
    Plane(Plane),
    Sphere { center: Vector3<f64>, radius: f64 },
    Capsule { ends: [Vector3<f64>; 2], radius: f64 },
    Cylinder(Cylinder),
    Poly(Poly),
    Sdf { sdf: Arc<SdfShape>, shape_from_body: Frame<f64> },
    Points { points: Arc<SurfacePoints>, body_from_shape: Frame<f64> },
}

/// A cylinder from `center - axis half_length` to `center + axis half_length`.
#[derive(Debug, Clone)]
pub(crate) struct Cylinder {
    pub center: Vector3<f64>,
    pub axis: Vector3<f64>,
    pub radius: f64,
    pub half_length: f64,
    /// Stands for it against shapes with faces. Corner 2 i is on the rim at `-axis`, 2 i + 1 on the other.
    pub prism: Poly,
}

/// A convex polyhedron.
#[derive(Debug, Clone)]
pub(crate) struct Poly {
    pub vertices: Vec<Vector3<f64>>,
    pub planes: Vec<Plane>,
    pub areas: Vec<f64>,
    pub edges: Vec<Edge>,
    /// Sides of all faces, counter-clockwise; those of face f are `side_start[f]..side_start[f + 1]`.
    sides: Vec<FaceSide>,
    side_start: Vec<u32>,
    /// Faces at each vertex, laid out like the sides.
    at_vertex: Vec<u32>,
    vertex_start: Vec<u32>,
    /// Length of rim that each vertex stands for, over the mean on its face.
    pub weights: Vec<f64>,
    /// A box around it: middle, directions of its sides (columns), half extents.
    pub middle: Vector3<f64>,
    pub axes: Matrix3<f64>,
    pub half: Vector3<f64>,
    /// If it is that box: its faces against and along each axis.
    pub box_faces: Option<[[u32; 2]; 3]>,
}

/// An edge: its ends, the two faces beside it, its unit direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Edge {
    pub ends: [u32; 2],
    pub faces: [u32; 2],
    pub along: Vector3<f64>,
}

/// One side of a face: the vertex it starts at, its edge, and the plane through it that stands on the face, whose normal
/// points away from the face.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FaceSide {
    pub vertex: u32,
    pub edge: u32,
    pub cut: Plane,
}

impl Cylinder {
    pub fn ends(&self) -> [Vector3<f64>; 2] {
        [self.center - self.axis * self.half_length, self.center + self.axis * self.half_length]
    }

    /// How far the sides of the prism are inside the cylinder.
    pub fn sagitta(&self) -> f64 {
        self.radius * (1.0 - (std::f64::consts::PI / f64::from(Shape::CYLINDER_SIDES)).cos())
    }
}

impl CollisionGeom {
    /// # Errors
    /// For sizes that no shape has and a pose that is not finite.
    pub fn new(shape: &Shape, body_from_shape: &Pose) -> Result<Self> {
        shape.check()?;
        let q = &body_from_shape.rotation.coords;
        if body_from_shape.translation.vector.iter().chain(q.iter()).any(|x| !x.is_finite()) {
            return Err(Error::NotFinite { what: "the pose of a shape on its body".into() });
        }
        let frame = Frame::of(body_from_shape);
        let z = frame.r.column(2).into_owned();
        let origin = frame.p;
        Ok(match shape {
            Shape::Plane => Self { kind: Kind::Plane((z, z.dot(&origin))), center: origin, radius: f64::INFINITY },
            Shape::Sphere { radius_m } => {
                let kind = Kind::Sphere { center: origin, radius: *radius_m };
                Self { kind, center: origin, radius: *radius_m }
            }
            Shape::Capsule { radius_m, half_length_m } => {
                let ends = [origin - z * *half_length_m, origin + z * *half_length_m];
                let kind = Kind::Capsule { ends, radius: *radius_m };
                Self { kind, center: origin, radius: radius_m + half_length_m }
            }
            Shape::Cylinder { radius_m, half_length_m } => {
                let (radius, half_length) = (*radius_m, *half_length_m);
                let prism = Poly::new(&ConvexPolyhedron::prism(radius, half_length, Shape::CYLINDER_SIDES), &frame);
                let kind = Kind::Cylinder(Cylinder { center: origin, axis: z, radius, half_length, prism });
                Self { kind, center: origin, radius: radius.hypot(half_length) }
            }
            Shape::Box { half_m } => Self::poly(Poly::new(&ConvexPolyhedron::cuboid(half_m), &frame).into_box()),
            Shape::Convex(piece) => Self::poly(Poly::new(piece, &frame)),
            Shape::Sdf(sdf) => {
                let (lo, hi) = sdf.bounds();
                let kind = Kind::Sdf { sdf: sdf.clone(), shape_from_body: frame.inverse() };
                Self { kind, center: frame.point(&((lo.coords + hi.coords) / 2.0)), radius: (hi - lo).norm() / 2.0 }
            }
            Shape::Points(points) => {
                let kind = Kind::Points { points: points.clone(), body_from_shape: frame };
                let (center, radius) = points.tree().nodes.first().map_or((Vector3::zeros(), 0.0), |root| {
                    let reach = points.tree().points.iter().map(|p| (p - root.center).norm()).fold(0.0, f64::max);
                    (root.center, reach)
                });
                Self { kind, center: frame.point(&center), radius }
            }
        })
    }

    fn poly(poly: Poly) -> Self {
        let center = poly.middle;
        let radius = poly.vertices.iter().map(|v| (v - center).norm()).fold(0.0, f64::max);
        Self { kind: Kind::Poly(poly), center, radius }
    }
}

impl Poly {
    pub fn new(piece: &ConvexPolyhedron, frame: &Frame<f64>) -> Self {
        let vertices: Vec<Vector3<f64>> = piece.vertices().iter().map(|v| frame.point(&v.coords)).collect();
        let planes: Vec<Plane> = piece.planes().iter().map(|plane| frame.plane(plane)).collect();
        let unit = |[a, b]: [u32; 2]| {
            (vertices[b as usize] - vertices[a as usize]).try_normalize(0.0).unwrap_or_else(Vector3::z)
        };
        let pairs = piece.edges().iter().zip(piece.edge_faces());
        let edges: Vec<Edge> = pairs.map(|(&ends, &faces)| Edge { ends, faces, along: unit(ends) }).collect();
        let edge_of =
            |a: u32, b: u32| edges.iter().position(|e| e.ends == [a, b] || e.ends == [b, a]).unwrap_or(0) as u32;
        let (mut sides, mut side_start, mut areas) = (Vec::new(), vec![0], Vec::new());
        let mut faces_at = vec![Vec::new(); vertices.len()];
        for (f, (n, _)) in planes.iter().enumerate() {
            let corners = piece.face(f);
            let mut area = Vector3::zeros();
            for (i, &vertex) in corners.iter().enumerate() {
                let next = corners[(i + 1) % corners.len()];
                let out = unit([vertex, next]).cross(n).try_normalize(0.0).unwrap_or(*n);
                let (v, w) = (vertices[vertex as usize], vertices[next as usize]);
                let cut = (out, out.dot(&v).max(out.dot(&w)));
                sides.push(FaceSide { vertex, edge: edge_of(vertex, next), cut });
                faces_at[vertex as usize].push(f as u32);
                area += (v - vertices[corners[0] as usize]).cross(&(w - vertices[corners[0] as usize]));
            }
            areas.push(area.norm() / 2.0);
            side_start.push(sides.len() as u32);
        }
        let weights = rim_weights(piece, &areas, &faces_at);
        let mut vertex_start = vec![0];
        let mut at_vertex = Vec::new();
        for faces in faces_at {
            at_vertex.extend(faces);
            vertex_start.push(at_vertex.len() as u32);
        }
        let (lo, hi) = piece.bounds();
        Self {
            middle: frame.point(&((lo.coords + hi.coords) / 2.0)),
            axes: frame.r,
            half: (hi - lo) / 2.0,
            vertices,
            planes,
            areas,
            edges,
            sides,
            side_start,
            at_vertex,
            vertex_start,
            box_faces: None,
            weights,
        }
    }

    fn into_box(self) -> Self {
        let face =
            |n: Vector3<f64>| (0..6).max_by(|&i, &j| self.planes[i].0.dot(&n).total_cmp(&self.planes[j].0.dot(&n)));
        let faces = [0, 1, 2].map(|k| {
            let axis = self.axes.column(k).into_owned();
            [-axis, axis].map(|n| face(n).unwrap_or(0) as u32)
        });
        Self { box_faces: Some(faces), ..self }
    }

    pub fn sides(&self, face: u32) -> &[FaceSide] {
        &self.sides[self.side_start[face as usize] as usize..self.side_start[face as usize + 1] as usize]
    }

    pub fn faces_at(&self, vertex: u32) -> &[u32] {
        &self.at_vertex[self.vertex_start[vertex as usize] as usize..self.vertex_start[vertex as usize + 1] as usize]
    }

    pub fn vertex(&self, v: u32) -> &Vector3<f64> {
        &self.vertices[v as usize]
    }
}

/// Half of a vertex's two sides around the largest face that it is a corner of, over the mean of that face's sides: the
/// pressure on a rim then does not depend on where the mesh has its vertices.
fn rim_weights(piece: &ConvexPolyhedron, areas: &[f64], faces_at: &[Vec<u32>]) -> Vec<f64> {
    let weight = |(v, faces): (usize, &Vec<u32>)| {
        let largest = faces.iter().max_by(|a, b| areas[**a as usize].total_cmp(&areas[**b as usize]))?;
        let corners = piece.face(*largest as usize);
        let n = corners.len();
        let at = |i: usize| piece.vertices()[corners[i % n] as usize];
        let here = corners.iter().position(|&c| c as usize == v)?;
        let around = (0..n).map(|i| (at(i + 1) - at(i)).norm()).sum::<f64>();
        let own = (at(here + 1) - at(here)).norm() + (at(here) - at(here + n - 1)).norm();
        (around > 0.0).then(|| 0.5 * own * n as f64 / around)
    };
    faces_at.iter().enumerate().map(|vertex| weight(vertex).unwrap_or(1.0)).collect()
}
