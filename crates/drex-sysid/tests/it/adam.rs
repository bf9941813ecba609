//! The method that is there for comparison.

use crate::common::{block, simulated};
use drex_sysid::{IdentifyOptions, Method, Verdict, identify};
use nalgebra::{Point3, Vector3};

#[test]
fn adam_finds_a_mass_from_its_guess_and_has_no_interval() {
    let m = 0.2;
    let mut push = simulated(m, 0.4, Vector3::z() * m * 9.81 * 1.6, Point3::origin());
    let mut options = IdentifyOptions::default();
    options.method = Method::Adam;
    options.dt_s = 2e-3;
    push.mass_prior_kg = Some(0.25);
    let a = identify(std::slice::from_ref(&push), &block(), &options).unwrap();
    assert!((a.mass_kg.unwrap() / m - 1.0).abs() < 0.01, "{:?}", a.mass_kg);
    assert_eq!((a.verdict, a.ci95_kg, a.simulations), (Verdict::Fitted, None, 401));
    assert!(a.reason.contains("No interval") && a.reason.contains("200 epochs"), "{}", a.reason);
    let losses = a.reason.split("residuals from ").nth(1).unwrap().split(" (").next().unwrap();
    let losses: Vec<f64> = losses.split(" to ").map(|x| x.parse().unwrap()).collect();
    assert!(losses[0] > 10.0 * losses[1] && losses[1] < 0.5, "{}", a.reason);
    // The guess is where it starts: with five times the mass it is on its way for longer, and ends in the same place.
    push.mass_prior_kg = Some(5.0 * m);
    let a = identify(&[push], &block(), &options).unwrap();
    assert!((a.mass_kg.unwrap() / m - 1.0).abs() < 0.02, "{:?}", a.mass_kg);
    assert!(a.reason.contains("from 1000.0 g"), "{}", a.reason);
}
