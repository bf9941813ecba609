//! The depth maps of a capture, and how they come about.

use std::sync::Arc;

use drex_core::capture::Capture;
use drex_core::{Error, Result};

use crate::consistency::confirmed;
use crate::depth_map::DepthMap;
use crate::gpu::Gpu;
use crate::kernel::Window;
use crate::options::{MvsOptions, Preset, Round};
use crate::patchmatch::{Field, MOST_SOURCES, Matcher, Pass, Peer, Scale};
use crate::rounds::Rounds;
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
    /// If there are fewer than two photos, one cannot be read, an option is out of range, no two photos can be compared, or a GPU is
    /// asked for and missing, or fails.
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
    gpu: Option<Gpu>,
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
        let gpu = if options.on_gpu { Some(Gpu::new(&window)?) } else { None };
        let total = capture.views.len();
        // One more for windows that show little.
        let sizes = 2 + options.preset.rounds().iter().map(|r| r.halvings).max().unwrap_or(0);
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
        Ok(Self { options, window, gpu, views, progress })
    }

    fn run(&self, take: &mut dyn FnMut(DepthMap) -> Result<()>) -> Result<()> {
        let (schedule, photos) = (self.options.preset.rounds(), self.views.len());
        let last = schedule.len() - 1;
        let mut rounds = Rounds::new(self.options, &self.views);
        let begin = rounds.last_complete(schedule.len()).map_or(0, |k| k + 1);
        for k in begin..schedule.len() {
            for i in 0..photos {
                (self.progress)(Step { stage: "depth", done: k * photos + i, total: schedule.len() * photos });
                if !rounds.has(k, i) {
                    let field = self.field(i, &schedule, k, &mut rounds)?;
                    rounds.put(k, i, field)?;
                }
            }
            rounds.forget_before(k);
        }
        for (i, view) in self.views.iter().enumerate() {
            (self.progress)(Step { stage: "consistency", done: i, total: photos });
            let field = rounds.get(last, i)?;
            let others: Vec<_> = view.witnesses.iter().map(|n| rounds.get(last, n.view)).collect::<Result<_>>()?;
            let deviations = self.deviations(i, &field)?;
            let least = self.options.least_confidence;
            let mut map = confirmed(&self.views, i, &field, &others, &self.window, &deviations, least);
            drop_specks(&mut map);
            take(map)?;
        }
        Ok(())
    }

    /// The planes of a photo after round `k`.
    fn field(&self, i: usize, schedule: &[Round], k: usize, rounds: &mut Rounds) -> Result<Field> {
        let round = schedule[k];
        // Those of the round before, at the size of this one.
        let mut before = |photo: usize| -> Result<Arc<Field>> {
            let k = k.saturating_sub(1);
            let field = rounds.get(k, photo)?;
            let same_size = schedule[k].halvings == round.halvings;
            let doubled = || Arc::new(field.doubled(&self.views[photo].searched[round.halvings]));
            Ok(if same_size { field.clone() } else { doubled() })
        };
        if round.alone > 0 {
            let start = if k == 0 { None } else { Some(before(i)?) };
            return self.photometric(i, start.as_deref(), round);
        }
        let others: Vec<_> = self.views[i].sources().iter().map(|n| before(n.view)).collect::<Result<_>>()?;
        let start = before(i)?;
        self.geometric(i, &start, &others, round)
    }

    fn photometric(&self, i: usize, start: Option<&Field>, round: Round) -> Result<Field> {
        let limits = self.limits(i);
        let matcher = self.matcher(i, round.halvings, &limits, Vec::new());
        let mut field = start.cloned().unwrap_or_else(|| Field::random(&matcher));
        if matcher.sources() == 0 {
            field.costs.fill(f32::INFINITY);
            return Ok(field);
        }
        let pass = |number: usize| {
            // Large steps where nothing is known, then half as large each time.
            let step_px = if start.is_none() { 4.0 } else { 1.0 } * 0.5f32.powi(number as i32);
            Pass { number: number as u64, far: true, step_px, restart: start.is_none(), last: false }
        };
        self.passes(&matcher, &mut field, &(0..round.alone).map(pass).collect::<Vec<_>>())?;
        Ok(field)
    }

    /// `others`: the planes of the sources.
    fn geometric(&self, i: usize, start: &Field, others: &[Arc<Field>], round: Round) -> Result<Field> {
        let (mut field, view) = (start.clone(), &self.views[i]);
        if others.is_empty() {
            return Ok(field);
        }
        let peer = |(n, field): (&Neighbour, &'_ Arc<Field>)| {
            let (turn, shift) = self.views[n.view].to(view, round.halvings);
            Peer { field: field.clone(), turn, shift }
        };
        let peers = view.sources().iter().zip(others).map(peer).collect();
        let limits = self.limits(i);
        let matcher = self.matcher(i, round.halvings, &limits, peers);
        let far = round.halvings > 0;
        let pass = Pass { number: round.number, far, step_px: 0.5, restart: false, last: round.last };
        self.passes(&matcher, &mut field, &[pass])?;
        Ok(field)
    }

    fn passes(&self, matcher: &Matcher<'_, G>, field: &mut Field, passes: &[Pass]) -> Result<()> {
        match &self.gpu {
            Some(gpu) => gpu.passes(matcher, field, passes)?,
            None => passes.iter().for_each(|pass| matcher.pass(field, *pass)),
        }
        Ok(())
    }

    fn deviations(&self, i: usize, field: &Field) -> Result<Vec<f32>> {
        if self.views[i].sources().is_empty() {
            return Ok(vec![f32::INFINITY; field.costs.len()]);
        }
        // Without the others' depth: how far off it may be the photos tell alone.
        let limits = self.limits(i);
        let matcher = self.matcher(i, 0, &limits, Vec::new());
        match &self.gpu {
            Some(gpu) => gpu.deviations(&matcher, field),
            None => Ok(matcher.deviations(field)),
        }
    }

    fn limits(&self, i: usize) -> Limits<'_> {
        Limits::new(&self.views[i].camera, self.views[i].range, self.options.region.as_ref())
    }

    fn matcher<'b>(&'b self, i: usize, halvings: usize, limits: &'b Limits<'b>, peers: Vec<Peer>) -> Matcher<'b, G> {
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
