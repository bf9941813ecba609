//! Many objects: processes, failures, limits, kills, shards.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::{Run, assert_same_folder, copy_tree, drex, edit, small_twin, tree};

/// Stages that take a moment.
const QUICK: [&str; 2] = ["--stages", "identify,asset"];

/// A folder of so many twins of different seeds and masses, put on a scale each, so that a stage takes a moment.
fn twins(count: usize) -> (tempfile::TempDir, PathBuf) {
    let (dir, small) = small_twin(2);
    let folder = dir.path().join("many");
    for number in 0..count {
        // Names whose order is not that of their numbers, and one folder deeper.
        let twin = folder.join(format!("row{}/tin-{number}", number % 2));
        copy_tree(&small, &twin);
        let weighed = format!("weighed_kg = 0.2{number:02}");
        edit(&twin.join("twin.toml"), "identify = [\"push/tilt\"]\nprior_kg = 0.5", &weighed);
        edit(&twin.join("twin.toml"), "seed = 1", &format!("seed = {number}"));
    }
    (dir, folder)
}

fn batch(folder: &Path, arguments: &[&str]) -> Run {
    drex(["batch".as_ref(), folder.as_os_str()].into_iter().chain(arguments.iter().map(std::convert::AsRef::as_ref)))
}

fn quick(folder: &Path, arguments: &[&str]) -> Run {
    batch(folder, &[&QUICK, arguments].concat())
}

fn results(folder: &Path) -> String {
    fs::read_to_string(folder.join("batch/results.csv")).unwrap()
}

/// The columns of these names, row by row.
fn columns(csv: &str, names: &[&str]) -> Vec<Vec<String>> {
    let mut lines = csv.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let places: Vec<usize> = names.iter().map(|name| header.iter().position(|h| h == name).unwrap()).collect();
    // Errors, which may hold commas, stand last.
    lines.map(|l| l.split(',').collect::<Vec<_>>()).map(|l| places.iter().map(|p| l[*p].to_owned()).collect()).collect()
}

#[test]
fn what_fails_is_named_and_stops_nothing_and_what_is_done_is_not_done_again() {
    let (_dir, folder) = twins(5);
    edit(&folder.join("row0/tin-2/twin.toml"), "friction = 0.5", "friction = -1");
    fs::write(folder.join("row1/tin-3/scan/tin.obj"), "v 0 0").unwrap();
    let run = quick(&folder, &["--jobs", "2", "--json"]);
    assert_eq!(run.code, 1, "{}", run.stderr);
    let answer = run.json();
    assert_eq!((&answer["items"], &answer["done"], &answer["failed"]), (&5.into(), &3.into(), &2.into()), "{answer}");
    let reason = |name: &str| answer["failures"][name].as_str().unwrap().to_owned();
    // Where the folder lies is not part of a result.
    assert!(reason("row0/tin-2").starts_with("row0/tin-2/twin.toml: [object] friction = -1"), "{answer}");
    assert!(reason("row1/tin-3").contains("tin.obj") && !reason("row1/tin-3").contains("many"), "{answer}");
    let table = columns(&results(&folder), &["name", "status", "mass_kg", "mass_source", "seed"]);
    assert_eq!(table[0], ["row0/tin-0", "done", "0.2", "weighed", "0"]);
    assert_eq!(table[1][..2], ["row0/tin-2", "failed"]);
    assert_eq!(table[4][..2], ["row1/tin-3", "failed"]);
    assert!(folder.join("row0/tin-4/asset/object.xml").is_file() && !folder.join("row0/tin-4/grasps").exists());

    // Nothing is left to do, and the failures stay known.
    let before = tree(&folder);
    let again = quick(&folder, &[]);
    assert_eq!(again.code, 1, "{}", again.stderr);
    for words in ["3 are up to date", "2 failed before; --retry-failed tries them again"] {
        assert!(again.stderr.contains(words), "{words}: {}", again.stderr);
    }
    assert!(again.stdout.contains("failed  row0/tin-2: "), "{}", again.stdout);
    let after = tree(&folder);
    assert_eq!(before.keys().collect::<Vec<_>>(), after.keys().collect::<Vec<_>>());
    let changed: Vec<_> = before.iter().filter(|(name, bytes)| after[*name] != **bytes).map(|(name, _)| name).collect();
    assert!(changed.is_empty(), "{changed:?}");

    // One is mended, and tried again; one that was done is made anew when its input changes.
    edit(&folder.join("row0/tin-2/twin.toml"), "friction = -1", "friction = 0.5");
    fs::copy(folder.join("row0/tin-2/scan/tin.obj"), folder.join("row1/tin-3/scan/tin.obj")).unwrap();
    edit(&folder.join("row0/tin-0/twin.toml"), "weighed_kg = 0.200", "weighed_kg = 0.3");
    let mended = quick(&folder, &["--retry-failed"]);
    assert_eq!(mended.code, 0, "{}", mended.stderr);
    assert!(mended.stderr.contains("2 are up to date"), "{}", mended.stderr);
    let table = columns(&results(&folder), &["status", "mass_kg"]);
    assert_eq!(table, [["done", "0.3"], ["done", "0.202"], ["done", "0.204"], ["done", "0.201"], ["done", "0.203"]]);
    let attempts = columns(&fs::read_to_string(folder.join("batch/runs.csv")).unwrap(), &["name", "attempts"]);
    assert_eq!(attempts[0], ["row0/tin-0", "2"]);
    assert_eq!(attempts[2], ["row0/tin-4", "1"]);
}

