//! Gaussians as PLY, in the layout that the code of Kerbl et al. 2023 introduced and every viewer reads.
//!
//! `x y z nx ny nz f_dc_0..2 f_rest_* opacity scale_0..2 rot_0..3`, all 32-bit floats: normals are zero, `f_rest` holds
//! the higher coefficients of red, then green, then blue, opacity is a logit, scales are logarithms, the quaternion is
//! w, x, y, z. Written little endian. Two additions, each only where it says something:
//! - surfels have the comment `drex kind surfel` and a small third scale, so that other viewers draw them as thin discs;
//! - labels other than background are a last property `uchar label`, which viewers skip.
//!
//! Read are all three formats of PLY, properties in any order and of any type, files with two scales (surfels of the code
//! of Huang et al. 2024), without normals or higher coefficients, and with properties that mean something to others.

use std::path::Path;

use drex_core::fsutil;
use drex_core::ply::{PlyFile, Scalar};

use super::{checked, content, three_log_scales};
use crate::{Gaussians, Kind, Label, Result};

/// What tells surfels from ellipsoids in a file with three scales.
const SURFEL_COMMENT: &str = "drex kind surfel";

/// Writes a set.
///
/// # Errors
/// If the set is inconsistent or the file cannot be written.
pub fn write(path: &Path, gaussians: &Gaussians) -> Result<()> {
    Ok(fsutil::write_atomic(path, &to_bytes(gaussians)?)?)
}

/// The bytes of the file.
///
/// # Errors
/// If the set is inconsistent.
pub fn to_bytes(gaussians: &Gaussians) -> Result<Vec<u8>> {
    gaussians.check()?;
    let labelled = gaussians.labels.iter().any(|&l| l != Label::BACKGROUND);
    let stride = gaussians.sh_stride();
    let mut out = header_text(gaussians, labelled).into_bytes();
    out.reserve(gaussians.len() * (4 * (14 + stride) + usize::from(labelled)));
    let mut row = Vec::with_capacity(14 + stride);
    for i in 0..gaussians.len() {
        let (dc, rest) = gaussians.sh[i * stride..(i + 1) * stride].split_at(3);
        row.clear();
        row.extend(gaussians.means[i]);
        row.extend([0.0; 3]);
        row.extend(dc);
        row.extend((0..3).flat_map(|channel| rest.iter().skip(channel).step_by(3)));
        row.push(gaussians.logit_opacities[i]);
        row.extend(three_log_scales(gaussians, i));
        row.extend(gaussians.rotations[i]);
        out.extend(row.iter().flat_map(|v: &f32| v.to_le_bytes()));
        if labelled {
            out.push(gaussians.labels[i].0);
        }
    }
    Ok(out)
}

fn header_text(gaussians: &Gaussians, labelled: bool) -> String {
    let mut text = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", gaussians.len());
    for name in
        ["x", "y", "z", "nx", "ny", "nz"].map(String::from).into_iter().chain(names(gaussians.sh_stride() - 3, 3))
    {
        text += &format!("property float {name}\n");
    }
    if labelled {
        text += "property uchar label\n";
    }
    if gaussians.kind == Kind::Surfel {
        text += &format!("comment {SURFEL_COMMENT}");
        text.push('\n');
    }
    text + "end_header\n"
}

/// The properties after position and normal, in the order of the layout.
fn names(rest: usize, scales: usize) -> impl Iterator<Item = String> {
    let numbered = |stem: &'static str, n: usize| (0..n).map(move |i| format!("{stem}_{i}"));
    numbered("f_dc", 3)
        .chain(numbered("f_rest", rest))
        .chain(["opacity".into()])
        .chain(numbered("scale", scales))
        .chain(numbered("rot", 4))
}

/// Reads a set. It consists of surfels if the file says so or has two scales, else of what `otherwise` says. A file
/// without labels is all background.
///
/// # Errors
/// If the file cannot be read, is no PLY of Gaussians, ends too early, or has a number that is not finite.
pub fn read(path: &Path, otherwise: Kind) -> Result<Gaussians> {
    parse(path, &fsutil::read_bytes(path)?, otherwise)
}

/// As [`read`], from memory.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, bytes: &[u8], otherwise: Kind) -> Result<Gaussians> {
    let file = PlyFile::parse(path, bytes, "Gaussians")?;
    let vertices = file.vertices("give a file of Gaussians or of points")?;
    let has = |name: &str| vertices.properties.iter().any(|p| p.name == name);
    let rest = vertices.properties.iter().filter(|p| p.name.starts_with("f_rest_")).count();
    let sh_degree = match rest {
        0 => 0,
        9 => 1,
        24 => 2,
        45 => 3,
        n => {
            let what = format!("{n} properties f_rest, which is no degree of spherical harmonics from 0 to 3");
            return Err(content(path, vertices.line, what, "write it again with 0, 9, 24 or 45 of them"));
        }
    };
    let scales = if has("scale_2") { 3 } else { 2 };
    let labelled = vertices.properties.iter().any(|p| p.name == "label" && p.scalar == Scalar::U8);
    let kind = if file.comments.iter().any(|c| c == SURFEL_COMMENT) || scales == 2 { Kind::Surfel } else { otherwise };
    let columns = ["x", "y", "z"]
        .map(String::from)
        .into_iter()
        .chain(names(rest, scales))
        .chain(labelled.then(|| "label".into()))
        .map(|name| {
            vertices.properties.iter().position(|p| p.name == name).ok_or_else(|| {
                let what = format!("the vertices have no property {name}");
                content(path, vertices.line, what, "give a file of Gaussians; this may be a mesh or a point cloud")
            })
        })
        .collect::<Result<Vec<_>>>()?;

    let mut gaussians = Gaussians::new(kind, sh_degree);
    let mut values = Vec::with_capacity(columns.len());
    file.rows(vertices, |row| -> Result<()> {
        values.clear();
        values.extend(columns.iter().map(|&c| row.values[c] as f32));
        let (geometry, row) = values.split_at(3);
        let (colour, row) = row.split_at(3 + rest);
        let (shape, row) = row.split_at(1 + scales);
        gaussians.means.push([geometry[0], geometry[1], geometry[2]]);
        gaussians.sh.extend(&colour[..3]);
        let channel = rest / 3;
        gaussians.sh.extend((0..channel).flat_map(|k| (0..3).map(move |c| colour[3 + c * channel + k])));
        gaussians.logit_opacities.push(shape[0]);
        // The third of two scales is never used; a surfel's thickness reads as zero.
        gaussians.log_scales.push([shape[1], shape[2], shape.get(3).copied().unwrap_or(f32::NEG_INFINITY)]);
        gaussians.rotations.push([row[0], row[1], row[2], row[3]]);
        gaussians.labels.push(Label(row.get(4).map_or(0, |&l| l as u8)));
        Ok(())
    })?;
    checked(path, gaussians)
}
