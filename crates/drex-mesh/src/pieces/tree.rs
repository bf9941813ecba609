//! A solid divided by planes: the tree of cuts, and groups of its leaves that make a piece each.

use nalgebra::{Point3, Unit, Vector3};
use rayon::prelude::*;

use drex_core::TriMesh;

use super::cut::{Cut, Leaf, Scene};
use super::part::{Part, Plane};
use super::probe::Fill;
use crate::hull::convex_hull;

/// A node of the tree: a plane with the nodes on both sides, or a leaf.
#[derive(Debug, Clone)]
enum Node {
    Cut(Plane, [usize; 2]),
    /// Its group.
    Leaf(usize),
}

/// The tree of cuts, the first node on top.
#[derive(Debug, Clone)]
pub(super) struct Tree {
    nodes: Vec<Node>,
}

/// A piece: the hull of some leaves.
#[derive(Debug, Clone)]
struct Group {
    hull: Option<TriMesh>,
    fill: Fill,
}

/// Cuts where it gains most, until every part fills at most the tolerance or there are `most` parts.
pub(super) fn split(scene: &Scene<'_>, whole: Part, most: usize) -> Option<(Tree, Vec<Leaf>)> {
    let mut nodes = vec![Node::Leaf(0)];
    let mut place = vec![0];
    let mut leaves = vec![scene.leaf(whole)?];
    let mut cuts: Vec<Option<Option<Cut>>> = vec![None];
    while leaves.len() < most {
        let mut best: Option<(f64, usize, Cut)> = None;
        for (i, leaf) in leaves.iter().enumerate() {
            let needed = leaf.fill.depth > scene.tolerance;
            let Some(cut) = *cuts[i].get_or_insert_with(|| if needed { scene.best_cut(leaf) } else { None }) else {
                continue;
            };
            let gain = leaf.fill.cost - cut.cost;
            if best.is_none_or(|(g, ..)| gain > g) {
                best = Some((gain, i, cut));
            }
        }
        let Some((_, i, cut)) = best else { break };
        let halves = scene.sides(&cut.plane).map(|side| leaves[i].part.behind(&side).and_then(|p| scene.leaf(p)));
        let [Some(a), Some(b)] = halves else {
            // One side is flat: nothing to gain here.
            cuts[i] = Some(None);
            continue;
        };
        let (left, right) = (nodes.len(), nodes.len() + 1);
        nodes[place[i]] = Node::Cut(cut.plane, [left, right]);
        nodes.extend([Node::Leaf(i), Node::Leaf(leaves.len())]);
        place[i] = left;
        place.push(right);
        leaves[i] = a;
        cuts[i] = None;
        leaves.push(b);
        cuts.push(None);
    }
    Some((Tree { nodes }, leaves))
}

/// Pieces under construction: groups of leaves.
#[derive(Debug)]
pub(super) struct Division<'a> {
    scene: &'a Scene<'a>,
    tree: Tree,
    whole: Part,
    groups: Vec<Group>,
}

impl<'a> Division<'a> {
    pub fn new(scene: &'a Scene<'a>, whole: Part, tree: Tree, leaves: Vec<Leaf>) -> Self {
        let groups = leaves.into_iter().map(|l| Group { hull: Some(l.hull), fill: l.fill }).collect();
        Self { scene, tree, whole, groups }
    }

    pub fn cost(&self) -> f64 {
        self.groups.iter().map(|g| g.fill.cost).sum()
    }

    pub fn pieces(&self) -> usize {
        self.groups.iter().filter(|g| g.hull.is_some()).count()
    }

    /// Joins the groups whose common hull costs least: while there are more than `most`, and while the common hull stays
    /// within the tolerance.
    pub fn merge(&mut self, most: usize) {
        let n = self.groups.len();
        let pairs: Vec<(usize, usize)> = (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).collect();
        let mut joined: Vec<Vec<Option<Group>>> = (0..n).map(|i| vec![None; i]).collect();
        let found: Vec<_> = pairs.par_iter().map(|&(i, j)| self.join(i, j)).collect();
        for (&(i, j), group) in pairs.iter().zip(found) {
            joined[i][j] = group;
        }
        loop {
            let mut best: Option<(f64, usize, usize)> = None;
            let full = self.pieces() > most;
            for i in 0..n {
                for j in 0..i {
                    let Some(group) = &joined[i][j] else { continue };
                    let more = group.fill.cost - self.groups[i].fill.cost - self.groups[j].fill.cost;
                    let free = group.fill.depth <= self.scene.tolerance || more <= 0.0;
                    if (full || free) && best.is_none_or(|(m, ..)| more < m) {
                        best = Some((more, i, j));
                    }
                }
            }
            let Some((_, i, j)) = best else { return };
            let Some(group) = joined[i][j].take() else { return };
            self.groups[j] = group;
            self.groups[i] = Group { hull: None, fill: Fill::NONE };
            for node in &mut self.tree.nodes {
                if let Node::Leaf(g) = node
                    && *g == i
                {
                    *g = j;
                }
            }
            let fresh: Vec<_> = (0..n).into_par_iter().map(|k| self.join(k, j)).collect();
            for (k, group) in fresh.into_iter().enumerate() {
                if k != j {
                    joined[k.max(j)][k.min(j)] = group;
                }
                if k != i {
                    joined[k.max(i)][k.min(i)] = None;
                }
            }
        }
    }

