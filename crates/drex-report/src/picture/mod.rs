//! Pictures for the report: a small z-buffered renderer and SVG plots. No GPU, no fonts, no network.

pub mod clip;
pub mod hand;
pub mod histogram;
pub mod plot;
pub mod raster;
pub mod sheet;
pub mod surface;
