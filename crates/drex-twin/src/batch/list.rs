//! The items of a batch: a folder of twins, or a list that names twins and meshes.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};
use std::str::FromStr;

use drex_core::fsutil;
use drex_trial::FindOptions;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::error::{Context, refuse};
use crate::manifest::{LengthUnit, MANIFEST};
use crate::{Error, Result};

/// Endings of meshes in a folder.
const MESHES: [&str; 5] = ["obj", "stl", "ply", "glb", "gltf"];
/// Folders inside each other that are looked into.
const DEEPEST: usize = 8;

/// One thing to do, with a name of its own in its batch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Item {
    /// Its name: the path of its folder or mesh from where the list is, and what else tells it from others.
    pub name: String,
    /// What is done.
    pub task: Task,
}

/// What is done with an item.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Task {
    /// The stages of a twin folder.
    Twin(PathBuf),
    /// A grasp is looked for: [`propose::find_grasp`](crate::propose::find_grasp).
    Find(FindTask),
}

impl Task {
    /// The word for it in tables.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Twin(_) => "twin",
            Self::Find(_) => "find",
        }
    }
}

/// A mesh, a mass and a hand, of which a grasp is wanted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FindTask {
    /// The mesh.
    pub mesh: PathBuf,
    /// Unit of its coordinates.
    #[serde(default)]
    pub unit: LengthUnit,
    /// Mass of the object, kg.
    pub mass_kg: f64,
    /// Coefficient of friction between object and hand; [`drex_core::ASSUMED_FRICTION`] if absent.
    pub friction: Option<f64>,
    /// A bundled hand, or a URDF or MJCF file.
    pub hand: String,
    /// Most that any joint of the hand gives, N m; what its model says if absent.
    pub torque_cap_nm: Option<f64>,
    /// Seed of everything random.
    #[serde(default)]
    pub seed: u64,
    /// Effort of the search; the defaults of [`FindOptions`] if absent.
    pub candidates: Option<usize>,
    /// Grasps that are simulated before one is chosen.
    pub simulated: Option<usize>,
    /// Trials of the chosen grasp.
    pub trials: Option<usize>,
}

impl FindTask {
    /// The options of the search.
    pub(super) fn options(&self, seed: u64) -> FindOptions {
        let mut options = FindOptions::default();
        options.seed = seed;
        options.candidates = self.candidates.unwrap_or(options.candidates);
        options.simulated = self.simulated.unwrap_or(options.simulated);
        options.trials = self.trials.unwrap_or(options.trials);
        options
    }
}

/// One of several parts of a batch: which one, from 0, and of how many.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    index: u64,
    count: u64,
}

impl Shard {
    /// Whether an item of this name belongs to it: by the digest of the name, so that neither order nor items that are added change where the
    /// others belong.
    pub fn has(self, name: &str) -> bool {
        let digest = Sha256::digest(name.as_bytes());
        let first = digest.iter().take(8).fold(0_u64, |number, byte| number << 8 | u64::from(*byte));
        first % self.count == self.index
    }

    /// Name of its folder.
    pub(super) fn folder(self) -> String {
        format!("{}-of-{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = Error;

    /// Reads `I/N`: part I of N, from 0.
    fn from_str(text: &str) -> Result<Self> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((index, count)) if index < count => Ok(Self { index, count }),
            _ => refuse!("\"{text}\" is no shard: give I/N, such as 0/4 to 3/4 for four of them"),
        }
    }
}

/// A list file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ListFile {
    /// Version of this format: 1.
    schema: u32,
    /// Twin folders, or folders of them.
    #[serde(default)]
    twins: Vec<PathBuf>,
    /// Meshes to find grasps for.
    #[serde(default)]
    grasps: Vec<Grid>,
}

/// Meshes, masses, hands and seeds, each with each.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Grid {
    /// Files, or folders of them.
    meshes: Vec<PathBuf>,
    #[serde(default)]
    unit: LengthUnit,
    masses_kg: Vec<f64>,
    hands: Vec<String>,
    friction: Option<f64>,
    torque_cap_nm: Option<f64>,
    #[serde(default = "one_seed")]
    seeds: Vec<u64>,
    candidates: Option<usize>,
    simulated: Option<usize>,
    trials: Option<usize>,
}

