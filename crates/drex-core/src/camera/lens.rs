//! The lens itself: direction to plane, distortion in the plane, and both inverses.

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

use super::CameraModel;

/// Below this angle or radius, series replace quotients of vanishing numbers.
const SMALL: f64 = 1e-6;

/// How a direction reaches the plane.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Plane {
    /// (x/z, y/z).
    Perspective,
    /// θ (x, y)/√(x² + y²).
    Equidistant,
    /// (x/z, y/z), then the radius r becomes atan(2 r tan(ω/2))/ω (Devernay and Faugeras 2001).
    FieldOfView {
        /// ω, rad.
        omega: f64,
    },
}

/// Distortion without focal length and principal point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lens {
    plane: Plane,
    /// k₁…k₄ of r², r⁴, r⁶, r⁸ above the line.
    above: [f64; 4],
    /// k of r², r⁴, r⁶ below the line.
    below: [f64; 3],
    /// p₁, p₂.
    tangential: [f64; 2],
    /// s_x, s_y.
    prism: [f64; 2],
    /// Radius in the plane at which the radial polynomial folds back: beyond it points would reappear in the image.
    fold_radius: f64,
}

impl Lens {
    /// The lens of `model` with the parameters that follow the principal point; their number has been checked.
    pub(super) fn new(model: CameraModel, k: &[f64]) -> Self {
        let mut lens = Self {
            plane: Plane::Perspective,
            above: [0.0; 4],
            below: [0.0; 3],
            tangential: [0.0; 2],
            prism: [0.0; 2],
            fold_radius: f64::INFINITY,
        };
        match model {
            CameraModel::SimplePinhole | CameraModel::Pinhole => {}
            CameraModel::SimpleRadial | CameraModel::Radial => lens.above[..k.len()].copy_from_slice(k),
            CameraModel::OpenCv => {
                lens.above[..2].copy_from_slice(&k[..2]);
                lens.tangential = [k[2], k[3]];
            }
            CameraModel::FullOpenCv => {
                lens.above[..3].copy_from_slice(&[k[0], k[1], k[4]]);
                lens.tangential = [k[2], k[3]];
                lens.below = [k[5], k[6], k[7]];
            }
            CameraModel::OpenCvFisheye | CameraModel::SimpleRadialFisheye | CameraModel::RadialFisheye => {
                lens.plane = Plane::Equidistant;
                lens.above[..k.len()].copy_from_slice(k);
            }
            CameraModel::ThinPrismFisheye => {
                lens.plane = Plane::Equidistant;
                lens.above = [k[0], k[1], k[4], k[5]];
                lens.tangential = [k[2], k[3]];
                lens.prism = [k[6], k[7]];
            }
            CameraModel::Fov => lens.plane = Plane::FieldOfView { omega: k[0] },
        }
        lens.fold_radius = lens.find_fold();
        lens
    }

    /// The smallest radius at which r ρ(r²) stops to grow, to a part in 10⁹ of an angle; infinite if it always grows.
    fn find_fold(self) -> f64 {
        const STEPS: u32 = 2000;
        let widest = match self.plane {
            Plane::Equidistant => std::f64::consts::PI,
            _ => 89.0f64.to_radians(),
        };
        let radius = |angle: f64| if self.plane == Plane::Equidistant { angle } else { angle.tan() };
        let grows = |angle: f64| {
            let r2 = radius(angle).powi(2);
            let (radial, by_r2, below) = self.radial(r2);
            below > 0.0 && radial + 2.0 * r2 * by_r2 > 0.0
        };
        let step = widest / f64::from(STEPS);
        let Some(first) = (1..=STEPS).find(|i| !grows(f64::from(*i) * step)) else { return f64::INFINITY };
        let (mut inside, mut outside) = (f64::from(first - 1) * step, f64::from(first) * step);
        for _ in 0..24 {
            let middle = 0.5 * (inside + outside);
            if grows(middle) { inside = middle } else { outside = middle }
        }
        radius(inside)
    }

