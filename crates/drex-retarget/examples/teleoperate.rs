//! Teleoperation: key points in, motor angles out, a line each.
//!
//! ```text
//! your-tracker | teleoperate [leap|allegro|FILE] [vector|dexpilot|position]
//! ```
//! A line of stdin is a frame, `{"t": 0.03, "keypoints": [[x, y, z], null, ...]}`; a line of stdout is the filtered joint angles, in
//! the order of the first line, which names the joints. `drex retarget -` does the same and says more.
#![allow(clippy::print_stdout, clippy::print_stderr)] // a program for the terminal

use std::io::BufRead;

use drex_demo::HandFrame;
use drex_retarget::{Objective, RetargetOptions, Retargeter, TargetHand};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let hand = TargetHand::resolve(args.next().as_deref().unwrap_or("leap"))?;
    let objective = match args.next().as_deref() {
        None | Some("vector") => Objective::Vector,
        Some("dexpilot") => Objective::DexPilot,
        Some("position") => Objective::Position,
        Some(other) => return Err(format!("no objective {other}: vector, dexpilot or position").into()),
    };
    let mut retargeter = Retargeter::new(&hand, RetargetOptions::new(objective))?;
    println!("{}", hand.robot.joint_names().join(" "));
    for (number, line) in std::io::stdin().lock().lines().enumerate() {
        match HandFrame::from_json_line(&line?, number + 1) {
            Ok(frame) => {
                let angles = retargeter.frame(&frame).q_filtered;
                println!("{}", angles.iter().map(|q| format!("{q:.4}")).collect::<Vec<_>>().join(" "));
            }
            // The hand stays where it is.
            Err(e) => eprintln!("{e}"),
        }
    }
    Ok(())
}
