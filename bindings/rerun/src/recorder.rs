//! The recording: entities by path, fixed or over a timeline of their own.

use anyhow::{Result, bail};
use drex_core::{Pose, TriMesh};
use nalgebra::{Point3, Vector3};
use re_sdk::log::TimeColumn;
use re_sdk::sink::MemorySinkStorage;
use re_sdk::time::{TimeCell, TimelineName};
use re_sdk::{
    AsComponents, EntityPath, EntityPathPart, RecordingStream, RecordingStreamBuilder, SerializedComponentColumn,
};
use re_sdk_types::archetypes::{Mesh3D, Scalars, Transform3D};
use re_sdk_types::datatypes::Quaternion;

/// A recording in memory. It is written in one piece at the end, so that an error leaves no half file.
pub struct Recorder {
    stream: RecordingStream,
    memory: MemorySinkStorage,
}

/// When something happened: the name of a timeline and places on it, as many as there are rows.
#[derive(Debug, Clone, Copy)]
pub enum Times<'a> {
    /// Seconds from the start of a recording or simulation.
    Seconds(&'a str, &'a [f64]),
    /// Numbers of grasps, or masses in whole milligrams.
    Numbers(&'a str, &'a [i64]),
}

impl Times<'_> {
    fn column(&self) -> Result<TimeColumn> {
        Ok(match *self {
            Self::Seconds(name, s) => {
                TimeColumn::new_duration_nanos(TimelineName::try_new(name)?, s.iter().map(|s| nanos(*s)))
            }
            Self::Numbers(name, n) => TimeColumn::new_sequence(TimelineName::try_new(name)?, n.iter().copied()),
        })
    }

    /// How many rows there are.
    pub fn len(&self) -> usize {
        match *self {
            Self::Seconds(_, s) => s.len(),
            Self::Numbers(_, n) => n.len(),
        }
    }
}

/// Whole nanoseconds; what is not finite or too far away becomes the last one (a cast of a float saturates).
fn nanos(seconds: f64) -> i64 {
    ((1e9 * seconds).round() as i64).max(i64::MIN + 1)
}

/// The path of an entity; names may hold any character.
pub fn path(parts: &[&str]) -> EntityPath {
    parts.iter().map(|part| EntityPathPart::new(*part)).collect::<Vec<_>>().into()
}

impl Recorder {
    /// An empty recording.
    ///
    /// # Errors
    /// If the machine has no thread for it.
    pub fn new(name: &str) -> Result<Self> {
        // `enabled`: the variable RERUN of the environment must not switch off what somebody asked for.
        let (stream, memory) = RecordingStreamBuilder::new("drex").recording_name(name).enabled(true).memory()?;
        // The time of logging says nothing about a twin, and every entity would be seen on these timelines.
        stream.set_log_time_enabled(false);
        stream.set_log_tick_enabled(false);
        Ok(Self { stream, memory })
    }

    /// Something that holds at all times.
    pub fn fixed(&self, parts: &[&str], what: &impl AsComponents) -> Result<()> {
        Ok(self.stream.log_static(path(parts), what)?)
    }

    /// Something that is there from the first of `times` on, and only on that timeline; nothing if there are no times.
    pub fn starting(&self, parts: &[&str], times: Times<'_>, what: &impl AsComponents) -> Result<()> {
        let (name, cell) = match times {
            Times::Seconds(name, [first, ..]) => (name, TimeCell::from_duration_nanos(nanos(*first))),
            Times::Numbers(name, [first, ..]) => (name, TimeCell::from_sequence(*first)),
            _ => return Ok(()),
        };
        self.stream.set_time(TimelineName::try_new(name)?, cell);
        let logged = self.stream.log(path(parts), what);
        self.stream.reset_time();
        Ok(logged?)
    }

    /// One row per time.
    ///
    /// # Errors
    /// If there are not as many rows as times: the file that they come from is damaged.
    pub fn columns(
        &self,
        parts: &[&str],
        times: Times<'_>,
        rows: usize,
        columns: impl IntoIterator<Item = SerializedComponentColumn>,
    ) -> Result<()> {
        if rows != times.len() {
            bail!("{} has {rows} rows for {} times; run the stage again that wrote it", parts.join("/"), times.len());
        }
        if rows == 0 {
            return Ok(());
        }
        Ok(self.stream.send_columns(path(parts), [times.column()?], columns)?)
    }