#[test]
fn jobs_and_shards_change_no_byte() {
    let (dir, folder) = twins(6);
    fs::write(folder.join("row0/tin-4/twin.toml"), "no toml [").unwrap();
    let [sharded, other] = ["sharded", "other"].map(|name| {
        copy_tree(&folder, &dir.path().join(name));
        dir.path().join(name)
    });
    assert_eq!(quick(&folder, &["--jobs", "3"]).code, 1);
    assert_eq!(quick(&other, &["--jobs", "1", "--threads", "1"]).code, 1);

    // Three processes at once, each with its part; a part may have nothing to do.
    let parts = ["0/3", "1/3", "2/3"].map(|shard| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_drex"));
        command.arg("batch").arg(&sharded).args(QUICK).args(["--shard", shard]);
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    });
    let codes: Vec<i32> = parts.map(|mut part| part.wait().unwrap().code().unwrap()).into();
    assert_eq!(codes.iter().sum::<i32>(), 1, "the part with the broken one fails: {codes:?}");
    assert!(!sharded.join("batch/results.csv").exists());
    let merged = drex(["batch".as_ref(), "merge".as_ref(), sharded.as_os_str()]);
    assert_eq!(merged.code, 1, "{}", merged.stderr);
    assert!(merged.stdout.contains("5 of 6 done, 1 failed, 0 not done yet"), "{}", merged.stdout);

    assert_eq!(results(&folder), results(&other));
    assert_eq!(results(&folder), results(&sharded));
    for twin in ["row0/tin-0", "row1/tin-1", "row0/tin-2", "row1/tin-3", "row1/tin-5"] {
        assert_same_folder(&folder.join(twin), &other.join(twin));
        assert_same_folder(&folder.join(twin), &sharded.join(twin));
    }
    // A part that is lost is missed, and done by whoever comes.
    let lost = (0..3).map(|i| sharded.join(format!("batch/shards/{i}-of-3"))).find(|f| f.join("results.csv").exists());
    fs::remove_dir_all(lost.unwrap()).unwrap();
    let merged = drex(["batch".as_ref(), "merge".as_ref(), sharded.as_os_str()]);
    assert_eq!(merged.code, 1);
    assert!(!merged.stdout.contains(" 0 not done yet"), "{}", merged.stdout);
    quick(&sharded, &[]);
    assert_eq!(results(&folder), results(&sharded));
}

#[test]
fn wrong_usage_and_folders_without_items_are_told() {
    let (dir, folder) = twins(1);
    for (arguments, words) in [
        (vec!["--shard", "3/3"], "0/4 to 3/4"),
        (vec!["--stages", "identfy"], "there is no stage"),
        (vec!["--jobs", "0"], "--jobs"),
    ] {
        let run = batch(&folder, &arguments);
        assert!(run.code == 2 && run.stderr.contains(words), "{}", run.stderr);
    }
    fs::create_dir(dir.path().join("empty")).unwrap();
    batch(&dir.path().join("empty"), &[]).fails_with(&["names no twin and no mesh"]);
    batch(&folder.join("row0/tin-0"), &[]).fails_with(&["is one twin", "drex run"]);
    batch(&dir.path().join("nowhere.toml"), &[]).fails_with(&["nowhere.toml"]);
    let list = dir.path().join("list.toml");
    for (text, words) in [
        ("schema = 2\n", vec!["list.toml", "schema = 2"]),
        ("schema = 1\ntwin = []\n", vec!["list.toml", "twin"]),
        ("schema = 1\n", vec!["names no twin"]),
        (
            "schema = 1\n[[grasps]]\nmeshes = [\"empty\"]\nmasses_kg = [1]\nhands = [\"leap_right\"]\n",
            vec!["holds no mesh"],
        ),
    ] {
        fs::write(&list, text).unwrap();
        batch(&list, &[]).fails_with(&words);
    }
}

