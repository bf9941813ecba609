//! The parts of an extracted surface: which stay, which are dropped, which hollows are filled.

use serde::{Deserialize, Serialize};

use drex_core::TriMesh;
use drex_core::sets::DisjointSets;

use super::marching::{Extracted, GridEdge};
use crate::topology::NONE;

/// A part of the surface that was dropped.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct DroppedPart {
    /// Its volume, m³.
    pub volume_m3: f64,
    /// Its faces.
    pub faces: usize,
    /// Mean of its vertices, metres.
    pub center_m: [f64; 3],
    /// Whether it was dropped because nothing of its surface was measured.
    pub unseen: bool,
}

/// Dropped parts that are listed.
const LISTED: usize = 16;

/// What was done.
pub(super) struct Cleaned {
    pub parts: usize,
    pub dropped_parts: usize,
    pub dropped: Vec<DroppedPart>,
    pub filled_hollows: usize,
}

#[derive(Clone, Default)]
struct Part {
    volume: f64,
    faces: usize,
    vertices: usize,
    sum: nalgebra::Vector3<f64>,
    /// Sum over the vertices of the views that measured them.
    views: f64,
}

/// Parts with this share of the largest one's volume stay, however few views measured them.
const LARGE: f64 = 0.1;

/// Keeps the parts of which some of the `views` measured something, whose volume is at least `volume_share` of the largest such part, and which are
/// large or were measured by `views_share` of its views, in the mean over their vertices.
///
/// Every part is closed, so a part with negative volume is the wall of a hollow.
pub(super) fn clean(
    extracted: &mut Extracted,
    volume_share: f64,
    views_share: f64,
    views: impl Fn(&GridEdge) -> u16,
) -> Cleaned {
    let mesh = &mut extracted.mesh;
    let mut sets = DisjointSets::new(mesh.vertices.len());
    for f in &mesh.faces {
        sets.join(f[0], f[1]);
        sets.join(f[0], f[2]);
    }
    let (labels, count) = sets.labels();
    let mut parts = vec![Part::default(); count];
    for f in 0..mesh.faces.len() {
        let part = &mut parts[labels[mesh.faces[f][0] as usize] as usize];
        part.volume += cone(mesh, f);
        part.faces += 1;
    }
    for (v, &label) in labels.iter().enumerate() {
        let part = &mut parts[label as usize];
        part.vertices += 1;
        part.sum += mesh.vertices[v].coords;
        part.views += f64::from(views(&extracted.edges[v]));
    }
    let mut measured = parts.iter().filter(|p| p.views > 0.0);
    let largest = measured.next().map(|first| measured.fold(first, |a, b| if b.volume > a.volume { b } else { a }));
    let Part { volume: most, views: best, vertices: of, .. } = largest.cloned().unwrap_or_default();
    let stays = |p: &Part| {
        let seen_well = || p.views / p.vertices as f64 >= views_share * best / of as f64;
        p.views > 0.0 && p.volume > 0.0 && p.volume >= volume_share * most && (p.volume >= LARGE * most || seen_well())
    };
    let mut dropped: Vec<DroppedPart> = parts
        .iter()
        .filter(|p| p.volume > 0.0 && !stays(p))
        .map(|p| DroppedPart {
            volume_m3: p.volume,
            faces: p.faces,
            center_m: (p.sum / p.vertices as f64).into(),
            unseen: p.views == 0.0,
        })
        .collect();
    dropped.sort_by(|a, b| b.volume_m3.total_cmp(&a.volume_m3));
    let dropped_parts = dropped.len();
    dropped.truncate(LISTED);
    let cleaned = Cleaned {
        parts: parts.iter().filter(|p| stays(p)).count(),
        dropped_parts,
        dropped,
        filled_hollows: parts.iter().filter(|p| p.volume <= 0.0).count(),
    };
    if cleaned.parts < parts.len() {
        let keep: Vec<bool> = labels.iter().map(|&l| stays(&parts[l as usize])).collect();
        retain(extracted, &keep);
    }
    cleaned
}

/// Volume enclosed by a closed mesh, m³.
pub(super) fn volume(mesh: &TriMesh) -> f64 {
    (0..mesh.faces.len()).map(|f| cone(mesh, f)).sum()
}

/// Signed volume of the tetrahedron of a face and the first vertex: any point will do for closed parts, a near one keeps
/// the digits.
fn cone(mesh: &TriMesh, face: usize) -> f64 {
    let [a, b, c] = mesh.triangle(face).map(|p| p - mesh.vertices[0]);
    a.dot(&b.cross(&c)) / 6.0
}

/// Keeps the vertices that are marked, with the faces between them.
fn retain(extracted: &mut Extracted, keep: &[bool]) {
    let mut number = vec![NONE; keep.len()];
    for (next, (v, _)) in keep.iter().enumerate().filter(|k| *k.1).enumerate() {
        number[v] = next as u32;
    }
    let marked = |v: usize| number[v] != NONE;
    let mesh = &mut extracted.mesh;
    mesh.faces.retain(|f| marked(f[0] as usize));
    mesh.faces.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
    let mut v = 0;
    mesh.vertices.retain(|_| (marked(v), v += 1).0);
    v = 0;
    extracted.edges.retain(|_| (marked(v), v += 1).0);
}
