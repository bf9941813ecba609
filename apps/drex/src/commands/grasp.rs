//! `drex grasp`: where the hand goes and how hard it grips.

use anyhow::Result;

use crate::cli::GraspArgs;
use crate::ui::Ui;
use drex_twin::{Prediction, Predictor};

/// Predicts and answers.
pub fn run(args: &GraspArgs, seed: Option<u64>, ui: &Ui) -> Result<()> {
    let prediction = Predictor::open(&args.twin_or_policy, args.mesh.as_deref(), &args.options(), seed)?.predict()?;
    ui.answer(&prediction, text(&prediction))
}

fn text(p: &Prediction) -> String {
    let [x, y, z] = p.world_from_base.translation_m;
    let [qw, qx, qy, qz] = p.world_from_base.quat_wxyz;
    let friction = match (p.friction_range, p.risk) {
        (Some([low, high]), Some(risk)) => {
            format!("{low} to {high}, gripped for {:.3}: {:.0} % would take more", p.friction, 100.0 * risk)
        }
        _ => p.friction.to_string(),
    };
    let mut lines = vec![
        format!("{} for {:.0} g at friction {friction}", p.grasp.hand, 1e3 * p.mass_kg),
        format!("  base     {x:.4} {y:.4} {z:.4} m, quaternion {qw:.4} {qx:.4} {qy:.4} {qz:.4} (world)"),
    ];
    let joints = p.grasp.joint_names.iter().zip(&p.grasp.joints_rad).map(|(name, q)| format!("{name} {q:.3}"));
    lines.push(format!("  joints   {} rad", joints.collect::<Vec<_>>().join(", ")));
    let fingers = p.contacts.iter().filter(|c| c.contacts > 0).map(|c| format!("{} {:.2} N", c.finger, c.normal_n));
    lines.push(format!("  touches  {}", fingers.collect::<Vec<_>>().join(", ")));
    lines.push(match p.needed_grip_force_n {
        Some(needed) => format!(
            "  grip force  {:.2} N (network), {needed:.2} N (by the grip-force policy); the paper's number {:.2}",
            p.grip_force_n, p.paper_force
        ),
        None => format!("  grip force  {:.2} N (network); the paper's number {:.2}", p.grip_force_n, p.paper_force),
    });
    let most = p.joint_torques_nm.iter().fold(0.0_f64, |m, t| m.max(t.abs()));
    if !p.joint_torques_nm.is_empty() {
        lines.push(format!("  torques  at most {most:.3} N m"));
    }
    if let Some(reason) = &p.cannot_hold {
        lines.push(format!(
            "  warning  none of the proposals can hold it once the hand has closed; the first: {reason}"
        ));
    }
    lines.push(format!(
        "  took     {:.1} ms for the network, {:.1} ms for closing the hand and its force; proposal {}",
        p.network_ms, p.force_ms, p.place
    ));
    lines.join("\n")
}
