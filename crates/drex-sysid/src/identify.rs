//! From recordings to an answer.

use std::time::Instant;

use drex_core::pose::to_wxyz;
use drex_core::trajectory::PoseNoise;
use drex_core::{Object, Pose};
use drex_recording::{Drive, PushRecording, TrackFrame};

use crate::answer::{Identification, PushReport, Sensitivity, Verdict};
use crate::distribution::EXCLUDES;
use crate::estimate::{Estimate, Outcome};
use crate::fit::Fit;
use crate::joint::{Candidate, Joint};
use crate::object::{collider, sd_of_rough_mesh_m, standing};
use crate::parameters::{Knowledge, Parameter, ParameterSet};
use crate::problem::{Motion, Problem};
use crate::{CONTRADICTS_SD, IdentifyOptions, Method, Result, SysidError, adam, checks, hand, invariance, noise};

/// Standard deviation of log mass above which a recording does not weigh the object.
pub(crate) const SD_LIMIT: f64 = 0.35;
/// Standard deviation of log(friction · mass) below which the product counts as known.
pub(crate) const SD_PRODUCT_LIMIT: f64 = 0.15;

/// Slopes that differ by more than this do not stem from a smooth motion.
const SLOPES_AGREE: f64 = 0.01;
/// Misses of poses, in standard deviations of their noise, beyond which an answer is doubtful, and of an encoder beyond which it is none.
/// Of 106 simulated pushes by a finger whose interval holds the truth one misses the encoder by more than five.
const MISSED_POSES: f64 = 3.0;
const MISSED_ENCODER: f64 = 10.0;

/// Estimates the mass of `object` from pushes of it.
///
/// Known forces are simulated and fitted together; what other recordings can tell is checked and said. A recording
/// without information about the mass is a verdict, not an error. Runs in rayon's current pool; the result does not depend on
/// its number of threads.
///
/// # Errors
/// If there is no recording, a track is too short, geometry and support contradict, or the object cannot be simulated.
pub fn identify(recordings: &[PushRecording], object: &Object, options: &IdentifyOptions) -> Result<Identification> {
    identify_watched(recordings, object, options, &|_| {})
}

