//! Convex pieces that together cover a solid, for collision.

use std::collections::BTreeSet;

use nalgebra::Point3;

use drex_core::TriMesh;
use parry3d_f64::math::Vector;
use parry3d_f64::transformation::vhacd::{VHACD, VHACDParameters};
use parry3d_f64::transformation::voxelization::{Voxel, VoxelSet};

use crate::boundary::boundary;
use crate::bvh::Bvh;
use crate::hull::{convex_hull, convex_hull_with_at_most, hull_volume};
use crate::repair::{Shell, describe_shells};
use crate::solid::Enclosed;
use crate::topology::Topology;
use crate::{Error, Result};

/// Settings of [`convex_pieces`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PieceOptions {
    /// A solid whose convex hull is at most this much larger in volume is one hull.
    pub convex_enough: f64,
    /// Pieces at most (closed convex shells of the mesh itself are kept beyond it).
    pub most_pieces: usize,
    /// Corners per piece at most. The pieces then lie inside their full hulls.
    pub most_corners: usize,
    /// Two pieces become one when their common hull adds no more than this share of the solid's volume.
    pub merge_excess: f64,
    /// Voxels along the longest side in the decomposition.
    pub resolution: u32,
}

impl Default for PieceOptions {
    fn default() -> Self {
        Self { convex_enough: 0.05, most_pieces: 32, most_corners: 64, merge_excess: 0.004, resolution: 64 }
    }
}

/// Pieces smaller than this are slivers that engines refuse, m³.
const SLIVER_M3: f64 = 1e-12;

/// How the pieces were obtained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum HowDivided {
    /// One hull: the solid is nearly convex.
    Hull,
    /// The mesh consists of closed convex shells, each is a piece.
    Shells,
    /// Approximate convex decomposition (V-HACD), then merging.
    Decomposed,
    /// The decomposition failed; one hull stands in, with its concavities filled.
    HullAsLastResort,
}

/// Covers the solid that `mesh` encloses with convex pieces.
///
/// In this order: one hull if the solid is nearly convex; the shells themselves where they are closed and convex;
/// V-HACD for the rest, its parts cut exactly along the surface and merged where that costs little volume. Openings are
/// closed by flat lids first. Every piece is a closed hull with at least 4 and at most
/// [`PieceOptions::most_corners`] corners; slivers below 1e-12 m³ are dropped.
///
/// # Errors
/// If the mesh encloses no volume, or an option is out of range.
pub fn convex_pieces(mesh: &TriMesh, options: &PieceOptions) -> Result<Vec<TriMesh>> {
    Ok(divide(mesh, &Enclosed::new(mesh)?, options)?.0)
}

pub(crate) fn divide(
    mesh: &TriMesh,
    enclosed: &Enclosed,
    options: &PieceOptions,
) -> Result<(Vec<TriMesh>, HowDivided)> {
    if options.most_corners < 4 || options.most_pieces == 0 || !(8..=512).contains(&options.resolution) {
        return Err(Error::value(
            "the options for convex pieces are out of range",
            "allow 4 or more corners, 1 or more pieces and 8 to 512 voxels along the longest side",
        ));
    }
    let volume = enclosed.solid.volume_m3;
    let bounded = |points: &[Point3<f64>]| convex_hull_with_at_most(points, options.most_corners);
    let whole = convex_hull(&mesh.vertices)?;
    if hull_volume(&whole) <= (1.0 + options.convex_enough) * volume {
        return Ok((vec![bounded(&whole.vertices)?], HowDivided::Hull));
    }

    let topology = Topology::new(mesh);
    let (labels, count) = topology.shells();
    let shells = describe_shells(mesh, &topology, &labels, count);
    let mut pieces = Vec::new();
    let mut rest = Vec::new();
    for shell in &shells {
        match convex_shell(mesh, shell, options.convex_enough) {
            Some(hull) => pieces.push(hull),
            // A cavity belongs to the shell around it.
            None => rest.extend_from_slice(&shell.faces),
        }
    }
    let mut how = HowDivided::Shells;
    if !rest.is_empty() {
        // With cavities or openings a single shell says nothing about the solid: then all goes in.
        let cavities = shells.iter().any(|s| s.volume_m3 < 0.0);
        let part = if enclosed.capped.openings > 0 {
            pieces.clear();
            // Without the parts of ragged lids that lie outside the solid.
            boundary(&enclosed.capped.mesh, &Bvh::new(&enclosed.capped.mesh), true).mesh()
        } else if cavities || pieces.is_empty() {
            pieces.clear();
            mesh.clone()
        } else {
            TriMesh { vertices: mesh.vertices.clone(), faces: rest.iter().map(|&f| mesh.faces[f as usize]).collect() }
        };
        match decompose(&part, options.resolution).or_else(|| decompose(&part, options.resolution / 2)) {
            Some(parts) => {
                let budget = options.most_pieces.saturating_sub(pieces.len()).max(1);
                pieces.extend(merged(parts, volume, options.merge_excess, budget)?);
                how = HowDivided::Decomposed;
            }
            None => {
                tracing::warn!("the convex decomposition failed: the hull of the whole object stands in");
                pieces = vec![whole];
                how = HowDivided::HullAsLastResort;
            }
        }
    }
    let mut out = Vec::with_capacity(pieces.len());
    for piece in pieces {
        let piece = bounded(&piece.vertices)?;
        if hull_volume(&piece) > SLIVER_M3 {
            out.push(piece);
        }
    }
    Ok((out, how))
}

