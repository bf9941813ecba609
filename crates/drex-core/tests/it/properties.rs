//! Properties that hold for any pose, any bytes, any manifest.

use std::path::Path;

use drex_core::mesh::{parse_obj, parse_stl};
use drex_core::npy::parse_npy;
use drex_core::pose::{interpolate, parse_pose_matrix, pose_difference, pose_from_matrix, pose_from_wxyz, to_wxyz};
use drex_core::{Pose, Trajectory};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use proptest::prelude::*;

fn poses() -> impl Strategy<Value = Pose> {
    (prop::array::uniform3(-2.0..2.0f64), prop::array::uniform3(-1.8..1.8f64)).prop_map(|(t, r)| {
        Pose::from_parts(Vector3::from(t).into(), UnitQuaternion::from_scaled_axis(Vector3::from(r)))
    })
}

fn close(a: &Pose, b: &Pose) -> bool {
    (a.to_homogeneous() - b.to_homogeneous()).abs().max() < 1e-12
}

proptest! {
    #[test]
    fn poses_form_a_group(a in poses(), b in poses(), c in poses(), p in prop::array::uniform3(-1.0..1.0f64)) {
        prop_assert!(close(&((a * b) * c), &(a * (b * c))));
        prop_assert!(close(&(a * a.inverse()), &Pose::identity()));
        prop_assert!(close(&(a * b).inverse(), &(b.inverse() * a.inverse())));
        let p = Point3::from(p);
        prop_assert!(((a * b) * p - a * (b * p)).norm() < 1e-12);
    }

    #[test]
    fn poses_survive_their_disk_forms(a in poses()) {
        let (t, q) = to_wxyz(&a);
        prop_assert!(q[0] >= 0.0);
        prop_assert!(close(&pose_from_wxyz(t, q).unwrap(), &a));
        prop_assert!(close(&pose_from_wxyz(t, q.map(|v| -v)).unwrap(), &a));
        prop_assert!(close(&pose_from_matrix(&a.to_homogeneous()).unwrap(), &a));
    }

    #[test]
    fn interpolation_is_a_geodesic_of_constant_speed(a in poses(), b in poses(), s in 0.0..1.0f64, t in 0.0..1.0f64) {
        prop_assert!(close(&interpolate(&a, &b, 0.0), &a) && close(&interpolate(&a, &b, 1.0), &b));
        let (at_s, at_t) = (interpolate(&a, &b, s), interpolate(&a, &b, t));
        prop_assert!((at_s.rotation.norm() - 1.0).abs() < 1e-12);
        let whole = pose_difference(&a, &b);
        let part = pose_difference(&at_s, &at_t);
        let ratio = (t - s).abs();
        let angle = |d: &nalgebra::Vector6<f64>| d.fixed_rows::<3>(3).norm();
        prop_assert!((angle(&part) - ratio * angle(&whole)).abs() < 1e-9);
        prop_assert!((part.fixed_rows::<3>(0) - whole.fixed_rows::<3>(0) * (t - s)).norm() < 1e-12);
        // As nalgebra's own slerp, up to the sign of a half turn.
        if angle(&whole) < 3.1 {
            prop_assert!(a.rotation.slerp(&b.rotation, s).angle_to(&at_s.rotation) < 1e-7);
        }
    }

    #[test]
    fn a_trajectory_is_sorted_and_stays_inside_its_span(
        samples in prop::collection::vec((-10.0..10.0f64, poses()), 1..30), t in -11.0..11.0f64
    ) {
        let (times, poses): (Vec<f64>, Vec<Pose>) = samples.into_iter().unzip();
        let track = Trajectory::from_samples(&times, &poses).unwrap();
        prop_assert!(track.times_s().windows(2).all(|w| w[0] < w[1]));
        let (first, last) = track.span_s().unwrap();
        prop_assert_eq!(track.at(t).is_some(), (first..=last).contains(&t));
        for (time, pose) in track.times_s().iter().zip(track.poses()) {
            prop_assert!(close(&track.at(*time).unwrap(), pose));
        }
        prop_assert_eq!(track.velocities().len(), track.len());
    }
}

const NPY: &[u8] = b"\x93NUMPY\x01\x00\x40\x00{'descr': '<f4', 'fortran_order': False, 'shape': (1, 2), }    \n\0\0\x80\x3f\0\0\x80\x3f";
const STL: &str =
    "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n";
const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0 1 1 1\nf 1/1 2//3 -1\n";

/// Every reader, told apart by number; whether it took the bytes.
fn read_with(reader: usize, bytes: &[u8]) -> bool {
    let path = Path::new("fuzz");
    let text = String::from_utf8_lossy(bytes);
    match reader {
        0 => parse_npy(path, bytes).is_ok(),
        1 => parse_stl(path, bytes).is_ok(),
        2 => parse_obj(path, bytes).is_ok(),
        _ => parse_pose_matrix(path, 1, &text).is_ok(),
    }
}

const SAMPLES: [&[u8]; 4] = [NPY, STL.as_bytes(), OBJ.as_bytes(), b"1 0 0 0.1\n0 1 0 0.2\n0 0 1 0.3\n0 0 0 1\n"];

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
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn readers_survive_arbitrary_bytes(reader in 0..SAMPLES.len(), bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = read_with(reader, &bytes);
    }

    #[test]
    fn readers_survive_damaged_files(reader in 0..SAMPLES.len(), edits in edits()) {
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
