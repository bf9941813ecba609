//! Fit of a model to measured pairs; the shape is chosen by pairs that the fit has not seen.

use nalgebra::{DMatrix, DVector};

use super::nnls::nnls;
use super::{Curve, Hysteresis, Provenance, TorqueCurrentModel};
use crate::{Error, Result};

/// Fewest pairs, and fewest different currents among them.
const NEEDED: usize = 6;
/// A richer shape has to be better than a plainer one by this factor.
const WORTH: f64 = 1.05;
/// Share of the variance of the torques that a model has to explain on pairs it has not seen.
const EXPLAINED: f64 = 0.8;
/// No current in mA and no torque in N m is as large.
const HUGE: f64 = 1e6;
/// Kendall's τ below which pairs do not rise.
const CONCORDANCE: f64 = 0.5;

/// Whether a pair was measured while the load rose or fell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Approach {
    /// The motor was pressing harder.
    Loading,
    /// The motor was letting go.
    Unloading,
    /// Not known.
    #[default]
    Unknown,
}

/// One measured pair at standstill.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Current, mA.
    pub current_ma: f64,
    /// Torque of the joint, N m, with the sign of the current.
    pub torque_nm: f64,
    /// Which way the load went.
    pub approach: Approach,
}

impl Sample {
    /// A pair with a torque, N m.
    pub fn from_torque(current_ma: f64, torque_nm: f64) -> Self {
        Self { current_ma, torque_nm, approach: Approach::Unknown }
    }

    /// A pair with a force, N, at a lever arm, m: a scale under the finger tip.
    pub fn from_force(current_ma: f64, force_n: f64, lever_m: f64) -> Self {
        Self::from_torque(current_ma, force_n * lever_m)
    }

    /// The same, measured while the load went this way.
    pub fn with_approach(mut self, approach: Approach) -> Self {
        self.approach = approach;
        self
    }
}

/// Model through measured pairs: of the four shapes the plainest one that predicts unseen pairs as well as the best, to within 5 %.
///
/// Pairs of rising and of falling load count equally, and their difference becomes the model's hysteresis. `source` says who measured
/// what and how, `date` on which day.
///
/// # Errors
/// [`Error::Value`] for numbers that are not finite and for pairs that no model explains, [`Error::TooFewPairs`],
/// [`Error::NotMonotone`].
pub fn fit(samples: &[Sample], source: impl Into<String>, date: impl Into<String>) -> Result<TorqueCurrentModel> {
    let points = usable(samples)?;
    // The way of the load would pass for scatter and hide the shape: a first model finds it, the second is fitted without it.
    let first = Shape::Table.fit(&points).or_else(|| Shape::Affine.fit(&points));
    let hysteresis = first.as_ref().and_then(|curve| measure_hysteresis(&points, curve));
    let level = match (&first, &hysteresis) {
        (Some(curve), Some(h)) => level_out(&points, curve, h),
        _ => points.clone(),
    };
    let scored: Vec<(Shape, f64)> = Shape::ALL.iter().filter_map(|s| Some((*s, cross_validate(*s, &level)?))).collect();
    let best = scored.iter().map(|s| s.1).fold(f64::INFINITY, f64::min);
    let scale = level.iter().map(|p| p.tau.abs()).fold(0.0, f64::max);
    let chosen = scored.into_iter().find(|(_, rms)| *rms <= WORTH * best + 1e-9 * scale);
    let Some((curve, cross_validated)) = chosen.and_then(|(shape, rms)| Some((shape.fit(&level)?, rms))) else {
        return Err(Error::NotMonotone {
            what: "every model through these pairs".into(),
            remedy: "check signs and units: mA, N m".into(),
        });
    };
    let mean = level.iter().map(|p| p.tau).sum::<f64>() / level.len() as f64;
    let spread = rms(level.iter().map(|p| p.tau - mean));
    if !(cross_validated.powi(2) <= (1.0 - EXPLAINED) * spread.powi(2)) {
        return Err(Error::value(
            format!(
                "pairs that scatter by {cross_validated:.4} N m about every model, with a spread of {spread:.4} N m in all"
            ),
            "measure at standstill, over a wider range, several times",
        ));
    }
    let provenance = Provenance {
        source: source.into(),
        date: Some(date.into()),
        pairs: points.len(),
        residual_nm: Some(rms(level.iter().map(|p| p.tau - curve.torque(p.i)))),
        cross_validated_nm: Some(cross_validated),
        range_ma: points.first().zip(points.last()).map(|(a, b)| [a.i, b.i]),
    };
    TorqueCurrentModel::new(curve, provenance, hysteresis)
}

