//! The numbers that matter, for the head of the page and for the terminal.

use crate::Result;
use drex_core::stats::median;
use drex_mesh::Asset;
use serde_json::{Map, Value, json};

use super::mass::{bounds_text, contradiction_text, grip_text, posterior_text, prior_text};
use super::page::Page;
use super::push::verdict_text;
use crate::learned::Learned;
use drex_grasp::{GraspChange, OriginCounts};
use drex_trial::DemonstrationCounts;
use drex_twin::records::{
    EvaluatedGrasp, Evaluation, ExecutionFile, FitFile, MassFile, PracticeRecord, SplatReport, Training, TrialFile,
};
use drex_twin::{Stage, Twin, records as files};

/// What a run found, as text and as JSON.
pub struct Findings {
    /// For the terminal.
    pub text: String,
    /// One JSON object.
    pub json: String,
}

/// Reads back what the stages up to `last` wrote.
pub fn findings(twin: &Twin, last: Stage) -> Result<Findings> {
    let mut text = format!("{}\n", twin.manifest.name);
    let mut found = Map::new();
    let mass = (last >= Stage::Identify).then(|| twin.mass()).transpose()?;
    if let Some(contradiction) = mass.as_ref().and_then(contradiction_text) {
        text += &format!("  warning    {contradiction}\n");
    }
    if twin.manifest.scan.is_some() {
        let volume_cm3 = 1e6 * twin.asset()?.report.volume_m3;
        let trained: Option<SplatReport> = files::read_json_if_there(&twin.path(files::SPLAT_REPORT))?;
        let psnr_db = trained.as_ref().and_then(|t| t.appearance.held_out.mean(|r| r.psnr));
        let photos = match (&trained, psnr_db) {
            (Some(t), Some(db)) => {
                format!("{} photos, {db:.1} dB on {} others, ", t.photos_trained, t.photos_held_out)
            }
            (Some(t), None) => format!("{} photos, ", t.photos_trained),
            (None, _) => String::new(),
        };
        text += &format!("  scan       {photos}closed mesh of {volume_cm3:.0} cm3\n");
        found.insert("scan".into(), json!({ "psnr_db": psnr_db, "volume_cm3": volume_cm3 }));
    }
    let has_grasps = twin.manifest.grasps.is_some();
    if let Some(mass) = &mass {
        text += &format!("  mass       {}\n", posterior_text(mass));
        if let Some(result) = &mass.identification {
            let stays = if mass.push_ci95_kg.is_none() { ": the prior stays as it is" } else { "" };
            text += &format!("  push alone {}{stays}\n", verdict_text(result).lines().next().unwrap_or_default());
        }
        if let Some(prior) = mass.prior.as_ref().filter(|p| !p.weighed) {
            text += &format!("  prior      {}\n", prior_text(prior));
        }
        if let Some(grip) = grip_text(mass).filter(|_| has_grasps) {
            text += &format!("  grip       {grip}\n");
        }
        found.insert(
            "mass".into(),
            json!({ "mass_kg": mass.mass_kg, "source": mass.source, "ci95_kg": mass.ci95_kg, "sd_kg": mass.sd_kg,
                    "grip_kg": mass.grip_kg, "push_ci95_kg": mass.push_ci95_kg, "prior": mass.prior,
                    "contradiction_sd": mass.contradiction_sd, "contradiction": contradiction_text(mass),
                    "verdict": mass.identification.as_ref().map(|i| i.verdict) }),
        );
    }
    if has_grasps && last >= Stage::Grasps {
        let fits: FitFile = files::read_json(&twin.path(files::FITS))?;
        let what = if fits.clips.is_empty() { "demonstrations" } else { "grasps of people" };
        text += &format!("  grasps     {} of {} {what} fit the object\n", fits.accepted, fits.demonstrations);
        found.insert("grasps".into(), json!({ "demonstrations": fits.demonstrations, "accepted": fits.accepted }));
    }
    if has_grasps && last >= Stage::Train {
        let training: Training = files::read_json(&twin.path(files::TRAINING))?;
        let Training { learned, tried, .. } = &training;
        text += &format!("  learned    {}\n", learned_line(learned, tried));
        let validated = training.practice.as_ref().filter(|p| p.demonstrations.demonstrated > 0);
        if let Some(practice) = validated {
            text += &format!("  refined    {}\n", refined_line(practice));
        }
        found.insert(
            "learned".into(),
            json!({ "learned": learned.total(), "demonstrated": learned.demonstrated, "refined": learned.refined,
                    "searched": learned.searched, "tried": tried, "demonstrations": validated.map(|p| p.demonstrations) }),
        );
    }
    if has_grasps && last >= Stage::Evaluate {
        let e: Evaluation = files::read_json(&twin.path(files::EVALUATION))?;
        text += &format!(
            "  check      static check at {:.0} g: {} predicted grasps pass, {} after refinement, {} demonstrations\n",
            1e3 * e.mass_kg,
            passed(&e.predicted),
            passed(&e.refined),
            passed(&e.demonstrations)
        );
        found.insert(
            "static_check".into(),
            json!({ "mass_kg": e.mass_kg, "friction": e.friction, "predicted": tally(&e.predicted),
                    "refined": tally(&e.refined), "demonstrations": tally(&e.demonstrations) }),
        );
    }
    if has_grasps && last >= Stage::Trial {
        let trial: TrialFile = files::read_json(&twin.path(files::TRIAL))?;
        text += &format!("  trial      {}\n", trial_line(&trial));
        let (grip_force_n, held_n) = grip_forces(&trial);
        found.insert(
            "trial".into(),
            json!({ "held": trial.held, "n": trial.n, "interval": trial.interval,
                    "squeeze_n": grip_force_n, "held_n": held_n }),
        );
    }
    if has_grasps && last >= Stage::Execute {
        let execution: ExecutionFile = files::read_json(&twin.path(files::EXECUTION))?;
        text += &format!("  hand       {}\n", execution_line(&execution));
        found.insert(
            "execution".into(),
            json!({ "hand": execution.hand, "held": execution.held, "not_driven": execution.not_driven }),
        );
    }
    if last >= Stage::Report {
        let path = twin.path("report.html");
        text += &format!("  report     {}", path.display());
        found.insert("report".into(), json!(path));
    }
    Ok(Findings { text, json: Value::Object(found).to_string() })
}

