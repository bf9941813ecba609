//! Edge collapses that keep a mesh what it is: the same genus, no flipped faces, no needles.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use nalgebra::{Point3, Vector3};

use drex_core::TriMesh;

use super::quadric::Quadric;
use super::track::Tracker;
use crate::topology::{NONE, edges, ends};

/// A rim moves this much less readily than the surface beside it.
const RIM_WEIGHT: f64 = 10.0;
/// A face may turn by at most the angle with this cosine in one collapse.
const LEAST_COSINE: f64 = 0.2;
/// Faces rounder than this are no needles (1 is equilateral, see [`roundness`]).
const NEEDLE: f64 = 0.15;

/// A mesh that is being simplified, moved so that its middle is the origin.
pub(super) struct Collapser {
    pub vertices: Vec<Point3<f64>>,
    /// Dead faces are [`DEAD`].
    pub faces: Vec<[u32; 3]>,
    pub alive: usize,
    quadrics: Vec<Quadric>,
    /// First corner (3 face + k) of each vertex and the corner after each corner; may lead through dead faces.
    first: Vec<u32>,
    next: Vec<u32>,
    /// How often each vertex has been merged; entries of the heap that are older are void.
    version: Vec<u32>,
    /// On the rim of an opening.
    rim: Vec<bool>,
    /// Where more than two faces meet at an edge, or several fans at a vertex: stays where it is.
    fixed: Vec<bool>,
    heap: BinaryHeap<Entry>,
    /// Noise of the normals, see [`Quadric`].
    noise: f64,
}

const DEAD: [u32; 3] = [NONE; 3];

struct Entry {
    cost: f64,
    edge: [u32; 2],
    stamp: u32,
}

impl Ord for Entry {
    /// The cheapest edge is the greatest entry; the numbers of its ends break ties.
    fn cmp(&self, o: &Self) -> Ordering {
        o.cost.total_cmp(&self.cost).then(o.edge.cmp(&self.edge)).then(o.stamp.cmp(&self.stamp))
    }
}

impl PartialOrd for Entry {
    fn partial_cmp(&self, o: &Self) -> Option<Ordering> {
        Some(self.cmp(o))
    }
}

impl PartialEq for Entry {
    fn eq(&self, o: &Self) -> bool {
        self.cmp(o) == Ordering::Equal
    }
}

impl Eq for Entry {}

/// Lists that every collapse needs, kept to spare allocations.
#[derive(Default)]
struct Scratch {
    a: Vec<u32>,
    b: Vec<u32>,
    shared: Vec<u32>,
    survivors: Vec<u32>,
    around: Vec<u32>,
    spokes: Vec<[u32; 2]>,
    triangles: Vec<[Point3<f64>; 3]>,
}

