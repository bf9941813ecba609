//! What training is told.

use serde::{Deserialize, Serialize};

use crate::loss::MaskMode;
use crate::{Error, Kind, Result};

/// Settings of one training run. The defaults are those of 3DGS (Kerbl et al. 2023) with schedules that stretch with
/// the number of iterations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct TrainOptions {
    /// Ellipsoids for looks or surfels for geometry.
    pub kind: Kind,
    /// Steps; each looks at one photo.
    pub iterations: u32,
    /// Seed of the order of photos, of random backgrounds and of densification.
    pub seed: u64,
    /// Highest degree of the spherical harmonics.
    pub sh_degree: usize,
    /// The degree grows by one at each of these fractions of the run.
    pub sh_schedule: [f64; 3],
    /// Side of the photos relative to full size, and until which fraction of the run it holds; full size afterwards.
    pub coarse: Vec<Coarse>,
    /// Learning rates.
    pub rates: Rates,
    /// Weight of 1 - SSIM against L1, 0 to 1.
    pub ssim_weight: f32,
    /// What masks do.
    pub masks: MaskMode,
    /// Weight of mean |alpha - mask| where masks make the rest transparent.
    pub alpha_weight: f32,
    /// Colour behind the scene; `None` draws a new one at every step.
    pub background: Option<[f32; 3]>,
    /// How Gaussians are born and removed.
    pub density: Density,
    /// Most Gaussians there may be.
    pub max_gaussians: usize,
    /// Whether small splats keep their weight under the pixel filter (Mip-Splatting). Ellipsoids only.
    pub antialias: bool,
    /// Whether each photo gets an affine colour of its own, which takes up differences of exposure.
    pub exposure: bool,
    /// Whether the cameras' poses are refined too.
    pub refine_poses: bool,
    /// Surfels: what shapes the surface.
    pub surface: SurfaceTerms,
    /// Weight of the depth maps that come with the photos (scene units of depth divided by the scene's extent).
    pub depth_weight: f32,
}

/// A stretch of training on smaller photos.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Coarse {
    /// The photos are this many times smaller along each side: 2, 4...
    pub divisor: u32,
    /// Until this fraction of the run.
    pub until: f64,
}

/// Learning rates of Adam.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rates {
    /// Positions at the start, times the scene's extent.
    pub position: f32,
    /// Positions at the end, times the scene's extent; log-linear between.
    pub position_end: f32,
    /// Colour, degree 0.
    pub colour: f32,
    /// Colour, higher degrees.
    pub colour_rest: f32,
    /// Logit of the opacity.
    pub opacity: f32,
    /// Logarithm of the scales.
    pub scale: f32,
    /// Quaternions.
    pub rotation: f32,
    /// Affine colour per photo.
    pub exposure: f32,
    /// Poses: radians and fractions of the extent.
    pub pose: f32,
}

/// Terms that shape the surface of surfels (Huang et al. 2024, section 4).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceTerms {
    /// Weight of 1 - N · n, normals of the surfels against normals of the depth map.
    pub normal: f32,
    /// From this fraction of the run.
    pub normal_from: f64,
    /// Weight of the depth distortion.
    pub distortion: f32,
    /// From this fraction of the run.
    pub distortion_from: f64,
    /// Share of the median depth in the depth map the normals are taken from: 1 for objects, 0 for open scenes.
    pub median_share: f32,
    /// Weight of the normal maps that come with the photos.
    pub prior_normal: f32,
}

/// How Gaussians are born and removed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Density {
    /// The set stays as it was given.
    Fixed,
    /// Clone, split, prune, reset (Kerbl et al. 2023, section 5.2).
    Adaptive(Adaptive),
    /// Markov chain Monte Carlo: relocation, noise, growth to a cap (Kheradmand et al. 2024).
    Mcmc(Mcmc),
}

/// Adaptive density control. Fractions are of the run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Adaptive {
    /// First and last densification.
    pub from: f64,
    /// See `from`.
    pub until: f64,
    /// Steps between densifications.
    pub every: u32,
    /// Mean gradient by the projected centre (image from -1 to 1) above which a Gaussian is cloned or split.
    pub gradient: f32,
    /// Whether that gradient is summed in absolute value (AbsGS); wants a threshold of 6e-4 to 8e-4.
    pub absolute: bool,
    /// Largest scale that is cloned, times the extent; above it splits.
    pub clone_below: f32,
    /// Gaussians less opaque are removed.
    pub prune_opacity: f32,
    /// Gaussians larger than this times the extent are removed, once opacities have been reset.
    pub prune_scale: f32,
    /// Steps between resets of the opacity; 0 for never.
    pub reset_every: u32,
}

/// Markov chain Monte Carlo. Fractions are of the run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Mcmc {
    /// First and last relocation.
    pub from: f64,
    /// See `from`.
    pub until: f64,
    /// Steps between relocations.
    pub every: u32,
    /// Gaussians less opaque are dead and move.
    pub min_opacity: f32,
    /// Growth at each relocation.
    pub growth: f32,
    /// Noise on the positions, times their learning rate.
    pub noise: f32,
    /// Weight of the mean opacity.
    pub opacity_weight: f32,
    /// Weight of the mean scale.
    pub scale_weight: f32,
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            kind: Kind::Ellipsoid,
            iterations: 7000,
            seed: 0,
            sh_degree: 3,
            sh_schedule: [0.15, 0.3, 0.45],
            coarse: Vec::new(),
            rates: Rates::default(),
            ssim_weight: 0.2,
            masks: MaskMode::Off,
            alpha_weight: 0.1,
            background: Some([0.0; 3]),
            density: Density::Adaptive(Adaptive::default()),
            max_gaussians: 200_000,
            antialias: false,
            exposure: false,
            refine_poses: false,
            surface: SurfaceTerms::default(),
            depth_weight: 0.0,
        }
    }
}

