//! Symmetric 3 x 3 matrices by their six numbers, and products spelled out for scalars that are dear to copy.

use nalgebra::{Matrix3, Vector3};

use crate::Scalar;

/// A symmetric 3 x 3 matrix, such as an inertia.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sym3<T> {
    pub xx: T,
    pub yy: T,
    pub zz: T,
    pub xy: T,
    pub xz: T,
    pub yz: T,
}

impl<T: Scalar> Sym3<T> {
    pub fn zero() -> Self {
        let o = T::zero();
        Self { xx: o, yy: o, zz: o, xy: o, xz: o, yz: o }
    }

    /// R A Rᵀ of a symmetric A.
    pub fn turned(r: &Matrix3<T>, a: &Matrix3<T>) -> Self {
        let (r0, r1, r2) = (row(r, 0), row(r, 1), row(r, 2));
        let (b0, b1, b2) = (mul(a, &r0), mul(a, &r1), mul(a, &r2));
        Self { xx: r0.dot(&b0), yy: r1.dot(&b1), zz: r2.dot(&b2), xy: r0.dot(&b1), xz: r0.dot(&b2), yz: r1.dot(&b2) }
    }

    /// This inertia about a point that is `c` away from the centre of mass, where m c = `first`.
    pub fn shifted(&self, c: &Vector3<T>, first: &Vector3<T>) -> Self {
        let (x, y, z) = (c.x * first.x, c.y * first.y, c.z * first.z);
        Self {
            xx: self.xx + y + z,
            yy: self.yy + x + z,
            zz: self.zz + x + y,
            xy: self.xy - c.x * first.y,
            xz: self.xz - c.x * first.z,
            yz: self.yz - c.y * first.z,
        }
    }

    pub fn times(&self, v: &Vector3<T>) -> Vector3<T> {
        Vector3::new(
            self.xx * v.x + self.xy * v.y + self.xz * v.z,
            self.xy * v.x + self.yy * v.y + self.yz * v.z,
            self.xz * v.x + self.yz * v.y + self.zz * v.z,
        )
    }

    pub fn matrix(&self) -> Matrix3<T> {
        Matrix3::new(self.xx, self.xy, self.xz, self.xy, self.yy, self.yz, self.xz, self.yz, self.zz)
    }
}

impl<T: Scalar> std::ops::AddAssign for Sym3<T> {
    fn add_assign(&mut self, o: Self) {
        self.xx += o.xx;
        self.yy += o.yy;
        self.zz += o.zz;
        self.xy += o.xy;
        self.xz += o.xz;
        self.yz += o.yz;
    }
}

fn row<T: Scalar>(m: &Matrix3<T>, i: usize) -> Vector3<T> {
    Vector3::new(m[(i, 0)], m[(i, 1)], m[(i, 2)])
}

/// A v.
pub(crate) fn mul<T: Scalar>(a: &Matrix3<T>, v: &Vector3<T>) -> Vector3<T> {
    Vector3::new(
        a[(0, 0)] * v.x + a[(0, 1)] * v.y + a[(0, 2)] * v.z,
        a[(1, 0)] * v.x + a[(1, 1)] * v.y + a[(1, 2)] * v.z,
        a[(2, 0)] * v.x + a[(2, 1)] * v.y + a[(2, 2)] * v.z,
    )
}
