//! Sets of grasps: our JSON, and npy tables of joint angles.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::check_angle;
use crate::series::JointPoses;
use drex_core::npy::parse_npy;
use drex_core::pose::pose_from_wxyz;
use drex_core::{Error, Result, fsutil};

/// A grasp file as it stands on disk (JSON, `schema` 1).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspFile {
    /// Version of this format: 1.
    pub schema: u32,
    /// Joint names, one per column of `grasps`.
    pub joint_names: Vec<String>,
    /// Unit of the angles: `rad`.
    pub unit: String,
    /// One row per grasp.
    pub grasps: Vec<Vec<f64>>,
    /// The grasped object.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// Where the grasps come from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Per grasp the pose `object_from_wrist` as x, y, z, qw, qx, qy, qz (m), if it was recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wrist: Option<Vec<[f64; 7]>>,
}

impl GraspFile {
    /// A file with the given joint angles, in radians, and nothing else known.
    pub fn new(poses: &JointPoses) -> Self {
        Self {
            schema: 1,
            joint_names: poses.names.clone(),
            unit: "rad".into(),
            grasps: poses.rows.clone(),
            object: None,
            source: None,
            wrist: None,
        }
    }
}

/// Reads grasps from `.json` (ours) or `.npy`. Where the file names no joints, `names` must. A JSON file that only
/// describes a table beside it (`cookie.json` with `cookie.npy`) leads to that table.
///
/// # Errors
/// If the file cannot be read, holds no grasps, no finite numbers or no radians, or the joints are unknown or do not fit.
pub fn read_grasps(path: &Path, names: Option<&[String]>) -> Result<JointPoses> {
    let is = |ending: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    let table = path.with_extension("npy");
    if is("npy") {
        read_grasps_npy(path, required(path, names)?)
    } else if is("json") && table.is_file() && !has_grasps(path)? {
        read_grasps_npy(&table, required(path, names)?)
    } else if is("json") {
        read_grasps_json(path)
    } else {
        Err(Error::content(path, None, "grasps are read from .json and .npy", "convert the file"))
    }
}

fn required<'a>(path: &Path, names: Option<&'a [String]>) -> Result<&'a [String]> {
    names.ok_or_else(|| {
        Error::content(
            path,
            None,
            "the table names no joints",
            "state the joint names, or the joint order, of its columns",
        )
    })
}

/// Whether the JSON file has grasps of its own.
fn has_grasps(path: &Path) -> Result<bool> {
    let value: serde_json::Value = fsutil::from_json(path, &fsutil::read_text(path)?)?;
    Ok(value.get("grasps").is_some())
}

/// Reads a [`GraspFile`].
///
/// # Errors
/// If the file cannot be read, is not of this format (with line and column), or its grasps fail the checks of [`read_grasps`].
pub fn read_grasps_json(path: &Path) -> Result<JointPoses> {
    parse_grasps_json(path, &fsutil::read_bytes(path)?)
}

/// As [`read_grasps_json`], from memory.
///
/// # Errors
/// As [`read_grasps_json`].
pub fn parse_grasps_json(path: &Path, bytes: &[u8]) -> Result<JointPoses> {
    let file = parse_grasp_file(path, bytes)?;
    Ok(JointPoses { names: file.joint_names, rows: file.grasps })
}

/// Reads a [`GraspFile`] whole, with what it knows besides the joint angles.
///
/// # Errors
/// As [`read_grasps_json`]; also if a wrist pose is not finite or its quaternion is not of unit norm.
pub fn read_grasp_file(path: &Path) -> Result<GraspFile> {
    parse_grasp_file(path, &fsutil::read_bytes(path)?)
}

