//! A state is everything that the future depends on, the same bytes come out of any number of threads, and every contact
//! can be read out.

use drex_core::Pose;
use drex_diffsim::{
    Articulation, Base, BodyState, Control, Job, Material, Model, Part, Path, Record, Scene, State, Workspace, rollout,
    rollout_batch, step,
};
use nalgebra::{UnitQuaternion, Vector3};

use crate::common::{G, at, ball, cuboid, resting, robot, turned, within};

/// Two fingers on a lifting carriage hold a box of `mass` that stands on a table; beside them two boxes on each other
/// slide and turn.
fn busy(mass: f64) -> (Model<f64>, Scene<f64>, State<f64>) {
    let finger = |name: &str, x: f64, axis: f64| {
        format!(
            r#"<body name="{name}" pos="{x} 0 0"><joint name="{name}" type="slide" axis="{axis} 0 0" damping="1" frictionloss="0.01"/>
            <inertial pos="0 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/><geom type="sphere" size="0.01"/></body>"#
        )
    };
    let fingers = robot(
        &format!(
            r#"<body name="carriage"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{}{}</body>"#,
            finger("left", -0.0401, 1.0),
            finger("right", 0.0401, -1.0)
        ),
        r#"<motor joint="left"/><motor joint="right"/>"#,
    );
    let path = Path::smooth(&[0.1, 0.6], &[at(0.0, 0.003, 0.035), at(0.02, 0.003, 0.085)]).unwrap();
    let arm = Articulation::new(fingers, Base::Path(path)).unwrap().with_friction(0.6).with_torsion_radius(3e-3);
    let bodies = vec![
        cuboid(Vector3::repeat(0.03), mass),
        cuboid(Vector3::new(0.04, 0.03, 0.02), 0.4),
        cuboid(Vector3::new(0.02, 0.02, 0.02), 0.1),
    ];
    let mut model = Model::new(bodies).with_articulation(arm);
    model.bodies.iter_mut().for_each(|b| b.material = Material::new(0.3));
    model.dt_s = 1e-3;
    let mut scene = Scene::on_table(0.4);
    scene.controls.push(Control::constant(&[5.0, 5.0]).unwrap());
    let mut state = resting(&[at(0.0, 0.0, 0.03), at(0.2, 0.0, 0.02), at(0.21, 0.005, 0.06)]);
    for s in &mut state.bodies[1..] {
        s.velocity = Vector3::new(0.3, 0.1, 0.0);
        s.angular_velocity.z = 2.0;
    }
    state.articulations.push(model.articulations[0].at_rest(&[0.0, 0.0], 0.0).unwrap());
    (model, scene, state)
}

fn advance(model: &Model<f64>, scene: &Scene<f64>, state: &mut State<f64>, work: &mut Workspace<f64>, steps: u32) {
    for _ in 0..steps {
        step(model, scene, state, work).unwrap();
    }
}

#[test]
fn a_saved_state_goes_on_to_the_same_bytes() {
    let (model, scene, mut state) = busy(0.25);
    let mut work = Workspace::default();
    advance(&model, &scene, &mut state, &mut work, 350);
    assert!(state.anchors.len() >= 6, "in the hand and on the table: {}", state.anchors.len());
    let saved = state.clone();
    advance(&model, &scene, &mut state, &mut work, 400);
    // Restored into new buffers, into used ones, and with new buffers in every step.
    let mut restored = saved.clone();
    advance(&model, &scene, &mut restored, &mut Workspace::default(), 400);
    assert_eq!(state, restored);
    restored.clone_from(&saved);
    advance(&model, &scene, &mut restored, &mut work, 400);
    assert_eq!(state, restored);
    restored.clone_from(&saved);
    (0..400).for_each(|_| advance(&model, &scene, &mut restored, &mut Workspace::default(), 1));
    assert_eq!(state, restored);
    // The anchors belong to it: without them the box sags in the hand.
    restored.clone_from(&saved);
    restored.anchors.clear();
    advance(&model, &scene, &mut restored, &mut work, 400);
    assert_ne!(state.bodies[0], restored.bodies[0]);
}

