//! The photos of each kind: where the camera is, what moves, what they are called.

use drex_core::Pose;
use drex_core::camera::Camera;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use super::desk::Desk;
use super::kinds::{Kind, Size};
use super::path::{Place, Walk, by_hand, look_at, rings};
use super::render::Shot;

/// The shots of a capture of `desks`, each with the index of its desk.
pub fn shots(kind: Kind, size: &Size, desks: &[Desk], camera: &Camera, rng: &mut ChaCha8Rng) -> Vec<(usize, Shot)> {
    let desk = &desks[0];
    let n = size.photos;
    let exposure = |rng: &mut ChaCha8Rng| rng.random_range(0.93..1.07);
    let still = |name: String, pose: Pose, gain: f64| Shot {
        name,
        shutter: vec![pose],
        camera_from_object: pose,
        turn_rad: 0.0,
        gain,
    };
    match kind {
        Kind::Turntable => turntable(n, desk, rng).into_iter().map(|s| (0, s)).collect(),
        Kind::Video => film(n, desk, camera, rng).into_iter().map(|s| (0, s)).collect(),
        Kind::Spin => {
            let place = place_near(desk, rng);
            let from = place.eye(&desk.target);
            let (wide, way) = (rng.random_range(1.0..1.9), rng.random_range(-0.1..0.1));
            (0..n)
                .map(|i| {
                    let turn = wide * ((i as f64 + 0.5) / n as f64 - 0.5);
                    let aim = Place {
                        around_rad: place.around_rad + std::f64::consts::PI + turn,
                        above_rad: rng.random_range(-0.08..0.08) + way - 0.35,
                        distance_m: desk.distance_m,
                    };
                    let pose = look_at(&from, &aim.eye(&from), rng.random_range(-0.02..0.02));
                    (0, still(format!("pan_{:02}.jpg", i + 1), pose, exposure(rng)))
                })
                .collect()
        }
        Kind::Few => {
            let mut place = place_near(desk, rng);
            (0..n)
                .map(|i| {
                    place.around_rad += rng.random_range(0.15..0.3);
                    (0, still(format!("pic{}.jpg", i + 1), by_hand(&place, &desk.target, rng), exposure(rng)))
                })
                .collect()
        }
        Kind::Apart => (0..n)
            .map(|i| {
                let pose = by_hand(&place_near(&desks[i], rng), &desks[i].target, rng);
                (i, still(format!("s{:02}.jpg", i + 1), pose, exposure(rng)))
            })
            .collect(),
        Kind::Two => {
            let poses = [n - n / 2, n / 2]
                .iter()
                .enumerate()
                .flat_map(|(d, count)| {
                    let first = place_near(&desks[d], rng);
                    (0..*count)
                        .map(|i| {
                            // A turn in steps that overlap.
                            let turn = std::f64::consts::TAU * i as f64 / *count as f64;
                            let place = Place { around_rad: first.around_rad + turn, ..first };
                            (d, by_hand(&place, &desks[d].target, rng))
                        })
                        .collect::<Vec<_>>()
                })
                .collect::<Vec<_>>();
            let mut order: Vec<usize> = (0..n).collect();
            order.shuffle(rng);
            let mut named: Vec<_> = poses
                .into_iter()
                .zip(order)
                .map(|((d, pose), i)| (d, still(format!("q{:03}.jpg", i + 1), pose, exposure(rng))))
                .collect();
            named.sort_by(|a, b| a.1.name.cmp(&b.1.name));
            named
        }
        Kind::Blur => rings(n, &desk.target, desk.distance_m, rng)
            .into_iter()
            .enumerate()
            .map(|(i, pose)| (0, smear(still(format!("m{:03}.jpg", i + 1), pose, exposure(rng)), camera, rng)))
            .collect(),
        Kind::Orbit | Kind::Echo | Kind::Plain | Kind::Gloss | Kind::Repeat => {
            let (stem, first) = match kind {
                Kind::Plain => ("P", 1),
                Kind::Echo => ("DSC0", 4000),
                _ => ("IMG_", rng.random_range(1..9000)),
            };
            rings(n, &desk.target, desk.distance_m, rng)
                .into_iter()
                .enumerate()
                .map(|(i, pose)| (0, still(format!("{stem}{:04}.jpg", first + i), pose, exposure(rng))))
                .collect()
        }
    }
}

