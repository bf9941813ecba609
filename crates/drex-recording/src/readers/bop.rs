//! Result files of the BOP benchmark: `scene_id,im_id,obj_id,score,R,t,time`.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Matrix3, Vector3};

use super::Table;
use super::foundation_pose::check_fps;
use drex_core::pose::{check_position, rotation_from_matrix};
use drex_core::{Error, Pose, Result, Trajectory, fsutil};

/// Nearest that an object is tracked in front of a camera, millimetres: smaller numbers are metres.
const NEAREST_MM: f64 = 10.0;

/// Which poses of the file make the track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BopSelection {
    /// Frames per second: the time of a frame is `im_id / fps`.
    pub fps: f64,
    /// Scene; may be left out if the file has one.
    pub scene_id: Option<u64>,
    /// Object; may be left out if the file has one.
    pub obj_id: Option<u64>,
}

/// Reads the track of one object: `camera_from_object` per image, translation converted from the file's MILLIMETRES to
/// metres. Of several poses in one image the one with the best score stays.
///
/// # Errors
/// If the file cannot be read, a column is missing, or several scenes or objects are there and none was chosen; with the
/// line if a number is not finite, R is no rotation, or t cannot be in millimetres.
pub fn read_bop_csv(path: &Path, selection: &BopSelection) -> Result<Trajectory> {
    parse_bop_csv(path, &fsutil::read_bytes(path)?, selection)
}

/// As [`read_bop_csv`], from memory.
///
/// # Errors
/// As [`read_bop_csv`].
pub fn parse_bop_csv(path: &Path, bytes: &[u8], selection: &BopSelection) -> Result<Trajectory> {
    let fps = check_fps(selection.fps)?;
    let table = Table::parse(path, bytes)?;
    let columns = table.columns(&["scene_id", "im_id", "obj_id", "score", "R", "t"])?;
    let id = |row: usize, column: usize| {
        table.text(row, column).parse::<u64>().map_err(|_| {
            let what =
                format!("column {}: `{}` is no number of a {0}", table.header()[column], table.text(row, column));
            Error::content(path, table.line(row), what, "give whole numbers")
        })
    };
    let ids = (0..table.len())
        .map(|row| Ok([id(row, columns[0])?, id(row, columns[1])?, id(row, columns[2])?]))
        .collect::<Result<Vec<_>>>()?;
    let scene = choose(path, "scene_id", selection.scene_id, ids.iter().map(|i| i[0]))?;
    let in_scene = ids.iter().filter(|i| i[0] == scene).map(|i| i[2]);
    let object = choose(path, "obj_id", selection.obj_id, in_scene)?;

    let mut best: BTreeMap<u64, (f64, usize)> = BTreeMap::new();
    for (row, [row_scene, image, row_object]) in ids.into_iter().enumerate() {
        if row_scene == scene && row_object == object {
            let score = table.number(row, columns[3])?;
            let entry = best.entry(image).or_insert((score, row));
            if score > entry.0 {
                *entry = (score, row);
            }
        }
    }
    let (mut times_s, mut poses) = (Vec::new(), Vec::new());
    let mut farthest_mm: f64 = 0.0;
    for (image, (_, row)) in best {
        let line = table.line(row);
        let r = Matrix3::from_row_slice(&vector::<9>(path, line, "R", table.text(row, columns[4]))?);
        let t = Vector3::from(vector::<3>(path, line, "t", table.text(row, columns[5]))?);
        let rotation = rotation_from_matrix(&r).map_err(|e| Error::at(path, line, e))?;
        farthest_mm = farthest_mm.max(t.norm());
        let t = t * 1e-3;
        check_position(path, line, &t)?;
        times_s.push(image as f64 / fps);
        poses.push(Pose::from_parts(t.into(), rotation));
    }
    if farthest_mm < NEAREST_MM {
        let what = format!("every t lies within {farthest_mm:.3} mm of the camera");
        return Err(Error::content(path, None, what, "t is in millimetres in this format; multiply metres by 1000"));
    }
    Trajectory::from_samples(&times_s, &poses)
}

/// The chosen id, or the only one there is.
fn choose(path: &Path, name: &str, chosen: Option<u64>, present: impl Iterator<Item = u64>) -> Result<u64> {
    let mut ids: Vec<u64> = present.collect();
    ids.sort_unstable();
    ids.dedup();
    match (chosen, ids.as_slice()) {
        (Some(id), _) if ids.contains(&id) => Ok(id),
        (Some(id), _) => Err(Error::content(
            path,
            None,
            format!("no {name} {id}; there are {ids:?}"),
            format!("choose one of these as {name}"),
        )),
        (None, [id]) => Ok(*id),
        (None, _) => {
            Err(Error::content(path, None, format!("several {name}: {ids:?}"), format!("choose one as {name}")))
        }
    }
}

/// Exactly `N` finite numbers separated by blanks.
fn vector<const N: usize>(path: &Path, line: usize, name: &str, text: &str) -> Result<[f64; N]> {
    let numbers: Vec<f64> =
        text.split_whitespace().filter_map(|t| t.parse().ok()).filter(|v: &f64| v.is_finite()).collect();
    if text.split_whitespace().count() != N {
        let what = format!("column {name} has {} entries, not {N}", text.split_whitespace().count());
        return Err(Error::content(path, line, what, "give numbers separated by blanks"));
    }
    numbers.try_into().map_err(|_| {
        Error::content(
            path,
            line,
            format!("column {name} has an entry that is no finite number"),
            "remove or repair the row",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "scene_id,im_id,obj_id,score,R,t,time\n\
        1,6,2,0.4,1 0 0 0 1 0 0 0 1,0 0 900,0.1\n1,3,2,0.9,1 0 0 0 1 0 0 0 1,100 -50 800,0.1\n1,6,2,0.5,1 0 0 0 0 -1 0 1 0,0 0 700,-1\n";

    fn parse(text: &str) -> Result<Trajectory> {
        let selection = BopSelection { fps: 30.0, scene_id: None, obj_id: None };
        parse_bop_csv(Path::new("bop.csv"), text.as_bytes(), &selection)
    }

    #[test]
    fn millimetres_become_metres_and_the_best_score_stays() {
        let track = parse(FILE).unwrap();
        assert_eq!(track.times_s(), [0.1, 0.2]);
        assert_eq!(track.poses()[0].translation.vector, Vector3::new(0.1, -0.05, 0.8));
        assert!((track.poses()[1].translation.z - 0.7).abs() < 1e-15);
    }

    #[test]
    fn metres_mirrored_rotations_and_ambiguous_objects_are_refused() {
        let metres =
            FILE.replace("0 0 900", "0 0 0.9").replace("100 -50 800", "0.1 0 0.8").replace("0 0 700", "0 0 0.7");
        assert!(parse(&metres).unwrap_err().to_string().contains("multiply metres by 1000"));
        let mirrored = FILE.replace("1 0 0 0 1 0 0 0 1,0 0 900", "1 0 0 0 1 0 0 0 -1,0 0 900").replace("0.4", "0.8");
        assert!(parse(&mirrored).unwrap_err().to_string().contains("line 2"));
        let two = format!("{FILE}1,9,5,0.5,1 0 0 0 1 0 0 0 1,0 0 700,-1\n");
        assert!(parse(&two).unwrap_err().to_string().contains("[2, 5]"));
    }
}
