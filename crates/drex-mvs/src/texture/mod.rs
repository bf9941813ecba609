//! One picture for a mesh, of the colours that photos show.
//!
//! ```text
//! mesh ─► charts (flat, without overlap) ─► atlas (texels) ─┐
//! photos ─► shot (what is seen, how well; low frequencies) ─┼─► gains, agreement (per cell of the atlas) ─► paint ─► fill ─► PNG
//! ```
//! Low frequencies are the mean of all photos that agree, high ones are the best photo's alone: so neither seams nor ghosts are seen (Burt and
//! Adelson 1983). Colours are blended in linear light.

mod atlas;
mod charts;
mod fill;
mod gains;
mod normals;
mod points;
mod shot;

use drex_core::capture::{Capture, PhotoOptions, Photos};
use drex_core::{Error, Result, TriMesh};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::Serialize;

use crate::maps::Step;
use atlas::{Atlas, CELL};
use gains::CellColour;
use normals::corner_normals;
pub use points::{Prediction, TexturedPoint, prediction, textured_points};
use shot::{LEAST_COSINE, Shot};

/// Photos that are held at once.
const BATCH: usize = 4;
/// Bytes that a texel takes in a PNG of photos, about; the first guess of how large the picture may be.
const BYTES_PER_TEXEL: f64 = 2.0;
/// Photos are scaled down to about this many pixels per texel.
const PIXELS_PER_TEXEL: f64 = 1.4;
/// Standard deviation of the blur that parts low from high frequencies, texels.
const BLUR_TEXELS: f64 = 4.0;
/// One of so many texels speaks for its cell.
const CELL_STEP: usize = 5;
/// Half the side of the window round a sparse point in which its colour is taken, as a share of the photo's longer side.
const WINDOW_SHARE: f64 = 0.004;
/// Pictures that are tried until one is small enough.
const TRIES: usize = 6;
/// Limits of [`TextureOptions::max_side`].
const SIDES: std::ops::RangeInclusive<usize> = 64..=16384;
/// Least value of [`TextureOptions::max_bytes`].
const LEAST_BYTES: usize = 10_000;

/// How a mesh is textured.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TextureOptions {
    /// Longest side of the picture, texels.
    pub max_side: usize,
    /// Largest size of the PNG file, bytes.
    pub max_bytes: usize,
}

impl Default for TextureOptions {
    fn default() -> Self {
        Self { max_side: 2048, max_bytes: 4_000_000 }
    }
}

/// A picture, and where on it the faces of a mesh lie.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Texture {
    /// Of each face the texture coordinates of its corners: u to the right, v down, both from 0 at the upper left corner to 1.
    pub uv: Vec<[[f32; 2]; 3]>,
    /// The picture, a PNG file of sRGB colours.
    pub png: Vec<u8>,
    /// How it was made.
    pub report: TextureReport,
}

/// How a texture was made.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct TextureReport {
    /// Columns and rows of the picture.
    pub size_px: [usize; 2],
    /// Bytes of the PNG file.
    pub bytes: usize,
    /// Side of a texel, in the unit of the mesh.
    pub texel: f64,
    /// Charts into which the mesh is cut.
    pub charts: usize,
    /// Share of the picture that shows the mesh.
    pub used_share: f64,
    /// Share of the texels that photos show; the others are filled from those beside them.
    pub seen_share: f64,
    /// Share of what photos show that was left out because most photos show something else.
    pub outlier_share: f64,
    /// Photos that show the mesh.
    pub photos: Vec<PhotoGain>,
}

/// Exposure of a photo against the others.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PhotoGain {
    /// Name of the photo.
    pub name: String,
    /// Red, green and blue in it over those of the texture, linear light.
    pub gain: [f64; 3],
}

