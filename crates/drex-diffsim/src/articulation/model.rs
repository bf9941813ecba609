//! What a robot is to the simulator: the numbers of its links, joints and drives, open for derivatives.

use std::sync::Arc;

use drex_core::Pose;
use drex_robot::{ActuatorKind as Drive, Robot};
use nalgebra::{Matrix3, Point3, Vector3};

use super::state::{ArticulationState, BaseState};
use super::{joint_error, surface};
use crate::collider::Collider;
use crate::material::Material;
use crate::path::Path;
use crate::{Error, Result, Scalar};

/// How far a joint gives before its dry friction slips, rad.
const PRESLIDING_RAD: f64 = 1e-5;
/// The same of prismatic joints, m.
const PRESLIDING_M: f64 = 1e-6;

/// A robot as the simulator needs it: a tree of rigid links in reduced coordinates.
///
/// Masses, inertias, drives, damping and friction may carry derivatives; where the joints sit is fixed by the robot.
/// Joints that a file couples (mimic, equality) move independently of one another. Set [`Articulation::base`] or any
/// number after construction and [`Articulation::check`] again.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Articulation<T: Scalar> {
    /// Names, tree and frames.
    pub robot: Arc<Robot>,
    /// Mass and inertia of each link.
    pub links: Vec<LinkInertia<T>>,
    /// What acts inside each joint.
    pub joints: Vec<JointParams<T>>,
    /// Drives, in the order of the control vector.
    pub actuators: Vec<ActuatorParams<T>>,
    /// What the base does.
    pub base: Base<T>,
    /// What of each link touches other bodies.
    pub colliders: Arc<Vec<Collider>>,
    /// The surface of each link.
    pub materials: Vec<Material<T>>,
    /// Whether links touch each other; links that [`Robot::may_collide`] excludes never do.
    pub self_collision: bool,
    /// The tree without names.
    pub(crate) tree: Arc<Vec<TreeLink>>,
}

/// Mass of a link; all zero for a link without mass.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LinkInertia<T: Scalar> {
    /// Mass, kg.
    pub mass_kg: T,
    /// Centre of mass in the link frame, m.
    pub center_of_mass: Point3<T>,
    /// Inertia about the centre of mass along the axes of the link frame, kg m²; symmetric.
    pub inertia: Matrix3<T>,
}

/// What acts inside a joint. Units: rad, N m for revolute joints, m, N for prismatic ones.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct JointParams<T: Scalar> {
    /// Inertia added by the drive, kg m² (kg).
    pub armature: T,
    /// Viscous damping, N m s/rad (N s/m).
    pub damping: T,
    /// Dry friction, N m (N).
    pub friction_loss: T,
    /// How far the joint gives under load before its dry friction slips, rad (m): the friction is a spring of
    /// stiffness friction_loss / presliding that lets go at friction_loss, so that a joint at rest does not creep.
    pub presliding: f64,
    /// Lowest and highest coordinate; `None` without limits.
    pub limits: Option<(f64, f64)>,
}

/// What a drive does with its control; position and velocity are those of the drive, gear times those of the joint.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum ActuatorKind<T> {
    /// effort = gain · control.
    Motor {
        /// Factor.
        gain: T,
    },
    /// effort = kp · (control − position) − kv · velocity.
    Position {
        /// Stiffness.
        kp: T,
        /// Damping.
        kv: T,
    },
    /// effort = kv · (control − velocity).
    Velocity {
        /// Damping.
        kv: T,
    },
    /// effort = gain · control + b₀ + b₁ · position + b₂ · velocity.
    Affine {
        /// Factor of the control.
        gain: T,
        /// b₀, b₁, b₂.
        bias: [T; 3],
    },
}

/// A drive on one joint.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ActuatorParams<T> {
    /// Name; empty if the robot gives none.
    pub name: String,
    /// Index of the joint.
    pub joint: usize,
    /// What it does.
    pub kind: ActuatorKind<T>,
    /// Lowest and highest effort before the gear, N m (N): the torque cap.
    pub force_range: Option<(T, T)>,
    /// Controls are brought into this range.
    pub ctrl_range: Option<(f64, f64)>,
    /// Ratio: the joint's effort is gear times that of the drive.
    pub gear: T,
}

/// What holds the base of a robot.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Base<T: Scalar> {
    /// It stands at this pose (world_from_base).
    Fixed(Pose<T>),
    /// It follows a path, whatever acts on it.
    Path(Path),
    /// Nothing: it moves as forces make it.
    Free,
}

/// One link of the tree as the recursions need it.
#[derive(Debug, Clone)]
pub(crate) struct TreeLink {
    pub parent: Option<usize>,
    pub parent_from_link: Pose,
    /// The joint that moves this link.
    pub joint: Option<TreeJoint>,
    /// The joint that moves this link or the nearest one up the tree.
    pub driver: Option<usize>,
}

