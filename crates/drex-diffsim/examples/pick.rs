//! The bundled LEAP hand picks a box off a table, lifts it by 20 cm in 2 s and holds it for 3 s.
//!
//!     cargo run --release -p drex-diffsim --example pick
//!
//! Prints the slip of the box in the hand for several grip forces, as parts of the smallest one that carries it.

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    ActuatorKind, Articulation, Base, Body, Collider, Control, Geom, Model, Part, Path, Result, Scene, Shape, State,
    Workspace, step,
};
use drex_robot::Robot;
use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion, Vector3};

/// Joint angles at which the thumb faces the index and middle fingers across 5 cm.
const GRASP: [(&str, f64); 12] = [
    ("if_mcp", 0.323),
    ("if_rot", 0.0332),
    ("if_pip", 1.3067),
    ("if_dip", 0.6129),
    ("mf_mcp", 0.4686),
    ("mf_rot", -0.1072),
    ("mf_pip", 0.5256),
    ("mf_dip", 1.2977),
    ("th_cmc", 1.493),
    ("th_axl", 0.8261),
    ("th_mcp", 1.623),
    ("th_ipl", -1.34),
];
/// Where the box is then: its centre line in the hand's frame, and its yaw.
const CENTER: (f64, f64, f64) = (-0.00776, -0.02648, -0.10179);
const YAW: f64 = 0.393;
/// Half extents of the box, metres, and the height of the contacts over the table.
const HALF: Vector3<f64> = Vector3::new(0.025, 0.04, 0.04);
const CONTACT_HEIGHT_M: f64 = 0.05;
/// Stiffness and damping of the position drives, N m/rad and N m s/rad.
const STIFFNESS: f64 = 3.0;
const DAMPING: f64 = 0.05;
/// How far the fingers are open at the start, rad.
const OPEN: [(&str, f64); 3] = [("if_mcp", -0.06), ("mf_mcp", -0.06), ("th_mcp", -0.06)];
const G: f64 = 9.81;

/// A pick to be simulated.
#[derive(Debug, Clone, Copy)]
pub struct Pick {
    /// Mass of the box, kg.
    pub mass_kg: f64,
    /// Friction between skin and box.
    pub friction: f64,
    /// Largest joint torque, N m.
    pub cap_nm: f64,
    /// Grip force of each side over m g / (2 friction).
    pub grip_force: f64,
    /// Torque that a drive may add to what the grip force needs, to hold its position, N m. With it, fingers that are told to
    /// press too little make up for it as they are pushed apart.
    pub reserve_nm: f64,
    /// Time step, seconds.
    pub dt_s: f64,
}

/// What became of it.
#[derive(Debug, Clone, Copy)]
pub struct Outcome {
    /// How far the box is above the table in the end, metres.
    pub height_m: f64,
    /// How far the skin slid over the box during the lift, metres: the longest way of a fingertip.
    pub slip_lift_m: f64,
    /// The same during the hold.
    pub slip_hold_m: f64,
    /// How far the box moved in the frame of the palm during the hold, metres.
    pub drift_hold_m: f64,
    /// Largest joint torque asked for, N m; the cap cuts what is above it.
    pub torque_nm: f64,
    /// Sum of the normal forces of the thumb in the end, newtons.
    pub thumb_n: f64,
    /// Steps whose contact equations were not solved to full precision.
    pub unconverged: usize,
}

/// Hand, box and table, at the start of the pick.
pub fn scene(pick: &Pick) -> Result<(Model<f64>, Scene<f64>, State<f64>)> {
    let robot = Arc::new(
        Robot::bundled("leap_right")
            .map_err(|e| drex_diffsim::Error::Series { what: e.to_string(), remedy: "reinstall drex-robot".into() })?,
    );
    let height = CONTACT_HEIGHT_M - CENTER.2;
    let at = |z: f64| Pose::translation(0.0, 0.0, z);
    let lift = Path::smooth(&[0.5, 2.5], &[at(height), at(height + 0.2)])?;
    let mut hand = Articulation::new(Arc::clone(&robot), Base::Path(lift))?.with_friction(pick.friction);
    for drive in &mut hand.actuators {
        drive.kind = ActuatorKind::Position { kp: STIFFNESS, kv: DAMPING };
    }
    let q = robot
        .joint_vector(GRASP)
        .map_err(|e| drex_diffsim::Error::Series { what: e.to_string(), remedy: "use the bundled hand".into() })?;
    let torque = torques(&hand, &q, pick, &at(height));
    let drives = hand.actuators.iter_mut();
    let commands: Vec<f64> = drives
        .map(|drive| {
            let cap = (torque[drive.joint].abs() + pick.reserve_nm).min(pick.cap_nm);
            drive.force_range = Some((-cap, cap));
            q[drive.joint] + torque[drive.joint] / STIFFNESS
        })
        .collect();
    let control = Control::constant(&commands)?;

    let s = HALF.component_mul(&HALF) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let collider = Collider::new(&[Geom::new(Shape::Box { half_m: HALF })])?;
    let pose = Pose::from_parts(
        Translation3::new(CENTER.0, CENTER.1, HALF.z),
        UnitQuaternion::from_euler_angles(0.0, 0.0, YAW),
    );
    let mut model = Model::new(vec![Body::new(&unit, pick.mass_kg, Arc::new(collider))]).with_articulation(hand);
    model.dt_s = pick.dt_s;
    let mut scene = Scene::on_table(pick.friction);
    scene.controls.push(control);
    let mut open = q;
    for (name, angle) in OPEN {
        open[model.articulations[0].joint_index(name)?] += angle;
    }
    let arm = model.articulations[0].at_rest(&open, 0.0)?;
    let mut start = State::at_rest(pose);
    start.articulations.push(arm);
    Ok((model, scene, start))
}

