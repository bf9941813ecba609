//! Tracks of FoundationPose: a folder of 4 x 4 text files, or the log that its demo prints.

use std::path::{Path, PathBuf};

use crate::clock::Clock;
use drex_core::pose::parse_pose_matrix;
use drex_core::{Error, Result, Trajectory, fsutil};

/// When the frames of a folder were taken.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum FrameTimes {
    /// Frame number divided by this rate, 1/s; the number is the one in the file name, so that missing frames leave gaps.
    Fps(f64),
    /// One time per file, seconds, in the natural order of the file names.
    Given(Vec<f64>),
}

/// Reads a folder of `<frame>.txt`, each a 4 x 4 `camera_from_object` (OpenCV axes, metres). If the folder holds
/// no such files but `ob_in_cam/` does, that one is read. Names are in natural order: `9.txt` before `10.txt`.
///
/// # Errors
/// If the folder cannot be read or holds no poses; if a file is no rigid transform; if there are not as many times as files.
pub fn read_foundation_pose_folder(folder: &Path, times: &FrameTimes) -> Result<Trajectory> {
    let mut files = pose_files(folder)?;
    let inner = folder.join("ob_in_cam");
    if files.is_empty() && inner.is_dir() {
        files = pose_files(&inner)?;
    }
    if files.is_empty() {
        return Err(Error::content(
            folder,
            None,
            "no <frame>.txt in the folder",
            "give FoundationPose's ob_in_cam folder",
        ));
    }
    let times_s = match times {
        FrameTimes::Given(given) if given.len() != files.len() => {
            let what = format!("{} times for {} pose files", given.len(), files.len());
            return Err(Error::content(folder, None, what, "give one time per file"));
        }
        FrameTimes::Given(given) => given.clone(),
        FrameTimes::Fps(fps) => {
            let fps = check_fps(*fps)?;
            files.iter().map(|(number, _)| *number as f64 / fps).collect()
        }
    };
    let poses = files
        .iter()
        .map(|(_, file)| parse_pose_matrix(file, 1, &fsutil::read_text(file)?))
        .collect::<Result<Vec<_>>>()?;
    Trajectory::from_samples(&times_s, &poses)
}

/// A frame rate that can divide.
pub(super) fn check_fps(fps: f64) -> Result<f64> {
    if fps.is_finite() && fps > 0.0 {
        Ok(fps)
    } else {
        Err(Error::value(format!("a frame rate of {fps} per second"), "give a positive number, such as fps = 30"))
    }
}

/// The `<number>.txt` files of `folder` in the order of their numbers.
fn pose_files(folder: &Path) -> Result<Vec<(u64, PathBuf)>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io("read", folder, e))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::io("read", folder, e))?.path();
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("txt")) && path.is_file() {
            let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
            let digits = stem.rsplit(|c: char| !c.is_ascii_digit()).next().unwrap_or_default();
            let number = digits.parse::<u64>().map_err(|_| {
                Error::content(&path, None, "the file name carries no frame number", "name pose files <frame>.txt")
            })?;
            files.push((number, path));
        }
    }
    files.sort();
    if let Some(pair) = files.windows(2).find(|w| w[0].0 == w[1].0) {
        let what = format!("the same frame number as {}", pair[0].1.display());
        return Err(Error::content(&pair[1].1, None, what, "keep one file per frame"));
    }
    Ok(files)
}

/// Reads the printed log: blocks `<ISO time> - Pose:` followed by a 4 x 4 `camera_from_object` in brackets. Other
/// blocks (`Final transform`, rounded) are skipped. `clock` says what the stamps mean; the times are seconds of it.
/// A last block that was cut off while it was written is ignored.
///
/// # Errors
/// If the file cannot be read or has no complete pose; with the line if any other block is malformed.
pub fn read_foundation_pose_log(path: &Path, clock: &Clock) -> Result<Trajectory> {
    parse_foundation_pose_log(path, &fsutil::read_bytes(path)?, clock)
}

