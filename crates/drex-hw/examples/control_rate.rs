//! How well the loop keeps its time on this machine, with an emulated Allegro hand: `control_rate [RATE_HZ] [SECONDS]`.
//!
//! Two hands: in memory, and over slcan at a pseudo-terminal. Late is how much later than planned a cycle began; busy is controller and
//! exchange; missed cycles were left out because the one before took too long.
#![allow(clippy::print_stdout, missing_docs)] // a program for the terminal

use drex_hw::allegro::{AllegroHand, AllegroOptions, AllegroVersion};
use drex_hw::control::{ControlLoop, ControlOptions, EStop, Quantiles, Trajectory, Waypoint, telemetry};
use drex_hw::emulator::allegro::AllegroEmulator;
use drex_hw::{Hand, HandState};
use drex_robot::Robot;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Outcome<()> {
    let mut arguments = std::env::args().skip(1);
    let rate_hz = arguments.next().map_or(Ok(400.0), |a| a.parse())?;
    let seconds: f64 = arguments.next().map_or(Ok(5.0), |a| a.parse())?;
    let estop = EStop::new();
    let robot = Robot::bundled("allegro_right")?;
    let options = || AllegroOptions::new(AllegroVersion::V5);
    let hand = emulated();
    let driver = AllegroHand::connect(hand.bus(), &robot, options())?;
    measure("in memory", driver, rate_hz, seconds, &estop)?;
    #[cfg(unix)]
    {
        use drex_hw::can::{Slcan, SlcanAdapter};
        use drex_hw::emulator::pty::PtyServer;

        let server = PtyServer::serve(SlcanAdapter::new(emulated().bus()), None)?;
        let driver = AllegroHand::connect(Slcan::open(server.path())?, &robot, options())?;
        measure("slcan, pseudo-terminal", driver, rate_hz, seconds, &estop)?;
    }
    Ok(())
}

fn emulated() -> AllegroEmulator {
    let hand = AllegroEmulator::new(AllegroVersion::V5).in_real_time();
    hand.place(12, 0.5);
    hand
}

fn measure(name: &str, mut hand: impl Hand + 'static, rate_hz: f64, seconds: f64, estop: &EStop) -> Outcome<()> {
    let mut state = HandState::new(16);
    hand.turn_on()?;
    hand.cycle(None, &mut state)?;
    let goal = Waypoint { time_s: seconds, position: state.position.clone() };
    let trajectory = Trajectory::new(vec![goal], vec![0.1; 16])?;
    let (recorder, mut reader) = telemetry(16, 4096);
    let options = ControlOptions::default().with_rate_hz(rate_hz).with_estop(estop).with_recorder(recorder);
    let running = ControlLoop::start(hand, trajectory, options)?;
    while reader.next(std::time::Duration::from_millis(100), |_| ()).is_ok() {}
    let (_, report) = running.wait();
    let s = report.stats;
    println!(
        "{name}: {:.1} Hz of {rate_hz}, {} cycles, {} missed, {} unrecorded, late {}, busy {}, {:?}",
        s.rate_hz,
        s.cycles,
        s.missed,
        report.unrecorded,
        show(s.late),
        show(s.busy),
        report.stop_reason
    );
    Ok(())
}

fn show(q: Quantiles) -> String {
    let us = |s: f64| (1e6 * s).round();
    format!("p50 {} us p99 {} us max {} us", us(q.p50_s), us(q.p99_s), us(q.max_s))
}
