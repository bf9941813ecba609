//! The real LEAP grasps of a cookie tin. Their wrists are not recorded, so this looks at joints only.
#![allow(clippy::unwrap_used, missing_docs)] // a test says what fails by failing
#![cfg(feature = "flex")]

use std::ops::ControlFlow;
use std::path::Path;

use drex_core::Pose;
use drex_policy::{Dataset, GRAVITY_M_S2, GraspPolicy, GraspSample, TrainOptions};
use nalgebra::Point3;

/// The rows of a little-endian f64 `.npy` matrix in C order.
fn read_rows(path: &Path, columns: usize) -> Vec<Vec<f64>> {
    let bytes = std::fs::read(path).unwrap();
    let header = u16::from_le_bytes([bytes[8], bytes[9]]) as usize;
    let text = String::from_utf8_lossy(&bytes[10..10 + header]).into_owned();
    assert!(text.contains("<f8") && text.contains("'fortran_order': False"), "{text}");
    let values: Vec<f64> = bytes[10 + header..].as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    values.chunks_exact(columns).map(<[f64]>::to_vec).collect()
}

/// A tin of 16 cm across and 6 cm high.
fn tin() -> Vec<Point3<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..512)
        .map(|i| {
            let (part, angle) = (f64::from(i) / 512.0, golden * f64::from(i));
            let (radius, z) = if i % 2 == 0 { (0.08, 0.06 * (part - 0.5)) } else { (0.08 * part.sqrt(), 0.03) };
            Point3::new(radius * angle.cos(), radius * angle.sin(), z)
        })
        .collect()
}

#[test]
fn modes_are_nearer_to_real_grasps_than_their_mean_is() {
    let Some(shared) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped: DREX_SHARED is not set");
        return;
    };
    let rows = read_rows(&Path::new(&shared).join("data/drex_real/demos/cookie_leap_grasps.npy"), 16);
    assert_eq!(rows.len(), 132);
    let limits = (0..16).map(|j| {
        let column = rows.iter().map(|r| r[j]);
        (column.clone().fold(f64::INFINITY, f64::min), column.fold(f64::NEG_INFINITY, f64::max))
    });
    let sample = |joints: &Vec<f64>, mass_kg: f64| GraspSample {
        joints: joints.clone(),
        object_from_palm: Pose::translation(0.0, 0.0, 0.1),
        squeeze_n: 3.0 * mass_kg * GRAVITY_M_S2,
        mass_kg,
    };
    let data = Dataset {
        joint_names: (0..16).map(|j| format!("joint{j}")).collect(),
        joint_limits: limits.collect(),
        hand: "leap_right".into(),
        points: tin(),
        samples: rows.iter().flat_map(|r| [0.1, 0.2, 0.4].map(|m| sample(r, m))).collect(),
    };
    // DREX_POLICY_EPOCHS lengthens the run to measure the full training.
    let epochs = std::env::var("DREX_POLICY_EPOCHS").ok().and_then(|e| e.parse().ok()).unwrap_or(40);
    let modes = std::env::var("DREX_POLICY_MODES").ok().and_then(|e| e.parse().ok()).unwrap_or(8);
    let options = TrainOptions::default().with_epochs(epochs).with_modes(modes);
    let (_, report) = GraspPolicy::train(&data, &options, &mut |_| ControlFlow::Continue(())).unwrap();
    let (found, rules) = (report.held_out.unwrap(), report.baselines.unwrap());
    eprintln!("{epochs} epochs in {:.1} s, {} parameters", report.seconds, report.parameters);
    eprintln!("held out {found:?}\nlast epoch {:?}\n{rules:#?}\n{:#?}", report.curve.last(), report.modes);
    assert!(found.joint_rms_rad < 0.9 * rules.mean_demonstration.joint_rms_rad);
    assert!(found.joint_rms_rad < rules.random_demonstrations.joint_rms_rad);
}
