//! Which way faces and shells look.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use drex_core::TriMesh;

use crate::bvh::{Aabb, Bvh};
use crate::topology::{NONE, Topology, ends};

/// A piece of surface connected over edges.
#[derive(Debug, Clone)]
pub(crate) struct Shell {
    pub faces: Vec<u32>,
    pub closed: bool,
    pub bounds: Aabb,
    pub area_m2: f64,
    /// Signed volume (of the cone from the middle of the box, if open).
    pub volume_m3: f64,
}

/// Makes the winding consistent over edges with two faces, if it is not.
///
/// Each patch connected over such edges then faces the side that sees more of the surroundings (Takayama et al.,
/// "A Simple Method for Correcting Facet Orientations in Polygon Meshes Based on Ray Casting", 2014); if neither does,
/// the side to which it bulges; if it is flat, the side that most of its area faced.
pub(crate) fn align_patches(mesh: &mut TriMesh, turned: &mut [bool]) {
    let topology = Topology::new(mesh);
    if topology.misaligned == 0 {
        return;
    }
    let mut neighbours = vec![[(NONE, false); 3]; mesh.faces.len()];
    for group in crate::topology::edges(mesh).chunk_by(|a, b| a.0 == b.0) {
        if let [(_, g), (_, h)] = group {
            let same = ends(mesh, *g).0 == ends(mesh, *h).0;
            neighbours[*g as usize / 3][*g as usize % 3] = (h / 3, same);
            neighbours[*h as usize / 3][*h as usize % 3] = (g / 3, same);
        }
    }
    let tree = Bvh::cut(mesh);
    let mut state: Vec<Option<bool>> = vec![None; mesh.faces.len()];
    for seed in 0..mesh.faces.len() {
        if state[seed].is_some() {
            continue;
        }
        state[seed] = Some(false);
        let mut patch = vec![seed];
        let mut next = 0;
        while next < patch.len() {
            let f = patch[next];
            next += 1;
            for (g, same) in neighbours[f] {
                if g != NONE && state[g as usize].is_none() {
                    state[g as usize] = Some((state[f] == Some(true)) ^ same);
                    patch.push(g as usize);
                }
            }
        }
        let flip = |f: usize| state[f] == Some(true);
        let sign = |f: usize| if flip(f) { -1.0 } else { 1.0 };
        let openness = openness(mesh, &tree, &patch, sign);
        let bulge = bulge(mesh, &patch, sign);
        let kept: f64 = patch.iter().map(|&f| sign(f) * area(mesh, f)).sum();
        let invert = match (openness, bulge) {
            (o, _) if o.abs() > 0.1 => o < 0.0,
            (_, b) if b.abs() > 0.1 => b < 0.0,
            _ => kept < 0.0,
        };
        for &f in &patch {
            if flip(f) != invert {
                mesh.faces[f].swap(1, 2);
                turned[f] = true;
            }
        }
    }
}

fn area(mesh: &TriMesh, f: usize) -> f64 {
    let [a, b, c] = mesh.triangle(f);
    (b - a).cross(&(c - a)).norm() * 0.5
}

/// How much more of the rays that leave a patch on its front get away than of those on its back: from -1 to 1.
fn openness(mesh: &TriMesh, tree: &Bvh, patch: &[usize], sign: impl Fn(usize) -> f64) -> f64 {
    const RAYS: usize = 12;
    let step = patch.len().div_ceil(48).max(1);
    let (mut front, mut back) = (0.0, 0.0);
    for &f in patch.iter().step_by(step) {
        let [a, b, c] = mesh.triangle(f);
        let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0).map(|n| n * sign(f)) else { continue };
        let middle = Point3::from((a.coords + b.coords + c.coords) / 3.0);
        let weight = area(mesh, f);
        for k in 0..RAYS {
            // Evenly over the hemisphere: a Fibonacci spiral.
            let z = (k as f64 + 0.5) / RAYS as f64;
            let turn = 2.399_963_229_728_653 * k as f64;
            let r = (1.0 - z * z).sqrt();
            let side = normal.cross(&Vector3::ith(normal.iamin(), 1.0)).normalize();
            let tangent = side * (r * turn.cos()) + normal.cross(&side) * (r * turn.sin());
            for (direction, sum) in [(normal * z + tangent, &mut front), (tangent - normal * z, &mut back)] {
                // Off the face itself by far less than any distance that matters.
                let origin = middle + direction * (1e-4 * weight.sqrt());
                if tree.ray(&origin, &direction, f64::INFINITY).is_none() {
                    *sum += weight * z;
                }
            }
        }
    }
    if front + back > 0.0 { (front - back) / (front + back) } else { 0.0 }
}

