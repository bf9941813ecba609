//! The torque-current model: both directions, fits to noisy pairs, refusals, files.

use drex_hw::Error;
use drex_hw::torque_current::{Approach, Curve, Nominal, Provenance, Sample, TorqueCurrentModel, fit};
use proptest::prelude::*;

fn measured() -> Provenance {
    Provenance {
        source: "test".into(),
        date: Some("2026-11-21".into()),
        pairs: 12,
        residual_nm: Some(1e-3),
        cross_validated_nm: Some(2e-3),
        range_ma: Some([20.0, 400.0]),
    }
}

fn model(curve: Curve) -> TorqueCurrentModel {
    TorqueCurrentModel::new(curve, measured(), None).unwrap()
}

fn any_curve() -> impl Strategy<Value = Curve> {
    let table = prop::collection::vec((0.5..80.0_f64, 0.002..0.08_f64), 1..9).prop_map(|steps| {
        let (mut current_ma, mut torque_nm) = (vec![7.0], vec![0.0]);
        for (i, (di, dt)) in steps.into_iter().enumerate() {
            current_ma.push(current_ma[i] + di);
            torque_nm.push(torque_nm[i] + dt);
        }
        Curve::Table { current_ma, torque_nm }
    });
    prop_oneof![
        (0.05..2.0_f64).prop_map(|kt_nm_per_a| Curve::Linear { kt_nm_per_a }),
        (0.0..60.0_f64, 0.05..2.0_f64).prop_map(|(i0_ma, k_nm_per_a)| Curve::Affine { i0_ma, k_nm_per_a }),
        (0.05..2.0_f64).prop_map(|c_nm_per_sqrt_a| Curve::Sqrt { c_nm_per_sqrt_a }),
        table,
    ]
}

proptest! {
    #[test]
    fn there_and_back_again(curve in any_curve(), share in 0.001..1.0_f64, negative: bool) {
        let model = model(curve);
        let most = model.max_torque_nm().min(0.6);
        let tau = share * most * if negative { -1.0 } else { 1.0 };
        let current = model.current_ma(tau).unwrap();
        prop_assert_eq!(current < 0.0, negative);
        let back = model.torque_nm(current).unwrap();
        prop_assert!((back - tau).abs() <= 1e-9 * tau.abs(), "{} from {} mA, not {}", back, current, tau);
        let again = model.current_ma(back).unwrap();
        prop_assert!((again - current).abs() <= 1e-9 * current.abs());
    }

    #[test]
    fn more_current_is_never_less_torque(curve in any_curve(), a in 0.0..1.0_f64, b in 0.0..1.0_f64) {
        let model = model(curve);
        let most = model.max_current_ma().min(900.0);
        let (low, high) = (a.min(b) * most, a.max(b) * most);
        prop_assert!(model.torque_nm(low).unwrap() <= model.torque_nm(high).unwrap());
    }

    /// Pairs with 1.5 % of noise on a model of each closed form: the fit inverts within 2 % where it was measured.
    #[test]
    fn a_fit_inverts_within_two_percent(which in 0..3_usize, noise in prop::collection::vec(-1.0..1.0_f64, 60)) {
        let truth = model([
            Curve::Linear { kt_nm_per_a: 0.52 },
            Curve::Affine { i0_ma: 16.1, k_nm_per_a: 0.45 },
            Curve::Sqrt { c_nm_per_sqrt_a: 0.69 },
        ][which].clone());
        let samples: Vec<Sample> = noise
            .iter()
            .enumerate()
            .map(|(k, e)| {
                let current = 40.0 + 6.0 * k as f64;
                Sample::from_force(current, truth.torque_nm(current).unwrap() * (1.0 + 0.015 * e) / 0.04, 0.04)
            })
            .collect();
        let fitted = fit(&samples, "synthetic", "2026-11-21").unwrap();
        for current in [80.0, 150.0, 250.0, 350.0] {
            let tau = truth.torque_nm(current).unwrap();
            let back = truth.torque_nm(fitted.current_ma(tau).unwrap()).unwrap();
            prop_assert!((back - tau).abs() <= 0.02 * tau, "{:?}: {} instead of {} N m", fitted.curve(), back, tau);
        }
        prop_assert_eq!(fitted.provenance().pairs, 60);
        prop_assert!(fitted.is_calibrated());
    }

    #[test]
    fn nothing_panics(pairs in prop::collection::vec((prop::num::f64::ANY, prop::num::f64::ANY), 0..24)) {
        let samples: Vec<Sample> = pairs.iter().map(|(i, t)| Sample::from_torque(*i, *t)).collect();
        if let Ok(model) = fit(&samples, "noise", "") {
            prop_assert!(model.current_ma(0.01).is_ok_and(f64::is_finite) || model.max_torque_nm() < 0.01);
        }
    }
}

