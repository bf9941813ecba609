//! Gaussians as SPZ, the compressed format of Niantic (MIT, github.com/nianticlabs/spz): 7 to 10 times smaller than PLY.
//!
//! A gzip stream of a header of 16 bytes (magic "NGSP", version, count: u32; degree, fractional bits, flags, 0: u8), then,
//! property by property for all Gaussians: positions (3 x 24-bit fixed point), opacities (u8), colours (3 x u8), scales
//! (3 x u8), rotations (version 2: x, y, z as 3 x u8; version 3: the three smallest of w, x, y, z in 32 bits), higher
//! spherical harmonics (u8, coefficient by coefficient, red, green, blue inside). Little endian.
//! Its axes are right, up, back; ours are those of COLMAP and PLY (right, down, forward), so y and z change their signs.
//!
//! What is lost: positions are rounded to the finest step 2^-n that reaches the farthest Gaussian (n at most 20; a scene of
//! 8 units keeps 1e-6 units), scales to 1/16 of a natural logarithm within e^-10 to e^5.9, opacities and colours to 1/255
//! (colours from -2.8 to 3.8 standard steps round grey), coefficients to 1/16 (degree 1) and 1/8 within -1 to 1. Labels and
//! kind are not kept.

use std::io::{Read, Write};
use std::path::Path;

use drex_core::{budget, fsutil};

use super::{byte, checked, content, logit, three_log_scales, unit_quaternion};
use crate::{Error, Gaussians, Kind, Label, Result};

const MAGIC: &[u8; 4] = b"NGSP";
/// Bytes of the header.
const HEADER: usize = 16;
/// Most Gaussians that readers accept.
const MOST: usize = 10_000_000;
/// Finest step of positions that is written, as a power of two.
const MOST_FRACTIONAL_BITS: u8 = 20;
/// Set in the flags of a file with vendors' extensions.
const HAS_EXTENSIONS: u8 = 2;
/// Colours are stored as 0.5 + 0.15 f_dc, wider than what is visible.
const COLOUR_SCALE: f32 = 0.15;
/// Signs of the functions of bands 1 to 3 after half a turn about x.
const FLIP_SH: [f32; 15] = [-1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0];

/// Version of the format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Version {
    /// Read by everyone; rotations to 3 degrees, to 20 near half a turn.
    V2,
    /// Rotations to 0.3 degrees.
    #[default]
    V3,
}

/// Writes a set.
///
/// # Errors
/// If the set is inconsistent, too large or too far from the origin for the format, a quaternion is zero, or the file
/// cannot be written.
pub fn write(path: &Path, gaussians: &Gaussians, version: Version) -> Result<()> {
    Ok(fsutil::write_atomic(path, &to_bytes(gaussians, version)?)?)
}

/// The bytes of the file.
///
/// # Errors
/// If the set is inconsistent, too large or too far from the origin for the format, or a quaternion is zero.
pub fn to_bytes(gaussians: &Gaussians, version: Version) -> Result<Vec<u8>> {
    let packed = pack(gaussians, version)?;
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    // Writing into memory fails only if memory ends.
    let done = gzip.write_all(&packed).and_then(|()| gzip.finish());
    done.map_err(|e| Error::Gaussians { what: format!("cannot compress the set: {e}"), remedy: "write a .ply".into() })
}

