//! Closes a hand on whatever is in it, presses, holds for two seconds, lets go, and writes a joint log of it:
//! `grasp leap|allegro LOG.csv [SHARE] [PORT]`.
//!
//! Without a port the hand is emulated, over an object that the closing joints meet at 0.6 rad. SHARE, 0 to 1, is the part of its
//! largest effort that each closing joint presses with, 0.3 if not given. Ctrl-C takes the torque off.
#![allow(clippy::print_stdout, missing_docs)] // a program for the terminal

use std::fs::File;
use std::io::BufWriter;
use std::time::Duration;

use drex_hw::Hand;
use drex_hw::allegro::{AllegroHand, AllegroOptions, AllegroVersion};
use drex_hw::can::Slcan;
use drex_hw::control::{
    ControlLoop, ControlOptions, EStop, GraspController, GraspPhase, GraspPlan, stop_on_signals, telemetry, write_csv,
};
use drex_hw::dynamixel::Timing;
use drex_hw::emulator::allegro::AllegroEmulator;
use drex_hw::emulator::leap::LeapEmulator;
use drex_hw::leap::{LeapHand, LeapOptions, table};
use drex_robot::Robot;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Part of its largest effort with which a joint moves.
const MOVING_SHARE: f64 = 0.2;
/// Where the emulated object is, and how far the fingers close if there is none, rad.
const OBJECT_RAD: f64 = 0.6;
const CLOSED_RAD: f64 = 1.1;
/// The joints that bend index, middle and ring at the palm: numbers of motors, and places on the wire.
const CLOSING: [u8; 3] = [1, 5, 9];

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [kind, log, rest @ ..] = arguments.as_slice() else {
        return Err("usage: grasp leap|allegro LOG.csv [SHARE] [PORT]".into());
    };
    let share: f64 = rest.first().map_or(Ok(0.3), |s| s.parse())?;
    if !(0.0..=1.0).contains(&share) {
        return Err("give a share from 0 to 1".into());
    }
    let port = rest.get(1).map(String::as_str);
    match kind.as_str() {
        "leap" => grasp(leap(port)?, "leap_right", GraspPlan::leap, share, log),
        "allegro" => grasp(allegro(port)?, "allegro_right", GraspPlan::allegro, share, log),
        other => Err(format!("a hand called {other}; there are leap and allegro").into()),
    }
}

/// A hand and the names of the joints that close.
type Found = (Box<dyn Hand>, Vec<String>);

fn leap(port: Option<&str>) -> Outcome<Found> {
    let (robot, options) = (Robot::bundled("leap_right")?, LeapOptions::right());
    let closing = options.joints.iter().filter(|j| CLOSING.contains(&j.id)).map(|j| j.name.clone()).collect();
    let Some(port) = port else {
        let hand = LeapEmulator::new().in_real_time();
        CLOSING.iter().for_each(|id| hand.set_wall(*id, f64::NEG_INFINITY, 2048.0 + OBJECT_RAD / table::RAD_PER_TICK));
        let options = options.with_timing(Timing::for_latency(Duration::ZERO));
        return Ok((Box::new(LeapHand::connect(hand.port(), &robot, options)?), closing));
    };
    let hand = LeapHand::open(port, &robot, options)?;
    hand.findings().iter().for_each(|f| println!("{f}"));
    Ok((Box::new(hand), closing))
}

fn allegro(port: Option<&str>) -> Outcome<Found> {
    let (robot, options) = (Robot::bundled("allegro_right")?, AllegroOptions::new(AllegroVersion::V4));
    let closing = CLOSING.map(|j| options.names[usize::from(j)].clone()).to_vec();
    let Some(port) = port else {
        let hand = AllegroEmulator::new(AllegroVersion::V4).in_real_time();
        hand.place(12, 0.5);
        CLOSING.iter().for_each(|j| hand.set_wall(usize::from(*j), f64::NEG_INFINITY, OBJECT_RAD));
        return Ok((Box::new(AllegroHand::connect(hand.bus(), &robot, options)?), closing));
    };
    Ok((Box::new(AllegroHand::connect(Slcan::open(port.as_ref())?, &robot, options)?), closing))
}

/// Makes the plan of a hand from poses, closing efforts and forces.
type Planner = fn([Vec<f64>; 3], Vec<f64>, Vec<f64>) -> GraspPlan;

fn grasp((hand, closing): Found, model: &str, planner: Planner, share: f64, log: &str) -> Outcome<()> {
    let estop = EStop::new();
    #[cfg(unix)]
    stop_on_signals(&estop)?;
    let robot = Robot::bundled(model)?;
    let mut open = vec![0.0; robot.dof()];
    robot.clamp_to_limits(&mut open);
    let mut closed = open.clone();
    let moving: Vec<f64> = hand.effort_caps().iter().map(|cap| MOVING_SHARE * cap).collect();
    let mut force = moving.clone();
    for name in &closing {
        let j = robot.require_joint(name)?;
        (closed[j], force[j]) = (CLOSED_RAD, share * hand.effort_caps()[j]);
    }
    let grasp = GraspController::new(planner([open.clone(), open, closed], moving, force.clone()).with_hold_s(2.0));
    let handle = grasp.handle();

    let (names, unit) = (hand.joints().to_vec(), hand.effort_unit());
    let (recorder, mut reader) = telemetry(names.len(), 4000);
    let mut file = BufWriter::new(File::create(log)?);
    let columns = names.clone();
    let writer = std::thread::spawn(move || write_csv(&mut reader, &columns, unit, &mut file));
    let options = ControlOptions::default().with_estop(&estop).with_recorder(recorder);
    let running = ControlLoop::start(hand, grasp, options)?;
    let mut shown = None;
    while running.is_running() {
        let phase = handle.phase();
        if shown.replace(phase) != Some(phase) {
            println!("{}", phase.name());
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let (back, report) = running.wait();
    let rows = writer.join().map_err(|_| "the writer of the log panicked")??;
    println!("{:?}, torque off: {:?}, {rows} rows in {log}", report.stop_reason, report.torque_off);
    println!("{:?}", report.stats);
    if let Some((_, grasp)) = back {
        let outcome = grasp.outcome();
        println!("missed: {}, lost: {}", outcome.missed, outcome.lost);
        for (j, contact) in outcome.contacts.iter().enumerate().filter_map(|(j, c)| Some((j, (*c)?))) {
            let (name, held, wanted) = (&names[j], outcome.held_effort[j], force[j]);
            println!("{name}: met at {:.3} rad, held with {held:.4} of {wanted:.4} ({unit:?})", contact.position);
        }
        if handle.phase() != GraspPhase::Done {
            println!("ended while it was to {}", handle.phase().name());
        }
    }
    Ok(())
}
