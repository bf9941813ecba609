//! Convex polyhedra: a bounded set of extreme points with the edges and planes of their hull.

use std::collections::{BTreeMap, BTreeSet};

use drex_core::mesh::convex_hull_faces;
use nalgebra::{Point3, Vector3};

use crate::{Error, Result};

/// Directions in which extreme points are looked for. Even, so that no direction is horizontal.
const DIRECTIONS: usize = 4096;
/// Most vertices a piece keeps.
const MAX_VERTICES: usize = 512;
/// Relative thickness below which a point counts as lying in a plane.
const FLAT: f64 = 2e-6;
/// Cosine of the angle under which two neighbouring triangles are one face.
const COPLANAR_COS: f64 = 0.999_999;

/// A convex polyhedron, in the frame of the body that carries it.
///
/// Its vertices are the points that are extreme in one of some thousand directions, so their number, and with it the
/// cost and the stiffness of contact, is bounded however fine the mesh is: a box keeps its eight corners, the rims of a
/// cylinder as many points as the mesh has (up to the bound).
#[derive(Debug, Clone, PartialEq)]
pub struct ConvexPolyhedron {
    vertices: Vec<Point3<f64>>,
    edges: Vec<[u32; 2]>,
    /// The two faces beside each edge.
    edge_faces: Vec<[u32; 2]>,
    planes: Vec<(Vector3<f64>, f64)>,
    /// Corners of all faces, one loop after the other; loop f is `loop_start[f]..loop_start[f + 1]`.
    loops: Vec<u32>,
    loop_start: Vec<u32>,
    /// Corners of the bounding box.
    bounds: (Point3<f64>, Point3<f64>),
}

impl ConvexPolyhedron {
    /// The convex hull of `points`, metres.
    ///
    /// # Errors
    /// If a coordinate is not finite or the points span no volume.
    pub fn from_points(points: &[Point3<f64>]) -> Result<Self> {
        if points.iter().any(|p| p.iter().any(|c| !c.is_finite())) {
            return Err(Error::NotFinite { what: "a vertex of a convex polyhedron".into() });
        }
        let vertices = spread_out(extreme_points(points), MAX_VERTICES);
        let triangles = convex_hull_faces(&vertices).map_err(|_| Error::FlatPolyhedron { points: points.len() })?;
        Ok(Self::from_hull(vertices, &triangles))
    }

    /// A box about the origin. Corner number i has its coordinate k at the upper side where bit k of i is set.
    pub(crate) fn cuboid(half: &Vector3<f64>) -> Self {
        let corner = |i: usize| {
            Point3::from(half.component_mul(&Vector3::from_fn(|k, _| if i >> k & 1 == 0 { -1.0 } else { 1.0 })))
        };
        let quads: [[u32; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let triangles: Vec<[u32; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        Self::from_hull((0..8).map(corner).collect(), &triangles)
    }

    /// A prism about the z axis whose corners lie on a cylinder: corner 2 i is at angle i of `sides` on the lower rim,
    /// 2 i + 1 above it.
    pub(crate) fn prism(radius_m: f64, half_length_m: f64, sides: u32) -> Self {
        let corner = |i: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i / 2) / f64::from(sides)).sin_cos();
            Point3::new(radius_m * cos, radius_m * sin, half_length_m * if i & 1 == 0 { -1.0 } else { 1.0 })
        };
        let mut triangles = Vec::new();
        for i in 0..sides {
            let j = (i + 1) % sides;
            triangles.extend([[2 * i, 2 * j, 2 * j + 1], [2 * i, 2 * j + 1, 2 * i + 1]]);
            if i > 0 && j > 0 {
                triangles.extend([[0, 2 * j, 2 * i], [1, 2 * i + 1, 2 * j + 1]]);
            }
        }
        Self::from_hull((0..2 * sides).map(corner).collect(), &triangles)
    }

    /// Corner points, metres.
    pub fn vertices(&self) -> &[Point3<f64>] {
        &self.vertices
    }