fn pairs(n: usize, torque: impl Fn(f64) -> f64) -> Vec<Sample> {
    (1..=n).map(|k| 400.0 * k as f64 / n as f64).map(|i| Sample::from_torque(i, torque(i))).collect()
}

#[test]
fn the_shape_is_found() {
    let shape = |f: &dyn Fn(f64) -> f64| fit(&pairs(40, f), "exact", "2026-11-21").unwrap().curve().clone();
    assert!(matches!(shape(&|i| 5e-4 * i), Curve::Linear { kt_nm_per_a } if (kt_nm_per_a - 0.5).abs() < 1e-9));
    assert!(matches!(shape(&|i| 0.02 * i.sqrt()), Curve::Sqrt { .. }));
    let affine = shape(&|i| (4e-4 * (i - 31.0)).max(0.0));
    assert!(
        matches!(affine, Curve::Affine { i0_ma, k_nm_per_a } if (i0_ma - 31.0).abs() < 1e-6 && (k_nm_per_a - 0.4).abs() < 1e-9),
        "{affine:?}"
    );
    // Two straight pieces, steep then shallow: none of the closed forms.
    let bent = shape(&|i| if i < 120.0 { 1e-3 * i } else { 0.12 + 1e-4 * (i - 120.0) });
    assert!(matches!(bent, Curve::Table { .. }), "{bent:?}");
}

#[test]
fn negative_currents_count_as_positive_ones() {
    let mirrored: Vec<Sample> = pairs(20, |i| 5e-4 * i)
        .into_iter()
        .enumerate()
        .map(|(k, s)| if k % 2 == 0 { s } else { Sample::from_torque(-s.current_ma, -s.torque_nm) })
        .collect();
    let model = fit(&mirrored, "both ways", "2026-11-21").unwrap();
    assert!((model.torque_nm(-200.0).unwrap() + 0.1).abs() < 1e-9);
}

#[test]
fn hysteresis_is_measured_and_kept_out_of_the_law() {
    let mut samples = Vec::new();
    for k in 1..=30 {
        let i = 12.0 * f64::from(k);
        let tau = 5e-4 * i;
        let half = 0.004 + 0.1 * tau;
        samples.push(Sample::from_torque(i, tau - half).with_approach(Approach::Loading));
        if k % 3 == 0 {
            samples.push(Sample::from_torque(i, tau + half).with_approach(Approach::Unloading));
        }
    }
    let model = fit(&samples, "up and down", "2026-11-21").unwrap();
    let tau = model.torque_nm(240.0).unwrap();
    assert!((tau - 0.12).abs() < 0.02 * 0.12, "{tau} from {:?}", model.curve());
    let half = model.hysteresis().unwrap().half_width_nm(0.12);
    assert!((half - 0.016).abs() < 0.003, "{half}");
    assert!(model.provenance().residual_nm.unwrap() < 0.004);
}

