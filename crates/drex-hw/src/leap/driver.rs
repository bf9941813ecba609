//! The hand as the computer sees it: connecting, and what can be asked of it.

use std::path::PathBuf;
use std::time::Duration;

use drex_robot::Robot;

use super::absent::{SILENCE, nobody};
use super::finding::{Finding, FindingKind};
use super::inspect::{inspect_motors, inspect_port};
use super::joint::{Joint, MotorHealth};
use super::options::LeapOptions;
use super::table::{self, MotorModel};
use crate::dynamixel::{Answers, Bus, BusStats, Port, SerialPort, Timing};
use crate::{Error, Result};

/// How long a hand may take to be set up.
pub(super) const SETUP_TIME: Duration = Duration::from_secs(2);
/// One turn, rad.
const TURN: f64 = std::f64::consts::TAU;

/// Bytes of a command: goal current and goal position, through the indirect addresses.
pub(super) const COMMAND: usize = 6;
/// Bytes of a reading: current, velocity, position.
pub(super) const READING: usize = 10;
/// Bytes of a motor's health: torque, hardware error, watchdog, voltage, temperature, through the indirect addresses.
pub(super) const HEALTH: usize = 5;
/// Where they are read.
pub(super) const HEALTH_ADDRESS: u16 = table::INDIRECT_DATA.address + COMMAND as u16;

/// A LEAP hand: 16 motors, each told a goal and the largest current to reach it with.
///
/// A motor that stops itself or falls silent costs only itself. When the program stops calling
/// [`cycle`](crate::Hand::cycle), the motors freeze after [`LeapOptions::watchdog`]; dropping the hand takes the torque off.
#[derive(Debug)]
pub struct LeapHand<P: Port> {
    pub(super) bus: Bus<P>,
    pub(super) options: LeapOptions,
    /// How long motors may take when nothing waits for them, and in an exchange.
    pub(super) patient: Timing,
    pub(super) brisk: Timing,
    /// In the order of the robot model, as all that follows.
    pub(super) joints: Vec<Joint>,
    pub(super) names: Vec<String>,
    pub(super) limits: Vec<(f64, f64)>,
    pub(super) caps_ma: Vec<f64>,
    pub(super) model: MotorModel,
    /// Joints that are asked together, and room for their answers.
    pub(super) asked: Vec<usize>,
    pub(super) readings: Option<Answers>,
    pub(super) healths: Option<Answers>,
    pub(super) on: bool,
    /// Whether the port failed and was not opened again.
    pub(super) lost: bool,
    pub(super) reconnects: u32,
    pub(super) connected: Duration,
    /// When the motors last heard something.
    pub(super) spoken: Duration,
    pub(super) next_probe: Duration,
    pub(super) last_probed: usize,
    /// Room for the commands of an exchange.
    pub(super) orders: Vec<(u8, [u8; COMMAND])>,
    pub(super) exchanges: u32,
    /// Exchanges in a row in which nobody answered.
    pub(super) unanswered: u32,
    findings: Vec<Finding>,
}

impl LeapHand<SerialPort> {
    /// Opens the hand at the serial port `path`, see [`LeapHand::connect`].
    ///
    /// # Errors
    /// If the port cannot be opened, and those of [`LeapHand::connect`].
    pub fn open(path: impl Into<PathBuf>, robot: &Robot, options: LeapOptions) -> Result<Self> {
        let port = SerialPort::open(path, options.baud)?;
        Self::connect(port, robot, options)
    }
}

