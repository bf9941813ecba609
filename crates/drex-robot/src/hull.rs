//! Closedness and convex hull of a mesh: what decides which solid a mesh stands for.

use std::collections::{BTreeSet, HashMap};
use std::f64::consts::PI;

use drex_core::TriMesh;
use nalgebra::{Point3, Vector3};

/// Vertices nearer than this fraction of the mesh's extent are one point: files round, and split vertices at seams.
const SAME_POINT: f64 = 1e-6;
/// A mesh whose openings could hide at most this share of its volume counts as closed.
const HIDDEN_VOLUME: f64 = 0.01;
/// Points nearer to a face of the hull than this fraction of the extent lie on it.
const ON_FACE: f64 = 1e-10;

/// Whether the mesh bounds a solid: every edge is used as often in one direction as in the other, but for openings so
/// small that the volume behind them does not matter. An opening of rim length L has at most area L²/4π, and
/// closing it changes the volume by at most a third of that times the extent.
pub(crate) fn is_closed(mesh: &TriMesh) -> bool {
    let Some((lo, hi)) = mesh.bounds() else { return false };
    let extent = (hi - lo).norm();
    let rim = open_rim(mesh, SAME_POINT * extent);
    rim * rim * extent / (12.0 * PI) <= HIDDEN_VOLUME * volume(mesh, &nalgebra::center(&lo, &hi)).abs()
}

fn volume(mesh: &TriMesh, reference: &Point3<f64>) -> f64 {
    (0..mesh.faces.len())
        .map(|f| {
            let [a, b, c] = mesh.triangle(f).map(|p| p - reference);
            a.dot(&b.cross(&c)) / 6.0
        })
        .sum()
}

/// Total length of the edges that are not used equally often both ways.
fn open_rim(mesh: &TriMesh, tolerance: f64) -> f64 {
    let welded = weld(&mesh.vertices, tolerance);
    let mut balance: HashMap<(u32, u32), i32> = HashMap::with_capacity(mesh.faces.len() * 2);
    for face in &mesh.faces {
        let f = face.map(|v| welded[v as usize]);
        for (a, b) in [(f[0], f[1]), (f[1], f[2]), (f[2], f[0])] {
            if a != b {
                *balance.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
            }
        }
    }
    // Sorted, so that the sum does not depend on the map's order.
    let open: BTreeSet<(u32, u32)> = balance.into_iter().filter(|(_, n)| *n != 0).map(|(edge, _)| edge).collect();
    open.iter().map(|&(a, b)| (mesh.vertices[a as usize] - mesh.vertices[b as usize]).norm()).sum()
}

/// For each vertex, the first vertex within `tolerance` of it.
fn weld(vertices: &[Point3<f64>], tolerance: f64) -> Vec<u32> {
    let cell = |p: &Point3<f64>| [p.x, p.y, p.z].map(|c| (c / tolerance.max(f64::MIN_POSITIVE)).floor() as i64);
    let mut grid: HashMap<[i64; 3], Vec<u32>> = HashMap::with_capacity(vertices.len());
    let mut welded = Vec::with_capacity(vertices.len());
    for (i, p) in vertices.iter().enumerate() {
        let at = cell(p);
        let mut found = None;
        'search: for dx in -1..=1i64 {
            for dy in -1..=1i64 {
                for dz in -1..=1i64 {
                    let key = [at[0].saturating_add(dx), at[1].saturating_add(dy), at[2].saturating_add(dz)];
                    let near = |k: &&u32| (vertices[**k as usize] - p).norm() <= tolerance;
                    found = grid.get(&key).and_then(|ks| ks.iter().find(near)).copied();
                    if found.is_some() {
                        break 'search;
                    }
                }
            }
        }
        welded.push(found.unwrap_or_else(|| {
            grid.entry(at).or_default().push(i as u32);
            i as u32
        }));
    }
    welded
}

/// A face of the growing hull.
struct Face {
    corners: [u32; 3],
    normal: Vector3<f64>,
    offset: f64,
}

/// The convex hull of the mesh's vertices, outward; `None` if they lie in a plane. Points are added one by one, each
/// replacing the faces that it sees.
pub(crate) fn convex_hull(mesh: &TriMesh) -> Option<TriMesh> {
    let (lo, hi) = mesh.bounds()?;
    let points = &mesh.vertices;
    let tolerance = ON_FACE * (hi - lo).norm();
    let first = first_tetrahedron(points, 1e-6 * (hi - lo).norm())?;
    let face = |corners: [u32; 3]| {
        let [a, b, c] = corners.map(|v| points[v as usize]);
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::zeros);
        Face { corners, normal, offset: normal.dot(&a.coords) }
    };
    let [a, b, c, d] = first;
    let mut faces: Vec<Face> = [[a, b, c], [a, d, b], [b, d, c], [c, d, a]].into_iter().map(face).collect();
    for (i, p) in points.iter().enumerate() {
        let sees = |f: &Face| f.normal.dot(&p.coords) - f.offset > tolerance;
        if !faces.iter().any(sees) {
            continue;
        }
        let mut edges = BTreeSet::new();
        faces.retain(|f| {
            let seen = sees(f);
            if seen {
                let [a, b, c] = f.corners;
                edges.extend([(a, b), (b, c), (c, a)]);
            }
            !seen
        });
        // The horizon: edges of seen faces whose other side is not seen.
        faces.extend(edges.iter().filter(|(a, b)| !edges.contains(&(*b, *a))).map(|&(a, b)| face([a, b, i as u32])));
    }
    let mut used: Vec<u32> = faces.iter().flat_map(|f| f.corners).collect();
    used.sort_unstable();
    used.dedup();
    let renumber = |v: u32| used.binary_search(&v).map_or(0, |k| k as u32);
    Some(TriMesh {
        vertices: used.iter().map(|&v| points[v as usize]).collect(),
        faces: faces.iter().map(|f| f.corners.map(renumber)).collect(),
    })
}

