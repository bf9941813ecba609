//! The trial: the grasp lifted, held and shaken in simulation.

use std::collections::BTreeMap;

use crate::Result;
use drex_core::Pose;
use drex_mesh::Asset;
use drex_robot::Robot;
use drex_trial::Verdict;

use super::mass::deviation_text;
use super::object::OBJECT_COLOR;
use super::page::Page;
use super::viewer::{Look, Placed, Scene};
use crate::picture::hand::HandShapes;
use crate::picture::plot::{COLORS, Plot, Series};
use crate::picture::raster::{Part, View, clearest_azimuth, render_png};
use drex_core::stats::median;
use drex_twin::Twin;
use drex_twin::records::{RecordedFrame, RolloutRecord, TrialFile};

/// Faces of the object in the film.
const OBJECT_FACES: usize = 4000;
/// Faces of one link.
const LINK_FACES: usize = 1500;
/// Room around the film, as a share of the size of hand and object: what is shaken and what comes near should be seen.
const AROUND: f64 = 0.12;

/// The outcome in words.
fn outcome(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Success => "stayed in the hand through lift, hold and shakes",
        Verdict::NoContact => "fewer than two fingers touched it",
        Verdict::Table => "the hand hit the table",
        Verdict::Slip => "slipped in the hand",
        Verdict::Drop => "dropped",
        Verdict::Crushed => "pressed too hard",
        Verdict::Penetration => "hand and object were inside each other",
        Verdict::TorqueLimit => "not tried: the motors are too weak",
        Verdict::CannotCarry => "not tried: the contacts cannot carry it",
        Verdict::Diverged => "the simulation did not come to an end",
        _ => "failed in another way",
    }
}

/// The section on the trial.
pub fn section(page: &mut Page, twin: &Twin, asset: &Asset, trial: &TrialFile) -> Result<()> {
    page.section("Trial: lift, hold, shake");
    let [low, high] = trial.interval;
    page.paragraph(&format!(
        "The grasp that the network gives, carried out in simulation: the hand comes near, closes until the fingers touch, grips, \
         lifts by 20 cm, holds and is shaken. In {} of {} rollouts the object stayed in the hand: {:.0} %, 95 % interval {:.0} to {:.0} % \
         (Wilson). Nothing was lifted by a real hand.",
        trial.held,
        trial.n,
        100.0 * trial.held as f64 / trial.n.max(1) as f64,
        100.0 * low,
        100.0 * high
    ));
    let told = match twin.manifest.object.friction {
        Some(_) => "told to within a tenth",
        None => "not known to the hand",
    };
    page.paragraph(&format!(
        "The hand takes the object for {:.1} g. In each rollout the true mass is drawn from the posterior of the mass: median {:.1} g, 95 % \
         interval {:.1} to {:.1} g, standard deviation {}. The friction is between {:.2} and {:.2} and {told}, and the \
         object stands a little aside of where the hand believes it.",
        1e3 * trial.mass_kg,
        1e3 * trial.mass_median_kg,
        1e3 * trial.mass_ci95_kg[0],
        1e3 * trial.mass_ci95_kg[1],
        deviation_text(trial.mass_sd_kg),
        trial.friction[0],
        trial.friction[1]
    ));
    if trial.recording.len() > 1 {
        film(page, twin, asset, trial)?;
    } else {
        page.paragraph("No rollout could be carried out, so there is nothing to show of it.");
    }
    verdicts(page, trial);
    Ok(())
}

/// What became of the rollouts.
fn verdicts(page: &mut Page, trial: &TrialFile) {
    let mut by: BTreeMap<Verdict, Vec<&RolloutRecord>> = BTreeMap::new();
    for rollout in &trial.rollouts {
        by.entry(rollout.verdict).or_default().push(rollout);
    }
    let range = |values: Vec<f64>, digits: usize| {
        let lo = values.iter().copied().fold(f64::INFINITY, f64::min);
        let hi = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if lo > hi { "-".to_owned() } else { format!("{lo:.digits$} to {hi:.digits$}") }
    };
    let middle = |values: Vec<f64>| median(values).map_or("-".to_owned(), |v| format!("{v:.2}"));
    let rows: Vec<Vec<String>> = by
        .into_iter()
        .map(|(verdict, all)| {
            let share_grip_force: Vec<f64> = all.iter().map(|r| r.grip_force_n).filter(|n| *n > 0.0).collect();
            vec![
                outcome(verdict).to_owned(),
                all.len().to_string(),
                range(all.iter().map(|r| 1e3 * r.mass_kg).collect(), 1),
                range(all.iter().map(|r| r.friction).collect(), 2),
                middle(share_grip_force),
                middle(all.iter().filter_map(|r| r.held_n).collect()),
                middle(all.iter().filter_map(|r| r.friction_used).collect()),
            ]
        })
        .collect();
    page.table(
        &[
            "outcome",
            "rollouts",
            "true mass, g",
            "true friction",
            "grip force told, N (median)",
            "delivered in the hold, N (median)",
            "share of the friction used (median)",
        ],
        &rows,
    );
    let (mut friction, mut told, mut held_at, mut held) = (vec![], vec![], vec![], vec![]);
    for r in trial.rollouts.iter().filter(|r| r.grip_force_n > 0.0) {
        friction.push(r.friction);
        told.push(r.grip_force_n);
        if let Some(n) = r.held_n {
            held_at.push(r.friction);
            held.push(n);
        }
    }
    if told.is_empty() {
        return;
    }
    let plot = Plot {
        title: "Grip force of each rollout",
        x_label: "true friction",
        y_label: "sum of the normal forces, N",
        series: vec![
            Series { label: "told", x: &friction, y: &told, color: COLORS[0], dots: true },
            Series { label: "delivered in the hold", x: &held_at, y: &held, color: COLORS[1], dots: true },
        ],
        ..Plot::default()
    };
    page.plots(&[plot.to_svg()]);
}

