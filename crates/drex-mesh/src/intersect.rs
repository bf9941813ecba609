//! Faces of a mesh that cross or touch each other where they should not.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use drex_core::TriMesh;

use crate::bvh::{Aabb, Bvh};

/// Steps of the lattice across the largest side: differences are below 2³¹, products of two into 64 bits, of three into 96.
const STEPS: f64 = (1u64 << 30) as f64;

type Lattice = [i64; 3];

/// Pairs of faces that have a point in common other than their common corner or edge, the smaller number first, sorted.
///
/// Decided exactly on coordinates rounded to 2⁻³⁰ of the largest side (a tenth of a nanometre for a hand-sized object), so
/// faces that only touch count too. Neighbours count when they are folded onto each other. Faces without area do not
/// count; vertices must be welded, or every pair of neighbours touches.
pub fn self_intersections(mesh: &TriMesh) -> Vec<[u32; 2]> {
    let Some(search) = Search::new(mesh) else { return Vec::new() };
    let of_face = |f: u32| {
        let mut pairs = Vec::new();
        search.partners_above(f, |g| pairs.push([f, g]));
        pairs.sort_unstable();
        pairs
    };
    (0..mesh.faces.len() as u32).into_par_iter().flat_map_iter(of_face).collect()
}

/// The number of pairs of [`self_intersections`], and which faces are in one, without a list of them: in a heap of faces
/// there are as many pairs as the square of their number.
pub(crate) fn meeting_faces(mesh: &TriMesh) -> (usize, Vec<bool>) {
    let Some(search) = Search::new(mesh) else { return (0, vec![false; mesh.faces.len()]) };
    let meets: Vec<AtomicBool> = mesh.faces.iter().map(|_| AtomicBool::new(false)).collect();
    let of_face = |f: u32| {
        let mut count = 0;
        search.partners_above(f, |g| {
            count += 1;
            meets[g as usize].store(true, Ordering::Relaxed);
        });
        if count > 0 {
            meets[f as usize].store(true, Ordering::Relaxed);
        }
        count
    };
    let count = (0..mesh.faces.len() as u32).into_par_iter().map(of_face).sum();
    (count, meets.into_iter().map(AtomicBool::into_inner).collect())
}

/// A mesh prepared for the search.
struct Search<'a> {
    mesh: &'a TriMesh,
    lattice: Vec<Lattice>,
    has_area: Vec<bool>,
    tree: Bvh,
}

impl<'a> Search<'a> {
    /// `None` for a mesh that is damaged or without extent.
    fn new(mesh: &'a TriMesh) -> Option<Self> {
        TriMesh::new(mesh.vertices.clone(), mesh.faces.clone()).ok()?;
        let (lo, hi) = mesh.bounds()?;
        let side = (hi - lo).max();
        if !(side > 0.0) {
            return None;
        }
        let lattice: Vec<Lattice> =
            mesh.vertices.iter().map(|p| [0, 1, 2].map(|k| ((p[k] - lo[k]) / side * STEPS).round() as i64)).collect();
        let has_area = mesh.faces.par_iter().map(|f| normal(&f.map(|v| lattice[v as usize])) != [0; 3]).collect();
        Some(Self { mesh, lattice, has_area, tree: Bvh::new(mesh) })
    }

    /// Calls `found` with every face of a larger number that meets face `f`.
    fn partners_above(&self, f: u32, mut found: impl FnMut(u32)) {
        if !self.has_area[f as usize] {
            return;
        }
        let faces = &self.mesh.faces;
        self.tree.any_in(&Aabb::of(&self.mesh.triangle(f as usize)), |g, _| {
            if g > f && self.has_area[g as usize] && meet(&self.lattice, faces[f as usize], faces[g as usize]) {
                found(g);
            }
            false
        });
    }
}

