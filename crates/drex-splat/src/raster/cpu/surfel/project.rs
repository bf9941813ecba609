//! A surfel as one camera sees it, and the way back from there to its parameters.
//!
//! The disc is p(u, v) = t + s_u u r₁ + s_v v r₂ in the camera frame; H = [s_u r₁, s_v r₂, t]. Its projection is the
//! homography T = K H (2DGS, eq. 5 and 6): z (x, y, 1) = T (u, v, 1). So the ray through a pixel meets the disc's plane
//! where (u, v, 1) / z = M (x, y, 1) with M = T⁻¹: three numbers that are affine in the pixel. This is the
//! intersection of the two planes of the paper's eq. 8 to 10, divided by det T, and its third number is the inverse depth.
//!
//! Pixels are counted from an origin near the surfel (whole numbers, so that single precision keeps every digit of a
//! small splat in a large image).

use nalgebra::{Matrix3, Vector2, Vector3};

use drex_core::camera::PinholeCamera;

/// The disc's scales are kept between these, times depth (over the focal length for the smallest): what is smaller than
/// a millionth of a pixel is drawn by the screen-space floor, what is larger is a plane.
const SCALE_RANGE: [f64; 2] = [1e-6, 1e9];
/// A plane that passes the camera's centre closer than this, relative to the distance of the surfel, is not drawn.
const MIN_FACING: f64 = 1e-9;

/// A surfel in the camera frame with its homography. Pixels are relative to `origin`.
#[derive(Debug, Clone)]
pub(super) struct Surfel {
    /// Unit axes of the disc (columns), camera frame; the third is the normal before it is flipped.
    pub r: Matrix3<f64>,
    /// Standard deviations along the first two axes.
    pub s: [f64; 2],
    /// Centre, camera frame.
    pub t: Vector3<f64>,
    /// 1, or -1 where the third axis points away from the camera.
    pub flip: f64,
    /// The pixel that coordinates are counted from.
    pub origin: [f64; 2],
    /// K with the principal point counted from `origin`.
    pub k: Matrix3<f64>,
    /// Homography z (x, y, 1) = T (u, v, 1).
    pub transform: Matrix3<f64>,
    /// Its inverse.
    pub m: Matrix3<f64>,
    /// Where the screen-space floor is centred; `None` if the disc reaches the camera's plane.
    pub centre: Option<Vector2<f64>>,
}

/// Derivative of a loss by what [`Surfel`] holds: the sums over pixels.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SurfelGradient {
    /// By M.
    pub m: Matrix3<f64>,
    /// By the floor's centre.
    pub centre: Vector2<f64>,
    /// By the normal that faces the camera.
    pub normal: Vector3<f64>,
    /// By the z of the centre.
    pub depth: f64,
}

/// Derivative by the disc's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct FrameGradient {
    /// By the columns of `r`.
    pub r: Matrix3<f64>,
    /// By the logarithms of the scales.
    pub log_s: [f64; 2],
    /// By the centre, camera frame.
    pub t: Vector3<f64>,
}

impl Surfel {
    /// `r` and `t` in the camera frame; `None` where the surfel cannot be seen (nearer than `near`, or its plane passes
    /// the camera's centre). `c2` is the squared distance, in standard deviations, of the box whose centre is the
    /// floor's.
    pub fn new(
        camera: &PinholeCamera,
        r: Matrix3<f64>,
        log_s: [f64; 2],
        t: Vector3<f64>,
        near: f64,
        c2: f64,
    ) -> Option<Self> {
        let facing = r.column(2).dot(&t);
        if !(t.z > near && facing.abs() > MIN_FACING * t.norm()) {
            return None;
        }
        let f = camera.fx.max(camera.fy);
        let s = log_s.map(|l| l.exp().clamp(SCALE_RANGE[0] * t.z / f, SCALE_RANGE[1] * t.z));
        let side = PinholeCamera::MAX_SIDE as f64;
        let origin = [camera.fx * t.x / t.z + camera.cx, camera.fy * t.y / t.z + camera.cy]
            .map(|x| x.clamp(-side, 2.0 * side).round());
        let k = Matrix3::new(
            camera.fx,
            0.0,
            camera.cx - origin[0], //
            0.0,
            camera.fy,
            camera.cy - origin[1], //
            0.0,
            0.0,
            1.0,
        );
        let h = Matrix3::from_columns(&[r.column(0) * s[0], r.column(1) * s[1], t]);
        let transform = k * h;
        let m = inverse(&r, s, &t, facing) * k_inverse(&k);
        let centre = box_centre(&transform, c2);
        Some(Self { r, s, t, flip: -facing.signum(), origin, k, transform, m, centre })
    }

    /// The normal that faces the camera, camera frame.
    pub fn normal(&self) -> Vector3<f64> {
        self.r.column(2) * self.flip
    }

