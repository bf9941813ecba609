//! A hand behind a pseudo-terminal, a program that drives it behind a guard, and what happens to them. Of use to a test as well.

use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use drex_hw::allegro::{AllegroHand, AllegroOptions, AllegroVersion};
use drex_hw::can::{Slcan, SlcanAdapter};
use drex_hw::control::{ControlOptions, Controller, EStop, Joints, StopReason, run, stop_on_signals};
use drex_hw::dynamixel::SerialPort;
use drex_hw::emulator::allegro::AllegroEmulator;
use drex_hw::emulator::leap::LeapEmulator;
use drex_hw::emulator::pty::PtyServer;
use drex_hw::guard::GuardOptions;
use drex_hw::leap::{LeapHand, LeapOptions};
use drex_hw::{Hand, HandCommand, HandState, SystemClock};
use drex_robot::Robot;

/// Where the driving program finds its hand: kind, port, heartbeat in ms.
pub const TASK: &str = "DREX_GUARD_KILL";
/// Nothing here takes longer, on the slowest machine.
const LONGEST: Duration = Duration::from_secs(30);
/// Time between two looks at the hand.
const LOOK: Duration = Duration::from_micros(300);

pub type Fault = Box<dyn std::error::Error>;

/// Which hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Model {
    Leap,
    AllegroV4,
    AllegroV5,
}

/// What happens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// The driving program is killed.
    Kill,
    /// It is stopped, and goes on later.
    Stop,
    /// Its terminal is closed.
    HangUp,
    /// The guard is killed.
    GuardKilled,
    /// The guard is stopped for ever.
    GuardStopped,
    /// The guard is told to end.
    GuardTold,
    /// A motor falls silent and the program is killed; what counts is when the motor is off after it can be reached again.
    MuteKill,
    /// The same with a program that is hung up, so that it is the first to try.
    MuteHangUp,
}

/// An emulated hand.
enum Emulated {
    Leap(LeapEmulator),
    Allegro(AllegroEmulator),
}

/// A hand at a pseudo-terminal.
pub struct Bench {
    model: Model,
    hand: Emulated,
    link: PathBuf,
    _server: PtyServer,
    _folder: tempfile::TempDir,
}

impl Bench {
    pub fn new(model: Model) -> Result<Self, Fault> {
        let folder = tempfile::tempdir()?;
        let link = folder.path().join("hand");
        let (hand, server) = match model {
            Model::Leap => {
                let hand = LeapEmulator::new().in_real_time();
                (0..8).for_each(|id| hand.set_wall(id, f64::NEG_INFINITY, 2100.0));
                (Emulated::Leap(hand.clone()), PtyServer::serve(hand, Some(&link))?)
            }
            Model::AllegroV4 | Model::AllegroV5 => {
                let hand = AllegroEmulator::new(version(model)).in_real_time();
                // Real hands are not known to stop by themselves.
                hand.set_watchdog(None);
                hand.place(12, 0.5);
                let robot = Robot::bundled("allegro_right")?;
                for (joint, name) in drex_robot::joint_order::ALLEGRO_ROS.iter().enumerate() {
                    // Torques stay while the program is stopped: a real joint ends at its stop.
                    let (low, high) = robot.joints[robot.require_joint(name)?].limits.ok_or("no limits")?;
                    hand.set_wall(joint, low, if joint < 8 { 0.1 } else { high });
                }
                (Emulated::Allegro(hand.clone()), PtyServer::serve(SlcanAdapter::new(hand.bus()), Some(&link))?)
            }
        };
        Ok(Self { model, hand, link, _server: server, _folder: folder })
    }

    /// Motors or hands under torque.
    fn under_torque(&self) -> usize {
        match &self.hand {
            Emulated::Leap(hand) => hand.under_torque(),
            Emulated::Allegro(hand) => usize::from(hand.is_on()),
        }
    }

    /// Whether joints press with torque.
    fn presses(&self) -> bool {
        match &self.hand {
            Emulated::Leap(hand) => hand.under_torque() == 16,
            Emulated::Allegro(hand) => hand.torques_nm().iter().any(|t| *t != 0.0),
        }
    }

    fn detach(&self, motor: u8, cut: bool) {
        if let Emulated::Leap(hand) = &self.hand {
            hand.detach(motor, cut);
        }
    }

