//! `drex hw` on hands that are not as they should be: emulated, in this process, so that the tests can break them.
#![cfg(unix)]

use std::path::PathBuf;
use std::time::{Duration, Instant};

use crate::common::{PATIENT, Run, drex};
use drex_hw::allegro::{AllegroCommand, AllegroOptions, AllegroVersion, JointCalibration};
use drex_hw::can::SlcanAdapter;
use drex_hw::emulator::allegro::AllegroEmulator;
use drex_hw::emulator::leap::{Fault, LeapEmulator};
use drex_hw::emulator::pty::PtyServer;
use drex_hw::leap::table::{self, MotorModel, hardware_error};

struct Bench<H> {
    hand: H,
    port: PathBuf,
    family: &'static str,
    _server: PtyServer,
    folder: tempfile::TempDir,
}

impl Bench<LeapEmulator> {
    fn leap(model: MotorModel) -> Self {
        let (hand, folder) = (LeapEmulator::with_model(model).in_real_time(), tempfile::tempdir().unwrap());
        let port = folder.path().join("leap");
        let server = PtyServer::serve(hand.clone(), Some(&port)).unwrap();
        Self { hand, port, family: "leap", _server: server, folder }
    }

    /// As a driver that was killed leaves it: under torque, frozen.
    fn leave_under_torque(&self) {
        for id in 0..16 {
            self.hand.set(id, table::MODE, 5);
            self.hand.set(id, table::GOAL_CURRENT, 100);
            self.hand.set(id, table::TORQUE_ENABLE, 1);
            self.hand.set(id, table::BUS_WATCHDOG, 255);
        }
    }
}

impl Bench<AllegroEmulator> {
    fn allegro(options: AllegroOptions) -> Self {
        let (hand, folder) = (AllegroEmulator::with_options(options).in_real_time(), tempfile::tempdir().unwrap());
        let port = folder.path().join("allegro");
        let server = PtyServer::serve(SlcanAdapter::new(hand.bus()), Some(&port)).unwrap();
        Self { hand, port, family: "allegro", _server: server, folder }
    }
}

impl<H> Bench<H> {
    fn hw(&self, command: &str, more: &[&str]) -> Run {
        let at = ["hw", command, "--hand", self.family, "--port", self.port.to_str().unwrap(), "--json"];
        let patient: &[&str] = if ["move", "record"].contains(&command) { &PATIENT } else { &[] };
        drex(at.iter().chain(more).chain(patient))
    }

    fn file(&self, name: &str, text: &str) -> String {
        let path = self.folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    }
}

/// The first line of stdout, which is the answer; `--json` adds the error as a second one.
fn answer(run: &Run) -> serde_json::Value {
    serde_json::from_str(run.stdout.lines().next().unwrap_or_default())
        .unwrap_or_else(|e| panic!("{e}: {}\n{}", run.stdout, run.stderr))
}

fn joints(run: &Run) -> Vec<serde_json::Value> {
    answer(run)["joints"].as_array().unwrap().clone()
}

#[test]
fn status_says_that_nobody_drives_and_off_lets_go_in_any_state() {
    let bench = Bench::leap(MotorModel::Xc330M288);
    bench.leave_under_torque();
    bench.hand.set(5, table::HOMING_OFFSET, 1000);
    bench.hand.fail(9, hardware_error::OVERLOAD);
    let status = bench.hw("status", &[]);
    status.fails_with(&["torque is on in 15 joints and nobody drives them: drex hw off"]);
    let seen = joints(&status);
    assert_eq!(seen.iter().filter(|j| j["watchdog"] == 255).count(), 16);
    assert_eq!(seen.iter().filter(|j| j["torque"] == true).count(), 15);
    assert!(seen.iter().any(|j| j["status"] == "torque on, frozen by its watchdog, driven by nobody"), "{seen:?}");
    assert!(seen.iter().any(|j| j["homing_offset_ticks"] == 1000) && seen.iter().all(|j| j["voltage_v"] == 5.0));
    assert!(seen.iter().any(|j| j["trouble"] == "overload"));
    assert_eq!(bench.hand.under_torque(), 15, "a look changes nothing");

    let off = bench.hw("off", &[]);
    assert_eq!(off.code, 0, "{}", off.stderr);
    assert!(answer(&off)["motors"].as_array().unwrap().iter().all(|m| m["torque"] == "off"), "{}", off.stdout);
    assert_eq!(bench.hand.under_torque(), 0);

    // A mute motor is never said to be off.
    bench.leave_under_torque();
    bench.hand.inject(Fault::Mute(2), 1_000_000);
    let off = bench.hw("off", &[]);
    off.fails_with(&["(motor 2): torque unknown: did not answer"]);
    let unknown = answer(&off)["motors"].as_array().unwrap().iter().filter(|m| m["torque"] == "unknown").count();
    assert_eq!(unknown, 1, "{}", off.stdout);
}

