//! The visual hull: where all masks agree that the object may be, and nothing hangs before a lens.

use nalgebra::Point3;

use drex_core::camera::PinholeCamera;

/// Silhouettes of an object from several cameras, and how far before each there is nothing.
#[derive(Debug, Clone, Default)]
pub struct VisualHull {
    silhouettes: Vec<Silhouette>,
    /// Cameras with the depth up to which their view is free, scene units.
    free: Vec<(PinholeCamera, f64)>,
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

    /// Excludes what is in a camera's picture and nearer than `depth`, scene units.
    pub fn keep_free(&mut self, camera: &PinholeCamera, depth: f64) {
        self.free.push((camera.clone(), depth));
    }

    /// Adds what another excludes.
    pub fn extend(&mut self, other: &Self) {
        self.silhouettes.extend_from_slice(&other.silhouettes);
        self.free.extend_from_slice(&other.free);
    }

    /// How many silhouettes there are.
    pub fn len(&self) -> usize {
        self.silhouettes.len()
    }

    /// Whether there is no silhouette.
    pub fn is_empty(&self) -> bool {
        self.silhouettes.is_empty()
    }

    /// Whether neither a silhouette nor a free view excludes a world point. A camera that does not see the point's place
    /// says nothing.
    pub fn contains(&self, point_world: &[f32; 3]) -> bool {
        let point = Point3::from(point_world.map(f64::from));
        let in_the_way = |camera, depth| seen(camera, &point).is_some_and(|(_, z)| z < depth);
        self.silhouettes.iter().all(|s| s.allows(&point) != Some(false))
            && !self.free.iter().any(|(camera, depth)| in_the_way(camera, *depth))
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
        let ([x, y], _) = seen(&self.camera, point)?;
        let i = y as usize * self.camera.width + x as usize;
        Some((self.bits[i / 64] >> (i % 64)) & 1 == 1)
    }
}

/// Pixel and depth of a world point; `None` if it is behind the camera or outside the image.
fn seen(camera: &PinholeCamera, point: &Point3<f64>) -> Option<([f64; 2], f64)> {
    let ([x, y], z) = camera.project(point)?;
    let (w, h) = (camera.width as f64, camera.height as f64);
    (x >= 0.0 && x < w && y >= 0.0 && y < h).then_some(([x, y], z))
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

    #[test]
    fn nothing_is_near_in_a_free_view() {
        let camera = PinholeCamera {
            camera_from_world: drex_core::Pose::identity(),
            fx: 10.0,
            fy: 10.0,
            cx: 5.0,
            cy: 5.0,
            width: 10,
            height: 10,
        };
        let mut free = VisualHull::new();
        free.keep_free(&camera, 2.0);
        let mut hull = VisualHull::new();
        hull.extend(&free);
        assert!(!hull.contains(&[0.0, 0.0, 1.9]), "in the way");
        assert!(hull.contains(&[0.0, 0.0, 2.1]), "far enough");
        assert!(hull.contains(&[1.0, 0.0, 1.0]), "beside the picture");
        assert!(hull.contains(&[0.0, 0.0, -1.0]), "behind the camera");
        assert_eq!(hull.seen_by(&[0.0, 0.0, 1.0]), 0, "a free view is no silhouette");
    }
}
