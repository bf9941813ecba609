//! What a rehearsed push would tell about the mass.

use drex_recording::PushRecording;
use rayon::prelude::*;

use super::rehearse::{Rehearsal, Stage};
use super::{GuardedPush, PlannedOutcome, PlannedPush, PushDrive, PushKind, words};
use crate::ensemble::{Steps, UNKNOWN};
use crate::identify::{SD_LIMIT, SD_PRODUCT_LIMIT};
use crate::joint::Joint;
use crate::problem::Problem;
use crate::{Result, Verdict};

/// An object that goes this much farther than its lean explains slides, metres.
const SLIPPED_M: f64 = 0.02;
/// An object that moves and leans less than this does not move: a fraction of what it was to.
const MOVED: f64 = 0.1;

/// What a recording tells about a logarithm of a mass.
#[derive(Debug, Clone, Copy)]
struct Worth {
    /// Noise of poses and encoder.
    poses: f64,
    /// Noise of the force.
    force: f64,
    /// Contact and whatever else two correct simulators disagree about.
    model: f64,
    product: Option<f64>,
}

impl Worth {
    fn noise(&self) -> f64 {
        self.poses.hypot(self.force)
    }

    fn all(&self) -> f64 {
        self.noise().hypot(self.model)
    }

    fn verdict(&self) -> Verdict {
        match self.product {
            _ if self.all() < SD_LIMIT => Verdict::Identified,
            Some(product) if product < SD_PRODUCT_LIMIT => Verdict::OnlyMuM,
            _ => Verdict::NotIdentifiable,
        }
    }
}

