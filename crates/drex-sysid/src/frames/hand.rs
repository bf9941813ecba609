//! Camera and hand in one world: yaw, clock offset and the height of the hand, from the fingertips that push.
//!
//! While a fingertip pushes, its centre stays one radius behind the face that it pushes against. With the object leaning
//! by θ towards x, that face (w behind the centre p of the bounding box) is at x = pₓ − w / cos θ + (z − p_z) tan θ at height
//! z, so that over the touch
//!
//! xₜ(t) + r / cos θ = x₀ + pₓ − w / cos θ + (zₜ + δ − p_z) tan θ,  all of the object at t + τ,
//!
//! which is linear in the unknown start x₀ of each finger and in the error δ of the stated height of the hand: a hand that is
//! higher than stated moves farther for the same lean. τ (the delay of the tracker) is scanned.

use drex_core::{Pose, Trajectory};
use drex_recording::clock::{Span, overlap};
use drex_robot::{Finger, Robot, Shape};
use nalgebra::{DMatrix, DVector, Point3, Translation3, UnitQuaternion, Vector3};

use super::standing::Standing;
use super::{FoundFrames, score};
use crate::calibrate::{ExtraTorque, Touch};
use crate::{Result, SysidError};

/// Standard deviation of the stated height of a hand over the table, metres.
const HEIGHT_SD: f64 = 0.05;
/// Standard deviation of a tracker's delay, seconds.
const DELAY_SD: f64 = 0.1;
/// The longest delay of a tracker that is thought of, seconds.
const MOST_DELAY: f64 = 0.3;
/// Positions of a moving object are off by this share of the way it went.
const SHARE_OF_WAY: f64 = 0.1;
/// Rate at which a touch is looked at, Hz.
const RATE: f64 = 60.0;

/// Where a fingertip was, by the stated pose of the hand, and when it pushed.
#[derive(Debug, Clone)]
pub struct TipPath {
    /// Name of the finger.
    pub name: String,
    /// Seconds of the joint log's clock.
    pub times_s: Vec<f64>,
    /// Centre of the tip in the world of the hand (z up), metres, one per time.
    pub centers: Vec<Point3<f64>>,
    /// Radius of the tip, metres.
    pub radius_m: f64,
    /// When it pushed, seconds; `None` if it touched nothing.
    pub touch_s: Option<[f64; 2]>,
}

/// How camera and hand stand to each other.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct HandPlacement {
    /// Pose of the camera in the world of the hand, the table at the stated height plus `height_offset_m` lower.
    pub world_from_camera: Pose,
    /// Time of the track = time of the joint log + this: the delay of the tracker; with its standard deviation, seconds.
    pub clock_offset_s: [f64; 2],
    /// The hand is this much higher over the table than stated; with its standard deviation, metres.
    pub height_offset_m: [f64; 2],
    /// Horizontal direction of the push in the world of the hand, unit vector.
    pub push_in_world: Vector3<f64>,
    /// Root mean square distance between fingertips and the face they push, metres.
    pub rms_m: f64,
    /// Samples that this rests on.
    pub samples: usize,
}

