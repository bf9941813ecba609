//! What is printed: on the tin, on the cloth, and the tag.

use std::f64::consts::{FRAC_PI_4, PI, TAU};

use drex_sfm::marker::Marker;
use nalgebra::{Point2, Point3, Rotation2, Vector2, Vector3};

use super::caddy::{COLLAR_M, CORNER_M, HEIGHT_M, LID_RADIUS_M, TOP_M, WIDTH_M};

type Color = Vector3<f64>;

/// Linear colours.
const PAPER: Color = Color::new(0.80, 0.72, 0.54);
const TEAL: Color = Color::new(0.020, 0.115, 0.120);
const GOLD: Color = Color::new(0.60, 0.40, 0.12);
const LEAF: Color = Color::new(0.085, 0.26, 0.075);
const LEAF_LIGHT: Color = Color::new(0.24, 0.40, 0.12);
const BLOSSOM: Color = Color::new(0.62, 0.13, 0.09);
const INK: Color = Color::new(0.035, 0.045, 0.05);

/// The label lies between these heights, metres; a golden line is so wide.
const LABEL_M: (f64, f64) = (0.008, 0.060);
const LINE_M: f64 = 0.0007;
/// Half the cloth's sides and width of its border, metres.
const CLOTH_M: (f64, f64) = (0.165, 0.145);
const BORDER_M: f64 = 0.016;
/// Middle of the tag, how far it is turned (degrees), and half the side of the paper that it is printed on, metres.
const TAG_M: (f64, f64) = (0.070, -0.060);
const TAG_TURN_DEG: f64 = 24.0;
const CARD_M: f64 = 0.027;

/// A colour and how much of a highlight it has: strength and exponent.
pub struct Paint {
    pub color: Color,
    pub gloss: (f64, f64),
}

/// What the tin looks like at a point of its surface.
pub fn on_tin(p: &Point3<f64>, normal: &Vector3<f64>) -> Paint {
    if p.z > HEIGHT_M - 1e-5 {
        return Paint { color: on_lid(p, normal), gloss: (0.25, 40.0) };
    }
    let (panel, u) = around(p);
    let grain = 0.86 + 0.18 * noise(&(p.coords * 700.0)) + 0.10 * noise(&(p.coords * 2200.0));
    Paint { color: on_panel(panel, u, p.z) * grain, gloss: (0.05, 25.0) }
}

/// Which side of the body a point is on, and where along it, metres from its middle; half of each corner belongs to it.
fn around(p: &Point3<f64>) -> (usize, f64) {
    let (half, flat) = (WIDTH_M / 2.0, WIDTH_M / 2.0 - CORNER_M);
    let panel = ((p.y.atan2(p.x) / (TAU / 4.0)).round() as i32).rem_euclid(4) as usize;
    let turned = Rotation2::new(-TAU / 4.0 * panel as f64) * Vector2::new(p.x, p.y);
    let beyond = turned.y.abs() - flat;
    let u = if beyond > 0.0 {
        let angle = beyond.atan2((turned.x - flat).min(half)).min(FRAC_PI_4);
        (flat + CORNER_M * angle).copysign(turned.y)
    } else {
        turned.y
    };
    (panel, u)
}

/// The printed sheet: `u` along a side from its middle, `z` over the table, metres.
fn on_panel(panel: usize, u: f64, z: f64) -> Color {
    let (low, high) = LABEL_M;
    let corner = WIDTH_M / 2.0 - CORNER_M + CORNER_M * FRAC_PI_4;
    if z < low || z > high {
        let line = [low - 0.0016, high + 0.0016, 0.0022].iter().any(|h| (z - h).abs() < LINE_M / 2.0);
        // A row of diamonds in the upper band.
        let diamond = (u / 0.0048 - (u / 0.0048).round()).abs() * 1.6 + (z - 0.0637).abs() / 0.0030;
        return if line || diamond < 0.55 { GOLD } else { TEAL };
    }
    let v = z - 0.5 * (low + high);
    // A braid where two sides meet.
    let from_corner = corner - u.abs();
    if from_corner < 0.0042 {
        let wave = 0.0018 * (TAU * z / 0.0105 + if u > 0.0 { 0.0 } else { PI }).sin() + 0.002;
        return if (from_corner - wave).abs() < 0.0006 || from_corner > 0.0036 { GOLD } else { TEAL };
    }
    let p = Point2::new(u, v);
    match panel {
        0 => front(&p),
        2 => back(&p),
        _ => garden(&p, panel),
    }
}

