//! What different pushes tell about the mass of the same block. Everything is simulated here, so the truth is known; no file is needed.
//!
//!     cargo run --release -p drex-sysid --example weigh_block
//!
//! A block of 137 g is lifted, tipped about its edge, and slid slowly over a table of unknown friction. The first two weigh it; the third
//! tells the product of friction and mass, and is answered with that and the reason.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::error::Error;
use std::sync::Arc;

use drex_core::trajectory::PoseNoise;
use drex_core::{ConvexPart, MassProperties, Object, Pose, Primitive, PrimitiveShape, Trajectory};
use drex_diffsim::{AppliedForce, Body, Collider, ForcePoint, Model, Part, Scene, State, rollout};
use drex_recording::{Drive, ForceProfile, PushRecording};
use drex_sysid::{IdentifyOptions, Knowledge, Parameter, identify};
use nalgebra::{Matrix3, Point3, Vector3};

const TRUE_KG: f64 = 0.137;
/// Half extents, m.
const HALF: Vector3<f64> = Vector3::new(0.025, 0.03, 0.04);

fn main() -> Result<(), Box<dyn Error>> {
    let weight = TRUE_KG * 9.81;
    let foot = Point3::new(-HALF.x, 0.0, -0.03);
    let head = Point3::new(-HALF.x, 0.0, 0.035);
    let tips = HALF.x / (HALF.z + head.z); // of the weight: moments about the far edge of the foot
    // Name, friction with the table, force, where it acts on the block, until when, whether friction is known.
    let pushes = [
        ("lifted", 0.4, Vector3::z() * 1.6 * weight, Point3::origin(), 0.45, true),
        ("tipped", 0.9, Vector3::x() * 1.25 * tips * weight, head, 0.45, true),
        ("slid slowly", 0.35, Vector3::x() * 1.04 * 0.35 * weight, foot, 1.1, false),
    ];
    println!("in truth {TRUE_KG} kg");
    for (name, friction, force, point, until_s, known) in pushes {
        let push = simulated(name, friction, force, point, until_s)?;
        let mut options = IdentifyOptions::default();
        if !known {
            options.parameters.set(Parameter::Friction, Knowledge::Free)?;
        }
        let answer = identify(&[push], &block()?, &options)?;
        print!("{name}: {:?}", answer.verdict);
        if let (Some(mass), Some([low, high])) = (answer.mass_kg, answer.ci95_kg) {
            print!(", {mass:.4} kg, 95 % from {low:.4} to {high:.4}");
        }
        if let Some(product) = answer.mu_m_kg {
            print!(", friction times mass {product:.4} kg (in truth {:.4})", friction * TRUE_KG);
        }
        println!(" after {} simulations\n    {}", answer.simulations, answer.reason);
    }
    Ok(())
}

/// The block, its mesh frame in the middle.
fn block() -> Result<Object, drex_core::Error> {
    let shape = PrimitiveShape::Box { half_m: HALF.into() };
    let part = ConvexPart::of_primitive(Primitive { shape, object_from_shape: Pose::identity() })?;
    let s = HALF.component_mul(&HALF) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    Ok(Object::of_parts(vec![part], unit))
}

/// A camera's view of the block from rest on, under `force` at `point` (mesh frame) from 0.3 s on; the track ends with the push if it
/// is a long one, so that nothing is seen of the block coasting to a stop.
fn simulated(
    name: &str,
    friction: f64,
    force: Vector3<f64>,
    point: Point3<f64>,
    until_s: f64,
) -> Result<PushRecording, Box<dyn Error>> {
    let object = block()?;
    let collider = Collider::of_parts(&object.convex_parts)?;
    let model = Model::new(vec![Body::new(&object.mass_properties, TRUE_KG, Arc::new(collider))]);
    let mut scene = Scene::on_table(friction);
    let times_s: Vec<f64> = (0..120).map(|k| f64::from(k) * 0.01).collect();
    let acts = |t: &f64| (0.3..until_s - 1e-4).contains(t);
    let forces_n: Vec<_> = times_s.iter().map(|t| if acts(t) { force } else { Vector3::zeros() }).collect();
    scene.forces.push(AppliedForce::new(Part::Body(0), &times_s, &forces_n, ForcePoint::Body(point))?);

    let start = Pose::translation(0.0, 0.0, HALF.z);
    let end_s = if until_s > 1.0 { until_s } else { 1.2 };
    let frames: Vec<f64> = (0..36).map(|k| f64::from(k) / 30.0).filter(|&t| t < end_s).collect();
    let record = rollout(&model, &scene, &State::at_rest(start), &frames)?;
    let track = Trajectory::from_samples(&frames, &record.bodies[0].poses)?;
    let profile = ForceProfile { times_s, forces_n, torques_nm: Vec::new(), point_in_object: point };
    let mut push = PushRecording::new(name, "block.obj", track, Drive::Force(profile));
    push.support.friction = Some(friction);
    push.initial_pose = Some(start);
    push.starts_at_rest = true;
    push.noise = Some(PoseNoise { position_m: 1e-3, rotation_rad: 0.01 });
    Ok(push)
}
