//! `drex run`, `train`, `evaluate` and `report`: the stages of a twin folder up to one of them.

use anyhow::Result;
use serde_json::json;

use crate::cli::TwinArgs;
use crate::ui::Ui;
use drex_twin::{RunOptions, Stage, Twin};

/// Runs the twin's stages up to `last` (that one in any case if `again`) and answers with what was done and found.
pub fn run(args: &TwinArgs, last: Stage, again: bool, seed: Option<u64>, ui: &Ui) -> Result<()> {
    let mut twin = Twin::open(&args.twin)?.with_seed(seed);
    twin.tool_limit = args.tools.limit();
    let options = RunOptions::default().until(last).with_again(again);
    let summary = twin.run(&options.with_picture(drex_report::write_picture).with_report(drex_report::write), ui)?;
    let findings = drex_report::findings(&twin, last)?;
    let mut answer = json!(summary);
    if let Some(object) = answer.as_object_mut() {
        object.extend(serde_json::from_str::<serde_json::Map<_, _>>(&findings.json)?);
    }
    ui.answer(&answer, findings.text)
}
