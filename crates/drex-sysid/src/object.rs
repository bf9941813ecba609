//! The pushed object: convex pieces for contact, mass properties at one kilogram.

use drex_core::mesh::coincident;
use drex_core::sets::DisjointSets;
use drex_core::{MassProperties, Pose, TriMesh};
use drex_diffsim::ConvexPolyhedron;
use nalgebra::Point3;
use std::collections::BTreeMap;

use crate::{Result, SysidError};

/// Vertices closer than this, relative to the size of the mesh, are one.
const WELD: f64 = 1e-6;

/// Geometry of the pushed object in its mesh frame, at uniform density.
#[derive(Debug, Clone)]
pub struct ObjectModel {
    /// Points of the convex pieces that touch the support, metres, mesh frame.
    pub pieces: Vec<Vec<Point3<f64>>>,
    /// Mass properties at a mass of 1 kg, mesh frame.
    pub unit: MassProperties,
}

impl ObjectModel {
    /// From a mesh of closed shells that touch but do not overlap, each the surface of a convex part.
    /// Meshes with holes or with parts that are not convex come as pieces from elsewhere: fill the fields then.
    ///
    /// # Errors
    /// If a shell is open, encloses no volume, or the mesh is empty.
    pub fn from_mesh(mesh: &TriMesh) -> Result<Self> {
        let shells = closed_shells(mesh)?;
        let parts = shells.iter().map(|s| s.mass_properties(1.0)).collect::<Result<Vec<_>, _>>()?;
        let whole = MassProperties::combined(&parts).ok_or_else(|| SysidError::Object {
            what: "encloses no volume".into(),
            remedy: "give a closed surface that winds outwards".into(),
        })?;
        Ok(Self { pieces: shells.into_iter().map(|s| s.vertices).collect(), unit: whole.with_mass(1.0) })
    }

    /// The pieces as the simulator takes them.
    pub(crate) fn shape(&self) -> Result<Vec<ConvexPolyhedron>> {
        if !self.unit.is_physical() {
            return Err(SysidError::Object {
                what: "has mass properties that no solid has".into(),
                remedy: "close the mesh, or check its scale".into(),
            });
        }
        let pieces = self.pieces.iter().map(|p| ConvexPolyhedron::from_points(p)).collect::<Result<Vec<_>, _>>();
        let pieces = pieces.map_err(|e| SysidError::Object {
            what: format!("has a bad convex piece: {e}"),
            remedy: "split or close it".into(),
        })?;
        if pieces.is_empty() {
            return Err(SysidError::Object { what: "has no convex piece".into(), remedy: "give at least one".into() });
        }
        Ok(pieces)
    }

    /// Lowest and highest corner of the object's outline in the world, placed at `pose`.
    pub(crate) fn bounds_at(&self, pose: &Pose) -> Option<(Point3<f64>, Point3<f64>)> {
        let mut points = self.pieces.iter().flatten().map(|p| pose * p);
        let first = points.next()?;
        Some(points.fold((first, first), |(lo, hi), p| (lo.inf(&p), hi.sup(&p))))
    }

    /// Diagonal of the bounding box of all pieces, metres.
    pub fn size_m(&self) -> f64 {
        self.bounds_at(&Pose::identity()).map_or(0.0, |(lo, hi)| (hi - lo).norm())
    }
}

/// The connected closed surfaces of a mesh, vertices welded.
fn closed_shells(mesh: &TriMesh) -> Result<Vec<TriMesh>> {
    let Some((lo, hi)) = mesh.bounds() else {
        return Err(SysidError::Object { what: "has no vertices".into(), remedy: "check the file".into() });
    };
    let tolerance_m = WELD * (hi - lo).norm().max(f64::MIN_POSITIVE);
    let mut places = coincident(&mesh.vertices, tolerance_m);
    let faces: Vec<[u32; 3]> = mesh
        .faces
        .iter()
        .map(|f| f.map(|v| places.find(v)))
        .filter(|f| f[0] != f[1] && f[1] != f[2] && f[2] != f[0])
        .collect();
    split_by_shared_edges(mesh, &faces)
}

/// Faces that share an edge in opposite directions belong to one shell. Where more than two faces meet in an edge (two
/// touching parts with welded vertices), the file's order of faces decides: parts are written one after the other.
fn split_by_shared_edges(mesh: &TriMesh, faces: &[[u32; 3]]) -> Result<Vec<TriMesh>> {
    let mut open: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
    let mut group = DisjointSets::new(faces.len());
    for (i, f) in (0..).zip(faces) {
        for k in 0..3 {
            let (a, b) = (f[k], f[(k + 1) % 3]);
            match open.get_mut(&(b, a)).and_then(Vec::pop) {
                Some(j) => group.join(i, j),
                None => open.entry((a, b)).or_default().push(i),
            }
        }
    }
    let holes = open.values().map(Vec::len).sum::<usize>();
    if holes > 0 {
        return Err(SysidError::Object {
            what: format!("is open: {holes} edges belong to one face only"),
            remedy: "close it (drex asset repairs scans), or give convex pieces and mass properties".into(),
        });
    }
    let mut shells: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
    for (i, f) in (0..).zip(faces) {
        shells.entry(group.find(i)).or_default().push(*f);
    }
    let mesh_of = |faces: Vec<[u32; 3]>| {
        let TriMesh { vertices, faces } = TriMesh::of_faces(&mesh.vertices, faces);
        Ok(TriMesh::new(vertices, faces)?)
    };
    shells.into_values().map(mesh_of).collect()
}
