//! Faces of a mesh that cross or touch each other where they should not.

use rayon::prelude::*;

use drex_core::TriMesh;

use crate::bvh::{Aabb, Bvh};

/// Steps of the lattice across the largest side: differences have 31 bits, their triple products fit into 96.
const STEPS: f64 = (1u64 << 30) as f64;

type Lattice = [i64; 3];

/// Pairs of faces that have a point in common other than their common corner or edge, the smaller number first, sorted.
///
/// Decided exactly on coordinates rounded to 2⁻³⁰ of the largest side (a tenth of a nanometre for a hand-sized object), so
/// faces that only touch count too. Neighbours count when they are folded onto each other. Faces without area do not
/// count; vertices must be welded, or every pair of neighbours touches.
pub fn self_intersections(mesh: &TriMesh) -> Vec<[u32; 2]> {
    let Ok(mesh) = TriMesh::new(mesh.vertices.clone(), mesh.faces.clone()) else { return Vec::new() };
    let Some((lo, hi)) = mesh.bounds() else { return Vec::new() };
    let side = (hi - lo).max();
    if !(side > 0.0) {
        return Vec::new();
    }
    let lattice: Vec<Lattice> =
        mesh.vertices.iter().map(|p| [0, 1, 2].map(|k| ((p[k] - lo[k]) / side * STEPS).round() as i64)).collect();
    let tree = Bvh::new(&mesh);
    let has_area: Vec<bool> =
        mesh.faces.par_iter().map(|f| normal(&f.map(|v| lattice[v as usize])) != [0; 3]).collect();
    let of_face = |f: u32| {
        let mut pairs = Vec::new();
        if !has_area[f as usize] {
            return pairs;
        }
        tree.any_in(&Aabb::of(&mesh.triangle(f as usize)), |g, _| {
            let cross = g > f && has_area[g as usize] && meet(&lattice, mesh.faces[f as usize], mesh.faces[g as usize]);
            if cross {
                pairs.push([f, g]);
            }
            false
        });
        pairs.sort_unstable();
        pairs
    };
    (0..mesh.faces.len() as u32).into_par_iter().flat_map_iter(of_face).collect()
}

/// Whether two faces have more in common than their common corners.
fn meet(p: &[Lattice], f: [u32; 3], g: [u32; 3]) -> bool {
    let at = |v: u32| p[v as usize];
    let (tf, tg) = (f.map(at), g.map(at));
    let shared: Vec<u32> = f.into_iter().filter(|v| g.contains(v)).collect();
    let others = |t: [u32; 3]| t.into_iter().filter(|v| !shared.contains(v)).map(at).collect::<Vec<_>>();
    match (&shared[..], &others(f)[..], &others(g)[..]) {
        ([], _, _) => {
            (0..3).any(|k| segment_meets(&tf[k], &tf[(k + 1) % 3], &tg))
                || (0..3).any(|k| segment_meets(&tg[k], &tg[(k + 1) % 3], &tf))
        }
        // Beyond the common corner, one far edge must meet the other face.
        ([_], [a, b], [c, d]) => segment_meets(a, b, &tg) || segment_meets(c, d, &tf),
        // Folded along the common edge: in one plane, on one side.
        ([a, b], [c], [d]) => {
            let (a, b) = (at(*a), at(*b));
            volume(&a, &b, c, d) == 0 && dot(&normal(&[a, b, *c]), &normal(&[a, b, *d])) > 0
        }
        _ => true,
    }
}

/// Whether a closed segment meets a closed triangle.
fn segment_meets(p: &Lattice, q: &Lattice, t: &[Lattice; 3]) -> bool {
    let [a, b, c] = t;
    let (side_p, side_q) = (volume(a, b, c, p).signum(), volume(a, b, c, q).signum());
    if side_p * side_q > 0 {
        return false;
    }
    if side_p == 0 && side_q == 0 {
        return segment_meets_in_plane(p, q, t);
    }
    let s = [(a, b), (b, c), (c, a)].map(|(u, v)| volume(p, q, u, v).signum());
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
    let apart = |x: i128, y: i128| x.signum() * y.signum() <= 0;
    let (s, t) = ((turn(p, q, a), turn(p, q, b)), (turn(a, b, p), turn(a, b, q)));
    // All on one line: then an end of one lies on the other, which the test of the ends has seen, or they are apart.
    (s.0 != 0 || s.1 != 0) && apart(s.0, s.1) && apart(t.0, t.1)
}

/// Twice the area of a triangle in the plane.
fn turn(a: &[i64; 2], b: &[i64; 2], c: &[i64; 2]) -> i128 {
    let d = |u: i64, v: i64| i128::from(u - v);
    d(b[0], a[0]) * d(c[1], a[1]) - d(b[1], a[1]) * d(c[0], a[0])
}

/// Six times the volume of a tetrahedron.
fn volume(a: &Lattice, b: &Lattice, c: &Lattice, d: &Lattice) -> i128 {
    let n = normal(&[*a, *b, *c]);
    // Floating point settles all but the close calls: each component of n is below 2⁶³, each difference below 2³¹.
    let quick: f64 = (0..3).map(|k| n[k] as f64 * (d[k] - a[k]) as f64).sum();
    if quick.abs() > 2.0_f64.powi(96 - 50) {
        return quick as i128;
    }
    (0..3).map(|k| n[k] * i128::from(d[k] - a[k])).sum()
}

fn normal([a, b, c]: &[Lattice; 3]) -> [i128; 3] {
    let (u, v) = ([0, 1, 2].map(|k| i128::from(b[k] - a[k])), [0, 1, 2].map(|k| i128::from(c[k] - a[k])));
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

fn dot(u: &[i128; 3], v: &[i128; 3]) -> i128 {
    // The products of two 63-bit components need 126 bits, their sum is below 2¹²⁷ for coordinates of 30 bits.
    (0..3).map(|k| u[k] * v[k]).sum()
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
            (0..3).map(|k| n[k] * i128::from(d[k] - a[k])).sum()
        };
        let big = 1i64 << 30;
        let point = |i: usize| crate::shapes::low_discrepancy(i).map(|c| (c * big as f64) as i64);
        for i in 0..2000 {
            let (a, b, c) = (point(i), point(i + 7), point(i + 31));
            // Close to the plane: an integer combination of the corners, off by a few steps.
            let d = [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) / 3 + (c[k] - a[k]) / 4 + (i % 3) as i64 - 1);
            assert_eq!(volume(&a, &b, &c, &d).signum(), exact(&a, &b, &c, &d).signum());
        }
    }
}