    fn join(&self, i: usize, j: usize) -> Option<Group> {
        let (a, b) = (self.groups[i].hull.as_ref()?, self.groups[j].hull.as_ref()?);
        if i == j {
            return None;
        }
        Some(self.group(a.vertices.iter().chain(&b.vertices).copied().collect()))
    }

    fn group(&self, points: Vec<Point3<f64>>) -> Group {
        match convex_hull(&points) {
            Ok(hull) => {
                let fill = self.scene.probes.fill(&hull, &self.scene.probes.near(&hull));
                Group { hull: Some(hull), fill }
            }
            Err(_) => Group { hull: None, fill: Fill::NONE },
        }
    }

    /// Moves and tilts the planes while that lowers the cost.
    pub fn refine(&mut self, rounds: usize) {
        let (mut shift, mut tilt) = (0.06, 0.15_f64);
        for _ in 0..rounds {
            let before = self.cost();
            self.refine_below(0, &self.whole.clone(), shift, tilt);
            if self.cost() > 0.98 * before {
                shift /= 2.0;
                tilt /= 2.0;
            }
        }
    }

    /// Moves the plane of a node, whose part is given, then those below it.
    fn refine_below(&mut self, node: usize, part: &Part, shift: f64, tilt: f64) {
        let Node::Cut(plane, children) = self.tree.nodes[node].clone() else { return };
        let touched = self.groups_below(node);
        let current: f64 = touched.iter().map(|&g| self.groups[g].fill.cost).sum();
        if !(current > 0.0) {
            return;
        }
        let moves = moves(&plane, part, shift, tilt);
        let outcomes: Vec<(f64, Vec<Group>)> = moves
            .par_iter()
            .map(|&plane| {
                let mut tree = self.tree.clone();
                tree.nodes[node] = Node::Cut(plane, children);
                let groups = self.groups_of(&tree, &touched);
                (groups.iter().map(|g| g.fill.cost).sum(), groups)
            })
            .collect();
        let mut best = (current, None);
        for (k, (cost, _)) in outcomes.iter().enumerate() {
            if *cost < best.0 {
                best = (*cost, Some(k));
            }
        }
        let mut plane = plane;
        if let Some(k) = best.1 {
            plane = moves[k];
            self.tree.nodes[node] = Node::Cut(plane, children);
            for (&g, group) in touched.iter().zip(&outcomes[k].1) {
                self.groups[g] = group.clone();
            }
        }
        for (child, side) in children.into_iter().zip(self.scene.sides(&plane)) {
            if let Some(part) = part.behind(&side) {
                self.refine_below(child, &part, shift, tilt);
            }
        }
    }

    fn groups_below(&self, node: usize) -> Vec<usize> {
        let mut found = Vec::new();
        let mut open = vec![node];
        while let Some(i) = open.pop() {
            match &self.tree.nodes[i] {
                Node::Cut(_, children) => open.extend(children),
                Node::Leaf(g) => found.push(*g),
            }
        }
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Some groups, as another tree makes them.
    fn groups_of(&self, tree: &Tree, wanted: &[usize]) -> Vec<Group> {
        let mut points = vec![Vec::new(); self.groups.len()];
        let mut keep = vec![false; self.groups.len()];
        wanted.iter().for_each(|&g| keep[g] = true);
        self.collect(tree, 0, &self.whole, &keep, &mut points);
        wanted.iter().map(|&g| self.group(std::mem::take(&mut points[g]))).collect()
    }

    fn collect(&self, tree: &Tree, node: usize, part: &Part, keep: &[bool], points: &mut [Vec<Point3<f64>>]) {
        match &tree.nodes[node] {
            Node::Leaf(g) if keep[*g] => points[*g].extend(part.points(|p| self.scene.solid.contains(p))),
            Node::Leaf(_) => {}
            Node::Cut(plane, children) => {
                for (&child, side) in children.iter().zip(self.scene.sides(plane)) {
                    if let Some(part) = part.behind(&side) {
                        self.collect(tree, child, &part, keep, points);
                    }
                }
            }
        }
    }

    /// The hulls of the pieces, cut from the given surface of the same solid.
    pub fn hulls(&self, surface: TriMesh) -> Vec<TriMesh> {
        let Some(whole) = Part::whole(surface) else { return Vec::new() };
        let mut points = vec![Vec::new(); self.groups.len()];
        self.collect(&self.tree, 0, &whole, &vec![true; self.groups.len()], &mut points);
        points.iter().filter_map(|p| convex_hull(p).ok()).collect()
    }
}

/// A plane shifted both ways and tilted both ways about two axes in it, around the middle of the part.
fn moves(plane: &Plane, part: &Part, shift: f64, tilt: f64) -> Vec<Plane> {
    let Some((lo, hi)) = part.surface.bounds() else { return Vec::new() };
    let size = (hi - lo).norm();
    let middle = nalgebra::center(&lo, &hi);
    let pivot = middle - plane.normal.into_inner() * plane.height(&middle);
    let u = plane.normal.cross(&Vector3::ith(plane.normal.iamin(), 1.0)).normalize();
    let v = plane.normal.cross(&u);
    let mut out = vec![plane.moved(-shift * size / 2.0), plane.moved(shift * size / 2.0)];
    for axis in [u, v, -u, -v] {
        let normal = Unit::new_normalize(plane.normal.into_inner() + axis * tilt.tan());
        out.push(Plane { normal, offset: normal.dot(&pivot.coords) });
    }
    out
}
