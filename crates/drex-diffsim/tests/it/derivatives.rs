//! Derivatives from dual numbers against central differences.

use drex_core::Pose;
use drex_diffsim::{
    ActuatorKind, AppliedForce, Articulation, Base, BodyState, Control, Dual, ForcePoint, Model, Part, Scalar, Scene,
    State, Workspace, parameter, rollout, step, tangents,
};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use crate::common::{G, ball, cuboid, robot, within};

/// A motion whose outcome depends on N numbers.
trait Motion<const N: usize> {
    const NAMES: [&'static str; N];
    const AT: [f64; N];
    fn outcome<T: Scalar>(&self, p: &[T; N]) -> Vec<T>;
}

/// Compares the derivative of every outcome by every parameter with central differences of fourth order. A difference
/// counts against the derivative itself, or against a thousandth of the largest one by that parameter where it is
/// smaller than that. The motion has kinks where a contact opens or closes a step earlier; the best of several widths
/// is the one that lies between two of them.
fn compare<const N: usize, M: Motion<N>>(name: &str, motion: &M, tolerance: f64) {
    let exact = motion.outcome(&std::array::from_fn(|i| parameter::<N>(M::AT[i], i)));
    let plain = motion.outcome(&M::AT);
    assert!(exact.iter().zip(&plain).all(|(d, x)| (d.re - x).abs() < 1e-9 * (1.0 + x.abs())), "values agree");
    for i in 0..N {
        let column: Vec<f64> = exact.iter().map(|x| tangents(x)[i]).collect();
        let largest = column.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
        assert!(largest > 0.0, "{name}: nothing depends on {}", M::NAMES[i]);
        let mut best = vec![f64::INFINITY; column.len()];
        for h in [3e-3, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8] {
            let at = |s: f64| {
                let mut p = M::AT;
                p[i] += s * h;
                motion.outcome(&p)
            };
            let (far, near) = ((at(2.0), at(-2.0)), (at(1.0), at(-1.0)));
            for (k, (j, b)) in column.iter().zip(&mut best).enumerate() {
                let slope = (8.0 * (near.0[k] - near.1[k]) - (far.0[k] - far.1[k])) / (12.0 * h);
                *b = b.min((slope - j).abs() / j.abs().max(1e-3 * largest));
            }
        }
        let worst = best.into_iter().fold(0.0, f64::max);
        within(name, &format!("by {}", M::NAMES[i]), worst, tolerance);
    }
}

/// Position, and rotation as the vector part of the quaternion.
fn pose_of<T: Scalar>(pose: &Pose<T>) -> [T; 6] {
    let (x, q) = (pose.translation.vector, pose.rotation);
    [x.x, x.y, x.z, q.i, q.j, q.k]
}

/// A box of 6 x 6 x 8 cm under a force from 0.1 s to 0.25 s at a height over its centre.
struct Push {
    force_n: Vector3<f64>,
    height: f64,
    until: f64,
    frequency: f64,
}

impl Motion<8> for Push {
    const NAMES: [&'static str; 8] = [
        "ln mass",
        "friction",
        "centre of mass x",
        "centre of mass y",
        "ln stiffness",
        "start x",
        "start y",
        "start yaw",
    ];
    const AT: [f64; 8] = [-1.6, 0.45, 0.001, 0.0005, 0.0, 0.01, -0.02, 0.3];

