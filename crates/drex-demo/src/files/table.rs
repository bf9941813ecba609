//! Demonstrations in comma-separated text.

use std::path::Path;

use drex_core::{Error, Result};
use drex_recording::readers::Table;
use nalgebra::Point3;

use super::objects::pose_of;
use super::order::{MANUS_NODES, key_point_named};
use super::{RawDemonstration, RawFrame};
use crate::KEYPOINTS;

/// Columns of the object's pose.
const OBJECT: [&str; 7] = ["object_x", "object_y", "object_z", "object_qw", "object_qx", "object_qy", "object_qz"];

/// Reads a table with three columns per key point, `wrist_x, wrist_y, wrist_z, thumb_cmc_x, …`, or numbered, `p0_x` (also `x0`) to `p20_z`,
/// or to `p24_z` for the 25 nodes of a Manus glove. Also `t` (s) and the object's pose (`object_x` to `object_qz`). Empty cells
/// and `nan` are points that were not seen.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<RawDemonstration> {
    let table = Table::parse(path, bytes)?;
    let columns = Columns::find(path, &table)?;
    let number = |row: usize, column: usize| -> Result<f64> {
        let text = table.text(row, column);
        match text.to_ascii_lowercase().as_str() {
            "" | "nan" | "null" | "none" | "na" => Ok(f64::NAN),
            _ => text.parse().map_err(|_| {
                let what = format!("column {}: `{text}` is not a number", table.header()[column]);
                Error::content(path, table.line(row), what, "leave the cell empty where nothing was seen")
            }),
        }
    };
    let mut frames = Vec::with_capacity(table.len());
    for row in 0..table.len() {
        let mut frame = RawFrame::new(Default::default());
        for (slot, axes) in frame.points.iter_mut().zip(&columns.points) {
            let [x, y, z] = [number(row, axes[0])?, number(row, axes[1])?, number(row, axes[2])?];
            *slot = [x, y, z].iter().all(|v| v.is_finite()).then(|| Point3::new(x, y, z));
        }
        frame.t_s = columns.t.map(|c| number(row, c)).transpose()?;
        if let Some(object) = &columns.object {
            let numbers = object.iter().map(|&c| number(row, c)).collect::<Result<Vec<_>>>()?;
            frame.object = pose_of(&numbers).map_err(|e| Error::at(path, table.line(row), e))?;
        }
        frames.push(frame);
    }
    let mut raw = RawDemonstration { frames, named: columns.named, ..RawDemonstration::default() };
    if table.cut_rows > 0 {
        raw.notes.push("the last row was cut off and is left out".into());
    }
    Ok(raw)
}

/// Where everything stands.
struct Columns {
    points: [[usize; 3]; KEYPOINTS],
    named: bool,
    t: Option<usize>,
    object: Option<Vec<usize>>,
}

impl Columns {
    fn find(path: &Path, table: &Table) -> Result<Self> {
        // Columns of each named key point and of each numbered one.
        let (mut named, mut numbered) = (vec![[None; 3]; KEYPOINTS], vec![[None; 3]; 25]);
        for (column, header) in table.header().iter().enumerate() {
            let Some((point, axis)) = point_and_axis(header) else { continue };
            let slot = match point {
                Point::Named(i) => &mut named[i][axis],
                Point::Numbered(i) if i < numbered.len() => &mut numbered[i][axis],
                Point::Numbered(_) => continue,
            };
            if slot.replace(column).is_some() {
                let what = format!("two columns are `{header}`");
                return Err(Error::content(path, 1, what, "keep one"));
            }
        }
        let whole = |slots: &[[Option<usize>; 3]]| -> Option<Vec<[usize; 3]>> {
            slots.iter().map(|s| Some([s[0]?, s[1]?, s[2]?])).collect()
        };
        let (points, named) = if let Some(points) = whole(&named) {
            (points, true)
        } else if let Some(nodes) = whole(&numbered) {
            (MANUS_NODES.iter().map(|&i| nodes[i]).collect(), false)
        } else if let Some(points) = whole(&numbered[..KEYPOINTS]) {
            (points, false)
        } else {
            let head = table.header().iter().take(6).map(String::as_str).collect::<Vec<_>>().join(", ");
            return Err(Error::content(
                path,
                1,
                format!("the columns ({head}, …) do not name x, y and z of 21 key points"),
                "name them wrist_x, wrist_y, wrist_z, thumb_cmc_x, … or p0_x, p0_y, p0_z, … p20_z",
            ));
        };
        let mut out = [[0; 3]; KEYPOINTS];
        out.copy_from_slice(&points);
        let t = ["t", "time", "t_s", "time_s", "timestamp"].iter().find_map(|n| table.find(n));
        Ok(Self { points: out, named, t, object: table.columns(&OBJECT).ok() })
    }
}

enum Point {
    Named(usize),
    Numbered(usize),
}

/// `thumb_tip_x`, `p4_x`, `4_x`, `x4`, also with the unit behind: `thumb_tip_x_m`.
fn point_and_axis(header: &str) -> Option<(Point, usize)> {
    let header = header.trim().to_ascii_lowercase();
    let header = ["_m", "_mm", "_cm"].iter().find_map(|u| header.strip_suffix(u)).unwrap_or(&header);
    if let Some(axis) = "xyz".find(header.chars().next()?)
        && let Ok(i) = header[1..].trim_start_matches('_').parse()
    {
        return Some((Point::Numbered(i), axis));
    }
    let (name, axis) = header.rsplit_once('_')?;
    let axis = ["x", "y", "z"].iter().position(|a| *a == axis)?;
    if let Some(i) = key_point_named(name) {
        return Some((Point::Named(i), axis));
    }
    let digits = name.trim_start_matches(|c: char| !c.is_ascii_digit());
    let prefix = &name[..name.len() - digits.len()];
    let known = ["", "p", "kp", "keypoint", "point", "node", "joint", "landmark", "lm"];
    known.contains(&prefix.trim_end_matches('_')).then(|| digits.parse().ok().map(|i| (Point::Numbered(i), axis)))?
}
