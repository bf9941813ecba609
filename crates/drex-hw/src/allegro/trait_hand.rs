//! An Allegro hand under a control loop: efforts are torques, N m, and their limit clips what the position loop asks for.

use super::AllegroHand;
use crate::can::CanBus;
use crate::{EffortUnit, Hand, HandCommand, HandState, JointStatus, Result};

impl<B: CanBus> Hand for AllegroHand<B> {
    fn joints(&self) -> &[String] {
        &self.names
    }

    fn limits(&self) -> &[(f64, f64)] {
        &self.limits
    }

    fn effort_unit(&self) -> EffortUnit {
        EffortUnit::NewtonMetre
    }

    fn effort_caps(&self) -> &[f64] {
        &self.caps
    }

    fn turn_on(&mut self) -> Result<()> {
        self.drive()
    }

    fn turn_off(&mut self) -> Result<()> {
        self.stop()
    }

    /// A command that must not be followed leaves the last one in force: the hand is not left to its last torques.
    fn cycle(&mut self, command: Option<&HandCommand>, state: &mut HandState) -> Result<()> {
        if let Err(lost) = self.gather(self.options.pose_wait) {
            if self.driven {
                // Blind, but perhaps not yet mute.
                let _ = self.send_torques([0; 16]);
            }
            return Err(lost);
        }
        let refused = command.map_or(Ok(()), |c| c.check(&self.names));
        if self.driven {
            if let Some(command) = command.filter(|_| refused.is_ok()) {
                self.aim(&command.position, &command.effort_limit);
            }
            self.press()?;
        }
        self.report(state);
        refused.and_then(|()| self.check_sight())
    }
}

impl<B: CanBus> AllegroHand<B> {
    /// Efforts are the torques that were commanded: the hand measures none.
    fn report(&self, state: &mut HandState) {
        if state.lengths() != [16; 8] {
            *state = HandState::new(16);
        }
        let time = self.time();
        state.time_s = time.as_secs_f64();
        for (wire, model) in self.model_of_wire.iter().enumerate() {
            let finger = &self.fingers[wire / 4];
            state.position[*model] = finger.q[wire % 4];
            state.velocity[*model] = finger.v[wire % 4];
            state.effort[*model] = if self.driven { self.options.torque(wire, self.sent[wire]) } else { 0.0 };
            state.temperature_c[*model] = self.temperatures_c[wire];
            state.hardware_error[*model] = self.motor_errors[wire];
            state.age[*model] = self.ages[wire / 4];
            state.status[*model] = match self.motor_errors[wire] {
                0 if !self.driven => JointStatus::TorqueOff,
                0 if self.is_stale(wire / 4) => JointStatus::Silent,
                0 => JointStatus::Driven,
                code => JointStatus::Faulted(code),
            };
        }
    }
}
