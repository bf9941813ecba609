//! Grasps for a mesh, found by search, tried over a spread of friction and of where the object is, in the engines there are.
//!
//!     cargo run --release -p drex-trial --example try_mesh [--features mujoco] -- MESH.obj KG [ROLLOUTS [ASSUMED]]
//!
//! ASSUMED is the mass that the hand assumes, in parts of the true one. One line per grasp: ten rollouts in each engine, a star for each
//! success, else the first letter of the verdict, `-` where there is no command. Then the rate over all grasps.
#![allow(clippy::print_stdout)] // the output is the point of an example

use std::path::Path;
use std::sync::Arc;

use drex_grasp::{Grasp, pinch_grasps};
use drex_mesh::{AssetOptions, build_asset};
use drex_robot::Robot;
use drex_trial::{Assumed, Engine, Error, GripForce, Outcome, Trial, TrialOptions, Truth, Verdict, wilson};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Grasps that are shown.
const SHOWN: usize = 12;
/// Pinches that are looked at.
const CANDIDATES: usize = 20_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let mass_kg: f64 = args.get(1).ok_or("give a mesh and a mass in kg")?.parse()?;
    let rollouts: u64 = args.get(2).map_or(Ok(10), |a| a.parse())?;
    let share: f64 = args.get(3).map_or(Ok(1.0), |a| a.parse())?;

    let asset = build_asset(Path::new(&args[0]), &AssetOptions::default())?;
    let object = asset.to_object("object")?;
    let hand = Arc::new(Robot::bundled("leap_right")?);
    let mut found = pinch_grasps(&object, &hand, CANDIDATES, 0)?;
    println!("{} grasps of {CANDIDATES} candidates", found.len());
    let weight_n = 9.81 * object.mass_kg();
    let weights = |g: &Grasp| g.grip_force_n.unwrap_or(f64::INFINITY) / weight_n;
    found.sort_by(|a, b| weights(a).total_cmp(&weights(b)));

    let trial = Trial::new(hand, object, TrialOptions::default())?;
    let assumed = Assumed { mass_kg: share * mass_kg, friction: 0.55 };
    let commanded = |f: &&Grasp| matches!(trial.command(f, &assumed, GripForce::Required), Ok(Ok(_)));
    let shown: Vec<&Grasp> = found.iter().filter(commanded).take(SHOWN).collect();
    let mut tally = [(0, 0); 2];
    let mut delivered = [Vec::new(), Vec::new()];
    for (index, grasp) in shown.iter().enumerate() {
        let mut line = format!("{index:>3}  {:4.1} weights", weights(grasp));
        for ((engine, sum), ratios) in [Engine::Diffsim, Engine::Mujoco].into_iter().zip(&mut tally).zip(&mut delivered)
        {
            let outcomes = (0..rollouts)
                .into_par_iter()
                .map(|seed| attempt(&trial, grasp, (mass_kg, share), seed, engine))
                .collect::<Result<Vec<_>, _>>();
            match outcomes {
                Ok(outcomes) => {
                    ratios.extend(outcomes.iter().flatten().filter_map(|o| Some(o.held_n? / o.grip_force_n)));
                    let verdicts: Vec<_> = outcomes.iter().map(|o| o.as_ref().map(|o| o.verdict)).collect();
                    sum.0 += verdicts.iter().filter(|v| **v == Some(Verdict::Success)).count();
                    sum.1 += verdicts.len();
                    line += &format!("  {engine:?} {}", verdicts.into_iter().map(letter).collect::<String>());
                }
                Err(Error::NoMujoco) => {}
                Err(other) => return Err(other.into()),
            }
        }
        println!("{line}");
    }
    for ((engine, (successes, n)), mut ratios) in
        [Engine::Diffsim, Engine::Mujoco].into_iter().zip(tally).zip(delivered).filter(|t| t.0.1.1 > 0)
    {
        ratios.sort_by(f64::total_cmp);
        let at = |share: f64| ratios.get((share * ratios.len() as f64) as usize).copied().unwrap_or(f64::NAN);
        let rate = wilson(successes, n);
        println!(
            "{engine:?}: {successes} of {n}, {:.0} % ({:.0} to {:.0}); delivered over commanded grip force {:.2} ({:.2} to {:.2})",
            100.0 * rate.value,
            100.0 * rate.low,
            100.0 * rate.high,
            at(0.5),
            at(0.1),
            at(0.9)
        );
    }
    Ok(())
}

/// One rollout: friction from 0.4 to 0.8 and assumed to a tenth, the object up to 5 mm and 5 degrees off.
fn attempt(
    trial: &Trial,
    grasp: &Grasp,
    (mass_kg, share): (f64, f64),
    seed: u64,
    engine: Engine,
) -> Result<Option<Outcome>, Error> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut even = |most: f64| random.random_range(-most..most);
    let friction = 0.6 + even(0.2);
    let truth =
        Truth { mass_kg, friction, shift_m: [even(0.005), even(0.005)], turn_rad: even(5f64.to_radians()), seed };
    let assumed = Assumed { mass_kg: share * mass_kg, friction: friction * (1.0 + even(0.1)) };
    match trial.command(grasp, &assumed, GripForce::Required)? {
        Ok(command) => trial.run(&command, &truth, engine).map(Some),
        Err(_) => Ok(None),
    }
}

/// A star for a success.
fn letter(verdict: Option<Verdict>) -> char {
    match verdict {
        Some(Verdict::Success) => '*',
        Some(other) => format!("{other:?}").chars().next().unwrap_or('?'),
        None => '-',
    }
}
