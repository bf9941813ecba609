//! One item after the other in this process: what a worker does.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use drex_core::{ASSUMED_FRICTION, Object, fsutil};
use drex_grasp::Grasp;
use drex_mesh::{AssetOptions, build_asset};
use drex_robot::Robot;
use drex_trial::{TriedGrasp, Verdict, find_grasp_watched};
use serde::{Deserialize, Serialize};

use super::list::{FindTask, Item, Task};
use super::row::Row;
use crate::lock::{Inputs, digest_of};
use crate::progress::flow;
use crate::records::write_json;
use crate::{Error, Progress, Result, RunOptions, Stage, Twin, with_torque_cap};

/// Version of the layout of a found grasp's file.
const SCHEMA: u32 = 1;

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

/// What became of a request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// What was found, or why nothing was.
    pub row: Row,
    /// Digest of what it depends on, where no lock file keeps it.
    pub inputs_sha256: Option<String>,
}

/// `grasps/NAME.json` of a batch: a grasp that was found.
#[derive(Debug, Serialize)]
struct FoundGrasp<'a> {
    schema: u32,
    mesh: &'a str,
    mass_kg: f64,
    friction: f64,
    /// Absent if none holds; so is all that follows.
    grasp: Option<&'a Grasp>,
    grip_force_n: Option<f64>,
    held: Option<usize>,
    verdicts: Option<&'a [Verdict]>,
}

/// Does items, and keeps the models of hands and the last mesh for the next ones.
#[derive(Default)]
pub struct Runner {
    options: RunOptions,
    hands: HashMap<(String, Option<u64>), Robot>,
    object: Option<((PathBuf, String), Object)>,
}

impl Runner {
    /// A runner that has nothing loaded. `options` say who writes the reports of twins; their stages are those of each request.
    pub fn new(options: RunOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// Does an item; what it has made stays, and doing it again finds that.
    ///
    /// # Errors
    /// Only [`Error::Stopped`] if `progress` stopped it, and [`Error::Busy`] if somebody else works on it. Whatever else goes wrong is the
    /// answer.
    pub fn run(&mut self, request: &Request, progress: &dyn Progress) -> Result<Answer> {
        let item = &request.item;
        let made = match &item.task {
            Task::Twin(folder) => twin(item, folder, request, &self.options, progress).map(|row| (row, None)),
            Task::Find(task) => self.find(item, task, request, progress).map(|(row, digest)| (row, Some(digest))),
        };
        Ok(match made {
            Ok((row, inputs_sha256)) => Answer { row, inputs_sha256 },
            Err(error @ (Error::Stopped | Error::Busy { .. })) => return Err(error),
            Err(error) => {
                let message = request.without_base(&error.with_causes());
                Answer { row: Row::failed(item, item.seed(request.seed), message), inputs_sha256: None }
            }
        })
    }

    fn find(
        &mut self,
        item: &Item,
        task: &FindTask,
        request: &Request,
        progress: &dyn Progress,
    ) -> Result<(Row, String)> {
        let digest = search_inputs(task, request.seed)?;
        let (friction, seed) = (task.friction.unwrap_or(ASSUMED_FRICTION), item.seed(request.seed));
        let hand = self.hand(task, &request.base)?;
        let object = self.object(task)?.with_mass(task.mass_kg);
        let object = Object { friction, ..object };
        progress.begin("find", None);
        let found = find_grasp_watched(&object, &hand, &task.options(seed), &|_| flow(progress));
        progress.end();
        if progress.is_stopped() {
            return Err(Error::Stopped);
        }
        let found = found?;
        write_found(request, task, friction, found.as_ref())?;
        Ok((Row::of_search(item, task, friction, seed, found.as_ref()), digest))
    }

    fn hand(&mut self, task: &FindTask, base: &Path) -> Result<Robot> {
        let key = (task.hand.clone(), task.torque_cap_nm.map(f64::to_bits));
        if let Some(hand) = self.hands.get(&key) {
            return Ok(hand.clone());
        }
        let hand = with_torque_cap(Robot::resolve(&task.hand, base)?, task.torque_cap_nm)?;
        self.hands.insert(key, hand.clone());
        Ok(hand)
    }

    /// The object of a task's mesh, at a mass and friction of its own.
    fn object(&mut self, task: &FindTask) -> Result<Object> {
        let key = (task.mesh.clone(), digest_of(&fsutil::read_bytes(&task.mesh)?));
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

    /// Whether the item that this entry tells of is still as it was left.
    pub(super) fn is_current(&self, inputs_sha256: Option<&str>, options: &RunOptions) -> Result<bool> {
        match &self.item.task {
            Task::Twin(folder) => Twin::open(folder)?.with_seed(self.seed).is_current(&self.options(options)?),
            Task::Find(task) => {
                let found = found_path(self)?.is_file();
                Ok(found && inputs_sha256 == Some(search_inputs(task, self.seed)?.as_str()))
            }
        }
    }

    /// A message with the folder of the batch left out of its paths.
    pub(super) fn without_base(&self, message: &str) -> String {
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

/// Digest of all that a search depends on.
fn search_inputs(task: &FindTask, seed: Option<u64>) -> Result<String> {
    // Where the mesh lies changes nothing.
    let settings = FindTask { mesh: PathBuf::new(), ..task.clone() };
    Ok(Inputs::new(seed.unwrap_or(task.seed)).setting("find", &settings)?.file(&task.mesh)?.digest())
}

fn found_path(request: &Request) -> Result<PathBuf> {
    Ok(fsutil::output_path(&request.out, &format!("grasps/{}.json", request.item.name))?)
}

fn write_found(request: &Request, task: &FindTask, friction: f64, found: Option<&TriedGrasp>) -> Result<()> {
    let mesh = fsutil::relative_path(&task.mesh, &request.base);
    let file = FoundGrasp {
        schema: SCHEMA,
        mesh: &mesh.to_string_lossy(),
        mass_kg: task.mass_kg,
        friction,
        grasp: found.map(|f| &f.grasp),
        grip_force_n: found.map(|f| f.grip_force_n),
        held: found.map(|f| f.held),
        verdicts: found.map(|f| f.verdicts.as_slice()),
    };
    write_json(&found_path(request)?, &file)
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
