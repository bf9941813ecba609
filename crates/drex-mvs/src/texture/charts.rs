//! A mesh cut into charts that lie flat without overlapping.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashSet};

use drex_core::TriMesh;
use nalgebra::{Unit, Vector3};

/// No face, chart or texel.
pub(super) const NONE: u32 = u32::MAX;
/// Faces join a growing chart while their normals are within this of its mean, cosine of 50 degrees.
const JOINS: f64 = 0.643;
/// Faces that lean farther from the chart's axis leave it again: they would be drawn too narrow. Cosine of 65 degrees.
const STAYS: f64 = 0.423;
/// The same for faces of charts too small to be worth a place of their own, cosine of 78 degrees.
const ADOPTED: f64 = 0.208;
/// Charts with fewer texels are given to their neighbours.
const SMALL: usize = 100;
/// Faces of fewer texels that lie flat in no chart beside them are not worth a chart.
const FOLDED: f64 = 16.0;
/// Angles at which the smallest rectangle round a chart is looked for, in a quarter turn.
const TURNS: usize = 24;

/// The charts of a mesh, each the parallel projection of its faces along one axis.
pub(super) struct Charts {
    /// Chart of each face.
    pub of_face: Vec<u32>,
    /// Corners of each face in its chart's plane, texels, x right and y down as seen from outside; a chart begins at 0, 0.
    pub flat: Vec<[[f64; 2]; 3]>,
    /// Width and height of each chart, texels.
    pub sizes: Vec<[f64; 2]>,
}

impl Charts {
    /// Grows charts from the largest faces. Texels are squares with sides of `texel`, the unit of the mesh; no texel's centre lies in two faces
    /// of a chart. Tiny faces that stand across have the colours of an edge at which they touch a chart, and no area in it.
    pub fn new(mesh: &TriMesh, texel: f64) -> Self {
        let mut cutter = Cutter::new(mesh, texel);
        cutter.grow();
        cutter.dissolve_small();
        cutter.adopt();
        cutter.fold();
        cutter.grow();
        cutter.laid_down()
    }
}

/// A mesh while it is being cut.
struct Cutter<'a> {
    mesh: &'a TriMesh,
    texel: f64,
    /// Normals as long as the faces' areas.
    normals: Vec<Vector3<f64>>,
    /// Faces by area, the largest first.
    order: Vec<u32>,
    neighbours: Vec<[u32; 3]>,
    /// Chart of each face, [`NONE`] of those that are free.
    of_face: Vec<u32>,
    /// Corners of faces that have no area in their chart.
    folded: BTreeMap<u32, [[f64; 2]; 3]>,
    charts: Vec<Chart>,
}

/// A chart's plane and what of it is taken.
struct Chart {
    axis: Unit<Vector3<f64>>,
    right: Vector3<f64>,
    down: Vector3<f64>,
    taken: HashSet<[i64; 2]>,
}

impl<'a> Cutter<'a> {
    fn new(mesh: &'a TriMesh, texel: f64) -> Self {
        let normal = |f: usize| {
            let [a, b, c] = mesh.triangle(f);
            0.5 * (b - a).cross(&(c - a))
        };
        let normals: Vec<Vector3<f64>> = (0..mesh.faces.len()).map(normal).collect();
        let mut order: Vec<u32> = (0..mesh.faces.len() as u32).collect();
        order.sort_by(|&a, &b| normals[b as usize].norm().total_cmp(&normals[a as usize].norm()).then(a.cmp(&b)));
        let neighbours = neighbours(&mesh.faces);
        Self {
            mesh,
            texel,
            normals,
            order,
            neighbours,
            of_face: vec![NONE; mesh.faces.len()],
            folded: BTreeMap::new(),
            charts: Vec::new(),
        }
    }

    /// Makes charts of all free faces.
    fn grow(&mut self) {
        for k in 0..self.order.len() {
            let seed = self.order[k];
            if self.of_face[seed as usize] != NONE {
                continue;
            }
            let faces = self.grown(seed);
            let first = self.normals[seed as usize];
            let sum: Vector3<f64> = faces.iter().map(|f| self.normals[*f as usize]).sum();
            let axis = if cosine(&first, &sum) < STAYS { first } else { sum };
            let chart = self.charts.len() as u32;
            self.charts.push(Chart::new(&axis));
            for f in faces {
                let _ = self.takes(chart, f, STAYS);
            }
            // A face without a normal is not sure of its own chart.
            self.of_face[seed as usize] = chart;
        }
    }

    /// Free faces round a seed, in the order in which they join it.
    fn grown(&self, seed: u32) -> Vec<u32> {
        let mut sum = Vector3::zeros();
        let mut faces = Vec::new();
        let mut met = HashSet::from([seed]);
        let mut heap = BinaryHeap::from([(Reverse(0), Reverse(seed))]);
        while let Some((_, Reverse(f))) = heap.pop() {
            let normal = &self.normals[f as usize];
            if cosine(normal, &sum) < JOINS {
                // It may be met again from another side, when the mean has turned.
                met.remove(&f);
                continue;
            }
            sum += normal;
            faces.push(f);
            for &next in &self.neighbours[f as usize] {
                if next != NONE && self.of_face[next as usize] == NONE && met.insert(next) {
                    heap.push((rank(cosine(&self.normals[next as usize], &sum)), Reverse(next)));
                }
            }
        }
        faces
    }

