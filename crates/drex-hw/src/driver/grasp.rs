//! A planned grasp, with a hand or an emulated one.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::scene::{allegro_scene, leap_scene};
use super::{HandKind, Run, Setup, run_logged};
use crate::allegro::AllegroHand;
use crate::control::{GraspController, GraspOutcome, GraspPlan, LoopReport};
use crate::dynamixel::Timing;
use crate::emulator::allegro::AllegroEmulator;
use crate::emulator::leap::LeapEmulator;
use crate::leap::LeapHand;
use crate::{Clock, Hand, Result};

/// What became of a grasp.
pub struct GraspResult {
    /// Contacts, and whether the object was missed or lost.
    pub outcome: GraspOutcome,
    /// How well the loop kept time, and what went wrong on the way.
    pub report: LoopReport,
    /// Largest effort of each joint in the hold: mA or N m.
    pub force: Vec<f64>,
}

/// A joint that touched.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ContactRecord {
    /// Its name.
    pub joint: String,
    /// When, from the start of the grasp, s.
    pub time_s: f64,
    /// Where, rad.
    pub position_rad: f64,
    /// How hard it may press: mA or N m.
    pub effort_limit: f64,
    /// How hard it pressed in the hold.
    pub held_effort: Option<f64>,
}

/// Opens, closes until the fingers touch, presses with the force, holds, opens.
///
/// # Errors
/// If the plan does not fit the hand, the hand fails, or somebody stops it.
pub fn grasp(hand: &mut dyn Hand, clock: &dyn Clock, plan: GraspPlan, how: &Run<'_>) -> Result<GraspResult> {
    let force = plan.force_effort.clone();
    let mut grasp = GraspController::new(plan);
    let report = run_logged(hand, &mut grasp, clock, how)?;
    Ok(GraspResult { outcome: grasp.outcome().clone(), report, force })
}

/// The same with an emulated hand in its own time; the object is in the way of every joint at `touching`, rad.
///
/// # Errors
/// As [`grasp`].
pub fn grasp_emulated(setup: &Setup, plan: GraspPlan, touching: &[f64], how: &Run<'_>) -> Result<GraspResult> {
    let names = setup.robot.joint_names();
    // Open from the start: what is in the way must not be jumped over.
    let start: Vec<(&str, f64)> = names.iter().copied().zip(plan.open.iter().copied()).collect();
    let walls: Vec<(&str, f64, f64)> = names
        .iter()
        .copied()
        .zip(touching)
        .zip(plan.open.iter().zip(&plan.closed))
        .map(|((name, at), (open, closed))| match closed > open {
            true => (name, f64::NEG_INFINITY, *at),
            false => (name, *at, f64::INFINITY),
        })
        .collect();
    match setup.hand {
        HandKind::Leap => {
            let emulator = LeapEmulator::with_model(setup.expected_motors());
            leap_scene(&emulator, &setup.leap, &start, &walls);
            let options = setup.leap.clone().with_timing(Timing::for_latency(Duration::ZERO));
            let mut hand = LeapHand::connect(emulator.port(), &setup.robot, options)?;
            grasp(&mut hand, &emulator, plan, how)
        }
        HandKind::Allegro => {
            let options = setup.allegro.clone();
            let emulator = AllegroEmulator::with_options(options.clone());
            allegro_scene(&emulator, &options, &start, &walls);
            let mut hand = AllegroHand::connect_with_clock(emulator.bus(), &setup.robot, options, emulator.clock())?;
            grasp(&mut hand, &emulator.clock(), plan, how)
        }
    }
}

impl GraspResult {
    /// Whether the object was touched and held to the end.
    pub fn held(&self) -> bool {
        !self.outcome.missed && !self.outcome.lost
    }

    /// The joints that touched.
    pub fn contacts(&self, joints: &[String]) -> Vec<ContactRecord> {
        joints
            .iter()
            .zip(&self.outcome.contacts)
            .enumerate()
            .filter_map(|(j, (name, contact))| {
                let contact = contact.as_ref()?;
                Some(ContactRecord {
                    joint: name.clone(),
                    time_s: contact.time_s,
                    position_rad: contact.position,
                    effort_limit: self.force[j],
                    held_effort: self.outcome.held_effort.get(j).copied(),
                })
            })
            .collect()
    }
}
