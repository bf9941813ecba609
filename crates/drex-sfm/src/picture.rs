//! A picture of a model: its points in their colours and its cameras, from above and from the side.

use drex_core::Error;
use drex_core::capture::Capture;
use drex_core::stats::quantile;
use image::{ImageFormat, Rgb, RgbImage};
use nalgebra::{Point2, Point3, Unit, Vector3};

/// Name of its file in the folder of a registration.
pub const PICTURE: &str = "cameras.png";

/// Side of a view, pixels, and the margin in it.
const SIDE: u32 = 800;
const MARGIN: f64 = 40.0;
const BACKGROUND: Rgb<u8> = Rgb([24, 26, 30]);
const CAMERA: Rgb<u8> = Rgb([255, 160, 40]);
const INK: Rgb<u8> = Rgb([230, 230, 230]);
const AXES: [Rgb<u8>; 3] = [Rgb([240, 90, 80]), Rgb([110, 200, 90]), Rgb([100, 150, 255])];
/// Length of a drawn camera's sides, share of the scene's size.
const FRUSTUM: f64 = 0.04;
/// Points beyond these quantiles of each axis do not widen the picture.
const MIDDLE: [f64; 2] = [0.05, 0.95];

/// Which way is up in a capture: z where it is `metric` (by a marker), else away from where the photos' lower edges point.
pub fn up_of(capture: &Capture, metric: bool) -> Unit<Vector3<f64>> {
    let lower_edges = |v: &drex_core::capture::View| v.camera_from_world.rotation.inverse() * Vector3::y();
    let sum: Vector3<f64> =
        if metric { Vector3::zeros() } else { -capture.views.iter().map(lower_edges).sum::<Vector3<f64>>() };
    Unit::try_new(sum, 1e-9).unwrap_or(Vector3::z_axis())
}

/// Draws points and cameras as a PNG of 1600 x 800 pixels: left from above, right from the side. With `metric`, the model is in
/// metres with z up, and a bar has a length.
///
/// # Errors
/// If the picture cannot be encoded.
pub fn draw(capture: &Capture, metric: bool) -> drex_core::Result<Vec<u8>> {
    let up = up_of(capture, metric);
    // Right in both views; with z up, x is right.
    let right = [Vector3::x(), Vector3::y()].map(|a| a - up.into_inner() * up.dot(&a));
    let right = Unit::new_normalize(if right[0].norm() > 0.5 { right[0] } else { right[1] });
    let away = Unit::new_normalize(up.cross(&right));
    let frame = Frame::around(capture, [right.into_inner(), away.into_inner(), up.into_inner()]);
    let mut image = RgbImage::from_pixel(2 * SIDE, SIDE, BACKGROUND);
    for (panel, (title, axes)) in [("top", [0, 1, 2]), ("side", [0, 2, 1])].into_iter().enumerate() {
        let mut canvas = Canvas { image: &mut image, left: panel as u32 * SIDE };
        frame.draw(&mut canvas, capture, axes);
        canvas.text(12, 12, 3, title, INK);
        draw_axes(&mut canvas, &frame, axes);
        if metric {
            draw_bar(&mut canvas, frame.pixels_per_unit);
        }
    }
    let mut bytes = std::io::Cursor::new(Vec::new());
    let failed = |e: image::ImageError| {
        Error::value(format!("the picture of the cameras cannot be encoded: {e}"), "report this")
    };
    image.write_to(&mut bytes, ImageFormat::Png).map_err(failed)?;
    Ok(bytes.into_inner())
}

/// What is shown: axes of the picture in the scene, the middle of the scene along them, and its scale.
struct Frame {
    axes: [Vector3<f64>; 3],
    middle: [f64; 3],
    pixels_per_unit: f64,
    /// Length of a camera's sides, scene units.
    frustum: f64,
}

