//! Painlevé's rod: where rigid bodies have no answer, compliant contact has one.

use drex_diffsim::{Geom, Model, Scene, Shape, State, Workspace, step};
use nalgebra::{UnitQuaternion, Vector3};

use crate::common::{G, body, energy, resting, turned, within};

const HALF: f64 = 0.5;
const RADIUS: f64 = 1e-3;
const MU: f64 = 2.0;
const SPEED: f64 = 1.0;

/// A slender rod of 1 kg that slides tip first at 60 degrees with mu = 2 > 4/3. Rigid contact has no solution: the force
/// at the tip turns it further into the ground (1 + 3 cos² - 3 mu sin cos < 0).
///
/// Velocities (along, up, tip against centre) when the tip leaves the ground after the jam.
fn jam(stiffness: f64) -> Vector3<f64> {
    let angle = 60_f64.to_radians();
    assert!(1.0 + 3.0 * angle.cos().powi(2) - 3.0 * MU * angle.sin() * angle.cos() < 0.0);
    let slender = Vector3::new(HALF * HALF / 3.0, HALF * HALF / 3.0, 1e-6);
    let geom = Geom::new(Shape::Capsule { radius_m: RADIUS, half_length_m: HALF });
    let mut model = Model::new(vec![body(&[geom], slender, 1.0)]);
    // The same damping ratio at any stiffness, and as many steps per oscillation.
    let second = 1.0 / stiffness.sqrt();
    model.contact.stiffness_n_m = Some(stiffness);
    (model.contact.relaxation_s, model.contact.tangential_relaxation_s) = (0.2 * second, 0.2 * second);
    model.dt_s = 0.02 * second;
    let scene = Scene::on_table(MU);
    // The rod leans back from its lower tip, which leads along x.
    let tilt = UnitQuaternion::from_scaled_axis(-Vector3::y() * (std::f64::consts::FRAC_PI_2 - angle));
    let mut state: State<f64> = resting(&[turned(Vector3::z() * (HALF * angle.sin() + RADIUS), tilt)]);
    state.bodies[0].velocity.x = SPEED;
    let (mut work, first) = (Workspace::default(), energy(&model, &state, &scene.gravity));
    let (mut most, mut fastest, mut force, mut left) = (0.0_f64, 0.0_f64, 0.0_f64, None);
    while state.time_s < 0.1 {
        step(&model, &scene, &mut state, &mut work).unwrap();
        let b = &state.bodies[0];
        most = most.max(energy(&model, &state, &scene.gravity) - first);
        fastest = fastest.max(b.velocity.norm() + HALF * b.angular_velocity.norm());
        force = force.max(work.contacts().map(|c| c.force.norm()).fold(0.0, f64::max));
        if left.is_none() && force > 5.0 * G && work.contacts().next().is_none() {
            left = Some(Vector3::new(b.velocity.x, b.velocity.z, HALF * b.angular_velocity.y));
        }
    }
    let left = left.unwrap();
    println!("17 rod, k {stiffness:.0e}: leaves with {left:?}, force up to {force:.0} N");
    let name = format!("17 Painlevé rod, k {stiffness:.0e} N/m, 0.1 s");
    within(&name, "energy gained, of the start", (most / first).max(0.0), 1e-9);
    // All energy in one mode of motion bounds the speed.
    let bound = (2.0 * first).sqrt() + HALF * (2.0 * first / slender.x).sqrt();
    within(&name, "speed, of the bound by energy", fastest / bound, 1.0);
    left
}

/// (17) Bounded, no gain of energy, converges as the stiffness grows.
#[test]
fn painleves_rod_jams_without_gaining_energy_and_converges_with_the_stiffness() {
    let ends = [1e5, 1e6, 1e7, 1e8, 1e9].map(jam);
    let steps: Vec<f64> = ends.windows(2).map(|w| (w[1] - w[0]).norm()).collect();
    for pair in steps.windows(2) {
        within(
            "17 Painlevé rod, ten times the stiffness",
            "change when it leaves, of that before",
            pair[1] / pair[0],
            0.5,
        );
    }
}
