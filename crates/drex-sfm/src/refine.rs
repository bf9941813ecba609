//! From what the engine mapped to what can be trusted: placed again, refined, adjusted, confirmed, or refused.

use std::collections::BTreeMap;

use drex_core::stats::upper_median;
use rayon::prelude::*;

use crate::adjust::{self, Adjusted, LensFreedom, PoseSigma};
use crate::front_end::{
    Counter, FEW_KEYPOINTS, FrontEnd, LEAST_PHOTOS, LEAST_PHOTOS_OF_ONLY, RegisterOptions, SMALL_SET, Step, only_turned,
};
use crate::mapping::Mapped;
use crate::matching::PairMatches;
use crate::model::{Model, Point, View};
use crate::photos::{self, Grey};
use crate::relocate::{Relocation, relocate};
use crate::subpixel;
use crate::verdict::{Cause, Verdict, count, list};
use crate::verify;

/// Cameras that stand within this share of the scene's distance of each other have only turned.
const LEAST_BASELINE: f64 = 0.05;
/// A rotation that explains this share of a pair's good matches says that the camera only turned.
const TURN_SHARE: f64 = 0.7;
/// A photo has to show this share of the points that its neighbours say it should: right ones show 0.18 to 0.9, one that was placed by a
/// look-alike side 0.10, frames smeared by motion 0 to 0.06.
const CONFIRMED_SHARE: f64 = 0.15;
/// Cameras this close, as a share of the scene's distance, that look the same way but for this angle in radians have not moved.
const SAME_PLACE: f64 = 0.005;
const SAME_DIRECTION: f64 = 0.005;
/// So many others in one photo's place are no accident.
const SAME_PARTNERS: usize = 3;
/// Points that a photo's place has to stand on at the end.
const LEAST_VIEW_POINTS: usize = 12;

/// A refined model.
pub(crate) struct Refined {
    pub(crate) model: Model,
    pub(crate) adjusted: Adjusted,
    pub(crate) sigmas: Option<Vec<PoseSigma>>,
    /// Share of the observations whose pixel was found by aligning patches.
    pub(crate) aligned: f64,
    /// Photos that were taken out again, and why.
    pub(crate) removed: Vec<(usize, String)>,
}

/// Photos that share a lens, at least, for its fuller model; and how much of the cost that has to save.
const FULL_LENS_PHOTOS: usize = 20;
const FULL_LENS_GAIN: f64 = 0.02;

