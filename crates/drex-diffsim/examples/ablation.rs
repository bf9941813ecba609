//! Semi-implicit against explicit Euler, and against the two other solvers: error and stability over the step size for
//! objects of 20 g to 700 g, and the mass that a fit with each of them finds.
//!
//!     cargo run --release -p drex-diffsim --features ablation --example ablation
//!
//! All methods simulate the same law of contact, with the fixed stiffness of a penalty method, and take one substep per
//! step. "refused" is a step for which a motion on the contact springs is certain to grow; "none" a fit that would have to
//! try masses at which the step is refused. The reference is the default method at 10 µs; a table says how far two other
//! methods at 2 µs are from it.
#![allow(clippy::print_stdout)] // it prints tables

use std::sync::Arc;
use std::time::Instant;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    AppliedForce, Body, Collider, ForcePoint, Geom, Method, Model, Part, Result, Scene, Scheme, Shape, State, rollout,
};
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;

const G: f64 = 9.81;
const FRICTION: f64 = 0.3;
/// Stiffness of the contact between object and table, N/m, and its damping, N s/m.
const STIFFNESS: f64 = 1e4;
const DAMPING: f64 = 25.0;
/// Name, mass (kg), half extents (m).
const OBJECTS: [(&str, f64, [f64; 3]); 5] = [
    ("brick", 0.02, [0.032, 0.016, 0.010]),
    ("letter", 0.06, [0.040, 0.030, 0.015]),
    ("domino", 0.12, [0.025, 0.0125, 0.050]),
    ("tin", 0.20, [0.060, 0.060, 0.025]),
    ("bottle", 0.70, [0.040, 0.030, 0.095]),
];
const METHODS: [(&str, Method); 4] = [
    ("semi-implicit penalty", Method::Penalty { scheme: Scheme::SemiImplicit, substeps: Some(1) }),
    ("explicit penalty", Method::Penalty { scheme: Scheme::Explicit, substeps: Some(1) }),
    ("velocity-implicit (default)", Method::SemiImplicit),
    ("position-based", Method::PositionBased { substeps: 1 }),
];
const STEPS_S: [f64; 8] = [5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5];
const REFERENCE: (Method, f64) = (Method::SemiImplicit, 1e-5);
/// When the force begins, seconds; frames per second; how many of them.
const ONSET_S: f64 = 0.05;
const RATE_HZ: f64 = 200.0;
const FRAMES: usize = 180;
/// What a tracker is expected to be off by: weighs positions (m) against angles (rad) in the fit.
const NOISE: (f64, f64) = (2e-3, 0.0175);

/// What is done to an object by a force that is known.
#[derive(Debug, Clone, Copy)]
enum Motion {
    /// Pushed for 0.2 s with 1.6 times the friction, then it slides to rest.
    Slide,
    /// Lifted at one side with three quarters of its weight, let go at a tenth of the angle at which it would tip over, and
    /// seen until it is back at half a degree.
    Tilt,
    /// The same, seen until it has rocked to rest.
    Rock,
}

