//! Teleoperation: one frame per line in, one per line out.

use std::io::{BufRead, Write};

use anyhow::{Result, bail};
use drex_demo::{HandFrame, Side};
use drex_retarget::Retargeter;
use serde_json::json;

use super::file::FrameRecord;
use super::{hand, options};
use crate::cli::{ObjectiveArg, RetargetArgs};
use crate::ui::Ui;

/// Answers each line of stdin until it ends. The first answer names the joints. A line that is no frame is answered with what is
/// wrong, and the next one is read: a hand on the bench must not stop for one bad line.
pub fn run(args: &RetargetArgs, ui: &Ui) -> Result<()> {
    if args.objective == ObjectiveArg::Grasp {
        bail!("the grasp objective works on whole clips; from stdin use vector, dexpilot or position");
    }
    if args.out.is_some() || args.picture.is_some() {
        bail!("a stream is answered on stdout; leave out --out and --picture");
    }
    let clip_only = [
        ("--object", args.object.is_some()),
        ("--augment", args.augment.is_some()),
        ("--frames", args.reading.frames.is_some()),
        ("--object-poses", args.reading.object_poses.is_some()),
    ];
    if let Some((name, _)) = clip_only.iter().find(|(_, given)| *given) {
        bail!("{name} is for whole clips; leave it out for a stream");
    }
    let side = args.reading.side.map_or(Side::Right, Into::into);
    let hand = hand(args, side, ui)?;
    let mut retargeter = Retargeter::new(&hand, options(args))?;
    let mut out = std::io::stdout().lock();
    let head = json!({ "hand": hand.robot.name, "joint_names": hand.robot.joint_names(), "unit": "rad" });
    // A closed pipe is the reader's decision to stop.
    if writeln!(out, "{head}").and_then(|()| out.flush()).is_err() {
        return Ok(());
    }
    let mut reader = std::io::stdin().lock();
    let mut bytes = Vec::new();
    for number in 1.. {
        bytes.clear();
        if reader.read_until(b'\n', &mut bytes)? == 0 {
            break;
        }
        let line = String::from_utf8_lossy(&bytes);
        if line.trim().is_empty() {
            continue;
        }
        let answer = match HandFrame::from_json_line(line.trim_end(), number) {
            Ok(frame) => serde_json::to_string(&FrameRecord::new(number - 1, &retargeter.frame(&frame)))?,
            Err(e) => json!({ "frame": number - 1, "error": e.to_string() }).to_string(),
        };
        if writeln!(out, "{answer}").and_then(|()| out.flush()).is_err() {
            break;
        }
    }
    Ok(())
}
