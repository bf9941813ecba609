//! The camera of HaMeR (Pavlakos et al., CVPR 2024): from the crop around a hand to the whole picture.

use nalgebra::Vector3;

/// Weak-perspective camera of one crop and where the crop lies in the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CropCamera {
    /// `pred_cam`: scale s and shifts tx, ty.
    pub pred_cam: [f64; 3],
    /// `box_center`: centre of the crop in the picture, pixels.
    pub box_center: [f64; 2],
    /// `box_size`: side of the crop, pixels.
    pub box_size: f64,
    /// `img_size`: width and height of the picture, pixels.
    pub img_size: [f64; 2],
    /// Whether the hand is a right one. HaMeR turns pictures of left hands around before it looks at them.
    pub right: bool,
}

/// Focal length HaMeR was trained with, pixels, and the side of its input picture.
const TRAINED: (f64, f64) = (5000.0, 256.0);

/// Translation of the hand's key points into the camera's frame (x right, y down, z forward, metres): with b the side of the
/// box, c its centre, W x H the picture and f the focal length, tz = 2 f / (b s), tx and ty grow by 2 (c - W/2) / (b s) and
/// 2 (c - H/2) / (b s); tx of a left hand is turned around first (`cam_crop_to_full` and `demo.py` of the HaMeR repository).
///
/// Without `focal_px` the focal length is HaMeR's guess, 5000/256 times the longer side of the picture; depth is only as true as that.
/// `None` if the box or the scale is not positive, or a number is not finite.
pub fn crop_to_full(camera: &CropCamera, focal_px: Option<f64>) -> Option<Vector3<f64>> {
    let [s, tx, ty] = camera.pred_cam;
    let [w, h] = camera.img_size;
    let f = focal_px.unwrap_or(TRAINED.0 / TRAINED.1 * w.max(h));
    let bs = camera.box_size * s;
    if !(bs > 0.0 && f > 0.0) {
        return None;
    }
    let tx = if camera.right { tx } else { -tx };
    let [cx, cy] = camera.box_center;
    let t = Vector3::new(tx + 2.0 * (cx - w / 2.0) / bs, ty + 2.0 * (cy - h / 2.0) / bs, 2.0 * f / bs);
    t.iter().all(|v| v.is_finite()).then_some(t)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// The crop shows p = s (X + t) in units of half the crop; a pinhole with the full camera must show the same pixel.
    #[test]
    fn the_hand_s_origin_falls_on_the_same_pixel() {
        let camera = CropCamera {
            pred_cam: [0.9, 0.07, -0.11],
            box_center: [900.0, 200.0],
            box_size: 220.0,
            img_size: [1280.0, 720.0],
            right: true,
        };
        for focal in [None, Some(1100.0)] {
            let t = crop_to_full(&camera, focal).unwrap();
            let f = focal.unwrap_or(25_000.0);
            let pixel = [f * t.x / t.z + 640.0, f * t.y / t.z + 360.0];
            let half = camera.box_size / 2.0;
            let expected = [900.0 + half * 0.9 * 0.07, 200.0 - half * 0.9 * 0.11];
            assert!((pixel[0] - expected[0]).abs() < 1e-9 && (pixel[1] - expected[1]).abs() < 1e-9, "{pixel:?}");
        }
    }

    #[test]
    fn a_left_hand_is_the_mirror_image_of_a_right_one() {
        let right = CropCamera {
            pred_cam: [0.8, 0.05, 0.02],
            box_center: [300.0, 400.0],
            box_size: 200.0,
            img_size: [640.0, 480.0],
            right: true,
        };
        let left = CropCamera { box_center: [340.0, 400.0], right: false, ..right };
        let (r, l) = (crop_to_full(&right, None).unwrap(), crop_to_full(&left, None).unwrap());
        assert!((l - Vector3::new(-r.x, r.y, r.z)).norm() < 1e-12);
        assert_eq!(crop_to_full(&CropCamera { box_size: 0.0, ..right }, None), None);
        assert_eq!(crop_to_full(&CropCamera { pred_cam: [f64::NAN; 3], ..right }, None), None);
    }
}
