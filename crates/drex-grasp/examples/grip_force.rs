//! How hard to grip force? A thumb against two fingers on a box 6 cm wide, over mass and friction.
//!
//!     cargo run --release -p drex-grasp --example grip force
//!
//! For each mass and friction: the minimum grip force that holds still (N, the sum of all normal forces; m g / μ where the pads oppose each other),
//! what the grip-force policy commands, and the share of it that the thumb gives. Then the same with fingers that may press
//! with 6 N at most: a command, or the reason why there is none.
#![allow(clippy::print_stdout)] // an example talks to a person

use drex_grasp::{ClosureOptions, Contact, GripForcePolicy, GripForceProblem, force_closure, minimum_grip_force};
use nalgebra::{Point3, Vector3};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let closure = force_closure(&pinch(0.5), &ClosureOptions::about(Point3::origin()))?;
    println!("at friction 0.5 the grasp is closed: {}, epsilon {:.3}", closure.closed, closure.epsilon);

    println!("\n  kg    μ   smallest   m g/μ   command  of it thumb");
    for mass_kg in [0.05, 0.2, 0.8] {
        for friction in [0.3, 0.5, 0.8] {
            let problem = problem(mass_kg, friction);
            let least = minimum_grip_force(&problem)?;
            let command = GripForcePolicy::default().command(&problem)?;
            println!(
                "{mass_kg:4.2}  {friction:3.1}  {:7.2} N {:7.2} {:7.2} N   {:7.2} N",
                least.total_n,
                mass_kg * 9.81 / friction,
                command.total_n,
                command.distribution.normal_n[0]
            );
        }
    }

    println!("\nno contact with more than 6 N:");
    let law = GripForcePolicy::default().with_max_contact_n(6.0);
    for mass_kg in [0.05, 0.2, 0.8] {
        match law.command(&problem(mass_kg, 0.5)) {
            Ok(command) => println!("{mass_kg:4.2} kg: {:.2} N, margin {:.2}", command.total_n, command.margin),
            Err(reason) => println!("{mass_kg:4.2} kg: {reason}"),
        }
    }
    Ok(())
}

/// Contacts in the object's frame, m; normals point into the object.
fn pinch(friction: f64) -> Vec<Contact> {
    vec![
        Contact::new(Point3::new(-0.03, 0.0, 0.0), Vector3::x(), friction).by_finger(3),
        Contact::new(Point3::new(0.03, 0.02, 0.0), -Vector3::x(), friction).by_finger(0),
        Contact::new(Point3::new(0.03, -0.02, 0.0), -Vector3::x(), friction).by_finger(1),
    ]
}

fn problem(mass_kg: f64, friction: f64) -> GripForceProblem {
    GripForceProblem::new(pinch(friction), mass_kg, Point3::origin(), Vector3::new(0.0, 0.0, -9.81))
}
