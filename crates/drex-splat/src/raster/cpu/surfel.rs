//! Surfels (Huang et al. 2024, 2DGS): discs that know depth and normal at every pixel.

mod backward;
mod bounds;
mod forward;
#[cfg(test)]
mod instructions;
mod project;
mod view;

use backward::{Differentiate, Record, TileGradients};
use bounds::Footprint;
use drex_core::camera::PinholeCamera;
use forward::{Draw, Projected, TileSums};
use rayon::prelude::*;
use view::View;

use super::check_geometry;
use super::lanes::{BLOCK, Plane, place};
use crate::raster::{GaussianGradients, Render, RenderGradients, RenderOptions, TILE, Tiles};
use crate::{Gaussians, Result};

#[derive(Debug, Clone)]
pub(super) struct Saved {
    tiles: Tiles,
    projected: Vec<Projected>,
    /// Blocks of its tile that a splat touched, for every slot.
    blocks: Vec<u16>,
    /// What the images do not tell of the sums, for every row of tiles; empty without geometry.
    hidden: Vec<Vec<Hidden>>,
}

/// The sums of a tile that are in no image; see [`TileSums`].
#[derive(Debug, Clone)]
struct Hidden {
    median_at: Plane,
    first: Plane,
    m1: Plane,
    m2: Plane,
}

pub(super) fn forward(scene: &Gaussians, camera: &PinholeCamera, options: &RenderOptions) -> Result<(Render, Saved)> {
    let view = View::new(camera, options);
    let (mut projected, mut boxes) = (Vec::new(), Vec::new());
    (0..scene.len())
        .into_par_iter()
        .with_min_len(256)
        .map(|i| view.project(scene, i).unwrap_or_default())
        .unzip_into_vecs(&mut projected, &mut boxes);
    let tiles = Tiles::new(&boxes, camera.width, camera.height, |i, column, row| {
        meets_tile(&projected[i].footprint, column, row)
    });
    let mut render = blank(camera, options);
    let mut blocks = vec![0; tiles.slot_count()];
    let (rules, arch) = (view.rules(), pulp::Arch::new());
    let hidden = bands(&mut render)
        .into_par_iter()
        .zip(tiles.cut_records(&mut blocks).par_chunks_mut(tiles.columns))
        .enumerate()
        .map(|(row, (mut band, blocks))| {
            let (mut sums, mut scratch) = (Box::new(TileSums::ZERO), Vec::new());
            let mut hidden = Vec::with_capacity(if options.geometry { tiles.columns } else { 0 });
            for (column, blocks) in blocks.iter_mut().enumerate() {
                let t = row * tiles.columns + column;
                arch.dispatch(Draw {
                    projected: &projected,
                    list: tiles.list(t),
                    corner: corner(&tiles, t),
                    scratch: &mut scratch,
                    blocks,
                    rules,
                    sums: &mut sums,
                });
                band.write(&sums, column * TILE, &view);
                if options.geometry {
                    let TileSums { median_at, first, m1, m2, .. } = *sums;
                    hidden.push(Hidden { median_at, first, m1, m2 });
                }
            }
            hidden
        })
        .collect();
    Ok((render, Saved { tiles, projected, blocks, hidden }))
}

pub(super) fn backward(
    scene: &Gaussians,
    camera: &PinholeCamera,
    options: &RenderOptions,
    render: &Render,
    saved: &Saved,
    gradients: &RenderGradients,
) -> Result<GaussianGradients> {
    check_geometry(options, gradients)?;
    let view = View::new(camera, options);
    let (tiles, rules, arch) = (&saved.tiles, view.rules(), pulp::Arch::new());
    let mut records = vec![Record::default(); tiles.slot_count()];
    let mut blocks = saved.blocks.clone();
    tiles.cut_records(&mut records).into_par_iter().zip(tiles.cut_records(&mut blocks)).enumerate().for_each_init(
        || (Vec::new(), Box::new(TileSums::ZERO), Box::new(TileGradients::ZERO)),
        |(scratch, sums, by_sums), (t, (records, blocks))| {
            if records.is_empty() {
                return;
            }
            let corner = corner(tiles, t);
            scratch.clear();
            scratch.extend(tiles.list(t).iter().map(|&i| saved.projected[i as usize].splat.in_tile(corner)));
            read_sums(render, saved, t, &view, sums);
            read_gradients(gradients, render, tiles.corner(t), &view, by_sums);
            arch.dispatch(Differentiate { splats: scratch, blocks, rules, sums, gradients: by_sums, records });
        },
    );
    Ok(view.gather(scene, saved, &records))
}

