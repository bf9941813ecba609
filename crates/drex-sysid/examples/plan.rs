//! Ranks pushes of an object by what they would tell about its mass, does the best of each kind in simulation with a hidden mass,
//! and compares the scatter of the estimates with what was promised.
//!
//! `cargo run --release -p drex-sysid --example plan -- object.obj [--friction MU] [--step HEIGHT] [--masses LO,HI] [--repeat N]`
//! The mesh must consist of closed convex shells in OBJ.

use std::error::Error;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

use drex_mesh::{AssetOptions, build_asset};
use drex_recording::{Support, SupportBox};
use drex_sysid::plan::{FingerLimits, ForceLimits, PlanOptions, RobotLimits, plan_push};
use drex_sysid::{IdentifyOptions, identify};

fn main() -> Result<(), Box<dyn Error>> {
    let mut support = Support::default();
    let mut masses = [0.05, 0.8];
    let (mut repeat, mut mesh, mut only) = (0, None, String::new());
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or_else(|| format!("{arg} needs a value"));
        match arg.as_str() {
            "--friction" => support.friction = Some(value()?.parse()?),
            "--step" => {
                let half = 0.5 * value()?.parse::<f64>()?;
                support.boxes.push(SupportBox { center_m: [0.0, 0.0, half], half_m: [0.15, 0.2, half] });
            }
            "--masses" => {
                let text = value()?;
                let (lo, hi) = text.split_once(',').ok_or("--masses needs LO,HI")?;
                masses = [lo.parse()?, hi.parse()?];
            }
            "--only" => only = value()?,
            "--repeat" => repeat = value()?.parse()?,
            _ => mesh = Some(arg),
        }
    }
    let object =
        build_asset(Path::new(&mesh.ok_or("name an OBJ file")?), &AssetOptions::in_metres())?.to_exact_object("")?;
    let robot = RobotLimits {
        reaction_s: 0.03,
        force: Some(ForceLimits { max_n: 10.0, noise_n: 0.03, lifts: true }),
        finger: Some(FingerLimits {
            max_n: 6.0,
            max_speed_m_s: 0.4,
            stroke_m: 0.15,
            radius_m: 0.01,
            mass_kg: 0.04,
            armature_kg: 0.02,
            damping_ns_m: 0.5,
            kp_n_m: 150.0,
            kv_ns_m: 2.5,
            friction: 0.6,
            encoder_m: Some(1e-4),
        }),
    };
    let options = PlanOptions::default();
    let begin = Instant::now();
    let plan = plan_push(&object, &support, &robot, masses, &options, |_, _| {})?;
    let mut out = std::io::stdout();
    writeln!(out, "{} pushes in {:.2} s", plan.len(), begin.elapsed().as_secs_f64())?;
    for p in plan.iter().filter(|p| p.text.contains(&only)) {
        writeln!(out, "{}\n    {:?}: {}", p.text, p.verdict, p.refused.as_ref().unwrap_or(&p.why))?;
        for o in &p.outcomes {
            let percent = |x: Option<f64>| x.map_or("-".into(), |x| format!("{:.2} %", 100.0 * x));
            let refused = o.refused.as_deref().unwrap_or("");
            writeln!(
                out,
                "    {:6.0} g {:6.2} N {:5.1} deg {:5.1} mm {:4.2} s: sd {} (noise {}) mu m {} {refused}",
                1e3 * o.mass_kg,
                o.peak_force_n,
                o.tilt_deg,
                1e3 * o.travel_m,
                o.seconds,
                percent(o.sd_log_mass),
                percent(o.sd_noise),
                percent(o.sd_log_mu_m)
            )?;
        }
        for o in p.outcomes.iter().filter(|o| repeat > 0 && o.refused.is_none()).skip(2).take(1) {
            let mut errors = Vec::new();
            for seed in 0..repeat {
                let push = p.push.rehearse(&object, &support, &robot, &options, o.mass_kg, seed)?;
                let answer = identify(&[push], &object, &IdentifyOptions::default())?;
                errors.extend(answer.mass_kg.map(|m| (m / o.mass_kg).ln()));
            }
            let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len().max(1) as f64).sqrt();
            let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
            let count = errors.len();
            writeln!(
                out,
                "      {:.0} g: {count} of {repeat} identified, rms {:.2} %, mean {:+.2} %",
                1e3 * o.mass_kg,
                1e2 * rms,
                1e2 * mean
            )?;
        }
    }
    Ok(())
}