/// As [`identify`]; `progress` is told now and then which part of the work is done, from 0 to 1 and never less than before.
///
/// # Errors
/// As [`identify`].
pub fn identify_watched(
    recordings: &[PushRecording],
    object: &Object,
    options: &IdentifyOptions,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Identification> {
    check(options)?;
    let begin = Instant::now();
    if recordings.is_empty() {
        return Err(SysidError::NoRecording);
    }
    let shape = collider(object)?;
    let is_on_table = |r: &PushRecording| matches!(r.drive, Drive::Force(_)) && r.support.boxes.is_empty();
    let standing = match recordings.iter().any(is_on_table) {
        true => Some(standing(object)?),
        false => None,
    };
    let standing = standing.map(|s| collider(&s).map(|c| (s, c))).transpose()?;
    agree(recordings)?;
    // What one push says of the mesh holds for all.
    let stated_sd_m = recordings.iter().filter_map(|r| r.mesh_sd_m).reduce(f64::max);
    let rough_sd_m = sd_of_rough_mesh_m(object);
    let mut reports = Vec::new();
    let mut problems = Vec::new();
    let mut frictions = Vec::new();
    let mut fitted = Vec::new();
    for (i, recording) in recordings.iter().enumerate() {
        let noise = recording.noise.unwrap_or_else(|| noise::of_track(&recording.track));
        checks::recording(recording, object, &noise)?;
        reports.push(report(recording, noise));
        if recording.track_frame != TrackFrame::World || !matches!(recording.drive, Drive::Force(_) | Drive::Finger(_))
        {
            continue;
        }
        let (object, shape) = match &standing {
            Some((standing, hull)) if is_on_table(recording) => (standing, hull),
            _ => (object, &shape),
        };
        let mut recording = recording.clone();
        recording.mesh_sd_m = stated_sd_m.or(rough_sd_m);
        let problem = Problem::new(&recording, object, shape, options, noise)?;
        if problem.can_weigh() {
            problems.push(problem);
            frictions.push(recording.support.friction);
            fitted.push(i);
        }
    }
    let mut answer = Identification {
        mass_kg: None,
        ci95_kg: None,
        verdict: Verdict::NotIdentifiable,
        mu_m_kg: None,
        reason: String::new(),
        seconds: 0.0,
        simulations: 0,
        prior_kg: recordings.iter().find_map(|r| r.mass_prior_kg),
        friction: None,
        sd_log_mass: None,
        error_budget: None,
        estimates: Vec::new(),
        sensitivities: Vec::new(),
        assumptions: assumptions(recordings, [stated_sd_m, rough_sd_m], options),
        profile: Vec::new(),
        pushes: Vec::new(),
    };
    let mut reasons = Vec::new();
    let hands = hand::look(recordings, object, options)?;
    for (i, recording) in recordings.iter().enumerate() {
        if let Some(found) = &hands[i] {
            reports[i].notes.extend(found.notes.iter().cloned());
            reports[i].hand = Some(found.report.clone());
            reports[i].clock_offset_s = found.report.clock_offset_s.map(|c| c[0]);
        } else if !fitted.contains(&i) {
            let finding = invariance::explain(recording, object, &shape, options)?;
            reports[i].notes.extend(finding.notes);
            reports[i].simulated = finding.simulated.iter().map(row).collect();
            if fitted.is_empty() && answer.profile.is_empty() {
                answer.profile = finding.profile;
            }
            reasons.push(finding.reason);
        }
    }
    if problems.is_empty() {
        if hand::decide(&mut answer, &hands) {
            reasons.insert(0, std::mem::take(&mut answer.reason));
        }
        answer.reason = reasons.join(" ");
    } else if options.method == Method::Adam {
        let joint = Joint::new(problems, &frictions);
        let end = by_adam(&mut answer, &joint, options)?;
        for (k, &i) in fitted.iter().enumerate() {
            fill(&mut reports[i], &joint.problems[k], &end.motions[k], &end.fits[k]);
        }
        answer.simulations = joint.simulations();
    } else {
        let mut by_hand = answer.clone();
        let is_by_hand = hand::decide(&mut by_hand, &hands);
        let mut joint = Joint::new(problems, &frictions);
        let outcome = joint.solve(options, progress)?;
        let best = match &outcome {
            Outcome::Estimate(estimate) => estimate.best.first(),
            Outcome::Unseen(best, _) => Some(best),
            Outcome::Lost => None,
        };
        if let Some(Candidate { motions, fits, .. }) = best {
            for (k, &i) in fitted.iter().enumerate() {
                fill(&mut reports[i], &joint.problems[k], &motions[k], &fits[k]);
            }
        }
        // What was fixed was not weighed, however it is followed.
        let unfollowed = || fitted.iter().find_map(|&i| unfollowed(&reports[i], options.encoder_m));
        let lost = joint.fixed_mass().is_none().then(unfollowed).flatten();
        match (outcome, lost) {
            (Outcome::Estimate(estimate), Some(why)) => {
                answer.profile = estimate.scan;
                answer.reason = why;
            }
            (Outcome::Estimate(estimate), None) => {
                for (k, &i) in fitted.iter().enumerate() {
                    reports[i].information.clone_from(&estimate.shares[k]);
                }
                decide(&mut answer, &estimate, &joint)?;
                if answer.verdict == Verdict::Identified {
                    for &i in &fitted {
                        answer.reason.extend(doubt(&reports[i]));
                        answer
                            .reason
                            .extend(checks::outside_m(&recordings[i], object).map(|d| elsewhere(&reports[i].name, d)));
                    }
                }
                answer.estimates = estimate.others;
                if let Some((sensitivities, slope)) = estimate.sensitivities {
                    let sensitivity = |(parameter, log_mass)| Sensitivity { parameter, log_mass };
                    answer.sensitivities = sensitivities.into_iter().map(sensitivity).collect();
                    if (slope - 1.0).abs() > SLOPES_AGREE {
                        answer.assumptions.push(format!(
                            "the sensitivities are rough: contact chatters, and the slope that they are compared with is {slope:.2} of \
                             that within the interval"
                        ));
                    }
                }
            }
            (Outcome::Unseen(_, scan), _) => {
                answer.profile = scan;
                answer.reason = format!(
                    "whatever the mass, the poses do not follow the motion that {} makes: in another order they would agree with it as \
                     well; check that the track belongs to this push and that the object moved",
                    cause(&joint)
                );
            }
            (Outcome::Lost, _) => {
                answer.reason = "no mass explains the push: around the best one it cannot be simulated, or draws of the unknowns go \
                                 ever farther without agreeing better; check forces, start and support"
                    .into();
            }
        }
        answer.simulations = joint.simulations();
        if is_by_hand && joint.fixed_mass().is_none() {
            count_in(&mut answer, by_hand);
        }
        if !reasons.is_empty() {
            answer.reason = format!("{} {}", answer.reason, reasons.join(" "));
        }
    }
    progress(1.0);
    answer.pushes = reports;
    answer.seconds = begin.elapsed().as_secs_f64();
    Ok(answer)
}

/// Counts what pushes by a hand say of the mass into what simulated pushes say of it.
fn count_in(answer: &mut Identification, by_hand: Identification) {
    let (simulated, of_hand) = (answer.likelihood(), by_hand.likelihood());
    if let (Some(simulated), Some(of_hand)) = (&simulated, &of_hand) {
        let both = simulated.times(of_hand);
        let [low, high] = both.interval95_kg();
        (answer.mass_kg, answer.ci95_kg) = (Some(both.median_kg()), Some([low, high]));
        answer.sd_log_mass = Some(both.sd_log());
        answer.profile = both.costs().collect();
        answer.reason +=
            &format!(". With what pushes by a hand say beside that, it is {:.1} to {:.1} g", 1e3 * low, 1e3 * high);
        let apart = simulated.contradiction_sd(of_hand);
        if apart > CONTRADICTS_SD {
            answer.reason += &format!(
                "; DOUBTFUL: the two are {apart:.1} standard deviations apart, so one of them is not a push of this object, or is not \
                 recorded as is stated"
            );
        }
        answer.reason += &format!("; by a hand alone: {}", by_hand.reason);
    } else if of_hand.is_some() {
        // Simulated pushes leave all masses, or all with one product of friction and mass.
        answer.reason = format!("{}. By simulated pushes alone: {}", by_hand.reason, answer.reason);
        if by_hand.verdict == Verdict::Identified {
            answer.verdict = by_hand.verdict;
        }
        (answer.mass_kg, answer.ci95_kg, answer.sd_log_mass) = (by_hand.mass_kg, by_hand.ci95_kg, by_hand.sd_log_mass);
        (answer.sensitivities, answer.profile) = (by_hand.sensitivities, by_hand.profile);
    } else {
        answer.reason += &format!(". By a hand alone: {}", by_hand.reason);
    }
}

/// The estimate of the method that has no interval.
fn by_adam(answer: &mut Identification, joint: &Joint, options: &IdentifyOptions) -> Result<Candidate> {
    let [lo, hi] = options.scan_kg;
    let stated = match options.parameters.get(Parameter::Mass) {
        Some(Knowledge::Prior { mean, .. }) => Some(mean),
        _ => answer.prior_kg,
    };
    let guess_kg = stated.unwrap_or((lo * hi).sqrt());
    let descent = adam::descend(joint, guess_kg, options.dt_s)?;
    answer.mass_kg = Some(descent.end.point[0].exp());
    answer.verdict = Verdict::Fitted;
    answer.reason = format!(
        "Adam on the logarithm of the mass went from {:.1} g{} to {:.1} g in {} epochs, and the mean square of the whitened residuals \
         from {:.3} to {:.3} (1 would be noise alone). No interval: this method gives none, nor does it notice a recording that \
         cannot weigh the object",
        1e3 * guess_kg,
        if stated.is_some() { "" } else { ", the middle of the scan, since nobody made a first guess," },
        1e3 * descent.end.point[0].exp(),
        descent.epochs,
        descent.first_loss,
        descent.loss
    );
    answer.profile = descent.path;
    Ok(descent.end)
}

/// Verdict and numbers from an estimate.
fn decide(answer: &mut Identification, e: &Estimate, joint: &Joint) -> Result<()> {
    let mass = e.mass()?;
    let (m, sd) = (mass.median_kg(), mass.sd_log());
    let mu = e.friction;
    let cause = cause(joint);
    answer.sd_log_mass = Some(sd);
    answer.error_budget = Some(e.budget);
    answer.profile = e.scan.clone();
    // Whether the worst mass of the scan is excluded, at least.
    let informative = e.relief > EXCLUDES;
    if let Some(kg) = joint.fixed_mass() {
        answer.friction = mu;
        answer.sd_log_mass = None;
        answer.reason = format!(
            "the mass was fixed to {:.1} g: everything else was fitted to it, and nothing was weighed",
            1e3 * kg
        );
    } else if informative && sd < SD_LIMIT {
        let [low, high] = mass.interval95_kg();
        answer.mass_kg = Some(m);
        answer.ci95_kg = Some([low, high]);
        answer.profile = mass.costs().collect();
        answer.verdict = Verdict::Identified;
        answer.friction = mu;
        answer.reason = format!(
            "{cause} moved the object in a way that only masses from {:.1} to {:.1} g explain",
            1e3 * low,
            1e3 * high
        );
        if e.budget.force_factor > 0.0 {
            let least = 196.0 * e.budget.force_factor;
            answer.reason +=
                &format!("; the noise of the force record alone leaves ±{least:.1} %, however good the poses");
        }
    } else if let Some((mu, sd)) = mu.zip(e.sd_mu_m).filter(|(_, sd)| informative && *sd < SD_PRODUCT_LIMIT) {
        answer.verdict = Verdict::OnlyMuM;
        answer.mu_m_kg = Some(mu * m);
        answer.reason = format!(
            "the object slid under {cause} with unknown friction: force and friction balance for every mass with the same \
             product of friction and mass, {:.4} kg (standard deviation {:.1} %); the friction coefficient, a coast after the push \
             or a push that tips would give the mass",
            mu * m,
            100.0 * sd
        );
    } else {
        answer.reason = format!(
            "the motion under {cause} is explained by masses over a range of more than {:.1} to 1: {}",
            (1.96 * sd.min(3.0) * 2.0).exp(),
            if joint.problems.iter().any(Problem::has_finger) {
                "the finger is so stiff that it moves every mass the same way, or its deflection is lost in the noise; use its \
                 encoder, a softer finger, a faster push, or tip the object"
            } else {
                "the push was too weak, or nothing moved; push harder, tip the object, or press on an overhanging end"
            }
        );
    }
    Ok(())
}

/// What moved the object.
fn cause(joint: &Joint) -> &'static str {
    if joint.problems.iter().any(Problem::has_finger) { "the compliant fingertip" } else { "the known force" }
}