fn place_near(desk: &Desk, rng: &mut ChaCha8Rng) -> Place {
    Place {
        around_rad: rng.random_range(0.0..std::f64::consts::TAU),
        above_rad: rng.random_range(0.4..0.65),
        distance_m: desk.distance_m * rng.random_range(0.95..1.15),
    }
}

/// A tripod at three heights; the disc turns a full turn at each.
fn turntable(n: usize, desk: &Desk, rng: &mut ChaCha8Rng) -> Vec<Shot> {
    let around_rad = desk.tripod_rad;
    let mut above_rad = rng.random_range(0.2..0.32);
    let mut shots = Vec::new();
    for height in 0..3 {
        let count = (n + height) / 3;
        let place = Place { around_rad, above_rad, distance_m: desk.distance_m * rng.random_range(0.97..1.05) };
        let pose = by_hand(&place, &desk.target, rng);
        let start: f64 = rng.random_range(0.0..1.0);
        for i in 0..count {
            let turn_rad = std::f64::consts::TAU * (start + i as f64 + rng.random_range(-0.08..0.08)) / count as f64;
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn_rad);
            shots.push(Shot {
                name: format!("stop_{:03}.jpg", shots.len() + 1),
                shutter: vec![pose],
                camera_from_object: pose * turn,
                turn_rad,
                gain: rng.random_range(0.985..1.015),
            });
        }
        above_rad += rng.random_range(0.24..0.36);
    }
    shots
}

/// Frames of a walk about the table, 24 a second.
fn film(n: usize, desk: &Desk, camera: &Camera, rng: &mut ChaCha8Rng) -> Vec<Shot> {
    const RATE: f64 = 24.0;
    let seconds = n as f64 / RATE;
    let jerks = (0.9 * seconds).round() as usize;
    let walk = Walk::new(desk.target, desk.distance_m, seconds, jerks, rng);
    let exposure_s = rng.random_range(0.011..0.019);
    let (drift, phase) = (rng.random_range(0.06..0.16), rng.random_range(0.0..6.0));
    (0..n)
        .map(|i| {
            let time_s = (i as f64 + 0.5) / RATE;
            let moments = motion_px(&walk, desk, camera, time_s, exposure_s).ceil().clamp(1.0, 32.0) as usize;
            let moment = |k: usize| time_s + exposure_s * ((k as f64 + 0.5) / moments as f64 - 0.5);
            Shot {
                name: format!("frame_{:04}.jpg", i + 1),
                shutter: (0..moments).map(|k| walk.pose(moment(k))).collect(),
                camera_from_object: walk.pose(time_s),
                turn_rad: 0.0,
                gain: 1.0 + drift * (0.9 * time_s + phase).sin(),
            }
        })
        .collect()
}

/// How far the object and what is behind it move in the picture while the shutter is open, pixels.
fn motion_px(walk: &Walk, desk: &Desk, camera: &Camera, time_s: f64, exposure_s: f64) -> f64 {
    let [open, close] = [-0.5, 0.5].map(|s| walk.pose(time_s + s * exposure_s));
    let eye = Point3::from(open.inverse().translation.vector);
    let reach = 0.5 * desk.size_m;
    [Vector3::zeros(), Vector3::new(reach, 0.0, 0.0), Vector3::new(0.0, reach, -0.5 * reach), 3.0 * (desk.target - eye)]
        .iter()
        .filter_map(|d| {
            let point: Point3<f64> = desk.target + d;
            Some((camera.project(&(open * point))? - camera.project(&(close * point))?).norm())
        })
        .fold(0.0, f64::max)
}

/// The same shot with the camera turned while the shutter is open: 25 to 40 pixels per 640 of width.
fn smear(mut shot: Shot, camera: &Camera, rng: &mut ChaCha8Rng) -> Shot {
    let length_px = rng.random_range(25.0..40.0) * f64::from(camera.width_px()) / 640.0;
    let direction: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let axis = nalgebra::Unit::new_normalize(Vector3::new(direction.cos(), direction.sin(), 0.0));
    let moments = length_px.ceil() as usize;
    let middle = shot.camera_from_object;
    shot.shutter = (0..moments)
        .map(|k| {
            let angle = length_px / camera.focal_px().x * ((k as f64 + 0.5) / moments as f64 - 0.5);
            UnitQuaternion::from_axis_angle(&axis, angle) * middle
        })
        .collect();
    shot
}