/// As [`read_grasp_file`], from memory.
///
/// # Errors
/// As [`read_grasp_file`].
pub fn parse_grasp_file(path: &Path, bytes: &[u8]) -> Result<GraspFile> {
    let text = std::str::from_utf8(bytes)
        .map_err(|_| Error::content(path, None, "the file is not text (UTF-8)", "check that this is the right file"))?;
    let file: GraspFile = fsutil::from_json(path, text)?;
    if file.schema != 1 {
        let what = format!("schema {} of grasp files is not known", file.schema);
        return Err(Error::content(path, None, what, "write schema 1 or use a newer drex"));
    }
    if file.unit != "rad" {
        let what = format!("the unit of the angles is `{}`", file.unit);
        return Err(Error::content(path, None, what, "give radians and unit \"rad\""));
    }
    let wrists = file.wrist.as_deref().unwrap_or_default();
    if file.wrist.is_some() && wrists.len() != file.grasps.len() {
        let what = format!("{} wrist poses for {} grasps", wrists.len(), file.grasps.len());
        return Err(Error::content(path, None, what, "give one per grasp, or none"));
    }
    for (i, &[x, y, z, qw, qx, qy, qz]) in wrists.iter().enumerate() {
        if let Err(e) = pose_from_wxyz([x, y, z], [qw, qx, qy, qz]) {
            return Err(Error::content(path, None, format!("wrist pose {i}: {e}"), "correct or remove the grasp"));
        }
    }
    let JointPoses { names, rows } = checked(path, file.joint_names, file.grasps)?;
    Ok(GraspFile { joint_names: names, grasps: rows, ..file })
}

/// Writes grasps in our format, in one step.
///
/// # Errors
/// If the file cannot be written.
pub fn write_grasps_json(path: &Path, file: &GraspFile) -> Result<()> {
    let mut text = serde_json::to_string_pretty(file).map_err(|e| {
        Error::value(format!("the grasps cannot be written as JSON: {e}"), "check for numbers that are not finite")
    })?;
    text.push('\n');
    fsutil::write_atomic(path, text.as_bytes())
}

/// Reads a two-dimensional npy array of floats: one row per grasp, one column per name, radians.
///
/// # Errors
/// If the file cannot be read, is no such array, or its grasps fail the checks of [`read_grasps`].
pub fn read_grasps_npy(path: &Path, names: &[String]) -> Result<JointPoses> {
    parse_grasps_npy(path, &fsutil::read_bytes(path)?, names)
}

/// As [`read_grasps_npy`], from memory. Layout of the bytes: NEP 1 of NumPy.
///
/// # Errors
/// As [`read_grasps_npy`].
pub fn parse_grasps_npy(path: &Path, bytes: &[u8], names: &[String]) -> Result<JointPoses> {
    let refuse = |what: String| Error::content(path, None, what, "save a 2-D float array with numpy.save");
    let array = parse_npy(path, bytes)?;
    let Some(numbers) = array.numbers().filter(|_| array.descr.contains('f')) else {
        return Err(refuse(format!("the numbers are of type {}, not f8 or f4", array.descr)));
    };
    let shape = &array.shape;
    let &[rows, columns] = shape.as_slice() else {
        return Err(refuse(format!("the array has {} dimensions, not 2 (grasp, joint)", shape.len())));
    };
    if rows == 0 {
        return Err(no_grasps(path));
    }
    if columns != names.len() {
        let what = format!("{columns} columns but {} joint names", names.len());
        return Err(Error::content(path, None, what, "name the joints of this table, one per column"));
    }
    let grasps = numbers.chunks_exact(columns.max(1)).map(<[f64]>::to_vec).collect();
    checked(path, names.to_vec(), grasps)
}

fn no_grasps(path: &Path) -> Error {
    Error::content(
        path,
        None,
        "the set holds no grasps",
        "record or retarget grasps first, or leave [grasps] out of the manifest",
    )
}