    fn outcome<T: Scalar>(&self, p: &[T; 8]) -> Vec<T> {
        let half = Vector3::new(0.03, 0.03, 0.04);
        let mut body = cuboid(half, p[0].exp());
        body.center_of_mass.x += p[2];
        body.center_of_mass.y += p[3];
        let mut model = Model::new(vec![body]);
        // Stiffness per mass is the square of the frequency.
        model.contact.frequency_rad_s = (p[4] * T::lift(0.5)).exp() * T::lift(self.frequency);
        let mut scene = Scene::on_table(p[1]);
        let at = ForcePoint::Body(Point3::new(-0.03, 0.004, self.height));
        scene
            .forces
            .push(AppliedForce::new(Part::Body(0), &[0.1, 0.25], &[self.force_n, Vector3::zeros()], at).unwrap());
        let yaw = UnitQuaternion::from_scaled_axis(Vector3::new(T::zero(), T::zero(), p[7]));
        let sunk = half.z - G / (self.frequency * self.frequency);
        let start = State::at_rest(Pose::from_parts(Translation3::new(p[5], p[6], T::lift(sunk)), yaw));
        let end = rollout(&model, &scene, &start, &[self.until]).unwrap();
        pose_of(&end.bodies[0].poses[0]).to_vec()
    }
}

fn push(force_n: Vector3<f64>, height: f64, until: f64) -> Push {
    Push { force_n, height, until, frequency: 1e3 }
}

#[test]
fn a_smooth_slide() {
    compare("slide", &push(Vector3::x() * 1.6, -0.03, 0.24), 1e-6);
}

#[test]
fn a_lift() {
    compare("lift", &push(Vector3::new(0.3, 0.0, 3.0), 0.0, 0.2), 1e-6);
}

#[test]
fn a_tilt_with_a_sticking_edge() {
    compare("tilt about a sticking edge", &push(Vector3::x() * 0.85, 0.035, 0.25), 1e-5);
}

#[test]
fn a_slide_to_rest_sticks_again() {
    compare("slide to rest", &push(Vector3::x() * 1.6, -0.03, 0.6), 1e-5);
}

#[test]
fn a_push_that_does_not_move_the_box() {
    compare("stiction", &push(Vector3::x() * 0.5, 0.0, 0.24), 1e-5);
}

/// A finger of two links, under position drives, pushes a box over the table; box and finger stick or slip on each other.
struct FingerPush {
    friction_of_skin: f64,
}

impl Motion<10> for FingerPush {
    const NAMES: [&'static str; 10] = [
        "ln mass",
        "friction",
        "centre of mass y",
        "ln stiffness",
        "kp",
        "kv",
        "start x",
        "start yaw",
        "start of a joint",
        "mass of a link",
    ];
    const AT: [f64; 10] = [-1.6, 0.4, 0.002, 0.0, 2.0, 0.1, 0.0, 0.1, 0.0, 0.03];

