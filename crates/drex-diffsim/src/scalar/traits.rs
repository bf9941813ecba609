//! What nalgebra asks of a real number, for [`Dual`].

use approx::{AbsDiffEq, RelativeEq, UlpsEq};
use nalgebra::{ComplexField, Field, RealField, SimdValue};
use num_traits::{FromPrimitive, Num, One, Signed, Zero};
use simba::scalar::{SubsetOf, SupersetOf};

use super::Dual;

impl<const N: usize> Zero for Dual<N> {
    #[inline(always)]
    fn zero() -> Self {
        Self::from_re(0.0)
    }
    #[inline(always)]
    fn is_zero(&self) -> bool {
        self.re == 0.0
    }
}

impl<const N: usize> One for Dual<N> {
    #[inline(always)]
    fn one() -> Self {
        Self::from_re(1.0)
    }
}

impl<const N: usize> Num for Dual<N> {
    type FromStrRadixErr = <f64 as Num>::FromStrRadixErr;
    fn from_str_radix(text: &str, radix: u32) -> Result<Self, Self::FromStrRadixErr> {
        f64::from_str_radix(text, radix).map(Self::from_re)
    }
}

impl<const N: usize> FromPrimitive for Dual<N> {
    fn from_i64(n: i64) -> Option<Self> {
        f64::from_i64(n).map(Self::from_re)
    }
    fn from_u64(n: u64) -> Option<Self> {
        f64::from_u64(n).map(Self::from_re)
    }
    fn from_f64(x: f64) -> Option<Self> {
        Some(Self::from_re(x))
    }
}

impl<const N: usize> Signed for Dual<N> {
    #[inline]
    fn abs(&self) -> Self {
        Dual::abs(*self)
    }
    fn abs_sub(&self, other: &Self) -> Self {
        if *self <= *other { Self::zero() } else { *self - *other }
    }
    #[inline]
    fn signum(&self) -> Self {
        Dual::signum(*self)
    }
    #[inline]
    fn is_positive(&self) -> bool {
        self.re.is_sign_positive()
    }
    #[inline]
    fn is_negative(&self) -> bool {
        self.re.is_sign_negative()
    }
}

impl<const N: usize> AbsDiffEq for Dual<N> {
    type Epsilon = Self;
    fn default_epsilon() -> Self {
        Self::from_re(f64::default_epsilon())
    }
    fn abs_diff_eq(&self, other: &Self, epsilon: Self) -> bool {
        self.re.abs_diff_eq(&other.re, epsilon.re)
    }
}

impl<const N: usize> RelativeEq for Dual<N> {
    fn default_max_relative() -> Self {
        Self::from_re(f64::default_max_relative())
    }
    fn relative_eq(&self, other: &Self, epsilon: Self, max_relative: Self) -> bool {
        self.re.relative_eq(&other.re, epsilon.re, max_relative.re)
    }
}

impl<const N: usize> UlpsEq for Dual<N> {
    fn default_max_ulps() -> u32 {
        f64::default_max_ulps()
    }
    fn ulps_eq(&self, other: &Self, epsilon: Self, max_ulps: u32) -> bool {
        self.re.ulps_eq(&other.re, epsilon.re, max_ulps)
    }
}

impl<const N: usize> SubsetOf<Self> for Dual<N> {
    #[inline(always)]
    fn to_superset(&self) -> Self {
        *self
    }
    #[inline(always)]
    fn from_superset_unchecked(element: &Self) -> Self {
        *element
    }
    #[inline(always)]
    fn is_in_subset(_: &Self) -> bool {
        true
    }
}

macro_rules! superset_of {
    ($($float:ty),*) => {$(
        /// Plain numbers are constants. The way back drops the derivatives.
        impl<const N: usize> SupersetOf<$float> for Dual<N> {
            #[inline]
            fn is_in_subset(&self) -> bool {
                SupersetOf::<$float>::is_in_subset(&self.re)
            }
            #[inline(always)]
            fn to_subset_unchecked(&self) -> $float {
                self.re as $float
            }
            #[inline(always)]
            fn from_subset(element: &$float) -> Self {
                Self::from_re(f64::from(*element))
            }
        }
    )*};
}
superset_of!(f32, f64);

/// One lane: a dual number is one scalar to nalgebra.
impl<const N: usize> SimdValue for Dual<N> {
    const LANES: usize = 1;
    type Element = Self;
    type SimdBool = bool;

    #[inline(always)]
    fn splat(val: Self) -> Self {
        val
    }
    #[inline(always)]
    fn extract(&self, _: usize) -> Self {
        *self
    }
    #[allow(unsafe_code)] // the trait declares it so; nothing unsafe is done
    #[inline(always)]
    unsafe fn extract_unchecked(&self, _: usize) -> Self {
        *self
    }
    #[inline(always)]
    fn replace(&mut self, _: usize, val: Self) {
        *self = val;
    }
    #[allow(unsafe_code)] // the trait declares it so; nothing unsafe is done
    #[inline(always)]
    unsafe fn replace_unchecked(&mut self, _: usize, val: Self) {
        *self = val;
    }
    #[inline(always)]
    fn select(self, cond: bool, other: Self) -> Self {
        if cond { self } else { other }
    }
}

