//! Random objects of many categories, some of which no network is trained on.

use std::f64::consts::{PI, TAU};

use anyhow::Result;
use drex_core::TriMesh;
use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::objects::ObjectSpec;
use crate::shapes::{extrusion, lathe, loft, rounded_box};

/// Masses that the objects are drawn from, kg: evenly in the logarithm.
const MASS_KG: [f64; 2] = [0.02, 1.0];
/// Least and greatest density, foam and filled tins, kg/m³: a mass beyond is cut.
const DENSITY_KG_M3: [f64; 2] = [30.0, 3000.0];
/// Strokes of letters and other outlines, and their depth, metres.
const STROKE_M: [f64; 2] = [0.014, 0.032];
const DEPTH_M: [f64; 2] = [0.02, 0.06];
/// Width of a stroke at its end, as a share of its width.
const END: f64 = 0.95;

/// What kind of thing an object is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[rustfmt::skip]
pub enum Category {
    // Trained on.
    Box, Can, Bottle, Flask, Cup, Ball, Prism, Tool, Bowl, LetterL, LetterT, LetterU, Cross, Frame, Wedge,
    // Held out.
    Dumbbell, Bulb, Goblet, Spray, Hammer, Star, LetterH, Arch, House,
}

impl Category {
    /// Those that training may see.
    #[rustfmt::skip]
    pub const TRAINED: [Self; 15] = [
        Self::Box, Self::Can, Self::Bottle, Self::Flask, Self::Cup, Self::Ball, Self::Prism, Self::Tool, Self::Bowl, Self::LetterL,
        Self::LetterT, Self::LetterU, Self::Cross, Self::Frame, Self::Wedge,
    ];
    /// Those that it may not.
    #[rustfmt::skip]
    pub const HELD_OUT: [Self; 9] = [
        Self::Dumbbell, Self::Bulb, Self::Goblet, Self::Spray, Self::Hammer, Self::Star, Self::LetterH, Self::Arch, Self::House,
    ];

    /// Its name in files.
    fn name(self) -> String {
        format!("{self:?}")
            .chars()
            .flat_map(|c| c.is_uppercase().then_some('_').into_iter().chain(c.to_lowercase()))
            .skip(1)
            .collect()
    }
}

/// The object of a number among those of a split: the same two numbers give the same object.
///
/// # Errors
/// If an outline that was drawn crosses itself.
pub fn graspable(categories: &[Category], seed: u64, number: u64) -> Result<ObjectSpec> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(number);
    let category = categories[(number % categories.len() as u64) as usize];
    let mesh = category.mesh(&mut Draw(&mut random))?;
    let volume_m3 = drex_mesh::solid_properties(&mesh)?.volume_m3;
    let mass_kg = Draw(&mut random).in_log(MASS_KG).clamp(DENSITY_KG_M3[0] * volume_m3, DENSITY_KG_M3[1] * volume_m3);
    let mass_kg = mass_kg.clamp(MASS_KG[0], MASS_KG[1]);
    let name = format!("{}_{number:04}", category.name());
    Ok(ObjectSpec { name, mesh, mass_kg, friction: None, max_force_n: None, damaged_at_n: None, up: None })
}

/// Draws lengths.
struct Draw<'a>(&'a mut ChaCha8Rng);

impl Draw<'_> {
    fn within(&mut self, [lo, hi]: [f64; 2]) -> f64 {
        self.0.random_range(lo..hi)
    }

    fn in_log(&mut self, [lo, hi]: [f64; 2]) -> f64 {
        self.within([lo.ln(), hi.ln()]).exp()
    }
}

