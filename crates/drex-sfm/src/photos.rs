//! The photos: which there are, how large they are, what they say of their camera, and their grey pixels.

use std::path::Path;

/// Size and camera of a photo, from its header.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Header {
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Maker, model, lens and focal length as the EXIF block has them; photos of one device agree in it.
    pub(crate) device: Option<String>,
    /// Focal length in pixels by the EXIF block.
    pub(crate) focal_px: Option<f64>,
}

/// Grey pixels, row by row.
#[derive(Debug, Clone)]
pub(crate) struct Grey {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) pixels: Vec<u8>,
}

impl Grey {
    /// The value at whole pixel coordinates inside the image.
    pub(crate) fn at(&self, x: usize, y: usize) -> f32 {
        f32::from(self.pixels[y * self.width + x])
    }

    /// Value between pixels by Catmull-Rom splines, where pixel centres have whole coordinates; `None` near the rim and outside.
    pub(crate) fn cubic(&self, x: f64, y: f64) -> Option<f64> {
        let inside = x >= 1.0 && y >= 1.0 && x < (self.width as f64 - 2.0) && y < (self.height as f64 - 2.0);
        if !inside {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (across, down) = (catmull_rom(x - column as f64), catmull_rom(y - row as f64));
        let mut sum = 0.0;
        for (dy, wy) in down.iter().enumerate() {
            let first = (row + dy - 1) * self.width + column - 1;
            let line = &self.pixels[first..first + 4];
            sum += wy * line.iter().zip(&across).map(|(v, w)| f64::from(*v) * w).sum::<f64>();
        }
        Some(sum)
    }
}

/// Weights of the four values round a place between the second and the third.
fn catmull_rom(t: f64) -> [f64; 4] {
    [
        0.5 * t * (-1.0 + t * (2.0 - t)),
        1.0 + 0.5 * t * t * (-5.0 + 3.0 * t),
        0.5 * t * (1.0 + t * (4.0 - 3.0 * t)),
        0.5 * t * t * (-1.0 + t),
    ]
}

/// Reads size and EXIF block.
pub(crate) fn read_header(path: &Path) -> Result<Header, String> {
    let [width, height] = drex_core::capture::photo_size(path).map_err(|e| e.to_string())?;
    let exif = std::fs::File::open(path)
        .ok()
        .and_then(|file| exif::Reader::new().read_from_container(&mut std::io::BufReader::new(file)).ok());
    let (mut device, mut focal_px) = (None, None);
    if let Some(exif) = exif {
        let text = |tag| exif.get_field(tag, exif::In::PRIMARY).map(|f| f.display_value().to_string());
        let number = |tag| match exif.get_field(tag, exif::In::PRIMARY).map(|f| &f.value) {
            Some(exif::Value::Rational(v)) => v.first().map(exif::Rational::to_f64),
            Some(value) => value.get_uint(0).map(f64::from),
            None => None,
        };
        focal_px = focal_of(number(exif::Tag::FocalLengthIn35mmFilm), width, height);
        let parts = [exif::Tag::Make, exif::Tag::Model, exif::Tag::LensModel, exif::Tag::FocalLength];
        let parts: Vec<String> = parts.into_iter().filter_map(text).collect();
        if !parts.is_empty() {
            device = Some(format!("{} {}", parts.join(" "), focal_px.unwrap_or(0.0)));
        }
    }
    Ok(Header { width, height, device, focal_px })
}

/// Pixels of a focal length that is given for film of 36 x 24 mm. Sensors of another shape are compared by their diagonals.
fn focal_of(film_mm: Option<f64>, width: u32, height: u32) -> Option<f64> {
    let film_mm = film_mm.filter(|f| *f > 0.0 && f.is_finite())?;
    let (w, h) = (f64::from(width.max(height)), f64::from(width.min(height)));
    let diagonal_mm = 36f64.hypot(24.0);
    Some(if (w / h - 1.5).abs() < 0.02 { film_mm / 36.0 * w } else { film_mm / diagonal_mm * w.hypot(h) })
}

/// Reads a photo as it is stored (an orientation tag turns nothing), as grey.
pub(crate) fn read_grey(path: &Path) -> Result<Grey, String> {
    read_colours(path).map(|(grey, _)| grey)
}

/// A photo as grey ([`luma`]) and in colour.
pub(crate) fn read_colours(path: &Path) -> Result<(Grey, Vec<[u8; 3]>), String> {
    let ([width, height], rgb) = drex_core::capture::read_rgb(path).map_err(|e| e.to_string())?;
    let pixels = rgb.iter().map(luma).collect();
    Ok((Grey { width, height, pixels }, rgb))
}

/// Luma of ITU-R BT.601.
pub(crate) fn luma(colour: &[u8; 3]) -> u8 {
    let [r, g, b] = colour.map(u32::from);
    ((299 * r + 587 * g + 114 * b + 500) / 1000) as u8
}

/// Refuses a mask of another aspect than its photo.
pub(crate) fn check_mask(photo: &Grey, mask: &Grey) -> Result<(), String> {
    let (a, b) = (photo.width * mask.height, photo.height * mask.width);
    if a.abs_diff(b) > photo.width.max(photo.height) * 2 {
        return Err(format!(
            "its mask has {} x {} pixels, the photo {} x {}: give masks of the photos' aspect",
            mask.width, mask.height, photo.width, photo.height
        ));
    }
    Ok(())
}
