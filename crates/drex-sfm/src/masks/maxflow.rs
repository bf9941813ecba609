//! Maximum flow by two search trees (Boykov and Kolmogorov, PAMI 2004) on graphs of any shape, integer capacities.
//!
//! One tree grows from the source, one from the sink. Where they touch, flow is pushed along the path; arcs that fill up
//! cut branches off, and these look for a new parent. Trees are kept between paths, which is why the method suits the
//! graphs of pictures: many short paths.

use std::collections::VecDeque;

const NONE: u32 = u32::MAX;
/// Parent of a node that hangs on its terminal.
const TERMINAL: u32 = u32::MAX - 1;
/// Parent of a node that was cut off and waits for a new parent.
const ORPHAN: u32 = u32::MAX - 2;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Tree {
    Free,
    Source,
    Sink,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    first: u32,
    parent: u32,
    /// Residual capacity from the source (positive) or to the sink (negative).
    terminal: i32,
    /// When `depth` was last known to be right.
    stamp: u32,
    depth: u32,
    tree: Tree,
    queued: bool,
}

#[derive(Debug, Clone, Copy)]
struct Arc {
    head: u32,
    next: u32,
    residual: i32,
}

/// A flow network with a source and a sink; the reverse of arc `a` is arc `a ^ 1`.
#[derive(Debug, Clone)]
pub(super) struct FlowGraph {
    nodes: Vec<Node>,
    arcs: Vec<Arc>,
    flow: i64,
    active: VecDeque<u32>,
    orphans: VecDeque<u32>,
    time: u32,
}

impl FlowGraph {
    /// A network of `nodes` nodes without edges; `edges` is how many will follow, as a hint.
    pub(super) fn new(nodes: usize, edges: usize) -> Self {
        let node = Node { first: NONE, parent: NONE, terminal: 0, stamp: 0, depth: 0, tree: Tree::Free, queued: false };
        Self {
            nodes: vec![node; nodes],
            arcs: Vec::with_capacity(2 * edges),
            flow: 0,
            active: VecDeque::new(),
            orphans: VecDeque::new(),
            time: 0,
        }
    }

    /// Adds capacity from the source to `node` and from `node` to the sink; both at least zero.
    pub(super) fn add_terminal(&mut self, node: usize, from_source: i32, to_sink: i32) {
        let had = self.nodes[node].terminal;
        let source = from_source + had.max(0);
        let sink = to_sink + (-had).max(0);
        self.flow += i64::from(source.min(sink));
        self.nodes[node].terminal = source - sink;
    }

    /// Adds an edge with a capacity for each direction; both at least zero.
    pub(super) fn add_edge(&mut self, from: usize, to: usize, capacity: i32, reverse: i32) {
        let arc = self.arcs.len() as u32;
        self.arcs.push(Arc { head: to as u32, next: self.nodes[from].first, residual: capacity });
        self.arcs.push(Arc { head: from as u32, next: self.nodes[to].first, residual: reverse });
        self.nodes[from].first = arc;
        self.nodes[to].first = arc + 1;
    }

    /// Pushes the maximum flow and returns it.
    pub(super) fn solve(&mut self) -> i64 {
        for i in 0..self.nodes.len() {
            let node = &mut self.nodes[i];
            if node.terminal != 0 {
                node.tree = if node.terminal > 0 { Tree::Source } else { Tree::Sink };
                node.parent = TERMINAL;
                node.depth = 1;
                self.activate(i as u32);
            }
        }
        while let Some(&node) = self.active.front() {
            let lives = self.nodes[node as usize].tree != Tree::Free;
            if let Some(bridge) = if lives { self.grow(node) } else { None } {
                self.time += 1;
                self.augment(bridge);
                while let Some(orphan) = self.orphans.pop_front() {
                    self.adopt(orphan);
                }
                continue;
            }
            self.active.pop_front();
            self.nodes[node as usize].queued = false;
        }
        self.flow
    }

