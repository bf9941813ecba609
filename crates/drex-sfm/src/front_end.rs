//! What is known of all photos before any has a pose: keypoints, cameras, and the pairs that one rigid scene explains.

use std::collections::BTreeSet;
use std::path::PathBuf;

use drex_core::camera::Camera;
use drex_core::sets::DisjointSets;
use drex_core::stats::upper_median;
use rayon::prelude::*;

use crate::cameras::{self, FocalSource, Group};
use crate::features::{self, Features};
use crate::matching::{Matcher, PairMatches};
use crate::photos::{self, Header};
use crate::still;
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

/// A model has at least so many photos; the only one of a small set may have fewer.
pub(crate) const LEAST_PHOTOS: usize = 5;
pub(crate) const LEAST_PHOTOS_OF_ONLY: usize = 3;
pub(crate) const SMALL_SET: usize = 20;
/// Keypoints that a photo needs to be worth looking at.
pub(crate) const FEW_KEYPOINTS: usize = 60;
/// Photos up to which every pair is compared; of more, the keypoints of each that are compared first, and its best partners by these.
const ALL_PAIRS: usize = 160;
const PREVIEW_KEYPOINTS: usize = 300;
const PARTNERS: usize = 40;
/// Frames of a video are compared with so many before and behind.
const NEIGHBOURS: usize = 8;

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

/// What the photos have in common.
pub(crate) struct Overlap {
    pub(crate) matches: Vec<PairMatches>,
    /// Pairs that one rigid scene explains and that do not contradict the others.
    pub(crate) pairs: Vec<Pair>,
    /// Share of the keypoints that belong to a background which stands still.
    pub(crate) still_background: Option<f64>,
    /// Pairs that were left out because they contradict the others.
    pub(crate) contradicting: usize,
}

impl FrontEnd {
    pub(crate) fn new(
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
    pub(crate) fn pairs(
        &mut self,
        options: &RegisterOptions,
        progress: &(dyn Fn(Step) + Sync),
    ) -> Result<Overlap, Verdict> {
        let chosen = which_pairs(&self.features, options, progress);
        let counter = Counter::new("matches", chosen.len(), progress);
        let mut matches = Matcher::new(&self.features, options.seed).pairs(&chosen, &|| counter.step());
        let mut still_background = None;
        let side = self.headers.iter().map(|h| f64::from(h.width.max(h.height))).fold(0.0, f64::max);
        if !self.masked
            && let Some(background) = still::find(&matches, &self.features, side)
        {
            still_background = Some(background.share);
            // Matched again: the background no longer makes what is on the object ambiguous. What still stays is its shadow and gloss.
            background.drop_from(&mut self.features);
            let counter = Counter::new("matches without the background", chosen.len(), progress);
            matches = Matcher::new(&self.features, options.seed).pairs(&chosen, &|| counter.step());
            still::drop_staying(&mut matches, &self.features, side);
        }
        matches.retain(|m| !m.matches.is_empty());
        // A megabyte a photo, and what follows needs the places only.
        self.features.iter_mut().for_each(|f| f.descriptors = Vec::new());
        self.vote(&matches, options);
        let lenses = self.groups.iter().map(Group::camera).collect::<Result<Vec<_>, String>>();
        let lenses = lenses.map_err(|e| Verdict::new(Cause::Input, e, "calibrate the camera again"))?;
        let counter = Counter::new("pairs", matches.len(), progress);
        let check = |(k, m): (usize, &PairMatches)| {
            let pair = verify::verify(k, m, &self.features, m.views.map(|v| &lenses[self.camera_of[v]]), options.seed);
            counter.step();
            pair
        };
        let pairs: Vec<Pair> = matches.par_iter().enumerate().filter_map(check).collect();
        let keep = triplets::consistent(&pairs, self.photos.len());
        let contradicting = keep.iter().filter(|k| !**k).count();
        let pairs = pairs.into_iter().zip(keep).filter_map(|(pair, keep)| keep.then_some(pair)).collect();
        Ok(Overlap { matches, pairs, still_background, contradicting })
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
    pub(crate) fn check_overlap(&self, pairs: &[Pair]) -> Result<(), Verdict> {
        let largest = components(self.photos.len(), pairs.iter()).into_iter().map(|c| c.len()).max().unwrap_or(0);
        if largest < LEAST_PHOTOS_OF_ONLY { Err(self.why_nothing(pairs)) } else { Ok(()) }
    }

    /// Why no model was found.
    pub(crate) fn why_nothing(&self, pairs: &[Pair]) -> Verdict {
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
        let groups = components(n, pairs.iter());
        // Who gives masks says that all photos show one object.
        if self.masked {
            let keypoints = self.features.iter().map(|f| f.keypoints.len() as f64);
            let typical = upper_median(keypoints).unwrap_or(0.0);
            let together = groups.first().map_or(0, Vec::len);
            return Verdict::new(
                Cause::TooFewPoints,
                format!(
                    "a photo has {typical:.0} points on what the masks show, and too few of them are found again in other photos: at most \
                     {} agree",
                    count(together, "photo")
                ),
                "dull gloss and glass with powder or chalk spray, put the object on printed paper that the masks show too, or take photos closer \
                 together",
            );
        }
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

pub(crate) fn only_turned(what: String) -> Verdict {
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
pub(crate) fn components<'a>(n: usize, pairs: impl Iterator<Item = &'a Pair>) -> Vec<Vec<usize>> {
    let mut sets = DisjointSets::new(n);
    pairs.for_each(|p| sets.join(p.views[0] as u32, p.views[1] as u32));
    let (labels, count) = sets.labels();
    let mut groups = vec![Vec::new(); count];
    labels.iter().enumerate().for_each(|(k, &label)| groups[label as usize].push(k));
    groups.sort_by_key(|g| (std::cmp::Reverse(g.len()), g[0]));
    groups
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
