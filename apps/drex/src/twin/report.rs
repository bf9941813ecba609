//! The page about all of it.

use std::path::PathBuf;

use anyhow::Result;
use drex_core::fsutil;

use super::Twin;

pub fn make(twin: &Twin) -> Result<Vec<PathBuf>> {
    let html = crate::report::page_of(twin)?;
    let path = twin.output("report.html")?;
    fsutil::write_atomic(&path, html.as_bytes())?;
    Ok(vec![path])
}
