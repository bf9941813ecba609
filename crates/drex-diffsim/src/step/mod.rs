//! Stepping in time.

#[cfg(feature = "ablation")]
pub(crate) mod ablation;
mod frames;
mod implicit;
pub(crate) mod pairs;

pub(crate) use frames::begin;
use nalgebra::{Matrix3, Vector3};

use crate::articulation::{JointForce, LinkForce, TreeWork};
use crate::collide::{CollideWork, Frame, Touch};
use crate::contact::{Contact, ContactForce};
use crate::solve::contact_model::ContactModel;
use crate::solve::free::{self, Lever};
use crate::solve::island::{Island, Solver};
use crate::state::Anchor;
use crate::{Method, Model, Result, Scalar, Scene, State};

/// Buffers that a step reuses, and what the last step did. Nothing in it influences the next step.
#[derive(Debug)]
pub struct Workspace<T: Scalar> {
    pub(crate) frames: Vec<BodyFrame<T>>,
    pub(crate) trees: Vec<TreeWork<T>>,
    /// Motions of the kinematic bodies at the start of the step.
    pub(crate) motions: Vec<crate::Motion>,
    pub(crate) collide: CollideWork,
    pub(crate) touches: Vec<Touch>,
    pub(crate) contacts: Vec<Contact<T>>,
    pub(crate) forces: Vec<ContactForce<T>>,
    /// Whether nobody asks for [`Workspace::contacts`].
    pub(crate) forgets_forces: bool,
    pub(crate) anchors: Vec<Anchor<T>>,
    /// Island of each unit (articulations, then bodies): index of the first unit in it.
    islands: Vec<usize>,
    pub(crate) models: Vec<ContactModel<T>>,
    levers: Vec<Lever<T>>,
    buffers: free::Buffers,
    island: Island<T>,
    solver: Solver<T>,
    mass: Vec<T>,
    bias: Vec<T>,
    external: Vec<LinkForce<T>>,
    /// Forces of the joints, per articulation.
    joint_forces: Vec<Vec<JointForce<T>>>,
    /// First velocity of each unit in its island.
    offsets: Vec<usize>,
    #[cfg(feature = "ablation")]
    pub(crate) ablation: ablation::Buffers<T>,
    unconverged: usize,
}

impl<T: Scalar> Default for Workspace<T> {
    fn default() -> Self {
        Self {
            frames: Vec::new(),
            trees: Vec::new(),
            motions: Vec::new(),
            collide: CollideWork::default(),
            touches: Vec::new(),
            contacts: Vec::new(),
            forces: Vec::new(),
            forgets_forces: false,
            anchors: Vec::new(),
            islands: Vec::new(),
            models: Vec::new(),
            levers: Vec::new(),
            buffers: free::Buffers::default(),
            island: Island::default(),
            solver: Solver::default(),
            mass: Vec::new(),
            bias: Vec::new(),
            external: Vec::new(),
            joint_forces: Vec::new(),
            offsets: Vec::new(),
            #[cfg(feature = "ablation")]
            ablation: ablation::Buffers::default(),
            unconverged: 0,
        }
    }
}

impl<T: Scalar> Workspace<T> {
    /// Contacts of the last step that carry something: where, between what, and with which force.
    pub fn contacts(&self) -> impl Iterator<Item = &ContactForce<T>> {
        self.forces.iter().filter(|c| c.force.iter().any(|f| f.value() != 0.0))
    }

    /// Steps so far in which the contact equations were not solved to full precision.
    pub fn unconverged_steps(&self) -> usize {
        self.unconverged
    }
}

/// A free body at the start of a step.
#[derive(Debug, Clone)]
pub(crate) struct BodyFrame<T: Scalar> {
    /// Pose of the body's frame, and the same without derivatives.
    pub frame: Frame<T>,
    pub plain: Frame<f64>,
    /// Centre of mass, world.
    pub com: Vector3<T>,
    /// Inertia per unit mass about it, world.
    pub inertia: Matrix3<T>,
    /// Velocities at the end of the step if nothing touches.
    pub free: (Vector3<T>, Vector3<T>),
    /// How fast a point of it can move, m/s.
    pub speed: f64,
}

/// One step.
///
/// Semi-implicit Euler: forces at the old pose, new velocities, and with these the new pose. Contact forces, friction,
/// actuators and joint damping are found together with the velocities they lead to (implicit in the velocity). The
/// gyroscopic moment is taken at the new angular velocity (one Newton step in the body's frame), orientation moves by
/// the exponential map.
///
/// # Errors
/// If the state does not fit the model or is not finite, the time step is out of range, a control does not fit its
/// articulation, or the motion diverges. Masses, constants and scene are checked by [`crate::rollout`] alone, or by
/// [`Model::check`].
pub fn step<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
) -> Result<()> {
    model.check_step()?;
    state.check(model)?;
    match model.method {
        Method::SemiImplicit => implicit::step(model, scene, state, work)?,
        #[cfg(feature = "ablation")]
        Method::Penalty { scheme, substeps } => ablation::penalty::step(model, scene, state, work, scheme, substeps)?,
        #[cfg(feature = "ablation")]
        Method::PositionBased { substeps } => ablation::position_based::step(model, scene, state, work, substeps)?,
    }
    state.time_s += model.dt_s;
    frames::check_speeds(state)
}
