//! The bench: objects, demonstrations, and experiments that say how well the policy grasps.

pub mod bound;
pub mod cell;
pub mod experiments;
pub mod judge;
pub mod learned;
pub mod library;
pub mod objects;
pub mod people;
pub mod postures;
pub mod practice;
pub mod shapes;
pub mod table;
pub mod thing;
pub mod wraps;
