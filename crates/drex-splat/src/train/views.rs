//! Where training gets its photos from.

use std::sync::Arc;

use drex_core::camera::PinholeCamera;
use drex_core::capture::{Photo, Photos};

use crate::{Error, Result};

/// Posed photos by number: a capture's, or some in memory.
pub trait Views: Sync {
    /// How many there are.
    fn count(&self) -> usize;

    /// Photo number `i`.
    ///
    /// # Errors
    /// If it cannot be read.
    fn photo(&self, i: usize) -> Result<Arc<Photo>>;

    /// What messages call it.
    fn name(&self, i: usize) -> String {
        format!("number {i}")
    }
}

impl Views for Photos {
    fn count(&self) -> usize {
        self.len()
    }

    fn photo(&self, i: usize) -> Result<Arc<Photo>> {
        Ok(self.get(i)?)
    }

    fn name(&self, i: usize) -> String {
        Photos::name(self, i).to_owned()
    }
}

impl Views for Vec<Arc<Photo>> {
    fn count(&self) -> usize {
        self.len()
    }

    fn photo(&self, i: usize) -> Result<Arc<Photo>> {
        self.get(i).cloned().ok_or_else(|| Error::Option {
            what: format!("there is no photo {i} among {}", self.len()),
            remedy: "give numbers of photos that exist".into(),
        })
    }
}

/// Refuses a photo whose pictures are not of its camera's size.
pub(crate) fn check_sizes(photo: &Photo, name: impl Fn() -> String) -> Result<()> {
    let (width, height) = (photo.camera.width, photo.camera.height);
    let lengths = [
        ("the colours", Some(photo.rgb.len())),
        ("the mask", photo.mask.as_ref().map(Vec::len)),
        ("the depth", photo.depth.as_ref().map(Vec::len)),
        ("the normals", photo.normal.as_ref().map(Vec::len)),
    ];
    for (what, length) in lengths {
        if let Some(length) = length.filter(|&n| Some(n) != width.checked_mul(height)) {
            return Err(Error::Training {
                what: format!("{what} of the photo {} have {length} pixels, its camera {width} x {height}", name()),
                remedy: "give pictures of the camera's size".into(),
            });
        }
    }
    Ok(())
}

/// A photo made `divisor` times smaller along each side: the mean of the pixels that fall together; what is left over
/// at the right and lower edge is cut off.
pub(crate) fn reduced(photo: &Photo, divisor: usize) -> Photo {
    let (w, h) = (photo.camera.width / divisor, photo.camera.height / divisor);
    if divisor <= 1 || w == 0 || h == 0 {
        return photo.clone();
    }
    let d = divisor as f64;
    let camera = PinholeCamera {
        fx: photo.camera.fx / d,
        fy: photo.camera.fy / d,
        cx: photo.camera.cx / d,
        cy: photo.camera.cy / d,
        width: w,
        height: h,
        ..photo.camera.clone()
    };
    let cell = |x: usize, y: usize| {
        let full = photo.camera.width;
        (y * divisor..(y + 1) * divisor).flat_map(move |v| (x * divisor..(x + 1) * divisor).map(move |u| v * full + u))
    };
    let pixels = || (0..h).flat_map(|y| (0..w).map(move |x| (x, y)));
    let area = (divisor * divisor) as u32;
    let mean = |values: &[u8], x, y| ((cell(x, y).map(|i| u32::from(values[i])).sum::<u32>() + area / 2) / area) as u8;
    let rgb = pixels().map(|(x, y)| {
        let mut sum = [0u32; 3];
        for i in cell(x, y) {
            for k in 0..3 {
                sum[k] += u32::from(photo.rgb[i][k]);
            }
        }
        sum.map(|s| ((s + area / 2) / area) as u8)
    });
    let depth = |values: &[f32], x, y| {
        let (sum, n) = cell(x, y).map(|i| values[i]).filter(|&z| z > 0.0).fold((0.0, 0), |(s, n), z| (s + z, n + 1));
        if n > 0 { sum / n as f32 } else { 0.0 }
    };
    let normal = |values: &[[f32; 3]], x, y| {
        let mut sum = nalgebra::Vector3::<f32>::zeros();
        for i in cell(x, y) {
            sum += nalgebra::Vector3::from(values[i]);
        }
        sum.try_normalize(1e-6).map_or([0.0; 3], Into::into)
    };
    Photo {
        rgb: rgb.collect(),
        mask: photo.mask.as_ref().map(|m| pixels().map(|(x, y)| mean(m, x, y)).collect()),
        depth: photo.depth.as_ref().map(|m| pixels().map(|(x, y)| depth(m, x, y)).collect()),
        confidence: photo.confidence.as_ref().map(|c| pixels().map(|(x, y)| mean(c, x, y)).collect()),
        normal: photo.normal.as_ref().map(|m| pixels().map(|(x, y)| normal(m, x, y)).collect()),
        camera,
    }
}
