//! The depth maps of a capture, and how they come about.

use drex_core::capture::Capture;
use drex_core::{Error, Result};

use crate::consistency::confirmed;
use crate::depth_map::DepthMap;
use crate::kernel::Window;
use crate::options::{Level, MvsOptions, Preset};
use crate::patchmatch::{Field, MOST_SOURCES, Matcher, Pass, Peer, Scale};
use crate::scene::{Limits, Neighbour, View, prepare};
use crate::specks::drop_specks;

/// Depth of the surfaces that the photos of a capture show.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMaps {
    /// One per view of the capture, in its order.
    pub views: Vec<DepthMap>,
}

/// How far the work has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Step {
    /// What is being done: "photos", "depth" or "consistency".
    pub stage: &'static str,
    /// Photos that are done with it, counted over all sizes.
    pub done: usize,
    /// Of so many.
    pub total: usize,
}

impl DepthMaps {
    /// Estimates depth for every photo of a capture.
    ///
    /// The same photos, cameras and options give the same numbers with any number of threads.
    ///
    /// # Errors
    /// If there are fewer than two photos, one cannot be read, an option is out of range, or no two photos can be compared.
    pub fn estimate(capture: &Capture, options: &MvsOptions, progress: &(dyn Fn(Step) + Sync)) -> Result<Self> {
        let mut views = Vec::with_capacity(capture.views.len());
        Self::each(capture, options, progress, &mut |map| {
            views.push(map);
            Ok(())
        })?;
        Ok(Self { views })
    }

    /// As [`DepthMaps::estimate`], with the maps handed over one after the other, in the order of the views, so that nobody has to hold them
    /// all.
    ///
    /// # Errors
    /// As [`DepthMaps::estimate`], and what `take` fails with.
    pub fn each(
        capture: &Capture,
        options: &MvsOptions,
        progress: &(dyn Fn(Step) + Sync),
        take: &mut dyn FnMut(DepthMap) -> Result<()>,
    ) -> Result<()> {
        if capture.views.len() < 2 {
            return Err(Error::capture(
                format!("{} photo in {}", capture.views.len(), capture.folder.display()),
                "depth takes at least two photos of the same thing from different places",
            ));
        }
        if !(0.0..=1.0).contains(&options.least_confidence) {
            return Err(Error::value(
                format!("a least confidence of {}", options.least_confidence),
                "give a share from 0 to 1",
            ));
        }
        match options.preset {
            Preset::Fast => Job::<4>::new(capture, options, Window::new(4, 3.0, 25.5), progress)?.run(take),
            Preset::Default | Preset::Best => {
                Job::<5>::new(capture, options, Window::new(5, 4.0, 25.5), progress)?.run(take)
            }
        }
    }
}

/// A window shows something if its grey varies by so many times the noise.
pub(crate) const CONTRAST_TO_NOISE: f32 = 2.5;
/// Sizes at which a window is looked for.
const MOST_SCALES: usize = 2;

struct Job<'a, const G: usize> {
    options: &'a MvsOptions,
    window: Window<G>,
    views: Vec<View>,
    progress: &'a (dyn Fn(Step) + Sync),
}

impl<'a, const G: usize> Job<'a, G> {
    fn new(
        capture: &Capture,
        options: &'a MvsOptions,
        window: Window<G>,
        progress: &'a (dyn Fn(Step) + Sync),
    ) -> Result<Self> {
        let total = capture.views.len();
        // One more for windows that show little.
        let sizes = 2 + options.preset.levels().iter().map(|l| l.halvings).max().unwrap_or(0);
        let views = prepare(capture, options, sizes, &|done| progress(Step { stage: "photos", done, total }))?;
        if views.iter().all(|v| v.sources().is_empty()) {
            return Err(Error::capture(
                format!(
                    "no two photos of {} look at the same place from 3 to 45 degrees apart",
                    capture.folder.display()
                ),
                "take photos from more places round the object, a step of 10 to 20 degrees apart",
            ));
        }
        Ok(Self { options, window, views, progress })
    }

