//! The scalars a simulation runs on: `f64`, or a dual number that carries derivatives along.

use nalgebra::{SVector, convert};
use num_dual::DualSVec64;

/// A dual number with `N` tangents on the stack: a value and its derivatives by `N` parameters.
/// It is num-dual's `DualSVec64`; comparisons look at the value alone, so a branch is taken as `f64` would take it.
pub type Dual<const N: usize> = DualSVec64<N>;

/// What the simulator asks of a number beyond [`drex_core::Real`].
pub trait Scalar: drex_core::Real {
    /// Number of derivatives that it carries; none for `f64`.
    const TANGENTS: usize;
    /// The value without derivatives.
    fn value(&self) -> f64;
    /// A constant.
    fn lift(x: f64) -> Self {
        convert(x)
    }
}

impl Scalar for f64 {
    const TANGENTS: usize = 0;
    fn value(&self) -> f64 {
        *self
    }
    fn lift(x: f64) -> Self {
        x
    }
}

impl<const N: usize> Scalar for Dual<N> {
    const TANGENTS: usize = N;
    fn value(&self) -> f64 {
        self.re
    }
    fn lift(x: f64) -> Self {
        Self::from_re(x)
    }
}

/// The parameter number `index` with value `x`: derivative one by itself, zero by the others.
pub fn parameter<const N: usize>(x: f64, index: usize) -> Dual<N> {
    Dual::<N>::from_re(x).derivative(index)
}

/// The derivatives a dual number carries.
pub fn tangents<const N: usize>(x: &Dual<N>) -> SVector<f64, N> {
    x.eps.0.unwrap_or_else(SVector::zeros)
}
