//! What a quadrilateral shows: the cells of a tag, and which tag has them.

use nalgebra::{Matrix3, Point2, Vector3};

use super::image::Grey;
use super::tag36h11::{DATA, SIDE, WHITE, turned};
use super::warp::Warp;

/// Most cells read wrongly. Tags differ in 11 cells; a random area passes for a given tag with probability 4e-8.
const MAX_ERRORS: u32 = 2;

/// Least difference of light between white margin and black border.
const MIN_CONTRAST: f64 = 0.01;

/// Most cells of the black border, of 28, that may look white.
const MAX_BORDER_ERRORS: usize = 4;

/// A tag that was read.
#[derive(Clone, Copy)]
pub(super) struct Read {
    pub(super) id: usize,
    /// Quarter turns clockwise of the picture: corner k of the quadrilateral is the tag's top left.
    pub(super) turns: usize,
}

/// The tag whose cells are these. `None` if there is none within [`MAX_ERRORS`].
pub(super) fn matching(white: u64) -> Option<Read> {
    // Turning what was read by the quarters that are missing to a whole turn makes it upright.
    let mut upright = white;
    for back in 0..4 {
        if let Some(id) = WHITE.iter().position(|code| (code ^ upright).count_ones() <= MAX_ERRORS) {
            return Some(Read { id, turns: (4 - back) % 4 });
        }
        upright = turned(upright);
    }
    None
}

/// White cells under a warp, as [`WHITE`] numbers them. `None` if there is no black border within a brighter margin.
pub(super) fn cells(image: &Grey<'_>, warp: &Warp<'_>) -> Option<u64> {
    let side = SIDE as i32;
    let light = |row: i32, column: i32| {
        let mut sum = 0.0;
        for (dx, dy) in [(0.0, 0.0), (-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)] {
            let cell = Point2::new(f64::from(column) + 0.5 + dx, f64::from(row) + 0.5 + dy);
            sum += image.light(warp.pixel(cell)?)?;
        }
        Some(sum / 5.0)
    };
    let ring = |low: i32, high: i32| {
        (low..high).flat_map(move |k| [(low, k), (k, high), (high, high + low - k), (high + low - k, low)])
    };
    let (margin, border) = (ring(-1, side), ring(0, side - 1));
    let bright = Shade::fit(margin.filter_map(|(r, c)| Some((r, c, light(r, c)?))))?;
    let border: Vec<_> = border.map(|(r, c)| Some((r, c, light(r, c)?))).collect::<Option<_>>()?;
    let dark = Shade::fit(border.iter().copied())?;
    let threshold = |r, c| 0.5 * (bright.at(r, c) + dark.at(r, c));
    let contrast = |r, c| bright.at(r, c) - dark.at(r, c);
    if [(0, 0), (0, side), (side, side), (side, 0)].iter().any(|&(r, c)| !(contrast(r, c) > MIN_CONTRAST)) {
        return None;
    }
    if border.iter().filter(|&&(r, c, l)| l > threshold(r, c)).count() > MAX_BORDER_ERRORS {
        return None;
    }
    let mut white = 0;
    for row in 0..DATA {
        for column in 0..DATA {
            let (r, c) = (row as i32 + 1, column as i32 + 1);
            white |= u64::from(light(r, c)? > threshold(r, c)) << (DATA * row + column);
        }
    }
    Some(white)
}

/// Light that changes linearly over the tag, as a lamp from one side makes it.
struct Shade(Vector3<f64>);

impl Shade {
    /// Least squares over cells (row, column, light); `None` if they do not surround the tag.
    fn fit(cells: impl Iterator<Item = (i32, i32, f64)>) -> Option<Self> {
        let (mut m, mut y) = (Matrix3::zeros(), Vector3::zeros());
        for (row, column, light) in cells {
            let a = Vector3::new(f64::from(row), f64::from(column), 1.0);
            m += a * a.transpose();
            y += a * light;
        }
        // Half of the margin at the least: 28 to 36 cells are a ring.
        if m[(2, 2)] < 16.0 {
            return None;
        }
        m.cholesky().map(|m| Self(m.solve(&y)))
    }

    fn at(&self, row: i32, column: i32) -> f64 {
        self.0.dot(&Vector3::new(f64::from(row), f64::from(column), 1.0))
    }
}