    /// Edges between faces that are not coplanar, as pairs of vertex indices.
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// The two faces (indices into [`Self::planes`]) that meet at each edge. The first has the edge in its loop in the
    /// direction of [`Self::edges`], the second against it.
    pub fn edge_faces(&self) -> &[[u32; 2]] {
        &self.edge_faces
    }

    /// Outward unit normal n and offset d of each face plane: inside where n·x <= d.
    pub fn planes(&self) -> &[(Vector3<f64>, f64)] {
        &self.planes
    }

    /// Corners of a face as vertex indices, counter-clockwise seen from outside; empty for a face that does not exist.
    pub fn face(&self, face: usize) -> &[u32] {
        match (self.loop_start.get(face), self.loop_start.get(face + 1)) {
            (Some(&a), Some(&b)) => &self.loops[a as usize..b as usize],
            _ => &[],
        }
    }

    /// Lower and upper corner of the bounding box.
    pub fn bounds(&self) -> (Point3<f64>, Point3<f64>) {
        self.bounds
    }

    /// The faces of a closed triangle hull: neighbouring triangles in one plane are one face.
    fn from_hull(vertices: Vec<Point3<f64>>, triangles: &[[u32; 3]]) -> Self {
        let (lo, hi) = vertices.iter().fold((vertices[0], vertices[0]), |(lo, hi), p| (lo.inf(p), hi.sup(p)));
        let (planes, group) = coplanar_groups(&vertices, triangles);
        let (mut loops, mut loop_start) = (Vec::new(), vec![0]);
        for (face, (normal, _)) in planes.iter().enumerate() {
            let members = triangles.iter().zip(&group).filter(|(_, g)| **g == face).map(|(t, _)| *t);
            loops.extend(outline(&members.collect::<Vec<_>>(), &vertices, normal));
            loop_start.push(loops.len() as u32);
        }
        let mut piece =
            Self { vertices, edges: vec![], edge_faces: vec![], planes, loops, loop_start, bounds: (lo, hi) };
        let sides = directed_edges((0..piece.planes.len()).map(|f| piece.face(f)));
        for (&(a, b), &f) in &sides {
            let twin = sides.get(&(b, a));
            if a < b || twin.is_none() {
                piece.edges.push([a, b]);
                piece.edge_faces.push([f as u32, *twin.unwrap_or(&f) as u32]);
            }
        }
        piece
    }
}

/// Which loop has the side from a to b.
fn directed_edges<'a>(loops: impl Iterator<Item = &'a [u32]>) -> BTreeMap<(u32, u32), usize> {
    let sides = |l: &'a [u32]| l.iter().zip(l.iter().cycle().skip(1)).map(|(a, b)| (*a, *b));
    loops.enumerate().flat_map(|(f, l)| sides(l).map(move |side| (side, f))).collect()
}

/// Planes of the faces, and the face of each triangle: regions that grow from the largest triangle that is left.
fn coplanar_groups(vertices: &[Point3<f64>], triangles: &[[u32; 3]]) -> (Vec<(Vector3<f64>, f64)>, Vec<usize>) {
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| vertices[v as usize]);
        (b - a).cross(&(c - a))
    };
    let areas: Vec<Vector3<f64>> = triangles.iter().map(area).collect();
    let neighbour = directed_edges(triangles.iter().map(|t| t.as_slice()));
    let mut order: Vec<usize> = (0..triangles.len()).collect();
    order.sort_by(|&i, &j| areas[j].norm_squared().total_cmp(&areas[i].norm_squared()));
    let mut group = vec![usize::MAX; triangles.len()];
    let mut planes = Vec::new();
    for seed in order {
        if group[seed] != usize::MAX {
            continue;
        }
        let normal = areas[seed].try_normalize(0.0).unwrap_or_else(Vector3::z);
        let mut open = vec![seed];
        group[seed] = planes.len();
        while let Some(t) = open.pop() {
            let [a, b, c] = triangles[t];
            for twin in [(b, a), (c, b), (a, c)].into_iter().filter_map(|side| neighbour.get(&side)) {
                if group[*twin] == usize::MAX && areas[*twin].dot(&normal) >= COPLANAR_COS * areas[*twin].norm() {
                    group[*twin] = planes.len();
                    open.push(*twin);
                }
            }
        }
        let offset = vertices.iter().map(|v| normal.dot(&v.coords)).fold(f64::NEG_INFINITY, f64::max);
        planes.push((normal, offset));
    }
    (planes, group)
}

