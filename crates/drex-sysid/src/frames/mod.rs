//! Frames and clocks of a tracked push when nobody calibrated the camera.
//!
//! [`find`] takes a track `camera_from_tracked` of an object that first stands on a table and is then pushed, and the
//! object's solid. It finds which direction is up, where the table is, to where the object leans when it topples, when it starts to
//! move, and until when the tracker can be believed. [`against_hand`] then puts camera and hand into one world: the yaw, the
//! clock offset, and how far the stated height of the hand is off.
//!
//! Frames: *tracked* is the frame whose pose the tracker reports; *mesh* is the frame of the mesh file. They are often
//! the same up to the centre of the bounding box, but some trackers were given a mesh with other axes; where the track
//! contradicts the stated axes, the 24 turns of a box are tried.

mod hand;
mod motion;
mod score;
mod standing;

use drex_core::trajectory::TrackNoise;
use drex_core::{Pose, Trajectory};
use drex_recording::{PushRecording, TrackFrame};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

pub use self::hand::{HandPlacement, TipPath, against_hand, tip_paths};
pub(crate) use self::hand::{moving_touch, tip_ball};
pub use self::standing::{Standing, StandingFace};
use crate::{Result, SysidError};
use motion::Motion;
use score::{Evidence, Hypothesis};

/// Up directions that differ by less count as one, rad.
const SAME_UP: f64 = 0.35;
/// Odds below which a turn of the mesh is left out.
const LEAST_ODDS: f64 = 1e-3;

/// What is known beforehand, for [`find`]. Everything may be left out.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct FrameOptions {
    /// Pose of the mesh in the tracked frame, if it is known.
    pub tracked_from_mesh: Option<Pose>,
    /// Whether that may be off by a turn of a box: trackers take objects upside down or turned by a quarter where they look
    /// alike, and a stated pose of the mesh does not tell. Other turns then are in [`FoundFrames::turns`].
    pub looks_alike: bool,
    /// Up in the tracked frame while the object rests, if it is known.
    pub up_in_tracked: Option<Vector3<f64>>,
    /// Horizontal direction of the topple in the tracked frame, if it is known.
    pub topples_towards_in_tracked: Option<Vector3<f64>>,
    /// Pose of the camera in a world with z up, if it was calibrated. Decides over `up_in_tracked`.
    pub world_from_camera: Option<Pose>,
}

impl FrameOptions {
    /// What a recording states of its frames. A track in the world tells up.
    pub fn of(recording: &PushRecording) -> Self {
        let known = Some(Pose::identity());
        match &recording.track_frame {
            TrackFrame::Camera { of_mesh, up, push } => Self {
                tracked_from_mesh: known.filter(|_| *of_mesh),
                looks_alike: true,
                up_in_tracked: *up,
                topples_towards_in_tracked: *push,
                world_from_camera: None,
            },
            _ => Self {
                tracked_from_mesh: known,
                up_in_tracked: recording.track.poses().first().map(|p| p.rotation.inverse() * -recording.gravity),
                ..Self::default()
            },
        }
    }
}

/// What [`find`] finds.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct FoundFrames {
    /// Pose of the mesh in the tracked frame.
    pub tracked_from_mesh: Pose,
    /// Up at rest, unit vector in the tracked frame.
    pub up_in_tracked: Vector3<f64>,
    /// Up at rest, unit vector in the mesh frame.
    pub up_in_mesh: Vector3<f64>,
    /// Horizontal unit vector to where it topples, tracked frame at rest; `None` if it does not tilt.
    pub topples_towards_in_tracked: Option<Vector3<f64>>,
    /// A world with z up, the table at z = 0, its origin below the resting centre of the bounding box, and x to where
    /// the object topples (or moves, if it does not tilt).
    pub world_from_camera: Pose,
    /// First and last time of the rest before the push.
    pub rest_s: [f64; 2],
    /// When the object starts to move, seconds of the track's clock.
    pub motion_start_s: f64,
    /// Standard deviation of that.
    pub motion_start_sd_s: f64,
    /// Until when the track agrees with a rigid object on a table.
    pub trusted_until_s: f64,
    /// Robust weight of each frame, 0 (an outlier, or after `trusted_until_s`) to 1.
    pub weights: Vec<f64>,
    /// Noise of the track.
    pub noise: TrackNoise,
    /// Odds of the next best up direction (20 degrees or more away) against this one; near 1 means a guess.
    pub runner_up_odds: f64,
    /// How the mesh may sit in the tracked frame with the same up (trackers take objects upside down or turned by a quarter where
    /// they look alike), with odds against the best, or against the one that was given. One, where that is certain.
    pub turns: Vec<Turn>,
    /// Other up directions, tracked frame, with their odds against this one, likely ones first.
    pub alternatives: Vec<(Vector3<f64>, f64)>,
    /// What the user should know.
    pub remarks: Vec<String>,
}

