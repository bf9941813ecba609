//! Calibration of a hand and what its efforts weigh: made-up logs of known friction and contact, and real ones.

use std::path::PathBuf;

use crate::common::{box_mesh, normals, object_at, object_of, pushed_by, shared};
use drex_core::{Object, Pose, Trajectory, TriMesh};
use drex_recording::JointLog;
use drex_recording::convert::allegro_run;
use drex_recording::{Drive, HandPush, PushRecording, TrackFrame};
use drex_robot::{Robot, joint_order};
use drex_sysid::bound::{Bound, BoundOptions, Topple, of_topple};
use drex_sysid::calibrate::{CalibrateOptions, ExtraTorque, HandCalibration, HandRun, hand};
use drex_sysid::frames::{FrameOptions, HandPlacement, Standing, against_hand, find, tip_paths};
use drex_sysid::{Identification, IdentifyOptions, Parameter, Verdict, identify};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
/// Truth of the made-up hand: Coulomb friction (N m), load factor, inertia (kg m²).
const FRICTION: (f64, f64, f64) = (0.08, 1.8, 0.003);

/// A quantity over time.
type Curve<'a> = &'a dyn Fn(f64) -> f64;

/// The Allegro hand with its fingers hanging down, 0.25 m up.
fn allegro() -> (Robot, Pose) {
    let turned = UnitQuaternion::from_quaternion(Quaternion::new(0.0, 0.0, -1.0, 0.0));
    (Robot::bundled("allegro_right").unwrap(), Isometry3::from_parts(Translation3::new(0.14, -0.08, 0.25), turned))
}

/// A log of all joints at 300 Hz from positions and contact torques of the joints `moving`, with efforts of the made-up hand.
fn log(robot: &Robot, base: &Pose, seconds: f64, moving: &[(usize, Curve<'_>, Curve<'_>)], seed: u64) -> JointLog {
    let mut n = normals(seed);
    let gravity = base.rotation.inverse() * DOWN;
    let names = robot.joint_names().iter().map(|s| (*s).to_owned()).collect();
    let mut out = JointLog { names, ..JointLog::default() };
    let drift: Vec<f64> = (0..robot.dof()).map(|_| 0.004 * n()).collect();
    for k in 0..(300.0 * seconds) as usize {
        let t = k as f64 / 300.0;
        let mut q = vec![0.0; robot.dof()];
        let h = 4e-3;
        for (j, position, _) in moving {
            q[*j] = position(t);
        }
        let g = robot.gravity_torque(&q, &gravity);
        let mut e = vec![0.0; robot.dof()];
        let mut v = vec![0.0; robot.dof()];
        for (j, position, contact) in moving {
            v[*j] = (position(t + h) - position(t - h)) / (2.0 * h);
            let a = (position(t + h) - 2.0 * position(t) + position(t - h)) / (h * h);
            let (c, factor, inertia) = FRICTION;
            let dry = if v[*j].abs() > 1e-3 { v[*j].signum() * (c + drift[*j]) } else { 0.0 };
            e[*j] = dry + factor * (g[*j] + contact(t)) + inertia * a + 0.01 * n();
        }
        out.times_s.push(t);
        out.positions.push(q);
        out.velocities.push(v);
        out.efforts.push(e);
    }
    out
}

/// A motion from 0 by `way` in `seconds` from `start` on, without jumps of velocity.
fn sweep(t: f64, start: f64, seconds: f64, way: f64) -> f64 {
    let s = ((t - start) / seconds).clamp(0.0, 1.0);
    way * s * s * (3.0 - 2.0 * s)
}