/// The hull of a shell that is closed, wound outwards and nearly convex.
fn convex_shell(mesh: &TriMesh, shell: &Shell, convex_enough: f64) -> Option<TriMesh> {
    if !shell.closed || !(shell.volume_m3 > 0.0) {
        return None;
    }
    let points: Vec<_> = shell.faces.iter().flat_map(|&f| mesh.triangle(f as usize)).collect();
    let hull = convex_hull(&points).ok()?;
    (hull_volume(&hull) <= (1.0 + convex_enough) * shell.volume_m3).then_some(hull)
}

/// Full hulls of the parts that V-HACD finds (Mamou and Ghorbel 2009); `None` if it fails.
fn decompose(mesh: &TriMesh, resolution: u32) -> Option<Vec<TriMesh>> {
    let points: Vec<Vector> = mesh.vertices.iter().map(|p| Vector::new(p.x, p.y, p.z)).collect();
    let parameters = VHACDParameters {
        resolution,
        concavity: 0.0025,
        convex_hull_downsampling: 4,
        plane_downsampling: 4,
        max_convex_hulls: 64,
        ..VHACDParameters::default()
    };
    // Its inner hulls assert on some inputs; that must not take the program down.
    let parts = std::panic::catch_unwind(|| {
        let voxels = VoxelSet::voxelize(&points, &mesh.faces, resolution, parameters.fill_mode, true);
        let place = |v: &Voxel| [v.coords.x, v.coords.y, v.coords.z];
        let surface: BTreeSet<_> = voxels.voxels().iter().filter(|v| v.is_on_surface).map(place).collect();
        let found = VHACD::from_voxels(&parameters, voxels);
        let mut parts = found.compute_primitive_intersections(&points, &mesh.faces);
        for (part, set) in parts.iter_mut().zip(found.voxel_parts()) {
            // A part is bounded by the surface and by cuts through the inside, where there are only voxels.
            for voxel in set.voxels().iter().filter(|v| !surface.contains(&place(v))) {
                let middle = set.get_voxel_point(voxel);
                for corner in 0..8 {
                    let side = |axis: u32| if corner >> axis & 1 == 0 { -0.5 } else { 0.5 };
                    part.push(middle + Vector::new(side(0), side(1), side(2)) * set.scale);
                }
            }
        }
        parts
    })
    .ok()?;
    let hulls: Vec<TriMesh> = parts
        .iter()
        .filter_map(|part| {
            let points: Vec<_> = part.iter().map(|v| Point3::new(v.x, v.y, v.z)).collect();
            convex_hull(&points).ok()
        })
        .filter(|h| hull_volume(h) > SLIVER_M3)
        .collect();
    (!hulls.is_empty()).then_some(hulls)
}