/// Volume of the cone over a surface from its own middle, relative to a ball of the same area: 1 for a sphere wound
/// outwards, -1 inwards, 0 for a flat sheet.
fn bulge(mesh: &TriMesh, faces: &[usize], sign: impl Fn(usize) -> f64) -> f64 {
    let (mut area, mut weighted) = (0.0, Vector3::zeros());
    for &f in faces {
        let [a, b, c] = mesh.triangle(f);
        let s = (b - a).cross(&(c - a)).norm() * 0.5;
        area += s;
        weighted += (a.coords + b.coords + c.coords) * (s / 3.0);
    }
    let middle = weighted / area;
    let volume: f64 = faces
        .iter()
        .map(|&f| {
            let [a, b, c] = mesh.triangle(f).map(|p| p.coords - middle);
            sign(f) * a.dot(&b.cross(&c)) / 6.0
        })
        .sum();
    volume * 6.0 * std::f64::consts::PI.sqrt() / area.powf(1.5)
}

/// For each shell the smallest closed shell that contains it.
pub(crate) fn nesting(mesh: &TriMesh, shells: &[Shell]) -> Vec<Option<usize>> {
    let volume = |i: usize| shells[i].volume_m3.abs();
    let mut closed: Vec<usize> = (0..shells.len()).filter(|&j| shells[j].closed).collect();
    closed.sort_by(|&j, &k| volume(j).total_cmp(&volume(k)));
    let mut parents = vec![None; shells.len()];
    for j in closed {
        let may_lie_inside = |&i: &usize| {
            i != j
                && parents[i].is_none()
                && shells[j].bounds.contains(&shells[i].bounds)
                && (volume(j) > volume(i) || !shells[i].closed)
        };
        let within: Vec<usize> = (0..shells.len()).into_par_iter().filter(may_lie_inside).collect();
        if within.is_empty() {
            continue;
        }
        let tree = Bvh::cut_over(mesh, shells[j].faces.clone());
        let inside: Vec<usize> = within.into_par_iter().filter(|&i| lies_inside(mesh, &shells[i], &tree)).collect();
        inside.into_iter().for_each(|i| parents[i] = Some(j));
    }
    parents
}

/// Whether up to 16 points of shell `a`, spread over its faces, all lie inside the closed shell of the tree.
fn lies_inside(mesh: &TriMesh, a: &Shell, tree: &Bvh) -> bool {
    let step = a.faces.len().div_ceil(16).max(1);
    a.faces.iter().step_by(step).all(|&f| {
        let [p, q, r] = mesh.triangle(f as usize);
        let middle = Point3::from((p.coords + q.coords + r.coords) / 3.0);
        // 0.75: a face that lies in a face of the shell sees half of it and is not inside.
        tree.winding(&middle).abs() > 0.75
    })
}

/// Winds the shells outwards and says which are cavities.
pub(crate) fn orient_shells(
    mesh: &mut TriMesh,
    shells: &[Shell],
    parents: &[Option<usize>],
    turned: &mut [bool],
) -> Vec<bool> {
    let mut flip = vec![None; shells.len()];
    for i in (0..shells.len()).filter(|&i| shells[i].closed) {
        // The outermost shell of the nest decides; what is inside turns with it.
        let mut root = i;
        while let Some(p) = parents[root] {
            root = p;
        }
        flip[i] = Some(shells[root].volume_m3 < 0.0);
    }
    let open: Vec<usize> = (0..shells.len())
        .filter(|&i| !shells[i].closed)
        .flat_map(|i| shells[i].faces.iter().map(|&f| f as usize))
        .collect();
    // Without a clear bulge (a sheet) there is no outside, and the file's word stands.
    let turn_open = !open.is_empty() && bulge(mesh, &open, |_| 1.0) < -1e-3;
    let mut cavities = vec![false; shells.len()];
    for (i, shell) in shells.iter().enumerate() {
        let turn = flip[i].unwrap_or(turn_open);
        cavities[i] = shell.closed && parents[i].is_some() && ((shell.volume_m3 < 0.0) ^ turn);
        if turn {
            for &f in &shell.faces {
                mesh.faces[f as usize].swap(1, 2);
                turned[f as usize] ^= true;
            }
        }
    }
    cavities
}