#[test]
fn friction_load_factor_and_touches_come_out_of_logs_that_name_none() {
    let (robot, base) = allegro();
    let j = |name: &str| robot.joint_index(name).unwrap();
    let push = |t: f64, from: f64, to: f64, size: f64| {
        if (from..to).contains(&t) { size * (std::f64::consts::PI * (t - from) / (to - from)).sin() } else { 0.0 }
    };
    let fast = |t: f64| sweep(t, 0.5, 0.9, 1.1);
    let slow = |t: f64| sweep(t, 0.5, 1.6, 1.3);
    let none = |_: f64| 0.0;
    let first = |t: f64| push(t, 0.7, 1.1, 0.06);
    let second = |t: f64| push(t, 0.9, 1.5, 0.05);
    let logs = [
        log(&robot, &base, 3.0, &[(j("ffj1"), &fast, &first), (j("mfj1"), &fast, &none), (j("rfj1"), &fast, &none)], 1),
        log(
            &robot,
            &base,
            3.0,
            &[(j("ffj1"), &slow, &none), (j("mfj1"), &slow, &second), (j("rfj1"), &slow, &second)],
            2,
        ),
        log(
            &robot,
            &base,
            3.0,
            &[(j("ffj1"), &fast, &second), (j("mfj1"), &slow, &second), (j("rfj1"), &slow, &none)],
            3,
        ),
    ];
    let runs: Vec<HandRun<'_>> = ["a", "b", "c"]
        .iter()
        .zip(&logs)
        .map(|(name, joints)| HandRun { name, joints, world_from_base: &base, gravity: DOWN })
        .collect();
    let c = hand(&runs, &robot, &CalibrateOptions::default()).unwrap();
    assert_eq!(c.joints.len(), 3);
    let ff = c.joint("ffj1").unwrap();
    assert_eq!(ff.alike, ["ffj1", "mfj1", "rfj1"]);
    assert!((ff.coulomb_nm[0] - FRICTION.0).abs() < 0.01, "{:?}", ff.coulomb_nm);
    assert!(ff.load_factor_seen && (ff.load_factor[0] / FRICTION.1 - 1.0).abs() < 0.15, "{:?}", ff.load_factor);
    assert!((ff.load_factor[0] - FRICTION.1).abs() < 3.0 * ff.load_factor[1] + 0.1);
    assert!((ff.inertia_kg_m2[0] - FRICTION.2).abs() < 0.002, "{:?}", ff.inertia_kg_m2);
    // At rest there is no friction in these logs, and the noise is 10 mN m.
    assert!((0.015..0.08).contains(&ff.holds_nm), "{}", ff.holds_nm);
    let (curve, at) = (ff.friction_nm(0.5, 0.05)[0], FRICTION.0 + (FRICTION.1 - 1.0) * 0.05);
    assert!((curve - at).abs() < 0.015, "{curve} for {at}");

    let touched: Vec<Vec<(String, [f64; 2])>> = runs
        .iter()
        .map(|r| {
            c.extra_torque(r, &robot).unwrap().touches(&robot).into_iter().map(|t| (t.finger, t.from_to_s)).collect()
        })
        .collect();
    let expected = [
        vec![("index", [0.7, 1.1])],
        vec![("middle", [0.9, 1.5]), ("ring", [0.9, 1.5])],
        vec![("index", [0.9, 1.4]), ("middle", [0.9, 1.5])],
    ];
    for (run, (found, expected)) in touched.iter().zip(&expected).enumerate() {
        assert_eq!(found.len(), expected.len(), "run {run}: {found:?}");
        for (name, span) in expected {
            let hit =
                found.iter().find(|f| f.0 == *name).unwrap_or_else(|| panic!("run {run}: {name} is not in {found:?}"));
            assert!(
                (hit.1[0] - span[0]).abs() < 0.15 && (hit.1[1] - span[1]).abs() < 0.2,
                "run {run}: {hit:?} for {span:?}"
            );
        }
    }
    let x = c.extra_torque(&runs[0], &robot).unwrap();
    let peak = x.times_s.iter().position(|t| *t >= 0.9).unwrap();
    let (value, sd) = (x.torque_nm[j("ffj1")][peak], x.sd_nm[j("ffj1")][peak]);
    assert!((value - 0.06).abs() < 3.0 * sd.hypot(x.scale_sd[j("ffj1")] * value), "{value} +- {sd}");
    assert!(sd < 0.01, "{sd}");
    // The force of that finger along the push, straight ahead of the palm.
    let index = &robot.fingers()[0];
    let force = x.tip_force(&robot, index, &base, peak, Some((-Vector3::x(), 0.3))).unwrap();
    let poses = robot.forward_kinematics(&x.positions[peak], &base);
    let lever = robot.jacobian(&poses, index.tip_link, &force.point).0.column(j("ffj1")).dot(&-Vector3::x());
    assert!((force.force_n.dot(&-Vector3::x()) * lever / 0.06 - 1.0).abs() < 0.25, "{force:?} {lever}");
    assert!(force.covariance.symmetric_eigenvalues().min() > 0.0);

    let file = tempfile::tempdir().unwrap().path().join("hand.json");
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    c.save(&file).unwrap();
    assert_eq!(HandCalibration::load(&file).unwrap(), c);
}

