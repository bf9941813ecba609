//! Marching cubes whose result is a closed 2-manifold for any labels of the grid.
//!
//! Lorensen and Cline 1987, with three rules instead of their table. A face of a cube with two diagonal inside corners is
//! always resolved by keeping the inside corners apart, which both cubes at the face see alike: so every segment on a face
//! belongs to exactly two polygons. Every cut edge of a cube is in exactly one of its polygons: so the surface around a
//! vertex is one disk. And no diagonal of a polygon lies in a face of its cube, where it could meet another one: a polygon
//! that cannot be divided so gets a vertex in its middle. Vertices are shared by construction, nothing is welded.

use std::sync::LazyLock;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use drex_core::TriMesh;

use super::lattice::{Field, SIDE};

/// How close to a grid point a vertex may come, in voxels: vertices of different edges must not coincide.
const CLEARANCE: f32 = 0.02;
/// Samples along a side of a block with those of the next one.
const REACH: usize = SIDE + 1;

/// A mesh and, per vertex, the grid edge it was found on.
#[derive(Debug, Default)]
pub(crate) struct Extracted {
    pub mesh: TriMesh,
    pub edges: Vec<GridEdge>,
}

/// The edge from a voxel to the next one along an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct GridEdge {
    pub voxel: [u32; 3],
    pub axis: u8,
}

impl GridEdge {
    /// The voxel at the other end.
    pub fn far(&self) -> [u32; 3] {
        let mut voxel = self.voxel;
        voxel[self.axis as usize] += 1;
        voxel
    }
}

/// The surface between the negative (inside) and the other samples of the field.
///
/// The outermost samples must not be negative, or the surface is open there.
pub(crate) fn extract(field: &Field) -> Extracted {
    let blocks: Vec<usize> = (0..field.lattice.count()).filter(|&b| field.may_have_surface(b)).collect();
    let cut: Vec<Cut> = blocks.par_iter().map(|&b| Cut::new(field, b)).collect();
    // Vertices of a block follow those of the blocks before it: first those on its edges, then those inside its cells.
    let mut place = vec![(u32::MAX, 0u32); field.lattice.count()];
    let mut next = 0;
    for (i, (&b, cut)) in blocks.iter().zip(&cut).enumerate() {
        place[b] = (i as u32, next);
        next += (cut.keys.len() + cut.middles.len()) as u32;
    }
    let faces: Vec<Vec<[u32; 3]>> =
        blocks.par_iter().zip(&cut).map(|(&b, own)| polygons(field, b, own, &cut, &place)).collect();
    let mut out = Extracted::default();
    out.mesh.faces = faces.concat();
    for (&b, cut) in blocks.iter().zip(cut) {
        let base = field.lattice.first_voxel(b);
        let edge = |key: u16| {
            let at = local(usize::from(key) / 3);
            GridEdge { voxel: [0, 1, 2].map(|k| (base[k] + at[k]) as u32), axis: (key % 3) as u8 }
        };
        out.edges.extend(cut.keys.iter().chain(cut.middles.iter().map(|m| &m.key)).map(|&key| edge(key)));
        out.mesh.vertices.extend(cut.points);
        out.mesh.vertices.extend(cut.middles.iter().map(|m| m.point));
    }
    out
}

/// The vertices that a block owns.
struct Cut {
    /// Cut edges: 3 times the local voxel at their lower end plus the axis, ascending.
    keys: Vec<u16>,
    points: Vec<Point3<f64>>,
    /// Vertices in the middle of polygons, by cell and polygon.
    middles: Vec<Middle>,
}

/// A vertex inside a cell.
struct Middle {
    /// One of the cut edges of the polygon, named like an edge of the block.
    key: u16,
    point: Point3<f64>,
}

impl Cut {
    fn new(field: &Field, block: usize) -> Self {
        let samples = Samples::new(field, block);
        let mut cut = Self { keys: Vec::new(), points: Vec::new(), middles: Vec::new() };
        for at in samples.mixed_rows() {
            let v = (at[2] * SIDE + at[1]) * SIDE;
            for x in 0..SIDE {
                for axis in 0..3 {
                    if let Some(p) = samples.crossing([x, at[1], at[2]], axis) {
                        cut.keys.push((3 * (v + x) + axis) as u16);
                        cut.points.push(field.lattice.point(block, p));
                    }
                }
                let at = [x, at[1], at[2]];
                for polygon in CASES[samples.case(at)].polygons.iter().filter(|p| p.middle) {
                    let sum: Vector3<f64> = polygon.edges.iter().filter_map(|&e| samples.on_edge(at, e)).sum();
                    let point = field.lattice.point(block, sum / polygon.edges.len() as f64);
                    cut.middles.push(Middle { key: 3 * (v + x) as u16, point });
                }
            }
        }
        cut
    }
}

