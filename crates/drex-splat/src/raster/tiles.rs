//! Which splats touch which tile, nearest first.

/// Side of a tile, pixels.
pub(crate) const TILE: usize = 16;

/// Where a splat may touch the image: pixels `x0 <= x < x1`, `y0 <= y < y1`; empty if it is not drawn.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct ScreenBox {
    pub x0: u16,
    pub y0: u16,
    pub x1: u16,
    pub y1: u16,
    /// z of the centre: the order of drawing.
    pub depth: f32,
}

/// The list of splats of every tile.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tiles {
    /// Tiles along x and y.
    pub columns: usize,
    pub rows: usize,
    /// `ids[starts[t]..starts[t + 1]]` are the splats of tile t (row by row), nearest first; ties by index.
    pub starts: Vec<u32>,
    pub ids: Vec<u32>,
}

impl Tiles {
    /// Lists for an image of `width` x `height` pixels; `touches(splat, column, row)` may refuse a tile inside the box.
    pub fn new(
        boxes: &[ScreenBox],
        width: usize,
        height: usize,
        touches: impl Fn(usize, usize, usize) -> bool,
    ) -> Self {
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        let mut order: Vec<u32> = (0..boxes.len() as u32)
            .filter(|&i| boxes[i as usize].x0 < boxes[i as usize].x1 && boxes[i as usize].y0 < boxes[i as usize].y1)
            .collect();
        order.sort_by(|&a, &b| boxes[a as usize].depth.total_cmp(&boxes[b as usize].depth).then(a.cmp(&b)));
        let tiles_of = |i: u32| {
            let b = boxes[i as usize];
            let (c0, c1) = (b.x0 as usize / TILE, (b.x1 as usize).div_ceil(TILE).min(columns));
            let (r0, r1) = (b.y0 as usize / TILE, (b.y1 as usize).div_ceil(TILE).min(rows));
            (r0..r1).flat_map(move |r| (c0..c1).map(move |c| (c, r)))
        };
        let mut pairs = Vec::new();
        let mut starts = vec![0u32; columns * rows + 1];
        for &i in &order {
            for (c, r) in tiles_of(i).filter(|&(c, r)| touches(i as usize, c, r)) {
                let tile = r * columns + c;
                starts[tile + 1] += 1;
                pairs.push((tile as u32, i));
            }
        }
        for t in 0..columns * rows {
            starts[t + 1] += starts[t];
        }
        let mut next = starts.clone();
        let mut ids = vec![0; pairs.len()];
        for (tile, i) in pairs {
            ids[next[tile as usize] as usize] = i;
            next[tile as usize] += 1;
        }
        Self { columns, rows, starts, ids }
    }

    /// The splats of tile `t`, nearest first.
    pub fn list(&self, t: usize) -> &[u32] {
        &self.ids[self.starts[t] as usize..self.starts[t + 1] as usize]
    }
}
