//! Pictures side by side, each with its number.

use crate::{Error, Result};
use image::{Rgb, RgbImage};

use super::raster::{Part, View, background, clearest_azimuth, encode_png, render};

/// Pixels of a tile.
const TILE: (u32, u32) = (300, 260);
/// Tiles in a row.
const COLUMNS: u32 = 5;
/// No more tiles than this.
const MOST: usize = 200;
/// Pixels per dot of a digit.
const DOT: u32 = 3;
const INK: Rgb<u8> = Rgb([60, 66, 80]);
/// Digits of three by five dots, row by row from the top, the left dot first.
const DIGITS: [u16; 10] = [
    0b111_101_101_101_111,
    0b010_110_010_010_111,
    0b111_001_111_100_111,
    0b111_001_111_001_111,
    0b101_101_111_001_001,
    0b111_100_111_001_111,
    0b111_100_111_101_111,
    0b111_001_010_010_010,
    0b111_101_111_101_111,
    0b111_101_111_001_111,
];

/// A PNG of all scenes, seen from the direction in which part `subject` (if there is one) is seen best in the middle one.
pub fn contact_sheet(scenes: &[(usize, Vec<Part<'_>>)], subject: Option<usize>) -> Result<Vec<u8>> {
    if scenes.is_empty() {
        return Err(Error::Refused("there is no frame to draw".into()));
    }
    // Of more frames than fit, every second, third... one is shown.
    let step = scenes.len().div_ceil(MOST);
    let scenes: Vec<_> = scenes.iter().step_by(step).collect();
    let mut view = View { width: TILE.0, height: TILE.1, azimuth: 0.6, elevation: 0.45, table_height_m: None };
    if let Some(subject) = subject {
        view.azimuth = clearest_azimuth(&scenes[scenes.len() / 2].1, subject, &view);
    }
    let columns = COLUMNS.min(scenes.len() as u32);
    let rows = (scenes.len() as u32).div_ceil(columns);
    let mut sheet = RgbImage::from_pixel(columns * TILE.0, rows * TILE.1, background());
    for (i, (number, parts)) in scenes.iter().enumerate() {
        let (x, y) = (i as u32 % columns * TILE.0, i as u32 / columns * TILE.1);
        image::imageops::replace(&mut sheet, &render(parts, &view), i64::from(x), i64::from(y));
        write_number(&mut sheet, *number, (x + 8, y + 8));
    }
    encode_png(&sheet)
}

fn write_number(sheet: &mut RgbImage, number: usize, (x, y): (u32, u32)) {
    for (i, digit) in number.to_string().bytes().enumerate() {
        let dots = DIGITS[usize::from(digit - b'0')];
        for k in (0..15u32).filter(|k| dots >> (14 - k) & 1 == 1) {
            let (left, top) = (x + (4 * i as u32 + k % 3) * DOT, y + k / 3 * DOT);
            for dy in 0..DOT {
                for dx in 0..DOT {
                    sheet.put_pixel(left + dx, top + dy, INK);
                }
            }
        }
    }
}
