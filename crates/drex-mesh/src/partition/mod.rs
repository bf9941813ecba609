//! Convex pieces that together cover a solid, for collision.
//!
//! The solid is divided by a tree of planes. A part is what lies in one cell of that tree; its piece is the hull of the
//! surface clipped by the planes. How much free space a hull fills is measured by rays that leave the solid along its
//! normals ([`probe`]): walls between parts cost nothing, a filled hollow costs by the cube of its depth (the aim of Wei et
//! al., "Approximate convex decomposition for 3D meshes with collision-aware concavity and tree search", 2022, with
//! another measure). Cuts are made where they gain most per length ([`cut`]), parts are joined where their common hull costs
//! least, and the planes of the pieces that remain are moved and tilted until nothing is gained ([`tree`]).

mod coarse;
mod corners;
mod cut;
mod part;
mod probe;
mod score;
mod tree;

use nalgebra::Point3;
use rayon::prelude::*;

use drex_core::{ConvexPart, Surface, TriMesh};

use crate::hull::hull_volume;
use crate::orient::Shell;
use crate::primitive::primitive;
use crate::repair::describe_shells;
use crate::sdf::MeshSdf;
use crate::solid::Enclosed;
use crate::topology::Topology;
use crate::weld::weld;
use crate::{Error, Result};
use drex_core::mesh::convex_hull;

pub use score::{UnionDistance, union_distance};

use coarse::coarse;
use corners::bounded_hull;
use cut::Scene;
use part::Part;
use tree::Division;

/// Settings of [`convex_parts`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PartitionOptions {
    /// A solid whose convex hull is at most this much larger in volume is one hull.
    pub convex_enough: f64,
    /// Pieces at most.
    pub most_parts: usize,
    /// Corners per piece at most. A hull with more is replaced by one of that many corners fitted to it.
    pub most_corners: usize,
    /// Parts that fill a hollow deeper than this are cut while there are pieces left, and parts whose common hull stays within
    /// it are joined; as a share of the diagonal of the mesh's bounding box.
    pub concavity: f64,
    /// A part that lies within this of a box, a cylinder, a ball or a capsule is one ([`primitive`](crate::primitive())); as a share of the
    /// radius, or of the smallest half side. 0 recognises none.
    pub primitive_tolerance: f64,
}

impl Default for PartitionOptions {
    fn default() -> Self {
        Self { convex_enough: 0.05, most_parts: 20, most_corners: 64, concavity: 0.0075, primitive_tolerance: 2e-3 }
    }
}

/// Pieces smaller than this are slivers that engines refuse, m³.
const SLIVER_M3: f64 = 1e-12;
/// Points of the surface at which filled hollows are measured.
const PROBES: usize = 3000;

/// How often parts are cut and joined anew.
const ROUNDS: usize = 2;
/// Rounds of moving the planes each time.
const REFINEMENTS: usize = 3;
/// Vertices of the surface at most while cuts are searched.
const COARSE: usize = 2500;

/// How the pieces were obtained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum PartitionMethod {
    /// One hull: the solid is nearly convex.
    Hull,
    /// The mesh consists of closed convex shells, each is a piece.
    Shells,
    /// Cut by planes into nearly convex parts.
    Decomposed,
    /// The decomposition failed; one hull stands in, with its concavities filled.
    HullAsLastResort,
}

/// Covers the solid that `mesh` encloses with convex parts, and recognises those that are primitives.
///
/// In this order: one hull if the solid is nearly convex; the shells themselves where they are closed and convex; cuts by
/// planes for the rest. Openings are closed by flat lids first, cavities without an opening are filled. Every piece is a
/// closed hull with at least 4 and at most [`PartitionOptions::most_corners`] corners, and there are never more than
/// [`PartitionOptions::most_parts`]; slivers below 1e-12 m³ are dropped. Neighbours reach over their common cut by 5e-5 of the
/// diagonal of the mesh's box, so that no gap is left. The same mesh and options give the same pieces with any number of
/// threads.
///
/// # Errors
/// If the mesh encloses no volume, or an option is out of range.
pub fn convex_parts(mesh: &TriMesh, options: &PartitionOptions) -> Result<Vec<ConvexPart>> {
    Ok(divide(mesh, &Enclosed::new(mesh)?, options)?.0)
}

