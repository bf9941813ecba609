//! `drex completions` and `drex man`: what a shell and `man` want to know of this program.

use std::path::Path;

use anyhow::{Context, Result, bail};
use clap_complete::Shell;
use drex_core::fsutil;
use serde_json::json;

use crate::cli::{self, ManArgs};
use crate::ui::Ui;

/// Prints the completions of a shell.
pub fn completions(shell: Shell, ui: &Ui) -> Result<()> {
    // Into memory first: the generator does not stand a closed pipe.
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut cli::command(), "drex", &mut script);
    let script = String::from_utf8(script).context("the completions are no text")?;
    ui.answer(&json!({ "shell": shell.to_string(), "script": script }), &script)
}

/// Prints the manual page of `drex`, or writes those of all subcommands.
pub fn man(args: &ManArgs, ui: &Ui) -> Result<()> {
    let mut command = cli::command().disable_help_subcommand(true);
    // Gives subcommands their full names and the options that all of them take.
    command.build();
    let Some(folder) = &args.out else {
        let page = page(&command)?;
        return ui.answer(&json!({ "page": page }), &page);
    };
    if folder.is_file() {
        bail!("--out {}: this is a file; give a folder for the pages", folder.display());
    }
    let mut written = Vec::new();
    write(&command, folder, &mut written)?;
    ui.answer(
        &json!({ "written": written }),
        format!("{} pages in {}; read one with man -l {}/drex.1", written.len(), folder.display(), folder.display()),
    )
}

/// The page of one command, in troff.
fn page(command: &clap::Command) -> Result<String> {
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone()).render(&mut page)?;
    String::from_utf8(page).context("the page is no text")
}

/// Writes the pages of a command and of all below it, and keeps their names.
fn write(command: &clap::Command, folder: &Path, written: &mut Vec<String>) -> Result<()> {
    let name = format!("{}.1", command.get_display_name().unwrap_or_else(|| command.get_name()));
    fsutil::write_atomic(&folder.join(&name), page(command)?.as_bytes())?;
    written.push(name);
    command.get_subcommands().try_for_each(|sub| write(sub, folder, written))
}