/// Why the best answer of a push by a finger is none: draws were made around a motion that the encoder is not even near.
fn unfollowed(push: &PushReport, encoder_m: f64) -> Option<String> {
    let missed_m = push.rms_encoder_m.filter(|m| *m > MISSED_ENCODER * encoder_m)?;
    Some(format!(
        "no motion was found that the encoder of `{}` follows: the best one misses it by {:.1} mm, so no mass does what was recorded; \
         check the encoder's clock and the finger's impedance, state the start pose, or repeat the push through the middle of the object",
        push.name,
        1e3 * missed_m
    ))
}

/// What speaks against an answer although it is the best that there is: observations that it misses by far more than their noise.
fn doubt(push: &PushReport) -> Option<String> {
    let per_axis = |rms: Option<f64>, sd: f64| rms.map_or(0.0, |r| r / (3.0_f64.sqrt() * sd));
    let missed = [
        ("positions", per_axis(push.rms_position_m, push.position_sd_m)),
        ("rotations", per_axis(push.rms_rotation_rad, push.rotation_sd_rad)),
    ];
    let (what, times) =
        missed.into_iter().filter(|(_, times)| *times > MISSED_POSES).max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(format!(
        "; DOUBTFUL: even so the {what} of `{}` are missed by {times:.1} times their noise, so something that was stated, or the shape, is \
         wrong, and the interval may be too narrow",
        push.name
    ))
}

