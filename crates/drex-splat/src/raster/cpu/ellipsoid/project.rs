//! One ellipsoid through a pinhole: EWA splatting (Zwicker et al. 2002) as in Kerbl et al. 2023, and its derivative.
//!
//! Camera point t = R mean + T; footprint Σ = A Aᵀ + blur I with A = J V, V = R Q diag(s), Q the splat's rotation, J the
//! derivative of the projection at t, its x / z and y / z clamped to 15 % outside the image. Opacity at distance d from
//! the projected mean is o exp(-½ dᵀ Σ⁻¹ d).

use drex_core::camera::PinholeCamera;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, Point3, Quaternion, UnitQuaternion, Vector2, Vector3};

use super::super::super::{MIN_ALPHA, RenderOptions, ScreenBox};
use super::super::{bounded, lanes::FADE, sh};
use crate::Gaussians;

/// What the kernels need to know of a splat. With (u, v) = (a dx + b dy, c dy), opacity is 2^(log2_opacity - u² - v²).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Splat {
    /// Projected centre, pixels.
    pub mean: [f32; 2],
    /// a, b, c: the Cholesky factor of Σ⁻¹ / (2 ln 2).
    pub whiten: [f32; 3],
    /// Where u² + v² is least for a given dy or dx: dx = valley₀ dy, dy = valley₁ dx.
    pub valley: [f32; 2],
    /// log₂ of the opacity, compensation included.
    pub log2_opacity: f32,
    pub colour: [f32; 3],
    pub depth: f32,
}

/// Sums of a splat over pixels, with g = dL/d ln α and the (u, v) of [`Splat`].
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums {
    /// Σ g, Σ g u, Σ g v, Σ g u², Σ g u v, Σ g v².
    pub moments: [f32; 6],
    /// dL/d(mean) with absolute values per pixel.
    pub abs_mean: [f32; 2],
    pub colour: [f32; 3],
    pub depth: f32,
}

impl Sums {
    pub fn add(&mut self, other: &Self) {
        let add = |a: &mut [f32], b: &[f32]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        add(&mut self.moments, &other.moments);
        add(&mut self.abs_mean, &other.abs_mean);
        add(&mut self.colour, &other.colour);
        self.depth += other.depth;
    }
}

/// The derivative of a loss by one ellipsoid's parameters; spherical harmonics go to the slice given.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SplatGradient {
    pub mean: [f32; 3],
    pub rotation: [f32; 4],
    pub log_scale: [f32; 3],
    pub logit_opacity: f32,
    pub mean2d: [f32; 2],
    pub abs_mean2d: [f32; 2],
    pub radius: f32,
    /// By a small motion of the camera (ρ, φ).
    pub twist: [f64; 6],
}

/// A camera with what every splat asks of it.
#[derive(Debug)]
pub(super) struct View<'a> {
    options: &'a RenderOptions,
    camera: &'a PinholeCamera,
    /// camera_from_world.
    r: Matrix3<f64>,
    t: Vector3<f64>,
    centre: Point3<f64>,
    /// Bounds of x / z and of y / z in J.
    clamp: [[f64; 2]; 2],
}

/// The projection's intermediate results.
struct Footprint {
    /// Mean in the camera frame.
    t: Vector3<f64>,
    /// Clamped x / z and y / z.
    ratio: [f64; 2],
    j: Matrix2x3<f64>,
    /// Scales, and V = R Q diag(s).
    scale: Vector3<f64>,
    v: Matrix3<f64>,
    a: Matrix2x3<f64>,
    /// Σ without and with blur: xx, xy, yy, determinant.
    cov0: [f64; 4],
    cov: [f64; 4],
}

/// Splats beyond are not drawn, since single precision would hold neither them nor their derivative: standard deviation
/// (or its inverse) and place in the image (pixels), depth (scene units), brightness.
const LARGEST: f64 = 1e9;
/// Quaternions shorter than this have no direction.
const SHORTEST: f64 = 1e-12;

/// 1 / √(2 ln 2): opacity is a power of two in the kernels.
fn half_log2_e() -> f64 {
    (0.5 * std::f64::consts::LOG2_E).sqrt()
}

