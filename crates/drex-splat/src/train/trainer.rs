//! One training run, step by step.

use std::path::Path;

use drex_core::Pose;
use drex_core::camera::PinholeCamera;
use drex_core::capture::Photo;
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::loss::{
    self, DepthOptions, DepthTarget, MaskMode, PhotometricOptions, SurfaceOptions, SurfaceTarget, Target,
};
use crate::optim::adam_step;
use crate::train::checkpoint;
use crate::train::density::{self, Statistics};
use crate::train::hull::VisualHull;
use crate::train::model::{Model, position_rate};
use crate::train::options::{Density, TrainOptions};
use crate::train::state::State;
use crate::train::views::{Views, check_sizes, reduced};
use crate::{Error, Gaussians, Kind, Rasterizer, Render, RenderGradients, RenderOptions, Result, usage};

/// Optimises a set of Gaussians so that it looks like the photos.
#[derive(Debug)]
pub struct Trainer<'a, V, R> {
    views: &'a V,
    /// Numbers of the photos that are trained on.
    indices: Vec<usize>,
    rasterizer: R,
    options: TrainOptions,
    /// Size of the scene: learning rates and thresholds are relative to it.
    extent: f64,
    hull: VisualHull,
    state: State,
}

/// Where a run is.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// Steps done.
    pub step: u32,
    /// Loss of this step.
    pub loss: f64,
    /// Peak signal-to-noise ratio of this step's photo, dB; inside its mask where masks are used.
    pub psnr: f64,
    /// Gaussians in the set.
    pub gaussians: usize,
}

/// Nothing is drawn nearer to a camera than this share of the scene's extent: what hangs right before one lens is seen by
/// no other and only fogs it.
pub(crate) const NEAR: f32 = 0.04;

impl<'a, V: Views, R: Rasterizer> Trainer<'a, V, R> {
    /// A run that starts from `gaussians` and looks at the photos `indices` of `views`. `extent` is the size of the
    /// scene in its unit: 1.1 times the largest distance of a camera from the mean of the cameras in 3DGS.
    ///
    /// # Errors
    /// If an option is out of range, there are fewer than two photos, no Gaussians, more than the cap, another kind, a
    /// number that is not finite, or the extent is not positive.
    pub fn new(
        views: &'a V,
        indices: Vec<usize>,
        rasterizer: R,
        gaussians: Gaussians,
        extent: f64,
        options: TrainOptions,
    ) -> Result<Self> {
        let model = Model::new(gaussians);
        let state = State::new(model, indices.len());
        Self::assemble(views, indices, rasterizer, extent, options, state)
    }

    /// Goes on from a checkpoint of the same photos; the result is that of a run that never stopped.
    ///
    /// # Errors
    /// If the file cannot be read, is damaged, or was made from another number of photos.
    pub fn resume(views: &'a V, indices: Vec<usize>, rasterizer: R, extent: f64, checkpoint: &Path) -> Result<Self> {
        let (state, options) = checkpoint::read(checkpoint)?;
        if state.poses.len() != indices.len() {
            return Err(Error::Training {
                what: format!(
                    "{} was made while training on {} photos, there are {} now",
                    checkpoint.display(),
                    state.poses.len(),
                    indices.len()
                ),
                remedy: "give the same photos and the same hold-out, or start anew".into(),
            });
        }
        Self::assemble(views, indices, rasterizer, extent, options, state)
    }

    fn assemble(
        views: &'a V,
        indices: Vec<usize>,
        rasterizer: R,
        extent: f64,
        options: TrainOptions,
        state: State,
    ) -> Result<Self> {
        options.check()?;
        let gaussians = &state.model.gaussians;
        gaussians.check()?;
        let refuse = |what: String, remedy: &str| Err(Error::Training { what, remedy: remedy.into() });
        if let Some(i) = indices.iter().find(|&&i| i >= views.count()) {
            return refuse(format!("photo {i} is asked for, there are {}", views.count()), "give numbers from 0");
        }
        if indices.len() < 2 {
            return refuse(
                format!("photos to train on: {}", indices.len()),
                "give photos from several sides: one photo tells nothing of the depth",
            );
        }
        if gaussians.is_empty() || gaussians.len() > options.max_gaussians {
            return refuse(
                format!(
                    "training starts from {} Gaussians, at most {} are allowed",
                    gaussians.len(),
                    options.max_gaussians
                ),
                "give at least one, and raise max_gaussians where there are more",
            );
        }
        if gaussians.kind != options.kind {
            return refuse(
                "the Gaussians and the options are of different kinds".into(),
                "make both ellipsoids or both surfels",
            );
        }
        if !(extent > 0.0 && extent.is_finite()) {
            return refuse(format!("the extent of the scene is {extent}"), "give cameras that stand apart");
        }
        usage::keep_freed_blocks();
        Ok(Self { views, indices, rasterizer, options, extent, hull: VisualHull::new(), state })
    }

