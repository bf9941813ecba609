//! From photos to models, or to a verdict.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use drex_core::camera::Camera;
use drex_core::capture::Capture;
use drex_core::sets::DisjointSets;
use drex_core::stats::upper_median;
use rayon::prelude::*;

use crate::adjust::{self, Adjusted, LensFreedom, PoseSigma};
use crate::cameras::{self, FocalSource, Group};
use crate::features::{self, Features};
use crate::mapping::{self, Mapped, Scene};
use crate::matching::{Matcher, PairMatches};
use crate::model::Model;
use crate::photos::{self, Grey, Header};
use crate::relocate::{Relocation, relocate};
use crate::report::Report;
use crate::still;
use crate::subpixel;
use crate::triplets;
use crate::verdict::{Cause, Verdict, count, list};
use crate::verify::{self, Geometry, Pair};

/// A photo that is to be registered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputPhoto {
    /// What the model calls it: its path below the photos' folder, with `/`.
    pub name: String,
    /// Its file, PNG or JPEG.
    pub path: PathBuf,
    /// A picture of the photo's aspect in which all that keeps its shape together is white; black pixels are not used.
    pub mask: Option<PathBuf>,
}

/// How photos are registered.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RegisterOptions {
    /// The camera of all photos, where it was calibrated: it is kept. Its size must have the photos' aspect.
    pub calibration: Option<Camera>,
    /// The photos are frames of one video: one camera, and neighbours in the list are neighbours in time.
    pub video: bool,
    /// Keypoints of a photo, at most.
    pub max_keypoints: usize,
    /// Of everything random.
    pub seed: u64,
}

impl Default for RegisterOptions {
    fn default() -> Self {
        Self { calibration: None, video: false, max_keypoints: 8000, seed: 0 }
    }
}

/// How far the work is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// What is being done.
    pub stage: &'static str,
    /// How much of it is done.
    pub done: usize,
    /// How much of it there is.
    pub total: usize,
}

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
/// A model has at least so many photos; the only one of a small set may have fewer.
const LEAST_PHOTOS: usize = 5;
const LEAST_PHOTOS_OF_ONLY: usize = 3;
const SMALL_SET: usize = 20;
/// Cameras that stand within this share of the scene's distance of each other have only turned.
const LEAST_BASELINE: f64 = 0.05;
/// A rotation that explains this share of a pair's good matches says that the camera only turned.
const TURN_SHARE: f64 = 0.7;
/// A photo has to show this share of the points that its neighbours say it should: right ones show 0.18 to 0.9, one that was placed by a
/// look-alike side 0.10, frames smeared by motion 0 to 0.06.
const CONFIRMED_SHARE: f64 = 0.15;
/// Points that a photo's place has to stand on at the end.
const LEAST_VIEW_POINTS: usize = 12;
/// Keypoints that a photo needs to be worth looking at.
const FEW_KEYPOINTS: usize = 60;
/// Photos up to which every pair is compared; of more, the keypoints of each that are compared first, and its best partners by these.
const ALL_PAIRS: usize = 160;
const PREVIEW_KEYPOINTS: usize = 300;
const PARTNERS: usize = 40;
/// Frames of a video are compared with so many before and behind.
const NEIGHBOURS: usize = 8;

