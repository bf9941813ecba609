//! Cameras and sparse points from photos of an object, or a verdict that says why not.

pub mod marker;