    fn outcome<T: Scalar>(&self, p: &[T; 10]) -> Vec<T> {
        let finger = robot(
            r#"<body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
            <body name="near"><joint name="near" axis="0 0 1"/><inertial pos="0.05 0 0" mass="0.06" diaginertia="1e-5 5e-5 5e-5"/>
            <body name="far" pos="0.1 0 0"><joint name="far" axis="0 0 1"/><inertial pos="0.04 0 0" mass="0.03" diaginertia="1e-5 2e-5 2e-5"/>
            <geom type="sphere" size="0.01" pos="0.08 0 0"/></body></body></body>"#,
            r#"<position joint="near" kp="2" kv="0.1"/><position joint="far" kp="2" kv="0.1"/>"#,
        );
        let base = Base::Fixed(Pose::translation(-0.17, -0.05, 0.035));
        let mut arm = Articulation::new(finger, base).unwrap().with_friction(self.friction_of_skin).lift::<T>();
        arm.actuators.iter_mut().for_each(|a| a.kind = ActuatorKind::Position { kp: p[4], kv: p[5] });
        arm.links[2].mass_kg = p[9];
        let mut body = cuboid(Vector3::new(0.03, 0.04, 0.03), p[0].exp());
        body.center_of_mass.y += p[2];
        let mut model = Model::new(vec![body]).with_articulation(arm);
        model.contact.frequency_rad_s = (p[3] * T::lift(0.5)).exp() * T::lift(1e3);
        let mut scene = Scene::on_table(p[1]);
        scene.controls.push(Control::constant(&[0.9, -0.2]).unwrap());
        let yaw = UnitQuaternion::from_scaled_axis(Vector3::new(T::zero(), T::zero(), p[7]));
        let pose = Pose::from_parts(Translation3::new(p[6], T::zero(), T::lift(0.03 - G / 1e6)), yaw);
        let joints = model.articulations[0].at_rest(&[T::lift(-0.4) + p[8], T::lift(0.9)], 0.0).unwrap();
        let start = State::new(vec![BodyState::at_rest(pose)], vec![joints]);
        let end = rollout(&model, &scene, &start, &[0.35]).unwrap();
        let mut out = pose_of(&end.bodies[0].poses[0]).to_vec();
        out.extend(&end.joints[0][0]);
        out
    }
}

#[test]
fn a_finger_pushes_a_box_and_slips_on_it() {
    compare("finger push, slippery", &FingerPush { friction_of_skin: 0.05 }, 1e-6);
}

#[test]
fn a_finger_pushes_a_box_and_sticks_to_it() {
    compare("finger push, sticking", &FingerPush { friction_of_skin: 1.0 }, 1e-5);
}

/// Largest derivative of a pose by ln m, of what the pose itself is (at least a centimetre or a hundredth of a turn).
fn by_mass(name: &str, poses: &[Pose<Dual<1>>]) {
    let of = |x: Dual<1>| tangents(&x)[0].abs() / x.re.abs().max(0.01);
    let worst = poses.iter().flat_map(pose_of).map(of).fold(0.0, f64::max);
    within(name, "no derivative by ln mass", worst, 1e-12);
}

/// What gravity and contact with static bodies alone move has no derivative by the mass.
#[test]
fn a_free_toss_does_not_see_the_mass() {
    let mass = parameter::<1>(0.3_f64.ln(), 0).exp();
    let model = Model::new(vec![cuboid(Vector3::new(0.03, 0.02, 0.04), mass)]);
    let mut start = State::at_rest(Pose::translation(0.0, 0.0, 0.3).cast());
    start.bodies[0].velocity = Vector3::new(0.8, -0.2, 1.0).map(Dual::from_re);
    start.bodies[0].angular_velocity = Vector3::new(3.0, -7.0, 5.0).map(Dual::from_re);
    let record = rollout(&model, &Scene::on_table(Dual::from_re(0.4)), &start, &[0.2, 0.5, 1.5]).unwrap();
    by_mass("toss, in the air", &record.bodies[0].poses[..1]);
    by_mass("toss, tumbling on the table and at rest", &record.bodies[0].poses[1..]);
}

/// The same for two bodies that collide, and for a robot in free flight, whose masses all grow alike.
#[test]
fn a_toss_of_several_bodies_does_not_see_their_common_mass() {
    let mass = parameter::<1>(0.3_f64.ln(), 0).exp();
    let model = Model::new(vec![ball(0.05, mass), ball(0.04, mass * Dual::from_re(2.5))]);
    let mut start = State::at_rest(Pose::translation(0.0, 0.0, 0.5).cast());
    start.bodies.push(BodyState::at_rest(Pose::translation(0.3, 0.02, 0.55).cast()));
    start.bodies[0].velocity = Vector3::new(2.0, 0.0, 0.3).map(Dual::from_re);
    let mut scene = Scene::empty();
    let record = rollout(&model, &scene, &start, &[0.1, 0.3]).unwrap();
    assert!(record.last.bodies[1].velocity.x.re > 0.1, "they collide");
    let poses: Vec<_> = record.bodies.iter().flat_map(|b| b.poses.clone()).collect();
    by_mass("toss of two balls that collide", &poses);

    let chain = robot(
        r#"<body name="a"><freejoint/><inertial pos="0.01 0 0" mass="1" diaginertia="0.01 0.02 0.02"/>
        <body name="b" pos="0.1 0 0"><joint name="j" axis="0 1 0"/><inertial pos="0.1 0 0" mass="0.5" diaginertia="0.001 0.004 0.004"/>
        <body name="c" pos="0.2 0 0"><joint name="k" axis="0 0 1"/><inertial pos="0 0.1 0" mass="0.2" diaginertia="0.002 0.001 0.002"/>
        </body></body></body>"#,
        "",
    );
    let factor = parameter::<1>(0.0, 0).exp();
    let mut arm = Articulation::new(chain, Base::Free).unwrap().lift::<Dual<1>>();
    for link in &mut arm.links {
        link.mass_kg *= factor;
        link.inertia *= factor;
    }
    let mut start = arm.at_rest(&[Dual::from_re(0.3), Dual::from_re(-0.5)], 0.0).unwrap();
    start.velocities = vec![Dual::from_re(2.0), Dual::from_re(-3.0)];
    start.base.velocity = Vector3::new(1.0, 0.0, 2.0).map(Dual::from_re);
    let model = Model::new(Vec::new()).with_articulation(arm);
    scene.controls.push(Control::constant(&[]).unwrap());
    let (mut state, mut work) = (State::new(Vec::new(), vec![start]), Workspace::default());
    for _ in 0..600 {
        step(&model, &scene, &mut state, &mut work).unwrap();
    }
    let arm = &state.articulations[0];
    let joints =
        Pose::from_parts(Translation3::new(arm.q[0], arm.q[1], Dual::from_re(0.0)), UnitQuaternion::identity());
    by_mass("toss of a robot", &[arm.base.world_from_base, joints]);
}
