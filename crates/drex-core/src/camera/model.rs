//! Names, ids and parameters of COLMAP's camera models.

use std::fmt;
use std::str::FromStr;

use crate::{Error, Result};

/// A lens model of COLMAP. The discriminant is COLMAP's id.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum CameraModel {
    /// f, cx, cy.
    SimplePinhole = 0,
    /// fx, fy, cx, cy.
    Pinhole = 1,
    /// f, cx, cy, k.
    SimpleRadial = 2,
    /// f, cx, cy, k1, k2.
    Radial = 3,
    /// fx, fy, cx, cy, k1, k2, p1, p2.
    OpenCv = 4,
    /// fx, fy, cx, cy, k1, k2, k3, k4.
    OpenCvFisheye = 5,
    /// fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6.
    FullOpenCv = 6,
    /// fx, fy, cx, cy, omega.
    Fov = 7,
    /// f, cx, cy, k.
    SimpleRadialFisheye = 8,
    /// f, cx, cy, k1, k2.
    RadialFisheye = 9,
    /// fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, sx1, sy1.
    ThinPrismFisheye = 10,
}

impl CameraModel {
    /// All models, by id.
    pub const ALL: [Self; 11] = [
        Self::SimplePinhole,
        Self::Pinhole,
        Self::SimpleRadial,
        Self::Radial,
        Self::OpenCv,
        Self::OpenCvFisheye,
        Self::FullOpenCv,
        Self::Fov,
        Self::SimpleRadialFisheye,
        Self::RadialFisheye,
        Self::ThinPrismFisheye,
    ];

    /// The model with COLMAP's `id`.
    ///
    /// # Errors
    /// If there is none.
    pub fn from_id(id: i32) -> Result<Self> {
        Self::ALL.into_iter().find(|m| *m as i32 == id).ok_or_else(|| {
            Error::value(
                format!("camera model id {id} is not known"),
                "export the reconstruction with one of COLMAP's models 0 to 10",
            )
        })
    }

    /// COLMAP's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::SimplePinhole => "SIMPLE_PINHOLE",
            Self::Pinhole => "PINHOLE",
            Self::SimpleRadial => "SIMPLE_RADIAL",
            Self::Radial => "RADIAL",
            Self::OpenCv => "OPENCV",
            Self::OpenCvFisheye => "OPENCV_FISHEYE",
            Self::FullOpenCv => "FULL_OPENCV",
            Self::Fov => "FOV",
            Self::SimpleRadialFisheye => "SIMPLE_RADIAL_FISHEYE",
            Self::RadialFisheye => "RADIAL_FISHEYE",
            Self::ThinPrismFisheye => "THIN_PRISM_FISHEYE",
        }
    }

    /// Names of the parameters in COLMAP's order; focal lengths and principal point are in pixels.
    pub fn parameter_names(self) -> &'static [&'static str] {
        match self {
            Self::SimplePinhole => &["f", "cx", "cy"],
            Self::Pinhole => &["fx", "fy", "cx", "cy"],
            Self::SimpleRadial | Self::SimpleRadialFisheye => &["f", "cx", "cy", "k"],
            Self::Radial | Self::RadialFisheye => &["f", "cx", "cy", "k1", "k2"],
            Self::OpenCv => &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"],
            Self::OpenCvFisheye => &["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"],
            Self::FullOpenCv => &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
            Self::Fov => &["fx", "fy", "cx", "cy", "omega"],
            Self::ThinPrismFisheye => &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"],
        }
    }
}

impl FromStr for CameraModel {
    type Err = Error;

    fn from_str(s: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|m| m.name() == s).ok_or_else(|| {
            let known = Self::ALL.map(Self::name).join(", ");
            Error::value(format!("camera model `{s}` is not known"), format!("use one of {known}"))
        })
    }
}

impl fmt::Display for CameraModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