/// "3 of 8".
pub fn passed(grasps: &[EvaluatedGrasp]) -> String {
    format!("{} of {}", grasps.iter().filter(|g| g.check.passed).count(), grasps.len())
}

fn tally(grasps: &[EvaluatedGrasp]) -> Value {
    json!({ "passed": grasps.iter().filter(|g| g.check.passed).count(), "of": grasps.len() })
}

/// "3 grasps: 0 demonstrated, 1 refined, 2 searched; tried were 42 demonstrated, 0 refined, 117 searched".
fn learned_line(learned: &OriginCounts, tried: &OriginCounts) -> String {
    format!("{} grasps: {learned}; tried were {tried}", learned.total())
}

/// "37 distinct: 11 can hold it, 6 of them as they are; 3 held in practice, 3 learned, changed by up to 0.38 rad, 11.0 mm and 9.9 degrees".
fn refined_line(practice: &PracticeRecord) -> String {
    let DemonstrationCounts { demonstrated, as_demonstrated, commanded, held, selected } = practice.demonstrations;
    let changes = || practice.learned.iter().filter_map(|g| g.change);
    let most = |of: fn(&GraspChange) -> f64| changes().map(|c| of(&c)).fold(0.0, f64::max);
    let changed = match selected {
        0 => String::new(),
        _ => format!(
            ", changed by up to {:.2} rad, {:.1} mm and {:.1} degrees",
            most(|c| c.joint_rad),
            1e3 * most(|c| c.base_m),
            most(|c| c.base_rad).to_degrees()
        ),
    };
    format!(
        "{demonstrated} distinct: {commanded} can hold it, {as_demonstrated} of them as they are; {held} held in practice, {selected} learned{changed}"
    )
}

/// "23 of 24 lifted, held and shaken (95 %: 80 to 99 %) with 7.1 N".
fn trial_line(trial: &TrialFile) -> String {
    let [low, high] = trial.interval.map(|p| 100.0 * p);
    let grip_force = grip_forces(trial).0.map(|n| format!(" with {n:.1} N (median)"));
    format!(
        "{} of {} rollouts lifted, held and shaken (95 %: {low:.0} to {high:.0} %){}",
        trial.held,
        trial.n,
        grip_force.unwrap_or_default()
    )
}

