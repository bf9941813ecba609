//! Real pushes of a hand beside simulated ones of the same object, hand and noise: how much wider is the real interval?
//! `cargo run --release -p drex-sysid --example simulated_hand -- RUNS [--seeds N]`; the folder RUNS holds one folder per run, and
//! `../true_mass_kg.json` the weighed masses, which only the simulation reads.
//!
//! The hand moves its joints as logged, the object stands where the track and the fingertips say. Efforts are joint friction
//! as calibrated, gravity, inertia and the simulated contact torques, with friction that differs from run to run, noise, and link
//! masses as they scatter; the track has the tracker's noise and delay.

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use drex_core::{Object, Pose, Trajectory};
use drex_diffsim::{
    ActuatorKind, Articulation, Base, Body, BodyState, Collider, Control, Model, Part, Scene, State, StaticBody,
    Workspace, step,
};
use drex_mesh::{AssetOptions, build_asset};
use drex_recording::JointLog;
use drex_recording::convert::allegro_run;
use drex_recording::{Drive, HandPush, PushRecording};
use drex_robot::{Robot, joint_order};
use drex_sysid::bound::{BoundOptions, Topple, of_topple};
use drex_sysid::calibrate::{CalibrateOptions, HandCalibration, HandRun, hand};
use drex_sysid::frames::{FoundFrames, FrameOptions, HandPlacement, Standing, TipPath, against_hand, find, tip_paths};
use drex_sysid::{Identification, IdentifyOptions, identify};
use nalgebra::{Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;

type Any<T> = Result<T, Box<dyn Error>>;

/// Friction of object against table and fingertips.
const FRICTION: f64 = 0.6;
/// Standard deviation of the masses of the links, as a fraction.
const LINK_MASS_SD: f64 = 0.1;
/// Time over which errors of an effort are alike, s.
const ALIKE_S: f64 = 0.05;
/// Speed at which dry friction has its full size, rad/s.
const SLIPS: f64 = 0.05;

fn main() -> Any<()> {
    let mut args = std::env::args().skip(1);
    let folder = PathBuf::from(args.next().ok_or("give the folder of the runs")?);
    let seeds: u64 = args.nth(1).map_or(Ok(3), |n| n.parse())?;
    let mut folders: Vec<PathBuf> =
        std::fs::read_dir(&folder)?.map(|e| Ok(e?.path())).collect::<std::io::Result<_>>()?;
    folders.sort();
    let load = |f: &PathBuf| allegro_run::load(f, &joint_order::ALLEGRO_ROS);
    let recordings = folders.iter().map(load).collect::<Result<Vec<_>, _>>()?;
    let runs: Vec<HandRun<'_>> = recordings.iter().filter_map(HandRun::of).collect();
    let Some(Drive::Hand(first)) = recordings.first().map(|r| &r.drive) else { return Err("no run has a hand".into()) };
    let robot = Arc::new(Robot::resolve(&first.robot, &folder)?);
    let calibration = hand(&runs, &robot, &CalibrateOptions::default())?;
    let truth: Value = serde_json::from_str(&std::fs::read_to_string(folder.join("../true_mass_kg.json"))?)?;

    let out = &mut std::io::stdout();
    writeln!(out, "run        weighed  real, kg          log width | simulated, kg, and log widths")?;
    let (mut real_sum, mut simulated_sum, mut compared, mut inside, mut all) = (0.0, 0.0, 0.0, 0, 0);
    for (folder, recording) in folders.iter().zip(&recordings) {
        let run: Value = serde_json::from_str(&std::fs::read_to_string(folder.join("run.json"))?)?;
        let mass = truth[run["object"].as_str().unwrap_or_default()].as_f64().ok_or("no weighed mass")?;
        let push = Push::of(recording, &robot, &calibration)?;
        let Some(real) = push.identify(recording)?.ci95_kg else {
            writeln!(out, "{:9} {mass:8.3}  no interval", recording.name)?;
            continue;
        };
        write!(out, "{:9} {mass:8.3}  {} {:9.2} |", recording.name, text(real), width(real))?;
        let mut widths = Vec::new();
        for seed in 0..seeds {
            let simulated = push.simulated(mass, seed)?;
            let answer = push.identify(&simulated)?;
            let Some(got) = answer.ci95_kg else {
                write!(out, "  no interval")?;
                continue;
            };
            write!(out, "  {} {:5.2}", text(got), width(got))?;
            inside += usize::from(got[0] <= mass && mass <= got[1]);
            all += 1;
            widths.push(width(got));
        }
        if widths.is_empty() {
            writeln!(out)?;
            continue;
        }
        let mean = widths.iter().sum::<f64>() / widths.len() as f64;
        writeln!(out, "  ratio {:.2}", width(real) / mean)?;
        (real_sum, simulated_sum, compared) = (real_sum + width(real), simulated_sum + mean, compared + 1.0);
    }
    writeln!(
        out,
        "mean log width {:.2} real, {:.2} simulated: ratio {:.2}; {inside} of {all} simulated intervals hold the mass",
        real_sum / compared,
        simulated_sum / compared,
        real_sum / simulated_sum
    )?;
    Ok(())
}

/// A recorded push and what is found about it.
struct Push<'a> {
    recording: &'a PushRecording,
    log: &'a HandPush,
    robot: &'a Arc<Robot>,
    calibration: &'a HandCalibration,
    solid: Standing,
    object: Object,
    found: FoundFrames,
    /// Camera in the world of the hand; height of the table there; delay of the track.
    world_from_camera: Pose,
    table_m: f64,
    delay_s: f64,
}

