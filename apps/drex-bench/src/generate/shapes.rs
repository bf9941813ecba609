//! Outer shapes, and what is left of them inside a wall.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::Kind;
use super::prism::{Prism, Section};

/// Lengths are multiples of one part of so many of a metre: halves and sums of them have at most six digits, as other programs write them.
const GRID_PER_M: f64 = 250_000.0;
/// Radius of a bottle's cap against that of its neck.
const CAP: f64 = 0.6;

/// How a part stands to the one that it is joined to.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Joint {
    /// Alone, or another is joined to it.
    None,
    /// On top of a wider one.
    Above,
    /// Under a wider one.
    Below,
}

/// An outer shape: parts one above another, the widest first, the origin in the middle of the bounding box.
#[derive(Debug, Clone)]
pub(super) struct Shape {
    parts: Vec<(Joint, Prism)>,
    top_m: f64,
}

/// The nearest length on the grid, metres.
pub(super) fn on_grid(length_m: f64) -> f64 {
    (length_m * GRID_PER_M).round() / GRID_PER_M
}

impl Shape {
    /// A shape of sizes that a hand can hold.
    pub fn draw(kind: Kind, random: &mut ChaCha8Rng) -> Self {
        let mut draw = |low: f64, high: f64| on_grid(random.random_range(low..high));
        match kind {
            Kind::Box => {
                let [x, y, z] = [draw(0.025, 0.06), draw(0.04, 0.11), draw(0.05, 0.14)];
                Self::of(z, [(Joint::None, Section::Rectangle([0.5 * x, 0.5 * y]), 0.0, [0.0, z])])
            }
            Kind::Cylinder => {
                let [radius, z] = [draw(0.018, 0.042), draw(0.06, 0.14)];
                Self::of(z, [(Joint::None, Section::Disc(radius), 0.0, [0.0, z])])
            }
            Kind::Bottle => {
                let [radius, body, neck_radius] = [draw(0.022, 0.04), draw(0.07, 0.12), draw(0.012, 0.018)];
                let [neck, cap] = [draw(0.02, 0.035), draw(0.012, 0.025)];
                let (shoulder, mouth) = (body, body + neck);
                Self::of(
                    mouth + cap,
                    [
                        (Joint::None, Section::Disc(radius), 0.0, [0.0, shoulder]),
                        (Joint::Above, Section::Disc(neck_radius), 0.0, [shoulder, mouth]),
                        (Joint::Above, Section::Disc(on_grid(CAP * neck_radius)), 0.0, [mouth, mouth + cap]),
                    ],
                )
            }
            Kind::LetterL | Kind::LetterT | Kind::LetterU => {
                let [thick, bar] = [draw(0.022, 0.045), draw(0.016, 0.028)];
                let [wide, high] = [draw(0.055, 0.1), draw(0.065, 0.11)];
                let across = Section::Rectangle([0.5 * thick, 0.5 * wide]);
                let stem = Section::Rectangle([0.5 * thick, 0.5 * bar]);
                let side = 0.5 * (wide - bar);
                let foot = (Joint::None, across, 0.0, [0.0, bar]);
                let left = (Joint::Above, stem, -side, [bar, high]);
                match kind {
                    Kind::LetterT => Self::of(
                        high,
                        [(Joint::None, across, 0.0, [high - bar, high]), (Joint::Below, stem, 0.0, [0.0, high - bar])],
                    ),
                    Kind::LetterU => Self::of(high, [foot, left, (Joint::Above, stem, side, [bar, high])]),
                    _ => Self::of(high, [foot, left]),
                }
            }
        }
    }

    /// Parts by joint, section, place along y and heights above the ground, metres.
    fn of<const N: usize>(height_m: f64, parts: [(Joint, Section, f64, [f64; 2]); N]) -> Self {
        let top_m = 0.5 * height_m;
        let parts =
            parts.map(|(joint, section, y, [low, high])| (joint, Prism::new(section, y, low - top_m, high - top_m)));
        Self { parts: parts.to_vec(), top_m }
    }

    pub fn parts(&self) -> impl Iterator<Item = Prism> {
        self.parts.iter().map(|(_, part)| *part)
    }

    /// The part that stands on the ground.
    pub fn base(&self) -> Prism {
        let low = |p: &Prism| p.center.z - p.half_height_m;
        let lowest = self.parts().min_by(|a, b| low(a).total_cmp(&low(b)));
        // Every shape has a part.
        lowest.expect("a shape has parts")
    }

    /// What is empty inside a wall of this thickness: one cavity per part. Where a part meets a wider one, its cavity goes on
    /// through that one's wall, so that the cavities are one.
    pub fn cavities(&self, wall_m: f64, open_top: bool) -> impl Iterator<Item = Prism> {
        self.parts.iter().map(move |(joint, part)| {
            let section = match part.section {
                Section::Rectangle(half) => Section::Rectangle(half.map(|h| h - wall_m)),
                Section::Disc(radius) => Section::Disc(radius - wall_m),
            };
            let [low, high] = [-1.0, 1.0].map(|side| part.center.z + side * part.half_height_m);
            let low = if *joint == Joint::Above { low - wall_m } else { low + wall_m };
            let is_top = (high - self.top_m) * GRID_PER_M > -0.5;
            let high = match joint {
                Joint::Below => high + wall_m,
                _ if open_top && is_top => high,
                _ => high - wall_m,
            };
            Prism::new(section, part.center.y, low, high)
        })
    }
}
