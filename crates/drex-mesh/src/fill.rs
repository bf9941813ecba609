//! Holes in a surface closed by triangles.

use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};

use drex_core::TriMesh;

use crate::bvh::Aabb;
use crate::topology::{Topology, boundary_loops, edges};

/// Rims with more vertices than this get a fan: the triangulation takes time with the cube of their number.
const LONGEST_RIM: usize = 128;

/// What [`fill_holes`] did.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Filled {
    /// Openings that were closed.
    pub holes: usize,
    /// Their area, m².
    pub area_m2: f64,
    /// The widest of them, metres.
    pub widest_m: f64,
}

/// Closes the openings of a mesh that are at most `narrower_m` wide (twice the distance of the farthest rim point from the
/// middle of the rim) and at most half as wide as their shell.
///
/// A short rim gets the triangulation whose largest fold is smallest, and of those the one with the least area (Liepa,
/// "Filling Holes in Meshes", 2003, section 3, after Barequet and Sharir 1995); a long one a flat fan.
pub(crate) fn fill_holes(mesh: &mut TriMesh, narrower_m: f64) -> Filled {
    let loops = boundary_loops(mesh);
    let mut out = Filled::default();
    if loops.is_empty() {
        return out;
    }
    let sizes = shell_sizes(mesh);
    let mut known = Edges::of(mesh);
    for rim in loops {
        let Some((middle, width)) = extent(mesh, &rim) else { continue };
        if width > narrower_m || width > 0.5 * sizes[rim[0] as usize] {
            continue;
        }
        let patch = close(mesh, &rim, &middle, &known);
        for f in &patch {
            known.add(f);
            let [a, b, c] = f.map(|v| mesh.vertices[v as usize]);
            out.area_m2 += (b - a).cross(&(c - a)).norm() / 2.0;
        }
        mesh.faces.extend(patch);
        out.holes += 1;
        out.widest_m = out.widest_m.max(width);
    }
    out
}

/// The mesh with every opening closed. A closed mesh comes back as it is.
///
/// Openings with up to 128 edges get a triangulation of their rim with small folds and little area, longer ones (the
/// missing bottom of a scan) a flat fan to the middle of the rim. The result is closed in the sense that every edge is
/// run along equally often in both directions; lids may cross the surface where a rim is ragged.
pub fn close_openings(mesh: &TriMesh) -> TriMesh {
    let mut out = mesh.clone();
    let mut known = Edges::of(mesh);
    for rim in boundary_loops(mesh) {
        let Some((middle, _)) = extent(mesh, &rim) else { continue };
        let patch = close(&mut out, &rim, &middle, &known);
        patch.iter().for_each(|f| known.add(f));
        out.faces.extend(patch);
    }
    out
}

/// Diagonal of the bounding box of each vertex's shell.
fn shell_sizes(mesh: &TriMesh) -> Vec<f64> {
    let (labels, count) = Topology::new(mesh).shells();
    let mut bounds = vec![Aabb::empty(); count];
    for (f, &label) in labels.iter().enumerate() {
        bounds[label as usize] = bounds[label as usize].union(&Aabb::of(&mesh.triangle(f)));
    }
    let mut sizes = vec![0.0; mesh.vertices.len()];
    for (f, &label) in mesh.faces.iter().zip(&labels) {
        let b = &bounds[label as usize];
        f.iter().for_each(|&v| sizes[v as usize] = (b.hi - b.lo).norm());
    }
    sizes
}

/// Middle and width of a rim; `None` if it is a point or runs back along itself.
fn extent(mesh: &TriMesh, rim: &[u32]) -> Option<(Point3<f64>, f64)> {
    let at = |k: usize| mesh.vertices[rim[k % rim.len()] as usize];
    let (mut length, mut weighted) = (0.0, Vector3::zeros());
    for k in 0..rim.len() {
        let edge = (at(k + 1) - at(k)).norm();
        length += edge;
        weighted += nalgebra::center(&at(k), &at(k + 1)).coords * edge;
    }
    if rim.len() < 3 || !(length > 0.0) {
        return None;
    }
    let middle = Point3::from(weighted / length);
    Some((middle, (0..rim.len()).map(|k| 2.0 * (at(k) - middle).norm()).fold(0.0, f64::max)))
}

/// Triangles over a rim; a fan adds its hub to the vertices.
fn close(mesh: &mut TriMesh, rim: &[u32], middle: &Point3<f64>, known: &Edges) -> Vec<[u32; 3]> {
    if rim.len() <= LONGEST_RIM
        && let Some(patch) = triangulated(mesh, rim, known)
    {
        return patch;
    }
    let hub = mesh.vertices.len() as u32;
    mesh.vertices.push(*middle);
    (0..rim.len()).map(|k| [rim[k], rim[(k + 1) % rim.len()], hub]).collect()
}

/// Largest fold (1 - cosine between neighbouring normals) and area of a triangulation; compared in this order.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
struct Weight(f64, f64);