impl Default for Rates {
    fn default() -> Self {
        Self {
            position: 1.6e-4,
            position_end: 1.6e-6,
            colour: 2.5e-3,
            colour_rest: 1.25e-4,
            opacity: 0.05,
            scale: 5e-3,
            rotation: 1e-3,
            exposure: 1e-3,
            pose: 1e-5,
        }
    }
}

impl Default for SurfaceTerms {
    fn default() -> Self {
        Self {
            normal: 0.05,
            normal_from: 0.25,
            distortion: 100.0,
            distortion_from: 0.1,
            median_share: 1.0,
            prior_normal: 0.0,
        }
    }
}

impl Default for Adaptive {
    fn default() -> Self {
        Self {
            from: 0.07,
            until: 0.7,
            every: 100,
            gradient: 2e-4,
            absolute: false,
            clone_below: 0.01,
            prune_opacity: 0.005,
            prune_scale: 0.1,
            reset_every: 3000,
        }
    }
}

impl Default for Mcmc {
    fn default() -> Self {
        Self {
            from: 0.05,
            until: 0.85,
            every: 100,
            min_opacity: 0.005,
            growth: 0.05,
            noise: 5e5,
            opacity_weight: 0.01,
            scale_weight: 0.01,
        }
    }
}

impl TrainOptions {
    /// # Errors
    /// If a number is out of range; names it.
    pub fn check(&self) -> Result<()> {
        let positive = [
            ("iterations", f64::from(self.iterations)),
            ("max_gaussians", self.max_gaussians as f64),
            ("rates.position", f64::from(self.rates.position)),
            ("rates.position_end", f64::from(self.rates.position_end)),
        ];
        let not_negative = [
            ("ssim_weight", self.ssim_weight),
            ("alpha_weight", self.alpha_weight),
            ("depth_weight", self.depth_weight),
            ("rates.colour", self.rates.colour),
            ("rates.colour_rest", self.rates.colour_rest),
            ("rates.opacity", self.rates.opacity),
            ("rates.scale", self.rates.scale),
            ("rates.rotation", self.rates.rotation),
            ("rates.exposure", self.rates.exposure),
            ("rates.pose", self.rates.pose),
            ("surface.normal", self.surface.normal),
            ("surface.distortion", self.surface.distortion),
            ("surface.prior_normal", self.surface.prior_normal),
        ];
        let shares = [("ssim_weight", self.ssim_weight), ("surface.median_share", self.surface.median_share)];
        if let Some((name, v)) = positive.iter().find(|(_, v)| !(*v > 0.0 && v.is_finite())) {
            return Err(wrong(name, v, "a positive number"));
        }
        if let Some((name, v)) = not_negative.iter().find(|(_, v)| !(*v >= 0.0 && v.is_finite())) {
            return Err(wrong(name, v, "a number that is not negative"));
        }
        if let Some((name, v)) = shares.iter().find(|(_, v)| !(0.0..=1.0).contains(v)) {
            return Err(wrong(name, v, "a share from 0 to 1"));
        }
        if self.sh_degree > 3 {
            return Err(wrong("sh_degree", &self.sh_degree, "0 to 3"));
        }
        if let Some(c) = self.coarse.iter().find(|c| !(1..=64).contains(&c.divisor)) {
            return Err(wrong("coarse.divisor", &c.divisor, "1 to 64"));
        }
        let every = match self.density {
            Density::Fixed => 1,
            Density::Adaptive(a) => a.every,
            Density::Mcmc(m) => m.every,
        };
        if every == 0 {
            return Err(wrong("density.every", &every, "1 or more steps"));
        }
        Ok(())
    }

    /// Degree of the spherical harmonics at a step, 1-based.
    pub fn sh_degree_at(&self, step: u32) -> usize {
        let done = self.done(step);
        self.sh_schedule.iter().filter(|&&from| done >= from).count().min(self.sh_degree)
    }

    /// How many times smaller the photos are at a step.
    pub fn divisor_at(&self, step: u32) -> u32 {
        let done = self.done(step);
        self.coarse.iter().find(|c| done < c.until).map_or(1, |c| c.divisor)
    }

    /// Learning rate of the positions at a step, without the extent.
    pub fn position_rate_at(&self, step: u32) -> f32 {
        let done = self.done(step) as f32;
        self.rates.position * (self.rates.position_end / self.rates.position).powf(done)
    }

    /// Fraction of the run that is behind a step.
    pub fn done(&self, step: u32) -> f64 {
        f64::from(step.saturating_sub(1)) / f64::from(self.iterations.max(1))
    }
}

fn wrong(name: &str, value: &dyn std::fmt::Display, may_be: &str) -> Error {
    Error::Option { what: format!("{name} is {value}"), remedy: format!("give {may_be}") }
}