/// Waits until the condition holds.
fn wait_for(what: &str, mut condition: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !condition() {
        assert!(begun.elapsed() < Duration::from_secs(60), "{what} did not happen");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[cfg(target_os = "linux")]
fn children(pid: u32) -> Vec<u32> {
    let tasks =
        fs::read_dir(format!("/proc/{pid}/task")).map_or_else(|_| Vec::new(), |tasks| tasks.flatten().collect());
    let lists = tasks.iter().filter_map(|task| fs::read_to_string(task.path().join("children")).ok());
    lists.flat_map(|l| l.split_whitespace().filter_map(|p| p.parse().ok()).collect::<Vec<u32>>()).collect()
}

/// Whether the process runs: one that ended and that nobody asked for has no command line any more.
#[cfg(target_os = "linux")]
fn lives(pid: u32) -> bool {
    fs::read(format!("/proc/{pid}/cmdline")).is_ok_and(|line| !line.is_empty())
}

#[cfg(target_os = "linux")]
fn started(folder: &Path, arguments: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_drex"));
    command.arg("batch").arg(folder).args(arguments);
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

#[cfg(target_os = "linux")]
#[test]
fn workers_do_not_outlive_a_batch_that_is_killed_and_the_next_run_ends_with_the_same_bytes() {
    let (dir, folder) = twins(4);
    let arguments = ["--stages", "asset", "--jobs", "2", "--threads", "2"];
    let undisturbed = dir.path().join("undisturbed");
    copy_tree(&folder, &undisturbed);
    for number in 0..4 {
        // With something to identify, so that a worker takes seconds.
        for root in [&folder, &undisturbed] {
            let manifest = root.join(format!("row{}/tin-{number}/twin.toml", number % 2));
            edit(&manifest, &format!("weighed_kg = 0.2{number:02}"), "identify = [\"push/tilt\"]\nprior_kg = 0.5");
        }
    }
    assert_eq!(batch(&undisturbed, &arguments).code, 0);
    for entries in [0, 1, 2] {
        let mut parent = started(&folder, &arguments);
        let journal = folder.join("batch/journal.jsonl");
        let lines = || fs::read_to_string(&journal).map_or(0, |text| text.lines().count());
        wait_for("work", || children(parent.id()).len() == 2 && lines() >= entries);
        let workers = children(parent.id());
        parent.kill().unwrap();
        parent.wait().unwrap();
        wait_for("the end of the workers", || !workers.iter().any(|w| lives(*w)));
    }
    // What a kill left half-written is cut off.
    let mut journal = fs::read(folder.join("batch/journal.jsonl")).unwrap();
    let whole = journal.clone();
    journal.extend(b"{\"row\":{\"name\":\"row0");
    fs::write(folder.join("batch/journal.jsonl"), journal).unwrap();
    assert_eq!(batch(&folder, &arguments).code, 0);
    let ended = fs::read(folder.join("batch/journal.jsonl")).unwrap();
    assert!(ended.starts_with(&whole) && !String::from_utf8_lossy(&ended).contains("\"row0{"));
    assert_eq!(results(&folder), results(&undisturbed));
    for twin in ["row0/tin-0", "row1/tin-1", "row0/tin-2", "row1/tin-3"] {
        assert_same_folder(&folder.join(twin), &undisturbed.join(twin));
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_worker_that_dies_or_takes_too_much_is_a_failure_of_its_item() {
    let (_dir, folder) = twins(2);
    // One of them takes seconds.
    edit(&folder.join("row0/tin-0/twin.toml"), "weighed_kg = 0.200", "identify = [\"push/tilt\"]\nprior_kg = 0.5");
    let mut parent = started(&folder, &["--stages", "evaluate", "--jobs", "1"]);
    wait_for("a worker", || children(parent.id()).len() == 1);
    let killed = Command::new("kill").args(["-9", &children(parent.id())[0].to_string()]).status().unwrap();
    assert!(killed.success());
    assert_eq!(parent.wait().unwrap().code(), Some(1));
    let table = results(&folder);
    assert!(table.contains("its process ended without an answer (signal: 9 (SIGKILL))"), "{table}");
    assert_eq!(columns(&table, &["name", "status"]), [["row0/tin-0", "failed"], ["row1/tin-1", "done"]]);

    // 60 MB of address space are too few for a hand's surface; the limit is said.
    let limited = ["--stages", "evaluate", "--retry-failed", "--jobs", "1", "--threads", "1", "--max-memory", "0.06"];
    let run = batch(&folder, &limited);
    assert_eq!(run.code, 1, "{}", run.stderr);
    let limit = "it takes more than 0.06 GB of memory, which is the limit of an item; raise it with --max-memory GB";
    assert!(results(&folder).contains(limit), "{}", results(&folder));
    let run = batch(&folder, &["--stages", "evaluate", "--retry-failed", "--max-seconds", "0.2"]);
    assert!(run.code == 1 && results(&folder).contains("the command has taken 0.2 s"), "{}", results(&folder));
    assert_eq!(batch(&folder, &["--stages", "evaluate", "--retry-failed"]).code, 0);
}

#[test]
fn what_somebody_else_works_on_comes_later_or_is_left() {
    let (_dir, folder) = twins(3);
    let held = fs::File::open(folder.join("row0/tin-0/twin.toml")).unwrap();
    held.lock().unwrap();
    let run = quick(&folder, &["--jobs", "1", "--json"]);
    assert_eq!(run.code, 75, "{}", run.stderr);
    assert!(run.stderr.contains("row0/tin-0 comes later: ") && run.stderr.contains("row0/tin-0 was not done: "));
    assert_eq!((&run.json()["done"], &run.json()["pending"]), (&2.into(), &1.into()));
    drop(held);
    assert_eq!(quick(&folder, &[]).code, 0);

    let held = fs::File::open(folder.join("batch/journal.jsonl")).unwrap();
    held.lock().unwrap();
    let run = quick(&folder, &["--retry-failed"]);
    assert!(run.code == 75 && run.stderr.contains("another drex is at work on"), "{}: {}", run.code, run.stderr);
    assert_eq!(quick(&folder, &["--shard", "0/2"]).code, 0, "a part is written elsewhere");
}

#[test]
fn grasps_are_found_for_meshes_masses_and_hands() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("meshes")).unwrap();
    let corner = |i: usize| [i & 1, i >> 1 & 1, i >> 2].map(|side| if side == 1 { "25" } else { "-25" }).join(" ");
    let corners: String = (0..8).map(|i| format!("v {}\n", corner(i))).collect();
    let faces = "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n";
    fs::write(dir.path().join("meshes/cube.obj"), format!("{corners}{faces}")).unwrap();
    fs::write(dir.path().join("meshes/note.txt"), "no mesh").unwrap();
    let list = dir.path().join("objects.toml");
    let text = "schema = 1\n[[grasps]]\nmeshes = [\"meshes\"]\nunit = \"mm\"\nmasses_kg = [0.1, 50.0]\nfriction = 0.5\n\
                hands = [\"leap_right\", \"nobody\"]\ncandidates = 2000\nsimulated = 4\ntrials = 2\n";
    fs::write(&list, text).unwrap();
    let run = batch(&list, &["--json", "--jobs", "2"]);
    assert_eq!(run.code, 1, "{}", run.stderr);
    let results_of = |list: &Path| fs::read_to_string(list.with_extension("batch").join("results.csv")).unwrap();
    let table = results_of(&list);
    let rows = columns(&table, &["name", "status", "mass_kg", "verdict", "hand", "trials"]);
    assert_eq!(rows[0], ["meshes/cube-leap_right-0.1kg", "done", "0.1", "found", "leap_right", "2"]);
    // Nothing holds what weighs 50 kg: that is an answer.
    assert_eq!(rows[1], ["meshes/cube-leap_right-50kg", "done", "50.0", "none", "leap_right", ""]);
    assert_eq!([&rows[2][1], &rows[3][1]], ["failed", "failed"]);
    assert!(table.contains("nobody") && !table.contains(dir.path().to_str().unwrap()), "{table}");
    let found = dir.path().join("objects.batch/grasps/meshes/cube-leap_right-0.1kg.json");
    let grasp: serde_json::Value = serde_json::from_slice(&fs::read(&found).unwrap()).unwrap();
    assert_eq!((&grasp["mesh"], &grasp["grasp"]["hand"]), (&"meshes/cube.obj".into(), &"leap_right".into()));
    assert!(grasp["grip_force_n"].as_f64().unwrap() > 1.9, "{grasp}");

    // Up to date, until the file or a setting changes.
    let again = batch(&list, &[]);
    assert!(again.stderr.contains("2 are up to date"), "{}", again.stderr);
    // What a search found says from what, so that whoever does it again finds that.
    let when = |file: &Path| fs::metadata(file).unwrap().modified().unwrap();
    let before = when(&found);
    fs::remove_file(dir.path().join("objects.batch/journal.jsonl")).unwrap();
    let anew = batch(&list, &["--jobs", "2"]);
    assert!(anew.code == 1 && !anew.stderr.contains("up to date"), "{}", anew.stderr);
    assert_eq!((when(&found), results_of(&list)), (before, table));
    fs::remove_file(&found).unwrap();
    fs::write(&list, text.replace(", \"nobody\"", "").replace(", 50.0", "")).unwrap();
    let more = batch(&list, &[]);
    assert_eq!(more.code, 0, "{}", more.stderr);
    assert!(!more.stderr.contains("up to date") && found.is_file(), "{}", more.stderr);
}
