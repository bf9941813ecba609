//! Grey images: their pyramid, and values between pixel centres.

use std::borrow::Cow;

use nalgebra::Point2;

/// Levels with a shorter side are not searched: no tag fits.
const MIN_SIDE_PX: usize = 20;

/// A grey image, row by row, without padding.
pub(super) struct Grey<'a> {
    pub(super) width: usize,
    pub(super) height: usize,
    pixels: Cow<'a, [u8]>,
}

impl<'a> Grey<'a> {
    /// An image of these bytes. `None` if they are not width x height or the image is too small for any tag.
    pub(super) fn new(pixels: &'a [u8], width: usize, height: usize) -> Option<Self> {
        let fits = width.checked_mul(height) == Some(pixels.len());
        // Lengths of runs and coordinates are kept in 32 bits.
        let sane = width.min(height) >= MIN_SIDE_PX && width.max(height) < i32::MAX as usize / 2;
        (fits && sane).then_some(Self { width, height, pixels: Cow::Borrowed(pixels) })
    }

    /// This image and its halvings, down to the smallest in which a tag could be found.
    pub(super) fn pyramid(self) -> Vec<Self> {
        let mut levels = vec![self];
        while let Some(next) = levels.last().and_then(Grey::halved) {
            levels.push(next);
        }
        levels
    }

    fn halved(&self) -> Option<Self> {
        let (width, height) = (self.width / 2, self.height / 2);
        if width.min(height) < MIN_SIDE_PX {
            return None;
        }
        let mut pixels = Vec::with_capacity(width * height);
        for y in 0..height {
            let (above, below) = (self.row(2 * y), self.row(2 * y + 1));
            pixels.extend((0..width).map(|x| {
                let sum: u16 =
                    [above[2 * x], above[2 * x + 1], below[2 * x], below[2 * x + 1]].map(u16::from).iter().sum();
                ((sum + 2) / 4) as u8
            }));
        }
        Some(Self { width, height, pixels: Cow::Owned(pixels) })
    }

    pub(super) fn row(&self, y: usize) -> &[u8] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// Light at a point, 0 (black) to 1, between pixel centres bilinearly. `None` outside of the outermost centres.
    pub(super) fn light(&self, at: Point2<f64>) -> Option<f64> {
        let (x, y) = (at.x - 0.5, at.y - 0.5);
        if !(x >= 0.0 && y >= 0.0 && x <= (self.width - 1) as f64 && y <= (self.height - 1) as f64) {
            return None;
        }
        // The last pixel has no right or lower neighbour: there the one before it is used with the weight one.
        let (i, j) = ((x as usize).min(self.width - 2), (y as usize).min(self.height - 2));
        let (u, v) = (x - i as f64, y - j as f64);
        let k = j * self.width + i;
        let of = |k: usize| f64::from(LIGHT[usize::from(self.pixels[k])]);
        let above = of(k) * (1.0 - u) + of(k + 1) * u;
        let below = of(k + self.width) * (1.0 - u) + of(k + self.width + 1) * u;
        Some(above * (1.0 - v) + below * v)
    }
}

/// Light of a grey value. Lenses blur light, not the values of a file, so that the middle of an edge is half way in light;
/// half way in values lies inside the dark, by 0.3 px for usual blur, on every side of a tag alike.
///
/// A square stands in for sRGB's curve (IEC 61966-2-1): the tone curve of a camera is not known better.
static LIGHT: [f32; 256] = {
    let mut light = [0.0; 256];
    let mut v = 0;
    while v < 256 {
        let value = v as f32 / 255.0;
        light[v] = value * value;
        v += 1;
    }
    light
};
