//! How well an assumed up direction explains a track: every hypothesis gets a cost (a negative log likelihood with heavy
//! tails, so that no single clue decides).
//!
//! What counts: the lowest point of the hull stays on the table while the object rocks and falls; the object tips about a
//! horizontal axis; its centre moves to where it leans, about as far as turning about a point on the table moves it; it
//! ends on a face that it can stand on; and the camera looks at the table from above.

use drex_core::Pose;
use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};

use super::motion::Motion;
use super::standing::Standing;

/// Frames of the motion that are looked at, at most.
const MOST_FRAMES: usize = 60;
/// Seconds after the start that are looked at: a topple lasts a second or two.
const SECONDS: f64 = 4.0;
/// A track of a moving object is off by this share of the way it went (bias of depth and of view).
const SHARE_OF_WAY: f64 = 0.12;
/// Beyond this the object lies, and its centre no longer moves as it leans, rad.
const MOST_TILT: f64 = 1.3;

/// Frames of a moving object against its rest, in camera axes.
pub(super) struct Evidence {
    frames: Vec<Pose>,
    settled: Option<Pose>,
    rest: Pose,
    noise_m: f64,
    noise_rad: f64,
}

/// An assumption about frames.
#[derive(Debug, Clone)]
pub(super) struct Hypothesis {
    /// Pose of the mesh in the tracked frame.
    pub tracked_from_mesh: Pose,
    /// Up at rest in the mesh frame: a way to stand.
    pub up_in_mesh: Vector3<f64>,
    /// Negative log likelihood up to a constant.
    pub cost: f64,
}

impl Evidence {
    /// Frames up to `until_s`.
    pub fn of(motion: &Motion, until_s: f64) -> Self {
        let (t, p) = (motion.clean.times_s(), motion.clean.poses());
        let end = (motion.start_s.0 + SECONDS).min(until_s);
        let moving: Vec<Pose> =
            (motion.rest.end..motion.settled.start.min(p.len())).filter(|&i| t[i] <= end).map(|i| p[i]).collect();
        let stride = moving.len().div_ceil(MOST_FRAMES).max(1);
        let settled = (motion.settled.len() >= 5 && t[motion.settled.start] <= until_s)
            .then(|| super::motion::mean_pose(&p[motion.settled.clone()]));
        Self {
            frames: moving.into_iter().step_by(stride).collect(),
            settled,
            rest: motion.rest_pose,
            noise_m: motion.noise.position_m.norm(),
            noise_rad: motion.noise.rotation_rad.norm(),
        }
    }

    /// The cost of `h.tracked_from_mesh` and `h.up_in_mesh`.
    pub fn cost(&self, h: &Hypothesis, solid: &Standing) -> f64 {
        let size = solid.size_m();
        let rest = self.rest * h.tracked_from_mesh;
        let up = rest.rotation * h.up_in_mesh;
        let com = solid.unit.center_of_mass;
        let table = table_of(&rest, &up, solid);
        let height = up.dot(&(rest * com).coords) - table;
        let mut gap = Mean::default();
        let (mut turned, mut spun, mut along, mut across, mut leaned) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for frame in self.frames.iter().chain(&self.settled) {
            let pose = frame * h.tracked_from_mesh;
            let moved = pose * com - rest * com;
            let sd = self.noise_m + 0.01 * size + SHARE_OF_WAY * moved.norm();
            gap.add(heavy((table_of(&pose, &up, solid) - table) / sd));
            let turn = (pose.rotation * rest.rotation.inverse()).scaled_axis();
            let lean = turn.cross(&up);
            if turn.norm() < MOST_TILT {
                turned += turn.norm_squared();
                spun += up.dot(&turn).powi(2);
                along += moved.dot(&lean);
                across += moved.dot(&up.cross(&lean));
                leaned += lean.norm_squared();
            }
        }
        // The noise of a rotation has no direction.
        let level = self.frames.len() as f64 * self.noise_rad.powi(2);
        let spin = ((spun - level / 3.0).max(0.0) / (turned - level).max(level).max(1e-12)).sqrt();
        let mut cost = 10.0 * gap.value() + 6.0 * heavy(spin / 0.25) + camera_prior(&up);
        if leaned > 4.0 * level.max(1e-9) {
            // Turning about a point on the table moves the centre by its height times the lean, to where it leans.
            let reach = self.noise_m / (height * leaned.sqrt());
            let (k, side) = (along / leaned / height, across / leaned / height);
            cost += 9.0 * heavy((k - 1.0) / reach.hypot(0.4)) + 3.0 * heavy(side / reach.hypot(0.4));
        }
        cost + self.settled.map_or(0.0, |s| 4.0 * self.standing_again(&(s * h.tracked_from_mesh), &up, solid))
    }

    /// How far the last rest is from a way to stand.
    fn standing_again(&self, pose: &Pose, up: &Vector3<f64>, solid: &Standing) -> f64 {
        let up = pose.rotation.inverse() * up;
        let off = solid.faces.iter().map(|f| f.up.angle(&up)).fold(f64::INFINITY, f64::min);
        heavy(off.min(3.0) / 0.17)
    }
}

/// All rotations that turn a box onto its axes, the identity first.
pub(super) fn axis_permutations() -> Vec<UnitQuaternion<f64>> {
    let axes: [Vector3<f64>; 6] =
        [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y(), Vector3::z(), -Vector3::z()];
    let mut all = Vec::with_capacity(24);
    for x in axes {
        for y in axes.into_iter().filter(|y| x.dot(y).abs() < 0.5) {
            let m = nalgebra::Matrix3::from_columns(&[x, y, x.cross(&y)]);
            all.push(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m)));
        }
    }
    all.sort_by(|a, b| a.angle().total_cmp(&b.angle()));
    all
}

/// `up · x` of the lowest point of the hull at `pose` (of the mesh).
pub(super) fn table_of(pose: &Pose, up: &Vector3<f64>, solid: &Standing) -> f64 {
    solid.lowest(&(pose.rotation.inverse() * up)) + up.dot(&pose.translation.vector)
}

/// The middle of the bounding box of the hull.
pub(super) fn box_center(solid: &Standing) -> Point3<f64> {
    solid.hull.bounds().map_or_else(Point3::origin, |(lo, hi)| nalgebra::center(&lo, &hi))
}

/// A camera looks at a table top from above, and is seldom upside down (OpenCV axes: y down, z forward).
fn camera_prior(up: &Vector3<f64>) -> f64 {
    let above = if up.z < -0.05 { 0.0 } else { 8.0 + 4.0 * up.z };
    let upright = if up.y < 0.0 { 0.0 } else { 4.0 * up.y };
    above + upright
}

/// Negative logarithm of a Cauchy density.
fn heavy(r: f64) -> f64 {
    (1.0 + 0.5 * r * r).ln()
}

#[derive(Default)]
struct Mean {
    sum: f64,
    count: usize,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    fn value(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.sum / self.count as f64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_24_turns_of_a_box_and_the_first_is_none() {
        let all = axis_permutations();
        assert_eq!(all.len(), 24);
        assert!(all[0].angle() < 1e-9);
        for (i, a) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|b| a.angle_to(b) > 0.5));
        }
    }

    #[test]
    fn cameras_look_from_above() {
        let looking_down = Vector3::new(0.0, -0.6, -0.8);
        assert!(camera_prior(&looking_down) == 0.0 && camera_prior(&-looking_down) > 10.0);
    }
}
