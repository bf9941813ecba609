//! A small rigid-body simulator whose every number may be a dual number: motion and its derivatives in one pass.
//!
//! It pushes, tips, lifts and drops free rigid bodies on a table and on fixed boxes. Contact is compliant and scaled
//! with the mass, friction sticks without creep, and a rollout on [`Dual`] numbers returns exact derivatives of every
//! recorded pose by mass, friction, centre of mass or start pose.
//!
//! ```
//! use std::sync::Arc;
//! use drex_core::{MassProperties, Pose};
//! use drex_diffsim::{AppliedForce, Body, Collider, ConvexPiece, Dual, ForcePoint, Model, Part, Scene, State, parameter, rollout, tangents};
//! use nalgebra::{ComplexField, Matrix3, Point3, Vector3};
//!
//! // A 4 cm cube of 0.2 kg, lifted by 3 N: how does its height after 0.1 s depend on ln m?
//! let corners: Vec<_> = (0..8).map(|i| Point3::new(
//!     0.02 * (2.0 * f64::from(i & 1) - 1.0), 0.02 * (f64::from(i & 2) - 1.0), 0.02 * (0.5 * f64::from(i & 4) - 1.0))).collect();
//! let cube = Arc::new(Collider::convex(vec![ConvexPiece::from_points(&corners)?]));
//! let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia: Matrix3::identity() * 2.667e-4 };
//! let mass = parameter::<1>(0.2_f64.ln(), 0).exp();
//! let model = Model::new(vec![Body::new(&unit, mass, cube)]);
//! let mut scene = Scene::on_table(Dual::from_re(0.5));
//! scene.forces.push(AppliedForce::new(Part::Body(0), &[0.0, 0.1], &[Vector3::z() * 3.0; 2], ForcePoint::Body(Point3::origin()))?);
//! let start = State::at_rest(Pose::translation(0.0, 0.0, 0.02).cast());
//! let end = rollout(&model, &scene, &start, &[0.1])?.bodies[0].poses[0].translation.vector.z;
//! assert!((end.re - (0.02 + 0.5 * (3.0 / 0.2 - 9.81) * 0.01)).abs() < 2e-4);
//! assert!((tangents(&end)[0] + 0.5 * 3.0 / 0.2 * 0.01).abs() < 1e-3);
//! # Ok::<(), drex_diffsim::SimError>(())
//! ```
//!
//! # Conventions
//! SI units, world z up; a pose is `world_from_body` of the body's (mesh) frame; velocities are those of the centre of
//! mass in the world. Derivatives are those of the branch that the values take: at the instant a contact opens, closes
//! or begins to slip, the motion has a kink, and its derivative is the one-sided one.

mod articulation;
mod collide;
mod collider;
mod contact;
mod error;
mod math;
mod model;
pub mod mujoco;
mod pairs;
mod penalty;
mod position_based;
mod rollout;
mod scalar;
mod scene;
mod shape;
mod sim;
mod solve;
mod state;

pub use articulation::{ActuatorKind, ActuatorParams, ArmState, Articulation, Base, BasePath, BaseState, JointParams, LinkInertia};
pub use collider::Collider;
pub use contact::{ContactForce, ContactKey, Part};
pub use error::{Result, SimError};
pub use model::{Body, ContactOptions, Material, Method, Model, Scheme};
pub use rollout::{Job, Record, Track, rollout, rollout_batch};
pub use scalar::{Dual, Scalar, parameter, tangents};
pub use scene::{AppliedForce, Control, Fixed, ForcePoint, Motion, Mover, Path, Scene};
pub use shape::{ConvexPiece, Geom, SdfShape, Shape, SurfacePoints};
pub use sim::{Workspace, step};
pub use state::{Anchor, BodyState, State};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
