//! Demonstrations of people to grasps on the object: the person's key points on the robot hand, with contacts.

use std::path::Path;

use crate::Result;
use crate::error::{Context, refuse};
use crate::manifest::GraspsConfig;
use drex_demo::{Demonstration, LoadOptions};
use drex_grasp::{EvaluationOptions, HandSurface, evaluate_with};
use drex_retarget::{
    AugmentOptions, Augmentation, GraspFrame, GraspOptions, GraspRetargeting, TargetHand, augment, retarget_grasp,
};
use nalgebra::{Unit, Vector3};
use rayon::prelude::*;

use crate::Progress;
use crate::Twin;
use crate::records::{ClipRecord, FitRecord, FitSource};
use crate::scene::Scene;

/// The held frames of every demonstration and the grasps made of them.
pub(crate) fn make(
    twin: &Twin,
    config: &GraspsConfig,
    scene: &Scene,
    progress: &dyn Progress,
) -> Result<(Vec<FitRecord>, Vec<ClipRecord>)> {
    let files = twin.demonstrations()?;
    let hand = hand(twin, config)?;
    let options = GraspOptions::default();
    let writer = Writer::new(scene, &options)?;
    let (mut records, mut clips) = (Vec::new(), Vec::new());
    progress.begin("grasps", Some(files.len() as u64));
    for file in &files {
        let clip = Clip::of(twin, config, scene, &hand, file, &options)?;
        let name = file.strip_prefix(&twin.root).unwrap_or(file).to_string_lossy().replace('\\', "/");
        clips.push(ClipRecord {
            file: name.clone(),
            frames: clip.grasps.frames.len(),
            held: clip.grasps.frames.iter().filter(|f| f.held).count(),
            accepted: 0,
            scale: clip.grasps.plain.scale.scale,
            attempts: clip.more.as_ref().map_or(0, |m| m.attempts),
            augmented: clip.more.as_ref().map_or(0, |m| m.grasps.len()),
            notes: clip.demo.notes.clone(),
        });
        clip.demo.notes.iter().for_each(|note| progress.note(&format!("{:>10}  {name}: {note}", "note")));
        let made = clip.records(&name, &writer)?;
        if let Some(c) = clips.last_mut() {
            c.accepted = made.iter().filter(|r| r.accepted && !r.is_augmented()).count();
        }
        records.extend(made);
        progress.step();
    }
    progress.end();
    if records.is_empty() {
        refuse!(
            "in no frame of {} does a fingertip come near the object while it is held: check the poses of the object, which are \
             those of the frame of the mesh, and the unit of the mesh",
            twin.path(&config.file).display()
        );
    }
    records.iter_mut().enumerate().for_each(|(i, r)| r.demonstration = i);
    Ok((records, clips))
}

fn hand(twin: &Twin, config: &GraspsConfig) -> Result<TargetHand> {
    let file = twin.path(&config.hand);
    let hand = if file.is_file() { TargetHand::load(&file, None) } else { TargetHand::resolve(&config.hand) };
    hand.with_context(|| format!("[grasps] hand = \"{}\"", config.hand))
}

/// An object that stands this far from the manifest's resting pose stands otherwise.
const TILTED_RAD: f64 = 0.5;

/// One demonstration and what was made of it.
struct Clip {
    demo: Demonstration,
    grasps: GraspRetargeting,
    more: Option<Augmentation>,
}

