//! Ellipsoids (Kerbl et al. 2023).

use super::super::{GaussianGradients, Render, RenderGradients, RenderOptions};
use crate::{Error, Gaussians, PinholeCamera, Result};

#[derive(Debug, Clone)]
pub(super) struct Saved;

pub(super) fn forward(_: &Gaussians, _: &PinholeCamera, _: &RenderOptions) -> Result<(Render, Saved)> {
    Err(not_yet())
}

pub(super) fn backward(
    _: &Gaussians,
    _: &PinholeCamera,
    _: &RenderOptions,
    _: &Render,
    _: &Saved,
    _: &RenderGradients,
) -> Result<GaussianGradients> {
    Err(not_yet())
}

fn not_yet() -> Error {
    Error::Option { what: "ellipsoids are not drawn yet".into(), remedy: "draw surfels".into() }
}
