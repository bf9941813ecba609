//! Human demonstrations.

use crate::Result;
use std::path::PathBuf;

use drex_core::fsutil;
use drex_robot::Robot;

use super::page::Page;
use crate::picture::clip::{self, Posed};
use drex_twin::records::{FitFile, FitRecord};
use drex_twin::{Twin, records as files};

/// The contact sheet shows every so many frames one.
const SHEET_EVERY: usize = 10;

/// Draws the demonstrated frames that hold the object, if there are any; names the file.
pub fn write_sheet(twin: &Twin) -> Result<Option<PathBuf>> {
    let Some(config) = &twin.manifest.grasps else { return Ok(None) };
    let fits: FitFile = files::read_json(&twin.path(files::FITS))?;
    if fits.clips.is_empty() {
        return Ok(None);
    }
    let robot = Robot::resolve(&config.hand, &twin.root)?;
    let asset = twin.asset()?;
    let rest = asset.world_from_mesh_at_rest;
    let mut posed = Vec::new();
    for fit in fits.grasps.iter().filter(|f| !f.is_augmented()).step_by(SHEET_EVERY) {
        let world_from_base = rest * fit.object_from_base.to_pose()?;
        let frame = fit.source.as_ref().map_or(fit.demonstration, |s| s.frame);
        posed.push(Posed { frame, q: &fit.joints_rad, world_from_base, world_from_object: Some(rest) });
    }
    let path = twin.output(files::SHEET)?;
    clip::write(&path, &robot, Some(&asset.visual), &posed, 1)?;
    Ok(Some(path))
}

/// What was done with the clips, and the hand in them.
pub fn section(page: &mut Page, twin: &Twin, fits: &FitFile) -> Result<()> {
    let total = |f: &dyn Fn(&files::ClipRecord) -> usize| fits.clips.iter().map(f).sum::<usize>();
    let count = |holds: &dyn Fn(&FitRecord) -> bool| fits.grasps.iter().filter(|g| holds(g)).count();
    let augmented = count(&|g| g.is_augmented() && g.accepted);
    let more = match total(&|c| c.attempts) {
        0 => String::new(),
        attempts => format!(
            " From the accepted frames that hold the object, {attempts} variants were tried (turned by the symmetries of the \
             object, with noise, solved again); {augmented} of them are further grasps."
        ),
    };
    page.paragraph(&format!(
        "The recordings hold key points of a person\u{2019}s hand and poses of the object. The key points are mapped to the robot \
         hand, and in the frames in which the person holds the object, wrist and joints are solved so that thumb and fingers lie \
         on the surface, without penetration, close to the person\u{2019}s pose. Of {} frames in {} the object is held in \
         {}; {} of these keep the rules.{more} The contacts of {} of the {} accepted grasps can carry the object at friction {}.",
        total(&|c| c.frames),
        if fits.clips.len() == 1 { "one recording".to_owned() } else { format!("{} recordings", fits.clips.len()) },
        total(&|c| c.held),
        total(&|c| c.accepted),
        count(&|g| g.accepted && g.grip_force_per_weight.is_some()),
        fits.accepted,
        twin.friction(),
    ));
    let rows: Vec<Vec<String>> = fits
        .clips
        .iter()
        .map(|c| {
            let numbers = [c.frames, c.held, c.accepted, c.augmented].map(|n| n.to_string());
            std::iter::once(c.file.clone()).chain(numbers).chain([format!("{:.2}", c.scale)]).collect()
        })
        .collect();
    page.table(&["recording", "frames", "held", "accepted", "made of them", "robot hand per person\u{2019}s"], &rows);
    page.list(&fits.clips.iter().flat_map(|c| c.notes.iter().map(|n| format!("{}: {n}", c.file))).collect::<Vec<_>>());
    let sheet = fsutil::read_bytes(&twin.path(files::SHEET))?;
    page.pictures(&[(
        sheet,
        "The retargeted hand in every 10th frame in which the object is held, with the number of the frame.".to_owned(),
    )]);
    Ok(())
}
