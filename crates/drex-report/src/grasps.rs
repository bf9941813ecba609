//! Demonstrations, training and predicted grasps.

use std::collections::BTreeMap;

use crate::Result;
use drex_core::Pose;
use drex_mesh::Asset;
use drex_robot::Robot;

use super::object::OBJECT_COLOR;
use super::page::Page;
use super::people;
use crate::picture::hand::HandShapes;
use crate::picture::plot::{COLORS, Plot, Series};
use crate::picture::raster::{Part, View, clearest_azimuth, render_png};
use drex_core::stats::median;
use drex_grasp::{GraspOrigin, OriginCounts};
use drex_trial::DemonstrationCounts;
use drex_twin::Twin;
use drex_twin::records::{EvaluatedGrasp, Evaluation, FitFile, FitRecord, LearnedGrasp, PracticeRecord, Training};

/// Fits that push the object out of the hand by less than this hold it between the fingers.
const PUSHED_OUT: f64 = 0.1;
/// Pictures per row of grasps.
const SHOWN: usize = 4;

/// What became of the demonstrations.
pub fn demonstrations(page: &mut Page, twin: &Twin, asset: &Asset, fits: &FitFile) -> Result<()> {
    page.section("Demonstrated grasps on the object");
    if fits.clips.is_empty() {
        of_robot(page, fits);
    } else {
        people::section(page, twin, fits)?;
    }
    let stage = Stage::new(twin, asset)?;
    let mut accepted: Vec<_> = fits.grasps.iter().filter(|g| g.accepted).collect();
    accepted.sort_by(|a, b| a.largest_correction_rad.total_cmp(&b.largest_correction_rad));
    let mut pictures = Vec::new();
    for grasp in accepted.iter().step_by((accepted.len() / SHOWN).max(1)).take(SHOWN) {
        let from = match &grasp.source {
            Some(s) if grasp.is_augmented() => format!("made of frame {} of {}", s.frame, s.file),
            Some(s) => format!("frame {} of {}", s.frame, s.file),
            None => format!("demonstration {}", grasp.demonstration),
        };
        let caption = format!(
            "{from}: {} on the surface, corrected by up to {:.2} rad",
            grasp.touching.join(", "),
            grasp.largest_correction_rad
        );
        pictures.push((stage.picture(&grasp.joints_rad, &grasp.object_from_base.to_pose()?)?, caption));
    }
    page.pictures(&pictures);
    let mut why: BTreeMap<String, usize> = BTreeMap::new();
    for reason in fits.grasps.iter().flat_map(|g| &g.reasons) {
        // The same reason with other numbers is the same reason.
        let kind: String = reason.chars().map(|c| if c.is_ascii_digit() { '#' } else { c }).collect();
        *why.entry(kind.replace("##", "#").replace("##", "#").replace("#.#", "#")).or_default() += 1;
    }
    if !why.is_empty() {
        let mut rows: Vec<(String, usize)> = why.into_iter().collect();
        rows.sort_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        let rows: Vec<Vec<String>> = rows.into_iter().take(8).map(|(k, n)| vec![k, n.to_string()]).collect();
        let what = if fits.clips.is_empty() { "a demonstration" } else { "a frame" };
        page.table(&[&format!("why {what} was left out"), "times"], &rows);
    }
    Ok(())
}

fn of_robot(page: &mut Page, fits: &FitFile) {
    let count = |holds: &dyn Fn(&FitRecord) -> bool| fits.grasps.iter().filter(|g| g.accepted && holds(g)).count();
    page.paragraph(&format!(
        "The recordings hold joint angles only. For each, the pose of the hand is solved so that the thumb and at least two \
         fingers lie on the surface, the hand stays above the table and penetrates by at most 2 mm, with finger corrections of at \
         most 0.15 rad. {} of {} demonstrations can be placed like this; the contacts of {} of these can carry the object at all, \
         and in {} the object lies between the fingers rather than being pressed from one side.",
        fits.accepted,
        fits.demonstrations,
        count(&|g| g.grip_force_per_weight.is_some()),
        count(&|g| g.pushed_out.is_some_and(|p| p < PUSHED_OUT)),
    ));
}