#[test]
fn a_release_is_slow_and_ends_in_torque_off() {
    let bench = Bench::leap(MotorModel::Xc330M288);
    bench.leave_under_torque();
    let begun = Instant::now();
    assert_eq!(bench.hw("release", &["--seconds", "0.5"]).code, 0);
    assert!(begun.elapsed() >= Duration::from_millis(500));
    assert_eq!(bench.hand.under_torque(), 0);
}

#[test]
fn an_allegro_hand_that_was_left_on_is_switched_off_or_said_not_to_be() {
    for version in [AllegroVersion::V3, AllegroVersion::V4, AllegroVersion::V5] {
        let name = format!("{version:?}").to_lowercase();
        let bench = Bench::allegro(AllegroOptions::new(version));
        bench.hand.set_watchdog(None);
        let leave_on = || {
            for command in [
                AllegroCommand::Period { pose_ms: 3, imu_ms: 0, temperature_ms: 0 },
                AllegroCommand::On,
                AllegroCommand::AskState,
                AllegroCommand::Torque { finger: 0, wire: [80; 4] },
            ] {
                if let Some(frame) = command.encode(version) {
                    bench.hand.hear(&frame);
                }
            }
            assert!(bench.hand.is_on() && bench.hand.torques_nm()[0] > 0.0);
        };
        leave_on();
        let status = bench.hw("status", &["--allegro", &name]);
        status.fails_with(&["the hand was on and nobody drove it"]);
        leave_on();
        for command in ["off", "release"] {
            let off = bench.hw(command, &["--allegro", &name]);
            assert_eq!((off.code, answer(&off)["torque"].as_str()), (0, Some("off")), "{name}: {}", off.stderr);
            assert!(!bench.hand.is_on() && bench.hand.torques_nm() == [0.0; 16]);
        }
        bench.hand.unplug();
        let off = bench.hw("off", &["--allegro", &name]);
        off.fails_with(&["torque unknown"]);
    }
}

#[test]
fn findings_stop_a_hand_before_it_moves_unless_they_are_allowed() {
    let bench = Bench::leap(MotorModel::Xc330M288);
    let log = bench.file("play.csv", "");
    let to = ["--to", "if_mcp=0.1", "--seconds", "0.3"];
    let moves = |more: &[&str]| bench.hw("move", &[&to[..], more].concat());
    let log_out = ["--log", &log];
    assert_eq!(moves(&log_out).code, 0);

    bench.hand.set(6, table::HOMING_OFFSET, 1000);
    moves(&[]).fails_with(&["homing offset is 1000 ticks", "88 degrees", "allow it by name: homing-offset", "--allow"]);
    let again = bench.folder.path().join("again.csv");
    let play = ["--play", &log, "--out", again.to_str().unwrap()];
    bench.hw("record", &play).fails_with(&["homing-offset"]);
    assert_eq!(moves(&["--allow", "homing-offset"]).code, 0);
    bench.hand.set_supply(4.0, 0.0);
    moves(&["--allow", "homing-offset"]).fails_with(&["its supply is 4.0 V", "low-voltage"]);
    assert_eq!(bench.hand.under_torque(), 0, "nothing moved");
    let derated = moves(&["--allow", "homing-offset,low-voltage"]);
    assert_eq!(derated.code, 0, "{}", derated.stderr);
    assert_eq!(bench.hw("record", &[&play[..], &["--allow", "homing-offset,low-voltage"]].concat()).code, 0);
}

#[test]
fn a_hardware_error_during_motion_is_reported_at_the_end() {
    // One that takes the torque off and is mended on the way, and one that the motor goes on with.
    for (bits, words) in [(hardware_error::OVERLOAD, "overload"), (hardware_error::VOLTAGE, "supply voltage")] {
        let bench = Bench::leap(MotorModel::Xc330M288);
        let hand = bench.hand.clone();
        let breaks = std::thread::spawn(move || {
            let begun = Instant::now();
            while hand.under_torque() < 16 && begun.elapsed() < Duration::from_secs(20) {
                std::thread::sleep(Duration::from_millis(2));
            }
            std::thread::sleep(Duration::from_millis(200));
            hand.fail(1, bits);
        });
        let moved = bench.hw("move", &["--to", "rest", "--seconds", "2"]);
        breaks.join().unwrap();
        moved.fails_with(&["if_mcp had a hardware error on the way", words]);
        assert_eq!(bench.hand.under_torque(), 0);
    }
}

