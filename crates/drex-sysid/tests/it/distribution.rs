//! Distributions of a mass against closed forms.

use drex_sysid::MassDistribution;
use proptest::prelude::*;

/// A likelihood that is a normal law of ln m, in `steps` even steps over five standard deviations on either side.
fn on_a_grid(median_kg: f64, sd_log: f64, steps: usize) -> MassDistribution {
    let point = |k: usize| {
        let z = -5.0 + 10.0 * k as f64 / steps as f64;
        (median_kg * (sd_log * z).exp(), 0.5 * z * z)
    };
    MassDistribution::from_costs(&(0..=steps).map(point).collect::<Vec<_>>()).unwrap()
}

fn quantiles(d: &MassDistribution) -> Vec<f64> {
    (0..=100).map(|k| d.quantile_kg(f64::from(k) / 100.0)).collect()
}

/// Largest difference of ln m between quantiles from 2 % to 98 %, over the standard deviation.
fn apart(a: &MassDistribution, b: &MassDistribution) -> f64 {
    let pairs = quantiles(a).into_iter().zip(quantiles(b)).skip(2).take(97);
    pairs.map(|(a, b)| (a / b).ln().abs()).fold(0.0, f64::max) / b.sd_log()
}

proptest! {
    #[test]
    fn two_normal_laws_multiply_to_the_one_of_the_closed_form(
        m1 in 0.01..2.0_f64, s1 in 0.01..1.0_f64, s2 in 0.01..1.0_f64, z in -4.0..4.0_f64,
    ) {
        let m2 = m1 * (z * s1.hypot(s2)).exp();
        let (a, b) = (MassDistribution::log_normal(m1, s1).unwrap(), MassDistribution::log_normal(m2, s2).unwrap());
        let (w1, w2) = (s1.powi(-2), s2.powi(-2));
        let sd = (w1 + w2).sqrt().recip();
        let mean = (w1 * m1.ln() + w2 * m2.ln()) / (w1 + w2);
        let product = a.times(&b);
        prop_assert!(apart(&product, &MassDistribution::log_normal(mean.exp(), sd).unwrap()) < 0.01);
        prop_assert!((product.sd_log() / sd - 1.0).abs() < 0.01, "{} {sd}", product.sd_log());
        prop_assert!((product.median_kg().ln() - mean).abs() < 0.01 * sd);
        // Their distance in the prior predictive's standard deviations.
        prop_assert!((a.contradiction_sd(&b) - z.abs()).abs() < 0.06, "{} {z}", a.contradiction_sd(&b));
    }

    #[test]
    fn the_order_of_factors_does_not_matter(m in 0.05..1.0_f64, s in 0.05..1.0_f64, t in 0.05..1.0_f64) {
        let a = MassDistribution::log_normal(0.3, t).unwrap();
        let (b, c) = (on_a_grid(m, s, 70), MassDistribution::log_normal(2.0 * m, 0.5).unwrap());
        prop_assert_eq!(a.times(&b), b.times(&a));
        prop_assert!(apart(&a.times(&b).times(&c), &a.times(&b.times(&c))) < 1e-3);
    }

    #[test]
    fn the_grid_of_a_likelihood_does_not_matter(m in 0.05..1.0_f64, s in 0.05..1.0_f64) {
        let prior = MassDistribution::log_normal(0.5, 2.0_f64.ln()).unwrap();
        let (coarse, fine) = (prior.times(&on_a_grid(m, s, 80)), prior.times(&on_a_grid(m, s, 1000)));
        prop_assert!(apart(&coarse, &fine) < 0.01, "{}", apart(&coarse, &fine));
        // Nor does a constant that is added to its costs.
        let raised: Vec<(f64, f64)> = on_a_grid(m, s, 80).costs().map(|(m, c)| (m, c + 7.0)).collect();
        let raised = prior.times(&MassDistribution::from_costs(&raised).unwrap());
        prop_assert!(apart(&raised, &coarse) < 1e-9);
    }

    #[test]
    fn a_flat_likelihood_returns_the_prior(m in 0.05..1.0_f64, s in 0.01..1.0_f64, cost in -3.0..3.0_f64) {
        let prior = MassDistribution::log_normal(m, s).unwrap();
        // Also where it says nothing of masses that the prior allows.
        for range in [[1e-6, 1e3], [0.1, 0.2]] {
            let flat = MassDistribution::from_costs(&range.map(|m| (m, cost))).unwrap();
            prop_assert_eq!(flat.bounds_kg(), [None, None]);
            prop_assert!(apart(&prior.times(&flat), &prior) < 1e-6);
            prop_assert!(prior.contradiction_sd(&flat) < 1e-5);
        }
    }

    #[test]
    fn quantiles_increase_and_samples_follow_them(
        costs in proptest::collection::vec(0.0..80.0_f64, 2..40), seed in 0..1000_u64,
    ) {
        let points: Vec<(f64, f64)> = costs.iter().enumerate().map(|(k, c)| (0.01 * 1.2_f64.powi(k as i32), *c)).collect();
        let d = MassDistribution::from_costs(&points).unwrap();
        let q = quantiles(&d);
        prop_assert!(q.is_sorted() && q.iter().all(|m| m.is_finite() && *m > 0.0), "{q:?}");
        prop_assert!(d.interval95_kg()[0] <= d.median_kg() && d.median_kg() <= d.interval95_kg()[1]);
        prop_assert!(d.sd_log() > 0.0 && d.sd_kg() > 0.0 && q[0] < d.mean_kg() && d.mean_kg() < q[100]);
        let drawn = d.sample_kg(400, seed);
        prop_assert!(drawn == d.sample_kg(400, seed) && drawn[..7] == d.sample_kg(7, seed)[..]);
        let below = drawn.iter().filter(|m| **m < d.median_kg()).count();
        prop_assert!((120..280).contains(&below), "{below} of 400 below the median");
    }
}