/// The best triangulation of a rim by dynamic programming over its sub-polygons i..=k; `None` if every one would need a
/// chord that is an edge of the mesh already, or a triangle without area.
fn triangulated(mesh: &TriMesh, rim: &[u32], known: &Edges) -> Option<Vec<[u32; 3]>> {
    let n = rim.len();
    let p: Vec<Point3<f64>> = rim.iter().map(|&v| mesh.vertices[v as usize]).collect();
    let normal = |i: usize, j: usize, k: usize| (p[j] - p[i]).cross(&(p[k] - p[i]));
    let chord = |i: usize, k: usize| k == i + 1 || (i == 0 && k == n - 1) || !known.has(rim[i], rim[k]);
    let mut best = vec![None::<(Weight, usize)>; n * n];
    let fold = |a: &Vector3<f64>, b: &Vector3<f64>| 1.0 - a.dot(b) / (a.norm() * b.norm());
    for span in 2..n {
        for i in 0..n - span {
            let k = i + span;
            if !chord(i, k) {
                continue;
            }
            for j in i + 1..k {
                let m = normal(i, j, k);
                let area = m.norm() / 2.0;
                if !(area > 0.0) {
                    continue;
                }
                let mut weight = Weight(0.0, area);
                let mut possible = true;
                for (from, to) in [(i, j), (j, k)] {
                    if to == from + 1 {
                        continue;
                    }
                    match best[from * n + to] {
                        Some((Weight(worst, sum), via)) => {
                            let across = fold(&m, &normal(from, via, to));
                            weight = Weight(weight.0.max(worst).max(across), weight.1 + sum);
                        }
                        None => possible = false,
                    }
                }
                let slot = &mut best[i * n + k];
                if possible && slot.is_none_or(|(w, _)| weight < w) {
                    *slot = Some((weight, j));
                }
            }
        }
    }
    let mut faces = Vec::with_capacity(n - 2);
    let mut open = vec![(0, n - 1)];
    while let Some((i, k)) = open.pop() {
        if k == i + 1 {
            continue;
        }
        let (_, j) = best[i * n + k]?;
        faces.push([rim[i], rim[j], rim[k]]);
        open.extend([(i, j), (j, k)]);
    }
    Some(faces)
}

/// Edges that a mesh has, and those that were added since.
struct Edges {
    sorted: Vec<u64>,
    added: BTreeSet<u64>,
}

impl Edges {
    fn of(mesh: &TriMesh) -> Self {
        Self { sorted: edges(mesh).into_iter().map(|e| e.0).collect(), added: BTreeSet::new() }
    }

    fn key(a: u32, b: u32) -> u64 {
        u64::from(a.min(b)) << 32 | u64::from(a.max(b))
    }

    fn has(&self, a: u32, b: u32) -> bool {
        let key = Self::key(a, b);
        self.sorted.binary_search(&key).is_ok() || self.added.contains(&key)
    }

    fn add(&mut self, f: &[u32; 3]) {
        self.added.extend((0..3).map(|k| Self::key(f[k], f[(k + 1) % 3])));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, sphere};

    #[test]
    fn an_open_box_is_closed_exactly() {
        let mut m = cuboid([0.0; 3], [1.0, 2.0, 3.0]);
        m.faces.drain(2..4);
        let c = close_openings(&m);
        assert_eq!((c.faces.len(), c.vertices.len()), (12, 8));
        assert!((c.mass_properties(1.0).unwrap().mass_kg - 6.0).abs() < 1e-12);
        let closed = sphere(1.0, 2);
        assert_eq!(close_openings(&closed), closed);
    }

    #[test]
    fn small_holes_are_filled_and_wide_ones_stay() {
        let mut m = sphere(0.05, 4);
        let whole = m.mass_properties(1.0).unwrap().mass_kg;
        m.faces.retain(|f| f.iter().all(|&v| m.vertices[v as usize].z < 0.03)); // 80 mm wide
        m.faces.retain(|f| !f.contains(&1)); // a few mm wide
        let open = Topology::new(&m).open_edges;
        let filled = fill_holes(&mut m, 0.02);
        assert_eq!(filled.holes, 1);
        assert!(filled.widest_m < 0.02 && filled.area_m2 > 0.0);
        assert!(Topology::new(&m).open_edges < open && Topology::new(&m).open_edges > 0);
        let all = close_openings(&m);
        assert_eq!(Topology::new(&all).open_edges, 0);
        assert!(all.mass_properties(1.0).unwrap().mass_kg < whole);
    }

    #[test]
    fn a_lone_triangle_is_not_doubled() {
        let mut m = TriMesh { vertices: cuboid([0.0; 3], [1.0; 3]).vertices, faces: vec![[0, 1, 2]] };
        assert_eq!(fill_holes(&mut m, f64::INFINITY).holes, 0);
    }

    #[test]
    fn a_chord_that_is_an_edge_already_is_not_used_twice() {
        // An octahedron without the faces around the edge 2-4, but with a flap on the edge 0-1... the rim is 0 2 1 4.
        let mut m = sphere(1.0, 1);
        let before = m.faces.len();
        m.faces.retain(|f| !(f.contains(&4) || f.contains(&0)));
        let removed = before - m.faces.len();
        assert!(removed > 0);
        let all = close_openings(&m);
        let topology = Topology::new(&all);
        assert_eq!((topology.open_edges, topology.crowded_edges), (0, 0));
    }
}