#[test]
fn bad_logs_are_refused_by_name() {
    let (robot, base) = allegro();
    let still = |_: f64| 0.3;
    let none = |_: f64| 0.0;
    let good = log(&robot, &base, 1.0, &[(1, &still, &none)], 1);
    let message = |joints: &JointLog, robot: &Robot| {
        let run = HandRun { name: "push7", joints, world_from_base: &base, gravity: DOWN };
        hand(&[run], robot, &CalibrateOptions::default()).unwrap_err().to_string()
    };
    assert!(message(&good, &robot).contains("no joint moves"));
    let other = message(&good, &Robot::bundled("leap_right").unwrap());
    assert!(other.contains("push7") && other.contains("not of the hand"), "{other}");
    let silent = JointLog { efforts: Vec::new(), ..good.clone() };
    assert!(message(&silent, &robot).contains("effort"));
    let mut short = good;
    short.times_s.truncate(10);
    short.positions.truncate(10);
    short.efforts.truncate(10);
    assert!(message(&short, &robot).contains("shorter"));
    assert!(hand(&[], &robot, &CalibrateOptions::default()).unwrap_err().to_string().contains("no run"));
}

/// A box that a finger topples, made so that finger, lean and effort fit a mass: the joint log and the camera's track.
struct MadeTopple {
    joints: JointLog,
    track: Trajectory,
    mesh: TriMesh,
}

/// Lean at time `t`: slow at first, then falling.
fn lean(t: f64) -> f64 {
    let s = (t - 1.0).max(0.0);
    (0.9 * s * s * s / (0.15 + s * s) + 0.5 * (s - 0.5).max(0.0).powi(2) * 8.0).min(std::f64::consts::FRAC_PI_2)
}

/// Half extents of the box, and the world height of the table.
const HALF: [f64; 3] = [0.03, 0.04, 0.07];
const TABLE: f64 = 0.05;
const DELAY: f64 = 0.08;

