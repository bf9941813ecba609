//! How much simulated time goes by per second, and how well each case is simulated.
//!
//! ```text
//! cargo run --release -p drex-mujoco --example speed -- [--case NAME] [--dt STEP] [--seconds S] [--mjcf DIR]
//! ```
//!
//! Prints one line of JSON per case and step: `case`, `dt_s`, `rate` (simulated seconds per second of wall time, at
//! least S seconds of it), `error_mm` (largest distance of the body from its true path). With `--mjcf` it also writes the cases as MJCF, for
//! `tests/peers/diffsim_speed.py`, which runs this program and MuJoCo in turn.
#![allow(clippy::print_stdout)] // a program

use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{Base, Body, Collider, Geom, Model, Scene, Shape, State, Workspace, rollout, step};
use drex_mujoco::{MjcfOptions, to_mjcf};
use nalgebra::{Matrix3, Point3, Vector3};

const G: f64 = 9.81;
const STEPS_S: [f64; 3] = [5e-4, 1e-3, 2e-3];
const SAMPLES: u32 = 50;
/// When the example `pick` has lifted its box.
const LIFTED_S: f64 = 2.5;
/// What is held has settled by then.
const SETTLED_S: f64 = 0.5;

#[path = "../../drex-diffsim/examples/pick.rs"]
#[allow(dead_code)] // it has a main of its own
mod pick;

/// What is simulated again and again, and how far from the truth it ends.
struct Case {
    name: &'static str,
    model: Model<f64>,
    scene: Scene<f64>,
    start: State<f64>,
    /// Length of one run, seconds.
    until_s: f64,
    /// Where the body's origin is in truth, by time; `None`: where it is at [`SETTLED_S`].
    truth: Option<fn(f64) -> Vector3<f64>>,
}

/// A cube of 6 cm and 0.2 kg on a table inclined by `degrees`, which here is gravity that leans.
fn box_case(name: &'static str, degrees: f64, friction: f64) -> Result<Case, Box<dyn Error>> {
    let shape = Shape::Box { half_m: Vector3::repeat(0.03) };
    let unit = MassProperties {
        mass_kg: 1.0,
        center_of_mass: Point3::origin(),
        inertia: Matrix3::identity() * (0.06_f64.powi(2) / 6.0),
    };
    let model = Model::new(vec![Body::new(&unit, 0.2, Arc::new(Collider::new(&[Geom::new(shape)])?))]);
    let mut scene = Scene::on_table(friction);
    let angle = degrees.to_radians();
    scene.gravity = Vector3::new(angle.sin(), 0.0, -angle.cos()) * G;
    let start = State::at_rest(Pose::translation(0.0, 0.0, 0.03));
    Ok(Case { name, model, scene, start, until_s: 1.0, truth: Some(|_| Vector3::z() * 0.03) })
}

fn cases() -> Result<Vec<Case>, Box<dyn Error>> {
    let mut slide = box_case("box_slide", 25.0, 0.4)?;
    slide.truth = Some(|t| {
        let a = 25.0_f64.to_radians();
        Vector3::new(0.5 * G * (a.sin() - 0.4 * a.cos()) * t * t, 0.0, 0.03)
    });
    Ok(vec![box_case("box_rest", 0.0, 0.5)?, box_case("box_stick", 20.0, 0.5)?, slide, hand_case()?])
}

/// The box of the example `pick` in the lifted hand, which now stands still.
fn hand_case() -> Result<Case, Box<dyn Error>> {
    let of = pick::Pick { mass_kg: 0.2, friction: 0.5, cap_nm: 0.29, grip_force: 1.5, reserve_nm: 0.1, dt_s: 1e-3 };
    let (mut model, scene, start) = pick::scene(&of)?;
    let mut state = rollout(&model, &scene, &start, &[LIFTED_S])?.last;
    model.articulations[0].base = Base::Fixed(state.articulations[0].base.world_from_base);
    state.time_s = 0.0;
    Ok(Case { name: "hand_hold", model, scene, start: state, until_s: 3.0, truth: None })
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut only, mut steps_s, mut seconds, mut mjcf) = (None, STEPS_S.to_vec(), 0.5, None::<PathBuf>);
    let mut args = std::env::args().skip(1);
    while let Some(flag) = args.next() {
        let value = args.next().ok_or_else(|| format!("{flag} needs a value"))?;
        match flag.as_str() {
            "--case" => only = Some(value),
            "--dt" => steps_s = vec![value.parse()?],
            "--seconds" => seconds = value.parse()?,
            "--mjcf" => mjcf = Some(value.into()),
            _ => return Err(format!("unknown option {flag}; there are --case, --dt, --seconds, --mjcf").into()),
        }
    }
    for mut case in cases()?.into_iter().filter(|c| only.as_ref().is_none_or(|o| c.name == o)) {
        if let Some(folder) = &mjcf {
            let text = to_mjcf(&case.model, &case.scene, &case.start, &MjcfOptions::default())?;
            std::fs::write(folder.join(format!("{}.xml", case.name)), text)?;
        }
        for &dt_s in &steps_s {
            case.model.dt_s = dt_s;
            let (rate, error_mm) = (rate(&case, seconds)?, error_mm(&case)?);
            let name = case.name;
            println!(r#"{{"case":"{name}","dt_s":{dt_s},"rate":{rate:.2},"error_mm":{error_mm:.6}}}"#);
        }
    }
    Ok(())
}

/// Simulated seconds per second, over at least `seconds`.
fn rate(case: &Case, seconds: f64) -> Result<f64, Box<dyn Error>> {
    let mut work = Workspace::default();
    let mut state = case.start.clone();
    let steps = (case.until_s / case.model.dt_s).round() as usize;
    let (begin, mut runs) = (Instant::now(), 0);
    while runs == 0 || begin.elapsed().as_secs_f64() < seconds {
        state.clone_from(&case.start);
        for _ in 0..steps {
            step(&case.model, &case.scene, &mut state, &mut work)?;
        }
        runs += 1;
    }
    Ok(f64::from(runs) * case.until_s / begin.elapsed().as_secs_f64())
}

/// Largest distance from the true path at [`SAMPLES`] times, millimetres.
fn error_mm(case: &Case) -> Result<f64, Box<dyn Error>> {
    let times: Vec<f64> = (1..=SAMPLES).map(|i| f64::from(i) * case.until_s / f64::from(SAMPLES)).collect();
    let record = rollout(&case.model, &case.scene, &case.start, &times)?;
    let path = || times.iter().zip(record.bodies[0].poses.iter().map(|p| p.translation.vector));
    let settled = path().find(|(t, _)| **t >= SETTLED_S - 1e-9).map_or(Vector3::zeros(), |(_, x)| x);
    let distance = |(t, x): (&f64, Vector3<f64>)| match case.truth {
        Some(truth) => (x - truth(*t)).norm() * 1e3,
        None if *t < SETTLED_S => 0.0,
        None => (x - settled).norm() * 1e3,
    };
    Ok(path().map(distance).fold(0.0, f64::max))
}
