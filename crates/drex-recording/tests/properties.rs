//! The readers survive any bytes, and time stamps any text.
#![allow(clippy::unwrap_used, missing_docs)] // a test may stop at the first surprise

use std::path::Path;

use drex_recording::PushConfig;
use drex_recording::clock::{self, Clock};
use drex_recording::readers::*;
use nalgebra::Point3;
use proptest::prelude::*;

proptest! {
    #[test]
    fn stamps_survive_any_text(text in ".{0,40}", minutes in any::<i32>()) {
        let _ = Clock::LocalIso { utc_offset_minutes: minutes }.parse(&text);
        let _ = Clock::Unix.parse(&text);
        let _ = clock::parse_utc_offset(&text);
    }
}

const POSE_CSV: &str = "t,x,y,z,qw,qx,qy,qz\n0,0,0,0.04405,1,0,0,0\n0.0335,0,0,0.0439973,1,0,0,0\n";
const JOINT_CSV: &str = "timestamp,local_time,position_0,position_1,velocity_0,velocity_1,effort_0,effort_1\n\
    1744941584.37,2025-04-18 01:59:44,0.1,0.2,0,0,0.01,0.02\n1744941584.38,x,0.1,0.2,0,0,0.01,0.02\n";
const FORCE_CSV: &str = "t,fx,fy,fz\n0,0,0,-0\n0.01,1,0,2\n";
const ACTION_CSV: &str = "t,x_cmd,y_cmd,z_cmd\n0,0,0,0.1\n0.01,0,0,0.1\n";
const PROPRIO_CSV: &str = "t,x,y,z,vx,vy,vz\n0,0,0,0.1,0,0,0\n";
const BOP: &str = "scene_id,im_id,obj_id,score,R,t,time\n1,3,2,0.9,1 0 0 0 1 0 0 0 1,100 -50 800,0.1\n";
const LOG: &str = "2025-04-17T18:59:37.5 - Final transform:\n[[1 0]]\n2025-04-17T18:59:37.5 - Pose:\ntensor([[[ 1.0, 0.0, 0.0, 0.1],\n\
    [0.0, 1.0, 0.0, 0.2],\n [0.0, 0.0, 1.0, 8e-1],\n [0.0, 0.0, 0.0, 1.0]]], device='cuda:0')\n";
const GRASPS: &str = r#"{"schema":1,"joint_names":["a","b"],"unit":"rad","grasps":[[0.1,0.2],[0.3,0.4]]}"#;
const NPY: &[u8] = b"\x93NUMPY\x01\x00\x40\x00{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2), }    \n\0\0\x80\x3f\0\0\x80\x3f";
const PUSH: &str = "schema = 1\nmesh = \"m.stl\"\n[track]\nfile = \"p.csv\"\nformat = \"pose_csv\"\nframe = \"world\"\n[force]\n\
    file = \"f.csv\"\npoint_in_object_m = [0, 0, 0.1]\n";

/// Every reader, told apart by number; whether it took the bytes.
fn read_with(reader: usize, bytes: &[u8]) -> bool {
    let path = Path::new("fuzz");
    let names = ["a".to_owned(), "b".to_owned()];
    match reader {
        0 => parse_pose_csv(path, bytes).is_ok(),
        1 => parse_joint_log_csv(path, bytes, Some(&names)).is_ok(),
        2 => parse_force_csv(path, bytes, Point3::origin()).is_ok(),
        3 => parse_action_csv(path, bytes).is_ok(),
        4 => parse_proprio_csv(path, bytes).is_ok(),
        5 => parse_bop_csv(path, bytes, &BopSelection { fps: 30.0, scene_id: None, obj_id: None }).is_ok(),
        6 => parse_foundation_pose_log(path, bytes, &Clock::LocalIso { utc_offset_minutes: -420 }).is_ok(),
        7 => parse_grasps_json(path, bytes).is_ok(),
        8 => parse_grasps_npy(path, bytes, &names).is_ok(),
        _ => drex_core::fsutil::from_toml::<PushConfig>(path, &String::from_utf8_lossy(bytes)).is_ok(),
    }
}

const SAMPLES: [&[u8]; 10] = [
    POSE_CSV.as_bytes(),
    JOINT_CSV.as_bytes(),
    FORCE_CSV.as_bytes(),
    ACTION_CSV.as_bytes(),
    PROPRIO_CSV.as_bytes(),
    BOP.as_bytes(),
    LOG.as_bytes(),
    GRASPS.as_bytes(),
    NPY,
    PUSH.as_bytes(),
];

#[test]
fn every_reader_takes_its_sample() {
    for (reader, sample) in SAMPLES.iter().enumerate() {
        assert!(read_with(reader, sample), "reader {reader}");
    }
}

#[test]
fn deep_nesting_and_long_lines_do_not_overflow() {
    for token in ["[", "{\"a\":", "(", "a = [", "[[a]]\n", "a.", "[a.", "\"", ",", "v 0 0 0 ", "f 1 ", "{a="] {
        let bytes = token.repeat(50_000).into_bytes();
        for reader in 0..SAMPLES.len() {
            let _ = read_with(reader, &bytes);
            let _ = read_with(reader, &[SAMPLES[reader], &bytes].concat());
        }
    }
}

/// A change to a valid file: put these bytes over or into it at a place, or cut it there.
fn edits() -> impl Strategy<Value = Vec<(usize, u8, Vec<u8>)>> {
    let token = prop_oneof![
        prop::collection::vec(any::<u8>(), 0..4),
        prop::sample::select(vec![
            "nan",
            "-inf",
            "1e999",
            ",",
            "\n",
            "\"",
            "[",
            "]",
            "-1",
            "99999999999999999999",
            "\u{e9}",
            "\0"
        ])
        .prop_map(|s| s.as_bytes().to_vec()),
    ];
    prop::collection::vec((any::<usize>(), 0..3u8, token), 1..6)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(15_000))]

    #[test]
    fn readers_survive_arbitrary_bytes(reader in 0..10usize, bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = read_with(reader, &bytes);
    }

    #[test]
    fn readers_survive_damaged_files(reader in 0..10usize, edits in edits()) {
        let mut bytes = SAMPLES[reader].to_vec();
        for (at, kind, token) in edits {
            let at = at % (bytes.len() + 1);
            match kind {
                0 => bytes.truncate(at),
                1 => drop(bytes.splice(at..at, token)),
                _ => {
                    let end = (at + token.len()).min(bytes.len());
                    drop(bytes.splice(at..end, token));
                }
            }
        }
        let _ = read_with(reader, &bytes);
    }
}
