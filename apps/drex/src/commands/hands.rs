//! `drex hands`: key points of a hand in a video, by a detector that is installed on this machine.

use std::ffi::OsString;
use std::time::Duration;

use anyhow::{Result, bail};
use drex_demo::{ExternalDetector, HandDetector, MediaPipe};
use serde_json::json;

use super::retarget::load_options;
use crate::cli::{DetectorArg, HandsArgs};
use crate::ui::Ui;

/// Detects, looks the key points over, writes them.
pub fn run(args: &HandsArgs, ui: &Ui) -> Result<()> {
    let timeout = Duration::try_from_secs_f64(args.timeout).unwrap_or(Duration::MAX);
    let detector: Box<dyn HandDetector> = match (&args.detector, args.command.split_first()) {
        (DetectorArg::Mediapipe, None) => {
            let mut detector = MediaPipe::default();
            detector.python = OsString::from(&args.python);
            (detector.confidence, detector.timeout) = (args.confidence, timeout);
            Box::new(detector)
        }
        (DetectorArg::Command, Some((program, rest))) => {
            let rest: Vec<&str> = rest.iter().map(String::as_str).collect();
            let mut detector = ExternalDetector::new(program, program, &rest);
            (detector.format, detector.timeout) = (args.format.clone(), timeout);
            Box::new(detector)
        }
        (DetectorArg::Mediapipe, Some(_)) => bail!("give --detector command to run a command of your own"),
        (DetectorArg::Command, None) => {
            bail!("give the command after --, such as: drex hands v.mp4 --detector command -- detect {{video}} {{out}}")
        }
    };
    let spinner = ui.spinner(detector.name());
    let demo = detector.detect(&args.video, &load_options(&args.reading));
    spinner.finish_and_clear();
    let demo = demo?;
    let report = demo.check();
    demo.save_json(&args.out)?;
    let mut lines = vec![format!("{} frames of a {} hand by {}", demo.frames.len(), demo.side, detector.name())];
    lines.extend(demo.notes.iter().chain(&report.notes).map(|note| format!("  note     {note}")));
    lines.push(format!(
        "  written  {}; use it with drex retarget {} --hand leap",
        args.out.display(),
        args.out.display()
    ));
    let notes: Vec<_> = demo.notes.iter().chain(&report.notes).collect();
    ui.answer(
        &json!({ "frames": demo.frames.len(), "side": demo.side, "notes": notes, "out": args.out }),
        lines.join("\n"),
    )
}