/// A way in which the mesh may sit in the tracked frame.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct Turn {
    /// Pose of the mesh in the tracked frame.
    pub tracked_from_mesh: Pose,
    /// Up at rest in the mesh frame.
    pub up_in_mesh: Vector3<f64>,
    /// Odds against the best one.
    pub odds: f64,
}

/// Finds the frames of `track` (poses `camera_from_tracked`, OpenCV camera axes) of the object `solid`.
///
/// # Errors
/// If the object is of a wrong scale, the track is too short, does not begin at rest, or never moves.
pub fn find(track: &Trajectory, solid: &Standing, options: &FrameOptions) -> Result<FoundFrames> {
    let motion = Motion::of(track)?;
    check_scale(solid, &motion)?;
    // Frames after a fault of the tracker mislead; which ones these are shows once up is roughly known.
    let rough = rank(&Evidence::of(&motion, f64::INFINITY), solid, &motion, options);
    let until = |h: &Hypothesis| trusted(&motion, solid, h);
    let end_s = rough.first().map_or(f64::INFINITY, |h| until(h).0);
    let ranked = rank(&Evidence::of(&motion, end_s), solid, &motion, options);
    let Some(best) = ranked.first() else {
        return Err(SysidError::Frames {
            what: "the object cannot stand on any face of its mesh".into(),
            remedy: "check that the mesh is the whole object".into(),
        });
    };
    let mut remarks = Vec::new();
    if best.tracked_from_mesh.rotation.angle() > 0.1 && options.tracked_from_mesh.is_none() {
        remarks
            .push("the track contradicts the axes of the mesh: the tracker seems to use a mesh with other axes".into());
    }
    let up_in_tracked = best.tracked_from_mesh.rotation * best.up_in_mesh;
    let mut alternatives: Vec<(Vector3<f64>, f64)> = Vec::new();
    let mut turns: Vec<Turn> = Vec::new();
    for h in &ranked {
        let up = h.tracked_from_mesh.rotation * h.up_in_mesh;
        if alternatives.iter().map(|a| a.0).chain([up_in_tracked]).all(|a| a.angle(&up) > SAME_UP) {
            alternatives.push((up, (best.cost - h.cost).exp()));
        }
    }
    let open = FrameOptions { up_in_tracked: Some(up_in_tracked), ..options.clone() };
    let turned = match options.tracked_from_mesh {
        Some(known) if options.looks_alike => {
            rank_among(&turned(solid, &known), &Evidence::of(&motion, end_s), solid, &motion, &open)
        }
        _ => Vec::new(),
    };
    for h in if turned.is_empty() { &ranked } else { &turned } {
        let up = h.tracked_from_mesh.rotation * h.up_in_mesh;
        let odds = (best.cost - h.cost).exp();
        let new = turns.iter().all(|t| t.tracked_from_mesh.rotation.angle_to(&h.tracked_from_mesh.rotation) > 0.1);
        if up.angle(&up_in_tracked) < SAME_UP && odds > LEAST_ODDS && new {
            turns.push(Turn { tracked_from_mesh: h.tracked_from_mesh, up_in_mesh: h.up_in_mesh, odds });
        }
    }
    alternatives.truncate(8);
    let runner_up_odds = alternatives.first().map_or(0.0, |a| a.1);
    if runner_up_odds > 0.2 && options.up_in_tracked.is_none() && options.world_from_camera.is_none() {
        remarks.push("another up direction explains the track nearly as well; state it if you know it".into());
    }
    let up = motion.rest_pose.rotation * up_in_tracked;
    let lean = match options.topples_towards_in_tracked {
        Some(known) => Some(motion.rest_pose.rotation * known),
        None => lean_in_camera(&motion, &up),
    }
    .and_then(|l| (l - up * up.dot(&l)).try_normalize(1e-6));
    let world_from_camera = match options.world_from_camera {
        Some(known) => known,
        None => world(&motion, solid, best, &up, lean.or_else(|| moves_in_camera(&motion, &up))),
    };
    let (trusted_until_s, doubt) = until(best);
    remarks.extend(doubt);
    let weights = track.times_s().iter().zip(&motion.weights);
    let weights = weights.map(|(t, w)| if *t > trusted_until_s { 0.0 } else { *w }).collect();
    let times = motion.clean.times_s();
    Ok(FoundFrames {
        tracked_from_mesh: best.tracked_from_mesh,
        up_in_tracked,
        up_in_mesh: best.up_in_mesh,
        topples_towards_in_tracked: lean.map(|l| motion.rest_pose.rotation.inverse() * l),
        world_from_camera,
        rest_s: [times[0], times[motion.rest.end.saturating_sub(1)]],
        motion_start_s: motion.start_s.0,
        motion_start_sd_s: motion.start_s.1,
        trusted_until_s,
        weights,
        noise: motion.noise,
        runner_up_odds,
        turns,
        alternatives,
        remarks,
    })
}