impl<'a> Push<'a> {
    fn of(recording: &'a PushRecording, robot: &'a Arc<Robot>, calibration: &'a HandCalibration) -> Any<Self> {
        let (Drive::Hand(log), Some(run)) = (&recording.drive, HandRun::of(recording)) else {
            return Err("no hand".into());
        };
        let object = build_asset(&recording.mesh, &AssetOptions::in_metres())?.to_exact_object("")?;
        let solid = Standing::of(&object)?;
        let mut found = find(&recording.track, &solid, &FrameOptions::of(recording))?;
        let extra = calibration.extra_torque(&run, robot)?;
        let touches = extra.touches(robot);
        let tips = tip_paths(robot, &log.world_from_base, &extra, &touches, found.motion_start_s);
        let stated = recording.support.table_height_m;
        // Stand it as the fall shows it.
        let placement = against_hand(&found, &recording.track, &solid, &tips, stated).ok();
        let topple = Topple {
            robot,
            world_from_base: &log.world_from_base,
            table_height_m: stated,
            extra: &extra,
            touches: &touches,
            track: &recording.track,
            solid: &solid,
            found: &found,
            placement: placement.as_ref(),
            gravity_m_s2: recording.gravity.norm(),
        };
        let turn = found.turns[of_topple(&topple, &BoundOptions::default())?.turn];
        (found.tracked_from_mesh, found.up_in_mesh) = (turn.tracked_from_mesh, solid.firm(&turn.up_in_mesh));
        let (world_from_camera, table_m, delay_s) = match against_hand(&found, &recording.track, &solid, &tips, stated)
        {
            Ok(HandPlacement { world_from_camera, height_offset_m, clock_offset_s, .. }) => {
                (world_from_camera, stated - height_offset_m[0], clock_offset_s[0])
            }
            Err(_) => (behind_the_fastest(&found, &solid, &tips, stated), stated, 0.1),
        };
        Ok(Self { recording, log, robot, calibration, solid, object, found, world_from_camera, table_m, delay_s })
    }

    fn identify(&self, recording: &PushRecording) -> Any<Identification> {
        let mut options = IdentifyOptions::default();
        options.hand = Some(self.calibration.clone());
        Ok(identify(std::slice::from_ref(recording), &self.object, &options)?)
    }

    /// The same push of an object of `mass`.
    fn simulated(&self, mass: f64, seed: u64) -> Any<PushRecording> {
        let motion = self.simulate(mass)?;
        let mut n = normals(seed);
        let mut out = self.recording.clone();
        out.track = self.track(&motion, &mut n)?;
        let joints = self.efforts(&motion, &mut n);
        out.drive = Drive::Hand(HandPush { joints, ..self.log.clone() });
        Ok(out)
    }

    /// Where the object stands at rest, upright on the table.
    fn rest(&self) -> Pose {
        let seen = self.recording.track.poses()[0];
        let tilted = self.world_from_camera * seen * self.found.tracked_from_mesh;
        let up = tilted.rotation * self.found.up_in_mesh;
        let upright = UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_default() * tilted.rotation;
        let center = tilted * self.solid.unit.center_of_mass;
        let arm = upright * self.solid.unit.center_of_mass.coords;
        let z = self.table_m - self.solid.lowest(&self.found.up_in_mesh);
        Pose::from_parts(Translation3::new(center.x - arm.x, center.y - arm.y, z), upright)
    }

