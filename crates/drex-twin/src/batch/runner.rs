//! One item after the other in this process: what a worker does.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use drex_core::{ASSUMED_FRICTION, Object, fsutil};
use drex_mesh::{AssetOptions, build_asset};
use drex_robot::Robot;
use drex_splat::usage;
use serde::{Deserialize, Serialize};

use super::journal::Entry;
use super::list::{FindTask, Item, Task};
use super::row::{Row, RunRecord};
use super::search::{self, SearchFile};
use crate::lock::{Inputs, digest_of};
use crate::manifest::LengthUnit;
use crate::progress::flow;
use crate::propose::find_grasp;
use crate::records::write_json;
use crate::{Error, Progress, Result, RunOptions, Stage, Twin, with_torque_cap};

/// An item with all that is needed to do it, as a scheduler carries it to a worker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Request {
    /// The item.
    pub item: Item,
    /// The folder that its name is relative to; errors leave it out, so that they are the same wherever it lies.
    pub base: PathBuf,
    /// The folder for grasps that are found.
    pub out: PathBuf,
    /// Names of the stages of a twin that are asked for; all if absent.
    pub stages: Option<Vec<String>>,
    /// Seed in place of those of manifests and lists.
    pub seed: Option<u64>,
    /// Address space that the process of the item may take, bytes; without a limit if absent.
    pub max_memory_bytes: Option<u64>,
}

/// Does items, and keeps the models of hands and the last mesh for the next ones.
#[derive(Default)]
pub struct Runner {
    options: RunOptions,
    hands: HashMap<(PathBuf, String, Option<u64>), Robot>,
    object: Option<((PathBuf, LengthUnit, String), Object)>,
}

impl Runner {
    /// A runner that has nothing loaded. `options` say who writes the reports of twins; their stages are those of each request.
    pub fn new(options: RunOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// Does an item; what it has made stays, and doing it again finds that. The record tells what the item took, but for the memory, which is
    /// the most that this process has held for any.
    ///
    /// # Errors
    /// Only [`Error::Stopped`] if `progress` stopped it, and [`Error::Busy`] if somebody else works on it. Whatever else goes wrong is a
    /// failed row.
    pub fn run(&mut self, request: &Request, progress: &dyn Progress) -> Result<Entry> {
        let (begun, before) = (Instant::now(), usage::core_seconds());
        let item = &request.item;
        let made = match &item.task {
            Task::Twin(folder) => twin(item, folder, request, &self.options, progress),
            Task::Find(task) => self.find(item, task, request, progress),
        };
        let row = match made {
            Ok(row) => row,
            Err(error @ (Error::Stopped | Error::Busy { .. })) => return Err(error),
            Err(error) => request.failed_row(&error.with_causes()),
        };
        let run = RunRecord {
            core_seconds: usage::core_seconds().zip(before).map(|(now, before)| now - before),
            peak_memory_bytes: usage::peak_memory_bytes(),
            threads: rayon::current_num_threads(),
            ..RunRecord::ending_now(begun)
        };
        Ok(Entry { row, run })
    }

    fn find(&mut self, item: &Item, task: &FindTask, request: &Request, progress: &dyn Progress) -> Result<Row> {
        let (path, inputs_sha256) = (request.search_path()?, request.search_inputs(task)?);
        let seed = item.seed(request.seed);
        if let Some(known) = SearchFile::current(&path, &inputs_sha256) {
            return Ok(Row::of_search(item, task, seed, &known));
        }
        let friction = task.friction.unwrap_or(ASSUMED_FRICTION);
        let hand = self.hand(task, &request.base)?;
        let object = self.object(task)?.with_mass(task.mass_kg);
        let object = Object { friction, ..object };
        progress.begin("find", None);
        let found = find_grasp(&object, &hand, &task.options(seed), &|_| flow(progress));
        progress.end();
        if progress.is_stopped() {
            return Err(Error::Stopped);
        }
        let found = found?;
        let mesh = fsutil::relative_path(&task.mesh, &request.base);
        let file = SearchFile {
            schema: search::SCHEMA,
            inputs_sha256,
            mesh: mesh.to_string_lossy().into_owned(),
            mass_kg: task.mass_kg,
            friction,
            grip_force_n: found.as_ref().map(|f| f.grip_force_n),
            held: found.as_ref().map(|f| f.held),
            verdicts: found.as_ref().map(|f| f.verdicts.clone()),
            grasp: found.map(|f| f.grasp),
        };
        write_json(&path, &file)?;
        Ok(Row::of_search(item, task, seed, &file))
    }

    fn hand(&mut self, task: &FindTask, base: &Path) -> Result<Robot> {
        let key = (base.to_path_buf(), task.hand.clone(), task.torque_cap_nm.map(f64::to_bits));
        if let Some(hand) = self.hands.get(&key) {
            return Ok(hand.clone());
        }
        let hand = with_torque_cap(Robot::resolve(&task.hand, base)?, task.torque_cap_nm)?;
        self.hands.insert(key, hand.clone());
        Ok(hand)
    }

    /// The object of a task's mesh, at a mass and friction of its own.
    fn object(&mut self, task: &FindTask) -> Result<Object> {
        let key = (task.mesh.clone(), task.unit, digest_of(&fsutil::read_bytes(&task.mesh)?));
        if let Some((_, object)) = self.object.as_ref().filter(|(known, _)| *known == key) {
            return Ok(object.clone());
        }
        let mut options = AssetOptions::default();
        options.unit = task.unit.into();
        let object = build_asset(&task.mesh, &options)?.to_object("object")?;
        self.object = Some((key, object.clone()));
        Ok(object)
    }
}

impl Item {
    /// The seed that an item without a manifest has.
    pub(super) fn seed(&self, given: Option<u64>) -> u64 {
        match &self.task {
            Task::Twin(folder) => given.or_else(|| Some(Twin::open(folder).ok()?.seed)).unwrap_or_default(),
            Task::Find(task) => given.unwrap_or(task.seed),
        }
    }
}

impl Request {
    /// The options of a twin's run.
    fn options(&self, options: &RunOptions) -> Result<RunOptions> {
        let options = options.clone();
        match &self.stages {
            Some(names) => Ok(options.with_stages(&stages(names)?)),
            None => Ok(options),
        }
    }

