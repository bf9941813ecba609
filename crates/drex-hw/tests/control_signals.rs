//! Signals stop a hand instead of leaving it under torque. One test: signals concern the whole process.
#![cfg(unix)]
#![allow(clippy::unwrap_used)] // a test may stop at the first surprise

use drex_hw::allegro::{AllegroHand, AllegroOptions, AllegroVersion};
use drex_hw::control::{ControlLoop, ControlOptions, EStop, StopReason, Trajectory, Waypoint, stop_on_signals};
use drex_hw::emulator::allegro::AllegroEmulator;
use drex_robot::Robot;

#[test]
fn signals_press_the_emergency_stop() {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};
    for signal in [SIGINT, SIGTERM, SIGHUP, SIGQUIT] {
        let estop = EStop::new();
        stop_on_signals(&estop).unwrap();
        let emulator = AllegroEmulator::new(AllegroVersion::V4).in_real_time();
        emulator.place(12, 0.5);
        let robot = Robot::bundled("allegro_right").unwrap();
        let hand = AllegroHand::connect(emulator.bus(), &robot, AllegroOptions::new(AllegroVersion::V4)).unwrap();
        let slow = Waypoint { time_s: 3600.0, position: vec![0.3; 16] };
        let trajectory = Trajectory::new(vec![slow], vec![0.1; 16]).unwrap();
        let options = ControlOptions::default().with_estop(&estop);
        let running = ControlLoop::start(hand, trajectory, options).unwrap();
        while running.stats().cycles == 0 {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        assert!(running.is_running() && emulator.is_on() && !estop.is_stopped());
        signal_hook::low_level::raise(signal).unwrap();
        let (_, report) = running.wait();
        assert!(matches!(report.stop_reason, StopReason::Stopped) && report.torque_off.is_ok());
        assert!(!emulator.is_on());
    }
}