/// Hypotheses, likely ones first.
fn rank(evidence: &Evidence, solid: &Standing, motion: &Motion, options: &FrameOptions) -> Vec<Hypothesis> {
    let frames = match options.tracked_from_mesh {
        Some(known) => vec![known],
        None => {
            // Trackers report the pose of the mesh's frame or of the middle of its bounding box.
            let center = score::box_center(solid).coords;
            let apart = center.norm() > 1e-3 * solid.size_m();
            let middle = apart.then(|| turned(solid, &Translation3::from(-center).into()));
            middle.into_iter().flatten().chain(turned(solid, &Pose::identity())).collect()
        }
    };
    rank_among(&frames, evidence, solid, motion, options)
}

/// `frame` (tracked from mesh) and the mesh turned in it about the middle of its bounding box.
fn turned(solid: &Standing, frame: &Pose) -> Vec<Pose> {
    let center = Translation3::from(score::box_center(solid).coords);
    let turn = |r| frame * center * Pose::from_parts(Translation3::identity(), r) * center.inverse();
    score::axis_permutations().into_iter().map(turn).collect()
}

fn rank_among(
    frames: &[Pose],
    evidence: &Evidence,
    solid: &Standing,
    motion: &Motion,
    options: &FrameOptions,
) -> Vec<Hypothesis> {
    /// Cost of the assumption that the tracker's mesh had other axes than the file.
    const OTHER_AXES: f64 = 2.0;
    let known_up = match options.world_from_camera {
        Some(w) => Some((w.rotation * motion.rest_pose.rotation).inverse() * Vector3::z()),
        None => options.up_in_tracked.and_then(|u| u.try_normalize(1e-9)),
    };
    let mut ranked = Vec::new();
    for frame in frames {
        let ways: Vec<Vector3<f64>> = match known_up {
            Some(up) => vec![frame.rotation.inverse() * up],
            None => solid.faces.iter().map(|f| f.up).collect(),
        };
        for up_in_mesh in ways {
            let mut h = Hypothesis { tracked_from_mesh: *frame, up_in_mesh, cost: 0.0 };
            let filed = options.tracked_from_mesh.map_or_else(UnitQuaternion::identity, |known| known.rotation);
            let as_filed = frame.rotation.angle_to(&filed) < 0.1;
            h.cost = evidence.cost(&h, solid) + if as_filed { 0.0 } else { OTHER_AXES };
            ranked.push(h);
        }
    }
    ranked.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    ranked
}

