//! The hand as the computer sees it: start, exchange, stop.

use std::io;
use std::time::Duration;

use drex_robot::Robot;

use super::finger::Finger;
use super::{AllegroCommand, AllegroInfo, AllegroOptions, AllegroReport};
use crate::can::CanBus;
use crate::{Clock, Error, Result, SystemClock};

/// Most frames that one exchange reads, so that a babbling bus cannot hold it up.
pub(super) const MOST_FRAMES: usize = 256;

/// What to do about a bus that is silent or refuses.
const CABLE: &str = "check the hand's power, the CAN cable and its termination, then connect again";
/// How long poses may stay away before an exchange is an error instead of one without torque.
const BLIND: Duration = Duration::from_millis(500);

/// What went over the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct AllegroStats {
    /// Frames received.
    pub frames: u64,
    /// Frames that are none of this version's.
    pub unknown: u64,
    /// Exchanges under torque.
    pub exchanges: u64,
    /// Exchanges in which poses were too old, and torques zero.
    pub stale: u64,
}

/// An Allegro hand on a CAN bus.
///
/// The position loop runs in [`Hand::cycle`](crate::Hand::cycle): the hand itself knows only torques and keeps the last ones, so that a program that stops
/// calling it must drop it. Dropping it takes the torque off.
pub struct AllegroHand<B: CanBus> {
    pub(super) bus: B,
    pub(super) clock: Box<dyn Clock>,
    pub(super) options: AllegroOptions,
    /// Model order.
    pub(super) names: Vec<String>,
    /// Model order, rad.
    pub(super) limits: Vec<(f64, f64)>,
    /// Model order, N m.
    pub(super) caps: Vec<f64>,
    /// Index in the model of each joint of the wire.
    pub(super) model_of_wire: [usize; 16],
    pub(super) fingers: [Finger; 4],
    /// Exchanges since each finger reported.
    pub(super) ages: [u32; 4],
    /// Since which exchange poses of a finger that was seen are too old.
    pub(super) blind_since: Option<Duration>,
    pub(super) started: bool,
    pub(super) driven: bool,
    /// Wire order, rad; none means where it is.
    pub(super) goal: Option<[f64; 16]>,
    /// Wire order, N m.
    pub(super) effort_nm: [f64; 16],
    pub(super) sent: [i16; 16],
    pub(super) motor_errors: [u8; 16],
    pub(super) temperatures_c: [Option<f64>; 16],
    pub(super) info: Option<AllegroInfo>,
    /// Whether the model is one of a left hand, by its name.
    pub(super) left_model: bool,
    pub(super) serial: Option<[u8; 8]>,
    stats: AllegroStats,
    /// Refusals of the bus that were told.
    refused: u64,
    connected: Duration,
}

impl<B: CanBus> AllegroHand<B> {
    /// Starts the hand's stream of poses, without torque. Nothing has been heard yet when this returns: see
    /// [`Self::wait_for_reports`].
    ///
    /// # Errors
    /// [`Error::Value`] for options that mean nothing or a model without the joints, [`Error::Port`] if the bus fails.
    pub fn connect(bus: B, robot: &Robot, options: AllegroOptions) -> Result<Self> {
        Self::connect_with_clock(bus, robot, options, SystemClock::default())
    }

    /// The same with another clock, such as an emulator's.
    ///
    /// # Errors
    /// As [`Self::connect`].
    pub fn connect_with_clock(
        bus: B,
        robot: &Robot,
        options: AllegroOptions,
        clock: impl Clock + 'static,
    ) -> Result<Self> {
        options.check()?;
        let model_of_wire = wire_to_model(robot, &options)?;
        let names = robot.joint_names().into_iter().map(String::from).collect();
        let limits = robot.joints.iter().map(|j| {
            j.limits.ok_or_else(|| Error::value(format!("joint {} without limits", j.name), "give it a range"))
        });
        let limits = limits.collect::<Result<Vec<_>>>()?;
        let mut caps = vec![0.0; 16];
        for (model, cap) in model_of_wire.iter().zip(options.torque_caps_nm()) {
            caps[*model] = cap;
        }
        let connected = clock.now();
        let mut hand = Self {
            bus,
            clock: Box::new(clock),
            effort_nm: options.torque_caps_nm(),
            options,
            names,
            limits,
            caps,
            model_of_wire,
            fingers: [Finger::default(); 4],
            ages: [u32::MAX; 4],
            blind_since: None,
            started: false,
            driven: false,
            goal: None,
            sent: [0; 16],
            motor_errors: [0; 16],
            temperatures_c: [None; 16],
            info: None,
            left_model: robot.name.to_lowercase().contains("left"),
            serial: None,
            stats: AllegroStats::default(),
            refused: 0,
            connected,
        };
        hand.start()?;
        Ok(hand)
    }

