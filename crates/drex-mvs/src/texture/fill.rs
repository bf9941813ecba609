//! Colours where no photo showed any.

use super::atlas::Atlas;
use super::charts::{NONE, neighbours};

/// Sweeps that smooth what was filled, and how far each overshoots (successive over-relaxation).
const SWEEPS: usize = 150;
const OVERSHOOT: f32 = 1.8;
/// Rings of texels round each chart that get its colours: as wide as two gutters, so that smaller pictures of the atlas have no dark rims.
const RINGS: usize = 6;

/// Gives the texels without a colour a smooth one, from those beside them on the mesh: the harmonic function between them, nearly. `faces` are
/// those of the mesh, `colours` has an entry per texel of the atlas.
pub(super) fn fill_unseen(atlas: &Atlas, faces: &[[u32; 3]], colours: &mut [Option<[f32; 3]>]) {
    let near = Near::new(atlas, faces);
    let unseen: Vec<usize> = (0..colours.len()).filter(|t| colours[*t].is_none()).collect();
    let mut rest = unseen.clone();
    loop {
        let ring: Vec<(usize, [f32; 3])> =
            rest.iter().filter_map(|&t| Some((t, mean(near.of(atlas, t).filter_map(|n| colours[n]))?))).collect();
        if ring.is_empty() {
            break;
        }
        ring.iter().for_each(|(t, colour)| colours[*t] = Some(*colour));
        rest.retain(|t| colours[*t].is_none());
    }
    // What has no connection to anything seen.
    let usual = mean(colours.iter().flatten().copied()).unwrap_or([0.5; 3]);
    colours.iter_mut().for_each(|c| *c = c.or(Some(usual)));
    for _ in 0..SWEEPS {
        for &t in &unseen {
            let Some(mean) = mean(near.of(atlas, t).filter_map(|n| colours[n])) else { continue };
            if let Some(own) = &mut colours[t] {
                (0..3).for_each(|k| own[k] = (own[k] + OVERSHOOT * (mean[k] - own[k])).max(0.0));
            }
        }
    }
}

/// The whole picture: rims of the charts go on beyond them, the rest has their mean colour. One colour per texel of the picture, row by row.
pub(super) fn picture(atlas: &Atlas, colours: &[Option<[f32; 3]>]) -> Vec<[f32; 3]> {
    let (width, height) = (atlas.width, atlas.height);
    let usual = mean(colours.iter().flatten().copied()).unwrap_or([0.5; 3]);
    let mut out: Vec<Option<[f32; 3]>> =
        atlas.index.iter().map(|t| colours.get(*t as usize).copied().flatten()).collect();
    let mut rest: Vec<usize> = (0..out.len()).filter(|at| out[*at].is_none()).collect();
    for _ in 0..RINGS {
        let round = |at: usize| {
            let (x, y) = (at % width, at / width);
            let lines = y.saturating_sub(1)..(y + 2).min(height);
            lines.flat_map(move |v| (x.saturating_sub(1)..(x + 2).min(width)).map(move |u| v * width + u))
        };
        let ring: Vec<(usize, [f32; 3])> =
            rest.iter().filter_map(|&at| Some((at, mean(round(at).filter_map(|n| out[n]))?))).collect();
        ring.iter().for_each(|(at, colour)| out[*at] = Some(*colour));
        rest.retain(|at| out[*at].is_none());
    }
    out.into_iter().map(|c| c.unwrap_or(usual)).collect()
}

fn mean(colours: impl Iterator<Item = [f32; 3]>) -> Option<[f32; 3]> {
    let (mut sum, mut count) = ([0.0; 3], 0.0f32);
    for c in colours {
        (0..3).for_each(|k| sum[k] += c[k]);
        count += 1.0;
    }
    (count > 0.0).then(|| sum.map(|s| s / count))
}