impl Category {
    fn mesh(self, draw: &mut Draw<'_>) -> Result<TriMesh> {
        let [stroke, depth] = [draw.within(STROKE_M), draw.within(DEPTH_M)];
        // Half of the width and the height of an outline.
        let [w, h] = [draw.within([0.026, 0.05]), draw.within([0.03, 0.07])];
        // As far as an outline of this size has room for its strokes.
        let s = stroke.min(0.55 * w).min(0.55 * h);
        Ok(match self {
            Self::Box => {
                let size = [draw.in_log([0.02, 0.1]), draw.in_log([0.025, 0.12]), draw.in_log([0.025, 0.18])];
                let radius = draw.within([0.02, 0.2]) * size[0].min(size[1]);
                rounded_box(size, radius)?
            }
            Self::Can => {
                let r = draw.in_log([0.014, 0.047]);
                lathe(&[[r, 0.0], [r, draw.in_log([0.025, 0.18])]])
            }
            Self::Bottle => {
                let [r, z] = [draw.within([0.02, 0.042]), draw.within([0.06, 0.13])];
                let [neck, shoulder, top] =
                    [r * draw.within([0.3, 0.7]), draw.within([0.005, 0.04]), draw.within([0.015, 0.06])];
                lathe(&[[0.93 * r, 0.0], [r, 0.005], [r, z], [neck, z + shoulder], [neck, z + shoulder + top]])
            }
            Self::Flask => {
                let [a, b, z] = [draw.within([0.028, 0.048]), draw.within([0.014, 0.032]), draw.within([0.06, 0.15])];
                let [bottom, top] = [draw.within([0.8, 1.0]), draw.within([0.35, 0.9])];
                loft(&[[bottom * a, bottom * b, 0.0], [a, b, 0.3 * z], [a, b, 0.6 * z], [top * a, top * b, z]])
            }
            Self::Cup => {
                let [r, z, foot] = [draw.within([0.028, 0.046]), draw.within([0.05, 0.12]), draw.within([0.6, 0.85])];
                lathe(&[[foot * r, 0.0], [r, z]])
            }
            Self::Ball => {
                let [a, b, c] = [draw.within([0.018, 0.045]), draw.within([0.75, 1.0]), draw.within([0.6, 1.2])];
                loft(
                    &(1..16)
                        .map(|i| (PI * f64::from(i) / 16.0).sin_cos())
                        .map(|(s, z)| [a * s, a * b * s, a * c * (1.0 - z)])
                        .collect::<Vec<_>>(),
                )
            }
            Self::Prism => {
                let (corners, r) = ([3, 5, 6, 8][draw.0.random_range(0..4)], draw.within([0.018, 0.045]));
                extrusion(&polygon(corners, &[r]), &[], draw.in_log([0.025, 0.14]))?
            }
            Self::Tool => {
                let [r, z] = [draw.within([0.011, 0.02]), draw.within([0.07, 0.12])];
                let [waist, blade, length] =
                    [draw.within([0.75, 1.0]), draw.within([0.15, 0.35]), draw.within([0.03, 0.1])];
                lathe(&[
                    [0.6 * r, 0.0],
                    [r, 0.006],
                    [waist * r, 0.6 * z],
                    [r, 0.85 * z],
                    [blade * r, z],
                    [blade * r, z + length],
                ])
            }
            Self::Bowl => {
                let [r, z, foot] = [draw.within([0.035, 0.052]), draw.within([0.022, 0.05]), draw.within([0.35, 0.7])];
                lathe(&[[foot * r, 0.0], [0.85 * r, 0.5 * z], [r, z]])
            }
            Self::LetterL => {
                extrusion(&[[-w, -h], [w, -h], [w, s - h], [s - w, s - h], [s - w, h], [-w, h]], &[], depth)?
            }
            Self::LetterT => {
                let half = 0.5 * s;
                extrusion(
                    &[[-half, -h], [half, -h], [half, h - s], [w, h - s], [w, h], [-w, h], [-w, h - s], [-half, h - s]],
                    &[],
                    depth,
                )?
            }
            Self::LetterU => extrusion(
                &[[-w, -h], [w, -h], [w, h], [w - s, h], [w - s, s - h], [s - w, s - h], [s - w, h], [-w, h]],
                &[],
                depth,
            )?,
            Self::Cross => {
                // Arms are narrower at their ends: ears cannot be cut from corners that are in line.
                let [a, b] = [0.5 * s, 0.5 * s * draw.within([0.8, 1.25])];
                let right = [[END * a, -h], [a, -b], [w, -END * b], [w, END * b], [a, b], [END * a, h]];
                let left = right.map(|[x, y]| [-x, -y]);
                extrusion(&[right, left].concat(), &[], depth)?
            }
            Self::Frame => {
                let (x, y) = (w - 0.8 * s, h - 0.8 * s);
                extrusion(&[[-w, -h], [w, -h], [w, h], [-w, h]], &[[-x, -y], [-x, y], [x, y], [x, -y]], depth)?
            }
            Self::Wedge => {
                let top = w * draw.within([0.1, 0.8]);
                let shift = (w - top) * draw.within([-1.0, 1.0]);
                extrusion(&[[-w, -h], [w, -h], [shift + top, 0.4 * h], [shift - top, 0.4 * h]], &[], depth)?
            }
            Self::Dumbbell => {
                let [r, bar, end, length] = [
                    draw.within([0.02, 0.04]),
                    draw.within([0.3, 0.55]),
                    draw.within([0.015, 0.035]),
                    draw.within([0.05, 0.1]),
                ];
                lathe(&[
                    [r, 0.0],
                    [r, end],
                    [bar * r, end + 0.003],
                    [bar * r, end + length],
                    [r, end + length + 0.003],
                    [r, 2.0 * end + length + 0.003],
                ])
            }
            Self::Bulb => {
                let [r, foot, length] =
                    [draw.within([0.022, 0.038]), draw.within([0.35, 0.5]), draw.within([0.7, 1.3])];
                let profile = [[foot, 0.0], [foot, 0.9], [0.8, 1.7], [1.0, 2.4], [0.92, 3.0], [0.5, 3.5], [0.15, 3.6]];
                lathe(&profile.map(|[x, z]| [x * r, z * length * r]))
            }
            Self::Goblet => {
                let [r, z, stem, foot] = [
                    draw.within([0.026, 0.042]),
                    draw.within([0.04, 0.07]),
                    draw.within([0.02, 0.05]),
                    draw.within([0.7, 0.95]),
                ];
                let thin = 0.2 * r;
                lathe(&[
                    [foot * r, 0.0],
                    [foot * r, 0.005],
                    [thin, 0.012],
                    [thin, 0.012 + stem],
                    [0.9 * r, 0.02 + stem + 0.3 * z],
                    [r, 0.02 + stem + z],
                ])
            }
            Self::Spray => {
                let [a, b, z] = [draw.within([0.03, 0.046]), draw.within([0.02, 0.03]), draw.within([0.07, 0.12])];
                let [neck, head] = [draw.within([0.01, 0.015]), draw.within([0.03, 0.045])];
                let sections = [
                    [a, b, 0.0],
                    [a, b, z],
                    [0.7 * a, 0.75 * b, z + 0.03],
                    [neck, neck, z + 0.042],
                    [neck, neck, z + 0.056],
                    [head, neck, z + 0.064],
                    [head, neck, z + 0.09],
                ];
                loft(&sections)
            }
            Self::Hammer => {
                let [half, head, grip] =
                    [draw.within([0.008, 0.014]), draw.within([0.02, 0.034]), draw.within([0.09, 0.15])];
                let reach = draw.within([0.028, 0.05]);
                let outline = [
                    [-half, 0.0],
                    [half, 0.0],
                    [half, grip],
                    [reach, grip],
                    [reach, grip + head],
                    [-reach, grip + head],
                    [-reach, grip],
                    [-half, grip],
                ];
                extrusion(&outline, &[], draw.within([0.018, 0.034]))?
            }
            Self::Star => {
                let [r, inner] = [draw.within([0.03, 0.05]), draw.within([0.45, 0.7])];
                extrusion(&polygon([5, 6, 8][draw.0.random_range(0..3)] * 2, &[r, inner * r]), &[], depth)?
            }
            Self::LetterH => {
                let (half, inner) = (0.5 * s, w - END * s);
                let right = [[w - s, -half], [inner, -h], [w, -h], [w, h], [inner, h], [w - s, half]];
                let left = right.map(|[x, y]| [-x, -y]);
                extrusion(&[right, left].concat(), &[], depth)?
            }
            Self::Arch => {
                let (inner, at) = (w - s, |r: f64, i: usize| (r, PI * i as f64 / 12.0));
                let point = |(r, angle): (f64, f64)| [r * angle.cos(), r * angle.sin()];
                let foot = -draw.within([0.005, 0.04]);
                let mut outline = vec![[-w, foot], [-inner, foot]];
                outline.extend((0..=12).rev().map(|i| point(at(inner, i))));
                outline.extend([[inner, foot], [w, foot]]);
                outline.extend((0..=12).map(|i| point(at(w, i))));
                extrusion(&outline, &[], depth)?
            }
            Self::House => {
                let roof = draw.within([0.3, 1.0]) * w;
                extrusion(
                    &[[-w, -h], [w, -h], [w, 0.5 * h], [0.0, 0.5 * h + roof], [-w, 0.5 * h]],
                    &[],
                    depth.max(0.03),
                )?
            }
        })
    }
}