/// What speaks against an answer whose force acts on nothing.
fn elsewhere(push: &str, distance_m: f64) -> String {
    format!(
        "; DOUBTFUL: the force of `{push}` is said to act {:.0} mm outside the mesh, which may be of another object, or in another \
         frame than the point of the force",
        1e3 * distance_m
    )
}

fn report(recording: &PushRecording, noise: PoseNoise) -> PushReport {
    PushReport {
        name: recording.name.clone(),
        position_sd_m: noise.position_m,
        rotation_sd_rad: noise.rotation_rad,
        rms_position_m: None,
        rms_rotation_rad: None,
        outliers: 0,
        clock_offset_s: None,
        rms_encoder_m: None,
        position_bias_m: None,
        information: Vec::new(),
        times_s: recording.track.times_s().to_vec(),
        observed: recording.track.poses().iter().map(row).collect(),
        simulated: Vec::new(),
        notes: recording.notes.clone(),
        hand: None,
    }
}

fn fill(report: &mut PushReport, problem: &Problem, motion: &Motion, fit: &Fit) {
    let poses = &fit.weights[..problem.times_s.len().min(fit.weights.len())];
    let kept: Vec<_> = fit.residuals.chunks_exact(6).zip(poses).filter(|(_, w)| **w >= 0.5).map(|(r, _)| r).collect();
    let n = kept.len().max(1) as f64;
    let sds = problem.sds();
    let square = |r: &[f64], i: usize| (r[i] * sds[i]).powi(2);
    let rms = |rows: std::ops::Range<usize>| {
        (kept.iter().map(|r| rows.clone().map(|i| square(r, i)).sum::<f64>()).sum::<f64>() / n).sqrt()
    };
    report.rms_position_m = Some(rms(0..3));
    report.rms_rotation_rad = Some(rms(3..6));
    report.outliers = poses.len() - kept.len();
    let readings = fit.residuals.get(6 * poses.len()..).unwrap_or(&[]);
    report.rms_encoder_m = (!readings.is_empty())
        .then(|| (readings.iter().map(|r| r * r).sum::<f64>() / readings.len() as f64).sqrt() * problem.encoder_m);
    report.clock_offset_s = Some(fit.nuisance[0]);
    report.position_bias_m = Some((problem.world_from_push * fit.nuisance.fixed_rows::<3>(1)).into());
    let pose = |t: &f64| row(&(problem.world_from_push * motion.at(t - fit.nuisance[0])));
    report.simulated = problem.times_s.iter().map(pose).collect();
    if motion.unconverged_steps > 0 {
        report.notes.push(format!(
            "{} steps of the best simulation were not solved to full precision: contact there is doubtful",
            motion.unconverged_steps
        ));
    }
}

