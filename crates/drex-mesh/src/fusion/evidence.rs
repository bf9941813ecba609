//! What is known of a surface, vertex by vertex: of meshes that were made of a fused one, and as a file.

use std::path::Path;

use drex_core::TriMesh;
use drex_core::fsutil::write_atomic;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Evidence, EvidenceKind, Fused};
use crate::bvh::Bvh;
use crate::{Error, Result};

impl Fused {
    /// What is known of the vertices of a mesh that was made of this one, by moving or decimation: of each, what is known of the nearest vertex
    /// here, among those of the nearest face.
    pub fn evidence_of(&self, mesh: &TriMesh) -> Vec<Evidence> {
        const UNSEEN: Evidence = Evidence { views: 0, best_cosine: 0.0, kind: EvidenceKind::Unseen };
        let tree = Bvh::new(&self.mesh);
        let of = |p| {
            let face = self.mesh.faces[tree.nearest(p, f64::INFINITY)?.face as usize];
            let away = |v: &u32| (self.mesh.vertices[*v as usize] - p).norm_squared();
            let nearest = face.into_iter().min_by(|a, b| away(a).total_cmp(&away(b)))?;
            self.evidence.get(nearest as usize).copied()
        };
        mesh.vertices.par_iter().map(|p| of(p).unwrap_or(UNSEEN)).collect()
    }
}

/// Shares of the area of a mesh by where its surface comes from; their sum is 1.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct SurfaceShares {
    /// Measured.
    pub measured: f64,
    /// Shown by surfels alone.
    pub surfels: f64,
    /// Seen by nobody: where silhouettes, or what else was measured, let the object end.
    pub silhouettes: f64,
    /// Where it stands.
    pub support: f64,
}

impl SurfaceShares {
    /// Of a mesh with what is known of each vertex; a face counts a third for each corner.
    pub fn of(mesh: &TriMesh, evidence: &[Evidence]) -> Self {
        let (mut shares, mut whole) = (Self::default(), 0.0);
        for (f, face) in mesh.faces.iter().enumerate() {
            let [a, b, c] = mesh.triangle(f);
            let third = (b - a).cross(&(c - a)).norm() / 6.0;
            for known in face.iter().filter_map(|v| evidence.get(*v as usize)) {
                whole += third;
                *match known.kind {
                    EvidenceKind::Seen => &mut shares.measured,
                    EvidenceKind::Surfels => &mut shares.surfels,
                    EvidenceKind::Unseen => &mut shares.silhouettes,
                    EvidenceKind::Support => &mut shares.support,
                } += third;
            }
        }
        let share = |area: f64| if whole > 0.0 { area / whole } else { 0.0 };
        Self {
            measured: share(shares.measured),
            surfels: share(shares.surfels),
            silhouettes: share(shares.silhouettes),
            support: share(shares.support),
        }
    }
}

/// Writes a mesh with what is known of each vertex as a binary PLY: `evidence` (0 measured, 1 seen by nobody, 2 the cut at the support, 3 shown by
/// surfels), `views` that measured the surface there and their `best_cosine`, and a colour that shows the first: grey, orange, blue, green.
///
/// # Errors
/// If there is not one entry per vertex, or the file cannot be written; an old one stays.
pub fn write_evidence(path: &Path, mesh: &TriMesh, evidence: &[Evidence]) -> Result<()> {
    if evidence.len() != mesh.vertices.len() {
        return Err(Error::value(
            format!("evidence of {} vertices for {}", evidence.len(), mesh.vertices.len()),
            "give one entry per vertex",
        ));
    }
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\ncomment evidence: 0 measured, 1 seen by nobody, 2 cut at the support, 3 shown by surfels\nelement vertex {}\n\
         property double x\nproperty double y\nproperty double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
         property uchar evidence\nproperty ushort views\nproperty float best_cosine\n\
         element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.vertices.len(),
        mesh.faces.len()
    )
    .into_bytes();
    for (vertex, Evidence { views, best_cosine, kind }) in mesh.vertices.iter().zip(evidence) {
        vertex.iter().for_each(|c| bytes.extend(c.to_le_bytes()));
        let (color, kind) = match kind {
            EvidenceKind::Seen => ([190, 190, 190], 0),
            EvidenceKind::Unseen => ([240, 140, 30], 1),
            EvidenceKind::Support => ([60, 110, 200], 2),
            EvidenceKind::Surfels => ([110, 170, 80], 3),
        };
        bytes.extend(color);
        bytes.push(kind);
        bytes.extend(views.to_le_bytes());
        bytes.extend(best_cosine.to_le_bytes());
    }
    for face in &mesh.faces {
        bytes.push(3);
        face.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    Ok(write_atomic(path, &bytes)?)
}
