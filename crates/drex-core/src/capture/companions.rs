//! The files beside a photo: masks, depth maps, normal maps; and which files are photos.

use std::path::{Component, Path, PathBuf};

use image::{DynamicImage, ImageDecoder, ImageReader};

use super::{CaptureOptions, View, refuse};
use crate::budget;
use crate::fsutil::read_bytes;
use crate::npy::parse_npy;
use crate::{Error, Result};

/// Optional files of one view.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Companions {
    pub(super) mask: Option<PathBuf>,
    pub(super) depth: Option<PathBuf>,
    pub(super) confidence: Option<PathBuf>,
    pub(super) normal: Option<PathBuf>,
}

const PICTURES: [&str; 6] = ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"];

impl Companions {
    /// What lies in the capture's folders for the photo of this relative name.
    pub(super) fn find(folder: &Path, name: &str, options: &CaptureOptions) -> Self {
        // Steps up, and roots, would lead out of these folders, back to the photo itself.
        let within: PathBuf = Path::new(name).components().filter(|c| matches!(c, Component::Normal(_))).collect();
        let place =
            |given: &Option<PathBuf>, usual: &str| given.clone().unwrap_or_else(|| folder.join(usual)).join(&within);
        let find = |at: PathBuf, extensions: &[&str]| {
            let beside_stem = extensions.iter().map(|e| at.with_extension(e));
            let behind_name = extensions.iter().map(|e| PathBuf::from(format!("{}.{e}", at.display())));
            beside_stem.chain(behind_name).find(|p| p.is_file())
        };
        Self {
            mask: find(place(&options.masks, "masks"), &PICTURES),
            depth: find(place(&options.depths, "depths"), &["npy", "png"]),
            confidence: None,
            normal: find(place(&options.normals, "normals"), &["png"]),
        }
    }
}

/// The file at `path`, or else one with the same stem and the extension of a picture.
pub(super) fn with_known_extension(path: &Path) -> Option<PathBuf> {
    if path.is_file() {
        return Some(path.into());
    }
    let appended = PICTURES.iter().map(|e| PathBuf::from(format!("{}.{e}", path.display())));
    appended.chain(PICTURES.iter().map(|e| path.with_extension(e))).find(|p| p.is_file())
}

/// A photo in a folder of photos.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct PhotoFile {
    /// Name within the folder, with forward slashes and extension.
    pub name: String,
    /// The file.
    pub path: PathBuf,
}

/// The photos of a capture that may have no cameras yet, and the folder that their names start from: `images`, `photos`,
/// `input` or the folder itself, or [`CaptureOptions::images`]. `None` where there are none.
pub fn photos_in(folder: &Path, options: &CaptureOptions) -> Option<(PathBuf, Vec<PhotoFile>)> {
    let usual = ["images", "photos", "input"].map(|n| folder.join(n));
    let places = match &options.images {
        Some(images) => vec![images.clone()],
        None => usual.into_iter().chain([folder.to_path_buf()]).collect(),
    };
    places.into_iter().map(|p| (p.clone(), photos_under(&p))).find(|(_, photos)| !photos.is_empty())
}

/// All photos under `root`, sorted by name; not the masks and maps of a capture's other folders.
pub fn photos_under(root: &Path) -> Vec<PhotoFile> {
    let mut found = Vec::new();
    let mut folders = vec![(String::new(), root.to_path_buf())];
    while let Some((prefix, folder)) = folders.pop() {
        for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            // Links to folders are not followed: they may lead in circles.
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                if ["masks", "depths", "normals", "colmap", "sparse"].contains(&name.as_str()) {
                    continue;
                }
                folders.push((format!("{name}/"), path));
            } else if path.extension().is_some_and(|e| PICTURES.iter().any(|p| e.eq_ignore_ascii_case(p)))
                && path.is_file()
            {
                found.push(PhotoFile { name, path });
            }
        }
    }
    found.sort();
    found
}

