//! Where to cut a part: candidate planes and what each costs.

use nalgebra::{Matrix3, Point3, SymmetricEigen, Unit, Vector3};
use rayon::prelude::*;

use drex_core::{SignedDistance, Surface, TriMesh};

use super::part::{Part, Plane, cut_length, edges, points_behind};
use super::probe::{Fill, Probes};
use crate::Result;
use crate::grid::{GridOptions, GridSdf};
use crate::sdf::MeshSdf;
use drex_core::mesh::convex_hull;

/// Positions tried along each direction.
const POSITIONS: usize = 12;
/// Planes through concave edges that are kept for the whole solid.
const EDGE_PLANES: usize = 32;
/// Nodes of the grid that tells inside from outside.
const GRID_NODES: usize = 1 << 16;
/// A cut this short is as good as a shorter one, as a share of the solid's diagonal.
const SHORT: f64 = 0.05;
/// How often the step of that search is halved.
const HALVINGS: usize = 6;
/// Of the planes tried, so many are moved to their best position.
const MOVED: usize = 4;

/// What the search for cuts needs to know about the solid.
#[derive(Debug)]
pub(super) struct Scene {
    solid: GridSdf,
    pub probes: Probes,
    /// Neighbours reach over their common cut by this much, so that they touch without a gap, metres.
    pub overlap: f64,
    /// A cut this short is as good as a shorter one, metres.
    short: f64,
    /// A part that fills free space no deeper than this is not divided, metres.
    pub tolerance: f64,
    /// Planes of the faces at concave edges, those with the longest edges first.
    edge_planes: Vec<Plane>,
}

/// A part with its hull and what that fills.
#[derive(Debug, Clone)]
pub(super) struct Leaf {
    pub part: Part,
    pub hull: TriMesh,
    pub fill: Fill,
    /// The probes in the hull's box.
    probes: Vec<u32>,
}

/// A plane that divides a part.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cut {
    pub plane: Plane,
    /// By how much the two sides cost less than the part.
    pub gain: f64,
    /// The gain per length of the cut.
    worth: f64,
}

impl Scene {
    pub fn new(solid: MeshSdf, surface: &TriMesh, probes: usize, tolerance: f64) -> Result<Self> {
        let (lo, hi) = solid.bounds();
        let size = (hi - lo).norm();
        let probes = Probes::new(&solid, probes, tolerance, 1);
        let grid = GridOptions { nodes: GRID_NODES, margin_m: Some(0.01 * size) };
        let solid = GridSdf::with_options(solid, &grid)?;
        Ok(Self {
            solid,
            probes,
            overlap: 5e-5 * size,
            short: SHORT * size,
            tolerance,
            edge_planes: edge_planes(surface, size),
        })
    }

    /// Whether a point is inside the solid, as the grid knows it: that may be wrong near the surface, by a part of the grid's
    /// spacing.
    pub fn inside(&self, p: &Point3<f64>) -> bool {
        self.solid.signed_distance(p).distance_m < 0.0
    }

    /// Whether a point is inside the solid.
    pub fn exactly_inside(&self, p: &Point3<f64>) -> bool {
        self.solid.exact().contains(p)
    }

    /// The two sides of a plane, each reaching over it by the overlap.
    pub fn sides(&self, plane: &Plane) -> [Plane; 2] {
        [*plane, plane.flipped()].map(|p| p.moved(self.overlap))
    }

    /// Hull of a part; `None` if the part is flat.
    pub fn hull(&self, part: &Part) -> Option<TriMesh> {
        convex_hull(&part.points(|p| self.inside(p))).ok()
    }

    pub fn leaf(&self, part: Part) -> Option<Leaf> {
        let hull = self.hull(&part)?;
        let probes = self.probes.near(&hull);
        let fill = self.probes.fill(&hull, &probes);
        Some(Leaf { part, hull, fill, probes })
    }

    /// The plane that leaves the least cost; `None` if no plane leaves less than the part has.
    pub fn best_cut(&self, leaf: &Leaf) -> Option<Cut> {
        let judge = Judge { scene: self, leaf, edges: edges(&leaf.part.surface), cell_edges: edges(&leaf.part.cell) };
        let (planes, steps) = self.candidates(leaf);
        let mut tried: Vec<(Cut, f64)> =
            planes.into_par_iter().zip(steps).map(|(plane, step)| (judge.cut(plane), step)).collect();
        tried.sort_by(|a, b| b.0.worth.total_cmp(&a.0.worth)); // stable: the first of equals stays first
        tried.truncate(MOVED);
        let moved = |(mut best, mut step): (Cut, f64)| {
            for _ in 0..HALVINGS {
                step /= 2.0;
                for by in [-step, step] {
                    let moved = judge.cut(best.plane.moved(by));
                    if moved.gain > best.gain {
                        best = moved;
                        break;
                    }
                }
            }
            best
        };
        let best: Vec<Cut> = tried.into_par_iter().map(moved).collect();
        best.into_iter()
            .reduce(|a, b| if b.worth > a.worth { b } else { a })
            .filter(|cut| cut.gain > self.probes.negligible())
    }