/// Words, and two sprigs under them.
fn front(p: &Point2<f64>) -> Color {
    for (text, y, height) in [("DREX", 0.0125, 0.0110), ("GREEN TEA", -0.0005, 0.0042), ("NET 100 G", -0.0222, 0.0024)]
    {
        if written(text, &(p.coords - Vector2::new(0.0, y)), height) {
            return if height > 0.01 { TEAL } else { INK };
        }
    }
    if (p.y - 0.0048).abs() < 0.0004 && p.x.abs() < 0.017 {
        return GOLD;
    }
    let round = (p - Point2::new(0.0, -0.0112)).norm();
    if (round - 0.0072).abs() < 0.0005 {
        return GOLD;
    }
    let stalk = Point2::new(0.0, -0.0175);
    let leaves = [(90.0, 0.0125), (52.0, 0.0105), (128.0, 0.0105), (20.0, 0.0072), (160.0, 0.0072)];
    if round < 0.0072 {
        return leaves.iter().find_map(|&(turn, length)| leaf(p, &stalk, turn, length)).unwrap_or(PAPER * 1.12);
    }
    for side in [-1.0, 1.0] {
        for k in 0..5 {
            let at = Point2::new(side * (0.0100 + 0.0024 * f64::from(k)), -0.0140 + 0.0016 * f64::from(k));
            let turn = 90.0 - side * (20.0 + 50.0 * f64::from(k % 2));
            if let Some(color) = leaf(p, &at, turn, 0.0058) {
                return color;
            }
        }
    }
    PAPER
}

/// How to brew it, lines that are too small to read, and a bar code.
fn back(p: &Point2<f64>) -> Color {
    for (text, y, height) in [("BREW 3 MIN", 0.0200, 0.0046), ("AT 90 C", 0.0125, 0.0034)] {
        if written(text, &(p.coords - Vector2::new(0.0, y)), height) {
            return TEAL;
        }
    }
    if (p.y - 0.0163).abs() < 0.0004 && p.x.abs() < 0.019 {
        return GOLD;
    }
    let line = ((0.0080 - p.y) / 0.0022).floor();
    if (0.0..6.0).contains(&line) && p.x.abs() < 0.019 {
        let inside = (0.0080 - p.y) / 0.0022 - line;
        let word = (p.x / 0.0007).floor();
        let gap = hashed(&Vector3::new((word / 5.0 + hashed(&Vector3::new(line, 1.0, 8.0))).floor(), line, 9.0)) < 0.22;
        let letter = hashed(&Vector3::new(word, line, 10.0)) < 0.72;
        return if (0.25..0.75).contains(&inside) && letter && !gap { INK } else { PAPER };
    }
    if (-0.0220..-0.0100).contains(&p.y) && p.x.abs() < 0.0130 {
        let bar = (p.x / 0.00055).floor();
        let dark = hashed(&Vector3::new(bar, 4.0, 12.0)) < 0.5 && p.x.abs() < 0.0118;
        return if dark && p.y > -0.0208 { INK } else { Color::repeat(0.78) };
    }
    PAPER
}

/// Branches with leaves and blossoms, each side with its own.
fn garden(p: &Point2<f64>, panel: usize) -> Color {
    let mut under = PAPER;
    for (branch, from) in [-0.0165, -0.0035, 0.0105].into_iter().enumerate() {
        let seed = Vector3::new(branch as f64, panel as f64, 0.5);
        let bend = |y: f64| from + 0.0036 * (150.0 * y + TAU * hashed(&seed)).sin();
        for k in 0..9 {
            let dice = |n: f64| hashed(&(seed + Vector3::new(f64::from(k) + 7.0, 0.0, n)));
            let y = -0.0235 + 0.0054 * (f64::from(k) + 0.4 * dice(1.0));
            let at = Point2::new(bend(y), y);
            if dice(2.0) > 0.74 {
                let around = p - (at + Vector2::new(0.0030 * (dice(3.0) - 0.5), 0.001));
                let petal = 0.0021 + 0.0006 * (5.0 * around.y.atan2(around.x)).cos();
                if around.norm() < 0.0007 {
                    return GOLD;
                } else if around.norm() < petal {
                    return BLOSSOM * (0.75 + 0.45 * (around.norm() / petal));
                }
            }
            let side = if k % 2 == 0 { 1.0 } else { -1.0 };
            if let Some(color) = leaf(p, &at, 90.0 - side * (35.0 + 35.0 * dice(4.0)), 0.0062 + 0.0034 * dice(5.0)) {
                under = color;
            }
        }
        if (p.x - bend(p.y)).abs() < 0.00035 {
            under = LEAF * 0.6;
        }
    }
    under
}