    /// From the sums over pixels to the disc's frame. `c2` as in [`Surfel::new`].
    pub fn backward(&self, g: &SurfelGradient, c2: f64) -> FrameGradient {
        let mt = self.m.transpose();
        let mut g_transform = -mt * g.m * mt;
        if let Some(centre) = self.centre {
            g_transform += box_centre_backward(&self.transform, c2, &centre, &g.centre);
        }
        let g_h = self.k.transpose() * g_transform;
        let (g_u, g_v) = (g_h.column(0), g_h.column(1));
        let r = Matrix3::from_columns(&[g_u * self.s[0], g_v * self.s[1], g.normal * self.flip]);
        let log_s = [self.s[0] * g_u.dot(&self.r.column(0)), self.s[1] * g_v.dot(&self.r.column(1))];
        FrameGradient { r, log_s, t: g_h.column(2) + Vector3::new(0.0, 0.0, g.depth) }
    }
}

/// H⁻¹ for orthonormal axes: with n = r₃ a ray d meets the plane at z = n·t / n·d, and u = r₁·(z d - t) / s_u.
fn inverse(r: &Matrix3<f64>, s: [f64; 2], t: &Vector3<f64>, facing: f64) -> Matrix3<f64> {
    let h3 = r.column(2) / facing;
    let h1 = (r.column(0) - h3 * r.column(0).dot(t)) / s[0];
    let h2 = (r.column(1) - h3 * r.column(1).dot(t)) / s[1];
    Matrix3::from_rows(&[h1.transpose(), h2.transpose(), h3.transpose()])
}

fn k_inverse(k: &Matrix3<f64>) -> Matrix3<f64> {
    let (fx, fy) = (k[(0, 0)], k[(1, 1)]);
    Matrix3::new(
        1.0 / fx,
        0.0,
        -k[(0, 2)] / fx, //
        0.0,
        1.0 / fy,
        -k[(1, 2)] / fy, //
        0.0,
        0.0,
        1.0,
    )
}

/// Centre of the box of the disc of radius c: f·(Tu Tw), f·(Tv Tw) with d = (c², c², -1), f = d / d·Tw² (2DGS, after
/// Sigg et al. 2006). None where the disc reaches the camera's plane (d·Tw² >= 0).
fn box_centre(transform: &Matrix3<f64>, c2: f64) -> Option<Vector2<f64>> {
    let d = Vector3::new(c2, c2, -1.0);
    let [tu, tv, tw] = [0, 1, 2].map(|i| transform.row(i).transpose());
    let dw = d.component_mul(&tw);
    let norm = dw.dot(&tw);
    (norm < 0.0).then(|| Vector2::new(dw.dot(&tu), dw.dot(&tv)) / norm)
}

fn box_centre_backward(transform: &Matrix3<f64>, c2: f64, centre: &Vector2<f64>, g: &Vector2<f64>) -> Matrix3<f64> {
    let d = Vector3::new(c2, c2, -1.0);
    let [tu, tv, tw] = [0, 1, 2].map(|i| transform.row(i).transpose());
    let norm = d.component_mul(&tw).dot(&tw);
    let f = d / norm;
    let by_tw = f.component_mul(&((tu - 2.0 * centre.x * tw) * g.x + (tv - 2.0 * centre.y * tw) * g.y));
    let f_tw = f.component_mul(&tw);
    Matrix3::from_rows(&[(f_tw * g.x).transpose(), (f_tw * g.y).transpose(), by_tw.transpose()])
}

/// Rotation of a quaternion w, x, y, z of any length; None of length zero.
pub(super) fn rotation(q: [f32; 4]) -> Option<Matrix3<f64>> {
    let (w, x, y, z) = unit(q)?.0;
    Some(Matrix3::new(
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y), //
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x), //
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    ))
}

/// The backward of [`rotation`], through the normalisation.
pub(super) fn rotation_backward(q: [f32; 4], g: &Matrix3<f64>) -> [f64; 4] {
    let Some(((w, x, y, z), length)) = unit(q) else { return [0.0; 4] };
    let by_unit = [
        2.0 * (x * (g.m32 - g.m23) + y * (g.m13 - g.m31) + z * (g.m21 - g.m12)),
        2.0 * (y * (g.m12 + g.m21) + z * (g.m13 + g.m31) + w * (g.m32 - g.m23) - 2.0 * x * (g.m22 + g.m33)),
        2.0 * (x * (g.m12 + g.m21) + z * (g.m23 + g.m32) + w * (g.m13 - g.m31) - 2.0 * y * (g.m11 + g.m33)),
        2.0 * (x * (g.m13 + g.m31) + y * (g.m23 + g.m32) + w * (g.m21 - g.m12) - 2.0 * z * (g.m11 + g.m22)),
    ];
    let unit = [w, x, y, z];
    let along: f64 = (0..4).map(|k| unit[k] * by_unit[k]).sum();
    std::array::from_fn(|k| (by_unit[k] - along * unit[k]) / length)
}

fn unit(q: [f32; 4]) -> Option<((f64, f64, f64, f64), f64)> {
    let [w, x, y, z] = q.map(f64::from);
    let length = (w * w + x * x + y * y + z * z).sqrt();
    (length > 0.0).then(|| ((w / length, x / length, y / length, z / length), length))
}
