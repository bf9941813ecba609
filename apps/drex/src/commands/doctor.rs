//! `drex doctor`: what is on this machine, and what is missing for which feature.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Result;
use drex_robot::Robot;
use serde::Serialize;

use crate::ui::Ui;

/// One thing that was looked for.
#[derive(Debug, Serialize)]
struct Check {
    name: &'static str,
    found: bool,
    detail: String,
    needed_for: &'static str,
    /// What to do when it is missing; empty when it was found.
    remedy: String,
}

/// The answer of `drex doctor --json`.
#[derive(Debug, Serialize)]
struct Diagnosis {
    version: &'static str,
    os: &'static str,
    threads: usize,
    /// Whether everything that `drex run` and `drex demo` need is there.
    ready: bool,
    checks: Vec<Check>,
}

/// Looks around and reports. Missing optional things are no failure.
pub fn run(ui: &Ui) -> Result<()> {
    let required = vec![writable_temporary_folder(), bundled_hand("leap_right"), bundled_hand("allegro_right")];
    let ready = required.iter().all(|c| c.found);
    // Cameras of photos need no other program; COLMAP is worth a line only where somebody has it.
    let colmap = program("colmap", &["-h"], "another opinion on cameras of photos (`--colmap`); optional", "");
    let optional = [
        program(
            "ffmpeg",
            &["-version"],
            "frames from a video of the object",
            "install it with your package manager, for example `apt-get install ffmpeg`",
        ),
        python_module("mujoco", "mujoco", "comparison with MuJoCo and loading the asset there"),
        // Later ones come without their models.
        python_module("mediapipe", "\"mediapipe==0.10.14\" opencv-python-headless", "hands in videos (`drex hands`)"),
        python_module("dex_retargeting", "dex-retargeting", "comparison with the reference retargeter"),
        devices(
            "serial port",
            "/dev",
            &["ttyUSB", "ttyACM"],
            "a LEAP hand (Dynamixel over USB)",
            "plug in the U2D2 adapter",
        ),
        devices(
            "CAN interface",
            "/sys/class/net",
            &["can", "vcan", "slcan"],
            "an Allegro hand (CAN)",
            "plug in the adapter, then `ip link set can0 up type can bitrate 1000000`",
        ),
        recordings(),
    ];
    let diagnosis = Diagnosis {
        version: env!("CARGO_PKG_VERSION"),
        os: std::env::consts::OS,
        threads: rayon::current_num_threads(),
        ready,
        checks: required.into_iter().chain(optional).chain(Some(colmap).filter(|c| c.found)).collect(),
    };
    ui.answer(&diagnosis, text(&diagnosis))
}

fn text(d: &Diagnosis) -> String {
    let mut out = format!("drex {} on {}, {} threads\n", d.version, d.os, d.threads);
    for c in &d.checks {
        let mark = if c.found { "ok     " } else { "missing" };
        out += &format!("{mark}  {}: {}\n         for {}\n", c.name, c.detail, c.needed_for);
        if !c.remedy.is_empty() {
            out += &format!("         to get it: {}\n", c.remedy);
        }
    }
    out + if d.ready {
        "Ready: `drex demo` and `drex run` have all they need."
    } else {
        "Not ready: see the missing ones above."
    }
}

fn writable_temporary_folder() -> Check {
    let folder = std::env::temp_dir();
    let probe = folder.join(format!("drex-doctor-{}", std::process::id()));
    let written = std::fs::write(&probe, b"probe").and_then(|()| std::fs::remove_file(&probe));
    Check {
        name: "temporary folder",
        found: written.is_ok(),
        detail: match &written {
            Ok(()) => format!("{} is writable", folder.display()),
            Err(e) => format!("{}: {e}", folder.display()),
        },
        needed_for: "every stage",
        remedy: if written.is_ok() { String::new() } else { "free some disk space or set TMPDIR".into() },
    }
}

fn bundled_hand(name: &'static str) -> Check {
    let loaded = Robot::bundled(name);
    Check {
        name: if name == "leap_right" { "LEAP hand model" } else { "Allegro hand model" },
        found: loaded.is_ok(),
        detail: match &loaded {
            Ok(robot) => format!("{name}, {} joints, bundled", robot.dof()),
            Err(e) => e.to_string(),
        },
        needed_for: "grasps and replayed pushes",
        remedy: if loaded.is_ok() { String::new() } else { "this build is damaged: install drex again".into() },
    }
}

fn program(name: &'static str, arguments: &[&str], needed_for: &'static str, remedy: &str) -> Check {
    let output = Command::new(name).args(arguments).output();
    let first_line = output.as_ref().ok().and_then(|o| {
        let text = String::from_utf8_lossy(&o.stdout).into_owned() + &String::from_utf8_lossy(&o.stderr);
        text.lines().find(|l| !l.trim().is_empty()).map(str::to_owned)
    });
    let found = output.is_ok();
    Check {
        name,
        found,
        detail: first_line.unwrap_or_else(|| "not on PATH".into()),
        needed_for,
        remedy: if found { String::new() } else { remedy.to_owned() },
    }
}

fn python_module(name: &'static str, package: &str, needed_for: &'static str) -> Check {
    let code = format!("import importlib.metadata as m; print(m.version('{}'))", name.replace('_', "-"));
    let version = Command::new("python3")
        .args(["-c", &code])
        .output()
        .ok()
        .filter(|o| o.status.success())
        .map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned());
    Check {
        name,
        found: version.is_some(),
        detail: version.as_ref().map_or_else(|| "no such Python package".into(), |v| format!("Python package {v}")),
        needed_for,
        remedy: if version.is_some() {
            String::new()
        } else {
            format!("`pip install {package}` in a virtual environment")
        },
    }
}

fn devices(name: &'static str, folder: &str, prefixes: &[&str], needed_for: &'static str, remedy: &str) -> Check {
    let mut found: Vec<String> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(|e| e.ok()?.file_name().into_string().ok())
        .filter(|n| prefixes.iter().any(|p| n.starts_with(p)))
        .collect();
    found.sort();
    Check {
        name,
        found: !found.is_empty(),
        detail: if found.is_empty() { "none".into() } else { found.join(", ") },
        needed_for,
        remedy: if found.is_empty() { remedy.to_owned() } else { String::new() },
    }
}

fn recordings() -> Check {
    let root = std::env::var_os("DREX_SHARED").map(PathBuf::from);
    let found = root.as_deref().is_some_and(|r: &Path| r.join("data").is_dir());
    Check {
        name: "reference recordings",
        found,
        detail: root.map_or_else(|| "DREX_SHARED is not set".into(), |r| format!("DREX_SHARED={}", r.display())),
        needed_for: "the tests on real data (others run without)",
        remedy: if found { String::new() } else { "set DREX_SHARED to the folder that holds data/".into() },
    }
}
