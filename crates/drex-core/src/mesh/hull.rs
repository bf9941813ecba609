//! Convex hulls in exact arithmetic.
//!
//! Points are rounded to a lattice of 2²⁸ steps across the largest side of their box (under a nanometre for a
//! hand-sized object), and every decision is an integer determinant: no tolerance, no failure on flat or
//! repeated points.

use std::collections::BTreeMap;

use nalgebra::Point3;

use super::TriMesh;
use crate::{Error, Result};

/// Steps of the lattice across the largest side.
const STEPS: f64 = (1u64 << 28) as f64;

type Lattice = [i64; 3];

/// The convex hull of a set of points, wound outwards, with only those points that are its corners.
///
/// # Errors
/// If a coordinate is not finite or all points lie in one plane.
pub fn convex_hull(points: &[Point3<f64>]) -> Result<TriMesh> {
    Ok(TriMesh::of_faces(points, convex_hull_faces(points)?))
}

/// Triangles of the convex hull of `points`, counter-clockwise from outside, as indices into `points`.
///
/// # Errors
/// If a coordinate is not finite or all points lie in one plane.
pub fn convex_hull_faces(points: &[Point3<f64>]) -> Result<Vec<[u32; 3]>> {
    if let Some(i) = points.iter().position(|p| p.iter().any(|c| !c.is_finite())) {
        return Err(Error::value(format!("point {i} of the hull is not finite"), "remove it"));
    }
    let flat = || {
        let what = format!("all {} points of the convex hull lie in one plane", points.len());
        Error::value(what, "give points of the whole surface of a solid")
    };
    let first = *points.first().ok_or_else(flat)?;
    let (lo, hi) = points.iter().fold((first, first), |(lo, hi), p| (lo.inf(p), hi.sup(p)));
    let side = (hi - lo).max();
    if !(side > 0.0) {
        return Err(flat());
    }
    let lattice: Vec<Lattice> =
        points.iter().map(|p| [0, 1, 2].map(|k| ((p[k] - lo[k]) / side * STEPS).round() as i64)).collect();
    // One of each place, sorted: the result does not depend on the order of the points.
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_unstable_by_key(|&i| (lattice[i as usize], i));
    order.dedup_by_key(|i| lattice[*i as usize]);
    let p: Vec<Lattice> = order.iter().map(|&i| lattice[i as usize]).collect();
    let facets = Builder::start(&p).ok_or_else(flat)?.finish();
    Ok(facets.into_iter().map(|f| f.map(|v| order[v as usize])).collect())
}

fn sub(a: Lattice, b: Lattice) -> [i128; 3] {
    [0, 1, 2].map(|k| i128::from(a[k] - b[k]))
}

fn cross(a: [i128; 3], b: [i128; 3]) -> [i128; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [i128; 3], b: [i128; 3]) -> i128 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

struct Facet {
    corners: [u32; 3],
    /// Facet across the edge from corner k to corner k + 1.
    neighbours: [u32; 3],
    normal: [i128; 3],
    /// Points in front of it that no earlier facet took.
    in_front: Vec<u32>,
    alive: bool,
}

/// Quickhull (Barber, Dobkin and Huhdanpaa 1996) with exact predicates.
struct Builder<'a> {
    points: &'a [Lattice],
    facets: Vec<Facet>,
}

