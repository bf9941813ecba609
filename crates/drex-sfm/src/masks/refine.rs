//! The masks at the full size of the photos, and what is doubtful about each: a cut in a band around the border, by the
//! colours on both sides nearby.

use rayon::prelude::*;

use super::cut::{Cut, Pixel, signed_distance};
use super::rounds::Work;
use super::view::Window;
use super::{Mask, MaskError, MaskInput, Photo, load};

/// Colours are compared with what lies within this many tiles; a tile is this many bands wide.
const TILE_BANDS: usize = 3;
/// Colours kept per tile and side.
const SAMPLES: usize = 40;
/// Spread of a colour on one side of the border, levels of 255.
const SPREAD: f32 = 14.0;

/// Masks at full size, with what is doubtful about each.
pub(super) fn finish(input: &MaskInput<'_>, work: &Work) -> Result<Vec<Mask>, MaskError> {
    let mut view_of = vec![None; input.views.len()];
    for (k, view) in work.views.iter().enumerate() {
        view_of[view.photo] = Some(k);
    }
    (0..input.views.len())
        .into_par_iter()
        .map(|photo| {
            let given = &input.views[photo];
            let Some(k) = view_of[photo] else {
                return Ok(Mask::empty(&given.camera, format!("{}: the box is not in the picture", given.name)));
            };
            let view = &work.views[k];
            let (coarse, s) = (view.window, view.shrink);
            let window = Window {
                x0: coarse.x0 * s,
                y0: coarse.y0 * s,
                x1: (coarse.x1 * s).min(given.camera.width_px() as usize),
                y1: (coarse.y1 * s).min(given.camera.height_px() as usize),
            };
            let object = refine(&load(input, photo)?, &window, work, k);
            let (mask, shape) = (&work.masks[k], &work.silhouettes[k]);
            let both = mask.iter().zip(shape).filter(|(m, s)| **m && **s).count() as f64;
            let either = mask.iter().zip(shape).filter(|(m, s)| **m || **s).count() as f64;
            let own = mask.iter().filter(|m| **m).count() as f64;
            let open = work.evidence[k].iter().zip(&view.inside).filter(|(e, i)| **i && e.abs() < 0.7).count() as f64;
            let undecided = (open / own.max(1.0)).min(1.0);
            let confidence = if either > 0.0 { both / either * (1.0 - 0.5 * undecided) } else { 0.0 };
            let covered =
                own * (s * s) as f64 / (f64::from(given.camera.width_px()) * f64::from(given.camera.height_px()));
            let doubt =
                doubt(confidence, undecided, both / either, covered).map(|why| format!("{}: {why}", given.name));
            Ok(Mask {
                width_px: given.camera.width_px(),
                height_px: given.camera.height_px(),
                confidence,
                undecided,
                doubt,
                window,
                object,
            })
        })
        .collect()
}

/// What is doubtful about a mask that covers `shape` of the shape that all photos voted for, and `covered` of its photo.
fn doubt(confidence: f64, undecided: f64, shape: f64, covered: f64) -> Option<String> {
    const WHOLE: f64 = 0.9;
    if covered == 0.0 {
        Some("nothing in the box looks unlike the background".to_owned())
    } else if covered > WHOLE {
        Some(format!(
            "the mask covers {:.0} % of the photo: the object was not told from what is round it",
            100.0 * covered
        ))
    } else if confidence < 0.75 {
        let (undecided, shape) = (100.0 * undecided, 100.0 * shape);
        Some(format!(
            "{undecided:.0} % of the mask is undecided, and it covers the shape that all photos voted for by {shape:.0} % only"
        ))
    } else {
        None
    }
}

