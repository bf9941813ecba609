//! Random objects for experiments ([`generate`]: boxes, cylinders, letters and bottles, solid, hollow and off-centre) and random twin folders
//! ([`twins`]).
//!
//! ```
//! use drex_bench::generate::{MassClass, random_object};
//!
//! let cup = random_object(900, 3, MassClass::Hollow);
//! let center = cup.mass_properties.center_of_mass;
//! println!("{}: {:.0} g, centre of mass {center}", cup.name, 1e3 * cup.mass_properties.mass_kg);
//! # assert!(cup.mass_properties.is_physical());
//! ```
//!
//! Units are SI. The frame of an object has its origin in the middle of the bounding box and z up while the object stands.
//!
//! The experiments themselves are the program of the same name.

pub mod generate;
pub mod tin;
pub mod twins;
