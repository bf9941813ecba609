//! The push: what was tracked, what the simulation makes of it, how likely each mass is.

use drex_sysid::{Identification, MassDistribution, ParameterEstimate, PushReport, Sensitivity, Verdict};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::mass::{bounds_text, deviation_text, grip_text, posterior_text, prior_text};
use super::page::Page;
use super::replay::Replay;
use crate::picture::plot::{COLORS, Plot, Series};
use drex_twin::records::MassFile;

/// The verdict as a person reads it.
pub fn verdict_text(r: &Identification) -> String {
    let mut text = match (r.verdict, r.mass_kg, r.ci95_kg) {
        (Verdict::Identified, Some(m), Some([lo, hi])) => {
            format!(
                "identified: {:.1} g, 95 % interval {:.1} to {:.1} g (upper/lower {:.2})",
                1e3 * m,
                1e3 * lo,
                1e3 * hi,
                hi / lo
            )
        }
        (Verdict::Fitted, Some(m), _) => format!("fitted, no interval: {:.1} g", 1e3 * m),
        (Verdict::OnlyMuM, ..) => match r.mu_m_kg {
            Some(mu_m) => format!("only friction times mass: mu m = {:.1} g", 1e3 * mu_m),
            None => "only friction times mass".to_owned(),
        },
        (_, _, Some([lo, hi])) => match r.likelihood().map(|l| l.bounds_kg()) {
            Some(bounds) if bounds.contains(&None) => format!("not identifiable; {} (95 %)", bounds_text(bounds)),
            _ => format!(
                "not identifiable; 95 % interval {:.1} to {:.1} g (upper/lower {:.2})",
                1e3 * lo,
                1e3 * hi,
                hi / lo
            ),
        },
        _ => "not identifiable".to_owned(),
    };
    text += &format!("\n  {}", r.reason);
    for assumption in &r.assumptions {
        text += &format!("\n  assumed: {assumption}");
    }
    text
}

/// How well a parameter is known, in words where it is not.
fn parameter_deviation_text(e: &ParameterEstimate) -> String {
    if e.parameter.is_logarithmic() && e.sd > e.value {
        "this push does not tell it".to_owned()
    } else {
        format!("{:.4}", e.sd)
    }
}

/// The effect of a likely error, in words.
fn sensitivity_text(s: &Sensitivity) -> String {
    if s.parameter.is_logarithmic() {
        format!("{:+.1} % if it is 10 % larger", 100.0 * s.log_mass * 1.1_f64.ln())
    } else {
        format!("{:+.1} % if it is a millimetre larger", 100.0 * s.log_mass * 1e-3)
    }
}

/// The section on mass and pushes; the second is there if a push was simulated and tracked.
pub fn section(page: &mut Page, mass: &MassFile, replays: &[Option<Replay>]) {
    page.section("Mass");
    page.paragraph(&format!("{}; standard deviation {}.", posterior_text(mass), deviation_text(mass.sd_kg)));
    let mut parts = Vec::new();
    parts.extend(mass.prior.as_ref().map(|prior| format!("Before the push: {}.", prior_text(prior))));
    if mass.identification.is_some() {
        parts.push(match mass.push_ci95_kg {
            Some(bounds) => format!("The push alone, whatever the prior: {} (95 %).", bounds_text(bounds)),
            None => "The push alone says nothing of the mass: the prior stays as it is.".to_owned(),
        });
    }
    parts.extend(grip_text(mass).map(|grip| format!("Grasps are made {grip}.")));
    page.list(&parts);
    page.plots(&[posterior_plot(mass)]);
    let Some(result) = &mass.identification else { return };
    page.paragraph(&format!(
        "The pushes say: {}",
        verdict_text(result).lines().take(2).collect::<Vec<_>>().join(" — ").replace("—   ", "— ")
    ));
    if result.profile.len() > 2 {
        page.plots(&[profile_plot(result)]);
    }
    tables(page, result);
    page.section(if result.pushes.len() == 1 { "Push" } else { "Pushes" });
    residuals(page, result);
    for (i, push) in result.pushes.iter().enumerate() {
        page.subsection(&push.name);
        let replay = replays.get(i).and_then(Option::as_ref);
        let viewer = replay.map_or_else(String::new, |r| r.show(page));
        let mut plots = push_plots(push);
        plots.extend(replay.and_then(Replay::force_plot));
        page.plots_of(&viewer, &plots);
        page.list(&push.notes);
    }
}

