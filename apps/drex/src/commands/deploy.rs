//! `drex deploy`: everything that driving the hand takes, in one file; and the grasp itself, with a hand or an emulated one.

use std::time::Instant;

use anyhow::{Result, bail};
use drex_hw::can::is_interface;
use drex_twin::Predictor;
use drex_twin::deploy::{DeployTo, Deployed, Limits, deploy, limit_to_driver};
use drex_twin::timings::{self, Timing};
use serde_json::json;

use super::hw;
use crate::cli::DeployArgs;
use crate::ui::Ui;

/// Predicts, writes the file, and grasps if there is a hand.
pub fn run(args: &DeployArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    // Before there is a hand that could be left with its torque on.
    let stop = hw::stop_button()?;
    let options = args.options();
    if let DeployTo::Port { port, .. } = &options.to
        && !port.exists()
        && !is_interface(port)
    {
        bail!("there is no port {}: check the cable and the name", port.display());
    }
    let of = &args.grasp;
    let mut predictor = Predictor::open(&of.twin_or_policy, of.mesh.as_deref(), &of.options(), seed)?;
    limit_to_driver(&mut predictor.robot, &options.setup)?;
    let prediction = predictor.predict()?;
    if let Some(reason) = &prediction.cannot_hold {
        bail!("there is no grasp to deploy: {reason}");
    }
    let begun = Instant::now();
    let Deployed { file, limits, done, .. } =
        deploy(&predictor, &prediction, &options, &stop, ui).map_err(hw::with_allow_flag)?;
    let mut timing = Timing::of(begun.elapsed().as_secs_f64());
    timing.input = Some(args.grasp.twin_or_policy.clone());
    timing.parts = [("network", prediction.network_ms), ("force", prediction.force_ms)]
        .map(|(part, ms)| (part.to_owned(), 1e-3 * ms))
        .into();
    timings::record(&predictor.root, "deploy", timing)?;
    let most = limits.force.iter().copied().fold(0.0, f64::max);
    let short = limits.short_nm.iter().copied().fold(0.0, f64::max);
    let mut text = format!(
        "{}: {:.2} N on {:.0} g, at most {most:.3} {}\n  written  {}\n",
        prediction.grasp.hand,
        prediction.grip_force_n,
        1e3 * prediction.mass_kg,
        limits.unit,
        file.display()
    );
    text += &limits_text(&limits);
    if short > 0.0 {
        text += &format!(
            "  note     the limits leave a joint {short:.3} N m short of the grip force: the cap is {:.3} {}, --cap raises it\n",
            limits.cap, limits.unit
        );
    }
    match &done {
        Some(done) => text += &hw::grasp_text(done, &prediction.grasp.joint_names, limits.unit),
        None => text += "  note     no hand moved: give --port PATH or --emulate",
    }
    let driven = done.as_ref().map(|d| hw::grasp_json(d, &prediction.grasp.joint_names));
    ui.answer(&json!({ "out": file, "hand": prediction.grasp.hand, "limits": limits, "driven": driven }), text)
}

/// The cap in force, the motors, and what is not known of them.
fn limits_text(limits: &Limits) -> String {
    let mut text = match limits.motor {
        Some(motor) => {
            let known = if limits.motor_assumed { " (assumed: no hand was asked)" } else { "" };
            format!("  motors   {motor}{known}, cap {} mA per joint\n", limits.cap)
        }
        None => format!("  cap      {:.3} N m at most per joint\n", limits.cap),
    };
    let uncalibrated = limits.law.as_ref().is_none_or(|law| !law.is_calibrated());
    if let Some((low, high)) = limits.published_nm.filter(|_| uncalibrated) {
        let most = limits.force.iter().copied().fold(0.0, f64::max);
        text += &format!(
            "  note     nobody has calibrated these motors: at {most:.3} {} published torque-current models give {low:.3} to {high:.3} N m; drex hw calibrate\n",
            limits.unit
        );
    }
    text
}
