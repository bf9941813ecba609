//! Many small twin folders whose truth is known, for whatever runs many.
//!
//! A twin is the bundled tin with another mesh, mass, friction and first guess, a push that is simulated anew, and some of its
//! demonstrations. Numbers are drawn by ChaCha8 from a seed and the twin's number, so that the same two numbers give the same bytes. A broken one has a [`Fault`] of the
//! kind that a laboratory meets.

mod fault;

use std::path::Path;

use anyhow::Result;
use drex_core::{Pose, fsutil};
use drex_recording::readers::{GraspFile, parse_grasp_file};
use nalgebra::{Point3, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

pub use self::fault::Fault;
use crate::tin::{PULSES, PUSH_HEIGHT_M, Pulse, TiltPush, WIDTH_M, merged, obj_text, plain_tin};

/// Least and greatest true mass, kg.
pub const MASS_RANGE_KG: [f64; 2] = [0.08, 0.20];
/// Least and greatest true friction against the table (a coefficient): the tin tips before it slides.
pub const FRICTION_RANGE: [f64; 2] = [0.65, 0.80];

/// Natural frequency of the contact with the table, rad/s: softer than the estimator assumes, but not so soft that the masses show it.
const CONTACT_RAD_S: f64 = 4000.0;
/// Sides of tin and lid; with an even number one faces the push.
const SIDES: [u32; 4] = [8, 10, 12, 16];
/// Factors on width and depth, and on the height, of the bundled tin.
const STRETCH: [f64; 2] = [0.88, 1.05];
const STRETCH_HEIGHT: [f64; 2] = [1.0, 1.25];
/// Starts, lengths and peaks of the two pulses, against those of the bundled push.
const START_S: [f64; 2] = [-0.05, 0.05];
const LENGTH: [f64; 2] = [0.95, 1.05];
const PEAK: [f64; 2] = [0.98, 1.02];
/// Range of the logarithm of a first guess against the mass.
const GUESS_LN: f64 = std::f64::consts::LN_2;
/// The demonstrations of the bundled tin, and how many of them a twin has.
const DEMONSTRATIONS: &str = include_str!("../../../../data/tin/demos/grasps.json");
const GRASPS: usize = 10;
/// Friction against the fingertips that the manifest assumes.
const ASSUMED_FRICTION: f64 = 0.5;
/// Passes of the training over the grasps.
const EPOCHS: usize = 50;
const HAND: &str = "leap_right";
/// Numbers of broken twins begin here, so that none shares its numbers with a twin that is not.
const BROKEN: u64 = 1 << 32;

/// A twin folder as text.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticTwin {
    /// Name of the folder: `twin-007`, `broken-0`.
    pub name: String,
    /// What is wrong with it.
    pub fault: Option<Fault>,
    /// True mass, kg.
    pub mass_kg: f64,
    /// True friction against the table (a coefficient).
    pub friction: f64,
    /// Sides of the bounding box, metres.
    pub size_m: [f64; 3],
    /// How far the push leans it at most, rad.
    pub largest_lean_rad: f64,
    /// Paths in the folder, and the texts of these files.
    files: Vec<(&'static str, String)>,
}

impl SyntheticTwin {
    /// The twin of a number.
    ///
    /// # Errors
    /// If the tin that was drawn cannot be pushed, which is a fault of this program.
    pub fn new(seed: u64, number: u32) -> Result<Self> {
        Self::draw(seed, u64::from(number), format!("twin-{number:03}"))
    }

    /// The broken twin of a number; the [`Fault`]s take turns.
    ///
    /// # Errors
    /// As [`SyntheticTwin::new`].
    pub fn broken(seed: u64, number: u32) -> Result<Self> {
        let fault = Fault::ALL[number as usize % Fault::ALL.len()];
        let mut twin = Self::draw(seed, BROKEN + u64::from(number), format!("broken-{number}"))?;
        for (path, text) in &mut twin.files {
            if *path == fault.file() {
                *text = fault.spoil(text);
            }
        }
        twin.fault = Some(fault);
        Ok(twin)
    }

    /// Writes the folder NAME below `folder`.
    ///
    /// # Errors
    /// If a file cannot be written; an old one stays.
    pub fn write(&self, folder: &Path) -> Result<()> {
        for (path, text) in &self.files {
            fsutil::write_atomic(&folder.join(&self.name).join(path), text.as_bytes())?;
        }
        Ok(())
    }

    fn draw(seed: u64, stream: u64, name: String) -> Result<Self> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(stream);
        let sides = SIDES[random.random_range(0..SIDES.len())];
        let stretch = [STRETCH, STRETCH, STRETCH_HEIGHT].map(|range| between(range, &mut random));
        let mass_kg = (1e4 * between(MASS_RANGE_KG, &mut random)).round() / 1e4;
        let friction = (1e3 * between(FRICTION_RANGE, &mut random)).round() / 1e3;
        let guess = mass_kg * random.random_range(-GUESS_LN..GUESS_LN).exp();
        let prior_kg = (1e3 * guess).round() / 1e3;
        let pulses = PULSES.map(|pulse| Pulse {
            start_s: pulse.start_s + between(START_S, &mut random),
            length_s: pulse.length_s * between(LENGTH, &mut random),
            peak: pulse.peak * between(PEAK, &mut random),
        });
        let seeds: [u32; 2] = random.random();

        let mut shells = plain_tin(sides)?;
        for vertex in shells.iter_mut().flat_map(|s| &mut s.vertices) {
            *vertex = Point3::from(vertex.coords.component_mul(&Vector3::from(stretch)));
        }
        let mesh = merged(&shells)?;
        let push = TiltPush {
            shells: &shells,
            mesh_from_tin: Pose::identity(),
            mass_kg,
            friction,
            contact_rad_s: CONTACT_RAD_S,
            half_width_m: stretch[0] * WIDTH_M / 2.0,
            height_m: stretch[2] * PUSH_HEIGHT_M,
            pulses,
            prior_kg,
            mesh: "../../scan/tin.obj",
            seed: seeds[0].into(),
        };
        let push = push.simulate()?;
        let grasps = some_grasps(&mut random)?;
        let size_m = mesh.bounds().map_or([0.0; 3], |(low, high)| (high - low).into());
        let volume_cm3 = (1e8 * mesh.mass_properties(1.0)?.mass_kg).round() / 100.0;
        let truth = format!("{{\"mass_kg\": {mass_kg}, \"friction\": {friction}, \"volume_cm3\": {volume_cm3}}}\n");
        let manifest = manifest(&name, seeds[1], prior_kg);
        Ok(Self {
            name,
            fault: None,
            mass_kg,
            friction,
            size_m,
            largest_lean_rad: push.largest_lean_rad,
            files: vec![
                ("twin.toml", manifest),
                ("scan/tin.obj", obj_text(&shells, &["tin", "lid"], "drex-bench twins")),
                ("push/tilt/push.toml", push.config),
                ("push/tilt/poses.csv", push.poses),
                ("push/tilt/force.csv", push.force),
                ("demos/grasps.json", serde_json::to_string(&grasps)? + "\n"),
                ("truth.json", truth),
            ],
        })
    }
}

