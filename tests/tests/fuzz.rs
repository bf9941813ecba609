//! Every reader on damaged inputs: the seeds, then mutations of them in an order that a seed fixes. None may panic, hang or take memory out
//! of proportion, and what they refuse they refuse with an error.
//!
//! A plain `cargo test` takes some hundred inputs per reader. `DREX_FUZZ_SECONDS=3` goes on for so many seconds per reader,
//! `DREX_FUZZ_SEED=7` begins elsewhere, `DREX_FUZZ_TARGET=glb` takes one reader alone. An input that fails is written to the folder
//! for temporary files, and the message names it. The same readers under libFuzzer: `fuzz/all`.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)] // a failed unwrap is a failed test; what was read is told

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use drex_tests::mutate::mutated;
use drex_tests::targets::{TARGETS, Target};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Inputs per reader without `DREX_FUZZ_SECONDS`.
const INPUTS: usize = 300;
/// An input that is read for longer hangs, s.
const LONGEST_S: u64 = 60;
/// Most memory for an input of at most 64 kB, bytes.
const MOST_BYTES: u64 = 256 << 20;

/// So many readers are tried side by side.
const WORKERS: usize = 2;

/// What a worker reads, so that a hang can be told.
#[derive(Clone)]
struct Reading {
    since: Instant,
    reader: &'static str,
    input: Vec<u8>,
}

/// Of each worker.
static READING: [Mutex<Option<Reading>>; WORKERS] = [const { Mutex::new(None) }; WORKERS];

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|v| v.parse().unwrap_or_else(|_| panic!("{name}={v} is no whole number")))
}

/// Writes an input that failed.
fn keep(name: &str, input: &[u8]) -> PathBuf {
    let path = std::env::temp_dir().join(format!("drex-fuzz-{name}-{}", std::process::id()));
    std::fs::write(&path, input).unwrap();
    path
}

fn read(target: &'static Target, input: &[u8], worker: usize) {
    let reading = Reading { since: Instant::now(), reader: target.name, input: input.to_vec() };
    *READING[worker].lock().unwrap() = Some(reading);
    let mut panicked = None;
    // Of this thread alone.
    let used = allocation_counter::measure(|| panicked = catch_unwind(AssertUnwindSafe(|| (target.run)(input))).err());
    *READING[worker].lock().unwrap() = None;
    if panicked.is_some() {
        panic!("{} panics on {}", target.name, keep(target.name, input).display());
    }
    let most = used.bytes_max;
    assert!(most < MOST_BYTES, "{} takes {most} bytes for {}", target.name, keep(target.name, input).display());
}

/// Ends the test program when one input takes too long.
fn watch() {
    std::thread::spawn(move || {
        loop {
            std::thread::sleep(Duration::from_secs(1));
            for reading in &READING {
                let late = reading.lock().unwrap().clone().filter(|r| r.since.elapsed().as_secs() > LONGEST_S);
                if let Some(Reading { reader, input, .. }) = late {
                    eprintln!("{reader} takes more than {LONGEST_S} s for {}", keep(reader, &input).display());
                    std::process::exit(1);
                }
            }
        }
    });
}

/// Reads the seeds of a reader and what is made of them; how many of these there were.
fn try_reader(target: &'static Target, seed: u64, seconds: Option<u64>, worker: usize) -> usize {
    let seeds = (target.seeds)();
    assert!(!seeds.is_empty(), "{} has no seeds", target.name);
    seeds.iter().for_each(|s| read(target, s, worker));
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (since, mut inputs) = (Instant::now(), 0);
    let more = |inputs| match seconds {
        Some(s) => since.elapsed().as_secs() < s,
        None => inputs < INPUTS,
    };
    while more(inputs) {
        read(target, &mutated(&seeds, &mut rng), worker);
        inputs += 1;
    }
    println!("{:<18} {inputs} inputs, {:.1} s", target.name, since.elapsed().as_secs_f64());
    inputs
}

