//! Where the camera goes.

use std::f64::consts::TAU;

use drex_core::Pose;
use nalgebra::{Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Camera from world of a camera at `eye` that looks at `target`, turned by `roll_rad` about its axis (clockwise
/// camera for positive angles); upright at 0.
#[must_use]
pub fn look_at(eye: &Point3<f64>, target: &Point3<f64>, roll_rad: f64) -> Pose {
    let forward = (target - eye).normalize();
    // A camera that looks straight down has the world's y upwards.
    let up = if forward.xy().norm() > 1e-6 { Vector3::z() } else { Vector3::y() };
    let right = forward.cross(&up).normalize();
    let down = forward.cross(&right);
    let rows = nalgebra::Matrix3::from_rows(&[right.transpose(), down.transpose(), forward.transpose()]);
    let upright = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows));
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -roll_rad) * upright;
    Pose::from_parts(Translation3::from(-(rotation * eye.coords)), rotation)
}

/// A camera place by its direction from a target.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// Angle about the vertical, radians.
    pub around_rad: f64,
    /// Angle above the horizon, radians.
    pub above_rad: f64,
    /// Distance from the target, metres.
    pub distance_m: f64,
}

impl Place {
    /// The place itself.
    #[must_use]
    pub fn eye(&self, target: &Point3<f64>) -> Point3<f64> {
        let (s, c) = self.around_rad.sin_cos();
        let level = self.above_rad.cos();
        target + Vector3::new(level * c, level * s, self.above_rad.sin()) * self.distance_m
    }
}

/// The camera at `place`, by hand: shifted, aimed and rolled a little wrong.
pub fn by_hand(place: &Place, target: &Point3<f64>, rng: &mut ChaCha8Rng) -> Pose {
    let mut shake = |size: f64| Vector3::from_fn(|_, _| rng.random_range(-size..size));
    let eye = place.eye(target) + shake(0.03 * place.distance_m);
    let aim = target + shake(0.06 * place.distance_m);
    look_at(&eye, &aim, rng.random_range(-0.09..0.09))
}

/// Three rings about `target` and close-ups, `photos` in all.
pub fn rings(photos: usize, target: &Point3<f64>, distance_m: f64, rng: &mut ChaCha8Rng) -> Vec<Pose> {
    let close = (0.15 * photos as f64).round() as usize;
    let low = rng.random_range(0.14..0.3);
    let mut poses = Vec::new();
    for ring in 0..3 {
        let above_rad = low + f64::from(ring) * rng.random_range(0.24..0.34);
        let count = (photos - close + ring as usize) / 3;
        let start: f64 = rng.random_range(0.0..TAU);
        let way = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let distance_m = distance_m * rng.random_range(0.92..1.12);
        for i in 0..count {
            let around_rad = start + way * TAU * (i as f64 + rng.random_range(-0.18..0.18)) / count as f64;
            poses.push(by_hand(&Place { around_rad, above_rad, distance_m }, target, rng));
        }
    }
    for i in 0..photos - poses.len() {
        let place = Place {
            around_rad: TAU * (i as f64 + rng.random_range(-0.3..0.3)) / close.max(1) as f64,
            above_rad: rng.random_range(0.3..0.8),
            distance_m: distance_m * rng.random_range(0.62..0.75),
        };
        poses.push(by_hand(&place, target, rng));
    }
    poses
}

/// A video by hand around `target`: the pose at any time.
pub struct Walk {
    target: Point3<f64>,
    start_rad: f64,
    turn_rad_s: f64,
    above_rad: [f64; 2],
    distance_m: f64,
    waves: Vec<[Wave; 6]>,
    jerks: Vec<Jerk>,
}

#[derive(Clone, Copy)]
struct Wave {
    size: f64,
    turns_s: f64,
    phase: f64,
}

struct Jerk {
    at_s: f64,
    lasts_s: f64,
    by: [f64; 6],
}

impl Walk {
    /// A bit more than one turn in `seconds`, with sway and `jerks` jerks.
    pub fn new(target: Point3<f64>, distance_m: f64, seconds: f64, jerks: usize, rng: &mut ChaCha8Rng) -> Self {
        let turns = rng.random_range(1.06..1.2) * if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        // Of eye (x, y, z) and aim (x, y, z), in distances: slow sway, steps, tremor.
        let waves = [(0.035, 0.25), (0.012, 0.9), (0.0025, 3.7)]
            .map(|(size, turns_s): (f64, f64)| {
                std::array::from_fn(|_| Wave {
                    size: distance_m * size * rng.random_range(0.5..1.0),
                    turns_s: turns_s * rng.random_range(0.7..1.4),
                    phase: rng.random_range(0.0..TAU),
                })
            })
            .to_vec();
        let jerks = (0..jerks)
            .map(|i| Jerk {
                at_s: seconds * (i as f64 + rng.random_range(0.2..0.8)) / jerks as f64,
                lasts_s: rng.random_range(0.08..0.16),
                by: std::array::from_fn(|_| distance_m * rng.random_range(-0.09..0.09)),
            })
            .collect();
        let above = rng.random_range(0.4..0.6);
        Self {
            target,
            start_rad: rng.random_range(0.0..TAU),
            turn_rad_s: TAU * turns / seconds,
            above_rad: [above, rng.random_range(0.1..0.22)],
            distance_m,
            waves,
            jerks,
        }
    }

    /// Camera from world at `time_s`.
    #[must_use]
    pub fn pose(&self, time_s: f64) -> Pose {
        let around_rad = self.start_rad + self.turn_rad_s * time_s;
        let place = Place {
            around_rad,
            above_rad: self.above_rad[0] + self.above_rad[1] * (0.8 * around_rad).sin(),
            distance_m: self.distance_m,
        };
        let mut moved = [0.0; 6];
        for (k, m) in moved.iter_mut().enumerate() {
            for wave in &self.waves {
                *m += wave[k].size * (TAU * wave[k].turns_s * time_s + wave[k].phase).sin();
            }
            for jerk in &self.jerks {
                // A push there and back: a bump that is over after three times its length.
                *m += jerk.by[k] * (-((time_s - jerk.at_s) / jerk.lasts_s).powi(2)).exp();
            }
        }
        let eye = place.eye(&self.target) + Vector3::new(moved[0], moved[1], moved[2]);
        let aim = self.target + Vector3::new(moved[3], moved[4], moved[5]);
        look_at(&eye, &aim, 0.9 * moved[0] / self.distance_m)
    }
}
