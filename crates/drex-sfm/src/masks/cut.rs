//! Object against background in one picture: a minimum cut over the pixels, along colour edges where it can.

use super::maxflow::FlowGraph;

/// Cost of an edge between unlike pixels of the same colour, nats, and the part that stays whatever the colours.
const SMOOTHNESS: f32 = 2.5;
const LEAST: f32 = 0.12;
const UNITS_PER_NAT: f32 = 200.0;

/// What is known of a pixel before the cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Pixel {
    Background,
    Object,
    /// Log-likelihood ratio, object over background, nats.
    Open(f32),
}

/// A window of a picture to be cut.
pub(super) struct Cut<'a> {
    pub width: usize,
    pub height: usize,
    pub pixels: &'a [Pixel],
    pub colour: &'a dyn Fn(usize) -> [u8; 3],
}

fn difference(a: [u8; 3], b: [u8; 3]) -> f32 {
    (0..3).map(|k| (f32::from(a[k]) - f32::from(b[k])).powi(2)).sum()
}

impl Cut<'_> {
    /// Visits each pair of neighbours of which one is open at the least: indices and 1/distance.
    fn pairs(&self, mut visit: impl FnMut(usize, usize, f32)) {
        let (w, h) = (self.width, self.height);
        let open = |at: usize| matches!(self.pixels[at], Pixel::Open(_));
        for y in 0..h {
            for x in 0..w {
                let at = y * w + x;
                let here = open(at);
                let mut pair = |other: usize, nearness: f32| {
                    if here || open(other) {
                        visit(at, other, nearness);
                    }
                };
                if x + 1 < w {
                    pair(at + 1, 1.0);
                }
                if y + 1 < h {
                    pair(at + w, 1.0);
                    if x + 1 < w {
                        pair(at + w + 1, std::f32::consts::FRAC_1_SQRT_2);
                    }
                    if x > 0 {
                        pair(at + w - 1, std::f32::consts::FRAC_1_SQRT_2);
                    }
                }
            }
        }
    }

    /// The pixels of the object.
    pub fn solve(&self) -> Vec<bool> {
        let mut node = vec![u32::MAX; self.pixels.len()];
        let mut count = 0;
        for (at, pixel) in self.pixels.iter().enumerate() {
            if matches!(pixel, Pixel::Open(_)) {
                node[at] = count as u32;
                count += 1;
            }
        }
        let (mut sum, mut number) = (0.0f64, 0u64);
        self.pairs(|a, b, _| {
            sum += f64::from(difference((self.colour)(a), (self.colour)(b)));
            number += 1;
        });
        let mean = (sum / number.max(1) as f64).max(1.0) as f32;
        let units = |nats: f32| (nats * UNITS_PER_NAT).clamp(0.0, 1e6) as i32;
        let mut graph = FlowGraph::new(count, number as usize);
        for (at, pixel) in self.pixels.iter().enumerate() {
            if let Pixel::Open(nats) = pixel {
                graph.add_terminal(node[at] as usize, units(*nats), units(-nats));
            }
        }
        self.pairs(|a, b, nearness| {
            let contrast = difference((self.colour)(a), (self.colour)(b)) / (2.0 * mean);
            let cost = units(nearness * (LEAST + SMOOTHNESS * (-contrast).exp()));
            match (node[a], node[b]) {
                (u32::MAX, n) | (n, u32::MAX) => {
                    let fixed = if node[a] == u32::MAX { self.pixels[a] } else { self.pixels[b] };
                    let (source, sink) = if fixed == Pixel::Object { (cost, 0) } else { (0, cost) };
                    graph.add_terminal(n as usize, source, sink);
                }
                (a, b) => graph.add_edge(a as usize, b as usize, cost, cost),
            }
        });
        graph.solve();
        (0..self.pixels.len())
            .map(|at| match self.pixels[at] {
                Pixel::Object => true,
                Pixel::Background => false,
                Pixel::Open(_) => graph.with_source(node[at] as usize),
            })
            .collect()
    }
}

/// Distance of each pixel to the nearest pixel of the other kind, positive inside `mask`, pixels; by two sweeps over
/// (1, sqrt 2) steps. Pixels beyond the window count as not in the mask where `open_border` is false, and as unknown else.
pub(super) fn signed_distance(mask: &[bool], width: usize, height: usize) -> Vec<f32> {
    const FAR: f32 = 1e6;
    let sweep = |of: bool| {
        let mut d: Vec<f32> = mask.iter().map(|m| if *m == of { FAR } else { 0.0 }).collect();
        let diagonal = std::f32::consts::SQRT_2;
        for y in 0..height {
            for x in 0..width {
                let at = y * width + x;
                let mut best = d[at];
                if x > 0 {
                    best = best.min(d[at - 1] + 1.0);
                }
                if y > 0 {
                    best = best.min(d[at - width] + 1.0);
                    if x > 0 {
                        best = best.min(d[at - width - 1] + diagonal);
                    }
                    if x + 1 < width {
                        best = best.min(d[at - width + 1] + diagonal);
                    }
                }
                d[at] = best;
            }
        }
        for y in (0..height).rev() {
            for x in (0..width).rev() {
                let at = y * width + x;
                let mut best = d[at];
                if x + 1 < width {
                    best = best.min(d[at + 1] + 1.0);
                }
                if y + 1 < height {
                    best = best.min(d[at + width] + 1.0);
                    if x > 0 {
                        best = best.min(d[at + width - 1] + diagonal);
                    }
                    if x + 1 < width {
                        best = best.min(d[at + width + 1] + diagonal);
                    }
                }
                d[at] = best;
            }
        }
        d
    };
    let (inside, outside) = (sweep(true), sweep(false));
    inside.iter().zip(&outside).map(|(i, o)| if *i > 0.0 { *i - 0.5 } else { 0.5 - *o }).collect()
}