fn row(pose: &Pose) -> [f64; 7] {
    let ([x, y, z], [qw, qx, qy, qz]) = to_wxyz(pose);
    [x, y, z, qw, qx, qy, qz]
}

fn assumptions(
    recordings: &[PushRecording],
    [stated_sd_m, rough_sd_m]: [Option<f64>; 2],
    options: &IdentifyOptions,
) -> Vec<String> {
    let mut out =
        vec!["the object is rigid and of uniform density: centre of mass and inertia follow from its mesh".to_owned()];
    let force = recordings.iter().any(|r| matches!(r.drive, Drive::Force(_)));
    let finger = recordings.iter().any(|r| matches!(r.drive, Drive::Finger(_)));
    if force {
        out.push("the recorded force has the right gain and acts at the stated point".into());
        out.push("a stretch of the force record that noise explains is no force".into());
    }
    if finger {
        out.push("gains, damping, moving mass, radius and friction of the fingertip are as stated".into());
        if recordings.iter().any(|r| matches!(&r.drive, Drive::Finger(f) if f.encoder.is_some())) {
            out.push(format!("the fingertip's encoder is good to {} mm", 1e3 * options.encoder_m));
        }
    }
    if force || finger {
        out.push("gravity and the shape of the support are as stated".into());
        out.push(match stated_sd_m.or(rough_sd_m) {
            Some(sd) if sd > 0.0 => format!(
                "the mesh is known to {:.1} mm{}, and with it the centre of mass, the start and the height of the push",
                1e3 * sd,
                if stated_sd_m.is_some() { "" } else { ", since it is rough (mesh_sd_m in push.toml says it better)" },
            ),
            Some(_) => "the mesh is exact, as stated".into(),
            None => "the mesh is exact; of a scan say how well it is known (mesh_sd_m in push.toml)".into(),
        });
        let of_push = |r: &PushRecording| r.parameters.contains_key(Parameter::Friction.as_str());
        if options.parameters.get(Parameter::Friction).is_none() && !recordings.iter().any(of_push) {
            out.push(match recordings.iter().find_map(|r| r.support.friction) {
                Some(mu) => format!("the friction against the support is {mu} as stated"),
                None => "the friction against the support is one unknown constant, probably between 0.13 and 2".into(),
            });
        }
    }
    out.extend(hand::assumptions(recordings, options));
    let stated = recordings.iter().filter_map(|r| ParameterSet::of_recording(r).ok());
    let sentences = stated.fold(options.parameters.clone(), |all, set| all.or(&set)).sentences();
    if !sentences.is_empty() && !force && !finger {
        out.push("what is stated of parameters plays no part: nothing here is simulated with them".into());
    } else {
        out.extend(sentences);
    }
    out
}