#[test]
fn caps_are_gentle_said_and_refused_by_motor() {
    let bench = Bench::leap(MotorModel::Xl330M288);
    let moves = |more: &[&str]| bench.hw("move", &[&["--to", "rest", "--seconds", "0.2"], more].concat());
    let gentle = moves(&[]);
    assert_eq!(answer(&gentle)["cap"]["per_joint"][0], 150.0, "{}", gentle.stdout);
    assert_eq!(answer(&gentle)["cap"]["motor"], "XL330-M288");
    moves(&["--cap", "1740"]).fails_with(&["1740 mA", "1470 mA", "stalls", "at most 300 mA"]);
    let much = moves(&["--cap", "400"]);
    assert!(much.code == 0 && much.stderr.contains("above the 300 mA"), "{}", much.stderr);
    let allegro = Bench::allegro(AllegroOptions::new(AllegroVersion::V4));
    allegro.hw("move", &["--to", "rest", "--cap", "5"]).fails_with(&["a cap of 5 N m", "0.562 N m"]);
}

#[test]
fn a_dead_bus_is_given_up_in_time() {
    let bench = Bench::leap(MotorModel::Xc330M288);
    (0..16).for_each(|id| bench.hand.inject(Fault::Mute(id), 1_000_000));
    for (command, more) in [("status", &[][..]), ("off", &[]), ("move", &["--to", "rest"])] {
        let begun = Instant::now();
        bench.hw(command, more).fails_with(&["no motor of the hand answers"]);
        // 5 s on a machine with nothing else to do.
        assert!(begun.elapsed() < Duration::from_secs(10), "{command}: {:?}", begun.elapsed());
    }
}

#[test]
fn a_hand_file_carries_the_zeros_of_one_hand_through_every_command() {
    let bench = Bench::leap(MotorModel::Xc330M288);
    // Horns a quarter turn off in one joint, a few ticks in another; an offset in a third.
    bench.hand.place(0, 2048.0 + 1024.0);
    bench.hand.place(5, 2048.0 - 60.0);
    bench.hand.set(6, table::HOMING_OFFSET, 300);
    bench.hand.place(6, 2048.0 + 300.0);
    let to = ["--to", "if_mcp=0.1", "--seconds", "0.3"];
    bench.hw("move", &[&to[..], &["--allow", "homing-offset"]].concat()).fails_with(&["calibrate-zero"]);

    let out = bench.folder.path().join("hand.toml");
    let out = out.to_str().unwrap();
    let made = bench.hw("calibrate-zero", &["--seconds", "0.3", "--out", out]);
    assert_eq!(made.code, 0, "{}", made.stderr);
    let text = std::fs::read_to_string(out).unwrap();
    assert!(
        text.contains("zero = 3072") && text.contains("zero = 1988") && text.contains("homing_offset = 300"),
        "{text}"
    );
    let with = ["--hand-file", out];
    let status = bench.hw("status", &with);
    assert!(joints(&status).iter().all(|j| j["position_rad"].as_f64().unwrap().abs() < 0.01), "{}", status.stdout);
    assert_eq!(bench.hw("move", &[&to[..], &with].concat()).code, 0);
    assert_eq!(bench.hw("ping", &with).code, 0);
    assert_eq!(bench.hw("off", &with).code, 0);

    // What makes no sense is refused: a pose that no horn allows, a hand that moves or is under torque, a silent motor.
    let calibrate = |more: &[&str]| bench.hw("calibrate-zero", &[&["--seconds", "0.4", "--out", out], more].concat());
    calibrate(&["--pose", "mf_mcp=0.7"]).fails_with(&["mf_mcp", "degrees from where a horn can be mounted"]);
    calibrate(&["--pose", "mf_mcp=9"]).fails_with(&["mf_mcp cannot be held at 9 rad"]);
    bench.hand.set(3, table::TORQUE_ENABLE, 1);
    calibrate(&[]).fails_with(&["is under torque", "drex hw off"]);
    bench.hand.set(3, table::TORQUE_ENABLE, 0);
    let (hand, stop) = (bench.hand.clone(), std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false)));
    let told = stop.clone();
    let moving = std::thread::spawn(move || {
        let mut angle = 0.0_f64;
        while !told.load(std::sync::atomic::Ordering::Relaxed) {
            angle += 0.1;
            hand.place(9, 2048.0 + 100.0 * angle.sin());
            std::thread::sleep(Duration::from_millis(5));
        }
    });
    calibrate(&[]).fails_with(&["the hand moved while it was read", "rf_mcp"]);
    stop.store(true, std::sync::atomic::Ordering::Relaxed);
    moving.join().unwrap();
    bench.hand.inject(Fault::Mute(3), 1_000_000);
    calibrate(&[]).fails_with(&["does not answer"]);
    assert_eq!(std::fs::read_to_string(out).unwrap(), text, "the file is left as it was");
}