fn made_topple(robot: &Robot, base: &Pose, mass: f64, seed: u64) -> MadeTopple {
    let index = &robot.fingers()[0];
    let j = index.joints[1];
    let tip = |q: f64| {
        let mut all = vec![0.0; robot.dof()];
        all[j] = q;
        let poses = robot.forward_kinematics(&all, base);
        let center = poses[index.tip_link] * Point3::new(0.0, 0.0, -0.012);
        let lever = -robot.jacobian(&poses, index.tip_link, &(poses[index.tip_link] * index.tip_point)).0[(0, j)];
        (-center.x, center.z - TABLE, lever)
    };
    // The face behind, one radius from the ball: x = edge + … of a box that turns about its front edge.
    let touch_q = 0.25;
    let rest_x = tip(touch_q).0 + 0.012 + HALF[0];
    let face = |lean: f64, z: f64| rest_x + HALF[0] - 2.0 * HALF[0] / lean.cos() + z * lean.tan() - 0.012 / lean.cos();
    let q_of = |t: f64| {
        if t < 1.0 {
            return touch_q - 0.8 * (1.0 - t).min(touch_q / 0.8);
        }
        let angle = lean(t).min(0.6);
        let (mut lo, mut hi) = (touch_q - 0.05, 1.5);
        for _ in 0..50 {
            let mid = 0.5 * (lo + hi);
            let (x, z, _) = tip(mid);
            if x < face(angle, z) { lo = mid } else { hi = mid }
        }
        0.5 * (lo + hi)
    };
    let table: Vec<f64> = (0..=3000).map(|k| q_of(k as f64 / 1000.0)).collect();
    // Smooth over 20 ms, as a drive would.
    let q = |t: f64| {
        let at = |t: f64| {
            let s = (t * 1000.0).clamp(0.0, 2999.0);
            let k = s as usize;
            table[k] + (table[k + 1] - table[k]) * (s - k as f64)
        };
        (-10..=10).map(|i| at(t + 0.001 * f64::from(i))).sum::<f64>() / 21.0
    };
    let inertia = (HALF[0].powi(2) + HALF[2].powi(2)) / 3.0 + HALF[0].powi(2) + HALF[2].powi(2);
    let contact = |t: f64| {
        if t < 1.0 {
            return 0.0;
        }
        let h = 1e-3;
        let acceleration = (lean(t + h) - 2.0 * lean(t) + lean(t - h)) / (h * h);
        let arm = 9.81 * (HALF[0] * lean(t).cos() - HALF[2] * lean(t).sin());
        let moment = (mass * (arm + inertia * acceleration)).max(0.0);
        let (_, z, lever) = tip(q(t));
        if lean(t) > 0.6 { 0.0 } else { moment / z * lever }
    };
    let none = |_: f64| 0.0;
    let others = |t: f64| sweep(t, 0.5, 1.2, 1.2);
    let (m, r) = (robot.fingers()[1].joints[1], robot.fingers()[2].joints[1]);
    let joints = log(robot, base, 2.9, &[(j, &q, &contact), (m, &others, &none), (r, &others, &none)], seed);

    let mut n = normals(seed + 50);
    let view = Isometry3::look_at_rh(&Point3::new(0.5, 0.9, 0.7), &Point3::origin(), &Vector3::z());
    let flip = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let (mut times, mut poses) = (Vec::new(), Vec::new());
    for k in 0..60 {
        let t = f64::from(k) / 15.0;
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), lean(t - DELAY));
        let edge = Vector3::new(HALF[0], 0.0, 0.0);
        let center = edge + turn * (Vector3::new(0.0, 0.0, HALF[2]) - edge) + Vector3::from_fn(|_, _| 0.0005 * n());
        let noise = UnitQuaternion::from_scaled_axis(Vector3::from_fn(|_, _| 0.005 * n()));
        times.push(t);
        poses.push(flip * view * Isometry3::from_parts(Translation3::from(center), noise * turn));
    }
    let track = Trajectory::from_samples(&times, &poses).unwrap();
    MadeTopple { joints, track, mesh: box_mesh(HALF.into(), Vector3::zeros()) }
}

fn weigh(
    robot: &Robot,
    base: &Pose,
    made: &MadeTopple,
    c: &HandCalibration,
    table: f64,
) -> (Bound, HandPlacement, ExtraTorque) {
    let run = HandRun { name: "made", joints: &made.joints, world_from_base: base, gravity: DOWN };
    let extra = c.extra_torque(&run, robot).unwrap();
    let touches = extra.touches(robot);
    let solid = Standing::of(&object_of(&made.mesh)).unwrap();
    let found = find(&made.track, &solid, &FrameOptions::default()).unwrap();
    let tips = tip_paths(robot, base, &extra, &touches, found.motion_start_s);
    let placement = against_hand(&found, &made.track, &solid, &tips, table).unwrap();
    let topple = Topple {
        robot,
        world_from_base: base,
        table_height_m: table,
        extra: &extra,
        touches: &touches,
        track: &made.track,
        solid: &solid,
        found: &found,
        placement: Some(&placement),
        gravity_m_s2: 9.81,
    };
    (of_topple(&topple, &BoundOptions::default()).unwrap(), placement, extra)
}