/// Triangles of the cells whose lowest corner is in the block.
fn polygons(field: &Field, block: usize, own: &Cut, cuts: &[Cut], place: &[(u32, u32)]) -> Vec<[u32; 3]> {
    let samples = Samples::new(field, block);
    let mut faces = Vec::new();
    let mut middle = place[block].1 + own.keys.len() as u32;
    for at in samples.mixed_rows() {
        for x in 0..SIDE {
            let at = [x, at[1], at[2]];
            for polygon in &CASES[samples.case(at)].polygons {
                let mut vertices = [0; 12];
                for (vertex, &edge) in vertices.iter_mut().zip(&polygon.edges) {
                    let (corner, axis) = EDGES[edge as usize];
                    let (owner, voxel) = field.lattice.neighbour(block, offset(at, corner));
                    let (slot, first) = place[owner];
                    // Both ends of the edge are samples of this cell, so its owner has found the crossing too.
                    *vertex = first + cuts[slot as usize].rank((3 * voxel + axis) as u16);
                }
                if polygon.middle {
                    let n = polygon.edges.len();
                    faces.extend((0..n).map(|i| [vertices[i], vertices[(i + 1) % n], middle]));
                    middle += 1;
                } else {
                    faces.extend(polygon.triangles.iter().map(|t| t.map(|i| vertices[i as usize])));
                }
            }
        }
    }
    faces
}

impl Cut {
    /// Place of an edge among the cut ones.
    fn rank(&self, key: u16) -> u32 {
        self.keys.partition_point(|&k| k < key) as u32
    }
}

/// Samples of a block and of the first layers of the blocks after it.
struct Samples {
    values: [f32; REACH * REACH * REACH],
    /// Which samples of each row along x are inside, as bits.
    inside: [u16; REACH * REACH],
}

impl Samples {
    fn new(field: &Field, block: usize) -> Self {
        let mut samples = Self { values: [0.0; REACH * REACH * REACH], inside: [0; REACH * REACH] };
        for (i, (row, inside)) in samples.values.chunks_exact_mut(REACH).zip(&mut samples.inside).enumerate() {
            field.row_near(block, [i % REACH, i / REACH], row);
            *inside = row.iter().rev().fold(0, |bits, &v| bits << 1 | u16::from(v < 0.0));
        }
        samples
    }

    /// The first cells of the rows of cells that have corners inside and outside.
    fn mixed_rows(&self) -> impl Iterator<Item = [usize; 3]> {
        const ALL: u16 = (1 << REACH) - 1;
        (0..SIDE * SIDE).map(|i| [0, i % SIDE, i / SIDE]).filter(|&[_, y, z]| {
            let rows = self.rows(y, z);
            rows != [0; 4] && rows != [ALL; 4]
        })
    }

    /// The rows at the four lengthwise edges of a row of cells.
    fn rows(&self, y: usize, z: usize) -> [u16; 4] {
        let row = z * REACH + y;
        [row, row + 1, row + REACH, row + REACH + 1].map(|i| self.inside[i])
    }

    fn value(&self, at: [usize; 3]) -> f32 {
        self.values[(at[2] * REACH + at[1]) * REACH + at[0]]
    }

    /// Which corners of a cell are inside, corner by corner as bits.
    fn case(&self, at: [usize; 3]) -> usize {
        let [a, b, c, d] = self.rows(at[1], at[2]).map(|row| usize::from(row >> at[0] & 3));
        a | b << 2 | c << 4 | d << 6
    }

    /// Where the surface cuts the edge from a sample along an axis, in voxels from the block's first one.
    fn crossing(&self, at: [usize; 3], axis: usize) -> Option<Vector3<f64>> {
        let (a, b) = (self.value(at), self.value(offset(at, 1 << axis)));
        ((a < 0.0) != (b < 0.0)).then(|| {
            let t = (a / (a - b)).clamp(CLEARANCE, 1.0 - CLEARANCE);
            let mut p = Vector3::from(at.map(|x| x as f64));
            p[axis] += f64::from(t);
            p
        })
    }

    fn on_edge(&self, at: [usize; 3], edge: u8) -> Option<Vector3<f64>> {
        let (corner, axis) = EDGES[edge as usize];
        self.crossing(offset(at, corner), axis)
    }
}