impl<const N: usize> Field for Dual<N> {}

macro_rules! forward {
    ($($name:ident)*) => {$(
        #[inline]
        fn $name(self) -> Self {
            Dual::$name(self)
        }
    )*};
}

impl<const N: usize> ComplexField for Dual<N> {
    type RealField = Self;

    forward! {
        floor ceil round trunc fract abs signum recip sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh
        sinc sinhc log2 log10 ln ln_1p sqrt exp exp2 exp_m1 cbrt
    }

    #[inline(always)]
    fn from_real(re: Self) -> Self {
        re
    }
    #[inline(always)]
    fn real(self) -> Self {
        self
    }
    #[inline(always)]
    fn imaginary(self) -> Self {
        Self::zero()
    }
    #[inline]
    fn modulus(self) -> Self {
        Dual::abs(self)
    }
    #[inline(always)]
    fn modulus_squared(self) -> Self {
        // Half the work of a product: both factors turn alike.
        let twice = 2.0 * self.re;
        Self { re: self.re * self.re, eps: self.eps.map(|e| e * twice) }
    }
    #[inline]
    fn argument(self) -> Self {
        if self.re >= 0.0 { Self::zero() } else { Self::pi() }
    }
    #[inline]
    fn norm1(self) -> Self {
        Dual::abs(self)
    }
    #[inline(always)]
    fn scale(self, factor: Self) -> Self {
        self * factor
    }
    #[inline(always)]
    fn unscale(self, factor: Self) -> Self {
        self / factor
    }
    #[inline]
    fn to_exp(self) -> (Self, Self) {
        if self.re >= 0.0 { (self, Self::one()) } else { (-self, -Self::one()) }
    }
    #[inline]
    fn mul_add(self, a: Self, b: Self) -> Self {
        Dual::mul_add(self, a, b)
    }
    #[inline]
    fn hypot(self, other: Self) -> Self {
        Dual::hypot(self, other)
    }
    #[inline(always)]
    fn conjugate(self) -> Self {
        self
    }
    #[inline]
    fn sin_cos(self) -> (Self, Self) {
        Dual::sin_cos(self)
    }
    #[inline]
    fn log(self, base: Self) -> Self {
        Dual::log(self, base)
    }
    #[inline]
    fn powi(self, n: i32) -> Self {
        Dual::powi(self, n)
    }
    #[inline]
    fn powf(self, n: Self) -> Self {
        Dual::powf(self, n)
    }
    #[inline]
    fn powc(self, n: Self) -> Self {
        Dual::powf(self, n)
    }
    #[inline]
    fn is_finite(&self) -> bool {
        self.re.is_finite()
    }
    #[inline]
    fn try_sqrt(self) -> Option<Self> {
        (self.re >= 0.0).then(|| Dual::sqrt(self))
    }
}

macro_rules! constants {
    ($($name:ident $value:ident)*) => {$(
        #[inline(always)]
        fn $name() -> Self {
            Self::from_re(std::f64::consts::$value)
        }
    )*};
}

impl<const N: usize> RealField for Dual<N> {
    constants! {
        pi PI two_pi TAU frac_pi_2 FRAC_PI_2 frac_pi_3 FRAC_PI_3 frac_pi_4 FRAC_PI_4 frac_pi_6 FRAC_PI_6
        frac_pi_8 FRAC_PI_8 frac_1_pi FRAC_1_PI frac_2_pi FRAC_2_PI frac_2_sqrt_pi FRAC_2_SQRT_PI
        e E log2_e LOG2_E log10_e LOG10_E ln_2 LN_2 ln_10 LN_10
    }

    #[inline]
    fn is_sign_positive(&self) -> bool {
        self.re.is_sign_positive()
    }
    #[inline]
    fn is_sign_negative(&self) -> bool {
        self.re.is_sign_negative()
    }
    #[inline]
    fn copysign(self, sign: Self) -> Self {
        if self.re.is_sign_negative() == sign.re.is_sign_negative() { self } else { -self }
    }
    #[inline]
    fn max(self, other: Self) -> Self {
        if other.re > self.re || self.re.is_nan() { other } else { self }
    }
    #[inline]
    fn min(self, other: Self) -> Self {
        if other.re < self.re || self.re.is_nan() { other } else { self }
    }
    #[inline]
    fn clamp(self, min: Self, max: Self) -> Self {
        if self.re < min.re {
            min
        } else if self.re > max.re {
            max
        } else {
            self
        }
    }
    #[inline]
    fn atan2(self, other: Self) -> Self {
        Dual::atan2(self, other)
    }
    fn min_value() -> Option<Self> {
        Some(Self::from_re(f64::MIN))
    }
    fn max_value() -> Option<Self> {
        Some(Self::from_re(f64::MAX))
    }
}