fn pack(gaussians: &Gaussians, version: Version) -> Result<Vec<u8>> {
    gaussians.check()?;
    let n = gaussians.len();
    if n > MOST {
        return Err(Error::Gaussians {
            what: format!("{n} Gaussians, but a .spz file holds {MOST} at most"),
            remedy: "write a .ply, or remove some".into(),
        });
    }
    let bits = fractional_bits(gaussians)?;
    let stride = gaussians.sh_stride();
    let mut out = Vec::with_capacity(HEADER + n * (20 + stride));
    out.extend(MAGIC);
    out.extend((if version == Version::V2 { 2u32 } else { 3 }).to_le_bytes());
    out.extend((n as u32).to_le_bytes());
    out.extend([gaussians.sh_degree as u8, bits, 0, 0]);
    for &[x, y, z] in &gaussians.means {
        for v in [x, -y, -z] {
            let fixed = (f64::from(v) * f64::from(1u32 << bits)).round() as i32;
            out.extend(&fixed.to_le_bytes()[..3]);
        }
    }
    out.extend((0..n).map(|i| byte(255.0 * gaussians.opacity(i))));
    out.extend(
        gaussians.sh.chunks_exact(stride).flat_map(|sh| &sh[..3]).map(|c| byte(255.0 * (0.5 + COLOUR_SCALE * c))),
    );
    out.extend((0..n).flat_map(|i| three_log_scales(gaussians, i)).map(|s| byte(16.0 * (s + 10.0))));
    for i in 0..n {
        let [w, x, y, z] = unit_quaternion(gaussians, i)?;
        match version {
            Version::V2 => out.extend(first_three([w, x, -y, -z])),
            Version::V3 => out.extend(smallest_three([w, x, -y, -z]).to_le_bytes()),
        }
    }
    for sh in gaussians.sh.chunks_exact(stride) {
        for (k, c) in sh[3..].iter().enumerate() {
            // The step of the first band is 8/128, of the others 16/128, as the format's own writer has it.
            let step = if k < 9 { 8.0 } else { 16.0 };
            out.push(((128.0 * FLIP_SH[k / 3] * c / step).round() * step + 128.0).clamp(0.0, 255.0) as u8);
        }
    }
    Ok(out)
}

/// Most bits after the point with which the farthest coordinate fits into 24 bits.
fn fractional_bits(gaussians: &Gaussians) -> Result<u8> {
    let far = |i: usize| gaussians.means[i].iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    let farthest = (0..gaussians.len()).max_by(|&a, &b| far(a).total_cmp(&far(b)));
    let most = farthest.map_or(0.0, |i| f64::from(far(i)));
    let fits = |bits: &u8| most * f64::from(1u32 << bits) <= f64::from((1 << 23) - 1);
    (0..=MOST_FRACTIONAL_BITS).rev().find(fits).ok_or_else(|| Error::Gaussians {
        what: format!(
            "Gaussian {} lies {most:.3e} units from the origin, a .spz file reaches 8388607",
            farthest.unwrap_or(0)
        ),
        remedy: "remove it, or write a .ply".into(),
    })
}

/// x, y, z as bytes of the quaternion whose w is not negative.
fn first_three([w, x, y, z]: [f32; 4]) -> [u8; 3] {
    let sign = if w < 0.0 { -127.5 } else { 127.5 };
    [x, y, z].map(|v| byte(sign * v + 127.5))
}

/// Two bits that name the largest of x, y, z, w, then for each of the others, in this order, a sign and nine bits of
/// its size over √½; the quaternion's sign makes the largest positive.
fn smallest_three([w, x, y, z]: [f32; 4]) -> u32 {
    let q = [x, y, z, w];
    let largest = (1..4).fold(0, |best, k| if q[k].abs() > q[best].abs() { k } else { best });
    let sign = q[largest].signum();
    (0..4).filter(|&k| k != largest).fold(largest as u32, |bits, k| {
        let v = sign * q[k];
        let size = (511.0 * v.abs() * std::f32::consts::SQRT_2).round().min(511.0) as u32;
        bits << 10 | u32::from(v < 0.0) << 9 | size
    })
}

/// Reads a set of version 2 or 3, all background; the file does not tell of which `kind`.
///
/// # Errors
/// If the file cannot be read, is no SPZ of these versions, is of a degree above 3, has extensions, or ends too early.
pub fn read(path: &Path, kind: Kind) -> Result<Gaussians> {
    parse(path, &fsutil::read_bytes(path)?, kind)
}

