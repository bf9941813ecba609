//! A wrist fit and a retargeted frame get the verdict that anybody gets who evaluates the same grasp with the same limits.

use std::path::Path;

use drex_core::Object;
use drex_grasp::{EvaluationOptions, Grasp, GraspEvaluation, evaluate};
use drex_mesh::{LengthUnit, metric_mesh};
use drex_retarget::{GraspOptions, TargetHand, WristFitOptions, fit_wrists, retarget_grasp};
use drex_robot::Robot;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::grasp::{cuboid, cylinder, lift, solid};
use super::wrist_fit::half_closed;

/// The tin that the project ships, and boxes and cylinders of random sizes.
fn objects(random: &mut ChaCha8Rng) -> Vec<Object> {
    let tin = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/tin/scan/tin.obj");
    let tin = solid(&metric_mesh(&tin, LengthUnit::Auto).unwrap().0);
    let mut size = || [(); 3].map(|()| random.random_range(0.015..0.1));
    let boxes = [size(), size(), size()].map(|[x, y, z]| solid(&cuboid(x, y, z)));
    let cylinders = [size(), size()].map(|[radius, half, _]| solid(&cylinder(radius, half)));
    boxes.into_iter().chain(cylinders).chain([tin]).collect()
}

#[test]
fn fits_and_frames_are_evaluated_as_anybody_would() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let (mut all, mut passed, mut differ) = (0, 0, Vec::new());
    let mut compare = |who: &str,
                       grasp: &Grasp,
                       found: &GraspEvaluation,
                       object: &Object,
                       robot: &Robot,
                       limits: &EvaluationOptions| {
        let anew = evaluate(grasp, object, robot, limits).unwrap();
        // Whose fingers are in the order of a mapping has the same numbers under other names.
        let verdict =
            |e: &GraspEvaluation| (e.passed, e.failures.len(), e.penetration_mm, e.force_closure, e.grip_force_n);
        if verdict(found) != verdict(&anew) || grasp.grip_force_n != anew.grip_force_n {
            differ.push(format!("{who}: {found:?}, {anew:?}"));
        }
        (all, passed) = (all + 1, passed + usize::from(anew.passed));
    };
    for object in objects(&mut random) {
        for name in ["leap_right", "allegro_right"] {
            let robot = Robot::bundled(name).unwrap();
            let mut options = WristFitOptions::default();
            (options.initial_guesses, options.kept) = (24, (6, 2));
            // Strict enough that many fail.
            options.limits.max_penetration_m = 0.0008;
            let noisy = |_| half_closed(&robot).iter().map(|q| q + random.random_range(-0.5..0.5)).collect();
            let rows: Vec<Vec<f64>> = (0..8).map(noisy).collect();
            for fit in fit_wrists(&robot, &rows, &object, &options).unwrap() {
                compare("wrist fit", &fit.grasp, &fit.evaluation, &object, &robot, &options.limits);
            }
            let target = TargetHand::bundled(name).unwrap();
            let mut options = GraspOptions::default();
            options.limits.max_penetration_m = 0.0008;
            let clip = retarget_grasp(&lift(&target, 0.75), &target, &object, &options).unwrap();
            for frame in clip.frames.iter().filter(|f| f.held) {
                compare("frame", &frame.grasp, &frame.evaluation, &object, &robot, &options.limits);
            }
        }
    }
    println!("{passed} of {all} grasps pass");
    assert!(differ.is_empty(), "{} of {all} differ:\n{}", differ.len(), differ.join("\n"));
    assert!(all >= 200 && passed > all / 5 && passed < 4 * all / 5, "{passed} of {all} pass: nothing is compared");
}
