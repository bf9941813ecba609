//! Which solid a mesh encloses: volume, centre of mass, inertia, and how far the answer depends on closing openings.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::Serialize;

use drex_core::{MassProperties, TriMesh};

use crate::boundary::{Moments, boundary};
use crate::bvh::Bvh;
use crate::caps::{Capped, cap};
use crate::sequence::unit_cube_point;
use crate::topology::Topology;
use crate::{Error, Result};

/// Points at which the solid of an open surface is sampled.
const SAMPLES: usize = 1 << 16;
/// An open surface whose lids would be more than this share of its boundary is called a sheet, not a solid.
const LARGEST_LID_SHARE: f64 = 0.45;

/// How the boundary of the solid was obtained from the mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ClosingMethod {
    /// The mesh is closed and nothing overlaps (shells may touch): exact integrals over its faces.
    Exact,
    /// The mesh is closed, but its shells overlap or it crosses itself: the solid is the union, hidden parts of
    /// faces do not count.
    Union,
    /// The mesh is open: the solid is where its generalised winding number exceeds 1/2, as if by flat lids.
    WindingNumber,
}

/// The solid that a mesh encloses.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Solid {
    /// Mass properties at a density of 1 kg/m³: the mass is the volume, the inertia per unit density (m⁵).
    pub properties: MassProperties,
    /// Volume, m³.
    pub volume_m3: f64,
    /// Whether every edge has a face on both sides.
    pub closed: bool,
    /// How the boundary was obtained.
    pub closing_method: ClosingMethod,
    /// Edges without a face on the other side.
    pub open_edges: usize,
    /// Openings (closed chains of such edges).
    pub openings: usize,
    /// Distance across the widest opening, metres.
    pub widest_opening_m: f64,
    /// Share of the boundary that is lids over openings.
    pub lid_area_share: f64,
    /// How far two ways of closing differ: the volume inside only one of {winding number > 1/2} and the mesh with
    /// fans over its openings, relative to the volume. 0 for a closed mesh.
    pub closing_spread: f64,
    /// Share of a closed mesh's area that lies inside the solid (overlaps, inner walls); 0 for an open one, where it is
    /// not measured.
    pub hidden_area_share: f64,
    /// Pieces of surface connected over edges.
    pub shells: usize,
}

/// Finds the solid that `mesh` encloses and integrates it.
///
/// The mesh should be welded and wound outwards ([`crate::repair()`] does both). The solid is where the generalised
/// winding number (Jacobson et al. 2013) exceeds 1/2: overlaps count once, shells wound inwards are cavities,
/// openings get flat lids. Closed meshes are integrated over the exact boundary; for open ones the exact integral with
/// fans over the openings is corrected by the volume between the fans and the level set 1/2, sampled at 65,536 points.
///
/// # Errors
/// If the mesh has no triangles or encloses no volume (flat, or a sheet whose lids would be as large as itself).
pub fn solid_properties(mesh: &TriMesh) -> Result<Solid> {
    Ok(Enclosed::new(mesh)?.solid)
}

/// The solid together with the closed mesh it was found with.
#[derive(Debug, Clone)]
pub(crate) struct Enclosed {
    pub solid: Solid,
    pub capped: Capped,
    /// Whether the mesh is closed and every face of it bounds the solid once.
    pub whole: bool,
}

impl Enclosed {
    pub fn new(mesh: &TriMesh) -> Result<Self> {
        let (capped, tree) = close(mesh)?;
        let topology = Topology::new(mesh);
        let no_volume = |reason: String| Error::NoVolume { subject: "the mesh".into(), reason };
        let area = mesh.area();
        let lid_area_share = capped.lid_area_m2 / (capped.lid_area_m2 + area);
        if lid_area_share > LARGEST_LID_SHARE {
            return Err(no_volume(format!(
                "it is a sheet: lids over its {} open edges would be {:.0} % of the surface",
                topology.open_edges,
                100.0 * lid_area_share
            )));
        }
        let mut whole = false;
        let (properties, closing_method, hidden_area_share, closing_spread) = if capped.openings == 0 {
            let boundary = boundary(&capped.mesh, &tree, false);
            whole = boundary.whole;
            let (properties, how) = if boundary.whole || boundary.simple {
                (capped.mesh.mass_properties(1.0).ok(), ClosingMethod::Exact)
            } else {
                (boundary.mass_properties(), ClosingMethod::Union)
            };
            (properties, how, boundary.hidden_area_share, 0.0)
        } else {
            let (properties, differing) = integrate_open(&capped, &tree);
            let spread = properties.map_or(0.0, |p| differing / p.mass_kg);
            (properties, ClosingMethod::WindingNumber, 0.0, spread)
        };
        let properties = properties
            .ok_or_else(|| no_volume(format!("its faces cancel, {} of its edges are open", topology.open_edges)))?;
        // 1 for a ball; a sheet of paper has 1e-3.
        let fullness = properties.mass_kg * 6.0 * std::f64::consts::PI.sqrt() / area.powf(1.5);
        if !(fullness > 1e-6) {
            return Err(no_volume(format!("{:.3e} m³ inside {area:.3e} m² of surface", properties.mass_kg)));
        }
        let solid = Solid {
            properties,
            volume_m3: properties.mass_kg,
            closed: topology.open_edges == 0,
            closing_method,
            open_edges: topology.open_edges,
            openings: capped.openings,
            widest_opening_m: capped.widest_m,
            lid_area_share,
            closing_spread,
            hidden_area_share,
            shells: topology.shells().1,
        };
        Ok(Self { solid, capped, whole })
    }
}