    /// Looks until `reached`; how long that took from `begun` on.
    fn until(&self, what: &str, begun: Instant, reached: impl Fn(&Self) -> bool) -> Result<Duration, Fault> {
        while !reached(self) {
            if begun.elapsed() > LONGEST {
                return Err(format!("{:?}: {what}: not within {} s", self.model, LONGEST.as_secs()).into());
            }
            std::thread::sleep(LOOK);
        }
        Ok(begun.elapsed())
    }

    /// Starts this program as one that drives, lets it drive for `moment`, and lets `event` happen; the time from the event, or
    /// from a mute motor's return, until all torque is off. `None` if the torque was off before. `role` gives the arguments with which this program drives or guards.
    pub fn trial(
        &self,
        event: Event,
        moment: Duration,
        heartbeat: Duration,
        role: fn(&str) -> Vec<String>,
    ) -> Result<Option<Duration>, Fault> {
        let task = format!("{:?} {} {}", self.model, heartbeat.as_millis(), self.link.display());
        let mut program = Command::new(std::env::current_exe()?)
            .args(role("drive"))
            .env(TASK, task)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        let mut out = BufReader::new(program.stdout.take().ok_or("no output")?);
        let mut program = Driven(program);
        let guard = loop {
            let mut line = String::new();
            if out.read_line(&mut line)? == 0 {
                return Err(program.end()?.into());
            }
            // What a test prints stands before it.
            if let Some((_, pid)) = line.rsplit_once("guard ") {
                break pid.trim().parse::<u32>()?;
            }
        };
        let pid = program.0.id();
        let begun = Instant::now();
        while !self.presses() {
            if program.0.try_wait()?.is_some() {
                let said = program.end()?;
                // So busy is this machine.
                let starved = ["no sign of life", "no fresh poses"].iter().any(|text| said.contains(text));
                return if starved { Ok(None) } else { Err(said.into()) };
            }
            if begun.elapsed() > LONGEST {
                return Err(format!("{:?} does not press", self.model).into());
            }
            std::thread::sleep(LOOK);
        }
        std::thread::sleep(moment);
        if matches!(event, Event::MuteKill | Event::MuteHangUp) {
            self.detach(5, true);
        }
        if self.under_torque() == 0 {
            self.detach(5, false);
            return Ok(None);
        }
        let begun = Instant::now();
        match event {
            Event::Kill | Event::MuteKill => program.0.kill()?,
            Event::Stop => signal("STOP", pid)?,
            Event::HangUp | Event::MuteHangUp => signal("HUP", pid)?,
            Event::GuardKilled => signal("KILL", guard)?,
            Event::GuardStopped => signal("STOP", guard)?,
            Event::GuardTold => signal("TERM", guard)?,
        }
        let mute = usize::from(matches!(event, Event::MuteKill | Event::MuteHangUp));
        let mut took = self.until("torque off", begun, |bench| bench.under_torque() == mute)?;
        if mute == 1 {
            // A while later it can be reached again, while somebody still tries.
            std::thread::sleep(moment * 4);
            let begun = Instant::now();
            self.detach(5, false);
            took = self.until("the mute motor is off", begun, |bench| bench.under_torque() == 0)?;
        }
        if event == Event::Stop {
            signal("CONT", pid)?;
        }
        let ended = program.end()?;
        let expected = match event {
            Event::Kill | Event::MuteKill => "",
            Event::Stop => "the guard took over: no sign of life",
            Event::HangUp => "stopped, torque off",
            Event::GuardKilled => "this program took the hand over: its guard has ended: torque off",
            Event::GuardStopped => "this program took the hand over: its guard does not answer: torque off",
            Event::GuardTold => "the guard took over: the guard was told to end by a signal: torque off",
            // Either it was reached while the program tried, or the program said that nobody knows.
            Event::MuteHangUp if ended.contains("stopped, torque off") => "",
            Event::MuteHangUp => "torque unknown: ",
        };
        if !ended.contains(expected) || self.under_torque() != 0 {
            return Err(format!("{:?} after {event:?}: {ended}", self.model).into());
        }
        self.until("the port is free", Instant::now(), |bench| SerialPort::open(&bench.link, 115_200).is_ok())?;
        Ok((self.under_torque() == 0).then_some(took))
    }
}