/// Four points far apart, ordered so that the first three wind outwards; `None` if the points are flat.
fn first_tetrahedron(points: &[Point3<f64>], least: f64) -> Option<[u32; 4]> {
    let farthest = |measure: &dyn Fn(&Point3<f64>) -> f64| {
        let i = (0..points.len()).max_by(|&i, &j| measure(&points[i]).total_cmp(&measure(&points[j])))?;
        (measure(&points[i]) > least).then_some(i)
    };
    let a = 0;
    let b = farthest(&|p| (p - points[a]).norm())?;
    let along = (points[b] - points[a]).try_normalize(0.0)?;
    let c = farthest(&|p| along.cross(&(p - points[a])).norm())?;
    let normal = along.cross(&(points[c] - points[a])).try_normalize(0.0)?;
    let d = farthest(&|p| normal.dot(&(p - points[a])).abs())?;
    let below = normal.dot(&(points[d] - points[a])) < 0.0;
    let (b, c) = if below { (b, c) } else { (c, b) };
    Some([a as u32, b as u32, c as u32, d as u32])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(points: Vec<Point3<f64>>) -> TriMesh {
        TriMesh { vertices: points, faces: Vec::new() }
    }

    /// Additive sequences: spread, reproducible, no generator needed.
    fn spread(n: usize) -> Vec<Point3<f64>> {
        let s = |k: usize, a: f64| (k as f64 * a.sqrt()).fract() - 0.5;
        (1..=n).map(|k| Point3::new(s(k, 2.0), s(k, 3.0), s(k, 5.0))).collect()
    }

    #[test]
    fn hull_of_a_filled_box_is_the_box() {
        let mut points = spread(500);
        for i in 0..8 {
            points.push(Point3::new((i & 1) as f64 - 0.5, (i >> 1 & 1) as f64 - 0.5, (i >> 2 & 1) as f64 - 0.5));
        }
        // Coplanar points on faces and edges, doubled corners.
        points.extend([Point3::new(0.5, 0.0, 0.0), Point3::new(0.5, 0.5, 0.1), Point3::new(0.5, 0.5, 0.5)]);
        let hull = convex_hull(&cloud(points)).unwrap();
        assert!(is_closed(&hull));
        assert!((hull.mass_properties(1.0).unwrap().mass_kg - 1.0).abs() < 1e-9);
    }

    /// A spiral on the unit ball: no two points alike.
    fn ball(n: usize) -> Vec<Point3<f64>> {
        let point = |k: usize| {
            let z = 1.0 - (2.0 * k as f64 + 1.0) / n as f64;
            let (sin, cos) = (2.4 * k as f64).sin_cos();
            Point3::from(Vector3::new(cos * (1.0 - z * z).sqrt(), sin * (1.0 - z * z).sqrt(), z))
        };
        (0..n).map(point).collect()
    }

    #[test]
    fn hull_of_points_on_a_ball_has_them_all() {
        let points: Vec<Point3<f64>> = ball(400).into_iter().map(|p| p * 0.3).collect();
        let hull = convex_hull(&cloud(points.clone())).unwrap();
        assert_eq!((hull.vertices.len(), hull.faces.len()), (400, 2 * 400 - 4));
        assert!(is_closed(&hull) && open_rim(&hull, 0.0) == 0.0);
        for f in 0..hull.faces.len() {
            let [a, b, c] = hull.triangle(f);
            let n = (b - a).cross(&(c - a)).normalize();
            assert!(points.iter().all(|p| n.dot(&(p - a)) < 1e-9));
        }
    }

    #[test]
    fn flat_and_empty_clouds_have_no_hull() {
        let flat: Vec<Point3<f64>> = spread(50).into_iter().map(|p| Point3::new(p.x, p.y, p.x + p.y)).collect();
        let line: Vec<Point3<f64>> = spread(50).into_iter().map(|p| Point3::new(p.x, p.x, p.x)).collect();
        for points in [flat, line, vec![], vec![Point3::origin(); 9], vec![Point3::new(f64::INFINITY, 0.0, 0.0); 5]] {
            assert!(convex_hull(&cloud(points)).is_none());
        }
    }

    #[test]
    fn cracks_from_rounding_do_not_open_a_mesh_but_holes_do() {
        let hull = convex_hull(&cloud(ball(200))).unwrap();
        // Every face with vertices of its own, rounded apart.
        let mut cracked = TriMesh::default();
        for f in 0..hull.faces.len() {
            for (k, p) in hull.triangle(f).iter().enumerate() {
                cracked.vertices.push(p + Vector3::new(1e-8, -1e-8, 1e-8) * (((f + k) % 5) as f64));
            }
            let n = cracked.vertices.len() as u32;
            cracked.faces.push([n - 3, n - 2, n - 1]);
        }
        assert!(is_closed(&cracked));
        let mut holed = hull.clone();
        holed.faces.truncate(hull.faces.len() - 40);
        assert!(!is_closed(&holed));
        // A pipe: its openings cancel in the sum of area vectors, but it is open.
        let ring =
            |z: f64| (0..32).map(move |k| (k as f64 * PI / 16.0).sin_cos()).map(move |(s, c)| Point3::new(c, s, z));
        let pipe = TriMesh {
            vertices: ring(0.0).chain(ring(3.0)).collect(),
            faces: (0..32u32)
                .flat_map(|k| [[k, (k + 1) % 32, 32 + (k + 1) % 32], [k, 32 + (k + 1) % 32, 32 + k]])
                .collect(),
        };
        assert!(!is_closed(&pipe));
    }
}
