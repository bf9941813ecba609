//! NumPy arrays in and out. In: anything that `numpy.asarray` takes, copied. Out: new arrays of 64-bit floats.

use drex_core::Pose;
use drex_core::pose::{pose_from_matrix, pose_from_wxyz, to_wxyz};
use nalgebra::{Matrix4, Point3, Vector3};
use numpy::{AllowTypeChange, PyArray1, PyArray2, PyArray3, PyArrayLikeDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::failure::{Failure, Result, refused};

/// Numbers of an array in row-major order, and its shape.
pub(crate) struct Numbers {
    what: &'static str,
    data: Vec<f64>,
    shape: Vec<usize>,
}

impl Numbers {
    /// The numbers of `value`, which messages call `what`.
    pub(crate) fn of(what: &'static str, value: &Bound<'_, PyAny>) -> Result<Self> {
        let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = value.extract().map_err(|error| {
            Failure::Refused(format!("{what} is no array of numbers ({error}); give a NumPy array or nested lists"))
        })?;
        let shape = array.shape().to_vec();
        Ok(Self { what, data: array.as_array().iter().copied().collect(), shape })
    }

    /// The same, if no number is NaN or infinite.
    pub(crate) fn finite(self) -> Result<Self> {
        match self.data.iter().position(|x| !x.is_finite()) {
            Some(i) => refused(format!(
                "{} holds {} (entry {i} of {}); give finite numbers",
                self.what,
                self.data[i],
                self.data.len()
            )),
            None => Ok(self),
        }
    }

    pub(crate) fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// "(3, 21, 3)", as Python writes it.
    fn shape_text(&self) -> String {
        let sides: Vec<String> = self.shape.iter().map(ToString::to_string).collect();
        if sides.len() == 1 { format!("({},)", sides[0]) } else { format!("({})", sides.join(", ")) }
    }

    pub(crate) fn wrong_shape<T>(&self, wanted: &str) -> Result<T> {
        refused(format!("{} has the shape {}; give {wanted}", self.what, self.shape_text()))
    }

    /// A vector of any length.
    pub(crate) fn column(self, wanted: &str) -> Result<Vec<f64>> {
        if self.shape.len() == 1 { Ok(self.data) } else { self.wrong_shape(wanted) }
    }

    /// A vector of N numbers.
    pub(crate) fn fixed<const N: usize>(self, wanted: &str) -> Result<[f64; N]> {
        if self.shape.len() != 1 {
            return self.wrong_shape(wanted);
        }
        <[f64; N]>::try_from(self.data.as_slice()).or_else(|_| self.wrong_shape(wanted))
    }

    /// Rows of N numbers.
    pub(crate) fn rows<const N: usize>(self, wanted: &str) -> Result<Vec<[f64; N]>> {
        if self.shape.len() != 2 || self.shape[1] != N {
            return self.wrong_shape(wanted);
        }
        Ok(self.data.as_chunks::<N>().0.to_vec())
    }

    /// Rows of any one length.
    pub(crate) fn table(self, wanted: &str) -> Result<Vec<Vec<f64>>> {
        match self.shape[..] {
            [rows, 0] => Ok(vec![Vec::new(); rows]),
            [_, columns] => Ok(self.data.chunks_exact(columns).map(<[f64]>::to_vec).collect()),
            _ => self.wrong_shape(wanted),
        }
    }

    /// All numbers, whatever the shape.
    pub(crate) fn flat(self) -> Vec<f64> {
        self.data
    }
}

/// A vector of finite numbers.
pub(crate) fn column(what: &'static str, value: &Bound<'_, PyAny>) -> Result<Vec<f64>> {
    Numbers::of(what, value)?.finite()?.column("one number each, shape (N,)")
}

/// Three finite numbers.
pub(crate) fn vector(what: &'static str, value: &Bound<'_, PyAny>) -> Result<Vector3<f64>> {
    Ok(Numbers::of(what, value)?.finite()?.fixed::<3>("three numbers, shape (3,)")?.into())
}

/// Rows of three finite numbers.
pub(crate) fn vectors(what: &'static str, value: &Bound<'_, PyAny>) -> Result<Vec<Vector3<f64>>> {
    let rows = Numbers::of(what, value)?.finite()?.rows::<3>("rows of three numbers, shape (N, 3)")?;
    Ok(rows.into_iter().map(Vector3::from).collect())
}

/// Rows of three finite numbers, as points.
pub(crate) fn points(what: &'static str, value: &Bound<'_, PyAny>) -> Result<Vec<Point3<f64>>> {
    Ok(vectors(what, value)?.into_iter().map(Point3::from).collect())
}

/// What a pose may be.
const ONE_POSE: &str = "x, y, z, qw, qx, qy, qz (shape (7,)) or a 4 x 4 matrix";
const POSES: &str = "rows of x, y, z, qw, qx, qy, qz (shape (N, 7)) or 4 x 4 matrices (shape (N, 4, 4))";

/// One pose or several.
pub(crate) enum Poses {
    One(Pose),
    Several(Vec<Pose>),
}

/// A pose, or one per row.
pub(crate) fn one_pose_or_several(what: &'static str, value: &Bound<'_, PyAny>) -> Result<Poses> {
    poses_or(what, value, &format!("{ONE_POSE}, or {POSES}"))
}

/// A pose or several; for another shape, what is `wanted`.
fn poses_or(what: &'static str, value: &Bound<'_, PyAny>, wanted: &str) -> Result<Poses> {
    let numbers = Numbers::of(what, value)?.finite()?;
    let about = |i: usize, e: drex_core::Error| Failure::Refused(format!("{what}, pose {i}: {e}"));
    Ok(match numbers.shape[..] {
        [7] => Poses::One(of_row(&numbers.data).map_err(|e| about(0, e))?),
        [4, 4] => Poses::One(of_matrix(&numbers.data).map_err(|e| about(0, e))?),
        [_, 7] => Poses::Several(
            numbers
                .data
                .chunks_exact(7)
                .enumerate()
                .map(|(i, r)| of_row(r).map_err(|e| about(i, e)))
                .collect::<Result<_>>()?,
        ),
        [_, 4, 4] => Poses::Several(
            numbers
                .data
                .chunks_exact(16)
                .enumerate()
                .map(|(i, m)| of_matrix(m).map_err(|e| about(i, e)))
                .collect::<Result<_>>()?,
        ),
        _ => return numbers.wrong_shape(wanted),
    })
}

/// One pose.
pub(crate) fn pose(what: &'static str, value: &Bound<'_, PyAny>) -> Result<Pose> {
    match poses_or(what, value, ONE_POSE)? {
        Poses::One(pose) => Ok(pose),
        Poses::Several(_) => Numbers::of(what, value)?.wrong_shape(ONE_POSE),
    }
}

/// One pose per row.
pub(crate) fn poses(what: &'static str, value: &Bound<'_, PyAny>) -> Result<Vec<Pose>> {
    match poses_or(what, value, POSES)? {
        Poses::Several(poses) => Ok(poses),
        Poses::One(_) => Numbers::of(what, value)?.wrong_shape(POSES),
    }
}

fn of_row(r: &[f64]) -> drex_core::Result<Pose> {
    pose_from_wxyz([r[0], r[1], r[2]], [r[3], r[4], r[5], r[6]])
}

fn of_matrix(m: &[f64]) -> drex_core::Result<Pose> {
    pose_from_matrix(&Matrix4::from_row_slice(m))
}

/// x, y, z, qw, qx, qy, qz with qw not negative.
pub(crate) fn pose_row(pose: &Pose) -> [f64; 7] {
    let ([x, y, z], [w, i, j, k]) = to_wxyz(pose);
    [x, y, z, w, i, j, k]
}

/// A vector for Python.
pub(crate) fn out1(py: Python<'_>, data: impl IntoIterator<Item = f64>) -> Bound<'_, PyArray1<f64>> {
    PyArray1::from_iter(py, data)
}

/// Rows for Python.
pub(crate) fn out2<'py, const N: usize>(
    py: Python<'py>,
    rows: impl IntoIterator<Item = [f64; N]>,
) -> Result<Bound<'py, PyArray2<f64>>> {
    let data: Vec<f64> = rows.into_iter().flatten().collect();
    table(py, data, N)
}

/// Row-major `data` of `columns` columns for Python.
pub(crate) fn table(py: Python<'_>, data: Vec<f64>, columns: usize) -> Result<Bound<'_, PyArray2<f64>>> {
    let rows = data.len().checked_div(columns).unwrap_or(0);
    Ok(PyArray1::from_vec(py, data).reshape([rows, columns])?)
}

/// Row-major `data` of shape (rows, columns, 7) for Python.
pub(crate) fn pose_grid<'py>(py: Python<'py>, poses: &[Pose], columns: usize) -> Result<Bound<'py, PyArray3<f64>>> {
    let data: Vec<f64> = poses.iter().flat_map(pose_row).collect();
    let rows = poses.len().checked_div(columns).unwrap_or(0);
    Ok(PyArray1::from_vec(py, data).reshape([rows, columns, 7])?)
}

/// A serialisable value as plain Python dicts, lists, numbers and strings.
pub(crate) fn plain<'py>(py: Python<'py>, value: &impl serde::Serialize) -> Result<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value)?;
    Ok(py.import("json")?.call_method1("loads", (text,))?)
}
