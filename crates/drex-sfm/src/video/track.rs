//! Points followed through a video: corners, and pyramids of Lucas and Kanade with a check by the way back.

use std::ops::Range;

use rayon::prelude::*;

use crate::photos::Grey;

/// Longest side of the finest level in which points are followed, pixels. Blur shows in finer frames.
const SIDE: usize = 320;
/// Levels of the pyramid, each half as large as the one below: the coarsest sees a step of some 40 pixels.
const LEVELS: usize = 4;
/// Cells along the longer side; each may start one point.
const CELLS: usize = 16;
/// Points that one cell may hold: where the picture shrinks, they would crowd and outvote the others.
const CROWD: usize = 2;
/// Half a patch, pixels.
const HALF: usize = 4;
const PATCH: usize = 2 * HALF + 1;
/// A patch with a rim, for its gradients.
const RIMMED: usize = PATCH + 2;
const STEPS: usize = 12;
/// Pixels from which a point that is followed forth and back may end.
const WAY_BACK: f32 = 0.7;
/// Half the square round a point in which its detail is measured, pixels.
const AROUND: usize = 9;
/// Least eigenvalue of a corner, grey levels squared per pixel: what noise alone does not reach.
const CORNER: f32 = 6.0;

/// A point of a frame. One of the same name in another frame shows the same place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    pub(super) name: u32,
    /// From the upper left corner, in units of the longer side.
    pub(super) at: [f32; 2],
    /// [`detail`] round it.
    pub(super) detail: [f32; 4],
}

/// Follows points from frame to frame.
#[derive(Debug, Default)]
pub(super) struct Tracker {
    last: Vec<Plane>,
    /// Names, and places in pixels of the finest level; names grow.
    points: Vec<(u32, [f32; 2])>,
    next: u32,
}

impl Tracker {
    /// The points of the next frame: those of the frame before that were found again, then new ones; sorted by name.
    pub(super) fn add(&mut self, frame: &Grey) -> Vec<Point> {
        let levels = pyramid(frame);
        let Some(finest) = levels.first() else {
            *self = Self { next: self.next, ..Self::default() };
            return Vec::new();
        };
        let same_size = self.last.first().is_some_and(|p| (p.width, p.height) == (finest.width, finest.height));
        let found = |&(name, from): &(u32, [f32; 2])| {
            let to = follow(&self.last, &levels, from)?;
            let back = follow(&levels, &self.last, to)?;
            ((back[0] - from[0]).hypot(back[1] - from[1]) < WAY_BACK).then_some((name, to))
        };
        let mut kept: Vec<(u32, [f32; 2])> =
            if same_size { self.points.par_iter().filter_map(found).collect() } else { Vec::new() };
        let cell_px = (finest.width.max(finest.height) as f32 / CELLS as f32).max(1.0);
        let columns = (finest.width as f32 / cell_px).ceil() as usize;
        let rows = (finest.height as f32 / cell_px).ceil() as usize;
        let cell = |at: [f32; 2]| {
            let [x, y] = at.map(|v| (v / cell_px) as usize);
            y.min(rows - 1) * columns + x.min(columns - 1)
        };
        let mut held = vec![0; columns * rows];
        kept.retain(|(_, at)| {
            held[cell(*at)] += 1;
            held[cell(*at)] <= CROWD
        });
        for at in corners(finest, &held, cell) {
            kept.push((self.next, at));
            self.next += 1;
        }
        let finer = frame.width as f32 / finest.width as f32;
        self.last = levels;
        self.points = kept;
        let side = cell_px * CELLS as f32;
        let point = |&(name, at): &(u32, [f32; 2])| {
            let [x, y] = at.map(|v| (v * finer) as usize);
            let columns = x.saturating_sub(AROUND)..(x + AROUND + 1).min(frame.width);
            let rows = y.saturating_sub(AROUND)..(y + AROUND + 1).min(frame.height);
            Point { name, at: at.map(|v| v / side), detail: detail(frame, columns, rows) }
        };
        self.points.iter().map(point).collect()
    }
}

