//! Keypoints and descriptors of one photo.

use drex_core::stats::upper_median;
use openmvg_features::extraction::{AlpExtractor, AlpPreset, GrayImage};
use openmvg_sfm::Keypoint;

use crate::photos::Grey;

/// Photos are scaled down to this side for the detector: finer detail than this is noise in most lenses.
const MAX_SIDE: usize = 1600;
/// The cells of a photo, each way, over which keypoints are spread before the weakest are cut.
const CELLS: usize = 8;

/// What a photo shows. Pixel coordinates are the engine's: the centre of the first pixel is (0, 0).
#[derive(Debug, Clone, Default)]
pub(crate) struct Features {
    pub(crate) keypoints: Vec<Keypoint>,
    pub(crate) descriptors: Vec<[u8; 128]>,
    /// Keypoints before any were left out or cut.
    pub(crate) found: usize,
    /// Median standard deviation of the finest blobs, pixels: large in a photo that is out of focus or smeared.
    pub(crate) finest_px: f64,
}

/// Finds at most `most` keypoints, of those at pixels where `mask` is white.
pub(crate) fn extract(grey: &Grey, mask: Option<&Grey>, most: usize) -> Result<Features, String> {
    let (image, factor) = scaled(grey);
    let extractor = AlpExtractor::with_preset(AlpPreset::High);
    let found = extractor.extract_u8(&image).map_err(|e| e.to_string())?;
    let count = found.len();
    let (points, descriptors) = found.into_parts();
    // Positions in the photo: pixel centres of the scaled image are at whole numbers too.
    let unscaled = |v: f32| (v + 0.5) * factor - 0.5;
    let mut kept: Vec<usize> = (0..points.len())
        .filter(|&i| mask.is_none_or(|m| shows(m, grey, unscaled(points[i].x), unscaled(points[i].y))))
        .collect();
    let strength = |i: usize| points[i].peak.abs();
    if kept.len() > most {
        kept = spread(&kept, most, [image.ncols(), image.nrows()], |i| [points[i].x, points[i].y], strength);
    }
    let mut features = Features { found: count, ..Features::default() };
    for i in kept {
        let p = &points[i];
        let keypoint = Keypoint::try_new(unscaled(p.x), unscaled(p.y), p.sigma * factor, p.orientation);
        if let Ok(keypoint) = keypoint {
            features.keypoints.push(keypoint);
            features.descriptors.push(*descriptors[i].as_array());
        }
    }
    let mut sigmas: Vec<f64> = points.iter().map(|p| f64::from(p.sigma * factor)).collect();
    sigmas.sort_by(f64::total_cmp);
    sigmas.truncate(sigmas.len() / 4);
    features.finest_px = upper_median(sigmas.into_iter()).unwrap_or(f64::INFINITY);
    Ok(features)
}

/// The photo for the detector, and its pixels per pixel of that.
fn scaled(grey: &Grey) -> (GrayImage, f32) {
    let side = grey.width.max(grey.height);
    if side <= MAX_SIDE {
        return (GrayImage::from_fn(grey.height, grey.width, |y, x| grey.at(x, y)), 1.0);
    }
    let factor = side as f32 / MAX_SIDE as f32;
    let width = ((grey.width as f32 / factor) as usize).max(1);
    let height = ((grey.height as f32 / factor) as usize).max(1);
    // The mean over the pixels that one stands for.
    let mean = |y: usize, x: usize| {
        let range = |i: usize, n: usize| {
            let first = (i as f32 * factor) as usize;
            first..(((i + 1) as f32 * factor).ceil() as usize).clamp(first + 1, n)
        };
        let (rows, columns) = (range(y, grey.height), range(x, grey.width));
        let count = (rows.len() * columns.len()) as f32;
        rows.map(|r| columns.clone().map(|c| grey.at(c, r)).sum::<f32>()).sum::<f32>() / count
    };
    (GrayImage::from_fn(height, width, mean), factor)
}

/// Whether the mask is white there; it may be smaller than the photo.
fn shows(mask: &Grey, photo: &Grey, x: f32, y: f32) -> bool {
    let column = ((x + 0.5) / photo.width as f32 * mask.width as f32) as usize;
    let row = ((y + 0.5) / photo.height as f32 * mask.height as f32) as usize;
    column < mask.width && row < mask.height && mask.at(column, row) >= 128.0
}

/// The strongest `most` of what is spread over the image: each cell gives its strongest first, then its second, and so on, so
/// that a busy table cannot take all places.
fn spread(
    all: &[usize],
    most: usize,
    size: [usize; 2],
    place: impl Fn(usize) -> [f32; 2],
    strength: impl Fn(usize) -> f32,
) -> Vec<usize> {
    let mut cells = vec![Vec::new(); CELLS * CELLS];
    for &i in all {
        let [x, y] = place(i);
        let cell = |v: f32, n: usize| ((v / n as f32 * CELLS as f32) as usize).min(CELLS - 1);
        cells[cell(y, size[1]) * CELLS + cell(x, size[0])].push(i);
    }
    for cell in &mut cells {
        cell.sort_by(|&a, &b| strength(b).total_cmp(&strength(a)).then(a.cmp(&b)));
    }
    let mut ranked: Vec<(usize, usize)> =
        cells.iter().flat_map(|cell| cell.iter().enumerate().map(|(rank, &i)| (rank, i))).collect();
    ranked.sort_by(|a, b| a.0.cmp(&b.0).then(strength(b.1).total_cmp(&strength(a.1))).then(a.1.cmp(&b.1)));
    ranked.truncate(most);
    let mut kept: Vec<usize> = ranked.into_iter().map(|(_, i)| i).collect();
    kept.sort_unstable();
    kept
}
