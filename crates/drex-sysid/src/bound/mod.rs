//! What joint efforts can tell about the mass of an object that a hand topples: a closed form and its error budget.
//!
//! While the object tips about the edge of its foot, friction at the edge has no moment about it. With the lean θ, the way c
//! from below the centre of mass to the edge, the height H of the centre of mass and the inertia J about the edge per unit mass,
//!
//! M(t) = m [g (c cos θ − H sin θ) + J θ̈],
//!
//! where M is the moment of the fingertips about the edge, Σ Fₙ (h + f d): normal forces from the extra joint torques at heights
//! h, friction f Fₙ along the face at the distance d from the edge. Linear in m: no simulation is needed, and the answer is
//! as good as M. What is known to within an error (gain and offset of the torques, height of the hand, clock, foot, centre of
//! mass, tip friction, tracked lean) is estimated along with m under its prior; [`Bound::budget`] says what each costs.

mod fit;
mod moments;
mod posterior;
mod scene;

use drex_core::{Pose, Trajectory};
use drex_robot::Robot;

use crate::calibrate::{ExtraTorque, Touch};
use crate::frames::{FoundFrames, HandPlacement, Standing};
use crate::{MassDistribution, Result, SysidError};
pub use fit::Bound;
use posterior::Profile;
use scene::Scene;

/// What [`of_topple`] needs of a run.
#[derive(Debug, Clone, Copy)]
pub struct Topple<'a> {
    /// The robot whose log it is.
    pub robot: &'a Robot,
    /// Stated pose of its base in the world (z up).
    pub world_from_base: &'a Pose,
    /// Stated height of the table there, metres.
    pub table_height_m: f64,
    /// Extra joint torques of the run.
    pub extra: &'a ExtraTorque,
    /// Touches found in them; without any, the fingers that move are taken to push.
    pub touches: &'a [Touch],
    /// Track of the object.
    pub track: &'a Trajectory,
    /// The object.
    pub solid: &'a Standing,
    /// Its frames.
    pub found: &'a FoundFrames,
    /// The hand against these, where it could be placed.
    pub placement: Option<&'a HandPlacement>,
    /// Size of gravity, m/s².
    pub gravity_m_s2: f64,
}

/// Standard deviations of what is not measured.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct BoundOptions {
    /// Of the height of the centre of mass against that of a uniform solid, as a fraction.
    pub density_sd: f64,
    /// Of the way to the edge of the foot, as a fraction, besides what the mesh leaves open.
    pub foot_sd: f64,
    /// Of tip friction over normal force.
    pub tip_friction_sd: f64,
    /// Of the tracked lean, as a fraction.
    pub lean_sd: f64,
    /// The lightest and the heaviest mass that is thought of, kg.
    pub range_kg: [f64; 2],
}

impl Default for BoundOptions {
    fn default() -> Self {
        Self { density_sd: 0.1, foot_sd: 0.15, tip_friction_sd: 0.2, lean_sd: 0.08, range_kg: [0.005, 5.0] }
    }
}

/// The closed-form mass of a toppled object, and how well it can be known from these efforts.
///
/// # Errors
/// If the object does not topple, or no finger moves while it does.
pub fn of_topple(run: &Topple<'_>, options: &BoundOptions) -> Result<Bound> {
    let refuse = |what: &str, remedy: &str| SysidError::Frames { what: what.into(), remedy: remedy.into() };
    let samples = moments::samples(run)
        .ok_or_else(|| refuse("the object does not lean while a finger moves", "push higher, so that it tips"))?;
    // How the mesh sits in the tracked frame decides about the foot; the fall tells more about it than the pictures.
    let mut fits = Vec::new();
    for (index, turn) in run.found.turns.iter().enumerate() {
        let mut found = run.found.clone();
        (found.tracked_from_mesh, found.up_in_mesh) = (turn.tracked_from_mesh, turn.up_in_mesh);
        let Some(scene) = Scene::of(&Topple { found: &found, ..*run }, &samples, options) else { continue };
        let Some((bound, misfit)) = fit::fit(&scene, options.range_kg) else { continue };
        let profile = if samples.seen { None } else { posterior::profile(&scene, options.range_kg) };
        fits.push((misfit - turn.odds.ln(), turn.odds, Bound { turn: index, ..bound }, profile));
    }
    combine(fits, options.range_kg).ok_or_else(|| {
        refuse(
            "fewer than three frames at which the object leans and a finger pushes",
            "push more slowly, so that it tips",
        )
    })
}

/// The likeliest fit, as unsure as all of them together. Each comes with its cost, its odds beforehand and, where no touch
/// stands out, with the profile of its masses.
fn combine(mut fits: Vec<(f64, f64, Bound, Option<Profile>)>, range_kg: [f64; 2]) -> Option<Bound> {
    fits.sort_by(|a, b| a.0.total_cmp(&b.0));
    let least = fits.first()?.0;
    let weights: Vec<f64> = fits.iter().map(|f| (least - f.0).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let weighted =
        |value: &dyn Fn(&Bound) -> f64| fits.iter().zip(&weights).map(|(f, w)| w * value(&f.2)).sum::<f64>() / sum;
    let per_kg = weighted(&|b| b.per_kg);
    let sd_per_kg = weighted(&|b| b.sd_per_kg.powi(2) + (b.per_kg - per_kg).powi(2)).sqrt();
    let turns = fits.iter().zip(&weights).map(|(f, w)| (w / sum, f.2.per_kg)).collect();
    let unseen: Vec<(f64, Profile)> = fits.iter_mut().filter_map(|f| Some((f.1, f.3.take()?))).collect();
    let of_all = if unseen.is_empty() { vec![(1.0, posterior::normal(per_kg, sd_per_kg, range_kg))] } else { unseen };
    let mass = posterior::mixture(&of_all)?;
    Some(Bound { per_kg, sd_per_kg, turns, mass, ..fits.swap_remove(0).2 })
}

/// The mass from several topples of one object by one hand.
///
/// Errors that all of them share (load factor, edge of the foot, centre of mass, friction of the tips) do not average out: with
/// the mean share ρ of these in the variance, n topples count as n / (1 + (n − 1) ρ). `None` without any.
pub(crate) fn together(bounds: &[&Bound]) -> Option<MassDistribution> {
    let share = |b: &Bound| {
        let common: f64 =
            b.budget.iter().filter(|(name, _)| scene::COMMON.contains(&name.as_str())).map(|x| x.1.powi(2)).sum();
        if b.seen { (common / b.sd_per_kg.powi(2)).min(1.0) } else { 1.0 }
    };
    let n = bounds.len() as f64;
    let rho = bounds.iter().map(|b| share(b)).sum::<f64>() / n;
    let all = bounds.iter().map(|b| b.mass.clone()).reduce(|a, b| a.times(&b))?;
    let costs: Vec<(f64, f64)> = all.costs().map(|(m, cost)| (m, cost / (1.0 + (n - 1.0) * rho))).collect();
    MassDistribution::from_costs(&costs).ok()
}
