//! Surfels (Huang et al. 2024, 2DGS): discs that know depth and normal at every pixel.

mod backward;
mod bounds;
mod forward;
mod project;

use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

use super::lanes::{BLOCK, least_exponent, place};
use super::sh;
use crate::raster::{DepthKind, GaussianGradients, Render, RenderGradients, RenderOptions, ScreenBox, TILE, Tiles};
use crate::{Gaussians, PinholeCamera, Result};
use backward::{Differentiate, Record, TileGradients};
use bounds::Footprint;
use forward::{Draw, Projected, Rules, Splat, TileSums};
use project::{Surfel, SurfelGradient, rotation, rotation_backward};

/// A plane that is met farther away than this many times the depth of the surfel's centre is seen edge-on: not drawn.
const MAX_DEPTH_RATIO: f64 = 1e6;
/// Coefficients beyond this leave the range of single precision on the way to a pixel; such a surfel is not drawn.
const MAX_COEFFICIENT: f32 = 1e15;

#[derive(Debug, Clone)]
pub(super) struct Saved {
    tiles: Tiles,
    projected: Vec<Projected>,
    /// Blocks of its tile that a splat touched, for every slot.
    blocks: Vec<u16>,
    sums: Vec<TileSums>,
}

pub(super) fn forward(scene: &Gaussians, camera: &PinholeCamera, options: &RenderOptions) -> Result<(Render, Saved)> {
    let view = View::new(camera, options);
    let (projected, boxes): (Vec<Projected>, Vec<ScreenBox>) =
        (0..scene.len()).into_par_iter().with_min_len(256).map(|i| view.project(scene, i).unwrap_or_default()).unzip();
    let tiles = Tiles::new(&boxes, camera.width, camera.height, |i, column, row| {
        meets_tile(&projected[i].footprint, column, row)
    });
    let rules = view.rules();
    let mut blocks = vec![0; tiles.slot_count()];
    let sums = tiles
        .cut_records(&mut blocks)
        .into_par_iter()
        .enumerate()
        .map_init(Vec::new, |scratch, (t, blocks)| {
            let mut sums = TileSums::ZERO;
            let (list, corner) = (tiles.list(t), corner(&tiles, t));
            pulp::Arch::new().dispatch(Draw {
                projected: &projected,
                list,
                corner,
                scratch,
                blocks,
                rules,
                sums: &mut sums,
            });
            sums
        })
        .collect();
    let saved = Saved { tiles, projected, blocks, sums };
    Ok((view.images(&saved), saved))
}

pub(super) fn backward(
    scene: &Gaussians,
    camera: &PinholeCamera,
    options: &RenderOptions,
    render: &Render,
    saved: &Saved,
    gradients: &RenderGradients,
) -> Result<GaussianGradients> {
    let view = View::new(camera, options);
    let (tiles, rules) = (&saved.tiles, view.rules());
    let mut records = vec![Record::default(); tiles.slot_count()];
    let mut hits = saved.blocks.as_slice();
    let hits: Vec<&[u16]> = (0..tiles.len())
        .map(|t| {
            let (of_tile, rest) = hits.split_at(tiles.list(t).len());
            hits = rest;
            of_tile
        })
        .collect();
    tiles.cut_records(&mut records).into_par_iter().zip(hits).enumerate().for_each_init(
        || (Vec::new(), Box::new(TileGradients::ZERO)),
        |(scratch, by_sums), (t, (records, blocks))| {
            if records.is_empty() {
                return;
            }
            let corner = corner(tiles, t);
            scratch.clear();
            scratch.extend(tiles.list(t).iter().map(|&i| saved.projected[i as usize].splat.in_tile(corner)));
            view.load_gradients(gradients, render, tiles.corner(t), by_sums);
            let sums = &saved.sums[t];
            pulp::Arch::new().dispatch(Differentiate {
                splats: scratch,
                blocks,
                rules,
                sums,
                gradients: by_sums,
                records,
            });
        },
    );
    Ok(view.gather(scene, saved, &records))
}

/// `count` pixels of an image, none of an empty one.
fn row<T>(image: &[T], from: usize, count: usize) -> &[T] {
    image.get(from..from + count).unwrap_or_default()
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

/// A camera with what is used of it for every surfel.
struct View<'a> {
    camera: &'a PinholeCamera,
    options: &'a RenderOptions,
    /// Rotation of camera_from_world.
    w: Matrix3<f64>,
    centre: nalgebra::Point3<f64>,
}