/// A pair with a current above zero, mA and N m; `way` is +1 where the load fell and −1 where it rose.
#[derive(Clone, Copy)]
struct Point {
    i: f64,
    tau: f64,
    way: f64,
    weight: f64,
}

/// Pairs with a current, by current.
fn usable(samples: &[Sample]) -> Result<Vec<Point>> {
    for s in samples {
        if !(s.current_ma.abs() < HUGE && s.torque_nm.abs() < HUGE) {
            return Err(Error::value(
                format!("a measured pair of {} mA and {} N m", s.current_ma, s.torque_nm),
                "give finite numbers in mA and N m",
            ));
        }
    }
    let count = |a| samples.iter().filter(|s| s.current_ma != 0.0 && s.approach == a).count() as f64;
    let (up, down) = (count(Approach::Loading), count(Approach::Unloading));
    let mut points: Vec<Point> = samples
        .iter()
        .filter(|s| s.current_ma != 0.0)
        .map(|s| {
            let (way, alike) = match s.approach {
                Approach::Loading => (-1.0, up),
                Approach::Unloading => (1.0, down),
                Approach::Unknown => (0.0, 0.0),
            };
            let weight = if way != 0.0 && up > 0.0 && down > 0.0 { 0.5 * (up + down) / alike } else { 1.0 };
            Point { i: s.current_ma.abs(), tau: s.torque_nm * s.current_ma.signum(), way, weight }
        })
        .collect();
    points.sort_by(|a, b| a.i.total_cmp(&b.i).then(a.tau.total_cmp(&b.tau)));
    let distinct = points.chunk_by(|a, b| a.i == b.i).count();
    if points.len() < NEEDED || distinct < NEEDED {
        return Err(Error::TooFewPairs { have: points.len(), distinct, need: NEEDED });
    }
    let concordance = concordance(&points);
    if !(concordance >= CONCORDANCE) {
        return Err(Error::NotMonotone {
            what: format!("the torque over the current (Kendall's tau {concordance:.2})"),
            remedy: "check signs and units, and that the joint stood still".into(),
        });
    }
    Ok(points)
}

/// Kendall's τ over pairs with different currents.
fn concordance(points: &[Point]) -> f64 {
    let (mut balance, mut all) = (0_i64, 0_i64);
    for (k, a) in points.iter().enumerate() {
        for b in points[k + 1..].iter().filter(|b| b.i != a.i && b.tau != a.tau) {
            balance += if b.tau > a.tau { 1 } else { -1 };
            all += 1;
        }
    }
    if all == 0 { 0.0 } else { balance as f64 / all as f64 }
}

fn measure_hysteresis(points: &[Point], curve: &Curve) -> Option<Hysteresis> {
    let of = |way: f64| {
        points.iter().filter(move |p| p.way == way).map(move |p| (curve.torque(p.i), way * (p.tau - curve.torque(p.i))))
    };
    let (up, down): (Vec<_>, Vec<_>) = (of(-1.0).collect(), of(1.0).collect());
    if up.len() < 3 || down.len() < 3 {
        return None;
    }
    Hysteresis::from_half_widths(&[up, down].concat())
}

/// The pairs as they would be half-way between rising and falling load.
fn level_out(points: &[Point], curve: &Curve, h: &Hysteresis) -> Vec<Point> {
    points.iter().map(|p| Point { tau: p.tau - p.way * h.half_width_nm(curve.torque(p.i)), ..*p }).collect()
}

/// Root mean square error of torque over ten parts, each predicted by a model through the others; `None` if one cannot be fitted.
fn cross_validate(shape: Shape, points: &[Point]) -> Option<f64> {
    let parts = points.len().min(10);
    let mut errors = Vec::with_capacity(points.len());
    for part in 0..parts {
        let (held, seen): (Vec<_>, Vec<_>) = points.iter().enumerate().partition(|(k, _)| k % parts == part);
        let seen: Vec<Point> = seen.into_iter().map(|(_, p)| *p).collect();
        let curve = shape.fit(&seen)?;
        errors.extend(held.iter().map(|(_, p)| p.tau - curve.torque(p.i)));
    }
    Some(rms(errors.into_iter()))
}

fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len().max(1) as f64;
    (values.map(|v| v * v).sum::<f64>() / n).sqrt()
}

