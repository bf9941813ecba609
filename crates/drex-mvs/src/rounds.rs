//! What is found of each photo from round to round: in memory, or in files of which a few are in memory as well, so that many photos fit and
//! an interrupted run goes on.

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use drex_core::fsutil::{read_bytes, write_atomic};
use drex_core::{Error, Result};

use crate::kernel::Plane;
use crate::options::MvsOptions;
use crate::patchmatch::Field;
use crate::scene::View;

/// Bytes of fields that are kept in memory where they are in files as well.
const IN_MEMORY: usize = 256 << 20;
/// First bytes of a file; another number where what is found changes.
const MAGIC: u64 = u64::from_le_bytes(*b"drexmvs1");
/// Of the files.
const ENDING: &str = "planes";
/// Bytes of that number, the fingerprint, width and height.
const HEAD: usize = 32;
/// Bytes of a pixel: its plane and its cost.
const PIXEL: usize = 16;

/// The fields of all photos after each round.
pub(crate) struct Rounds {
    /// Of the files, if there are any.
    folder: Option<PathBuf>,
    /// What the fields depend on.
    of: u64,
    photos: usize,
    /// By round and photo.
    held: BTreeMap<(usize, usize), Arc<Field>>,
    /// The oldest one first.
    order: VecDeque<(usize, usize)>,
    bytes: usize,
}

impl Rounds {
    /// Those of an earlier run with the same views and options are gone on with, if they are in the folder for it.
    pub fn new(options: &MvsOptions, views: &[View]) -> Self {
        let of = if options.work.is_some() { fingerprint(options, views) } else { 0 };
        let (held, order) = (BTreeMap::new(), VecDeque::new());
        Self { folder: options.work.clone(), of, photos: views.len(), held, order, bytes: 0 }
    }

    /// Whether a photo has been through a round.
    pub fn has(&self, round: usize, photo: usize) -> bool {
        self.held.contains_key(&(round, photo)) || self.file(round, photo).is_some_and(|file| self.is_whole(&file))
    }

    /// The last of `rounds` that all photos have been through.
    pub fn last_complete(&self, rounds: usize) -> Option<usize> {
        (0..rounds).rev().find(|round| (0..self.photos).all(|photo| self.has(*round, photo)))
    }

    /// The field of a photo after a round.
    ///
    /// # Errors
    /// If its file cannot be read any more.
    pub fn get(&mut self, round: usize, photo: usize) -> Result<Arc<Field>> {
        if let Some(field) = self.held.get(&(round, photo)) {
            return Ok(field.clone());
        }
        let Some(field) = self.read(round, photo)? else {
            return Err(Error::value(
                format!("what was found of photo {photo} is gone or damaged"),
                "leave the folder for work in progress alone, and start again",
            ));
        };
        Ok(self.hold(round, photo, field))
    }

    /// Keeps the field of a photo after a round.
    ///
    /// # Errors
    /// If its file cannot be written.
    pub fn put(&mut self, round: usize, photo: usize, field: Field) -> Result<()> {
        if let Some(file) = self.file(round, photo) {
            write_atomic(&file, &self.bytes_of(&field))?;
        }
        self.hold(round, photo, field);
        Ok(())
    }

    /// Forgets what a round before this one found.
    pub fn forget_before(&mut self, round: usize) {
        let Some(gone) = round.checked_sub(1) else { return };
        for photo in 0..self.photos {
            if let Some(field) = self.held.remove(&(gone, photo)) {
                self.bytes -= field.costs.len() * PIXEL;
            }
            // One that stays takes room, and is none of the rounds that are looked for.
            self.file(gone, photo).iter().for_each(|file| drop(std::fs::remove_file(file)));
        }
        self.order.retain(|(of, _)| *of != gone);
    }

    fn hold(&mut self, round: usize, photo: usize, field: Field) -> Arc<Field> {
        let field = Arc::new(field);
        self.bytes += field.costs.len() * PIXEL;
        self.held.insert((round, photo), field.clone());
        self.order.push_back((round, photo));
        while self.folder.is_some() && self.bytes > IN_MEMORY && self.order.len() > 1 {
            let oldest = self.order.pop_front().and_then(|at| self.held.remove(&at));
            self.bytes -= oldest.map_or(0, |field| field.costs.len() * PIXEL);
        }
        field
    }