/// What was learned, curve and errors of the training.
pub fn training(page: &mut Page, twin: &Twin, asset: &Asset, training: &Training) -> Result<()> {
    page.section("The network");
    let r = &training.report;
    let row = |what: &str, o: &OriginCounts| {
        vec![
            what.to_owned(),
            o.demonstrated.to_string(),
            o.refined.to_string(),
            o.searched.to_string(),
            o.total().to_string(),
        ]
    };
    page.table(
        &["grasps", "demonstrated", "refined", "searched", "all"],
        &[row("tried", &training.tried), row("learned", &training.learned)],
    );
    page.paragraph(
        "Demonstrated grasps are those of the recordings; refined ones were made of them, by the object's symmetries or by small changes \
         that held better in simulation; searched ones were found without a demonstration.",
    );
    if training.learned.demonstrated == 0 {
        page.paragraph(&format!(
            "None of the grasps that the network learned was demonstrated{}.",
            if training.learned.refined == 0 { ", nor made of one that was" } else { "" }
        ));
    }
    if let Some(practice) = &training.practice {
        learned(page, &Stage::new(twin, asset)?, practice)?;
    }
    page.paragraph(&format!(
        "{} parameters, {} samples for training ({} grasps at several masses) and {} held out. From surface points and mass to \
         several modes of joint angles, wrist pose and grip force.",
        r.parameters, r.train_samples, r.train_grasps, r.held_out_samples
    ));
    let x: Vec<f64> = r.curve.iter().map(|e| e.epoch as f64).collect();
    let column = |f: fn(&drex_policy::EpochStats) -> f64| -> Vec<f64> {
        r.curve.iter().map(|e| f(e).max(1e-9).log10()).collect()
    };
    let (joints, wrist, force) = (column(|e| e.joint_loss), column(|e| e.wrist_loss), column(|e| e.force_loss));
    let plot = Plot {
        title: "Training",
        x_label: "epoch",
        y_label: "log10(loss)",
        series: vec![
            Series { label: "joints", x: &x, y: &joints, color: COLORS[0], dots: false },
            Series { label: "wrist", x: &x, y: &wrist, color: COLORS[1], dots: false },
            Series { label: "force", x: &x, y: &force, color: COLORS[2], dots: false },
        ],
        ..Plot::default()
    };
    page.plots(&[plot.to_svg()]);
    if let (Some(held_out), Some(b)) = (&r.held_out, &r.baselines) {
        let row = |name: &str, e: &drex_policy::GraspErrors| {
            vec![
                name.to_owned(),
                format!("{:.3}", e.joint_rms_rad),
                format!("{:.1}", 1e3 * e.wrist_m),
                format!("{:.1}", e.wrist_rad.to_degrees()),
                format!("{:.1} %", 100.0 * e.force_relative),
            ]
        };
        page.table(
            &["nearest answer to held-out grasps", "joints, rad (rms)", "wrist, mm", "wrist, deg", "force"],
            &[
                row("the network's modes", held_out),
                row("mean demonstration", &b.mean_demonstration),
                row("as many random demonstrations", &b.random_demonstrations),
                row("nearest demonstration of all", &b.nearest_demonstration),
            ],
        );
    }
    Ok(())
}

/// How far the demonstrations came in simulation, and the grasps that were learned.
fn learned(page: &mut Page, stage: &Stage<'_>, practice: &PracticeRecord) -> Result<()> {
    let DemonstrationCounts { demonstrated, as_demonstrated, commanded, held, selected } = practice.demonstrations;
    if demonstrated > 0 {
        page.paragraph(&format!(
            "Of {demonstrated} distinct demonstrated grasps and variants of them the motors can hold the object with {as_demonstrated} as they are and \
             with {commanded} after a local refinement, once the hand has closed; of those that were lifted, held and shaken {held} held under most \
             conditions, and {selected} were learned."
        ));
    }
    let row = |g: &LearnedGrasp| {
        let change = g.change.map_or(vec!["-".to_owned(); 3], |c| {
            vec![
                format!("{:.2}", c.joint_rad),
                format!("{:.1}", 1e3 * c.base_m),
                format!("{:.1}", c.base_rad.to_degrees()),
            ]
        });
        let origin = match g.grasp.origin {
            GraspOrigin::Retargeted => "demonstrated",
            GraspOrigin::Refined => "refined",
            GraspOrigin::Power | GraspOrigin::Pinch => "searched",
            GraspOrigin::Predicted => "predicted",
        };
        let [held, of] = g.held;
        [vec![origin.to_owned(), format!("{held} of {of}")], change].concat()
    };
    page.table(
        &["learned", "held under", "joints changed by up to, rad", "wrist moved, mm", "wrist turned, deg"],
        &practice.learned.iter().map(row).collect::<Vec<_>>(),
    );
    let mut pictures = Vec::new();
    for (g, demonstration) in
        practice.learned.iter().filter_map(|g| Some((g, g.demonstration.as_ref()?))).take(SHOWN / 2)
    {
        let before = stage.picture(&demonstration.joints_rad, &demonstration.object_from_base)?;
        let what = match demonstration.origin {
            GraspOrigin::Retargeted => "as demonstrated, on the object",
            _ => "a variant of a demonstrated grasp, before it was refined",
        };
        pictures.push((before, what.to_owned()));
        let after = stage.picture(&g.grasp.joints_rad, &g.grasp.object_from_base)?;
        pictures.push((after, format!("as it held under {} of {} conditions", g.held[0], g.held[1])));
    }
    page.pictures(&pictures);
    Ok(())
}