/// Medians of the grip force that was commanded and of the one that was delivered, N.
pub fn grip_forces(trial: &TrialFile) -> (Option<f64>, Option<f64>) {
    let commanded = trial.rollouts.iter().filter(|r| r.proposal > 0).map(|r| r.grip_force_n);
    (median(commanded), median(trial.rollouts.iter().filter_map(|r| r.held_n)))
}

/// What the emulated hand did.
fn execution_line(execution: &ExecutionFile) -> String {
    match &execution.not_driven {
        Some(reason) => format!("{} did not move: {reason}", execution.hand),
        None => {
            let touched = execution.contacts.len();
            let most = execution.force_limits.iter().copied().fold(0.0, f64::max);
            let became = if execution.held { "held" } else { "did not hold" };
            format!(
                "{}, emulated, {became}: {touched} joints touched, at most {most:.0} {}",
                execution.hand, execution.unit
            )
        }
    }
}

/// The row of figures at the head of the page.
pub fn figures(page: &mut Page, asset: &Asset, mass: &MassFile, learned: Option<&Learned>) {
    let [low, high] = mass.ci95_kg.map(|m| 1e3 * m);
    let remark = format!("{}; 95 % interval {low:.1} to {high:.1} g", mass.source.text());
    let mut all = vec![(format!("{:.1} g", 1e3 * mass.mass_kg), "mass".to_owned(), remark)];
    if let Some(result) = &mass.identification {
        let said = mass.push_ci95_kg.map_or("nothing".to_owned(), bounds_text);
        let verdict = if result.mass_kg.is_some() { "identified" } else { "not identifiable" };
        all.push((said, "mass by the push alone".to_owned(), format!("95 % interval without any prior; {verdict}")));
    }
    all.extend([(
        format!("{:.1} cm³", 1e6 * asset.report.volume_m3),
        "volume".to_owned(),
        format!("{}; {}", super::closing_text(&asset.report), super::pieces_text(asset)),
    )]);
    if let Some(Learned { fits, training, trial, .. }) = learned {
        all.push((
            format!("{} / {}", fits.accepted, fits.demonstrations),
            if fits.clips.is_empty() { "demonstrations" } else { "grasps" }.to_owned() + " that fit the object",
            "thumb and two fingers on the surface".to_owned(),
        ));
        all.push((training.learned.total().to_string(), "grasps learned".to_owned(), training.learned.to_string()));
        let newtons = |n: Option<f64>| n.map_or("-".to_owned(), |n| format!("{n:.1} N"));
        let (grip_force_n, held_n) = grip_forces(trial);
        all.push((
            newtons(grip_force_n),
            "grip force (median)".to_owned(),
            format!("commanded, sum of normal forces; {} delivered in the hold", newtons(held_n)),
        ));
        let [low, high] = trial.interval;
        all.push((
            format!("{} of {}", trial.held, trial.n),
            "rollouts in which it stayed in the hand".to_owned(),
            format!("lift, hold, shake in simulation; 95 % interval {:.0} to {:.0} %", 100.0 * low, 100.0 * high),
        ));
    }
    page.figures(&all);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_says_how_far_demonstrations_came() {
        let demonstrations =
            DemonstrationCounts { demonstrated: 37, as_demonstrated: 6, commanded: 11, held: 3, selected: 1 };
        let practice = PracticeRecord { commanded: 60, robust: 5, demonstrations, learned: Vec::new() };
        let text = refined_line(&practice);
        assert!(
            text.starts_with("37 distinct: 11 can hold it, 6 of them as they are; 3 held in practice, 1 learned"),
            "{text}"
        );
    }

    #[test]
    fn the_report_says_where_learned_grasps_come_from() {
        let learned = OriginCounts { demonstrated: 1, refined: 2, searched: 3 };
        let tried = OriginCounts { demonstrated: 42, refined: 7, searched: 117 };
        assert_eq!(
            learned_line(&learned, &tried),
            "6 grasps: 1 demonstrated, 2 refined, 3 searched; tried were 42 demonstrated, 7 refined, 117 searched"
        );
    }
}
