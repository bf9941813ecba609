//! The visual hull: where all masks agree that the object may be.

use nalgebra::Point3;

use drex_core::camera::PinholeCamera;

/// Silhouettes of an object from several cameras.
#[derive(Debug, Clone, Default)]
pub struct VisualHull {
    silhouettes: Vec<Silhouette>,
}

#[derive(Debug, Clone)]
struct Silhouette {
    camera: PinholeCamera,
    /// One bit a pixel, row by row: set inside the mask and in a margin round it.
    bits: Vec<u64>,
}

impl VisualHull {
    /// A hull without silhouettes, which holds everything.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds the mask of one photo (`mask[row * width + column]`, 128 and more is the object), grown by `margin_px`.
    /// A mask of another size than the camera's image is ignored.
    pub fn add(&mut self, camera: &PinholeCamera, mask: &[u8], margin_px: usize) {
        let (w, h) = (camera.width, camera.height);
        if mask.len() != w * h {
            return;
        }
        let inside: Vec<bool> = mask.iter().map(|&m| m >= 128).collect();
        let rows = grown(&inside, w, h, margin_px, 1, w);
        let grown = grown(&rows, h, w, margin_px, w, 1);
        let mut bits = vec![0u64; (w * h).div_ceil(64)];
        for (i, _) in grown.iter().enumerate().filter(|(_, m)| **m) {
            bits[i / 64] |= 1 << (i % 64);
        }
        self.silhouettes.push(Silhouette { camera: camera.clone(), bits });
    }

    /// Adds the silhouettes of another.
    pub fn extend(&mut self, other: &Self) {
        self.silhouettes.extend_from_slice(&other.silhouettes);
    }

    /// How many silhouettes there are.
    pub fn len(&self) -> usize {
        self.silhouettes.len()
    }

    /// Whether there is no silhouette.
    pub fn is_empty(&self) -> bool {
        self.silhouettes.is_empty()
    }

    /// Whether no silhouette excludes a world point. A camera that does not see the point's place says nothing.
    pub fn contains(&self, point_world: &[f32; 3]) -> bool {
        let point = Point3::from(point_world.map(f64::from));
        self.silhouettes.iter().all(|s| s.allows(&point) != Some(false))
    }

    /// How many silhouettes can judge a world point: it is before their camera and inside the image.
    pub fn seen_by(&self, point_world: &[f32; 3]) -> usize {
        let point = Point3::from(point_world.map(f64::from));
        self.silhouettes.iter().filter(|s| s.allows(&point).is_some()).count()
    }
}

impl Silhouette {
    /// Whether the silhouette allows the point; `None` where the camera does not see the point's place.
    fn allows(&self, point: &Point3<f64>) -> Option<bool> {
        let ([x, y], _) = self.camera.project(point)?;
        let (w, h) = (self.camera.width as f64, self.camera.height as f64);
        if !(x >= 0.0 && x < w && y >= 0.0 && y < h) {
            return None;
        }
        let i = y as usize * self.camera.width + x as usize;
        Some((self.bits[i / 64] >> (i % 64)) & 1 == 1)
    }
}

/// Marks everything within `margin` of something marked, along lines of `length` entries `step` apart; `lines` start
/// `next` apart.
fn grown(inside: &[bool], length: usize, lines: usize, margin: usize, step: usize, next: usize) -> Vec<bool> {
    let mut out = inside.to_vec();
    for line in 0..lines {
        let at = |k: usize| line * next + k * step;
        let mut since = usize::MAX;
        for k in 0..length {
            since = if inside[at(k)] { 0 } else { since.saturating_add(1) };
            out[at(k)] |= since <= margin;
        }
        since = usize::MAX;
        for k in (0..length).rev() {
            since = if inside[at(k)] { 0 } else { since.saturating_add(1) };
            out[at(k)] |= since <= margin;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_outside_one_mask_is_outside() {
        let camera = PinholeCamera {
            camera_from_world: drex_core::Pose::translation(0.0, 0.0, 2.0),
            fx: 10.0,
            fy: 10.0,
            cx: 5.5,
            cy: 4.5,
            width: 11,
            height: 9,
        };
        let mut mask = vec![0u8; 99];
        mask[4 * 11 + 5] = 255;
        let at = |dx: f64, dy: f64| [(dx * 0.2) as f32, (dy * 0.2) as f32, 0.0];
        for margin in 0..3 {
            let mut hull = VisualHull::new();
            hull.add(&camera, &mask, margin);
            for (dx, dy) in [(0_i32, 0_i32), (1, 0), (0, -1), (2, 2), (-3, 0), (4, 4)] {
                let inside = dx.unsigned_abs() as usize <= margin && dy.unsigned_abs() as usize <= margin;
                assert_eq!(hull.contains(&at(f64::from(dx), f64::from(dy))), inside, "margin {margin}, {dx}, {dy}");
            }
            assert_eq!(
                [hull.seen_by(&at(0.0, 0.0)), hull.seen_by(&[9.0, 0.0, 0.0]), hull.seen_by(&[0.0, 0.0, -5.0])],
                [1, 0, 0]
            );
            assert!(hull.contains(&[9.0, 0.0, 0.0]), "out of the image");
            assert!(hull.contains(&[0.0, 0.0, -5.0]), "behind the camera");
        }
        assert!(VisualHull::new().contains(&[1.0; 3]));
    }
}
