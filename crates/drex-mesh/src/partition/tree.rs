//! A solid divided by planes: the tree of cuts, and groups of its leaves that make a piece each.

use nalgebra::{Point3, Unit, Vector3};
use rayon::prelude::*;

use drex_core::TriMesh;

use super::cut::{Cut, Leaf, Scene};
use super::part::{Part, Plane};
use super::probe::Fill;
use drex_core::mesh::convex_hull;

/// A node of the tree: a plane with the nodes on both sides, or a leaf with its number.
#[derive(Debug, Clone)]
enum Node {
    Cut(Plane, [usize; 2]),
    Leaf(usize),
}

/// A piece: the hull of some leaves. None if it is flat or has become part of another group.
#[derive(Debug, Clone)]
struct Group {
    hull: Option<TriMesh>,
    fill: Fill,
}

/// A solid cut into parts, and the parts grouped into pieces.
#[derive(Debug, Clone)]
pub(super) struct Division<'a> {
    scene: &'a Scene,
    whole: Part,
    /// The tree of cuts, the first node on top.
    nodes: Vec<Node>,
    /// Points whose hull is that of each leaf.
    leaves: Vec<Vec<Point3<f64>>>,
    group_of: Vec<usize>,
    groups: Vec<Group>,
}

impl<'a> Division<'a> {
    /// The undivided solid.
    pub fn new(scene: &'a Scene, whole: Part) -> Self {
        let leaves = vec![whole.points(|p| scene.inside(p))];
        let mut division = Self { scene, whole, nodes: vec![Node::Leaf(0)], leaves, group_of: vec![0], groups: vec![] };
        division.groups = vec![division.group(division.leaves[0].clone())];
        division
    }

    pub fn cost(&self) -> f64 {
        self.groups.iter().map(|g| g.fill.cost).sum()
    }

    pub fn hull_count(&self) -> usize {
        self.groups.iter().filter(|g| g.hull.is_some()).count()
    }

    /// Breaks up the groups that fill more than the tolerance, and cuts their parts where it gains most, until every part
    /// fills at most the tolerance or `more` cuts are made.
    pub fn split(&mut self, more: usize) {
        let mut open: Vec<(usize, usize, Leaf)> = Vec::new();
        for (node, leaf, part) in self.parts() {
            if self.groups[self.group_of[leaf]].fill.depth > self.scene.tolerance
                && let Some(found) = self.scene.leaf(part)
            {
                open.push((node, leaf, found));
            }
        }
        for &(_, leaf, ref found) in &open {
            let old = self.group_of[leaf];
            self.groups[old] = Group { hull: None, fill: Fill::NONE };
            self.group_of[leaf] = self.groups.len();
            self.groups.push(Group { hull: Some(found.hull.clone()), fill: found.fill });
        }
        let mut cuts: Vec<Option<Cut>> = open.iter().map(|(.., leaf)| self.cut_of(leaf)).collect();
        for _ in 0..more {
            let mut best: Option<(usize, Cut)> = None;
            for (i, cut) in cuts.iter().enumerate() {
                let Some(cut) = cut else { continue };
                if best.is_none_or(|(_, b)| cut.gain > b.gain) {
                    best = Some((i, *cut));
                }
            }
            let Some((i, cut)) = best else { break };
            let (node, leaf, ref found) = open[i];
            let sides = self.scene.sides(&cut.plane);
            let halves = sides.map(|side| found.part.behind(&side).and_then(|p| self.scene.leaf(p)));
            let [Some(a), Some(b)] = halves else {
                // One side is flat: nothing to gain here.
                cuts[i] = None;
                continue;
            };
            let (left, right, twin) = (self.nodes.len(), self.nodes.len() + 1, self.leaves.len());
            self.nodes[node] = Node::Cut(cut.plane, [left, right]);
            self.nodes.extend([Node::Leaf(leaf), Node::Leaf(twin)]);
            self.leaves[leaf] = a.hull.vertices.clone();
            self.leaves.push(b.hull.vertices.clone());
            self.groups[self.group_of[leaf]] = Group { hull: Some(a.hull.clone()), fill: a.fill };
            self.group_of.push(self.groups.len());
            self.groups.push(Group { hull: Some(b.hull.clone()), fill: b.fill });
            cuts[i] = self.cut_of(&a);
            cuts.push(self.cut_of(&b));
            open[i] = (left, leaf, a);
            open.push((right, twin, b));
        }
    }

    fn cut_of(&self, leaf: &Leaf) -> Option<Cut> {
        if leaf.fill.depth > self.scene.tolerance { self.scene.best_cut(leaf) } else { None }
    }

