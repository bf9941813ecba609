//! Which places within the footprint of the box are the plane and not under the object, before there are masks.
//!
//! A place of the plane looks the same in all photos that see it. So photos from about the same side are compared: they agree
//! on a place of the plane, shadow or not, as steadily as on the plane beside the box, and on no place above it; below an
//! object they see different parts of its surface. An object of one colour can deceive this where the table has no pattern,
//! so the place must also have the hues and the contrast of the plane beside the box, or a strong pattern: a print on it.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use super::table::{SIDE, Table, Tone, densest};
use super::view::View;

/// Heights that are compared with the plane, parts of the box's height.
const HEIGHTS: [f64; 9] = [0.06, 0.1, 0.15, 0.22, 0.3, 0.4, 0.5, 0.65, 0.8];
/// A place is steadier on the plane than above it by this.
const STEADIER: f32 = 0.7;
/// And at least as steady as the plane beside the box, times this.
const AS_STEADY: f32 = 1.5;
/// Share of the photos of one side that must agree.
const AGREE: f64 = 0.75;
/// Pixels likelier than this, of 255, hide what is behind.
const SURELY: u8 = 180;
const MOST_VIEWS: usize = 48;
/// Sides, photos of a side at least, and their share of all.
const SIDES: usize = 10;
const FEWEST_VIEWS: usize = 5;
const SHARE: f64 = 0.17;
/// Half of the side of the patch in which patterns are compared, cells.
const PATCH: usize = 6;
/// The pattern has at least this part of the contrast beside the box.
const CONTRAST: f32 = 0.35;
/// From this part on, any hues may be the plane's: a print on it.
const STRONG_CONTRAST: f32 = 1.5;
/// Bins of a hue coordinate, and the share of the plane's places whose hues are taken for odd.
const HUES: usize = 64;
const ODD: f64 = 0.03;

/// Per cell of the finest level, its colour where it is surely the plane.
///
/// `likely` holds, once it is known, how likely each pixel of each view shows the object, 0 to 255. Then all photos in which
/// a place is not hidden by what is surely the object are compared, instead of those of one side.
pub(super) fn find(table: &Table, views: &[View], tones: &[Tone], likely: Option<&[Vec<u8>]>) -> Vec<Option<[u8; 3]>> {
    let step = views.len().div_ceil(MOST_VIEWS).max(1);
    let asked: Vec<Asked<'_>> = (0..views.len())
        .step_by(step)
        .map(|k| Asked { view: &views[k], tone: &tones[k], likely: likely.map(|all| all[k].as_slice()) })
        .collect();
    let sides = if likely.is_some() { vec![(0..asked.len()).collect()] } else { sides(&asked, table) };
    let mut beside: Vec<f32> = (0..SIDE * SIDE)
        .into_par_iter()
        .filter(|index| index % 13 == 0 && table.finest_colour(*index).is_some())
        .map_init(Sampler::default, |sampler, index| {
            sampler.look(&asked, &table.finest_centre(index), true);
            sides.iter().filter_map(|side| sampler.unrest(side)).map(|(unrest, _)| unrest).collect::<Vec<_>>()
        })
        .flatten()
        .collect();
    if beside.len() < 50 {
        return vec![None; SIDE * SIDE];
    }
    let middle = beside.len() / 2;
    let limit = AS_STEADY * *beside.select_nth_unstable_by(middle, f32::total_cmp).1;
    let steady: Vec<Option<[f32; 3]>> = (0..SIDE * SIDE)
        .into_par_iter()
        .map_init(Sampler::default, |sampler, index| {
            let mut point = table.finest_centre(index);
            if !table.may_be_covered(&point) {
                return None;
            }
            sampler.look(&asked, &point, true);
            let mut left: Vec<(usize, f32, [f32; 3])> = (0..sides.len())
                .filter_map(|s| sampler.unrest(&sides[s]).map(|(unrest, colour)| (s, unrest, colour)))
                .filter(|(_, unrest, _)| *unrest < limit)
                .collect();
            for h in HEIGHTS {
                if left.is_empty() {
                    return None;
                }
                point.z = h * table.height();
                sampler.look(&asked, &point, false);
                left.retain(|(s, low, _)| sampler.unrest(&sides[*s]).is_none_or(|(above, _)| *low < STEADIER * above));
            }
            left.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)).map(|(_, _, colour)| colour)
        })
        .collect();
    let plausible = like_the_plane(table, &steady);
    let sure = majority(&plausible, |index| table.may_be_covered(&table.finest_centre(index)));
    (0..SIDE * SIDE)
        .map(|index| steady[index].filter(|_| sure[index]).map(|c| c.map(|v| v.round().clamp(0.0, 255.0) as u8)))
        .collect()
}

