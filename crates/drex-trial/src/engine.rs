//! One hand, one object and a table in either engine, step by step.

use std::sync::Arc;

use drex_core::{Object, Pose};
use drex_diffsim::{
    ActuatorKind, Articulation, Base, Body, Collider, ContactForce, Control, Model, Part, Path, Scene, State,
    Workspace, step,
};
use drex_robot::{Actuator, ActuatorKind as DriveKind, Robot};
use nalgebra::Vector3;

use serde::{Deserialize, Serialize};

use crate::{Error, Result, Truth};

/// Stiffness and damping of drives of hands whose model has no position drives, N m/rad and N m s/rad.
const STIFFNESS: f64 = 0.8;
const DAMPING: f64 = 0.02;

/// Steps of MuJoCo in one of ours: the shorter its steps, the less slides there what is held (median 2.0 mm at 2 ms, 1.4 mm
/// at 1 ms: docs/grasping.md).
#[cfg(feature = "mujoco")]
const MUJOCO_STEPS: usize = 2;

/// The engine that a trial runs in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Engine {
    /// drex-diffsim: the engine that rollouts of the training use.
    Diffsim,
    /// MuJoCo, never used in training; only in builds with the feature `mujoco`.
    Mujoco,
}

impl Engine {
    /// Whether this build has the engine.
    ///
    /// # Errors
    /// [`Error::NoMujoco`].
    pub fn check(self) -> Result<()> {
        match self {
            Self::Mujoco if !cfg!(feature = "mujoco") => Err(Error::NoMujoco),
            _ => Ok(()),
        }
    }
}

/// What the hand meets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Met {
    Object,
    Table,
}

/// A contact of one link of the hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Touch {
    pub link: usize,
    pub with: Met,
    /// World, m.
    pub point: Vector3<f64>,
    /// Unit vector from the link into what it meets, world.
    pub inward: Vector3<f64>,
    /// N.
    pub normal_n: f64,
    pub tangential_n: f64,
    pub depth_m: f64,
    /// Of the object over the skin, tangential, world, m/s.
    pub slide: Vector3<f64>,
}

/// The numbers of a drive that the controller needs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drive {
    pub joint: usize,
    pub stiffness: f64,
    /// Joint torque per unit of the drive's own.
    pub gear: f64,
}

/// A hand, an object and a table that move.
pub(crate) enum Simulation {
    Diffsim {
        model: Box<Model<f64>>,
        scene: Box<Scene<f64>>,
        state: Box<State<f64>>,
        work: Box<Workspace<f64>>,
    },
    #[cfg(feature = "mujoco")]
    Mujoco {
        simulation: Box<drex_mujoco::MujocoEngine>,
        state: Box<State<f64>>,
    },
}

/// What an engine is made of.
pub(crate) struct Setup<'a> {
    pub hand: &'a Arc<Robot>,
    pub drives: &'a [Drive],
    pub object: &'a Object,
    pub collider: &'a Arc<Collider>,
    /// True pose of the object at the start.
    pub world_from_object: Pose,
    pub truth: &'a Truth,
    pub path: Path,
    /// Joint angles at the start, rad.
    pub joints: &'a [f64],
    /// Largest torque of each joint, N m.
    pub effort_nm: &'a [f64],
    pub dt_s: f64,
}

/// The hand's drives as position drives within the joints' largest torques.
fn hand_of(hand: &Arc<Robot>, base: Base<f64>, effort_nm: &[f64], friction: f64) -> Result<Articulation<f64>> {
    let mut arm = Articulation::new(Arc::clone(hand), base)?.with_friction(friction);
    for (drive, given) in arm.actuators.iter_mut().zip(&hand.actuators) {
        let (kp, kv) = gains(given);
        drive.kind = ActuatorKind::Position { kp, kv };
        let cap = effort_nm[drive.joint] / gear(given).abs();
        drive.force_range = Some((-cap, cap));
        // Commands lie beyond a joint's end where the grip force needs it; the force range is what bounds them.
        drive.ctrl_range = None;
    }
    Ok(arm)
}

/// The numbers of the hand's drives, in the order of their commands.
pub(crate) fn drives_of(hand: &Robot) -> Vec<Drive> {
    let drive = |a: &Actuator| Drive { joint: a.joint, stiffness: gains(a).0, gear: gear(a) };
    hand.actuators.iter().map(drive).collect()
}

/// Stiffness and damping of a drive that holds a position.
fn gains(actuator: &Actuator) -> (f64, f64) {
    match actuator.kind {
        DriveKind::Position { kp, kv } if kp > 0.0 => (kp, kv),
        _ => (STIFFNESS, DAMPING),
    }
}

