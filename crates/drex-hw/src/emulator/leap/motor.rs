//! One emulated motor: its control table and what writing to it does.

use std::time::Duration;

use super::physics::Body;
use super::registers::{END, check_write, is_defined, is_writable, refusal};
use crate::dynamixel::Pong;
use crate::leap::table::{self, MotorModel, Register, Value};

/// First address that is not kept without power.
const RAM: u16 = 64;
/// Supply below which a motor loses what is in RAM, V; our choice, the manual gives none.
const BROWN_OUT_V: f64 = 3.0;
/// What the watchdog register says when it has run out.
const FROZEN: u8 = 255;
/// How long a motor is deaf after a reboot.
const BOOT: Duration = Duration::from_millis(150);

/// An emulated motor.
#[derive(Debug, Clone)]
pub(super) struct Motor {
    pub id: u8,
    model: MotorModel,
    memory: [u8; END],
    pub body: Body,
    booted_at: Duration,
    heard_at: Duration,
    /// Whether nothing reaches it, nor comes from it.
    pub detached: bool,
    /// A write that waits for an action.
    pub registered: Option<(u16, Vec<u8>)>,
}

impl Motor {
    pub fn new(id: u8, model: MotorModel) -> Self {
        let mut motor = Self {
            id,
            model,
            memory: [0; END],
            body: Body::default(),
            booted_at: Duration::ZERO,
            heard_at: Duration::ZERO,
            detached: false,
            registered: None,
        };
        motor.set(table::MODEL_NUMBER, model.number());
        motor.set(table::FIRMWARE, 52);
        motor.set(table::ID, id);
        motor.set(table::BAUD, 6);
        motor.set(table::RETURN_DELAY, 250);
        motor.set(table::MODE, 3);
        motor.set(table::SHADOW_ID, 255);
        motor.set(table::TEMPERATURE_LIMIT, 70);
        motor.set(table::MAX_VOLTAGE, 70);
        motor.set(table::MIN_VOLTAGE, 35);
        motor.set(table::PWM_LIMIT, 885);
        motor.set(table::CURRENT_LIMIT, model.current_limit_max_ma());
        motor.set(table::SHUTDOWN, model.default_shutdown());
        motor.start();
        motor
    }

    pub fn get<T: Value>(&self, register: Register<T>) -> T {
        register.in_block(0, &self.memory)
    }

    /// Sets a register without asking whether that is allowed.
    pub fn set<T: Value>(&mut self, register: Register<T>, value: T) {
        let at = usize::from(register.address);
        self.memory[at..at + T::LEN].copy_from_slice(&value.bytes()[..T::LEN]);
    }

    /// RAM as after power has come.
    fn start(&mut self) {
        self.memory[usize::from(RAM)..].fill(0);
        self.set(table::STATUS_LEVEL, 2);
        self.set(table::PRESENT_VOLTAGE, 50);
        self.set(table::PRESENT_TEMPERATURE, 31);
        self.set(table::GOAL_PWM, 885);
        for i in 0..20u16 {
            let at = usize::from(table::INDIRECT_ADDRESS.address + 2 * i);
            self.memory[at..at + 2].copy_from_slice(&(224 + i).min(227).to_le_bytes());
        }
        self.mode_changed();
        self.registered = None;
        // A motor knows its angle within one turn only.
        self.body.forget_turns();
        self.body.stop();
        self.show();
        self.set(table::GOAL_POSITION, self.get(table::PRESENT_POSITION));
    }

    /// What a motor sets back when its mode changes: gains, and the current to all that is allowed.
    fn mode_changed(&mut self) {
        let (p, d) = self.model.default_gains();
        self.set(table::POSITION_P, p);
        self.set(table::POSITION_I, 0);
        self.set(table::POSITION_D, d);
        self.set(table::GOAL_CURRENT, self.get(table::CURRENT_LIMIT) as i16);
    }

    pub fn reboot(&mut self, now: Duration) {
        self.start();
        self.booted_at = now + BOOT;
    }

    pub fn deaf(&self, now: Duration) -> bool {
        self.detached || now < self.booted_at
    }

    pub fn pong(&self) -> Pong {
        let (model, firmware) = (self.get(table::MODEL_NUMBER), self.get(table::FIRMWARE));
        Pong { id: self.id, model, firmware, alert: self.alert() != 0 }
    }

    /// The alert bit of its status packets.
    pub fn alert(&self) -> u8 {
        if self.get(table::HARDWARE_ERROR) == 0 { 0 } else { 0x80 }
    }

    /// How long it hesitates before an answer.
    pub fn return_delay(&self) -> Duration {
        Duration::from_micros(2 * u64::from(self.get(table::RETURN_DELAY)))
    }

    /// Keeps a write for later.
    pub fn register(&mut self, address: u16, data: &[u8]) -> Result<(), u8> {
        // Whether it may is found out by a motor that is thrown away.
        self.clone().write(address, data)?;
        self.registered = Some((address, data.to_vec()));
        Ok(())
    }

    /// Forgets its turns, if that is what `params` ask for.
    pub fn clear(&mut self, params: &[u8]) -> Result<(), u8> {
        if params != [0x01, 0x44, 0x58, 0x4c, 0x22] {
            return Err(refusal::RANGE);
        }
        if self.body.velocity != 0.0 {
            return Err(refusal::FAILED);
        }
        self.body.forget_turns();
        self.show();
        self.set(table::GOAL_POSITION, self.get(table::PRESENT_POSITION));
        Ok(())
    }

    pub fn knows_fast_reads(&self) -> bool {
        self.get(table::FIRMWARE) >= 46
    }

    /// Notes that an instruction for it has come.
    pub fn note_instruction(&mut self, now: Duration) {
        self.heard_at = now;
    }

