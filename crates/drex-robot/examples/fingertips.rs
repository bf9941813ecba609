//! What a robot model says of a hand: its fingers, where their tips are when they are half closed, how fast and how hard they can be.
//!
//!     cargo run -p drex-robot --example fingertips -- [leap_right | allegro_left | path/to/robot.urdf]
//!
//! Per finger: the tip in the frame of the base (mm), the joint that moves it most (mm per rad), and the force at the tip, straight along
//! its motion, that one joint's largest torque makes (N). Then the torques that only carry the fingers' own weight.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::path::Path;

use drex_robot::{Result, Robot};
use nalgebra::{Isometry3, Vector3};

fn main() {
    if let Err(e) = run() {
        eprintln!("{e}");
        std::process::exit(1);
    }
}

fn run() -> Result<()> {
    let name = std::env::args().nth(1).unwrap_or_else(|| "leap_right".into());
    let hand = Robot::resolve(&name, Path::new("."))?;
    println!("{name}: {} joints, {} links, {:.0} g", hand.dof(), hand.links.len(), 1e3 * hand.total_mass_kg());
    for remark in &hand.unsupported {
        println!("not used: {remark}");
    }

    let q = hand.mid_range();
    let base_from_link = hand.forward_kinematics(&q, &Isometry3::identity());
    for finger in hand.fingers() {
        let tip = base_from_link[finger.tip_link] * finger.tip_point;
        let (linear, _) = hand.jacobian(&base_from_link, finger.tip_link, &tip); // 3 x dof, m/rad
        let arm = |&j: &usize| linear.column(j).norm();
        let Some(&joint) = finger.joints.iter().max_by(|a, b| arm(a).total_cmp(&arm(b))) else { continue };
        let thumb = if finger.is_thumb && finger.name != "thumb" { " (thumb)" } else { "" };
        let mm = 1e3 * tip.coords;
        print!("{}{thumb}: tip at {:.0}, {:.0}, {:.0} mm; ", finger.name, mm.x, mm.y, mm.z);
        print!("{} moves it {:.0} mm per rad", hand.joints[joint].name, 1e3 * arm(&joint));
        match hand.joints[joint].effort_limit {
            Some(torque_nm) => println!(", {torque_nm} N m press with {:.1} N", torque_nm / arm(&joint)),
            None => println!("; the model states no torque"),
        }
    }

    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let holding = hand.gravity_torque(&q, &gravity);
    println!("carrying itself takes up to {:.3} N m, base as in the file's frame", holding.amax());
    Ok(())
}
