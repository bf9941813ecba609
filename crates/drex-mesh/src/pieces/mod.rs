//! Convex pieces that together cover a solid, for collision.

mod coarse;
mod corners;
mod cut;
mod part;
mod probe;
mod score;
mod tree;

use nalgebra::Point3;

use drex_core::{Surface, TriMesh};

use crate::hull::{convex_hull, hull_volume};
use crate::repair::{Shell, describe_shells, weld};
use crate::sdf::MeshSdf;
use crate::solid::Enclosed;
use crate::topology::Topology;
use crate::{Error, Result};

pub use score::{UnionDistance, union_distance};

use coarse::coarse;
use corners::bounded_hull;
use cut::Scene;
use part::Part;
use tree::Division;

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
    /// A piece may fill a hollow this deep, as a share of the diagonal of the mesh's bounding box.
    pub concavity: f64,
}

impl Default for PieceOptions {
    fn default() -> Self {
        Self { convex_enough: 0.05, most_pieces: 32, most_corners: 64, concavity: 0.0075 }
    }
}

/// Pieces smaller than this are slivers that engines refuse, m³.
const SLIVER_M3: f64 = 1e-12;
/// Points of the surface at which filled hollows are measured.
const PROBES: usize = 4000;

/// How often parts are cut and joined anew.
const ROUNDS: usize = 2;
/// Vertices of the surface at most while cuts are searched.
const COARSE: usize = 2500;

/// How the pieces were obtained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum HowDivided {
    /// One hull: the solid is nearly convex.
    Hull,
    /// The mesh consists of closed convex shells, each is a piece.
    Shells,
    /// Cut by planes into nearly convex parts.
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
    if options.most_corners < 4 || options.most_pieces == 0 || !(1e-6..=1.0).contains(&options.concavity) {
        return Err(Error::value(
            "the options for convex pieces are out of range",
            "allow 4 or more corners, 1 or more pieces and a concavity of 1e-6 to 1",
        ));
    }
    let volume = enclosed.solid.volume_m3;
    let bounded = |points: &[Point3<f64>]| bounded_hull(points, options.most_corners);
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
            mesh.clone()
        } else if cavities || pieces.is_empty() {
            pieces.clear();
            mesh.clone()
        } else {
            TriMesh { vertices: mesh.vertices.clone(), faces: rest.iter().map(|&f| mesh.faces[f as usize]).collect() }
        };
        let budget = options.most_pieces.saturating_sub(pieces.len()).max(1);
        match decompose(&part, enclosed.whole, options, budget) {
            Some(parts) => {
                pieces.extend(parts);
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

/// Cuts the solid into parts and joins what fits together; `None` if it has no surface.
fn decompose(mesh: &TriMesh, whole: bool, options: &PieceOptions, most: usize) -> Option<Vec<TriMesh>> {
    let solid = if whole { MeshSdf::of_whole(mesh.clone()) } else { MeshSdf::new(mesh) }.ok()?;
    let (lo, hi) = solid.bounds();
    let size = (hi - lo).norm();
    let surface = weld(solid.boundary(), 1e-9 * size).0;
    let t = std::time::Instant::now();
    let scene = Scene::new(solid, &surface, PROBES, options.concavity * size).ok()?;
    eprintln!("scene {:?}", t.elapsed());
    let whole = Part::whole(coarse(&surface, COARSE))?;
    eprintln!(
        "surface {} {} coarse {} {}",
        surface.vertices.len(),
        surface.faces.len(),
        whole.surface.vertices.len(),
        whole.surface.faces.len()
    );
    let t = std::time::Instant::now();
    let mut division = Division::new(&scene, whole);
    division.split(2 * most - 1);
    eprintln!("split cost {:e} pieces {} {:?}", division.cost(), division.pieces(), t.elapsed());
    division.merge(most);
    eprintln!("merge cost {:e} pieces {} {:?}", division.cost(), division.pieces(), t.elapsed());
    division.refine(4);
    eprintln!("refine cost {:e} pieces {} {:?}", division.cost(), division.pieces(), t.elapsed());
    for _ in 0..ROUNDS {
        let mut other = division.clone();
        other.split(most / 4 + 1);
        other.merge(most);
        other.refine(3);
        eprintln!("other cost {:e} pieces {} {:?}", other.cost(), other.pieces(), t.elapsed());
        if other.cost() >= 0.98 * division.cost() {
            break;
        }
        division = other;
    }
    let hulls = division.hulls(surface);
    (!hulls.is_empty()).then_some(hulls)
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
