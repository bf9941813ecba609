//! Colour by direction: real spherical harmonics of degree 0 to 3 (Kerbl et al. 2023; signs as in INRIA's files).

use nalgebra::{Point3, Vector3};

/// Numbers of a basis of degree 3.
const COUNT: usize = 16;

/// Unit direction from the camera's centre to a splat's, world frame, and 1 / distance; zero at the centre itself.
#[inline]
pub(crate) fn direction(mean: [f32; 3], centre: &Point3<f64>) -> (Vector3<f32>, f32) {
    let d = Vector3::new(
        (f64::from(mean[0]) - centre.x) as f32,
        (f64::from(mean[1]) - centre.y) as f32,
        (f64::from(mean[2]) - centre.z) as f32,
    );
    let r = d.norm();
    if r > 0.0 && r.is_finite() { (d / r, 1.0 / r) } else { (Vector3::zeros(), 0.0) }
}

/// max(0, 0.5 + Σ basis_k(dir) sh_k): `sh` coefficient by coefficient, RGB last; if it has less than `degree`, all of it.
#[inline]
pub(crate) fn colour(degree: usize, sh: &[f32], dir: &Vector3<f32>) -> [f32; 3] {
    let basis = basis(degree, dir);
    let mut c = [0.5; 3];
    for (b, s) in basis.iter().zip(sh.as_chunks::<3>().0).take((degree + 1).pow(2)) {
        for k in 0..3 {
            c[k] += b * s[k];
        }
    }
    c.map(|v| v.max(0.0))
}

/// The backward of [`colour`]: `d_sh` += dL/dsh, returns dL/d(mean) through the direction (of which dL/d(centre) is
/// the negative). `c` is what [`colour`] gave, `inv_distance` what [`direction`] gave.
#[inline]
pub(crate) fn colour_backward(
    degree: usize,
    sh: &[f32],
    (dir, inv_distance): (&Vector3<f32>, f32),
    c: [f32; 3],
    d_c: [f32; 3],
    d_sh: &mut [f32],
) -> Vector3<f32> {
    let d_c: [f32; 3] = std::array::from_fn(|k| if c[k] > 0.0 { d_c[k] } else { 0.0 });
    let basis = basis(degree, dir);
    let used = (degree + 1).pow(2);
    let mut d_basis = [0.0; COUNT];
    let (sh, d_sh) = (sh.as_chunks::<3>().0, d_sh.as_chunks_mut::<3>().0);
    for k in 0..used.min(sh.len()).min(d_sh.len()) {
        for i in 0..3 {
            d_sh[k][i] += basis[k] * d_c[i];
            d_basis[k] += sh[k][i] * d_c[i];
        }
    }
    if degree == 0 {
        return Vector3::zeros();
    }
    let d_dir = basis_backward(degree, dir, &d_basis);
    (d_dir - dir * dir.dot(&d_dir)) * inv_distance
}

const C0: f32 = 0.282_094_8;
const C1: f32 = 0.488_602_5;
const C2: [f32; 3] = [1.092_548_4, 0.315_391_57, 0.546_274_2];
const C3: [f32; 5] = [0.590_043_6, 2.890_611_4, 0.457_045_8, 0.373_176_33, 1.445_305_7];

#[inline]
fn basis(degree: usize, dir: &Vector3<f32>) -> [f32; COUNT] {
    let (x, y, z) = (dir.x, dir.y, dir.z);
    let mut b = [0.0; COUNT];
    b[0] = C0;
    if degree >= 1 {
        [b[1], b[2], b[3]] = [-C1 * y, C1 * z, -C1 * x];
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        b[4] = C2[0] * x * y;
        b[5] = -C2[0] * y * z;
        b[6] = C2[1] * (2.0 * zz - xx - yy);
        b[7] = -C2[0] * x * z;
        b[8] = C2[2] * (xx - yy);
    }
    if degree >= 3 {
        b[9] = -C3[0] * y * (3.0 * xx - yy);
        b[10] = C3[1] * x * y * z;
        b[11] = -C3[2] * y * (4.0 * zz - xx - yy);
        b[12] = C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        b[13] = -C3[2] * x * (4.0 * zz - xx - yy);
        b[14] = C3[4] * z * (xx - yy);
        b[15] = -C3[0] * x * (xx - 3.0 * yy);
    }
    b
}

