//! Which faces meet at which edges, which faces form one shell, where a mesh is open.

use nalgebra::Vector3;

use drex_core::TriMesh;
use drex_core::sets::DisjointSets;

/// No partner.
pub(crate) const NONE: u32 = u32::MAX;

/// Half-edge `3 f + k` of face f runs from its corner k to its corner k + 1.
#[derive(Debug, Clone)]
pub(crate) struct Topology {
    /// The half-edge on the other side of each half-edge, [`NONE`] where the mesh is open.
    pub partner: Vec<u32>,
    /// Half-edges without partner.
    pub open_edges: usize,
    /// Edges at which more than two faces meet.
    pub crowded_edges: usize,
    /// Pairs of faces that run along their common edge in the same direction: one of them is wound the wrong way.
    pub misaligned: usize,
}

/// Start and end vertex of a half-edge.
pub(crate) fn ends(mesh: &TriMesh, half: u32) -> (u32, u32) {
    let f = mesh.faces[half as usize / 3];
    let k = half as usize % 3;
    (f[k], f[(k + 1) % 3])
}

/// Half-edges grouped by the edge they run along (in either direction).
pub(crate) fn edges(mesh: &TriMesh) -> Vec<(u64, u32)> {
    let mut keyed: Vec<(u64, u32)> = (0..3 * mesh.faces.len() as u32)
        .map(|h| {
            let (a, b) = ends(mesh, h);
            (u64::from(a.min(b)) << 32 | u64::from(a.max(b)), h)
        })
        .collect();
    keyed.sort_unstable();
    keyed
}

impl Topology {
    /// Pairs the half-edges of `mesh`, whose vertices are welded.
    ///
    /// Where more than two faces meet, faces that bound one wedge of the solid are paired: each face with the
    /// next one that closes the wedge behind it, by angle around the edge. So two solids that touch along an
    /// edge or a face stay two shells.
    pub fn new(mesh: &TriMesh) -> Self {
        let keyed = edges(mesh);
        let mut topology = Self { partner: vec![NONE; keyed.len()], open_edges: 0, crowded_edges: 0, misaligned: 0 };
        for group in keyed.chunk_by(|a, b| a.0 == b.0) {
            match group {
                [(_, g), (_, h)] => {
                    topology.pair(*g, *h);
                    topology.misaligned += usize::from(ends(mesh, *g).0 == ends(mesh, *h).0);
                }
                [_] => {}
                crowd => {
                    topology.crowded_edges += 1;
                    topology.pair_crowd(mesh, crowd);
                }
            }
        }
        topology.open_edges = topology.partner.iter().filter(|&&p| p == NONE).count();
        topology
    }

    fn pair(&mut self, g: u32, h: u32) {
        self.partner[g as usize] = h;
        self.partner[h as usize] = g;
    }

    fn pair_crowd(&mut self, mesh: &TriMesh, crowd: &[(u64, u32)]) {
        let key = crowd[0].0;
        let (lo, hi) = ((key >> 32) as u32, key as u32);
        let origin = mesh.vertices[lo as usize];
        let Some(axis) = (mesh.vertices[hi as usize] - origin).try_normalize(0.0) else { return };
        let u = axis.cross(&Vector3::ith(axis.iamin(), 1.0)).normalize();
        let v = axis.cross(&u);
        let angle = |h: u32| {
            let f = mesh.faces[h as usize / 3];
            let d = mesh.vertices[f[(h as usize + 2) % 3] as usize] - origin;
            d.dot(&v).atan2(d.dot(&u))
        };
        // A face that runs lo -> hi has the solid at smaller angles, one that runs hi -> lo at larger ones.
        let (forth, back): (Vec<u32>, Vec<u32>) = crowd.iter().map(|c| c.1).partition(|&h| ends(mesh, h).0 == lo);
        let turn = 2.0 * std::f64::consts::PI;
        let mut candidates = Vec::with_capacity(forth.len() * back.len());
        for &b in &back {
            for &f in &forth {
                let wedge = (angle(f) - angle(b)).rem_euclid(turn);
                // Faces that coincide (two solids touching) bound no wedge with each other.
                candidates.push((if wedge < 1e-6 { turn } else { wedge }, b, f));
            }
        }
        candidates.sort_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
        for (_, b, f) in candidates {
            if self.partner[b as usize] == NONE && self.partner[f as usize] == NONE {
                self.pair(b, f);
            }
        }
    }

    /// How many of the shells have no open edge.
    pub fn closed_shells(&self, labels: &[u32], count: usize) -> usize {
        let mut closed = vec![true; count];
        for (h, &p) in self.partner.iter().enumerate() {
            closed[labels[h / 3] as usize] &= p != NONE;
        }
        closed.iter().filter(|&&c| c).count()
    }

    /// Shell of each face (faces connected over paired edges) and the number of shells.
    pub fn shells(&self) -> (Vec<u32>, usize) {
        let mut sets = DisjointSets::new(self.partner.len() / 3);
        for (h, &p) in self.partner.iter().enumerate() {
            if p != NONE {
                sets.join(h as u32 / 3, p / 3);
            }
        }
        sets.labels()
    }
}