impl Collapser {
    /// Prepares a checked mesh; `noise` is the σ of [`Quadric::at`].
    pub fn new(mesh: TriMesh, noise: f64) -> Self {
        let n = mesh.vertices.len();
        let mut quadrics = vec![Quadric::zero(); n];
        for f in 0..mesh.faces.len() {
            let [a, b, c] = mesh.triangle(f);
            let double_area = (b - a).cross(&(c - a));
            let Some(normal) = double_area.try_normalize(0.0) else { continue };
            let middle = (a.coords + b.coords + c.coords) / 3.0;
            let q = Quadric::plane(&normal, &middle, double_area.norm() / 2.0);
            mesh.faces[f].iter().for_each(|&v| quadrics[v as usize] = quadrics[v as usize].plus(&q));
        }
        let (mut rim, mut fixed) = (vec![false; n], vec![false; n]);
        for group in edges(&mesh).chunk_by(|e, f| e.0 == f.0) {
            let (a, b) = ends(&mesh, group[0].1);
            match group {
                [(_, h)] => {
                    let (p, q) = (mesh.vertices[a as usize], mesh.vertices[b as usize]);
                    let [r, s, t] = mesh.triangle(*h as usize / 3);
                    let wall = (q - p).cross(&(s - r).cross(&(t - r)));
                    let wall = wall.try_normalize(0.0).unwrap_or_default();
                    let weight = RIM_WEIGHT * (q - p).norm_squared();
                    let quadric = Quadric::plane(&wall, &nalgebra::center(&p, &q).coords, weight);
                    for v in [a, b] {
                        rim[v as usize] = true;
                        quadrics[v as usize] = quadrics[v as usize].plus(&quadric);
                    }
                }
                [(_, g), (_, h)] if ends(&mesh, *g).0 != ends(&mesh, *h).0 => {}
                _ => [a, b].iter().for_each(|&v| fixed[v as usize] = true),
            }
        }
        let (mut first, mut next) = (vec![NONE; n], vec![NONE; 3 * mesh.faces.len()]);
        for (c, &v) in mesh.faces.iter().flatten().enumerate() {
            next[c] = std::mem::replace(&mut first[v as usize], c as u32);
        }
        let alive = mesh.faces.len();
        let mut out = Self {
            vertices: mesh.vertices,
            faces: mesh.faces,
            alive,
            quadrics,
            first,
            next,
            version: vec![0; n],
            rim,
            fixed,
            heap: BinaryHeap::new(),
            noise,
        };
        out.fix_pinched();
        out
    }

    /// Fixes vertices at which the faces form more than one fan.
    fn fix_pinched(&mut self) {
        let mut star = Vec::new();
        for v in 0..self.vertices.len() as u32 {
            self.star(v, &mut star);
            // Faces of one fan follow each other over spokes: the head of each far edge is the tail of the next one.
            let mut spokes: Vec<[u32; 2]> = star.iter().map(|&c| self.far_edge(c)).collect();
            spokes.sort_unstable();
            let mut heads: Vec<u32> = spokes.iter().map(|s| s[1]).collect();
            heads.sort_unstable();
            let start = spokes.iter().find(|s| heads.binary_search(&s[0]).is_err()).or(spokes.first());
            let mut reached = 0;
            let mut at = start.copied();
            while let Some([_, head]) = at.filter(|_| reached < spokes.len()) {
                reached += 1;
                let next = spokes.partition_point(|s| s[0] < head);
                at = spokes.get(next).copied().filter(|s| s[0] == head && Some(s) != start);
            }
            self.fixed[v as usize] |= reached < spokes.len();
        }
    }

    /// Collapses the cheapest edges while more than `target` faces are left and `tracker` allows it.
    pub fn run(&mut self, target: usize, mut tracker: Option<&mut Tracker<'_>>) {
        let mut scratch = Scratch::default();
        loop {
            let before = self.alive;
            self.seed();
            while self.alive > target {
                let Some(entry) = self.heap.pop() else { break };
                let [a, b] = entry.edge;
                let live = self.first[a as usize] != NONE && self.first[b as usize] != NONE;
                if live && self.stamp(a, b) == entry.stamp {
                    self.collapse(a, b, tracker.as_deref_mut(), &mut scratch);
                }
            }
            // An edge that was refused may have become free when its surroundings changed. With a tracker a test is dear, and
            // the last percent is not worth another round.
            let least = if tracker.is_some() { before / 100 } else { 0 };
            if self.alive <= target || before - self.alive <= least {
                return;
            }
        }
    }

    /// The mesh as it is now; unused vertices stay in it.
    pub fn mesh(self) -> TriMesh {
        TriMesh { vertices: self.vertices, faces: self.faces.into_iter().filter(|f| *f != DEAD).collect() }
    }

    fn seed(&mut self) {
        let mut list = Vec::with_capacity(self.alive * 3 / 2);
        for f in &self.faces {
            for k in 0..3 {
                let (a, b) = (f[k], f[(k + 1) % 3]);
                // An inner edge is met from both sides, a rim edge from one.
                if *f != DEAD && (a < b || (self.rim[a as usize] && self.rim[b as usize])) {
                    list.push([a.min(b), a.max(b)]);
                }
            }
        }
        list.sort_unstable();
        list.dedup();
        let entries: Vec<Entry> = list.into_iter().map(|[a, b]| self.entry(a, b)).collect();
        self.heap = BinaryHeap::from(entries);
    }

