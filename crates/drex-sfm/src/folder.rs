//! The photos of a folder that are to be registered: each once, with a word about what cannot be used.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use drex_core::capture::{CaptureOptions, PhotoFile, find_mask, photo_size, photos_in};
use drex_core::{Error, Result, fsutil};
use rayon::prelude::*;
use sha2::{Digest, Sha256};

use crate::front_end::InputPhoto;
use crate::picture::PICTURE;
use crate::verdict::{count, list};

/// Pictures that phones and cameras write and that are not read here, by the ending of their names.
const HEIC: [&str; 4] = ["heic", "heif", "hif", "avif"];
const RAW: [&str; 6] = ["dng", "cr2", "cr3", "nef", "arw", "raf"];
const OTHER: [&str; 5] = ["tif", "tiff", "webp", "bmp", "gif"];

/// Photos of a folder for [`register`](crate::register()).
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PhotoFolder {
    /// The folder that the photos' names start from.
    pub root: PathBuf,
    /// The photos, sorted by name; of several files with the same bytes the first.
    pub photos: Vec<InputPhoto>,
    /// The size of most of them, pixels.
    pub usual_size_px: [u32; 2],
    /// What was odd, in sentences.
    pub notes: Vec<String>,
    /// SHA-256 of names and contents of photos and masks, hexadecimal.
    pub sha256: String,
}

impl PhotoFolder {
    /// The photos in `folder` (`images`, `photos`, `input` or the folder itself), with the masks of
    /// [`CaptureOptions::masks`] where that names a folder. What lies in `out`, the folder of the result, is no photo, unless
    /// the photos themselves lie there.
    ///
    /// # Errors
    /// If there are no photos (the message says of HEIC and raw pictures what to do), or a file cannot be read.
    pub fn read(folder: &Path, options: &CaptureOptions, out: &Path) -> Result<Self> {
        if folder.is_file() {
            let remedy = "give the folder that holds the photos";
            return Err(Error::capture(format!("{} is one file", folder.display()), remedy));
        }
        if !folder.exists() {
            return Err(Error::capture(format!("there is no {}", folder.display()), "give a folder with photos"));
        }
        let unusable = unusable_in(folder);
        let (root, mut files) = photos_in(folder, options).unwrap_or_else(|| (folder.into(), Vec::new()));
        let (absolute, out) = (fsutil::absolute(&root), fsutil::absolute(out));
        let inside = absolute.starts_with(&out);
        files.retain(|p| {
            let file = fsutil::absolute(&p.path);
            file != out.join(PICTURE) && (inside || !file.starts_with(&out))
        });
        if files.is_empty() {
            let remedy = match unusable.first() {
                Some(sentence) => sentence.clone(),
                None => "put 20 to 80 photos (JPEG or PNG) of the object into it".into(),
            };
            return Err(Error::capture(format!("{} has no photos", folder.display()), remedy));
        }
        let mut notes: Vec<String> = unusable.into_iter().map(|sentence| format!("Left out: {sentence}.")).collect();
        let named = |p: &PhotoFile| p.path.file_name().is_some_and(|n| n.to_str().is_some());
        let odd: Vec<String> = files.iter().filter(|p| !named(p)).map(|p| p.name.clone()).collect();
        files.retain(named);
        if !odd.is_empty() {
            let odd: Vec<&str> = odd.iter().map(String::as_str).collect();
            notes.push(format!("Left out: {} has a name that is not UTF-8: rename it.", list(&odd)));
        }
        let digests: Vec<[u8; 32]> = files.par_iter().map(|p| digest(&p.path)).collect::<Result<_>>()?;
        let (mut first, mut photos, mut whole) = (BTreeMap::new(), Vec::new(), Sha256::new());
        let (mut twice, mut sizes): (Vec<String>, BTreeMap<[u32; 2], usize>) = Default::default();
        for (PhotoFile { name, path }, digest) in files.into_iter().zip(digests) {
            if let Some(same) = first.get(&digest) {
                twice.push(format!("{name} (as {same})"));
                continue;
            }
            whole.update(name.as_bytes());
            whole.update(digest);
            first.insert(digest, name.clone());
            let mask = options.masks.as_ref().and_then(|_| find_mask(folder, &name, options));
            if let Some(mask) = &mask {
                whole.update(self::digest(mask)?);
            }
            if let Ok(size) = photo_size(&path) {
                *sizes.entry(size).or_default() += 1;
            }
            photos.push(InputPhoto { name, path, mask });
        }
        if !twice.is_empty() {
            let twice: Vec<&str> = twice.iter().map(String::as_str).collect();
            notes.push(format!("Used once, as the bytes are the same: {}.", list(&twice)));
        }
        let usual_size_px = sizes.into_iter().max_by_key(|(_, n)| *n).map_or([0, 0], |(size, _)| size);
        Ok(Self { root, photos, usual_size_px, notes, sha256: fsutil::hex(&whole.finalize()) })
    }
}

impl PhotoFolder {
    /// The same photos, each as a whole.
    #[must_use]
    pub fn without_masks(&self) -> Self {
        let mut whole = self.clone();
        whole.photos.iter_mut().for_each(|p| p.mask = None);
        whole
    }

    /// Whether a photo has a mask.
    pub fn has_masks(&self) -> bool {
        self.photos.iter().any(|p| p.mask.is_some())
    }

    /// Says which photos have no mask, where others have one.
    pub(crate) fn partly_masked(&self) -> Option<String> {
        let without: Vec<&str> = self.photos.iter().filter(|p| p.mask.is_none()).map(|p| p.name.as_str()).collect();
        let partly = self.has_masks() && !without.is_empty();
        partly
            .then(|| format!("{} without a mask, used as a whole: {}.", count(without.len(), "photo"), list(&without)))
    }
}

fn digest(path: &Path) -> Result<[u8; 32]> {
    Ok(Sha256::digest(fsutil::read_bytes(path)?).into())
}

/// What to do with pictures that are not read, a sentence without a full stop for each kind.
fn unusable_in(folder: &Path) -> Vec<String> {
    let mut names = Vec::new();
    let places = ["", "images", "photos", "input"].map(|place| folder.join(place));
    for entry in places.iter().filter_map(|p| std::fs::read_dir(p).ok()).flatten().flatten() {
        names.push(entry.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    let ends = |name: &str, endings: &[&str]| {
        let ending = Path::new(name).extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        endings.contains(&ending.as_str())
    };
    let kinds: [(&str, &[&str], &str); 3] = [
        (
            "HEIC",
            &HEIC,
            "convert to JPEG (heif-convert IMG_1.HEIC IMG_1.jpg), or let the phone take JPEG (iPhone: Settings, Camera, Formats, \
             Most Compatible)",
        ),
        ("raw pictures", &RAW, "export them as JPEG at full size"),
        ("no JPEG or PNG", &OTHER, "convert them to JPEG or PNG"),
    ];
    let sentence = |(kind, endings, remedy): (&str, &[&str], &str)| {
        let of: Vec<&str> = names.iter().map(String::as_str).filter(|n| ends(n, endings)).collect();
        let are = if of.len() == 1 { "1 file is".to_owned() } else { format!("{} files are", of.len()) };
        (!of.is_empty()).then(|| format!("{are} {kind}, which drex does not read ({}): {remedy}", list(&of)))
    };
    kinds.into_iter().filter_map(sentence).collect()
}