/// Shapes from plain to rich.
#[derive(Clone, Copy)]
enum Shape {
    Linear,
    Sqrt,
    Affine,
    Table,
}

impl Shape {
    const ALL: [Self; 4] = [Self::Linear, Self::Sqrt, Self::Affine, Self::Table];

    /// Least squares; `None` where the best would not rise.
    fn fit(self, points: &[Point]) -> Option<Curve> {
        match self {
            Self::Linear => rising(slope(points, |p| p.i * 1e-3)).map(|kt_nm_per_a| Curve::Linear { kt_nm_per_a }),
            Self::Sqrt => {
                rising(slope(points, |p| (p.i * 1e-3).sqrt())).map(|c_nm_per_sqrt_a| Curve::Sqrt { c_nm_per_sqrt_a })
            }
            Self::Affine => fit_affine(points),
            Self::Table => fit_table(points),
        }
    }
}

fn rising(slope: f64) -> Option<f64> {
    (slope > 0.0 && slope.is_finite()).then_some(slope)
}

/// Slope of a line through the origin.
fn slope(points: &[Point], x: impl Fn(&Point) -> f64) -> f64 {
    let (xt, xx) =
        points.iter().fold((0.0, 0.0), |(xt, xx), p| (xt + p.weight * x(p) * p.tau, xx + p.weight * x(p) * x(p)));
    xt / xx
}

/// Where the dead band ends decides which pairs lie on the line: all places between two pairs and at a pair are tried.
fn fit_affine(points: &[Point]) -> Option<Curve> {
    let mut best: Option<(f64, Curve)> = None;
    let mut consider = |i0_ma: f64, k: f64| {
        if let Some(k_nm_per_a) = rising(k) {
            let curve = Curve::Affine { i0_ma, k_nm_per_a };
            let sse: f64 = points.iter().map(|p| p.weight * (p.tau - curve.torque(p.i)).powi(2)).sum();
            if best.as_ref().is_none_or(|b| sse < b.0) {
                best = Some((sse, curve));
            }
        }
    };
    for m in 0..points.len() - 1 {
        let (from, to) = (if m == 0 { 0.0 } else { points[m - 1].i }, points[m].i);
        let beyond = &points[m..];
        let w: f64 = beyond.iter().map(|p| p.weight).sum();
        let (mi, mt) = beyond.iter().fold((0.0, 0.0), |(i, t), p| (i + p.weight * p.i / w, t + p.weight * p.tau / w));
        let (it, ii) = beyond.iter().fold((0.0, 0.0), |(it, ii), p| {
            let d = p.i - mi;
            (it + p.weight * d * (p.tau - mt), ii + p.weight * d * d)
        });
        let k = it / ii;
        let i0 = mi - mt / k;
        if (from..=to).contains(&i0) {
            consider(i0, 1e3 * k);
        }
        consider(from, slope(beyond, |p| (p.i - from) * 1e-3));
    }
    best.map(|b| b.1)
}

/// Straight lines with slopes of zero or more between knots that have as many pairs between them; flat pieces are left out.
fn fit_table(points: &[Point]) -> Option<Curve> {
    let currents: Vec<f64> = points.chunk_by(|a, b| a.i == b.i).map(|c| c[0].i).collect();
    let pieces = (currents.len() / 4).clamp(2, 8);
    let mut knots = vec![0.0];
    knots.extend((1..=pieces).map(|k| currents[k * (currents.len() - 1) / pieces]));
    knots.dedup();
    let pieces = knots.len() - 1;
    let a = DMatrix::from_fn(points.len(), pieces, |r, k| {
        points[r].weight.sqrt() * (points[r].i - knots[k]).clamp(0.0, knots[k + 1] - knots[k])
    });
    let b = DVector::from_iterator(points.len(), points.iter().map(|p| p.weight.sqrt() * p.tau));
    let slopes = nnls(&a, &b);
    let (mut current_ma, mut torque_nm) = (vec![0.0], vec![0.0]);
    let mut tau = 0.0;
    let least = 1e-9 * b.amax();
    for k in 0..pieces {
        let rise = slopes[k] * (knots[k + 1] - knots[k]);
        if rise > least {
            tau += rise;
            current_ma.push(knots[k + 1]);
            torque_nm.push(tau);
        } else if current_ma.len() == 1 {
            current_ma[0] = knots[k + 1];
        }
    }
    (current_ma.len() > 1).then_some(Curve::Table { current_ma, torque_nm })
}