/// As [`read`], from memory.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, bytes: &[u8], kind: Kind) -> Result<Gaussians> {
    let mut gzip = flate2::read::GzDecoder::new(bytes);
    let mut header = [0; HEADER];
    gzip.read_exact(&mut header).map_err(|e| {
        content(path, None, format!("no .spz file of version 2 or 3 ({e})"), "check that this is the right file")
    })?;
    let word = |k: usize| u32::from_le_bytes([header[k], header[k + 1], header[k + 2], header[k + 3]]);
    let (version, n, [sh_degree, bits, flags]) = (word(4), word(8) as usize, [header[12], header[13], header[14]]);
    let refuse =
        |what: String| Err(content(path, None, what, "convert the file to version 3 without extensions, or to .ply"));
    if !header.starts_with(MAGIC) || !(2..=3).contains(&version) {
        return refuse(format!("no .spz file of version 2 or 3 (version {version})"));
    }
    if n > MOST || sh_degree > 3 || bits > 23 {
        return refuse(format!("{n} Gaussians of degree {sh_degree} with {bits} fractional bits"));
    }
    if flags & HAS_EXTENSIONS != 0 {
        return refuse("the file has extensions of a vendor".into());
    }
    let rest = 3 * ((usize::from(sh_degree) + 1).pow(2) - 1);
    let rotation = if version == 2 { 3 } else { 4 };
    let size = n * (9 + 1 + 3 + 3 + rotation + rest);
    budget::allow_unpacked(path, bytes.len() as u64, size as u64)?;
    let unpacked = size_of::<[f32; 3]>() * 2 + size_of::<[f32; 5]>() + size_of::<Label>() + 4 * (3 + rest);
    budget::allow(path, format_args!("{n} Gaussians"), (size + n * unpacked) as u64)?;
    let mut body = Vec::new();
    gzip.take(size as u64).read_to_end(&mut body).map_err(|e| drex_core::Error::io("read", path, e))?;
    if body.len() != size {
        let what = format!("{n} Gaussians of {} bytes are announced, but the file ends before", size / n.max(1));
        return Err(content(path, None, what, "fetch the file again: it was cut off"));
    }
    let (positions, tail) = body.split_at(9 * n);
    let (opacities, tail) = tail.split_at(n);
    let (colours, tail) = tail.split_at(3 * n);
    let (scales, tail) = tail.split_at(3 * n);
    let (rotations, coefficients) = tail.split_at(rotation * n);

    let mut out = Gaussians::new(kind, usize::from(sh_degree));
    let step = f64::from(1u32 << bits).recip();
    // The 24 bits go to the top of 32, so that the shift down brings the sign.
    let fixed = |b: &[u8]| (f64::from(i32::from_le_bytes([0, b[0], b[1], b[2]]) >> 8) * step) as f32;
    out.means.extend(positions.chunks_exact(9).map(|p| [fixed(&p[..3]), -fixed(&p[3..6]), -fixed(&p[6..])]));
    out.logit_opacities.extend(opacities.iter().map(|&o| logit(o)));
    out.log_scales.extend(scales.chunks_exact(3).map(|s| [s[0], s[1], s[2]].map(|v| f32::from(v) / 16.0 - 10.0)));
    out.rotations.extend(rotations.chunks_exact(rotation).map(|r| {
        let [w, x, y, z] = match *r {
            [a, b, c, d] => from_smallest_three(u32::from_le_bytes([a, b, c, d])),
            _ => from_first_three([r[0], r[1], r[2]]),
        };
        [w, x, -y, -z]
    }));
    for i in 0..n {
        out.sh.extend(colours[3 * i..3 * i + 3].iter().map(|&c| (f32::from(c) / 255.0 - 0.5) / COLOUR_SCALE));
        let higher = coefficients[rest * i..rest * (i + 1)].iter().enumerate();
        out.sh.extend(higher.map(|(k, &c)| FLIP_SH[k / 3] * (f32::from(c) - 128.0) / 128.0));
    }
    out.labels.resize(n, Label::BACKGROUND);
    checked(path, out)
}

fn from_first_three(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|b| f32::from(b) / 127.5 - 1.0);
    [(1.0 - x * x - y * y - z * z).max(0.0).sqrt(), x, y, z]
}

fn from_smallest_three(mut bits: u32) -> [f32; 4] {
    let largest = (bits >> 30) as usize;
    let (mut q, mut sum) = ([0.0_f32; 4], 0.0);
    for k in (0..4).rev().filter(|&k| k != largest) {
        let size = (bits & 511) as f32 / 511.0 * std::f32::consts::FRAC_1_SQRT_2;
        q[k] = if bits & 512 == 0 { size } else { -size };
        sum += size * size;
        bits >>= 10;
    }
    q[largest] = (1.0 - sum).max(0.0).sqrt();
    [q[3], q[0], q[1], q[2]]
}