/// A ratio that is not given is one.
fn gear(actuator: &Actuator) -> f64 {
    if actuator.gear == 0.0 { 1.0 } else { actuator.gear }
}

impl Simulation {
    /// Everything at rest at time zero.
    pub fn new(setup: Setup<'_>, engine: Engine) -> Result<Self> {
        let Setup { hand, drives, object, collider, world_from_object, truth, path, joints, effort_nm, dt_s } = setup;
        let arm = hand_of(hand, Base::Path(path), effort_nm, truth.friction)?;
        let hold: Vec<f64> = drives.iter().map(|d| joints[d.joint] * d.gear).collect();
        let mut state = State::at_rest(world_from_object);
        state.articulations.push(arm.at_rest(joints, 0.0)?);
        let body = Body::new(&object.mass_properties, truth.mass_kg, Arc::clone(collider));
        let mut model = Model::new(vec![body]).with_articulation(arm);
        model.dt_s = dt_s;
        let mut scene = Scene::on_table(truth.friction);
        scene.controls.push(Control::constant(&hold)?);
        Ok(match engine {
            Engine::Diffsim => {
                model.check()?;
                Self::Diffsim {
                    model: Box::new(model),
                    scene: Box::new(scene),
                    state: Box::new(state),
                    work: Box::default(),
                }
            }
            #[cfg(feature = "mujoco")]
            Engine::Mujoco => {
                let mut options = drex_mujoco::MjcfOptions::default();
                options.dt_s = Some(dt_s / MUJOCO_STEPS as f64);
                let simulation = drex_mujoco::MujocoEngine::new(&model, &scene, &state, &options)?;
                Self::Mujoco { simulation: Box::new(simulation), state: Box::new(state) }
            }
            #[cfg(not(feature = "mujoco"))]
            Engine::Mujoco => return Err(Error::NoMujoco),
        })
    }

    /// One step under position commands, one per drive.
    pub fn step(&mut self, command: &[f64]) -> Result<()> {
        let control = Control::constant(command)?;
        match self {
            Self::Diffsim { model, scene, state, work } => {
                scene.controls[0] = control;
                step(model, scene, state, work).map_err(Error::from)
            }
            #[cfg(feature = "mujoco")]
            Self::Mujoco { simulation, state } => {
                simulation.set_controls(vec![control]);
                for _ in 0..MUJOCO_STEPS {
                    simulation.step()?;
                }
                **state = simulation.state();
                Ok(())
            }
        }
    }

    fn state(&self) -> &State<f64> {
        match self {
            Self::Diffsim { state, .. } => state,
            #[cfg(feature = "mujoco")]
            Self::Mujoco { state, .. } => state,
        }
    }

    /// Joint angles, model order.
    pub fn joints(&self) -> &[f64] {
        &self.state().articulations[0].q
    }

    pub fn world_from_object(&self) -> Pose {
        self.state().bodies[0].world_from_body
    }

    pub fn world_from_base(&self) -> Pose {
        self.state().articulations[0].base.world_from_base
    }

    /// Contacts of the hand in the last step that carry something, and whether the object touches the table.
    pub fn touches(&self, out: &mut Vec<Touch>) -> bool {
        out.clear();
        match self {
            Self::Diffsim { work, .. } => collect(work.contacts(), out),
            #[cfg(feature = "mujoco")]
            Self::Mujoco { simulation, .. } => collect(simulation.contacts().iter(), out),
        }
    }
}

/// Sorts contacts; true if the object touches the table.
fn collect<'a>(contacts: impl Iterator<Item = &'a ContactForce<f64>>, out: &mut Vec<Touch>) -> bool {
    let mut on_table = false;
    for c in contacts {
        let normal_n = c.force.dot(&c.normal);
        if normal_n <= 0.0 {
            continue;
        }
        let (link, with, inward) = match (c.key.a, c.key.b) {
            (Part::Body(_), Part::Link { link, .. }) => (link, Met::Object, c.normal),
            (Part::Link { link, .. }, Part::Static(_)) => (link, Met::Table, -c.normal),
            (Part::Body(_), Part::Static(_)) => {
                on_table = true;
                continue;
            }
            _ => continue,
        };
        out.push(Touch {
            link: link as usize,
            with,
            point: c.point,
            inward,
            normal_n,
            tangential_n: (c.force - c.normal * normal_n).norm(),
            depth_m: c.depth,
            slide: c.velocity - c.normal * c.velocity.dot(&c.normal),
        });
    }
    on_table
}