fn one_seed() -> Vec<u64> {
    vec![0]
}

/// The folder that names are relative to, and the items of `path`, by name: twins in a folder and in folders below it, or what a list says.
pub(super) fn items(path: &Path) -> Result<(PathBuf, Vec<Item>)> {
    let mut found = Found::default();
    let base = if path.is_dir() {
        if path.join(MANIFEST).exists() {
            refuse!("{} is one twin: give the folder above it, or use drex run", path.display());
        }
        found.twins_below(path, "", 0)?;
        path.to_path_buf()
    } else {
        let list: ListFile = fsutil::from_toml(path, &fsutil::read_text(path)?)?;
        if list.schema != 1 {
            refuse!("{}: schema = {} is not known; this drex reads schema = 1", path.display(), list.schema);
        }
        let base = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_path_buf();
        for twins in &list.twins {
            let name = &name_of(twins)?;
            if base.join(twins).join(MANIFEST).exists() || !base.join(twins).is_dir() {
                found.add(name.clone(), Task::Twin(base.join(twins)))?;
            } else {
                found.twins_below(&base.join(twins), name, 0)?;
            }
        }
        for grid in &list.grasps {
            found.grid(grid, &base)?;
        }
        base
    };
    if found.0.is_empty() {
        refuse!("{} names no twin and no mesh: a twin is a folder with a {MANIFEST}", path.display());
    }
    Ok((base, found.0.into_iter().map(|(name, task)| Item { name, task }).collect()))
}

/// Items by their names.
#[derive(Default)]
struct Found(BTreeMap<String, Task>);

impl Found {
    fn add(&mut self, name: String, task: Task) -> Result<()> {
        match self.0.insert(name, task.clone()) {
            Some(other) if other != task => refuse!("two items have the same name: {other:?} and {task:?}; rename one"),
            _ => Ok(()),
        }
    }

    /// The twins below a folder whose name is `prefix`. What begins with a dot, and links to folders that are no twins, are left out.
    fn twins_below(&mut self, folder: &Path, prefix: &str, depth: usize) -> Result<()> {
        for path in listed(folder)? {
            let file_name = path.file_name().unwrap_or_default();
            if !path.is_dir() || file_name.as_encoded_bytes().starts_with(b".") {
                continue;
            }
            let name = name_of(&Path::new(prefix).join(file_name))?;
            if path.join(MANIFEST).exists() {
                self.add(name, Task::Twin(path))?;
            } else if !path.is_symlink() && depth < DEEPEST {
                self.twins_below(&path, &name, depth + 1)?;
            }
        }
        Ok(())
    }

    fn grid(&mut self, grid: &Grid, base: &Path) -> Result<()> {
        for mesh in &grid.meshes {
            let path = base.join(mesh);
            let files = if path.is_dir() { meshes_in(&path)? } else { vec![path] };
            for file in files {
                let stem = name_of(&fsutil::relative_path(&file, base).with_extension(""))?;
                for hand in &grid.hands {
                    let hand_name = Path::new(hand).file_stem().unwrap_or_default().to_string_lossy();
                    for mass_kg in &grid.masses_kg {
                        for seed in &grid.seeds {
                            let mut name = format!("{stem}-{hand_name}-{mass_kg}kg");
                            if grid.seeds.len() > 1 {
                                name += &format!("-seed{seed}");
                            }
                            let task = FindTask {
                                mesh: file.clone(),
                                unit: grid.unit,
                                mass_kg: *mass_kg,
                                friction: grid.friction,
                                hand: hand.clone(),
                                torque_cap_nm: grid.torque_cap_nm,
                                seed: *seed,
                                candidates: grid.candidates,
                                simulated: grid.simulated,
                                trials: grid.trials,
                            };
                            self.add(name, Task::Find(task))?;
                        }
                    }
                }
            }
        }
        Ok(())
    }
}

