//! `drex deploy`: everything that driving the hand takes, in one file.

use anyhow::{Context, Result, bail};
use drex_core::fsutil;
use drex_trial::TrialOptions;
use serde::Serialize;

use crate::cli::DeployArgs;
use crate::predict::{Prediction, Ready};
use crate::ui::Ui;

/// Layout of the file.
const SCHEMA: u32 = 1;
/// Torque per current of the hand's motors that public models of LEAP use, N m/A. It is not calibrated.
const TORQUE_PER_CURRENT: f64 = 0.53;

/// `deploy.json`.
#[derive(Serialize)]
struct Deployment<'a> {
    schema: u32,
    written_by: &'static str,
    weights: Weights,
    units: Units,
    force_law: ForceLaw,
    grasp: &'a Prediction,
    /// Per joint: what the torque of the squeeze takes, mA, at the motors' nominal constant.
    current_limits_ma: Vec<f64>,
    current_note: String,
}

/// Which network it is.
#[derive(Serialize)]
struct Weights {
    policy: String,
    file: String,
    sha256: String,
}

#[derive(Serialize)]
struct Units {
    joints: &'static str,
    length: &'static str,
    mass: &'static str,
    force: &'static str,
    torque: &'static str,
    current: &'static str,
}

/// How the squeeze came about.
#[derive(Serialize)]
struct ForceLaw {
    what: &'static str,
    torque_cap_nm: f64,
    margin: f64,
    shake_m_s2: f64,
}

/// Predicts, writes the file, and says what is still missing.
pub fn run(args: &DeployArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    let ready = Ready::of(&args.grasp, seed)?;
    let grasp = ready.predict()?;
    if let Some(reason) = &grasp.cannot_hold {
        bail!("there is no grasp to deploy: {reason}");
    }
    let card = ready.folder.join("policy.json");
    let card: serde_json::Value = fsutil::from_json(&card, &fsutil::read_text(&card)?)?;
    let field = |name: &str| {
        let text = card.get(name).and_then(|v| v.as_str()).map(str::to_owned);
        text.with_context(|| {
            format!("{} has no \"{name}\": train the policy again", ready.folder.join("policy.json").display())
        })
    };
    let options = TrialOptions::default();
    let deployment = Deployment {
        schema: SCHEMA,
        written_by: concat!("drex ", env!("CARGO_PKG_VERSION")),
        weights: Weights {
            policy: ready.folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
            file: field("weights_file")?,
            sha256: field("weights_sha256")?,
        },
        units: Units { joints: "rad", length: "m", mass: "kg", force: "N", torque: "N m", current: "mA" },
        force_law: ForceLaw {
            what: "smallest sum of normal forces that carries the weight and shakes in every direction at the lowest friction believed in, times the margin, within the torque cap",
            torque_cap_nm: options.torque_cap_nm,
            margin: options.law.margin,
            shake_m_s2: options.shake_m_s2,
        },
        current_limits_ma: grasp.joint_torques_nm.iter().map(|t| 1e3 * t.abs() / TORQUE_PER_CURRENT).collect(),
        current_note: format!(
            "torque over {TORQUE_PER_CURRENT} N m/A, what public models of the hand use; measured laws differ by a factor of two and more, \
             so calibrate before use"
        ),
        grasp: &grasp,
    };
    let out = match &args.out {
        Some(out) => out.clone(),
        // The network's folder is policy/network of a twin.
        None if ready.folder.ends_with("policy/network") => ready.folder.with_file_name("deploy.json"),
        None => ready.folder.join("deploy.json"),
    };
    fsutil::write_atomic(&out, &serde_json::to_vec_pretty(&deployment)?)?;
    let text = format!(
        "{}: {:.2} N on {:.0} g, at most {:.0} mA\n  written  {}\n  note     driving a hand comes with drex-hw, which is not there yet: this file is what it will read",
        grasp.hand,
        grasp.squeeze_n,
        1e3 * grasp.mass_kg,
        deployment.current_limits_ma.iter().fold(0.0_f64, |m, c| m.max(*c)),
        out.display()
    );
    ui.answer(&serde_json::json!({ "out": out, "deployment": deployment, "driven": false }), text)
}
