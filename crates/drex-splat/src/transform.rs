//! Moving, scaling, joining and selecting sets.

use nalgebra::{DMatrix, Quaternion, Similarity3, UnitQuaternion, Vector3};

use crate::{Error, Gaussians, Label, Result};

/// Real spherical harmonics of degrees 0 to 3 in the unit direction `d`, with the signs of the 3DGS code: the basis that
/// [`Gaussians::sh`] are coefficients of.
pub fn sh_basis(d: &Vector3<f64>) -> [f64; 16] {
    let [x, y, z] = [d.x, d.y, d.z];
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        0.282_094_791_773_878_14,
        -0.488_602_511_902_919_9 * y,
        0.488_602_511_902_919_9 * z,
        -0.488_602_511_902_919_9 * x,
        1.092_548_430_592_079_2 * x * y,
        -1.092_548_430_592_079_2 * y * z,
        0.315_391_565_252_520_05 * (2.0 * zz - xx - yy),
        -1.092_548_430_592_079_2 * x * z,
        0.546_274_215_296_039_6 * (xx - yy),
        -0.590_043_589_926_643_5 * y * (3.0 * xx - yy),
        2.890_611_442_640_554 * x * y * z,
        -0.457_045_799_464_465_8 * y * (4.0 * zz - xx - yy),
        0.373_176_332_590_115_4 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.457_045_799_464_465_8 * x * (4.0 * zz - xx - yy),
        1.445_305_721_320_277 * z * (xx - yy),
        -0.590_043_589_926_643_5 * x * (xx - 3.0 * yy),
    ]
}

/// How coefficients of spherical harmonics change when what they colour is rotated: bands do not mix, band l has an
/// orthogonal matrix of 2 l + 1 rows.
#[derive(Debug, Clone)]
pub struct ShRotation {
    bands: [DMatrix<f64>; 3],
}

impl ShRotation {
    /// For a rotation `R` that maps the old frame to the new one.
    ///
    /// With Y(d) the basis of a band and Y(R d) = D Y(d), the colour stays with the body if c' = D c. Y is orthonormal,
    /// so D = ∫ Y(R d) Y(d)ᵀ dΩ, a polynomial of degree 6 at most that a sum over few directions integrates exactly.
    pub fn new(rotation: &UnitQuaternion<f64>) -> Self {
        let mut bands = [3, 5, 7].map(|n| DMatrix::zeros(n, n));
        for (d, w) in directions() {
            let (y, y_turned) = (sh_basis(&d), sh_basis(&(rotation * d)));
            for (l, matrix) in (1usize..).zip(&mut bands) {
                *matrix += DMatrix::from_fn(2 * l + 1, 2 * l + 1, |i, j| w * y_turned[l * l + i] * y[l * l + j]);
            }
        }
        Self { bands }
    }

    /// Rotates one Gaussian's coefficients in place: coefficient by coefficient, red, green, blue inside; degree 0 to 3.
    pub fn apply(&self, sh: &mut [f32]) {
        for (l, matrix) in (1usize..).zip(&self.bands) {
            let Some(band) = sh.get_mut(3 * l * l..3 * (l + 1) * (l + 1)) else { break };
            let mut c = [[0.0; 3]; 7];
            for (k, c) in c.iter_mut().enumerate().take(2 * l + 1) {
                *c = [band[3 * k], band[3 * k + 1], band[3 * k + 2]].map(f64::from);
            }
            for (row, out) in band.chunks_exact_mut(3).enumerate() {
                for (channel, out) in out.iter_mut().enumerate() {
                    *out = (0..2 * l + 1).map(|k| matrix[(row, k)] * c[k][channel]).sum::<f64>() as f32;
                }
            }
        }
    }
}

/// Directions and weights that integrate polynomials of degree 7 over the sphere exactly: 4 points of Gauss and Legendre
/// along z, 8 even angles round it.
fn directions() -> impl Iterator<Item = (Vector3<f64>, f64)> {
    const NODES: [(f64, f64); 2] =
        [(0.339_981_043_584_856_3, 0.652_145_154_862_546_1), (0.861_136_311_594_052_6, 0.347_854_845_137_453_86)];
    const STEP: f64 = std::f64::consts::FRAC_PI_4;
    NODES.into_iter().flat_map(|(z, w)| [(z, w), (-z, w)]).flat_map(|(z, w)| {
        let r = (1.0 - z * z).sqrt();
        (0..8)
            .map(move |k| (STEP * f64::from(k)).sin_cos())
            .map(move |(s, c)| (Vector3::new(r * c, r * s, z), w * STEP))
    })
}

