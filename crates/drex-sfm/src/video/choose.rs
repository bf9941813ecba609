//! Which frames: of each stretch over which the picture moves by a few per cent of its longer side, the best.

use super::track::Point;
use crate::photos::Grey;

/// What is known of a frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Measured {
    /// Points that are followed, sorted by name.
    pub(super) points: Vec<Point>,
    pub(super) time_s: f64,
}

/// What makes a frame worth keeping.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rules {
    /// From the frame that was chosen last, in shares of the longer side.
    pub(super) window: [f64; 2],
    pub(super) least_sharpness: f64,
    /// Fewest and most that are wished for.
    pub(super) number: [usize; 2],
}

/// Frames that are compared for sharpness lie at most so far apart, seconds.
const NEAR_S: f64 = 1.0;
/// Points that two frames must share, or they show different places.
const LEAST_SHARED: usize = 12;
/// Motion from frame to frame that is no rest.
const MOVING: f32 = 0.001;
/// Frames further apart than this may be hard to connect.
const GAP: f64 = 0.2;
/// Frames that show a point whose detail is compared: what is seen in a jerk alone is smeared in all of them.
const LONG: usize = 8;
/// How much narrower and wider than wished windows may become.
const NARROWEST: f64 = 0.25;
const WIDEST: f64 = 100.0;

/// Means of so many pixels that the longer side has at most `side`.
pub(super) fn shrunk(frame: &Grey, side: usize) -> Grey {
    let n = frame.width.max(frame.height).div_ceil(side.max(1)).max(1);
    let (width, height) = (frame.width / n, frame.height / n);
    let mean = |x: usize, y: usize| {
        let rows = (y * n..(y + 1) * n).map(|r| &frame.pixels[r * frame.width + x * n..][..n]);
        let sum: u32 = rows.flatten().map(|&v| u32::from(v)).sum();
        let pixels = (n * n) as u32;
        ((sum + pixels / 2) / pixels) as u8
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| mean(x, y)).collect();
    Grey { width, height, pixels }
}

/// How well a frame may serve, beside those about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Quality {
    /// How sharp it is along the direction that is smeared most; 1 is usual, 0 is a frame without detail.
    pub(super) sharpness: f64,
    /// The same, less where the picture moves faster than usual.
    pub(super) calm: f64,
}

/// The quality of each frame. A shutter that is open for long smears what moves fast, and a slight smear is easier to see in
/// the motion, and in points that are lost, than in the detail.
pub(super) fn quality(frames: &[Measured]) -> Vec<Quality> {
    let sharpness = sharpness(frames);
    // From the frame before to the one after: where the camera turns back it rests.
    let last = frames.len().saturating_sub(1);
    let through = |i: usize| {
        let [a, b] = [i.saturating_sub(1), (i + 1).min(last)];
        let distances = shared(&frames[a], &frames[b]);
        let found = distances.len() as f32;
        (found, quantile(distances, 0.5) / (b - a).max(1) as f32)
    };
    let (found, speed): (Vec<f32>, Vec<f32>) = (0..frames.len()).map(through).unzip();
    let (found, speed) = (beside(frames, &found, 0.0), beside(frames, &speed, MOVING));
    let calm = |i: usize| (sharpness[i] * (2.0 * found[i]).min(1.0) / (1.0 + 0.25 * speed[i] * speed[i])) as f32;
    let calm = beside(frames, &(0..frames.len()).map(calm).collect::<Vec<_>>(), 0.0);
    sharpness.into_iter().zip(calm).map(|(sharpness, calm)| Quality { sharpness, calm }).collect()
}

/// The same places are compared, as texture comes and goes while the camera moves: the detail round the points of a frame
/// to what is usual for these points in the frames that show them. Squared, as photos that
/// keep less than about 0.7 of it are hard to register.
fn sharpness(frames: &[Measured]) -> Vec<f64> {
    let mut tracks: Vec<Vec<[f32; 4]>> = Vec::new();
    for point in frames.iter().flat_map(|f| &f.points) {
        let name = point.name as usize;
        if tracks.len() <= name {
            tracks.resize_with(name + 1, Vec::new);
        }
        tracks[name].push(point.detail);
    }
    // Blur only ever takes detail away.
    let of_track =
        |t: &Vec<[f32; 4]>| std::array::from_fn(|d| quantile(t.iter().map(|detail| detail[d]).collect(), 0.75));
    let usual: Vec<[f32; 4]> = tracks.iter().map(of_track).collect();
    let least = |values: [f32; 4]| values.into_iter().fold(f32::INFINITY, f32::min);
    let same_places = |frame: &Measured| {
        let known: Vec<&Point> = frame.points.iter().filter(|p| tracks[p.name as usize].len() >= LONG).collect();
        let along = |d: usize| {
            let usually: f32 = known.iter().map(|p| usual[p.name as usize][d]).sum();
            known.iter().map(|p| p.detail[d]).sum::<f32>() / usually.max(1e-3)
        };
        if known.len() < LEAST_SHARED { 0.0 } else { least(std::array::from_fn(along)) }
    };
    // Where the picture is another at once there are no such places.
    let as_it_is = |frame: &Measured| {
        let n = frame.points.len().max(1) as f32;
        least(std::array::from_fn(|d| frame.points.iter().map(|p| p.detail[d]).sum::<f32>() / n))
    };
    let [first, second] = [&same_places as &dyn Fn(&Measured) -> f32, &as_it_is]
        .map(|of| beside(frames, &frames.iter().map(of).collect::<Vec<_>>(), 0.0));
    first.into_iter().zip(second).map(|(a, b)| if a > 0.0 { a * a } else { b * b }).collect()
}

