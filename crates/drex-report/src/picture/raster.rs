//! A z-buffered triangle renderer on the CPU: enough to see a mesh, its pieces, and a hand around it.

use std::io::Cursor;
use std::ops::Range;

use crate::{Error, Result};
use drex_core::camera::PinholeCamera;
use drex_core::{Pose, TriMesh};
use image::{ImageFormat, Rgb, RgbImage};
use nalgebra::{Point3, Vector3};

/// Supersampling per axis: edges are averaged over this many samples squared.
const OVERSAMPLE: u32 = 2;
/// Samples that are drawn at a time, 48 bytes each: larger pictures are drawn band by band.
const BAND_SAMPLES: u32 = 1 << 22;
/// Sky colour, matching the report's panels.
const BACKGROUND: [f64; 3] = [0.957, 0.961, 0.969];

/// The background as a pixel.
pub(super) fn background() -> Rgb<u8> {
    Rgb(BACKGROUND.map(|c| (255.0 * c).round() as u8))
}

/// A picture on a mesh. It is drawn as it is: the light of the photos is in it.
#[derive(Clone, Copy)]
pub struct Texture<'a> {
    /// Texture coordinate of each vertex: u to the right, v down, both from 0 at the upper left corner to 1.
    pub(crate) uv: &'a [[f32; 2]],
    /// The picture.
    pub(crate) picture: &'a RgbImage,
}

/// A mesh in the scene with one colour (linear-ish sRGB in [0, 1]) or a picture.
pub struct Part<'a> {
    /// Geometry in its own frame.
    pub mesh: &'a TriMesh,
    /// Where it stands.
    pub world_from_mesh: Pose,
    /// Red, green, blue in [0, 1].
    pub color: [f64; 3],
    /// What is drawn instead of the colour.
    pub texture: Option<Texture<'a>>,
}

/// An orbiting pinhole view of the scene: z is up.
#[derive(Clone, Copy)]
pub struct View {
    /// Picture width, pixels.
    pub width: u32,
    /// Picture height, pixels.
    pub height: u32,
    /// Direction from the target to the eye: azimuth from +x, radians.
    pub azimuth: f64,
    /// Elevation above the horizon, radians.
    pub elevation: f64,
    /// World height of the table to draw under the scene; none when absent.
    pub table_height_m: Option<f64>,
}