/// Joint torques that make the fingertips press with the grip force and carry the box, half of it on each side:
/// Jᵀ f + gravity.
fn torques(hand: &Articulation<f64>, q: &[f64], pick: &Pick, world_from_base: &Pose) -> Vec<f64> {
    let robot = &hand.robot;
    let poses = robot.forward_kinematics(q, world_from_base);
    let grip_force = pick.grip_force * pick.mass_kg * G / (2.0 * pick.friction);
    let out = UnitQuaternion::from_euler_angles(0.0, 0.0, YAW) * Vector3::x();
    let mut torque: Vec<f64> = robot.gravity_torque(q, &Vector3::new(0.0, 0.0, -G)).iter().copied().collect();
    for (finger, share) in [("thumb", 1.0), ("index", -0.5), ("middle", -0.5)] {
        if let Some(f) = robot.fingers().iter().find(|f| f.name == finger) {
            let pad = poses[f.tip_link] * Point3::new(-0.00085, 0.0097, 0.0);
            let (linear, _) = robot.jacobian(&poses, f.tip_link, &pad);
            let weight: f64 = 0.5 * pick.mass_kg * G * share;
            let tau = linear.transpose() * (out * (grip_force * share) + Vector3::z() * weight.abs());
            torque.iter_mut().zip(tau.iter()).for_each(|(t, x)| *t += x);
        }
    }
    torque
}

/// Runs a pick.
pub fn run(pick: &Pick) -> Result<Outcome> {
    let (model, scene, mut state) = scene(pick)?;
    let mut work = Workspace::default();
    let in_hand = |s: &State<f64>| s.articulations[0].base.world_from_base.inverse() * s.bodies[0].world_from_body;
    let links = model.articulations[0].robot.links.len();
    let (mut slips, mut marks) = (Vec::new(), Vec::new());
    for end in [0.5, 2.5, 5.5] {
        let mut way = vec![Vector3::zeros(); links];
        while state.time_s < end - 1e-9 {
            step(&model, &scene, &mut state, &mut work)?;
            // Mean sliding velocity of each link's contacts, weighed by what they carry.
            let (mut sum, mut load) = (vec![Vector3::zeros(); links], vec![0.0; links]);
            for c in work.contacts() {
                if let Part::Link { link, .. } = c.key.b {
                    let carried = c.force.dot(&c.normal);
                    sum[link as usize] += (c.velocity - c.normal * c.velocity.dot(&c.normal)) * carried;
                    load[link as usize] += carried;
                }
            }
            for ((w, s), l) in way.iter_mut().zip(&sum).zip(&load).filter(|x| *x.1 > 0.0) {
                *w += s * (model.dt_s / l);
            }
        }
        slips.push(way.iter().map(Vector3::norm).fold(0.0, f64::max));
        marks.push(in_hand(&state));
    }
    let thumb =
        model.articulations[0].robot.fingers().iter().find(|f| f.is_thumb).map(|f| f.links.clone()).unwrap_or_default();
    let of_thumb = |p: Part| matches!(p, Part::Link { link, .. } if thumb.contains(&(link as usize)));
    let thumb_n = work.contacts().filter(|c| of_thumb(c.key.b)).map(|c| c.force.dot(&c.normal)).sum();
    let drives = model.articulations[0].actuators.iter().zip(scene.controls[0].at(0.0));
    let torque_nm = drives.map(|(a, c)| (STIFFNESS * (c - state.articulations[0].q[a.joint])).abs());
    Ok(Outcome {
        height_m: state.bodies[0].world_from_body.translation.z - HALF.z,
        slip_lift_m: slips[1],
        slip_hold_m: slips[2],
        drift_hold_m: (marks[1].translation.vector - marks[2].translation.vector).norm(),
        torque_nm: torque_nm.fold(0.0, f64::max),
        thumb_n,
        unconverged: work.unconverged_steps(),
    })
}

#[allow(clippy::print_stdout, dead_code)] // the output is the point of an example; a test includes this file
fn main() -> Result<()> {
    let dt_s = 1e-3;
    println!(
        "{:>6} {:>5} {:>5} {:>8} | {:>9} {:>9} {:>9} {:>9} {:>7} {:>7}",
        "kg", "mu", "N m", "grip force", "height m", "lift mm", "hold mm", "drift mm", "thumb N", "N m"
    );
    for (mass_kg, friction, cap_nm) in [(0.2, 0.5, 0.29), (0.7, 0.9, 0.5)] {
        for (grip_force, reserve_nm) in [(0.5, 0.0), (1.2, 0.1), (1.5, 0.1), (2.0, 0.1)] {
            let o = run(&Pick { mass_kg, friction, cap_nm, grip_force, reserve_nm, dt_s })?;
            println!(
                "{mass_kg:>6} {friction:>5} {cap_nm:>5} {grip_force:>8} | {:>9.4} {:>9.4} {:>9.4} {:>9.4} {:>7.2} {:>7.3} {}",
                o.height_m,
                1e3 * o.slip_lift_m,
                1e3 * o.slip_hold_m,
                1e3 * o.drift_hold_m,
                o.thumb_n,
                o.torque_nm,
                o.unconverged
            );
        }
    }
    Ok(())
}