/// Each value over the median of those values above `least` that lie within [`NEAR_S`].
fn beside(frames: &[Measured], values: &[f32], least: f32) -> Vec<f64> {
    let (mut first, mut end) = (0, 0);
    let mut result = Vec::with_capacity(frames.len());
    for (frame, &value) in frames.iter().zip(values) {
        while frames[first].time_s < frame.time_s - NEAR_S {
            first += 1;
        }
        while end < frames.len() && frames[end].time_s <= frame.time_s + NEAR_S {
            end += 1;
        }
        let near = quantile(values[first..end].iter().copied().filter(|v| *v > least).collect(), 0.5);
        result.push(f64::from(value) / f64::from(near.max(1e-6)));
    }
    result
}

/// The number at this share of the sorted list, 0 if there are none.
fn quantile(mut values: Vec<f32>, share: f64) -> f32 {
    let place = (values.len().saturating_sub(1) as f64 * share).round() as usize;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(place, f32::total_cmp).1 }
}

/// How far the points that two frames share have moved, of their distances the one at `share` of the sorted list, in
/// units of the longer side; `None` if they share too few.
pub(super) fn moved(a: &Measured, b: &Measured, share: f64) -> Option<f64> {
    let distances = shared(a, b);
    (distances.len() >= LEAST_SHARED).then(|| f64::from(quantile(distances, share)))
}

/// How far each point that two frames share has moved.
fn shared(a: &Measured, b: &Measured) -> Vec<f32> {
    let mut distances = Vec::new();
    let mut others = b.points.iter().peekable();
    for p in &a.points {
        while others.next_if(|q| q.name < p.name).is_some() {}
        if let Some(q) = others.next_if(|q| q.name == p.name) {
            distances.push((q.at[0] - p.at[0]).hypot(q.at[1] - p.at[1]));
        }
    }
    distances
}

/// The frames to keep, in order; `share` as in [`moved`]. Windows are narrowed, to a quarter at most, where they give
/// fewer frames than are wished for, and widened where they give more.
pub(super) fn choose(frames: &[Measured], rules: &Rules, share: f64) -> Vec<usize> {
    let quality = quality(frames);
    let with = |wider: f64| walk(frames, &quality, rules.least_sharpness, rules.window.map(|w| w * wider), share);
    let [fewest, most] = rules.number.map(|n| n.max(1));
    let mut wider: f64 = 1.0;
    let mut chosen = with(wider);
    while chosen.len() < fewest.min(most) && wider > NARROWEST {
        wider = (wider * (chosen.len() as f64 / fewest as f64).clamp(0.7, 0.95)).max(NARROWEST);
        chosen = with(wider);
    }
    while chosen.len() > most {
        if wider > WIDEST {
            // These share nothing, each is new however wide the window is.
            return (0..most).map(|i| chosen[i * chosen.len() / most]).collect();
        }
        wider *= (chosen.len() as f64 / most as f64).clamp(1.05, 2.0);
        chosen = with(wider);
    }
    chosen
}

/// From each chosen frame to the best of those that lie a window away.
fn walk(frames: &[Measured], quality: &[Quality], least: f64, [near, far]: [f64; 2], share: f64) -> Vec<usize> {
    let with =
        |good: &dyn Fn(&Quality) -> bool| -> Vec<usize> { (0..frames.len()).filter(|&i| good(&quality[i])).collect() };
    let calm = with(&|q| q.calm.min(q.sharpness) >= least);
    let sharp = with(&|q| q.sharpness >= least);
    // The earlier of two that are alike.
    let better = |a: usize, b: usize| if quality[b].calm > quality[a].calm { b } else { a };
    let from = |key: usize, i: usize| moved(&frames[key], &frames[i], share).unwrap_or(f64::INFINITY);
    let next = |key: usize, among: &[usize]| {
        let mut best = None;
        for &i in &among[among.partition_point(|&i| i <= key)..] {
            let distance = from(key, i);
            if distance > far {
                // Without any, it moves faster than the window is wide.
                return best.or(Some(i));
            }
            if distance >= near {
                best = Some(best.map_or(i, |b| better(b, i)));
            }
        }
        best
    };
    let Some(&start) = calm.first() else { return Vec::new() };
    let beginning = calm.iter().copied().take_while(|&i| from(start, i) < near);
    let mut chosen = vec![beginning.fold(start, better)];
    while let Some(&key) = chosen.last() {
        let Some(mut best) = next(key, &calm) else { break };
        if from(key, best) > GAP.max(far) {
            // A stretch that is fast all along is no jerk.
            best = next(key, &sharp).unwrap_or(best);
        }
        chosen.push(best);
    }
    chosen
}