fn corner(tiles: &Tiles, t: usize) -> [f32; 2] {
    let (x, y) = tiles.corner(t);
    [x as f32, y as f32]
}

/// Whether the strip of a footprint meets a tile; the box does.
fn meets_tile(f: &Footprint, column: usize, row: usize) -> bool {
    const REACH: f32 = (TILE - 1) as f32 / 2.0;
    let [x, y] = [column, row].map(|k| (k * TILE + TILE / 2) as f32);
    let [a, b] = f.axis;
    let (at, reach) = (a * x + b * y, REACH * (a.abs() + b.abs()));
    at + reach >= f.strip[0] && at - reach <= f.strip[1]
}

/// Images that nothing is drawn in yet.
fn blank(camera: &PinholeCamera, options: &RenderOptions) -> Render {
    let (width, height) = (camera.width, camera.height);
    let (all, geometry) = (width * height, if options.geometry { width * height } else { 0 });
    Render {
        width,
        height,
        rgb: vec![[0.0; 3]; all],
        alpha: vec![0.0; all],
        depth: vec![0.0; all],
        normal: vec![[0.0; 3]; geometry],
        median_depth: vec![0.0; geometry],
        distortion: vec![0.0; geometry],
        count: vec![0; if options.count { all } else { 0 }],
    }
}

/// The rows of a row of tiles in every image, none of an empty one.
struct Band<'a> {
    width: usize,
    rgb: &'a mut [[f32; 3]],
    alpha: &'a mut [f32],
    depth: &'a mut [f32],
    normal: &'a mut [[f32; 3]],
    median_depth: &'a mut [f32],
    distortion: &'a mut [f32],
    count: &'a mut [u32],
}

fn bands(render: &mut Render) -> Vec<Band<'_>> {
    let (width, rows) = (render.width, render.height.div_ceil(TILE));
    let mut rgb = render.rgb.chunks_mut(TILE * width);
    let mut alpha = render.alpha.chunks_mut(TILE * width);
    let mut depth = render.depth.chunks_mut(TILE * width);
    let mut normal = render.normal.chunks_mut(TILE * width);
    let mut median_depth = render.median_depth.chunks_mut(TILE * width);
    let mut distortion = render.distortion.chunks_mut(TILE * width);
    let mut count = render.count.chunks_mut(TILE * width);
    (0..rows)
        .map(|_| Band {
            width,
            rgb: rgb.next().unwrap_or_default(),
            alpha: alpha.next().unwrap_or_default(),
            depth: depth.next().unwrap_or_default(),
            normal: normal.next().unwrap_or_default(),
            median_depth: median_depth.next().unwrap_or_default(),
            distortion: distortion.next().unwrap_or_default(),
            count: count.next().unwrap_or_default(),
        })
        .collect()
}

impl Band<'_> {
    /// Puts a tile with its left edge at `x0` into the images.
    fn write(&mut self, sums: &TileSums, x0: usize, view: &View<'_>) {
        let (background, kappa2) = (view.options.background, view.kappa2());
        let at = (self.width, x0);
        put(self.rgb, at, |p| std::array::from_fn(|i| sums.rgb[i].0[p] + (1.0 - sums.alpha.0[p]) * background[i]));
        put(self.alpha, at, |p| sums.alpha.0[p]);
        put(self.depth, at, |p| sums.depth.0[p]);
        put(self.normal, at, |p| std::array::from_fn(|i| sums.normal[i].0[p]));
        put(self.median_depth, at, |p| sums.median.0[p]);
        // Σ_{i<j} w_i w_j (μ_i - μ_j)² = A M₂ - M₁²; the first splat has μ = 0, so no digits are lost to an offset.
        put(self.distortion, at, |p| {
            (kappa2 * (sums.alpha.0[p] * sums.m2.0[p] - sums.m1.0[p] * sums.m1.0[p])).max(0.0)
        });
        put(self.count, at, |p| sums.count.0[p] as u32);
    }
}

