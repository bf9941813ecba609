//! Quadrilaterals around dark areas: candidates for the black border of a tag.
//!
//! Adaptive threshold over tiles as in AprilTag 2 (Wang and Olson 2016, section III-A), connected dark areas, and the
//! largest quadrilateral in the convex hull of each.

use nalgebra::Point2;

use super::image::Grey;

/// Side of a tile, pixels; the threshold of a tile is taken over it and its eight neighbours.
const TILE_PX: usize = 4;

/// Least difference of grey values in such a neighbourhood for it to have dark and bright.
const MIN_CONTRAST: u8 = 15;

/// Least shorter and longer side of the box around a dark area, pixels: below, cells are too small to be read.
const MIN_BOX_PX: [i32; 2] = [10, 16];

/// Least share of the hull that the quadrilateral covers: a perspective square covers nearly all, a disc 0.64.
const MIN_COVERED: f64 = 0.85;

/// Dark pixels x0..x1 of a row.
#[derive(Clone, Copy)]
struct Run {
    y: i32,
    x0: i32,
    x1: i32,
}

/// Quadrilaterals of a level in its pixels, corners clockwise as seen.
pub(super) fn quads(image: &Grey<'_>) -> Vec<[Point2<f64>; 4]> {
    let runs = dark_runs(image);
    let roots = connected(&runs);
    let mut order: Vec<usize> = (0..runs.len()).collect();
    order.sort_by_key(|&i| (roots[i], i));
    order
        .chunk_by(|&a, &b| roots[a] == roots[b])
        .filter_map(|area| {
            let area: Vec<Run> = area.iter().map(|&i| runs[i]).collect();
            quad_around(&area, image.width as i32, image.height as i32)
        })
        .collect()
}

fn dark_runs(image: &Grey<'_>) -> Vec<Run> {
    let (columns, rows) = (image.width.div_ceil(TILE_PX), image.height.div_ceil(TILE_PX));
    let mut extremes = vec![(u8::MAX, u8::MIN); columns * rows];
    for y in 0..image.height {
        let tiles = &mut extremes[y / TILE_PX * columns..][..columns];
        for (tile, pixels) in tiles.iter_mut().zip(image.row(y).chunks(TILE_PX)) {
            *tile = pixels.iter().fold(*tile, |(low, high), &v| (low.min(v), high.max(v)));
        }
    }
    let mut runs = Vec::new();
    let mut thresholds = vec![0; columns];
    for y in 0..image.height {
        if y % TILE_PX == 0 {
            let row = y / TILE_PX;
            for column in 0..columns {
                let (mut low, mut high) = (u8::MAX, u8::MIN);
                for r in row.saturating_sub(1)..(row + 2).min(rows) {
                    for &(l, h) in &extremes[r * columns..][column.saturating_sub(1)..(column + 2).min(columns)] {
                        (low, high) = (low.min(l), high.max(h));
                    }
                }
                // Nothing is below zero: a tile without contrast has nothing dark.
                thresholds[column] = if high - low >= MIN_CONTRAST { low + (high - low) / 2 } else { 0 };
            }
        }
        let mut start = None;
        for (x, &v) in image.row(y).iter().enumerate() {
            match (v < thresholds[x / TILE_PX], start) {
                (true, None) => start = Some(x),
                (false, Some(x0)) => {
                    runs.push(Run { y: y as i32, x0: x0 as i32, x1: x as i32 });
                    start = None;
                }
                _ => {}
            }
        }
        if let Some(x0) = start {
            runs.push(Run { y: y as i32, x0: x0 as i32, x1: image.width as i32 });
        }
    }
    runs
}

/// The first run of the area that each run belongs to: runs of neighbouring rows that share a column are one area.
fn connected(runs: &[Run]) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..runs.len()).collect();
    fn root(parent: &mut [usize], mut i: usize) -> usize {
        while parent[i] != i {
            parent[i] = parent[parent[i]];
            i = parent[i];
        }
        i
    }
    let mut above = 0;
    for i in 0..runs.len() {
        let run = runs[i];
        while above < i && (runs[above].y < run.y - 1 || (runs[above].y == run.y - 1 && runs[above].x1 <= run.x0)) {
            above += 1;
        }
        let mut k = above;
        while k < i && runs[k].y == run.y - 1 && runs[k].x0 < run.x1 {
            let (a, b) = (root(&mut parent, i), root(&mut parent, k));
            parent[a.max(b)] = a.min(b);
            k += 1;
        }
    }
    (0..runs.len()).map(|i| root(&mut parent, i)).collect()
}

