//! Many bodies in one island, and a robot that is hit.

use drex_core::Pose;
use drex_diffsim::{
    AppliedForce, Articulation, Base, BodyState, ForcePoint, Material, Model, Part, Scene, State, Workspace, step,
};
use nalgebra::{Point3, Vector3};

use crate::common::{G, at, ball, cuboid, relative, resting, robot, within};

/// (12) SimBenchmark's rolling test: 25 balls of 1 kg on a box of 10 kg that 150 N drag over the ground for 4 s, along a
/// direction between the axes; mu 0.4 below and 0.8 above.
#[test]
fn balls_roll_on_a_box_that_is_dragged() {
    let (big, small, force, mu) = (10.0, 1.0, 150.0, 0.4);
    let (half, radius) = (Vector3::new(10.0, 10.0, 0.5), 0.4);
    let grid = |k: usize| 2.0 * (k as f64 - 2.0);
    let mut bodies: Vec<_> = (0..25).map(|_| ball(radius, small)).collect();
    bodies.iter_mut().for_each(|b| b.material = Material::new(0.8));
    bodies.push(cuboid(half, big));
    let mut poses: Vec<Pose> = (0..25).map(|k| at(grid(k / 5), grid(k % 5), 1.0 + radius)).collect();
    poses.push(at(0.0, 0.0, 0.5));
    let mut model = Model::new(bodies);
    model.dt_s = 1e-3;
    let along = Vector3::new(0.5, 0.75_f64.sqrt(), 0.0);
    let mut scene = Scene::on_table(mu);
    scene.forces.push(
        AppliedForce::new(
            Part::Body(25),
            &[0.0, 9.0],
            &[along * force, Vector3::zeros()],
            ForcePoint::Body(Point3::origin()),
        )
        .unwrap(),
    );
    let f1 = mu * (big + 25.0 * small) * G;
    let f2 = (force - f1) / big / (3.5 / small + 25.0 / big);
    let (a_box, a_ball) = ((force - f1 - 25.0 * f2) / big, f2 / small);
    let (mut state, mut work) = (resting(&poses), Workspace::default());
    let (mut worst, mut square) = ([0.0_f64; 3], 0.0);
    for k in 1..=4000 {
        step(&model, &scene, &mut state, &mut work).unwrap();
        let t = f64::from(k) * model.dt_s;
        let off = |i: usize, a: f64| state.bodies[i].velocity - along * (a * t);
        square += (off(25, a_box).norm_squared() + off(12, a_ball).norm_squared()) / 4000.0;
        if t > 0.5 {
            worst[0] = worst[0].max(off(25, a_box).norm() / (a_box * t));
            let balls = (0..25).map(|i| off(i, a_ball).norm() / (a_ball * t));
            worst[1] = worst[1].max(balls.fold(0.0, f64::max));
            let friction = |ground: bool| -> f64 {
                let of = |p: Part| matches!(p, Part::Static(_));
                work.contacts().filter(|c| of(c.key.b) == ground).map(|c| c.force.dot(&along).abs()).sum()
            };
            worst[2] = worst[2].max(relative(friction(true), f1)).max(relative(friction(false), 25.0 * f2));
        }
    }
    println!("12 box on balls: mean squared error of the velocities {square:.2e} m²/s²");
    within("12 balls on a box, 4 s", "a of the box = (F - f1 - 25 f2) / M", worst[0], 0.02);
    within("12 balls on a box, 4 s", "a of each ball = f2 / m", worst[1], 0.02);
    within("12 balls on a box, 4 s", "f1 = mu (M + 25 m) g, f2", worst[2], 0.02);
    assert_eq!(work.unconverged_steps(), 0);
}

/// A trunk with four legs of two links.
fn walker() -> Articulation<f64> {
    let legs: String = [(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)]
        .iter()
        .enumerate()
        .map(|(i, (x, y))| {
            format!(
                r#"<body name="thigh{i}" pos="{x} {y} 0"><joint name="hip{i}" axis="0 1 0" damping="0.5"/>
                <inertial pos="0 0 -0.12" mass="2" diaginertia="0.01 0.01 0.002"/><geom type="capsule" size="0.03 0.1" pos="0 0 -0.13"/>
                <body name="shank{i}" pos="0 0 -0.25"><joint name="knee{i}" axis="0 1 0.2" frictionloss="0.3"/>
                <inertial pos="0 0 -0.1" mass="0.6" diaginertia="0.003 0.003 0.0004"/><geom type="sphere" size="0.03" pos="0 0 -0.25"/>
                </body></body>"#
            )
        })
        .collect();
    let text = format!(
        r#"<body name="trunk"><freejoint/><inertial pos="0.02 0 0.01" mass="16" diaginertia="0.2 0.5 0.6"/>
        <geom type="box" size="0.35 0.12 0.08"/>{legs}</body>"#
    );
    Articulation::new(robot(&text, ""), Base::Free).unwrap()
}

