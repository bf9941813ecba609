//! The calibration of a camera in a text file.

use std::path::Path;

use drex_core::camera::{Camera, CameraModel};
use drex_core::{Error, Result, fsutil};

const FORM: &str =
    "give the 3 x 3 matrix fx 0 cx, 0 fy cy, 0 0 1, or fx fy cx cy k1 k2 p1 p2 on one line, in pixels of the photos";

/// Reads the calibration of photos of `size_px`, width and height: a 3 x 3 camera matrix (nine numbers), or fx, fy, cx, cy and
/// the lens coefficients k1, k2, p1, p2 (eight numbers, or the first four). As OpenCV writes them, cx and cy count from the
/// centre of the first pixel. Text behind `#` is a comment, commas and brackets count as blanks.
///
/// # Errors
/// If the file cannot be read or its numbers are no calibration of such photos; the message names the file and what to give.
pub fn read_calibration(path: &Path, size_px: [u32; 2]) -> Result<Camera> {
    let refuse = |what: String| Err(Error::content(path, None, what, FORM));
    let text = fsutil::read_text(path)?;
    let mut numbers = Vec::new();
    for word in text.lines().flat_map(|l| l.split('#').next()).flat_map(|l| l.split([' ', '\t', ',', ';', '[', ']'])) {
        match word.trim() {
            "" => {}
            word => match word.parse::<f64>().ok().filter(|v| v.is_finite()) {
                Some(v) => numbers.push(v),
                None => return refuse(format!("`{word}` is no number")),
            },
        }
    }
    let [fx, fy, cx, cy, k1, k2, p1, p2] = match numbers[..] {
        [fx, skew, cx, a, fy, cy, b, c, one] => {
            if [a, b, c] != [0.0; 3] || one != 1.0 || skew.abs() > 1e-3 * fx.abs() {
                return refuse("the nine numbers are no camera matrix without skew".into());
            }
            [fx, fy, cx, cy, 0.0, 0.0, 0.0, 0.0]
        }
        [fx, fy, cx, cy] => [fx, fy, cx, cy, 0.0, 0.0, 0.0, 0.0],
        [fx, fy, cx, cy, k1, k2, p1, p2] => [fx, fy, cx, cy, k1, k2, p1, p2],
        _ => return refuse(format!("{} numbers are no calibration", numbers.len())),
    };
    let [width, height] = size_px;
    let (w, h) = (f64::from(width), f64::from(height));
    let longest = w.max(h);
    if !(fx > 0.0 && fy > 0.0) {
        return refuse(format!("the focal lengths {fx} and {fy} are not positive"));
    }
    let plausible = |f: f64| (0.2 * longest..=20.0 * longest).contains(&f);
    if !(plausible(fx) && plausible(fy) && (0.2 * w..0.8 * w).contains(&cx) && (0.2 * h..0.8 * h).contains(&cy)) {
        return refuse(format!(
            "focal lengths {fx}, {fy} and centre {cx}, {cy} are not of photos of {width} x {height} pixels"
        ));
    }
    Camera::new(CameraModel::OpenCv, width, height, &[fx, fy, cx + 0.5, cy + 0.5, k1, k2, p1, p2])
        .map_err(|e| Error::at(path, None, e))
}
