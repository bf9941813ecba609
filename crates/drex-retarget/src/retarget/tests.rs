#![allow(clippy::unwrap_used, clippy::print_stdout)]

use super::support::{HANDS, SEQUENCES, canonical, demonstration, golden, shared};
use drex_core::Pose;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::*;
use crate::solve::{Problem, State};

/// A reference's joint vector in our objective gives the reference's objective.
#[test]
fn the_objectives_are_those_of_the_reference() {
    let Some(shared) = shared() else { return };
    let mut compared = 0;
    for sequence in SEQUENCES {
        let demonstrations = [demonstration(&shared, sequence), canonical(&shared, sequence)];
        for (name, objective) in
            HANDS.iter().flat_map(|n| [Objective::Vector, Objective::DexPilot, Objective::Position].map(|o| (n, o)))
        {
            let Some(golden) = golden(&shared, sequence, name, objective) else { continue };
            let hand = TargetHand::bundled(name).unwrap();
            let mut options = RetargetOptions::new(objective);
            if objective != Objective::Position {
                options.scale = Scale::Fixed(1.6);
            }
            let mut retargeter = Retargeter::new(&hand, options).unwrap();
            let mut worst = 0.0_f64;
            for (frame, ((base, q), expected)) in demonstrations[usize::from(objective != Objective::Position)]
                .frames
                .iter()
                .zip(golden.frames.iter().zip(&golden.objectives))
            {
                retargeter.set_targets(&frame.points).unwrap();
                let base = match base[..] {
                    [x, y, z, a, b, c] => {
                        let turn = |axis: Vector3<f64>, angle| UnitQuaternion::new(axis * angle);
                        let rotation = turn(Vector3::x(), a) * turn(Vector3::y(), b) * turn(Vector3::z(), c);
                        Isometry3::from_parts(Translation3::new(x, y, z), rotation) * root_from_base(&hand)
                    }
                    _ => Isometry3::identity(),
                };
                retargeter.problem.value(&State { base, q: q.clone() });
                worst = worst.max((retargeter.problem.objective() - expected).abs());
                compared += 1;
            }
            println!("{sequence} {name} {objective:?}: {worst:.2e}");
            // The fingertips of the bundled LEAP hand are up to 1e-5 m off the URDF's, whose numbers are rounded otherwise.
            let rounding = if hand.robot.name.contains("leap") { 3e-5 } else { 1e-6 };
            assert!(worst < rounding, "{sequence} {name} {objective:?}: {worst}");
        }
    }
    assert!(compared > 0);
}

/// Where the bundled model's base is in the root link of the URDF that the reference used: LEAP's root is the wrist.
fn root_from_base(hand: &TargetHand) -> Pose {
    if hand.robot.name.contains("leap") { hand.base_from_operator.inverse() } else { Pose::identity() }
}
