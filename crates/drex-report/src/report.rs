//! The page, section by section.

use std::path::PathBuf;

use drex_core::fsutil;
use drex_twin::lock::made_by;
use drex_twin::{Twin, records as files};

use crate::learned::Learned;
use crate::mass::contradiction_text;
use crate::page::Page;
use crate::picture::raster::encode_png;
use crate::{Result, grasps, hand, object, people, push, replay, scan, summary, trial};

/// Name of the page in a twin folder.
const PAGE: &str = "report.html";
/// Name of the first picture there.
const PICTURE: &str = "picture.png";

/// Writes `report.html` and the pictures that belong to it into the twin's folder, and names them: the last stage of a twin, see
/// [`drex_twin::RunOptions::with_report`].
///
/// # Errors
/// If a record of an earlier stage is missing or damaged, or a file cannot be written.
pub fn write(twin: &Twin) -> Result<Vec<PathBuf>, Box<dyn std::error::Error + Send + Sync>> {
    let sheet = people::write_sheet(twin)?;
    let (html, path) = (page(twin)?, twin.output(PAGE)?);
    fsutil::write_atomic(&path, html.as_bytes())?;
    Ok(sheet.into_iter().chain([path]).collect())
}

/// Writes `picture.png` into the twin's folder, a photo of the object beside its mesh from the same place, and names it; nothing where no photo shows
/// all of the object or the mesh has no texture. See [`drex_twin::RunOptions::with_picture`].
///
/// # Errors
/// If a record of the scan or the asset is missing or damaged, or the file cannot be written.
pub fn write_picture(twin: &Twin) -> Result<Vec<PathBuf>, Box<dyn std::error::Error + Send + Sync>> {
    let Some(surface) = scan::textured(twin)? else { return Ok(Vec::new()) };
    let Some(beside) = scan::beside_a_photo(twin, &surface)? else { return Ok(Vec::new()) };
    let path = twin.output(PICTURE)?;
    fsutil::write_atomic(&path, &encode_png(&beside.sheet())?)?;
    Ok(vec![path])
}

/// The report as one HTML page.
///
/// # Errors
/// If a record of an earlier stage is missing or damaged.
pub fn page(twin: &Twin) -> Result<String> {
    let asset = twin.asset()?;
    let mass = twin.mass()?;
    let learned = match &twin.manifest.grasps {
        Some(_) => Some(Learned {
            fits: files::read_json(&twin.path(files::FITS))?,
            training: files::read_json(&twin.path(files::TRAINING))?,
            evaluation: files::read_json(&twin.path(files::EVALUATION))?,
            trial: files::read_json(&twin.path(files::TRIAL))?,
            execution: files::read_json(&twin.path(files::EXECUTION))?,
        }),
        None => None,
    };
    let mut page = Page::new(&format!("{}: digital twin", twin.manifest.name));
    if let Some(text) = contradiction_text(&mass) {
        page.warning(&text);
    }
    summary::figures(&mut page, asset, &mass, learned.as_ref());
    if let Some(scan) = &twin.manifest.scan {
        scan::section(&mut page, twin, asset, &scan.photos)?;
    }
    object::section(&mut page, asset, &mass)?;
    let replays = replay::of(twin, asset, &mass)?;
    push::section(&mut page, &mass, &replays);
    if let Some(learned) = &learned {
        grasps::demonstrations(&mut page, twin, asset, &learned.fits)?;
        grasps::training(&mut page, twin, asset, &learned.training)?;
        grasps::evaluation(&mut page, twin, asset, &learned.evaluation)?;
        trial::section(&mut page, twin, asset, &learned.trial)?;
        hand::section(&mut page, twin, &learned.execution)?;
    }
    provenance(&mut page, twin);
    Ok(page.to_html())
}

/// Settings, seeds, versions, digests.
fn provenance(page: &mut Page, twin: &Twin) {
    page.section("How this was made");
    page.paragraph(&format!("{} with seed {}. The manifest:", made_by(), twin.seed));
    page.code(&twin.manifest.to_toml_string().unwrap_or_else(|e| e.to_string()));
    let rows: Vec<Vec<String>> = twin
        .lock
        .stages()
        .iter()
        // The report cannot carry its own digest, nor that of the run that replaces it.
        .filter(|(name, _)| name.as_str() != "report")
        .map(|(name, r)| {
            vec![
                name.clone(),
                r.made_by.clone(),
                r.seed.to_string(),
                r.inputs_sha256[..16.min(r.inputs_sha256.len())].to_owned(),
            ]
        })
        .collect();
    page.table(&["stage", "made by", "seed", "digest of its inputs"], &rows);
}