/// Closes the openings and builds a tree over all faces.
pub(crate) fn close(mesh: &TriMesh) -> Result<(Capped, Bvh)> {
    if mesh.faces.is_empty() {
        return Err(Error::Empty { subject: "the mesh".into() });
    }
    let mesh = TriMesh::new(mesh.vertices.clone(), mesh.faces.clone())?;
    let capped = cap(&mesh);
    let tree = Bvh::cut(&capped.mesh);
    Ok((capped, tree))
}

/// Mass properties at density 1 of {w > 1/2} for the winding number w of an open surface, and the volume on which that
/// solid and the one closed by fans differ.
///
/// With v the winding number of the closed surface, an integer, ∫ f v dV is exact by the divergence theorem, and only
/// ∫ f (H(w - 1/2) - v) dV is sampled: nothing but a film between lid and level set, and folds of the surface.
fn integrate_open(capped: &Capped, tree: &Bvh) -> (Option<MassProperties>, f64) {
    let lids = Bvh::cut_over(&capped.mesh, (capped.surface_faces as u32..capped.mesh.faces.len() as u32).collect());
    let Some((lo, hi)) = capped.mesh.bounds() else { return (None, 0.0) };
    let size = hi - lo;
    let cell = size.product() / SAMPLES as f64;
    let changes: Vec<(Point3<f64>, f64, bool)> = (0..SAMPLES)
        .into_par_iter()
        .filter_map(|i| {
            let p = lo + size.component_mul(&Vector3::from(unit_cube_point(i)));
            let closed = tree.winding(&p);
            let inside = closed - lids.winding(&p) > 0.5;
            let change = f64::from(u8::from(inside)) - closed.round();
            let differs = inside != (closed > 0.5);
            (change != 0.0 || differs).then_some((p, change * cell, differs))
        })
        .collect();
    let mut moments = Moments::about(nalgebra::center(&lo, &hi));
    for f in 0..capped.mesh.faces.len() {
        moments.add_tetrahedron(&capped.mesh.triangle(f), 1.0);
    }
    let mut differing = 0.0;
    for (p, volume, differs) in &changes {
        moments.add_point(p, *volume);
        differing += if *differs { cell } else { 0.0 };
    }
    (moments.mass_properties(), differing)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, flipped, joined, sphere};

    fn close(a: f64, b: f64, relative: f64) {
        assert!((a - b).abs() <= relative * b.abs(), "{a} is not {b} within {relative}");
    }

    #[test]
    fn a_box_is_exact() {
        let s = solid_properties(&cuboid([0.0; 3], [0.1, 0.2, 0.3])).unwrap();
        assert_eq!((s.closing_method, s.closed, s.closing_spread), (ClosingMethod::Exact, true, 0.0));
        close(s.volume_m3, 6e-3, 1e-14);
        close(s.properties.inertia[(0, 0)], 6e-3 / 12.0 * (0.04 + 0.09), 1e-13);
    }

    #[test]
    fn overlapping_boxes_count_their_common_part_once() {
        // Common part [0.06, 0.1] x [0.02, 0.05] x [0.01, 0.04], and one pair that shares two planes.
        let general = joined(&[cuboid([0.0; 3], [0.1, 0.05, 0.04]), cuboid([0.06, 0.02, 0.01], [0.16, 0.08, 0.07])]);
        let s = solid_properties(&general).unwrap();
        assert_eq!(s.closing_method, ClosingMethod::Union);
        close(s.volume_m3, 0.1 * 0.05 * 0.04 + 0.1 * 0.06 * 0.06 - 0.04 * 0.03 * 0.03, 2e-4);
        let flush = joined(&[cuboid([0.0; 3], [0.1, 0.02, 0.03]), cuboid([0.04, -0.06, 0.0], [0.06, 0.01, 0.03])]);
        let s = solid_properties(&flush).unwrap();
        let parts = [
            cuboid([0.0; 3], [0.1, 0.02, 0.03]).mass_properties(1.0).unwrap(),
            cuboid([0.04, -0.06, 0.0], [0.06, 0.0, 0.03]).mass_properties(1.0).unwrap(),
        ];
        let truth = MassProperties::combined(&parts).unwrap();
        close(s.volume_m3, truth.mass_kg, 2e-4);
        assert!((s.properties.center_of_mass - truth.center_of_mass).norm() < 1e-5);
        assert!((s.properties.inertia - truth.inertia).norm() < 5e-4 * truth.inertia.norm());
    }

    #[test]
    fn touching_boxes_are_exact() {
        let t =
            joined(&[cuboid([-0.05, 0.0, 0.0], [0.05, 0.02, 0.03]), cuboid([-0.01, -0.06, 0.0], [0.01, 0.0, 0.03])]);
        let s = solid_properties(&t).unwrap();
        assert_eq!(s.closing_method, ClosingMethod::Exact);
        close(s.volume_m3, 0.1 * 0.02 * 0.03 + 0.02 * 0.06 * 0.03, 1e-13);
        assert!(s.hidden_area_share > 0.05);
    }

    #[test]
    fn a_cavity_is_taken_off_and_an_inner_body_is_not_counted_twice() {
        let (big, small) = (sphere(0.05, 3), sphere(0.03, 3));
        let v = |m: &TriMesh| m.mass_properties(1.0).unwrap().mass_kg;
        let hollow = solid_properties(&joined(&[big.clone(), flipped(&small)])).unwrap();
        assert_eq!(hollow.closing_method, ClosingMethod::Exact);
        close(hollow.volume_m3, v(&big) - v(&small), 1e-12);
        let filled = solid_properties(&joined(&[big.clone(), small])).unwrap();
        assert_eq!(filled.closing_method, ClosingMethod::Union);
        close(filled.volume_m3, v(&big), 1e-12);
    }

    #[test]
    fn a_missing_face_gets_a_flat_lid() {
        let mut m = cuboid([0.0; 3], [0.1, 0.06, 0.04]);
        m.faces.drain(0..2);
        let s = solid_properties(&m).unwrap();
        assert_eq!((s.closing_method, s.open_edges, s.openings), (ClosingMethod::WindingNumber, 4, 1));
        // The level set 1/2 bulges a little through the opening of so coarse a box: that is the spread.
        close(s.volume_m3, 2.4e-4, 0.03);
        assert!(s.closing_spread < 0.05 && s.lid_area_share > 0.1, "{s:?}");
    }

    #[test]
    fn a_cut_sphere_agrees_with_its_cap() {
        let mut m = sphere(0.05, 5);
        m.faces.retain(|f| f.iter().all(|&v| m.vertices[v as usize].z < 0.0351));
        let s = solid_properties(&m).unwrap();
        let cut = m.vertices.iter().zip(0..).filter(|(_, i)| m.faces.iter().flatten().any(|v| v == i));
        let top = cut.map(|(v, _)| v.z).fold(f64::MIN, f64::max);
        let h = 0.05 - top;
        let truth =
            4.0 / 3.0 * std::f64::consts::PI * 0.05_f64.powi(3) - std::f64::consts::PI * h * h * (0.15 - h) / 3.0;
        close(s.volume_m3, truth, 0.02);
    }

    #[test]
    fn sheets_and_flat_meshes_are_refused() {
        let mut sheet = cuboid([0.0; 3], [0.1, 0.2, 0.3]);
        sheet.faces.truncate(2);
        let mut bowed = sphere(0.05, 4);
        bowed.faces.retain(|f| f.iter().all(|&v| bowed.vertices[v as usize].z > 0.04));
        let mut flat = cuboid([0.0; 3], [0.1, 0.2, 0.3]);
        flat.vertices.iter_mut().for_each(|v| v.z = 0.0);
        for mesh in [sheet, bowed, flat] {
            let e = solid_properties(&mesh).unwrap_err();
            assert!(matches!(e, Error::NoVolume { .. }), "{e}");
            assert!(e.to_string().contains("thickness"));
        }
    }
}