/// How well each push is explained.
fn residuals(page: &mut Page, result: &Identification) {
    let rows: Vec<Vec<String>> = result
        .pushes
        .iter()
        .map(|p| {
            vec![
                p.name.clone(),
                p.times_s.len().to_string(),
                format!("{:.2} / {:.2}", 1e3 * p.position_sd_m, p.rotation_sd_rad.to_degrees()),
                p.rms_position_m.map_or("-".into(), |v| format!("{:.2}", 1e3 * v)),
                p.rms_rotation_rad.map_or("-".into(), |v| format!("{:.2}", v.to_degrees())),
                p.outliers.to_string(),
            ]
        })
        .collect();
    page.table(
        &["push", "poses", "noise taken, mm / deg", "residual, mm (rms)", "residual, deg (rms)", "outliers"],
        &rows,
    );
}

/// Where the interval comes from, and what else was estimated and assumed.
fn tables(page: &mut Page, result: &Identification) {
    if let Some(b) = &result.error_budget {
        let percent = |v: f64| format!("{:.2} %", 100.0 * v);
        page.table(
            &[
                "standard deviation of the mass from",
                "poses",
                "encoder",
                "force record",
                "contact and time step",
                "start, clock and what else was stated",
                "simulators differ",
            ],
            &[vec![
                String::new(),
                percent(b.poses),
                percent(b.encoder),
                percent(b.force),
                percent(b.contact),
                percent(b.stated),
                percent(b.simulator),
            ]],
        );
    }
    if !result.sensitivities.is_empty() {
        let rows: Vec<Vec<String>> =
            result.sensitivities.iter().map(|s| vec![s.parameter.as_str().to_owned(), sensitivity_text(s)]).collect();
        page.table(&["if this is wrong", "the mass changes by"], &rows);
    }
    if !result.estimates.is_empty() {
        let rows: Vec<Vec<String>> = result
            .estimates
            .iter()
            .map(|e| vec![e.parameter.as_str().to_owned(), format!("{:.4}", e.value), parameter_deviation_text(e)])
            .collect();
        page.table(&["estimated along with the mass", "value", "standard deviation"], &rows);
    }
    page.list(&result.assumptions.iter().map(|a| format!("Assumed: {a}")).collect::<Vec<_>>());
}

/// Prior, push and posterior over the mass.
fn posterior_plot(mass: &MassFile) -> String {
    // Below e^-8 of its maximum a density is nothing to the eye.
    let curve = |d: MassDistribution| -> (Vec<f64>, Vec<f64>) {
        d.costs().filter(|p| p.1 < 8.0).map(|(kg, cost)| (1e3 * kg, (-cost).exp())).unzip()
    };
    let prior = mass.prior.as_ref().and_then(|p| p.distribution().ok());
    let push = mass.identification.as_ref().and_then(Identification::likelihood);
    let all = [("prior", prior), ("push", push), ("posterior", Some(mass.posterior.clone()))];
    let curves: Vec<_> = all.into_iter().filter_map(|(label, d)| Some((label, curve(d?)))).collect();
    let series =
        curves.iter().zip(COLORS).map(|((label, (x, y)), color)| Series { label, x, y, color, dots: false }).collect();
    Plot {
        title: "What is known of the mass; shaded: 95 % interval of the posterior",
        x_label: "mass, g",
        y_label: "density over log mass, maximum 1",
        series,
        log_x: true,
        marks: vec![(1e3 * mass.mass_kg, format!("{:.1} g", 1e3 * mass.mass_kg))],
        band: Some((1e3 * mass.ci95_kg[0], 1e3 * mass.ci95_kg[1])),
        ..Plot::default()
    }
    .to_svg()
}

/// What the pushes say of the mass: the law of its logarithm where there is an interval, else the costs of the scan.
fn profile_plot(result: &Identification) -> String {
    // Above this a mass is nil for any purpose.
    const NEAR: f64 = 30.0;
    let lowest = result.profile.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let is_law = result.ci95_kg.is_some();
    let points = result.profile.iter().map(|p| (1e3 * p.0, p.1 - lowest));
    // Costs span orders of magnitude over all masses.
    let (x, y): (Vec<f64>, Vec<f64>) = if is_law {
        points.filter(|p| p.1 < NEAR).unzip()
    } else {
        points.map(|(m, c)| (m, (1.0 + c).log10())).unzip()
    };
    Plot {
        title: if is_law { "What the pushes say; shaded: 95 % interval" } else { "Cost over the mass" },
        x_label: "mass, g",
        y_label: if is_law { "minus log density above the best" } else { "log10(1 + cost above the best)" },
        series: vec![
            Series { label: "", x: &x, y: &y, color: COLORS[0], dots: false },
            Series { label: "", x: &x, y: &y, color: COLORS[0], dots: true },
        ],
        log_x: !is_law,
        marks: result.mass_kg.map(|m| (1e3 * m, format!("{:.1} g", 1e3 * m))).into_iter().collect(),
        band: result.ci95_kg.map(|[lo, hi]| (1e3 * lo, 1e3 * hi)),
        ..Plot::default()
    }
    .to_svg()
}

