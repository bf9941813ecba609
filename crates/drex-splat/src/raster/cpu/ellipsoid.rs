//! Ellipsoids (Kerbl et al. 2023).

mod backward;
mod forward;
#[cfg(test)]
mod golden_projection;
#[cfg(test)]
mod instructions;
mod project;

use drex_core::camera::PinholeCamera;
use project::{Splat, Sums, View};
use pulp::Arch;
use rayon::prelude::*;

use super::super::{GaussianGradients, Render, RenderGradients, RenderOptions, Tiles};
use super::lanes::Plane;
use crate::{Gaussians, Result};

/// Gaussians that one task projects: also the unit in which the camera's twist is summed.
const CHUNK: usize = 256;

#[derive(Debug, Clone)]
pub(super) struct Saved {
    splats: Vec<Splat>,
    tiles: Tiles,
    ends: Vec<End>,
}

/// How a tile's pixels ended.
#[derive(Debug, Clone)]
struct End {
    /// Transmittance behind the last splat.
    t: Plane,
    /// 1 + place in the tile's list of the last splat that touches the pixel; 0 where none does.
    last: Plane,
    /// For the splats of the list that were reached, the blocks they touch, one bit each.
    blocks: Vec<u16>,
}

pub(super) fn forward(scene: &Gaussians, camera: &PinholeCamera, options: &RenderOptions) -> Result<(Render, Saved)> {
    let view = View::new(camera, options);
    let (mut splats, mut boxes) = (Vec::new(), Vec::new());
    (0..scene.len())
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|i| view.project(scene, i))
        .unzip_into_vecs(&mut splats, &mut boxes);
    let (width, height) = (camera.width, camera.height);
    Tiles::check(&boxes)?;
    let tiles = Tiles::new(&boxes, width, height, |_, _, _| true);

    let pixels = width * height;
    let mut render = Render {
        width,
        height,
        rgb: vec![[0.0; 3]; pixels],
        alpha: vec![0.0; pixels],
        depth: vec![0.0; pixels],
        count: if options.count { vec![0; pixels] } else { Vec::new() },
        ..Render::default()
    };
    let arch = Arch::new();
    let ends = (
        0..tiles.len(),
        tiles.cut_image(&mut render.rgb, width),
        tiles.cut_image(&mut render.alpha, width),
        tiles.cut_image(&mut render.depth, width),
        tiles.cut_image(&mut render.count, width),
    )
        .into_par_iter()
        .map(|(tile, mut rgb, mut alpha, mut depth, mut count)| {
            let list = tiles.list(tile);
            let drawn = arch.dispatch(forward::DrawTile { splats: &splats, list, corner: tiles.corner(tile), options });
            drawn.write(options.background, &mut rgb, &mut alpha, &mut depth, &mut count);
            drawn.end
        })
        .collect();
    Ok((render, Saved { splats, tiles, ends }))
}

pub(super) fn backward(
    scene: &Gaussians,
    camera: &PinholeCamera,
    options: &RenderOptions,
    saved: &Saved,
    gradients: &RenderGradients,
) -> Result<GaussianGradients> {
    let view = View::new(camera, options);
    let Saved { splats, tiles, ends } = saved;
    let arch = Arch::new();
    let mut records = vec![Sums::default(); tiles.slot_count()];
    (0..tiles.len(), tiles.cut_records(&mut records)).into_par_iter().for_each(|(tile, sums)| {
        if sums.is_empty() {
            return;
        }
        let corner = tiles.corner(tile);
        arch.dispatch(backward::DifferentiateTile {
            splats,
            list: tiles.list(tile),
            corner,
            options,
            end: &ends[tile],
            incoming: &backward::Incoming::read(gradients, options.background, camera, corner),
            sums,
        });
    });
    Ok(gather(scene, &view, saved, &records))
}

/// Sums the records of every splat and leads them to its parameters.
fn gather(scene: &Gaussians, view: &View<'_>, saved: &Saved, records: &[Sums]) -> GaussianGradients {
    let n = scene.len();
    let stride = scene.sh_stride();
    let mut out = GaussianGradients {
        means: vec![[0.0; 3]; n],
        rotations: vec![[0.0; 4]; n],
        log_scales: vec![[0.0; 3]; n],
        logit_opacities: vec![0.0; n],
        sh: vec![0.0; n * stride],
        mean2d: vec![[0.0; 2]; n],
        abs_mean2d: vec![[0.0; 2]; n],
        radius: vec![0.0; n],
        twist: [0.0; 6],
    };
    let twists: Vec<[f64; 6]> = (
        out.means.par_chunks_mut(CHUNK),
        out.rotations.par_chunks_mut(CHUNK),
        out.log_scales.par_chunks_mut(CHUNK),
        out.logit_opacities.par_chunks_mut(CHUNK),
        out.sh.par_chunks_mut(CHUNK * stride),
        out.mean2d.par_chunks_mut(CHUNK),
        out.abs_mean2d.par_chunks_mut(CHUNK),
        out.radius.par_chunks_mut(CHUNK),
    )
        .into_par_iter()
        .enumerate()
        .map(|(chunk, (means, rotations, log_scales, logit_opacities, sh, mean2d, abs_mean2d, radius))| {
            let mut twist = [0.0; 6];
            for k in 0..means.len() {
                let i = chunk * CHUNK + k;
                let slots = saved.tiles.slots_of(i);
                if slots.is_empty() {
                    continue;
                }
                let mut sums = Sums::default();
                for &slot in slots {
                    sums.add(&records[slot as usize]);
                }
                let d_sh = &mut sh[k * stride..(k + 1) * stride];
                let d = view.backward(scene, i, &saved.splats[i], &sums, d_sh);
                (means[k], rotations[k], log_scales[k]) = (d.mean, d.rotation, d.log_scale);
                (logit_opacities[k], radius[k]) = (d.logit_opacity, d.radius);
                (mean2d[k], abs_mean2d[k]) = (d.mean2d, d.abs_mean2d);
                for axis in 0..6 {
                    twist[axis] += d.twist[axis];
                }
            }
            twist
        })
        .collect();
    for twist in twists {
        for axis in 0..6 {
            out.twist[axis] += twist[axis];
        }
    }
    out
}
