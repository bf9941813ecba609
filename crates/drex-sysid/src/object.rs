//! The pushed object as it is simulated.

use std::sync::Arc;

use drex_core::mesh::convex_hull;
use drex_core::{ConvexPart, Object};
use drex_diffsim::{Collider, ConvexPolyhedron};

use crate::{Result, SysidError};

/// The shapes of an object that can be simulated.
///
/// # Errors
/// If it has mass properties that no solid has, no convex part, or one without volume.
pub(crate) fn collider(object: &Object) -> Result<Arc<Collider>> {
    let bad = |what: &str, remedy: &str| Err(SysidError::Object { what: what.into(), remedy: remedy.into() });
    if !object.mass_properties.is_physical() {
        return bad("has mass properties that no solid has", "close the mesh, or check its scale");
    }
    if object.convex_parts.is_empty() {
        return bad("has no convex piece", "give at least one");
    }
    match Collider::of_parts(&object.convex_parts) {
        Ok(collider) => Ok(Arc::new(collider)),
        Err(e) => bad(&format!("has a bad convex piece: {e}"), "split or close it"),
    }
}

/// Standard deviation of a surface per [roughness](drex_core::TriMesh::roughness_m), since an error that is smooth over a few edges does
/// not show: meshes that were made of photos have a voxel per 5.7 to 7.6 of it.
const ERROR_PER_ROUGHNESS: f64 = 6.0;
/// Roughness over size of a coarse drawing.
const DRAWN: f64 = 2.5e-4;

/// How well a rough mesh is known of which nobody says it: to a tenth of a millimetre, metres; `None` of one as smooth as a drawing.
pub(crate) fn sd_of_rough_mesh_m(object: &Object) -> Option<f64> {
    let roughness_m = object.mesh.roughness_m().filter(|r| *r > DRAWN * object.size_m())?;
    Some((1e4 * ERROR_PER_ROUGHNESS * roughness_m).round() / 1e4)
}

/// An object as a plane that it stands on touches it: its hull, into however many parts it is cut. One of primitives is as it was.
///
/// # Errors
/// If its mesh is flat.
pub(crate) fn standing(object: &Object) -> Result<Object> {
    let mut out = object.clone();
    if object.convex_parts.iter().any(|p| p.primitive.is_none()) {
        let flat = |e: &dyn std::fmt::Display| SysidError::Object {
            what: format!("has a bad mesh: {e}"),
            remedy: "close it, or check its scale".into(),
        };
        let points: Vec<_> = match object.mesh.vertices.as_slice() {
            [] => object.corners().copied().collect(),
            of_mesh => of_mesh.to_vec(),
        };
        let hull = ConvexPolyhedron::from_points(&points).map_err(|e| flat(&e))?;
        let hull = convex_hull(hull.vertices()).map_err(|e| flat(&e))?;
        out.convex_parts = Arc::new(vec![ConvexPart::of_hull(hull)]);
    }
    Ok(out)
}
