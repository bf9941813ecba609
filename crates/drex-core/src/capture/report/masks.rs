//! Whether a mask lies where the object is.
//!
//! Points that the other views see inside their masks belong to the object, and every point of the object, hidden or not,
//! projects into its silhouette. Points that the other views see outside must not be seen inside. Both are counted with a
//! margin, so that a rim drawn a little tight or wide does no harm. A mask that is moved towards a side where the object
//! has hardly any points is not found.

use std::fmt;

use nalgebra::Point3;
use serde::Serialize;

use super::super::{Capture, View, companions};
use crate::Result;
use crate::stats::upper_median;

/// Margin at the rim, as a part of the photo's longest side.
const MARGIN: f64 = 0.005;
/// Points that are needed for a verdict.
const ENOUGH: usize = 20;
/// A mask with a share of the object inside that is smaller than the median of all masks by this factor is misplaced.
/// (The median, not 1: something may stand before the object in all photos.)
const INSIDE: f64 = 0.9;
/// A mask with a larger share of the background inside is misplaced.
const BACKGROUND_INSIDE: f64 = 0.5;

/// How well one mask fits the points.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct MaskCheck {
    /// Points of the object, by the other views' masks, that project into the photo.
    pub object_points: usize,
    /// Share of them inside the mask.
    pub object_inside: f64,
    /// Points of the background, by the other views' masks, that are seen in the photo.
    pub background_points: usize,
    /// Share of them inside the mask.
    pub background_inside: f64,
    /// Whether the mask contradicts the other views.
    pub misplaced: bool,
}

/// The checks of all views.
pub(super) struct Masks {
    pub(super) checks: Vec<Option<MaskCheck>>,
    /// The median of the object's points.
    pub(super) object_centre: Option<Point3<f64>>,
}

/// Sightings of one point inside masks and in all.
#[derive(Clone, Copy, Default)]
struct Votes {
    inside: usize,
    all: usize,
}

impl Votes {
    fn of_object(self) -> bool {
        self.inside >= 2 && self.inside * 5 >= self.all * 4
    }

    fn of_background(self) -> bool {
        self.all >= 2 && self.inside == 0
    }
}

pub(super) fn check(capture: &Capture) -> Result<Masks> {
    let mut votes = vec![Votes::default(); capture.points.len()];
    // What each view says about the points it sees: (point, inside).
    let mut sightings: Vec<Option<Vec<(usize, bool)>>> = Vec::new();
    for view in &capture.views {
        let Some(mask) = Mask::of(view)? else {
            sightings.push(None);
            continue;
        };
        let seen = view.keypoints.iter().filter_map(|k| Some((k.point?, mask.is_object([k.x, k.y])?)));
        let seen: Vec<_> = seen.collect();
        for (point, inside) in &seen {
            votes[*point].all += 1;
            votes[*point].inside += usize::from(*inside);
        }
        sightings.push(Some(seen));
    }
    let object = capture.points.iter().zip(&votes).filter(|(_, v)| v.of_object());
    let object: Vec<_> = object.map(|(p, _)| Point3::from(p.position)).collect();
    let mut checks = Vec::with_capacity(capture.views.len());
    for (view, seen) in capture.views.iter().zip(&sightings) {
        let mask = if seen.is_some() { Mask::of(view)? } else { None };
        checks.push(seen.as_ref().zip(mask).and_then(|(seen, mask)| check_view(capture, view, &mask, seen, &votes)));
    }
    let enough = checks.iter().flatten().filter(|c| c.object_points >= ENOUGH);
    let usual = upper_median(enough.map(|c| c.object_inside)).unwrap_or(1.0);
    for check in checks.iter_mut().flatten() {
        check.misplaced = check.object_points >= ENOUGH && check.object_inside < INSIDE * usual
            || check.background_points >= ENOUGH && check.background_inside > BACKGROUND_INSIDE;
    }
    let object_centre = (object.len() >= ENOUGH).then(|| super::median_point(object.iter().copied()));
    Ok(Masks { checks, object_centre })
}

fn check_view(
    capture: &Capture,
    view: &View,
    mask: &Mask,
    seen: &[(usize, bool)],
    votes: &[Votes],
) -> Option<MaskCheck> {
    // This view has no vote on itself.
    let mut others = votes.to_vec();
    for (point, inside) in seen {
        others[*point].all -= 1;
        others[*point].inside -= usize::from(*inside);
    }
    let margin = (MARGIN * mask.width.max(mask.height) as f64).ceil() as i64;
    let (mut object_points, mut object_in) = (0, 0);
    for (point, votes) in capture.points.iter().zip(&others) {
        let pixel = |p: &Point3<f64>| view.lens.project(&(view.camera_from_world * p)).map(|p| [p.x, p.y]);
        if let Some(at) = votes.of_object().then(|| pixel(&point.position.into())).flatten()
            && let Some(inside) = mask.has_near(at, true, margin)
        {
            object_points += 1;
            object_in += usize::from(inside);
        }
    }
    let (mut background_points, mut background_in) = (0, 0);
    for keypoint in &view.keypoints {
        if let Some(point) = keypoint.point
            && others[point].of_background()
            && let Some(rim) = mask.has_near([keypoint.x, keypoint.y], false, margin)
        {
            background_points += 1;
            background_in += usize::from(!rim);
        }
    }
    let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
    let (object_inside, background_inside) = (share(object_in, object_points), share(background_in, background_points));
    (object_points.max(background_points) >= ENOUGH).then_some(MaskCheck {
        object_points,
        object_inside,
        background_points,
        background_inside,
        misplaced: false, // known when all views are
    })
}

/// A mask over the pixels of its photo.
struct Mask {
    width: usize,
    height: usize,
    values: Vec<u8>,
    /// Pixels of the mask per pixel of the photo.
    scale: [f64; 2],
}

impl Mask {
    fn of(view: &View) -> Result<Option<Self>> {
        let Some((width, height, values)) = companions::mask_of(view)? else { return Ok(None) };
        let scale = [width as f64 / f64::from(view.lens.width_px()), height as f64 / f64::from(view.lens.height_px())];
        Ok(Some(Self { width, height, values, scale }))
    }

    /// Column and row of a place in the photo; `None` outside.
    fn cell(&self, at: [f64; 2]) -> Option<[i64; 2]> {
        let [x, y] = [at[0] * self.scale[0], at[1] * self.scale[1]];
        let within = (0.0..self.width as f64).contains(&x) && (0.0..self.height as f64).contains(&y);
        within.then_some([x as i64, y as i64])
    }

    fn is_object(&self, at: [f64; 2]) -> Option<bool> {
        self.has_near(at, true, 0)
    }

    /// Whether a pixel of the object, or of the background, lies within `margin` pixels to each side of a place in the
    /// photo; `None` outside of the photo.
    fn has_near(&self, at: [f64; 2], object: bool, margin: i64) -> Option<bool> {
        let [x, y] = self.cell(at)?;
        let side = |v: i64, size: usize| (v - margin).max(0) as usize..=((v + margin) as usize).min(size - 1);
        let of_class = |v: &u8| (*v >= 128) == object;
        let row = |y: usize| &self.values[y * self.width..][..self.width];
        Some(side(y, self.height).any(|y| row(y)[side(x, self.width)].iter().any(of_class)))
    }
}

impl fmt::Display for MaskCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:.0} % of {} points of the object and {:.0} % of {} points of the background are inside",
            100.0 * self.object_inside,
            self.object_points,
            100.0 * self.background_inside,
            self.background_points
        )
    }
}
