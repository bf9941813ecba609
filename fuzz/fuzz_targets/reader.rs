//! One reader under libFuzzer: that which `DREX_FUZZ_TARGET` names. One program serves all, since each would link all of drex.
#![no_main]

use std::sync::LazyLock;

use drex_tests::targets::{Target, find};

static TARGET: LazyLock<&'static Target> = LazyLock::new(|| {
    let name = std::env::var("DREX_FUZZ_TARGET").unwrap_or_default();
    find(&name).unwrap_or_else(|| panic!("DREX_FUZZ_TARGET={name:?} names no reader; `seeds` lists them"))
});

libfuzzer_sys::fuzz_target!(|data: &[u8]| (TARGET.run)(data));