/// A program that ends with the trial.
struct Driven(Child);

impl Driven {
    /// Waits for its end; what it said last.
    fn end(&mut self) -> Result<String, Fault> {
        let begun = Instant::now();
        while self.0.try_wait()?.is_none() {
            if begun.elapsed() > LONGEST {
                return Err("the program does not end".into());
            }
            std::thread::sleep(LOOK);
        }
        let mut said = String::new();
        if let Some(mut text) = self.0.stderr.take() {
            text.read_to_string(&mut said)?;
        }
        Ok(said)
    }
}

impl Drop for Driven {
    fn drop(&mut self) {
        // It may be gone already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Sends a signal to a process.
fn signal(name: &str, pid: u32) -> Result<(), Fault> {
    let status = Command::new("kill").args([format!("-{name}"), pid.to_string()]).status()?;
    if status.success() { Ok(()) } else { Err(format!("no signal {name} to {pid}").into()) }
}

fn version(model: Model) -> AllegroVersion {
    if model == Model::AllegroV5 { AllegroVersion::V5 } else { AllegroVersion::V4 }
}

/// Half of the joints press on something, the others go to and fro.
struct ToAndFro {
    effort: f64,
    low: Vec<f64>,
}

impl Controller for ToAndFro {
    fn begin(&mut self, joints: &Joints<'_>, _: &HandState) -> drex_hw::Result<()> {
        self.low = joints.limits.iter().map(|(low, _)| low.max(0.0)).collect();
        Ok(())
    }

    fn command(
        &mut self,
        time_s: f64,
        _: &HandState,
        command: &mut HandCommand,
    ) -> drex_hw::Result<std::ops::ControlFlow<()>> {
        for (goal, low) in command.position.iter_mut().zip(&self.low) {
            *goal = low + 0.3 - 0.2 * (3.0 * time_s).cos();
        }
        command.effort_limit.fill(self.effort);
        Ok(std::ops::ControlFlow::Continue(()))
    }
}

/// The program that drives: until somebody ends it. What became of it is its answer.
pub fn drive(role: fn(&str) -> Vec<String>) -> Result<String, Fault> {
    let task = std::env::var(TASK)?;
    let mut words = task.splitn(3, ' ');
    let mut word = || words.next().ok_or("no task");
    let (model, heartbeat, path) = (word()?, word()?.parse()?, PathBuf::from(word()?));
    let guard = GuardOptions::this_program(role("guard"))?.with_heartbeat(Duration::from_millis(heartbeat));
    let stop = EStop::new();
    stop_on_signals(&stop)?;
    let (mut hand, pid, effort): (Box<dyn Hand>, u32, f64) = if model == "Leap" {
        let mut hand = LeapHand::open_guarded(&path, &Robot::bundled("leap_right")?, LeapOptions::right(), &guard)?;
        let pid = hand.guard_id();
        (Box::new(hand), pid, 100.0)
    } else {
        let version = if model == "AllegroV5" { AllegroVersion::V5 } else { AllegroVersion::V4 };
        let bus = Slcan::open_guarded(&path, version, &guard)?;
        let pid = bus.guard_id();
        let hand = AllegroHand::connect(bus, &Robot::bundled("allegro_right")?, AllegroOptions::new(version))?;
        (Box::new(hand), pid, 0.08)
    };
    announce(pid);
    let mut controller = ToAndFro { effort, low: Vec::new() };
    let options = ControlOptions::default()
        .with_estop(&stop)
        .with_outage(Duration::from_secs(5))
        .with_off_patience(Duration::from_millis(500));
    let report = run(&mut *hand, &mut controller, &SystemClock::default(), options);
    let off = match &report.torque_off {
        Ok(()) => "torque off".to_owned(),
        Err(error) => error.to_string(),
    };
    Ok(match report.stop_reason {
        StopReason::Stopped => format!("stopped, {off}"),
        StopReason::Failed(error) => format!("{error}; {off}"),
        other => format!("{other:?}; {off}"),
    })
}

#[allow(clippy::print_stdout)] // the other end of the pipe waits for it
fn announce(guard: u32) {
    println!("guard {guard}");
}
