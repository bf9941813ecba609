//! Charts side by side in one picture.

use drex_core::{Error, Result, TriMesh};
use nalgebra::Point3;

use super::charts::{Charts, NONE, covered};

/// Charts begin at multiples of this many texels: a cell, over which photos are compared, is of one chart.
pub(super) const CELL: usize = 8;
/// Texels between a chart and the rim of its rectangle.
pub(super) const GUTTER: usize = 3;
/// Rectangles are tried in pictures this much wider than a square of their area.
const WIDTHS: [f64; 8] = [1.0, 1.04, 1.08, 1.12, 1.17, 1.22, 1.3, 1.4];

/// Where every face lies in the picture.
pub(super) struct Atlas {
    /// Columns of the picture.
    pub width: usize,
    /// Rows of the picture.
    pub height: usize,
    /// Side of a texel, unit of the mesh.
    pub texel: f64,
    /// Number of charts.
    pub charts: usize,
    /// Corners of each face, texels from the upper left corner.
    pub corners: Vec<[[f64; 2]; 3]>,
    /// Texels that show the mesh.
    pub texels: Vec<Texel>,
    /// For each texel of the picture its position in `texels`, [`NONE`] where it shows nothing.
    pub index: Vec<u32>,
    /// Chart of each cell, [`NONE`] where there is none; row by row.
    pub cells: Vec<u32>,
}

/// One texel that shows the mesh.
#[derive(Clone, Copy)]
pub(super) struct Texel {
    /// Its place in the picture, row by row.
    pub at: u32,
    /// The face it shows.
    pub face: u32,
    /// Weights of the face's corners.
    pub weights: [f32; 3],
}

impl Atlas {
    /// Cuts and packs a mesh with texels of `texel`, or as much larger as the picture has to be to have no side over `max_side`.
    ///
    /// # Errors
    /// If the mesh falls into so many charts that they do not fit, however small.
    pub fn new(mesh: &TriMesh, texel: f64, max_side: usize) -> Result<Self> {
        let extent = mesh.bounds().map_or(0.0, |(lo, hi)| (hi - lo).norm());
        // Long thin meshes have less area than their rectangles.
        let mut texel = texel.max(0.25 * extent / max_side as f64);
        loop {
            let charts = Charts::new(mesh, texel);
            let (places, [width, height]) = pack(&charts.sizes);
            let longest = width.max(height);
            if longest <= max_side {
                return Ok(Self::placed(mesh, &charts, &places, [width, height], texel));
            }
            if texel > extent {
                return Err(Error::value(
                    format!("the mesh falls into {} charts, too many for {max_side} x {max_side} texels", places.len()),
                    "give a mesh whose faces are connected, or allow a larger picture",
                ));
            }
            texel *= (longest as f64 / max_side as f64).max(1.02);
        }
    }

    fn placed(mesh: &TriMesh, charts: &Charts, places: &[[usize; 2]], size: [usize; 2], texel: f64) -> Self {
        let [width, height] = size;
        let mut atlas = Self {
            width,
            height,
            texel,
            charts: places.len(),
            corners: Vec::with_capacity(mesh.faces.len()),
            texels: Vec::new(),
            index: vec![NONE; width * height],
            cells: vec![NONE; width * height / (CELL * CELL)],
        };
        let mut shown = vec![false; places.len()];
        for (flat, chart) in charts.flat.iter().zip(&charts.of_face) {
            let [left, top] = places[*chart as usize].map(|p| (p + GUTTER) as f64);
            atlas.corners.push(flat.map(|[x, y]| [x + left, y + top]));
        }
        for f in 0..mesh.faces.len() {
            let chart = charts.of_face[f] as usize;
            for (x, y, weights) in covered(&atlas.corners[f], size) {
                shown[chart] |= atlas.show(f, [x, y], weights);
            }
        }
        // What is narrower than a texel is shown by one all the same.
        for f in 0..mesh.faces.len() {
            let chart = charts.of_face[f] as usize;
            if !shown[chart] {
                let middle = [0, 1].map(|k| atlas.corners[f].iter().map(|c| c[k]).sum::<f64>() / 3.0);
                shown[chart] = atlas.show(f, middle.map(|c| c as usize), [1.0 / 3.0; 3]);
            }
        }
        for (chart, ([left, top], size)) in places.iter().zip(&charts.sizes).enumerate() {
            let [columns, rows] = size.map(cells);
            for row in 0..rows {
                let first = (top / CELL + row) * (width / CELL) + left / CELL;
                atlas.cells[first..first + columns].fill(chart as u32);
            }
        }
        atlas
    }

    /// Takes a texel for a face, unless another has it.
    fn show(&mut self, face: usize, [x, y]: [usize; 2], weights: [f64; 3]) -> bool {
        let at = y * self.width + x;
        let free = self.index.get(at) == Some(&NONE);
        if free {
            self.index[at] = self.texels.len() as u32;
            self.texels.push(Texel { at: at as u32, face: face as u32, weights: weights.map(|w| w as f32) });
        }
        free
    }

    /// The cell that a texel of the picture lies in.
    pub fn cell(&self, at: u32) -> usize {
        let (x, y) = (at as usize % self.width, at as usize / self.width);
        y / CELL * (self.width / CELL) + x / CELL
    }
}

impl Texel {
    /// The point in the middle of the texel.
    pub fn point(&self, mesh: &TriMesh) -> Point3<f64> {
        let corners = mesh.triangle(self.face as usize);
        Point3::from((0..3).map(|k| f64::from(self.weights[k]) * corners[k].coords).sum::<nalgebra::Vector3<f64>>())
    }
}

/// Cells that a chart takes along one side, its gutters included.
fn cells(texels: f64) -> usize {
    (texels.ceil() as usize + 2 * GUTTER).div_ceil(CELL)
}

/// Upper left corners of rectangles, and the size of the picture that they take, texels: on shelves, the highest first.
fn pack(sizes: &[[f64; 2]]) -> (Vec<[usize; 2]>, [usize; 2]) {
    let sizes: Vec<[usize; 2]> = sizes.iter().map(|size| size.map(cells)).collect();
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(sizes[i][1]), std::cmp::Reverse(sizes[i][0]), i));
    let area: usize = sizes.iter().map(|[w, h]| w * h).sum();
    let widest = sizes.iter().map(|size| size[0]).max().unwrap_or(1);
    let shelves = |width: usize| {
        let mut places = vec![[0; 2]; sizes.len()];
        let ([mut x, mut y], mut shelf) = ([0, 0], 0);
        for &i in &order {
            let [w, h] = sizes[i];
            if x + w > width {
                (x, y) = (0, y + shelf);
                shelf = 0;
            }
            places[i] = [x * CELL, y * CELL];
            (x, shelf) = (x + w, shelf.max(h));
        }
        (places, [width * CELL, (y + shelf) * CELL])
    };
    let width = |factor: &f64| ((area as f64).sqrt() * factor).ceil() as usize;
    let longest = |(_, [w, h]): &(Vec<[usize; 2]>, [usize; 2])| (*w.max(h), w * h);
    let tried = WIDTHS.iter().map(|factor| shelves(width(factor).max(widest)));
    tried.min_by_key(longest).unwrap_or_default()
}
