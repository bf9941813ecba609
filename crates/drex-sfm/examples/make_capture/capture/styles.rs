//! What each style of picture draws.

use std::f64::consts::TAU;

use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::canvas::{Canvas, Noise};
use super::hash01;
use super::paint::{Colour, luminance, random_colour};

impl Canvas {
    pub(super) fn print(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let dark = luminance(self.texels[0]) < 0.2;
        let range = if dark { 0.5..0.85 } else { 0.02..0.08 };
        let ink = random_colour(rng, range.clone());
        let other = random_colour(rng, range);
        let columns = (self.size_m[0] / (unit_m * rng.random_range(250.0..600.0))).ceil().max(1.0);
        let width = self.size_m[0] / columns;
        for column in 0..columns as usize {
            let left = width * (column as f64 + 0.04);
            let right = width * (column as f64 + 0.94);
            let mut y = 0.0;
            while y < self.size_m[1] {
                let size: f64 =
                    if rng.random_bool(0.12) { rng.random_range(28.0..75.0) } else { rng.random_range(9.0..17.0) };
                let height = size * unit_m;
                if y + height > self.size_m[1] {
                    break;
                }
                let mut x = left + rng.random_range(0.0..0.1) * width;
                while x + 3.0 * height < right {
                    let colour = if rng.random_bool(0.85) { ink } else { other };
                    x += self.word(Vector2::new(x, y), height, Vector2::x(), colour, rng) + 0.7 * height;
                }
                y += height * rng.random_range(1.3..1.8);
            }
        }
    }

    pub(super) fn confetti(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let palette: Vec<Colour> = (0..12).map(|_| random_colour(rng, 0.03..0.8)).collect();
        let mut left = 1.1 * self.size_m[0] * self.size_m[1];
        let largest = 0.2 * self.size_m[0].min(self.size_m[1]);
        let dense = rng.random_range(0.8..1.6);
        while left > 0.0 {
            // Sizes by a power law: many small, few large.
            let r = (unit_m * 4.0 * rng.random_range(0.012f64..1.0).powf(-0.7) * dense).min(largest);
            left -= 2.0 * r * r;
            let at = Vector2::new(rng.random_range(0.0..self.size_m[0]), rng.random_range(0.0..self.size_m[1]));
            let ink = palette[rng.random_range(0..palette.len())];
            self.scrap(at, r, ink, rng);
        }
    }

    fn scrap(&mut self, at: Vector2<f64>, r: f64, ink: Colour, rng: &mut ChaCha8Rng) {
        let angle: f64 = rng.random_range(0.0..TAU);
        let along = Vector2::new(angle.cos(), angle.sin());
        let slim: f64 = rng.random_range(0.35..1.0);
        let reach = 1.6 * r + self.texel_m[0];
        match rng.random_range(0..5) {
            0 => self.fill(at, reach, ink, |p| {
                let q = Vector2::new(p.dot(&along), p.perp(&along) / slim);
                (q.norm() - r) * slim
            }),
            1 => self.stroke(at - along * r, at + along * r, 0.15 * r, ink),
            2 => {
                self.word(at, r, along, ink, rng);
            }
            _ => {
                let corners = rng.random_range(3..6);
                let sides: Vec<(Vector2<f64>, f64)> = (0..corners)
                    .map(|i| {
                        let a = angle + TAU * (f64::from(i) + rng.random_range(-0.25..0.25)) / f64::from(corners);
                        (Vector2::new(a.cos(), a.sin()), r * rng.random_range(0.4..0.8))
                    })
                    .collect();
                self.fill(at, reach, ink, |p| sides.iter().map(|(n, d)| n.dot(&p) - d).fold(f64::MIN, f64::max));
            }
        }
    }

    pub(super) fn spines(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let mut shelf = 0.0;
        while shelf < self.size_m[1] {
            let tall = (unit_m * rng.random_range(220.0..420.0)).min(self.size_m[1] - shelf);
            let mut x = 0.0;
            while x < self.size_m[0] {
                let wide = (unit_m * rng.random_range(22.0..70.0)).min(self.size_m[0] - x);
                let top = tall * rng.random_range(0.03..0.25);
                let half = Vector2::new(0.5 * wide, 0.5 * (tall - top));
                let middle = Vector2::new(x + half.x, shelf + top + half.y);
                let colour = random_colour(rng, 0.03..0.7);
                self.fill(middle, half.norm(), colour, |p| (p.x.abs() - half.x).max(p.y.abs() - half.y));
                let ink = random_colour(rng, if luminance(colour) < 0.25 { 0.4..0.85 } else { 0.02..0.1 });
                let mut y = shelf + top + 0.1 * tall;
                let height = wide * rng.random_range(0.3..0.6);
                while y + 6.0 * height < shelf + tall {
                    let corner = Vector2::new(x + 0.5 * (wide + height), y);
                    y += self.word(corner, height, Vector2::y(), ink, rng) + rng.random_range(0.5..3.0) * height;
                }
                x += wide;
            }
            shelf += tall;
        }
    }

