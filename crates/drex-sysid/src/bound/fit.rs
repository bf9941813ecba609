//! The mass and what is uncertain beside it, by Gauss-Newton under priors.
//!
//! The equations are linear in 1/m, which may come out zero or negative: then the efforts show no force, and there is no upper bound.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::posterior;
use super::scene::{Row, Scene};
use crate::MassDistribution;

/// The closed-form answer and its error budget.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Bound {
    /// Whether any touch stands out of the joint friction. If none does, contact hides in friction and nothing bounds the mass.
    pub seen: bool,
    /// Fingers that push.
    pub fingers: Vec<String>,
    /// First and last touch, seconds of the joint log's clock.
    pub from_to_s: [f64; 2],
    /// Frames used, and how many of them while touched.
    pub frames: [usize; 2],
    /// ∫ M dt over the touch, N m s.
    pub impulse_nms: f64,
    /// Work of the extra torques over the touch, J.
    pub work_j: f64,
    /// 1/m with everything at its most likely value beforehand, 1/kg.
    pub closed_form_per_kg: f64,
    /// 1/m with the uncertain quantities estimated along, 1/kg.
    pub per_kg: f64,
    /// Standard deviation of that, 1/kg.
    pub sd_per_kg: f64,
    /// What standard deviation (1/kg) would be left if all but efforts and leans were known exactly.
    pub sd_of_efforts_per_kg: f64,
    /// Probability and 1/m (1/kg) of each way in which the mesh may sit in the tracked frame; the other fields but those of the
    /// mass are of the likeliest.
    pub turns: Vec<(f64, f64)>,
    /// Index of the likeliest of these in [`crate::frames::FoundFrames::turns`].
    pub turn: usize,
    /// What each uncertain quantity costs: square root of the variance that knowing it would save, 1/kg; largest first.
    pub budget: Vec<(String, f64)>,
    /// The uncertain quantities: name, value beforehand, its standard deviation, value in the fit.
    pub unknowns: Vec<(String, f64, f64, f64)>,
    /// The mass, all uncertain quantities integrated over, within [`super::BoundOptions::range_kg`]. Without a touch that stands out the
    /// lightest mass is not excluded: it is a bound from above.
    pub mass: MassDistribution,
}

impl Bound {
    /// What limits the answer, in words.
    pub fn limits(&self) -> &str {
        match self.budget.first() {
            _ if !self.seen => "no force stands out of the joint friction",
            Some(b) => b.0.as_str(),
            None => "nothing",
        }
    }
}

/// The least-squares answer of one way in which the mesh may sit, and half its sum of squares, equations and priors together.
pub(super) fn fit(scene: &Scene<'_>, range_kg: [f64; 2]) -> Option<(Bound, f64)> {
    let samples = scene.samples;
    let rows = scene.rows(&scene.values(&vec![0.0; scene.unknowns.len()]));
    let touched: Vec<&Row> = rows.iter().filter(|r| r.moment != 0.0).collect();
    if touched.len() < 3 {
        return None;
    }
    let closed = touched.iter().map(|r| r.moment * r.per_mass).sum::<f64>()
        / touched.iter().map(|r| r.moment.powi(2)).sum::<f64>().max(1e-300);
    let n = scene.unknowns.len() + 1;
    let (mut per_kg, mut u) = (closed, vec![0.0; n - 1]);
    let (mut normal, mut misfit) = (DMatrix::zeros(n, n), f64::INFINITY);
    // Variance added to equations that miss by more than two standard deviations (a knock, a slip, a jump of the tracker).
    let mut added = vec![0.0; rows.len()];
    for round in 0..90 {
        let (jacobian, residual) = scene.linearised(per_kg, &u, &added)?;
        normal = jacobian.transpose() * &jacobian;
        misfit = 0.5 * residual.norm_squared();
        let step = normal.clone().try_inverse()? * (jacobian.transpose() * &residual);
        // A step beyond half a standard deviation leaves the range in which the model is straight.
        let longest = step.iter().skip(1).fold(1.0, |m: f64, s| m.max(2.0 * s.abs()));
        per_kg -= step[0] / longest;
        for (u, s) in u.iter_mut().zip(step.iter().skip(1)) {
            *u -= s / longest;
        }
        let settled = longest == 1.0 && step.norm() < 1e-6;
        if round % 20 == 19 || settled {
            let before = added.clone();
            scene.forgive(per_kg, &u, &mut added)?;
            if settled && added.iter().zip(&before).all(|(a, b)| (a - b).abs() <= 1e-3 * a.abs()) {
                break;
            }
        }
    }
    let variance = |known: &dyn Fn(usize) -> bool| -> Option<f64> {
        let keep: Vec<usize> = (0..n).filter(|&i| i == 0 || !known(i - 1)).collect();
        let part = DMatrix::from_fn(keep.len(), keep.len(), |i, j| normal[(keep[i], keep[j])]);
        Some(part.try_inverse()?[(0, 0)])
    };
    let total = variance(&|_| false)?;
    let mut budget: Vec<(String, f64)> = Vec::new();
    for (k, u) in scene.unknowns.iter().enumerate() {
        budget.push((u.name.clone(), (total - variance(&|i| i == k)?).max(0.0).sqrt()));
    }
    budget.sort_by(|a, b| b.1.total_cmp(&a.1));
    let efforts = variance(&|i| !scene.unknowns[i].effort)?;
    // Where the equations fit worse than their noise, the answer is that much less sure.
    let worse = (2.0 * misfit / rows.len() as f64).sqrt().max(1.0);
    let sd_per_kg = total.sqrt() * worse;
    let touch = |k: usize| samples.pushers.iter().map(move |p| p.touch_s[k]);
    let values = scene.values(&u);
    let bound = Bound {
        seen: samples.seen,
        fingers: samples.pushers.iter().map(|p| p.name.clone()).collect(),
        from_to_s: [touch(0).fold(f64::INFINITY, f64::min), touch(1).fold(f64::NEG_INFINITY, f64::max)],
        frames: [rows.len(), touched.len()],
        impulse_nms: scene.impulse(&scene.values(&vec![0.0; n - 1])),
        work_j: samples.pushers.iter().map(|p| p.work_j).sum(),
        closed_form_per_kg: closed,
        per_kg,
        sd_per_kg,
        sd_of_efforts_per_kg: efforts.sqrt() * worse,
        turns: Vec::new(),
        turn: 0,
        budget,
        unknowns: scene.unknowns.iter().zip(&values).map(|(u, v)| (u.name.clone(), u.mean, u.sd, *v)).collect(),
        mass: posterior::mixture(&[(1.0, posterior::normal(per_kg, sd_per_kg, range_kg))])?,
    };
    Some((bound, misfit))
}