impl Clip {
    fn of(
        twin: &Twin,
        config: &GraspsConfig,
        scene: &Scene,
        hand: &TargetHand,
        file: &Path,
        options: &GraspOptions,
    ) -> Result<Self> {
        let mut demo = Demonstration::load(file, &LoadOptions::default())?;
        if demo.side != hand.side {
            // The mirror image would be another model than the one that the next stages load.
            refuse!(
                "{} is of a {} hand and [grasps] hand = \"{}\" is a {} one: name the {} hand there (the bundled ones are \
                 leap_{side} and allegro_{side})",
                file.display(),
                demo.side,
                config.hand,
                hand.side,
                demo.side,
                side = demo.side,
            );
        }
        // A recording that does not say where up is begins with the object on its table.
        let first = demo.frames.iter().find_map(|f| f.source_from_object);
        let up = Unit::try_new(Vector3::from(twin.manifest.object.up_in_mesh), 1e-9);
        if let (Some(recorded), Some(pose), Some(up)) = (demo.up, first, up) {
            let recorded = pose.rotation.inverse() * recorded;
            if recorded.angle(&up) > TILTED_RAD {
                demo.notes.push(format!(
                    "the recording begins with [{:.2}, {:.2}, {:.2}] of the mesh pointing up; the manifest's up_in_mesh is another \
                     resting pose, in which the person's hand may be inside the table",
                    recorded.x, recorded.y, recorded.z
                ));
            }
        }
        demo.up = demo.up.or_else(|| first.zip(up).map(|(pose, up)| pose.rotation * up));
        let at = || format!("{}", file.display());
        let grasps = retarget_grasp(&demo, hand, &scene.object, options).with_context(at)?;
        // Without a frame that holds there is nothing to vary; its reasons say why.
        let holds = grasps.frames.iter().any(|f| f.is_accepted() && f.evaluation.force_closure);
        let more = match config.augment.filter(|_| holds) {
            Some(count) => {
                let mut vary = AugmentOptions::default();
                (vary.grasp, vary.seed) = (options.clone(), twin.seed);
                Some(augment(&grasps, hand, &scene.object, &vary, count).with_context(at)?)
            }
            None => None,
        };
        Ok(Self { demo, grasps, more })
    }

    /// A record per held frame, then one per grasp made of them.
    fn records(&self, file: &str, writer: &Writer<'_>) -> Result<Vec<FitRecord>> {
        let source = |frame: usize, symmetry| FitSource {
            file: file.to_owned(),
            frame: self.demo.frames[frame].index,
            symmetry,
        };
        let held = (0..self.grasps.frames.len()).filter(|&i| self.grasps.frames[i].held);
        let own = held.map(|i| (&self.grasps.frames[i], &self.grasps.plain.frames[i].q, source(i, None)));
        let made = self.more.iter().flat_map(|m| &m.grasps).map(|g| {
            (&g.grasp, &self.grasps.frames[g.source_frame].grasp.joints_rad, source(g.source_frame, Some(g.symmetry)))
        });
        let all: Vec<_> = own.chain(made).collect();
        all.into_par_iter().map(|(grasp, before, source)| writer.record(grasp, before, source)).collect()
    }
}

/// Measures what the retargeting does not know of: the table, and the weight at rest on it.
struct Writer<'a> {
    scene: &'a Scene,
    surface: HandSurface,
    /// Those of the frames, on the table.
    limits: EvaluationOptions,
}

impl<'a> Writer<'a> {
    fn new(scene: &'a Scene, options: &GraspOptions) -> Result<Self> {
        let mut limits = options.limits.clone();
        limits.min_table_clearance_m = EvaluationOptions::demonstrated().min_table_clearance_m;
        Ok(Self { scene, surface: HandSurface::new(&scene.robot, limits.contact.spacing_m)?, limits })
    }

    /// `before` are the joints that the grasp was corrected from.
    fn record(&self, frame: &GraspFrame, before: &[f64], source: FitSource) -> Result<FitRecord> {
        let Scene { robot, object, .. } = self.scene;
        let grasp = &frame.grasp;
        let evaluation = evaluate_with(&self.surface, grasp, object, robot, &self.limits)?;
        let correction_rad = grasp.joints_rad.iter().zip(before).map(|(q, b)| q - b).collect();
        let mut record = FitRecord::of(0, grasp, &evaluation, correction_rad, object.weight_n());
        // What the evaluation does not know: how far the robot's hand is from the person's.
        record.reasons.extend(frame.reasons.iter().filter(|r| !frame.evaluation.failures.contains(r)).cloned());
        record.accepted = record.reasons.is_empty();
        record.touching = frame.fingers.iter().filter(|f| f.touches).map(|f| f.finger.name().to_owned()).collect();
        Ok(FitRecord { source: Some(source), ..record })
    }
}
