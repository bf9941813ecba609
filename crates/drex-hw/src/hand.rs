//! What every hand offers to a control loop: read the joints, move them, never push harder than allowed.

use crate::{Error, Result};

/// What the effort of a hand's joints is counted in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum EffortUnit {
    /// Current at the motor's supply, mA.
    Milliampere,
    /// Joint torque, N m.
    NewtonMetre,
}

/// How a joint is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum JointStatus {
    /// Driven by no torque.
    #[default]
    TorqueOff,
    /// Under torque, does what it is told.
    Driven,
    /// Does not answer; its values are old.
    Silent,
    /// Stopped itself; the number is the device's own error code.
    Faulted(u8),
    /// Is being started again after a fault.
    Recovering,
}

/// Joint values of one moment, in the order of [`Hand::joints`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HandState {
    /// When the values were read, s since the hand was connected.
    pub time_s: f64,
    /// Positions, rad, in the robot model's frame.
    pub position: Vec<f64>,
    /// Velocities, rad/s.
    pub velocity: Vec<f64>,
    /// Efforts as measured, in the unit of [`Hand::effort_unit`], positive where they push the joint to larger angles.
    pub effort: Vec<f64>,
    /// Temperatures, °C, where the hand measures them.
    pub temperature_c: Vec<Option<f64>>,
    /// Supply voltages, V, where the hand measures them.
    pub voltage_v: Vec<Option<f64>>,
    /// Hardware errors as the device codes them, 0 for none; also those with which a joint goes on.
    pub hardware_error: Vec<u8>,
    /// Cycles since the values of a joint were last read; 0 is fresh.
    pub age: Vec<u32>,
    /// How each joint is doing.
    pub status: Vec<JointStatus>,
}

impl HandState {
    /// A state of `joints` joints, all zero and limp.
    pub fn new(joints: usize) -> Self {
        Self {
            time_s: 0.0,
            position: vec![0.0; joints],
            velocity: vec![0.0; joints],
            effort: vec![0.0; joints],
            temperature_c: vec![None; joints],
            voltage_v: vec![None; joints],
            hardware_error: vec![0; joints],
            age: vec![u32::MAX; joints],
            status: vec![JointStatus::TorqueOff; joints],
        }
    }

    /// Refuses a state that nobody must act on: of the wrong length or not finite.
    ///
    /// # Errors
    /// With the joint's name and the value.
    pub fn check(&self, joints: &[String]) -> Result<()> {
        let Self { position, velocity, effort, .. } = self;
        let lengths = self.lengths();
        if lengths != [joints.len(); 8] {
            return Err(Error::value(
                format!("a state with lists of {lengths:?} values for {} joints", joints.len()),
                "have the driver fill every list",
            ));
        }
        for ((name, q), (v, e)) in joints.iter().zip(position).zip(velocity.iter().zip(effort)) {
            if !(q.is_finite() && v.is_finite() && e.is_finite()) {
                return Err(Error::value(
                    format!("joint {name} read at {q} rad, {v} rad/s, effort {e}"),
                    "check the joint's encoder and calibration",
                ));
            }
        }
        Ok(())
    }

    /// Lengths of the lists.
    pub(crate) fn lengths(&self) -> [usize; 8] {
        let Self { time_s: _, position, velocity, effort, temperature_c, voltage_v, hardware_error, age, status } =
            self;
        [
            position.len(),
            velocity.len(),
            effort.len(),
            temperature_c.len(),
            voltage_v.len(),
            hardware_error.len(),
            age.len(),
            status.len(),
        ]
    }

    /// Takes over the values of `other` without allocating when the number of joints is the same.
    pub fn copy_from(&mut self, other: &Self) {
        self.clone_from(other);
    }
}

/// What the joints are to do, in the order of [`Hand::joints`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HandCommand {
    /// Goal positions, rad.
    pub position: Vec<f64>,
    /// Largest efforts, in the unit of [`Hand::effort_unit`], not negative.
    pub effort_limit: Vec<f64>,
}

impl HandCommand {
    /// A command for `joints` joints, all zero.
    pub fn new(joints: usize) -> Self {
        Self { position: vec![0.0; joints], effort_limit: vec![0.0; joints] }
    }

    /// Refuses a command that a hand must not follow: of the wrong length, not finite, or with a negative limit.
    ///
    /// # Errors
    /// With the joint's name and the value.
    pub fn check(&self, joints: &[String]) -> Result<()> {
        if self.position.len() != joints.len() || self.effort_limit.len() != joints.len() {
            return Err(Error::value(
                format!(
                    "a command with {} positions and {} effort limits for {} joints",
                    self.position.len(),
                    self.effort_limit.len(),
                    joints.len()
                ),
                "give one of each per joint, in the order of the hand's joints",
            ));
        }
        for (j, name) in joints.iter().enumerate() {
            let (position, limit) = (self.position[j], self.effort_limit[j]);
            if !position.is_finite() {
                return Err(Error::value(format!("the goal of {name} is {position} rad"), "command finite angles"));
            }
            if !(limit >= 0.0 && limit.is_finite()) {
                return Err(Error::value(
                    format!("the effort limit of {name} is {limit}"),
                    "command finite limits of at least 0",
                ));
            }
        }
        Ok(())
    }
}

/// A hand that a control loop can drive. Whoever implements it clips what is commanded to the limits and caps, sets the goal to
/// the present position before torque goes on, and takes torque off when it is dropped.
pub trait Hand: Send {
    /// Names of the joints, as the robot model has them and in its order.
    fn joints(&self) -> &[String];

    /// Lowest and highest angle a joint may be told, rad.
    fn limits(&self) -> &[(f64, f64)];

    /// What efforts are counted in.
    fn effort_unit(&self) -> EffortUnit;

    /// Largest effort each joint may be told.
    fn effort_caps(&self) -> &[f64];

    /// Words for a hardware error of a joint ([`HandState::hardware_error`], [`JointStatus::Faulted`]).
    fn error_text(&self, code: u8) -> String {
        format!("error {code:#04x}")
    }

    /// Puts the joints under torque where they are.
    ///
    /// # Errors
    /// If a joint does not answer or is not where it can be.
    fn turn_on(&mut self) -> Result<()>;

    /// Takes the torque off all joints.
    ///
    /// # Errors
    /// If the hand cannot be reached; then its watchdog stops it.
    fn turn_off(&mut self) -> Result<()>;

    /// One exchange: sends `command`, if there is one and the hand is on, and reads `state`. A joint that does not answer keeps
    /// its old values and grows older.
    ///
    /// # Errors
    /// If the command must not be followed ([`HandCommand::check`]) or the hand cannot be reached. A single joint that
    /// does not answer is no error.
    fn cycle(&mut self, command: Option<&HandCommand>, state: &mut HandState) -> Result<()>;
}

impl<H: Hand + ?Sized> Hand for Box<H> {
    fn joints(&self) -> &[String] {
        (**self).joints()
    }

    fn limits(&self) -> &[(f64, f64)] {
        (**self).limits()
    }

    fn effort_unit(&self) -> EffortUnit {
        (**self).effort_unit()
    }

    fn effort_caps(&self) -> &[f64] {
        (**self).effort_caps()
    }

    fn error_text(&self, code: u8) -> String {
        (**self).error_text(code)
    }

    fn turn_on(&mut self) -> Result<()> {
        (**self).turn_on()
    }

    fn turn_off(&mut self) -> Result<()> {
        (**self).turn_off()
    }

    fn cycle(&mut self, command: Option<&HandCommand>, state: &mut HandState) -> Result<()> {
        (**self).cycle(command, state)
    }
}