    fn stamp(&self, a: u32, b: u32) -> u32 {
        // Versions only grow, so an equal sum means that neither has changed.
        self.version[a as usize].wrapping_add(self.version[b as usize])
    }

    fn entry(&self, a: u32, b: u32) -> Entry {
        let (_, cost) = self.place(a, b);
        Entry { cost, edge: [a.min(b), a.max(b)], stamp: self.stamp(a, b) }
    }

    /// Where the merged vertex belongs, and the error there.
    fn place(&self, a: u32, b: u32) -> (Point3<f64>, f64) {
        let q = self.quadrics[a as usize].plus(&self.quadrics[b as usize]);
        let (p, r) = (self.vertices[a as usize], self.vertices[b as usize]);
        let x = match (self.fixed[a as usize], self.fixed[b as usize]) {
            (true, _) => p,
            (_, true) => r,
            // Nearly parallel rims and rounding could send it far away: the flip test would refuse it, the middle is safe.
            _ => q.minimum().unwrap_or_else(|| nalgebra::center(&p, &r)),
        };
        (x, q.at(&x.coords, self.noise))
    }

    /// Corners of the living faces around `v`; forgets the dead ones.
    fn star(&mut self, v: u32, out: &mut Vec<u32>) {
        out.clear();
        let mut c = self.first[v as usize];
        while c != NONE {
            if self.faces[c as usize / 3] != DEAD {
                out.push(c);
            }
            c = self.next[c as usize];
        }
        self.link(v, out);
    }

    fn link(&mut self, v: u32, corners: &[u32]) {
        self.first[v as usize] = corners.first().copied().unwrap_or(NONE);
        for (i, &c) in corners.iter().enumerate() {
            self.next[c as usize] = corners.get(i + 1).copied().unwrap_or(NONE);
        }
    }

    /// The edge opposite a corner.
    fn far_edge(&self, corner: u32) -> [u32; 2] {
        let f = self.faces[corner as usize / 3];
        let k = corner as usize % 3;
        [f[(k + 1) % 3], f[(k + 2) % 3]]
    }

    /// Merges b into a, if that does no harm.
    fn collapse(&mut self, a: u32, b: u32, mut tracker: Option<&mut Tracker<'_>>, s: &mut Scratch) {
        self.star(a, &mut s.a);
        self.star(b, &mut s.b);
        if !self.topology_stays(a, b, s) {
            return;
        }
        let (best, _) = self.place(a, b);
        // Where the best place does harm, one of the ends may not.
        let ends = [best, self.vertices[a as usize], self.vertices[b as usize]];
        let fixed = self.fixed[a as usize] || self.fixed[b as usize];
        let Some(x) = ends.into_iter().take(if fixed { 1 } else { 3 }).find(|x| {
            self.shape_stays(x, s)
                && tracker.as_deref_mut().is_none_or(|tracker| {
                    tracker.moved(s.shared.iter().chain(&s.survivors).map(|c| c / 3), &s.survivors, &s.triangles, x)
                })
        }) else {
            return;
        };
        self.quadrics[a as usize] = self.quadrics[a as usize].plus(&self.quadrics[b as usize]);
        self.vertices[a as usize] = x;
        self.rim[a as usize] |= self.rim[b as usize];
        self.fixed[a as usize] |= self.fixed[b as usize];
        for &c in &s.shared {
            self.faces[c as usize / 3] = DEAD;
            self.alive -= 1;
        }
        for &c in &s.survivors {
            self.faces[c as usize / 3][c as usize % 3] = a;
        }
        self.link(a, &s.survivors);
        self.first[b as usize] = NONE;
        self.version[a as usize] += 1;
        s.around.clear();
        s.around.extend(s.survivors.iter().flat_map(|&c| self.far_edge(c)));
        s.around.sort_unstable();
        s.around.dedup();
        for &v in &s.around {
            let entry = self.entry(a, v);
            self.heap.push(entry);
        }
    }