    /// Whether `node` lies on the source's side of the minimum cut nearest to the source; after [`Self::solve`].
    pub(super) fn with_source(&self, node: usize) -> bool {
        self.nodes[node].tree == Tree::Source
    }

    fn activate(&mut self, node: u32) {
        if !self.nodes[node as usize].queued {
            self.nodes[node as usize].queued = true;
            self.active.push_back(node);
        }
    }

    /// Whether flow can still pass from the source's end to the sink's end between a node of `tree` and the head of `arc`,
    /// the node being nearer to its terminal.
    fn open(&self, tree: Tree, arc: u32) -> bool {
        self.arcs[if tree == Tree::Source { arc } else { arc ^ 1 } as usize].residual > 0
    }

    /// Takes free neighbours of `node` into its tree; the arc from source tree to sink tree if they touch.
    fn grow(&mut self, node: u32) -> Option<u32> {
        let Node { tree, stamp, depth, .. } = self.nodes[node as usize];
        let mut arc = self.nodes[node as usize].first;
        while arc != NONE {
            let Arc { head, next, .. } = self.arcs[arc as usize];
            if self.open(tree, arc) {
                let other = &mut self.nodes[head as usize];
                if other.tree == Tree::Free {
                    (other.tree, other.parent, other.stamp, other.depth) = (tree, arc ^ 1, stamp, depth + 1);
                    self.activate(head);
                } else if other.tree != tree {
                    return Some(if tree == Tree::Source { arc } else { arc ^ 1 });
                } else if other.parent < ORPHAN && other.stamp <= stamp && other.depth > depth + 1 {
                    (other.parent, other.stamp, other.depth) = (arc ^ 1, stamp, depth + 1);
                }
            }
            arc = next;
        }
        None
    }

    /// Pushes what fits along source, tree, `bridge`, tree, sink.
    fn augment(&mut self, bridge: u32) {
        let ends = [self.arcs[(bridge ^ 1) as usize].head, self.arcs[bridge as usize].head];
        let mut room = self.arcs[bridge as usize].residual;
        for (side, end) in ends.into_iter().enumerate() {
            let mut node = end;
            loop {
                let Node { parent, terminal, .. } = self.nodes[node as usize];
                if parent == TERMINAL {
                    room = room.min(terminal.abs());
                    break;
                }
                room = room.min(self.arcs[(parent ^ (1 - side as u32)) as usize].residual);
                node = self.arcs[parent as usize].head;
            }
        }
        self.arcs[bridge as usize].residual -= room;
        self.arcs[(bridge ^ 1) as usize].residual += room;
        for (side, end) in ends.into_iter().enumerate() {
            let mut node = end;
            loop {
                let Node { parent, terminal, .. } = self.nodes[node as usize];
                if parent == TERMINAL {
                    let left = if side == 0 { terminal - room } else { terminal + room };
                    self.nodes[node as usize].terminal = left;
                    if left == 0 {
                        self.cut_off(node);
                    }
                    break;
                }
                let along = parent ^ (1 - side as u32);
                self.arcs[along as usize].residual -= room;
                self.arcs[(along ^ 1) as usize].residual += room;
                if self.arcs[along as usize].residual == 0 {
                    self.cut_off(node);
                }
                node = self.arcs[parent as usize].head;
            }
        }
        self.flow += i64::from(room);
    }

    fn cut_off(&mut self, node: u32) {
        self.nodes[node as usize].parent = ORPHAN;
        self.orphans.push_back(node);
    }

    /// Steps from `node` to its terminal, if its branch is whole.
    fn depth_of(&self, mut node: u32) -> Option<u32> {
        let mut steps = 0;
        loop {
            let Node { parent, stamp, depth, .. } = self.nodes[node as usize];
            if stamp == self.time && parent < ORPHAN {
                return Some(steps + depth);
            }
            match parent {
                TERMINAL => return Some(steps + 1),
                ORPHAN | NONE => return None,
                arc => node = self.arcs[arc as usize].head,
            }
            steps += 1;
        }
    }