/// Momentum, kinetic energy and height times mass of a robot on a free base.
fn sums(model: &Model<f64>, state: &State<f64>) -> (Vector3<f64>, f64, f64) {
    let (arm, s) = (&model.articulations[0], &state.articulations[0]);
    let poses = arm.robot.forward_kinematics(&s.q, &s.base.world_from_base);
    let (mut p, mut energy, mut height) = (Vector3::zeros(), 0.0, 0.0);
    let rates = nalgebra::DVector::from_vec(s.velocities.clone());
    for (i, link) in arm.links.iter().enumerate() {
        let com = poses[i] * link.center_of_mass;
        let (linear, angular) = arm.robot.jacobian(&poses, i, &com);
        let turn = s.base.angular_velocity;
        let v =
            s.base.velocity + turn.cross(&(com.coords - s.base.world_from_base.translation.vector)) + linear * &rates;
        let w = poses[i].rotation.inverse() * (turn + angular * &rates);
        p += v * link.mass_kg;
        energy += 0.5 * (link.mass_kg * v.norm_squared() + w.dot(&(link.inertia * w)));
        height += link.mass_kg * com.z;
    }
    (p, energy, height)
}

/// (13) SimBenchmark's momentum test: a ball of 10 kg at 5 m/s hits a free robot in free space.
#[test]
fn a_ball_hands_its_momentum_to_a_free_robot() {
    let mut model = Model::new(vec![ball(0.15, 10.0)]).with_articulation(walker());
    model.contact.relaxation_s = 1e-3;
    let mut scene = Scene::empty();
    scene.gravity = Vector3::zeros();
    scene.controls.push(drex_diffsim::Control::constant(&[]).unwrap());
    let arm = model.articulations[0].at_rest(&[0.2, -0.4, 0.1, -0.3, 0.0, -0.5, 0.3, -0.2], 0.0).unwrap();
    let mut body = BodyState::at_rest(at(-1.0, 0.05, 0.03));
    body.velocity.x = 5.0;
    let mut state = State::new(vec![body], vec![arm]);
    let (mut work, mut worst, mut square, mut hit) = (Workspace::default(), 0.0_f64, 0.0, 0);
    let steps = 2000;
    let first = 0.5 * 10.0 * 25.0;
    let mut most = 0.0_f64;
    for _ in 0..steps {
        step(&model, &scene, &mut state, &mut work).unwrap();
        hit += usize::from(work.contacts().next().is_some());
        let (p, energy, _) = sums(&model, &state);
        let off = (p + state.bodies[0].velocity * 10.0 - Vector3::x() * 50.0).norm();
        square += off * off / f64::from(steps);
        worst = worst.max(off / 50.0);
        most = most.max(energy + 5.0 * state.bodies[0].velocity.norm_squared());
    }
    println!("13 momentum: mean |p - 50|² = {square:.2e} (N s)², touching in {hit} steps");
    assert!(hit > 0 && state.bodies[0].velocity.x < 3.0, "it hits: {}", state.bodies[0].velocity);
    within("13 ball hits a free robot, 1 s", "p = 50 N s", worst, 1e-9);
    within("13 ball hits a free robot, 1 s", "energy gained", most / first - 1.0, 1e-9);
    assert_eq!(work.unconverged_steps(), 0);
}

/// (13) A free robot falls with its joints in motion: momentum grows by m g t, energy is kept.
#[test]
fn a_free_robot_falls_as_one() {
    let mut model = Model::new(Vec::new()).with_articulation(walker());
    model.articulations[0].joints.iter_mut().for_each(|j| (j.damping, j.friction_loss) = (0.0, 0.0));
    let mut arm = model.articulations[0].at_rest(&[0.2, -0.4, 0.1, -0.3, 0.0, -0.5, 0.3, -0.2], 0.0).unwrap();
    arm.velocities = vec![1.0, -2.0, 0.5, 2.0, -1.0, 1.5, 0.3, -1.0];
    arm.base.angular_velocity = Vector3::new(0.3, -0.6, 0.9);
    let mut state = State::new(Vec::new(), vec![arm]);
    let mut scene = Scene::empty();
    scene.controls.push(drex_diffsim::Control::constant(&[]).unwrap());
    let mass = model.articulations[0].robot.total_mass_kg();
    let (p0, e0, h0) = sums(&model, &state);
    let mut work = Workspace::default();
    for _ in 0..2000 {
        step(&model, &scene, &mut state, &mut work).unwrap();
    }
    let (p, e, h) = sums(&model, &state);
    let truth = p0 - Vector3::z() * (mass * G * state.time_s);
    within("13 free fall of a robot, 1 s", "p = p0 + m g t", (p - truth).norm() / truth.norm(), 1e-9);
    within(
        "13 free fall of a robot, 1 s",
        "KE + PE, of the height fallen",
        ((e - e0) / (G * (h0 - h)) - 1.0).abs(),
        2e-3,
    );
}
