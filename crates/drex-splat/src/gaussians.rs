//! A set of Gaussians as it is optimised: position, rotation, logarithms of the scales, logit of the opacity, colour as
//! spherical harmonics.

use rayon::prelude::*;

use crate::{Error, Result};

/// What a Gaussian is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// An ellipsoid with three scales (Kerbl et al. 2023): looks.
    Ellipsoid,
    /// A flat disc with two scales, its normal is the third axis (Huang et al. 2024, 2DGS): geometry.
    Surfel,
}

/// What a Gaussian belongs to; carried through training, files and rendering.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, serde::Serialize, serde::Deserialize)]
#[serde(transparent)]
pub struct Label(pub u8);

impl Label {
    /// Everything that is not an object.
    pub const BACKGROUND: Self = Self(0);
    /// The (first) object; further instances count up.
    pub const OBJECT: Self = Self(1);
}

/// Gaussians in the scene's frame and unit of length. All vectors have one entry a Gaussian.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaussians {
    /// Ellipsoids or surfels.
    pub kind: Kind,
    /// Degree of the spherical harmonics that are stored, 0 to 3.
    pub sh_degree: usize,
    /// Centres, world frame.
    pub means: Vec<[f32; 3]>,
    /// Rotations world_from_splat, quaternions w, x, y, z of any length but zero.
    pub rotations: Vec<[f32; 4]>,
    /// Natural logarithms of the standard deviations along the splat's axes. A surfel's third is ignored.
    pub log_scales: Vec<[f32; 3]>,
    /// Logit of the opacity.
    pub logit_opacities: Vec<f32>,
    /// Coefficients of the spherical harmonics, Gaussian by Gaussian, then coefficient, then red, green, blue:
    /// `3 (sh_degree + 1)²` numbers each. Colour is `max(0, 0.5 + Σ basis · coefficient)`.
    pub sh: Vec<f32>,
    /// What each belongs to.
    pub labels: Vec<Label>,
}

impl Gaussians {
    /// An empty set.
    pub fn new(kind: Kind, sh_degree: usize) -> Self {
        Self {
            kind,
            sh_degree,
            means: Vec::new(),
            rotations: Vec::new(),
            log_scales: Vec::new(),
            logit_opacities: Vec::new(),
            sh: Vec::new(),
            labels: Vec::new(),
        }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Numbers of colour a Gaussian has: `3 (sh_degree + 1)²`.
    pub fn sh_stride(&self) -> usize {
        3 * (self.sh_degree + 1).pow(2)
    }

    /// Opacity of one, 0 to 1.
    pub fn opacity(&self, i: usize) -> f32 {
        1.0 / (1.0 + (-self.logit_opacities[i]).exp())
    }

    /// Those for which `keep` is true, in the same order.
    #[must_use]
    pub fn filtered(&self, keep: impl Fn(usize) -> bool) -> Self {
        let mut out = Self::new(self.kind, self.sh_degree);
        for i in (0..self.len()).filter(|&i| keep(i)) {
            out.push_from(self, i);
        }
        out
    }

    /// Appends number `i` of `other`, which has the same degree.
    pub fn push_from(&mut self, other: &Self, i: usize) {
        let stride = self.sh_stride();
        self.means.push(other.means[i]);
        self.rotations.push(other.rotations[i]);
        self.log_scales.push(other.log_scales[i]);
        self.logit_opacities.push(other.logit_opacities[i]);
        self.sh.extend_from_slice(&other.sh[i * stride..(i + 1) * stride]);
        self.labels.push(other.labels[i]);
    }

    /// # Errors
    /// If the vectors differ in length, the degree is above 3, or a number is not finite; a logarithm of a scale may
    /// be minus infinity (a scale of zero).
    pub fn check(&self) -> Result<()> {
        let n = self.len();
        let lengths = [
            ("rotations", self.rotations.len(), n),
            ("log_scales", self.log_scales.len(), n),
            ("logit_opacities", self.logit_opacities.len(), n),
            ("sh", self.sh.len(), n * self.sh_stride()),
            ("labels", self.labels.len(), n),
        ];
        if self.sh_degree > 3 {
            return Err(Error::Gaussians {
                what: format!("spherical harmonics of degree {}", self.sh_degree),
                remedy: "give degree 0 to 3".into(),
            });
        }
        if let Some((name, has, wants)) = lengths.iter().find(|(_, has, wants)| has != wants) {
            return Err(Error::Gaussians {
                what: format!("{n} Gaussians have {has} {name}, not {wants}"),
                remedy: "give every vector one entry a Gaussian".into(),
            });
        }
        let finite = |i: usize| {
            let stride = self.sh_stride();
            let scales = self.log_scales[i].iter().all(|s| s.is_finite() || *s == f32::NEG_INFINITY);
            self.means[i].iter().chain(&self.rotations[i]).all(|v| v.is_finite())
                && scales
                && !self.logit_opacities[i].is_nan()
                && self.sh[i * stride..(i + 1) * stride].iter().all(|v| v.is_finite())
        };
        if let Some(i) = (0..n).into_par_iter().with_min_len(1024).find_first(|&i| !finite(i)) {
            return Err(Error::Gaussians {
                what: format!("Gaussian {i} of {n} has a number that is not finite"),
                remedy: "remove it or read the file again".into(),
            });
        }
        Ok(())
    }
}
