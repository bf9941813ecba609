//! The LEAP with torque-capped drives picks boxes off a table; with half the force that is needed it does not.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)] // a test may panic and say what it measured

#[path = "../examples/pick.rs"]
#[allow(dead_code)] // it has a main of its own
mod pick;

use pick::Pick;

/// Light and slippery, heavy and rough: kg, friction, torque cap.
const BOXES: [(f64, f64, f64); 2] = [(0.2, 0.5, 0.29), (0.7, 0.9, 0.5)];

fn of((mass_kg, friction, cap_nm): (f64, f64, f64), grip_force: f64, reserve_nm: f64, dt_s: f64) -> Pick {
    Pick { mass_kg, friction, cap_nm, grip_force, reserve_nm, dt_s }
}

#[test]
fn one_and_a_half_times_the_force_lifts_and_holds() {
    for object in BOXES {
        for dt_s in [1e-3, 2e-3] {
            let o = pick::run(&of(object, 1.5, 0.1, dt_s)).unwrap();
            println!("{object:?}, {dt_s} s: {o:?}");
            assert!((o.height_m - 0.2).abs() < 5e-3, "{o:?}");
            assert!(o.slip_lift_m < 5e-4 && o.slip_hold_m < 5e-4 && o.drift_hold_m < 5e-4, "{o:?}");
        }
    }
}

#[test]
fn half_the_force_drops() {
    for object in BOXES {
        let o = pick::run(&of(object, 0.5, 0.0, 1e-3)).unwrap();
        println!("{object:?}: {o:?}");
        assert!(o.height_m < 1e-3, "it stands on the table: {o:?}");
    }
}

#[test]
fn the_contact_equations_are_solved() {
    let o = pick::run(&of(BOXES[0], 1.5, 0.1, 1e-3)).unwrap();
    assert!(o.unconverged <= 5, "{} of 5500 steps", o.unconverged);
}
