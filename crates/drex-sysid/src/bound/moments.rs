//! Torques, levers and lean over the topple, brought together.

use drex_core::Pose;
use drex_robot::Finger;
use nalgebra::{Matrix3xX, Vector3};

use super::Topple;
use crate::frames::moving_touch;

/// Delay of a tracker where it could not be found, and its standard deviation, s.
const USUAL_DELAY: [f64; 2] = [0.1, 0.05];
/// Standard deviation of a stated height of a hand, m.
const HEIGHT_SD: f64 = 0.05;
/// Beyond this lean the foot slides and the fall is no longer about its edge, rad.
const MOST_LEAN: f64 = 0.7;
/// Leans below this do not show that the object tips, rad.
const LEAST_LEAN: f64 = 0.01;

/// A finger that pushes, on the time grid of the extra torques.
pub(super) struct Pusher {
    pub name: String,
    /// First and last time of its touch, s of the joint log.
    pub touch_s: [f64; 2],
    pub times_s: Vec<f64>,
    /// Normal force if friction is right, N.
    pub force_n: Vec<f64>,
    /// Normal force per torque that friction is off by, 1/m.
    pub per_offset: Vec<f64>,
    /// Height of the tip over the stated table, m.
    pub height_m: Vec<f64>,
    /// Lever of the main joint against friction along the face over that against the normal force.
    pub friction_lever: Vec<f64>,
    /// What the force misses while the joint is knocked or starts, N: alike from sample to sample.
    pub knock_n: Vec<f64>,
    /// White noise of the force, N, of means over a twentieth of a second.
    pub noise_n: f64,
    /// Standard deviation of the offset, N m.
    pub offset_sd_nm: f64,
    /// Relative standard deviation of the torque scale.
    pub scale_sd: f64,
    /// Work of its joints against the extra torque over the touch, J.
    pub work_j: f64,
}

/// All of it.
pub(super) struct Samples {
    /// Whether any touch stands out of the joint friction.
    pub seen: bool,
    pub pushers: Vec<Pusher>,
    pub clock_s: [f64; 2],
    pub height_m: [f64; 2],
    /// Consecutive frames from the last one before the object tips: time of the track, and lean, rad.
    pub frames: Vec<(f64, f64)>,
    /// Standard deviation of a tracked lean, rad.
    pub lean_noise: f64,
}

pub(super) fn samples(run: &Topple<'_>) -> Option<Samples> {
    let clock_s = run.placement.map_or(USUAL_DELAY, |p| p.clock_offset_s);
    let height_m = run.placement.map_or([0.0, HEIGHT_SD], |p| p.height_offset_m);
    let fingers = run.robot.fingers();
    let mut touching: Vec<(&Finger, [f64; 2])> = Vec::new();
    for finger in &fingers {
        if let Some(t) = moving_touch(run.touches, &finger.name, run.found.motion_start_s) {
            touching.push((finger, t.from_to_s));
        }
    }
    let seen = !touching.is_empty();
    if !seen {
        let start = run.found.motion_start_s - clock_s[0];
        let span = [start - 0.1, start + 1.0];
        touching = fingers.iter().filter(|f| moves(run, f, span)).map(|f| (f, span)).collect();
    }
    let first = touching.iter().map(|t| t.1[0]).min_by(f64::total_cmp)?;
    let push = run.placement.map_or_else(|| direction(run, &touching), |p| p.push_in_world);
    let frames = leans(run, first)?;
    let pushers = touching.iter().map(|(f, span)| pusher(run, f, *span, &push)).collect();
    let lean_noise = run.found.noise.pooled().rotation_rad.max(1e-3);
    (frames.len() >= 5).then_some(Samples { seen, pushers, clock_s, height_m, frames, lean_noise })
}

/// Leans of trusted frames from the last one before the object tips (after `from_s`), up to [`MOST_LEAN`].
fn leans(run: &Topple<'_>, from_s: f64) -> Option<Vec<(f64, f64)>> {
    let f = run.found;
    let up = f.world_from_camera.rotation.inverse() * Vector3::z();
    f.topples_towards_in_tracked?;
    let x = f.world_from_camera.rotation.inverse() * Vector3::x();
    let mut out = Vec::new();
    for (i, (t, pose)) in run.track.times_s().iter().zip(run.track.poses()).enumerate() {
        if *t < from_s || f.weights[i] < 0.1 {
            continue;
        }
        let now = pose.rotation * f.up_in_tracked;
        let lean = now.dot(&x).atan2(now.dot(&up));
        if lean > MOST_LEAN {
            break;
        }
        out.push((*t, lean));
    }
    let noise = 3.0 * f.noise.pooled().rotation_rad;
    let tips = out.iter().position(|(t, lean)| *lean > noise.max(LEAST_LEAN) || *t > f.motion_start_s)?;
    Some(out.split_off(tips.saturating_sub(1)))
}

/// Whether a joint of `finger` moves by more than 0.1 rad in `span`.
fn moves(run: &Topple<'_>, finger: &Finger, span: [f64; 2]) -> bool {
    let inside = |k: &usize| (span[0]..=span[1]).contains(&run.extra.times_s[*k]);
    let ks: Vec<usize> = (0..run.extra.times_s.len()).filter(inside).collect();
    finger.joints.iter().any(|&j| {
        let values = ks.iter().map(|&k| run.extra.positions[k][j]);
        let (lo, hi) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), q| (a.min(q), b.max(q)));
        hi - lo > 0.1
    })
}