    fn run(&self, take: &mut dyn FnMut(DepthMap) -> Result<()>) -> Result<()> {
        let levels = self.options.preset.levels();
        let total: usize =
            levels.iter().map(|l| self.views.len() * (usize::from(l.photometric > 0) + l.geometric)).sum();
        let mut done = 0;
        let mut step = || {
            (self.progress)(Step { stage: "depth", done, total });
            done += 1;
        };
        let mut fields: Vec<Field> = Vec::new();
        for (k, level) in levels.into_iter().enumerate() {
            if k > 0 {
                let doubled = |(view, field): (&View, &Field)| field.doubled(&view.searched[level.halvings]);
                fields = self.views.iter().zip(&fields).map(doubled).collect();
            }
            if level.photometric > 0 || k == 0 {
                let mut next = Vec::with_capacity(fields.len());
                for i in 0..self.views.len() {
                    step();
                    next.push(self.photometric(i, fields.get(i), level));
                }
                fields = next;
            }
            for round in 0..level.geometric {
                let last = level.halvings == 0 && round + 1 == level.geometric;
                let mut next = Vec::with_capacity(fields.len());
                for i in 0..self.views.len() {
                    step();
                    next.push(self.geometric(i, &fields, level, round, last));
                }
                fields = next;
            }
        }
        for i in 0..self.views.len() {
            (self.progress)(Step { stage: "consistency", done: i, total: self.views.len() });
            let deviations = self.deviations(i, &fields);
            let least = self.options.least_confidence;
            let mut map = confirmed(&self.views, &fields, i, &self.window, &deviations, least);
            drop_specks(&mut map);
            take(map)?;
        }
        Ok(())
    }

    fn photometric(&self, i: usize, field: Option<&Field>, level: Level) -> Field {
        let limits = self.limits(i);
        let matcher = self.matcher(i, level.halvings, &limits, Vec::new());
        let first = field.is_none();
        let mut field = field.cloned().unwrap_or_else(|| Field::random(&matcher));
        if matcher.sources() == 0 {
            field.costs.fill(f32::INFINITY);
            return field;
        }
        for number in 0..level.photometric {
            // Large steps where nothing is known, then half as large each time.
            let step_px = if first { 4.0 } else { 1.0 } * 0.5f32.powi(number as i32);
            let pass = Pass { number: number as u64, far: true, step_px, restart: first, last: false };
            matcher.pass(&mut field, pass);
        }
        field
    }

    fn geometric(&self, i: usize, fields: &[Field], level: Level, round: usize, last: bool) -> Field {
        let mut field = fields[i].clone();
        if self.views[i].sources().is_empty() {
            return field;
        }
        let limits = self.limits(i);
        let matcher = self.matcher(i, level.halvings, &limits, self.peers(i, level.halvings, fields));
        let number = (level.photometric + round) as u64;
        let far = level.halvings > 0;
        matcher.pass(&mut field, Pass { number, far, step_px: 0.5, restart: false, last });
        field
    }

    fn deviations(&self, i: usize, fields: &[Field]) -> Vec<f32> {
        if self.views[i].sources().is_empty() {
            return vec![f32::INFINITY; fields[i].costs.len()];
        }
        self.matcher(i, 0, &self.limits(i), self.peers(i, 0, fields)).deviations(&fields[i])
    }

    fn peers<'b>(&'b self, i: usize, halvings: usize, fields: &'b [Field]) -> Vec<Peer<'b>> {
        let view = &self.views[i];
        let peer = |n: &Neighbour| {
            let (turn, shift) = self.views[n.view].to(view, halvings);
            Peer { field: &fields[n.view], turn, shift }
        };
        view.sources().iter().map(peer).collect()
    }

    fn limits(&self, i: usize) -> Limits<'_> {
        Limits::new(&self.views[i].camera, self.views[i].range, self.options.region.as_ref())
    }

    fn matcher<'b>(
        &'b self,
        i: usize,
        halvings: usize,
        limits: &'b Limits<'b>,
        peers: Vec<Peer<'b>>,
    ) -> Matcher<'b, G> {
        let view = &self.views[i];
        let own = view.matrix(halvings).map(|v| v as f32);
        let chosen = &view.sources()[..view.sources().len().min(MOST_SOURCES)];
        let scale = |halvings: usize| Scale {
            picture: &view.pictures[halvings],
            searched: &view.searched[halvings],
            least_variance: (CONTRAST_TO_NOISE * view.noise[halvings]).powi(2),
            noise_variance: view.noise[halvings].powi(2),
            sources: chosen.iter().map(|n| view.source(&self.views[n.view], halvings)).collect(),
        };
        Matcher {
            window: &self.window,
            searched: &view.searched[halvings],
            scales: (halvings..(halvings + MOST_SCALES).min(view.pictures.len())).map(scale).collect(),
            masked: view.masked,
            weights: chosen.iter().map(|n| (n.angle_rad.to_degrees() / 10.0).min(1.0).powf(1.5) as f32).collect(),
            peers,
            focal: [own[(0, 0)], own[(1, 1)]],
            centre: [own[(0, 2)], own[(1, 2)]],
            limits,
            halvings,
            disparity: view.disparity(&self.views, halvings),
            seed: self.options.seed ^ ((i as u64) << 8) ^ ((halvings as u64) << 56),
        }
    }
}
