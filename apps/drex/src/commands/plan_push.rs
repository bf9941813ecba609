//! `drex plan-push`: which push would weigh an object best.

use std::path::Path;

use anyhow::{Context, Result, bail};
use drex_core::fsutil;
use drex_mesh::{AssetOptions, build_asset};
use drex_recording::{Support, SupportBox};
use drex_robot::Robot;
use drex_sysid::plan::{FingerLimits, ForceLimits, PlanOptions, PlannedPush, RobotLimits, plan_push, tip_force_limit};
use nalgebra::Vector3;
use serde::Serialize;

use crate::cli::{OnOff, PlanPushArgs};
use crate::ui::Ui;

/// Half the edges of the step that an object is put on to stick out, metres; its height is stated.
const STEP_HALF_M: [f64; 2] = [0.15, 0.2];
/// Pushes that are printed with reasons.
const SHOWN: usize = 8;

/// What is written: the assumptions, then the pushes, best first.
#[derive(Serialize)]
struct Plan<'a> {
    schema: u32,
    mesh: &'a Path,
    masses_kg: [f64; 2],
    robot: &'a RobotLimits,
    support: &'a Support,
    /// What was simulated with if the support states none.
    friction_guess: f64,
    push: &'a [PlannedPush],
}

/// Builds the object from its mesh, plans, answers.
pub fn run(args: &PlanPushArgs, ui: &Ui) -> Result<()> {
    let mut asset = AssetOptions::default();
    asset.unit = args.unit;
    let object = build_asset(&args.mesh, &asset)?.to_exact_object("")?;
    let robot = robot(args)?;
    let mut support = Support { friction: args.friction, ..Support::default() };
    if let Some(height) = args.step {
        let half_m = [STEP_HALF_M[0], STEP_HALF_M[1], 0.5 * height];
        support.boxes.push(SupportBox { center_m: [0.0, 0.0, 0.5 * height], half_m });
    }
    let mut options = PlanOptions::default();
    options.topple = args.topple;
    options.up_in_mesh = args.up.map_or(options.up_in_mesh, Vector3::from);
    let bar = ui.bar("plan-push", 0);
    let pushes = plan_push(&object, &support, &robot, args.masses, &options, |done, of| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    let plan = Plan {
        schema: 1,
        mesh: &args.mesh,
        masses_kg: args.masses,
        robot: &robot,
        support: &support,
        friction_guess: options.friction,
        push: &pushes,
    };
    if let Some(out) = &args.out {
        fsutil::write_atomic(out, toml::to_string(&plan)?.as_bytes())?;
    }
    ui.answer(&plan, text(&pushes, args))
}

/// The robot of the file, or the one that the options describe.
fn robot(args: &PlanPushArgs) -> Result<RobotLimits> {
    let mut robot: RobotLimits = match &args.robot {
        Some(file) => fsutil::from_toml(file, &fsutil::read_text(file)?)?,
        None => RobotLimits {
            reaction_s: 0.03,
            force: args.max_force.map(|max_n| ForceLimits { max_n, noise_n: args.force_noise, lifts: !args.no_lift }),
            finger: args.stiffness.map(|kp_n_m| FingerLimits {
                max_n: args.max_tip_force,
                max_speed_m_s: args.max_speed,
                stroke_m: args.stroke,
                radius_m: 0.01,
                mass_kg: 0.04,
                armature_kg: 0.02,
                damping_ns_m: 0.5,
                kp_n_m,
                // Critically damped, as a servo would be set up.
                kv_ns_m: 2.0 * (kp_n_m * 0.06).sqrt(),
                friction: 0.6,
                encoder_m: (args.encoder == OnOff::On).then_some(1e-4),
            }),
        },
    };
    if robot.force.is_none() && robot.finger.is_none() {
        bail!(
            "state what the robot pushes with: --max-force N, --stiffness N/M, or --robot FILE with [force] or [finger]"
        );
    }
    if let Some(name) = &args.hand {
        let Some(finger) = &mut robot.finger else {
            bail!("--hand limits the force of a fingertip, but there is none; add --stiffness or --robot");
        };
        let hand = Robot::resolve(name, Path::new("."))?;
        let limit = tip_force_limit(&hand, &hand.mid_range())?
            .with_context(|| format!("{name} states no torque limits; give --max-tip-force"))?;
        finger.max_n = finger.max_n.min(limit);
    }
    Ok(robot)
}

fn text(pushes: &[PlannedPush], args: &PlanPushArgs) -> String {
    let [lo, hi] = args.masses.map(|m| 1e3 * m);
    let mut out = format!("pushes of {}, {lo:.0} to {hi:.0} g, best first:\n", args.mesh.display());
    let (good, bad): (Vec<_>, Vec<_>) = pushes.iter().partition(|p| p.refused.is_none());
    for (k, push) in good.iter().take(SHOWN).enumerate() {
        out += &format!("{:3}. {}\n     {}\n", k + 1, push.text, push.why);
    }
    if good.len() > SHOWN {
        out += &format!("     and {} more that tell less\n", good.len() - SHOWN);
    }
    for push in bad {
        let why = push.refused.as_deref().unwrap_or_default();
        out += &format!("  not {}: {why}\n", push.text.rsplit_once(": ").map_or(push.text.as_str(), |t| t.0));
    }
    out
}