/// Some of the bundled tin's demonstrations.
fn some_grasps(random: &mut ChaCha8Rng) -> Result<GraspFile> {
    let mut file = parse_grasp_file(Path::new("data/tin/demos/grasps.json"), DEMONSTRATIONS.as_bytes())?;
    for i in 0..GRASPS.min(file.grasps.len()) {
        let other = random.random_range(i..file.grasps.len());
        file.grasps.swap(i, other);
    }
    file.grasps.truncate(GRASPS);
    Ok(file)
}

/// `twin.toml`: as that of the bundled tin, with a training that takes seconds.
fn manifest(name: &str, seed: u32, prior_kg: f64) -> String {
    format!(
        "# A tin that was drawn at random, with a simulated push. Made by drex-bench twins; truth.json has the truth.
schema = 1
name = \"{name}\"
seed = {seed}

[object]
mesh = \"scan/tin.obj\"
up_in_mesh = [0, 0, 1]
friction = {ASSUMED_FRICTION:?}          # against the fingertips; an assumption

[mass]
identify = [\"push/tilt\"]
prior_kg = {prior_kg:?}

[grasps]
file = \"demos/grasps.json\"
hand = \"{HAND}\"

[train]
epochs = {EPOCHS}
"
    )
}

fn between([low, high]: [f64; 2], random: &mut ChaCha8Rng) -> f64 {
    random.random_range(low..high)
}