/// Corners around a face that consists of `triangles`.
fn outline(triangles: &[[u32; 3]], vertices: &[Point3<f64>], normal: &Vector3<f64>) -> Vec<u32> {
    let sides = directed_edges(triangles.iter().map(|t| t.as_slice()));
    let next: BTreeMap<u32, u32> = sides.keys().filter(|(a, b)| !sides.contains_key(&(*b, *a))).copied().collect();
    let mut around = Vec::new();
    let mut at = next.keys().next().copied();
    while let Some(v) = at.filter(|v| around.first() != Some(v) && around.len() < next.len()) {
        around.push(v);
        at = next.get(&v).copied();
    }
    if around.len() == next.len() && around.len() > 2 {
        return around;
    }
    // A region that touches itself (from slivers): its corners by their angle about the middle.
    let corners: BTreeSet<u32> = triangles.iter().flatten().copied().collect();
    let at = |v: &u32| vertices[*v as usize].coords;
    let center = corners.iter().map(at).sum::<Vector3<f64>>() / corners.len().max(1) as f64;
    let x = normal.cross(&Vector3::ith(normal.iamin(), 1.0)).normalize();
    let y = normal.cross(&x);
    let angle = |v: &u32| y.dot(&(at(v) - center)).atan2(x.dot(&(at(v) - center)));
    let mut around: Vec<u32> = corners.into_iter().collect();
    around.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
    around
}

/// The points that lie farthest out in one of [`DIRECTIONS`] directions (a Fibonacci lattice of one octant, and its mirror images, so
/// that mirrored points are thinned alike), each once. The lattice is generic, so of points on a flat face only its corners are found.
fn extreme_points(points: &[Point3<f64>]) -> Vec<Point3<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let blocks = Blocks::new(points);
    let mut found = BTreeSet::new();
    for i in 0..DIRECTIONS {
        let z = 1.0 - (2 * (i / 8) + 1) as f64 / (DIRECTIONS / 8 * 2) as f64;
        let (r, a) = ((1.0 - z * z).sqrt(), (golden * (i / 8) as f64 + 0.1) % std::f64::consts::FRAC_PI_2);
        let n = [r * a.cos(), r * a.sin(), z];
        let n = Vector3::from_fn(|k, _| if i >> k & 1 == 0 { n[k] } else { -n[k] });
        found.extend(blocks.farthest(&n));
    }
    let mut kept: Vec<Point3<f64>> = Vec::new();
    let size = found.iter().map(|&k| (points[k] - points[0]).norm()).fold(0.0, f64::max);
    for k in found {
        if kept.iter().all(|p| (p - points[k]).norm() > FLAT * size) {
            kept.push(points[k]);
        }
    }
    kept
}

/// Points in groups of neighbours, so that most are never looked at when one asks for the farthest.
struct Blocks<'a> {
    points: &'a [Point3<f64>],
    /// Indices of the points, group after group, with the centre and the half extents of the group's box.
    groups: Vec<(Vec<usize>, Vector3<f64>, Vector3<f64>)>,
}

impl<'a> Blocks<'a> {
    fn new(points: &'a [Point3<f64>]) -> Self {
        const CELLS: f64 = 10.0;
        let Some(&first) = points.first() else { return Self { points, groups: Vec::new() } };
        let (low, high) = points.iter().fold((first, first), |(lo, hi), p| (lo.inf(p), hi.sup(p)));
        let size = high - low;
        let cell =
            |p: &Point3<f64>| [0, 1, 2].map(|i| (CELLS * (p[i] - low[i]) / size[i].max(f64::MIN_POSITIVE)) as u8);
        let mut cells: BTreeMap<[u8; 3], Vec<usize>> = BTreeMap::new();
        for (k, p) in points.iter().enumerate() {
            cells.entry(cell(p)).or_default().push(k);
        }
        let boxed = |of: Vec<usize>| {
            let start = points[of[0]];
            let (lo, hi) = of.iter().fold((start, start), |(lo, hi), &k| (lo.inf(&points[k]), hi.sup(&points[k])));
            (of, nalgebra::center(&lo, &hi).coords, (hi - lo) * 0.5)
        };
        Self { points, groups: cells.into_values().map(boxed).collect() }
    }

