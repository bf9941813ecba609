//! Sim-ready assets of meshes.

use std::path::PathBuf;
use std::sync::Arc;

use drex_core::TriMesh;
use drex_mesh::{
    AssetOptions, CheckOptions, LengthUnit, asset_from_mesh, build_asset, check_asset, check_file, check_mesh,
};
use nalgebra::Point3;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

use crate::arrays::{Numbers, out1, out2, plain, points, pose_row, vector};
use crate::failure::{Result, refused};
use crate::watch::watched;

/// Vertices and faces as arrays.
type Arrays<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<u32>>);

/// A mesh as Python gives it.
pub(crate) enum MeshInput {
    File(PathBuf),
    Mesh(TriMesh),
}

impl MeshInput {
    pub(crate) fn of(value: &Bound<'_, PyAny>) -> Result<Self> {
        if let Ok(path) = value.extract::<PathBuf>() {
            return Ok(Self::File(path));
        }
        let Ok((vertices, faces)) = value.extract::<(Bound<'_, PyAny>, Bound<'_, PyAny>)>() else {
            return refused("the mesh is neither a path nor a tuple (vertices, faces); give one of these");
        };
        let vertices: Vec<Point3<f64>> = points("vertices", &vertices)?;
        let rows = Numbers::of("faces", &faces)?.finite()?.rows::<3>("rows of three vertex numbers, shape (F, 3)")?;
        let mut faces = Vec::with_capacity(rows.len());
        for row in rows {
            // Whole numbers of that size are exact as floats.
            if row.iter().any(|x| x.fract() != 0.0 || !(0.0..=f64::from(u32::MAX)).contains(x)) {
                return refused(format!("faces holds {row:?}; give numbers of vertices, counted from 0"));
            }
            faces.push(row.map(|x| x as u32));
        }
        Ok(Self::Mesh(TriMesh::new(vertices, faces)?))
    }

    /// The asset of it.
    pub(crate) fn asset(&self, options: &AssetOptions) -> Result<drex_mesh::Asset> {
        Ok(match self {
            Self::File(path) => build_asset(path, options)?,
            Self::Mesh(mesh) => asset_from_mesh(mesh, options)?,
        })
    }
}

/// An object that is to be grasped, as Python gives it: an `Asset`, or a mesh of which one is made.
pub(crate) struct ObjectInput {
    source: ObjectSource,
    mass_kg: Option<f64>,
    friction: Option<f64>,
}

enum ObjectSource {
    Asset(Arc<drex_mesh::Asset>),
    Mesh(MeshInput, LengthUnit),
}

impl ObjectInput {
    /// The object with this mass and friction; an `Asset` has its own where they are left out.
    pub(crate) fn of(
        value: &Bound<'_, PyAny>,
        mass_kg: Option<f64>,
        friction: Option<f64>,
        unit: &str,
    ) -> Result<Self> {
        let source = match value.extract::<PyRef<'_, Asset>>() {
            Ok(asset) => ObjectSource::Asset(Arc::clone(&asset.inner)),
            Err(_) if mass_kg.is_none() => {
                return refused("nobody says what the object weighs; give mass_kg, or an Asset with its mass");
            }
            Err(_) => ObjectSource::Mesh(MeshInput::of(value)?, unit.parse()?),
        };
        Ok(Self { source, mass_kg, friction })
    }

    /// The object, where it stands on the table z = 0. It takes seconds for a fine mesh.
    pub(crate) fn object(&self) -> Result<drex_core::Object> {
        let made;
        let asset = match &self.source {
            ObjectSource::Asset(asset) => asset.as_ref(),
            ObjectSource::Mesh(mesh, unit) => {
                let mut options = AssetOptions::default();
                options.unit = *unit;
                made = mesh.asset(&options)?;
                &made
            }
        };
        let object = asset.to_object("object")?;
        let mut object = object.with_mass(self.mass_kg.unwrap_or(asset.properties.mass_kg));
        object.friction = self.friction.unwrap_or(object.friction);
        Ok(object)
    }
}

fn arrays<'py>(py: Python<'py>, mesh: &TriMesh) -> Result<Arrays<'py>> {
    let faces: Vec<u32> = mesh.faces.iter().flatten().copied().collect();
    let faces = PyArray1::from_vec(py, faces).reshape([mesh.faces.len(), 3])?;
    Ok((out2(py, mesh.vertices.iter().map(|v| [v.x, v.y, v.z]))?, faces))
}