impl Frame {
    fn around(capture: &Capture, axes: [Vector3<f64>; 3]) -> Self {
        let centres = capture.centres();
        let mut middle = [0.0; 3];
        let mut size = 0.0_f64;
        for (k, axis) in axes.iter().enumerate() {
            let points = capture.points.iter().map(|p| axis.dot(&Vector3::from(p.position)));
            let ends = MIDDLE.map(|q| quantile(points.clone(), q)).into_iter().flatten();
            let along = || ends.clone().chain(centres.iter().map(|c| axis.dot(&c.coords)));
            let (lo, hi) = (along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max));
            if lo.is_finite() && hi.is_finite() {
                middle[k] = 0.5 * (lo + hi);
                size = size.max(hi - lo);
            }
        }
        let size = if size > 0.0 && size.is_finite() { size } else { 1.0 };
        let frustum = FRUSTUM * size;
        let pixels_per_unit = (f64::from(SIDE) - 2.0 * MARGIN) / (size + 2.0 * frustum);
        Self { axes, middle, pixels_per_unit, frustum }
    }

    /// Pixel of a point in the view that shows axis `across` to the right and `along` upwards.
    fn pixel(&self, p: &Point3<f64>, [across, along, _]: [usize; 3]) -> Point2<f64> {
        let place = |k: usize| (self.axes[k].dot(&p.coords) - self.middle[k]) * self.pixels_per_unit;
        let middle = 0.5 * f64::from(SIDE);
        Point2::new(middle + place(across), middle - place(along))
    }

    fn draw(&self, canvas: &mut Canvas<'_>, capture: &Capture, view: [usize; 3]) {
        // What is nearer to the viewer hides what is behind it: the top view looks down, the side view looks away.
        let towards = if view[2] == 2 { 1.0 } else { -1.0 };
        let nearness = |p: &Point3<f64>| towards * self.axes[view[2]].dot(&p.coords);
        let mut points: Vec<(f64, Point3<f64>, [u8; 3])> =
            capture.points.iter().map(|p| (nearness(&p.position.into()), p.position.into(), p.rgb)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, p, rgb) in &points {
            let at = self.pixel(p, view);
            for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
                canvas.dot(at.x + dx - 0.5, at.y + dy - 0.5, Rgb(rgb.map(brighter)));
            }
        }
        for v in &capture.views {
            let world_from_camera = v.camera_from_world.inverse();
            let (w, h) = (f64::from(v.lens.width_px()), f64::from(v.lens.height_px()));
            let focal = v.lens.focal_px().mean().max(1e-9);
            let (x, y) = (0.5 * w / focal, 0.5 * h / focal);
            let longest = x.hypot(y).hypot(1.0);
            let corner = |(sx, sy): (f64, f64)| {
                self.pixel(
                    &(world_from_camera * Point3::from(Vector3::new(sx * x, sy * y, 1.0) * self.frustum / longest)),
                    view,
                )
            };
            let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(corner);
            let eye = self.pixel(&Point3::from(world_from_camera.translation.vector), view);
            for k in 0..4 {
                canvas.line(eye, corners[k], CAMERA);
                canvas.line(corners[k], corners[(k + 1) % 4], CAMERA);
            }
        }
    }
}

/// Dark points would drown in the background.
fn brighter(channel: u8) -> u8 {
    (u16::from(channel) * 4 / 5 + 51) as u8
}

/// The model's axes in the lower left corner, with their names.
fn draw_axes(canvas: &mut Canvas<'_>, frame: &Frame, [across, along, _]: [usize; 3]) {
    const LENGTH: f64 = 42.0;
    let origin = Point2::new(64.0, f64::from(SIDE) - 64.0);
    for (k, name) in ["x", "y", "z"].into_iter().enumerate() {
        let (dx, dy) = (frame.axes[across][k], -frame.axes[along][k]);
        if dx.hypot(dy) < 0.15 {
            continue;
        }
        let end = Point2::new(origin.x + LENGTH * dx, origin.y + LENGTH * dy);
        canvas.line(origin, end, AXES[k]);
        canvas.text((end.x + 8.0 * dx - 5.0) as i64, (end.y + 8.0 * dy - 7.0) as i64, 2, name, AXES[k]);
    }
}

