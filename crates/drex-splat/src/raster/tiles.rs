//! Which splats touch which tile, nearest first; and images and records cut into tiles, so that threads can fill them.

use crate::{Error, Result};

/// Side of a tile, pixels.
pub(crate) const TILE: usize = 16;

/// Where a splat may touch the image: pixels `x0 <= x < x1`, `y0 <= y < y1`; empty if it is not drawn.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct ScreenBox {
    pub x0: u16,
    pub y0: u16,
    pub x1: u16,
    pub y1: u16,
    /// z of the centre, positive: the order of drawing.
    pub depth: f32,
}

impl ScreenBox {
    fn is_empty(&self) -> bool {
        self.x0 >= self.x1 || self.y0 >= self.y1
    }

    /// How many tiles the box touches.
    fn tiles(&self) -> usize {
        let side = |from: u16, to: u16| (to as usize).div_ceil(TILE).saturating_sub(from as usize / TILE);
        if self.is_empty() { 0 } else { side(self.x0, self.x1) * side(self.y0, self.y1) }
    }
}

/// The list of splats of every tile. A place in `ids` is called a slot: one splat in one tile.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tiles {
    /// Tiles along x and y.
    pub columns: usize,
    pub rows: usize,
    /// `ids[starts[t]..starts[t + 1]]` are the splats of tile t (row by row), nearest first; ties by index.
    starts: Vec<u32>,
    ids: Vec<u32>,
    /// Slots of every splat: `slots[ranges[i].0..ranges[i].1]`, ascending.
    ranges: Vec<(u32, u32)>,
    slots: Vec<u32>,
}

impl Tiles {
    /// Most slots that are listed: a gigabyte of lists, 6 gigabytes of records in a backward pass.
    const MAX_SLOTS: usize = 1 << 27;

    /// # Errors
    /// If the lists of these boxes would fill the memory: thousands of splats each over the whole of a large image.
    pub fn check(boxes: &[ScreenBox]) -> Result<()> {
        let slots: usize = boxes.iter().map(ScreenBox::tiles).sum();
        if slots <= Self::MAX_SLOTS {
            return Ok(());
        }
        let (widest, at) = boxes.iter().zip(0..).map(|(b, i)| (b.tiles(), i)).max().unwrap_or_default();
        Err(Error::Gaussians {
            what: format!(
                "{} Gaussians touch {slots} tiles of {TILE} x {TILE} pixels together (Gaussian {at} alone {widest}), at most {} are drawn",
                boxes.len(),
                Self::MAX_SLOTS
            ),
            remedy:
                "remove those that cover the whole image (a training that diverged makes them), or draw a smaller image"
                    .into(),
        })
    }

    /// Lists for an image of `width` x `height` pixels; `touches(splat, column, row)` may refuse a tile inside the box.
    pub fn new(
        boxes: &[ScreenBox],
        width: usize,
        height: usize,
        touches: impl Fn(usize, usize, usize) -> bool,
    ) -> Self {
        let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
        // First the tile of every slot, splat by splat from near to far; `slots` holds tiles for now.
        let mut ranges = vec![(0, 0); boxes.len()];
        let mut slots = Vec::with_capacity(4 * boxes.len());
        let mut starts = vec![0u32; columns * rows + 1];
        let order = nearest_first(boxes);
        for &i in &order {
            let b = boxes[i as usize];
            let begin = slots.len() as u32;
            for row in b.y0 as usize / TILE..(b.y1 as usize).div_ceil(TILE).min(rows) {
                for column in b.x0 as usize / TILE..(b.x1 as usize).div_ceil(TILE).min(columns) {
                    if touches(i as usize, column, row) {
                        let tile = row * columns + column;
                        starts[tile + 1] += 1;
                        slots.push(tile as u32);
                    }
                }
            }
            ranges[i as usize] = (begin, slots.len() as u32);
        }
        for t in 0..columns * rows {
            starts[t + 1] += starts[t];
        }
        let mut next = starts.clone();
        let mut ids = vec![0; slots.len()];
        for &i in &order {
            let (begin, end) = ranges[i as usize];
            for slot in &mut slots[begin as usize..end as usize] {
                let place = &mut next[*slot as usize];
                (ids[*place as usize], *slot) = (i, *place);
                *place += 1;
            }
        }
        Self { columns, rows, starts, ids, ranges, slots }
    }

    /// How many tiles there are.
    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// How many slots there are: the sum of the lengths of all lists.
    pub fn slot_count(&self) -> usize {
        self.ids.len()
    }

    /// The splats of tile `t`, nearest first.
    pub fn list(&self, t: usize) -> &[u32] {
        &self.ids[self.starts[t] as usize..self.starts[t + 1] as usize]
    }

    /// The slots of splat `i`, in the order in which its records are to be summed.
    pub fn slots_of(&self, i: usize) -> &[u32] {
        let (begin, end) = self.ranges[i];
        &self.slots[begin as usize..end as usize]
    }

    /// Pixels from the image's left and upper edge to those of tile `t`.
    pub fn corner(&self, t: usize) -> (usize, usize) {
        (t % self.columns * TILE, t / self.columns * TILE)
    }

