//! The hand itself: what it does with frames, how its joints move, what it reports and when.

use std::collections::VecDeque;
use std::time::Duration;

use crate::allegro::{AllegroCommand, AllegroInfo, AllegroOptions, AllegroReport, AllegroVersion};
use crate::can::CanFrame;

/// Step of the simulation.
const STEP: Duration = Duration::from_micros(250);
const STEP_S: f64 = 250e-6;
/// A gap longer than this is skipped: the machine slept.
const LONGEST_GAP: Duration = Duration::from_secs(10);
/// Frames that wait to be received; the oldest are lost then, as in an adapter that nobody reads.
const QUEUE: usize = 256;
/// Inertia of a joint with its motor, kg m².
const INERTIA: f64 = 1e-3;
/// Drag of a joint, N m s/rad: with the vendor's gains a joint comes to its goal without ringing.
const DRAG: f64 = 0.03;

/// A command that the hand heard, and when.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReceivedCommand {
    /// Time of the hand.
    pub at: Duration,
    /// What it was told.
    pub command: AllegroCommand,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Joint {
    /// rad.
    pub q: f64,
    /// rad/s.
    pub v: f64,
    /// N m, as told.
    pub commanded: f64,
    /// N m with which it presses on the wall, signed.
    pub contact: f64,
    /// What is in the way leaves these angles, rad.
    pub wall: (f64, f64),
}

impl Joint {
    const AT_ZERO: Self =
        Self { q: 0.0, v: 0.0, commanded: 0.0, contact: 0.0, wall: (f64::NEG_INFINITY, f64::INFINITY) };

    fn step(&mut self, torque: f64) {
        self.v = (self.v + torque / INERTIA * STEP_S) / (1.0 + DRAG / INERTIA * STEP_S);
        let next = self.q + self.v * STEP_S;
        self.q = next.max(self.wall.0).min(self.wall.1);
        self.contact = 0.0;
        if self.q != next {
            self.v = 0.0;
            self.contact = if next > self.q { torque.max(0.0) } else { torque.min(0.0) };
        }
    }
}

#[derive(Debug)]
pub(super) struct Device {
    pub options: AllegroOptions,
    pub joints: [Joint; 16],
    pub on: bool,
    /// Whether version 3 was asked to report.
    asked: bool,
    /// Of poses and temperatures, ms; 0 is never.
    period_ms: [u16; 2],
    due: [Duration; 2],
    pub now: Duration,
    simulated: Duration,
    last_torque: Duration,
    pub watchdog: Option<Duration>,
    pub out: VecDeque<CanFrame>,
    pub mute: [bool; 4],
    pub plugged: bool,
    pub celsius: [u8; 16],
    pub info: AllegroInfo,
    pub record: Option<Vec<ReceivedCommand>>,
}

impl Device {
    pub fn new(options: AllegroOptions) -> Self {
        let hardware = match options.version {
            AllegroVersion::V3 => 0x0300,
            AllegroVersion::V4 => 0x0402,
            AllegroVersion::V5 => 0x0500,
        };
        Self {
            options,
            joints: [Joint::AT_ZERO; 16],
            on: false,
            asked: false,
            period_ms: [0; 2],
            due: [Duration::ZERO; 2],
            now: Duration::ZERO,
            simulated: Duration::ZERO,
            last_torque: Duration::ZERO,
            watchdog: Some(Duration::from_millis(100)),
            out: VecDeque::with_capacity(QUEUE),
            mute: [false; 4],
            plugged: true,
            celsius: [35; 16],
            info: AllegroInfo { hardware, firmware: 0x0401, left: false, status: 0 },
            record: None,
        }
    }

    /// Lets time pass up to `then`.
    pub fn advance_to(&mut self, then: Duration) {
        self.now = self.now.max(then);
        self.simulated = self.simulated.max(self.now.saturating_sub(LONGEST_GAP));
        while self.simulated + STEP <= self.now {
            self.simulated += STEP;
            if self.watchdog.is_some_and(|w| self.simulated.saturating_sub(self.last_torque) > w) {
                self.joints.iter_mut().for_each(|j| j.commanded = 0.0);
            }
            for j in &mut self.joints {
                j.step(if self.on { j.commanded } else { 0.0 });
            }
            self.report_what_is_due();
        }
    }

    /// When the next report is due, if the hand reports at all.
    pub fn next_report(&self) -> Option<Duration> {
        (0..2).filter(|k| self.reports(*k)).map(|k| self.due[k].max(self.now + STEP)).min()
    }

    fn reports(&self, kind: usize) -> bool {
        let awake = self.on && (self.asked || self.options.version != AllegroVersion::V3);
        self.plugged && awake && self.period_ms[kind] > 0
    }

    fn report_what_is_due(&mut self) {
        for kind in 0..2 {
            if !self.reports(kind) || self.due[kind] > self.simulated {
                continue;
            }
            self.due[kind] = self.simulated + Duration::from_millis(self.period_ms[kind].into());
            let mute = self.mute;
            for finger in (0..4_u8).filter(|f| !mute[usize::from(*f)]) {
                let at = 4 * usize::from(finger);
                let report = match kind {
                    0 => AllegroReport::Pose {
                        finger,
                        counts: std::array::from_fn(|k| self.options.counts(at + k, self.joints[at + k].q)),
                    },
                    _ => AllegroReport::Temperature { finger, celsius: std::array::from_fn(|k| self.celsius[at + k]) },
                };
                self.say(report);
            }
        }
    }

    pub fn say(&mut self, report: AllegroReport) {
        if let Some(frame) = report.encode(self.options.version).filter(|_| self.plugged) {
            if self.out.len() == QUEUE {
                self.out.pop_front();
            }
            self.out.push_back(frame);
        }
    }

    /// Takes a frame from the bus; what is no command of this version is ignored, as by the hand.
    pub fn hear(&mut self, frame: &CanFrame) {
        let Some(command) = AllegroCommand::decode(self.options.version, frame).filter(|_| self.plugged) else {
            return;
        };
        if let Some(record) = &mut self.record {
            record.push(ReceivedCommand { at: self.now, command });
        }
        match command {
            AllegroCommand::On => {
                self.on = true;
                self.due = [self.simulated; 2];
            }
            AllegroCommand::Off => {
                self.on = false;
                self.joints.iter_mut().for_each(|j| j.commanded = 0.0);
            }
            AllegroCommand::Torque { finger, wire } => {
                self.last_torque = self.now;
                let at = 4 * usize::from(finger & 3);
                for (k, w) in wire.iter().enumerate() {
                    self.joints[at + k].commanded = self.options.torque(at + k, *w);
                }
            }
            AllegroCommand::Period { pose_ms, temperature_ms, .. } => self.period_ms = [pose_ms, temperature_ms],
            AllegroCommand::AskInfo => self.say(AllegroReport::Info(self.info)),
            AllegroCommand::AskSerial => self.say(AllegroReport::Serial(*b"EMULATED")),
            AllegroCommand::AskState => self.asked = true,
        }
    }
}