    /// Frees the faces of charts that have few texels.
    fn dissolve_small(&mut self) {
        let small = |chart: &u32| self.charts[*chart as usize].taken.len() < SMALL;
        self.of_face.iter_mut().filter(|chart| small(chart)).for_each(|chart| *chart = NONE);
    }

    /// Gives free faces to charts beside them in which they lie flat, those first that lean least.
    fn adopt(&mut self) {
        let mut heap = BinaryHeap::new();
        let offers = |cutter: &Self, chart: u32, f: u32, heap: &mut BinaryHeap<_>| {
            let axis = cutter.charts[chart as usize].axis;
            for &next in &cutter.neighbours[f as usize] {
                if next != NONE && cutter.of_face[next as usize] == NONE {
                    heap.push((rank(cosine(&cutter.normals[next as usize], &axis)), Reverse(next), Reverse(chart)));
                }
            }
        };
        for f in 0..self.of_face.len() as u32 {
            if self.of_face[f as usize] != NONE {
                offers(self, self.of_face[f as usize], f, &mut heap);
            }
        }
        while let Some((_, Reverse(f), Reverse(chart))) = heap.pop() {
            if self.of_face[f as usize] == NONE && self.takes(chart, f, ADOPTED) {
                offers(self, chart, f, &mut heap);
            }
        }
    }

    /// Folds tiny free faces onto an edge that they share with a face of a chart: the corner across goes to its middle.
    fn fold(&mut self) {
        let tiny = |cutter: &Self, f: usize| cutter.normals[f].norm() < FOLDED * cutter.texel * cutter.texel;
        let mut free: Vec<usize> =
            (0..self.of_face.len()).filter(|&f| self.of_face[f] == NONE && tiny(self, f)).collect();
        loop {
            let before = free.len();
            free.retain(|&f| {
                let beside = self.neighbours[f].map(|g| (g, self.of_face.get(g as usize).copied().unwrap_or(NONE)));
                let Some(edge) = beside.iter().position(|(_, chart)| *chart != NONE) else { return true };
                let (g, chart) = beside[edge];
                let there = self.flat(g);
                let place = |k: usize| {
                    let v = self.mesh.faces[f][k % 3];
                    self.mesh.faces[g as usize].iter().position(|c| *c == v).map(|k| there[k])
                };
                let (Some(a), Some(b)) = (place(edge), place(edge + 1)) else { return true };
                let mut corners = [[0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])]; 3];
                (corners[edge], corners[(edge + 1) % 3]) = (a, b);
                self.folded.insert(f as u32, corners);
                self.of_face[f] = chart;
                false
            });
            if free.len() == before {
                return;
            }
        }
    }

    /// Corners of a face in the plane of its chart, texels.
    fn flat(&self, f: u32) -> [[f64; 2]; 3] {
        let chart = || self.charts[self.of_face[f as usize] as usize].flat(self.mesh, f, self.texel);
        self.folded.get(&f).copied().unwrap_or_else(chart)
    }

    /// Puts a face into a chart, unless it leans too far there or lies on what the chart has.
    fn takes(&mut self, chart: u32, f: u32, least_cosine: f64) -> bool {
        let plane = &mut self.charts[chart as usize];
        if cosine(&self.normals[f as usize], &plane.axis) < least_cosine {
            return false;
        }
        let corners = plane.flat(self.mesh, f, self.texel);
        let lo = [0, 1].map(|k| corners.iter().map(|c| c[k]).fold(f64::INFINITY, f64::min).floor());
        let near = corners.map(|c| [c[0] - lo[0], c[1] - lo[1]]);
        // Rims belong to both sides.
        let own: Vec<[i64; 2]> = covered(&near, [usize::MAX; 2])
            .filter(|(_, _, weights)| weights.iter().all(|w| *w > 1e-6))
            .map(|(x, y, _)| [x as i64 + lo[0] as i64, y as i64 + lo[1] as i64])
            .collect();
        let free = own.iter().all(|at| !plane.taken.contains(at));
        if free {
            plane.taken.extend(own);
            self.of_face[f as usize] = chart;
        }
        free
    }

    /// The charts that have faces, each in its smallest rectangle.
    fn laid_down(self) -> Charts {
        let mut faces: Vec<Vec<u32>> = vec![Vec::new(); self.charts.len()];
        self.of_face.iter().zip(0..).for_each(|(chart, f)| faces[*chart as usize].push(f));
        let count = self.of_face.len();
        let mut out = Charts { of_face: vec![NONE; count], flat: vec![[[0.0; 2]; 3]; count], sizes: Vec::new() };
        for faces in faces.iter().filter(|faces| !faces.is_empty()) {
            let mut flat: Vec<_> = faces.iter().map(|f| self.flat(*f)).collect();
            let size = lay_down(&mut flat);
            for (f, corners) in faces.iter().zip(flat) {
                (out.of_face[*f as usize], out.flat[*f as usize]) = (out.sizes.len() as u32, corners);
            }
            out.sizes.push(size);
        }
        out
    }
}