    /// One record a slot, cut tile by tile.
    pub fn cut_records<'a, R>(&self, mut records: &'a mut [R]) -> Vec<&'a mut [R]> {
        let mut cut = Vec::with_capacity(self.len());
        for t in 0..self.len() {
            let (list, rest) = records.split_at_mut(self.list(t).len());
            cut.push(list);
            records = rest;
        }
        cut
    }

    /// The rows of an image, cut tile by tile: entry t holds at most 16 rows of at most 16 pixels. An empty image gives
    /// tiles without rows.
    pub fn cut_image<'a, T>(&self, image: &'a mut [T], width: usize) -> Vec<Vec<&'a mut [T]>> {
        let mut cut: Vec<Vec<&mut [T]>> = (0..self.len()).map(|_| Vec::with_capacity(TILE)).collect();
        for (y, row) in image.chunks_mut(width.max(1)).enumerate() {
            for (column, piece) in row.chunks_mut(TILE).enumerate() {
                cut[y / TILE * self.columns + column].push(piece);
            }
        }
        cut
    }
}

/// Indices of the boxes that are not empty, by depth, then by index: a radix sort of the bits of the depth, which order
/// positive numbers as their values do.
fn nearest_first(boxes: &[ScreenBox]) -> Vec<u32> {
    const BITS: usize = 11;
    let mut keys: Vec<(u32, u32)> =
        (0u32..).zip(boxes).filter(|(_, b)| !b.is_empty()).map(|(i, b)| (b.depth.max(0.0).to_bits(), i)).collect();
    let mut sorted = vec![(0, 0); keys.len()];
    for shift in [0, BITS, 2 * BITS] {
        let digit = |key: u32| (key >> shift) as usize & ((1 << BITS) - 1);
        let mut next = [0u32; (1 << BITS) + 1];
        for &(key, _) in &keys {
            next[digit(key) + 1] += 1;
        }
        for d in 0..1 << BITS {
            next[d + 1] += next[d];
        }
        for &(key, i) in &keys {
            let place = &mut next[digit(key)];
            sorted[*place as usize] = (key, i);
            *place += 1;
        }
        std::mem::swap(&mut keys, &mut sorted);
    }
    keys.into_iter().map(|(_, i)| i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some_boxes(n: usize) -> Vec<ScreenBox> {
        let mut state = 1u32;
        let mut next = |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % below
        };
        (0..n)
            .map(|_| {
                let (x0, y0) = (next(70) as u16, next(50) as u16);
                let (x1, y1) = (x0 + next(9) as u16, y0 + next(30) as u16);
                ScreenBox { x0, y0, x1: x1.min(70), y1: y1.min(50), depth: 0.1 + next(40) as f32 * 1.7 }
            })
            .collect()
    }

    #[test]
    fn lists_hold_every_touching_splat_nearest_first() {
        let boxes = some_boxes(500);
        let tiles = Tiles::new(&boxes, 70, 50, |i, column, _| i % 7 != 0 || column != 1);
        let mut slots = 0;
        for t in 0..tiles.len() {
            let (x, y) = tiles.corner(t);
            let mut expected: Vec<u32> = (0..500)
                .filter(|&i| {
                    let b = boxes[i as usize];
                    let meets = |a0: u16, a1: u16, c: usize| (a0 as usize) < c + TILE && (a1 as usize) > c;
                    !b.is_empty() && meets(b.x0, b.x1, x) && meets(b.y0, b.y1, y) && (i % 7 != 0 || x != TILE)
                })
                .collect();
            expected.sort_by(|&a, &b| boxes[a as usize].depth.total_cmp(&boxes[b as usize].depth).then(a.cmp(&b)));
            assert_eq!(tiles.list(t), expected);
            slots += expected.len();
        }
        assert_eq!(slots, tiles.slot_count());
    }

    #[test]
    fn lists_that_would_fill_the_memory_are_refused() {
        let whole = ScreenBox { x0: 0, y0: 0, x1: 8192, y1: 8192, depth: 1.0 };
        assert!(Tiles::check(&vec![whole; 500]).is_ok());
        let error = Tiles::check(&vec![whole; 600]).unwrap_err().to_string();
        assert!(error.contains("600 Gaussians") && error.contains("262144"), "{error}");
    }

    #[test]
    fn slots_lead_back_to_their_splat() {
        let tiles = Tiles::new(&some_boxes(300), 70, 50, |_, _, _| true);
        let mut seen = vec![false; tiles.slot_count()];
        for i in 0..300 {
            assert!(tiles.slots_of(i).is_sorted());
            for &slot in tiles.slots_of(i) {
                assert_eq!(tiles.ids[slot as usize], i as u32);
                assert!(!std::mem::replace(&mut seen[slot as usize], true));
            }
        }
        assert!(seen.iter().all(|s| *s));
    }

    #[test]
    fn images_and_records_are_cut_at_the_edges_of_tiles() {
        let tiles = Tiles::new(&some_boxes(300), 70, 50, |_, _, _| true);
        let mut image: Vec<usize> = (0..70 * 50).collect();
        for (t, rows) in tiles.cut_image(&mut image, 70).into_iter().enumerate() {
            let (x, y) = tiles.corner(t);
            assert_eq!(rows.len(), TILE.min(50 - y));
            for (k, row) in rows.iter().enumerate() {
                assert_eq!((row[0], row.len()), ((y + k) * 70 + x, TILE.min(70 - x)));
            }
        }
        assert!(tiles.cut_image(&mut [0u8; 0], 70).iter().all(Vec::is_empty));
        let mut records = tiles.ids.clone();
        for (t, cut) in tiles.cut_records(&mut records).into_iter().enumerate() {
            assert_eq!(cut, tiles.list(t));
        }
    }
}