/// Mean squared differences of pixels two apart, along four directions, in a part of a frame, grey levels squared. A smear
/// along one of them leaves the others as they were.
fn detail(frame: &Grey, columns: Range<usize>, rows: Range<usize>) -> [f32; 4] {
    let w = frame.width;
    let [columns, rows] =
        [(columns, w), (rows, frame.height)].map(|(r, n)| r.start.max(1)..r.end.min(n.saturating_sub(1)));
    let mut sums = [0u32; 4];
    for y in rows.clone() {
        for x in columns.clone() {
            let i = y * w + x;
            for (sum, step) in sums.iter_mut().zip([1, w, w + 1, w - 1]) {
                let difference = u32::from(frame.pixels[i + step].abs_diff(frame.pixels[i - step]));
                *sum += difference * difference;
            }
        }
    }
    sums.map(|s| s as f32 / (columns.len() * rows.len()).max(1) as f32)
}

/// Grey levels, row by row; the first pixel's centre is (0.5, 0.5), so that places halve exactly from level to level.
#[derive(Debug, Clone)]
struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Plane {
    /// Means of two by two pixels.
    fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut values = Vec::with_capacity(width * height);
        for y in 0..height {
            let rows = [2 * y, 2 * y + 1].map(|r| &self.values[r * self.width..(r + 1) * self.width]);
            values.extend((0..width).map(|x| 0.25 * rows.iter().map(|r| r[2 * x] + r[2 * x + 1]).sum::<f32>()));
        }
        Self { width, height, values }
    }

    /// N by N values round `at`, one pixel apart, between pixels linearly; beyond the rim the rim goes on.
    fn patch<const N: usize>(&self, at: [f32; 2]) -> [[f32; N]; N] {
        let first = at.map(|v| v - 0.5 - (N / 2) as f32);
        let whole = first.map(f32::floor);
        let [fx, fy] = [first[0] - whole[0], first[1] - whole[1]];
        let [x0, y0] = whole.map(|v| v as isize);
        let inside = |v: isize, n: usize| v.clamp(0, n as isize - 1) as usize;
        let across = |y: isize| {
            let row = inside(y, self.height) * self.width;
            let value = |x: isize| self.values[row + inside(x, self.width)];
            let mut left = value(x0);
            std::array::from_fn::<f32, N, _>(|i| {
                let right = value(x0 + i as isize + 1);
                let between = left + fx * (right - left);
                left = right;
                between
            })
        };
        let mut above = across(y0);
        std::array::from_fn(|j| {
            let below = across(y0 + j as isize + 1);
            let between = std::array::from_fn(|i| above[i] + fy * (below[i] - above[i]));
            above = below;
            between
        })
    }
}

/// Levels from fine to coarse; none where the frame is too small for one patch.
fn pyramid(frame: &Grey) -> Vec<Plane> {
    let values = frame.pixels.iter().map(|&v| f32::from(v)).collect();
    let mut plane = Plane { width: frame.width, height: frame.height, values };
    while plane.width.max(plane.height) > SIDE {
        plane = plane.halved();
    }
    let mut levels = Vec::new();
    while plane.width.min(plane.height) >= PATCH && levels.len() < LEVELS {
        let coarser = plane.halved();
        levels.push(plane);
        plane = coarser;
    }
    levels
}

/// Where the patch round `from` in `a` lies in `b`, from coarse to fine (Bouguet 2000); patches are compared about their
/// means, so that exposure may change. `None` where it leaves the picture or has no texture.
fn follow(a: &[Plane], b: &[Plane], from: [f32; 2]) -> Option<[f32; 2]> {
    let mut moved = [0.0f32; 2];
    for (level, (a, b)) in a.iter().zip(b).enumerate().rev() {
        let scale = 1.0 / (1 << level) as f32;
        let at = from.map(|v| v * scale);
        moved = moved.map(|v| 2.0 * v);
        // Coarse levels may have nothing to say where fine ones do.
        match step(a, b, at, moved) {
            Some(better) => moved = better,
            None if level == 0 => return None,
            None => {}
        }
    }
    let to = [from[0] + moved[0], from[1] + moved[1]];
    let inside = |v: f32, n: usize| v >= 2.0 && v <= n as f32 - 2.0;
    (inside(to[0], a[0].width) && inside(to[1], a[0].height)).then_some(to)
}

