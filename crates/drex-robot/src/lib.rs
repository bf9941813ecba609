//! Robot models from URDF and MJCF: forward kinematics, Jacobians, mass matrix and bias force, generic over the scalar
//! so that dual numbers pass through; fingers and palm found in the model; and two bundled hands, LEAP and Allegro.
//!
//! ```
//! use drex_robot::Robot;
//! use nalgebra::{Isometry3, Vector3};
//!
//! # fn main() -> drex_robot::Result<()> {
//! let hand = Robot::bundled("leap_right")?;
//! let q = hand.joint_vector([("if_mcp", 0.9), ("if_pip", 0.6), ("th_cmc", 1.1)])?;
//! let world_from_link = hand.forward_kinematics(&q, &Isometry3::identity());
//! for finger in hand.fingers() {
//!     let tip = world_from_link[finger.tip_link] * finger.tip_point;
//!     println!("{} tip at {:.3} {:.3} {:.3} m", finger.name, tip.x, tip.y, tip.z);
//! }
//! let holding = hand.gravity_torque(&q, &Vector3::new(0.0, 0.0, -9.81));
//! assert_eq!(holding.len(), hand.dof());
//! # Ok(()) }
//! ```
//!
//! Joints are keyed by name; a name that is not in the model is an error that lists the names there are:
//!
//! ```
//! let hand = drex_robot::Robot::bundled("allegro_right")?;
//! let error = hand.joint_vector([("index_2", 0.5)]).unwrap_err().to_string();
//! assert!(error.contains("no joint \"index_2\"") && error.contains("ffj0"));
//! # Ok::<(), drex_robot::Error>(())
//! ```
//!
//! # Conventions
//! SI units, `f64`. `a_from_b` maps coordinates in b to coordinates in a. `links[0]` is the base, and every function
//! takes its pose from the caller (`world_from_base`); [`Robot::file_world_from_base`] is what the file says. Where a
//! file holds a scene, the robot is the one body that stands on the world without a joint; the rest is remarked on in
//! [`Robot::unsupported`]. The vector of joint coordinates has the order of [`Robot::joints`]; arrays in other orders are
//! brought over by name, see [`joint_order`].
//!
#![doc = include_str!("docs/formats.md")]
//!
#![doc = include_str!("docs/hands.md")]

pub mod error;
pub mod joint_order;
pub mod model;

mod closed;
mod dynamics;
mod effort;
mod fingers;
mod kinematics;
mod load;
mod meshfile;
mod mirror;
mod mjcf;
mod samples;
mod shape;
mod unsupported;
mod urdf;
mod xml;

pub use error::{Error, Place, Result};
pub use fingers::Finger;
pub use mirror::MirrorPlane;
pub use model::{Actuator, ActuatorKind, Geom, GeomRole, Joint, JointKind, Link, Mimic, Robot, Shape};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct ReadmeDoctests;
