//! A comma-separated table with a header, kept as text until a column is asked for.

use std::path::{Path, PathBuf};

use drex_core::{Error, Result, budget};

/// Memory of a row and of a field apart from the text, bytes.
const ROW_BYTES: u64 = 256;
const FIELD_BYTES: u64 = 16;
/// No recording has more columns.
const MOST_COLUMNS: usize = 4096;

/// A csv file with a header line. Blank lines and lines that start with `#` are skipped.
///
/// A last row that is too short, in a file that does not end in a line break, was cut off while it was written: it is
/// dropped and counted in [`Table::cut_rows`].
#[derive(Debug, Clone)]
pub struct Table {
    path: PathBuf,
    header: Vec<String>,
    rows: Vec<(usize, csv::StringRecord)>,
    /// 1 if a last, incomplete row was dropped.
    pub cut_rows: usize,
}

impl Table {
    /// Splits `bytes`; `path` is for messages.
    ///
    /// # Errors
    /// If it is not text, has no header or no rows, names a column twice, or a row has another number of fields than the header.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        let count = |mark: u8| bytes.iter().filter(|&&b| b == mark).count() as u64;
        let rows = count(b'\n') + 1;
        let memory = rows * ROW_BYTES + count(b',') * FIELD_BYTES + 2 * bytes.len() as u64;
        budget::allow(path, format_args!("{rows} rows"), memory)?;
        let mut reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .comment(Some(b'#'))
            .trim(csv::Trim::All)
            .from_reader(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes));
        let mut records = Vec::new();
        for record in reader.records() {
            let record = record.map_err(|e| {
                let line = e.position().map(|p| p.line() as usize);
                Error::content(
                    path,
                    line,
                    "the line is not comma-separated text (UTF-8)",
                    "check that this is the right file",
                )
            })?;
            let line = record.position().map_or(0, |p| p.line() as usize);
            records.push((line, record));
        }
        let mut records = records.into_iter();
        let Some((_, head)) = records.next() else {
            return Err(Error::content(path, None, "the file is empty", "give a csv file with a header line"));
        };
        if head.len() > MOST_COLUMNS {
            let what = format!("{} columns, more than {MOST_COLUMNS}", head.len());
            return Err(Error::content(path, 1, what, "give a csv file with one row per time"));
        }
        let header: Vec<String> = head.iter().map(str::to_owned).collect();
        let mut rows: Vec<_> = records.collect();
        let mut cut_rows = 0;
        if rows.last().is_some_and(|(_, r)| r.len() < header.len()) && !bytes.ends_with(b"\n") {
            rows.pop();
            cut_rows = 1;
        }
        if let Some((line, row)) = rows.iter().find(|(_, r)| r.len() != header.len()) {
            return Err(Error::content(
                path,
                *line,
                format!("{} fields where the header names {} columns", row.len(), header.len()),
                "repair or remove the row",
            ));
        }
        if rows.is_empty() {
            return Err(Error::content(
                path,
                None,
                "the table has a header but no rows",
                "record again or give another file",
            ));
        }
        Ok(Self { path: path.to_path_buf(), header, rows, cut_rows })
    }

    /// The file the table came from, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Column names in file order.
    pub fn header(&self) -> &[String] {
        &self.header
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there are no rows; never so for a parsed table.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// 1-based line of row `row` in the file.
    pub fn line(&self, row: usize) -> usize {
        self.rows[row].0
    }

    /// Index of the column `name`, if there is one.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.header.iter().position(|h| h == name)
    }

    /// Indices of the columns `names`.
    ///
    /// # Errors
    /// If one is missing or there twice; the message names the missing ones and those present.
    pub fn columns<S: AsRef<str>>(&self, names: &[S]) -> Result<Vec<usize>> {
        let missing: Vec<&str> = names.iter().map(AsRef::as_ref).filter(|n| self.find(n).is_none()).collect();
        if !missing.is_empty() {
            return Err(Error::content(
                &self.path,
                1,
                format!("no column {}; the columns are {}", missing.join(", "), shorten(&self.header)),
                "name the columns as documented (the name fixes the unit) or give the right file",
            ));
        }
        names
            .iter()
            .map(|n| {
                let mut hits = self.header.iter().enumerate().filter(|(_, h)| *h == n.as_ref()).map(|(i, _)| i);
                match (hits.next(), hits.next()) {
                    (Some(i), None) => Ok(i),
                    _ => {
                        Err(Error::content(&self.path, 1, format!("column {} is there twice", n.as_ref()), "keep one"))
                    }
                }
            })
            .collect()
    }

    /// The text in `row`, `column`.
    pub fn text(&self, row: usize, column: usize) -> &str {
        self.rows[row].1.get(column).unwrap_or_default()
    }

    /// The finite number in `row`, `column`.
    ///
    /// # Errors
    /// If it is no number or not finite, with line and column name.
    pub fn number(&self, row: usize, column: usize) -> Result<f64> {
        let text = self.text(row, column);
        match text.parse::<f64>() {
            Ok(v) if v.is_finite() => Ok(v),
            parsed => {
                let what = if parsed.is_ok() { "not finite" } else { "not a number" };
                Err(Error::content(
                    &self.path,
                    self.line(row),
                    format!("column {}: `{text}` is {what}", self.header[column]),
                    "remove the row or repair the recording",
                ))
            }
        }
    }

    /// The finite numbers of `row` in the columns `columns`.
    ///
    /// # Errors
    /// As [`Table::number`].
    pub fn numbers<const N: usize>(&self, row: usize, columns: &[usize]) -> Result<[f64; N]> {
        let mut out = [0.0; N];
        for (value, &column) in out.iter_mut().zip(columns) {
            *value = self.number(row, column)?;
        }
        Ok(out)
    }

    /// Row indices in order of increasing time in the column `column`; of rows with the same time the first stays.
    ///
    /// # Errors
    /// If a time is no finite number.
    pub fn rows_by_time(&self, column: usize) -> Result<Vec<(usize, f64)>> {
        let mut rows = (0..self.len()).map(|r| Ok((r, self.number(r, column)?))).collect::<Result<Vec<_>>>()?;
        rows.sort_by(|a, b| a.1.total_cmp(&b.1));
        rows.dedup_by(|a, b| a.1 == b.1);
        Ok(rows)
    }
}

/// Column names for a message, at most a dozen.
fn shorten(names: &[String]) -> String {
    const MOST: usize = 12;
    let head = names.iter().take(MOST).map(String::as_str).collect::<Vec<_>>().join(", ");
    if names.len() > MOST { format!("{head}, … ({} in all)", names.len()) } else { head }
}