/// Renders the parts, framed to fit, as a PNG file in memory.
pub fn render_png(parts: &[Part<'_>], view: &View) -> Result<Vec<u8>> {
    encode_png(&render(parts, view))
}

/// What a camera sees of the parts, with a sky behind them. Only the focal length along x counts.
pub(crate) fn render_from(parts: &[Part<'_>], camera: &PinholeCamera) -> RgbImage {
    Scene::from(parts, camera).render()
}

/// A picture as a PNG file in memory.
pub(crate) fn encode_png(picture: &RgbImage) -> Result<Vec<u8>> {
    let mut png = Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png).map_err(|e| Error::Png(e.to_string()))?;
    Ok(png.into_inner())
}

/// The azimuth from which most pixels show part `subject` or, where it is large, its surroundings too: both the object and
/// the hand around it should be seen.
pub fn clearest_azimuth(parts: &[Part<'_>], subject: usize, view: &View) -> f64 {
    const VIEWS: u32 = 24;
    let small = View { width: view.width / 6, height: view.height / 6, table_height_m: None, ..*view };
    let mut best = (0.0, view.azimuth);
    for k in 0..VIEWS {
        let azimuth = std::f64::consts::TAU * f64::from(k) / f64::from(VIEWS);
        let canvas = Scene::new(parts, &View { azimuth, ..small }).draw(0..small.height);
        let seen =
            |wanted: bool| canvas.part.iter().filter(|p| p.is_some_and(|p| (p == subject) == wanted)).count() as f64;
        let score = seen(true) * seen(false);
        if score > best.0 {
            best = (score, azimuth);
        }
    }
    best.1
}

pub(crate) fn render(parts: &[Part<'_>], view: &View) -> RgbImage {
    Scene::new(parts, view).render()
}

/// A part in the world.
struct Placed<'a> {
    mesh: TriMesh,
    color: [f64; 3],
    texture: Option<Texture<'a>>,
}

/// The parts in the world, and the camera that sees all of them.
struct Scene<'a> {
    /// Width and height of the picture, pixels.
    size: [u32; 2],
    table_height_m: Option<f64>,
    parts: Vec<Placed<'a>>,
    camera: Option<Camera>,
}

impl<'a> Scene<'a> {
    fn new(parts: &[Part<'a>], view: &View) -> Self {
        let parts = placed(parts);
        let (width, height) = (view.width * OVERSAMPLE, view.height * OVERSAMPLE);
        let camera = Camera::framing(&parts, view, f64::from(width), f64::from(height));
        Self { size: [view.width, view.height], table_height_m: view.table_height_m, parts, camera }
    }

    fn from(parts: &[Part<'a>], camera: &PinholeCamera) -> Self {
        // A picture's side fits: the camera's check.
        let size = [camera.width as u32, camera.height as u32];
        Self { size, table_height_m: None, parts: placed(parts), camera: Some(Camera::of(camera)) }
    }

    fn render(&self) -> RgbImage {
        let [width, height] = self.size;
        let mut picture = RgbImage::new(width, height);
        let band = (BAND_SAMPLES / (width * OVERSAMPLE * OVERSAMPLE).max(1)).max(1);
        for first in (0..height).step_by(band as usize) {
            let rows = first..height.min(first + band);
            self.draw(rows.clone()).downsample(&mut picture, rows);
        }
        picture
    }

    /// The samples of these rows of the picture.
    fn draw(&self, rows: Range<u32>) -> Canvas {
        let samples = |n: u32| (n * OVERSAMPLE) as usize;
        let mut canvas = Canvas::new(samples(self.size[0]), samples(rows.start)..samples(rows.end));
        if let Some(camera) = &self.camera {
            if let Some(z) = self.table_height_m {
                canvas.draw_table(camera, z);
            }
            for (index, part) in self.parts.iter().enumerate() {
                canvas.draw_mesh(camera, part, index);
            }
        }
        canvas
    }
}

fn placed<'a>(parts: &[Part<'a>]) -> Vec<Placed<'a>> {
    let place =
        |p: &Part<'a>| Placed { mesh: p.mesh.transformed(&p.world_from_mesh), color: p.color, texture: p.texture };
    parts.iter().map(place).collect()
}

struct Camera {
    eye: Point3<f64>,
    right: Vector3<f64>,
    up: Vector3<f64>,
    forward: Vector3<f64>,
    focal: f64,
    center: (f64, f64),
    target: Point3<f64>,
    radius: f64,
}