/// The predicted grasps and the static check.
pub fn evaluation(page: &mut Page, twin: &Twin, asset: &Asset, e: &Evaluation) -> Result<()> {
    page.section("Predicted grasps, static check");
    page.paragraph(&format!(
        "Judged at {:.1} g, which grasps are made for, and friction {}: contacts of thumb and at least two fingers, penetration, force closure, and the \
         minimum grip force that carries the weight within the motors' torque. This is a static check of geometry and forces: \
         nothing was lifted for it, in simulation or on a robot.",
        1e3 * e.mass_kg,
        e.friction
    ));
    let stage = Stage::new(twin, asset)?;
    let mut best: Vec<&EvaluatedGrasp> = e.refined.iter().collect();
    best.sort_by(|a, b| {
        b.check.passed.cmp(&a.check.passed).then(b.weight.unwrap_or(0.0).total_cmp(&a.weight.unwrap_or(0.0)))
    });
    let mut pictures = Vec::new();
    for grasp in best.iter().take(SHOWN) {
        let caption = match (grasp.check.passed, grasp.check.grip_force_n) {
            (true, Some(n)) => format!(
                "passes: grip force {n:.2} N, network asks for {:.2} N",
                grasp.predicted_grip_force_n.unwrap_or(f64::NAN)
            ),
            _ => format!("fails: {}", grasp.check.failures.join("; ")),
        };
        pictures.push((stage.picture(&grasp.joints_rad, &grasp.object_from_base.to_pose()?)?, caption));
    }
    page.pictures(&pictures);
    let rows: Vec<Vec<String>> =
        [("as predicted", &e.predicted), ("refined on the surface", &e.refined), ("demonstrations", &e.demonstrations)]
            .into_iter()
            .map(|(name, grasps)| {
                let of = |f: &dyn Fn(&EvaluatedGrasp) -> Option<f64>| {
                    median(grasps.iter().filter_map(f)).map_or("-".to_owned(), |v| format!("{v:.2}"))
                };
                vec![
                    name.to_owned(),
                    super::summary::passed(grasps),
                    of(&|g| Some(g.check.penetration_mm)),
                    format!("{}", grasps.iter().filter(|g| g.check.force_closure).count()),
                    of(&|g| g.check.grip_force_n),
                    of(&|g| g.predicted_grip_force_n),
                    of(&|g| g.check.friction_margin),
                ]
            })
            .collect();
    page.table(
        &[
            "grasps",
            "pass",
            "penetration, mm",
            "force closure",
            "minimum grip force, N",
            "network's grip force, N",
            "friction margin",
        ],
        &rows,
    );
    let rows: Vec<Vec<String>> = e
        .refined
        .iter()
        .enumerate()
        .map(|(i, g)| {
            let contacts: Vec<String> = g
                .check
                .fingers
                .iter()
                .filter(|c| c.contacts > 0)
                .map(|c| format!("{} {}", c.finger, c.contacts))
                .collect();
            vec![
                (i + 1).to_string(),
                g.weight.map_or("-".into(), |w| format!("{:.2}", w)),
                if g.check.passed { "pass".into() } else { g.check.failures.join("; ") },
                contacts.join(", "),
                format!("{:.2}", g.check.penetration_mm),
                g.check.grip_force_n.map_or("-".into(), |v| format!("{v:.2}")),
                g.predicted_grip_force_n.map_or("-".into(), |v| format!("{v:.2}")),
            ]
        })
        .collect();
    page.table(
        &[
            "mode",
            "weight",
            "static check",
            "contacts",
            "penetration, mm",
            "minimum grip force, N",
            "network's grip force, N",
        ],
        &rows,
    );
    Ok(())
}

/// The object on its table, ready for pictures with the hand.
struct Stage<'a> {
    robot: Robot,
    shapes: HandShapes,
    asset: &'a Asset,
    world_from_object: Pose,
}

impl<'a> Stage<'a> {
    fn new(twin: &Twin, asset: &'a Asset) -> Result<Self> {
        let hand = twin.manifest.grasps.as_ref().map_or("leap_right", |g| g.hand.as_str());
        let robot = Robot::resolve(hand, &twin.root)?;
        Ok(Self { shapes: HandShapes::new(&robot), robot, asset, world_from_object: asset.world_from_mesh_at_rest })
    }

    fn picture(&self, joints: &[f64], object_from_base: &Pose) -> Result<Vec<u8>> {
        let links = self.robot.forward_kinematics(joints, &(self.world_from_object * object_from_base));
        let mut parts = self.shapes.parts(&links);
        parts.push(Part {
            mesh: &self.asset.visual,
            world_from_mesh: self.world_from_object,
            color: OBJECT_COLOR,
            texture: None,
        });
        let view = View { width: 420, height: 340, azimuth: 0.0, elevation: 0.45, table_height_m: Some(0.0) };
        let azimuth = clearest_azimuth(&parts, parts.len() - 1, &view);
        render_png(&parts, &View { azimuth, ..view })
    }
}
