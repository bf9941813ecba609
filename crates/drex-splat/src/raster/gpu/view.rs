//! The camera and the options as the shaders read them.

use drex_core::camera::PinholeCamera;

use crate::Gaussians;
use crate::raster::{DepthKind, RenderOptions, TILE};

/// Margin round the image, as a part of its side, up to which the Jacobian of the projection follows a centre.
const JACOBIAN_MARGIN: f64 = 0.15;

/// Words of the struct `View` of `shaders/view.wgsl`, in its order.
pub(super) fn words(scene: &Gaussians, camera: &PinholeCamera, options: &RenderOptions) -> Vec<u32> {
    let pose = camera.camera_from_world.to_homogeneous();
    let eye = camera.centre();
    let (width, height) = (camera.width as f64, camera.height as f64);
    let limit =
        |f: f64, c: f64, side: f64| [-(c + JACOBIAN_MARGIN * side) / f, (side * (1.0 + JACOBIAN_MARGIN) - c) / f];
    let mut view = Words::default();
    for r in 0..3 {
        view.floats(pose.row(r).iter().copied());
    }
    view.floats([eye.x, eye.y, eye.z, 0.0]);
    view.singles(options.background);
    view.singles([0.0]);
    view.floats([camera.fx, camera.fy, camera.cx, camera.cy]);
    view.floats(limit(camera.fx, camera.cx, width));
    view.floats(limit(camera.fy, camera.cy, height));
    view.singles([options.near, options.max_alpha, options.blur, options.centre_cutoff]);
    view.singles(options.distortion_range);
    let flags = [options.antialias, options.depth == DepthKind::Ray, options.geometry, options.smooth_cutoff];
    let sides = [camera.width, camera.height];
    view.whole(sides);
    view.whole(sides.map(|side| side.div_ceil(TILE)));
    view.whole([scene.len(), scene.sh_stride() / 3, options.sh_degree.min(scene.sh_degree)]);
    view.whole([flags.iter().enumerate().map(|(bit, on)| usize::from(*on) << bit).sum()]);
    view.whole([0; 2]);
    view.0
}

#[derive(Default)]
struct Words(Vec<u32>);

impl Words {
    fn floats(&mut self, values: impl IntoIterator<Item = f64>) {
        self.0.extend(values.into_iter().map(|v| (v as f32).to_bits()));
    }

    fn singles(&mut self, values: impl IntoIterator<Item = f32>) {
        self.0.extend(values.into_iter().map(f32::to_bits));
    }

    fn whole<const N: usize>(&mut self, values: [usize; N]) {
        self.0.extend(values.map(|v| v as u32));
    }
}