/// Moves the guess `moved` of where the patch round `at` in `a` lies in `b`: Gauss-Newton steps with the gradients of `a`
/// (Baker and Matthews 2004).
fn step(a: &Plane, b: &Plane, at: [f32; 2], mut moved: [f32; 2]) -> Option<[f32; 2]> {
    let rimmed: [[f32; RIMMED]; RIMMED] = a.patch(at);
    let mut mean = 0.0;
    let [mut sx, mut sy, mut xx, mut xy, mut yy] = [0.0f32; 5];
    let mut gradients = [[[0.0f32; 2]; PATCH]; PATCH];
    for j in 0..PATCH {
        for i in 0..PATCH {
            let gx = 0.5 * (rimmed[j + 1][i + 2] - rimmed[j + 1][i]);
            let gy = 0.5 * (rimmed[j + 2][i + 1] - rimmed[j][i + 1]);
            gradients[j][i] = [gx, gy];
            mean += rimmed[j + 1][i + 1];
            (sx, sy) = (sx + gx, sy + gy);
            (xx, xy, yy) = (xx + gx * gx, xy + gx * gy, yy + gy * gy);
        }
    }
    let n = (PATCH * PATCH) as f32;
    mean /= n;
    (xx, xy, yy) = (xx - sx * sx / n, xy - sx * sy / n, yy - sy * sy / n);
    let determinant = xx * yy - xy * xy;
    if !(determinant > 1e-3 * (xx + yy) * (xx + yy)) || !(xx + yy > n) {
        return None;
    }
    for _ in 0..STEPS {
        let there: [[f32; PATCH]; PATCH] = b.patch([at[0] + moved[0], at[1] + moved[1]]);
        let there_mean = there.iter().flatten().sum::<f32>() / n;
        let [mut bx, mut by] = [0.0f32; 2];
        for j in 0..PATCH {
            for i in 0..PATCH {
                let difference = (rimmed[j + 1][i + 1] - mean) - (there[j][i] - there_mean);
                bx += difference * gradients[j][i][0];
                by += difference * gradients[j][i][1];
            }
        }
        let change = [(yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant];
        moved = [moved[0] + change[0], moved[1] + change[1]];
        let far = 4.0 * (a.width + a.height) as f32;
        if !(moved[0].abs() + moved[1].abs() < far) {
            return None;
        }
        if change[0].hypot(change[1]) < 0.02 {
            break;
        }
    }
    Some(moved)
}

/// The best corner (Shi and Tomasi 1994) of each cell that holds no point.
fn corners(plane: &Plane, held: &[usize], cell: impl Fn([f32; 2]) -> usize) -> Vec<[f32; 2]> {
    /// Half the window over which gradients are summed.
    const SUMMED: usize = 2;
    let (w, h) = (plane.width, plane.height);
    let mut products = vec![[0.0f32; 3]; w * h];
    for y in 1..h - 1 {
        for x in 1..w - 1 {
            let i = y * w + x;
            let gx = 0.5 * (plane.values[i + 1] - plane.values[i - 1]);
            let gy = 0.5 * (plane.values[i + w] - plane.values[i - w]);
            products[i] = [gx * gx, gx * gy, gy * gy];
        }
    }
    let add = |a: [f32; 3], b: &[f32; 3]| [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
    let mut rows = vec![[0.0f32; 3]; w * h];
    for y in 0..h {
        for x in SUMMED..w - SUMMED {
            let i = y * w + x;
            rows[i] = products[i - SUMMED..=i + SUMMED].iter().fold([0.0; 3], add);
        }
    }
    let mut best: Vec<Option<(f32, [f32; 2])>> = vec![None; held.len()];
    let margin = HALF + 1;
    for y in margin..h.saturating_sub(margin) {
        for x in margin..w.saturating_sub(margin) {
            let at = [x as f32 + 0.5, y as f32 + 0.5];
            let c = cell(at);
            if held[c] > 0 {
                continue;
            }
            let sum = (y - SUMMED..=y + SUMMED).map(|r| &rows[r * w + x]).fold([0.0; 3], add);
            let [xx, xy, yy] = sum.map(|v| v / ((2 * SUMMED + 1) * (2 * SUMMED + 1)) as f32);
            let least = 0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
            if least > CORNER && best[c].is_none_or(|(b, _)| least > b) {
                best[c] = Some((least, at));
            }
        }
    }
    best.into_iter().flatten().map(|(_, at)| at).collect()
}