impl<'a> View<'a> {
    fn new(camera: &'a PinholeCamera, options: &'a RenderOptions) -> Self {
        let w = camera.camera_from_world.rotation.to_rotation_matrix().into_inner();
        Self { camera, options, w, centre: camera.centre() }
    }

    fn rules(&self) -> Rules {
        Rules {
            max_alpha: self.options.max_alpha,
            max_inverse_depth: 1.0 / self.options.near,
            ray_depth: self.options.depth == DepthKind::Ray,
            geometry: self.options.geometry,
            smooth: self.options.smooth_cutoff,
        }
    }

    /// (m_i - m_j)² = κ² (1/z_i - 1/z_j)² with m = far / (far - near) (1 - near / z).
    fn kappa2(&self) -> f32 {
        let [near, far] = self.options.distortion_range;
        (far * near / (far - near)).powi(2)
    }

    fn surfel(&self, scene: &Gaussians, i: usize) -> Option<Surfel> {
        let r = self.w * rotation(scene.rotations[i])?;
        let mean = Vector3::from(scene.means[i].map(f64::from));
        let t = self.w * mean + self.camera.camera_from_world.translation.vector;
        let [log_u, log_v, _] = scene.log_scales[i].map(f64::from);
        let (near, c2) = (f64::from(self.options.near), f64::from(self.options.centre_cutoff));
        Surfel::new(self.camera, r, [log_u, log_v], t, near, c2)
    }

    /// None if the surfel is nowhere in the image.
    fn project(&self, scene: &Gaussians, i: usize) -> Option<(Projected, ScreenBox)> {
        let opacity = 1.0 / (1.0 + (-f64::from(scene.logit_opacities[i])).exp());
        let least = f64::from(least_exponent(self.options.smooth_cutoff));
        let radius2 = 2.0 * std::f64::consts::LN_2 * (opacity.log2() - least);
        let surfel = self.surfel(scene, i)?;
        let footprint = Footprint::new(&surfel, radius2, f64::from(self.options.near))?;
        let screen_box = self.screen_box(&footprint, surfel.t.z as f32);
        if screen_box.x0 >= screen_box.x1 || screen_box.y0 >= screen_box.y1 {
            return None;
        }
        let stride = scene.sh_stride();
        let (direction, _) = sh::direction(scene.means[i], &self.centre);
        // A floor beyond the camera's plane is put where no pixel is.
        let centre = surfel.centre.unwrap_or(Vector2::repeat(1e6)).map(|x| x.clamp(-1e6, 1e6) as f32);
        let splat = Splat {
            m: std::array::from_fn(|k| surfel.m[(k / 3, k % 3)] as f32),
            origin: surfel.origin.map(|x| x as f32),
            centre: centre.into(),
            log2_opacity: opacity.log2() as f32,
            radius2: radius2 as f32,
            min_inverse_depth: (1.0 / (MAX_DEPTH_RATIO * surfel.t.z)) as f32,
            colour: sh::colour(self.options.sh_degree, &scene.sh[i * stride..(i + 1) * stride], &direction),
            normal: surfel.normal().map(|x| x as f32).into(),
            depth: surfel.t.z as f32,
        };
        let sound = splat.m.iter().all(|m| m.abs() < MAX_COEFFICIENT) && splat.depth < MAX_COEFFICIENT;
        sound.then_some((Projected { splat, footprint }, screen_box))
    }

    fn screen_box(&self, footprint: &Footprint, depth: f32) -> ScreenBox {
        let pixels = |[lo, hi]: [f32; 2], side: usize| {
            let side = side as f32;
            [(lo - 0.5).ceil().clamp(0.0, side), ((hi - 0.5).floor() + 1.0).clamp(0.0, side)].map(|v| v as u16)
        };
        let [x0, x1] = pixels(footprint.x, self.camera.width);
        let [y0, y1] = pixels(footprint.y, self.camera.height);
        ScreenBox { x0, y0, x1, y1, depth }
    }

