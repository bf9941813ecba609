//! `report.html`: what was made of the twin, with which inputs, and how far it can be trusted.

mod grasps;
mod hand;
mod mass;
mod object;
mod page;
mod people;
mod push;
mod replay;
mod scan;
mod summary;
mod trial;
mod viewer;

use anyhow::Result;

use crate::lock::made_by;
use crate::twin::{Evaluation, ExecutionFile, FitFile, MassFile, Training, TrialFile, Twin, files};

pub use mass::{contradiction_text, posterior_text, prior_text};
pub use object::{closing_text, pieces_text};
pub use push::verdict_text;
pub use summary::findings;

use page::Page;

/// What became of the grasps.
struct Learned {
    fits: FitFile,
    training: Training,
    evaluation: Evaluation,
    trial: TrialFile,
    execution: ExecutionFile,
}

/// The report as one HTML page.
pub fn page_of(twin: &Twin) -> Result<String> {
    let asset = twin.asset()?;
    let mass: MassFile = files::read_json(&twin.path(files::MASS))?;
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
        grasps::training(&mut page, &learned.training);
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