/// Colours a mesh, given in the capture's world and unit, by the photos of a capture. The same input gives the same bytes with any number of
/// threads. Photos are read twice each and not kept.
///
/// # Errors
/// If the mesh is empty or malformed, falls into more charts than the picture has room for, an option is out of range, a photo cannot be read,
/// or none shows the mesh.
pub fn texture(
    mesh: &TriMesh,
    capture: &Capture,
    options: &TextureOptions,
    progress: &(dyn Fn(Step) + Sync),
) -> Result<Texture> {
    options.check()?;
    let mesh = &TriMesh::new(mesh.vertices.clone(), mesh.faces.clone())?;
    if mesh.faces.is_empty() {
        return Err(Error::value("a mesh without faces", "give the mesh of the object"));
    }
    let finest = finest_pixel(mesh, capture)?;
    let within_bytes = (mesh.area() * BYTES_PER_TEXEL / options.max_bytes as f64).sqrt();
    let mut texel = finest.max(within_bytes);
    for _ in 0..TRIES {
        let atlas = Atlas::new(mesh, texel, options.max_side)?;
        let mut photo_options = PhotoOptions::default();
        let scale = PIXELS_PER_TEXEL * finest / atlas.texel;
        let longest = capture.views.iter().map(|v| v.lens.width_px().max(v.lens.height_px())).max().unwrap_or(0);
        photo_options.max_side = (scale < 1.0).then(|| ((scale * f64::from(longest)) as usize).max(1));
        photo_options.memory_bytes = 0;
        let normals = corner_normals(mesh);
        let work = Work { mesh, capture, normals, photos: Photos::new(capture, photo_options)?, atlas, progress };
        let (rgb, report) = work.painted()?;
        let png = encoded(&rgb, report.size_px)?;
        if png.len() <= options.max_bytes {
            let size = report.size_px.map(|s| s as f64);
            let uv = |corners: &[[f64; 2]; 3]| corners.map(|[x, y]| [(x / size[0]) as f32, (y / size[1]) as f32]);
            let uv = work.atlas.corners.iter().map(uv).collect();
            return Ok(Texture { uv, report: TextureReport { bytes: png.len(), ..report }, png });
        }
        texel = 1.05 * work.atlas.texel * (png.len() as f64 / options.max_bytes as f64).sqrt();
    }
    Err(Error::value(
        format!("no picture of the mesh has less than {} bytes", options.max_bytes),
        "allow more bytes, or give a simpler mesh",
    ))
}

impl Texture {
    /// Width and height of the picture, and its colours row by row.
    ///
    /// # Errors
    /// If the file was changed and is no picture any more.
    pub fn pixels(&self) -> Result<([usize; 2], Vec<[u8; 3]>)> {
        let picture = image::load_from_memory(&self.png)
            .map_err(|e| {
                Error::value(format!("the picture cannot be decoded: {e}"), "give the PNG file as it was made")
            })?
            .into_rgb8();
        let size = [picture.width() as usize, picture.height() as usize];
        Ok((size, picture.pixels().map(|p| p.0).collect()))
    }
}

impl TextureOptions {
    fn check(&self) -> Result<()> {
        if SIDES.contains(&self.max_side) && self.max_bytes >= LEAST_BYTES {
            return Ok(());
        }
        Err(Error::value(
            format!("a texture with sides up to {} and up to {} bytes", self.max_side, self.max_bytes),
            format!("give a side from {} to {} and at least {LEAST_BYTES} bytes", SIDES.start(), SIDES.end()),
        ))
    }
}