/// A simulation asset: a closed object with mass, inertia, convex pieces and poses at rest.
///
/// Everything is in the frame of the mesh, in metres. Arrays are copies.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Asset {
    pub(crate) inner: Arc<drex_mesh::Asset>,
}

#[pymethods]
impl Asset {
    /// Vertices of the repaired mesh, shape (V, 3), m.
    #[getter]
    fn vertices<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        Ok(arrays(py, &self.inner.visual)?.0)
    }

    /// Faces of the repaired mesh, shape (F, 3), vertex numbers counter-clockwise seen from outside.
    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<u32>>> {
        Ok(arrays(py, &self.inner.visual)?.1)
    }

    /// Convex collision pieces: tuples (vertices (V, 3), faces (F, 3)).
    #[getter]
    fn pieces<'py>(&self, py: Python<'py>) -> Result<Vec<Arrays<'py>>> {
        self.inner.convex_parts.iter().map(|piece| arrays(py, &piece.hull)).collect()
    }

    /// Volume of the solid, m³.
    #[getter]
    fn volume_m3(&self) -> f64 {
        self.inner.report.volume_m3
    }

    /// Mass, kg.
    #[getter]
    fn mass_kg(&self) -> f64 {
        self.inner.properties.mass_kg
    }

    /// Centre of mass, shape (3,), m.
    #[getter]
    fn center_of_mass_m<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.properties.center_of_mass.iter().copied())
    }

    /// Inertia about the centre of mass along the mesh's axes, shape (3, 3), kg m².
    #[getter]
    fn inertia_kg_m2<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        let m = &self.inner.properties.inertia;
        out2(py, [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)])))
    }

    /// Coefficient of sliding friction.
    #[getter]
    fn friction(&self) -> f64 {
        self.inner.friction
    }

    /// Unit direction in the mesh that points up when the object stands, shape (3,).
    #[getter]
    fn up_in_mesh<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.up_in_mesh.iter().copied())
    }

    /// Pose of the mesh where the object stands on the table z = 0, shape (7,): x, y, z, qw, qx, qy, qz.
    #[getter]
    fn rest_pose<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, pose_row(&self.inner.world_from_mesh_at_rest))
    }

    /// Poses in which the object rests on the table z = 0, the most probable first, shape (N, 7).
    #[getter]
    fn stable_poses<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        out2(py, self.inner.stable_poses.iter().map(|p| pose_row(&p.world_from_mesh)))
    }

    /// Probability of each of the stable poses when the object is let go in a random orientation, shape (N,).
    #[getter]
    fn stable_pose_probabilities<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.inner.stable_poses.iter().map(|p| p.probability))
    }

    /// What a person should look at, one sentence each.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.inner.report.warnings.clone()
    }

    /// Writes mesh/visual.obj, mesh/collision_NN.obj, mesh/report.json, asset/object.xml (MJCF), asset/object.urdf and
    /// asset/object.glb under `out`.
    fn write(&self, py: Python<'_>, out: PathBuf) -> Result<()> {
        let asset = Arc::clone(&self.inner);
        watched(py, None, move |_| Ok(asset.write(&out)?))
    }

    /// The same object with another mass; the inertia scales along.
    fn with_mass(&self, mass_kg: f64) -> Result<Self> {
        if !(mass_kg > 0.0 && mass_kg.is_finite()) {
            return refused(format!("mass_kg is {mass_kg}; give a positive number of kilograms"));
        }
        Ok(Self { inner: Arc::new(drex_mesh::Asset::clone(&self.inner).with_mass(mass_kg)) })
    }

    /// Everything that is known about how the asset was made, as mesh/report.json has it.
    fn to_dict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.inner.report)
    }

    fn __repr__(&self) -> String {
        let a = &self.inner;
        format!(
            "Asset({:.4} kg, {:.6} m³, {} vertices, {} convex pieces)",
            a.properties.mass_kg,
            a.report.volume_m3,
            a.visual.vertices.len(),
            a.convex_parts.len()
        )
    }
}