/// The meshes in a folder, by name.
fn meshes_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files = listed(folder)?;
    files.retain(|f| f.extension().is_some_and(|e| MESHES.iter().any(|ending| e.eq_ignore_ascii_case(ending))));
    if files.is_empty() {
        refuse!("{} holds no mesh: put .{} files there", folder.display(), MESHES.join(", ."));
    }
    Ok(files)
}

/// What lies in a folder, by name.
pub(super) fn listed(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot list {}", folder.display()))?;
    let mut paths: Vec<PathBuf> = entries
        .map(|entry| entry.map(|e| e.path()))
        .collect::<Result<_, _>>()
        .with_context(|| format!("cannot list {}", folder.display()))?;
    paths.sort();
    Ok(paths)
}

/// A path as a name, from its first folder that is one: results are put below a folder by it.
fn name_of(path: &Path) -> Result<String> {
    let parts = path.components().filter(|part| matches!(part, Component::Normal(_)));
    let name: PathBuf = parts.collect();
    Ok(name.to_str().with_context(|| format!("{} is not Unicode; rename it", path.display()))?.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_share_out_all_items_evenly_and_whatever_else_there_is() {
        let names: Vec<String> = (0..1000).map(|i| format!("cups/cup-{i}")).collect();
        for count in [1, 2, 4, 7] {
            let shards: Vec<Shard> = (0..count).map(|i| format!("{i}/{count}").parse().unwrap()).collect();
            for name in &names {
                assert_eq!(shards.iter().filter(|s| s.has(name)).count(), 1, "{name}");
            }
            for shard in &shards {
                let share = names.iter().filter(|name| shard.has(name)).count() * count;
                // Five standard deviations of a fair draw.
                assert!((800..=1200).contains(&share), "{shard:?}: {share}");
            }
        }
        // Other machines and later versions must share out alike; by the digests of another program.
        let first: Vec<&String> = names.iter().filter(|name| "0/100".parse::<Shard>().unwrap().has(name)).collect();
        assert_eq!(first[..2], ["cups/cup-33", "cups/cup-435"]);
        for wrong in ["", "1", "4/4", "-1/4", "0/0", "1/2/3", "a/b"] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn twins_are_found_below_folders_and_named_by_their_paths() {
        let dir = tempfile::tempdir().unwrap();
        let lists = dir.path().join("lists");
        for twin in ["cups/a", "cups/deep/b", "cups/.hidden/c", "cups/a/inner", "can"] {
            std::fs::create_dir_all(dir.path().join(twin)).unwrap();
            std::fs::write(dir.path().join(twin).join(MANIFEST), "").unwrap();
        }
        std::fs::create_dir_all(dir.path().join("cups/empty")).unwrap();
        let names = |path: &Path| items(path).map(|(_, items)| items.into_iter().map(|i| i.name).collect::<Vec<_>>());
        assert_eq!(names(&dir.path().join("cups")).unwrap(), ["a", "deep/b"]);

        std::fs::create_dir(&lists).unwrap();
        let list = lists.join("all.toml");
        std::fs::write(&list, "schema = 1\ntwins = [\"../cups\", \"../can\", \"../nowhere\"]").unwrap();
        // One that is not there fails when it is run, by its name.
        assert_eq!(names(&list).unwrap(), ["can", "cups/a", "cups/deep/b", "nowhere"]);
        std::fs::write(&list, "schema = 1\ntwins = [\"../can\", \"can\"]").unwrap();
        assert!(names(&list).unwrap_err().to_string().contains("two items have the same name"));
    }

    #[cfg(unix)]
    #[test]
    fn a_link_to_a_twin_counts_and_a_link_to_a_folder_does_not() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("twins");
        std::fs::create_dir_all(dir.path().join("elsewhere/a")).unwrap();
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(dir.path().join("elsewhere/a").join(MANIFEST), "").unwrap();
        std::os::unix::fs::symlink(dir.path().join("elsewhere/a"), folder.join("linked")).unwrap();
        // A circle.
        std::os::unix::fs::symlink(&folder, folder.join("self")).unwrap();
        let (_, items) = items(&folder).unwrap();
        assert_eq!(items.iter().map(|i| i.name.as_str()).collect::<Vec<_>>(), ["linked"]);
    }
}