    /// Gaussians whose centres leave this hull are removed at every densification and by [`Trainer::cut`].
    pub fn set_hull(&mut self, hull: VisualHull) {
        self.hull = hull;
    }

    /// Steps done.
    pub fn steps_done(&self) -> u32 {
        self.state.step
    }

    /// Whether all steps are done.
    pub fn is_done(&self) -> bool {
        self.state.step >= self.options.iterations
    }

    /// The set as it is now.
    pub fn gaussians(&self) -> &Gaussians {
        &self.state.model.gaussians
    }

    /// The options of the run.
    pub fn options(&self) -> &TrainOptions {
        &self.options
    }

    /// Writes everything that is needed to go on.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        checkpoint::write(path, &self.state, &self.options)
    }

    /// Removes Gaussians outside the hull; gives how many.
    pub fn cut(&mut self, hull: &VisualHull) -> usize {
        let keep: Vec<bool> = self.gaussians().means.iter().map(|m| hull.contains(m)).collect();
        self.keep(&keep);
        keep.iter().filter(|&&k| !k).count()
    }

    fn keep(&mut self, keep: &[bool]) {
        self.state.model.retain(keep);
        let mut index = 0..;
        self.state.statistics.gradient.retain(|_| index.next().is_some_and(|i: usize| keep[i]));
        let mut index = 0..;
        self.state.statistics.seen.retain(|_| index.next().is_some_and(|i: usize| keep[i]));
    }

    /// The camera of photo `k` of those trained on, with its correction.
    fn camera(&self, k: usize, photo: &Photo) -> PinholeCamera {
        PinholeCamera { camera_from_world: self.correction(k) * photo.camera.camera_from_world, ..photo.camera.clone() }
    }

    fn correction(&self, k: usize) -> Pose {
        let [w, x, y, z, tx, ty, tz] = self.state.poses[k];
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        Pose::from_parts(Translation3::new(tx, ty, tz), rotation)
    }

    /// How the set is drawn at a step.
    fn render_options(&self, step: u32, background: [f32; 3]) -> RenderOptions {
        RenderOptions {
            background,
            sh_degree: self.options.sh_degree_at(step).min(self.gaussians().sh_degree),
            antialias: self.options.antialias,
            geometry: self.options.kind == Kind::Surfel,
            near: NEAR * self.extent as f32,
            distortion_range: [0.05, 25.0].map(|x| x * self.extent as f32),
            ..RenderOptions::default()
        }
    }

    /// Draws the set for a camera as it is now.
    ///
    /// # Errors
    /// If the camera cannot be drawn for.
    pub fn render(&self, camera: &PinholeCamera, background: [f32; 3]) -> Result<Render> {
        let options = self.render_options(self.state.step.max(1), background);
        Ok(self.rasterizer.forward(self.gaussians(), camera, &options)?.0)
    }

    /// One step: a photo, its loss, the derivative, Adam, and densification where it is due.
    ///
    /// # Errors
    /// If the photo cannot be read, is black all over, its mask is empty, or a parameter is no longer finite.
    pub fn step(&mut self) -> Result<Progress> {
        let step = self.state.step + 1;
        let k = self.photo_of(step);
        let full = self.views.photo(self.indices[k])?;
        check_sizes(&full, || self.views.name(self.indices[k]))?;
        if full.rgb.iter().all(|c| *c == [0; 3]) {
            return Err(Error::Training {
                what: format!("the photo {} is black all over", self.views.name(self.indices[k])),
                remedy: "leave it out, or look for the right file".into(),
            });
        }
        let photo = reduced(&full, self.options.divisor_at(step) as usize);
        let camera = self.camera(k, &photo);
        let mut rng = self.rng(step, 0);
        let background = self.options.background.unwrap_or_else(|| rng.random());
        let render_options = self.render_options(step, background);
        let (render, saved) = self.rasterizer.forward(self.gaussians(), &camera, &render_options)?;

        let (value, psnr, gradients) = self.loss(step, k, &photo, &camera, (&render, background))?;
        let mut by_set =
            self.rasterizer.backward(self.gaussians(), &camera, &render_options, &render, &saved, &gradients)?;
        if let Density::Mcmc(m) = self.options.density {
            self.state.model.add_shrinkage(&mut by_set, m.opacity_weight, m.scale_weight);
        }
        let rate = position_rate(&self.options, step, self.extent);
        self.state.model.descend(&by_set, &self.options.rates, rate, step)?;
        if self.options.refine_poses {
            self.move_camera(step, k, &by_set.twist)?;
        }
        if let Density::Adaptive(a) = self.options.density {
            self.state.statistics.add(&by_set, a.absolute, camera.width, camera.height);
        }
        self.densify(step, rate);
        if step.is_multiple_of(100) || step == self.options.iterations {
            self.check_finite(step)?;
        }
        self.state.step = step;
        Ok(Progress { step, loss: value, psnr, gaussians: self.state.model.len() })
    }

    /// The photo of a step: all of them in a random order, then all in another.
    fn photo_of(&self, step: u32) -> usize {
        let n = self.indices.len();
        let (round, place) = ((step as usize - 1) / n, (step as usize - 1) % n);
        let mut order: Vec<usize> = (0..n).collect();
        order.shuffle(&mut self.rng(round as u32, 1));
        order[place]
    }

    /// Random numbers that depend on the seed, the step and the purpose only, so that a checkpoint needs no state of them.
    fn rng(&self, step: u32, purpose: u64) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.options.seed);
        rng.set_stream(u64::from(step) << 8 | purpose);
        rng
    }

    /// Loss, PSNR, and the derivative of the loss by the picture; the photo's exposure takes its step on the way.
    fn loss(
        &mut self,
        step: u32,
        k: usize,
        photo: &Photo,
        camera: &PinholeCamera,
        (render, background): (&Render, [f32; 3]),
    ) -> Result<(f64, f64, RenderGradients)> {
        let o = &self.options;
        let name = self.views.name(self.indices[k]);
        let mask = photo.mask.as_deref().filter(|_| o.masks != MaskMode::Off);
        let target = Target {
            name: &name,
            rgb: &photo.rgb,
            mask: photo.mask.as_deref(),
            exposure: o.exposure.then_some(&self.state.exposures[k]),
        };
        let photometric = PhotometricOptions {
            lambda: o.ssim_weight,
            mask: o.masks,
            background,
            alpha: o.alpha_weight,
            ignore_band: 0,
        };
        let mut loss = loss::photometric(render, &target, &photometric)?;
        let mut value = loss.value;
        if o.kind == Kind::Surfel {
            let done = o.done(step);
            let from = |weight: f32, from: f64| if done >= from { weight } else { 0.0 };
            let surface = SurfaceOptions {
                consistency: from(o.surface.normal, o.surface.normal_from),
                distortion: from(o.surface.distortion, o.surface.distortion_from),
                normals: o.surface.prior_normal,
                median_share: o.surface.median_share,
                ..SurfaceOptions::default()
            };
            let target = SurfaceTarget { name: &name, mask, normals: photo.normal.as_deref() };
            let shape = loss::surface(render, camera, &target, &surface)?;
            value += shape.value;
            loss.gradients.add(shape.gradients);
        }
        if let (true, Some(_)) = (o.depth_weight > 0.0, &photo.depth) {
            let target = DepthTarget { name: &name, dense: photo.depth.as_deref(), sparse: &[], mask };
            let weight = o.depth_weight / self.extent as f32;
            let depth = loss::depth(render, &target, &DepthOptions { weight, ..DepthOptions::default() })?;
            value += depth.value;
            loss.gradients.add(depth.gradients);
        }
        if let Some(by_exposure) = loss.exposure {
            let visits = (step - 1) / self.indices.len() as u32 + 1;
            let mut change = [0.0_f32; 12];
            let rates = [self.options.rates.exposure; 12];
            adam_step(&mut change, by_exposure.as_flattened(), &mut self.state.exposure_moments[k], &rates, visits)?;
            self.expose(k, &change);
        }
        Ok((value, psnr_of(render, photo, mask), loss.gradients))
    }

    /// Changes the exposure of photo `k` and all others a little the other way: their mean stays the identity, else the
    /// set's own colours could drift and every exposure with them.
    fn expose(&mut self, k: usize, change: &[f32; 12]) {
        let share = 1.0 / self.state.exposures.len() as f32;
        for (i, exposure) in self.state.exposures.iter_mut().enumerate() {
            let part = if i == k { 1.0 - share } else { -share };
            for (m, c) in exposure.matrix.as_flattened_mut().iter_mut().zip(change) {
                *m += part * c;
            }
        }
    }

    /// Moves the camera of photo `k` against the gradient: exp(-rate · Adam direction) on the left.
    fn move_camera(&mut self, step: u32, k: usize, twist: &[f64; 6]) -> Result<()> {
        let visits = (step - 1) / self.indices.len() as u32 + 1;
        let mut x = [0.0_f32; 6];
        // Shifts in units of the extent, so that one rate serves both.
        let unit = |i: usize| if i < 3 { self.extent } else { 1.0 };
        let by_x: [f32; 6] = std::array::from_fn(|i| (twist[i] * unit(i)) as f32);
        adam_step(&mut x, &by_x, &mut self.state.pose_moments[k], &[self.options.rates.pose; 6], visits)?;
        let xi: [f64; 6] = std::array::from_fn(|i| f64::from(x[i]) * unit(i));
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(xi[3], xi[4], xi[5]));
        // First order in the shift: steps are of the size of the rate.
        let motion = Pose::from_parts(Translation3::new(xi[0], xi[1], xi[2]), turn);
        let pose = motion * self.correction(k);
        let (q, t) = (pose.rotation.quaternion(), pose.translation);
        self.state.poses[k] = [q.w, q.i, q.j, q.k, t.x, t.y, t.z];
        Ok(())
    }

    fn densify(&mut self, step: u32, position_rate: f32) {
        let done = self.options.done(step);
        let most = self.options.max_gaussians;
        match self.options.density {
            Density::Fixed => {}
            Density::Adaptive(a) => {
                let reset = a.reset_every > 0 && step.is_multiple_of(a.reset_every) && done < a.until;
                if step.is_multiple_of(a.every) && done >= a.from && done < a.until {
                    let prune_large = self.state.resets > 0;
                    let mut rng = self.rng(step, 2);
                    density::adapt(
                        &mut self.state.model,
                        &self.state.statistics,
                        &a,
                        (self.extent, most, prune_large),
                        &mut rng,
                    );
                    self.state.statistics = Statistics::new(self.state.model.len());
                    self.cut_to_hull();
                }
                if reset {
                    self.state.model.reset_opacities(2.0 * a.prune_opacity);
                    self.state.resets += 1;
                }
            }
            Density::Mcmc(m) => {
                if step.is_multiple_of(m.every) && done >= m.from && done < m.until {
                    let mut rng = self.rng(step, 2);
                    density::relocate(&mut self.state.model, &m, most, &mut rng);
                    self.state.statistics = Statistics::new(self.state.model.len());
                    self.cut_to_hull();
                }
                let mut rng = self.rng(step, 3);
                density::shake(&mut self.state.model, &m, position_rate, &mut rng);
            }
        }
    }

    fn cut_to_hull(&mut self) {
        let hull = std::mem::take(&mut self.hull);
        self.cut(&hull);
        self.hull = hull;
    }

    fn check_finite(&self, step: u32) -> Result<()> {
        match self.state.model.first_not_finite() {
            None => Ok(()),
            Some(i) => Err(Error::Training {
                what: format!("at step {step} Gaussian {i} is no longer finite"),
                remedy: "lower the learning rates, or look for photos with wrong poses".into(),
            }),
        }
    }
}

/// Peak signal-to-noise ratio, dB, inside the mask if there is one.
fn psnr_of(render: &Render, photo: &Photo, mask: Option<&[u8]>) -> f64 {
    let (mut sum, mut area) = (0.0_f64, 0.0_f64);
    for (i, (ours, theirs)) in render.rgb.iter().zip(&photo.rgb).enumerate() {
        let weight = mask.map_or(1.0, |m| f64::from(m[i]) / 255.0);
        let error: f32 = (0..3).map(|c| (ours[c].clamp(0.0, 1.0) - f32::from(theirs[c]) / 255.0).powi(2)).sum();
        sum += weight * f64::from(error);
        area += 3.0 * weight;
    }
    -10.0 * (sum / area).max(1e-10).log10()
}