/// Writes the tile with its left edge at `x0` into rows of `width` pixels.
fn put<T>(rows: &mut [T], (width, x0): (usize, usize), value: impl Fn(usize) -> T) {
    for (y, row) in rows.chunks_mut(width).enumerate() {
        for (block, pixels) in row[x0..].chunks_mut(BLOCK).take(TILE / BLOCK).enumerate() {
            let first = place(block * BLOCK, y);
            for (x, pixel) in pixels.iter_mut().enumerate() {
                *pixel = value(first + x);
            }
        }
    }
}

/// Reads the pixels of the tile with its corner at (x0, y0), none of an empty image.
fn take<T: Copy>(image: &[T], width: usize, (x0, y0): (usize, usize), mut pixel: impl FnMut(usize, T)) {
    for (y, row) in image.chunks(width).skip(y0).take(TILE).enumerate() {
        for (block, pixels) in row[x0..].chunks(BLOCK).take(TILE / BLOCK).enumerate() {
            let first = place(block * BLOCK, y);
            for (x, value) in pixels.iter().enumerate() {
                pixel(first + x, *value);
            }
        }
    }
}

/// The sums of tile `t` again. Those of pixels outside the image are of no account, for their gradients are zero.
fn read_sums(render: &Render, saved: &Saved, t: usize, view: &View<'_>, sums: &mut TileSums) {
    let (at, background) = (saved.tiles.corner(t), view.options.background);
    let TileSums { rgb, alpha, depth, normal, median_at, first, m1, m2, .. } = sums;
    take(&render.alpha, render.width, at, |p, v| alpha.0[p] = v);
    take(&render.depth, render.width, at, |p, v| depth.0[p] = v);
    take(&render.rgb, render.width, at, |p, v| {
        for i in 0..3 {
            rgb[i].0[p] = v[i] - (1.0 - alpha.0[p]) * background[i];
        }
    });
    let columns = saved.tiles.columns;
    if let Some(hidden) = saved.hidden[t / columns].get(t % columns) {
        take(&render.normal, render.width, at, |p, v| {
            for i in 0..3 {
                normal[i].0[p] = v[i];
            }
        });
        (*median_at, *first, *m1, *m2) = (hidden.median_at, hidden.first, hidden.m1, hidden.m2);
    }
}

/// From the derivatives by images to those by the sums of the tile with its corner at `at`.
fn read_gradients(
    gradients: &RenderGradients,
    render: &Render,
    at: (usize, usize),
    view: &View<'_>,
    by_sums: &mut TileGradients,
) {
    let (kappa2, [r, g, b]) = (view.kappa2(), view.options.background);
    let TileGradients { rgb, alpha, depth, normal, median, distortion } = by_sums;
    if at.0 + TILE > render.width || at.1 + TILE > render.height {
        // Pixels outside the image.
        for plane in rgb.iter_mut().chain(normal.iter_mut()).chain([&mut *depth, &mut *median, &mut *distortion]) {
            *plane = Plane::ZERO;
        }
    }
    *alpha = Plane::ZERO;
    take(&gradients.alpha, render.width, at, |p, d| alpha.0[p] = d);
    take(&gradients.rgb, render.width, at, |p, d| {
        alpha.0[p] -= d[0] * r + d[1] * g + d[2] * b;
        for i in 0..3 {
            rgb[i].0[p] = d[i];
        }
    });
    take(&gradients.normal, render.width, at, |p, d| {
        for i in 0..3 {
            normal[i].0[p] = d[i];
        }
    });
    take(&gradients.depth, render.width, at, |p, d| depth.0[p] = d);
    take(&gradients.median_depth, render.width, at, |p, d| median.0[p] = d);
    take(&gradients.distortion, render.width, at, |p, d| distortion.0[p] = kappa2 * d);
}