/// The mask of view `k` in `window` of the full photo. A photo less sharp than the others is trusted less along its edges.
fn refine(photo: &Photo, window: &Window, work: &Work, k: usize) -> Vec<bool> {
    let (coarse, sharpness) = (&work.masks[k], work.sharpness[k]);
    let (coarse_window, shrink) = (work.views[k].window, work.views[k].shrink);
    let (w, h) = (window.width(), window.height());
    let from_coarse = |x: usize, y: usize| {
        let cx = ((x + window.x0) / shrink).clamp(coarse_window.x0, coarse_window.x1 - 1) - coarse_window.x0;
        let cy = ((y + window.y0) / shrink).clamp(coarse_window.y0, coarse_window.y1 - 1) - coarse_window.y0;
        coarse[cy * coarse_window.width() + cx]
    };
    let start: Vec<bool> = (0..w * h).map(|at| from_coarse(at % w, at / w)).collect();
    let distance = signed_distance(&start, w, h);
    let band = (1.5 * shrink as f32 + 1.5).max(2.5);
    let colour = |at: usize| {
        let k = 3 * ((at / w + window.y0) * photo.width_px as usize + at % w + window.x0);
        [photo.rgb[k], photo.rgb[k + 1], photo.rgb[k + 2]]
    };
    let tile = TILE_BANDS * band.ceil() as usize;
    let (columns, rows) = (w.div_ceil(tile), h.div_ceil(tile));
    // Colours of both sides per tile, from outside of the band but not far away.
    let mut sides: [Vec<Vec<[u8; 3]>>; 2] = std::array::from_fn(|_| vec![Vec::new(); columns * rows]);
    for at in 0..w * h {
        let d = distance[at];
        if d.abs() > 0.5 * band && d.abs() < 5.0 * band && (at % w + at / w) % 2 == 0 {
            sides[usize::from(d > 0.0)][(at / w / tile) * columns + at % w / tile].push(colour(at));
        }
    }
    for side in &mut sides {
        for all in side.iter_mut().filter(|all| all.len() > SAMPLES) {
            let n = all.len();
            *all = (0..SAMPLES).map(|k| all[k * n / SAMPLES]).collect();
        }
    }
    let nearest = |side: usize, at: usize| {
        let (x, y) = (at % w / tile, at / w / tile);
        let seen = colour(at);
        let mut best = [f32::MAX; 3];
        for row in y.saturating_sub(1)..(y + 2).min(rows) {
            for column in x.saturating_sub(1)..(x + 2).min(columns) {
                for other in &sides[side][row * columns + column] {
                    let d: f32 = (0..3).map(|k| (f32::from(seen[k]) - f32::from(other[k])).powi(2)).sum();
                    if d < best[2] {
                        best[2] = d;
                        best.sort_by(f32::total_cmp);
                    }
                }
            }
        }
        (best[2] < f32::MAX).then(|| best.iter().sum::<f32>() / 3.0)
    };
    let pixels: Vec<Pixel> = (0..w * h)
        .map(|at| {
            let d = distance[at];
            if d.abs() > band {
                return if d > 0.0 { Pixel::Object } else { Pixel::Background };
            }
            let colours = match (nearest(1, at), nearest(0, at)) {
                (Some(object), Some(background)) => {
                    // Both capped: a colour that neither side has says nothing.
                    let cap = 9.0 * SPREAD * SPREAD;
                    ((background.min(cap) - object.min(cap)) / (2.0 * SPREAD * SPREAD)).clamp(-3.0, 3.0)
                }
                _ => 0.0,
            };
            Pixel::Open(colours * sharpness + (1.5 - sharpness) * d / band)
        })
        .collect();
    Cut { width: w, height: h, pixels: &pixels, colour: &colour }.solve()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_of_nearly_all_of_its_photo_is_doubted_however_well_photos_agree() {
        assert!(doubt(0.99, 0.0, 1.0, 0.96).unwrap().contains("covers 96 % of the photo"));
        assert!(doubt(0.99, 0.0, 1.0, 0.0).unwrap().contains("nothing in the box"));
        assert!(doubt(0.5, 0.4, 0.6, 0.3).unwrap().contains("40 % of the mask is undecided"));
        assert_eq!(doubt(0.9, 0.1, 0.95, 0.7), None);
    }
}