/// Σ_k d_k ∂basis_k / ∂(x, y, z).
#[inline]
fn basis_backward(degree: usize, dir: &Vector3<f32>, d: &[f32; COUNT]) -> Vector3<f32> {
    let (x, y, z) = (dir.x, dir.y, dir.z);
    let mut g = Vector3::new(-C1 * d[3], -C1 * d[1], C1 * d[2]);
    if degree >= 2 {
        g.x += C2[0] * (y * d[4] - z * d[7]) - 2.0 * C2[1] * x * d[6] + 2.0 * C2[2] * x * d[8];
        g.y += C2[0] * (x * d[4] - z * d[5]) - 2.0 * C2[1] * y * d[6] - 2.0 * C2[2] * y * d[8];
        g.z += -C2[0] * (y * d[5] + x * d[7]) + 4.0 * C2[1] * z * d[6];
    }
    if degree >= 3 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        g.x += -6.0 * C3[0] * x * y * d[9] + C3[1] * y * z * d[10] + 2.0 * C3[2] * x * y * d[11]
            - 6.0 * C3[3] * x * z * d[12]
            - C3[2] * (4.0 * zz - 3.0 * xx - yy) * d[13]
            + 2.0 * C3[4] * x * z * d[14]
            - 3.0 * C3[0] * (xx - yy) * d[15];
        g.y += -3.0 * C3[0] * (xx - yy) * d[9] + C3[1] * x * z * d[10]
            - C3[2] * (4.0 * zz - xx - 3.0 * yy) * d[11]
            - 6.0 * C3[3] * y * z * d[12]
            + 2.0 * C3[2] * x * y * d[13]
            - 2.0 * C3[4] * y * z * d[14]
            + 6.0 * C3[0] * x * y * d[15];
        g.z += C3[1] * x * y * d[10] - 8.0 * C3[2] * y * z * d[11] + 3.0 * C3[3] * (2.0 * zz - xx - yy) * d[12]
            - 8.0 * C3[2] * x * z * d[13]
            + C3[4] * (xx - yy) * d[14];
    }
    g
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backward_is_the_derivative_of_the_colour() {
        let sh: Vec<f32> = (0..48).map(|k| 0.3 * (1.7 * k as f32).sin()).collect();
        let (mean, centre, d_c) = ([0.4, -0.9, 1.6], Point3::new(-0.2, 0.3, 0.1), [0.7, -0.4, 1.1]);
        let loss = |mean: [f32; 3], sh: &[f32], degree: usize| -> f32 {
            let c = colour(degree, sh, &direction(mean, &centre).0);
            (0..3).map(|k| c[k] * d_c[k]).sum()
        };
        for degree in 0..=3 {
            let (dir, inv) = direction(mean, &centre);
            let mut d_sh = vec![0.0; 48];
            let c = colour(degree, &sh, &dir);
            let d_mean = colour_backward(degree, &sh, (&dir, inv), c, d_c, &mut d_sh);
            for axis in 0..3 {
                let h = 1e-2;
                let (mut up, mut down) = (mean, mean);
                (up[axis], down[axis]) = (mean[axis] + h, mean[axis] - h);
                let slope = (loss(up, &sh, degree) - loss(down, &sh, degree)) / (2.0 * h);
                assert!((slope - d_mean[axis]).abs() < 5e-4, "degree {degree}: {slope} {}", d_mean[axis]);
            }
            for k in 0..3 * (degree + 1).pow(2) {
                let mut up = sh.clone();
                up[k] += 0.01;
                let slope = (loss(mean, &up, degree) - loss(mean, &sh, degree)) / 0.01;
                assert!((slope - d_sh[k]).abs() < 1e-3, "degree {degree}, coefficient {k}");
            }
        }
    }

    #[test]
    fn a_splat_at_the_cameras_centre_has_a_finite_colour() {
        let (dir, inv) = direction([1.0; 3], &Point3::new(1.0, 1.0, 1.0));
        assert_eq!(inv, 0.0);
        assert!(colour(3, &[0.1; 48], &dir).iter().all(|c| c.is_finite()));
    }
}
