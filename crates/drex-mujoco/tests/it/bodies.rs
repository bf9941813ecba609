//! The same bodies and scene in both engines.

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    AppliedForce, Body, BodyState, Collider, ConvexPolyhedron, Error as SimulationError, ForcePoint, Geom,
    KinematicBody, Model, Part, Path, Scene, Shape, State, StaticBody, rollout,
};
use drex_mujoco::{Error, MjcfOptions, MujocoEngine, to_mjcf};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

const G: f64 = 9.81;

fn piece(half: Vector3<f64>, center: Vector3<f64>) -> ConvexPolyhedron {
    let sign = |i: usize| Vector3::from_fn(|k, _| if i >> k & 1 == 0 { -1.0 } else { 1.0 });
    let corners: Vec<_> = (0..8).map(|i| Point3::from(center + half.component_mul(&sign(i)))).collect();
    ConvexPolyhedron::from_points(&corners).unwrap()
}

fn body(mass_kg: f64, com: Point3<f64>, gyration: Vector3<f64>, pieces: Vec<ConvexPolyhedron>) -> Model<f64> {
    let s = gyration.component_mul(&gyration);
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: com, inertia };
    Model::new(vec![Body::new(&unit, mass_kg, Arc::new(Collider::convex(pieces)))])
}

fn block(half: Vector3<f64>, mass_kg: f64) -> Model<f64> {
    body(mass_kg, Point3::origin(), half / 3.0_f64.sqrt(), vec![piece(half, Vector3::zeros())])
}

fn cylinder(radius: f64, half_length: f64, sides: u32) -> ConvexPolyhedron {
    let rim = (0..sides).flat_map(|i| {
        let a = std::f64::consts::TAU * f64::from(i) / f64::from(sides);
        [-half_length, half_length].map(|z| Point3::new(radius * a.cos(), radius * a.sin(), z))
    });
    ConvexPolyhedron::from_points(&rim.collect::<Vec<_>>()).unwrap()
}

fn force(f: Vector3<f64>, from: f64, to: f64, at: Point3<f64>) -> AppliedForce<f64> {
    AppliedForce::new(Part::Body(0), &[from, to], &[f, Vector3::zeros()], ForcePoint::Body(at)).unwrap()
}

/// Runs both engines and checks that positions agree within `mm` and orientations within `degrees` at fifty times, and
/// that the body moved at least `moved_mm`, so that the comparison says something.
fn agree(model: &Model<f64>, scene: &Scene<f64>, start: &State<f64>, until_s: f64, bounds: (f64, f64, f64)) {
    let times: Vec<f64> = (1..=50).map(|i| f64::from(i) * until_s / 50.0).collect();
    let ours = rollout(model, scene, start, &times).unwrap();
    let theirs = drex_mujoco::rollout(model, scene, start, &times, &MjcfOptions::default()).unwrap();
    let from = start.bodies[0].world_from_body.translation.vector;
    let (mut distance, mut angle, mut moved) = (0.0_f64, 0.0_f64, 0.0_f64);
    for (a, b) in ours.bodies[0].poses.iter().zip(&theirs.bodies[0].poses) {
        distance = distance.max((a.translation.vector - b.translation.vector).norm() * 1e3);
        angle = angle.max(a.rotation.angle_to(&b.rotation).to_degrees());
        moved = moved.max((a.translation.vector - from).norm() * 1e3);
    }
    println!("{distance:.4} mm, {angle:.3} degrees on a way of {moved:.1} mm");
    let (mm, degrees, moved_mm) = bounds;
    assert!(moved > moved_mm, "it moved {moved} mm");
    assert!(distance < mm && angle < degrees, "{distance} mm, {angle} degrees");
}

#[test]
fn a_tumbling_body_with_its_mass_off_centre() {
    let box_piece = piece(Vector3::new(0.03, 0.05, 0.08), Vector3::zeros());
    let model = body(0.3, Point3::new(0.02, -0.01, 0.03), Vector3::new(0.02, 0.04, 0.06), vec![box_piece]);
    let turned = UnitQuaternion::from_euler_angles(0.3, 0.7, -0.4);
    let mut start = State::at_rest(Pose::from_parts(Vector3::new(0.1, 0.2, 3.0).into(), turned));
    start.bodies[0].velocity = Vector3::new(0.5, -0.3, 1.0);
    start.bodies[0].angular_velocity = Vector3::new(3.0, 7.0, -2.0);
    agree(&model, &Scene::empty(), &start, 0.6, (0.01, 0.01, 1000.0));
}

#[test]
fn a_box_that_drops_and_rests() {
    let model = block(Vector3::repeat(0.03), 0.2);
    let start = State::at_rest(Pose::translation(0.0, 0.0, 0.08));
    agree(&model, &Scene::on_table(0.5), &start, 0.5, (0.2, 0.05, 45.0));
}