/// Coordinates of voxel `v` of a block.
fn local(v: usize) -> [usize; 3] {
    [v % SIDE, v / SIDE % SIDE, v / (SIDE * SIDE)]
}

/// The sample at corner `c` of the cell at `at`.
fn offset(at: [usize; 3], c: usize) -> [usize; 3] {
    [at[0] + (c & 1), at[1] + (c >> 1 & 1), at[2] + (c >> 2 & 1)]
}

/// The edges of a cube: lower corner (x + 2 y + 4 z) and axis.
const EDGES: [(usize, usize); 12] =
    [(0, 0), (2, 0), (4, 0), (6, 0), (0, 1), (1, 1), (4, 1), (5, 1), (0, 2), (1, 2), (2, 2), (3, 2)]; // x edges, y edges, z edges

/// The polygons of one of the 256 cases.
struct Case {
    polygons: Vec<Polygon>,
}

struct Polygon {
    /// Cut edges in order, counter-clockwise seen from outside.
    edges: Vec<u8>,
    /// Triangles as positions in `edges`; none if the polygon has a vertex in its middle.
    triangles: Vec<[u8; 3]>,
    middle: bool,
}

static CASES: LazyLock<Vec<Case>> = LazyLock::new(|| (0..256).map(case_of).collect());

/// The edge between two corners of a cube.
fn edge_between(a: usize, b: usize) -> u8 {
    let (low, axis) = (a.min(b), (a ^ b).trailing_zeros() as usize);
    // Every pair of corners that is asked for is an edge, so it is in the list.
    EDGES.iter().position(|&e| e == (low, axis)).unwrap_or(0) as u8
}

/// Corners of a face, counter-clockwise seen from outside the cube.
fn face_corners(axis: usize, upper: bool) -> [usize; 4] {
    let (b, c) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
    let base = usize::from(upper) << axis;
    if upper { [base, base + b, base + b + c, base + c] } else { [base, base + c, base + b + c, base + b] }
}

fn case_of(bits: usize) -> Case {
    let inside = |corner: usize| bits >> corner & 1 == 1;
    // On each face, every run of inside corners is cut off by one segment, from where the walk around the face leaves the
    // run to where it entered it: with the inside on its right seen from outside the cube.
    let mut next = [u8::MAX; 12];
    for (axis, upper) in [0, 1, 2].into_iter().flat_map(|a| [(a, false), (a, true)]) {
        let corners = face_corners(axis, upper);
        for k in 0..4 {
            if inside(corners[k]) || !inside(corners[(k + 1) % 4]) {
                continue;
            }
            let entered = edge_between(corners[k], corners[(k + 1) % 4]);
            let mut last = (k + 1) % 4;
            while inside(corners[(last + 1) % 4]) {
                last = (last + 1) % 4;
            }
            let left = edge_between(corners[last], corners[(last + 1) % 4]);
            next[entered as usize] = left;
        }
    }
    let mut polygons = Vec::new();
    let mut used = [false; 12];
    for start in 0..12u8 {
        let mut edges = Vec::new();
        let mut edge = start;
        while next[edge as usize] != u8::MAX && !used[edge as usize] {
            used[edge as usize] = true;
            edges.push(edge);
            edge = next[edge as usize];
        }
        if !edges.is_empty() {
            let corners: Vec<u8> = (0..edges.len() as u8).collect();
            let triangles = divide(&edges, &corners);
            polygons.push(Polygon { middle: triangles.is_none(), triangles: triangles.unwrap_or_default(), edges });
        }
    }
    Case { polygons }
}

/// Triangles of the polygon with these corners (positions in `edges`) without a diagonal in a face of the cube.
fn divide(edges: &[u8], corners: &[u8]) -> Option<Vec<[u8; 3]>> {
    let n = corners.len();
    if n < 3 {
        return Some(Vec::new());
    }
    // The triangle at the side from the first to the last corner has its tip at one of the others.
    let allowed =
        |i: usize, j: usize| j == i + 1 || !share_face(edges[corners[i] as usize], edges[corners[j] as usize]);
    (1..n - 1).filter(|&tip| allowed(0, tip) && allowed(tip, n - 1)).find_map(|tip| {
        let mut triangles = divide(edges, &corners[..=tip])?;
        triangles.extend(divide(edges, &corners[tip..])?);
        triangles.push([corners[0], corners[tip], corners[n - 1]]);
        Some(triangles)
    })
}

