//! Meshes of robot models as their files and scales give them.

use drex_core::TriMesh;
use nalgebra::Vector3;

/// The mesh with every vertex multiplied by `scale`; a mirroring scale turns the faces around so that they stay outward.
pub(crate) fn scaled(mut mesh: TriMesh, scale: &Vector3<f64>) -> TriMesh {
    for v in &mut mesh.vertices {
        v.coords.component_mul_assign(scale);
    }
    if scale.product() < 0.0 {
        for f in &mut mesh.faces {
            f.swap(1, 2);
        }
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirroring_keeps_the_volume_positive() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
        let mesh = drex_core::mesh::parse_obj("a.obj".as_ref(), text.as_bytes()).unwrap();
        let mirrored = scaled(mesh, &Vector3::new(-2.0, 1.0, 1.0));
        let volume = mirrored.mass_properties(1.0).unwrap().mass_kg;
        assert!((volume - 2.0 / 6.0).abs() < 1e-12);
    }
}