    /// Planes across the axes, across the principal axes of the part's surface, and planes of faces at concave edges;
    /// with each the distance to the next one of its kind.
    fn candidates(&self, leaf: &Leaf) -> (Vec<Plane>, Vec<f64>) {
        let mut directions = vec![Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()];
        for axis in principal_axes(&leaf.part.surface) {
            if directions.iter().all(|d| d.dot(&axis).abs() < 0.996) {
                directions.push(axis);
            }
        }
        let (mut planes, mut steps) = (Vec::new(), Vec::new());
        let range = |normal: &Unit<Vector3<f64>>| {
            let along = leaf.hull.vertices.iter().map(|p| normal.dot(&p.coords));
            along.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), h| (lo.min(h), hi.max(h)))
        };
        for normal in directions {
            let (lo, hi) = range(&normal);
            let step = (hi - lo) / (POSITIONS + 1) as f64;
            for k in 1..=POSITIONS {
                planes.push(Plane { normal, offset: lo + step * k as f64 });
                steps.push(step);
            }
        }
        for plane in &self.edge_planes {
            let (lo, hi) = range(&plane.normal);
            let margin = 0.01 * (hi - lo);
            if plane.offset > lo + margin && plane.offset < hi - margin {
                planes.push(*plane);
                steps.push(0.1 * (hi - lo));
            }
        }
        (planes, steps)
    }
}

/// Judges the cuts of one part.
struct Judge<'a> {
    scene: &'a Scene,
    leaf: &'a Leaf,
    edges: Vec<[u32; 2]>,
    cell_edges: Vec<[u32; 2]>,
}

impl Judge<'_> {
    fn cut(&self, plane: Plane) -> Cut {
        let part = &self.leaf.part;
        let mut cost = 0.0;
        for side in self.scene.sides(&plane) {
            let mut points = points_behind(&part.surface, &self.edges, &side);
            if points.is_empty() {
                return Cut { plane, gain: f64::NEG_INFINITY, worth: f64::NEG_INFINITY };
            }
            let corners = points_behind(&part.cell, &self.cell_edges, &side);
            points.extend(corners.iter().filter(|p| self.scene.inside(p)));
            // A flat side has no volume and fills nothing.
            if let Ok(hull) = convex_hull(&points) {
                cost += self.scene.probes.fill(&hull, &self.leaf.probes).cost;
            }
        }
        let gain = self.leaf.fill.cost - cost;
        // A plane in a face is as long as the shorter of the cuts beside it.
        let length = self.scene.sides(&plane).map(|side| cut_length(&part.surface, &side));
        Cut { plane, gain, worth: gain / (length[0].min(length[1]) + self.scene.short) }
    }
}

/// Principal axes of a surface, by area.
fn principal_axes(surface: &TriMesh) -> [Unit<Vector3<f64>>; 3] {
    let triangles = || (0..surface.faces.len()).map(|f| surface.triangle(f).map(|p| p.coords));
    let area = |[a, b, c]: &[Vector3<f64>; 3]| (b - a).cross(&(c - a)).norm();
    let total: f64 = triangles().map(|t| area(&t)).sum();
    let mean: Vector3<f64> = triangles().map(|t| (t[0] + t[1] + t[2]) * (area(&t) / 3.0)).sum::<Vector3<f64>>() / total;
    let mut spread = Matrix3::zeros();
    for t in triangles() {
        for p in &t {
            spread += (p - mean) * (p - mean).transpose() * (area(&t) / 3.0);
        }
    }
    if !(total > 0.0) {
        return [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()];
    }
    let eigen = SymmetricEigen::new(spread);
    [0, 1, 2].map(|k| Unit::new_normalize(eigen.eigenvectors.column(k).into_owned()))
}

/// Planes of the faces that meet at concave edges, alike ones taken together, those with the longest edges first.
fn edge_planes(surface: &TriMesh, size: f64) -> Vec<Plane> {
    let mut found: Vec<(Plane, f64)> = Vec::new();
    let normal = |f: usize| {
        let [a, b, c] = surface.triangle(f);
        Unit::try_new((b - a).cross(&(c - a)), 0.0)
    };
    for group in crate::topology::edges(surface).chunk_by(|a, b| a.0 == b.0) {
        let [(_, g), (_, h)] = group else { continue };
        let (f, g) = (*g as usize / 3, *h as usize / 3);
        let (Some(m), Some(n)) = (normal(f), normal(g)) else { continue };
        let (a, b) = ((group[0].0 >> 32) as usize, group[0].0 as u32 as usize);
        let edge = surface.vertices[b] - surface.vertices[a];
        let beyond = surface.triangle(g).iter().map(|p| m.dot(&(p - surface.vertices[a]))).fold(0.0, f64::max);
        // Concave by more than about 20 degrees.
        if !(beyond > 0.0 && m.dot(&n) < 0.94) {
            continue;
        }
        for normal in [m, n] {
            let plane = Plane { normal, offset: normal.dot(&surface.vertices[a].coords) };
            let alike = |p: &Plane| p.normal.dot(&normal) > 0.999 && (p.offset - plane.offset).abs() < 2e-3 * size;
            match found.iter().position(|(p, _)| alike(p)) {
                Some(k) => found[k].1 += edge.norm(),
                None if found.len() < 64 * EDGE_PLANES => found.push((plane, edge.norm())),
                None => {}
            }
        }
    }
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    // An edge shorter than a twentieth of the solid is a detail.
    found.into_iter().filter(|(_, length)| *length > 0.05 * size).map(|(p, _)| p).take(EDGE_PLANES).collect()
}
