//! How a hand is, motor by motor, without changing anything: also if some of them do not answer.

use drex_robot::Robot;

use super::absent::{SILENCE, nobody};
use super::driver::{READING, joints, known_timing};
use super::faults::FROZEN;
use super::finding::Finding;
use super::inspect::inspect;
use super::joint::{Joint, MotorHealth};
use super::options::LeapOptions;
use super::table::{self, MotorModel, RAD_S_PER_UNIT};
use crate::dynamixel::{Bus, Port};
use crate::{Error, Result};

/// What a motor tells.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MotorReading {
    /// Model number.
    pub model: u16,
    /// Version of its firmware.
    pub firmware: u8,
    /// Whether it is under torque.
    pub torque: bool,
    /// Bus watchdog, register 98: 0 is off, 1 to 127 the silence in 20 ms after which it freezes, 255 that it has.
    pub watchdog: u8,
    /// Homing offset, register 20, ticks.
    pub homing_offset: i32,
    /// Position as the motor has it, ticks.
    pub ticks: i32,
    /// Angle of the joint, rad.
    pub position: f64,
    /// Its velocity, rad/s.
    pub velocity: f64,
    /// Current, mA, in the direction of the joint.
    pub current_ma: f64,
    /// Temperature, voltage and hardware errors.
    pub health: MotorHealth,
}

impl MotorReading {
    /// Whether its bus watchdog has run out: it stays where it is, under torque if that was on, and takes no goals.
    pub fn is_frozen(&self) -> bool {
        self.watchdog == FROZEN
    }
}

/// How a motor was found.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct MotorInspection {
    /// The joint that it moves.
    pub joint: String,
    /// Its id.
    pub id: u8,
    /// What it tells; `None` if it does not answer or refuses.
    pub reading: Option<MotorReading>,
    /// What is wrong with it, in words.
    pub fault: Option<String>,
}

/// How a hand was found.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct HandInspection {
    /// Its motors in the order of the robot model.
    pub motors: Vec<MotorInspection>,
    /// What is not as it should be, as [`inspect`] says.
    pub findings: Vec<Finding>,
}

/// Reads what can be read of every motor of `robot` behind `port` and writes nothing: torque stays as it is.
///
/// # Errors
/// If options or model do not fit, the port fails, or no motor answers at all; one that does not is told in its [`MotorInspection`].
pub fn inspect_hand<P: Port>(port: P, robot: &Robot, options: &LeapOptions) -> Result<HandInspection> {
    options.check()?;
    let timing = known_timing(&port, options).unwrap_or_default();
    let mut bus = Bus::new(port, timing);
    bus.limit_silence(Some(SILENCE));
    let mut motors = Vec::new();
    for mut joint in joints(robot, options)? {
        let (reading, fault) = match read(&mut bus, &mut joint) {
            Err(lost @ Error::Port { .. }) => return Err(lost),
            Err(error) => (None, Some(error.to_string())),
            Ok(reading) => {
                let fault = fault(&reading);
                (Some(reading), fault)
            }
        };
        motors.push(MotorInspection { joint: joint.name, id: joint.id, reading, fault });
    }
    if motors.iter().all(|m| m.reading.is_none()) {
        let ids: Vec<u8> = motors.iter().map(|m| m.id).collect();
        return Err(nobody(&mut bus, &ids, options.baud));
    }
    bus.limit_silence(Some(SILENCE));
    let findings = inspect(&mut bus, options)?;
    Ok(HandInspection { motors, findings })
}

fn read<P: Port>(bus: &mut Bus<P>, joint: &mut Joint) -> Result<MotorReading> {
    let id = joint.id;
    let pong = bus.ping(id)?;
    let torque = bus.get(id, table::TORQUE_ENABLE)? != 0;
    let hardware_error = bus.get(id, table::HARDWARE_ERROR)?;
    let watchdog = bus.get(id, table::BUS_WATCHDOG)?;
    let homing_offset = bus.get(id, table::HOMING_OFFSET)?;
    let (start, mut data) = (table::PRESENT_CURRENT.address, [0; READING]);
    bus.read(id, start, &mut data)?;
    let decivolt = bus.get(id, table::PRESENT_VOLTAGE)?;
    let celsius = bus.get(id, table::PRESENT_TEMPERATURE)?;
    let ticks = table::PRESENT_POSITION.in_block(start, &data);
    // Whole turns are no matter.
    joint.count_turns(ticks, 0.0);
    Ok(MotorReading {
        model: pong.model,
        firmware: pong.firmware,
        torque,
        watchdog,
        homing_offset,
        ticks,
        position: joint.angle(ticks),
        velocity: joint.directed(f64::from(table::PRESENT_VELOCITY.in_block(start, &data)) * RAD_S_PER_UNIT),
        current_ma: joint.directed(f64::from(table::PRESENT_CURRENT.in_block(start, &data))),
        health: MotorHealth {
            temperature_c: f64::from(celsius),
            voltage_v: f64::from(decivolt) / 10.0,
            hardware_error,
        },
    })
}

fn fault(reading: &MotorReading) -> Option<String> {
    if MotorModel::from_number(reading.model).is_none() {
        return Some(format!("is of model {}, which is not one of a LEAP hand", reading.model));
    }
    let bits = reading.health.hardware_error;
    (bits != 0).then(|| table::hardware_error_text(bits))
}