impl Stage<'_> {
    /// Does a push with every mass and says what it would tell.
    pub(super) fn judge(&self, push: GuardedPush, masses_kg: &[f64]) -> Result<PlannedPush> {
        let outcomes = match push.drive {
            PushDrive::Force => self.scaled(&push, masses_kg)?,
            PushDrive::Finger => masses_kg.par_iter().map(|&m| self.outcome(&push, m)).collect::<Result<_>>()?,
        };
        // What is known beforehand: the logarithm is somewhere in the range.
        let width = masses_kg.last().zip(masses_kg.first()).map_or(0.0, |(hi, lo)| (hi / lo).ln());
        let prior = (width / 12.0_f64.sqrt()).max(1e-3);
        let left = |o: &PlannedOutcome| match o.sd_log_mass.filter(|_| o.verdict == Verdict::Identified) {
            Some(sd) => sd / (sd / prior).hypot(1.0),
            None => prior,
        };
        let sd = outcomes.iter().map(left).sum::<f64>() / outcomes.len().max(1) as f64;
        let done: Vec<&PlannedOutcome> = outcomes.iter().filter(|o| o.refused.is_none()).collect();
        let count = |v: Verdict| done.iter().filter(|o| o.verdict == v).count();
        let verdict = [Verdict::NotIdentifiable, Verdict::OnlyMuM, Verdict::Identified]
            .into_iter()
            .max_by_key(|v| count(*v))
            .filter(|_| !done.is_empty())
            .unwrap_or(Verdict::NotIdentifiable);
        let refused = match done.is_empty() {
            true => outcomes.get(outcomes.len() / 2).and_then(|o| o.refused.clone()),
            false => None,
        };
        let half_width = words::half_width(sd);
        let text = words::text(&push, &outcomes, verdict);
        let why = words::why(&push, self, verdict);
        Ok(PlannedPush { text, why, verdict, half_width, refused, push, outcomes })
    }

    /// Under a known force, one mass stands for all: the middle one, or the next lighter one that the force can move. It is
    /// met by the force as soon as the lightest one would be, which spares the wait.
    fn scaled(&self, push: &GuardedPush, masses_kg: &[f64]) -> Result<Vec<PlannedOutcome>> {
        let Some(&lightest_kg) = masses_kg.first() else { return Ok(Vec::new()) };
        let mut model_kg = lightest_kg;
        let mut done = None;
        for &mass_kg in masses_kg[..masses_kg.len().div_ceil(2)].iter().rev() {
            let first_force_n = push.first_force_n.map(|f| f * mass_kg / lightest_kg);
            let run = self.rehearse(&GuardedPush { first_force_n, ..push.clone() }, mass_kg)?;
            model_kg = mass_kg;
            let reached = run.reached;
            done = Some(run);
            if reached {
                break;
            }
        }
        let Some(run) = done else { return Ok(Vec::new()) };
        let worth = self.worth_if_done(push, model_kg, &run)?;
        let of = |&mass_kg: &f64| {
            let factor = mass_kg / model_kg;
            let peak_force_n = run.peak_force_n * factor;
            let beyond = run.reached && peak_force_n > self.limit(push);
            let refused = self.refused(push, &run).or_else(|| beyond.then(|| words::too_weak(self.limit(push))));
            let wait_s = push.doubling_s.unwrap_or(0.0) * (mass_kg / lightest_kg).log2();
            // Of the force's noise, what counts is its ratio to the force.
            let worth = worth.map(|w| Worth { force: w.force / factor, ..w });
            let done = Done { peak_force_n, seconds: run.seconds + wait_s, ..Done::of(&run) };
            outcome(mass_kg, done, worth, refused)
        };
        Ok(masses_kg.iter().map(of).collect())
    }

    fn outcome(&self, push: &GuardedPush, mass_kg: f64) -> Result<PlannedOutcome> {
        let run = self.rehearse(push, mass_kg)?;
        let worth = self.worth_if_done(push, mass_kg, &run)?;
        Ok(outcome(mass_kg, Done::of(&run), worth, self.refused(push, &run)))
    }

    fn worth_if_done(&self, push: &GuardedPush, mass_kg: f64, run: &Rehearsal) -> Result<Option<Worth>> {
        match self.refused(push, run) {
            Some(_) => Ok(None),
            None => self.worth(push.kind, &run.recording, mass_kg).map(Some),
        }
    }

    /// Why a push is not to be done, from what it did.
    fn refused(&self, push: &GuardedPush, run: &Rehearsal) -> Option<String> {
        let moved = run.travel_m / push.until_travel_m.unwrap_or(SLIPPED_M);
        let tipping = matches!(push.kind, PushKind::Tilt | PushKind::Topple | PushKind::OverhangPress);
        if tipping && run.travel_m > SLIPPED_M + run.tilt * self.object.size_m() {
            return Some(words::slides(self.friction()));
        }
        if run.reached {
            let tilt = run.tilt > self.options.largest_tilt_rad && push.kind != PushKind::Topple;
            return tilt.then(|| words::falls(run.tilt));
        }
        let tips = run.tilt > self.options.largest_tilt_rad;
        Some(match moved < MOVED && run.peak_force_n < 0.9 * self.limit(push) {
            _ if tips => words::falls(run.tilt),
            true => words::unmoved(),
            false => words::too_weak(self.limit(push)),
        })
    }

    fn worth(&self, kind: PushKind, recording: &PushRecording, mass_kg: f64) -> Result<Worth> {
        let options = self.identify_options();
        // The noise of a force is found in the record, so there must be some.
        let recording = self.with_noisy_force(recording.clone(), options.seed);
        let noise = self.options.noise;
        let problem = Problem::new(&recording, self.object, &self.collider, &options, noise)?;
        let joint = Joint::new(vec![problem], &[recording.support.friction]);
        // What pushes something that slides is in balance with friction alone.
        let simulators = joint.simulators(if kind == PushKind::Slide { 1.0 } else { 0.0 });
        let mut point = joint.start();
        point[0] = mass_kg.ln();
        if let Some(k) = joint.friction() {
            point[k] = self.friction().ln();
        }
        let unknown = Worth { poses: UNKNOWN, force: 0.0, model: simulators, product: None };
        let there = joint.evaluate(point.clone(), None, options.dt_s);
        if !there.cost.is_finite() {
            return Ok(unknown);
        }
        // Twice: the first draws are as wide as a line may be, the second ones as the posterior is.
        let mut gaussian = joint.first_guess(&there);
        let mut found = None;
        for _ in 0..2 {
            let Some(next) = joint.linearise(&gaussian, Steps::One(options.dt_s), options.seed) else {
                return Ok(unknown);
            };
            gaussian.covariance = next.gaussian.covariance.clone();
            found = Some(next);
        }
        let Some(found) = found else { return Ok(unknown) };
        let product = joint.friction().map(|f| {
            let c = &found.gaussian.covariance;
            (c[(0, 0)] + 2.0 * c[(0, f)] + c[(f, f)]).max(0.0).sqrt()
        });
        let s = &found.sources;
        let poses = (s.poses + s.encoder + s.priors.max(0.0)).sqrt();
        if poses.is_nan() || poses >= UNKNOWN {
            return Ok(Worth { product, ..unknown });
        }
        Ok(Worth { poses, force: s.force.sqrt(), model: s.contact.sqrt().hypot(simulators), product })
    }
}

/// What a rehearsal did, in numbers.
#[derive(Clone, Copy)]
struct Done {
    peak_force_n: f64,
    tilt: f64,
    travel_m: f64,
    seconds: f64,
}

impl Done {
    fn of(run: &Rehearsal) -> Self {
        Self { peak_force_n: run.peak_force_n, tilt: run.tilt, travel_m: run.travel_m, seconds: run.seconds }
    }
}

fn outcome(mass_kg: f64, run: Done, worth: Option<Worth>, refused: Option<String>) -> PlannedOutcome {
    let worth = worth.filter(|_| refused.is_none());
    let known = |sd: f64| Some(sd).filter(|sd| *sd < UNKNOWN);
    PlannedOutcome {
        mass_kg,
        peak_force_n: run.peak_force_n,
        tilt_deg: run.tilt.to_degrees(),
        travel_m: run.travel_m,
        seconds: run.seconds,
        sd_log_mass: worth.and_then(|w| known(w.all())),
        sd_noise: worth.and_then(|w| known(w.noise())),
        sd_log_mu_m: worth.and_then(|w| w.product.and_then(known)),
        verdict: worth.map_or(Verdict::NotIdentifiable, |w| w.verdict()),
        refused,
    }
}