impl Footprint {
    /// a, b, c of [`Splat::whiten`]: Σ⁻¹ = Wᵀ W with W = [√(Σyy / det), -Σxy / √(det Σyy); 0, 1 / √Σyy], over √(2 ln 2).
    fn whiten(&self) -> [f64; 3] {
        let [_, xy, yy, det] = self.cov;
        [(yy / det).sqrt(), -xy / (det * yy).sqrt(), 1.0 / yy.sqrt()].map(|w| w * half_log2_e())
    }
}

impl<'a> View<'a> {
    pub fn new(camera: &'a PinholeCamera, options: &'a RenderOptions) -> Self {
        let PinholeCamera { fx, fy, cx, cy, .. } = *camera;
        let (w, h) = (camera.width as f64, camera.height as f64);
        let pose = &camera.camera_from_world;
        Self {
            options,
            camera,
            r: pose.rotation.to_rotation_matrix().into_inner(),
            t: pose.translation.vector,
            centre: camera.centre(),
            clamp: [
                [-(cx + 0.15 * w) / fx, (w - cx + 0.15 * w) / fx],
                [-(cy + 0.15 * h) / fy, (h - cy + 0.15 * h) / fy],
            ],
        }
    }

    /// Splat number `i` and the pixels in which its opacity reaches 1/255; an empty box if there are none, or if the
    /// numbers leave what a computer can hold.
    pub fn project(&self, scene: &Gaussians, i: usize) -> (Splat, ScreenBox) {
        self.try_project(scene, i).unwrap_or_default()
    }

    fn try_project(&self, scene: &Gaussians, i: usize) -> Option<(Splat, ScreenBox)> {
        let camera = self.camera;
        let f = self.footprint(scene, i)?;
        let [xx, xy, yy, _] = f.cov;
        let mut opacity = f64::from(scene.opacity(i));
        if self.options.antialias {
            opacity *= (f.cov0[3] / f.cov[3]).max(0.0).sqrt();
        }
        let least = f64::from(MIN_ALPHA) * if self.options.smooth_cutoff { 1.0 - f64::from(FADE) } else { 1.0 };
        // How far opacity may fall: d² = dᵀ Σ⁻¹ d at the cut. Everything beyond is not drawn, nothing within is lost.
        let d2 = 2.0 * (opacity / least).ln();
        let mean = [camera.fx * f.t.x / f.t.z + camera.cx, camera.fy * f.t.y / f.t.z + camera.cy];
        if !(d2 > 0.0 && mean.iter().all(|m| m.abs() < LARGEST)) {
            return None;
        }
        let half = [xx, yy].map(|var| (d2 * var).sqrt() * (1.0 + 1e-5) + 1e-3);
        let [x0, x1] = pixels(mean[0], half[0], camera.width);
        let [y0, y1] = pixels(mean[1], half[1], camera.height);
        if x0 >= x1 || y0 >= y1 {
            return None;
        }
        let stride = scene.sh_stride();
        let (dir, _) = sh::direction(scene.means[i], &self.centre);
        let colour = sh::colour(self.options.sh_degree, &scene.sh[i * stride..(i + 1) * stride], &dir);
        let depth = f.t.z as f32;
        let splat = Splat {
            mean: mean.map(|m| m as f32),
            whiten: f.whiten().map(|w| w as f32),
            valley: [xy / yy, xy / xx].map(|v| v as f32),
            log2_opacity: opacity.log2() as f32,
            colour,
            depth,
        };
        let drawable = colour.iter().chain([&depth]).all(|v| f64::from(*v) < LARGEST);
        drawable.then_some((splat, ScreenBox { x0, y0, x1, y1, depth }))
    }