/// Width and height of a picture in pixels as it is stored (an orientation tag turns nothing), from its header alone.
///
/// # Errors
/// If the file cannot be read or is no PNG or JPEG.
pub fn photo_size(path: &Path) -> Result<[u32; 2]> {
    let (width, height) = open(path)?.into_dimensions().map_err(|e| unreadable(path, e))?;
    Ok([width, height])
}

/// As [`photo_size`], to reckon with.
pub(super) fn size_of(path: &Path) -> Result<[f64; 2]> {
    Ok(photo_size(path)?.map(f64::from))
}

/// A picture as it is stored: its width and height in pixels, and its colours row by row. 16-bit pictures lose their lower half, grey ones
/// get three equal channels.
///
/// # Errors
/// If the file cannot be read, is no PNG or JPEG, is damaged, or is too large for the memory that is allowed.
pub fn read_rgb(path: &Path) -> Result<([usize; 2], Vec<[u8; 3]>)> {
    let rgb = picture(path)?.into_rgb8();
    let size = [rgb.width() as usize, rgb.height() as usize];
    Ok((size, rgb.pixels().map(|p| p.0).collect()))
}

/// The mask of the photo of this relative name in the capture's folder of masks, if there is one.
pub fn find_mask(folder: &Path, name: &str, options: &CaptureOptions) -> Option<PathBuf> {
    Companions::find(folder, name, options).mask
}

/// The decoded picture, as stored.
pub(super) fn picture(path: &Path) -> Result<DynamicImage> {
    let picture = open(path)?.decode().map_err(|e| unreadable(path, e))?;
    if is_cut_off(&read_bytes(path)?) {
        return refuse(
            format!("{} is cut off: its JPEG data has no end", path.display()),
            "copy the photo again, or leave it out",
        );
    }
    Ok(picture)
}

/// Whether a file is a JPEG whose picture has no end: decoders fill what is missing with grey. What other data follows the picture, as in
/// motion photos, does not count; a thumbnail before it has its own end inside of a segment.
fn is_cut_off(bytes: &[u8]) -> bool {
    let [0xff, 0xd8, ..] = bytes else { return false };
    let mut at = 2;
    // Segments of the header, up to the first scan: ff, kind, length of what follows including itself.
    while let Some(&[0xff, kind, high, low]) = bytes.get(at..at + 4) {
        at += 2 + usize::from(u16::from_be_bytes([high, low]));
        if kind == 0xda {
            break;
        }
    }
    !bytes.get(at..).is_some_and(|rest| rest.windows(2).any(|pair| pair == [0xff, 0xd9]))
}

fn open(path: &Path) -> Result<ImageReader<std::io::BufReader<std::fs::File>>> {
    let io = |e| Error::io("read", path, e);
    let mut reader = ImageReader::open(path).map_err(io)?.with_guessed_format().map_err(io)?;
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(picture_bytes());
    reader.limits(limits);
    Ok(reader)
}

/// Most memory of a decoded picture: it is turned into wider pixels afterwards.
fn picture_bytes() -> u64 {
    budget::max_memory() / 8
}

fn unreadable(path: &Path, source: image::ImageError) -> Error {
    if let image::ImageError::Limits(_) = source {
        let what = format!("the picture takes more than {} MB when it is decoded", picture_bytes() / 1_000_000);
        let remedy = "scale it down, or raise the limit, an eighth of --max-memory GB";
        return Error::content(path, None, what, remedy);
    }
    Error::Picture { action: "read", path: path.into(), source: source.into() }
}