#[test]
fn a_push_by_a_known_force_and_one_by_a_hand_are_one_answer() {
    let (robot, base) = allegro();
    let object = object_of(&box_mesh(HALF.into(), Vector3::zeros()));
    let by_hand = |mass: f64| {
        let made = made_topple(&robot, &base, mass, 15);
        let drive = HandPush { robot: "allegro_right".into(), world_from_base: base, joints: made.joints };
        let mut push = PushRecording::new("by hand", "box.obj", made.track, Drive::Hand(drive));
        push.support.table_height_m = TABLE;
        push.starts_at_rest = true;
        push.track_frame = TrackFrame::Camera { of_mesh: true, up: None, push: None };
        push
    };
    let by_force = |mass: f64, size: f64| {
        let lift = Vector3::z() * mass * 9.81 * size;
        pushed_by(&object, 0.45, mass, 0.4, [lift, Vector3::zeros()], Point3::origin())
    };
    let say = |pushes: &[PushRecording]| identify(pushes, &object, &IdentifyOptions::default()).unwrap();
    let (hand, force) = (say(&[by_hand(0.3)]), say(&[by_force(0.3, 1.6)]));
    let both = say(&[by_force(0.3, 1.6), by_hand(0.3)]);
    let product = force.likelihood().unwrap().times(&hand.likelihood().unwrap());
    assert_eq!(both.ci95_kg, Some(product.interval95_kg()), "{}", both.reason);
    assert!(both.verdict == Verdict::Identified && !both.reason.contains("DOUBTFUL"), "{}", both.reason);
    assert!(both.reason.contains(&hand.reason) && both.pushes[1].hand.is_some(), "{}", both.reason);
    // A lift of another object.
    let other = say(&[by_force(3.0, 1.6), by_hand(0.15)]);
    assert!(
        other.reason.contains("DOUBTFUL") && other.reason.contains("standard deviations apart"),
        "{}",
        other.reason
    );
    // Too weak to lift anything.
    let weak = say(&[by_force(0.3, 0.5), by_hand(0.3)]);
    assert_eq!(
        (weak.verdict, weak.ci95_kg, weak.mass_kg),
        (hand.verdict, hand.ci95_kg, hand.mass_kg),
        "{}",
        weak.reason
    );
}

#[test]
fn a_made_up_topple_gives_back_clock_height_and_mass() {
    let (robot, base) = allegro();
    let made: Vec<(f64, MadeTopple)> =
        [0.15, 0.3, 0.6].map(|m| (m, made_topple(&robot, &base, m, (100.0 * m) as u64))).into();
    let runs: Vec<HandRun<'_>> = made
        .iter()
        .map(|(_, t)| HandRun { name: "made", joints: &t.joints, world_from_base: &base, gravity: DOWN })
        .collect();
    let c = hand(&runs, &robot, &CalibrateOptions::default()).unwrap();
    let mut estimates = Vec::new();
    for (mass, t) in &made {
        let (bound, placement, _) = weigh(&robot, &base, t, &c, TABLE);
        eprintln!(
            "{mass} kg: {:?} closed {:.3} kg, {:.3} kg, interval {:.3?}, clock {:.3?}, height {:.3?}, limited by {}",
            bound.fingers,
            1.0 / bound.closed_form_per_kg,
            1.0 / bound.per_kg,
            bound.mass.ends_kg(),
            placement.clock_offset_s,
            placement.height_offset_m,
            bound.limits()
        );
        assert_eq!(bound.fingers, ["index"]);
        assert!((placement.clock_offset_s[0] - DELAY).abs() < 0.06, "{:?}", placement.clock_offset_s);
        assert!(
            placement.height_offset_m[0].abs() < 2.5 * placement.height_offset_m[1],
            "{:?}",
            placement.height_offset_m
        );
        assert!((placement.push_in_world + Vector3::x()).norm() < 0.1);
        let [lo, hi] = bound.mass.ends_kg();
        assert!(lo < *mass && *mass < hi && hi / lo < 6.0, "{lo} to {hi} for {mass}");
        estimates.push(1.0 / bound.per_kg);
        assert!((estimates[estimates.len() - 1] / mass - 1.0).abs() < 0.35, "{:?} for {mass}", estimates.last());
        // A table that is stated two centimetres too low is found out.
        let (_, moved, _) = weigh(&robot, &base, t, &c, TABLE - 0.02);
        let shift = placement.height_offset_m[0] - moved.height_offset_m[0];
        assert!((0.01..0.03).contains(&shift), "{shift}");
    }
    assert!(estimates[1] / estimates[0] > 1.5 && estimates[2] / estimates[1] > 1.5, "{estimates:?}");
}

