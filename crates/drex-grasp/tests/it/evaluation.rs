//! Whoever evaluates a grasp with the same limits gets the same verdict.

use drex_core::{ConvexPart, MassProperties, Object, Pose, Primitive, PrimitiveShape};
use drex_grasp::{EvaluationOptions, Grasp, HandSurface, evaluate, evaluate_with, synthesize_grasps};
use drex_robot::Robot;
use nalgebra::{Matrix3, Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A box or an upright cylinder of random size, mass and friction, on the table.
fn random_object(random: &mut ChaCha8Rng) -> Object {
    let mut even = |low: f64, high: f64| random.random_range(low..high);
    let (half_m, mass_kg, friction) =
        ([even(0.015, 0.03), even(0.015, 0.03), even(0.03, 0.07)], even(0.05, 0.6), even(0.3, 0.9));
    let shape = match even(0.0, 1.0) < 0.5 {
        true => PrimitiveShape::Box { half_m },
        false => PrimitiveShape::Cylinder { radius_m: half_m[0], half_length_m: half_m[2] },
    };
    let part = ConvexPart::of_primitive(Primitive { shape, object_from_shape: Pose::identity() }).unwrap();
    let inertia = Matrix3::identity() * (mass_kg * half_m[2].powi(2) / 3.0);
    let mut object =
        Object::of_parts(vec![part], MassProperties { mass_kg, center_of_mass: Point3::origin(), inertia });
    object.friction = friction;
    object.with_rest_pose(Pose::translation(0.0, 0.0, half_m[2]))
}

/// 200 grasps of random objects by both hands, half of them moved by millimetres so that they may break any limit.
#[test]
fn equal_limits_give_equal_verdicts() {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let hands = ["leap_right", "allegro_right"].map(|name| Robot::bundled(name).unwrap());
    let (mut all, mut passed, mut differ) = (0, 0, Vec::new());
    for seed in 0.. {
        let (object, robot) = (random_object(&mut random), &hands[seed as usize % 2]);
        let mut options = EvaluationOptions::default();
        // What pinches with one finger beside the thumb is among them as well.
        options.min_fingers = 1;
        let surface = HandSurface::new(robot, options.contact.spacing_m).unwrap();
        for (i, mut grasp) in synthesize_grasps(&object, robot, 400, seed).unwrap().into_iter().take(20).enumerate() {
            if i % 2 == 1 {
                let shift = Vector3::from_fn(|_, _| random.random_range(-0.002..0.002));
                grasp.object_from_base.translation.vector += shift;
            }
            let whole = evaluate(&grasp, &object, robot, &options).unwrap();
            let mut verdict = options.clone();
            verdict.complete = false;
            let short = evaluate_with(&surface, &grasp, &object, robot, &verdict).unwrap();
            let kept = grasp.clone().screened(&surface, &object, robot, &options).unwrap();
            let force = kept.as_ref().and_then(|g: &Grasp| g.grip_force_n);
            if (short.passed, kept.is_some()) != (whole.passed, whole.passed)
                || whole.passed && (force, force) != (whole.grip_force_n, short.grip_force_n)
            {
                differ.push(format!("{seed}/{i}: {:?}, {:?}, {force:?}", whole, short));
            }
            (all, passed) = (all + 1, passed + usize::from(whole.passed));
        }
        if all >= 200 {
            break;
        }
    }
    println!("{passed} of {all} grasps pass");
    assert!(differ.is_empty(), "{} of {all} differ:\n{}", differ.len(), differ.join("\n"));
    assert!(passed > all / 5 && passed < 4 * all / 5, "{passed} of {all} pass: nothing is compared");
}