pub(crate) fn divide(
    mesh: &TriMesh,
    enclosed: &Enclosed,
    options: &PartitionOptions,
) -> Result<(Vec<ConvexPart>, PartitionMethod)> {
    let in_range = (1e-6..=1.0).contains(&options.concavity) && (0.0..=0.1).contains(&options.primitive_tolerance);
    if options.most_corners < 4 || options.most_parts == 0 || !in_range {
        return Err(Error::value(
            "the options for convex parts are out of range",
            "allow 4 or more corners, 1 or more pieces, a concavity of 1e-6 to 1 and primitives within 0 to 0.1",
        ));
    }
    let topology = Topology::new(mesh);
    let (labels, count) = topology.shells();
    let (cavities, shells): (Vec<Shell>, Vec<Shell>) =
        describe_shells(mesh, &topology, &labels, count).into_iter().partition(|s| s.closed && s.volume_m3 < 0.0);
    let filled = enclosed.solid.volume_m3 - cavities.iter().map(|s| s.volume_m3).sum::<f64>();
    let whole = convex_hull(&mesh.vertices)?;
    let (hulls, how) = if hull_volume(&whole) <= (1.0 + options.convex_enough) * filled {
        (vec![whole], PartitionMethod::Hull)
    } else {
        divide_shells(mesh, enclosed, &shells, options).unwrap_or_else(|| {
            tracing::warn!("the convex decomposition failed: the hull of the whole object stands in");
            (vec![whole], PartitionMethod::HullAsLastResort)
        })
    };
    let part = |full: &TriMesh| {
        let primitive = primitive(full, options.primitive_tolerance);
        let facets = primitive.and_then(|p| p.hull().ok()).filter(|h| h.vertices.len() <= options.most_corners);
        let hull = facets.map_or_else(|| bounded_hull(&full.vertices, options.most_corners), Ok)?;
        Ok(ConvexPart { hull, primitive })
    };
    let parts: Vec<ConvexPart> = hulls.par_iter().map(part).collect::<Result<_>>()?;
    Ok((parts.into_iter().filter(|p| hull_volume(&p.hull) > SLIVER_M3).collect(), how))
}

