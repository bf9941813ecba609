//! Two fingers lift a box by friction.

use std::sync::Arc;

use drex_core::Pose;
use drex_diffsim::{Articulation, Base, BodyState, Control, Model, Part, Path, Scene, State, Workspace, step};
use drex_robot::Robot;
use nalgebra::Vector3;

use crate::common::{G, at, cuboid, relative, robot, within};

const MU: f64 = 0.5;
const HALF: f64 = 0.03;
const RADIUS: f64 = 0.01;
/// Lift by 1 cm in 2 s, so slowly that it adds 0.2 % to the weight.
const LIFT: [f64; 2] = [0.4, 2.4];

/// Two balls on slides that motors press together.
fn gripper() -> Arc<Robot> {
    let finger = |name: &str, x: f64, axis: f64| {
        format!(
            r#"<body name="{name}" pos="{x} 0 0"><joint name="{name}" type="slide" axis="{axis} 0 0" damping="1"/>
            <inertial pos="0 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/><geom type="sphere" size="{RADIUS}"/></body>"#
        )
    };
    let open = HALF + RADIUS + 2e-4;
    robot(
        &format!(
            r#"<body name="carriage"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{}{}</body>"#,
            finger("left", -open, 1.0),
            finger("right", open, -1.0)
        ),
        r#"<motor name="left" joint="left"/><motor name="right" joint="right"/>"#,
    )
}

struct Grip {
    model: Model<f64>,
    scene: Scene<f64>,
    state: State<f64>,
    work: Workspace<f64>,
}

impl Grip {
    /// A box of `mass` that is gripped by `force` on each side.
    fn new(mass: f64, force: f64) -> Self {
        let height = HALF + 0.005;
        let path = Path::smooth(&LIFT, &[at(0.0, 0.0, height), at(0.0, 0.0, height + 0.01)]).unwrap();
        let arm = Articulation::new(gripper(), Base::Path(path)).unwrap().with_friction(MU);
        let mut model = Model::new(vec![cuboid(Vector3::repeat(HALF), mass)]).with_articulation(arm);
        model.dt_s = 1e-3;
        let mut scene = Scene::on_table(MU);
        scene.controls.push(Control::constant(&[force, force]).unwrap());
        let state = State::new(
            vec![BodyState::at_rest(at(0.0, 0.0, HALF))],
            vec![model.articulations[0].at_rest(&[0.0, 0.0], 0.0).unwrap()],
        );
        Self { model, scene, state, work: Workspace::default() }
    }

    fn until(&mut self, t: f64) -> Pose {
        while self.state.time_s < t - 1e-9 {
            step(&self.model, &self.scene, &mut self.state, &mut self.work).unwrap();
        }
        self.state.articulations[0].base.world_from_base.inverse() * self.state.bodies[0].world_from_body
    }

    /// Whether the box is in the air at the end of the lift and a second later.
    fn holds(mass: f64, force: f64) -> bool {
        let mut grip = Self::new(mass, force);
        grip.until(LIFT[1] + 1.0);
        grip.state.bodies[0].world_from_body.translation.z - HALF > 5e-3
    }
}

/// (14) Threshold m g / (2 mu), hold at 1.5 times it, balance of forces; the masses of Symbol-Y.
#[test]
fn two_fingers_lift_what_friction_can_carry_and_hold_it() {
    for mass in [0.117, 0.206, 0.324] {
        let critical = mass * G / (2.0 * MU);
        let (mut low, mut high) = (0.9, 1.1);
        assert!(!Grip::holds(mass, low * critical) && Grip::holds(mass, high * critical));
        while high - low > 1e-3 {
            let middle = 0.5 * (low + high);
            if Grip::holds(mass, middle * critical) { high = middle } else { low = middle }
        }
        let name = format!("14 two-finger lift, {} g", (mass * 1e3_f64).round());
        within(&name, "threshold m g / (2 mu)", (0.5 * (low + high) - 1.0).abs(), 0.01);

        let mut grip = Grip::new(mass, 1.5 * critical);
        let closed = grip.until(LIFT[0]);
        let start = grip.until(LIFT[1] + 0.01);
        let end = grip.until(LIFT[1] + 3.01);
        let way = |a: &Pose, b: &Pose| (b.translation.vector - a.translation.vector).norm();
        within(&name, "slip in 3 s of hold at 1.5 times it, m", way(&start, &end), 2e-4);
        within(&name, "slip from the grasp on, m", way(&closed, &end), 2e-4);
        within(&name, "turn in 3 s of hold, rad", start.rotation.angle_to(&end.rotation), 1e-6);
        let held: Vec<_> = grip.work.contacts().collect();
        assert!(held.len() == 2 && held.iter().all(|c| matches!(c.key.b, Part::Link { .. })), "{held:?}");
        let up: f64 = held.iter().map(|c| c.force.z).sum();
        within(&name, "sum of the friction = m g", relative(up, mass * G), 1e-3);
        let grip_force = held.iter().map(|c| relative(c.force.dot(&c.normal), 1.5 * critical)).fold(0.0, f64::max);
        within(&name, "normal force = that of the motor", grip_force, 1e-3);
        assert_eq!(grip.work.unconverged_steps(), 0);
    }
}