#[test]
fn no_reader_panics_hangs_or_takes_memory_out_of_proportion() {
    let seconds = number("DREX_FUZZ_SECONDS");
    let seed = number("DREX_FUZZ_SEED").unwrap_or(1);
    let only = std::env::var("DREX_FUZZ_TARGET").ok();
    watch();
    // The glTF library panics on some files, inside the reader, which catches it: no news on stderr.
    let loud = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        if !info.location().is_some_and(|l| l.file().contains("gltf")) {
            loud(info);
        }
    }));
    let targets: Vec<&Target> = TARGETS.iter().filter(|t| only.as_ref().is_none_or(|o| o == t.name)).collect();
    let (targets, next, total) = (&targets, &AtomicUsize::new(0), &AtomicUsize::new(0));
    std::thread::scope(|scope| {
        for worker in 0..WORKERS {
            scope.spawn(move || {
                while let Some(target) = targets.get(next.fetch_add(1, Ordering::Relaxed)) {
                    total.fetch_add(try_reader(target, seed, seconds, worker), Ordering::Relaxed);
                }
            });
        }
    });
    let total = total.load(Ordering::Relaxed);
    assert!(total > 0, "DREX_FUZZ_TARGET names no reader");
    println!("{total} inputs");
}

/// A seed that its own reader refuses would only test the first lines of it.
#[test]
fn seeds_are_read() {
    use std::path::Path;
    let first = |seeds: Vec<Vec<u8>>| seeds.into_iter().next().unwrap();
    use drex_tests::seeds;
    for (name, bytes) in [
        ("a.stl", first(seeds::stl())),
        ("a.stl", seeds::stl().remove(1)),
        ("a.obj", first(seeds::obj())),
        ("a.ply", first(seeds::ply())),
        ("a.ply", seeds::ply().remove(1)),
        ("a.gltf", first(seeds::gltf())),
        ("a.glb", first(seeds::glb())),
    ] {
        drex_mesh::parse_mesh(Path::new(name), &bytes).unwrap();
    }
    for (i, bytes) in seeds::demo_json().iter().chain(&seeds::demo_npz()).enumerate() {
        let name = if i < 3 { "d.json" } else { "d.npz" };
        drex_demo::Demonstration::parse(Path::new(name), bytes, &Default::default()).unwrap();
    }
    drex_demo::Demonstration::parse(Path::new("d.csv"), &first(seeds::demo_csv()), &Default::default()).unwrap();
    drex_demo::ManoModel::parse_npz(Path::new("m.npz"), &first(seeds::mano_npz())).unwrap();
    for bytes in seeds::spz() {
        assert_eq!(drex_splat::io::spz::parse(Path::new("a.spz"), &bytes, drex_splat::Kind::Surfel).unwrap().len(), 3);
    }
    for text in seeds::twin_toml() {
        drex_twin::manifest::TwinManifest::parse(Path::new("twin.toml"), std::str::from_utf8(&text).unwrap()).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    };
    for text in seeds::push_toml() {
        drex_recording::PushConfig::read(&at("push.toml", &text)).unwrap();
    }
    drex_robot::Robot::from_urdf(&at("a.urdf", &first(seeds::urdf()))).unwrap();
    for text in seeds::mjcf() {
        drex_robot::Robot::from_mjcf_str(std::str::from_utf8(&text).unwrap(), None).unwrap();
    }
    let model = seeds::colmap();
    for (name, bytes) in [("cameras", &model.cameras), ("images", &model.images), ("points3D", &model.points)] {
        at(&format!("colmap/sparse/0/{name}.bin"), bytes);
    }
    (0..3).for_each(|i| drop(at(&format!("colmap/images/{i}.png"), &seeds::picture(32, 24))));
    let capture = drex_core::capture::Capture::load(&folder.path().join("colmap"), &Default::default()).unwrap();
    assert_eq!((capture.views.len(), capture.points.len()), (3, 2));
    drex_splat::io::ply::parse(Path::new("a.ply"), &first(seeds::gaussians_ply()), drex_splat::Kind::Surfel).unwrap();
}