/// The colour of a leaf that begins `at` a point and grows in a direction (degrees from u), where it covers `p`.
fn leaf(p: &Point2<f64>, at: &Point2<f64>, turn_deg: f64, length: f64) -> Option<Color> {
    let q = Rotation2::new(-turn_deg.to_radians()) * (p - at) / length;
    if !(0.0..1.0).contains(&q.x) {
        return None;
    }
    let wide = 0.27 * (PI * q.x.powf(0.8)).sin();
    if q.y.abs() > wide {
        return None;
    }
    let rib = q.y.abs() < 0.022 * (1.2 - q.x) || ((q.x - 0.8 * q.y.abs()) * 7.0).rem_euclid(1.0) < 0.13;
    Some(if rib {
        LEAF * 0.55
    } else if q.y > 0.0 {
        LEAF_LIGHT
    } else {
        LEAF
    })
}

/// Brass: turned on a lathe, with a star pressed into its top.
fn on_lid(p: &Point3<f64>, normal: &Vector3<f64>) -> Color {
    let (r, angle) = (p.coords.xy().norm(), p.y.atan2(p.x));
    let stains = 0.80 + 0.28 * noise(&(p.coords * 330.0)) + 0.16 * noise(&(p.coords * 1300.0));
    let turned = 1.0 + 0.06 * (TAU * r / 0.0011).sin();
    let color = if p.z > TOP_M - 0.0005 && normal.z > 0.5 {
        let star = 0.0085 + 0.0035 * (8.0 * angle).cos();
        let ring = (r - 0.0150).abs() < 0.0008 || (r - 0.0175).abs() < 0.0004;
        let dots = ((r - 0.0162).abs() < 0.0006) && (24.0 * angle / TAU).rem_euclid(1.0) < 0.4;
        if ring || dots || (r - star).abs() < 0.0006 || r < 0.0016 { GOLD * 0.35 } else { GOLD * turned }
    } else if p.z > COLLAR_M && r > LID_RADIUS_M - 0.0015 {
        // A knurled edge, each notch a little different.
        let notch = 60.0 * angle / TAU;
        let cut = notch.rem_euclid(1.0) < 0.3 + 0.25 * hashed(&Vector3::new(notch.floor(), 3.0, 1.0));
        if cut && (0.0755..0.0795).contains(&p.z) { GOLD * 0.45 } else { GOLD }
    } else if p.z > HEIGHT_M + 1e-5 {
        GOLD * 0.82
    } else {
        // The shoulder's flat top.
        TEAL.lerp(&GOLD, 0.25) * turned
    };
    color * stains
}

/// The table at z = 0: a tag on a paper, a cloth of linen with leaves, planks of oak.
pub fn on_table(p: &Point3<f64>, tag: &Marker) -> Paint {
    let matt = |color: Color| Paint { color, gloss: (0.0, 1.0) };
    let q = Rotation2::new(-TAG_TURN_DEG.to_radians()) * (Vector2::new(p.x, p.y) - Vector2::new(TAG_M.0, TAG_M.1));
    if q.abs().max() < CARD_M {
        // Rows from the top, columns from the left, 8 of each.
        let cell = |along: f64| ((along / tag.side_m + 0.5) * 8.0).floor() as i32;
        return matt(Color::repeat(if tag.is_white(cell(-q.y), cell(q.x)) { 0.78 } else { 0.025 }));
    }
    let inside = (CLOTH_M.0 - p.x.abs()).min(CLOTH_M.1 - p.y.abs());
    if inside < 0.0 {
        return Paint { color: oak(p), gloss: (0.06, 18.0) };
    }
    // Threads of linen, irregular in both directions.
    let thread = |along: f64, across: f64, seed: f64| {
        let strand = (across / 0.0011).floor();
        0.82 + 0.30 * noise(&Vector3::new(along * 160.0, strand * 0.73, seed))
    };
    let weave = 0.5 * (thread(p.x, p.y, 1.0) + thread(p.y, p.x, 2.0)) + 0.14 * (noise(&(p.coords * 1500.0)) - 0.5);
    let stripe = (0.0..BORDER_M).contains(&inside) && (inside - 0.5 * BORDER_M).abs() < 0.005;
    let mut color = if stripe { Color::new(0.10, 0.17, 0.24) } else { Color::new(0.62, 0.57, 0.47) };
    // Sprigs in the squares of a grid, none like another.
    const GRID_M: f64 = 0.026;
    if inside > BORDER_M {
        let (i, j) = ((p.x / GRID_M).floor(), (p.y / GRID_M).floor());
        let dice = |n: f64| hashed(&Vector3::new(i, j, 11.0 + n));
        let middle = |k: f64, n: f64| GRID_M * (k + 0.36 + 0.28 * dice(n));
        let at = Point2::new(middle(i, 1.0), middle(j, 2.0));
        let (turn, length) = (360.0 * dice(3.0), GRID_M * (0.26 + 0.14 * dice(4.0)));
        let here = Point2::new(p.x, p.y);
        let leaves = 2 + (3.0 * dice(5.0)) as u32;
        for k in 0..leaves {
            let spread = 150.0 * (f64::from(k) - 0.5 * f64::from(leaves - 1)) / f64::from(leaves);
            if leaf(&here, &at, turn + spread, length).is_some() {
                let tint = [Color::new(0.12, 0.20, 0.30), Color::new(0.30, 0.11, 0.09), Color::new(0.15, 0.24, 0.13)];
                color = tint[(2.999 * dice(6.0)) as usize];
            }
        }
    }
    matt(color * weave)
}

