//! Adam on the logarithm of the mass alone, from a first guess: the optimizer and the schedule of the D-REX paper (200 epochs; its
//! learning rate is not published), for comparison. The loss is the mean square of the whitened geodesic residuals, with the
//! clock and the frame of the track taken as they are. Kingma and Ba, *Adam* (ICLR 2015), algorithm 1.

use crate::Result;
use crate::joint::{Candidate, Joint, Point};
use crate::parameters::Parameter;

const EPOCHS: i32 = 200;
/// Change of the logarithm per epoch, at most about: far enough in all to cross a factor of 50.
const RATE: f64 = 0.02;
const DECAYS: (f64, f64) = (0.9, 0.999);
const TINY: f64 = 1e-8;

/// Where Adam ended.
pub(crate) struct Descent {
    pub end: Candidate,
    pub epochs: i32,
    pub first_loss: f64,
    pub loss: f64,
    /// Mass (kg) and half the sum of squares, per epoch.
    pub path: Vec<(f64, f64)>,
}

/// Descends from `guess_kg`.
///
/// # Errors
/// If a mass on the way cannot be simulated.
pub(crate) fn descend(joint: &Joint, guess_kg: f64, dt_s: f64) -> Result<Descent> {
    let mut point = joint.start();
    point[0] = guess_kg.ln();
    let (mut first, mut second) = (0.0, 0.0);
    let mut now = evaluate(joint, &point, dt_s)?;
    let first_loss = loss(&now);
    let mut path = vec![(guess_kg, now.cost)];
    for epoch in 1..=EPOCHS {
        let gradient = gradient(joint, &now, dt_s)?;
        let (a, b) = DECAYS;
        first = a * first + (1.0 - a) * gradient;
        second = b * second + (1.0 - b) * gradient * gradient;
        let (mean, square) = (first / (1.0 - a.powi(epoch)), second / (1.0 - b.powi(epoch)));
        point[0] -= RATE * mean / (square.sqrt() + TINY);
        now = evaluate(joint, &point, dt_s)?;
        path.push((point[0].exp(), now.cost));
    }
    path.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(Descent { epochs: EPOCHS, first_loss, loss: loss(&now), end: now, path })
}

/// Motions at a point, the track taken as it is.
fn evaluate(joint: &Joint, point: &Point, dt_s: f64) -> Result<Candidate> {
    let mut out = Candidate { point: point.clone(), cost: 0.0, motions: Vec::new(), fits: Vec::new() };
    for (i, problem) in joint.problems.iter().enumerate() {
        let motion = problem.simulate(&joint.values(i, point), dt_s)?;
        let fit = problem.evaluate(&motion, &problem.nuisance_mean());
        out.cost += 0.5 * fit.residuals.iter().map(|r| r * r).sum::<f64>();
        out.motions.push(motion);
        out.fits.push(fit);
    }
    Ok(out)
}

/// Mean square of the residuals.
fn loss(c: &Candidate) -> f64 {
    2.0 * c.cost / count(c)
}

/// Its derivative by the logarithm of the mass, by dual numbers.
fn gradient(joint: &Joint, c: &Candidate, dt_s: f64) -> Result<f64> {
    let mut sum = 0.0;
    for (i, (problem, fit)) in joint.problems.iter().zip(&c.fits).enumerate() {
        let slopes = problem.slopes(&joint.values(i, &c.point), &[Parameter::Mass], fit, dt_s)?;
        sum += slopes.iter().flatten().zip(&fit.residuals).map(|(s, r)| 2.0 * s * r).sum::<f64>();
    }
    Ok(sum / count(c))
}

fn count(c: &Candidate) -> f64 {
    c.fits.iter().map(|f| f.residuals.len()).sum::<usize>().max(1) as f64
}