    /// ρ at r², its derivative by r², and the polynomial below the line.
    fn radial(self, r2: f64) -> (f64, f64, f64) {
        let [k1, k2, k3, k4] = self.above;
        let [b1, b2, b3] = self.below;
        let above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
        let d_above = k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + r2 * 4.0 * k4));
        let below = 1.0 + r2 * (b1 + r2 * (b2 + r2 * b3));
        let d_below = b1 + r2 * (2.0 * b2 + r2 * 3.0 * b3);
        let radial = above / below;
        (radial, (d_above - radial * d_below) / below, below)
    }

    /// The point of the plane that a direction reaches, and its derivative.
    pub(super) fn to_plane(self, d: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let xy = d.xy();
        let rho = xy.norm();
        match self.plane {
            Plane::Equidistant => {
                let n2 = d.norm_squared();
                if !(n2 > 0.0) || (rho == 0.0 && d.z < 0.0) {
                    return None;
                }
                let theta = rho.atan2(d.z);
                // s = θ/ρ; ds = (ds/dρ) dρ + (ds/dz) dz with dθ/dρ = z/n², dθ/dz = -ρ/n².
                let (s, ds_by_rho_over_rho) = if theta < SMALL {
                    // θ/ρ = 1/z (1 - (ρ/z)²/3 + …)
                    (1.0 / d.z * (1.0 - (rho / d.z).powi(2) / 3.0), -2.0 / (3.0 * d.z.powi(3)))
                } else {
                    (theta / rho, (d.z / n2 - theta / rho) / (rho * rho))
                };
                let mut j = Matrix2x3::zeros();
                let by_xy = Matrix2::identity() * s + xy * xy.transpose() * ds_by_rho_over_rho;
                j.fixed_view_mut::<2, 2>(0, 0).copy_from(&by_xy);
                j.set_column(2, &(-xy / n2));
                Some((xy * s, j))
            }
            Plane::Perspective | Plane::FieldOfView { .. } => {
                if !(d.z > 0.0) {
                    return None;
                }
                let p = xy / d.z;
                let j = Matrix2x3::new(1.0, 0.0, -p.x, 0.0, 1.0, -p.y) / d.z;
                match self.plane {
                    Plane::FieldOfView { omega } => {
                        let (s, ds_over_r) = fov_scale(omega, p.norm());
                        Some((p * s, (Matrix2::identity() * s + p * p.transpose() * ds_over_r) * j))
                    }
                    _ => Some((p, j)),
                }
            }
        }
    }

    /// The unit direction that reaches a point of the plane.
    pub(super) fn ray_of(self, p: &Vector2<f64>) -> Option<Vector3<f64>> {
        let r = p.norm();
        match self.plane {
            Plane::Perspective => Some(Vector3::new(p.x, p.y, 1.0).normalize()),
            Plane::Equidistant => {
                if !(r <= std::f64::consts::PI) {
                    return None;
                }
                let sinc = if r < SMALL { 1.0 - r * r / 6.0 } else { r.sin() / r };
                Some(Vector3::new(p.x * sinc, p.y * sinc, r.cos()))
            }
            Plane::FieldOfView { omega } => {
                let w = omega.abs();
                if !(r * w < std::f64::consts::FRAC_PI_2) {
                    return None;
                }
                let tangent = 2.0 * (0.5 * w).tan();
                let s = match w {
                    w if w < SMALL => 1.0,
                    w if r * w < SMALL => w / tangent,
                    w => (r * w).tan() / (r * tangent),
                };
                Some(Vector3::new(p.x * s, p.y * s, 1.0).normalize())
            }
        }
    }

    /// Distortion in the plane, with its derivative.
    pub(super) fn distort(self, p: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let (x, y) = (p.x, p.y);
        let r2 = p.norm_squared();
        let (radial, d_radial, _) = self.radial(r2);
        let [p1, p2] = self.tangential;
        let s = Vector2::from(self.prism);
        let tangent =
            Vector2::new(2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y));
        let bent = p * radial + tangent + s * r2;
        let tangent_j = Matrix2::new(
            2.0 * p1 * y + 6.0 * p2 * x,
            2.0 * p1 * x + 2.0 * p2 * y,
            2.0 * p2 * y + 2.0 * p1 * x,
            2.0 * p2 * x + 6.0 * p1 * y,
        );
        let j = Matrix2::identity() * radial + (p * d_radial + s) * (2.0 * p.transpose()) + tangent_j;
        (bent, j)
    }

    /// Whether a point of the plane lies before the fold.
    pub(super) fn covers(self, p: &Vector2<f64>) -> bool {
        p.norm() < self.fold_radius
    }

    /// The point of the plane that is bent to `target`: Newton's method with halved steps, along a path from the
    /// centre so that the answer is on the branch that contains the optical axis.
    pub(super) fn undistort(self, target: &Vector2<f64>) -> Option<Vector2<f64>> {
        if !target.iter().all(|v| v.is_finite()) {
            return None;
        }
        if self.above == [0.0; 4] && self.below == [0.0; 3] && self.tangential == [0.0; 2] && self.prism == [0.0; 2] {
            return Some(*target);
        }
        let mut p = Vector2::zeros();
        // Steps of the target of at most 0.25 (about 14 degrees) keep Newton on the branch.
        let legs = (target.norm() / 0.25).ceil().clamp(1.0, 64.0) as usize;
        for leg in 1..=legs {
            p = self.newton(p, &(target * (leg as f64 / legs as f64)))?;
        }
        Some(p)
    }

    fn newton(self, start: Vector2<f64>, target: &Vector2<f64>) -> Option<Vector2<f64>> {
        const TOLERANCE: f64 = 1e-13;
        let mut p = start;
        let (mut bent, mut j) = self.distort(&p);
        for _ in 0..50 {
            let error = target - bent;
            let size = error.norm();
            if size <= TOLERANCE * (1.0 + target.norm()) {
                break;
            }
            let step = j.try_inverse()? * error;
            let mut scale = 1.0;
            loop {
                let (next_bent, next_j) = self.distort(&(p + step * scale));
                // On the branch of the optical axis the map keeps orientation; a step that leaves it is cut.
                if next_j.determinant() > 0.0 && (target - next_bent).norm() < size {
                    p += step * scale;
                    (bent, j) = (next_bent, next_j);
                    break;
                }
                scale *= 0.5;
                if scale < 1e-10 {
                    // No progress: either at rounding, or at the fold.
                    return (size <= 1e-11 * (1.0 + target.norm())).then_some(p);
                }
            }
        }
        ((target - bent).norm() <= 1e-11 * (1.0 + target.norm())).then_some(p)
    }
}

/// atan(2 r tan(ω/2))/(ω r), and its derivative by r divided by r.
fn fov_scale(omega: f64, r: f64) -> (f64, f64) {
    let w = omega.abs();
    if w < SMALL {
        return (1.0, 0.0);
    }
    let a = 2.0 * (0.5 * w).tan();
    if r * a < 1e-3 {
        // atan(x)/x = 1 - x²/3 + x⁴/5 - …
        let x2 = (a * r).powi(2);
        let (k, a2) = (a / w, a * a);
        return (k * (1.0 - x2 / 3.0 + x2 * x2 / 5.0), k * a2 * (-2.0 / 3.0 + 0.8 * x2));
    }
    let s = (a * r).atan() / (w * r);
    let by_r = a / (w * r * (1.0 + (a * r).powi(2))) - s / r;
    (s, by_r / r)
}