/// Whether two edges of a cube lie in one of its faces.
fn share_face(a: u8, b: u8) -> bool {
    let on = |(corner, axis): (usize, usize), face: usize, side: usize| axis != face && corner >> face & 1 == side;
    (0..6).any(|f| on(EDGES[a as usize], f / 2, f % 2) && on(EDGES[b as usize], f / 2, f % 2))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;
    use crate::fusion::lattice::{FieldBlock, Lattice};

    fn field(blocks: [usize; 3], value: impl Fn([usize; 3]) -> f32) -> Field {
        let lattice = Lattice { origin: Point3::origin(), spacing: 1.0, blocks };
        let blocks = (0..lattice.count())
            .map(|b| {
                let first = lattice.first_voxel(b);
                let at = |v| [0, 1, 2].map(|k| first[k] + local(v)[k]);
                FieldBlock::Samples(Box::new(std::array::from_fn(|v| value(at(v)))))
            })
            .collect();
        Field { lattice, blocks }
    }

    /// Every edge has two faces that run along it in opposite directions, and the faces around every vertex are one disk.
    fn is_closed_manifold(mesh: &TriMesh) -> bool {
        let mut after: BTreeMap<(u32, u32), u32> = BTreeMap::new();
        let mut fan = vec![0; mesh.vertices.len()];
        for &[a, b, c] in &mesh.faces {
            for [p, q, r] in [[a, b, c], [b, c, a], [c, a, b]] {
                fan[p as usize] += 1;
                if p == q || after.insert((p, q), r).is_some() {
                    return false;
                }
            }
        }
        after.keys().all(|&(a, b)| after.contains_key(&(b, a)))
            && (0..mesh.vertices.len() as u32).all(|v| {
                let Some((&(_, first), _)) = after.range((v, 0)..=(v, u32::MAX)).next() else { return false };
                let mut next = first;
                for turn in 1.. {
                    // The triangle (v, next, third) is followed around v by the one that begins with (v, third).
                    next = after[&(v, next)];
                    if next == first {
                        return turn == fan[v as usize];
                    }
                }
                false
            })
    }

    fn volume(mesh: &TriMesh) -> f64 {
        (0..mesh.faces.len())
            .map(|f| {
                let [a, b, c] = mesh.triangle(f).map(|p| p.coords);
                a.dot(&b.cross(&c)) / 6.0
            })
            .sum()
    }

    #[test]
    fn each_of_the_256_cases_alone_is_closed() {
        for bits in 0..256usize {
            let value = |at: [usize; 3]| {
                let c: [usize; 3] = at.map(|x| x.wrapping_sub(7));
                let corner = c[0] | c[1] << 1 | c[2] << 2;
                if c.iter().all(|&x| x < 2) && bits >> corner & 1 == 1 { -1.0 } else { 1.0 }
            };
            let mesh = extract(&field([2; 3], value)).mesh;
            assert!(is_closed_manifold(&mesh), "{bits}");
            // One octahedron of half-diagonal 1/2 per corner alone; more where corners are joined.
            assert!(volume(&mesh) > bits.count_ones() as f64 / 6.0 - 1e-9, "{bits}");
        }
    }

    #[test]
    fn a_sphere_across_blocks_has_its_volume() {
        let r = |at: [usize; 3]| (Vector3::from(at.map(|x| x as f64)) - Vector3::new(11.7, 12.1, 11.9)).norm();
        let mesh = extract(&field([3; 3], |at| (r(at) - 9.0) as f32)).mesh;
        assert!(is_closed_manifold(&mesh));
        let ball = 4.0 / 3.0 * std::f64::consts::PI * 9.0_f64.powi(3);
        assert!((volume(&mesh) / ball - 1.0).abs() < 0.01);
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn random_samples_give_a_closed_manifold(seed: u64, share in 1u64..99, blocks in prop::array::uniform3(1usize..3)) {
            let inside = |at: [usize; 3]| (0..3).all(|k| at[k] > 0 && at[k] + 1 < blocks[k] * SIDE);
            let random = |at: [usize; 3]| {
                let mut x = seed ^ (at[0] + 64 * at[1] + 4096 * at[2]) as u64;
                for _ in 0..3 {
                    x = (x ^ x >> 31).wrapping_mul(0x9e37_79b9_7f4a_7c15);
                }
                x >> 33
            };
            let value = |at| {
                let size = (random(at) / 100 % 1000) as f32 / 1000.0;
                if inside(at) && random(at) % 100 < share { -0.001 - size } else { size }
            };
            let out = extract(&field(blocks, value));
            prop_assert!(is_closed_manifold(&out.mesh));
            prop_assert_eq!(out.edges.len(), out.mesh.vertices.len());
            prop_assert!(out.mesh.faces.is_empty() || volume(&out.mesh) > 0.0);
        }
    }
}
