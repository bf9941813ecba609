//! A policy of one object, trained on grasps that hold in simulation.

use std::sync::Arc;
use std::time::Instant;

use crate::Result;
use crate::error::{Context, refuse};
use drex_core::Object;
use drex_grasp::{Grasp, GraspOrigin, OriginCounts};
use drex_policy::{
    Dataset, GraspPolicy, GraspSample, ObjectCloud, PredictedGrasp, Query, TrainOptions, TrainReport, Trainer,
};
use drex_robot::Robot;
use drex_trial::{
    Assumed, ConditionSpread, DemonstrationCounts, Evaluator, GripForce, Proposal, Selection, SelectionOptions,
    ValidatedGrasp, select_grasps,
};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Points of the object that the network sees.
pub const POINTS: usize = 512;
/// The network learns the force at these multiples of the object's mass
pub(crate) const MASS_FACTORS: [f64; 3] = [0.4, 1.0, 2.0];
/// and at these multiples of its friction.
const FRICTION_FACTORS: [f64; 3] = [0.7, 1.0, 1.5];
/// More than the motors of any hand grip force with, N.
const MORE_THAN_ANY_N: f64 = 1e4;

/// How a policy is trained.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnOptions {
    /// Settings of the training.
    pub train: TrainOptions,
    /// Distribution of the conditions under which grasps are simulated.
    pub spread: ConditionSpread,
    /// Grasps that are simulated before the best are learned, those that need least force; zero simulates nothing.
    pub simulated: usize,
    /// Acceleration of the shakes, m/s².
    pub shake_m_s2: f64,
    /// Masses of the labels, kg; empty: multiples of the object's own.
    pub masses_kg: Vec<f64>,
    /// Whether the network sees the same mass whatever it was: what randomising masses in training amounts to.
    pub mass_hidden: bool,
}

/// A trained policy.
pub struct Learned {
    policy: GraspPolicy,
    /// Mass that the network sees in place of the assumed one, kg.
    shown_kg: Option<f64>,
    /// Number of grasps for which there is a command.
    pub commanded: usize,
    /// Number of grasps that held under most conditions.
    pub robust: usize,
    /// Grasps that were learned.
    pub learned: OriginCounts,
    /// These grasps, the best first.
    pub validated: Vec<ValidatedGrasp>,
    /// What became of the demonstrations.
    pub demonstrations: DemonstrationCounts,
    /// Lowest assumed friction at which a closed grasp has a grip force for the heaviest mass.
    pub carries_from: Option<f64>,
    /// Curve and errors of the training.
    pub report: TrainReport,
    /// Number of pairs of grasp and grip force.
    pub samples: usize,
    /// Time of the selection and of learning, s.
    pub seconds: [f64; 2],
}

impl Learned {
    /// Trains on grasps of an object: those that hold in practice, in drex-diffsim, with the force that the cone programme asks for once the hand
    /// has closed.
    ///
    /// # Errors
    /// If no grasp can carry the object at any of the masses, or the training fails.
    pub fn train<E: Evaluator>(
        object: &Object,
        robot: &Arc<Robot>,
        grasps: &[Grasp],
        evaluator: &E,
        options: &LearnOptions,
    ) -> Result<Self> {
        let start = Instant::now();
        let masses: Vec<f64> = match options.masses_kg.is_empty() {
            true => MASS_FACTORS.map(|f| f * object.mass_kg()).to_vec(),
            false => options.masses_kg.clone(),
        };
        let middle = (masses.iter().map(|m| m.ln()).sum::<f64>() / masses.len() as f64).exp();
        let shown_kg = options.mass_hidden.then_some(middle);
        // What is to hold at several masses is simulated at all of them.
        let own = [object.mass_kg()];
        let practice_kg = if options.masses_kg.is_empty() { &own[..] } else { &masses[..] };
        let selection = SelectionOptions {
            spread: options.spread,
            simulated: options.simulated,
            shake_m_s2: options.shake_m_s2,
            seed: options.train.seed,
        };
        let Selection { grasps: selected, commanded, robust, demonstrations, carries_from } =
            select_grasps(object, robot, grasps, evaluator, practice_kg, &selection)?;
        let samples: Vec<GraspSample> = selected
            .par_iter()
            .map(|p| samples(p, evaluator, &masses, object.friction, shown_kg))
            .collect::<Result<Vec<_>>>()?
            .into_iter()
            .flatten()
            .collect();
        if samples.is_empty() {
            refuse!(
                "none of the {} grasps of \"{}\" can carry {:.0} g with the motors of {}: it may be too heavy or too smooth for this hand",
                grasps.len(),
                object.name,
                1e3 * middle,
                robot.name
            );
        }
        let data = dataset(object, robot, samples, options.train.seed)?;
        let mut train = options.train.clone();
        // Every grasp that held has a mode of its own; a mean of two may hold nothing.
        train.modes = selected.len();
        train.hold_out_every = 0;
        let selected_s = start.elapsed().as_secs_f64();
        let mut trainer = Trainer::new(&data, &train)?;
        while trainer.learn()?.is_some() {}
        let (policy, report) = trainer.finish()?;
        let seconds = [selected_s, start.elapsed().as_secs_f64() - selected_s];
        let (learned, samples) = (OriginCounts::of(selected.iter().map(|p| p.grasp.origin)), data.samples.len());
        let validated = selected;
        Ok(Self {
            policy,
            shown_kg,
            commanded,
            robust,
            learned,
            validated,
            demonstrations,
            carries_from,
            report,
            samples,
            seconds,
        })
    }