#[test]
fn nonsense_is_refused_by_name() {
    let refuse = |samples: &[Sample]| fit(samples, "nonsense", "2026-11-21").unwrap_err();
    assert!(matches!(refuse(&pairs(5, |i| i)), Error::TooFewPairs { have: 5, distinct: 5, need: 6 }));
    let same: Vec<Sample> = (0..30).map(|k| Sample::from_torque(100.0, 0.05 + 1e-4 * f64::from(k))).collect();
    assert!(matches!(refuse(&same), Error::TooFewPairs { have: 30, distinct: 1, .. }));
    assert!(matches!(refuse(&pairs(20, |i| 0.3 - 5e-4 * i)), Error::NotMonotone { .. }));
    assert!(matches!(refuse(&pairs(20, |_| 0.0)), Error::NotMonotone { .. }));
    let mut with_nan = pairs(20, |i| 5e-4 * i);
    with_nan[3].torque_nm = f64::NAN;
    assert!(matches!(refuse(&with_nan), Error::Value { .. }));
    // Rising on the whole, but mostly scatter.
    let scattered = pairs(40, |i| 1e-4 * i + 0.02 * (i * 12.9898).sin());
    assert!(matches!(refuse(&scattered), Error::Value { .. } | Error::NotMonotone { .. }));
}

#[test]
fn curves_that_cannot_be_inverted_are_refused() {
    let refuse = |curve| TorqueCurrentModel::new(curve, measured(), None).unwrap_err();
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(refuse(Curve::Linear { kt_nm_per_a: bad }), Error::Value { .. }));
        assert!(matches!(refuse(Curve::Sqrt { c_nm_per_sqrt_a: bad }), Error::Value { .. }));
        assert!(matches!(refuse(Curve::Affine { i0_ma: 10.0, k_nm_per_a: bad }), Error::Value { .. }));
    }
    assert!(matches!(refuse(Curve::Affine { i0_ma: -1.0, k_nm_per_a: 0.4 }), Error::Value { .. }));
    let flat = Curve::Table { current_ma: vec![0.0, 10.0, 20.0], torque_nm: vec![0.0, 0.1, 0.1] };
    assert!(matches!(refuse(flat), Error::NotMonotone { .. }));
    let short = Curve::Table { current_ma: vec![0.0], torque_nm: vec![0.0] };
    assert!(matches!(refuse(short), Error::Value { .. }));
}

#[test]
fn nothing_is_said_beyond_the_end_of_a_table() {
    let model = model(Curve::Table { current_ma: vec![10.0, 110.0], torque_nm: vec![0.0, 0.05] });
    assert!(matches!(model.current_ma(0.06), Err(Error::OutOfRange { .. })));
    assert!(matches!(model.torque_nm(-111.0), Err(Error::OutOfRange { .. })));
    assert!(matches!(model.torque_nm(f64::NAN), Err(Error::Value { .. })));
    assert!(matches!(model.current_ma(f64::INFINITY), Err(Error::Value { .. })));
    assert_eq!(model.torque_nm(5.0).unwrap(), 0.0);
}

#[test]
fn files_come_back_and_strangers_do_not() {
    let model = model(Curve::Affine { i0_ma: 16.1, k_nm_per_a: 0.45 });
    let text = serde_json::to_string(&model).unwrap();
    assert_eq!(serde_json::from_str::<TorqueCurrentModel>(&text).unwrap(), model);
    for (from, to) in
        [("\"version\":1", "\"version\":2"), ("\"version\":1", "\"version\":1,\"x\":0"), ("0.45", "-0.45")]
    {
        let bent = text.replace(from, to);
        assert_ne!(bent, text);
        assert!(serde_json::from_str::<TorqueCurrentModel>(&bent).is_err(), "{bent}");
    }
}

#[test]
fn nominal_laws_say_that_they_are_not_calibrated() {
    let all = [
        (Nominal::Xc330Linear, 0.181),
        (Nominal::Xc330Affine, 0.150),
        (Nominal::Xc330Sqrt, 0.410),
        (Nominal::Xl330Linear, 0.124),
        (Nominal::Xl330Sqrt, 0.254),
        (Nominal::LeapSimulation, 0.1855),
        (Nominal::AllegroV5, 0.245),
    ];
    for (which, at_350_ma) in all {
        let model = TorqueCurrentModel::nominal(which).unwrap();
        assert!(!model.is_calibrated() && model.provenance().source.starts_with("nominal, not calibrated"));
        let tau = model.torque_nm(350.0).unwrap();
        assert!((tau - at_350_ma).abs() < 0.005 * at_350_ma, "{which:?}: {tau} N m");
    }
}