#[test]
fn a_box_that_slides_to_rest() {
    // MuJoCo's box loses and regains contact while it slides, which turns it a little.
    let model = block(Vector3::repeat(0.03), 0.2);
    let mut start = State::at_rest(Pose::translation(0.0, 0.0, 0.03));
    start.bodies[0].velocity = Vector3::new(0.6, 0.3, 0.0);
    let scene = Scene::on_table(0.4);
    let mut engine = MujocoEngine::new(&model, &scene, &start, &MjcfOptions::default()).unwrap();
    let touching = (0..200).map(|_| engine.step().map(|()| engine.contacts().len()).unwrap()).sum::<usize>();
    println!("MuJoCo's sliding box: {:.1} of 4 corners in contact on average", touching as f64 / 200.0);
    agree(&model, &scene, &start, 0.5, (1.5, 2.5, 55.0));
}

#[test]
fn a_block_tilted_about_its_edge() {
    let model = block(Vector3::new(0.02, 0.04, 0.05), 0.25);
    let mut scene = Scene::on_table(0.9);
    let f = 1.4 * 0.25 * G * 0.02 / 0.08;
    scene.forces.push(force(Vector3::x() * f, 0.1, 0.2, Point3::new(-0.02, 0.0, 0.03)));
    agree(&model, &scene, &State::at_rest(Pose::translation(0.0, 0.0, 0.05)), 0.28, (0.02, 0.05, 10.0));
}

#[test]
fn a_board_rocked_over_the_edge_of_a_step() {
    let model = block(Vector3::new(0.04, 0.03, 0.015), 0.2);
    let mut scene = Scene::on_table(0.6);
    let half = Vector3::new(0.15, 0.2, 0.025);
    scene.static_bodies.push(StaticBody::cuboid(Point3::new(-0.15, 0.0, 0.025), half, 0.6).unwrap());
    let f = 1.5 * 0.2 * G * 0.008 / 0.032;
    scene.forces.push(force(-Vector3::z() * f, 0.1, 0.2, Point3::new(0.04, 0.0, 0.015)));
    agree(&model, &scene, &State::at_rest(Pose::translation(-0.008, 0.0, 0.065)), 0.25, (0.05, 0.1, 5.0));
}

#[test]
fn a_cylinder_made_of_points_that_is_pushed() {
    let model = body(0.3, Point3::origin(), Vector3::new(0.017, 0.017, 0.03), vec![cylinder(0.03, 0.05, 38)]);
    let mut scene = Scene::on_table(0.4);
    scene.forces.push(force(Vector3::x() * 2.0, 0.1, 0.2, Point3::new(0.0, 0.0, -0.045)));
    agree(&model, &scene, &State::at_rest(Pose::translation(0.0, 0.0, 0.05)), 0.6, (1.5, 5.0, 20.0));
}

#[test]
fn a_box_pushed_by_a_prescribed_sphere() {
    let model = block(Vector3::repeat(0.03), 0.2);
    let mut scene = Scene::on_table(0.4);
    let path = [Point3::new(-0.06, 0.0, 0.03), Point3::new(0.04, 0.0, 0.03)];
    scene.kinematic_bodies.push(KinematicBody::sphere(0.01, 0.6, &[0.1, 1.1], &path).unwrap());
    agree(&model, &scene, &State::at_rest(Pose::translation(0.0, 0.0, 0.03)), 1.3, (0.4, 0.4, 70.0));
}

#[test]
fn a_resting_box_is_carried_by_its_contacts() {
    let model = block(Vector3::repeat(0.03), 0.2);
    let start = State::at_rest(Pose::translation(0.0, 0.0, 0.03));
    let mut engine = MujocoEngine::new(&model, &Scene::on_table(0.5), &start, &MjcfOptions::default()).unwrap();
    for _ in 0..400 {
        engine.step().unwrap();
    }
    let contacts = engine.contacts();
    assert_eq!(contacts.len(), 4);
    let mut force = Vector3::zeros();
    for c in &contacts {
        assert_eq!((c.key.a, c.key.b), (Part::Body(0), Part::Static(0)));
        assert!(c.normal.z > 0.999 && c.depth.abs() < 1e-4 && c.point.z.abs() < 1e-4 && !c.slips, "{c:?}");
        force += c.force;
    }
    assert!((force - Vector3::z() * 0.2 * G).norm() < 1e-4, "{force}");
    assert!((engine.time_s() - 0.2).abs() < 1e-12);
    assert!(engine.state().bodies[0].velocity.norm() < 1e-6);
}

#[test]
fn what_cannot_be_run_is_refused_by_name() {
    let model = block(Vector3::repeat(0.03), 0.2);
    let scene = Scene::on_table(0.5);
    let start = State::at_rest(Pose::translation(0.0, 0.0, 0.03));
    let mut options = MjcfOptions::default();
    options.contact_time_s = Some(1e-4);
    let error = to_mjcf(&model, &scene, &start, &options).unwrap_err();
    assert!(error.to_string().contains("contact_time_s"), "{error}");
    options = MjcfOptions::default();
    assert!(drex_mujoco::rollout(&block(Vector3::repeat(0.03), -1.0), &scene, &start, &[0.1], &options).is_err());
    assert!(drex_mujoco::rollout(&model, &scene, &start, &[0.2, 0.1], &options).is_err());
    options.impratio = f64::NAN;
    assert!(drex_mujoco::rollout(&model, &scene, &start, &[0.1], &options).is_err());
    let mut wild = scene.clone();
    wild.forces.push(force(Vector3::x() * 1e6, 0.0, 1.0, Point3::origin()));
    let error = drex_mujoco::rollout(&model, &wild, &start, &[0.1], &MjcfOptions::default()).unwrap_err();
    assert!(matches!(error, Error::Simulation(SimulationError::Diverged { .. })), "{error}");
}

