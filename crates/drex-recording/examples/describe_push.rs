//! How a push of your own is written down: makes a folder with a mesh, a track, a force and their `push.toml`, reads it as `drex identify`
//! does, and says what is in it.
//!
//!     cargo run -p drex-recording --example describe_push -- [FOLDER]
//!
//! Without FOLDER the files go to the folder for temporary files. Change one of them and name the folder of a push that is there already:
//! it is read as it is, and what is wrong is said with file, line and remedy.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::fmt::Write;
use std::path::{Path, PathBuf};

use drex_core::fsutil::write_atomic;
use drex_core::{Result, TriMesh};
use drex_recording::{Drive, PushRecording};

/// A block of 60 x 40 x 30 mm, the origin of its mesh in the middle, m.
const BLOCK: &str = "v -0.03 -0.02 -0.015\nv 0.03 -0.02 -0.015\nv 0.03 0.02 -0.015\nv -0.03 0.02 -0.015\n\
                     v -0.03 -0.02 0.015\nv 0.03 -0.02 0.015\nv 0.03 0.02 0.015\nv -0.03 0.02 0.015\n\
                     f 1 3 2\nf 1 4 3\nf 5 6 7\nf 5 7 8\nf 1 2 6\nf 1 6 5\nf 2 3 7\nf 2 7 6\nf 3 4 8\nf 3 8 7\nf 4 1 5\nf 4 5 8\n";

/// Files are named relative to the description; units are in the names of the keys.
const DESCRIPTION: &str = r#"schema = 1
name = "slide"
mesh = "block.obj"

[track] # poses of the mesh frame, from a camera
file = "poses.csv"
format = "pose_csv"
frame = "world"
clock = { kind = "relative" }

[support]
table_height_m = 0.0

[force] # what the finger did, from its sensor
file = "force.csv"
point_in_object_m = [-0.03, 0.0, 0.0]
clock = { kind = "relative" }
"#;

fn main() {
    let folder =
        std::env::args_os().nth(1).map_or_else(|| std::env::temp_dir().join("drex-describe-push"), PathBuf::from);
    if let Err(e) = run(&folder) {
        eprintln!("{e}");
        std::process::exit(1);
    }
}

fn run(folder: &Path) -> Result<()> {
    if folder.join("push.toml").exists() {
        println!("reading {}, which is there already", folder.display());
    } else {
        write(folder)?;
        println!("wrote {}", folder.display());
    }

    let push = PushRecording::load(folder)?;
    println!("{}: {}", push.name, push.notes.join("; "));
    let block = TriMesh::read(&push.mesh)?.mass_properties(1.0)?;
    println!("the mesh encloses {:.1} cm³", 1e6 * block.mass_kg); // at 1 kg/m³ the mass is the volume
    let (start_s, end_s) = push.track.span_s().unwrap_or_default();
    let fastest = push.track.speeds().iter().map(|s| s.linear_m_s).fold(0.0, f64::max);
    println!("{} poses from {start_s:.2} to {end_s:.2} s, at most {:.0} mm/s", push.track.len(), 1e3 * fastest);
    if let Some(noise) = push.track.noise() {
        let pooled = noise.pooled();
        println!(
            "noise of the track: {:.2} mm, {:.2} degrees",
            1e3 * pooled.position_m,
            pooled.rotation_rad.to_degrees()
        );
        println!("at rest for its first {} poses", push.track.leading_rest(&noise, 6.0));
    }
    for gap in push.track.gaps(1.5) {
        println!("no pose from {:.2} to {:.2} s", gap.start_s, gap.end_s);
    }
    if let Drive::Force(force) = &push.drive {
        println!("pushed with up to {:.2} N", force.forces_n.iter().map(|f| f.norm()).fold(0.0, f64::max));
    }
    Ok(())
}

/// A block that rests for half a second, is pushed for another and slides to a stop; tracked at 30 Hz, two poses missing.
fn write(folder: &Path) -> Result<()> {
    let mut poses = String::from("t,x,y,z,qw,qx,qy,qz\n");
    for k in (0..45).filter(|k| ![20, 21].contains(k)) {
        let t = f64::from(k) / 30.0;
        let pushed = (t - 0.5).clamp(0.0, 0.5);
        let after = (t - 1.0).clamp(0.0, 0.25);
        let x = 0.2 * pushed * pushed + 0.2 * after - 0.4 * after * after;
        let noise = 2e-4 * (7.3 * f64::from(k)).sin(); // made up, the same at every run
        let _ = writeln!(poses, "{t:.4},{:.5},{:.5},0.015,1,0,0,0", x + noise, 0.5 * noise);
    }
    let mut force = String::from("t,fx,fy,fz\n");
    for k in 0..150 {
        let t = f64::from(k) / 100.0;
        let _ = writeln!(force, "{t:.2},{},0,0", if (0.5..1.0).contains(&t) { 0.9 } else { 0.0 });
    }
    for (name, text) in [("block.obj", BLOCK), ("poses.csv", &poses), ("force.csv", &force), ("push.toml", DESCRIPTION)]
    {
        write_atomic(&folder.join(name), text.as_bytes())?;
    }
    Ok(())
}
