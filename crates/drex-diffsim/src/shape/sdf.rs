//! A solid given by signed distance.

use std::fmt;
use std::sync::Arc;

use drex_core::{SdfSample, SignedDistance};
use nalgebra::Point3;

use crate::{Error, Result};

/// A solid given by signed distance, in its own frame.
#[derive(Clone)]
pub struct SdfShape {
    distance: Arc<dyn SignedDistance>,
    bounds: (Point3<f64>, Point3<f64>),
    resolution_m: f64,
}

impl fmt::Debug for SdfShape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SdfShape").field("bounds", &self.bounds).field("resolution_m", &self.resolution_m).finish()
    }
}

impl SdfShape {
    /// A solid inside the box `bounds` (lower and upper corner). `resolution_m` is the size of its smallest detail, as
    /// the spacing of a grid: edges of other bodies are sampled at this distance, and the curvature of the surface is
    /// taken over a tenth of it.
    ///
    /// # Errors
    /// If the box is not finite or empty, or the resolution not positive.
    pub fn new(
        distance: Arc<dyn SignedDistance>,
        bounds: (Point3<f64>, Point3<f64>),
        resolution_m: f64,
    ) -> Result<Self> {
        if bounds.0.iter().chain(bounds.1.iter()).any(|x| !x.is_finite()) {
            return Err(Error::NotFinite { what: "a bound of a signed distance".into() });
        }
        if (0..3).any(|k| bounds.0[k] >= bounds.1[k]) {
            return Err(Error::Shape {
                what: format!("a signed distance with bounds from {} to {} holds nothing", bounds.0, bounds.1),
                remedy: "give the lower corner first, then the upper one, in metres".into(),
            });
        }
        if !(resolution_m.is_finite() && resolution_m > 0.0) {
            return Err(Error::Shape {
                what: format!("the resolution of a signed distance is {resolution_m} m"),
                remedy: "give its grid spacing or smallest detail in metres".into(),
            });
        }
        Ok(Self { distance, bounds, resolution_m })
    }

    /// Lower and upper corner of the box that holds the solid, metres.
    pub fn bounds(&self) -> (Point3<f64>, Point3<f64>) {
        self.bounds
    }

    /// Size of the smallest detail, metres.
    pub fn resolution_m(&self) -> f64 {
        self.resolution_m
    }

    /// Signed distance and unit gradient at a point of the shape's frame.
    pub fn sample(&self, point: &Point3<f64>) -> SdfSample {
        self.distance.signed_distance(point)
    }
}