/// A photo that takes part.
struct Asked<'a> {
    view: &'a View,
    tone: &'a Tone,
    likely: Option<&'a [u8]>,
}

/// Groups of photos that look from about the same side: around photos far from each other, those nearest in direction.
fn sides(asked: &[Asked<'_>], table: &Table) -> Vec<Vec<usize>> {
    let middle = table.middle();
    let directions: Vec<Vector3<f64>> =
        asked.iter().map(|a| (a.view.eye.centre - middle).try_normalize(1e-12).unwrap_or_default()).collect();
    let size = ((asked.len() as f64 * SHARE).ceil() as usize).max(FEWEST_VIEWS + 1).min(asked.len());
    let mut nearest = vec![f64::MIN; asked.len()];
    let mut sides = Vec::new();
    let mut centre = 0;
    while sides.len() < SIDES && sides.len() < asked.len() {
        let mut order: Vec<usize> = (0..asked.len()).collect();
        let closeness = |k: &usize| directions[centre].dot(&directions[*k]);
        order.sort_by(|a, b| closeness(b).total_cmp(&closeness(a)).then(a.cmp(b)));
        sides.push(order[..size].to_vec());
        for (k, near) in nearest.iter_mut().enumerate() {
            *near = near.max(directions[centre].dot(&directions[k]));
        }
        centre = (0..asked.len()).min_by(|a, b| nearest[*a].total_cmp(&nearest[*b])).unwrap_or(0);
    }
    sides
}

/// What each photo sees at a point.
#[derive(Default)]
struct Sampler {
    colours: Vec<Option<[f32; 3]>>,
    hidden: Vec<bool>,
    channel: Vec<f32>,
}

impl Sampler {
    /// Reads the photos at a point; those in which it is hidden by the object keep silent, as they did at the last point that
    /// was looked at `afresh`.
    fn look(&mut self, asked: &[Asked<'_>], point: &Point3<f64>, afresh: bool) {
        self.colours.clear();
        if afresh {
            self.hidden.clear();
        }
        for (k, Asked { view, tone, likely }) in asked.iter().enumerate() {
            let pixel = view.project(point);
            if afresh {
                let object = pixel.and_then(|p| view.index(p)).zip(*likely).is_some_and(|(at, l)| l[at] > SURELY);
                self.hidden.push(object);
            }
            let colour = pixel.filter(|_| !self.hidden[k]).and_then(|p| view.picture.sample(p.x, p.y));
            self.colours.push(colour.map(|colour| std::array::from_fn(|c| colour[c] / tone.gain[c])));
        }
    }

    /// How much the photos of a side differ, levels of 255, all channels, and the colour that they agree on.
    fn unrest(&mut self, side: &[usize]) -> Option<(f32, [f32; 3])> {
        let (mut unrest, mut colour) = (0.0, [0.0; 3]);
        for c in 0..3 {
            self.channel.clear();
            self.channel.extend(side.iter().filter_map(|k| self.colours[*k].map(|colour| colour[c])));
            if self.channel.len() < FEWEST_VIEWS {
                return None;
            }
            let (from, to) = densest(&mut self.channel, AGREE);
            unrest += self.channel[to] - self.channel[from];
            colour[c] = 0.5 * (self.channel[to] + self.channel[from]);
        }
        Some((unrest, colour))
    }
}

/// Which places have hues and contrast of the plane beside the box.
fn like_the_plane(table: &Table, steady: &[Option<[f32; 3]>]) -> Vec<bool> {
    let beside: Vec<Option<[f32; 3]>> =
        (0..SIDE * SIDE).map(|index| table.finest_colour(index).map(|c| c.map(f32::from))).collect();
    let mut hues = vec![0.0f32; HUES * HUES];
    for colour in beside.iter().flatten() {
        let (u, v) = hue(*colour);
        for y in v.saturating_sub(1)..(v + 2).min(HUES) {
            hues[y * HUES + u.saturating_sub(1)..y * HUES + (u + 2).min(HUES)].iter_mut().for_each(|h| *h += 1.0);
        }
    }
    let commonness = |colour: [f32; 3]| {
        let (u, v) = hue(colour);
        hues[v * HUES + u]
    };
    let mut common: Vec<f32> = beside.iter().flatten().map(|c| commonness(*c)).collect();
    let mut contrasts: Vec<f32> = (0..SIDE * SIDE).step_by(11).filter_map(|index| contrast(&beside, index)).collect();
    if common.is_empty() || contrasts.is_empty() {
        return vec![false; steady.len()];
    }
    let odd = (common.len() as f64 * ODD) as usize;
    let odd = *common.select_nth_unstable_by(odd, f32::total_cmp).1;
    let middle = contrasts.len() / 2;
    let usual = *contrasts.select_nth_unstable_by(middle, f32::total_cmp).1;
    (0..steady.len())
        .into_par_iter()
        .map(|index| {
            let (Some(colour), Some(here)) = (steady[index], contrast(steady, index)) else { return false };
            let least = if commonness(colour) >= odd { CONTRAST } else { STRONG_CONTRAST };
            here >= least * usual
        })
        .collect()
}

/// Shares of red and green, as bins.
fn hue(colour: [f32; 3]) -> (usize, usize) {
    let sum = colour.iter().sum::<f32>() + 3.0;
    let bin = |c: f32| (((c + 1.0) / sum * HUES as f32) as usize).min(HUES - 1);
    (bin(colour[0]), bin(colour[1]))
}

/// Spread of the brightness over its mean in the patch around a cell, from the cells that have a colour.
fn contrast(colours: &[Option<[f32; 3]>], index: usize) -> Option<f32> {
    colours[index]?;
    let (x, y) = (index % SIDE, index / SIDE);
    let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
    for row in y.saturating_sub(PATCH)..(y + PATCH + 1).min(SIDE) {
        for column in x.saturating_sub(PATCH)..(x + PATCH + 1).min(SIDE) {
            if let Some(c) = colours[row * SIDE + column] {
                let v = c.iter().sum::<f32>();
                n += 1.0;
                sum += v;
                squares += v * v;
            }
        }
    }
    let mean = sum / n;
    Some((squares / n - mean * mean).max(0.0).sqrt() / (mean + 1.0))
}

/// What most of the 5 x 5 cells around each cell say; only cells `inside` count and are kept.
fn majority(cells: &[bool], inside: impl Fn(usize) -> bool) -> Vec<bool> {
    (0..cells.len())
        .map(|index| {
            let (x, y) = (index % SIDE, index / SIDE);
            if x < 2 || y < 2 || x + 2 >= SIDE || y + 2 >= SIDE || !inside(index) {
                return false;
            }
            let around = (y - 2..=y + 2).flat_map(|y| (x - 2..=x + 2).map(move |x| y * SIDE + x));
            let (all, set) = around.filter(|k| inside(*k)).fold((0, 0), |(n, s), k| (n + 1, s + usize::from(cells[k])));
            5 * set > 3 * all
        })
        .collect()
}