    /// The network.
    pub fn policy(&self) -> &GraspPolicy {
        &self.policy
    }

    /// The grasps for an object with these points, `up` for it the way from the table, the most probable first.
    ///
    /// # Errors
    /// If the policy is not defined for what is asked.
    pub fn propose(&self, points: &[Point3<f64>], up: &Vector3<f64>, assumed: &Assumed) -> Result<Vec<Proposal>> {
        let query = Query::new(points, self.shown_kg.unwrap_or(assumed.mass_kg), assumed.friction).with_up(*up);
        propose(&self.policy, &query)
    }
}

/// What a policy proposes for what is asked, the most probable first.
///
/// # Errors
/// If the policy is not defined for what is asked.
pub fn propose(policy: &GraspPolicy, query: &Query<'_>) -> Result<Vec<Proposal>> {
    let proposal = |g: PredictedGrasp| Proposal {
        grasp: grasp_of(policy.hand(), policy.joint_names(), &g),
        grip_force_n: g.grip_force_n,
        weight: g.weight,
    };
    Ok(policy.predict(query)?.into_iter().map(proposal).collect())
}

/// What a network predicts, as a grasp of this hand. The network's grip force is no part of it: contacts say what force they take.
pub fn grasp_of(hand: &str, joint_names: &[String], predicted: &PredictedGrasp) -> Grasp {
    Grasp {
        hand: hand.to_owned(),
        joint_names: joint_names.to_vec(),
        joints_rad: predicted.joints.clone(),
        object_from_base: predicted.object_from_base,
        contacts: Vec::new(),
        grip_force_n: None,
        origin: GraspOrigin::Predicted,
        source: 0,
    }
}

/// The grasp with the force that it needs at each of the masses, closed as for the first.
fn samples<E: Evaluator>(
    validated: &ValidatedGrasp,
    evaluator: &E,
    masses: &[f64],
    friction: f64,
    shown_kg: Option<f64>,
) -> Result<Vec<GraspSample>> {
    let closed = evaluator.close(&validated.grasp, &Assumed { mass_kg: masses[0], friction })?;
    let labels = labels(&validated.grasp, &validated.fingers, masses, friction, |assumed| {
        needed_n(evaluator, &closed, assumed)
    })?;
    Ok(labels.into_iter().map(|s| GraspSample { mass_kg: shown_kg.unwrap_or(s.mass_kg), ..s }).collect())
}

/// The grasp with its grip force at each of the masses (kg) and at multiples of the friction; without those where `grip_force_n` knows none.
pub(crate) fn labels(
    grasp: &Grasp,
    fingers: &[bool],
    masses: &[f64],
    friction: f64,
    grip_force_n: impl Fn(&Assumed) -> Result<Option<f64>>,
) -> Result<Vec<GraspSample>> {
    let mut out = Vec::new();
    for (mass_kg, friction) in masses.iter().flat_map(|m| FRICTION_FACTORS.map(|f| (*m, f * friction))) {
        if let Some(grip_force_n) = grip_force_n(&Assumed { mass_kg, friction })? {
            out.push(GraspSample {
                object: 0,
                joints: grasp.joints_rad.clone(),
                object_from_base: grasp.object_from_base,
                contacts: fingers.to_vec(),
                grip_force_n,
                mass_kg,
                friction,
            });
        }
    }
    Ok(out)
}

/// What the network learns of one object.
///
/// # Errors
/// If a joint of the hand has no limits.
pub(crate) fn dataset(object: &Object, robot: &Robot, samples: Vec<GraspSample>, seed: u64) -> Result<Dataset> {
    let limits = robot.joints.iter().map(|j| {
        let why = || format!("joint {} of {} has no limits; the network needs them", j.name, robot.name);
        j.limits.with_context(why)
    });
    Ok(Dataset {
        hand: robot.name.clone(),
        joint_names: robot.joint_names().into_iter().map(str::to_owned).collect(),
        joint_limits: limits.collect::<Result<_>>()?,
        fingers: robot.fingers().into_iter().map(|f| f.name).collect(),
        objects: vec![ObjectCloud {
            name: object.name.clone(),
            points: object.point_cloud(POINTS, seed),
            up: object.table().up.into_inner(),
        }],
        samples,
    })
}

/// The grip force that the law asks for; all that the motors have where they have too little for it but may still carry. Without these
/// the network would know heavy things only by the cases that are easy.
fn needed_n<E: Evaluator>(evaluator: &E, closed: &E::Closed, assumed: &Assumed) -> Result<Option<f64>> {
    for force in [GripForce::Required, GripForce::Total(MORE_THAN_ANY_N)] {
        if let Ok(grip_force_n) = evaluator.grip_force_n(closed, assumed, force)? {
            return Ok(Some(grip_force_n));
        }
    }
    Ok(None)
}