    /// Writes down the depths that [`Self::depth_of`] found.
    fn stamp_branch(&mut self, mut node: u32, mut depth: u32) {
        loop {
            let now = self.time;
            let this = &mut self.nodes[node as usize];
            if this.stamp == now && this.parent < ORPHAN {
                return;
            }
            (this.stamp, this.depth) = (now, depth);
            if this.parent >= ORPHAN {
                return;
            }
            node = self.arcs[this.parent as usize].head;
            depth -= 1;
        }
    }

    /// Finds a new parent for a node that was cut off, or frees it and cuts its children off.
    fn adopt(&mut self, orphan: u32) {
        let tree = self.nodes[orphan as usize].tree;
        let (mut best, mut best_depth) = (NONE, u32::MAX);
        let mut arc = self.nodes[orphan as usize].first;
        while arc != NONE {
            let Arc { head, next, .. } = self.arcs[arc as usize];
            let usable = self.nodes[head as usize].tree == tree && self.open(tree, arc ^ 1);
            if let Some(depth) = if usable { self.depth_of(head) } else { None } {
                if depth < best_depth {
                    (best, best_depth) = (arc, depth);
                }
                self.stamp_branch(head, depth);
            }
            arc = next;
        }
        if best != NONE {
            let time = self.time;
            let node = &mut self.nodes[orphan as usize];
            (node.parent, node.stamp, node.depth) = (best, time, best_depth + 1);
            return;
        }
        let mut arc = self.nodes[orphan as usize].first;
        while arc != NONE {
            let Arc { head, next, .. } = self.arcs[arc as usize];
            let other = self.nodes[head as usize];
            if other.tree == tree {
                if self.open(tree, arc ^ 1) {
                    self.activate(head);
                }
                if other.parent < ORPHAN && self.arcs[other.parent as usize].head == orphan {
                    self.cut_off(head);
                }
            }
            arc = next;
        }
        let node = &mut self.nodes[orphan as usize];
        (node.tree, node.parent) = (Tree::Free, NONE);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Capacity of the cut whose source side is `side`.
    fn cut_of(side: u32, terminals: &[(i32, i32)], edges: &[(usize, usize, i32, i32)]) -> i64 {
        let at_source = |n: usize| side >> n & 1 == 1;
        let ends: i64 =
            terminals.iter().enumerate().map(|(n, (s, t))| i64::from(if at_source(n) { *t } else { *s })).sum();
        let inner: i64 = edges
            .iter()
            .map(|(a, b, c, r)| match (at_source(*a), at_source(*b)) {
                (true, false) => i64::from(*c),
                (false, true) => i64::from(*r),
                _ => 0,
            })
            .sum();
        ends + inner
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn flow_is_the_smallest_of_all_cuts(
            terminals in prop::collection::vec((0..9i32, 0..9i32), 1..9),
            raw in prop::collection::vec((0..9usize, 0..9usize, 0..9i32, 0..9i32), 0..25),
        ) {
            let n = terminals.len();
            let edges: Vec<_> = raw.into_iter().filter(|(a, b, ..)| a != b && *a < n && *b < n).collect();
            let mut graph = FlowGraph::new(n, edges.len());
            for (i, (s, t)) in terminals.iter().enumerate() {
                graph.add_terminal(i, *s, *t);
            }
            for (a, b, c, r) in &edges {
                graph.add_edge(*a, *b, *c, *r);
            }
            let flow = graph.solve();
            let smallest = (0..1u32 << n).map(|side| cut_of(side, &terminals, &edges)).min().unwrap();
            prop_assert_eq!(flow, smallest);
            let side = (0..n).fold(0, |side, i| side | u32::from(graph.with_source(i)) << i);
            prop_assert_eq!(cut_of(side, &terminals, &edges), smallest);
        }
    }
}