impl Gaussians {
    /// The set in another frame: centres, rotations and scales are mapped by `a_from_b`, and the spherical harmonics are
    /// rotated so that every Gaussian keeps its colours as seen from the same side.
    ///
    /// # Errors
    /// If a number of the transform is not finite or its scale is not positive.
    pub fn transformed(&self, a_from_b: &Similarity3<f64>) -> Result<Self> {
        let s = a_from_b.scaling();
        if !(s > 0.0) || a_from_b.to_homogeneous().iter().any(|v| !v.is_finite()) {
            return Err(Error::Option {
                what: format!("Gaussians are to be moved by a transform with scale {s}, or one that is not finite"),
                remedy: "give a finite transform with a positive scale".into(),
            });
        }
        let rotation = a_from_b.isometry.rotation;
        let q = rotation.quaternion();
        let log_s = s.ln() as f32;
        let mut out = self.clone();
        for mean in &mut out.means {
            let p = a_from_b * nalgebra::Point3::from(mean.map(f64::from));
            *mean = [p.x as f32, p.y as f32, p.z as f32];
        }
        for r in &mut out.rotations {
            let [w, x, y, z] = r.map(f64::from);
            let turned = q * Quaternion::new(w, x, y, z);
            *r = [turned.w as f32, turned.i as f32, turned.j as f32, turned.k as f32];
        }
        for log_scale in out.log_scales.iter_mut().flatten() {
            *log_scale += log_s;
        }
        if self.sh_degree > 0 && rotation.angle() > 0.0 {
            let sh_rotation = ShRotation::new(&rotation);
            for sh in out.sh.chunks_exact_mut(self.sh_stride()) {
                sh_rotation.apply(sh);
            }
        }
        Ok(out)
    }

    /// The set with spherical harmonics of another degree: higher ones are zero, or dropped.
    #[must_use]
    pub fn with_sh_degree(&self, sh_degree: usize) -> Self {
        let stride = 3 * (sh_degree + 1).pow(2);
        let kept = stride.min(self.sh_stride());
        let mut sh = vec![0.0; self.len() * stride];
        for (to, from) in sh.chunks_exact_mut(stride).zip(self.sh.chunks_exact(self.sh_stride())) {
            to[..kept].copy_from_slice(&from[..kept]);
        }
        Self { sh_degree, sh, ..self.clone() }
    }

    /// The Gaussians of all `sets`, in order, with the highest of their degrees.
    ///
    /// # Errors
    /// If there are no sets, or ellipsoids and surfels are mixed.
    pub fn merged(sets: &[&Self]) -> Result<Self> {
        let Some(first) = sets.first() else {
            return Err(Error::Gaussians { what: "no set of Gaussians to join".into(), remedy: "give one".into() });
        };
        if sets.iter().any(|s| s.kind != first.kind) {
            return Err(Error::Gaussians {
                what: "ellipsoids and surfels cannot be drawn together".into(),
                remedy: "give sets of one kind".into(),
            });
        }
        let sh_degree = sets.iter().map(|s| s.sh_degree).max().unwrap_or(0);
        let mut out = Self::new(first.kind, sh_degree);
        for set in sets {
            let set = set.with_sh_degree(sh_degree);
            out.means.extend(set.means);
            out.rotations.extend(set.rotations);
            out.log_scales.extend(set.log_scales);
            out.logit_opacities.extend(set.logit_opacities);
            out.sh.extend(set.sh);
            out.labels.extend(set.labels);
        }
        Ok(out)
    }

    /// Those with a label, in the same order.
    #[must_use]
    pub fn labelled(&self, label: Label) -> Self {
        self.filtered(|i| self.labels[i] == label)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)] // a panic is the report
mod tests {
    use super::*;

    #[test]
    fn the_basis_is_orthonormal_over_the_directions() {
        for i in 0..16 {
            for j in 0..16 {
                let dot: f64 = directions().map(|(d, w)| w * sh_basis(&d)[i] * sh_basis(&d)[j]).sum();
                assert!((dot - f64::from(u8::from(i == j))).abs() < 1e-12, "{i} {j}: {dot}");
            }
        }
    }

    #[test]
    fn bands_turn_by_orthogonal_matrices_that_compose() {
        let a = UnitQuaternion::from_scaled_axis(Vector3::new(0.4, -1.2, 2.0));
        let b = UnitQuaternion::from_scaled_axis(Vector3::new(-2.4, 0.3, 0.1));
        let [ra, rb, rab] = [a, b, a * b].map(|r| ShRotation::new(&r));
        for l in 0..3 {
            let d = &ra.bands[l];
            assert!((d * d.transpose() - DMatrix::identity(d.nrows(), d.nrows())).amax() < 1e-12);
            assert!((d * &rb.bands[l] - &rab.bands[l]).amax() < 1e-12);
        }
    }
}