/// One joint of the tree.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TreeJoint {
    pub index: usize,
    pub prismatic: bool,
    pub axis: Vector3<f64>,
    /// A point on the axis, unless that is the link's origin.
    pub anchor: Option<Vector3<f64>>,
    pub reference: f64,
    /// The next joint up the tree.
    pub above: Option<usize>,
}

impl Articulation<f64> {
    /// The robot with the numbers of its file on the given base.
    ///
    /// # Errors
    /// If a number cannot be simulated ([`Articulation::check`]).
    pub fn new(robot: Arc<Robot>, base: Base<f64>) -> Result<Self> {
        let tree = Arc::new(tree(&robot)?);
        let links = robot.links.iter().map(|link| match &link.inertial {
            Some(m) => LinkInertia { mass_kg: m.mass_kg, center_of_mass: m.center_of_mass, inertia: m.inertia },
            None => LinkInertia { mass_kg: 0.0, center_of_mass: Point3::origin(), inertia: Matrix3::zeros() },
        });
        let joints = robot.joints.iter().map(|j| JointParams {
            armature: j.armature,
            damping: j.damping,
            friction_loss: j.friction_loss,
            presliding: if is_prismatic(j) { PRESLIDING_M } else { PRESLIDING_RAD },
            limits: j.limits,
        });
        let actuators = robot.actuators.iter().map(|a| {
            let kind = match a.kind {
                Drive::Motor { gain } => ActuatorKind::Motor { gain },
                Drive::Position { kp, kv } => ActuatorKind::Position { kp, kv },
                Drive::Velocity { kv } => ActuatorKind::Velocity { kv },
                Drive::Affine { gain, bias } => ActuatorKind::Affine { gain, bias },
                _ => {
                    let joint = robot.joints.get(a.joint).map_or("", |j| j.name.as_str());
                    return Err(joint_error(
                        &robot,
                        joint,
                        format!("drive \"{}\" is of an unknown kind", a.name),
                        "drop it",
                    ));
                }
            };
            let (force_range, ctrl_range) = (a.force_range, a.ctrl_range);
            Ok(ActuatorParams { name: a.name.clone(), joint: a.joint, kind, force_range, ctrl_range, gear: a.gear })
        });
        let (links, joints, actuators) = (links.collect(), joints.collect(), actuators.collect::<Result<_>>()?);
        let colliders = Arc::new(surface::colliders(&robot)?);
        let materials = surface::materials(&robot);
        let out = Self { robot, links, joints, actuators, base, colliders, materials, self_collision: false, tree };
        out.check()?;
        Ok(out)
    }

    /// The same robot for another scalar, without derivatives; parameters are then set on the copy.
    pub fn lift<T: Scalar>(&self) -> Articulation<T> {
        self.map(|x| T::lift(*x))
    }
}

impl<T: Scalar> Articulation<T> {
    /// Every number that may carry derivatives passed through `f`.
    pub fn map<U: Scalar>(&self, f: impl Fn(&T) -> U) -> Articulation<U> {
        let links = self.links.iter().map(|l| LinkInertia {
            mass_kg: f(&l.mass_kg),
            center_of_mass: Point3::from(l.center_of_mass.coords.map(|x| f(&x))),
            inertia: l.inertia.map(|x| f(&x)),
        });
        let joints = self.joints.iter().map(|j| JointParams {
            armature: f(&j.armature),
            damping: f(&j.damping),
            friction_loss: f(&j.friction_loss),
            presliding: j.presliding,
            limits: j.limits,
        });
        let actuators = self.actuators.iter().map(|a| ActuatorParams {
            name: a.name.clone(),
            joint: a.joint,
            kind: match &a.kind {
                ActuatorKind::Motor { gain } => ActuatorKind::Motor { gain: f(gain) },
                ActuatorKind::Position { kp, kv } => ActuatorKind::Position { kp: f(kp), kv: f(kv) },
                ActuatorKind::Velocity { kv } => ActuatorKind::Velocity { kv: f(kv) },
                ActuatorKind::Affine { gain, bias } => {
                    ActuatorKind::Affine { gain: f(gain), bias: [f(&bias[0]), f(&bias[1]), f(&bias[2])] }
                }
            },
            force_range: a.force_range.as_ref().map(|(lo, hi)| (f(lo), f(hi))),
            ctrl_range: a.ctrl_range,
            gear: f(&a.gear),
        });
        Articulation {
            robot: self.robot.clone(),
            links: links.collect(),
            joints: joints.collect(),
            actuators: actuators.collect(),
            base: match &self.base {
                Base::Fixed(pose) => Base::Fixed(map_pose(pose, &f)),
                Base::Path(path) => Base::Path(path.clone()),
                Base::Free => Base::Free,
            },
            colliders: self.colliders.clone(),
            materials: self
                .materials
                .iter()
                .map(|m| Material { friction: f(&m.friction), torsion_radius_m: m.torsion_radius_m })
                .collect(),
            self_collision: self.self_collision,
            tree: self.tree.clone(),
        }
    }

    /// Number of generalised velocities: six for a free base, then one per joint.
    pub fn dof(&self) -> usize {
        self.base_dof() + self.joints.len()
    }

