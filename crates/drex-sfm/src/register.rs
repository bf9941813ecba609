//! From photos to models, or to a verdict.

use drex_core::capture::Capture;

use crate::cameras::Group;
use crate::front_end::{
    FrontEnd, InputPhoto, LEAST_PHOTOS, LEAST_PHOTOS_OF_ONLY, RegisterOptions, SMALL_SET, Step, components,
};
use crate::mapping::{self, Mapped, Scene};
use crate::matching::PairMatches;
use crate::refine::refine;
use crate::report::Report;
use crate::verdict::{Cause, Verdict};
use crate::verify::Pair;

/// Cameras and points of photos.
#[derive(Debug, Clone, PartialEq)]
pub struct Registration {
    /// One model per scene, the one with the most photos first. Each has its own frame and unit of length.
    pub models: Vec<Capture>,
    /// What happened to each photo, and what to trust.
    pub report: Report,
}

/// Photos are looked at more closely when fewer than this share of them could be registered.
const ENOUGH_SHARE: f64 = 0.9;

/// Finds the cameras of photos, and the points that they show.
///
/// # Errors
/// A [`Verdict`] that says why no camera can be trusted, and what to do.
pub fn register(
    photos: &[InputPhoto],
    options: &RegisterOptions,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Registration, Verdict> {
    // In a thread of the pool: the matches, tables and models that follow take the room that the workers' descriptors leave.
    rayon::scope(|_| register_in_pool(photos, options, progress))
}

fn register_in_pool(
    photos: &[InputPhoto],
    options: &RegisterOptions,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Registration, Verdict> {
    let first = attempt(photos, options, false, progress);
    let registered = |r: &Registration| r.models.iter().map(|m| m.views.len()).sum::<usize>();
    let hopeless = |v: &Verdict| matches!(v.cause, Cause::TooFewPhotos | Cause::Input | Cause::Blur);
    match first {
        Ok(done) if registered(&done) as f64 >= ENOUGH_SHARE * photos.len() as f64 => Ok(done),
        Err(verdict) if hopeless(&verdict) => Err(verdict),
        // Few or small photos, or weak texture: a closer look takes four times as long, and often finds the rest.
        first => match (first, attempt(photos, options, true, progress)) {
            (Ok(a), Ok(b)) if registered(&b) > registered(&a) => Ok(b),
            (Err(_), Ok(b)) => Ok(b),
            (first, _) => first,
        },
    }
}

/// A registration with the keypoints of the photos, or of the photos at twice their size.
fn attempt(
    photos: &[InputPhoto],
    options: &RegisterOptions,
    closer: bool,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Registration, Verdict> {
    let mut front = FrontEnd::new(photos, options, closer, progress)?;
    let mut report = Report::new(photos, &front.unreadable);
    let overlap = front.pairs(options, progress)?;
    (report.still_background, report.contradicting_pairs) = (overlap.still_background, overlap.contradicting);
    let (matches, pairs) = (overlap.matches, overlap.pairs);
    front.check_overlap(&pairs)?;
    let models = map_all(&front, &matches, &pairs, options, progress)?;
    if models.is_empty() {
        return Err(front.why_nothing(&pairs));
    }
    let mut captures = Vec::new();
    let mut refused = Vec::new();
    let taken =
        |m: &Mapped| m.reconstruction().registered_views().map(|(id, _)| m.photos[id.index()]).collect::<Vec<_>>();
    let mut left: Vec<usize> = (0..front.photos.len()).collect();
    models.iter().for_each(|m| left.retain(|k| taken(m).binary_search(k).is_err()));
    for mapped in models {
        match refine(&front, mapped, (&matches, &left), options, progress) {
            Ok(refined) => {
                left.retain(|k| refined.model.views.iter().all(|v| v.photo != *k));
                report.add_model(captures.len(), &refined, &front);
                captures.push(refined.capture(&front));
            }
            Err(verdict) => refused.push(verdict),
        }
    }
    if captures.is_empty() {
        return Err(refused.into_iter().next().unwrap_or_else(|| front.why_nothing(&pairs)));
    }
    report.finish(&front, &pairs, refused);
    Ok(Registration { models: captures, report })
}

/// Models of all scenes, the largest first: what one run leaves over is mapped again.
fn map_all(
    front: &FrontEnd,
    matches: &[PairMatches],
    pairs: &[Pair],
    options: &RegisterOptions,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Vec<Mapped>, Verdict> {
    let n = front.photos.len();
    let names: Vec<String> = front.photos.iter().map(|p| p.name.clone()).collect();
    let sizes: Vec<[u32; 2]> = front.headers.iter().map(|h| [h.width, h.height]).collect();
    let lenses = front.groups.iter().map(Group::camera).collect::<Result<Vec<_>, String>>();
    let lenses = lenses.map_err(|e| Verdict::new(Cause::Input, e, "calibrate the camera again"))?;
    let scene = Scene {
        names: &names,
        sizes: &sizes,
        features: &front.features,
        cameras: &lenses,
        camera_of: &front.camera_of,
        calibrated: options.calibration.is_some(),
        seed: options.seed,
    };
    let mut left: Vec<usize> = (0..n).collect();
    let mut models: Vec<Mapped> = Vec::new();
    loop {
        progress(Step { stage: "model", done: n - left.len(), total: n });
        let among = |p: &&Pair| p.views.iter().all(|v| left.binary_search(v).is_ok());
        let own: Vec<&Pair> = pairs.iter().filter(among).collect();
        let Some(largest) = components(n, own.iter().copied()).into_iter().find(|c| c.len() >= LEAST_PHOTOS_OF_ONLY)
        else {
            break;
        };
        let mapped = mapping::map(&scene, matches, &own, &largest);
        let registered: Vec<usize> = match &mapped {
            Ok(m) => m.reconstruction().registered_views().map(|(id, _)| m.photos[id.index()]).collect(),
            Err(_) => Vec::new(),
        };
        let least = if models.is_empty() && n < SMALL_SET { LEAST_PHOTOS_OF_ONLY } else { LEAST_PHOTOS };
        match mapped {
            Ok(m) if registered.len() >= least => {
                left.retain(|k| registered.binary_search(k).is_err());
                models.push(m);
            }
            // Nothing more to be had of these.
            _ => left.retain(|k| largest.binary_search(k).is_err()),
        }
    }
    models.sort_by_key(|m| std::cmp::Reverse(m.reconstruction().registered_view_count()));
    Ok(models)
}