/// Places the hand against the found frames. `tips` are all fingertips; at least one must have touched. The table is at
/// `table_height_m` in the world of the hand, as stated.
///
/// # Errors
/// If no tip touches, or tips and track do not overlap in time, or the object moves long before it is touched.
pub fn against_hand(
    found: &FoundFrames,
    track: &Trajectory,
    solid: &Standing,
    tips: &[TipPath],
    table_height_m: f64,
) -> Result<HandPlacement> {
    let (first_s, last_s) = track.span_s().unwrap_or_default();
    let touching: Vec<(&TipPath, [f64; 2])> = tips.iter().filter_map(|t| Some((t, t.touch_s?))).collect();
    for tip in tips {
        let (a, b) = (tip.times_s.first().copied().unwrap_or(0.0), tip.times_s.last().copied().unwrap_or(0.0));
        overlap(Span { what: "pose track", first_s, last_s }, Span { what: "joint log", first_s: a, last_s: b })?;
    }
    let Some(touched) = touching.iter().map(|t| t.1[0]).min_by(f64::total_cmp) else {
        return Err(SysidError::Frames {
            what: "no fingertip is seen to push".into(),
            remedy: "calibrate the hand with more runs, or push something heavier".into(),
        });
    };
    if found.motion_start_s < touched - 0.5 {
        return Err(SysidError::Frames {
            what: format!(
                "the object moves at {:.3} s, but the hand (joint log {:.3} to {:.3} s) touches nothing before {touched:.3} s",
                found.motion_start_s,
                tips.first().and_then(|t| t.times_s.first()).copied().unwrap_or(0.0),
                tips.first().and_then(|t| t.times_s.last()).copied().unwrap_or(0.0),
            ),
            remedy: "check that track and joint log are of the same run, and their clocks".into(),
        });
    }
    let push = push_direction(&touching);
    let view = View::of(found, track, solid);
    // The object cannot have moved before it was touched; the tracker may be late.
    let onset = found.motion_start_s - touched;
    let mut best: Option<(f64, f64, Fit)> = None;
    let mut profile = Vec::new();
    for step in 0..=30 {
        let tau = -0.1 + 0.01 * f64::from(step);
        let Some(fit) = view.fit(&touching, &push, tau, table_height_m) else { continue };
        // Neighbouring samples err alike: about one in a tenth of a second counts.
        let cost = 0.5 * fit.chi2 * (fit.samples as f64 / RATE * 10.0) / fit.samples as f64
            + 0.5 * (tau / DELAY_SD).powi(2)
            + 0.5 * ((onset - tau) / 0.07).powi(2);
        profile.push((tau, cost));
        if best.as_ref().is_none_or(|b| cost < b.0) {
            best = Some((cost, tau, fit));
        }
    }
    let Some((least, tau, fit)) = best else {
        return Err(SysidError::Frames {
            what: "the object leans too little while it is touched to place the hand".into(),
            remedy: "push higher or longer, or state the pose of the camera".into(),
        });
    };
    let weights: Vec<f64> = profile.iter().map(|(_, c)| (least - c).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let tau_sd =
        (profile.iter().zip(&weights).map(|((t, _), w)| w * (t - tau).powi(2)).sum::<f64>() / sum).sqrt().max(0.01);
    let slope = {
        let other = view.fit(&touching, &push, tau + 0.02, table_height_m);
        other.map_or(0.0, |o| (o.height - fit.height) / 0.02)
    };
    let height = fit.mean_height + fit.height;
    let height_sd = (fit.height_sd.powi(2) + (slope * tau_sd).powi(2) + (SHARE_OF_WAY * height).powi(2)).sqrt();
    // The stated height counts as a measurement, too.
    let (w, v) = (height_sd.powi(-2), HEIGHT_SD.powi(-2));
    let (offset, offset_sd) = (fit.height * w / (w + v), (w + v).powf(-0.5));

    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), push.y.atan2(push.x));
    let lateral = touching.iter().map(|(t, s)| push.cross(&Vector3::z()).dot(&t.at(s[0]).coords)).sum::<f64>()
        / touching.len() as f64;
    let origin = push * -fit.start - Vector3::z().cross(&push) * lateral + Vector3::z() * (table_height_m - offset);
    Ok(HandPlacement {
        world_from_camera: Pose::from_parts(Translation3::from(origin), yaw) * found.world_from_camera,
        clock_offset_s: [tau, tau_sd],
        height_offset_m: [offset, offset_sd],
        push_in_world: push,
        rms_m: fit.rms,
        samples: fit.samples,
    })
}

/// The touch of `finger` that can have moved an object which starts to move at `motion_start_s` of the track's clock: of those
/// that go on while it starts (the tracker may be late by [`MOST_DELAY`]), the strongest.
pub(crate) fn moving_touch<'a>(touches: &'a [Touch], finger: &str, motion_start_s: f64) -> Option<&'a Touch> {
    let mine = touches.iter().filter(|t| t.finger == finger);
    let goes_on =
        mine.filter(|t| t.from_to_s[0] < motion_start_s + 0.5 && t.from_to_s[1] > motion_start_s - MOST_DELAY);
    goes_on.max_by(|a, b| a.sigmas.total_cmp(&b.sigmas))
}