    /// What the hand said about itself, if it did.
    pub fn info(&self) -> Option<AllegroInfo> {
        self.info
    }

    /// Serial number, if the hand told it.
    pub fn serial(&self) -> Option<String> {
        self.serial.map(|s| String::from_utf8_lossy(&s).trim_matches(['\0', ' ']).to_string())
    }

    /// Temperatures, °C, order of the model; only with [`AllegroOptions::temperature_period_ms`].
    pub fn temperatures_c(&self) -> [Option<f64>; 16] {
        let mut model = [None; 16];
        for (wire, t) in self.temperatures_c.iter().enumerate() {
            model[self.model_of_wire[wire]] = *t;
        }
        model
    }

    /// What went over the bus so far.
    pub fn stats(&self) -> AllegroStats {
        self.stats
    }

    /// The bus, to look at.
    pub fn bus(&self) -> &B {
        &self.bus
    }

    /// Time since the hand was connected.
    pub(super) fn time(&self) -> Duration {
        self.clock.now().saturating_sub(self.connected)
    }

    pub(super) fn send(&mut self, command: AllegroCommand) -> Result<()> {
        match command.encode(self.options.version) {
            Some(frame) => self.bus.send(&frame),
            None => Ok(()),
        }
    }

    /// Reads what has come, and waits up to `wait` for poses of all fingers.
    pub(super) fn gather(&mut self, wait: Duration) -> Result<()> {
        let begin = self.clock.now();
        let mut fresh = [false; 4];
        for _ in 0..MOST_FRAMES {
            let left = wait.saturating_sub(self.clock.now().saturating_sub(begin));
            let left = if fresh == [true; 4] { Duration::ZERO } else { left };
            match self.bus.receive(left)? {
                Some(frame) => {
                    self.stats.frames += 1;
                    match AllegroReport::decode(self.options.version, &frame) {
                        Some(report) => self.take(report, &mut fresh),
                        None => self.stats.unknown += 1,
                    }
                }
                None if left.is_zero() => break,
                None => {}
            }
        }
        for (age, fresh) in self.ages.iter_mut().zip(fresh) {
            *age = if fresh { 0 } else { age.saturating_add(1) };
        }
        let now = self.clock.now();
        let blind = self.fingers.iter().any(|f| f.seen.is_some() && !f.is_fresh(now, self.options.stale));
        self.blind_since = blind.then(|| self.blind_since.unwrap_or(now));
        self.check_refusals(CABLE)
    }

    /// Refuses to go on without poses for ever.
    pub(super) fn check_sight(&self) -> Result<()> {
        let now = self.clock.now();
        if self.blind_since.is_none_or(|since| now.saturating_sub(since) <= BLIND) {
            return Ok(());
        }
        let blind = self.fingers_that(|f| !f.is_fresh(now, self.options.stale));
        Err(Error::Port {
            port: self.bus.name().into(),
            source: io::Error::new(
                io::ErrorKind::TimedOut,
                format!("no poses of {blind} for {} s", BLIND.as_secs_f64()),
            ),
            remedy: CABLE.into(),
        })
    }

    /// Names of fingers, or "no finger".
    pub(super) fn fingers_that(&self, are: impl Fn(&Finger) -> bool) -> String {
        let named = ["index", "middle", "ring", "thumb"].into_iter().zip(&self.fingers);
        let names: Vec<&str> = named.filter_map(|(name, f)| are(f).then_some(name)).collect();
        if names.is_empty() { "no finger".into() } else { names.join(", ") }
    }

    /// Tells once what the bus refused since the last time.
    pub(super) fn check_refusals(&mut self, remedy: &str) -> Result<()> {
        let refused = self.bus.refused();
        let new = refused - std::mem::replace(&mut self.refused, refused).min(refused);
        if new == 0 {
            return Ok(());
        }
        Err(Error::Port {
            port: self.bus.name().into(),
            source: io::Error::other(format!("the adapter refused {new} frames")),
            remedy: remedy.into(),
        })
    }

