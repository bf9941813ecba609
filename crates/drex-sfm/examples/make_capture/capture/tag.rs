//! A printed AprilTag of the family tag36h11.

use nalgebra::Vector2;

use super::paint::{Canvas, Picture};

/// Identity and the 36 bits of a tag, row by row from the top left, white = 1, upright as the authors of the family draw it.
const TAGS: [(u32, u64); 6] = [
    (0, 0xd_5d62_8584),
    (5, 0xf_31da_b3ac),
    (17, 0x6_83bb_6c4c),
    (42, 0xd_290a_a77b),
    (113, 0x7_6521_bb7b),
    (318, 0x2_078f_ca82),
];

/// A sheet of paper with a tag, on the table.
#[derive(Debug, Clone, Copy)]
pub struct Marker {
    /// Identity.
    pub id: u32,
    bits: u64,
    /// Outer edge of the black border, metres: 8 of the tag's cells.
    pub side_m: f64,
    /// Centre of its top face, world, metres.
    pub centre_m: [f64; 3],
    /// Turn about the world's z axis; at 0 its top points along the world's y.
    pub yaw_rad: f64,
}

impl Marker {
    /// One of the tags known here; `choice` may be any number.
    #[must_use]
    pub fn new(choice: usize, side_m: f64, centre_m: [f64; 3], yaw_rad: f64) -> Self {
        let (id, bits) = TAGS[choice % TAGS.len()];
        Self { id, bits, side_m, centre_m, yaw_rad }
    }

    /// Side of the square sheet, metres.
    #[must_use]
    pub fn sheet_m(&self) -> f64 {
        self.side_m * 13.0 / 8.0
    }

    /// What is printed on the sheet, seen from above with its top at the top.
    #[must_use]
    pub fn picture(&self) -> Picture {
        let cell = self.side_m / 8.0;
        let sheet = self.sheet_m();
        let mut canvas = Canvas::new([sheet; 2], cell / 24.0, [0.8; 3]);
        let mut square = |centre: Vector2<f64>, half: f64, tone: f32| {
            canvas.fill(centre, 1.5 * half, [tone; 3], |p| p.x.abs().max(p.y.abs()) - half);
        };
        let (middle, corner) = (Vector2::repeat(0.5 * sheet), 0.5 * sheet - 3.0 * cell);
        square(middle, 4.0 * cell, 0.03);
        for i in 0..36 {
            if self.bits >> (35 - i) & 1 == 1 {
                let at = Vector2::new((i % 6) as f64 + 0.5, (i / 6) as f64 + 0.5) * cell;
                square(at.add_scalar(corner), 0.5 * cell, 0.8);
            }
        }
        canvas.finish()
    }
}