/// Horizontal direction of the tips over the first half second.
fn direction(run: &Topple<'_>, touching: &[(&Finger, [f64; 2])]) -> Vector3<f64> {
    let tip = |f: &Finger, t: f64| {
        let k = run.extra.times_s.partition_point(|s| *s < t).min(run.extra.times_s.len() - 1);
        let poses = run.robot.forward_kinematics(&run.extra.positions[k], run.world_from_base);
        poses[f.tip_link] * f.tip_point
    };
    let sum: Vector3<f64> = touching.iter().map(|(f, s)| tip(f, s[1].min(s[0] + 0.5)) - tip(f, s[0])).sum();
    Vector3::new(sum.x, sum.y, 0.0).try_normalize(1e-9).unwrap_or_else(Vector3::x)
}

fn pusher(run: &Topple<'_>, finger: &Finger, touch_s: [f64; 2], push: &Vector3<f64>) -> Pusher {
    let x = run.extra;
    let inside = |k: &usize| (touch_s[0] - 0.1..=touch_s[1] + 0.1).contains(&x.times_s[*k]);
    let mut out = Pusher {
        name: finger.name.clone(),
        touch_s,
        times_s: Vec::new(),
        force_n: Vec::new(),
        per_offset: Vec::new(),
        height_m: Vec::new(),
        friction_lever: Vec::new(),
        knock_n: Vec::new(),
        noise_n: 0.0,
        offset_sd_nm: 1.0,
        scale_sd: 1.0,
        work_j: 0.0,
    };
    let (mut noise, mut total, mut before) = (Vec::new(), Vec::new(), None::<usize>);
    for k in (0..x.times_s.len()).filter(inside) {
        let q = &x.positions[k];
        let poses = run.robot.forward_kinematics(q, run.world_from_base);
        let (linear, _) = run.robot.jacobian(&poses, finger.tip_link, &(poses[finger.tip_link] * finger.tip_point));
        let (force, offset, main) = normal_force(run, finger, k, push, &linear);
        let lever = push.dot(&linear.column(main));
        out.times_s.push(x.times_s[k]);
        total.push(if offset != 0.0 { x.sd_nm[main][k] / lever.abs() } else { 0.0 });
        out.force_n.push(force);
        out.per_offset.push(offset);
        out.height_m.push(ball_height(run, finger, &poses) - run.table_height_m);
        out.friction_lever.push(if lever.abs() > 1e-3 { linear[(2, main)] / lever } else { 0.0 });
        if offset != 0.0 && (touch_s[0]..=touch_s[1]).contains(&x.times_s[k]) {
            (out.offset_sd_nm, out.scale_sd) = (x.offset_sd_nm[main], x.scale_sd[main]);
            let white = (x.sd_nm[main][k].powi(2) - x.offset_sd_nm[main].powi(2)).max(x.offset_sd_nm[main].powi(2));
            noise.push(white.sqrt() / lever.abs());
        }
        if let Some(b) = before.filter(|_| (touch_s[0]..=touch_s[1]).contains(&x.times_s[k])) {
            let work = finger.joints.iter().map(|&j| x.torque_nm[j][k] * (q[j] - x.positions[b][j]));
            out.work_j += work.filter(|w| w.is_finite()).sum::<f64>();
        }
        before = Some(k);
    }
    noise.sort_by(f64::total_cmp);
    out.noise_n = noise.get(noise.len() / 2).copied().unwrap_or(1.0);
    let mut usual = total.clone();
    usual.sort_by(f64::total_cmp);
    let usual = usual.get(usual.len() / 2).copied().unwrap_or(0.0);
    out.knock_n = total.iter().map(|sd| (sd * sd - usual * usual).max(0.0).sqrt()).collect();
    out
}

/// The normal force from T_j = l_j F over the joints of the finger, each with its own errors; what it gains per offset of all
/// torques; and the joint that says most.
fn normal_force(
    run: &Topple<'_>,
    finger: &Finger,
    k: usize,
    push: &Vector3<f64>,
    linear: &Matrix3xX<f64>,
) -> (f64, f64, usize) {
    let x = run.extra;
    let (mut a, mut b, mut u, mut best) = (0.0, 0.0, 0.0, (0.0, finger.joints.first().copied().unwrap_or(0)));
    for &j in &finger.joints {
        let (lever, torque, sd) = (push.dot(&linear.column(j)), x.torque_nm[j][k], x.sd_nm[j][k]);
        if torque.is_finite() && sd.is_finite() && lever.abs() > 1e-3 {
            let w = 1.0 / (sd * sd + (x.scale_sd[j] * torque).powi(2));
            a += w * lever * lever;
            b += w * lever * torque;
            u += w * lever;
            if w * lever * lever > best.0 {
                best = (w * lever * lever, j);
            }
        }
    }
    if a > 0.0 { (b / a, u / a, best.1) } else { (0.0, 0.0, best.1) }
}

/// Height of the middle of the tip's ball, m.
fn ball_height(run: &Topple<'_>, finger: &Finger, poses: &[Pose]) -> f64 {
    let (ball, _) = crate::frames::tip_ball(run.robot, finger);
    (poses[finger.tip_link] * ball).z
}

impl Pusher {
    /// Whether it touches at `t` of the joint log.
    pub fn touches(&self, t: f64) -> bool {
        (self.touch_s[0]..=self.touch_s[1]).contains(&t)
    }

    /// Grid point at `t`.
    pub fn index(&self, t: f64) -> usize {
        self.times_s.partition_point(|s| *s < t).min(self.times_s.len().saturating_sub(1))
    }
}