/// Planks along x with grain and knots.
fn oak(p: &Point3<f64>) -> Color {
    const PLANK_M: f64 = 0.085;
    let plank = (p.y / PLANK_M).floor();
    let tone = 0.75 + 0.45 * hashed(&Vector3::new(plank, 5.0, 5.0));
    let bent = p.y + 0.010 * noise(&Vector3::new(p.x * 11.0, p.y * 24.0, plank));
    let rings = noise(&Vector3::new(p.x * 6.0, bent * 420.0, plank + 0.5));
    let fibre = noise(&Vector3::new(p.x * 90.0, bent * 1500.0, plank + 0.2));
    let gap = (p.y / PLANK_M - plank).min(1.0 - (p.y / PLANK_M - plank)) * PLANK_M < 0.0007;
    let color = Color::new(0.36, 0.215, 0.11) * tone * (0.55 + 0.6 * rings + 0.3 * fibre);
    if gap { color * 0.25 } else { color }
}

/// Whether ink covers a point, in the frame of a text's middle, metres; letters are `height` high.
fn written(text: &str, p: &Vector2<f64>, height: f64) -> bool {
    const ADVANCE: f64 = 5.6;
    const HALF_STROKE: f64 = 0.48;
    let unit = height / 6.0;
    let (x, y) = (p.x / unit + 0.5 * (ADVANCE * text.len() as f64 - (ADVANCE - 4.0)), p.y / unit + 3.0);
    if !(-1.0..7.0).contains(&y) || x < -1.0 {
        return false;
    }
    let index = ((x + 0.5 * (ADVANCE - 4.0)) / ADVANCE) as usize;
    let Some(letter) = text.chars().nth(index) else { return false };
    let q = Point2::new(x - ADVANCE * index as f64, y);
    strokes(letter).iter().any(|line| line.windows(2).any(|ends| distance(&q, ends) < HALF_STROKE))
}