impl Chart {
    fn new(axis: &Vector3<f64>) -> Self {
        let axis = Unit::try_new(*axis, 0.0).unwrap_or(Vector3::z_axis());
        let right = axis.cross(&Vector3::ith(axis.iamin(), 1.0)).normalize();
        Self { axis, right, down: right.cross(&axis), taken: HashSet::new() }
    }

    /// Corners of a face in the chart's plane, texels.
    fn flat(&self, mesh: &TriMesh, f: u32, texel: f64) -> [[f64; 2]; 3] {
        mesh.triangle(f as usize).map(|p| [p.coords.dot(&self.right) / texel, p.coords.dot(&self.down) / texel])
    }
}

/// Cosine between two vectors; 1 if one of them is zero, for a face without area fits everywhere.
fn cosine(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    let lengths = a.norm() * b.norm();
    if lengths > 0.0 { a.dot(b) / lengths } else { 1.0 }
}

/// Order in which faces are looked at: small angles first.
fn rank(cosine: f64) -> Reverse<u64> {
    Reverse(((1.0 - cosine).max(0.0) * 1e6) as u64)
}

/// Turns and moves a chart so that its rectangle is small, lies on its longer side and begins at 0, 0; the size of that.
fn lay_down(flat: &mut [[[f64; 2]; 3]]) -> [f64; 2] {
    let turned = |angle: f64, [x, y]: [f64; 2]| {
        let (sin, cos) = angle.sin_cos();
        [cos * x - sin * y, sin * x + cos * y]
    };
    let bounds = |angle: f64| {
        let (mut lo, mut hi) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in flat.iter().flatten().map(|p| turned(angle, *p)) {
            (0..2).for_each(|k| (lo[k], hi[k]) = (lo[k].min(p[k]), hi[k].max(p[k])));
        }
        (lo, [hi[0] - lo[0], hi[1] - lo[1]])
    };
    let angle = |k: usize| k as f64 * std::f64::consts::FRAC_PI_2 / TURNS as f64;
    let area = |k: &usize| bounds(angle(*k)).1.iter().product::<f64>();
    let best = (0..TURNS).min_by(|a, b| area(a).total_cmp(&area(b))).unwrap_or(0);
    let (_, size) = bounds(angle(best));
    let best = angle(best) + if size[0] < size[1] { std::f64::consts::FRAC_PI_2 } else { 0.0 };
    let (lo, size) = bounds(best);
    for p in flat.iter_mut().flatten() {
        let [x, y] = turned(best, *p);
        *p = [x - lo[0], y - lo[1]];
    }
    size
}

/// Texels of a picture of `size` whose centres a triangle covers, rims included, with the weights of its corners; none if it has no area.
pub(super) fn covered(
    corners: &[[f64; 2]; 3],
    size: [usize; 2],
) -> impl Iterator<Item = (usize, usize, [f64; 3])> + use<> {
    let corners = *corners;
    let range = |axis: usize| {
        let (lo, hi) =
            corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p[axis]), h.max(p[axis])));
        // A float outside the range of the integer becomes its nearest value.
        ((lo - 0.5).ceil().max(0.0) as usize)..(((hi - 0.5).floor() + 1.0).max(0.0) as usize).min(size[axis])
    };
    let side = |p: [f64; 2], q: [f64; 2], x: [f64; 2]| (q[0] - p[0]) * (x[1] - p[1]) - (q[1] - p[1]) * (x[0] - p[0]);
    let [a, b, c] = corners;
    let area = side(a, b, c);
    let columns = range(0);
    range(1).flat_map(move |y| columns.clone().map(move |x| (x, y))).filter_map(move |(x, y)| {
        let p = [x as f64 + 0.5, y as f64 + 0.5];
        let weights = [side(b, c, p), side(c, a, p), side(a, b, p)].map(|w| w / area);
        weights.iter().all(|w| *w >= -1e-9).then_some((x, y, weights))
    })
}

/// The faces across the edges of each face: first to second corner, second to third, third to first; [`NONE`] at openings.
pub(super) fn neighbours(faces: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let mut edges: Vec<(u32, u32, u32, u8)> = Vec::with_capacity(3 * faces.len());
    for (f, face) in faces.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (face[k], face[(k + 1) % 3]);
            edges.push((a.min(b), a.max(b), f as u32, k as u8));
        }
    }
    edges.sort_unstable();
    let mut out = vec![[NONE; 3]; faces.len()];
    // Where more than two faces meet, two of them go together and the others are rims.
    let mut rest = &edges[..];
    while let [first, tail @ ..] = rest {
        rest = tail;
        if let [second, after @ ..] = tail
            && (first.0, first.1) == (second.0, second.1)
        {
            out[first.2 as usize][usize::from(first.3)] = second.2;
            out[second.2 as usize][usize::from(second.3)] = first.2;
            rest = after;
        }
    }
    out
}
