//! Scenes that move: a still background, and objects whose Gaussians are bound to rigid bodies.

use drex_core::{Pose, Trajectory};
use nalgebra::Similarity3;

use crate::{Error, Gaussians, Result};

/// Gaussians that move with a rigid body.
#[derive(Debug, Clone)]
pub struct Attachment {
    /// The object in the body's frame, metres.
    pub gaussians: Gaussians,
    /// Poses of the body in the scene's frame over time.
    pub world_from_body: Trajectory,
}

impl Attachment {
    /// Binds `gaussians`, which are in a frame and unit of their own, to a body whose frame they reach by
    /// `body_from_splat` (its scale is metres per unit of the Gaussians).
    ///
    /// # Errors
    /// If the transform is not finite, its scale is not positive, or the trajectory has no poses.
    pub fn new(gaussians: &Gaussians, body_from_splat: &Similarity3<f64>, world_from_body: Trajectory) -> Result<Self> {
        if world_from_body.is_empty() {
            return Err(Error::Option {
                what: "a body has a trajectory without poses".into(),
                remedy: "give a trajectory with at least one pose".into(),
            });
        }
        Ok(Self { gaussians: gaussians.transformed(body_from_splat)?, world_from_body })
    }

    /// Where the body is at `t_s`, seconds: at rest before the first and after the last pose.
    pub fn pose(&self, t_s: f64) -> Option<Pose> {
        let (first, last) = self.world_from_body.span_s()?;
        self.world_from_body.at(t_s.clamp(first, last))
    }
}

/// A still background with moving objects, all of one kind.
#[derive(Debug, Clone)]
pub struct Scene {
    /// What does not move, world frame, metres.
    pub background: Gaussians,
    /// What moves.
    pub objects: Vec<Attachment>,
}

impl Scene {
    /// First and last time at which something moves, seconds; `None` without objects.
    pub fn span_s(&self) -> Option<(f64, f64)> {
        let spans = self.objects.iter().filter_map(|o| o.world_from_body.span_s());
        spans.reduce(|(a, b), (c, d)| (a.min(c), b.max(d)))
    }

    /// Everything at time `t_s`, world frame: the background, then the objects in their order.
    ///
    /// # Errors
    /// If the time is not finite, a trajectory is empty, or ellipsoids and surfels are mixed.
    pub fn posed(&self, t_s: f64) -> Result<Gaussians> {
        if !t_s.is_finite() {
            return Err(Error::Option {
                what: format!("a scene at time {t_s} s"),
                remedy: "give a finite time".into(),
            });
        }
        let moved = self
            .objects
            .iter()
            .enumerate()
            .map(|(i, object)| {
                let pose = object.pose(t_s).ok_or_else(|| Error::Option {
                    what: format!("object {i} of the scene has a trajectory without poses"),
                    remedy: "give a trajectory with at least one pose".into(),
                })?;
                object.gaussians.transformed(&Similarity3::from_isometry(pose, 1.0))
            })
            .collect::<Result<Vec<_>>>()?;
        Gaussians::merged(&std::iter::once(&self.background).chain(&moved).collect::<Vec<_>>())
    }
}