/// From a point to a segment.
fn distance(p: &Point2<f64>, ends: &[(f64, f64)]) -> f64 {
    let [a, b] = [0, 1].map(|k| Point2::new(ends[k].0, ends[k].1));
    let along = b - a;
    let t = ((p - a).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
    (p - (a + along * t)).norm()
}

/// Lines of a capital letter or a digit, 4 wide and 6 high.
fn strokes(letter: char) -> &'static [&'static [(f64, f64)]] {
    match letter {
        'A' => &[&[(0.0, 0.0), (2.0, 6.0), (4.0, 0.0)], &[(0.8, 2.0), (3.2, 2.0)]],
        'B' => &[&[
            (0.0, 3.1),
            (2.6, 3.1),
            (3.5, 3.8),
            (3.5, 5.3),
            (2.6, 6.0),
            (0.0, 6.0),
            (0.0, 0.0),
            (2.8, 0.0),
            (4.0, 0.8),
            (4.0, 2.3),
            (2.6, 3.1),
        ]],
        'C' => &[&[
            (3.9, 4.7),
            (3.3, 5.7),
            (2.2, 6.0),
            (0.9, 5.5),
            (0.0, 4.2),
            (0.0, 1.8),
            (0.9, 0.5),
            (2.2, 0.0),
            (3.3, 0.3),
            (3.9, 1.3),
        ]],
        'I' => &[&[(2.0, 0.0), (2.0, 6.0)]],
        'M' => &[&[(0.0, 0.0), (0.0, 6.0), (2.0, 2.5), (4.0, 6.0), (4.0, 0.0)]],
        'W' => &[&[(0.0, 6.0), (1.0, 0.0), (2.0, 4.0), (3.0, 0.0), (4.0, 6.0)]],
        '3' => &[&[
            (0.2, 5.2),
            (1.2, 6.0),
            (2.8, 6.0),
            (3.8, 5.2),
            (3.8, 4.0),
            (2.6, 3.1),
            (3.8, 2.2),
            (3.8, 0.9),
            (2.8, 0.0),
            (1.2, 0.0),
            (0.2, 0.8),
        ]],
        '9' => &[&[
            (0.4, 0.6),
            (1.4, 0.0),
            (2.8, 0.3),
            (3.8, 2.0),
            (3.8, 4.6),
            (2.8, 6.0),
            (1.2, 6.0),
            (0.2, 4.9),
            (0.2, 3.8),
            (1.2, 2.8),
            (2.8, 2.8),
            (3.8, 4.0),
        ]],
        'D' => &[&[
            (0.0, 0.0),
            (0.0, 6.0),
            (2.3, 6.0),
            (3.5, 5.3),
            (4.0, 4.2),
            (4.0, 1.8),
            (3.5, 0.7),
            (2.3, 0.0),
            (0.0, 0.0),
        ]],
        'E' => &[&[(4.0, 6.0), (0.0, 6.0), (0.0, 0.0), (4.0, 0.0)], &[(0.0, 3.0), (3.2, 3.0)]],
        'G' => &[&[
            (3.9, 4.7),
            (3.3, 5.7),
            (2.2, 6.0),
            (0.9, 5.5),
            (0.0, 4.2),
            (0.0, 1.8),
            (0.9, 0.5),
            (2.2, 0.0),
            (4.0, 0.8),
            (4.0, 2.8),
            (2.4, 2.8),
        ]],
        'N' => &[&[(0.0, 0.0), (0.0, 6.0), (4.0, 0.0), (4.0, 6.0)]],
        'R' => &[
            &[(0.0, 0.0), (0.0, 6.0), (2.6, 6.0), (3.7, 5.5), (4.0, 4.6), (3.7, 3.6), (2.6, 3.0), (0.0, 3.0)],
            &[(2.0, 3.0), (4.0, 0.0)],
        ],
        'T' => &[&[(0.0, 6.0), (4.0, 6.0)], &[(2.0, 6.0), (2.0, 0.0)]],
        'X' => &[&[(0.0, 0.0), (4.0, 6.0)], &[(0.0, 6.0), (4.0, 0.0)]],
        '0' => &[&[
            (1.2, 0.0),
            (0.2, 1.4),
            (0.2, 4.6),
            (1.2, 6.0),
            (2.8, 6.0),
            (3.8, 4.6),
            (3.8, 1.4),
            (2.8, 0.0),
            (1.2, 0.0),
        ]],
        '1' => &[&[(0.8, 4.6), (2.2, 6.0), (2.2, 0.0)]],
        _ => &[],
    }
}

/// Smooth noise in [0, 1]: random values at the corners of a unit grid, interpolated.
pub fn noise(p: &Vector3<f64>) -> f64 {
    let cell = p.map(f64::floor);
    let f = (p - cell).map(|t| t * t * (3.0 - 2.0 * t));
    let mut sum = 0.0;
    for k in 0..8_u32 {
        let offset = Vector3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2));
        let weight = (0..3).map(|i| if offset[i] > 0.5 { f[i] } else { 1.0 - f[i] }).product::<f64>();
        sum += weight * hashed(&(cell + offset));
    }
    sum
}

/// A number in [0, 1) for a corner of a grid (the finaliser of splitmix64).
pub fn hashed(corner: &Vector3<f64>) -> f64 {
    let mut h =
        corner.iter().fold(7_u64, |h, c| h.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ ((c * 64.0).round() as i64 as u64));
    h = (h ^ (h >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    h = (h ^ (h >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((h ^ (h >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}
