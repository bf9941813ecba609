//! The scalars a simulation runs on: `f64`, or a dual number that carries derivatives along.

mod dual;
mod traits;

use nalgebra::{SVector, convert};

pub use dual::Dual;

/// What the simulator asks of a number beyond [`drex_core::Real`].
///
/// Code over `T: Scalar` is written once. It takes branches on [`value`](Self::value), so that a dual number goes where
/// `f64` would go, and searches (which contacts, which iterate) on values alone.
pub trait Scalar: drex_core::Real {
    /// Number of derivatives that come along.
    const TANGENTS: usize;

    /// The value without derivatives.
    fn value(&self) -> f64;

    /// Derivative by parameter `i`; zero for an index beyond [`TANGENTS`](Self::TANGENTS).
    fn tangent(&self, i: usize) -> f64;

    /// A number with a given value and a given derivative by each parameter, for results that were found on values and
    /// differentiated by hand (implicit function theorem).
    fn with_tangents(value: f64, tangent: impl FnMut(usize) -> f64) -> Self;

    /// The product with a constant; cheaper than the product with a [lifted](Self::lift) one.
    fn scaled(self, k: f64) -> Self;

    /// A constant.
    fn lift(x: f64) -> Self {
        convert(x)
    }
}

impl Scalar for f64 {
    const TANGENTS: usize = 0;

    #[inline(always)]
    fn value(&self) -> f64 {
        *self
    }
    #[inline(always)]
    fn tangent(&self, _: usize) -> f64 {
        0.0
    }
    #[inline(always)]
    fn with_tangents(value: f64, _: impl FnMut(usize) -> f64) -> Self {
        value
    }
    #[inline(always)]
    fn scaled(self, k: f64) -> Self {
        self * k
    }
    #[inline(always)]
    fn lift(x: f64) -> Self {
        x
    }
}

impl<const N: usize> Scalar for Dual<N> {
    const TANGENTS: usize = N;

    #[inline(always)]
    fn value(&self) -> f64 {
        self.re
    }
    #[inline(always)]
    fn tangent(&self, i: usize) -> f64 {
        self.eps.get(i).copied().unwrap_or(0.0)
    }
    #[inline(always)]
    fn with_tangents(value: f64, tangent: impl FnMut(usize) -> f64) -> Self {
        Self { re: value, eps: std::array::from_fn(tangent) }
    }
    #[inline(always)]
    fn scaled(self, k: f64) -> Self {
        self * k
    }
    #[inline(always)]
    fn lift(x: f64) -> Self {
        Self::from_re(x)
    }
}

/// The dual number of the num-dual crate: an implementation of others that [`Dual`] is measured and tested against.
#[cfg(feature = "num-dual")]
impl<const N: usize> Scalar for num_dual::DualSVec64<N> {
    const TANGENTS: usize = N;

    #[inline]
    fn value(&self) -> f64 {
        self.re
    }
    #[inline]
    fn tangent(&self, i: usize) -> f64 {
        self.eps.0.and_then(|e| e.get(i).copied()).unwrap_or(0.0)
    }
    #[inline]
    fn with_tangents(value: f64, mut tangent: impl FnMut(usize) -> f64) -> Self {
        Self::new(value, num_dual::Derivative::some(SVector::from_fn(|i, _| tangent(i))))
    }
    #[inline]
    fn scaled(self, k: f64) -> Self {
        self * k
    }
    #[inline]
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
    SVector::from(x.eps)
}