/// Refines a mapped model; `left` are the photos without one.
///
/// # Errors
/// If what is left cannot be trusted.
pub(crate) fn refine(
    front: &FrontEnd,
    mapped: Mapped,
    (matches, left): (&[PairMatches], &[usize]),
    options: &RegisterOptions,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Refined, Verdict> {
    let sizes: Vec<[u32; 2]> = front.headers.iter().map(|h| [h.width, h.height]).collect();
    let mut model = Model::new(&mapped, &sizes);
    // The engine's tables are as large as all photos.
    drop(mapped);
    let lenses: BTreeMap<usize, usize> = model.views.iter().map(|v| (front.camera_of[v.photo], v.lens)).collect();
    let lens_of = |photo: usize| lenses.get(&front.camera_of[photo]).copied();
    let relocation = Relocation { features: &front.features, matches, left, lens_of: &lens_of, seed: options.seed };
    relocate(&mut model, &relocation);
    check_baseline(front, &model)?;
    let counter = Counter::new("sub-pixels", model.views.len(), progress);
    let read = |view: usize| -> Result<(Grey, Colours), String> {
        let (grey, rgb) = photos::read_colours(&front.photos[model.views[view].photo].path)?;
        counter.step();
        let colours = colours_of(&model, view, &grey, &rgb);
        Ok((grey, colours))
    };
    let read: Result<Vec<_>, String> = (0..model.views.len()).into_par_iter().map(read).collect();
    let changed = |e| Verdict::new(Cause::Input, format!("a photo changed while it was used: {e}"), "run it again");
    let (greys, colours): (Vec<Grey>, Vec<_>) = read.map_err(changed)?.into_iter().unzip();
    let greys: BTreeMap<usize, Grey> = model.views.iter().map(|v| v.photo).zip(greys).collect();
    colours.into_iter().flatten().for_each(|(point, rgb)| model.points[point].rgb = rgb);
    let aligned = subpixel::refine(&mut model, &greys);
    // Beside all photos an adjustment of many does not fit into two gigabytes; they are read again for the confirmation.
    drop(greys);
    progress(Step { stage: "adjustment", done: 0, total: 4 });
    let failed = |e: String| {
        Verdict::new(
            Cause::Inconsistent,
            format!("the cameras cannot be adjusted: {e}"),
            "take more photos, with overlap",
        )
    };
    let simple = if options.calibration.is_some() { LensFreedom::Fixed } else { LensFreedom::Simple };
    let mut freedom = simple;
    let mut adjusted = adjust::adjust(&mut model, simple, 20).map_err(failed)?;
    progress(Step { stage: "adjustment", done: 1, total: 4 });
    if simple == LensFreedom::Simple && model.views.len() >= FULL_LENS_PHOTOS * model.lenses.len() {
        let mut fuller = model.clone();
        let with_simple = adjust::adjust(&mut model, simple, 20).map_err(failed)?;
        let with_full = adjust::adjust(&mut fuller, LensFreedom::Full, 20).map_err(failed)?;
        if with_full.gain_over(&with_simple) > FULL_LENS_GAIN {
            (model, freedom) = (fuller, LensFreedom::Full);
        }
    }
    for round in 2..4 {
        progress(Step { stage: "adjustment", done: round, total: 4 });
        adjust::drop_outliers(&mut model);
        adjusted = adjust::adjust(&mut model, freedom, 20).map_err(failed)?;
    }
    progress(Step { stage: "confirmation", done: 0, total: model.views.len() });
    check_turns(front, &model, matches)?;
    let mut removed = drop_weak(&mut model);
    let again = |view: &View| Ok((view.photo, photos::read_grey(&front.photos[view.photo].path)?));
    let greys: Result<BTreeMap<usize, Grey>, String> = model.views.par_iter().map(again).collect();
    removed.extend(drop_unconfirmed(&mut model, &greys.map_err(changed)?));
    if !removed.is_empty() {
        adjust::drop_outliers(&mut model);
        adjusted = adjust::adjust(&mut model, freedom, 20).map_err(failed)?;
        removed.extend(drop_weak(&mut model));
    }
    let least = if front.photos.len() < SMALL_SET { LEAST_PHOTOS_OF_ONLY } else { LEAST_PHOTOS };
    if model.views.len() < least {
        return Err(Verdict::new(
            Cause::Inconsistent,
            format!("only {} of a model could be confirmed", count(model.views.len(), "photo")),
            "take more photos, each overlapping the one before by two thirds",
        ));
    }
    check_baseline(front, &model)?;
    check_still(front, &model)?;
    check_lenses(&model)?;
    // What was not estimated of a lens is not known either: its expected spread counts.
    let uncertain = if freedom == LensFreedom::Fixed { LensFreedom::Fixed } else { LensFreedom::Full };
    let sigmas = adjust::pose_sigmas(&model, uncertain);
    Ok(Refined { model, adjusted, sigmas, aligned, removed })
}

/// Takes out the views that are left with too few points to stand on.
fn drop_weak(model: &mut Model) -> Vec<(usize, String)> {
    let mut gone = Vec::new();
    while let Some((view, n)) = model.counts().into_iter().enumerate().find(|(_, n)| *n < LEAST_VIEW_POINTS) {
        let photo = model.views[view].photo;
        gone.push((photo, format!("its place stands on {} only", count(n, "point"))));
        model.remove(photo);
    }
    gone
}

/// Takes out the views that show too little of what they should; see [`subpixel::confirm`].
fn drop_unconfirmed(model: &mut Model, greys: &BTreeMap<usize, Grey>) -> Vec<(usize, String)> {
    let counts: Vec<[usize; 2]> = (0..model.views.len()).map(|k| subpixel::confirm(model, k, greys)).collect();
    let share = |[yes, no]: [usize; 2]| yes as f64 / (yes + no).max(1) as f64;
    let typical = upper_median(counts.iter().map(|c| share(*c))).unwrap_or(0.0);
    let least = CONFIRMED_SHARE.min(0.5 * typical);
    let mut gone = Vec::new();
    for (view, count) in model.views.iter().zip(&counts) {
        let [shown, expected] = [count[0], count[0] + count[1]];
        if expected >= FEW_KEYPOINTS && share(*count) < least {
            let why = format!(
                "its place cannot be confirmed: of {expected} points that it should show it shows {shown} (motion blur, or a look-alike side \
                 of the object)"
            );
            gone.push((view.photo, why));
        }
    }
    if model.views.len() < gone.len() + LEAST_PHOTOS_OF_ONLY {
        return Vec::new();
    }
    gone.iter().for_each(|(photo, _)| model.remove(*photo));
    gone
}

/// Points and their colours.
type Colours = Vec<(usize, [u8; 3])>;

/// Colours of the points whose first observation is in the view.
fn colours_of(model: &Model, view: usize, grey: &Grey, rgb: &[[u8; 3]]) -> Colours {
    let colour = |(k, p): (usize, &Point)| {
        let o = p.observations.first().filter(|o| o.view == view)?;
        let (x, y) = (o.pixel.x.round() as usize, o.pixel.y.round() as usize);
        Some((k, *rgb.get(y.min(grey.height - 1) * grey.width + x.min(grey.width - 1))?))
    };
    model.points.iter().enumerate().filter_map(colour).collect()
}

/// Median depth of what the photos show, units of the model.
fn typical_depth(model: &Model) -> f64 {
    let of_point = |p: &Point| -> Vec<f64> {
        p.observations.iter().map(|o| (model.views[o.view].camera_from_world * p.position).z).collect()
    };
    upper_median(model.points.iter().flat_map(of_point)).unwrap_or(0.0)
}

/// Refuses cameras that have only turned.
fn check_baseline(front: &FrontEnd, model: &Model) -> Result<(), Verdict> {
    let centres: Vec<_> = model.views.iter().map(View::centre).collect();
    let extent = centres.iter().flat_map(|a| centres.iter().map(move |b| (a - b).norm())).fold(0.0, f64::max);
    let depth = typical_depth(model);
    let names = list(&front.names(model.views.iter().map(|v| v.photo)));
    if model.points.len() < FEW_KEYPOINTS / 2 {
        return Err(only_turned(format!(
            "only {} of what {names} show has a distance",
            count(model.points.len(), "point")
        )));
    }
    if !(extent >= LEAST_BASELINE * depth) {
        let share = 100.0 * extent / depth.max(f64::MIN_POSITIVE);
        return Err(only_turned(format!(
            "the cameras of {names} moved by {share:.1} % of the distance to what they show"
        )));
    }
    Ok(())
}

/// Refuses cameras that have only turned: a rotation explains what the pairs have in common, with the lens as it is known now.
fn check_turns(front: &FrontEnd, model: &Model, matches: &[PairMatches]) -> Result<(), Verdict> {
    let lens: BTreeMap<usize, usize> = model.views.iter().map(|v| (v.photo, v.lens)).collect();
    let turned = |m: &PairMatches| {
        let [a, b] = m.views.map(|v| lens.get(&v));
        let cameras = [model.lenses[*a?].engine_camera()?, model.lenses[*b?].engine_camera()?];
        verify::turn_share(m, &front.features, [&cameras[0], &cameras[1]])
    };
    let shares: Vec<f64> = matches.par_iter().filter_map(turned).collect();
    let turns = shares.iter().filter(|s| **s > TURN_SHARE).count();
    if shares.len() >= 3 && 2 * turns > shares.len() {
        return Err(only_turned(format!(
            "in {turns} of {} pairs of photos the camera only turned: {}",
            shares.len(),
            list(&front.names(model.views.iter().map(|v| v.photo)))
        )));
    }
    Ok(())
}

/// Refuses cameras that hardly ever moved: the object turned, and the model is one of the room behind it.
fn check_still(front: &FrontEnd, model: &Model) -> Result<(), Verdict> {
    let reach = SAME_PLACE * typical_depth(model);
    let at_one_place = |a: &View, b: &View| {
        (a.centre() - b.centre()).norm() < reach
            && a.camera_from_world.rotation.angle_to(&b.camera_from_world.rotation) < SAME_DIRECTION
    };
    // Each is at one place with itself.
    let partners = |a: &&View| model.views.iter().filter(|b| at_one_place(a, b)).count() > SAME_PARTNERS;
    let still: Vec<usize> = model.views.iter().filter(partners).map(|v| v.photo).collect();
    if 2 * still.len() < model.views.len() {
        return Ok(());
    }
    Err(Verdict::new(
        Cause::Inconsistent,
        format!(
            "{} of {} photos were taken from a place that others have too, looking the same way ({}): the object turned and only the \
             background that stands still was recognised, or each view was taken again and again",
            still.len(),
            model.views.len(),
            list(&front.names(still.iter().copied()))
        ),
        "give masks of what turns (--masks) or cover the background; of photos of one view leave all but one out",
    ))
}

/// Refuses lenses that no camera has.
fn check_lenses(model: &Model) -> Result<(), Verdict> {
    for lens in &model.lenses {
        let [f, _, _, k1, ..] = lens.numbers;
        let focal = f / f64::from(lens.width.max(lens.height));
        if !(0.2..=10.0).contains(&focal) || k1.abs() > 1.0 {
            return Err(Verdict::new(
                Cause::Inconsistent,
                format!("the photos fit together only with a focal length of {focal:.2} image widths (k1 {k1:.2})"),
                "give the camera's calibration (--camera K.txt), or take photos from more heights",
            ));
        }
    }
    Ok(())
}