/// Which texels lie beside each other on the mesh.
struct Near {
    /// Texels on both sides of the edges where charts meet, in both directions, sorted.
    links: Vec<(u32, u32)>,
    /// Where the links of each texel begin, and the end of the last.
    starts: Vec<u32>,
}

impl Near {
    fn new(atlas: &Atlas, faces: &[[u32; 3]]) -> Self {
        let chart = |f: usize| {
            let [x, y] = atlas.corners[f][0].map(|c| c as usize);
            atlas.cells[atlas.cell((y * atlas.width + x) as u32)]
        };
        let mut links = Vec::new();
        for (f, across) in neighbours(faces).iter().enumerate() {
            for k in 0..3 {
                let g = across[k] as usize;
                if across[k] == NONE || g < f || chart(f) == chart(g) {
                    continue;
                }
                let [a, b] = [faces[f][k], faces[f][(k + 1) % 3]];
                let (Some(own), Some(other)) = (Edge::of(atlas, faces, f, [a, b]), Edge::of(atlas, faces, g, [a, b]))
                else {
                    continue;
                };
                let steps = own.length().max(other.length()).ceil().max(1.0);
                for step in 0..=steps as usize {
                    let share = step as f64 / steps;
                    if let (Some(t), Some(u)) = (own.texel(atlas, share), other.texel(atlas, share)) {
                        links.extend([(t, u), (u, t)]);
                    }
                }
            }
        }
        links.sort_unstable();
        links.dedup();
        let mut starts = vec![0u32; atlas.texels.len() + 1];
        links.iter().for_each(|(t, _)| starts[*t as usize + 1] += 1);
        (1..starts.len()).for_each(|t| starts[t] += starts[t - 1]);
        Self { links, starts }
    }

    /// The texels beside one.
    fn of<'a>(&'a self, atlas: &'a Atlas, t: usize) -> impl Iterator<Item = usize> + 'a {
        let at = atlas.texels[t].at as usize;
        // Charts keep away from the rim of the picture.
        let beside = [at.wrapping_sub(1), at + 1, at.wrapping_sub(atlas.width), at + atlas.width];
        let beside = beside.into_iter().filter_map(|n| atlas.index.get(n).copied().filter(|t| *t != NONE));
        let links = &self.links[self.starts[t] as usize..self.starts[t + 1] as usize];
        beside.chain(links.iter().map(|(_, u)| *u)).map(|t| t as usize)
    }
}

/// An edge of a face in the picture.
struct Edge {
    ends: [[f64; 2]; 2],
    /// The face's middle.
    middle: [f64; 2],
}

impl Edge {
    /// `ends` are vertices of the face.
    fn of(atlas: &Atlas, faces: &[[u32; 3]], face: usize, ends: [u32; 2]) -> Option<Self> {
        let corners = &atlas.corners[face];
        let corner = |v: u32| faces[face].iter().position(|c| *c == v).map(|k| corners[k]);
        let middle = [0, 1].map(|k| corners.iter().map(|c| c[k]).sum::<f64>() / 3.0);
        Some(Self { ends: [corner(ends[0])?, corner(ends[1])?], middle })
    }

    fn length(&self) -> f64 {
        let [a, b] = self.ends;
        (b[0] - a[0]).hypot(b[1] - a[1])
    }

    /// The first texel on the way from a point of the edge to the middle of the face.
    fn texel(&self, atlas: &Atlas, share: f64) -> Option<u32> {
        let [a, b] = self.ends;
        let from = [0, 1].map(|k| a[k] + share * (b[k] - a[k]));
        let way = [0, 1].map(|k| self.middle[k] - from[k]);
        let length = way[0].hypot(way[1]);
        [0.0, 0.5, 1.0, length].iter().find_map(|along| {
            let t = (along / length.max(f64::MIN_POSITIVE)).min(1.0);
            let [x, y] = [0, 1].map(|k| (from[k] + t * way[k]).max(0.0) as usize);
            atlas.index.get(y * atlas.width + x).copied().filter(|t| *t != NONE)
        })
    }
}