impl<'a> Builder<'a> {
    /// A first tetrahedron; `None` if all points lie in one plane. Points are sorted, so the first and the last are corners.
    fn start(points: &'a [Lattice]) -> Option<Self> {
        let n = points.len();
        if n < 4 {
            return None;
        }
        let (a, b) = (0, n - 1);
        // Ties go to the last of the sorted points, which is a corner of whatever ties.
        let ab = sub(points[b], points[a]);
        let from_line = |i: usize| {
            let c = cross(ab, sub(points[i], points[a]));
            dot(c, c)
        };
        let c = (0..n).max_by_key(|&i| (from_line(i), i)).filter(|&i| from_line(i) > 0)?;
        let normal = cross(ab, sub(points[c], points[a]));
        let from_plane = |i: usize| dot(normal, sub(points[i], points[a]));
        let d = (0..n).max_by_key(|&i| (from_plane(i).abs(), i)).filter(|&i| from_plane(i) != 0)?;
        let (b, c) = if from_plane(d) > 0 { (c, b) } else { (b, c) };
        let [a, b, c, d] = [a, b, c, d].map(|i| i as u32);
        let mut builder = Self { points, facets: Vec::new() };
        for corners in [[a, b, c], [a, d, b], [b, d, c], [c, d, a]] {
            builder.push(corners);
        }
        for f in 0..4u32 {
            for k in 0..3 {
                let (p, q) = builder.edge(f, k);
                for g in 0..4u32 {
                    if (0..3).any(|m| builder.edge(g, m) == (q, p)) {
                        builder.facets[f as usize].neighbours[k] = g;
                    }
                }
            }
        }
        let all = (0..n as u32).collect();
        builder.distribute(all, 0);
        Some(builder)
    }

    fn push(&mut self, corners: [u32; 3]) {
        let [a, b, c] = corners.map(|v| self.points[v as usize]);
        let normal = cross(sub(b, a), sub(c, a));
        self.facets.push(Facet { corners, neighbours: [0; 3], normal, in_front: Vec::new(), alive: true });
    }

    fn edge(&self, f: u32, k: usize) -> (u32, u32) {
        let c = self.facets[f as usize].corners;
        (c[k], c[(k + 1) % 3])
    }

    fn height(&self, f: u32, p: u32) -> i128 {
        let facet = &self.facets[f as usize];
        dot(facet.normal, sub(self.points[p as usize], self.points[facet.corners[0] as usize]))
    }

    /// Gives each point to the first facet from number `first` on that it is in front of.
    fn distribute(&mut self, points: Vec<u32>, first: u32) {
        for p in points {
            if let Some(f) = (first..self.facets.len() as u32).find(|&f| self.height(f, p) > 0) {
                self.facets[f as usize].in_front.push(p);
            }
        }
    }

    fn finish(mut self) -> Vec<[u32; 3]> {
        let mut f = 0u32;
        while (f as usize) < self.facets.len() {
            if self.facets[f as usize].alive && !self.facets[f as usize].in_front.is_empty() {
                self.add_farthest(f);
            }
            f += 1;
        }
        self.facets.into_iter().filter(|f| f.alive).map(|f| f.corners).collect()
    }