    fn simulate(&self, mass: f64) -> Any<Motion> {
        let body =
            Body::new(&self.object.mass_properties, mass, Arc::new(Collider::of_parts(&self.object.convex_parts)?));
        let mut arm = Articulation::new(self.robot.clone(), Base::Fixed(self.log.world_from_base))?;
        for joint in &mut arm.joints {
            (joint.armature, joint.damping, joint.friction_loss, joint.limits) = (1e-4, 0.0, 0.0, None);
        }
        // Stiff drives: the joints go where they were logged.
        for drive in &mut arm.actuators {
            drive.kind = ActuatorKind::Position { kp: 50.0, kv: 0.1 };
            (drive.force_range, drive.ctrl_range, drive.gear) = (None, None, 1.0);
        }
        arm.materials.iter_mut().for_each(|m| m.friction = FRICTION);
        let columns: Vec<usize> =
            self.log.joints.names.iter().map(|n| self.robot.require_joint(n)).collect::<Result<_, _>>()?;
        let vector = |row: &Vec<f64>| {
            let mut q: Vec<f64> = self.robot.joints.iter().map(|j| j.reference).collect();
            columns.iter().zip(row).for_each(|(&j, x)| q[j] = *x);
            q
        };
        let times = &self.log.joints.times_s;
        let controls = self.log.joints.positions.iter().map(|row| {
            let q = vector(row);
            arm.actuators.iter().map(|a| q[a.joint]).collect()
        });
        let mut scene = Scene::empty();
        scene.gravity = self.recording.gravity;
        scene.static_bodies.push(StaticBody::table(self.table_m, FRICTION));
        scene.controls.push(Control::sampled(times, controls.collect())?);
        // Nothing happens before the touch, and nothing that matters long after it.
        let start = (self.found.motion_start_s - 1.2).max(times[0]);
        let first = times.partition_point(|t| *t < start);
        let arm_state = arm.at_rest(&vector(&self.log.joints.positions[first]), start)?;
        let mut model = Model::new(vec![body]).with_articulation(arm);
        model.dt_s = 1e-3;
        let mut state = State::new(vec![BodyState::at_rest(self.rest())], vec![arm_state]);
        state.time_s = start;
        let mut work = Workspace::default();
        let mut motion = Motion { times_s: Vec::new(), poses: Vec::new(), contact_nm: Vec::new() };
        let until = (self.found.motion_start_s + 2.0).min(times[times.len() - 1]);
        while state.time_s < until {
            step(&model, &scene, &mut state, &mut work)?;
            let q = &state.articulations[0].q;
            let links = self.robot.forward_kinematics(q, &self.log.world_from_base);
            let mut torque = vec![0.0; q.len()];
            for c in work.contacts() {
                let (link, force) = match (c.key.a, c.key.b) {
                    (Part::Link { link, .. }, _) => (link, c.force),
                    (_, Part::Link { link, .. }) => (link, -c.force),
                    _ => continue,
                };
                let (linear, _) = self.robot.jacobian(&links, link as usize, &Point3::from(c.point));
                // What the drive must hold against.
                torque.iter_mut().enumerate().for_each(|(j, t)| *t -= linear.column(j).dot(&force));
            }
            motion.times_s.push(state.time_s);
            motion.poses.push(state.bodies[0].world_from_body);
            motion.contact_nm.push(torque);
        }
        Ok(motion)
    }

    /// What the tracker would have seen.
    fn track(&self, motion: &Motion, n: &mut impl FnMut() -> f64) -> Any<Trajectory> {
        let noise = self.found.noise;
        let (camera, tracked) = (self.world_from_camera.inverse(), self.found.tracked_from_mesh.inverse());
        let times = self.recording.track.times_s();
        let pose = |t: &f64| {
            let seen = camera * motion.poses[motion.index(t - self.delay_s)] * tracked;
            let shift = noise.position_m.map(|sd| sd * n());
            let turn = UnitQuaternion::from_scaled_axis(noise.rotation_rad.map(|sd| sd * n()));
            Pose::from_parts(Translation3::from(seen.translation.vector + shift), seen.rotation * turn)
        };
        let poses: Vec<Pose> = times.iter().map(pose).collect();
        Ok(Trajectory::from_samples(times, &poses)?)
    }