    fn footprint(&self, scene: &Gaussians, i: usize) -> Option<Footprint> {
        let (fx, fy) = (self.camera.fx, self.camera.fy);
        let t = self.r * Vector3::from(scene.means[i].map(f64::from)) + self.t;
        if !(t.z > f64::from(self.options.near)) {
            return None;
        }
        let q = unit(scene.rotations[i])?;
        let scale = Vector3::from(scene.log_scales[i].map(|s| f64::from(s.exp())));
        let ratio = [0, 1].map(|axis| (t[axis] / t.z).clamp(self.clamp[axis][0], self.clamp[axis][1]));
        let j = Matrix2x3::new(fx / t.z, 0.0, -fx * ratio[0] / t.z, 0.0, fy / t.z, -fy * ratio[1] / t.z);
        let rq = self.r * q.to_rotation_matrix().into_inner();
        let v = rq * Matrix3::from_diagonal(&scale);
        let a = j * v;
        let (a1, a2) = (a.row(0).transpose(), a.row(1).transpose());
        let [xx, xy, yy] = [a1.dot(&a1), a1.dot(&a2), a2.dot(&a2)];
        // det(A Aᵀ) = |a1 x a2|² (Lagrange): exact also for needles, where xx yy - xy² cancels.
        let det0 = a1.cross(&a2).norm_squared();
        let blur = f64::from(self.options.blur);
        let cov = [xx + blur, xy, yy + blur, det0 + blur * (xx + yy) + blur * blur];
        let widest = cov[0].max(cov[2]);
        let drawable = widest < LARGEST * LARGEST && cov[3] > widest / (LARGEST * LARGEST);
        drawable.then_some(Footprint { t, ratio, j, scale, v, a, cov0: [xx, xy, yy, det0], cov })
    }

