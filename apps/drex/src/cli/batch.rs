//! Arguments of `drex batch`.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args, Subcommand};
use drex_twin::Stage;
use drex_twin::batch::Shard;

/// `drex batch`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct BatchArgs {
    /// What to do with a batch that has been run.
    #[command(subcommand)]
    pub command: Option<BatchCommand>,
    /// The items and where their results go.
    #[command(flatten)]
    pub place: BatchPlace,
    /// Stages of twins that are done, with those that they need, such as identify,trial [default: all].
    #[arg(long, value_name = "STAGE,…", value_delimiter = ',')]
    pub stages: Vec<Stage>,
    /// Items at a time; each has its share of --threads [default: one per core].
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
    /// Do part I of N, from 0: which items belong to it depends on their names alone.
    #[arg(long, value_name = "I/N")]
    pub shard: Option<Shard>,
    /// Try again what failed before.
    #[arg(long)]
    pub retry_failed: bool,
}

/// The items and where their results go.
#[derive(Debug, Args)]
pub struct BatchPlace {
    /// Folder of twin folders, or a list of twins and meshes.
    #[arg(value_name = "FOLDER|LIST.toml", required = true)]
    pub items: Option<PathBuf>,
    /// Folder for the results [default: FOLDER/batch, or LIST.batch].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// What is done with a batch that has been run.
#[derive(Debug, Subcommand)]
pub enum BatchCommand {
    /// Join what shards have done into one table.
    Merge(BatchPlace),
    /// Write a page about all items: failures, outliers, histograms, a gallery.
    Report(BatchPlace),
    /// Do the one item that standard input names.
    #[command(hide = true)]
    Item,
}
