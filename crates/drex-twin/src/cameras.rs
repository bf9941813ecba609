//! The cameras of a scan that were found already.

use std::io::Read;
use std::path::Path;

use drex_core::Result;
use drex_core::capture::{Capture, CaptureOptions, photos_in};

/// Folders of what is found, below the output folder.
pub(crate) const SFM: &str = "sfm";
pub(crate) const COLMAP: &str = "colmap";
pub(crate) const FRAMES: &str = "scan";

/// The photos of a scan with the cameras that lie beside them, or that were found for them when `out` was made of them.
///
/// # Errors
/// If there are no cameras, or a file is damaged.
pub fn cameras_of(scan: &Path, out: &Path) -> Result<Capture> {
    cameras_within(scan, out, &CaptureOptions::default())
}

/// As [`cameras_of`], with masks and maps where the options say.
pub(crate) fn cameras_within(scan: &Path, out: &Path, within: &CaptureOptions) -> Result<Capture> {
    let folder = if is_video(scan) { out.join(FRAMES) } else { scan.to_path_buf() };
    if !Capture::is_in(&folder) {
        for found in [SFM, COLMAP] {
            if let Some(capture) = load_found(&folder, &out.join(found), within)? {
                return Ok(capture);
            }
        }
    }
    Capture::load(&folder, within)
}

/// The largest model that was found for the photos of `folder` and written into `found`.
pub(crate) fn load_found(folder: &Path, found: &Path, within: &CaptureOptions) -> Result<Option<Capture>> {
    let mut within = within.clone();
    if let Some((root, _)) = photos_in(folder, &within) {
        within.images = Some(root);
    }
    Capture::load_model(folder, &found.join("sparse"), &within)
}

/// Whether an input is one file, neither picture nor text: ffmpeg says whether it is a video.
pub fn is_video(input: &Path) -> bool {
    const PICTURES: [&str; 13] =
        ["jpg", "jpeg", "png", "heic", "heif", "hif", "avif", "tif", "tiff", "webp", "bmp", "gif", "dng"];
    let picture = |e: &std::ffi::OsStr| PICTURES.iter().any(|p| e.eq_ignore_ascii_case(p));
    input.is_file() && !input.extension().is_some_and(picture) && !is_text(input)
}

/// Whether a file begins with UTF-8 text, as no container of a video does for long; an empty one does, an unreadable one does not.
fn is_text(file: &Path) -> bool {
    let mut start = Vec::new();
    let read = std::fs::File::open(file).and_then(|f| f.take(512).read_to_end(&mut start));
    let whole = |e: std::str::Utf8Error| e.error_len().is_none() && start.len() == 512;
    read.is_ok() && !start.contains(&0) && std::str::from_utf8(&start).map_or_else(whole, |_| true)
}