/// The quadrilateral around an area of runs in order of rows. `None` if it is too small, cut by the image's border or of
/// another shape.
fn quad_around(area: &[Run], width: i32, height: i32) -> Option<[Point2<f64>; 4]> {
    let (y0, y1) = (area.first()?.y, area.last()?.y + 1);
    let (x0, x1) = area.iter().fold((width, 0), |(a, b), r| (a.min(r.x0), b.max(r.x1)));
    let (short, long) = ((x1 - x0).min(y1 - y0), (x1 - x0).max(y1 - y0));
    if short < MIN_BOX_PX[0] || long < MIN_BOX_PX[1] || x0 == 0 || y0 == 0 || x1 == width || y1 == height {
        return None;
    }
    let mut outline = Vec::with_capacity(4 * (y1 - y0) as usize);
    for row in area.chunk_by(|a, b| a.y == b.y) {
        let (left, right) = row.iter().fold((width, 0), |(a, b), r| (a.min(r.x0), b.max(r.x1)));
        for y in [row[0].y, row[0].y + 1] {
            outline.extend([(left, y), (right, y)]);
        }
    }
    let hull = hull(outline);
    let (corners, area) = largest_quad(&hull)?;
    let whole: f64 = 0.5 * (0..hull.len()).map(|i| cross(hull[0], hull[i], hull[(i + 1) % hull.len()])).sum::<f64>();
    (area >= MIN_COVERED * whole).then(|| corners.map(|(x, y)| Point2::new(f64::from(x), f64::from(y))))
}

/// Twice the area of a triangle, positive if a, b, c go clockwise as seen (y down).
fn cross(a: (i32, i32), b: (i32, i32), c: (i32, i32)) -> f64 {
    f64::from(b.0 - a.0) * f64::from(c.1 - a.1) - f64::from(b.1 - a.1) * f64::from(c.0 - a.0)
}

/// Convex hull, clockwise as seen, without points on its sides (Andrew 1979).
fn hull(mut points: Vec<(i32, i32)>) -> Vec<(i32, i32)> {
    points.sort_unstable();
    points.dedup();
    let mut hull: Vec<(i32, i32)> = Vec::new();
    for half in 0..2 {
        let start = hull.len();
        let mut push = |p| {
            while hull.len() >= start + 2 && cross(hull[hull.len() - 2], hull[hull.len() - 1], p) <= 0.0 {
                hull.pop();
            }
            hull.push(p);
        };
        if half == 0 {
            points.iter().copied().for_each(&mut push)
        } else {
            points.iter().rev().copied().for_each(&mut push)
        }
        // The last point of one half is the first of the other.
        hull.pop();
    }
    hull
}

/// The largest quadrilateral among the vertices of a convex polygon, with its area: for each diagonal the farthest vertex on
/// either side, which moves one way as the diagonal turns (rotating calipers).
fn largest_quad(hull: &[(i32, i32)]) -> Option<([(i32, i32); 4], f64)> {
    let n = hull.len();
    if n < 4 {
        return None;
    }
    let at = |i: usize| hull[i % n];
    let mut best: Option<([(i32, i32); 4], f64)> = None;
    for i in 0..n - 2 {
        let (mut b, mut d) = (i + 1, i + 3);
        for k in i + 2..(i + n - 1).min(n) {
            while b + 1 < k && cross(at(i), at(b + 1), at(k)) >= cross(at(i), at(b), at(k)) {
                b += 1;
            }
            d = d.max(k + 1);
            while d + 1 < i + n && cross(at(k), at(d + 1), at(i)) >= cross(at(k), at(d), at(i)) {
                d += 1;
            }
            let area = 0.5 * (cross(at(i), at(b), at(k)) + cross(at(k), at(d), at(i)));
            if best.is_none_or(|(_, most)| area > most) {
                best = Some(([at(i), at(b), at(k), at(d)], area));
            }
        }
    }
    best
}
