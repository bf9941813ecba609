//! Archives of NumPy arrays (`.npz`): stored or deflated zip members, read one at a time.

use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

use drex_core::npy::{NpyArray, NpyValues, parse_npy};
use drex_core::{Error, Result, budget};
use zip::ZipArchive;

/// An open archive.
pub(crate) struct Npz<'b> {
    path: PathBuf,
    archive: ZipArchive<Cursor<&'b [u8]>>,
    /// Bytes of the whole archive: a member can have no more.
    packed: u64,
    names: Vec<String>,
}

impl<'b> Npz<'b> {
    /// Opens the bytes of `path`.
    pub(crate) fn open(path: &Path, bytes: &'b [u8]) -> Result<Self> {
        let archive = ZipArchive::new(Cursor::new(bytes)).map_err(|e| {
            Error::content(path, None, format!("no readable zip archive ({e})"), "save it again with numpy.savez")
        })?;
        let stem = |n: &str| n.strip_suffix(".npy").map(str::to_owned);
        let mut names: Vec<String> = archive.file_names().flatten().filter_map(|n| stem(&n)).collect();
        names.sort();
        Ok(Self { path: path.to_path_buf(), archive, packed: bytes.len() as u64, names })
    }

    /// Names of the arrays, sorted.
    pub(crate) fn names(&self) -> &[String] {
        &self.names
    }

    /// The first of `candidates` that is there.
    pub(crate) fn first_of(&self, candidates: &[&'static str]) -> Option<&'static str> {
        candidates.iter().copied().find(|c| self.names.iter().any(|n| n == c))
    }

    /// The names of the arrays, for messages.
    pub(crate) fn listing(&self) -> String {
        const MOST: usize = 16;
        let head = self.names.iter().take(MOST).map(String::as_str).collect::<Vec<_>>().join(", ");
        match self.names.len() {
            0 => "an archive without arrays".into(),
            n if n > MOST => format!("{head}, … ({n} arrays)"),
            _ => head,
        }
    }

    /// The array `name`.
    pub(crate) fn array(&mut self, name: &str) -> Result<NpyArray> {
        let refuse = |what: String| Error::content(&self.path, None, what, "save it again with numpy.savez");
        let member = self.archive.by_name(&format!("{name}.npy")).map_err(|e| refuse(format!("array {name}: {e}")))?;
        let mut bytes = Vec::new();
        // What the archive says of the size may be a lie: the size is what comes out.
        let read = member.take(budget::unpacked_limit(self.packed) + 1).read_to_end(&mut bytes);
        read.map_err(|e| refuse(format!("array {name} is damaged: {e}")))?;
        budget::allow_unpacked(&self.path.join(name), self.packed, bytes.len() as u64)?;
        parse_npy(&self.path.join(name), &bytes)
    }

    /// The numbers of the array `name`.
    pub(crate) fn table(&mut self, name: &str) -> Result<Table> {
        let place = self.path.join(name);
        Table::new(&place, self.array(name)?)
    }
}

/// An array of numbers.
pub(crate) struct Table {
    pub(crate) shape: Vec<usize>,
    pub(crate) numbers: Vec<f64>,
}

impl Table {
    pub(crate) fn from_npy(path: &Path, bytes: &[u8]) -> Result<Self> {
        Self::new(path, parse_npy(path, bytes)?)
    }

    fn new(path: &Path, array: NpyArray) -> Result<Self> {
        match array.values {
            NpyValues::Numbers(numbers) => Ok(Self { shape: array.shape, numbers }),
            _ => Err(Error::content(path, None, "texts where numbers are needed", "save numbers")),
        }
    }

    /// Rows of one of the `forms` (lengths of the dimensions after the first). A single row may lack the first dimension;
    /// dimensions of length 1 beside it are passed over, as in n x 1 x 3 x 3.
    pub(crate) fn rows<'t>(
        &'t self,
        path: &Path,
        forms: &[&[usize]],
        what: &str,
    ) -> Result<std::slice::ChunksExact<'t, f64>> {
        let squeezed = |from: usize| -> Vec<usize> {
            self.shape.get(from..).unwrap_or_default().iter().copied().filter(|&d| d != 1).collect()
        };
        let fits = |from: usize| forms.iter().find(|form| self.shape.len() >= from && squeezed(from) == **form);
        let row = fits(1).or_else(|| fits(0)).map(|form| form.iter().product::<usize>());
        let Some(row) = row.filter(|&n| n > 0) else {
            let text = |form: &[usize]| form.iter().map(|d| format!(" x {d}")).collect::<String>();
            let expected = forms.iter().map(|f| format!("n{}", text(f))).collect::<Vec<_>>().join(" or ");
            let found = self.shape.iter().map(usize::to_string).collect::<Vec<_>>().join(" x ");
            let message = format!("{what} of shape {found} where {expected} is needed");
            return Err(Error::content(path, None, message, "save one row per frame"));
        };
        Ok(self.numbers.chunks_exact(row))
    }
}