/// Whether two faces have more in common than their common corners.
fn meet(p: &[Lattice], f: [u32; 3], g: [u32; 3]) -> bool {
    let at = |v: u32| p[v as usize];
    let (tf, tg) = (f.map(at), g.map(at));
    // The corners of a face from the first that the other face has, or from the first that it has not.
    let from = |t: [u32; 3], o: [u32; 3], common: bool| {
        let k = t.iter().position(|v| o.contains(v) == common).unwrap_or(0);
        [0, 1, 2].map(|j| at(t[(k + j) % 3]))
    };
    match f.iter().filter(|v| g.contains(v)).count() {
        0 => {
            (0..3).any(|k| segment_meets(&tf[k], &tf[(k + 1) % 3], &tg))
                || (0..3).any(|k| segment_meets(&tg[k], &tg[(k + 1) % 3], &tf))
        }
        // Beyond the common corner, one far edge must meet the other face.
        1 => {
            let ([_, a, b], [_, c, d]) = (from(f, g, true), from(g, f, true));
            let meets = |p: Lattice, q: Lattice, t: &[Lattice; 3]| !apart(&[p, q], t) && segment_meets(&p, &q, t);
            meets(a, b, &tg) || meets(c, d, &tf)
        }
        // Folded along the common edge: in one plane, on one side.
        2 => {
            let ([c, a, b], [d, _, _]) = (from(f, g, false), from(g, f, false));
            side(&a, &b, &c, &d) == 0 && dot(&normal(&[a, b, c]), &normal(&[a, b, d])) > 0
        }
        _ => true,
    }
}

/// Whether the boxes of two sets of points have no point in common: most slivers of a fan are told apart by that.
fn apart(p: &[Lattice], q: &[Lattice]) -> bool {
    let range =
        |set: &[Lattice], k: usize| set.iter().fold((i64::MAX, i64::MIN), |(lo, hi), v| (lo.min(v[k]), hi.max(v[k])));
    (0..3).any(|k| {
        let (p, q) = (range(p, k), range(q, k));
        p.1 < q.0 || q.1 < p.0
    })
}

/// Whether a closed segment meets a closed triangle.
fn segment_meets(p: &Lattice, q: &Lattice, t: &[Lattice; 3]) -> bool {
    let [a, b, c] = t;
    let (side_p, side_q) = (side(a, b, c, p), side(a, b, c, q));
    if side_p * side_q > 0 {
        return false;
    }
    if side_p == 0 && side_q == 0 {
        return segment_meets_in_plane(p, q, t);
    }
    let s = [(a, b), (b, c), (c, a)].map(|(u, v)| side(p, q, u, v));
    s.iter().all(|&s| s >= 0) || s.iter().all(|&s| s <= 0)
}

/// The same when all lie in one plane: seen along the axis that is steepest to it.
fn segment_meets_in_plane(p: &Lattice, q: &Lattice, t: &[Lattice; 3]) -> bool {
    let n = normal(t);
    let drop = (0..3).max_by_key(|&k| n[k].abs()).unwrap_or(0);
    let flat = |v: &Lattice| [v[(drop + 1) % 3], v[(drop + 2) % 3]];
    let (p, q, t) = (flat(p), flat(q), t.each_ref().map(flat));
    let inside = |v: &[i64; 2]| {
        let s = [0, 1, 2].map(|k| turn(&t[k], &t[(k + 1) % 3], v).signum());
        s.iter().all(|&s| s >= 0) || s.iter().all(|&s| s <= 0)
    };
    inside(&p) || inside(&q) || (0..3).any(|k| segments_cross(&p, &q, &t[k], &t[(k + 1) % 3]))
}

/// Whether two segments in the plane cross, their ends not on one line.
fn segments_cross(p: &[i64; 2], q: &[i64; 2], a: &[i64; 2], b: &[i64; 2]) -> bool {
    let apart = |x: i64, y: i64| x.signum() * y.signum() <= 0;
    let (s, t) = ((turn(p, q, a), turn(p, q, b)), (turn(a, b, p), turn(a, b, q)));
    // All on one line: then an end of one lies on the other, which the test of the ends has seen, or they are apart.
    (s.0 != 0 || s.1 != 0) && apart(s.0, s.1) && apart(t.0, t.1)
}

/// Twice the area of a triangle in the plane.
fn turn(a: &[i64; 2], b: &[i64; 2], c: &[i64; 2]) -> i64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// On which side of the plane of a triangle a point lies: the sign of the volume of the tetrahedron.
fn side(a: &Lattice, b: &Lattice, c: &Lattice, d: &Lattice) -> i32 {
    let n = normal(&[*a, *b, *c]);
    // Floating point settles all but the close calls: each component of n is below 2⁶³, each difference below 2³¹.
    let quick: f64 = (0..3).map(|k| n[k] as f64 * (d[k] - a[k]) as f64).sum();
    if quick.abs() > 2.0_f64.powi(96 - 50) {
        return if quick > 0.0 { 1 } else { -1 };
    }
    (0..3).map(|k| i128::from(n[k]) * i128::from(d[k] - a[k])).sum::<i128>().signum() as i32
}

