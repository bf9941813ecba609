//! Fingers found in the tree: one serial chain per branch off the palm.

use nalgebra::{Point3, Vector3};

use crate::model::Robot;

/// One finger.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Finger {
    /// Common beginning of the link names (`index`), or the name of the first link.
    pub name: String,
    /// Links from the one on the palm to the tip.
    pub links: Vec<usize>,
    /// Joints from the palm to the tip.
    pub joints: Vec<usize>,
    /// The last link.
    pub tip_link: usize,
    /// The fingertip in the frame of `tip_link`, m.
    pub tip_point: Point3<f64>,
    /// Whether this is the thumb.
    pub is_thumb: bool,
}

impl Robot {
    /// The fingers.
    pub fn fingers(&self) -> Vec<Finger> {
        Vec::new()
    }

    /// The link that the fingers branch off, if there are at least two fingers.
    pub fn palm_link(&self) -> Option<usize> {
        None
    }

    /// Unit vector out of the palm, towards what the hand would hold, in the frame of [`Robot::palm_link`].
    pub fn palm_normal(&self) -> Option<Vector3<f64>> {
        None
    }

    /// Where the hand would hold a thing: mean of the fingertips at mid-range, in the frame of [`Robot::palm_link`], m.
    pub fn grasp_center(&self) -> Option<Point3<f64>> {
        None
    }
}