#[test]
fn a_hand_file_is_read_strictly() {
    let bench = Bench::leap(MotorModel::Xc330M288);
    let head = "schema = 1\nhand = \"leap\"\n";
    let refused = |text: &str, words: &[&str]| {
        let file = bench.file("bad.toml", text);
        bench.hw("status", &["--hand-file", &file]).fails_with(words);
    };
    refused(&format!("{head}speed = 3\n"), &["bad.toml", "line 3", "speed"]);
    refused(&format!("{head}[joints.knee]\nzero = 3\n"), &["bad.toml", "joints.knee", "if_mcp"]);
    refused("schema = 1\nhand = \"allegro\"\n", &["is of a hand Allegro"]);
    let other = bench.file("other.toml", &format!("{head}motors = \"xl330\"\n"));
    bench.hw("move", &["--to", "rest", "--hand-file", &other]).fails_with(&["XC330-M288", "XL330-M288"]);
}

#[test]
fn an_allegro_hand_file_has_gears_units_and_the_serial_number() {
    let mut options = AllegroOptions::new(AllegroVersion::V5);
    // A V5 Plus: joints 1, 5 and 9 with twice the gear; a thumb with its zero 84 degrees off.
    for j in [1, 5, 9] {
        options.gear_ratios[j] = 2.0;
    }
    options.calibration[13] = JointCalibration { offset_counts: 955, ..JointCalibration::NONE };
    options.wire_per_nm = 1900.0;
    let bench = Bench::allegro(options);
    for (j, rad) in [(1, 0.4), (13, 0.3)] {
        bench.hand.place(j, rad);
    }
    let plus = "schema = 1\nhand = \"allegro\"\nversion = \"v5\"\nserial = \"EMULATED\"\nwire_per_nm = 1900.0\n\
                temperature_period_ms = 50\ncap_nm = 0.05\n[joints.ffj1]\ngear_ratio = 2.0\n[joints.mfj1]\ngear_ratio = 2.0\n\
                [joints.rfj1]\ngear_ratio = 2.0\n";
    let file = bench.file("plus.toml", plus);
    let (out, with) = (bench.folder.path().join("hand.toml"), ["--hand-file", &file]);
    let out = out.to_str().unwrap();
    let pose = ["--pose", "ffj1=0.4,thj1=0.3", "--seconds", "0.3", "--out", out];
    let made = bench.hw("calibrate-zero", &[&with[..], &pose].concat());
    assert_eq!(made.code, 0, "{}", made.stderr);
    let text = std::fs::read_to_string(out).unwrap();
    assert!(
        text.contains("zero = 955") && text.contains("gear_ratio = 2.0") && text.contains("cap_nm = 0.05"),
        "{text}"
    );
    let moved = bench.hw("move", &["--to", "ffj1=0.6", "--seconds", "0.5", "--hand-file", out]);
    assert_eq!(moved.code, 0, "{}", moved.stderr);
    assert!((bench.hand.positions()[1] - 0.6).abs() < 0.2, "{:?}", bench.hand.positions());
    let cap = answer(&moved)["cap"]["per_joint"].as_array().unwrap().clone();
    assert!(cap.iter().all(|c| (c.as_f64().unwrap() - 0.05).abs() < 1e-3), "{cap:?}");
    let status = bench.hw("status", &["--hand-file", out]);
    assert!(status.stdout.contains("temperature_c\":35"), "{}", status.stdout);
    let other = bench.file("other.toml", &plus.replace("EMULATED", "SAHB0001"));
    bench.hw("status", &["--hand-file", &other]).fails_with(&["EMULATED", "SAHB0001"]);
}

#[test]
fn a_hand_behind_a_slow_adapter_moves_all_the_same() {
    let (hand, folder) = (LeapEmulator::new().in_real_time(), tempfile::tempdir().unwrap());
    let port = folder.path().join("leap");
    let _server = PtyServer::serve(hand.behind_adapter(Duration::from_millis(16)), Some(&port)).unwrap();
    let at = ["--hand", "leap", "--port", port.to_str().unwrap(), "--json"];
    let to = ["--to", "if_mcp=0.3", "--seconds", "1", "--rate", "40"];
    let moved = drex(["hw", "move"].iter().chain(&at).chain(&to).chain(&PATIENT)).json();
    assert!(moved["farthest_rad"].as_f64().unwrap() < 0.05, "{moved}");
}
