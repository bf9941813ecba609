//! `drex calibrate-hand`: joint friction of a hand from logs of its runs.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use drex_recording::{Drive, PushRecording};
use drex_robot::Robot;
use drex_sysid::calibrate::{CalibrateOptions, HandCalibration, HandRun, hand};

use crate::cli::CalibrateHandArgs;
use crate::ui::Ui;

/// Loads the runs, fits, writes.
pub fn run(args: &CalibrateHandArgs, ui: &Ui) -> Result<()> {
    let mut recordings = Vec::new();
    for path in args.runs.iter().map(|p| pushes(p)).collect::<Result<Vec<_>>>()?.concat() {
        recordings.push(PushRecording::load(&path)?);
    }
    let mut model = None::<String>;
    for recording in &recordings {
        let Drive::Hand(push) = &recording.drive else {
            bail!(
                "{} was not pushed by a logged hand, so it says nothing about joints; give runs with a joint log ([hand] in push.toml)",
                recording.name
            )
        };
        match &model {
            None => model = Some(push.robot.clone()),
            Some(first) if *first != push.robot => {
                bail!(
                    "{} is of the hand {}, the first run of {first}; calibrate one hand at a time",
                    recording.name,
                    push.robot
                )
            }
            Some(_) => {}
        }
    }
    let Some(model) = model else { bail!("there is no run") };
    let robot = Robot::resolve(&model, Path::new("."))?;
    let runs: Vec<HandRun<'_>> = recordings.iter().filter_map(HandRun::of).collect();
    let calibration = hand(&runs, &robot, &CalibrateOptions::default())?;
    calibration.save(&args.out)?;
    ui.answer(&serde_json::to_value(&calibration)?, text(&calibration, &args.out))
}

/// `path` itself if it is a push, else the pushes one folder below it.
fn pushes(path: &Path) -> Result<Vec<PathBuf>> {
    let is_push = |p: &Path| p.join("push.toml").is_file();
    if !path.is_dir() || is_push(path) {
        return Ok(vec![path.to_path_buf()]);
    }
    let entries = std::fs::read_dir(path).map_err(|e| drex_core::Error::io("list", path, e))?;
    let mut below: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).filter(|p| is_push(p)).collect();
    below.sort();
    if below.is_empty() {
        bail!(
            "no push.toml in {} or one folder below it; give folders of pushes, as `drex import allegro-run` makes them of runs",
            path.display()
        );
    }
    Ok(below)
}

/// One line per kind of joint.
fn text(c: &HandCalibration, out: &Path) -> String {
    let mut lines = vec![format!("{} from {} run(s): {}", c.robot, c.runs.len(), c.runs.join(", "))];
    for j in c.joints.iter().filter(|j| j.alike.first() == Some(&j.joint)) {
        lines.push(format!(
            "  {}: friction {:.3} +- {:.3} N m, repeats within {:.3} N m; effort per load {:.2} +- {:.2} ({})",
            j.alike.join(" "),
            j.coulomb_nm[0],
            j.coulomb_nm[1],
            j.repeatability_nm,
            j.load_factor[0],
            j.load_factor[1],
            if j.load_factor_seen { "seen" } else { "taken from other joints" }
        ));
    }
    lines.extend(c.remarks.iter().map(|r| format!("  {r}")));
    lines.push(format!("written to {}; use it with drex identify RUN --hand {}", out.display(), out.display()));
    lines.join("\n")
}