/// Gives every fan of faces at a vertex (faces connected over paired edges) a vertex of its own. Returns how many vertices
/// were added; afterwards no vertex and no edge joins more than one sheet.
pub(crate) fn split_pinched(mesh: &mut TriMesh, topology: &Topology) -> usize {
    let mut fans = DisjointSets::new(topology.partner.len());
    for (h, &p) in topology.partner.iter().enumerate() {
        if p == NONE {
            continue;
        }
        // Corner k of a face is where its half-edge k begins.
        let after = |h: u32| 3 * (h / 3) + (h + 1) % 3;
        let (h, start) = (h as u32, ends(mesh, h as u32).0);
        let (same, other) = if ends(mesh, p).0 == start { (p, after(p)) } else { (after(p), p) };
        fans.join(h, same);
        fans.join(after(h), other);
    }
    let mut owner = vec![NONE; mesh.vertices.len()];
    let mut copy = std::collections::BTreeMap::new();
    let before = mesh.vertices.len();
    for corner in 0..topology.partner.len() as u32 {
        let fan = fans.find(corner);
        let v = &mut mesh.faces[corner as usize / 3][corner as usize % 3];
        let first = &mut owner[*v as usize];
        if *first == NONE {
            *first = fan;
        }
        if *first != fan {
            let old = *v;
            *v = *copy.entry(fan).or_insert_with(|| {
                mesh.vertices.push(mesh.vertices[old as usize]);
                mesh.vertices.len() as u32 - 1
            });
        }
    }
    mesh.vertices.len() - before
}

/// The boundary of an open mesh as closed loops of vertices, each to be walked so that a cap on it winds like the mesh.
///
/// Every edge counts with its net direction (faces that run along it one way minus the other way). That sum is a
/// cycle whatever the mesh looks like (the boundary of a boundary is empty), so the edges always form closed loops.
pub(crate) fn boundary_loops(mesh: &TriMesh) -> Vec<Vec<u32>> {
    let mut out: std::collections::BTreeMap<u32, Vec<u32>> = std::collections::BTreeMap::new();
    for group in edges(mesh).chunk_by(|a, b| a.0 == b.0) {
        let (lo, hi) = ((group[0].0 >> 32) as u32, group[0].0 as u32);
        let net: i64 = group.iter().map(|&(_, h)| if ends(mesh, h).0 == lo { 1 } else { -1 }).sum();
        // The cap runs against the mesh.
        let (from, to) = if net > 0 { (hi, lo) } else { (lo, hi) };
        for _ in 0..net.abs() {
            out.entry(from).or_default().push(to);
        }
    }
    // Smallest vertex first out, whatever the order of the faces.
    for next in out.values_mut() {
        next.sort_unstable_by(|a, b| b.cmp(a));
    }
    let mut loops = Vec::new();
    let mut position = std::collections::BTreeMap::new();
    while let Some((&start, _)) = out.first_key_value() {
        let mut path = vec![start];
        position.clear();
        position.insert(start, 0);
        while let Some(&here) = path.last() {
            let Some(next) = out.get_mut(&here) else { break };
            let Some(to) = next.pop() else { break };
            if next.is_empty() {
                out.remove(&here);
            }
            if let Some(&at) = position.get(&to) {
                // Back on the path: cut the loop off and go on from there.
                let cycle: Vec<u32> = path.drain(at + 1..).collect();
                for v in &cycle {
                    position.remove(v);
                }
                loops.push(std::iter::once(to).chain(cycle).collect());
                if path.len() == 1 && !out.contains_key(&to) {
                    break;
                }
            } else {
                position.insert(to, path.len());
                path.push(to);
            }
        }
    }
    loops
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, joined};

    #[test]
    fn a_box_is_one_closed_shell() {
        let t = Topology::new(&cuboid([0.0; 3], [1.0; 3]));
        assert_eq!((t.open_edges, t.crowded_edges, t.misaligned, t.shells().1), (0, 0, 0, 1));
    }

    #[test]
    fn stacked_boxes_with_a_common_face_stay_two_shells() {
        let two = joined(&[cuboid([0.0; 3], [1.0; 3]), cuboid([0.0, 0.0, 1.0], [1.0, 1.0, 2.0])]);
        let welded = crate::weld::weld(&two, 1e-9).0;
        assert_eq!(welded.vertices.len(), 12);
        let t = Topology::new(&welded);
        // The four edges of the common face and its diagonal.
        assert_eq!((t.open_edges, t.crowded_edges, t.shells().1), (0, 5, 2));
    }

    #[test]
    fn the_rim_of_an_open_box_is_one_loop() {
        let mut m = cuboid([0.0; 3], [1.0; 3]);
        m.faces.drain(2..4); // the top
        assert_eq!(Topology::new(&m).open_edges, 4);
        let loops = boundary_loops(&m);
        assert_eq!(loops.len(), 1);
        assert_eq!(loops[0].len(), 4);
    }
}