/// The first `frames` poses of an object if its mass were `mass_kg`, under the force that was chosen for its true mass.
fn simulate(
    object: usize,
    motion: Motion,
    mass_kg: f64,
    (method, dt_s): (Method, f64),
    frames: usize,
) -> Result<Vec<Pose>> {
    let (_, true_kg, half) = OBJECTS[object];
    let half_m = Vector3::from(half);
    let [a, b, c] = half.map(|x| x * x / 3.0);
    let inertia = Matrix3::from_diagonal(&Vector3::new(b + c, c + a, a + b));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let mut model =
        Model::new(vec![Body::new(&unit, mass_kg, Arc::new(Collider::new(&[Geom::new(Shape::Box { half_m })])?))]);
    model.contact.stiffness_n_m = Some(STIFFNESS);
    model.contact.relaxation_s = DAMPING / STIFFNESS;
    model.contact.tangential_relaxation_s = DAMPING / STIFFNESS;
    (model.method, model.dt_s) = (method, dt_s);

    let (force_n, at, pulse_s) = match motion {
        Motion::Slide => (Vector3::x() * (1.6 * FRICTION), Point3::new(-half[0], 0.0, 0.0), 0.2),
        Motion::Tilt | Motion::Rock => {
            // Angular acceleration at the start, about the other edge.
            let angular = 0.5 * G * half[0] / (4.0 * (a + c));
            let until = 0.1 * (half[0] / half[2]).atan();
            (Vector3::z() * 0.75, Point3::new(-half[0], 0.0, 0.0), (2.0 * until / angular).sqrt())
        }
    };
    let mut scene = Scene::on_table(FRICTION);
    let forces = [force_n * (true_kg * G), Vector3::zeros()];
    scene.forces.push(AppliedForce::new(Part::Body(0), &[ONSET_S, ONSET_S + pulse_s], &forces, ForcePoint::Body(at))?);
    // It starts where it rests.
    let start = State::at_rest(Pose::translation(0.0, 0.0, half[2] - mass_kg * G / STIFFNESS));
    let times: Vec<f64> = (0..frames).map(|k| k as f64 / RATE_HZ).collect();
    Ok(rollout(&model, &scene, &start, &times)?.bodies.swap_remove(0).poses)
}

/// The motion of the object with its true mass, cut where it is to end.
fn reference(object: usize, motion: Motion) -> Result<Vec<Pose>> {
    let mut poses = simulate(object, motion, OBJECTS[object].1, REFERENCE, FRAMES)?;
    if let Motion::Tilt = motion {
        let angle = |p: &Pose| p.rotation.angle().to_degrees();
        let top = (0..FRAMES).max_by(|&i, &j| angle(&poses[i]).total_cmp(&angle(&poses[j]))).unwrap_or(0);
        let back = (top..FRAMES).find(|&k| angle(&poses[k]) < 0.5).unwrap_or(FRAMES);
        poses.truncate(back);
    }
    Ok(poses)
}

/// Sums of squares of position (m²) and angle (rad²).
fn squares(poses: &[Pose], truth: &[Pose]) -> (f64, f64) {
    poses.iter().zip(truth).fold((0.0, 0.0), |(p, r), (a, b)| {
        let way = a.translation.vector - b.translation.vector;
        (p + way.norm_squared(), r + (a.rotation * b.rotation.inverse()).angle().powi(2))
    })
}

/// Root mean square of position (mm) and angle (degrees).
fn error(poses: &[Pose], truth: &[Pose]) -> (f64, f64) {
    let (p, r) = squares(poses, truth);
    let n = truth.len() as f64;
    ((p / n).sqrt() * 1e3, (r / n).sqrt().to_degrees())
}

/// The mass that fits `truth` best in the least-squares sense, kg: a scan from half to twice the true mass, then a
/// golden-section search about the best. `None` if the method cannot simulate there, or the best is at an end.
fn fit(object: usize, motion: Motion, method: (Method, f64), truth: &[Pose]) -> Option<f64> {
    let cost = |x: f64| {
        let poses = simulate(object, motion, OBJECTS[object].1 * x.exp(), method, truth.len()).ok()?;
        let (p, r) = squares(&poses, truth);
        Some(p / NOISE.0.powi(2) + r / NOISE.1.powi(2))
    };
    let grid: Vec<f64> = (-12..=12).map(|k| f64::from(k) / 12.0 * 2.0_f64.ln()).collect();
    let scan: Vec<Option<f64>> = grid.iter().map(|&x| cost(x)).collect();
    let best = (0..grid.len()).min_by(|&i, &j| {
        let [a, b] = [i, j].map(|k| scan[k].unwrap_or(f64::INFINITY));
        a.total_cmp(&b)
    })?;
    if best == 0 || best + 1 == grid.len() || scan[best - 1].is_none() || scan[best + 1].is_none() {
        return None;
    }
    let (mut low, mut high) = (grid[best - 1], grid[best + 1]);
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    let (mut a, mut b) = (high - golden * (high - low), low + golden * (high - low));
    let (mut at_a, mut at_b) = (cost(a)?, cost(b)?);
    while high - low > 2e-5 {
        if at_a < at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - golden * (high - low);
            at_a = cost(a)?;
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + golden * (high - low);
            at_b = cost(b)?;
        }
    }
    Some(OBJECTS[object].1 * (0.5 * (low + high)).exp())
}