/// A mask: width, height and values from 0 (background) to 255 (object). A transparent pixel is background; a picture of
/// zeros and ones is taken as of 0 and 255.
pub(super) fn mask(path: &Path) -> Result<(usize, usize, Vec<u8>)> {
    let picture = picture(path)?;
    let mut values: Vec<u8> = if picture.color().has_alpha() {
        picture.to_luma_alpha8().pixels().map(|p| (u16::from(p.0[0]) * u16::from(p.0[1]) / 255) as u8).collect()
    } else {
        picture.to_luma8().into_raw()
    };
    if values.iter().all(|v| *v <= 1) {
        values.iter_mut().for_each(|v| *v *= 255);
    }
    Ok((picture.width() as usize, picture.height() as usize, values))
}

/// The mask of a view, from its file or the photo's alpha channel.
pub(super) fn mask_of(view: &View) -> Result<Option<(usize, usize, Vec<u8>)>> {
    if let Some(path) = &view.mask {
        return mask(path).map(Some);
    }
    let has_alpha = open(&view.photo)?.into_decoder().map_err(|e| unreadable(&view.photo, e))?.color_type().has_alpha();
    if !has_alpha {
        return Ok(None);
    }
    let photo = picture(&view.photo)?.into_rgba8();
    let alpha = photo.pixels().map(|p| p.0[3]).collect();
    Ok(Some((photo.width() as usize, photo.height() as usize, alpha)))
}

/// A depth map: width, height and z in the camera's frame; 0 where unknown. Integers of a 16-bit PNG are multiplied by
/// `scale`, numbers of an npy file are taken as they are.
pub(super) fn depth(path: &Path, scale: f64) -> Result<(usize, usize, Vec<f32>)> {
    let (width, height, mut values) = if path.extension().is_some_and(|e| e == "npy") {
        npy(path)?
    } else {
        match picture(path)? {
            DynamicImage::ImageLuma16(map) => {
                let values = map.pixels().map(|p| (f64::from(p.0[0]) * scale) as f32).collect();
                (map.width() as usize, map.height() as usize, values)
            }
            _ => return refuse(format!("{} is no 16-bit grey PNG", path.display()), "write depth maps with 16 bits"),
        }
    };
    for v in &mut values {
        if !(v.is_finite() && *v > 0.0) {
            *v = 0.0;
        }
    }
    Ok((width, height, values))
}

/// A normal map: width, height and unit vectors in the camera's frame (x right, y down, z forward) after `flip`; zero
/// where unknown (black, white or grey pixels).
pub(super) fn normal(path: &Path, flip: [bool; 3]) -> Result<(usize, usize, Vec<[f32; 3]>)> {
    let picture = picture(path)?.to_rgb16();
    let values = picture.pixels().map(|p| {
        let mut n = p.0.map(|v| f32::from(v) / 65535.0 * 2.0 - 1.0);
        let norm = n.iter().map(|v| v * v).sum::<f32>().sqrt();
        for (v, flip) in n.iter_mut().zip(flip) {
            *v *= if flip { -1.0 } else { 1.0 } / norm;
        }
        // Half way between 0 and 1 there is no direction; black and white are no unit vectors.
        if (0.5..1.5).contains(&norm) { n } else { [0.0; 3] }
    });
    Ok((picture.width() as usize, picture.height() as usize, values.collect()))
}

/// A two-dimensional npy array of 32- or 64-bit numbers: columns, rows, values.
fn npy(path: &Path) -> Result<(usize, usize, Vec<f32>)> {
    let array = parse_npy(path, &read_bytes(path)?)?;
    let refuse = |what: &str| {
        let remedy = "save a float32 or float64 array of shape (height, width) with numpy.save";
        Err(Error::content(path, None, what, remedy))
    };
    let (&[rows, columns], Some(numbers)) = (array.shape.as_slice(), array.numbers()) else {
        return refuse("the array has not two dimensions of numbers");
    };
    if !matches!(array.descr.get(1..), Some("f4" | "f8")) || numbers.is_empty() {
        return refuse("the array is not of float32 or float64, or empty");
    }
    Ok((columns, rows, numbers.iter().map(|&v| v as f32).collect()))
}