    /// A number over time.
    ///
    /// # Errors
    /// As [`Recorder::columns`].
    pub fn series(&self, parts: &[&str], times: Times<'_>, values: &[f64]) -> Result<()> {
        let columns = Scalars::new(values.iter().copied()).columns_of_unit_batches()?;
        self.columns(parts, times, values.len(), columns)
    }

    /// A number that holds at all times.
    pub fn number(&self, parts: &[&str], value: f64) -> Result<()> {
        self.fixed(parts, &Scalars::single(value))
    }

    /// Poses of the entity in its parent, one per time.
    ///
    /// # Errors
    /// As [`Recorder::columns`].
    pub fn poses(&self, parts: &[&str], times: Times<'_>, poses: &[Pose]) -> Result<()> {
        let transform = Transform3D::update_fields()
            .with_many_translation(poses.iter().map(|p| vector(&p.translation.vector)))
            .with_many_quaternion(poses.iter().map(quaternion));
        self.columns(parts, times, poses.len(), transform.columns_of_unit_batches()?)
    }

    /// The file.
    ///
    /// # Errors
    /// If what was recorded cannot be encoded.
    pub fn finish(self) -> Result<Vec<u8>> {
        self.stream.flush_blocking()?;
        Ok(self.memory.drain_as_bytes()?)
    }
}

/// In single precision, as the viewer has it.
pub fn vector(v: &Vector3<f64>) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}

/// See [`vector`].
pub fn point(p: &Point3<f64>) -> [f32; 3] {
    vector(&p.coords)
}

fn quaternion(pose: &Pose) -> Quaternion {
    let q = pose.rotation.quaternion();
    Quaternion::from_xyzw([q.i as f32, q.j as f32, q.k as f32, q.w as f32])
}

/// A pose of an entity in its parent.
pub fn transform(pose: &Pose) -> Transform3D {
    Transform3D::new().with_translation(vector(&pose.translation.vector)).with_quaternion(quaternion(pose))
}

/// A mesh with one colour, with normals for the light: of corners for smooth ones, of faces for those with edges.
pub fn mesh(mesh: &TriMesh, smooth: bool, rgba: [u8; 4]) -> Mesh3D {
    let shown = if smooth { mesh.clone() } else { apart(mesh) };
    let normals: Vec<[f32; 3]> = normals(&shown).iter().map(vector).collect();
    Mesh3D::new(shown.vertices.iter().map(point))
        .with_triangle_indices(shown.faces)
        .with_vertex_normals(normals)
        .with_albedo_factor(rgba)
}

/// Every face with corners of its own.
fn apart(mesh: &TriMesh) -> TriMesh {
    let vertices = mesh.faces.iter().flatten().filter_map(|&v| mesh.vertices.get(v as usize).copied()).collect();
    let faces = (0..mesh.faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    TriMesh { vertices, faces }
}

/// Unit normals of the corners, faces weighted by their area; up where there is none.
fn normals(mesh: &TriMesh) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros(); mesh.vertices.len()];
    for (f, face) in mesh.faces.iter().enumerate() {
        let [a, b, c] = mesh.triangle(f);
        let area = (b - a).cross(&(c - a));
        for &v in face {
            sums[v as usize] += area;
        }
    }
    sums.iter().map(|n| n.try_normalize(0.0).unwrap_or_else(Vector3::z)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_face_of_its_own_has_its_own_normal() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let bent = TriMesh { vertices: corners.map(Point3::from).to_vec(), faces: vec![[0, 1, 2], [0, 2, 3]] };
        let flat = normals(&apart(&bent));
        assert_eq!(flat.len(), 6);
        assert!((flat[0] - Vector3::z()).norm() < 1e-12 && (flat[3] - Vector3::x()).norm() < 1e-12);
        let shared = normals(&bent);
        assert!((shared[0] - Vector3::new(1.0, 0.0, 1.0).normalize()).norm() < 1e-12);
    }

    #[test]
    fn times_that_are_no_numbers_do_not_panic() {
        assert_eq!(nanos(1.5), 1_500_000_000);
        assert_eq!(nanos(-0.25), -250_000_000);
        assert_eq!(nanos(f64::NEG_INFINITY), i64::MIN + 1);
        assert_eq!((nanos(f64::INFINITY), nanos(f64::NAN)), (i64::MAX, 0));
    }

    #[test]
    fn names_with_slashes_are_one_part() {
        assert_eq!(path(&["world", "a/b", "c d"]).len(), 3);
    }
}