    /// Node, number and part of every leaf that is not empty.
    fn parts(&self) -> Vec<(usize, usize, Part)> {
        let mut found = Vec::new();
        let mut open = vec![(0, self.whole.clone())];
        while let Some((node, part)) = open.pop() {
            match &self.nodes[node] {
                Node::Leaf(leaf) => found.push((node, *leaf, part)),
                Node::Cut(plane, children) => {
                    for (&child, side) in children.iter().zip(self.scene.sides(plane)) {
                        open.extend(part.behind(&side).map(|p| (child, p)));
                    }
                }
            }
        }
        found
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
            let full = self.hull_count() > most;
            for i in 0..n {
                for j in 0..i {
                    let Some(group) = &joined[i][j] else { continue };
                    let more = group.fill.cost - self.groups[i].fill.cost - self.groups[j].fill.cost;
                    let free = group.fill.depth <= self.scene.tolerance || more <= self.scene.probes.negligible();
                    if (full || free) && best.is_none_or(|(m, ..)| more < m) {
                        best = Some((more, i, j));
                    }
                }
            }
            let Some((_, i, j)) = best else { return };
            let Some(group) = joined[i][j].take() else { return };
            self.groups[j] = group;
            self.groups[i] = Group { hull: None, fill: Fill::NONE };
            self.group_of.iter_mut().filter(|g| **g == i).for_each(|g| *g = j);
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
            if self.cost() > 0.97 * before {
                shift /= 2.0;
                tilt /= 2.0;
            }
        }
    }

    /// Moves the plane of a node, whose part is given, then those below it.
    fn refine_below(&mut self, node: usize, part: &Part, shift: f64, tilt: f64) {
        let Node::Cut(plane, children) = self.nodes[node].clone() else { return };
        let touched = self.groups_below(node);
        let current: f64 = touched.iter().map(|&g| self.groups[g].fill.cost).sum();
        if !(current > 0.0) {
            return;
        }
        let moves = moves(&plane, part, shift, tilt);
        let outcomes: Vec<_> = moves.par_iter().map(|plane| self.moved(plane, children, part, &touched)).collect();
        let pieces = touched.iter().filter(|&&g| self.groups[g].hull.is_some()).count();
        let mut best = (current, None);
        for (k, (groups, _)) in outcomes.iter().enumerate() {
            let cost = groups.iter().map(|g| g.fill.cost).sum();
            // A flat group that gets a volume would be a piece more.
            if cost < best.0 && groups.iter().filter(|g| g.hull.is_some()).count() <= pieces {
                best = (cost, Some(k));
            }
        }
        let plane = best.1.map_or(plane, |k| moves[k]);
        if let Some((groups, leaves)) = best.1.and_then(|k| outcomes.into_iter().nth(k)) {
            self.nodes[node] = Node::Cut(plane, children);
            for (g, group) in touched.into_iter().zip(groups) {
                self.groups[g] = group;
            }
            for (leaf, points) in leaves {
                self.leaves[leaf] = points;
            }
        }
        for (child, side) in children.into_iter().zip(self.scene.sides(&plane)) {
            if let Some(part) = part.behind(&side) {
                self.refine_below(child, &part, shift, tilt);
            }
        }
    }

    /// Leaves below a node.
    fn leaves_below(&self, node: usize) -> Vec<usize> {
        match &self.nodes[node] {
            Node::Cut(_, children) => children.iter().flat_map(|&c| self.leaves_below(c)).collect(),
            Node::Leaf(leaf) => vec![*leaf],
        }
    }

    fn groups_below(&self, node: usize) -> Vec<usize> {
        let mut groups: Vec<usize> = self.leaves_below(node).into_iter().map(|leaf| self.group_of[leaf]).collect();
        groups.sort_unstable();
        groups.dedup();
        groups
    }

    /// The groups in `touched` and the leaves' points if the cut of a part were another one.
    #[allow(clippy::type_complexity)]
    fn moved(
        &self,
        plane: &Plane,
        children: [usize; 2],
        part: &Part,
        touched: &[usize],
    ) -> (Vec<Group>, Vec<(usize, Vec<Point3<f64>>)>) {
        let mut leaves = Vec::new();
        for (child, side) in children.into_iter().zip(self.scene.sides(plane)) {
            self.collect(child, part.behind(&side), &|p| self.scene.inside(p), &mut leaves);
        }
        let changed = |leaf: usize| leaves.iter().find(|(l, _)| *l == leaf).map(|(_, points)| points);
        let groups = touched
            .iter()
            .map(|&g| {
                let members = (0..self.leaves.len()).filter(|&leaf| self.group_of[leaf] == g);
                self.group(members.flat_map(|l| changed(l).unwrap_or(&self.leaves[l])).copied().collect())
            })
            .collect();
        (groups, leaves)
    }

    /// Points of the leaves below a node whose part is given.
    fn collect(
        &self,
        node: usize,
        part: Option<Part>,
        inside: &impl Fn(&Point3<f64>) -> bool,
        leaves: &mut Vec<(usize, Vec<Point3<f64>>)>,
    ) {
        match &self.nodes[node] {
            Node::Leaf(leaf) => leaves.push((*leaf, part.map_or(Vec::new(), |p| p.points(inside)))),
            Node::Cut(plane, children) => {
                for (&child, side) in children.iter().zip(self.scene.sides(plane)) {
                    self.collect(child, part.as_ref().and_then(|p| p.behind(&side)), inside, leaves);
                }
            }
        }
    }

    /// The hulls of the pieces, cut from the given surface of the same solid.
    pub fn hulls(&self, surface: TriMesh) -> Vec<TriMesh> {
        let mut leaves = Vec::new();
        self.collect(0, Part::whole(surface), &|p| self.scene.exactly_inside(p), &mut leaves);
        let mut points = vec![Vec::new(); self.groups.len()];
        for (leaf, found) in leaves {
            points[self.group_of[leaf]].extend(found);
        }
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