/// Width of a pixel of the nearest photo that a face turns to, the median over the area of the mesh.
fn finest_pixel(mesh: &TriMesh, capture: &Capture) -> Result<f64> {
    let cameras = (0..capture.views.len()).map(|i| capture.pinhole(i, None)).collect::<Result<Vec<_>>>()?;
    let finest = |f: usize| {
        let [a, b, c] = mesh.triangle(f);
        let normal = (b - a).cross(&(c - a));
        let middle = Point3::from((a.coords + b.coords + c.coords) / 3.0);
        let seen = cameras.iter().filter_map(|camera| {
            let ([x, y], z) = camera.project(&middle)?;
            let ray = middle - camera.centre();
            let within = (0.0..camera.width as f64).contains(&x) && (0.0..camera.height as f64).contains(&y);
            let facing = -normal.dot(&ray) > LEAST_COSINE * normal.norm() * ray.norm();
            (within && facing).then(|| z / camera.fx)
        });
        Some((seen.min_by(f64::total_cmp)?, normal.norm()))
    };
    let mut sizes: Vec<(f64, f64)> = (0..mesh.faces.len()).into_par_iter().filter_map(finest).collect();
    sizes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * sizes.iter().map(|s| s.1).sum::<f64>();
    let mut sum = 0.0;
    let median = sizes.iter().find(|s| {
        sum += s.1;
        sum >= half
    });
    median.map(|s| s.0).filter(|s| *s > 0.0).ok_or_else(|| {
        Error::value(
            format!("none of the {} photos shows the mesh", cameras.len()),
            "give the mesh in the frame and unit of the capture",
        )
    })
}

fn encoded(rgb: &[[u8; 3]], [width, height]: [usize; 2]) -> Result<Vec<u8>> {
    let mut png = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut png, CompressionType::Best, FilterType::Adaptive);
    encoder
        .write_image(rgb.as_flattened(), width as u32, height as u32, ExtendedColorType::Rgb8)
        .map_err(|e| Error::value(format!("the picture cannot be encoded: {e}"), "allow a smaller side"))?;
    Ok(png)
}

/// One picture at work.
struct Work<'a> {
    mesh: &'a TriMesh,
    capture: &'a Capture,
    /// Unit normals of the corners of each face.
    normals: Vec<[Vector3<f64>; 3]>,
    photos: Photos,
    atlas: Atlas,
    progress: &'a (dyn Fn(Step) + Sync),
}

/// What photos say of a texel so far.
#[derive(Clone, Copy, Default)]
struct Paint {
    /// Weighted sum of the low frequencies, and of the weights.
    low: [f32; 3],
    weight: f32,
    /// High frequencies of the best photo, and its score.
    high: [f32; 3],
    best: f32,
}

