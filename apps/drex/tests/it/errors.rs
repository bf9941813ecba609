//! One typical mistake for every subcommand: the message names what is wrong and says what to do, and nothing is left behind.
//! The subcommands are those that `--help` lists, so that a new one without a case here fails.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::common::{copy_tree, tin_data};

/// A mistake: subcommand, what else is written on the command line, exit status, words of the message.
type Case = (&'static str, &'static [&'static str], i32, &'static [&'static str]);

/// Paths are in a folder that holds `tin` (the bundled twin), `bare` (the same without grasps), `photos` (the bundled scan), an
/// `empty` folder, a cloud `points.ply`, and files `notes.txt` and `film.mov`.
const CASES: &[Case] = &[
    ("sfm", &["empty", "--out", "new"], 1, &["empty has no photos", "put 20 to 80 photos"]),
    ("masks", &["empty", "--out", "new"], 1, &["empty has no photos", "put 20 to 80 photos"]),
    (
        "masks",
        &["photos", "--out", "new", "--object", "middle"],
        2,
        &["\"middle\" is no click", "512,300@IMG_1001.jpg"],
    ),
    ("reconstruct", &["empty", "--out", "new"], 1, &["empty has no photos", "put 20 to 80 photos"]),
    ("asset", &["nowhere", "--out", "new"], 1, &["there is no nowhere", "give a mesh, a folder of photos"]),
    ("reconstruct", &["nowhere", "--out", "new"], 1, &["there is no nowhere", "give a folder with photos"]),
    ("reconstruct", &["film.mov", "--out", "new", "--ffmpeg", "no-such-ffmpeg"], 1, &["no-such-ffmpeg", "install"]),
    ("reconstruct", &["notes.txt", "--out", "new", "--ffmpeg", "no-such-ffmpeg"], 1, &["notes.txt is one file"]),
    ("asset", &["notes.txt", "--out", "new"], 1, &["notes.txt", "give a .stl, .obj"]),
    ("asset", &["photos", "--out", "new"], 1, &["photos has no scale", "--distance", "--scale"]),
    ("asset", &["photos", "--out", "new", "--distance", "A-Z=0.1"], 1, &["no mark is called \"Z\"", "use one of A, B"]),
    ("mesh check", &["empty"], 1, &["empty", "make the asset first"]),
    ("mesh convert", &["tin/scan/tin.obj", "tin.fbx"], 1, &["tin.fbx", "give a .stl, .obj"]),
    ("mesh picture", &["tin/scan/tin.obj", "--out", "tin.jpg"], 1, &["tin.jpg", "ends in .png"]),
    ("identify", &["tin/push"], 1, &["tin/push: ", "holds no push.toml", "`drex import` makes one"]),
    ("identify", &["tin", "--free", "friction"], 1, &["tin is a twin", "name one of its pushes"]),
    ("identify", &["tin/push/tilt", "--guess", "unobtainium"], 1, &["unobtainium", "choose one of", "cork"]),
    ("identify", &["tin/push/tilt", "--free", "speed"], 2, &["speed", "choose one of mass, friction"]),
    ("plan-push", &["tin/scan/tin.obj"], 1, &["state what the robot pushes with", "--max-force"]),
    ("calibrate-hand", &["empty", "--out", "new"], 1, &["empty", "give folders of pushes"]),
    ("calibrate-hand", &["tin/push", "--out", "new"], 1, &["tilt was not pushed by a logged hand", "give runs with"]),
    ("render", &["tin/scan/tin.obj", "--out", "new"], 1, &["tin.obj", "use .ply, .spz or .splat"]),
    ("render", &["points.ply", "--out", "new"], 1, &["points.ply", "may be a mesh or a point cloud"]),
    ("hands", &["nowhere.mp4", "--out", "new"], 1, &["nowhere.mp4 is no file", "give a video"]),
    ("hands", &["notes.txt", "--out", "new", "--python", "no-such-python"], 1, &["no-such-python", "install Python"]),
    (
        "retarget",
        &["clip.json", "--hand", "leep", "--out", "new"],
        1,
        &["\"leep\"", "one of the bundled models leap_right"],
    ),
    ("retarget", &["clip.json", "--hand", "leap"], 1, &["nothing to write", "give --out FILE"]),
    ("retarget", &["tin/truth.json", "--hand", "leap", "--out", "new"], 1, &["truth.json", "write drex-hand-demo/1"]),
    ("train", &["bare"], 1, &["bare/twin.toml has no [grasps] section", "name a file of demonstrated grasps"]),
    ("evaluate", &["tin/push"], 1, &["tin/push/twin.toml", "give a twin.toml or the folder that holds it"]),
    ("grasp", &["tin"], 1, &["tin has no policy yet", "run `drex train tin` first"]),
    ("grasp", &["tin", "--friction", "0.8,0.3"], 2, &["--friction", "expected the smaller number first"]),
    ("deploy", &["tin", "--emulate"], 1, &["tin has no policy yet", "run `drex train tin` first"]),
    ("deploy", &["tin", "--emulate", "--port", "here"], 2, &["--port <PATH>", "cannot be used with"]),
    ("hw ping", &["--hand", "leap", "--port", "nowhere"], 1, &["port nowhere", "plug the hand in"]),
    ("hw status", &["--hand", "allegro", "--port", "nowhere"], 1, &["nowhere is no file", "give the serial port"]),
    ("hw move", &["--hand", "leap", "--port", "notes.txt", "--to", "rest"], 1, &["port notes.txt", "is a serial port"]),
    (
        "hw move",
        &["--hand", "shadow", "--port", "x", "--to", "rest"],
        2,
        &["'shadow'", "possible values: leap, allegro"],
    ),
    ("hw guard", &[], 1, &["no guard for the port", "started by the program that drives the hand"]),
    ("hw record", &["--hand", "leap", "--port", "nowhere", "--out", "new"], 1, &["port nowhere", "plug the hand in"]),
    (
        "hw calibrate",
        &["notes.txt", "--source", "a scale", "--date", "2026-11-21", "--out", "new"],
        1,
        &["notes.txt", "no column current_ma", "the first line names the columns"],
    ),
    ("hw off", &["--hand", "leap", "--port", "nowhere"], 1, &["port nowhere", "plug the hand in"]),
    ("hw release", &["--hand", "leap", "--port", "nowhere", "--seconds", "99"], 2, &["give at most 10 s"]),
    (
        "hw calibrate-zero",
        &["--hand", "leap", "--port", "nowhere", "--pose", "knee=1", "--out", "new"],
        1,
        &["no joint \"knee\"", "there are if_mcp"],
    ),
    ("hw emulate", &["leap", "--wall", "knee=1", "--seconds", "1"], 1, &["no joint \"knee\"", "there are if_mcp"]),
    ("hw emulate", &["leap", "--link", "notes.txt", "--seconds", "1"], 1, &["notes.txt", "check that"]),
    ("run", &["nowhere"], 1, &["nowhere", "give a twin.toml or the folder that holds it"]),
    ("batch", &["empty"], 1, &["empty names no twin and no mesh", "a folder with a twin.toml"]),
    ("batch item", &[], 1, &["standard input holds no request", "`drex batch`"]),
    ("batch merge", &["notes.txt"], 1, &["notes.txt", "line 1"]),
    ("batch report", &["tin"], 1, &["tin is one twin", "use drex run"]),
    ("report", &["empty"], 1, &["empty/twin.toml", "docs/formats.md"]),
    ("demo", &["--out", "notes.txt"], 1, &["notes.txt", "choose another place"]),
    ("import d-rex", &["nowhere", "--out", "new"], 1, &["cannot list nowhere", "check the path"]),
    (
        "import d-rex",
        &["empty", "--out", "new"],
        1,
        &["no run.json in a folder below empty", "give the folder that holds runs/"],
    ),
    ("import allegro-run", &["empty", "--out", "new"], 1, &["empty/run.json", "check the path"]),
    ("import mujoco-push", &["empty", "--out", "new"], 1, &["empty/meta.json", "check the path"]),
    ("import mujoco-push", &["empty", "--poses", "perfect", "--out", "new"], 2, &["`perfect`", "noisy, hard or clean"]),
    ("doctor", &["please"], 2, &["unexpected argument 'please'"]),
    ("completions", &["tcsh"], 2, &["'tcsh'", "possible values: bash"]),
    ("man", &["--out", "notes.txt"], 1, &["--out notes.txt", "give a folder"]),
];

/// Runs the program in a folder.
fn drex_in(folder: &Path, arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_drex"));
    let output =
        command.current_dir(folder).args(arguments).env_remove("RUST_BACKTRACE").stdin(Stdio::null()).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap_or(-1), text(&output.stdout), text(&output.stderr))
}

/// Every subcommand that can be run without naming one of its own, as `drex help` and the help of groups list them.
fn subcommands(folder: &Path) -> BTreeSet<String> {
    // What `drex man` writes a page for is the tree of the parser itself, whatever the help looks like.
    let (code, _, message) = drex_in(folder, &["man", "--out", "pages"]);
    assert_eq!(code, 0, "{message}");
    let names: Vec<String> = fs::read_dir(folder.join("pages"))
        .unwrap()
        .map(|page| page.unwrap().file_name().into_string().unwrap())
        .map(|name| name.strip_suffix(".1").unwrap().to_owned())
        .collect();
    // `drex-hw-calibrate-zero` is not inside of `drex-hw-calibrate`; `drex batch` works without any of its subcommands.
    let is_group = |name: &str| {
        let page = fs::read_to_string(folder.join("pages").join(format!("{name}.1"))).unwrap();
        page.contains("<\\fIsubcommands\\fR>")
    };
    let leaves: BTreeSet<String> = names.iter().filter(|name| !is_group(name)).cloned().collect();
    fs::remove_dir_all(folder.join("pages")).unwrap();
    let listed = drex_in(folder, &["--help"]).1;
    for name in names.iter().filter_map(|n| n.strip_prefix("drex-")).filter(|n| !n.contains("-")) {
        assert!(listed.lines().any(|l| l.trim_start().starts_with(name)), "{name} is not in drex --help");
    }
    leaves
}

/// All files and folders below a folder, with the sizes of files.
fn listing(folder: &Path) -> BTreeSet<(PathBuf, u64)> {
    let mut all = BTreeSet::new();
    for entry in fs::read_dir(folder).unwrap() {
        let (path, about) = entry.map(|e| (e.path(), e.metadata().unwrap())).unwrap();
        all.insert((path.clone(), if about.is_file() { about.len() } else { 0 }));
        if about.is_dir() {
            all.extend(listing(&path));
        }
    }
    all
}

fn folder() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/demo");
    copy_tree(&tin_data(), &at("tin"));
    copy_tree(&tin_data(), &at("bare"));
    copy_tree(&demo.join("scan"), &at("photos"));
    fs::write(at("photos/marks.json"), r#"{"00.jpg": {"A": [10, 20], "B": [300, 20]}}"#).unwrap();
    fs::copy(demo.join("demos/clip_0.json"), at("clip.json")).unwrap();
    let manifest = fs::read_to_string(at("bare/twin.toml")).unwrap();
    fs::write(at("bare/twin.toml"), manifest.split("[grasps]").next().unwrap()).unwrap();
    fs::create_dir(at("empty")).unwrap();
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n";
    fs::write(at("points.ply"), ply).unwrap();
    fs::write(at("notes.txt"), "not a mesh, not a scan, not a video\n").unwrap();
    fs::write(at("film.mov"), [0, 0, 0, 20]).unwrap();
    dir
}

#[test]
fn every_subcommand_answers_a_mistake_with_what_to_do() {
    let dir = folder();
    let before = listing(dir.path());
    for (subcommand, rest, code, words) in CASES {
        let arguments: Vec<&str> = subcommand.split(' ').chain(rest.iter().copied()).collect();
        let call = format!("drex {}", arguments.join(" "));
        let (is, out, message) = drex_in(dir.path(), &arguments);
        assert_eq!(is, *code, "{call}: {message}");
        assert!(!message.contains("panicked") && !message.contains("RUST_BACKTRACE"), "{call}: {message}");
        // One line says what is wrong, after what was said about the input; wrong usage has hints below it.
        let error: Vec<&str> = message.lines().filter(|l| l.starts_with("error: ")).collect();
        assert_eq!(error.len(), 1, "{call}: {message}");
        if *code == 1 {
            assert_eq!(message.lines().last(), Some(error[0]), "{call}: {message}");
            assert!(out.is_empty(), "{call} answered {out}");
        }
        for word in *words {
            assert!(message.contains(word), "{call}: `{word}` is missing in: {message}");
        }
        let after = listing(dir.path());
        assert_eq!(after.symmetric_difference(&before).collect::<Vec<_>>(), Vec::<&(PathBuf, u64)>::new(), "{call}");
    }
}

#[test]
fn no_subcommand_is_without_a_case() {
    let dir = tempfile::tempdir().unwrap();
    let cases: BTreeSet<String> = CASES.iter().map(|(name, ..)| format!("drex-{}", name.replace(' ', "-"))).collect();
    assert_eq!(subcommands(dir.path()), cases);
}

#[test]
fn what_is_printed_for_shells_and_man_knows_every_subcommand() {
    let dir = tempfile::tempdir().unwrap();
    let page = drex_in(dir.path(), &["man"]).1;
    assert!(page.contains(".TH") && page.contains("plan\\-push"), "{page}");
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let (code, script, message) = drex_in(dir.path(), &["completions", shell]);
        assert_eq!(code, 0, "{message}");
        for name in ["calibrate-hand", "d-rex", "object-from-splat", "json"] {
            assert!(script.contains(name), "{shell}: {name} is missing");
        }
    }
}

#[test]
fn the_mistake_is_json_too_when_asked_for() {
    let dir = folder();
    let (code, out, _) = drex_in(dir.path(), &["grasp", "tin", "--json"]);
    let answer: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(code, 1);
    assert!(answer["error"].as_str().unwrap().contains("drex train tin"), "{answer}");
}

#[test]
#[cfg(not(feature = "wgpu"))]
fn a_gpu_that_this_build_has_not_is_refused_before_any_work() {
    let dir = folder();
    for command in ["asset", "reconstruct"] {
        let (code, _, error) = drex_in(dir.path(), &[command, "photos", "--out", "new", "--gpu"]);
        assert!(code == 1 && error.contains("built without a GPU") && error.contains("--features wgpu"), "{error}");
        assert!(!error.contains("cameras") && !dir.path().join("new").exists(), "{error}");
    }
}