    fn images(&self, saved: &Saved) -> Render {
        let (width, height, options) = (self.camera.width, self.camera.height, self.options);
        let (background, kappa2) = (options.background, self.kappa2());
        let pixels = |sums: &TileSums, p: usize| -> [f32; 3] {
            std::array::from_fn(|i| sums.rgb[i].0[p] + (1.0 - sums.alpha.0[p]) * background[i])
        };
        let image = |wanted, value: fn(&TileSums, usize) -> f32| self.image(saved, wanted, value);
        let g = options.geometry;
        Render {
            width,
            height,
            rgb: self.image(saved, true, pixels),
            alpha: image(true, |s, p| s.alpha.0[p]),
            depth: image(true, |s, p| s.depth.0[p]),
            normal: self.image(saved, g, |s, p| std::array::from_fn(|i| s.normal[i].0[p])),
            median_depth: image(g, |s, p| s.median.0[p]),
            // Σ_{i<j} w_i w_j (μ_i - μ_j)² = A M₂ - M₁²; the first splat has μ = 0, so no digits are lost to an offset.
            distortion: self
                .image(saved, g, |s, p| (kappa2 * (s.alpha.0[p] * s.m2.0[p] - s.m1.0[p] * s.m1.0[p])).max(0.0)),
            count: self.image(saved, options.count, |s, p| s.count.0[p] as u32),
        }
    }

    /// An image from the sums of its tiles, empty unless `wanted`.
    fn image<T: Send + Copy + Default>(
        &self,
        saved: &Saved,
        wanted: bool,
        value: impl Fn(&TileSums, usize) -> T + Sync,
    ) -> Vec<T> {
        if !wanted {
            return Vec::new();
        }
        let (width, columns) = (self.camera.width, saved.tiles.columns);
        let mut image = vec![T::default(); width * self.camera.height];
        image.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (column, piece) in row.chunks_mut(TILE).enumerate() {
                let sums = &saved.sums[y / TILE * columns + column];
                for (block, pixels) in piece.chunks_mut(BLOCK).enumerate() {
                    let first = place(block * BLOCK, y % TILE);
                    for (x, pixel) in pixels.iter_mut().enumerate() {
                        *pixel = value(sums, first + x);
                    }
                }
            }
        });
        image
    }

    /// From the derivatives by images to those by the sums of the tile with its corner at pixel (x0, y0).
    fn load_gradients(
        &self,
        gradients: &RenderGradients,
        render: &Render,
        (x0, y0): (usize, usize),
        by_sums: &mut TileGradients,
    ) {
        let (kappa2, [r, g, b]) = (self.kappa2(), self.options.background);
        let (columns, rows) = (TILE.min(render.width - x0), TILE.min(render.height - y0));
        if columns < TILE || rows < TILE {
            *by_sums = TileGradients::ZERO;
        }
        for y in 0..rows {
            let from = (y0 + y) * render.width + x0;
            let at = |x: usize| place(x, y);
            for (x, d) in row(&gradients.rgb, from, columns).iter().enumerate() {
                by_sums.alpha.0[at(x)] = -(d[0] * r + d[1] * g + d[2] * b);
                for i in 0..3 {
                    by_sums.rgb[i].0[at(x)] = d[i];
                }
            }
            let shown = !gradients.rgb.is_empty();
            for (x, d) in row(&gradients.alpha, from, columns).iter().enumerate() {
                let background = if shown { by_sums.alpha.0[at(x)] } else { 0.0 };
                by_sums.alpha.0[at(x)] = background + d;
            }
            for (x, d) in row(&gradients.normal, from, columns).iter().enumerate() {
                for i in 0..3 {
                    by_sums.normal[i].0[at(x)] = d[i];
                }
            }
            for (x, d) in row(&gradients.depth, from, columns).iter().enumerate() {
                by_sums.depth.0[at(x)] = *d;
            }
            for (x, d) in row(&gradients.median_depth, from, columns).iter().enumerate() {
                by_sums.median.0[at(x)] = *d;
            }
            for (x, d) in row(&gradients.distortion, from, columns).iter().enumerate() {
                by_sums.distortion.0[at(x)] = kappa2 * d;
            }
        }
    }

    /// Sums the records of every surfel and takes them back to its parameters.
    fn gather(&self, scene: &Gaussians, saved: &Saved, records: &[Record]) -> GaussianGradients {
        let stride = scene.sh_stride();
        let mut sh = vec![0.0; scene.sh.len()];
        let own: Vec<Own> = sh
            .par_chunks_mut(stride)
            .enumerate()
            .with_min_len(64)
            .map(|(i, d_sh)| self.of_one(scene, saved, records, i, d_sh))
            .collect();
        let mut twist = [0.0; 6];
        for one in &own {
            for k in 0..6 {
                twist[k] += one.twist[k];
            }
        }
        GaussianGradients {
            means: own.iter().map(|o| o.mean).collect(),
            rotations: own.iter().map(|o| o.rotation).collect(),
            log_scales: own.iter().map(|o| o.log_scale).collect(),
            logit_opacities: own.iter().map(|o| o.logit_opacity).collect(),
            sh,
            mean2d: own.iter().map(|o| o.mean2d).collect(),
            abs_mean2d: own.iter().map(|o| o.abs_mean2d).collect(),
            radius: own.iter().map(|o| o.radius).collect(),
            twist,
        }
    }

    fn of_one(&self, scene: &Gaussians, saved: &Saved, records: &[Record], i: usize, d_sh: &mut [f32]) -> Own {
        let slots = saved.tiles.slots_of(i);
        let surfel = if slots.is_empty() { None } else { self.surfel(scene, i) };
        let Some(surfel) = surfel else { return Own::default() };
        let sum = Sum::of(slots.iter().map(|&slot| &records[slot as usize]));
        let g = SurfelGradient { m: sum.m, centre: sum.centre, normal: sum.normal, depth: sum.depth };
        let frame = surfel.backward(&g, f64::from(self.options.centre_cutoff));

        let (direction, inverse_distance) = sh::direction(scene.means[i], &self.centre);
        let stride = scene.sh_stride();
        let by_direction = sh::colour_backward(
            self.options.sh_degree,
            &scene.sh[i * stride..(i + 1) * stride],
            (&direction, inverse_distance),
            saved.projected[i].splat.colour,
            sum.colour.map(|c| c as f32).into(),
            d_sh,
        )
        .map(f64::from);

        let by_rotation = rotation_backward(scene.rotations[i], &(self.w.transpose() * frame.r));
        let mean = self.w.transpose() * frame.t + by_direction;
        // Moving the camera by ρ moves every point by ρ in the camera frame. Turning it turns discs and points, but not
        // the directions that colours are seen from.
        let rho = self.w * mean;
        let phi = (0..3).fold(surfel.t.cross(&frame.t), |phi, k| phi + surfel.r.column(k).cross(&frame.r.column(k)));
        let opacity = 1.0 / (1.0 + (-f64::from(scene.logit_opacities[i])).exp());
        let last = sum.m.column(2);
        let mean2d: [f64; 2] = std::array::from_fn(|k| sum.centre[k] - surfel.m.column(k).dot(&last));
        Own {
            mean: mean.map(single).into(),
            rotation: by_rotation.map(single),
            log_scale: [single(frame.log_s[0]), single(frame.log_s[1]), 0.0],
            logit_opacity: single(sum.log_opacity * (1.0 - opacity)),
            mean2d: mean2d.map(single),
            abs_mean2d: sum.abs.map(single).into(),
            radius: saved.projected[i].footprint.radius,
            twist: [rho.x, rho.y, rho.z, phi.x, phi.y, phi.z],
        }
    }
}