/// Keeps the shells that are closed and convex and divides the others; `None` if that fails.
fn divide_shells(
    mesh: &TriMesh,
    enclosed: &Enclosed,
    shells: &[Shell],
    options: &PartitionOptions,
) -> Option<(Vec<TriMesh>, PartitionMethod)> {
    let faces = |shells: &[&Shell]| TriMesh {
        vertices: mesh.vertices.clone(),
        faces: shells.iter().flat_map(|s| &s.faces).map(|&f| mesh.faces[f as usize]).collect(),
    };
    let convex: Vec<Option<TriMesh>> = shells.iter().map(|s| convex_shell(mesh, s, options.convex_enough)).collect();
    let kept: Vec<TriMesh> = convex.iter().flatten().cloned().collect();
    let rest: Vec<&Shell> = shells.iter().zip(&convex).filter(|(_, hull)| hull.is_none()).map(|(s, _)| s).collect();
    if rest.is_empty() && kept.len() <= options.most_parts {
        return Some((kept, PartitionMethod::Shells));
    }
    // With openings a single shell says nothing about the solid.
    let all = enclosed.capped.openings > 0 || kept.len() >= options.most_parts;
    let (kept, rest) = if all { (Vec::new(), shells.iter().collect()) } else { (kept, rest) };
    let parts = decompose(&faces(&rest), enclosed.whole, options, options.most_parts - kept.len())?;
    Some((kept.into_iter().chain(parts).collect(), PartitionMethod::Decomposed))
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
fn decompose(mesh: &TriMesh, whole: bool, options: &PartitionOptions, most: usize) -> Option<Vec<TriMesh>> {
    let solid = if whole { MeshSdf::of_whole(mesh.clone()) } else { MeshSdf::new(mesh) }.ok()?;
    let (lo, hi) = solid.bounds();
    let size = (hi - lo).norm();
    let surface = weld(solid.boundary(), 1e-9 * size).0;
    let scene = Scene::new(solid, &surface, PROBES, options.concavity * size).ok()?;
    let mut division = Division::new(&scene, Part::whole(coarse(&surface, COARSE))?);
    division.split(2 * most - 1);
    division.merge(most);
    division.refine(REFINEMENTS);
    for _ in 0..ROUNDS {
        let mut other = division.clone();
        other.split(most / 4 + 1);
        other.merge(most);
        other.refine(REFINEMENTS);
        if !(other.cost() < 0.98 * division.cost()) {
            break;
        }
        division = other;
    }
    let hulls = at_most(division.hulls(surface), most);
    (!hulls.is_empty()).then_some(hulls)
}

/// Joins the smallest hull with the one to which it adds least while there are more than `most`: a part too flat to have a
/// hull in the coarse stand-in may have one in the surface itself.
fn at_most(mut hulls: Vec<TriMesh>, most: usize) -> Vec<TriMesh> {
    while hulls.len() > most.max(1) {
        let volumes: Vec<f64> = hulls.iter().map(hull_volume).collect();
        let Some(i) = (0..hulls.len()).min_by(|&i, &j| volumes[i].total_cmp(&volumes[j])) else { break };
        let small = hulls.swap_remove(i);
        let joined = hulls.iter().enumerate().filter_map(|(k, hull)| {
            let points: Vec<Point3<f64>> = hull.vertices.iter().chain(&small.vertices).copied().collect();
            let both = convex_hull(&points).ok()?;
            Some((hull_volume(&both) - hull_volume(hull), k, both))
        });
        let Some((_, k, both)) = joined.min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        hulls[k] = both;
    }
    hulls
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, flipped, joined, sphere};

    #[test]
    fn a_nearly_convex_mesh_is_one_hull_of_few_corners() {
        let pieces = convex_parts(&sphere(0.05, 4), &PartitionOptions::default()).unwrap();
        assert_eq!((pieces.len(), pieces[0].corners().len()), (1, 64));
        assert!(matches!(pieces[0].primitive.unwrap().shape, drex_core::PrimitiveShape::Sphere { .. }));
    }

    #[test]
    fn boxes_of_a_letter_are_its_pieces() {
        let t =
            joined(&[cuboid([-0.05, 0.0, 0.0], [0.05, 0.02, 0.03]), cuboid([-0.01, -0.06, 0.0], [0.01, 0.0, 0.03])]);
        let pieces = convex_parts(&t, &PartitionOptions::default()).unwrap();
        assert_eq!(pieces.iter().map(|p| p.corners().len()).collect::<Vec<_>>(), [8, 8]);
        let boxed =
            |p: &ConvexPart| matches!(p.primitive, Some(p) if matches!(p.shape, drex_core::PrimitiveShape::Box { .. }));
        assert!(pieces.iter().all(boxed));
    }

    #[test]
    fn hulls_beyond_the_number_allowed_join_their_neighbours() {
        let row = |x: f64| cuboid([x, 0.0, 0.0], [x + 0.02, 0.02, 0.02]);
        let mut hulls = vec![row(0.0), row(0.02), row(0.3)];
        hulls.push(cuboid([0.04, 0.0, 0.0], [0.041, 0.02, 0.02]));
        let joined = at_most(hulls, 3);
        assert_eq!(joined.len(), 3);
        let volume: f64 = joined.iter().map(hull_volume).sum();
        assert!((volume - (3.0 * 8e-6 + 0.4e-6)).abs() < 1e-12, "{volume}");
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
        let pieces = convex_parts(&bowl, &PartitionOptions::default()).unwrap();
        let sum: f64 = pieces.iter().map(|p| hull_volume(&p.hull)).sum();
        assert!(pieces.len() >= 5 && sum < 1.2 * truth && sum > 0.95 * truth, "{} pieces, {sum} {truth}", pieces.len());
        assert_eq!(pieces, convex_parts(&bowl, &PartitionOptions::default()).unwrap());
    }

    #[test]
    fn options_out_of_range_are_refused() {
        let options = PartitionOptions { most_corners: 3, ..PartitionOptions::default() };
        assert!(convex_parts(&sphere(0.05, 2), &options).is_err());
    }
}