    fn file(&self, round: usize, photo: usize) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("round-{round:02}-photo-{photo:05}.{ENDING}")))
    }

    /// Whether a file is of the same views and options, and as long as it says.
    fn is_whole(&self, file: &Path) -> bool {
        let mut head = [0; HEAD];
        let whole = File::open(file).and_then(|mut file| {
            file.read_exact(&mut head)?;
            Ok(self.size(&head).is_some_and(|[width, height]| {
                let bytes = (HEAD + PIXEL * width * height) as u64;
                file.metadata().is_ok_and(|of| of.len() == bytes)
            }))
        });
        whole.unwrap_or(false)
    }

    /// `None` if there is none of the same views and options.
    fn read(&self, round: usize, photo: usize) -> Result<Option<Field>> {
        let Some(file) = self.file(round, photo).filter(|file| file.is_file()) else { return Ok(None) };
        Ok(self.parse(&read_bytes(&file)?))
    }

    fn bytes_of(&self, field: &Field) -> Vec<u8> {
        let head = [MAGIC, self.of, field.width as u64, field.height as u64];
        let mut bytes: Vec<u8> = head.iter().flat_map(|v| v.to_le_bytes()).collect();
        bytes.reserve(PIXEL * field.costs.len());
        for (plane, cost) in field.planes.iter().zip(&field.costs) {
            [plane.w, plane.a, plane.b, *cost].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        }
        bytes
    }

    /// Width and height that the head of a file says, if it is of the same views and options.
    fn size(&self, head: &[u8; HEAD]) -> Option<[usize; 2]> {
        let words = head.as_chunks::<8>().0;
        let [magic, of, width, height] = std::array::from_fn(|k| u64::from_le_bytes(words[k]));
        let sides = [usize::try_from(width).ok()?, usize::try_from(height).ok()?];
        let possible = sides[0].checked_mul(sides[1]).and_then(|n| n.checked_mul(PIXEL)).is_some();
        ([magic, of] == [MAGIC, self.of] && possible).then_some(sides)
    }

    fn parse(&self, bytes: &[u8]) -> Option<Field> {
        let (head, pixels) = bytes.split_first_chunk::<HEAD>()?;
        let [width, height] = self.size(head)?;
        let (pixels, rest) = pixels.as_chunks::<PIXEL>();
        if pixels.len() != width * height || !rest.is_empty() {
            return None;
        }
        let number = |pixel: &[u8; PIXEL], k: usize| f32::from_le_bytes(std::array::from_fn(|i| pixel[4 * k + i]));
        Some(Field {
            width,
            height,
            planes: pixels.iter().map(|p| Plane { w: number(p, 0), a: number(p, 1), b: number(p, 2) }).collect(),
            costs: pixels.iter().map(|p| number(p, 3)).collect(),
        })
    }
}

/// Removes what runs with this folder as [`MvsOptions::work`] left in it, and the folder if nothing else is in it.
///
/// # Errors
/// If a file cannot be removed.
pub fn remove_work(folder: &Path) -> Result<()> {
    let failed = |e| Error::io("remove", folder, e);
    if !folder.is_dir() {
        return Ok(());
    }
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.extension().is_some_and(|e| e == ENDING) {
            std::fs::remove_file(&path).map_err(failed)?;
        }
    }
    // What somebody else put there stays.
    let _ = std::fs::remove_dir(folder);
    Ok(())
}

/// A number that is another one for other pictures, cameras or options.
fn fingerprint(options: &MvsOptions, views: &[View]) -> u64 {
    let mut of = DefaultHasher::new();
    format!("{:?} {:?} {:?}", options.preset, options.region, options.seed).hash(&mut of);
    if options.on_gpu {
        "on the GPU".hash(&mut of);
    }
    for view in views {
        format!("{:?} {:?} {:?} {}", view.camera, view.range, view.witnesses, view.masked).hash(&mut of);
        (&view.pictures[0].values, &view.searched[0].inside).hash(&mut of);
    }
    of.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(value: f32, side: usize) -> Field {
        let planes = vec![Plane { w: value, a: 0.5 * value, b: -value }; side * side];
        Field { width: side, height: side, planes, costs: vec![f32::INFINITY; side * side] }
    }

    fn rounds(folder: Option<PathBuf>, of: u64) -> Rounds {
        Rounds { folder, of, photos: 2, held: BTreeMap::new(), order: VecDeque::new(), bytes: 0 }
    }

    #[test]
    fn fields_of_an_earlier_run_are_reused_unless_stale_or_damaged() {
        let dir = tempfile::tempdir().unwrap();
        let folder = || Some(dir.path().join("work"));
        let mut first = rounds(folder(), 7);
        for photo in 0..2 {
            first.put(0, photo, field(photo as f32, 3)).unwrap();
        }
        first.put(1, 0, field(5.0, 4)).unwrap();
        let mut second = rounds(folder(), 7);
        assert_eq!((second.last_complete(3), second.has(1, 0), second.has(1, 1)), (Some(0), true, false));
        assert_eq!(*second.get(0, 1).unwrap(), field(1.0, 3));
        assert_eq!(*second.get(1, 0).unwrap(), field(5.0, 4));
        assert_eq!(rounds(folder(), 8).last_complete(3), None, "of other photos");
        let file = second.file(0, 0).unwrap();
        let mut bytes = std::fs::read(&file).unwrap();
        for damaged in [bytes.len() - 1, 20, 0] {
            bytes.truncate(damaged);
            std::fs::write(&file, &bytes).unwrap();
            let mut third = rounds(folder(), 7);
            assert_eq!((third.last_complete(3), third.get(0, 0).is_err()), (None, true));
        }
        second.put(1, 1, field(6.0, 4)).unwrap();
        second.forget_before(1);
        assert!(!file.exists() && second.last_complete(3) == Some(1) && second.get(0, 1).is_err());
        let work = dir.path().join("work");
        std::fs::write(work.join("notes.txt"), "mine").unwrap();
        remove_work(&work).unwrap();
        assert_eq!(work.read_dir().unwrap().count(), 1, "a file of somebody else stays");
        std::fs::remove_file(work.join("notes.txt")).unwrap();
        remove_work(&work).unwrap();
        assert!(!work.exists() && remove_work(&work).is_ok());
    }

    #[test]
    fn memory_holds_a_few_of_many_and_all_where_there_are_no_files() {
        let dir = tempfile::tempdir().unwrap();
        let side = 1 << 11;
        let count = 6;
        for (folder, held) in [(Some(dir.path().to_owned()), IN_MEMORY / (PIXEL * side * side)), (None, count)] {
            let mut rounds = rounds(folder, 7);
            (0..count).for_each(|photo| rounds.put(0, photo, field(photo as f32, side)).unwrap());
            assert_eq!((rounds.held.len(), rounds.bytes), (held, held * PIXEL * side * side));
            assert_eq!(rounds.get(0, 0).unwrap().planes[9].w, 0.0);
        }
    }
}