/// The paths of all fingertips of `robot` in a run, each with the touch that can have moved an object which starts to move at
/// `motion_start_s`.
pub fn tip_paths(
    robot: &Robot,
    world_from_base: &Pose,
    extra: &ExtraTorque,
    touches: &[Touch],
    motion_start_s: f64,
) -> Vec<TipPath> {
    let tips = |q: &Vec<f64>| robot.forward_kinematics(q, world_from_base);
    let poses: Vec<Vec<Pose>> = extra.positions.iter().map(tips).collect();
    let path = |finger: Finger| {
        let (ball, radius_m) = tip_ball(robot, &finger);
        TipPath {
            times_s: extra.times_s.clone(),
            centers: poses.iter().map(|links| links[finger.tip_link] * ball).collect(),
            radius_m,
            touch_s: moving_touch(touches, &finger.name, motion_start_s).map(|t| t.from_to_s),
            name: finger.name,
        }
    };
    robot.fingers().into_iter().map(path).collect()
}

/// Centre, in the frame of the tip link, and radius of the ball at the end of a finger; the tip itself where there is none.
pub(crate) fn tip_ball(robot: &Robot, finger: &Finger) -> (Point3<f64>, f64) {
    let balls = robot.links[finger.tip_link].geoms.iter().filter_map(|g| match g.shape {
        Shape::Sphere { radius } => Some((Point3::from(g.link_from_geom.translation.vector), radius)),
        _ => None,
    });
    let nearest = balls.min_by(|a, b| (a.0 - finger.tip_point).norm().total_cmp(&(b.0 - finger.tip_point).norm()));
    nearest.unwrap_or((finger.tip_point, 0.0))
}

/// Mean horizontal direction of the tips while they push.
fn push_direction(touching: &[(&TipPath, [f64; 2])]) -> Vector3<f64> {
    let sum: Vector3<f64> = touching.iter().map(|(t, s)| t.at(s[1]) - t.at(s[0])).sum();
    Vector3::new(sum.x, sum.y, 0.0).try_normalize(1e-9).unwrap_or_else(Vector3::x)
}

impl TipPath {
    /// Where the centre is at `t_s`, linear between samples and constant beyond them.
    pub fn at(&self, t_s: f64) -> Point3<f64> {
        let i = self.times_s.partition_point(|&t| t <= t_s).clamp(1, self.times_s.len().max(2) - 1);
        let (Some(a), Some(b)) = (self.centers.get(i - 1), self.centers.get(i)) else {
            return self.centers.first().copied().unwrap_or_else(Point3::origin);
        };
        let s = (t_s - self.times_s[i - 1]) / (self.times_s[i] - self.times_s[i - 1]);
        a + (b - a) * s.clamp(0.0, 1.0)
    }
}

/// The object in the world of the found frames.
struct View<'a> {
    found: &'a FoundFrames,
    track: Trajectory,
    /// From the centre of the bounding box to the face behind, m.
    behind: f64,
    center: Point3<f64>,
    until: f64,
}

struct Fit {
    start: f64,
    height: f64,
    height_sd: f64,
    mean_height: f64,
    chi2: f64,
    rms: f64,
    samples: usize,
}

impl<'a> View<'a> {
    fn of(found: &'a FoundFrames, track: &Trajectory, solid: &Standing) -> Self {
        let keep: Vec<usize> = (0..track.len()).filter(|&i| found.weights[i] > 0.1).collect();
        let times: Vec<f64> = keep.iter().map(|&i| track.times_s()[i]).collect();
        let poses: Vec<Pose> =
            keep.iter().map(|&i| found.world_from_camera * track.poses()[i] * found.tracked_from_mesh).collect();
        let center = score::box_center(solid);
        let lean = found.topples_towards_in_tracked.map(|l| found.tracked_from_mesh.rotation.inverse() * l);
        let behind =
            lean.map_or(0.0, |l| solid.hull.vertices.iter().map(|v| -l.dot(&(v - center))).fold(0.0, f64::max));
        let track = Trajectory::from_samples(&times, &poses).unwrap_or_default();
        let until = track.span_s().map_or(0.0, |s| s.1);
        Self { found, track, behind, center, until }
    }