impl Camera {
    /// A camera that sees the bounding sphere of all meshes; `None` if there is nothing to see.
    fn framing(parts: &[Placed<'_>], view: &View, width: f64, height: f64) -> Option<Self> {
        let meshes = || parts.iter().map(|p| &p.mesh);
        let (lo, hi) = meshes().filter_map(TriMesh::bounds).reduce(|a, b| (a.0.inf(&b.0), a.1.sup(&b.1)))?;
        let target = nalgebra::center(&lo, &hi);
        let radius = meshes().flat_map(|m| &m.vertices).map(|v| (v - target).norm()).fold(1e-6, f64::max);
        let (sa, ca) = view.azimuth.sin_cos();
        let (se, ce) = view.elevation.sin_cos();
        let back = Vector3::new(ce * ca, ce * sa, se);
        let distance = radius * 4.2;
        let forward = -back;
        let right = forward.cross(&Vector3::z()).normalize();
        let up = right.cross(&forward);
        let focal = 0.92 * 0.5 * width.min(height) * (distance * distance - radius * radius).sqrt() / radius;
        Some(Self {
            eye: target + back * distance,
            right,
            up,
            forward,
            focal,
            center: (width / 2.0, height / 2.0),
            target,
            radius,
        })
    }

    /// That of a photo, for a picture with more samples.
    fn of(camera: &PinholeCamera) -> Self {
        let turn = camera.camera_from_world.rotation.inverse();
        let (n, eye) = (f64::from(OVERSAMPLE), camera.centre());
        let forward = turn * Vector3::z();
        Self {
            eye,
            right: turn * Vector3::x(),
            up: turn * -Vector3::y(),
            forward,
            focal: n * camera.fx,
            center: (n * camera.cx, n * camera.cy),
            target: eye + forward,
            radius: 1.0,
        }
    }

    /// Pixel coordinates and depth along the optical axis; `None` behind the eye.
    fn project(&self, p: &Point3<f64>) -> Option<Vector3<f64>> {
        let d = p - self.eye;
        let z = d.dot(&self.forward);
        (z > 1e-6).then(|| {
            Vector3::new(
                self.center.0 + self.focal * d.dot(&self.right) / z,
                self.center.1 - self.focal * d.dot(&self.up) / z,
                z,
            )
        })
    }
}

/// Some rows of the samples of a picture.
struct Canvas {
    width: usize,
    rows: Range<usize>,
    depth: Vec<f64>,
    color: Vec<[f64; 3]>,
    /// Which part is seen in each sample.
    part: Vec<Option<usize>>,
}

impl Canvas {
    fn new(width: usize, rows: Range<usize>) -> Self {
        let samples = width * rows.len();
        Self {
            width,
            rows,
            depth: vec![f64::INFINITY; samples],
            color: vec![BACKGROUND; samples],
            part: vec![None; samples],
        }
    }

    /// Where the sample of a column and a row of the whole picture is kept.
    fn index(&self, x: usize, y: usize) -> usize {
        (y - self.rows.start) * self.width + x
    }

    fn draw_mesh(&mut self, camera: &Camera, placed: &Placed<'_>, part: usize) {
        let Placed { mesh, color, texture } = placed;
        for (f, face) in mesh.faces.iter().enumerate() {
            let corners = mesh.triangle(f);
            if let Some(Texture { uv, picture }) = texture {
                let uv = face.map(|v| uv.get(v as usize).copied().unwrap_or_default().map(f64::from));
                self.draw_triangle(camera, &corners, part, |[a, b, c]| {
                    let at = [0, 1].map(|k| a * uv[0][k] + b * uv[1][k] + c * uv[2][k]);
                    // Beyond its edges a picture repeats, as OBJ and glTF have it.
                    sampled(picture, at.map(|c| if (0.0..=1.0).contains(&c) { c } else { c.rem_euclid(1.0) }))
                });
                continue;
            }
            let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
            let Some(normal) = normal.try_normalize(0.0) else { continue };
            let to_eye = (camera.eye - corners[0]).normalize();
            // Scans can be wound either way: light the side that is seen.
            let normal = if normal.dot(&to_eye) < 0.0 { -normal } else { normal };
            let shade = shade(&normal, &to_eye, camera);
            let shaded = color.map(|c| (c * shade).min(1.0));
            self.draw_triangle(camera, &corners, part, |_| shaded);
        }
    }

    /// A checked disc under the scene that fades into the background.
    fn draw_table(&mut self, camera: &Camera, z: f64) {
        let square = nice_length(camera.radius / 4.0);
        let reach = 2.2 * camera.radius;
        for y in self.rows.clone() {
            for x in 0..self.width {
                let ray = camera.forward
                    + camera.right * ((x as f64 + 0.5 - camera.center.0) / camera.focal)
                    + camera.up * ((camera.center.1 - y as f64 - 0.5) / camera.focal);
                if ray.z >= -1e-9 {
                    continue;
                }
                let t = (z - camera.eye.z) / ray.z;
                let p = camera.eye + ray * t;
                let fade = 1.0 - ((p.xy() - camera.target.xy()).norm() / reach).powi(2);
                if t <= 0.0 || fade <= 0.0 {
                    continue;
                }
                let dark = ((p.x / square).floor() + (p.y / square).floor()).rem_euclid(2.0) < 0.5;
                let tone = if dark { 0.80 } else { 0.87 };
                let i = self.index(x, y);
                self.depth[i] = t;
                self.color[i] = std::array::from_fn(|k| BACKGROUND[k] + (tone - BACKGROUND[k]) * fade);
            }
        }
    }