    /// What the drives would have logged.
    fn efforts(&self, motion: &Motion, n: &mut impl FnMut() -> f64) -> JointLog {
        let mut log = self.log.joints.clone();
        let down = self.log.world_from_base.rotation.inverse() * self.recording.gravity;
        let links = 1.0 + LINK_MASS_SD * n();
        let times = log.times_s.clone();
        let gravity: Vec<Vec<f64>> = log
            .positions
            .iter()
            .map(|row| {
                let mut q: Vec<f64> = self.robot.joints.iter().map(|j| j.reference).collect();
                for (name, x) in log.names.iter().zip(row) {
                    self.robot.joint_index(name).into_iter().for_each(|j| q[j] = *x);
                }
                self.robot.gravity_torque(&q, &down).iter().copied().collect()
            })
            .collect();
        for (column, name) in log.names.iter().enumerate() {
            let (Some(j), Some(c)) = (self.robot.joint_index(name), self.calibration.joint(name)) else { continue };
            let repeats = c.repeatability_nm * n();
            let factor = c.load_factor[0] + c.load_factor[1] * n() * f64::from(u8::from(c.load_factor_seen));
            let white = (c.noise_nm.powi(2) - c.repeatability_nm.powi(2)).max(1e-6).sqrt();
            let q = |t: f64| {
                let k = times.partition_point(|s| *s < t).clamp(1, times.len() - 1);
                let s = ((t - times[k - 1]) / (times[k] - times[k - 1])).clamp(0.0, 1.0);
                let (a, b) = (self.log.joints.positions[k - 1][column], self.log.joints.positions[k][column]);
                a + s * (b - a)
            };
            let (h, mut held, mut before) = (0.02, n(), times[0]);
            for (k, &t) in times.iter().enumerate() {
                let v = (q(t + h) - q(t - h)) / (2.0 * h);
                let a = (q(t + h) - 2.0 * q(t) + q(t - h)) / (h * h);
                let keep = (-(t - before) / ALIKE_S).exp();
                held = keep * held + (1.0 - keep * keep).max(0.0).sqrt() * n();
                before = t;
                let contact = motion.contact(j, t);
                let dry = (v / SLIPS).tanh() * (c.coulomb_nm[0] + repeats);
                log.efforts[k][column] = dry
                    + c.viscous_nms[0] * v
                    + factor * (links * gravity[k][j] + contact)
                    + c.inertia_kg_m2[0] * a
                    + white * held;
            }
        }
        log
    }
}

/// What was simulated, per step.
struct Motion {
    times_s: Vec<f64>,
    poses: Vec<Pose>,
    contact_nm: Vec<Vec<f64>>,
}

impl Motion {
    /// The step at `t`; the first before, the last after.
    fn index(&self, t: f64) -> usize {
        self.times_s.partition_point(|s| *s < t).min(self.times_s.len() - 1)
    }

    /// Mean contact torque of joint `j` about `t`; a hundredth of a second is what a drive sees.
    fn contact(&self, j: usize, t: f64) -> f64 {
        if t < self.times_s[0] || t > self.times_s[self.times_s.len() - 1] {
            return 0.0;
        }
        let rows = &self.contact_nm[self.index(t - 0.005)..=self.index(t + 0.005)];
        rows.iter().map(|r| r[j]).sum::<f64>() / rows.len() as f64
    }
}

/// The camera where the object stands before the fingertip that goes farthest, where no touch tells better.
fn behind_the_fastest(found: &FoundFrames, solid: &Standing, tips: &[TipPath], table_m: f64) -> Pose {
    let touch = found.motion_start_s - 0.1;
    let way = |t: &TipPath| (t.at(touch + 0.4) - t.at(touch)).xy().norm();
    let Some(tip) = tips.iter().max_by(|a, b| way(a).total_cmp(&way(b))) else { return found.world_from_camera };
    let d = tip.at(touch + 0.4) - tip.at(touch);
    let push = Vector3::new(d.x, d.y, 0.0).normalize();
    let lean = found.topples_towards_in_tracked.unwrap_or_else(Vector3::x);
    let lean = found.tracked_from_mesh.rotation.inverse() * lean;
    let middle = solid.hull.bounds().map_or_else(Point3::origin, |(a, b)| nalgebra::center(&a, &b));
    let behind = solid.hull.vertices.iter().map(|v| -lean.dot(&(v - middle))).fold(0.0, f64::max);
    let at = tip.at(touch).coords + push * (behind + tip.radius_m);
    let yaw =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_axis_angle(&Vector3::z_axis(), push.y.atan2(push.x)));
    Pose::from_parts(Translation3::new(at.x, at.y, table_m), yaw) * found.world_from_camera
}

fn width([lo, hi]: [f64; 2]) -> f64 {
    (hi / lo).ln()
}

fn text([lo, hi]: [f64; 2]) -> String {
    format!("{lo:.3} to {hi:.3}")
}

/// Standard normal numbers: sums of twelve uniform ones.
fn normals(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(0x1234_5678_9ABC_DEF1);
    move || {
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }
}
