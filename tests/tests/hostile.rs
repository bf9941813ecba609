//! Small inputs that ask for much are refused before they get it, with the limit and the option that raises it; what is only long is read.
//! `tests/budgets` runs the whole list through the program.
#![allow(clippy::unwrap_used, missing_docs)] // a failed unwrap is a failed test

use std::fmt::Display;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use allocation_counter::measure;
use drex_robot::Robot;
use drex_splat::Kind;
use drex_tests::hostile;

/// The limit is one for the process, so that a test that lowers it runs alone.
fn alone() -> MutexGuard<'static, ()> {
    static LIMIT: Mutex<()> = Mutex::new(());
    LIMIT.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The message of what is refused, and the most memory that was in use, bytes.
fn refused<T, E: Display>(read: impl FnOnce() -> Result<T, E>) -> (String, u64) {
    let mut message = String::new();
    let used = measure(|| message = read().err().map_or_else(String::new, |e| e.to_string()));
    (message, used.bytes_max)
}

#[test]
fn what_unpacks_to_a_thousand_times_its_size_is_refused() {
    let _alone = alone();
    let bomb = hostile::spz(2_000_000);
    assert!(bomb.len() < 200_000);
    let (message, most) = refused(|| drex_splat::io::spz::parse(Path::new("a.spz"), &bomb, Kind::Surfel));
    assert!(message.contains("130 MB") && message.contains("--max-memory"), "{message}");
    assert!(most < 1 << 20, "{most}");

    let bomb = hostile::zip_bomb(200 << 20);
    let (message, most) = refused(|| drex_demo::Demonstration::parse(Path::new("d.npz"), &bomb, &Default::default()));
    assert!(message.contains("compressed bytes") && message.contains("--max-memory"), "{message}");
    assert!(most < 200 << 20, "{most}");
}

#[test]
fn elements_are_counted_before_they_are_made() {
    let _alone = alone();
    let many = [b"<robot>".as_slice(), &b"<a/>".repeat(10_000_000), b"</robot>"].concat();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("h.urdf");
    std::fs::write(&path, &many).unwrap();
    drex_core::budget::set_max_memory(1 << 30);
    let (message, most) = refused(|| Robot::load(&path));
    drex_core::budget::set_max_memory(256 << 20);
    let classes = String::from_utf8(hostile::classes(1000, 3000)).unwrap();
    let (of_classes, most_of_classes) = refused(|| Robot::from_mjcf_str(&classes, None));
    drex_core::budget::set_max_memory(drex_core::budget::DEFAULT_MAX_MEMORY);
    assert!(of_classes.contains("default classes") && of_classes.contains("--max-memory"), "{of_classes}");
    assert!(most_of_classes < 300 << 20, "{most_of_classes}");
    assert!(message.contains("limit is 1074 MB") && message.contains("--max-memory 3"), "{message}");
    assert!(most < 4 * many.len() as u64, "{most}");

    let text = String::from_utf8(hostile::laughs()).unwrap();
    assert!(Robot::from_mjcf_str(&text, None).is_err());
}

#[test]
fn models_of_40_000_links_are_read() {
    let _alone = alone();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("h.urdf");
    for chain in [true, false] {
        std::fs::write(&path, hostile::urdf(40_000, chain)).unwrap();
        let robot = Robot::load(&path).unwrap();
        assert_eq!((robot.links.len(), robot.joints.len()), (40_000, 39_999));
        // Each joint follows the one as far from the other end.
        let followed = |j: usize| robot.joints[robot.joints[j].mimic.unwrap().joint].name.clone();
        let first = robot.joints.iter().position(|j| j.name == "j1").unwrap();
        assert_eq!(followed(first), "j39999");
        assert!(robot.unsupported.len() >= 40_000, "one note per link without mass: {}", robot.unsupported.len());
    }
    let robot = Robot::from_mjcf_str(&String::from_utf8(hostile::mjcf(40_000)).unwrap(), None).unwrap();
    assert_eq!((robot.links.len(), robot.actuators.len()), (40_001, 40_000));
    assert_eq!((robot.links[40_000].name.as_str(), robot.actuators[39_999].joint), ("body_40000", 39_999));
}

#[test]
fn names_that_are_taken_are_passed_over_once() {
    let _alone = alone();
    // Bodies called as those without a name would be, then some without a name.
    let named: String = (5..9).map(|k| format!("<body name=\"body_{k}\"/>")).collect();
    let text = format!("<mujoco><worldbody><body name=\"base\">{named}<body/><body/></body></worldbody></mujoco>");
    let robot = Robot::from_mjcf_str(&text, None).unwrap();
    let names: Vec<&str> = robot.links.iter().map(|l| l.name.as_str()).collect();
    assert_eq!(names, ["base", "body_5", "body_6", "body_7", "body_8", "body_9", "body_10"]);
}