    /// `color` is that of a point of the triangle by the shares of its corners.
    fn draw_triangle(
        &mut self,
        camera: &Camera,
        corners: &[Point3<f64>; 3],
        part: usize,
        color: impl Fn([f64; 3]) -> [f64; 3],
    ) {
        let [Some(a), Some(b), Some(c)] = [0, 1, 2].map(|i| camera.project(&corners[i])) else { return };
        let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
        if area.abs() < 1e-12 {
            return;
        }
        let clamp = |v: f64, to: &Range<usize>| v.clamp(to.start as f64, to.end as f64) as usize;
        let columns = 0..self.width;
        let (x0, x1) = (clamp(a.x.min(b.x).min(c.x).floor(), &columns), clamp(a.x.max(b.x).max(c.x).ceil(), &columns));
        let (y0, y1) =
            (clamp(a.y.min(b.y).min(c.y).floor(), &self.rows), clamp(a.y.max(b.y).max(c.y).ceil(), &self.rows));
        for y in y0..y1 {
            for x in x0..x1 {
                let (px, py) = (x as f64 + 0.5, y as f64 + 0.5);
                let wa = ((b.x - px) * (c.y - py) - (b.y - py) * (c.x - px)) / area;
                let wb = ((c.x - px) * (a.y - py) - (c.y - py) * (a.x - px)) / area;
                let wc = 1.0 - wa - wb;
                if wa < 0.0 || wb < 0.0 || wc < 0.0 {
                    continue;
                }
                // 1/z is linear on the screen.
                let z = 1.0 / (wa / a.z + wb / b.z + wc / c.z);
                let i = self.index(x, y);
                if z < self.depth[i] {
                    self.depth[i] = z;
                    self.color[i] = color([wa / a.z, wb / b.z, wc / c.z].map(|w| w * z));
                    self.part[i] = Some(part);
                }
            }
        }
    }