#[test]
fn moments_are_those_of_the_lognormal_law() {
    let (m, s) = (0.2, 0.4_f64);
    let d = MassDistribution::log_normal(m, s).unwrap();
    let mean = m * (0.5 * s * s).exp();
    assert!((d.mean_kg() / mean - 1.0).abs() < 1e-3, "{}", d.mean_kg());
    assert!((d.sd_kg() / (mean * ((s * s).exp() - 1.0).sqrt()) - 1.0).abs() < 5e-3, "{}", d.sd_kg());
    assert!((d.sd_log() / s - 1.0).abs() < 1e-3, "{}", d.sd_log());
    // An even density whose knots are uneven: (b - a) / sqrt 12.
    let even = MassDistribution::from_costs(&[0.0, 1.0, 4.0].map(|x: f64| (x.exp(), 3.0))).unwrap();
    assert!((even.sd_log() - 4.0 / 12.0_f64.sqrt()).abs() < 1e-9, "{}", even.sd_log());
    // A density that falls as an exponential law of ln m does, cut after 30 of its standard deviations: mean and deviation are one.
    let falling = MassDistribution::from_costs(&[(1.0, 0.0), (30.0_f64.exp(), 30.0)]).unwrap();
    assert!((falling.sd_log() - 1.0).abs() < 1e-6 && (falling.quantile_kg(0.5).ln() - 2.0_f64.ln()).abs() < 1e-6);
    for (p, z) in [(0.025, -1.95996), (0.16, -0.99446), (0.5, 0.0), (0.95, 1.64485)] {
        assert!(((d.quantile_kg(p) / m).ln() / s - z).abs() < 2e-3, "{p}");
    }
}

#[test]
fn a_bound_from_above_contradicts_by_the_share_of_the_prior_that_it_allows() {
    let above: Vec<(f64, f64)> = vec![(0.005, 0.0), (0.1, 0.0), (0.1001, 50.0), (5.0, 60.0)];
    let above = MassDistribution::from_costs(&above).unwrap();
    assert!(above.bounds_kg()[0].is_none() && above.bounds_kg()[1].unwrap() <= 0.1001);
    // A tenth of this prior is below 100 g.
    let prior = MassDistribution::log_normal(0.1 * (1.281_55 * 0.5_f64).exp(), 0.5).unwrap();
    let expected = (-2.0 * 0.1_f64.ln()).sqrt();
    assert!((prior.contradiction_sd(&above) - expected).abs() < 0.01, "{}", prior.contradiction_sd(&above));
    let light = MassDistribution::log_normal(0.02, 0.3).unwrap();
    assert!(light.contradiction_sd(&above) < 1e-2, "a light object is within the bound");
    // What is left is within the bound.
    let both = prior.times(&above);
    assert!(both.quantile_kg(0.999) < 0.101 && both.median_kg() > 0.05, "{:?}", both.interval95_kg());
}

#[test]
fn a_file_gives_the_same_distribution_and_nonsense_is_refused() {
    let d = MassDistribution::log_normal(0.2, 0.3).unwrap().times(&on_a_grid(0.3, 0.5, 80));
    let again: MassDistribution = serde_json::from_str(&serde_json::to_string(&d).unwrap()).unwrap();
    assert!(apart(&again, &d) < 1e-9);
    for text in [
        r#"{"mass_kg": [0.1], "cost": [0.0]}"#,
        r#"{"mass_kg": [0.1, 0.2], "cost": [0.0]}"#,
        r#"{"mass_kg": [0.2, 0.1], "cost": [0.0, 1.0]}"#,
        r#"{"mass_kg": [0.1, 0.1, 0.2], "cost": [0.0, 1.0, 2.0]}"#,
        r#"{"mass_kg": [0.1, 0.2], "cost": [0.0, 1e13]}"#,
        r#"{"mass_kg": [-0.1, 0.1], "cost": [0.0, 1.0]}"#,
        r#"{"mass_kg": [0.1, 0.2], "cost": [0.0, 1e999]}"#,
        r#"{"mass_kg": [0.1, 0.10000000000000002], "cost": [0.0, 1.0]}"#,
    ] {
        assert!(serde_json::from_str::<MassDistribution>(text).is_err(), "{text}");
    }
    for (m, s) in [(0.0, 1.0), (1.0, 0.0), (f64::NAN, 1.0), (1.0, f64::INFINITY), (1.0, 1e-13), (1e300, 1.0)] {
        assert!(MassDistribution::log_normal(m, s).is_err(), "{m} kg, {s}");
    }
    // The narrowest laws, far apart: still numbers. Beyond 8 standard deviations the cost is linear: sqrt(16 ln 1.5 / 1e-6) = 2547.
    let narrow = |m: f64| MassDistribution::log_normal(m, 1e-6).unwrap();
    let (both, far) = (narrow(0.2).times(&narrow(0.3)), narrow(0.2).contradiction_sd(&narrow(0.3)));
    assert!(
        (0.19..0.31).contains(&both.median_kg()) && both.sd_kg() >= 0.0 && (2400.0..2600.0).contains(&far),
        "{far}"
    );
}