    pub(super) fn chips(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let palette: Vec<Colour> = (0..5).map(|_| random_colour(rng, 0.04..0.8)).collect();
        let coarse = rng.random_range(1.0..1.8);
        let mut left = 0.8 * self.size_m[0] * self.size_m[1];
        while left > 0.0 {
            let r = unit_m * coarse * rng.random_range(2.0..10.0f64);
            left -= 2.0 * r * r;
            let at = Vector2::new(rng.random_range(0.0..self.size_m[0]), rng.random_range(0.0..self.size_m[1]));
            let ink = palette[rng.random_range(0..palette.len())];
            let angle: f64 = rng.random_range(0.0..TAU);
            let sides: Vec<(Vector2<f64>, f64)> = (0..5)
                .map(|i| {
                    let a = angle + TAU * f64::from(i) / 5.0;
                    (Vector2::new(a.cos(), a.sin()), r * rng.random_range(0.5..1.0))
                })
                .collect();
            self.fill(at, 1.6 * r, ink, |p| sides.iter().map(|(n, d)| n.dot(&p) - d).fold(f64::MIN, f64::max));
        }
    }

    pub(super) fn quilt(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let cell = unit_m * rng.random_range(35.0..90.0);
        let cells = self.size_m.map(|s| (s / cell).ceil().max(2.0) as i64);
        let pitch = [self.size_m[0] / cells[0] as f64, self.size_m[1] / cells[1] as f64];
        let colours: Vec<Colour> = (0..cells[0] * cells[1]).map(|_| random_colour(rng, 0.04..0.75)).collect();
        let seed: u64 = rng.random();
        let ragged = [Noise::new(self, seed ^ 1, [0.3 * cell; 2], 3), Noise::new(self, seed ^ 2, [0.3 * cell; 2], 3)];
        let middles: Vec<Vector2<f64>> = (0..colours.len() as u64)
            .map(|id| [seed ^ id, seed ^ (id + (1 << 32))].map(|key| 0.1 + 0.8 * f64::from(hash01(key))).into())
            .collect();
        self.every_texel(|near, u, v, texel| {
            let [dx, dy] = [0, 1].map(|i| f64::from(ragged[i].at(u, v, &mut near[i])) - 0.5);
            let (x, y) = (u * cells[0] as f64 + 0.5 * dx, v * cells[1] as f64 + 0.5 * dy);
            let (cx, cy) = (x.floor() as i64, y.floor() as i64);
            let mut best = (f64::INFINITY, 0);
            for j in cy - 1..=cy + 1 {
                for i in cx - 1..=cx + 1 {
                    let id = (j.rem_euclid(cells[1]) * cells[0] + i.rem_euclid(cells[0])) as usize;
                    let middle = middles[id];
                    let d = Vector2::new((i as f64 + middle.x - x) * pitch[0], (j as f64 + middle.y - y) * pitch[1]);
                    if d.norm_squared() < best.0 {
                        best = (d.norm_squared(), id);
                    }
                }
            }
            *texel = colours[best.1];
        });
        self.shade(seed ^ 5, 25.0 * unit_m, 3, 0.35);
    }

    pub(super) fn wood(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let dark = luminance(self.texels[0]) < 0.3;
        let other = random_colour(rng, if dark { 0.4..0.65 } else { 0.05..0.16 });
        let planks = (self.size_m[1] / (unit_m * rng.random_range(150.0..320.0))).ceil();
        let rings = rng.random_range(5.0..11.0);
        let seed: u64 = rng.random();
        let size = self.size_m;
        let bend = Noise::new(self, seed ^ 3, [360.0 * unit_m, 60.0 * unit_m], 4);
        let fibre = Noise::new(self, seed ^ 4, [90.0 * unit_m, 4.0 * unit_m], 3);
        self.every_texel(|[near_bend, near_fibre], u, v, texel| {
            let plank = (v * planks).floor();
            let key = seed ^ plank as u64;
            let across = v * planks - plank;
            let at = f64::from(bend.at((u + f64::from(hash01(key))).fract(), v, near_bend));
            let ring = (rings * (across + 2.2 * at)).fract();
            let grain = f64::from(fibre.at(u, v, near_fibre));
            let tone = 0.75 * (ring * (2.0 - ring)) + 0.25 * grain;
            let shade = 0.85 + 0.3 * hash01(key ^ 99);
            let gap = (0.5 - (across - 0.5).abs()) * size[1] / planks < 0.7 * unit_m;
            for c in 0..3 {
                let mixed = (texel[c] + tone as f32 * (other[c] - texel[c])) * shade;
                texel[c] = if gap { 0.3 * mixed } else { mixed };
            }
        });
    }

    pub(super) fn cloth(&mut self, unit_m: f64, rng: &mut ChaCha8Rng) {
        let pitch = unit_m * rng.random_range(26.0..44.0);
        let count = self.size_m.map(|s| (s / pitch).round().max(1.0) as usize);
        let step = Vector2::new(self.size_m[0] / count[0] as f64, self.size_m[1] / count[1] as f64);
        let inks = [0, 1, 2].map(|_| random_colour(rng, 0.05..0.8));
        let letter = rng.random_range(0..60u64) * 7919;
        let r = 0.22 * pitch;
        for j in 0..count[1] {
            for i in 0..count[0] {
                let at = Vector2::new((i as f64 + 0.3) * step.x, (j as f64 + 0.3) * step.y);
                self.fill(at, r + unit_m, inks[0], |p| p.norm() - r);
                let corner = at + Vector2::new(0.45 * step.x, 0.2 * step.y);
                self.letter(corner, 0.4 * pitch, Vector2::x(), letter, inks[1]);
                let line = Vector2::new((i as f64 + 0.5) * step.x, (j as f64 + 0.95) * step.y);
                self.stroke(
                    line - step * 0.3,
                    line + Vector2::new(0.3, -0.3).component_mul(&step),
                    0.03 * pitch,
                    inks[2],
                );
            }
        }
    }
}
