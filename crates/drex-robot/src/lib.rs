//! Robot models from URDF and MJCF: kinematics, Jacobians, mass matrix; bundled LEAP and Allegro hands.

pub mod error;
pub mod model;
pub mod orders;

mod dynamics;
mod fingers;
mod kinematics;
mod load;
mod meshfile;
mod mjcf;
mod samples;
mod shape;
mod unread;
mod urdf;
mod xml;

pub use error::{Error, Result};
pub use fingers::Finger;
pub use model::{Actuator, ActuatorKind, Geom, GeomRole, Joint, JointKind, Link, Mimic, Robot, Shape};
