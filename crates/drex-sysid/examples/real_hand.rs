//! Everything that recorded runs of a hand tell before an object is weighed.
use std::error::Error;
use std::io::Write;
use std::path::PathBuf;

use drex_core::clock::{Clock, parse_utc_offset};
use drex_core::readers::read_foundation_pose_log;
use drex_core::TriMesh;
use drex_sysid::frames::{FrameOptions, against_hand, find, tip_paths};
use drex_core::push::{Drive, InputChoice, PushRecording};
use drex_robot::Robot;
use drex_sysid::bound::{BoundOptions, Topple, of_topple};
use drex_sysid::calibrate::{CalibrateOptions, HandRun, hand};
use nalgebra::Vector3;
use serde_json::Value;

fn vector(v: &Value) -> Vector3<f64> {
    Vector3::from_fn(|i, _| v[i].as_f64().unwrap_or(f64::NAN))
}

fn main() -> Result<(), Box<dyn Error>> {
    let runs = PathBuf::from(std::env::args().nth(1).ok_or("give the folder of the runs")?);
    let mut folders: Vec<PathBuf> = std::fs::read_dir(&runs)?.map(|e| Ok(e?.path())).collect::<std::io::Result<_>>()?;
    folders.sort();
    let mut out = std::io::stdout();
    let mut loaded = Vec::new();
    let mut run_objects = std::collections::BTreeMap::new();
    let masses: Value = serde_json::from_str(&std::fs::read_to_string(runs.join("../true_mass_kg.json"))?)?;
    let mut found = std::collections::BTreeMap::new();
    for folder in folders {
        let run: Value = serde_json::from_str(&std::fs::read_to_string(folder.join("run.json"))?)?;
        let utc = parse_utc_offset(run["pose_clock"].as_str().unwrap_or_default())?;
        let track = read_foundation_pose_log(&folder.join("object_poses.txt"), &Clock::LocalIso { utc_offset_minutes: utc })?;
        let zero = track.times_s()[0];
        let track = track.shifted(-zero);
        let mesh = TriMesh::read(&folder.join(run["mesh"].as_str().unwrap_or_default()))?;
        let begin = std::time::Instant::now();
        let f = find(&track, &mesh, &FrameOptions::default())?;
        let up = vector(&run["up_in_tracked_frame"]);
        let lean = vector(&run["topples_towards_in_tracked_frame"]);
        writeln!(
            out,
            "{:9} up {:5.1} deg off, lean {:5.1} deg off, odds of the next {:.1e}; rest to {:.2} s, moves {:.3} +- {:.3} s, trusted to {:.2} s; {:.2} s",
            folder.file_name().unwrap_or_default().to_string_lossy(),
            up.angle(&f.up_in_tracked).to_degrees(),
            f.topples_towards_in_tracked.map_or(f64::NAN, |l| lean.angle(&l).to_degrees()),
            f.runner_up_odds, f.rest_s[1], f.motion_start_s, f.motion_start_sd_s, f.trusted_until_s, begin.elapsed().as_secs_f64(),
        )?;
        for (u, o) in f.alternatives.iter().take(3) {
            writeln!(out, "     other {:.2} {:.2} {:.2} odds {o:.1e}", u.x, u.y, u.z)?;
        }
        for r in &f.remarks { writeln!(out, "     {r}")?; }
        run_objects.insert(folder.file_name().unwrap_or_default().to_string_lossy().into_owned(), run["object"].as_str().unwrap_or_default().to_owned());
        found.insert(folder.file_name().unwrap_or_default().to_string_lossy().into_owned(), (f, track, mesh));
        loaded.push((folder.file_name().unwrap_or_default().to_string_lossy().into_owned(), PushRecording::load(&folder, &InputChoice::default())?));
    }
    let robot = Robot::bundled("allegro_right")?;
    let hands: Vec<HandRun<'_>> = loaded.iter().filter_map(|(name, r)| match &r.drive {
        Drive::Hand(h) => Some(HandRun { name, joints: &h.joints, world_from_base: &h.world_from_base, gravity: r.gravity }),
        _ => None,
    }).collect();
    let begin = std::time::Instant::now();
    let c = hand(&hands, &robot, &CalibrateOptions::default())?;
    writeln!(out, "calibrated in {:.2} s", begin.elapsed().as_secs_f64())?;
    for j in &c.joints {
        writeln!(out, "{} c {:.3?} k {:.2?} {} b {:.3?} I {:.4?} arm {:?} noise {:.4} rep {:.4} start {:.2} holds {:.3} spans {}", j.joint, j.coulomb_nm, j.load_factor, j.load_factor_seen, j.viscous_nms, j.inertia_kg_m2, j.armature_kg_m2, j.noise_nm, j.repeatability_nm, j.start_error, j.holds_nm, j.spans.len())?;
    }
    for h in &hands {
        let x = c.extra_torque(h, &robot)?;
        for t in x.touches(&robot) {
            writeln!(out, "{} {} {:.3?} {} peak {:.3} sigmas {:.1}", h.name, t.finger, t.from_to_s, t.joint, t.peak_nm, t.sigmas)?;
        }
        let (f, track, mesh) = &found[h.name];
        let tips = tip_paths(&robot, h.world_from_base, &x, &x.touches(&robot), f.motion_start_s);
        let placed = against_hand(f, track, mesh, &tips, 0.062);
        match &placed {
            Ok(p) => writeln!(out, "  {} clock {:.3?} height {:.3?} rms {:.4} n {} push {:.2} {:.2}", h.name, p.clock_offset_s, p.height_offset_m, p.rms_m, p.samples, p.push_in_world.x, p.push_in_world.y)?,
            Err(e) => writeln!(out, "  {} {e}", h.name)?,
        }
        let touches = x.touches(&robot);
        let topple = Topple { robot: &robot, world_from_base: h.world_from_base, table_height_m: 0.062, extra: &x, touches: &touches, track, mesh, found: f, placement: placed.as_ref().ok(), gravity_m_s2: 9.81 };
        match of_topple(&topple, &BoundOptions::default()) {
            Ok(b) => {
                let truth: f64 = masses[run_objects[h.name].as_str()].as_f64().unwrap_or(f64::NAN);
                writeln!(out, "  BOUND {} {:?} {:.3?} n {:?} imp {:.4} work {:.4} closed {:.3} m {:.3} sdlog {:.2} eff {:.2} ci {:.3?} misfit {:.2} true {truth}", h.name, b.fingers, b.from_to_s, b.frames, b.impulse_nms, b.work_j, 1.0 / b.closed_form_per_kg, 1.0 / b.per_kg, b.sd_log(), b.sd_of_efforts_per_kg / b.per_kg, b.interval_kg(), b.misfit)?;
                writeln!(out, "      turns {:?}", b.turns.iter().map(|(w, p)| format!("{w:.2}: {:.3}", 1.0 / p)).collect::<Vec<_>>())?;
                for (n, v) in &b.budget { write!(out, "      {n} {v:.3};")?; }
                writeln!(out)?;
                for (n, m, sd, v) in &b.unknowns { write!(out, "      {n} {m:.3}+-{sd:.3}->{v:.3};")?; }
                writeln!(out)?;
            }
            Err(e) => writeln!(out, "  BOUND {} {e}", h.name)?,
        }
    }
    Ok(())
}
