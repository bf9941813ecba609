//! A rigid-body simulator whose every number may be a dual number: motion and its derivatives in one pass.
//!
//! [`Model`] says what is simulated (free bodies and robots), [`Scene`] where (gravity, surroundings, forces, controls),
//! [`State`] from where; [`step`] and [`rollout`] do it. On [`Dual`] numbers a rollout returns exact derivatives of every
//! recorded pose by mass, friction, centre of mass, stiffness, drive gains or start pose.
//!
//! ```
//! use std::sync::Arc;
//! use drex_core::{MassProperties, Pose};
//! use drex_diffsim::{
//!     AppliedForce, Body, Collider, Dual, ForcePoint, Geom, Model, Part, Scene, Shape, State, parameter, rollout, tangents,
//! };
//! use nalgebra::{Matrix3, Point3, Vector3};
//!
//! // A 4 cm cube of 0.2 kg, lifted by 3 N: how does its height after 0.1 s depend on ln m?
//! let cube = Arc::new(Collider::new(&[Geom::new(Shape::Box { half_m: Vector3::repeat(0.02) })])?);
//! let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia: Matrix3::identity() * 2.667e-4 };
//! let mass = parameter::<1>(0.2_f64.ln(), 0).exp();
//! let model = Model::new(vec![Body::new(&unit, mass, cube)]);
//! let mut scene = Scene::on_table(Dual::from_re(0.5));
//! let at = ForcePoint::Body(Point3::origin());
//! scene.forces.push(AppliedForce::new(Part::Body(0), &[0.0, 0.1], &[Vector3::z() * 3.0; 2], at)?);
//! let start = State::at_rest(Pose::translation(0.0, 0.0, 0.02).cast());
//! let end = rollout(&model, &scene, &start, &[0.1])?.bodies[0].poses[0].translation.vector.z;
//! assert!((end.re - (0.02 + 0.5 * (3.0 / 0.2 - 9.81) * 0.01)).abs() < 2e-4);
//! assert!((tangents(&end)[0] + 0.5 * 3.0 / 0.2 * 0.01).abs() < 1e-3);
//! # Ok::<(), drex_diffsim::Error>(())
//! ```
//!
//! # Conventions
//! SI units, world z up; a pose is `world_from_body` of the body's (mesh) frame; velocities are those of the centre of
//! mass in the world. The generalised velocity of a robot is that of its base (if it is free), then one per joint.
//!
//! # The step
//! Semi-implicit Euler with implicit contact: M (u⁺ - ũ) = h Σ Jᵀ f(u⁺) is solved for the velocities u⁺ at the end of the
//! step, where ũ is what smooth forces alone would lead to and f are the laws of contacts, drives, joint friction and
//! stops; then poses move with u⁺. Newton's method on plain numbers solves it, island by island; derivatives follow from
//! the converged equations (implicit function theorem).
//!
#![doc = include_str!("docs/derivatives.md")]

mod articulation;
mod collide;
mod collider;
mod contact;
mod contact_options;
mod error;
mod material;
mod math;
mod model;
mod path;
mod rollout;
mod scalar;
mod scene;
mod series;
mod shape;
mod solve;
mod state;
mod step;

pub use articulation::{
    ActuatorKind, ActuatorParams, Articulation, ArticulationState, Base, BaseState, JointParams, LinkInertia,
};
pub use collider::Collider;
pub use contact::{ContactForce, ContactKey, Part};
pub use contact_options::{ContactOptions, SoftContact};
pub use error::{Error, Result};
pub use material::Material;
#[cfg(feature = "ablation")]
pub use model::Scheme;
pub use model::{Body, Method, Model};
pub use path::{Motion, Path};
pub use rollout::{Job, Record, Track, check, record, rollout, rollout_batch};
pub use scalar::{Dual, Scalar, parameter, tangents};
pub use scene::{AppliedForce, Control, ForcePoint, KinematicBody, Scene, StaticBody};
pub use shape::{ConvexPolyhedron, Geom, SdfShape, Shape, SurfacePoints};
pub use state::{Anchor, BodyState, State};
pub use step::{Workspace, step};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