/// All numbers of a record, as bits.
fn bits(record: &Record<f64>) -> Vec<u64> {
    let mut out = Vec::new();
    for track in &record.bodies {
        for ((p, v), w) in track.poses.iter().zip(&track.velocities).zip(&track.angular_velocities) {
            let numbers = p.translation.vector.iter().chain(p.rotation.coords.iter()).chain(v.iter()).chain(w.iter());
            out.extend(numbers.map(|x| x.to_bits()));
        }
    }
    out.extend(record.joints.iter().flatten().flatten().map(|x| x.to_bits()));
    out
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let jobs: Vec<Job<f64>> = (0..24)
        .map(|i| {
            let (model, scene, start) = busy(0.1 + 0.02 * f64::from(i));
            Job { model, scene, start }
        })
        .collect();
    let times: Vec<f64> = (1..=12).map(|k| 0.0503 * f64::from(k)).collect();
    let alone: Vec<_> = jobs.iter().map(|j| bits(&rollout(&j.model, &j.scene, &j.start, &times).unwrap())).collect();
    for threads in [1, 2, 4] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let records = pool.install(|| rollout_batch(&jobs, &times));
        let batch: Vec<_> = records.iter().map(|r| bits(r.as_ref().unwrap())).collect();
        assert!(batch == alone, "{threads} threads");
    }
    assert!(alone.windows(2).all(|w| w[0] != w[1]), "the jobs differ");
}

/// Force and moment about its centre of mass that contacts put on body `i`.
fn load(model: &Model<f64>, start: &State<f64>, work: &Workspace<f64>, i: usize) -> (Vector3<f64>, Vector3<f64>) {
    let com = (start.bodies[i].world_from_body * model.bodies[i].center_of_mass).coords;
    let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
    for c in work.contacts() {
        for (part, sign) in [(c.key.a, 1.0), (c.key.b, -1.0)] {
            if part == Part::Body(i as u32) {
                force += c.force * sign;
                moment += ((c.point - com).cross(&c.force) + c.normal * c.torque) * sign;
            }
        }
    }
    (force, moment)
}

/// In every step, of impacts too: m (v' - v) = h (m g + f), forces in the cone, torques under their bound; links and
/// bodies are named, and the anchors are those of the contacts.
#[test]
fn contacts_can_be_read_out_in_every_step() {
    let (model, scene, mut state) = busy(0.25);
    state.bodies[2].world_from_body.translation.z += 0.02;
    let mut work = Workspace::default();
    let (mut worst, mut worst_spin, mut links, mut pairs) = (0.0_f64, 0.0_f64, 0, 0);
    for _ in 0..800 {
        let before = state.clone();
        step(&model, &scene, &mut state, &mut work).unwrap();
        for (i, body) in model.bodies.iter().enumerate() {
            let (force, moment) = load(&model, &before, &work, i);
            let (a, b) = (&before.bodies[i], &state.bodies[i]);
            let push = (b.velocity - a.velocity - scene.gravity * model.dt_s) * (body.mass_kg / model.dt_s);
            worst = worst.max((push - force).norm() / (body.mass_kg * G + force.norm()));
            // The balance of moments, but for the gyroscopic one, which is of the order of the spin squared.
            let r = a.world_from_body.rotation.to_rotation_matrix().into_inner();
            let inertia = r * body.unit_inertia * r.transpose() * body.mass_kg;
            let turn = inertia * (b.angular_velocity - a.angular_velocity) / model.dt_s;
            let gyro = inertia.norm() * (a.angular_velocity.norm() + b.angular_velocity.norm()).powi(2);
            worst_spin = worst_spin.max(((turn - moment).norm() - gyro) / (body.mass_kg * G * 0.03));
        }
        for c in work.contacts() {
            let mu = match c.key.b {
                Part::Link { .. } => 0.6,
                Part::Body(_) => 0.3,
                _ => 0.4,
            };
            let normal = c.force.dot(&c.normal);
            let across = (c.force - c.normal * normal).norm();
            assert!(normal > 0.0 && across <= mu * normal * (1.0 + 1e-9), "{c:?}");
            assert!(c.slips == (across > mu * normal * (1.0 - 1e-9)), "{c:?}");
            assert!(c.torque.abs() <= mu * 3e-3 * normal * (1.0 + 1e-9), "{c:?}");
            assert!((c.normal.norm() - 1.0).abs() < 1e-12);
            let anchor = state.anchors.iter().find(|a| a.key == c.key).unwrap();
            assert!((anchor.stretch.norm() - c.stretch.norm()).abs() < 1e-15);
            links += usize::from(matches!(c.key.b, Part::Link { .. }));
            pairs += usize::from((c.key.a, c.key.b) == (Part::Body(1), Part::Body(2)));
        }
        assert!(state.anchors.is_sorted_by(|a, b| a.key < b.key));
    }
    assert!(links > 500 && pairs > 500, "links in {links}, the pair of bodies in {pairs} contacts");
    within("contact read-out, 800 steps", "m dv = h (m g + sum of the forces)", worst, 1e-9);
    within("contact read-out, 800 steps", "sum of the moments, of m g 3 cm", worst_spin, 1e-9);
    assert_eq!(work.unconverged_steps(), 0);
}

