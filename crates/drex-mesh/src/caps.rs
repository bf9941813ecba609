//! Closing the openings of a surface.

use nalgebra::{Point3, Vector3};

use drex_core::TriMesh;

use crate::topology::boundary_loops;

/// A surface with its openings closed.
#[derive(Debug, Clone)]
pub(crate) struct Capped {
    /// The surface, then the caps.
    pub mesh: TriMesh,
    /// Number of faces that belong to the surface itself.
    pub surface_faces: usize,
    /// Number of openings.
    pub openings: usize,
    /// Largest distance across an opening (twice the farthest rim point from its middle), metres.
    pub widest_m: f64,
    /// Area of the lids, m²: for each the length of its vector area, so that folds of a ragged lid cancel.
    pub lid_area_m2: f64,
}

/// Closes every opening by a fan of triangles from its rim to the middle of the rim.
pub(crate) fn cap(mesh: &TriMesh) -> Capped {
    let loops = boundary_loops(mesh);
    let mut out = Capped {
        mesh: mesh.clone(),
        surface_faces: mesh.faces.len(),
        openings: loops.len(),
        widest_m: 0.0,
        lid_area_m2: 0.0,
    };
    for rim in &loops {
        let at = |k: usize| mesh.vertices[rim[k % rim.len()] as usize];
        let (mut length, mut weighted) = (0.0, Vector3::zeros());
        for k in 0..rim.len() {
            let edge = (at(k + 1) - at(k)).norm();
            length += edge;
            weighted += nalgebra::center(&at(k), &at(k + 1)).coords * edge;
        }
        if rim.len() < 3 || !(length > 0.0) {
            continue;
        }
        if rim.len() == 3 {
            out.mesh.faces.push([rim[0], rim[1], rim[2]]);
        } else {
            let hub = out.mesh.vertices.len() as u32;
            out.mesh.vertices.push(Point3::from(weighted / length));
            out.mesh.faces.extend((0..rim.len()).map(|k| [rim[k], rim[(k + 1) % rim.len()], hub]));
        }
        let middle = Point3::from(weighted / length);
        let vector_area: Vector3<f64> =
            (0..rim.len()).map(|k| (at(k) - middle).cross(&(at(k + 1) - middle)) * 0.5).sum();
        out.lid_area_m2 += vector_area.norm();
        out.widest_m = (0..rim.len()).map(|k| 2.0 * (at(k) - middle).norm()).fold(out.widest_m, f64::max);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::cuboid;

    #[test]
    fn an_open_box_is_closed_exactly() {
        let mut m = cuboid([0.0; 3], [1.0, 2.0, 3.0]);
        m.faces.drain(2..4);
        let c = cap(&m);
        assert_eq!((c.openings, c.mesh.faces.len()), (1, 14));
        assert!((c.widest_m - 5.0_f64.sqrt()).abs() < 1e-12);
        assert!((c.mesh.mass_properties(1.0).unwrap().mass_kg - 6.0).abs() < 1e-12);
    }
}
