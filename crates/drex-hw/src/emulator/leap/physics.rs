//! The body of an emulated motor: a rotor that a current turns, a gearbox with friction, and a wall to push against.

use crate::leap::table::{RAD_PER_TICK, TICKS_PER_TURN};

/// Acceleration per current, ticks/s² per mA: 0.517 N m/A on 1.41e-3 kg m².
const ACCELERATION: f64 = 0.517e-3 / 1.41e-3 / RAD_PER_TICK;
/// Current that the gearbox's dry friction eats, mA.
const FRICTION: f64 = 15.0;
/// Drag, 1/s.
const DRAG: f64 = 20.0;
/// No-load speed, ticks/s.
const TOP_SPEED: f64 = 8.48 / RAD_PER_TICK;
/// Current per gain P and tick, mA.
const P_SCALE: f64 = 1.0 / 256.0;
/// Current per gain D and tick/s, mA; near critical damping at P 600, D 200.
const D_SCALE: f64 = 1.0 / 1000.0;

/// Where a motor is and how it moves.
#[derive(Debug, Clone)]
pub(super) struct Body {
    /// Ticks, turns included.
    pub position: f64,
    /// Ticks/s.
    pub velocity: f64,
    /// Measured current, mA, signed.
    pub current: f64,
    /// Measured current over the one that flows.
    pub sensor: f64,
    /// Where the position sensor is stuck, ticks.
    pub stuck: Option<f64>,
    /// Lowest and highest angle that something in the way leaves, ticks.
    pub wall: (f64, f64),
}

impl Default for Body {
    fn default() -> Self {
        let wall = (f64::NEG_INFINITY, f64::INFINITY);
        Self { position: 2048.0, velocity: 0.0, current: 0.0, sensor: 1.0, stuck: None, wall }
    }
}

impl Body {
    pub fn stop(&mut self) {
        (self.velocity, self.current) = (0.0, 0.0);
    }

    /// Position, ticks, and velocity, ticks/s, as the sensor has them.
    pub fn seen(&self) -> (f64, f64) {
        self.stuck.map_or((self.position, self.velocity), |at| (at, 0.0))
    }

    /// Current that flows, mA, signed.
    pub fn flowing(&self) -> f64 {
        self.current / self.sensor
    }

    pub fn forget_turns(&mut self) {
        let turned = self.position.rem_euclid(f64::from(TICKS_PER_TURN)) - self.position;
        self.position += turned;
        (self.wall.0, self.wall.1) = (self.wall.0 + turned, self.wall.1 + turned);
    }

    /// One step of `dt` seconds; `drive` is goal (ticks), gains P and D, and the largest current (mA), or nothing without torque.
    pub fn step(&mut self, dt: f64, drive: Option<(f64, f64, f64, f64)>) {
        let (position, velocity) = self.seen();
        self.current = drive.map_or(0.0, |(goal, p, d, limit)| {
            (P_SCALE * p * (goal - position) - D_SCALE * d * velocity).clamp(-limit, limit)
        });
        let pushed = self.velocity + ACCELERATION * self.flowing() * dt;
        let friction = (ACCELERATION * FRICTION * dt).min(pushed.abs());
        self.velocity = ((pushed - friction * pushed.signum()) / (1.0 + DRAG * dt)).clamp(-TOP_SPEED, TOP_SPEED);
        let next = self.position + self.velocity * dt;
        self.position = next.max(self.wall.0).min(self.wall.1);
        if self.position != next {
            self.velocity = 0.0;
        }
    }
}