/// What several pushes state about something that they share must be the same.
fn agree(recordings: &[PushRecording]) -> Result<()> {
    let mut stated: Vec<(&str, ParameterSet)> = Vec::new();
    for recording in recordings {
        let set = ParameterSet::of_recording(recording)?;
        for parameter in Parameter::ALL.into_iter().filter(|p| !p.is_of_push()) {
            let Some(here) = set.get(parameter) else { continue };
            let other = stated.iter().find(|(_, s)| s.get(parameter).is_some_and(|k| k != here));
            if let Some((name, _)) = other {
                return Err(SysidError::Parameter {
                    name: parameter.as_str().into(),
                    what: format!("is stated differently by the pushes `{name}` and `{}`", recording.name),
                    remedy: "it is one number for all pushes: state it once".into(),
                });
            }
        }
        stated.push((&recording.name, set));
    }
    Ok(())
}

fn check(options: &IdentifyOptions) -> Result<()> {
    let bad = |option, what: &str| Err(SysidError::Option { option, what: what.into() });
    let [lo, hi] = options.scan_kg;
    if !(lo > 0.0 && hi > lo && hi.is_finite()) {
        return bad("scan_kg", "needs two positive masses in kilograms, the smaller first");
    }
    if options.scan_points < 5 {
        return bad("scan_points", "needs at least five points");
    }
    let positive = [("dt_s", options.dt_s), ("scan_dt_s", options.scan_dt_s), ("encoder_m", options.encoder_m)];
    if let Some((option, _)) = positive.into_iter().find(|(_, x)| !(*x > 0.0 && x.is_finite())) {
        return bad(option, "needs a positive number");
    }
    Ok(())
}