/// Makes a sim-ready asset of a mesh, which may be open, a soup of triangles or of several shells.
///
/// `mesh` is an STL, OBJ, PLY, glTF or GLB file, or a tuple (vertices (V, 3), faces (F, 3)). Without `mass_kg` the density counts (1000
/// kg/m³ if left out). `wall_m` makes the object hollow with walls of that thickness. `unit` is the unit of the mesh: "m", "cm", "mm",
/// "in" or "auto" (told by the size). With `out`, the files of `Asset.write` are written there.
#[pyfunction]
#[pyo3(signature = (mesh, *, out=None, mass_kg=None, density_kg_m3=None, wall_m=None, unit="auto", up_in_mesh=None, friction=0.5,
    most_pieces=20, most_corners=64, concavity=0.0075))]
pub(crate) fn mesh_asset(
    py: Python<'_>,
    mesh: &Bound<'_, PyAny>,
    out: Option<PathBuf>,
    mass_kg: Option<f64>,
    density_kg_m3: Option<f64>,
    wall_m: Option<f64>,
    unit: &str,
    up_in_mesh: Option<&Bound<'_, PyAny>>,
    friction: f64,
    most_pieces: usize,
    most_corners: usize,
    concavity: f64,
) -> Result<Asset> {
    if mass_kg.is_some() && density_kg_m3.is_some() {
        return refused("both mass_kg and density_kg_m3 are given; give one of them");
    }
    let mut options = AssetOptions::default();
    options.mass_kg = mass_kg;
    options.density_kg_m3 = density_kg_m3.unwrap_or(options.density_kg_m3);
    options.wall_m = wall_m;
    options.unit = unit.parse()?;
    options.up_in_mesh = up_in_mesh.map(|up| vector("up_in_mesh", up)).transpose()?;
    options.friction = friction;
    options.partition.most_parts = most_pieces;
    options.partition.most_corners = most_corners;
    options.partition.concavity = concavity;
    let mesh = MeshInput::of(mesh)?;
    let asset = watched(py, None, move |_| {
        let asset = mesh.asset(&options)?;
        if let Some(out) = out {
            asset.write(&out)?;
        }
        Ok(asset)
    })?;
    Ok(Asset { inner: Arc::new(asset) })
}

/// The verdicts of the rules on a mesh or asset. `print` shows them as a table.
#[pyclass(module = "drex", frozen)]
pub(crate) struct MeshCheck {
    report: drex_mesh::CheckReport,
}

#[pymethods]
impl MeshCheck {
    /// Whether no rule failed. Rules that hold after repair count as kept.
    #[getter]
    fn passed(&self) -> bool {
        self.report.passed()
    }

    /// The file, or "the mesh".
    #[getter]
    fn subject(&self) -> &str {
        &self.report.subject
    }

    /// One dict per rule: number, name, outcome ("pass", "repaired", "fail" or "not_applicable"), reason, fix.
    #[getter]
    fn rules<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.report.rules)
    }

    /// Subject and rules.
    fn to_dict<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.report)
    }

    fn __str__(&self) -> String {
        self.report.to_string()
    }

    fn __repr__(&self) -> String {
        let verdict = if self.report.passed() { "passed" } else { "failed" };
        format!("MeshCheck(\"{}\", {verdict})", self.report.subject)
    }
}

/// Judges a mesh, or a written asset, by rules of what simulators need.
///
/// `mesh` is a mesh file, a folder or MJCF that `mesh_asset` wrote, or a tuple (vertices (V, 3), faces (F, 3)). `unit` as for `mesh_asset`.
#[pyfunction]
#[pyo3(signature = (mesh, *, unit="auto"))]
pub(crate) fn mesh_check(py: Python<'_>, mesh: &Bound<'_, PyAny>, unit: &str) -> Result<MeshCheck> {
    let mut options = CheckOptions::default();
    options.asset.unit = unit.parse()?;
    let mesh = MeshInput::of(mesh)?;
    let report = watched(py, None, move |_| {
        Ok(match &mesh {
            MeshInput::Mesh(mesh) => check_mesh(mesh, &options),
            MeshInput::File(path) if path.is_dir() || path.extension().is_some_and(|e| e == "xml") => {
                check_asset(path, &options)?
            }
            MeshInput::File(path) => check_file(path, &options)?,
        })
    })?;
    Ok(MeshCheck { report })
}
