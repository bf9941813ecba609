//! Keypoints and descriptors of one photo.

use openmvg_features::extraction::{AlpExtractor, AlpPreset, GrayImage};
use openmvg_sfm::Keypoint;

use crate::distance::Descriptor;
use crate::photos::Grey;

/// Photos are scaled down to this side for the detector: finer detail than this is noise in most lenses.
const MAX_SIDE: usize = 1600;
/// Photos are looked at at twice their size up to this side.
const MOST_ENLARGED: usize = 2600;
/// The cells of a photo, each way, over which keypoints are spread before the weakest are cut.
const CELLS: usize = 8;
/// Below this [`sharpness`] a photo is blurred: rendered and real photos that can be used have 0.25 to 1.9, smears of 25 to 40 pixels 0.21 at most.
const BLURRED: f64 = 0.22;

/// What a photo shows, the strongest keypoints of each part of the photo first. Pixel coordinates are the engine's: the centre of the first
/// pixel is (0, 0).
#[derive(Debug, Clone, Default)]
pub(crate) struct Features {
    pub(crate) keypoints: Vec<Keypoint>,
    pub(crate) descriptors: Vec<Descriptor>,
    /// Whether the photo is smeared or out of focus.
    pub(crate) blurred: bool,
}

impl Features {
    /// The first so many keypoints.
    pub(crate) fn first(&self, most: usize) -> Self {
        let n = self.keypoints.len().min(most);
        Self { keypoints: self.keypoints[..n].to_vec(), descriptors: self.descriptors[..n].to_vec(), ..*self }
    }

    /// Keeps the keypoints of these indices.
    pub(crate) fn retain(&mut self, keep: impl Fn(usize) -> bool) {
        let kept: Vec<usize> = (0..self.keypoints.len()).filter(|&k| keep(k)).collect();
        self.keypoints = kept.iter().map(|&k| self.keypoints[k]).collect();
        self.descriptors = kept.iter().map(|&k| self.descriptors[k]).collect();
    }
}

