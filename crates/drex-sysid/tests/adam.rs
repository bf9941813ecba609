//! The method that is there for comparison.
#![allow(clippy::unwrap_used, missing_docs, dead_code)] // a test may panic; not every test uses every helper

mod common;

use common::{block, simulated};
use drex_sysid::{IdentifyOptions, Method, Verdict, identify};
use nalgebra::{Point3, Vector3};

#[test]
fn adam_finds_a_mass_near_its_guess_without_an_interval_and_stalls_where_nothing_moves() {
    let m = 0.2;
    let mut push = simulated(m, 0.4, Vector3::z() * m * 9.81 * 1.6, Point3::origin());
    let mut options = IdentifyOptions::default();
    options.method = Method::Adam;
    options.dt_s = 2e-3;
    push.mass_prior_kg = Some(0.25);
    let a = identify(std::slice::from_ref(&push), &block(), &options).unwrap();
    assert!((a.mass_kg.unwrap() / m - 1.0).abs() < 0.01, "{:?}", a.mass_kg);
    assert_eq!((a.verdict, a.ci95_kg, a.simulations), (Verdict::Identified, None, 401));
    assert!(a.reason.contains("No interval") && a.reason.contains("200 epochs"), "{}", a.reason);
    // 1 kg does not rise under this force, so there is no slope to follow.
    push.mass_prior_kg = Some(1.0);
    let a = identify(&[push], &block(), &options).unwrap();
    assert!((a.mass_kg.unwrap() - 1.0).abs() < 0.05, "{:?}", a.mass_kg);
}