impl<P: Port> LeapHand<P> {
    /// Finds the motors of `robot` behind `port` and sets them up, all torque off. Joints are found by name.
    ///
    /// # Errors
    /// If options or model do not fit, a motor does not answer or is of another kind, or has a hardware error that a reboot does
    /// not clear; then by name.
    pub fn connect(port: P, robot: &Robot, options: LeapOptions) -> Result<Self> {
        options.check()?;
        let joints = joints(robot, &options)?;
        let known = known_timing(&port, &options);
        let timing = known.unwrap_or_default();
        // All joints have limits, or there would be no `joints`.
        let limits: Vec<_> = robot.joints.iter().filter_map(|j| j.limits).collect();
        let connected = port.now();
        let mut hand = Self {
            bus: Bus::new(port, timing),
            patient: timing,
            brisk: timing,
            names: joints.iter().map(|j| j.name.clone()).collect(),
            caps_ma: vec![0.0; joints.len()],
            joints,
            limits,
            options,
            model: MotorModel::Xc330M288,
            asked: Vec::new(),
            readings: None,
            healths: None,
            on: false,
            lost: false,
            reconnects: 0,
            connected,
            spoken: connected,
            next_probe: connected,
            last_probed: 0,
            orders: Vec::new(),
            exchanges: 0,
            unanswered: 0,
            findings: Vec::new(),
        };
        hand.bus.limit_silence(Some(SILENCE));
        hand.find_model()?;
        hand.findings = inspect_port(hand.bus.port());
        hand.findings.extend(inspect_motors(&mut hand.bus, &hand.options)?);
        // A motor that is started again is silent for a while.
        hand.bus.limit_silence(None);
        hand.learn_timing(known);
        let ready = hand.make_ready();
        if ready.is_err() {
            // Whoever is dead was waited for already, and need not be once more when the hand is dropped.
            hand.patient = hand.brisk;
        }
        ready?;
        hand.learn_timing(known);
        Ok(hand)
    }

    fn make_ready(&mut self) -> Result<()> {
        self.await_silent()?;
        self.set_up_all()?;
        self.regroup()?;
        self.read_health()
    }

    /// How long a loop waits for an answer: twice the slowest until now, where nobody has said it.
    fn learn_timing(&mut self, known: Option<Timing>) {
        if known.is_none() {
            self.brisk = Timing::for_loop(self.bus.slowest());
        }
    }

    /// What was not as it should be when the hand was connected, and how to mend it. What the driver mends itself is
    /// mentioned too.
    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// The motors of this hand.
    pub fn model(&self) -> MotorModel {
        self.model
    }

