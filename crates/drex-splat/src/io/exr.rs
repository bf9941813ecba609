//! Depth and normal maps as OpenEXR: 32-bit float, scan lines, uncompressed, which every reader of the format knows.
//!
//! Written from "The OpenEXR File Layout" (openexr.com).

use std::path::Path;

use drex_core::fsutil;

use crate::{Error, Result};

/// Writes a map of one value a pixel, row by row from the upper left, as channel Z (the format's name for depth).
///
/// # Errors
/// If the map has another number of pixels or none, or the file cannot be written.
pub fn write_depth(path: &Path, width: usize, height: usize, depth: &[f32]) -> Result<()> {
    Ok(fsutil::write_atomic(path, &to_bytes(width, height, &[("Z", depth)])?)?)
}

/// Writes a map of vectors, row by row from the upper left, with x, y, z as channels R, G, B.
///
/// # Errors
/// If the map has another number of pixels or none, or the file cannot be written.
pub fn write_vectors(path: &Path, width: usize, height: usize, vectors: &[[f32; 3]]) -> Result<()> {
    let plane = |k: usize| vectors.iter().map(|v| v[k]).collect::<Vec<_>>();
    let channels = [("R", plane(0)), ("G", plane(1)), ("B", plane(2))];
    let channels = channels.each_ref().map(|(name, values)| (*name, values.as_slice()));
    Ok(fsutil::write_atomic(path, &to_bytes(width, height, &channels)?)?)
}

/// The bytes of a picture with these channels (name and values), each one value a pixel.
///
/// # Errors
/// If there are no channels or pixels, a channel has another number of values, or a name is empty, longer than 31 bytes
/// or there twice.
pub fn to_bytes(width: usize, height: usize, channels: &[(&str, &[f32])]) -> Result<Vec<u8>> {
    // The layout wants channels in the order of their names.
    let mut channels = channels.to_vec();
    channels.sort_by_key(|&(name, _)| name);
    let named = |name: &str| (1..32).contains(&name.len()) && !name.contains('\0');
    let full = |values: &[f32]| Some(values.len()) == width.checked_mul(height);
    let sound = channels.iter().all(|(name, values)| named(name) && full(values))
        && channels.windows(2).all(|pair| pair[0].0 != pair[1].0);
    let (Ok(w), Ok(h), true) = (i32::try_from(width), i32::try_from(height), sound && !channels.is_empty()) else {
        return Err(refuse(width, height, &channels));
    };
    let line_bytes = width.checked_mul(4 * channels.len()).and_then(|n| i32::try_from(n).ok());
    let (Some(line_bytes), true) = (line_bytes, w > 0 && h > 0) else {
        return Err(refuse(width, height, &channels));
    };

    let mut out = Vec::with_capacity(512 + height * (16 + line_bytes as usize));
    out.extend(20_000_630_i32.to_le_bytes());
    out.extend(2_i32.to_le_bytes()); // version 2, scan lines
    let mut list = Vec::new();
    for (name, _) in &channels {
        list.extend(name.bytes());
        list.push(0);
        list.extend(2_i32.to_le_bytes()); // 32-bit float
        list.extend([0; 4]);
        list.extend([1_i32, 1].map(i32::to_le_bytes).as_flattened()); // one sample a pixel
    }
    list.push(0);
    let window = [0, 0, w - 1, h - 1].map(i32::to_le_bytes);
    let mut attribute = |name: &str, kind: &str, value: &[u8]| {
        out.extend([name.as_bytes(), &[0], kind.as_bytes(), &[0]].concat());
        out.extend((value.len() as i32).to_le_bytes());
        out.extend(value);
    };
    attribute("channels", "chlist", &list);
    attribute("compression", "compression", &[0]);
    attribute("dataWindow", "box2i", window.as_flattened());
    attribute("displayWindow", "box2i", window.as_flattened());
    attribute("lineOrder", "lineOrder", &[0]);
    attribute("pixelAspectRatio", "float", &1_f32.to_le_bytes());
    attribute("screenWindowCenter", "v2f", &[0; 8]);
    attribute("screenWindowWidth", "float", &1_f32.to_le_bytes());
    out.push(0);
    // Where each line starts, then the lines: y, size, then channel after channel.
    let first = out.len() + 8 * height;
    for y in 0..height {
        out.extend(((first + y * (8 + line_bytes as usize)) as u64).to_le_bytes());
    }
    for y in 0..height {
        out.extend((y as i32).to_le_bytes());
        out.extend(line_bytes.to_le_bytes());
        for (_, values) in &channels {
            out.extend(values[y * width..(y + 1) * width].iter().flat_map(|v| v.to_le_bytes()));
        }
    }
    Ok(out)
}

fn refuse(width: usize, height: usize, channels: &[(&str, &[f32])]) -> Error {
    let list: Vec<String> =
        channels.iter().map(|(name, values)| format!("{name} with {} values", values.len())).collect();
    Error::Option {
        what: format!("an EXR picture of {width} x {height} pixels is to have the channels [{}]", list.join(", ")),
        remedy: "give pixels, and channels with different names and one value a pixel".into(),
    }
}