fn real_runs() -> Option<Vec<(String, PushRecording, HandPush)>> {
    let mut folders: Vec<PathBuf> =
        std::fs::read_dir(shared()?.join("data/drex_real/runs")).unwrap().map(|e| e.unwrap().path()).collect();
    folders.sort();
    let load = |folder: PathBuf| {
        let recording = allegro_run::load(&folder, &joint_order::ALLEGRO_ROS).unwrap();
        let Drive::Hand(push) = recording.drive.clone() else { panic!("{} has no hand", folder.display()) };
        (folder.file_name().unwrap().to_string_lossy().into_owned(), recording, push)
    };
    Some(folders.into_iter().map(load).collect())
}

fn hand_runs(all: &[(String, PushRecording, HandPush)]) -> Vec<HandRun<'_>> {
    all.iter()
        .map(|(name, r, h)| HandRun {
            name,
            joints: &h.joints,
            world_from_base: &h.world_from_base,
            gravity: r.gravity,
        })
        .collect()
}

#[test]
fn real_logs_show_the_friction_and_the_touches_that_were_measured_in_them() {
    let Some(all) = real_runs() else { return };
    let robot = Robot::bundled("allegro_right").unwrap();
    let runs = hand_runs(&all);
    let c = hand(&runs, &robot, &CalibrateOptions::default()).unwrap();
    let near = c.joint("rfj1").unwrap();
    let far = c.joint("ffj3").unwrap();
    // By hand: a free finger needs 0.2 N m near standstill with its links raised, 0.08 at full speed with them hanging (both
    // with the links' gravity taken off); distal joints about 0.06; repeatable within 0.007.
    let (raised, hanging) = (near.friction_nm(0.4, 0.08)[0], near.friction_nm(2.0, 0.01)[0]);
    assert!((0.14..0.22).contains(&raised) && (0.06..0.1).contains(&hanging), "{raised} {hanging}");
    assert!((0.04..0.075).contains(&far.coulomb_nm[0]), "{:?}", far.coulomb_nm);
    assert!(near.load_factor_seen && !far.load_factor_seen);
    assert!(near.repeatability_nm < 0.013 && near.noise_nm < 0.015, "{near:?}");
    // Which fingers touch, and how hard: N m of contact torque.
    let expected = [
        ("A1", "middle", 0.01..0.06),
        ("A2", "middle", 0.01..0.06),
        ("A2", "index", 0.01..0.05),
        ("cookie1", "middle", 0.03..0.09),
        ("domino2", "middle", 0.03..0.08),
        ("ketchup1", "index", 0.05..0.1),
        ("ketchup1", "middle", 0.05..0.1),
    ];
    for (run, finger, range) in expected {
        let run = runs.iter().find(|r| r.name == run).unwrap();
        let touches = c.extra_torque(run, &robot).unwrap().touches(&robot);
        let hit = touches.iter().filter(|t| t.finger == finger).map(|t| t.peak_nm).fold(0.0, f64::max);
        assert!(range.contains(&hit), "{} {finger}: {hit} not in {range:?}", run.name);
    }
    for (run, free) in [("domino2", ["index", "ring"]), ("ketchup1", ["ring", "thumb"]), ("lego2", ["index", "middle"])]
    {
        let run = runs.iter().find(|r| r.name == run).unwrap();
        let touches = c.extra_torque(run, &robot).unwrap().touches(&robot);
        assert!(touches.iter().all(|t| !free.contains(&t.finger.as_str())), "{}: {touches:?}", run.name);
    }
}