impl Work<'_> {
    /// The picture, sRGB, and what is known of it.
    fn painted(&self) -> Result<(Vec<[u8; 3]>, TextureReport)> {
        let atlas = &self.atlas;
        let (gains, agreement, shown) = self.compared()?;
        let mut paints = vec![Paint::default(); atlas.texels.len()];
        self.each_shot(1, |view, shot| {
            paints.par_iter_mut().enumerate().for_each(|(t, paint)| {
                let Some(s) = self.sample(t, shot) else { return };
                let agrees = self.agreement_at(&agreement, t, view);
                let gain = gains[view].map(|g| g as f32);
                // Pixels per area of the surface; the low frequencies are a mean, in which surfaces seen aslant count little.
                let weight = agrees * s.trust * s.resolution * s.resolution * s.cosine;
                let wide = weight * s.cosine * s.cosine;
                (0..3).for_each(|k| paint.low[k] += wide * s.low[k] / gain[k]);
                paint.weight += wide;
                if weight * s.cosine > paint.best {
                    paint.best = weight * s.cosine;
                    paint.high = [0, 1, 2].map(|k| (s.full[k] - s.low[k]) / gain[k]);
                }
            });
        })?;
        let mut colours: Vec<Option<[f32; 3]>> = paints
            .iter()
            .map(|p| (p.weight > 0.0).then(|| [0, 1, 2].map(|k| (p.low[k] / p.weight + p.high[k]).max(0.0))))
            .collect();
        let seen = colours.iter().flatten().count();
        if seen == 0 {
            return Err(Error::value(
                format!("none of the {} photos shows the mesh well enough", self.photos.len()),
                "give the mesh in the frame and unit of the capture, and masks that show the object",
            ));
        }
        fill::fill_unseen(atlas, &self.mesh.faces, &mut colours);
        let rgb = fill::picture(atlas, &colours);
        let (mut of, mut out) = (0.0, 0.0);
        for (view, cells) in shown.iter().enumerate() {
            for (row, _) in agreement.iter().zip(cells).filter(|(_, c)| c[3] > 0.0) {
                (of, out) = (of + 1.0, out + 1.0 - f64::from(row[view]));
            }
        }
        let photos = shown.iter().enumerate().filter(|(_, cells)| cells.iter().any(|c| c[3] > 0.0));
        let report = TextureReport {
            size_px: [atlas.width, atlas.height],
            bytes: 0,
            texel: atlas.texel,
            charts: atlas.charts,
            used_share: atlas.texels.len() as f64 / atlas.index.len() as f64,
            seen_share: seen as f64 / atlas.texels.len() as f64,
            outlier_share: out / f64::max(of, 1.0),
            photos: photos.map(|(v, _)| PhotoGain { name: self.photos.name(v).to_owned(), gain: gains[v] }).collect(),
        };
        Ok((rgb.par_iter().map(|c| c.map(srgb)).collect(), report))
    }

    /// Gains of the photos, how far each one agrees with the others about each cell, and the cells' colours in each.
    #[expect(clippy::type_complexity, reason = "named in the sentence above, taken apart by its only caller")]
    fn compared(&self) -> Result<(Vec<[f64; 3]>, Vec<Vec<f32>>, Vec<Vec<CellColour>>)> {
        let atlas = &self.atlas;
        let speakers: Vec<usize> = (0..atlas.texels.len()).step_by(CELL_STEP).collect();
        let mut cells = vec![Vec::new(); self.photos.len()];
        self.each_shot(0, |view, shot| {
            let samples: Vec<_> = speakers.par_iter().map(|&t| self.sample(t, shot)).collect();
            let mut sums = vec![[0.0f32; 4]; atlas.cells.len()];
            for (t, s) in speakers.iter().zip(samples) {
                let Some(s) = s else { continue };
                let weight = s.trust * s.cosine;
                let sum = &mut sums[atlas.cell(atlas.texels[*t].at)];
                (0..3).for_each(|k| sum[k] += weight * s.low[k]);
                sum[3] += weight;
            }
            sums.iter_mut().filter(|s| s[3] > 0.0).for_each(|s| (0..3).for_each(|k| s[k] /= s[3]));
            cells[view] = sums;
        })?;
        for (cells, count) in cells.iter_mut().map(|c| (c, atlas.cells.len())) {
            cells.resize(count, [0.0; 4]);
        }
        let scene = (0..self.photos.len()).map(|v| self.scene_colours(v)).collect::<Result<Vec<_>>>()?;
        let gains = gains::gains(&scene, &cells);
        let agreement = self.most_doubtful_neighbour(&gains::agreement(&cells, &gains));
        Ok((gains, agreement, cells))
    }

    /// Colours round the sparse points that a photo sees: a highlight that lies all over a side of the object brightens that side alone, an exposure
    /// the table and the room as well.
    fn scene_colours(&self, view: usize) -> Result<Vec<CellColour>> {
        let mut colours = vec![[0.0; 4]; self.capture.points.len()];
        let seen: Vec<usize> = self.capture.views[view].keypoints.iter().filter_map(|k| k.point).collect();
        if seen.is_empty() {
            return Ok(colours);
        }
        let photo = self.photos.get(view)?;
        let camera = &photo.camera;
        let (width, height) = (camera.width, camera.height);
        let reach = (WINDOW_SHARE * width.max(height) as f64).ceil() as usize;
        for p in seen {
            let at = self.capture.points.get(p).and_then(|p| camera.project(&p.position.into()));
            let Some(([x, y], _)) = at else { continue };
            if !(x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64) {
                continue;
            }
            let around =
                |at: f64, size: usize| (at as usize).saturating_sub(reach)..(at as usize + reach + 1).min(size);
            let mut sum = [0.0; 4];
            for row in around(y, height) {
                for c in &photo.rgb[row * width..][around(x, width)] {
                    (0..3).for_each(|k| sum[k] += shot::linear(f32::from(c[k]) / 255.0));
                    sum[3] += 1.0;
                }
            }
            colours[p] = [sum[0] / sum[3], sum[1] / sum[3], sum[2] / sum[3], 1.0];
        }
        Ok(colours)
    }

    /// Each cell as doubtful as the most doubtful one that touches it in its chart: what is in the way does not end where cells do.
    fn most_doubtful_neighbour(&self, agreement: &[Vec<f32>]) -> Vec<Vec<f32>> {
        let (columns, rows) = (self.atlas.width / CELL, self.atlas.height / CELL);
        let of = |cell: usize| {
            let (x, y) = (cell % columns, cell / columns);
            let mut out = agreement[cell].clone();
            for v in y.saturating_sub(1)..(y + 2).min(rows) {
                for other in (x.saturating_sub(1)..(x + 2).min(columns)).map(|u| v * columns + u) {
                    if self.atlas.cells[other] == self.atlas.cells[cell] {
                        out.iter_mut().zip(&agreement[other]).for_each(|(own, other)| *own = own.min(*other));
                    }
                }
            }
            out
        };
        (0..agreement.len()).into_par_iter().map(of).collect()
    }

    /// Hands the photos to `take`, one after the other in their order.
    fn each_shot(&self, pass: usize, mut take: impl FnMut(usize, &Shot)) -> Result<()> {
        let total = 2 * self.photos.len();
        let views: Vec<usize> = (0..self.photos.len()).collect();
        for batch in views.chunks(BATCH) {
            let shot = |&v: &usize| -> Result<Option<Shot>> {
                Ok(Shot::new(&*self.photos.get(v)?, self.mesh, BLUR_TEXELS * self.atlas.texel))
            };
            let shots: Vec<Option<Shot>> = batch.par_iter().map(shot).collect::<Result<_>>()?;
            for (&view, shot) in batch.iter().zip(shots) {
                if let Some(shot) = shot {
                    take(view, &shot);
                }
            }
            (self.progress)(Step {
                stage: "texture",
                done: pass * self.photos.len() + batch[batch.len() - 1] + 1,
                total,
            });
        }
        Ok(())
    }

    fn sample(&self, t: usize, shot: &Shot) -> Option<shot::Sample> {
        let texel = &self.atlas.texels[t];
        let corners = &self.normals[texel.face as usize];
        let normal: Vector3<f64> = (0..3).map(|k| f64::from(texel.weights[k]) * corners[k]).sum();
        shot.sample(&texel.point(self.mesh), &normal.try_normalize(0.0)?)
    }

    /// How far a photo agrees with the others about a texel, between the four cells round it.
    fn agreement_at(&self, agreement: &[Vec<f32>], t: usize, view: usize) -> f32 {
        let atlas = &self.atlas;
        let (columns, rows) = (atlas.width / CELL, atlas.height / CELL);
        let at = atlas.texels[t].at as usize;
        let chart = atlas.cells[atlas.cell(at as u32)];
        let place = |x: usize| (x as f32 + 0.5) / CELL as f32 - 0.5;
        let (x, y) = (place(at % atlas.width), place(at / atlas.width));
        let (mut sum, mut weights) = (0.0, 0.0);
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (u, v) = (x.floor() as isize + dx, y.floor() as isize + dy);
            let weight = (1.0 - (x - u as f32).abs()) * (1.0 - (y - v as f32).abs());
            if u < 0 || v < 0 || u >= columns as isize || v >= rows as isize {
                continue;
            }
            let cell = v as usize * columns + u as usize;
            if atlas.cells[cell] == chart {
                sum += weight * agreement[cell][view];
                weights += weight;
            }
        }
        sum / weights.max(f32::MIN_POSITIVE)
    }
}

/// Linear light to sRGB of 8 bits.
fn srgb(c: f32) -> u8 {
    (display(c) * 255.0).round() as u8
}

/// Linear light to sRGB from 0 to 1 (IEC 61966-2-1).
fn display(c: f32) -> f32 {
    let v = if c <= 0.003_130_8 { c * 12.92 } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
    v.clamp(0.0, 1.0)
}