/// The film, with the forces of the fingers and stills of it.
fn film(page: &mut Page, twin: &Twin, asset: &Asset, trial: &TrialFile) -> Result<()> {
    let hand = twin.manifest.grasps.as_ref().map_or(trial.hand.as_str(), |g| g.hand.as_str());
    let robot = Robot::resolve(hand, &twin.root)?;
    let shapes = HandShapes::new(&robot);
    let mut links = Vec::with_capacity(trial.recording.len());
    let mut object = Vec::with_capacity(trial.recording.len());
    for frame in &trial.recording {
        links.push(robot.forward_kinematics(&frame.joints_rad, &frame.world_from_base.to_pose()?));
        object.push(frame.world_from_object.to_pose()?);
    }
    let times: Vec<f64> = trial.recording.iter().map(|f| f.time_s).collect();
    let parts_at = |i: usize| -> Vec<Part<'_>> {
        let mut parts = shapes.parts(&links[i]);
        parts.push(Part { mesh: &asset.visual, world_from_mesh: object[i], color: OBJECT_COLOR, texture: None });
        parts
    };
    let last = times.len() - 1;
    let frame_at = |t: f64| times.partition_point(|x| *x < t).min(last);
    let [_, _, _, (lift, _), (hold, _), (shake, _)] = drex_trial::phases();
    let lifted = frame_at(hold);
    let view = View { width: 420, height: 340, azimuth: 0.0, elevation: 0.4, table_height_m: Some(0.0) };
    let azimuth = {
        let parts = parts_at(frame_at(lift));
        clearest_azimuth(&parts, parts.len() - 1, &view)
    };
    let picture = |i: usize| render_png(&parts_at(i), &View { azimuth, ..view });

    let mut scene = Scene::new(azimuth, view.elevation)
        .on_table(0.0)
        .timed(&times, Some(times[lifted]))?
        .phases(drex_trial::phases());
    // As large as hand and object are; the camera rises with the object.
    let boxes = parts_at(lifted).into_iter().filter_map(|p| p.mesh.transformed(&p.world_from_mesh).bounds());
    if let Some((lo, hi)) = boxes.reduce(|a, b| (a.0.inf(&b.0), a.1.sup(&b.1))) {
        let around = (hi - lo) * AROUND;
        scene = scene.framed((lo - around, hi + around));
    }
    for (link, mesh, color) in shapes.by_link() {
        if let Some(mesh) = scene.mesh(&mesh, LINK_FACES) {
            let placed: Vec<Placed> = links.iter().map(|l: &Vec<Pose>| l[link].into()).collect();
            scene.part(mesh, Look::Solid, color, &placed)?;
        }
    }
    if let Some(mesh) = scene.mesh(&asset.visual, OBJECT_FACES) {
        let placed: Vec<Placed> = object.iter().map(|p| (*p).into()).collect();
        scene.part(mesh, Look::Solid, OBJECT_COLOR, &placed)?;
        scene.follow_last();
    }
    let caption = match trial.filmed.and_then(|i| Some((i, trial.rollouts.get(i)?))) {
        Some((i, r)) => format!(
            "rollout {} of {}: true mass {:.1} g, friction {:.2}, grip force {:.2} N; {}",
            i + 1,
            trial.n,
            1e3 * r.mass_kg,
            r.friction,
            r.grip_force_n,
            outcome(r.verdict)
        ),
        None => "a rollout".to_owned(),
    };
    let viewer = page.viewers(&[(scene, picture(lifted)?, caption)]);
    page.plots_of(&viewer, &[forces(&robot, &trial.recording, &times)]);
    let shaken = frame_at(0.5 * (shake + times[last]));
    let mut stills: Vec<(usize, &str)> =
        vec![(0, "approach"), (frame_at(lift), "closed and gripping"), (lifted, "lifted"), (shaken, "shaken")];
    stills.dedup_by_key(|s| s.0);
    let stills: Vec<(Vec<u8>, String)> = stills
        .into_iter()
        .map(|(i, what)| Ok((picture(i)?, format!("{what}, {:.1} s", times[i]))))
        .collect::<Result<_>>()?;
    page.pictures(&stills);
    Ok(())
}

/// Normal force of each finger over the film.
fn forces(robot: &Robot, film: &[RecordedFrame], times: &[f64]) -> String {
    let names: Vec<String> = robot.fingers().into_iter().map(|f| f.name).collect();
    let count = film.iter().map(|f| f.finger_n.len()).max().unwrap_or(0);
    let of = |finger: usize| film.iter().map(|f| f.finger_n.get(finger).copied().unwrap_or(f64::NAN)).collect();
    let all: Vec<Vec<f64>> = (0..count).map(of).collect();
    let total: Vec<f64> = film.iter().map(|f| f.finger_n.iter().sum()).collect();
    let mut series: Vec<Series<'_>> = all
        .iter()
        .enumerate()
        .map(|(i, y)| Series {
            label: names.get(i).map_or("finger", String::as_str),
            x: times,
            y,
            color: COLORS[i % COLORS.len()],
            dots: false,
        })
        .collect();
    series.push(Series { label: "sum", x: times, y: &total, color: "currentColor", dots: false });
    let marks: Vec<(f64, String)> = drex_trial::phases()
        .into_iter()
        .filter(|(t, name)| times.last().is_some_and(|end| t < end) && ["lift", "hold", "shake"].contains(name))
        .map(|(t, name)| (t, name.to_owned()))
        .collect();
    let y_label = "normal force, N";
    Plot { title: "Force of each finger", x_label: "time, s", y_label, series, marks, ..Plot::default() }.to_svg()
}