    /// The backward of [`View::project`] for a splat that is drawn: from its sums over the image to its parameters.
    pub fn backward(&self, scene: &Gaussians, i: usize, splat: &Splat, sums: &Sums, d_sh: &mut [f32]) -> SplatGradient {
        let Some(f) = self.footprint(scene, i) else { return SplatGradient::default() };
        let ln2 = std::f64::consts::LN_2;
        let [g, gu, gv, guu, guv, gvv] = sums.moments.map(f64::from);
        let [a, b, c] = f.whiten();

        // q = u² + v², dL/dq = -ln 2 Σ g; d(u, v)/d(mean) = -W.
        let d_mean2d = Vector2::new(a * gu, b * gu + c * gv) * (2.0 * ln2);
        // dL/dΣ = ½ Wᵀ (Σ g n nᵀ) W in whitened coordinates n = W d; W here is smaller by √(2 ln 2), n likewise.
        let w = Matrix2::new(a, b, 0.0, c);
        let mut d_cov = w.transpose() * Matrix2::new(guu, guv, guv, gvv) * w * (2.0 * ln2 * ln2);
        if self.options.antialias {
            // ln √(det Σ₀ / det Σ): ½ (Σ₀⁻¹ - Σ⁻¹).
            let inverse = |[xx, xy, yy, det]: [f64; 4]| Matrix2::new(yy, -xy, -xy, xx) / det;
            d_cov += (inverse(f.cov0) - inverse(f.cov)) * (0.5 * g);
        }
        let d_a = d_cov * f.a * 2.0;
        let d_j = d_a * f.v.transpose();
        let d_v = f.j.transpose() * d_a;

        let d_t = self.point_backward(&f, &d_mean2d, &d_j) + Vector3::new(0.0, 0.0, f64::from(sums.depth));
        let mut d_log_scale = [0.0; 3];
        let mut d_rq = Matrix3::zeros();
        let mut twist_rotation = f.t.cross(&d_t);
        for k in 0..3 {
            d_log_scale[k] = (f.v.column(k).dot(&d_v.column(k))) as f32;
            d_rq.set_column(k, &(d_v.column(k) * f.scale[k]));
            twist_rotation += f.v.column(k).cross(&d_v.column(k));
        }

        let stride = scene.sh_stride();
        let (dir, inv_distance) = sh::direction(scene.means[i], &self.centre);
        let d_mean_colour = sh::colour_backward(
            self.options.sh_degree,
            &scene.sh[i * stride..(i + 1) * stride],
            (&dir, inv_distance),
            splat.colour,
            sums.colour,
            d_sh,
        )
        .map(f64::from);

        // The camera's centre moves by -Rᵀ ρ, the colour's direction with it.
        let twist_translation = d_t + self.r * d_mean_colour;
        let d_mean = self.r.transpose() * d_t + d_mean_colour;
        let opacity = f64::from(scene.opacity(i));
        let [xx, xy, yy, _] = f.cov;
        let largest = 0.5 * (xx + yy) + (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        SplatGradient {
            mean: d_mean.map(|v| v as f32).into(),
            rotation: rotation_backward(scene.rotations[i], &(self.r.transpose() * d_rq)),
            log_scale: d_log_scale,
            logit_opacity: (g * (1.0 - opacity)) as f32,
            mean2d: d_mean2d.map(|v| v as f32).into(),
            abs_mean2d: sums.abs_mean,
            radius: (3.0 * largest.sqrt()) as f32,
            twist: [
                twist_translation.x,
                twist_translation.y,
                twist_translation.z,
                twist_rotation.x,
                twist_rotation.y,
                twist_rotation.z,
            ]
            .map(bounded),
        }
    }

    /// dL/dt through the projected mean and through J.
    fn point_backward(&self, f: &Footprint, d_mean2d: &Vector2<f64>, d_j: &Matrix2x3<f64>) -> Vector3<f64> {
        let z = f.t.z;
        let mut d_t = Vector3::zeros();
        for (axis, focal) in [(0, self.camera.fx), (1, self.camera.fy)] {
            let (x_z, ratio) = (f.t[axis] / z, f.ratio[axis]);
            d_t[axis] += d_mean2d[axis] * focal / z;
            d_t.z -= d_mean2d[axis] * focal * x_z / z;
            // J = focal / z (1, -ratio) in columns axis and 2.
            d_t.z -= (d_j[(axis, axis)] - d_j[(axis, 2)] * ratio) * focal / (z * z);
            if ratio == x_z {
                let d_ratio = -d_j[(axis, 2)] * focal / z;
                d_t[axis] += d_ratio / z;
                d_t.z -= d_ratio * x_z / z;
            }
        }
        d_t
    }
}

/// Pixels of an axis whose centres lie within `half` of `mean`.
fn pixels(mean: f64, half: f64, side: usize) -> [u16; 2] {
    [(mean - half - 0.5).ceil(), (mean + half + 0.5).floor()].map(|edge| edge.clamp(0.0, side as f64) as u16)
}

/// The rotation of a quaternion w, x, y, z of any length but zero.
fn unit(q: [f32; 4]) -> Option<UnitQuaternion<f64>> {
    let [w, x, y, z] = q.map(f64::from);
    UnitQuaternion::try_new(Quaternion::new(w, x, y, z), SHORTEST)
}

/// dL/dq through Q(q / |q|), from dL/dQ.
fn rotation_backward(q: [f32; 4], d: &Matrix3<f64>) -> [f32; 4] {
    let q = q.map(f64::from);
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [w, x, y, z] = q.map(|v| v / norm);
    // Q = 1 + 2 (w [v]ₓ + [v]ₓ²) with v = (x, y, z).
    let d_unit = [
        2.0 * (x * (d.m32 - d.m23) + y * (d.m13 - d.m31) + z * (d.m21 - d.m12)),
        2.0 * (y * (d.m12 + d.m21) + z * (d.m13 + d.m31) + w * (d.m32 - d.m23) - 2.0 * x * (d.m22 + d.m33)),
        2.0 * (x * (d.m12 + d.m21) + z * (d.m23 + d.m32) + w * (d.m13 - d.m31) - 2.0 * y * (d.m11 + d.m33)),
        2.0 * (x * (d.m13 + d.m31) + y * (d.m23 + d.m32) + w * (d.m21 - d.m12) - 2.0 * z * (d.m11 + d.m22)),
    ];
    let along = [w, x, y, z].iter().zip(&d_unit).map(|(q, d)| q * d).sum::<f64>();
    std::array::from_fn(|k| ((d_unit[k] - along * [w, x, y, z][k]) / norm) as f32)
}
