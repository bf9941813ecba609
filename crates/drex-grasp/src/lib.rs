//! Contacts between a hand and an object: grasp map, force closure, the minimum grip force.
//!
//! ```
//! use drex_grasp::{Contact, GripForceProblem, minimum_grip_force};
//! use nalgebra::{Point3, Vector3};
//!
//! // Two fingers pinch a 206 g box from both sides, friction 0.5.
//! let left = Contact::new(Point3::new(-0.03, 0.0, 0.0), Vector3::x(), 0.5);
//! let right = Contact::new(Point3::new(0.03, 0.0, 0.0), -Vector3::x(), 0.5);
//! let gravity = Vector3::new(0.0, 0.0, -9.81);
//! let grip_force = minimum_grip_force(&GripForceProblem::new(vec![left, right], 0.206, Point3::origin(), gravity))?;
//! assert!((grip_force.normal_n[0] - 0.206 * 9.81 / (2.0 * 0.5)).abs() < 1e-5); // m g / (2 mu)
//! # Ok::<(), drex_grasp::GripForceError>(())
//! ```
//!
//! # Conventions
//! Points, normals and forces are in the object's frame, SI units. A contact's normal points *into* the object; a contact
//! force is the force of the hand *on* the object. Robot joint values are in the model's order.

#![allow(clippy::neg_cmp_op_on_partial_ord)] // `!(x >= 0.0)` refuses NaN, `x < 0.0` does not

mod balance;
mod ball;
mod closure;
mod cone;
mod contact;
mod distribute;
mod error;
mod evaluation;
mod find;
mod grasp;
mod grip_force;
mod grip_force_policy;
mod hand;
mod load_bound;
mod loads;
mod pinch;
mod power;
mod problem;
mod rolling;
mod synthesis;

pub use closure::{ClosureOptions, ForceClosure, force_closure, is_force_closed, min_weight};
pub use contact::{Contact, characteristic_length_m, grasp_map};
pub use distribute::{Distribution, distribute, maximum_grip_force};
pub use error::{GraspError, Result};
pub use evaluation::{EvaluationOptions, FingerContacts, GraspEvaluation, evaluate, evaluate_with};
pub use find::{ContactOptions, find_contacts};
pub use grasp::{Grasp, GraspChange, GraspContact, GraspOrigin, OriginCounts};
pub use grip_force::{GripForceError, GripForceSolution, minimum_grip_force, smallest_forces};
pub use grip_force_policy::{ForceCommand, GripForcePolicy, PAPER_FORCE_LIMIT_N, paper_force};
pub use hand::{HandSurface, LinkSurface, SelfCollision};
pub use load_bound::{least_friction, least_friction_index};
pub use loads::{required_grip_force, shake_loads};
pub use pinch::pinch_grasps;
pub use power::{FingerClosing, abduction_joints, power_grasps};
pub use problem::{GripForceProblem, TorqueLimits};
pub use rolling::{Rolling, RollingError, RollingPath, RollingWaypoint, rolling_path};
pub use synthesis::synthesize_grasps;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