    /// What each motor said about itself when it was last asked, every [`LeapOptions::health_every`] exchanges.
    pub fn health(&self) -> impl Iterator<Item = Option<MotorHealth>> + '_ {
        self.joints.iter().map(|j| j.health)
    }

    /// Temperatures, °C, of motors that told them.
    pub fn temperatures_c(&self) -> Vec<Option<f64>> {
        self.health().map(|h| h.map(|h| h.temperature_c)).collect()
    }

    /// What is wrong with joints, by number and in words.
    pub fn faults(&self) -> impl Iterator<Item = (usize, &str)> {
        self.joints.iter().enumerate().filter_map(|(j, joint)| Some((j, joint.fault.as_deref()?)))
    }

    /// The port that the motors are behind.
    pub(crate) fn port(&mut self) -> &mut P {
        self.bus.port()
    }

    /// What went over the bus.
    pub fn bus_stats(&self) -> BusStats {
        self.bus.stats()
    }

    /// How often the port was opened again after it was gone.
    pub fn reconnects(&self) -> u32 {
        self.reconnects
    }

    /// Starts the motor of a joint again that stopped itself, in the exchanges to come. Overloads are dealt with like this without being
    /// asked, see [`LeapOptions::recoveries`]; other errors want somebody to look first.
    ///
    /// # Errors
    /// If there is no such joint or the port fails.
    pub fn restart(&mut self, joint: usize) -> Result<()> {
        if joint >= self.joints.len() {
            return Err(Error::value(format!("joint number {joint}"), format!("the hand has {}", self.joints.len())));
        }
        self.joints[joint].recoveries = self.options.recoveries;
        self.begin_reboot(joint)
    }

    /// The motors must all be of one kind, which gives the cap.
    fn find_model(&mut self) -> Result<()> {
        // Motors that were told to be quiet would look absent.
        let ids = self.joints.iter().map(|j| (j.id, &[2_u8][..]));
        self.bus.sync_write(table::STATUS_LEVEL.address, 1, ids)?;
        let Some(pong) = self.joints.iter().find_map(|j| match self.bus.ping(j.id) {
            Err(Error::Silent { .. }) => None,
            other => Some(other),
        }) else {
            let ids = self.ids();
            return Err(nobody(&mut self.bus, &ids, self.options.baud));
        };
        let pong = pong?;
        let Some(model) = MotorModel::from_number(pong.model) else {
            // It is a motor of `joints` that was asked.
            let j = self.joints.iter().position(|j| j.id == pong.id).unwrap_or(0);
            let what = format!("is of model {}", pong.model);
            return Err(self.wrong(j, what, "build the hand with XC330-M288 (1240) or XL330-M288 (1200) alone"));
        };
        let cap = self.options.cap_ma.unwrap_or(model.gentle_cap_ma());
        model.check_cap_ma(cap)?;
        self.model = model;
        self.caps_ma.fill(cap);
        Ok(())
    }

    /// Waits for motors that did not answer when they were looked at, all together: they may just have got their power.
    fn await_silent(&mut self) -> Result<()> {
        let silent = |f: &Finding| (f.kind == FindingKind::Silent).then_some(f.motor).flatten();
        let mut silent: Vec<u8> = self.findings.iter().filter_map(silent).collect();
        let give_up = self.now() + SETUP_TIME;
        while !silent.is_empty() {
            let mut still = Vec::new();
            for id in silent {
                match self.bus.ping(id) {
                    Ok(_) => {}
                    Err(lost @ Error::Port { .. }) => return Err(lost),
                    Err(_) => still.push(id),
                }
            }
            if let Some(first) = still.first().filter(|_| self.now() >= give_up) {
                let j = self.joints.iter().position(|j| j.id == *first).unwrap_or(0);
                let what = match still.len() {
                    1 => "does not answer".to_owned(),
                    n => format!("does not answer, and neither do {} more of motors {still:?}", n - 1),
                };
                return Err(self.wrong(j, what, "check its power, cable, id and speed (baud), then try again"));
            }
            silent = still;
        }
        Ok(())
    }

    /// Says anew who is asked together.
    pub(super) fn regroup(&mut self) -> Result<()> {
        self.asked.clear();
        self.asked.extend((0..self.joints.len()).filter(|j| self.joints[*j].is_asked()));
        let ids: Vec<u8> = self.asked.iter().map(|j| self.joints[*j].id).collect();
        let room = |len| if ids.is_empty() { Ok(None) } else { Answers::new(&ids, len).map(Some) };
        (self.readings, self.healths) = (room(READING)?, room(HEALTH)?);
        Ok(())
    }

    pub(super) fn now(&mut self) -> Duration {
        self.bus.port().now()
    }

    /// The error of a joint.
    pub(super) fn wrong(&self, j: usize, what: impl Into<String>, remedy: impl Into<String>) -> Error {
        let joint = &self.joints[j];
        Error::Joint { joint: joint.name.clone(), id: joint.id, what: what.into(), remedy: remedy.into() }
    }

    /// Writes one byte to all motors; nobody confirms it.
    pub(super) fn tell_all(&mut self, register: table::Register<u8>, value: u8) -> Result<()> {
        let value = [value];
        self.bus.sync_write(register.address, 1, self.joints.iter().map(|j| (j.id, &value[..])))
    }

    pub(super) fn ids(&self) -> Vec<u8> {
        self.joints.iter().map(|j| j.id).collect()
    }
}

/// The bytes of a command: goal current, mA, and goal position, ticks.
pub(super) fn command(current: i16, ticks: i32) -> [u8; COMMAND] {
    let ([a, b], [c, d, e, f]) = (current.to_le_bytes(), ticks.to_le_bytes());
    [a, b, c, d, e, f]
}

/// How long motors may take, if somebody says so or the adapter tells.
pub(super) fn known_timing<P: Port>(port: &P, options: &LeapOptions) -> Option<Timing> {
    options.timing.or_else(|| port.latency().map(Timing::for_latency))
}

/// The joints of the model in its order, each with its motor.
pub(super) fn joints(robot: &Robot, options: &LeapOptions) -> Result<Vec<Joint>> {
    let find = |name: &str| options.joints.iter().position(|j| j.name == name);
    if let Some(extra) = options.joints.iter().find(|j| robot.joint_index(&j.name).is_none()) {
        robot.require_joint(&extra.name)?;
    }
    let of = |joint: &drex_robot::Joint| {
        let wiring = find(&joint.name).ok_or_else(|| {
            Error::value(format!("no motor for joint {}", joint.name), "name its motor among those of the hand")
        })?;
        let Some((low, high)) = joint.limits.filter(|(low, high)| -TURN <= *low && low <= high && *high <= TURN) else {
            let what = format!("joint {} with limits of {:?} rad", joint.name, joint.limits);
            return Err(Error::value(what, "give it a range within one turn either way"));
        };
        Ok(Joint::new(&options.joints[wiring], options.gains[wiring], (low, high)))
    };
    robot.joints.iter().map(of).collect()
}
