//! Grasps for a mesh, found by search, tried at a mass over a spread of friction and of where the object is, in the engines there are.
//!
//!     cargo run --release -p drex-trial --example try_mesh [--features mujoco] -- MESH.obj KG [ROLLOUTS] [part of the mass that the hand believes]
#![allow(clippy::print_stdout)] // the output is the point of an example

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use drex_diffsim::{Collider, ConvexPiece};
use drex_grasp::{HandSurface, SearchOptions, TablePlane, search_grasps};
use drex_mesh::{AssetOptions, GridOptions, GridSdf, MeshSdf, build_asset, sample_surface};
use drex_robot::Robot;
use drex_trial::{Belief, Judge, Squeeze, Trial, TrialObject, TrialOptions, Truth, wilson};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let mass_kg: f64 = args.get(1).ok_or("give a mesh and a mass in kg")?.parse()?;
    let rollouts: usize = args.get(2).map_or(Ok(40), |a| a.parse())?;
    let part: f64 = args.get(3).map_or(Ok(1.0), |a| a.parse())?;
    let asset = build_asset(Path::new(&args[0]), &AssetOptions::default())?;
    let mut grid = GridOptions::default();
    grid.margin_m = Some(0.1);
    let sdf = Arc::new(GridSdf::with_options(MeshSdf::new(&asset.visual)?, &grid)?);
    let pieces = asset.pieces.iter().map(|p| ConvexPiece::from_points(&p.vertices)).collect::<Result<Vec<_>, _>>()?;
    let world_from_object = asset.world_from_mesh_at_rest;
    let up = world_from_object.rotation.inverse() * nalgebra::Vector3::z();
    let table = TablePlane::under(&asset.visual.vertices, up).ok_or("the mesh has no points")?;
    let hand = Arc::new(Robot::bundled("leap_right")?);
    let surface = HandSurface::new(&hand, 0.004)?;
    let begun = Instant::now();
    let points = sample_surface(&asset.visual, 2000, 0);
    let mut options = SearchOptions::default();
    options.candidates = 20_000;
    let com = asset.properties.center_of_mass;
    let found = search_grasps(&hand, &surface, sdf.as_ref(), &points, &com, &table, &options)?;
    println!(
        "{} pieces; {} grasps, {} closed, of {} candidates in {:.1} s",
        asset.pieces.len(),
        found.len(),
        found.iter().filter(|f| f.closed).count(),
        options.candidates,
        begun.elapsed().as_secs_f64()
    );
    let object = TrialObject {
        collider: Arc::new(Collider::convex(pieces)),
        properties: asset.properties,
        surface: sdf,
        world_from_object,
        max_finger_n: None,
    };
    let trial = Trial::new(Arc::clone(&hand), object, TrialOptions::default())?;
    let begun = Instant::now();
    let mut best: Vec<(f64, usize)> =
        found.iter().enumerate().filter(|(_, f)| f.closed).map(|(i, f)| (f.squeeze_per_weight, i)).collect();
    best.sort_by(|a, b| a.0.total_cmp(&b.0));
    let shown = Belief { mass_kg: mass_kg * part, friction: 0.5 };
    let mut reasons: BTreeMap<String, usize> = BTreeMap::new();
    let mut good = Vec::new();
    for &(_, i) in best.iter().take(60) {
        match trial.command(&found[i].joints, &found[i].object_from_base, &shown, Squeeze::Needed)? {
            Ok(command) => good.push((command.squeeze_n, i)),
            Err(reason) => {
                *reasons.entry(format!("{reason:?}").split(['(', ' ']).next().unwrap_or("").into()).or_default() += 1
            }
        }
    }
    good.sort_by(|a, b| a.0.total_cmp(&b.0));
    println!("{} can be commanded at friction 0.5, {reasons:?}; {:.1} s", good.len(), begun.elapsed().as_secs_f64());
    for judge in [Judge::Diffsim, Judge::Mujoco] {
        let begun = Instant::now();
        let outcomes: Vec<_> = (0..rollouts)
            .into_par_iter()
            .map(|i| {
                let mut random = ChaCha8Rng::seed_from_u64(i as u64);
                let friction = random.random_range(0.4..0.8);
                let belief = Belief { mass_kg: mass_kg * part, friction: friction * random.random_range(0.9..1.1) };
                let truth = Truth {
                    mass_kg,
                    friction,
                    shift_m: [random.random_range(-0.005..0.005), random.random_range(-0.005..0.005)],
                    turn_rad: random.random_range(-0.087..0.087),
                    seed: i as u64,
                };
                for &(_, g) in good.iter().skip(i % 5).take(10) {
                    let f = &found[g];
                    if let Ok(command) = trial.command(&f.joints, &f.object_from_base, &belief, Squeeze::Needed)? {
                        return trial.run(&command, &truth, judge).map(Some);
                    }
                }
                Ok(None)
            })
            .collect();
        let mut verdicts: BTreeMap<String, usize> = BTreeMap::new();
        let mut successes = 0;
        for (i, o) in outcomes.iter().enumerate() {
            match o {
                Err(drex_trial::Error::NoMujoco) => *verdicts.entry("no MuJoCo".into()).or_default() += 1,
                Err(e) => println!("{e}"),
                Ok(None) => *verdicts.entry("no command".into()).or_default() += 1,
                Ok(Some(o)) => {
                    successes += usize::from(o.succeeded());
                    *verdicts.entry(format!("{:?}", o.verdict)).or_default() += 1;
                    if i < 12 {
                        println!(
                            "  {:>7.2} N {:?} at {:.2} s, peak {:.2} N, slip {:.2} mm, turn {:.1} deg, deep {:.2} mm, used {:.2}, held {:.2}",
                            o.squeeze_n,
                            o.verdict,
                            o.failed_at_s.unwrap_or(f64::NAN),
                            o.peak_finger_n,
                            1e3 * o.slip_m,
                            o.turn_rad.to_degrees(),
                            1e3 * o.penetration_m,
                            o.friction_used.unwrap_or(f64::NAN),
                            o.retained
                        );
                    }
                }
            }
        }
        let rate = wilson(successes, rollouts);
        println!(
            "{judge:?}: {:.1} % ({:.1} to {:.1}), {verdicts:?}, {:.3} s a rollout",
            100.0 * rate.value,
            100.0 * rate.low,
            100.0 * rate.high,
            begun.elapsed().as_secs_f64() / rollouts as f64
        );
    }
    Ok(())
}
