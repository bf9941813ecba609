//! What recorded runs of a hand tell before an object is weighed: frames, clocks, joint friction, touches, and what the efforts
//! bound. `cargo run --release -p drex-sysid --example real_hand -- RUNS [--entries]`; the folder RUNS holds one folder per run
//! (`run.json`, `object_poses.txt`, `joint_states.csv`). The frame entries of `run.json` are left out, or used with `--entries`.

use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};

use drex_core::{Pose, Trajectory};
use drex_mesh::{AssetOptions, build_asset};
use drex_recording::convert::allegro_run;
use drex_recording::{Drive, HandPush};
use drex_robot::{Robot, joint_order};
use drex_sysid::bound::{Bound, BoundOptions, Topple, of_topple};
use drex_sysid::calibrate::{CalibrateOptions, ExtraTorque, HandCalibration, HandRun, Touch, hand};
use drex_sysid::frames::{FoundFrames, FrameOptions, HandPlacement, Standing, against_hand, find, tip_paths};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use serde_json::Value;

type Any<T> = Result<T, Box<dyn Error>>;

struct Run {
    name: String,
    object: String,
    hand: HandPush,
    gravity: Vector3<f64>,
    table_height_m: f64,
    track: Trajectory,
    solid: Standing,
    up: Vector3<f64>,
    lean: Vector3<f64>,
    options: FrameOptions,
}

fn main() -> Any<()> {
    let mut args = std::env::args().skip(1);
    let folder = PathBuf::from(args.next().ok_or("give the folder of the runs")?);
    let entries = args.next().as_deref() == Some("--entries");
    let mut folders: Vec<PathBuf> =
        std::fs::read_dir(&folder)?.map(|e| Ok(e?.path())).collect::<std::io::Result<_>>()?;
    folders.sort();
    let runs = folders.iter().map(|f| load(f, entries)).collect::<Any<Vec<Run>>>()?;
    let robot = Robot::resolve(&runs.first().ok_or("there is no run")?.hand.robot, &folder)?;
    let hands: Vec<HandRun<'_>> = runs.iter().map(hand_run).collect();
    let calibration = hand(&hands, &robot, &CalibrateOptions::default())?;
    let truth = std::fs::read_to_string(folder.join("../true_mass_kg.json"));
    let truth: Value = truth.ok().and_then(|t| serde_json::from_str(&t).ok()).unwrap_or_default();

    let out = &mut std::io::stdout();
    let mut found = Vec::new();
    writeln!(
        out,
        "Frames (degrees against run.json)\nrun       up off  lean off  next best  rest until  moves at       trusted until"
    )?;
    for run in &runs {
        let f = find(&run.track, &run.solid, &run.options)?;
        frames_row(out, run, &f)?;
        found.push(f);
    }
    friction_table(out, &calibration)?;
    let mut rows = Vec::new();
    writeln!(out, "\nTouches (contact torque, N m) and the hand against the object")?;
    for ((run, h), f) in runs.iter().zip(&hands).zip(&found) {
        let extra = calibration.extra_torque(h, &robot)?;
        let touches = extra.touches(&robot);
        let tips = tip_paths(&robot, h.world_from_base, &extra, &touches, f.motion_start_s);
        let placement = against_hand(f, &run.track, &run.solid, &tips, run.table_height_m);
        touch_rows(out, run, &touches, placement.as_ref().map_err(ToString::to_string))?;
        rows.push(bound(run, &robot, f, &extra, &touches, placement.as_ref().ok()).map_err(|e| e.to_string()));
    }
    let head = ["fingers", "mN m s", "mJ", "kg", "sd(log)", "of efforts", "95 %, kg", "limited by", "weighed, kg"];
    let [fingers, impulse, work, mass, sd, efforts, interval, limits, weighed] = head;
    writeln!(
        out,
        "\nWhat the efforts tell: impulse and work about the edge, closed form, what limits it\n\
         {:9} {fingers:18} {impulse:>7} {work:>6} {mass:>6} {sd:>8} {efforts:>10}  {interval:14}  {limits:42} {weighed}",
        "run"
    )?;
    for (run, row) in runs.iter().zip(&rows) {
        match row {
            Ok(b) => bound_row(out, run, b, truth[&run.object].as_f64())?,
            Err(e) => writeln!(out, "{:9} {e}", run.name)?,
        }
    }
    Ok(())
}

fn load(folder: &Path, entries: bool) -> Any<Run> {
    let run: Value = serde_json::from_str(&std::fs::read_to_string(folder.join("run.json"))?)?;
    let vector = |key: &str| Vector3::from_fn(|i, _| run[key][i].as_f64().unwrap_or(f64::NAN));
    let mut recording = allegro_run::load(folder, &joint_order::ALLEGRO_ROS)?;
    let Drive::Hand(hand) = recording.drive.clone() else {
        return Err(format!("{} has no hand", folder.display()).into());
    };
    let entry = &run["tracked_from_mesh"];
    let rotation = Matrix3::from_fn(|i, j| entry["rotation_rows"][i][j].as_f64().unwrap_or(f64::NAN));
    let at = Vector3::from_fn(|i, _| entry["translation_m"][i].as_f64().unwrap_or(f64::NAN));
    let tracked_from_mesh = Pose::from_parts(at.into(), UnitQuaternion::from_matrix(&rotation));
    // With its entries a run is in the frame of the mesh; without, in the tracker's own, as if it said nothing of it.
    let (options, from_tracked) = if entries {
        (FrameOptions::of(&recording), tracked_from_mesh.rotation.inverse())
    } else {
        recording.track = recording.track.right_mul(&tracked_from_mesh.inverse());
        (FrameOptions::default(), UnitQuaternion::identity())
    };
    Ok(Run {
        name: folder.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        object: run["object"].as_str().unwrap_or_default().to_owned(),
        hand,
        gravity: recording.gravity,
        table_height_m: recording.support.table_height_m,
        track: recording.track,
        solid: Standing::of(&build_asset(&recording.mesh, &AssetOptions::in_metres())?.to_exact_object("")?)?,
        up: from_tracked * vector("up_in_tracked_frame"),
        lean: from_tracked * vector("topples_towards_in_tracked_frame"),
        options,
    })
}