#[test]
fn a_calibration_from_other_runs_finds_the_same_torques() {
    let Some(all) = real_runs() else { return };
    let robot = Robot::bundled("allegro_right").unwrap();
    let runs = hand_runs(&all);
    let whole = hand(&runs, &robot, &CalibrateOptions::default()).unwrap();
    for (name, joint) in [("ketchup1", "ffj1"), ("domino2", "mfj1"), ("A2", "mfj1")] {
        let others: Vec<HandRun<'_>> = runs.iter().filter(|r| r.name != name).copied().collect();
        let c = hand(&others, &robot, &CalibrateOptions::default()).unwrap();
        let run = runs.iter().find(|r| r.name == name).unwrap();
        let j = robot.joint_index(joint).unwrap();
        let peak = |c: &HandCalibration| {
            let x = c.extra_torque(run, &robot).unwrap();
            x.touches(&robot).iter().filter(|t| t.joint == joint).map(|t| t.peak_nm).fold(0.0, f64::max)
        };
        let (a, b) = (peak(&whole), peak(&c));
        eprintln!("{name} {joint} ({j}): {a:.3} with, {b:.3} N m without the run itself");
        assert!((a - b).abs() < 0.015 && b > 0.0, "{name}: {a} with, {b} without");
    }
}

#[test]
fn tracks_and_logs_of_different_runs_are_refused_with_both_times() {
    let Some(all) = real_runs() else { return };
    let robot = Robot::bundled("allegro_right").unwrap();
    let runs = hand_runs(&all);
    let c = hand(&runs, &robot, &CalibrateOptions::default()).unwrap();
    let at = |name: &str| all.iter().position(|r| r.0 == name).unwrap();
    let (cookie, ketchup) = (at("cookie1"), at("ketchup1"));
    let solid = Standing::of(&object_at(&all[ketchup].1.mesh)).unwrap();
    let found = find(&all[ketchup].1.track, &solid, &FrameOptions::default()).unwrap();
    let extra = c.extra_torque(&runs[cookie], &robot).unwrap();
    let mut tips = tip_paths(&robot, runs[cookie].world_from_base, &extra, &extra.touches(&robot), 4.5);
    // Each recording counts from its own start here; on the computer's clock the runs are half an hour apart.
    for tip in &mut tips {
        tip.times_s.iter_mut().for_each(|t| *t -= 1800.0);
        tip.touch_s.iter_mut().flatten().for_each(|t| *t -= 1800.0);
    }
    let message = against_hand(&found, &all[ketchup].1.track, &solid, &tips, 0.062).unwrap_err().to_string();
    assert!(
        message.contains("do not overlap") && message.contains("joint log") && message.contains("pose track"),
        "{message}"
    );
}

/// What identify says of a run, with a calibration or without.
fn identified(recording: &PushRecording, object: &Object, hand: Option<&HandCalibration>) -> Identification {
    let mut options = IdentifyOptions::default();
    options.hand = hand.cloned();
    identify(std::slice::from_ref(recording), object, &options).unwrap()
}

