//! Retargeting a stream of frames or a whole sequence.

mod stream;
#[cfg(test)]
#[path = "../tests/support/mod.rs"]
pub(crate) mod support;
#[cfg(test)]
mod tests;

pub use stream::Retargeter;

use drex_demo::{Demonstration, HandFrame};

use crate::measurements::HandMeasurements;
use crate::{Error, Objective, Result, Retargeting, TargetHand};

/// The factor on the human vectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// From the lengths of the human bones and the robot's reach; over a sequence ([`retarget`]) refined so that the fingertips'
    /// mean error in units of the scale is smallest. The human hand is brought to a nominal size first, so that the size and the
    /// unit of the key points do not matter.
    Auto,
    /// A given factor, on key points as they are.
    Fixed(f64),
}

/// Options of plain retargeting.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RetargetOptions {
    /// The quantity that is minimised.
    pub objective: Objective,
    /// Factor on the human vectors.
    pub scale: Scale,
    /// Part of the new joint vector in the filtered one, 0 to 1; 1 does not filter.
    pub low_pass_alpha: f64,
    /// Weight of the squared distance to the frame before (rad², m²).
    pub norm_delta: f64,
    /// Number of other initial guesses for the thumb, which has local minima: all are tried on the first frame, then one per frame in turn. 0 keeps to
    /// the minimum that the first frame led to.
    pub thumb_guesses: usize,
    /// Most steps of the solver per frame and initial guess.
    pub iterations: usize,
}

impl RetargetOptions {
    /// What dex-retargeting uses with an objective, but for the scale: automatic, or 1 for `position`, whose output is not
    /// filtered either.
    pub fn new(objective: Objective) -> Self {
        let (scale, low_pass_alpha) = match objective {
            Objective::Position => (Scale::Fixed(1.0), 1.0),
            _ => (Scale::Auto, 0.2),
        };
        Self { objective, scale, low_pass_alpha, norm_delta: 4e-3, thumb_guesses: 4, iterations: 100 }
    }

    fn check(&self) -> Result<()> {
        let wrong = |what: String, remedy| Err(Error::value(what, remedy));
        if let Scale::Fixed(s) = self.scale
            && !(s > 0.0 && s.is_finite())
        {
            return wrong(format!("the scale {s} is not positive"), "give a positive factor or let it be found");
        }
        if !(self.low_pass_alpha > 0.0 && self.low_pass_alpha <= 1.0) {
            return wrong(
                format!("low_pass_alpha is {}", self.low_pass_alpha),
                "give a number above 0 (which would freeze the hand) and at most 1 (no filter)",
            );
        }
        if !(self.norm_delta >= 0.0 && self.norm_delta.is_finite()) {
            return wrong(format!("norm_delta is {}", self.norm_delta), "give 0 or a small positive number");
        }
        Ok(())
    }
}

impl Default for RetargetOptions {
    /// `vector` with automatic scale.
    fn default() -> Self {
        Self::new(Objective::Vector)
    }
}

/// Retargets a sequence frame by frame; the same as a [`Retargeter`] but for the automatic scale, which is that of the whole sequence.
///
/// # Errors
/// As [`Retargeter::new`]; if the demonstration is of the other hand; if the automatic scale finds no frame to measure.
pub fn retarget(demonstration: &Demonstration, hand: &TargetHand, options: &RetargetOptions) -> Result<Retargeting> {
    if demonstration.side != hand.side {
        return Err(Error::value(
            format!(
                "{}: a {} hand cannot be retargeted to \"{}\", a {} hand",
                demonstration.source,
                demonstration.side.name(),
                hand.robot.name,
                hand.side.name()
            ),
            "use the mirrored model of the robot, or mirror the key points",
        ));
    }
    let mut retargeter = Retargeter::new(hand, options.clone())?;
    retargeter.measure(HandMeasurements::of(&demonstration.frames, demonstration.side));
    if options.scale == Scale::Auto {
        retargeter.refinement = refined(&retargeter, &demonstration.frames)?;
    }
    let Some(scale) = retargeter.scale() else {
        return Err(Error::value(
            format!("{}: no frame shows a finger from wrist to tip", demonstration.source),
            "give the scale as a number, or repair the key points",
        ));
    };
    let frames = demonstration.frames.iter().map(|f| retargeter.frame(f)).collect();
    Ok(Retargeting {
        joint_names: hand.robot.joints.iter().map(|j| j.name.clone()).collect(),
        objective: options.objective,
        scale,
        frames,
    })
}

/// The factor on the scale of the reaches with which the fingertips' mean error, in units of the scale, is smallest on the sequence;
/// in steps of [`FINE`]. FingerCandidate with `vector` on at most [`SAMPLES`] frames.
fn refined(retargeter: &Retargeter, frames: &[HandFrame]) -> Result<f64> {
    let samples: Vec<&HandFrame> = frames.iter().step_by(frames.len().div_ceil(SAMPLES).max(1)).collect();
    let mut probe = retargeter.probe()?;
    let mut error = |step: i32| {
        probe.reset();
        probe.refinement = 1.0 + FINE * f64::from(step);
        let Some(report) = probe.scale() else { return f64::INFINITY };
        let (mut sum, mut count) = (0.0, 0);
        for frame in &samples {
            for residual in probe.frame(frame).fingers.iter().filter_map(|f| f.residual_mm) {
                sum += residual;
                count += 1;
            }
        }
        if count == 0 { f64::INFINITY } else { sum / f64::from(count) / report.scale }
    };
    let mut best = (0, error(0));
    let mut try_step = |step: i32, best: &mut (i32, f64)| {
        let e = error(step);
        if e < best.1 {
            *best = (step, e);
        }
    };
    for step in (-COARSE_STEPS..=COARSE_STEPS).filter(|s| *s != 0) {
        try_step(step * COARSE, &mut best);
    }
    let coarse = best.0;
    for step in (1 - COARSE..COARSE).filter(|s| *s != 0) {
        try_step(coarse + step, &mut best);
    }
    Ok(1.0 + FINE * f64::from(best.0))
}

/// Frames that the scale is found on, at most and evenly.
const SAMPLES: usize = 24;
/// A fine step of the factor, and fine steps to a coarse one.
const FINE: f64 = 0.03;
const COARSE: i32 = 3;
/// Coarse steps to each side.
const COARSE_STEPS: i32 = 4;