    fn take(&mut self, report: AllegroReport, fresh: &mut [bool; 4]) {
        let now = self.clock.now();
        match report {
            AllegroReport::Pose { finger, counts } => {
                let finger = usize::from(finger & 3);
                let q = std::array::from_fn(|k| self.options.angle(4 * finger + k, counts[k]));
                self.fingers[finger].take(q, now, self.options.velocity_filter_s, self.options.stale);
                fresh[finger] = true;
            }
            AllegroReport::Temperature { finger, celsius } => {
                for (k, c) in celsius.iter().enumerate() {
                    self.temperatures_c[4 * usize::from(finger & 3) + k] = Some(f64::from(*c));
                }
            }
            AllegroReport::Info(info) => self.info = Some(info),
            AllegroReport::Serial(serial) => self.serial = Some(serial),
            AllegroReport::MotorError { motor, code } => {
                if let Some(error) = self.motor_errors.get_mut(usize::from(motor)) {
                    *error = code;
                }
            }
            AllegroReport::Fingertips { .. } | AllegroReport::Imu => {}
        }
    }

    pub(super) fn all_fresh(&self, now: Duration) -> bool {
        self.fingers.iter().all(|f| f.is_fresh(now, self.options.stale))
    }

    pub(super) fn is_stale(&self, finger: usize) -> bool {
        !self.fingers[finger].is_fresh(self.clock.now(), self.options.stale)
    }

    /// Takes a goal, rad, and effort limits, N m, model order, clipped to what the joints and motors may.
    pub(super) fn aim(&mut self, position: &[f64], effort_nm: &[f64]) {
        let mut goal = [0.0; 16];
        for (wire, model) in self.model_of_wire.iter().enumerate() {
            let (low, high) = self.limits[*model];
            goal[wire] = position[*model].max(low).min(high);
            self.effort_nm[wire] = effort_nm[*model].min(self.caps[*model]);
        }
        self.goal = Some(goal);
    }

    /// One step of the position loop; without fresh poses no torque, and the goal is forgotten.
    pub(super) fn press(&mut self) -> Result<()> {
        self.stats.exchanges += 1;
        if !self.all_fresh(self.clock.now()) {
            self.stats.stale += 1;
            self.goal = None;
            return self.send_torques([0; 16]);
        }
        let q = |j: usize| self.fingers[j / 4].q[j % 4];
        let goal = self.goal.unwrap_or_else(|| {
            std::array::from_fn(|j| {
                let (low, high) = self.limits[self.model_of_wire[j]];
                q(j).max(low).min(high)
            })
        });
        let wire = std::array::from_fn(|j| {
            let gains = self.options.gains[j];
            let torque = gains.kp * (goal[j] - q(j)) - gains.kd * self.fingers[j / 4].v[j % 4];
            match self.motor_errors[j] {
                0 => self.options.wire(j, torque, self.effort_nm[j]),
                _ => 0,
            }
        });
        self.goal = Some(goal);
        self.send_torques(wire)
    }

    /// All four fingers are tried; the first failure is told.
    pub(super) fn send_torques(&mut self, wire: [i16; 16]) -> Result<()> {
        // Before a hand has shown all its fingers it is sent no torques, not even none.
        if self.fingers.iter().any(|f| f.seen.is_none()) {
            return Ok(());
        }
        self.sent = wire;
        let mut told = Ok(());
        for finger in 0..4_u8 {
            let at = 4 * usize::from(finger);
            let sent = self.send(AllegroCommand::Torque { finger, wire: std::array::from_fn(|k| wire[at + k]) });
            told = told.and(sent);
        }
        told
    }
}

impl<B: CanBus> Drop for AllegroHand<B> {
    fn drop(&mut self) {
        // Nobody is left to be told that the bus failed.
        let _ = self.stop();
    }
}

/// Index in the model of each joint of the wire, by name.
fn wire_to_model(robot: &Robot, options: &AllegroOptions) -> Result<[usize; 16]> {
    if robot.dof() != 16 {
        return Err(Error::value(
            format!("a model with {} joints for an Allegro hand", robot.dof()),
            "give one with 16, such as allegro_right",
        ));
    }
    let mut model = [0; 16];
    for (wire, name) in options.names.iter().enumerate() {
        model[wire] = robot.require_joint(name)?;
        if let Some(twice) = options.names[..wire].iter().find(|n| *n == name) {
            return Err(Error::value(format!("joint {twice} twice in the names"), "name each joint once"));
        }
    }
    Ok(model)
}