/// Finds the cameras of photos, and the points that they show.
///
/// # Errors
/// A [`Verdict`] that says why no camera can be trusted, and what to do.
pub fn register(
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
    let (matches, pairs) = front.pairs(options, progress, &mut report)?;
    front.check_overlap(&pairs)?;
    let models = map_all(&front, &pairs, options, progress)?;
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
        match refine(&front, &mapped, (&matches, &left), options, progress) {
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

/// What is known of all photos before any has a pose.
pub(crate) struct FrontEnd {
    /// Photos that could be read.
    pub(crate) photos: Vec<InputPhoto>,
    /// Names of the others, and why.
    pub(crate) unreadable: Vec<(String, String)>,
    pub(crate) headers: Vec<Header>,
    pub(crate) groups: Vec<Group>,
    pub(crate) camera_of: Vec<usize>,
    pub(crate) features: Vec<Features>,
    masked: bool,
}

impl FrontEnd {
    fn new(
        photos: &[InputPhoto],
        options: &RegisterOptions,
        closer: bool,
        progress: &(dyn Fn(Step) + Sync),
    ) -> Result<Self, Verdict> {
        let masked = photos.iter().filter(|p| p.mask.is_some()).count();
        let counter = Counter::new("keypoints", photos.len(), progress);
        let read = |photo: &InputPhoto| -> Result<(Header, Features), String> {
            let header = photos::read_header(&photo.path)?;
            let grey = photos::read_grey(&photo.path)?;
            let mask = photo.mask.as_ref().map(|m| photos::read_grey(m)).transpose()?;
            if let Some(mask) = &mask {
                photos::check_mask(&grey, mask)?;
            }
            let features = features::extract(&grey, mask.as_ref(), options.max_keypoints, closer)?;
            counter.step();
            Ok((header, features))
        };
        let results: Vec<_> = photos.par_iter().map(read).collect();
        let mut front = Self {
            photos: Vec::new(),
            unreadable: Vec::new(),
            headers: Vec::new(),
            groups: Vec::new(),
            camera_of: Vec::new(),
            features: Vec::new(),
            masked: masked > 0,
        };
        for (photo, result) in photos.iter().zip(results) {
            match result {
                Ok((header, features)) => {
                    front.photos.push(photo.clone());
                    front.headers.push(header);
                    front.features.push(features);
                }
                Err(why) => front.unreadable.push((photo.name.clone(), why)),
            }
        }
        let (groups, camera_of) = cameras::group(&front.headers);
        (front.groups, front.camera_of) = (groups, camera_of);
        if let Some(calibration) = &options.calibration {
            cameras::calibrate(&mut front.groups, calibration)?;
        }
        front.check_photos()?;
        Ok(front)
    }

    fn check_photos(&self) -> Result<(), Verdict> {
        let n = self.photos.len();
        if n < LEAST_PHOTOS_OF_ONLY {
            let (what, unreadable) = (count(n, "photo"), self.unreadable.first());
            let also = unreadable.map_or(String::new(), |(name, why)| {
                format!(" ({} cannot be read, the first of them {name}: {why})", count(self.unreadable.len(), "other"))
            });
            return Err(Verdict::new(
                Cause::TooFewPhotos,
                format!("there are too few photos: {what}{also}"),
                "take 20 to 80 photos round the object, each overlapping the one before by two thirds",
            ));
        }
        Ok(())
    }

    pub(crate) fn names(&self, of: impl Iterator<Item = usize>) -> Vec<&str> {
        of.map(|k| self.photos[k].name.as_str()).collect()
    }

    /// Pairs of photos that one rigid scene explains.
    fn pairs(
        &mut self,
        options: &RegisterOptions,
        progress: &(dyn Fn(Step) + Sync),
        report: &mut Report,
    ) -> Result<(Vec<PairMatches>, Vec<Pair>), Verdict> {
        let chosen = which_pairs(&self.features, options, progress);
        let counter = Counter::new("matches", chosen.len(), progress);
        let mut matches = Matcher::new(&self.features, options.seed).pairs(&chosen, &|| counter.step());
        let side = self.headers.iter().map(|h| f64::from(h.width.max(h.height))).fold(0.0, f64::max);
        if !self.masked
            && let Some(background) = still::find(&matches, &self.features, side)
        {
            report.still_background = Some(background.share);
            // Matched again: the background no longer makes what is on the object ambiguous. What still stays is its shadow and gloss.
            background.drop_from(&mut self.features);
            let counter = Counter::new("matches without the background", chosen.len(), progress);
            matches = Matcher::new(&self.features, options.seed).pairs(&chosen, &|| counter.step());
            still::drop_staying(&mut matches, &self.features, side);
        }
        matches.retain(|m| !m.matches.is_empty());
        self.vote(&matches, options);
        let lenses = self.groups.iter().map(Group::camera).collect::<Result<Vec<_>, String>>();
        let lenses = lenses.map_err(|e| Verdict::new(Cause::Input, e, "calibrate the camera again"))?;
        let counter = Counter::new("pairs", matches.len(), progress);
        let check = |m: &PairMatches| {
            let pair = verify::verify(m, &self.features, m.views.map(|v| &lenses[self.camera_of[v]]), options.seed);
            counter.step();
            pair
        };
        let pairs: Vec<Pair> = matches.par_iter().filter_map(check).collect();
        let keep = triplets::consistent(&pairs, self.photos.len());
        report.contradicting_pairs = keep.iter().filter(|k| !**k).count();
        let pairs = pairs.into_iter().zip(keep).filter_map(|(pair, keep)| keep.then_some(pair)).collect();
        Ok((matches, pairs))
    }

    /// Focal lengths of cameras of which nothing is known.
    fn vote(&mut self, matches: &[PairMatches], options: &RegisterOptions) {
        let voters = cameras::Voters { photos: &self.features, headers: &self.headers };
        // One camera held upright and across has two groups and one focal length.
        let family = |g: &Group| [g.width.max(g.height), g.width.min(g.height)];
        let mut families: Vec<[u32; 2]> =
            self.groups.iter().filter(|g| g.source == FocalSource::Guess).map(family).collect();
        families.sort_unstable();
        families.dedup();
        for own in families {
            let member = |v: &usize| {
                let group = &self.groups[self.camera_of[*v]];
                group.source == FocalSource::Guess && family(group) == own
            };
            let pairs: Vec<&PairMatches> = matches.iter().filter(|m| m.views.iter().all(member)).collect();
            let Some(focal) = cameras::vote(&voters, &pairs, options.seed) else { continue };
            for group in self.groups.iter_mut().filter(|g| g.source == FocalSource::Guess && family(g) == own) {
                (group.focal_px, group.source) = (focal * f64::from(own[0]), FocalSource::Vote);
            }
        }
    }

    /// Refuses photos that show different places, before anything is mapped.
    fn check_overlap(&self, pairs: &[Pair]) -> Result<(), Verdict> {
        let largest = components(self.photos.len(), pairs).into_iter().map(|c| c.len()).max().unwrap_or(0);
        if largest < LEAST_PHOTOS_OF_ONLY { Err(self.why_nothing(pairs)) } else { Ok(()) }
    }

    /// Why no model was found.
    fn why_nothing(&self, pairs: &[Pair]) -> Verdict {
        let n = self.photos.len();
        let blurred: Vec<usize> = (0..n).filter(|&k| self.features[k].blurred).collect();
        if 2 * blurred.len() > n {
            return Verdict::new(
                Cause::Blur,
                format!("{} of {n} photos are blurred: {}", blurred.len(), list(&self.names(blurred.into_iter()))),
                "hold the camera still, give more light or a shorter exposure, and focus on the object",
            );
        }
        let few: Vec<usize> = (0..n).filter(|&k| self.features[k].keypoints.len() < FEW_KEYPOINTS).collect();
        if 2 * few.len() > n {
            let on = if self.masked { "on what the masks show" } else { "in them" };
            return Verdict::new(
                Cause::TooFewPoints,
                format!(
                    "{} of {n} photos have fewer than {FEW_KEYPOINTS} points {on}: {}",
                    few.len(),
                    list(&self.names(few.into_iter()))
                ),
                "put the object on printed paper or a patterned cloth; dull gloss with powder or chalk spray",
            );
        }
        let turns = pairs.iter().filter(|p| matches!(p.geometry, Geometry::Turn { .. })).count();
        if !pairs.is_empty() && 2 * turns > pairs.len() {
            return only_turned(format!("in {turns} of {} pairs of photos the camera only turned", pairs.len()));
        }
        let groups = components(n, pairs);
        let sizes: Vec<String> = groups
            .iter()
            .filter(|g| g.len() > 1)
            .map(|g| format!("{{{}}}", list(&self.names(g.iter().copied()))))
            .collect();
        let alone = groups.iter().filter(|g| g.len() == 1).count();
        let what = if sizes.is_empty() {
            format!("no two of the {n} photos show the same place")
        } else {
            format!("the photos do not overlap: groups {}; {} alone", sizes.join(", "), count(alone, "photo"))
        };
        Verdict::new(
            Cause::NoOverlap,
            what,
            "photograph one object, each photo overlapping the one before by two thirds",
        )
    }
}

fn only_turned(what: String) -> Verdict {
    Verdict::new(Cause::OnlyTurned, what, "walk round the object: a camera that turns on the spot sees no distances")
}

/// Pairs that are compared: all of a small set; of a large one, for each photo those that look most like it by its strongest keypoints, and
/// of a video its neighbours in time.
fn which_pairs(features: &[Features], options: &RegisterOptions, progress: &(dyn Fn(Step) + Sync)) -> Vec<[usize; 2]> {
    let n = features.len();
    let all: Vec<[usize; 2]> = (0..n).flat_map(|i| (i + 1..n).map(move |j| [i, j])).collect();
    if n <= ALL_PAIRS {
        return all;
    }
    let preview: Vec<Features> = features.par_iter().map(|f| f.first(PREVIEW_KEYPOINTS)).collect();
    let counter = Counter::new("preview", all.len(), progress);
    let alike = Matcher::new(&preview, options.seed).pairs(&all, &|| counter.step());
    let mut by_photo: Vec<Vec<(usize, usize)>> = vec![Vec::new(); n];
    for pair in &alike {
        let [i, j] = pair.views;
        by_photo[i].push((pair.matches.len(), j));
        by_photo[j].push((pair.matches.len(), i));
    }
    let mut chosen = BTreeSet::new();
    for (i, mut others) in by_photo.into_iter().enumerate() {
        others.sort_by_key(|&(matches, j)| (std::cmp::Reverse(matches), j));
        let near = (i.saturating_sub(NEIGHBOURS)..(i + NEIGHBOURS + 1).min(n)).filter(|j| options.video && *j != i);
        let best = others.iter().take(PARTNERS).filter(|(matches, _)| *matches > 0).map(|(_, j)| *j);
        chosen.extend(best.chain(near).map(|j| [i.min(j), i.max(j)]));
    }
    chosen.into_iter().collect()
}

/// Groups of photos that pairs connect, each sorted, the largest first.
fn components(n: usize, pairs: &[Pair]) -> Vec<Vec<usize>> {
    let mut sets = DisjointSets::new(n);
    pairs.iter().for_each(|p| sets.join(p.views[0] as u32, p.views[1] as u32));
    let (labels, count) = sets.labels();
    let mut groups = vec![Vec::new(); count];
    labels.iter().enumerate().for_each(|(k, &label)| groups[label as usize].push(k));
    groups.sort_by_key(|g| (std::cmp::Reverse(g.len()), g[0]));
    groups
}

/// Models of all scenes, the largest first: what one run leaves over is mapped again.
fn map_all(
    front: &FrontEnd,
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
        let own: Vec<Pair> = pairs.iter().filter(among).cloned().collect();
        let Some(largest) = components(n, &own).into_iter().find(|c| c.len() >= LEAST_PHOTOS_OF_ONLY) else { break };
        let refs: Vec<&Pair> = own.iter().collect();
        let mapped = mapping::map(&scene, &refs, &largest);
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

fn refine(
    front: &FrontEnd,
    mapped: &Mapped,
    (matches, left): (&[PairMatches], &[usize]),
    options: &RegisterOptions,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Refined, Verdict> {
    let sizes: Vec<[u32; 2]> = front.headers.iter().map(|h| [h.width, h.height]).collect();
    let mut model = Model::new(mapped, &sizes);
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
    removed.extend(drop_unconfirmed(&mut model, &greys));
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
    check_lenses(&model)?;
    let sigmas = adjust::pose_sigmas(&model, freedom);
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
    let colour = |(k, p): (usize, &crate::model::Point)| {
        let o = p.observations.first().filter(|o| o.view == view)?;
        let (x, y) = (o.pixel.x.round() as usize, o.pixel.y.round() as usize);
        Some((k, *rgb.get(y.min(grey.height - 1) * grey.width + x.min(grey.width - 1))?))
    };
    model.points.iter().enumerate().filter_map(colour).collect()
}

/// Refuses cameras that have only turned.
fn check_baseline(front: &FrontEnd, model: &Model) -> Result<(), Verdict> {
    let centres: Vec<_> = model.views.iter().map(crate::model::View::centre).collect();
    let extent = centres.iter().flat_map(|a| centres.iter().map(move |b| (a - b).norm())).fold(0.0, f64::max);
    let depths = model.points.iter().flat_map(|p| {
        p.observations.iter().map(|o| (model.views[o.view].camera_from_world * p.position).z).collect::<Vec<_>>()
    });
    let depth = upper_median(depths).unwrap_or(0.0);
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

/// Tells how many of a stage's items are done.
pub(crate) struct Counter<'a> {
    stage: &'static str,
    total: usize,
    done: std::sync::atomic::AtomicUsize,
    progress: &'a (dyn Fn(Step) + Sync),
}

impl<'a> Counter<'a> {
    pub(crate) fn new(stage: &'static str, total: usize, progress: &'a (dyn Fn(Step) + Sync)) -> Self {
        progress(Step { stage, done: 0, total });
        Self { stage, total, done: 0.into(), progress }
    }

    pub(crate) fn step(&self) {
        let done = self.done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
        (self.progress)(Step { stage: self.stage, done, total: self.total });
    }
}