/// The checks that every set of grasps passes.
fn checked(path: &Path, names: Vec<String>, rows: Vec<Vec<f64>>) -> Result<JointPoses> {
    if rows.is_empty() {
        return Err(no_grasps(path));
    }
    if names.is_empty() {
        return Err(Error::content(path, None, "no joint is named", "name the joint of each column"));
    }
    let mut sorted: Vec<&String> = names.iter().collect();
    sorted.sort();
    if let Some(pair) = sorted.windows(2).find(|w| w[0] == w[1]) {
        return Err(Error::content(path, None, format!("joint {} is named twice", pair[0]), "name each joint once"));
    }
    for (i, row) in rows.iter().enumerate() {
        if row.len() != names.len() {
            let what = format!("grasp {i} has {} angles for {} joints", row.len(), names.len());
            return Err(Error::content(path, None, what, "give one angle per joint"));
        }
        for (joint, &angle) in names.iter().zip(row) {
            if !angle.is_finite() {
                let what = format!("grasp {i}, joint {joint}: the angle is not finite");
                return Err(Error::content(path, None, what, "remove the grasp"));
            }
            check_angle(path, None, joint, angle)?;
        }
    }
    Ok(JointPoses { names, rows })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
        while !(10 + header.len() + 1).is_multiple_of(64) {
            header.push(' ');
        }
        header.push('\n');
        [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), data].concat()
    }

    fn names() -> Vec<String> {
        vec!["a".into(), "b".into()]
    }

    #[test]
    fn both_float_widths_are_read_row_by_row() {
        let rows = vec![vec![0.5, -0.25], vec![1.0, 2.0]];
        let f8: Vec<u8> = rows.iter().flatten().flat_map(|v: &f64| v.to_le_bytes()).collect();
        let f4: Vec<u8> = rows.iter().flatten().flat_map(|v: &f64| (*v as f32).to_le_bytes()).collect();
        for (descr, data) in [("<f8", f8), ("<f4", f4)] {
            let poses = parse_grasps_npy(Path::new("g.npy"), &npy(descr, "(2, 2)", &data), &names()).unwrap();
            assert_eq!(poses, JointPoses { names: names(), rows: rows.clone() });
        }
    }

    #[test]
    fn bad_tables_are_refused_with_the_reason() {
        let read = |bytes: &[u8]| parse_grasps_npy(Path::new("g.npy"), bytes, &names()).unwrap_err().to_string();
        assert!(read(&npy("<f8", "(0, 2)", &[])).contains("no grasps"));
        assert!(read(&npy("<f8", "(1, 3)", &[0; 24])).contains("3 columns but 2 joint names"));
        assert!(read(&npy("<f8", "(2, 2)", &[0; 31])).contains("31 bytes"));
        assert!(read(&npy("<i8", "(2, 2)", &[0; 32])).contains("<i8"));
        assert!(read(&npy("<f8", "(4,)", &[0; 32])).contains("1 dimensions"));
        assert!(read(&npy("<f8", "(9223372036854775807, 2)", &[0; 32])).contains("32 bytes"));
        assert!(read(&npy("<f8", "(1, 2)", &[90f64.to_le_bytes(), 0f64.to_le_bytes()].concat())).contains("degrees"));
        assert!(
            read(&npy("<f8", "(1, 2)", &[f64::NAN.to_le_bytes(), 0f64.to_le_bytes()].concat())).contains("joint a")
        );
    }

    #[test]
    fn json_is_checked_and_survives_a_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("g.json");
        let poses = JointPoses { names: names(), rows: vec![vec![0.1, 0.2]] };
        write_grasps_json(&path, &GraspFile::new(&poses)).unwrap();
        assert_eq!(read_grasps(&path, None).unwrap(), poses);
        let parse = |text: &str| parse_grasps_json(&path, text.as_bytes()).unwrap_err().to_string();
        assert!(parse(r#"{"schema":1,"joint_names":["a"],"unit":"rad","grasps":[]}"#).contains("no grasps"));
        assert!(parse(r#"{"schema":1,"joint_names":["a"],"unit":"deg","grasps":[[1]]}"#).contains("deg"));
        let wrist = r#"{"schema":1,"joint_names":["a"],"unit":"rad","grasps":[[1]],"wrist":[[0,0,0,2,0,0,0]]}"#;
        assert!(parse(wrist).contains("wrist pose 0"));
        let unknown = parse("{\"schema\":1,\n\"joints\":[\"a\"],\"unit\":\"rad\",\"grasps\":[[1]]}");
        assert!(unknown.contains("line 2") && unknown.contains("joints"), "{unknown}");
    }
}