#[test]
fn intervals_of_real_objects_hold_the_weighed_mass() {
    let Some(all) = real_runs() else { return };
    let robot = Robot::bundled("allegro_right").unwrap();
    let runs = hand_runs(&all);
    let c = hand(&runs, &robot, &CalibrateOptions::default()).unwrap();
    let truth = std::fs::read_to_string(shared().unwrap().join("data/drex_real/true_mass_kg.json")).unwrap();
    let truth: serde_json::Value = serde_json::from_str(&truth).unwrap();
    for (name, recording, _) in &all {
        let object = name.trim_end_matches(|c: char| c.is_ascii_digit());
        let mass = truth[object].as_f64().unwrap();
        let solid = object_at(&recording.mesh);
        let answer = identified(recording, &solid, Some(&c));
        let [lo, hi] = answer.ci95_kg.unwrap();
        eprintln!("{name}: {lo:.3} to {hi:.3} kg, weighed {mass} kg; {}", answer.reason);
        assert!(lo < mass && mass < hi, "{name}: {lo} to {hi} without {mass}");
        assert_eq!(answer.verdict == Verdict::Identified, answer.mass_kg.is_some());
        let report = answer.pushes[0].hand.as_ref().unwrap();
        match object {
            "ketchup" => assert!(answer.verdict == Verdict::Identified && hi / lo < 4.0, "{lo} to {hi}"),
            "lego" => assert!(report.fingers == ["thumb"] && report.touch_s.is_none() && lo < 0.006, "{report:?}"),
            _ => assert!(report.clock_offset_s.is_some_and(|c| (0.0..0.2).contains(&c[0])), "{report:?}"),
        }
        let of = |p: Parameter| answer.sensitivities.iter().find(|s| s.parameter == p).map(|s| s.log_mass);
        // More torque, more mass, by the same factor.
        assert_eq!(of(Parameter::ForceGain).is_some_and(|gain| (0.8..1.2).contains(&gain)), object != "lego", "{name}");
        assert_eq!(of(Parameter::ContactHeight).is_some_and(f64::is_finite), object != "lego", "{name}");
        // A guess of the mass takes no part.
        let mut other = recording.clone();
        other.mass_prior_kg = recording.mass_prior_kg.map(|m| 10.0 * m);
        assert_eq!(identified(&other, &solid, Some(&c)).ci95_kg, answer.ci95_kg, "{name}");
        // Without efforts the hand is only replayed.
        let Drive::Hand(push) = &mut other.drive else { panic!() };
        push.joints.efforts.clear();
        let replayed = identified(&other, &solid, Some(&c));
        assert!(replayed.ci95_kg.is_none() && replayed.reason.contains("replayed"), "{}", replayed.reason);
    }
}

#[test]
fn a_joint_log_of_another_hand_is_refused_by_name() {
    let Some(all) = real_runs() else { return };
    let (name, mut recording, mut push) = all.into_iter().next().unwrap();
    let object = object_at(&recording.mesh);
    let mut message = |push: &HandPush| {
        recording.drive = Drive::Hand(push.clone());
        identify(std::slice::from_ref(&recording), &object, &IdentifyOptions::default()).unwrap_err().to_string()
    };
    push.robot = "leap_right".into();
    let other = message(&push);
    assert!(other.contains(&name) && other.contains("not of the hand"), "{other}");
    push.robot = "allegro_right".into();
    push.joints.positions[40][5] = 2.9;
    let beyond = message(&push);
    assert!(beyond.contains("beyond its limits") && beyond.contains("mfj1"), "{beyond}");
}

#[test]
fn efforts_that_cannot_be_are_no_answer() {
    let Some(all) = real_runs() else { return };
    let (_, recording, _) = all.into_iter().find(|r| r.0 == "ketchup1").unwrap();
    let object = object_at(&recording.mesh);
    let scaled = |factor: f64| {
        let mut other = recording.clone();
        if let Drive::Hand(hand) = &mut other.drive {
            hand.joints.efforts.iter_mut().flatten().for_each(|e| *e *= factor);
        }
        identify(&[other], &object, &IdentifyOptions::default())
    };
    // Columns of zeros are no efforts.
    let none = scaled(0.0).unwrap();
    assert!(none.ci95_kg.is_none() && none.reason.contains("no joint efforts"), "{}", none.reason);
    for (factor, what) in [(1e3, "its drive can do"), (-1.0, "less than nothing"), (1e-3, "less than nothing")] {
        let message = scaled(factor).unwrap_err().to_string();
        assert!(message.contains(what) && message.contains("N m"), "{factor}: {message}");
    }
}
