//! What the noise of a force leaves unknown, where an estimate starts, and what wrong assumptions do to it.

use std::path::Path;

use crate::common::{block, normals, object_at, shared, simulated};
use drex_core::Object;
use drex_recording::convert::mujoco_push::{self, ForceQuality, Inputs, PoseQuality};
use drex_recording::{Drive, PushRecording};
use drex_sysid::{Identification, IdentifyOptions, Knowledge, Parameter, identify};
use nalgebra::{Point3, Vector3};

/// The same push with noise of `sd` newtons per axis on the samples of its force.
fn with_noise(push: &PushRecording, sd: f64, random: &mut impl FnMut() -> f64) -> PushRecording {
    let mut out = push.clone();
    let Drive::Force(force) = &mut out.drive else { unreachable!("the push has a known force") };
    force.forces_n.iter_mut().for_each(|f| *f += Vector3::from_fn(|_, _| sd * random()));
    out
}

#[test]
fn noise_of_the_force_leaves_what_it_must_and_hardly_more() {
    let (m, draws) = (0.137, 12);
    let force = Vector3::z() * m * 9.81 * 1.6;
    let push = simulated(m, 0.4, force, Point3::origin());
    let sd = 0.05 * force.norm();
    // 15 samples of 0.15 s.
    let bound = 0.05 / 15.0_f64.sqrt();
    let mut random = normals(11);
    let (mut square, mut held) = (0.0, 0);
    for _ in 0..draws {
        let a = identify(&[with_noise(&push, sd, &mut random)], &block(), &IdentifyOptions::default()).unwrap();
        let (found, ci) = (a.mass_kg.unwrap(), a.ci95_kg.unwrap());
        square += (found / m).ln().powi(2);
        held += usize::from(ci[0] < m && m < ci[1]);
        let printed = a.error_budget.unwrap().force_factor;
        assert!((printed / bound - 1.0).abs() < 0.25, "{printed} and {bound}");
        let half = 0.5 * (ci[1] / ci[0]).ln();
        assert!((1.96 * printed..3.0 * printed).contains(&half), "{half} and {printed}");
    }
    let rms = (square / f64::from(draws)).sqrt();
    assert!((0.5..1.6).contains(&(rms / bound)), "{rms} and {bound}");
    assert!(held >= 11, "{held} of {draws}");
}

fn load(folder: &Path, poses: PoseQuality, force: ForceQuality) -> (PushRecording, Object) {
    let recording = mujoco_push::load(folder, Inputs { poses, force }).unwrap();
    let object = object_at(&recording.mesh);
    (recording, object)
}

fn relative_half(a: &Identification) -> f64 {
    let ci = a.ci95_kg.unwrap();
    0.5 * (ci[1] / ci[0]).ln()
}

#[test]
fn the_answer_does_not_depend_on_the_start() {
    let Some(shared) = shared() else { return };
    for folder in ["brick/tilt_force", "letter_l/lift_force", "can/slide_force"] {
        let folder = shared.join("data/push_mujoco").join(folder);
        let (mut push, object) = load(&folder, PoseQuality::Noisy, ForceQuality::Noisy);
        let plain = identify(std::slice::from_ref(&push), &object, &IdentifyOptions::default()).unwrap();
        let m = plain.mass_kg.unwrap();
        // A first guess takes no part at all.
        for guess in [0.002, 50.0 * m] {
            push.mass_prior_kg = Some(guess);
            let a = identify(std::slice::from_ref(&push), &object, &IdentifyOptions::default()).unwrap();
            assert_eq!((a.mass_kg, a.ci95_kg), (plain.mass_kg, plain.ci95_kg));
        }
        // Where the scan begins plays no part that counts.
        for range in [[0.002, 0.4], [0.02, 50.0 * m]] {
            let mut options = IdentifyOptions::default();
            options.scan_kg = range;
            let a = identify(std::slice::from_ref(&push), &object, &options).unwrap();
            let moved = (a.mass_kg.unwrap() / m).ln().abs();
            assert!(moved < 0.25 * relative_half(&plain), "{}: {moved} from {range:?}", folder.display());
        }
    }
}

/// What is wrong: a parameter, its stated value, and the size of the error in the unit of its sensitivity.
fn wrong(push: &PushRecording) -> [(Parameter, f64, f64); 3] {
    [
        (Parameter::ContactHeight, 0.01, 0.01),
        (Parameter::ForceGain, 1.03, 1.03_f64.ln()),
        (Parameter::Friction, 1.3 * push.support.friction.unwrap(), 1.3_f64.ln()),
    ]
}

#[test]
fn printed_sensitivities_predict_what_wrong_assumptions_do() {
    let Some(shared) = shared() else { return };
    for name in [
        "brick/tilt_force",
        "letter_l_rho1/tilt_force",
        "letter_l/lift_force",
        "letter_t/slide_force",
        "brick/overhang_press",
    ] {
        let folder = shared.join("data/push_mujoco").join(name);
        let (push, object) = load(&folder, PoseQuality::Noisy, ForceQuality::Exact);
        let plain = identify(std::slice::from_ref(&push), &object, &IdentifyOptions::default()).unwrap();
        for (parameter, value, size) in wrong(&push) {
            let slope = plain.sensitivities.iter().find(|s| s.parameter == parameter).map_or(0.0, |s| s.log_mass);
            let mut options = IdentifyOptions::default();
            options.parameters.set(parameter, Knowledge::Fixed(value)).unwrap();
            let a = identify(std::slice::from_ref(&push), &object, &options).unwrap();
            let (moved, predicted) = ((a.mass_kg.unwrap() / plain.mass_kg.unwrap()).ln(), slope * size);
            eprintln!(
                "{name}: {} moves the mass by {:+.2} %, predicted {:+.2} %",
                parameter.as_str(),
                100.0 * moved,
                100.0 * predicted
            );
            assert!(
                (moved - predicted).abs() < 0.3 * moved.abs() + relative_half(&plain),
                "{name}: {} moves log mass by {moved:+.4}, predicted {predicted:+.4}",
                parameter.as_str()
            );
        }
    }
}
