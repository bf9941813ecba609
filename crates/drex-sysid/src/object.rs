//! The pushed object as it is simulated.

use std::sync::Arc;

use drex_core::Object;
use drex_diffsim::Collider;

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
