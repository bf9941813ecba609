//! A hand and an object, prepared for closings and trials.

use std::sync::Arc;

use drex_core::{Object, Pose};
use drex_diffsim::Collider;
use drex_grasp::HandSurface;
use drex_robot::Robot;
use nalgebra::{Translation3, UnitQuaternion, Vector3};

use crate::engine::{Drive, Setup, Simulation, drives_of};
use crate::reach::Reach;
use crate::{Engine, Mismatch, Result, TrialOptions, Truth, mismatch, timeline};

/// Distance of the points on the hand by which it is planned, m.
const SPACING_M: f64 = 0.003;
/// Steps of the engine per command.
pub(crate) const STEPS_PER_TICK: usize = 2;

/// What closings and trials of one hand with one object share.
#[derive(Clone)]
pub(crate) struct HandAndObject {
    pub hand: Arc<Robot>,
    pub drives: Vec<Drive>,
    pub surface: Arc<HandSurface>,
    pub object: Object,
    collider: Arc<Collider>,
    pub options: TrialOptions,
    /// Largest torque of each joint, model order, N m.
    pub effort_nm: Vec<f64>,
    /// Time from reading the joints to when the command that comes of it acts, s.
    pub latency_s: f64,
}

impl HandAndObject {
    /// See [`Trial::new`](crate::Trial::new).
    pub fn new(hand: Arc<Robot>, object: Object, options: TrialOptions) -> Result<Self> {
        options.check()?;
        let collider = Collider::of_parts(&object.convex_parts)?;
        let effort_nm = hand.effort_limits()?;
        let surface = HandSurface::new(&hand, SPACING_M)?;
        let drives = drives_of(&hand);
        let (surface, collider) = (Arc::new(surface), Arc::new(collider));
        Ok(Self { hand, drives, surface, object, collider, options, effort_nm, latency_s: 0.0 })
    }

    /// See [`Trial::mismatched`](crate::Trial::mismatched).
    pub fn mismatched(&self, mismatch: &Mismatch, seed: u64) -> Result<Self> {
        mismatch.check()?;
        let mut random = mismatch::random(seed);
        let object = mismatch.object(&self.object, &mut random);
        let hand = mismatch.hand(&self.hand, &mut random);
        Ok(Self {
            drives: drives_of(&hand),
            collider: Arc::new(Collider::of_parts(&object.convex_parts)?),
            hand,
            object,
            latency_s: mismatch.latency_s,
            ..self.clone()
        })
    }

    /// Everything at the start of a command, with the palm's path until `last_s`.
    pub(crate) fn simulation(
        &self,
        world_from_base: &Pose,
        reach: &Reach,
        truth: &Truth,
        last_s: f64,
        engine: Engine,
    ) -> Result<Simulation> {
        let TrialOptions { shake_m_s2, dt_s, .. } = self.options;
        let path = timeline::palm_path(world_from_base, &reach.retreat, shake_m_s2, truth.seed, last_s, dt_s)?;
        let setup = Setup {
            hand: &self.hand,
            drives: &self.drives,
            object: &self.object,
            collider: &self.collider,
            world_from_object: self.true_pose(truth),
            truth,
            path,
            joints: &reach.open,
            effort_nm: &self.effort_nm,
            dt_s: self.options.dt_s,
        };
        Simulation::new(setup, engine)
    }

    /// Where the object really is.
    fn true_pose(&self, truth: &Truth) -> Pose {
        let assumed = self.object.world_from_object;
        let centre = assumed * self.object.mass_properties.center_of_mass;
        let about = Translation3::from(centre.coords);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), truth.turn_rad);
        Translation3::new(truth.shift_m[0], truth.shift_m[1], 0.0) * (about * turn * about.inverse()) * assumed
    }
}