    /// Lean towards x, and the centre of the box, at time `t` of the track.
    fn at(&self, t: f64) -> Option<(f64, Point3<f64>)> {
        let pose = self.track.at(t)?;
        let up = pose.rotation * self.found.up_in_mesh;
        Some((up.x.atan2(up.z), pose * self.center))
    }

    /// Least squares for the starts of the fingers and the height of the hand, the clock being given.
    fn fit(&self, touching: &[(&TipPath, [f64; 2])], push: &Vector3<f64>, tau: f64, table: f64) -> Option<Fit> {
        let mut rows: Vec<(usize, f64, f64, f64, f64)> = Vec::new();
        for (n, (tip, span)) in touching.iter().enumerate() {
            let count = ((span[1] - span[0]) * RATE).floor().max(0.0) as usize;
            for k in 0..=count {
                let t = span[0] + k as f64 / RATE;
                if t + tau > self.until {
                    break;
                }
                let Some((lean, p)) = self.at(t + tau) else { continue };
                if lean > 0.6 {
                    break;
                }
                let center = tip.at(t);
                let (x, z) = (push.dot(&center.coords), center.z - table);
                let y = x - p.x + (p.z - z) * lean.tan() + (self.behind + tip.radius_m) / lean.cos();
                let sd = 1.5e-3 + SHARE_OF_WAY * p.x.abs();
                rows.push((n, y, lean.tan(), sd, z));
            }
        }
        let tilts =
            rows.iter().map(|r| r.2).fold(f64::INFINITY, f64::min)..rows.iter().map(|r| r.2).fold(0.0, f64::max);
        let unknowns = touching.len() + 1;
        if rows.len() < unknowns + 3 || tilts.end - tilts.start < 0.05 {
            return None;
        }
        let mut a = DMatrix::zeros(rows.len(), unknowns);
        let mut b = DVector::zeros(rows.len());
        for (i, (n, y, tan, sd, _)) in rows.iter().enumerate() {
            a[(i, *n)] = 1.0 / sd;
            a[(i, unknowns - 1)] = tan / sd;
            b[i] = y / sd;
        }
        let inverse = (a.transpose() * &a).try_inverse()?;
        let x = &inverse * (a.transpose() * &b);
        let r = &a * &x - &b;
        let (chi2, n) = (r.norm_squared(), rows.len());
        // As many independent samples as tenths of a second.
        let inflate = (RATE / 10.0).sqrt() * (chi2 / n as f64).sqrt().max(1.0);
        let mean = |f: &dyn Fn(usize) -> f64| (0..n).map(f).sum::<f64>() / n as f64;
        Some(Fit {
            start: -(0..unknowns - 1).map(|k| x[k]).sum::<f64>() / (unknowns - 1) as f64,
            height: x[unknowns - 1],
            height_sd: inverse[(unknowns - 1, unknowns - 1)].sqrt() * inflate,
            mean_height: mean(&|i| rows[i].4),
            chi2,
            rms: mean(&|i| (r[i] * rows[i].3).powi(2)).sqrt(),
            samples: n,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tip_moves_linearly_between_samples_and_stays_beyond_them() {
        let centers = [0.0, 2.0, 1.0].map(|x| Point3::new(x, -x, 0.5)).to_vec();
        let path = |times_s: Vec<f64>, centers| TipPath {
            name: "index".into(),
            times_s,
            centers,
            radius_m: 0.01,
            touch_s: None,
        };
        let tip = path(vec![1.0, 3.0, 4.0], centers);
        for (t, x) in [(0.0, 0.0), (1.0, 0.0), (1.5, 0.5), (3.0, 2.0), (3.25, 1.75), (4.0, 1.0), (9.0, 1.0)] {
            assert!((tip.at(t) - Point3::new(x, -x, 0.5)).norm() < 1e-12, "{t}: {}", tip.at(t));
        }
        assert_eq!(path(vec![2.0], vec![Point3::new(1.0, 2.0, 3.0)]).at(7.0), Point3::new(1.0, 2.0, 3.0));
    }
}