    /// The link condition (Dey et al., "Topology Preserving Edge Contraction", 1999): the ends have no common neighbours
    /// but the far corners of the faces at the edge, and no two faces become one. Fills `shared` and `survivors`.
    fn topology_stays(&self, a: u32, b: u32, s: &mut Scratch) -> bool {
        let has = |c: u32, v: u32| self.faces[c as usize / 3].contains(&v);
        s.shared.clear();
        s.shared.extend(s.a.iter().copied().filter(|&c| has(c, b)));
        s.survivors.clear();
        s.survivors.extend(s.a.iter().copied().filter(|&c| !has(c, b)));
        s.survivors.extend(s.b.iter().copied().filter(|&c| !has(c, a)));
        let rims = self.rim[a as usize] && self.rim[b as usize];
        let both_fixed = self.fixed[a as usize] && self.fixed[b as usize];
        // An inner edge from rim to rim would pinch the surface.
        if both_fixed || s.survivors.is_empty() || !(s.shared.len() == 1 || (s.shared.len() == 2 && !rims)) {
            return false;
        }
        s.around.clear();
        s.around.extend(s.a.iter().flat_map(|&c| self.far_edge(c)).filter(|&v| v != b));
        s.around.sort_unstable();
        s.around.dedup();
        let beside_a = s.around.len();
        s.around.extend(s.b.iter().flat_map(|&c| self.far_edge(c)).filter(|&v| v != a));
        s.around[beside_a..].sort_unstable();
        let (of_a, of_b) = s.around.split_at(beside_a);
        let common =
            of_b.iter().enumerate().filter(|&(i, v)| (i == 0 || of_b[i - 1] != *v) && of_a.binary_search(v).is_ok());
        if common.count() != s.shared.len() {
            return false;
        }
        s.spokes.clear();
        s.spokes.extend(s.survivors.iter().map(|&c| {
            let [p, q] = self.far_edge(c);
            [p.min(q), p.max(q)]
        }));
        s.spokes.sort_unstable();
        s.spokes.windows(2).all(|w| w[0] != w[1])
    }

    /// Whether no face flips and none becomes a needle when the merged vertex is at `x`. Fills `triangles`.
    fn shape_stays(&self, x: &Point3<f64>, s: &mut Scratch) -> bool {
        let corners = |c: u32| self.faces[c as usize / 3].map(|v| self.vertices[v as usize]);
        s.triangles.clear();
        let (mut worst, mut worst_before) = (1.0_f64, 1.0_f64);
        for &c in &s.survivors {
            let before = corners(c);
            let mut after = before;
            after[c as usize % 3] = *x;
            let (m, n) = (normal(&before), normal(&after));
            if !(n.dot(&m) >= LEAST_COSINE * n.norm() * m.norm()) {
                return false;
            }
            worst_before = worst_before.min(roundness(&before));
            worst = worst.min(roundness(&after));
            s.triangles.push(after);
        }
        let worst_before = s.shared.iter().fold(worst_before, |w, &c| w.min(roundness(&corners(c))));
        worst > 0.0 && (worst >= NEEDLE || worst >= worst_before)
    }
}

fn normal([a, b, c]: &[Point3<f64>; 3]) -> Vector3<f64> {
    (b - a).cross(&(c - a))
}

/// 4 √3 area / (sum of the squared sides): 1 for an equilateral triangle, 0 for a needle.
pub(super) fn roundness(t: &[Point3<f64>; 3]) -> f64 {
    let sides: f64 = (0..3).map(|k| (t[(k + 1) % 3] - t[k]).norm_squared()).sum();
    if sides > 0.0 { 2.0 * 3.0_f64.sqrt() * normal(t).norm() / sides } else { 0.0 }
}