/// A closed outline with its corners at these radii in turns, counter-clockwise.
fn polygon(corners: usize, radii: &[f64]) -> Vec<[f64; 2]> {
    let corner = |i: usize| (radii[i % radii.len()], TAU * i as f64 / corners as f64);
    (0..corners).map(corner).map(|(r, angle)| [r * angle.cos(), r * angle.sin()]).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use drex_mesh::solid_properties;

    use super::*;

    #[test]
    fn objects_of_every_category_are_closed_graspable_and_given_by_their_numbers() {
        for (categories, seed) in [(&Category::TRAINED[..], 1), (&Category::HELD_OUT[..], 2)] {
            for number in 0..90 {
                let spec = graspable(categories, seed, number).unwrap();
                let solid = solid_properties(&spec.mesh).unwrap();
                assert!(solid.open_edges == 0 && solid.volume_m3 > 5e-6, "{}: {solid:?}", spec.name);
                assert!((0.02..=1.0).contains(&spec.mass_kg), "{}", spec.name);
                let (lo, hi) = spec.mesh.bounds().unwrap();
                let mut size: Vec<f64> = (hi - lo).iter().copied().collect();
                size.sort_by(f64::total_cmp);
                assert!(size[0] > 0.015 && size[0] < 0.11 && size[2] < 0.25, "{}: {size:?}", spec.name);
                assert_eq!(graspable(categories, seed, number).unwrap().mesh, spec.mesh);
            }
        }
        assert!(Category::TRAINED.iter().all(|c| !Category::HELD_OUT.contains(c)));
        assert_eq!((Category::LetterH.name(), Category::Box.name()), ("letter_h".into(), "box".into()));
    }
}