fn hand_run(run: &Run) -> HandRun<'_> {
    HandRun {
        name: &run.name,
        joints: &run.hand.joints,
        world_from_base: &run.hand.world_from_base,
        gravity: run.gravity,
    }
}

fn bound(
    run: &Run,
    robot: &Robot,
    found: &FoundFrames,
    extra: &ExtraTorque,
    touches: &[Touch],
    placement: Option<&HandPlacement>,
) -> drex_sysid::Result<Bound> {
    let topple = Topple {
        robot,
        world_from_base: &run.hand.world_from_base,
        table_height_m: run.table_height_m,
        extra,
        touches,
        track: &run.track,
        solid: &run.solid,
        found,
        placement,
        gravity_m_s2: run.gravity.norm(),
    };
    of_topple(&topple, &BoundOptions::default())
}

fn frames_row(out: &mut impl Write, run: &Run, f: &FoundFrames) -> std::io::Result<()> {
    writeln!(
        out,
        "{:9} {:6.1}  {:8.1}  {:9.0e}  {:8.2} s  {:.2} +- {:.2} s  {:.2} s",
        run.name,
        run.up.angle(&f.up_in_tracked).to_degrees(),
        f.topples_towards_in_tracked.map_or(f64::NAN, |l| run.lean.angle(&l).to_degrees()),
        f.runner_up_odds,
        f.rest_s[1],
        f.motion_start_s,
        f.motion_start_sd_s,
        f.trusted_until_s
    )?;
    f.remarks.iter().try_for_each(|r| writeln!(out, "          {r}"))
}

fn friction_table(out: &mut impl Write, c: &HandCalibration) -> std::io::Result<()> {
    writeln!(
        out,
        "\nFriction of {} from {} runs\njoints              Coulomb, N m     load factor         inertia, g m2    noise  repeats within, N m",
        c.robot,
        c.runs.len()
    )?;
    for j in c.joints.iter().filter(|j| j.alike.first() == Some(&j.joint)) {
        writeln!(
            out,
            "{:19} {:.3} +- {:.3}   {:.2} +- {:.2} {}   {:.2} +- {:.2}    {:.4}   {:.4}",
            j.alike.join(" "),
            j.coulomb_nm[0],
            j.coulomb_nm[1],
            j.load_factor[0],
            j.load_factor[1],
            if j.load_factor_seen { "seen " } else { "taken" },
            1e3 * j.inertia_kg_m2[0],
            1e3 * j.inertia_kg_m2[1],
            j.noise_nm,
            j.repeatability_nm
        )?;
    }
    c.remarks.iter().try_for_each(|r| writeln!(out, "  {r}"))
}

fn touch_rows(
    out: &mut impl Write,
    run: &Run,
    touches: &[Touch],
    placement: Result<&HandPlacement, String>,
) -> std::io::Result<()> {
    for t in touches {
        writeln!(
            out,
            "{:9} {:7} {:.2} to {:.2} s  {:.3} at {} ({:.0} sd)",
            run.name, t.finger, t.from_to_s[0], t.from_to_s[1], t.peak_nm, t.joint, t.sigmas
        )?;
    }
    match placement {
        Ok(p) => writeln!(
            out,
            "{:9} tracker late by {:.2} +- {:.2} s; hand {:+.0} +- {:.0} mm higher than stated; tips within {:.1} mm of the face",
            run.name,
            p.clock_offset_s[0],
            p.clock_offset_s[1],
            1e3 * p.height_offset_m[0],
            1e3 * p.height_offset_m[1],
            1e3 * p.rms_m
        ),
        Err(e) => writeln!(out, "{:9} {e}", run.name),
    }
}

fn bound_row(out: &mut impl Write, run: &Run, b: &Bound, truth: Option<f64>) -> std::io::Result<()> {
    let [lo, hi] = b.mass.ends_kg();
    writeln!(
        out,
        "{:9} {:18} {:7.1} {:6.1} {:>6} {:8.2} {:10.2}  {:.3} to {:.3}  {:42} {}",
        run.name,
        b.fingers.join(" "),
        1e3 * b.impulse_nms,
        1e3 * b.work_j,
        format!("{:.3}", b.mass.median_kg()),
        b.mass.sd_log(),
        b.sd_of_efforts_per_kg / b.per_kg.max(0.0),
        lo,
        hi,
        b.limits(),
        truth.map_or("unknown".into(), |m| format!("{m:.3}"))
    )
}
