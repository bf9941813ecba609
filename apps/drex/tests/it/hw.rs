//! `drex hw` with emulated hands of its own.
#![cfg(unix)]

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::{PATIENT, drex};
use drex_hw::emulator::leap::LeapEmulator;
use drex_hw::emulator::pty::PtyServer;
use drex_hw::leap::table;

/// `drex hw emulate`, told to stop when the test is over.
struct Emulated {
    process: Child,
    _folder: tempfile::TempDir,
    port: PathBuf,
}

impl Emulated {
    fn new(arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let port = folder.path().join("hand");
        let mut process = Command::new(env!("CARGO_BIN_EXE_drex"))
            .args(["hw", "emulate"])
            .args(arguments)
            .args(["--seconds", "120", "--link", port.to_str().unwrap()])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.take().unwrap()).read_line(&mut line).unwrap();
        assert_eq!(Path::new(line.trim()), port);
        Self { process, _folder: folder, port }
    }

    fn port(&self) -> &str {
        self.port.to_str().unwrap()
    }
}

impl Drop for Emulated {
    fn drop(&mut self) {
        // It may be gone already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn a_leap_hand_is_found_read_moved_and_recorded() {
    let hand = Emulated::new(&["leap", "--wall", "if_mcp=0.4"]);
    let at = ["--hand", "leap", "--port", hand.port(), "--json"];
    let ping = drex(["hw", "ping"].iter().chain(&at)).json();
    assert_eq!(ping["motors"].as_array().unwrap().len(), 16, "{ping}");
    assert_eq!((ping["motors"][3]["id"].as_u64(), ping["motors"][3]["model"].as_u64()), (Some(3), Some(1240)));

    // The object is in the way of one joint, the other arrives; the log is one that is read again.
    let log = hand.port.with_file_name("move.csv");
    let to = ["--to", "if_mcp=0.8,mf_mcp=0.5", "--seconds", "0.6", "--cap", "80", "--log", log.to_str().unwrap()];
    let to = [&to[..], &PATIENT].concat();
    let moved = drex(["hw", "move"].iter().chain(&at).chain(&to)).json();
    let status = drex(["hw", "status"].iter().chain(&at)).json();
    let joint = |name: &str| {
        let found = status["joints"].as_array().unwrap().iter().find(|j| j["name"] == name).unwrap().clone();
        assert_eq!(found["status"], "torque off");
        found["position_rad"].as_f64().unwrap()
    };
    assert!((joint("if_mcp") - 0.4).abs() < 0.01, "{status}");
    assert!((joint("mf_mcp") - 0.5).abs() < 0.05, "{moved}\n{status}");
    let short = moved["short"].as_array().unwrap();
    assert!(short.len() == 1 && short[0]["joint"] == "if_mcp", "{moved}");
    assert!((short[0]["rad"].as_f64().unwrap() - 0.4).abs() < 0.05, "{moved}");

    let out = hand.port.with_file_name("again.csv");
    let play = ["--play", log.to_str().unwrap(), "--out", out.to_str().unwrap(), PATIENT[0], PATIENT[1]];
    let played = drex(["hw", "record"].iter().chain(&at).chain(&play)).json();
    assert!(played["loop"]["cycles"].as_u64().unwrap() > 200, "{played}");
    let text = std::fs::read_to_string(&out).unwrap();
    assert!(text.starts_with("timestamp,position_if_mcp,") || text.contains(",position_if_mcp,"), "{}", &text[..200]);

    let refuse =
        |to: &str, words: &[&str]| drex(["hw", "move"].iter().chain(&at).chain(&["--to", to])).fails_with(words);
    refuse("if_mcp=9", &["if_mcp cannot be at 9 rad"]);
    refuse("knee=0.1", &["no joint \"knee\"", "if_mcp"]);
    refuse("if_mcp", &["JOINT=RAD"]);
}

#[test]
fn an_allegro_hand_is_found_and_moved() {
    let hand = Emulated::new(&["allegro", "--allegro", "v4"]);
    let at = ["--hand", "allegro", "--port", hand.port(), "--json"];
    let ping = drex(["hw", "ping"].iter().chain(&at)).json();
    assert!(ping["frames"].as_u64().unwrap() > 0, "{ping}");
    let moved =
        drex(["hw", "move"].iter().chain(&at).chain(&["--to", "ffj1=0.5", "--seconds", "1"]).chain(&PATIENT)).json();
    assert!(moved["farthest_rad"].as_f64().unwrap() < 0.2, "{moved}");
}

/// An emulated LEAP hand of this process, and `drex hw move` that drives it for a long time with these arguments besides.
struct Moved {
    hand: LeapEmulator,
    process: Child,
    _server: PtyServer,
    _folder: tempfile::TempDir,
}

impl Moved {
    fn new(arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let port = folder.path().join("hand");
        let hand = LeapEmulator::new().in_real_time();
        let server = PtyServer::serve(hand.clone(), Some(&port)).unwrap();
        let process = Command::new(env!("CARGO_BIN_EXE_drex"))
            .args(["hw", "move", "--hand", "leap", "--to", "if_mcp=0.5", "--port", port.to_str().unwrap()])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let moved = Self { hand, process, _server: server, _folder: folder };
        moved.until("it moves", |hand| hand.under_torque() == 16 && hand.position(1).unwrap() > 2055.0);
        moved
    }