/// As [`read_foundation_pose_log`], from memory.
///
/// # Errors
/// As [`read_foundation_pose_log`].
pub fn parse_foundation_pose_log(path: &Path, bytes: &[u8], clock: &Clock) -> Result<Trajectory> {
    // A cut-off file may end inside a character; what stands before is still text.
    let text = match std::str::from_utf8(bytes) {
        Ok(text) => text,
        Err(e) if e.error_len().is_none() => std::str::from_utf8(&bytes[..e.valid_up_to()]).unwrap_or_default(),
        Err(_) => {
            return Err(Error::content(path, None, "the file is not text", "check that this is the right file"));
        }
    };
    let lines: Vec<&str> = text.lines().collect();
    let headers: Vec<usize> = (0..lines.len()).filter(|&i| header(lines[i]).is_some()).collect();
    let (mut times_s, mut poses) = (Vec::new(), Vec::new());
    for (k, &at) in headers.iter().enumerate() {
        let Some((stamp, "Pose")) = header(lines[at]) else {
            continue;
        };
        let next = headers.get(k + 1).copied();
        let block = lines[at + 1..next.unwrap_or(lines.len())].join("\n");
        let Some(matrix) = bracketed(&block) else {
            if next.is_none() {
                break; // cut off while it was written
            }
            let what = "the matrix of this pose has no closing bracket";
            return Err(Error::content(path, at + 1, what, "remove the block or record again"));
        };
        times_s.push(clock.parse(stamp).map_err(|e| Error::at(path, at + 1, e))?);
        poses.push(parse_pose_matrix(path, at + 2, matrix)?);
    }
    if poses.is_empty() {
        let what = "no complete `<ISO time> - Pose:` block";
        return Err(Error::content(path, None, what, "give the log that FoundationPose printed during the push"));
    }
    Trajectory::from_samples(&times_s, &poses)
}

/// Stamp and title of a block header `<stamp> - <title>:`.
fn header(line: &str) -> Option<(&str, &str)> {
    let (stamp, title) = line.trim_end().strip_suffix(':')?.split_once(" - ")?;
    stamp.starts_with(|c: char| c.is_ascii_digit()).then_some((stamp, title))
}

/// The text from the first `[` to the `]` that closes it.
fn bracketed(text: &str) -> Option<&str> {
    let open = text.find('[')?;
    let mut depth = 0usize;
    for (i, c) in text[open..].char_indices() {
        match c {
            '[' => depth += 1,
            ']' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return Some(&text[open..open + i + 1]);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOG: &str = "2025-04-17T18:59:37.5 - Final transform:\n[[1 0 0 0]\n [0 1 0 0]\n [0 0 1 0]\n [0 0 0 1]]\n\
        2025-04-17T18:59:37.5 - Pose:\ntensor([[[ 1.0, 0.0, 0.0, 0.1],\n [0.0, 1.0, 0.0, 0.2],\n [0.0, 0.0, 1.0, 8e-1],\n \
        [0.0, 0.0, 0.0, 1.0]]], device='cuda:0')\n";

    fn parse(text: &str) -> Result<Trajectory> {
        parse_foundation_pose_log(Path::new("poses.txt"), text.as_bytes(), &Clock::LocalIso { utc_offset_minutes: 0 })
    }

    #[test]
    fn only_pose_blocks_count() {
        let track = parse(LOG).unwrap();
        assert_eq!(track.len(), 1);
        assert_eq!(track.poses()[0].translation.vector.z, 0.8);
    }

    #[test]
    fn any_cut_off_end_is_ignored_and_no_cut_adds_a_pose() {
        let second = LOG.replace("37.5", "38.5");
        for cut in 0..second.len() {
            let track = parse(&format!("{LOG}{}", &second[..cut])).unwrap();
            let closing = second.find("]]]").unwrap();
            assert_eq!(track.len(), if cut >= closing + 3 { 2 } else { 1 }, "cut at {cut}");
        }
    }

    #[test]
    fn a_broken_block_in_the_middle_is_named_by_its_line() {
        let broken = LOG.replace("8e-1]", "8e-1x]");
        let message = parse(&format!("{broken}{LOG}")).unwrap_err().to_string();
        assert!(message.contains("line 9") && message.contains("8e-1x"), "{message}");
        let unclosed = LOG.replace("]]]", "");
        assert!(parse(&format!("{unclosed}{LOG}")).unwrap_err().to_string().contains("line 6"));
        assert!(parse(&LOG.replace("8e-1", "nan")).unwrap_err().to_string().contains("line 9"));
        assert!(parse(&LOG.replace("8e-1", "800")).unwrap_err().to_string().contains("millimetres"));
    }
}
