//! Closed meshes made of a few numbers: lofts of ellipses, boxes with round edges, extruded letters. Metres, z up.

use std::f64::consts::TAU;

use anyhow::{Context, Result};
use drex_core::TriMesh;
use drex_core::mesh::convex_hull;
use nalgebra::{Point2, Point3, Vector3};

/// Corners of a ring of a loft.
const RING: usize = 48;
/// Corners of a quarter of a rounded edge.
const QUARTER: usize = 6;

/// An ellipse of a loft: half axes along x and y, and its height, metres.
pub type Section = [f64; 3];

/// A body of ellipses one above the other, lowest first, closed by flat ends.
pub fn loft(sections: &[Section]) -> TriMesh {
    let mut mesh = TriMesh::default();
    for [a, b, z] in sections {
        for k in 0..RING {
            let (sin, cos) = (TAU * k as f64 / RING as f64).sin_cos();
            mesh.vertices.push(Point3::new(a * cos, b * sin, *z));
        }
    }
    let at = |ring: usize, k: usize| (ring * RING + k % RING) as u32;
    for ring in 0..sections.len().saturating_sub(1) {
        for k in 0..RING {
            let [a, b, c, d] = [at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k)];
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    let ends = [(0, sections.first()), (sections.len().saturating_sub(1), sections.last())];
    for (ring, section) in ends {
        let Some([_, _, z]) = section else { continue };
        let middle = mesh.vertices.len() as u32;
        mesh.vertices.push(Point3::new(0.0, 0.0, *z));
        for k in 0..RING {
            let (a, b) = (at(ring, k), at(ring, k + 1));
            mesh.faces.push(if ring == 0 { [middle, b, a] } else { [middle, a, b] });
        }
    }
    mesh
}

/// A body of circles: radius and height of each.
pub fn lathe(profile: &[[f64; 2]]) -> TriMesh {
    let sections: Vec<Section> = profile.iter().map(|[r, z]| [*r, *r, *z]).collect();
    loft(&sections)
}

/// Up for a lathe that lies on one of its flat sides: of those, all as stable as each other, always the same one.
pub fn flat_side() -> Vector3<f64> {
    let (sin, cos) = (0.5 * TAU / RING as f64).sin_cos();
    Vector3::new(cos, sin, 0.0)
}

/// A box that stands on z = 0, its upright edges rounded by `radius`.
pub fn rounded_box(size: [f64; 3], radius: f64) -> Result<TriMesh> {
    let mut points = Vec::new();
    for (sx, sy, from) in [(1.0, 1.0, 0.0), (-1.0, 1.0, 0.25), (-1.0, -1.0, 0.5), (1.0, -1.0, 0.75)] {
        for k in 0..=QUARTER {
            let (sin, cos) = (TAU * (from + 0.25 * k as f64 / QUARTER as f64)).sin_cos();
            let (x, y) = (sx * (0.5 * size[0] - radius) + radius * cos, sy * (0.5 * size[1] - radius) + radius * sin);
            points.extend([Point3::new(x, y, 0.0), Point3::new(x, y, size[2])]);
        }
    }
    convex_hull(&points).context("a box without volume")
}

/// An outline, counter-clockwise and closed by itself, with at most one hole (clockwise), made `height` thick over z = 0.
pub fn extrusion(outline: &[[f64; 2]], hole: &[[f64; 2]], height: f64) -> Result<TriMesh> {
    let flat: Vec<Point2<f64>> = outline.iter().chain(hole).map(|p| Point2::from(*p)).collect();
    let n = flat.len();
    let mut mesh = TriMesh::default();
    for z in [0.0, height] {
        mesh.vertices.extend(flat.iter().map(|p| Point3::new(p.x, p.y, z)));
    }
    for [a, b, c] in triangulated(&flat, outline.len()).context("an outline that crosses itself")? {
        mesh.faces.push([a as u32, c as u32, b as u32]);
        mesh.faces.push([a, b, c].map(|i| (i + n) as u32));
    }
    for ring in [0..outline.len(), outline.len()..n] {
        for i in ring.clone() {
            let next = if i + 1 == ring.end { ring.start } else { i + 1 };
            let [a, b, c, d] = [i, next, next + n, i + n].map(|i| i as u32);
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    Ok(mesh)
}

/// Triangles of a polygon whose points from `outer` on are a hole: the hole is joined to the nearest corner outside, then ears are
/// cut (Meisters 1975). `None` if there is no ear left to cut.
fn triangulated(points: &[Point2<f64>], outer: usize) -> Option<Vec<[usize; 3]>> {
    let mut ring: Vec<usize> = (0..outer).collect();
    if outer < points.len() {
        let pairs = (0..outer).flat_map(|o| (outer..points.len()).map(move |h| (o, h)));
        let length = |&(o, h): &(usize, usize)| (points[o] - points[h]).norm();
        let (o, h) = pairs.min_by(|a, b| length(a).total_cmp(&length(b)))?;
        let around = (h..points.len()).chain(outer..=h);
        ring = (0..=o).chain(around).chain(o..outer).collect();
    }
    let area = |a: usize, b: usize, c: usize| (points[b] - points[a]).perp(&(points[c] - points[a]));
    let mut triangles = Vec::new();
    while ring.len() > 3 {
        let n = ring.len();
        let ear = (0..n).find(|&i| {
            let [a, b, c] = [ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]];
            let inside = |p: usize| area(a, b, p) > 0.0 && area(b, c, p) > 0.0 && area(c, a, p) > 0.0;
            area(a, b, c) > 0.0 && !ring.iter().any(|&p| ![a, b, c].contains(&p) && inside(p))
        })?;
        triangles.push([ring[(ear + n - 1) % n], ring[ear], ring[(ear + 1) % n]]);
        ring.remove(ear);
    }
    triangles.push([ring[0], ring[1], ring[2]]);
    Some(triangles)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use drex_mesh::solid_properties;

    #[test]
    fn volumes_are_those_of_the_formulas() {
        let volume = |mesh: &TriMesh| {
            let solid = solid_properties(mesh).unwrap();
            assert_eq!((solid.open_edges, solid.closed), (0, true));
            solid.volume_m3
        };
        // A 48-gon in a circle.
        let share = 24.0 * (TAU / 48.0).sin();
        let can = volume(&lathe(&[[0.03, 0.0], [0.03, 0.1]]));
        assert!((can / (share * 0.03 * 0.03 * 0.1) - 1.0).abs() < 1e-9, "{can}");
        let bottle = volume(&loft(&[[0.04, 0.02, 0.0], [0.04, 0.02, 0.1]]));
        assert!((bottle / (share * 0.04 * 0.02 * 0.1) - 1.0).abs() < 1e-9);
        let square = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]];
        let hole = [[0.03, 0.03], [0.03, 0.07], [0.07, 0.07], [0.07, 0.03]];
        let frame = volume(&extrusion(&square, &hole, 0.02).unwrap());
        assert!((frame - (0.01 - 0.0016) * 0.02).abs() < 1e-12, "{frame}");
        let cuboid = volume(&rounded_box([0.1, 0.06, 0.08], 0.01).unwrap());
        assert!(cuboid < 0.1 * 0.06 * 0.08 && cuboid > (0.006 - 4e-4 + 3.0e-4) * 0.08, "{cuboid}");
    }
}
