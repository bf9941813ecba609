//! From a reconstruction in arbitrary scale and axes to metres with z up: known distances, a sheet of marks, the table.

mod marks;
mod plane;
mod similarity;
mod triangulate;

pub use marks::{
    DistanceResidual, KnownDistance, Marks, ScaleFit, read_marks, scale_from_distances, sheet_from_marks,
    triangulate_marks,
};
pub use plane::TablePlane;
pub use similarity::Similarity;
pub use triangulate::{Sighting, Triangulated, triangulate};