/// Merges the pair whose common hull adds the least volume, while that is little or there are too many pieces.
fn merged(mut parts: Vec<TriMesh>, volume: f64, excess: f64, most: usize) -> Result<Vec<TriMesh>> {
    let join = |a: &TriMesh, b: &TriMesh| -> Result<(f64, TriMesh)> {
        let points: Vec<_> = a.vertices.iter().chain(&b.vertices).copied().collect();
        let hull = convex_hull(&points)?;
        Ok((hull_volume(&hull) - hull_volume(a) - hull_volume(b), hull))
    };
    let mut costs: Vec<Vec<f64>> = Vec::new();
    for i in 0..parts.len() {
        costs.push((0..i).map(|j| join(&parts[i], &parts[j]).map(|c| c.0)).collect::<Result<_>>()?);
    }
    while parts.len() > 1 {
        let mut best = (f64::INFINITY, 0, 0);
        for (i, row) in costs.iter().enumerate() {
            for (j, &c) in row.iter().enumerate() {
                if c < best.0 {
                    best = (c, i, j);
                }
            }
        }
        let (cost, i, j) = best;
        if cost > excess * volume && parts.len() <= most {
            break;
        }
        let (_, hull) = join(&parts[i], &parts[j])?;
        parts[j] = hull;
        parts.remove(i);
        costs.remove(i);
        for row in costs.iter_mut().skip(i) {
            row.remove(i);
        }
        for k in 0..parts.len() {
            if k != j {
                costs[k.max(j)][k.min(j)] = join(&parts[k], &parts[j])?.0;
            }
        }
    }
    Ok(parts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, flipped, joined, sphere};

    #[test]
    fn a_nearly_convex_mesh_is_one_hull_of_few_corners() {
        let pieces = convex_pieces(&sphere(0.05, 4), &PieceOptions::default()).unwrap();
        assert_eq!((pieces.len(), pieces[0].vertices.len()), (1, 64));
    }

    #[test]
    fn boxes_of_a_letter_are_its_pieces() {
        let t =
            joined(&[cuboid([-0.05, 0.0, 0.0], [0.05, 0.02, 0.03]), cuboid([-0.01, -0.06, 0.0], [0.01, 0.0, 0.03])]);
        let pieces = convex_pieces(&t, &PieceOptions::default()).unwrap();
        assert_eq!(pieces.iter().map(|p| p.vertices.len()).collect::<Vec<_>>(), [8, 8]);
    }

    #[test]
    fn a_bowl_stays_hollow() {
        // A box with a smaller box taken out of its top: walls 10 mm.
        let outer = cuboid([0.0; 3], [0.1, 0.1, 0.06]);
        let inner = flipped(&cuboid([0.01, 0.01, 0.01], [0.09, 0.09, 0.06]));
        let mut bowl = joined(&[outer, inner]);
        bowl.faces.drain(14..16); // the lid of the inner box
        bowl.faces.drain(2..4); // the lid of the outer one
        for (a, b) in [(4, 5), (5, 7), (7, 6), (6, 4)] {
            bowl.faces.extend([[a, b, b + 8], [a, b + 8, a + 8]]);
        }
        let solid = crate::solid_properties(&bowl).unwrap();
        let truth = 0.1 * 0.1 * 0.06 - 0.08 * 0.08 * 0.05;
        assert!(solid.closed && (solid.volume_m3 - truth).abs() < 1e-12, "{solid:?}");
        let pieces = convex_pieces(&bowl, &PieceOptions::default()).unwrap();
        let sum: f64 = pieces.iter().map(hull_volume).sum();
        assert!(pieces.len() >= 5 && sum < 1.2 * truth && sum > 0.95 * truth, "{} pieces, {sum} {truth}", pieces.len());
        assert_eq!(pieces, convex_pieces(&bowl, &PieceOptions::default()).unwrap());
    }

    #[test]
    fn options_out_of_range_are_refused() {
        let options = PieceOptions { most_corners: 3, ..PieceOptions::default() };
        assert!(convex_pieces(&sphere(0.05, 2), &options).is_err());
    }
}