/// One method and step on one object: pose error, and mass error in per cent.
type Cell = (Option<(f64, f64)>, Option<f64>);

fn main() -> Result<()> {
    for motion in [Motion::Slide, Motion::Tilt, Motion::Rock] {
        let truths = (0..OBJECTS.len()).map(|object| reference(object, motion)).collect::<Result<Vec<_>>>()?;
        let cells: Vec<(usize, usize, usize)> = (0..OBJECTS.len())
            .flat_map(|o| (0..METHODS.len()).flat_map(move |m| (0..STEPS_S.len()).map(move |s| (o, m, s))))
            .collect();
        let results: Vec<Cell> = cells
            .par_iter()
            .map(|&(o, m, s)| {
                let (method, truth, mass_kg) = ((METHODS[m].1, STEPS_S[s]), &truths[o], OBJECTS[o].1);
                let poses = simulate(o, motion, mass_kg, method, truth.len()).ok();
                let found = poses.as_ref().and_then(|_| fit(o, motion, method, truth));
                (poses.map(|p| error(&p, truth)), found.map(|m| 100.0 * (m / mass_kg - 1.0)))
            })
            .collect();
        let row = |o: usize, m: usize| &results[(o * METHODS.len() + m) * STEPS_S.len()..][..STEPS_S.len()];
        println!("## {motion:?}: pose error, mm / degrees\n");
        table(|o, m| {
            row(o, m).iter().map(|c| c.0.map_or("refused".into(), |(p, r)| format!("{p:.2} / {r:.2}"))).collect()
        });
        println!("\n## {motion:?}: error of the identified mass, %\n");
        table(|o, m| {
            let cell = |c: &Cell| match (c.0, c.1) {
                (None, _) => "refused".into(),
                (_, None) => "none".into(),
                (_, Some(e)) => format!("{e:+.2}"),
            };
            row(o, m).iter().map(cell).collect()
        });
        println!("\n## {motion:?}: how far two others at 2 µs are from the reference, mm / degrees\n");
        println!("| object | semi-implicit penalty | position-based |\n|---|---|---|");
        for (o, truth) in truths.iter().enumerate() {
            let others = [0, 3].map(|m| simulate(o, motion, OBJECTS[o].1, (METHODS[m].1, 2e-6), truth.len()));
            let [a, b] = others.map(|poses| poses.map(|p| error(&p, truth)));
            let ((a, b), (c, d)) = (a?, b?);
            println!("| {} | {a:.4} / {b:.4} | {c:.4} / {d:.4} |", OBJECTS[o].0);
        }
        println!();
    }
    println!("## Time per step of a slide, µs\n");
    for (name, method) in METHODS {
        let mut times: Vec<f64> = (0..7)
            .map(|_| {
                let begun = Instant::now();
                simulate(3, Motion::Slide, OBJECTS[3].1, (method, 1e-4), FRAMES)
                    .map(|_| begun.elapsed().as_secs_f64() * 1e6 / (FRAMES as f64 / RATE_HZ / 1e-4))
            })
            .collect::<Result<_>>()?;
        times.sort_by(f64::total_cmp);
        println!("- {name}: {:.1}", times[times.len() / 2]);
    }
    Ok(())
}

fn table(cells: impl Fn(usize, usize) -> Vec<String>) {
    let steps = STEPS_S.map(|s| if s < 1e-3 { format!("{:.0} µs", s * 1e6) } else { format!("{:.0} ms", s * 1e3) });
    println!("| object | method | {} |\n|---|---|{}", steps.join(" | "), "---|".repeat(STEPS_S.len()));
    for (o, (name, mass_kg, _)) in OBJECTS.iter().enumerate() {
        for (m, (method, _)) in METHODS.iter().enumerate() {
            println!("| {name}, {:.0} g | {method} | {} |", mass_kg * 1e3, cells(o, m).join(" | "));
        }
    }
}