    /// Six if the base is free, else zero.
    pub fn base_dof(&self) -> usize {
        if matches!(self.base, Base::Free) { 6 } else { 0 }
    }

    /// At rest at the joint vector `q` and time `time_s`: the joints do not move, a base on a path moves with it. A free
    /// base starts at the pose that the robot's file gives; set it in the state for another.
    ///
    /// # Errors
    /// If `q` has not one finite number per joint.
    pub fn at_rest(&self, q: &[T], time_s: f64) -> Result<ArticulationState<T>> {
        let base = match &self.base {
            Base::Free => BaseState::at_rest(map_pose(&self.robot.file_world_from_base, |x| T::lift(*x))),
            _ => self.prescribed_base(time_s),
        };
        let zero = || vec![T::zero(); q.len()];
        let state = ArticulationState { base, q: q.to_vec(), velocities: zero(), friction: zero() };
        self.check_state(&state)?;
        Ok(state)
    }

    /// Pose and velocity of a fixed base, or of a base on a path, at time t in seconds; rest at the origin for a free base.
    pub fn prescribed_base(&self, t: f64) -> BaseState<T> {
        match &self.base {
            Base::Fixed(pose) => BaseState::at_rest(*pose),
            Base::Free => BaseState::at_rest(Pose::identity()),
            Base::Path(path) => {
                let p = path.at(t);
                BaseState {
                    world_from_base: map_pose(&p.pose, |x| T::lift(*x)),
                    velocity: p.velocity.map(T::lift),
                    angular_velocity: p.angular_velocity.map(T::lift),
                }
            }
        }
    }
}

impl<T: Scalar> Articulation<T> {
    /// The same friction on all links.
    pub fn with_friction(mut self, friction: T) -> Self {
        self.materials.iter_mut().for_each(|m| m.friction = friction);
        self
    }

    /// Soft skin on all links: the radius of the ring on which a point of contact spreads, metres. See
    /// [`Material::torsion_radius_m`].
    pub fn with_torsion_radius(mut self, radius_m: f64) -> Self {
        self.materials.iter_mut().for_each(|m| m.torsion_radius_m = radius_m);
        self
    }

    /// The mass that scales the contact stiffness of a link where no free body takes part: its own, or the mean of all
    /// links for a link without mass.
    pub(crate) fn contact_mass(&self, link: usize) -> T {
        let own = self.links[link].mass_kg;
        if own.value() > 0.0 {
            return own;
        }
        let (mut sum, mut count) = (T::zero(), 0.0);
        for m in self.links.iter().map(|l| l.mass_kg).filter(|m| m.value() > 0.0) {
            sum += m;
            count += 1.0;
        }
        if count > 0.0 { sum * T::lift(1.0 / count) } else { T::one() }
    }
}

/// A pose with every number passed through `f`.
pub(crate) fn map_pose<T: Scalar, U: Scalar>(pose: &Pose<T>, f: impl Fn(&T) -> U) -> Pose<U> {
    let q = pose.rotation.quaternion().coords.map(|x| f(&x));
    Pose::from_parts(pose.translation.vector.map(|x| f(&x)).into(), nalgebra::UnitQuaternion::new_unchecked(q.into()))
}

fn is_prismatic(joint: &drex_robot::Joint) -> bool {
    joint.kind == drex_robot::JointKind::Prismatic
}

/// The tree of a robot. Checks what the recursions rely on.
fn tree(robot: &Robot) -> Result<Vec<TreeLink>> {
    let broken = |what: String| Error::Joint {
        robot: robot.name.clone(),
        joint: String::new(),
        what,
        remedy: "read the robot from a file again".into(),
    };
    let mut out: Vec<TreeLink> = Vec::with_capacity(robot.links.len());
    for (i, link) in robot.links.iter().enumerate() {
        let above = match link.parent {
            Some(p) if p < i => out[p].driver,
            None if i == 0 => None,
            _ => return Err(broken(format!("link \"{}\" does not come after its parent", link.name))),
        };
        let joint = match link.joints[..] {
            [] => None,
            [index] if i > 0 && robot.joints.get(index).is_some_and(|j| j.link == i) => {
                let j = &robot.joints[index];
                let anchor = (j.anchor.coords != Vector3::zeros()).then_some(j.anchor.coords);
                let prismatic = is_prismatic(j);
                Some(TreeJoint { index, prismatic, axis: j.axis, anchor, reference: j.reference, above })
            }
            _ => return Err(broken(format!("link \"{}\" does not have one joint of its own at most", link.name))),
        };
        let driver = joint.map_or(above, |j| Some(j.index));
        out.push(TreeLink { parent: link.parent, parent_from_link: link.parent_from_link, joint, driver });
    }
    if out.is_empty() || (0..robot.joints.len()).any(|j| !out.iter().any(|l| l.joint.is_some_and(|t| t.index == j))) {
        return Err(broken("it has no links, or a joint that moves none".into()));
    }
    Ok(out)
}