#[test]
fn contact_forces_of_a_heap_balance_its_weight() {
    let masses = [0.5, 0.3, 0.2, 0.4];
    let half = [Vector3::new(0.05, 0.05, 0.03), Vector3::new(0.04, 0.05, 0.02), Vector3::new(0.03, 0.03, 0.03)];
    let mut bodies: Vec<_> = half.iter().zip(masses).map(|(h, m)| cuboid(*h, m)).collect();
    bodies.push(ball(0.03, masses[3]));
    bodies.iter_mut().for_each(|b| b.material = Material::new(0.6));
    let model = Model::new(bodies);
    let turn = |yaw: f64| UnitQuaternion::from_scaled_axis(Vector3::z() * yaw);
    let poses: [Pose; 4] = [
        at(0.0, 0.0, 0.03),
        turned(Vector3::new(0.01, -0.005, 0.08), turn(0.4)),
        turned(Vector3::new(0.0, 0.01, 0.13), turn(-0.7)),
        at(0.5, 0.0, 0.03),
    ];
    let (scene, mut state, mut work) = (Scene::on_table(0.5), resting(&poses), Workspace::default());
    advance(&model, &scene, &mut state, &mut work, 3000);
    let before = state.clone();
    advance(&model, &scene, &mut state, &mut work, 1);
    let mut worst = 0.0_f64;
    for (i, m) in masses.iter().enumerate() {
        let (force, moment) = load(&model, &before, &work, i);
        worst = worst.max((force - Vector3::z() * (m * G)).norm() / (m * G)).max(moment.norm() / (m * G * 0.03));
    }
    within("contact read-out, heap at rest", "forces and moments on each body balance its weight", worst, 1e-9);
    let on_table: f64 = work.contacts().filter(|c| c.key.b == Part::Static(0)).map(|c| c.force.z).sum();
    let weight = masses.iter().sum::<f64>() * G;
    within(
        "contact read-out, heap at rest",
        "forces of the table = weight of the heap",
        (on_table / weight - 1.0).abs(),
        1e-9,
    );
}

/// Links of two robots, and two links of one.
#[test]
fn pairs_of_links_are_read_out() {
    let paddle = |x: f64| {
        let text = format!(
            r#"<body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
            <body name="left" pos="{} 0 0"><joint name="left" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="0.1"
            diaginertia="1e-4 1e-4 1e-4"/><geom type="sphere" size="0.02"/></body>
            <body name="right" pos="{} 0 0"><joint name="right" type="slide" axis="-1 0 0"/><inertial pos="0 0 0" mass="0.1"
            diaginertia="1e-4 1e-4 1e-4"/><geom type="sphere" size="0.02"/></body></body>"#,
            x - 0.021,
            x + 0.021
        );
        let mut arm = Articulation::new(
            robot(&text, "<motor joint=\"left\"/><motor joint=\"right\"/>"),
            Base::Fixed(Pose::identity()),
        )
        .unwrap();
        arm.self_collision = true;
        arm
    };
    let mut model = Model::new(Vec::new()).with_articulation(paddle(0.0)).with_articulation(paddle(0.084));
    model.dt_s = 1e-3;
    let mut scene = Scene::empty();
    let control = |left: f64, right: f64| Control::constant(&[left, right]).unwrap();
    // The outer motors press with 2 N, the inner ones do nothing: a row of four balls.
    scene.controls = vec![control(2.0, 0.0), control(0.0, 2.0)];
    let arms = model.articulations.iter().map(|a| a.at_rest(&[0.0, 0.0], 0.0).unwrap()).collect();
    let (mut state, mut work) = (State::new(Vec::<BodyState<f64>>::new(), arms), Workspace::default());
    advance(&model, &scene, &mut state, &mut work, 1500);
    let link = |arm: u32, name: &str| Part::Link {
        articulation: arm,
        link: model.articulations[0].robot.link_index(name).unwrap() as u32,
    };
    let row =
        [(link(0, "left"), link(0, "right")), (link(0, "right"), link(1, "left")), (link(1, "left"), link(1, "right"))];
    let found: Vec<_> = work.contacts().map(|c| (c.key.a, c.key.b)).collect();
    assert!(row.iter().all(|p| found.contains(p)) && found.len() == 3, "{found:?}");
    let off = work.contacts().map(|c| (c.force.norm() / 2.0 - 1.0).abs()).fold(0.0, f64::max);
    within("contact read-out, links", "each carries the 2 N of the motors", off, 1e-9);
}