/// A bar of a round length in the lower right corner.
fn draw_bar(canvas: &mut Canvas<'_>, pixels_per_m: f64) {
    let longest_m = 220.0 / pixels_per_m;
    let decade = 10f64.powf(longest_m.log10().floor());
    let length_m = [5.0, 2.0, 1.0].into_iter().map(|k| k * decade).find(|l| *l <= longest_m).unwrap_or(decade);
    let text = if length_m >= 1.0 {
        format!("{length_m:.0} m")
    } else if length_m >= 0.01 {
        format!("{:.0} cm", 1e2 * length_m)
    } else {
        format!("{:.1} mm", 1e3 * length_m)
    };
    let (right, y) = (f64::from(SIDE) - 24.0, f64::from(SIDE) - 24.0);
    let left = right - length_m * pixels_per_m;
    for dy in [0.0, 1.0] {
        canvas.line(Point2::new(left, y + dy), Point2::new(right, y + dy), INK);
    }
    for x in [left, right] {
        canvas.line(Point2::new(x, y - 6.0), Point2::new(x, y + 6.0), INK);
    }
    canvas.text(left as i64, y as i64 - 26, 2, &text, INK);
}

/// One view's part of the picture; what lies outside of it is not drawn.
struct Canvas<'a> {
    image: &'a mut RgbImage,
    left: u32,
}

impl Canvas<'_> {
    fn dot(&mut self, x: f64, y: f64, colour: Rgb<u8>) {
        let side = f64::from(SIDE);
        if (0.0..side).contains(&x) && (0.0..side).contains(&y) {
            self.image.put_pixel(self.left + x as u32, y as u32, colour);
        }
    }

    fn line(&mut self, a: Point2<f64>, b: Point2<f64>, colour: Rgb<u8>) {
        // A camera beyond the view's edge is at most as long as the view is wide.
        let steps = (b - a).abs().max().clamp(1.0, 4.0 * f64::from(SIDE)).ceil();
        for k in 0..=steps as usize {
            let p = a + (b - a) * (k as f64 / steps);
            self.dot(p.x, p.y, colour);
        }
    }

    fn text(&mut self, x: i64, y: i64, scale: i64, text: &str, colour: Rgb<u8>) {
        for (k, letter) in text.chars().enumerate() {
            for (row, bits) in glyph(letter).into_iter().enumerate() {
                for column in (0..5).filter(|c| bits >> (4 - c) & 1 == 1) {
                    for (i, j) in (0..scale).flat_map(|i| (0..scale).map(move |j| (i, j))) {
                        let (column, row) = (column + 6 * k as i64, row as i64);
                        self.dot((x + scale * column + i) as f64, (y + scale * row + j) as f64, colour);
                    }
                }
            }
        }
    }
}