fn normal([a, b, c]: &[Lattice; 3]) -> [i64; 3] {
    let (u, v) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

fn dot(u: &[i64; 3], v: &[i64; 3]) -> i128 {
    // The products of two 63-bit components need 126 bits, their sum is below 2¹²⁷ for coordinates of 30 bits.
    (0..3).map(|k| i128::from(u[k]) * i128::from(v[k])).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, joined, sphere};
    use nalgebra::Point3;

    fn pair(points: &[[f64; 3]], f: [u32; 3], g: [u32; 3]) -> usize {
        let vertices = points.iter().map(|&p| Point3::from(p)).collect();
        self_intersections(&TriMesh { vertices, faces: vec![f, g] }).len()
    }

    #[test]
    fn closed_shapes_do_not_cross_themselves() {
        for mesh in [cuboid([0.0; 3], [1.0, 2.0, 3.0]), sphere(0.05, 4)] {
            assert_eq!(self_intersections(&mesh), Vec::<[u32; 2]>::new());
        }
    }

    #[test]
    fn pairs_that_cross_touch_or_pass() {
        let base = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let with = |more: &[[f64; 3]]| [&base[..], more].concat();
        let (f, g) = ([0, 1, 2], [3, 4, 5]);
        assert_eq!(pair(&with(&[[0.2, 0.2, -1.0], [0.2, 0.2, 1.0], [3.0, 0.2, 1.0]]), f, g), 1);
        assert_eq!(pair(&with(&[[0.2, 0.2, 0.0], [0.2, 0.2, 1.0], [3.0, 0.2, 1.0]]), f, g), 1, "touching");
        assert_eq!(pair(&with(&[[0.2, 0.2, 0.1], [0.2, 0.2, 1.0], [3.0, 0.2, 1.0]]), f, g), 0);
        assert_eq!(pair(&with(&[[0.1, 0.1, 0.0], [0.2, 0.1, 0.0], [0.1, 0.2, 0.0]]), f, g), 1, "within, same plane");
        assert_eq!(pair(&with(&[[0.1, 0.1, 0.0], [2.0, 0.1, 0.0], [2.0, 0.2, 0.0]]), f, g), 1, "overlap, same plane");
        assert_eq!(pair(&with(&[[0.6, 0.6, 0.0], [2.0, 0.6, 0.0], [2.0, 0.7, 0.0]]), f, g), 0, "same plane, apart");
        // A common corner.
        assert_eq!(pair(&with(&[[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), f, [0, 3, 4]), 0);
        assert_eq!(pair(&with(&[[1.0, 1.0, 1.0], [1.0, 1.0, -1.0]]), f, [0, 3, 4]), 1);
        assert_eq!(pair(&with(&[[0.3, 0.1, 0.0], [0.1, 0.3, 0.0]]), f, [0, 3, 4]), 1, "sectors overlap");
        // A common edge.
        assert_eq!(pair(&with(&[[0.0, 0.0, 1.0]]), f, [1, 0, 3]), 0);
        assert_eq!(pair(&with(&[[0.3, -1.0, 0.0]]), f, [1, 0, 3]), 0);
        assert_eq!(pair(&with(&[[0.3, 0.5, 0.0]]), f, [1, 0, 3]), 1, "folded over");
        assert_eq!(pair(&base, f, [0, 2, 1]), 1, "twice the same");
    }

    #[test]
    fn two_overlapping_balls_cross_along_a_ring() {
        let mut other = sphere(0.05, 4);
        other.vertices.iter_mut().for_each(|v| v.x += 0.06);
        let pairs = self_intersections(&joined(&[sphere(0.05, 4), other]));
        assert!(pairs.len() > 50 && pairs.len() < 800, "{}", pairs.len());
        assert!(pairs.iter().all(|&[f, g]| f < 2048 && g >= 2048));
    }

    #[test]
    fn the_filter_never_changes_the_answer() {
        let exact = |a: &Lattice, b: &Lattice, c: &Lattice, d: &Lattice| -> i128 {
            let n = normal(&[*a, *b, *c]);
            (0..3).map(|k| i128::from(n[k]) * i128::from(d[k] - a[k])).sum()
        };
        let big = 1i64 << 30;
        let point = |i: usize| crate::shapes::low_discrepancy(i).map(|c| (c * big as f64) as i64);
        for i in 0..2000 {
            let (a, b, c) = (point(i), point(i + 7), point(i + 31));
            // Close to the plane: an integer combination of the corners, off by a few steps.
            let d = [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) / 3 + (c[k] - a[k]) / 4 + (i % 3) as i64 - 1);
            assert_eq!(i128::from(side(&a, &b, &c, &d)), exact(&a, &b, &c, &d).signum());
        }
    }
}