    fn until(&self, what: &str, reached: impl Fn(&LeapEmulator) -> bool) {
        let begun = Instant::now();
        while !reached(&self.hand) {
            assert!(begun.elapsed() < Duration::from_secs(30), "{what}");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Exit status, and what it said on both outputs.
    fn end(mut self) -> (Option<i32>, String) {
        let status = self.process.wait().unwrap();
        let mut said = String::new();
        self.process.stdout.take().unwrap().read_to_string(&mut said).unwrap();
        self.process.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        (status.code(), said)
    }
}

#[test]
fn the_hand_of_a_killed_command_has_its_torque_off() {
    let mut moved = Moved::new(&[PATIENT[0], PATIENT[1], "--seconds", "20"]);
    moved.process.kill().unwrap();
    moved.until("torque off", |hand| hand.under_torque() == 0);
    // The guard holds the other end of this until it has said what it did.
    let (_, said) = moved.end();
    assert!(said.contains("the program has ended; torque off, confirmed by 16 motors"), "{said}");

    // Without a guard the motors freeze, and that is all.
    let mut moved = Moved::new(&["--no-guard", "--seconds", "20"]);
    moved.process.kill().unwrap();
    moved.process.wait().unwrap();
    moved.until("frozen", |hand| (0..16).all(|id| hand.get(id, table::BUS_WATCHDOG) == Some(255)));
    assert_eq!(moved.hand.under_torque(), 16);
}

#[test]
fn a_plug_that_was_pulled_is_said_to_be_back_or_not() {
    // It comes back in time.
    for guard in [&PATIENT[..], &["--no-guard"]] {
        let moved = Moved::new(&[guard, &["--seconds", "1.5", "--outage", "20"]].concat());
        moved.hand.unplug();
        std::thread::sleep(Duration::from_millis(300));
        moved.hand.plug();
        let hand = moved.hand.clone();
        let (code, said) = moved.end();
        assert!(code == Some(0) && said.contains("came back and went on") && said.contains("arrived"), "{said}");
        assert_eq!(hand.under_torque(), 0);
    }
    // Too late to go on, in time to be switched off.
    let moved = Moved::new(&[PATIENT[0], PATIENT[1], "--seconds", "20", "--outage", "0.1"]);
    moved.hand.unplug();
    std::thread::sleep(Duration::from_millis(700));
    assert_eq!(moved.hand.under_torque(), 16);
    moved.hand.plug();
    moved.until("torque off", |hand| hand.under_torque() == 0);
    let (code, said) = moved.end();
    assert!(code == Some(1) && said.contains("torque off, ") && said.contains("could be reached again"), "{said}");
}

#[test]
fn a_mute_motor_is_torque_unknown_and_the_guard_goes_on_trying() {
    let mut moved = Moved::new(&[PATIENT[0], PATIENT[1], "--seconds", "0.5"]);
    moved.hand.detach(7, true);
    moved.until("the others are off", |hand| hand.under_torque() == 1);
    // The command has tried for 5 s; its guard says at once that it goes on.
    let mut errors = BufReader::new(moved.process.stderr.take().unwrap());
    let mut said = String::new();
    assert!(errors.read_line(&mut said).unwrap() > 0);
    assert!(said.contains("the program has ended; torque unknown: no confirmation of motors [7]"), "{said}");
    moved.hand.detach(7, false);
    moved.until("it is off", |hand| hand.under_torque() == 0);
    errors.read_to_string(&mut said).unwrap();
    assert!(said.contains("torque off, confirmed by 16 motors"), "{said}");
    assert!(said.contains("error: torque unknown: ") && said.contains("(motor 7)"), "{said}");
    assert_eq!(moved.process.wait().unwrap().code(), Some(1));
}

#[test]
fn a_hand_that_is_not_there_is_named() {
    let nobody = ["--hand", "leap", "--port", "/dev/no-such-hand"];
    drex(["hw", "ping"].iter().chain(&nobody)).fails_with(&["/dev/no-such-hand"]);
    drex(["hw", "status", "--hand", "allegro", "--port", "can9"]).fails_with(&["can9"]);
}

#[test]
fn a_law_is_fitted_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (pairs, law) = (folder.path().join("pairs.csv"), folder.path().join("law.json"));
    // 0.45 N m/A after 16 mA, at a lever of 5 cm.
    let row = |ma: f64| format!("{ma},{}\n", 0.45e-3 * (ma - 16.0) / 0.05);
    let rows: String = (1..12).map(|k| row(30.0 * f64::from(k))).collect();
    std::fs::write(&pairs, format!("current_ma,force_n\n{rows}")).unwrap();
    let common = ["hw", "calibrate", pairs.to_str().unwrap(), "--out", law.to_str().unwrap(), "--source", "a scale"];
    let day = ["--date", "2026-11-21", "--json"];
    let fitted = drex(common.iter().chain(&day).chain(&["--lever", "0.05"])).json();
    let text = fitted.to_string();
    assert!(fitted["law"]["provenance"]["pairs"] == 11 && text.contains("a scale"), "{text}");
    assert!(law.is_file());
    drex(common.iter().chain(&day)).fails_with(&["--lever"]);
    std::fs::write(&pairs, "current_ma,torque_nm\n10,nan\n20,0.1\n").unwrap();
    assert_eq!(drex(common.iter().chain(&day)).code, 1);
}