    fn add_farthest(&mut self, seed: u32) {
        let in_front = &self.facets[seed as usize].in_front;
        let Some(&apex) = in_front.iter().max_by_key(|&&p| (self.height(seed, p), p)) else { return };
        // Everything the point sees, and the horizon around it.
        let mut seen = vec![seed];
        self.facets[seed as usize].alive = false;
        let mut horizon = BTreeMap::new();
        let mut next = 0;
        while next < seen.len() {
            let f = seen[next];
            next += 1;
            for k in 0..3 {
                let g = self.facets[f as usize].neighbours[k];
                if !self.facets[g as usize].alive {
                    continue;
                }
                if self.height(g, apex) > 0 {
                    self.facets[g as usize].alive = false;
                    seen.push(g);
                }
            }
        }
        for &f in &seen {
            for k in 0..3 {
                let g = self.facets[f as usize].neighbours[k];
                if self.facets[g as usize].alive {
                    let (a, b) = self.edge(f, k);
                    horizon.insert(a, (b, g));
                }
            }
        }
        let first = self.facets.len() as u32;
        let number: BTreeMap<u32, u32> = horizon.keys().copied().zip(first..).collect();
        let mut before = BTreeMap::new();
        for (&a, &(b, g)) in &horizon {
            before.insert(b, number[&a]);
            self.push([a, b, apex]);
            let m = (0..3).find(|&m| self.edge(g, m) == (b, a)).unwrap_or(0);
            self.facets[g as usize].neighbours[m] = number[&a];
        }
        for (&a, &(b, g)) in &horizon {
            // The horizon of an exact hull is one loop, so both neighbours exist.
            let after = number.get(&b).copied().unwrap_or(first);
            let previous = before.get(&a).copied().unwrap_or(first);
            self.facets[number[&a] as usize].neighbours = [g, after, previous];
        }
        for f in seen {
            let orphans = std::mem::take(&mut self.facets[f as usize].in_front);
            self.distribute(orphans, first);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Additive sequences: spread, reproducible, no generator needed.
    fn spread(n: usize) -> Vec<Point3<f64>> {
        let s = |k: usize, a: f64| (k as f64 * a.sqrt()).fract() - 0.5;
        (1..=n).map(|k| Point3::new(s(k, 2.0), s(k, 3.0), s(k, 5.0))).collect()
    }

    /// Closed, and no point sticks out.
    fn check(points: &[Point3<f64>], hull: &TriMesh) {
        assert_eq!(hull.vertices.len() + hull.faces.len(), 2 + hull.faces.len() * 3 / 2);
        // Closed and wound one way: each side of a face is, the other way round, that of one other face.
        let sides: Vec<_> = hull.faces.iter().flat_map(|f| [(f[0], f[1]), (f[1], f[2]), (f[2], f[0])]).collect();
        let set: std::collections::BTreeSet<_> = sides.iter().copied().collect();
        assert!(set.len() == sides.len() && set.iter().all(|(a, b)| set.contains(&(*b, *a))));
        for f in 0..hull.faces.len() {
            let [a, b, c] = hull.triangle(f);
            let n = (b - a).cross(&(c - a));
            let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
            // Rounding to the lattice tilts the plane of a sliver by the step over its height.
            let tilt = 4e-9 / (n.norm() / longest);
            let out = points.iter().map(|p| n.dot(&(p - a)) / n.norm()).fold(0.0, f64::max);
            assert!(out < 1e-8 + 4.0 * tilt, "a point sticks out by {out}, tilt {tilt}");
        }
    }

    #[test]
    fn points_in_and_on_a_box_give_its_corners() {
        let mut points = spread(500);
        for i in 0..7 * 7 * 7 {
            points.push(
                Point3::new((i % 7) as f64, (i / 7 % 7) as f64, (i / 49) as f64) / 6.0
                    - Point3::new(0.5, 0.5, 0.5).coords,
            );
        }
        let hull = convex_hull(&points).unwrap();
        assert_eq!((hull.vertices.len(), hull.faces.len()), (8, 12));
        assert!((hull.mass_properties(1.0).unwrap().mass_kg - 1.0).abs() < 1e-15);
        check(&points, &hull);
    }

    #[test]
    fn the_hull_of_points_on_a_ball_has_them_all() {
        // A spiral: no two points alike.
        let point = |k: usize| {
            let z = 1.0 - (2.0 * k as f64 + 1.0) / 400.0;
            let (sin, cos) = (2.4 * k as f64).sin_cos();
            Point3::new(cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z) * 0.3
        };
        let points: Vec<_> = (0..400).map(point).collect();
        let hull = convex_hull(&points).unwrap();
        assert_eq!((hull.vertices.len(), hull.faces.len()), (400, 2 * 400 - 4));
        check(&points, &hull);
    }

    #[test]
    fn scattered_and_rounded_points() {
        for round in [1e9, 50.0, 4.0] {
            let points: Vec<_> = spread(3000).into_iter().map(|p| p.map(|c| (c * round).round() / round)).collect();
            check(&points, &convex_hull(&points).unwrap());
        }
    }

    #[test]
    fn flat_and_empty_clouds_have_no_hull() {
        let grid: Vec<_> = (0..50).map(|i| Point3::new((i % 7) as f64, (i / 7) as f64, 1.0)).collect();
        let line: Vec<_> = spread(50).into_iter().map(|p| Point3::new(p.x, p.x, p.x)).collect();
        let infinite = vec![Point3::new(f64::INFINITY, 0.0, 0.0); 5];
        for points in [&grid, &grid[..3].to_vec(), &line, &vec![], &vec![Point3::origin(); 9]] {
            assert!(convex_hull(points).unwrap_err().to_string().contains("one plane"));
        }
        assert!(convex_hull(&infinite).unwrap_err().to_string().contains("finite"));
        assert!(convex_hull(&[Point3::new(f64::NAN, 0.0, 0.0); 5]).is_err());
    }
}