fn sphere(radius_m: f64) -> Collider {
    Collider::new(&[Geom::new(Shape::Sphere { radius_m })]).unwrap()
}

#[test]
fn a_ball_that_rolls_against_a_box() {
    let mut model = block(Vector3::repeat(0.02), 0.05);
    let radius = 0.03;
    let unit = MassProperties {
        mass_kg: 1.0,
        center_of_mass: Point3::origin(),
        inertia: Matrix3::identity() * (0.4 * radius * radius),
    };
    model.bodies.push(Body::new(&unit, 0.3, Arc::new(sphere(radius))));
    let mut start = State::at_rest(Pose::translation(0.0, 0.0, 0.02));
    let mut ball = BodyState::at_rest(Pose::translation(-0.12, 0.0, radius));
    ball.velocity = Vector3::x() * 0.5;
    ball.angular_velocity = Vector3::y() * (0.5 / radius);
    start.bodies.push(ball);
    agree(&model, &Scene::on_table(0.3), &start, 0.6, (2.0, 5.0, 100.0));
}

#[test]
fn a_ball_on_soft_skin_that_spins_down() {
    let (radius, ring, mu) = (0.03, 4e-3, 0.5);
    let inertia = Matrix3::identity() * (0.4 * radius * radius);
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let model = Model::new(vec![Body::new(&unit, 0.2, Arc::new(sphere(radius)))]);
    let mut scene = Scene::on_table(mu);
    scene.static_bodies[0].material.torsion_radius_m = ring;
    let mut start = State::at_rest(Pose::translation(0.0, 0.0, radius));
    start.bodies[0].angular_velocity = Vector3::z() * 20.0;
    // Torsional friction mu r m g brings it down at a constant rate: it stops after 20 / 54.5 = 0.37 s.
    let rate = mu * ring * G / (0.4 * radius * radius);
    let times = [0.1, 0.2, 0.3, 0.5];
    let ours = rollout(&model, &scene, &start, &times).unwrap();
    let theirs = drex_mujoco::rollout(&model, &scene, &start, &times, &MjcfOptions::default()).unwrap();
    for (i, t) in times.iter().enumerate() {
        let spin = [&ours, &theirs].map(|r| r.bodies[0].angular_velocities[i].z);
        println!("t {t}: {:.3} rad/s, {:.3} rad/s", spin[0], spin[1]);
        let truth = (20.0 - rate * t).max(0.0);
        assert!(spin.iter().all(|w| (w - truth).abs() < 0.2), "{spin:?} {truth}");
    }
}

#[test]
fn a_box_on_a_turntable() {
    let model = block(Vector3::repeat(0.02), 0.1);
    let turn = |a: f64| Pose::from_parts(Vector3::zeros().into(), UnitQuaternion::from_euler_angles(0.0, 0.0, a));
    let half_m = Vector3::new(0.2, 0.2, 0.01);
    let table = Collider::new(&[Geom::new(Shape::Box { half_m }).at(Pose::translation(0.0, 0.0, -0.01))]).unwrap();
    let mut scene = Scene::empty();
    let path = Path::smooth(&[0.1, 1.1], &[turn(0.0), turn(1.5)]).unwrap();
    scene.kinematic_bodies.push(KinematicBody::new(path, Arc::new(table), 0.8));
    agree(&model, &scene, &State::at_rest(Pose::translation(0.1, 0.0, 0.02)), 1.2, (0.5, 0.5, 100.0));
}

#[test]
fn capsules_and_cylinders_that_roll() {
    let shapes = [
        Shape::Capsule { radius_m: 0.02, half_length_m: 0.03 },
        Shape::Cylinder { radius_m: 0.02, half_length_m: 0.03 },
    ];
    for shape in shapes {
        let lying = UnitQuaternion::from_euler_angles(std::f64::consts::FRAC_PI_2, 0.0, 0.0);
        let geom = Geom::new(shape).at(Pose::from_parts(Vector3::zeros().into(), lying));
        let unit = MassProperties {
            mass_kg: 1.0,
            center_of_mass: Point3::origin(),
            inertia: Matrix3::from_diagonal(&Vector3::new(5e-4, 2e-4, 5e-4)),
        };
        let model = Model::new(vec![Body::new(&unit, 0.2, Arc::new(Collider::new(&[geom]).unwrap()))]);
        let mut scene = Scene::on_table(0.5);
        scene.gravity = Vector3::new(0.2_f64.sin(), 0.0, -0.2_f64.cos()) * G;
        agree(&model, &scene, &State::at_rest(Pose::translation(0.0, 0.0, 0.02)), 0.5, (0.05, 0.05, 100.0));
    }
}
