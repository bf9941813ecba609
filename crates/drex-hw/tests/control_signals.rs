//! Signals stop a hand instead of leaving it under torque. One test: signals concern the whole process.
#![cfg(unix)]
#![allow(clippy::unwrap_used)] // a test may stop at the first surprise

use drex_hw::control::{EStop, stop_on_signals};

#[test]
fn signals_press_the_emergency_stop() {
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        let estop = EStop::new();
        stop_on_signals(&estop).unwrap();
        assert!(!estop.is_stopped());
        signal_hook::low_level::raise(signal).unwrap();
        assert!(estop.is_stopped());
    }
}