/// Refuses an object that cannot be where the track says.
fn check_scale(solid: &Standing, motion: &Motion) -> Result<()> {
    let (size, distance) = (solid.size_m(), motion.rest_pose.translation.vector.norm());
    if size > 2.0 * distance || size < 1e-3 * distance {
        return Err(SysidError::Object {
            what: format!("measures {size:.4} m across but is tracked {distance:.3} m from the camera"),
            remedy: "give the mesh in metres".into(),
        });
    }
    Ok(())
}

/// Mean horizontal direction, in the camera, into which up turns while the object tilts by 4 to 45 degrees.
fn lean_in_camera(motion: &Motion, up: &Vector3<f64>) -> Option<Vector3<f64>> {
    let rest = motion.rest_pose.rotation.inverse();
    let mut sum = Vector3::zeros();
    for p in &motion.clean.poses()[motion.rest.end..motion.settled.start.max(motion.rest.end)] {
        let now = p.rotation * (rest * up);
        let tilt = now.angle(up);
        if (0.07..0.8).contains(&tilt) {
            sum += now - up * up.dot(&now);
        }
    }
    sum.try_normalize(0.05)
}

/// Horizontal direction, in the camera, of the way to the last rest.
fn moves_in_camera(motion: &Motion, up: &Vector3<f64>) -> Option<Vector3<f64>> {
    let last = motion.clean.poses().last()?;
    let d = last.translation.vector - motion.rest_pose.translation.vector;
    (d - up * up.dot(&d)).try_normalize(1e-4)
}

fn world(motion: &Motion, solid: &Standing, best: &Hypothesis, up: &Vector3<f64>, x: Option<Vector3<f64>>) -> Pose {
    let x = x.unwrap_or_else(|| {
        let any = if up.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        (any - up * up.dot(&any)).normalize()
    });
    let rows = Matrix3::from_rows(&[x.transpose(), up.cross(&x).transpose(), up.transpose()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows));
    let rest = motion.rest_pose * best.tracked_from_mesh;
    let center = rotation * (rest * score::box_center(solid)).coords;
    let table = score::table_of(&rest, up, solid);
    Pose::from_parts(Translation3::new(-center.x, -center.y, -table), rotation)
}

/// Until when the track looks like a rigid object that topples on a table, and a remark if that is not the end.
fn trusted(motion: &Motion, solid: &Standing, best: &Hypothesis) -> (f64, Option<String>) {
    let (t, p) = (motion.clean.times_s(), motion.clean.poses());
    let size = solid.size_m();
    let rest = motion.rest_pose * best.tracked_from_mesh;
    let up = rest.rotation * best.up_in_mesh;
    let table = score::table_of(&rest, &up, solid);
    let lean = lean_in_camera(motion, &up);
    for i in motion.rest.end..p.len() {
        let pose = p[i] * best.tracked_from_mesh;
        let moved = (pose.translation.vector - rest.translation.vector).norm();
        let before = i.saturating_sub(1);
        let above = score::table_of(&pose, &up, solid) - table;
        let rate = p[i].rotation.angle_to(&p[before].rotation) / (t[i] - t[before]).max(1e-3);
        let turn = pose.rotation * rest.rotation.inverse();
        let tilt = (turn * up).angle(&up);
        // The part of the turn about the object's own upright axis.
        let spin = 2.0 * turn.quaternion().imag().dot(&up).atan2(turn.quaternion().w);
        let spin = (spin + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
        let fault = if above.abs() > 0.03 * size + 0.25 * moved + 5.0 * motion.noise.position_m.norm() {
            format!("the tracked object is {:+.0} mm off the table", 1e3 * above)
        } else if rate > 25.0 {
            format!("the tracked orientation turns at {rate:.0} rad/s")
        } else if lean.is_some() && (0.15..1.4).contains(&tilt) && spin.abs() > 0.5 {
            format!(
                "the tracked object has turned by {:.0} degrees about its own axis while it topples",
                spin.to_degrees()
            )
        } else {
            continue;
        };
        return (t[before], Some(format!("after {:.3} s {fault}: not used from there on", t[before])));
    }
    (t.last().copied().unwrap_or(0.0), None)
}