/// Displacement and lean of the object, tracked and simulated.
fn push_plots(push: &PushReport) -> Vec<String> {
    // A single tracked pose is noisy; the simulated start is not.
    let Some(start) = push.simulated.first().or(push.observed.first()) else { return Vec::new() };
    let moved =
        |poses: &[[f64; 7]], axis: usize| -> Vec<f64> { poses.iter().map(|p| 1e3 * (p[axis] - start[axis])).collect() };
    let turned = |poses: &[[f64; 7]]| -> Vec<f64> {
        poses.iter().map(|p| (rotation(start).inverse() * rotation(p)).angle().to_degrees()).collect()
    };
    let labels = ["x", "y", "z"];
    let tracked: Vec<Vec<f64>> = (0..3).map(|a| moved(&push.observed, a)).collect();
    let simulated: Vec<Vec<f64>> = (0..3).map(|a| moved(&push.simulated, a)).collect();
    let mut series = Vec::new();
    for a in 0..3 {
        series.push(Series { label: labels[a], x: &push.times_s, y: &tracked[a], color: COLORS[a], dots: true });
        if !push.simulated.is_empty() {
            series.push(Series { label: "", x: &push.times_s, y: &simulated[a], color: COLORS[a], dots: false });
        }
    }
    let how = if push.simulated.is_empty() { "tracked" } else { "dots tracked, lines simulated" };
    let title = format!("{}: displacement ({how})", push.name);
    let displacement = Plot { title: &title, x_label: "time, s", y_label: "mm", series, ..Plot::default() }.to_svg();

    let (tracked, simulated) = (turned(&push.observed), turned(&push.simulated));
    let mut series = vec![Series { label: "tracked", x: &push.times_s, y: &tracked, color: COLORS[0], dots: true }];
    if !push.simulated.is_empty() {
        series.push(Series { label: "simulated", x: &push.times_s, y: &simulated, color: COLORS[1], dots: false });
    }
    let title = format!("{}: rotation since the start", push.name);
    let rotation = Plot { title: &title, x_label: "time, s", y_label: "degrees", series, ..Plot::default() }.to_svg();
    let mut plots = vec![displacement, rotation];
    plots.extend(residual_plot(push));
    plots.extend(information_plot(push));
    plots
}

/// What the simulation leaves unexplained at each pose, in standard deviations of the tracker.
fn residual_plot(push: &PushReport) -> Option<String> {
    if push.simulated.len() != push.observed.len() {
        return None;
    }
    let bias = Vector3::from(push.position_bias_m.unwrap_or_default());
    let pairs = || push.observed.iter().zip(&push.simulated);
    let place = |p: &[f64; 7]| Vector3::new(p[0], p[1], p[2]);
    let shift: Vec<f64> =
        pairs().map(|(o, s)| (place(o) - place(s) - bias).norm() / (3.0_f64.sqrt() * push.position_sd_m)).collect();
    let turn: Vec<f64> =
        pairs().map(|(o, s)| rotation(s).angle_to(&rotation(o)) / (3.0_f64.sqrt() * push.rotation_sd_rad)).collect();
    let title = format!("{}: residuals", push.name);
    let series = vec![
        Series { label: "position", x: &push.times_s, y: &shift, color: COLORS[0], dots: true },
        Series { label: "rotation", x: &push.times_s, y: &turn, color: COLORS[1], dots: true },
    ];
    let y_label = "standard deviations (rms of three axes)";
    Some(Plot { title: &title, x_label: "time, s", y_label, series, ..Plot::default() }.to_svg())
}

/// Which poses tell the mass.
fn information_plot(push: &PushReport) -> Option<String> {
    let share: Vec<f64> = push.information.iter().map(|i| 100.0 * i).collect();
    if share.len() != push.times_s.len() || share.is_empty() {
        return None;
    }
    let title = format!("{}: which poses tell the mass", push.name);
    let series = vec![
        Series { label: "", x: &push.times_s, y: &share, color: COLORS[2], dots: false },
        Series { label: "", x: &push.times_s, y: &share, color: COLORS[2], dots: true },
    ];
    Some(
        Plot { title: &title, x_label: "time, s", y_label: "% of the information", series, ..Plot::default() }.to_svg(),
    )
}

fn rotation(pose: &[f64; 7]) -> UnitQuaternion<f64> {
    let q = Quaternion::from_parts(pose[3], Vector3::new(pose[4], pose[5], pose[6]));
    UnitQuaternion::from_quaternion(q)
}
