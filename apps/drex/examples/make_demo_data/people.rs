//! Clips of a made-up person who takes the tin: key points of a hand that comes near, closes and holds.
//!
//! The person's hand has the proportions of a LEAP hand but for its size; where it goes is a search on the tin. What
//! differing proportions do is the business of recorded demonstrations.

use std::path::Path;

use anyhow::Result;
use drex_bench::tin::normal3;
use drex_core::Pose;
use drex_demo::{Demonstration, HandFrame, HumanFinger, KEYPOINTS, KeyPoints};
use drex_grasp::{Grasp, pinch_grasps};
use drex_mesh::Asset;
use drex_retarget::TargetHand;
use nalgebra::{Point3, Translation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Clips, and pinches that the search looks at.
const CLIPS: usize = 4;
const CANDIDATES: usize = 30_000;
/// Frames of the approach and of the hold, and frames per second.
const APPROACH: usize = 12;
const HOLD: usize = 8;
const FPS: f64 = 15.0;
/// Where the approach begins: this far back, metres, and fingers opened by this share.
const RETREAT_M: f64 = 0.06;
const OPENED: f64 = 0.5;
/// Noise of the key points, metres.
const POINT_SD_M: f64 = 0.0004;

/// Writes `clip_N.json`.
pub fn make(tin: &Asset, folder: &Path, seed: u64) -> Result<()> {
    let target = TargetHand::bundled("leap_right")?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let holds = holds(tin, &target, seed)?;
    for (i, hold) in holds.iter().enumerate() {
        let demo = clip(&target, hold, &mut rng);
        demo.save_json(&folder.join(format!("clip_{i}.json")))?;
    }
    eprintln!("{} clips", holds.len());
    Ok(())
}

/// Grasps with the thumb and most fingers, easy to hold, from sides that differ.
fn holds(tin: &Asset, target: &TargetHand, seed: u64) -> Result<Vec<Grasp>> {
    let robot = &target.robot;
    let mut found = pinch_grasps(&tin.to_object("tin")?, robot, CANDIDATES, seed)?;
    let fingers = robot.fingers();
    let touches =
        |g: &Grasp, links: &[usize]| g.contacts.iter().any(|c| links.iter().any(|l| robot.links[*l].name == c.link));
    found.retain(|g| fingers.iter().filter(|f| touches(g, &f.links)).count() > 2);
    let force = |g: &Grasp| g.grip_force_n.unwrap_or(f64::INFINITY);
    found.sort_by(|a, b| force(a).total_cmp(&force(b)));
    let mut out: Vec<Grasp> = Vec::new();
    for f in found {
        let apart = |o: &Grasp| o.object_from_base.rotation.angle_to(&f.object_from_base.rotation) > 0.5;
        if out.len() < CLIPS && out.iter().all(apart) {
            out.push(f);
        }
    }
    Ok(out)
}

/// The hand comes from behind the palm, closes, and holds.
fn clip(target: &TargetHand, hold: &Grasp, rng: &mut ChaCha8Rng) -> Demonstration {
    let robot = &target.robot;
    let size = rng.random_range(0.95..1.0);
    let back = (hold.object_from_base.translation.vector - Vector3::z() * 0.04).normalize();
    let open = robot.reference_position();
    let frames = (0..APPROACH + HOLD)
        .map(|k| {
            let left = 1.0 - (k as f64 / APPROACH as f64).min(1.0);
            let q: Vec<f64> = hold.joints_rad.iter().zip(&open).map(|(q, o)| q + OPENED * left * (o - q)).collect();
            let pose = Translation3::from(back * RETREAT_M * left) * hold.object_from_base;
            let recorded =
                |p: Point3<f64>, noise: Vector3<f64>| (p + noise * POINT_SD_M).map(|c| (c * 1e5).round() / 1e5);
            let points = key_points(target, &q, size, &pose).map(|p| p.map(|p| recorded(p, normal3(rng))));
            let mut frame = HandFrame::new(k as f64 / FPS, points);
            (frame.index, frame.source_from_object) = (k, Some(Pose::identity()));
            frame
        })
        .collect();
    let mut demo = Demonstration::new("a made-up person", target.side, frames);
    demo.up = Some(Vector3::z_axis());
    demo
}

/// Key points of a hand of `size` times the robot's; a finger that the robot does not have lies beside its neighbour.
fn key_points(target: &TargetHand, q: &[f64], size: f64, object_from_base: &Pose) -> KeyPoints {
    let poses = target.robot.forward_kinematics(q, object_from_base);
    let wrist = object_from_base * Point3::from(target.base_from_operator.translation.vector);
    let scaled = |p: Point3<f64>| wrist + (p - wrist) * size;
    let mut points: KeyPoints = [None; KEYPOINTS];
    points[0] = Some(wrist);
    for finger in &target.fingers {
        let tip = scaled(poses[finger.tip.link] * finger.tip.point);
        let middle = scaled(poses[finger.middle.link] * finger.middle.point);
        let first = target.robot.path_to(finger.middle.link).into_iter().find(|&l| l != 0);
        let base = first.map_or(middle, |l| scaled(Point3::from(poses[l].translation.vector)));
        let along = [base, middle, nalgebra::center(&middle, &tip), tip];
        let at = finger.human.base();
        for (point, p) in points[at..at + 4].iter_mut().zip(along) {
            *point = Some(p);
        }
    }
    let [ring, middle, little] = [HumanFinger::Ring, HumanFinger::Middle, HumanFinger::Little].map(|f| f.base());
    for k in 0..4 {
        if let (None, Some(r), Some(m)) = (points[little + k], points[ring + k], points[middle + k]) {
            points[little + k] = Some(r + (r - m));
        }
    }
    points
}
