//! A grasp for an object that nobody has trained on: what the network for many objects proposes, and a search where none ships.

use std::ops::ControlFlow;
use std::sync::Mutex;

use drex_core::{ConvexPart, MassProperties, Object, Pose, Primitive, PrimitiveShape};
use drex_robot::Robot;
use drex_trial::{FindOptions, find_grasp};
use drex_twin::{Error, propose};
use nalgebra::{Matrix3, Point3};

/// A can of 6 cm and 10 cm that stands, 100 g.
fn can() -> Object {
    let (radius_m, half_length_m, mass_kg) = (0.03, 0.05, 0.1);
    let properties =
        MassProperties { mass_kg, center_of_mass: Point3::origin(), inertia: Matrix3::identity() * (mass_kg * 1e-3) };
    let shape = PrimitiveShape::Cylinder { radius_m, half_length_m };
    let part = ConvexPart::of_primitive(Primitive { shape, object_from_shape: Pose::identity() }).unwrap();
    Object::of_parts(vec![part], properties).with_rest_pose(Pose::translation(0.0, 0.0, half_length_m))
}

/// So little that a search finds nothing.
fn options() -> FindOptions {
    let mut options = FindOptions::default();
    (options.candidates, options.simulated, options.trials) = (0, 3, 6);
    options
}

#[test]
fn a_can_is_grasped_as_the_network_proposes() {
    let (can, options) = (can(), options());
    let hand = Robot::bundled("leap_right").unwrap();
    assert!(find_grasp(&can, &hand, &options).unwrap().is_none(), "without candidates a search finds nothing");
    let parts = Mutex::new(Vec::new());
    let watch = |part| {
        parts.lock().unwrap().push(part);
        ControlFlow::Continue(())
    };
    let found = propose::find_grasp(&can, &hand, &options, &watch).unwrap().unwrap();
    assert!(found.held >= 5 && found.verdicts.len() == 6, "{:?}", found.verdicts);
    let parts = parts.into_inner().unwrap();
    assert!(parts.iter().all(|part| (0.0..=1.0).contains(part)) && parts.last() == Some(&1.0), "{parts:?}");
    let negative = propose::find_grasp(&can.clone().with_mass(-1.0), &hand, &options, &|_| ControlFlow::Continue(()));
    assert!(negative.err().unwrap().to_string().contains("-1 kg"));
    let stopped = propose::find_grasp(&can, &hand, &options, &|_| ControlFlow::Break(())).err().unwrap();
    assert!(matches!(stopped, Error::Trial(drex_trial::Error::Stopped) | Error::Stopped), "{stopped}");
}

#[test]
fn a_hand_without_a_network_searches() {
    let mut hand = Robot::bundled("leap_right").unwrap();
    hand.name = "another".into();
    let go_on = |_| ControlFlow::Continue(());
    assert!(propose::find_grasp(&can(), &hand, &options(), &go_on).unwrap().is_none());
}