    /// Lets time pass until `now`, `dt` of it since the last call.
    pub fn step(&mut self, now: Duration, dt: f64) {
        let watchdog = self.get(table::BUS_WATCHDOG);
        if (1..=127).contains(&watchdog) && now > self.heard_at + Duration::from_millis(20 * u64::from(watchdog)) {
            self.set(table::BUS_WATCHDOG, FROZEN);
            self.set(table::GOAL_POSITION, self.body.seen().0.round() as i32);
        }
        // The other modes are not for hands: such a motor does nothing.
        let on = self.get(table::TORQUE_ENABLE) != 0 && matches!(self.get(table::MODE), 3..=5);
        let limit = match self.get(table::MODE) {
            table::CURRENT_BASED_POSITION => f64::from(self.get(table::GOAL_CURRENT).unsigned_abs()),
            _ => f64::from(self.get(table::CURRENT_LIMIT)),
        };
        let goal = f64::from(self.get(table::GOAL_POSITION));
        let (p, d) = (f64::from(self.get(table::POSITION_P)), f64::from(self.get(table::POSITION_D)));
        self.body.step(dt, on.then_some((goal, p, d, limit)));
        self.show();
    }

    /// Puts what is measured into the table.
    pub fn show(&mut self) {
        let (position, velocity) = self.body.seen();
        self.set(table::PRESENT_POSITION, position.round() as i32);
        let units = velocity * table::RAD_PER_TICK / table::RAD_S_PER_UNIT;
        self.set(table::PRESENT_VELOCITY, units.round() as i32);
        self.set(table::PRESENT_CURRENT, self.body.current.round() as i16);
    }

    /// A hardware error; the torque goes if it is one that shuts down.
    pub fn fail(&mut self, bits: u8) {
        let all = self.get(table::HARDWARE_ERROR) | bits;
        self.set(table::HARDWARE_ERROR, all);
        if all & self.get(table::SHUTDOWN) != 0 {
            self.set(table::TORQUE_ENABLE, 0);
        }
    }

    /// Sets the supply: too little of it is a hardware error, still less takes what is in RAM.
    pub fn supply(&mut self, volts: f64, now: Duration) {
        let decivolt = (10.0 * volts).round().clamp(0.0, 255.0) as u16;
        if volts < BROWN_OUT_V {
            self.reboot(now);
        } else if decivolt < self.get(table::MIN_VOLTAGE) {
            self.fail(table::hardware_error::VOLTAGE);
        }
        self.set(table::PRESENT_VOLTAGE, decivolt);
    }

    /// Where `address` really lies.
    fn target(&self, address: usize) -> usize {
        let (map, data) = (usize::from(table::INDIRECT_ADDRESS.address), usize::from(table::INDIRECT_DATA.address));
        let Some(i) = address.checked_sub(data).filter(|i| *i < 20) else { return address };
        let at = map + 2 * i;
        let target = usize::from(u16::from_le_bytes([self.memory[at], self.memory[at + 1]]));
        if (64..END).contains(&target) { target } else { address }
    }

    /// Reads `data.len()` bytes at `address`.
    pub fn read(&self, address: u16, data: &mut [u8]) -> Result<(), u8> {
        let start = usize::from(address);
        if data.is_empty() || start + data.len() > END {
            return Err(refusal::LENGTH);
        }
        for (address, byte) in (start..).zip(data) {
            let target = self.target(address);
            if !(is_defined(address) && is_defined(target)) {
                return Err(refusal::ACCESS);
            }
            *byte = self.memory[target];
        }
        Ok(())
    }

    /// Writes `data` at `address`, and does what that causes.
    pub fn write(&mut self, address: u16, data: &[u8]) -> Result<(), u8> {
        let start = usize::from(address);
        check_write(start, data.len())?;
        let targets: Vec<usize> = (start..start + data.len()).map(|a| self.target(a)).collect();
        let mut after = self.clone();
        for (&target, &byte) in targets.iter().zip(data) {
            if target < usize::from(RAM) && self.get(table::TORQUE_ENABLE) != 0 {
                return Err(refusal::ACCESS);
            }
            if !is_writable(target) {
                return Err(refusal::ACCESS);
            }
            if self.frozen() && (100..120).contains(&target) {
                return Err(refusal::RANGE);
            }
            after.memory[target] = byte;
        }
        let limit = after.get(table::CURRENT_LIMIT);
        let wrote = |r: u16| targets.contains(&usize::from(r));
        if limit > self.model.current_limit_max_ma() || !matches!(after.get(table::MODE), 0 | 1 | 3 | 4 | 5 | 16) {
            return Err(refusal::RANGE);
        }
        if wrote(table::GOAL_CURRENT.address) && after.get(table::GOAL_CURRENT).unsigned_abs() > limit {
            return Err(refusal::LIMIT);
        }
        if wrote(table::TORQUE_ENABLE.address) && after.get(table::TORQUE_ENABLE) != 0 && self.shut_down() {
            return Err(refusal::FAILED);
        }
        if wrote(table::MODE.address) {
            after.mode_changed();
        }
        if wrote(table::BUS_WATCHDOG.address) && after.frozen() {
            return Err(refusal::RANGE);
        }
        if self.frozen() && wrote(table::BUS_WATCHDOG.address) && after.get(table::BUS_WATCHDOG) != 0 {
            // Only 0 ends it.
            after.set(table::BUS_WATCHDOG, FROZEN);
        }
        *self = after;
        Ok(())
    }

    /// Whether its bus watchdog has run out.
    fn frozen(&self) -> bool {
        self.get(table::BUS_WATCHDOG) == FROZEN
    }

    fn shut_down(&self) -> bool {
        self.get(table::HARDWARE_ERROR) & self.get(table::SHUTDOWN) != 0
    }
}