    /// Averages the samples of these rows of the picture.
    fn downsample(&self, picture: &mut RgbImage, rows: Range<u32>) {
        let n = OVERSAMPLE as usize;
        let width = picture.width();
        for (x, y) in rows.flat_map(|y| (0..width).map(move |x| (x, y))) {
            let mut sum = [0.0; 3];
            for dy in 0..n {
                for dx in 0..n {
                    let c = self.color[self.index(x as usize * n + dx, y as usize * n + dy)];
                    for k in 0..3 {
                        sum[k] += c[k];
                    }
                }
            }
            picture.put_pixel(x, y, Rgb(sum.map(|s| (255.0 * s / (n * n) as f64).round().clamp(0.0, 255.0) as u8)));
        }
    }
}

/// A picture between its pixels, at a texture coordinate.
pub(super) fn sampled(picture: &RgbImage, at: [f64; 2]) -> [f64; 3] {
    let size = [picture.width(), picture.height()];
    if size.contains(&0) {
        return [0.0; 3];
    }
    let along = |k: usize| {
        let last = f64::from(size[k] - 1);
        let p = (at[k] * f64::from(size[k]) - 0.5).clamp(0.0, last);
        let first = p.floor().min((last - 1.0).max(0.0));
        (first as u32, (first + 1.0).min(last) as u32, p - first)
    };
    let ((x0, x1, s), (y0, y1, t)) = (along(0), along(1));
    let pixel = |x: u32, y: u32| picture.get_pixel(x, y).0.map(|v| f64::from(v) / 255.0);
    let [a, b, c, d] = [pixel(x0, y0), pixel(x1, y0), pixel(x0, y1), pixel(x1, y1)];
    std::array::from_fn(|k| (a[k] * (1.0 - s) + b[k] * s) * (1.0 - t) + (c[k] * (1.0 - s) + d[k] * s) * t)
}

/// Two lights (over the left shoulder, and a weak one from the right) and an ambient term.
fn shade(normal: &Vector3<f64>, to_eye: &Vector3<f64>, camera: &Camera) -> f64 {
    let key = (to_eye - camera.right * 0.6 + Vector3::z() * 0.9).normalize();
    let fill = (to_eye + camera.right * 1.2).normalize();
    0.34 + 0.60 * normal.dot(&key).max(0.0) + 0.16 * normal.dot(&fill).max(0.0)
}

/// The largest of 1, 2, 5 times a power of ten that is at most `length`.
fn nice_length(length: f64) -> f64 {
    let power = 10f64.powf(length.log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|k| k * power).find(|&l| l <= length).unwrap_or(power)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(z: f64) -> TriMesh {
        TriMesh::new(
            vec![Point3::new(-1.0, -1.0, z), Point3::new(1.0, -1.0, z), Point3::new(0.0, 1.0, z)],
            vec![[0, 1, 2]],
        )
        .unwrap()
    }

    fn centre_color(parts: &[Part<'_>]) -> Rgb<u8> {
        let view = View { width: 65, height: 65, azimuth: 0.3, elevation: 1.5, table_height_m: None };
        *render(parts, &view).get_pixel(32, 32)
    }

    #[test]
    fn the_nearer_triangle_hides_the_farther_whatever_the_order() {
        let (low, high) = (triangle(0.0), triangle(0.4));
        let red = Part { mesh: &high, world_from_mesh: Pose::identity(), color: [1.0, 0.0, 0.0], texture: None };
        let blue = Part { mesh: &low, world_from_mesh: Pose::identity(), color: [0.0, 0.0, 1.0], texture: None };
        let red_after = Part { mesh: &high, world_from_mesh: Pose::identity(), color: [1.0, 0.0, 0.0], texture: None };
        let seen = centre_color(&[red, blue]);
        assert!(seen[0] > 100 && seen[2] < 50, "the upper, red triangle must be seen from above: {seen:?}");
        let blue = Part { mesh: &low, world_from_mesh: Pose::identity(), color: [0.0, 0.0, 1.0], texture: None };
        assert_eq!(seen, centre_color(&[blue, red_after]));
    }

    #[test]
    fn the_clearest_view_shows_what_the_other_part_hides() {
        // A wall between the eye at azimuth 0 and a small subject behind it.
        let wall = TriMesh::new(
            vec![
                Point3::new(0.3, -1.0, -1.0),
                Point3::new(0.3, 1.0, -1.0),
                Point3::new(0.3, 1.0, 1.0),
                Point3::new(0.3, -1.0, 1.0),
            ],
            vec![[0, 1, 2], [0, 2, 3]],
        )
        .unwrap();
        let subject = TriMesh::new(
            vec![Point3::new(0.0, -0.3, -0.3), Point3::new(0.0, 0.3, -0.3), Point3::new(0.0, 0.0, 0.4)],
            vec![[0, 1, 2]],
        )
        .unwrap();
        let part = |mesh| Part { mesh, world_from_mesh: Pose::identity(), color: [0.5; 3], texture: None };
        let view = View { width: 120, height: 120, azimuth: 0.0, elevation: 0.2, table_height_m: None };
        let azimuth = clearest_azimuth(&[part(&wall), part(&subject)], 1, &view);
        assert!(azimuth.cos() < 0.0, "the subject is hidden from azimuth 0 and seen from behind: {azimuth}");
    }

    #[test]
    fn a_large_picture_is_drawn_band_by_band_and_is_the_same() {
        let (low, high) = (triangle(0.0), triangle(0.4));
        let part = |mesh, color| Part { mesh, world_from_mesh: Pose::identity(), color, texture: None };
        let parts = [part(&high, [1.0, 0.0, 0.0]), part(&low, [0.0, 0.0, 1.0])];
        let view = View { width: 33, height: 40, azimuth: 0.3, elevation: 0.4, table_height_m: Some(-0.1) };
        let scene = Scene::new(&parts, &view);
        let mut bands = RgbImage::new(view.width, view.height);
        for rows in [0..7, 7..8, 8..40] {
            scene.draw(rows.clone()).downsample(&mut bands, rows);
        }
        assert_eq!(bands, render(&parts, &view));
        // Memory: a band, and the picture with the bytes of its file.
        let large = View { width: 4000, height: 3000, ..view };
        let mut bytes = 0;
        let used = allocation_counter::measure(|| bytes = render_png(&parts, &large).unwrap().len());
        assert!(bytes > 0 && used.bytes_max < 300_000_000, "{} bytes", used.bytes_max);
    }

    #[test]
    fn an_empty_scene_is_background() {
        let seen = centre_color(&[]);
        assert_eq!(seen, background());
    }

    #[test]
    fn a_picture_repeats_beyond_its_edges() {
        let corners = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]].map(Point3::from);
        let mesh = TriMesh::new(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        // Black on the left, white on the right, twice from left to right.
        let picture = RgbImage::from_fn(64, 4, |x, _| Rgb([if x < 32 { 0 } else { 255 }; 3]));
        let texture = Some(Texture { uv: &[[-1.0, 0.0], [1.0, 0.0], [1.0, 1.0], [-1.0, 1.0]], picture: &picture });
        let part = Part { mesh: &mesh, world_from_mesh: Pose::identity(), color: [1.0, 0.0, 0.0], texture };
        let world_from_camera = Pose::face_towards(&Point3::new(0.0, 0.0, 2.0), &Point3::origin(), &-Vector3::y());
        let camera_from_world = world_from_camera.inverse();
        let camera =
            PinholeCamera { camera_from_world, fx: 80.0, fy: 80.0, cx: 50.0, cy: 50.0, width: 100, height: 100 };
        let seen = render_from(&[part], &camera);
        for (x, white) in [(-0.75, false), (-0.25, true), (0.25, false), (0.75, true)] {
            let ([column, row], _) = camera.project(&Point3::new(x, 0.1, 0.0)).unwrap();
            assert_eq!(seen.get_pixel(column as u32, row as u32)[0] > 127, white, "at {x}");
        }
    }

    #[test]
    fn a_picture_lies_on_the_mesh_as_its_coordinates_say_also_where_it_recedes() {
        // A floor 1 wide and 10 long, seen from one end; its picture is white from the middle of its length on.
        let corners = [[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 10.0, 0.0], [-0.5, 10.0, 0.0]].map(Point3::from);
        let mesh = TriMesh::new(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        let picture = RgbImage::from_fn(4, 100, |_, y| Rgb([if y < 50 { 0 } else { 255 }; 3]));
        let uv = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let texture = Some(Texture { uv: &uv, picture: &picture });
        let parts = [Part { mesh: &mesh, world_from_mesh: Pose::identity(), color: [1.0, 0.0, 0.0], texture }];
        let eye = Point3::new(0.0, -2.0, 1.0);
        let world_from_camera = Pose::face_towards(&eye, &Point3::new(0.0, 5.0, 0.0), &-Vector3::z());
        let camera = PinholeCamera {
            camera_from_world: world_from_camera.inverse(),
            fx: 200.0,
            fy: 200.0,
            cx: 60.0,
            cy: 50.0,
            width: 120,
            height: 100,
        };
        let seen = render_from(&parts, &camera);
        for along in [1.0, 4.7, 5.3, 9.0] {
            let ([x, y], _) = camera.project(&Point3::new(0.02, along, 0.0)).unwrap();
            let value = seen.get_pixel(x as u32, y as u32)[0];
            assert_eq!(value > 127, along > 5.0, "{value} at {along}");
        }
    }
}