/// In single precision; what is too large for it becomes its largest number.
fn single(x: f64) -> f32 {
    if x.is_nan() { 0.0 } else { x.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32 }
}

/// Derivatives by the parameters of one surfel.
#[derive(Debug, Clone, Copy, Default)]
struct Own {
    mean: [f32; 3],
    rotation: [f32; 4],
    log_scale: [f32; 3],
    logit_opacity: f32,
    mean2d: [f32; 2],
    abs_mean2d: [f32; 2],
    radius: f32,
    twist: [f64; 6],
}

/// The records of one surfel together.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    m: Matrix3<f64>,
    centre: Vector2<f64>,
    abs: Vector2<f64>,
    log_opacity: f64,
    colour: Vector3<f64>,
    normal: Vector3<f64>,
    depth: f64,
}

impl Sum {
    fn of<'r>(records: impl Iterator<Item = &'r Record>) -> Self {
        let mut sum = Self::default();
        for r in records {
            sum.m += Matrix3::from_row_slice(&r.m.map(f64::from));
            sum.centre += Vector2::from(r.centre.map(f64::from));
            sum.abs += Vector2::from(r.abs.map(f64::from));
            sum.log_opacity += f64::from(r.log_opacity);
            sum.colour += Vector3::from(r.colour.map(f64::from));
            sum.normal += Vector3::from(r.normal.map(f64::from));
            sum.depth += f64::from(r.depth);
        }
        sum
    }
}