/// Finds at most `most` keypoints, of those at pixels where `mask` is white; `closer`: in the photo at twice its size, where blobs that are
/// smaller than the detector's smallest are found too.
pub(crate) fn extract(grey: &Grey, mask: Option<&Grey>, most: usize, closer: bool) -> Result<Features, String> {
    let extractor = AlpExtractor::with_preset(AlpPreset::High);
    let (mut image, mut factor) = scaled(grey);
    let mut found = extractor.extract_u8(&image).map_err(|e| e.to_string())?;
    if closer && 2 * grey.width.max(grey.height) <= MOST_ENLARGED {
        (image, factor) = (enlarged(grey), 0.5);
        found = extractor.extract_u8(&image).map_err(|e| e.to_string())?;
    }
    let (points, descriptors) = found.into_parts();
    // Positions in the photo: pixel centres of the scaled image are at whole numbers too.
    let unscaled = |v: f32| (v + 0.5) * factor - 0.5;
    let kept: Vec<usize> = (0..points.len())
        .filter(|&i| mask.is_none_or(|m| shows(m, grey, unscaled(points[i].x), unscaled(points[i].y))))
        .collect();
    let strength = |i: usize| points[i].peak.abs();
    let kept = spread(&kept, most, [image.ncols(), image.nrows()], |i| [points[i].x, points[i].y], strength);
    let mut features = Features { blurred: sharpness(grey) < BLURRED, ..Features::default() };
    for i in kept {
        let p = &points[i];
        let keypoint = Keypoint::try_new(unscaled(p.x), unscaled(p.y), p.sigma * factor, p.orientation);
        if let Ok(keypoint) = keypoint {
            features.keypoints.push(keypoint);
            features.descriptors.push(*descriptors[i].as_array());
        }
    }
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

/// The photo at twice its size, between pixels by splines; the pixel (0, 0) of the photo covers (0, 0) to (1, 1).
fn enlarged(grey: &Grey) -> GrayImage {
    let at = |k: usize, n: usize| ((k as f64 + 0.5) / 2.0 - 0.5).clamp(1.0, n as f64 - 2.001);
    GrayImage::from_fn(2 * grey.height, 2 * grey.width, |y, x| {
        let value = grey.cubic(at(x, grey.width), at(y, grey.height));
        value.map_or_else(|| grey.at(x / 2, y / 2), |v| v.clamp(0.0, 255.0) as f32)
    })
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
    ranked.into_iter().map(|(_, i)| i).collect()
}

/// How much of the texture is fine: energy of the gradient across its weaker direction at full resolution, in units of that at a quarter of
/// it, over the fifth of the photo's blocks with most texture. A smear keeps the gradient across itself and takes the one along.
fn sharpness(grey: &Grey) -> f64 {
    const BLOCK: usize = 32;
    let quarter = Grey {
        width: grey.width / 4,
        height: grey.height / 4,
        pixels: (0..(grey.width / 4) * (grey.height / 4))
            .map(|k| {
                let (x, y) = (k % (grey.width / 4) * 4, k / (grey.width / 4) * 4);
                let sum: u32 = (0..16).map(|n| u32::from(grey.pixels[(y + n / 4) * grey.width + x + n % 4])).sum();
                (sum / 16) as u8
            })
            .collect(),
    };
    let fine = weaker_energies(&smoothed(grey), BLOCK);
    let coarse = weaker_energies(&smoothed(&quarter), BLOCK / 4);
    let mut blocks: Vec<(f64, f64)> = coarse.into_iter().filter_map(|(at, c)| Some((c, *fine.get(&at)?))).collect();
    blocks.sort_by(|a, b| b.0.total_cmp(&a.0).then(b.1.total_cmp(&a.1)));
    blocks.truncate((blocks.len() / 5).max(1));
    let (coarse, fine) = blocks.iter().fold((0.0, 0.0), |(c, f), b| (c + b.0, f + b.1));
    if coarse > 0.0 { fine / coarse } else { 0.0 }
}

/// Smoothed by the binomial filter of five, rows of one length.
fn smoothed(grey: &Grey) -> (usize, Vec<f32>) {
    const FILTER: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
    let (w, h) = (grey.width, grey.height);
    let tap = |at: usize, k: usize, n: usize| (at + k).saturating_sub(2).min(n - 1);
    let mut across = vec![0.0; w * h];
    let mut out = vec![0.0; w * h];
    for (k, value) in across.iter_mut().enumerate() {
        *value = (0..5).map(|t| FILTER[t] * grey.at(tap(k % w, t, w), k / w)).sum();
    }
    for (k, value) in out.iter_mut().enumerate() {
        *value = (0..5).map(|t| FILTER[t] * across[tap(k / w, t, h) * w + k % w]).sum();
    }
    (w, out)
}

/// The smaller eigenvalue of the mean structure tensor of each block, by the block's column and row.
fn weaker_energies((w, values): &(usize, Vec<f32>), block: usize) -> std::collections::BTreeMap<[usize; 2], f64> {
    let mut sums = std::collections::BTreeMap::<[usize; 2], [f64; 3]>::new();
    let h = values.len() / (*w).max(1);
    for y in 1..h.saturating_sub(1) {
        for x in 1..w - 1 {
            let gx = f64::from(values[y * w + x + 1] - values[y * w + x - 1]) / 2.0;
            let gy = f64::from(values[(y + 1) * w + x] - values[(y - 1) * w + x]) / 2.0;
            let sum = sums.entry([x / block, y / block]).or_default();
            *sum = [sum[0] + gx * gx, sum[1] + gx * gy, sum[2] + gy * gy];
        }
    }
    let pixels = (block * block) as f64;
    let weaker = |[xx, xy, yy]: [f64; 3]| (0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt()) / pixels;
    sums.into_iter().map(|(at, sum)| (at, weaker(sum))).collect()
}
