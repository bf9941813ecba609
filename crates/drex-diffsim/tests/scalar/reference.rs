//! num-dual's dual numbers as the independent reference.

use drex_diffsim::{Dual, Scalar};
use num_dual::DualSVec64;
use proptest::prelude::*;

use crate::algebra::{Outputs, cholesky, inverse4, isometry, quaternion, rotation_matrix};
use crate::close;
use crate::functions::{BINARY, UNARY, binary, unary};

fn agree(ours: &Dual<2>, theirs: &DualSVec64<2>) -> bool {
    close(ours.re, theirs.value(), 1e-13) && (0..2).all(|i| close(ours.eps[i], Scalar::tangent(theirs, i), 1e-12))
}

fn both(x: f64, eps: [f64; 2]) -> (Dual<2>, DualSVec64<2>) {
    (Dual::new(x, eps), DualSVec64::with_tangents(x, |i| eps[i]))
}

proptest! {
    #[test]
    fn functions_agree(s in 0.0..1.0_f64, e in -2.0..2.0_f64) {
        for (name, lo, hi) in UNARY {
            if name == "argument" {
                continue; // theirs is zero for negative numbers too
            }
            let (x, y) = both(lo + s * (hi - lo), [e, 1.0]);
            prop_assert!(agree(&unary(name, x), &unary(name, y)), "{}({}): {} {}", name, x, unary(name, x), unary(name, y));
        }
    }

    #[test]
    fn functions_of_two_numbers_agree(x in 0.2..3.0_f64, y in 1.2..2.8_f64, e in -2.0..2.0_f64) {
        prop_assume!((x - y).abs() > 1e-6);
        let ((a, c), (b, d)) = (both(x, [e, 1.0]), both(y, [0.5, -e]));
        for name in BINARY {
            prop_assert!(agree(&binary(name, a, b), &binary(name, c, d)), "{}({}, {})", name, a, b);
        }
    }

    #[test]
    fn linear_algebra_agrees(p in prop::array::uniform6(-1.0..1.0_f64), e in prop::array::uniform6(-1.0..1.0_f64)) {
        let ours: [Dual<2>; 6] = std::array::from_fn(|i| both(p[i], [e[i], e[5 - i]]).0);
        let theirs: [DualSVec64<2>; 6] = std::array::from_fn(|i| both(p[i], [e[i], e[5 - i]]).1);
        prop_assert!(inverse4.at(ours).iter().zip(&inverse4.at(theirs)).all(|(a, b)| agree(a, b)));
        prop_assert!(cholesky.at(ours).iter().zip(&cholesky.at(theirs)).all(|(a, b)| agree(a, b)));
        prop_assert!(quaternion.at(ours).iter().zip(&quaternion.at(theirs)).all(|(a, b)| agree(a, b)));
        prop_assert!(rotation_matrix.at(ours).iter().zip(&rotation_matrix.at(theirs)).all(|(a, b)| agree(a, b)));
        prop_assert!(isometry.at(ours).iter().zip(&isometry.at(theirs)).all(|(a, b)| agree(a, b)));
    }
}