    /// Whether the item is done, and as it was left.
    pub(super) fn is_current(&self, options: &RunOptions) -> Result<bool> {
        match &self.item.task {
            Task::Twin(folder) => Twin::open(folder)?.with_seed(self.seed).is_current(&self.options(options)?),
            Task::Find(task) => Ok(SearchFile::current(&self.search_path()?, &self.search_inputs(task)?).is_some()),
        }
    }

    /// The file of what a search finds.
    fn search_path(&self) -> Result<PathBuf> {
        Ok(fsutil::output_path(&self.out, &format!("grasps/{}.json", self.item.name))?)
    }

    /// Digest of all that a search depends on.
    fn search_inputs(&self, task: &FindTask) -> Result<String> {
        // Where the mesh lies changes nothing.
        let settings = FindTask { mesh: PathBuf::new(), ..task.clone() };
        let inputs = Inputs::new(self.seed.unwrap_or(task.seed)).setting("find", &settings)?.file(&task.mesh)?;
        let hand = self.base.join(&task.hand);
        Ok(if hand.is_file() { inputs.file(&hand)? } else { inputs }.digest())
    }

    /// The entry of an item whose process ended without one; `reason` says why.
    pub fn failed(&self, reason: &str) -> Entry {
        Entry { row: self.failed_row(reason), run: RunRecord::ending_now(Instant::now()) }
    }

    fn failed_row(&self, reason: &str) -> Row {
        Row::failed(&self.item, self.item.seed(self.seed), self.without_base(reason))
    }

    /// A message with the folder of the batch left out of its paths.
    fn without_base(&self, message: &str) -> String {
        let folder = format!("{}/", self.base.display());
        let mut short = String::new();
        let mut rest = message;
        while let Some(at) = rest.find(&folder) {
            let (before, from) = rest.split_at(at);
            short += before;
            // Where a path begins, and not in the middle of another one.
            let begins = !short.ends_with(|c: char| c.is_alphanumeric() || "/._-".contains(c));
            let (name, after) = from.split_at(folder.len());
            short += if begins { "" } else { name };
            rest = after;
        }
        short + rest
    }
}

/// Stages by their names.
pub(super) fn stages(names: &[String]) -> Result<Vec<Stage>> {
    names.iter().map(|name| name.parse()).collect()
}

fn twin(item: &Item, folder: &Path, request: &Request, options: &RunOptions, progress: &dyn Progress) -> Result<Row> {
    let mut twin = Twin::open(folder)?.with_seed(request.seed);
    let options = request.options(options)?;
    twin.run(&options, progress)?;
    Row::of_twin(item, &twin, &twin.stages(&options))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_leave_out_where_the_batch_lies() {
        let short = |base: &str, message: &str| {
            let item = Item { name: "a".into(), task: Task::Twin(PathBuf::new()) };
            let (base, out) = (base.into(), PathBuf::new());
            Request { item, base, out, stages: None, seed: None, max_memory_bytes: None }.without_base(message)
        };
        assert_eq!(
            short("/lab/cups", "stage asset of /lab/cups/a: \"/lab/cups/a/x.obj\""),
            "stage asset of a: \"a/x.obj\""
        );
        assert_eq!(short(".", "./a/twin.toml names ../hands/leap.xml"), "a/twin.toml names ../hands/leap.xml");
        assert_eq!(short("cups", "cups/a, teacups/b, /lab/cups/c"), "a, teacups/b, /lab/cups/c");
    }
}
