//! Plain loops compiled for the instructions of the machine that runs them.

/// Runs `work` as if it were compiled for the widest vectors this machine has.
///
/// That holds only for code that is inlined into it: mark the closure, closures within it and the functions they call
/// `#[inline(always)]`. It is `FnMut` because for `FnOnce` the compiler may put a call in between that is not inlined.
#[inline(always)]
pub fn vectorised<R>(work: impl FnMut() -> R) -> R {
    struct Work<F>(F);

    impl<R, F: FnMut() -> R> pulp::WithSimd for Work<F> {
        type Output = R;

        #[inline(always)]
        fn with_simd<S: pulp::Simd>(mut self, _: S) -> R {
            (self.0)()
        }
    }

    pulp::Arch::new().dispatch(Work(work))
}