    /// The point farthest along `n`; of several the last.
    fn farthest(&self, n: &Vector3<f64>) -> Option<usize> {
        let reach: Vec<f64> = self.groups.iter().map(|(_, c, half)| n.dot(c) + n.abs().dot(half)).collect();
        let value = |k: usize| n.dot(&self.points[k].coords);
        let better = |a: &usize, b: &usize| value(*a).total_cmp(&value(*b)).then(a.cmp(b));
        let of = |g: usize| self.groups[g].0.iter().copied().max_by(better);
        let first = (0..reach.len()).max_by(|&a, &b| reach[a].total_cmp(&reach[b]))?;
        let mut best = of(first)?;
        // Rounding of a reach must not hide a group.
        let (_, center, half) = &self.groups[first];
        let margin = 1e-12 * (center.norm() + half.norm());
        for g in (0..reach.len()).filter(|&g| g != first) {
            if reach[g] + margin >= value(best) {
                best = of(g).into_iter().chain([best]).max_by(better)?;
            }
        }
        Some(best)
    }
}

/// At most `limit` of `points`, chosen so that each is the farthest from those already chosen; order of `points` kept.
fn spread_out(points: Vec<Point3<f64>>, limit: usize) -> Vec<Point3<f64>> {
    if points.len() <= limit {
        return points;
    }
    let center = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
    let farthest = |d: &[f64]| (0..d.len()).max_by(|&a, &b| d[a].total_cmp(&d[b])).unwrap_or(0);
    let mut chosen = BTreeSet::new();
    let mut distance: Vec<f64> = points.iter().map(|p| (p.coords - center).norm()).collect();
    let mut next = farthest(&distance);
    distance = vec![f64::INFINITY; points.len()];
    while chosen.len() < limit {
        chosen.insert(next);
        for (d, p) in distance.iter_mut().zip(&points) {
            *d = d.min((p - points[next]).norm());
        }
        next = farthest(&distance);
    }
    chosen.into_iter().map(|i| points[i]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_find_what_a_look_at_all_points_finds() {
        let mut state = 1_u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let cloud: Vec<Point3<f64>> = (0..3000).map(|_| Point3::new(next(), 0.1 * next(), 3.0 + next())).collect();
        for points in [cloud, grid_box(0.02, 0.03, 0.04, 12), vec![Point3::origin(); 5]] {
            let blocks = Blocks::new(&points);
            for _ in 0..200 {
                let n = Vector3::new(next(), next(), next()).normalize();
                let all = points.iter().enumerate();
                let best = all.max_by(|x, y| n.dot(&x.1.coords).total_cmp(&n.dot(&y.1.coords))).map(|(k, _)| k);
                assert_eq!(blocks.farthest(&n), best);
            }
        }
        assert_eq!(Blocks::new(&[]).farthest(&Vector3::x()), None);
    }

    fn grid_box(hx: f64, hy: f64, hz: f64, n: usize) -> Vec<Point3<f64>> {
        let mut out = Vec::new();
        for i in 0..=n {
            for j in 0..=n {
                for k in 0..=n {
                    let f = |m: usize, h: f64| h * (2.0 * m as f64 / n as f64 - 1.0);
                    out.push(Point3::new(f(i, hx), f(j, hy), f(k, hz)));
                }
            }
        }
        out
    }

    #[test]
    fn a_box_keeps_eight_corners_however_fine_its_mesh() {
        for n in [1, 7, 20] {
            let piece = ConvexPolyhedron::from_points(&grid_box(0.014, 0.039, 0.012, n)).unwrap();
            assert_eq!((piece.vertices().len(), piece.edges().len(), piece.planes().len()), (8, 12, 6), "n = {n}");
        }
    }

    #[test]
    fn a_cylinder_keeps_its_rims() {
        let rim = |z: f64| {
            (0..38).map(move |i| {
                let a = std::f64::consts::TAU * f64::from(i) / 38.0;
                Point3::new(0.03 * a.cos(), 0.03 * a.sin(), z)
            })
        };
        let points: Vec<_> = rim(-0.05).chain(rim(0.0)).chain(rim(0.05)).collect();
        let piece = ConvexPolyhedron::from_points(&points).unwrap();
        assert_eq!((piece.vertices().len(), piece.edges().len(), piece.planes().len()), (76, 114, 40));
    }

    /// Loops run around their faces, and each side belongs to one edge of two faces.
    fn check_faces(piece: &ConvexPolyhedron) {
        let at = |v: u32| piece.vertices()[v as usize].coords;
        for (f, (n, d)) in piece.planes().iter().enumerate() {
            let corners = piece.face(f);
            let area: Vector3<f64> =
                corners.iter().zip(corners.iter().cycle().skip(1)).map(|(a, b)| at(*a).cross(&at(*b))).sum();
            assert!(corners.len() > 2 && area.dot(n) > 0.999 * area.norm());
            assert!(corners.iter().all(|v| (n.dot(&at(*v)) - d).abs() < 1e-3));
        }
        for ([a, b], [f, g]) in piece.edges().iter().zip(piece.edge_faces()) {
            let has = |face: u32, from: u32, to: u32| {
                let l = piece.face(face as usize);
                (0..l.len()).any(|i| l[i] == from && l[(i + 1) % l.len()] == to)
            };
            assert!(f != g && has(*f, *a, *b) && has(*g, *b, *a));
        }
        let corners: usize = (0..piece.planes().len()).map(|f| piece.face(f).len()).sum();
        assert_eq!(corners, 2 * piece.edges().len());
    }

    #[test]
    fn boxes_and_prisms_are_what_their_hulls_are() {
        let half = Vector3::new(0.014, 0.039, 0.012);
        let exact = ConvexPolyhedron::cuboid(&half);
        check_faces(&exact);
        assert_eq!((exact.vertices().len(), exact.edges().len(), exact.planes().len()), (8, 12, 6));
        assert!(exact.planes().iter().all(|(n, d)| (n.abs().dot(&half) - d).abs() < 1e-15));
        assert!((0..6).all(|f| exact.face(f).len() == 4));
        let prism = ConvexPolyhedron::prism(0.03, 0.05, 32);
        check_faces(&prism);
        assert_eq!((prism.vertices().len(), prism.edges().len(), prism.planes().len()), (64, 96, 34));
        let hull = ConvexPolyhedron::from_points(prism.vertices()).unwrap();
        check_faces(&hull);
        assert_eq!((hull.vertices().len(), hull.edges().len(), hull.planes().len()), (64, 96, 34));
    }

    #[test]
    fn a_ball_is_bounded_and_flat_points_are_refused() {
        let ball: Vec<_> = (0..3000)
            .map(|i| {
                let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 3000.0;
                let a = 2.4 * f64::from(i);
                Point3::new((1.0 - z * z).sqrt() * a.cos(), (1.0 - z * z).sqrt() * a.sin(), z)
            })
            .collect();
        let piece = ConvexPolyhedron::from_points(&ball).unwrap();
        assert_eq!(piece.vertices().len(), MAX_VERTICES);
        assert_eq!(piece.vertices().len() + piece.planes().len() - piece.edges().len(), 2, "Euler's formula");
        check_faces(&piece);
        let flat: Vec<_> = ball.iter().map(|p| Point3::new(p.x, p.y, 0.2)).collect();
        assert!(matches!(ConvexPolyhedron::from_points(&flat), Err(Error::FlatPolyhedron { points: 3000 })));
        assert!(ConvexPolyhedron::from_points(&[]).is_err());
    }
}
