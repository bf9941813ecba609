//! Quadric error metrics.

use nalgebra::{Matrix3, Point3, Vector3};

/// Weight of the second moment when a place is sought: enough to decide where planes leave it open, too little to pull a
/// corner off its planes by more than 1e-6 of the region.
const TIE: f64 = 1e-6;

/// A weighted sum of squared distances to planes (Garland and Heckbert, "Surface Simplification Using Quadric Error
/// Metrics", 1997), P(x) = xᵀ A x - 2 bᵀ x + c, and of squared distances to points on them, M(x) = w xᵀ x - 2 mᵀ x + s.
///
/// P + σ² M is the expected squared distance to planes whose normals are known up to Gaussian noise σ per axis (Trettner and
/// Kobbelt, "Fast and Robust QEF Minimization using Probabilistic Quadrics", 2020). M is the second moment of the surface
/// that a vertex stands for, so it also keeps those regions equally large.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quadric {
    /// A: xx xy xz yy yz zz.
    a: [f64; 6],
    b: Vector3<f64>,
    c: f64,
    w: f64,
    m: Vector3<f64>,
    s: f64,
}

impl Quadric {
    pub fn zero() -> Self {
        Self { a: [0.0; 6], b: Vector3::zeros(), c: 0.0, w: 0.0, m: Vector3::zeros(), s: 0.0 }
    }

    /// The plane through `p` with unit normal `n`.
    pub fn plane(n: &Vector3<f64>, p: &Vector3<f64>, weight: f64) -> Self {
        let d = n.dot(p);
        Self {
            a: [n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z].map(|e| weight * e),
            b: n * (weight * d),
            c: weight * d * d,
            w: weight,
            m: p * weight,
            s: weight * p.norm_squared(),
        }
    }

    pub fn plus(&self, o: &Self) -> Self {
        Self {
            a: std::array::from_fn(|k| self.a[k] + o.a[k]),
            b: self.b + o.b,
            c: self.c + o.c,
            w: self.w + o.w,
            m: self.m + o.m,
            s: self.s + o.s,
        }
    }

    /// P + σ² M at `x`.
    pub fn at(&self, x: &Vector3<f64>, sigma: f64) -> f64 {
        let p = x.dot(&(symmetric(&self.a) * x)) - 2.0 * self.b.dot(x) + self.c;
        let m = self.w * x.norm_squared() - 2.0 * self.m.dot(x) + self.s;
        // Rounding can make them a hair negative.
        p.max(0.0) + sigma * sigma * m.max(0.0)
    }

    /// Where the distance to the planes is smallest; what they leave open is decided by M.
    pub fn minimum(&self) -> Option<Point3<f64>> {
        let a = symmetric(&self.a) + Matrix3::identity() * (TIE * self.w);
        let x = a.cholesky()?.solve(&(self.b + self.m * TIE));
        x.iter().all(|c| c.is_finite()).then(|| x.into())
    }
}

fn symmetric(&[xx, xy, xz, yy, yz, zz]: &[f64; 6]) -> Matrix3<f64> {
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}
