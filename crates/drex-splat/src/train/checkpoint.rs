//! The state of a training run as one file, so that it can stop and go on with the same result.
//!
//! Layout: `drexgs1\n`, the length of a JSON header (u64), the header, then little-endian numbers: every parameter of
//! the set in f32, its moments, the statistics of densification, exposures and poses.

use std::path::Path;

use drex_core::fsutil;
use serde::{Deserialize, Serialize};

use crate::optim::Moments;
use crate::train::model::Model;
use crate::train::options::TrainOptions;
use crate::train::state::State;
use crate::{Error, Gaussians, Kind, Label, Result};

const MAGIC: &[u8; 8] = b"drexgs1\n";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    options: TrainOptions,
    step: u32,
    resets: u32,
    gaussians: usize,
    kind: Kind,
    sh_degree: usize,
    /// Photos trained on: a checkpoint goes on with the same ones.
    photos: usize,
}

/// Writes the state; an old file is replaced only once the new one is whole.
pub(crate) fn write(path: &Path, state: &State, options: &TrainOptions) -> Result<()> {
    let g = &state.model.gaussians;
    let header = Header {
        options: options.clone(),
        step: state.step,
        resets: state.resets,
        gaussians: g.len(),
        kind: g.kind,
        sh_degree: g.sh_degree,
        photos: state.poses.len(),
    };
    // Numbers, strings and lists only: this cannot fail for a struct of them.
    let header = serde_json::to_vec(&header).map_err(|e| refuse(path, &format!("cannot encode the header: {e}")))?;
    let mut out = MAGIC.to_vec();
    out.extend((header.len() as u64).to_le_bytes());
    out.extend(&header);
    out.extend(g.labels.iter().map(|l| l.0));
    out.extend(state.statistics.seen.iter().flat_map(|v| v.to_le_bytes()));
    let mut state = state.clone();
    for part in f32_parts(&mut state) {
        out.extend(part.iter().flat_map(|v| v.to_le_bytes()));
    }
    for part in f64_parts(&mut state) {
        out.extend(part.iter().flat_map(|v| v.to_le_bytes()));
    }
    Ok(fsutil::write_atomic(path, &out)?)
}

/// Reads a state that `write` wrote and its options.
pub(crate) fn read(path: &Path) -> Result<(State, TrainOptions)> {
    let bytes = fsutil::read_bytes(path)?;
    let short = || refuse(path, "the file ends too early");
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| refuse(path, "this is no checkpoint of a training run"))?;
    let (length, rest) = rest.split_first_chunk::<8>().ok_or_else(short)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok().filter(|&l| l <= rest.len()).ok_or_else(short)?;
    let (header, mut rest) = rest.split_at(length);
    let header: Header = serde_json::from_slice(header).map_err(|e| refuse(path, &format!("its header: {e}")))?;
    let n = header.gaussians;
    // Before memory is asked for: each Gaussian has more bytes than this, and so has each photo.
    if header.sh_degree > 3
        || n.checked_mul(44).is_none_or(|b| b > rest.len())
        || header.photos.checked_mul(56).is_none_or(|b| b > rest.len())
    {
        return Err(short());
    }
    let mut g = Gaussians::new(header.kind, header.sh_degree);
    g.means = vec![[0.0; 3]; n];
    g.rotations = vec![[0.0; 4]; n];
    g.log_scales = vec![[0.0; 3]; n];
    g.logit_opacities = vec![0.0; n];
    g.sh = vec![0.0; n * g.sh_stride()];
    g.labels = take(&mut rest, n).ok_or_else(short)?.iter().map(|&l| Label(l)).collect();
    let mut state = State::new(Model::new(g), header.photos);
    state.step = header.step;
    state.resets = header.resets;
    for v in &mut state.statistics.seen {
        *v = u32::from_le_bytes(*take(&mut rest, 4).and_then(|b| b.first_chunk()).ok_or_else(short)?);
    }
    for v in f32_parts(&mut state).into_iter().flatten() {
        *v = f32::from_le_bytes(*take(&mut rest, 4).and_then(|b| b.first_chunk()).ok_or_else(short)?);
    }
    for v in f64_parts(&mut state).into_iter().flatten() {
        *v = f64::from_le_bytes(*take(&mut rest, 8).and_then(|b| b.first_chunk()).ok_or_else(short)?);
    }
    if !rest.is_empty() {
        return Err(refuse(path, "the file is longer than its header says"));
    }
    Ok((state, header.options))
}

/// Every single-precision number of the state, in the order of the file.
fn f32_parts(state: &mut State) -> Vec<&mut [f32]> {
    let g = &mut state.model.gaussians;
    let mut parts = vec![
        g.means.as_flattened_mut(),
        g.rotations.as_flattened_mut(),
        g.log_scales.as_flattened_mut(),
        g.logit_opacities.as_mut_slice(),
        g.sh.as_mut_slice(),
    ];
    parts.push(&mut state.statistics.gradient);
    for exposure in &mut state.exposures {
        parts.push(exposure.matrix.as_flattened_mut());
    }
    let moments = state.model.moments.iter_mut().chain(&mut state.exposure_moments).chain(&mut state.pose_moments);
    for (m, v) in moments.map(Moments::slices_mut) {
        parts.extend([m, v]);
    }
    parts
}

/// Every double-precision number of the state.
fn f64_parts(state: &mut State) -> Vec<&mut [f64]> {
    vec![state.poses.as_flattened_mut()]
}

fn take<'a>(bytes: &mut &'a [u8], n: usize) -> Option<&'a [u8]> {
    let (head, tail) = bytes.split_at_checked(n)?;
    *bytes = tail;
    Some(head)
}

fn refuse(path: &Path, what: &str) -> Error {
    drex_core::Error::content(path, None, what, "start the training anew").into()
}