/// Seven rows of five pixels, the left one in the highest of five bits.
fn glyph(letter: char) -> [u8; 7] {
    match letter {
        '0' => [14, 17, 19, 21, 25, 17, 14],
        '1' => [4, 12, 4, 4, 4, 4, 14],
        '2' => [14, 17, 1, 2, 4, 8, 31],
        '5' => [31, 16, 30, 1, 1, 17, 14],
        '.' => [0, 0, 0, 0, 0, 12, 12],
        'c' => [0, 0, 14, 16, 16, 17, 14],
        'd' => [1, 1, 13, 19, 17, 17, 15],
        'e' => [0, 0, 14, 17, 31, 16, 14],
        'i' => [4, 0, 12, 4, 4, 4, 14],
        'm' => [0, 0, 26, 21, 21, 17, 17],
        'o' => [0, 0, 14, 17, 17, 17, 14],
        'p' => [0, 0, 30, 17, 30, 16, 16],
        's' => [0, 0, 14, 16, 14, 1, 30],
        't' => [8, 8, 28, 8, 8, 9, 6],
        'x' => [0, 0, 17, 10, 4, 10, 17],
        'y' => [0, 0, 17, 17, 15, 1, 14],
        'z' => [0, 0, 31, 2, 4, 8, 31],
        _ => [0; 7],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::Pose;
    use drex_core::camera::{Camera, CameraModel};
    use drex_core::capture::{SparsePoint, View};
    use nalgebra::Translation3;

    /// A red point at the origin, a green one 0.2 up, a blue one 0.2 along x; a camera 0.6 away along -y that looks at them.
    fn capture() -> Capture {
        let lens = Camera::new(CameraModel::SimplePinhole, 640, 480, &[500.0, 320.0, 240.0]).unwrap();
        let point = |position, rgb| SparsePoint { position, rgb, error_px: 0.0, track: Vec::new() };
        // Right is x, down is -z, forward is y.
        let axes =
            nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::new(1., 0., 0., 0., 0., -1., 0., 1., 0.));
        let camera_from_world = Pose::from_parts(Translation3::new(0.0, 0.0, 0.6), axes.into());
        let view = View {
            name: "a.png".into(),
            photo: "a.png".into(),
            mask: None,
            depth: None,
            confidence: None,
            normal: None,
            lens,
            camera_from_world,
            keypoints: Vec::new(),
        };
        let points = vec![
            point([0.0, 0.0, 0.0], [255, 0, 0]),
            point([0.0, 0.0, 0.2], [0, 255, 0]),
            point([0.2, 0.0, 0.0], [0, 0, 255]),
        ];
        Capture { folder: "x".into(), views: vec![view], points, unregistered: Vec::new(), notes: Vec::new() }
    }

    /// Mean place of the pixels of a colour in a view of the picture.
    fn place(picture: &RgbImage, view: u32, is: impl Fn([u8; 3]) -> bool) -> Option<[f64; 2]> {
        let of = picture.enumerate_pixels().filter(|(x, _, p)| x / SIDE == view && is(p.0));
        let all: Vec<[f64; 2]> = of.map(|(x, y, _)| [f64::from(x % SIDE), f64::from(y)]).collect();
        let n = all.len() as f64;
        (n > 0.0).then(|| [0, 1].map(|k| all.iter().map(|p| p[k]).sum::<f64>() / n))
    }

    #[test]
    fn up_is_up_and_right_is_right() {
        let capture = capture();
        assert!(up_of(&capture, false).dot(&Vector3::z()) > 0.999, "the camera's lower edge points down");
        for metric in [true, false] {
            let picture = image::load_from_memory(&draw(&capture, metric).unwrap()).unwrap().into_rgb8();
            let at = |view, rgb: [u8; 3]| place(&picture, view, |p| p == rgb.map(brighter));
            let [red, green, blue] = [[255, 0, 0], [0, 255, 0], [0, 0, 255]];
            // From the side the green point is above the red one, the blue one to the right; from above green hides red.
            let [r, g, b] = [red, green, blue].map(|c| at(1, c).unwrap());
            assert!(g[1] < r[1] - 50.0 && (g[0] - r[0]).abs() < 1.0 && b[0] > r[0] + 50.0, "{r:?} {g:?} {b:?}");
            assert!(at(0, red).is_none() && at(0, green).is_some());
            // The camera stands on the reader's side.
            let camera = place(&picture, 0, |p| p == CAMERA.0).unwrap();
            assert!(camera[1] > at(0, green).unwrap()[1] + 50.0, "{camera:?}");
            let bar = picture.enumerate_pixels().filter(|(x, y, p)| *x > 1400 && *y > 700 && p.0 == INK.0).count();
            assert_eq!(bar > 20, metric, "{bar} pixels of a bar");
        }
    }

    #[test]
    fn nothing_to_draw_is_a_picture_too() {
        let mut nothing = capture();
        nothing.points.clear();
        assert!(draw(&nothing, true).is_ok());
        nothing.views.clear();
        assert!(draw(&nothing, false).is_ok());
    }
}
