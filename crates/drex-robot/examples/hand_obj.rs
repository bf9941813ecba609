//! Writes the collision shapes of a posed robot as an OBJ file.
//!
//! ```text
//! cargo run --example hand_obj -- leap_right hand.obj if_mcp=0.9 th_cmc=1.2
//! cargo run --example hand_obj -- path/to/robot.urdf robot.obj --mid-range
//! ```

use std::fmt::Write;
use std::path::Path;

use drex_robot::{Error, Result, Robot};
use nalgebra::Isometry3;

fn main() {
    if let Err(e) = run() {
        eprintln!("{e}");
        std::process::exit(1);
    }
}

fn run() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (Some(model), Some(out)) = (arguments.next(), arguments.next()) else {
        eprintln!("usage: hand_obj MODEL OUT.obj [--mid-range] [JOINT=RAD ...]");
        std::process::exit(2);
    };
    let robot = Robot::resolve(&model, Path::new("."))?;
    for remark in &robot.unsupported {
        eprintln!("not used: {remark}");
    }
    let mut q = robot.reference_position();
    for argument in arguments {
        if argument == "--mid-range" {
            q = robot.mid_range();
            continue;
        }
        let value = argument.split_once('=').and_then(|(name, v)| Some((name, v.parse::<f64>().ok()?)));
        let Some((name, value)) = value else {
            eprintln!("\"{argument}\" is not JOINT=RAD");
            std::process::exit(2);
        };
        q[robot.require_joint(name)?] = value;
    }
    let text = obj(&robot, &q);
    std::fs::write(&out, text).map_err(|e| Error::from(drex_core::Error::io("write", &out, e)))
}

/// One group per shape, in the world frame, metres.
fn obj(robot: &Robot, q: &[f64]) -> String {
    let poses = robot.forward_kinematics(q, &Isometry3::identity());
    let mut text = String::new();
    let mut first = 1;
    for (link, geom) in robot.collision_geoms() {
        let Some(mesh) = geom.shape.to_mesh(32) else { continue };
        let name = geom.name.as_deref().unwrap_or("shape");
        // Writing to a string cannot fail.
        let _ = writeln!(text, "g {}/{name}", robot.links[link].name);
        for v in &mesh.transformed(&(poses[link] * geom.link_from_geom)).vertices {
            let _ = writeln!(text, "v {:.7} {:.7} {:.7}", v.x, v.y, v.z);
        }
        for f in &mesh.faces {
            let _ = writeln!(text, "f {} {} {}", f[0] + first, f[1] + first, f[2] + first);
        }
        first += mesh.vertices.len() as u32;
    }
    text
}
