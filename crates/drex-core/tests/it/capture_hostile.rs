//! Damaged files: an error that names the file, or a capture that holds together; never a panic, never more memory than
//! the file has bytes.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use drex_core::camera::CameraModel;
use drex_core::capture::{Capture, CaptureOptions, Photos};
use proptest::prelude::*;

use crate::capture_support::{lens, on_disk, ring};

/// A capture folder with files of every kind, and the sound bytes of those that will be damaged.
struct Sound {
    _guard: tempfile::TempDir,
    folder: PathBuf,
}

const BINARY: [&str; 3] = ["sparse/0/cameras.bin", "sparse/0/images.bin", "sparse/0/points3D.bin"];
const TEXT: [&str; 3] = ["sparse/0/cameras.txt", "sparse/0/images.txt", "sparse/0/points3D.txt"];

fn sound(text: bool) -> Sound {
    let mut model = ring(&lens(CameraModel::OpenCv), 3, 6);
    // Some bytes that are changed by chance should hit numbers that matter.
    model.images.iter_mut().for_each(|i| i.keypoints.truncate(4));
    let (guard, folder) = on_disk(&model);
    if text {
        std::fs::remove_dir_all(folder.join("sparse/0")).unwrap();
        model.write_txt(&folder.join("sparse/0"));
    }
    Sound { _guard: guard, folder }
}

/// Loads and uses a capture; whatever comes out must hold together.
fn try_out(folder: &Path) -> Result<(), String> {
    let capture = Capture::load(folder, &CaptureOptions::default()).map_err(|e| e.to_string())?;
    for (i, point) in capture.points.iter().enumerate() {
        for (view, k) in &point.track {
            assert_eq!(capture.views[*view].keypoints[*k].point, Some(i));
        }
    }
    assert!(capture.views.iter().flat_map(|v| &v.keypoints).all(|k| k.point.is_none_or(|p| p < capture.points.len())));
    assert!(capture.extent() > 0.0);
    let report = capture.report().map_err(|e| e.to_string())?;
    assert!(!report.to_string().is_empty());
    let photos = Photos::new(&capture, Default::default()).map_err(|e| e.to_string())?;
    for view in 0..photos.len() {
        photos.camera(view).check().unwrap();
        photos.get(view).map_err(|e| e.to_string())?;
    }
    Ok(())
}

#[test]
fn a_file_cut_anywhere_is_refused_by_name() {
    let Sound { folder, _guard } = sound(false);
    for name in BINARY {
        let path = folder.join(name);
        let bytes = std::fs::read(&path).unwrap();
        for length in 0..bytes.len() {
            std::fs::write(&path, &bytes[..length]).unwrap();
            let message = try_out(&folder).expect_err(&format!("{name} cut at {length} of {}", bytes.len()));
            assert!(message.contains(Path::new(name).file_name().unwrap().to_str().unwrap()), "{message}");
        }
        // Nor may anything follow.
        std::fs::write(&path, [bytes.as_slice(), &[0]].concat()).unwrap();
        assert!(try_out(&folder).unwrap_err().contains("1 bytes follow"));
        std::fs::write(&path, bytes).unwrap();
    }
    try_out(&folder).unwrap();
}

#[test]
fn counts_are_not_believed() {
    let Sound { folder, _guard } = sound(false);
    for (name, at) in [(BINARY[0], 0), (BINARY[1], 0), (BINARY[2], 0), (BINARY[2], 8 + 8 + 24 + 3 + 8)] {
        let path = folder.join(name);
        let bytes = std::fs::read(&path).unwrap();
        for count in [u64::MAX, u64::MAX / 24, 1 << 40, 1 << 20] {
            let mut bytes = bytes.clone();
            bytes[at..at + 8].copy_from_slice(&count.to_le_bytes());
            std::fs::write(&path, bytes).unwrap();
            assert!(try_out(&folder).unwrap_err().contains("are announced, but only"));
        }
        std::fs::write(&path, bytes).unwrap();
    }
}

#[test]
fn text_that_is_wrong_is_refused_by_line() {
    let Sound { folder, _guard } = sound(true);
    for (name, from, to, reason) in [
        (TEXT[0], "OPENCV", "LENS", "cameras.txt, line 2: camera model `LENS` is not known"),
        (TEXT[0], "160", "-160", "cameras.txt, line 2: `-160` is no image width"),
        (TEXT[0], "160", "16000000000", "cameras.txt, line 2: camera 2 has images of 16000000000"),
        (TEXT[0], " 0.002", "", "cameras.txt, line 2: OPENCV camera: 7 parameters instead of 8"),
        (TEXT[1], "view 00.png", "", "images.txt, line 2: the line ends where the image name should be"),
        (TEXT[1], "-1", "-1 5", "images.txt, line 3: "),
        (TEXT[2], " 0.25", " 0.25 9", "points3D.txt, line 2: a track with half an entry"),
        (TEXT[2], " 100 ", " 256 ", "points3D.txt, line 2: `256` is no green"),
    ] {
        let path = folder.join(name);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{text}");
        std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let message = try_out(&folder).unwrap_err();
        assert!(message.contains(reason), "{message}");
        std::fs::write(&path, text).unwrap();
    }
    try_out(&folder).unwrap();
}

/// What is done to a file: bytes are replaced, and a piece is cut out or doubled.
#[derive(Debug, Clone)]
struct Damage {
    file: usize,
    bytes: Vec<(prop::sample::Index, u8)>,
    cut: Option<(prop::sample::Index, prop::sample::Index)>,
}

fn damage() -> impl Strategy<Value = Damage> {
    let byte = (any::<prop::sample::Index>(), prop_oneof![any::<u8>(), Just(0), Just(255), Just(b' '), Just(b'9')]);
    let cut = prop::option::of((any::<prop::sample::Index>(), any::<prop::sample::Index>()));
    (0usize..3, prop::collection::vec(byte, 0..4), cut).prop_map(|(file, bytes, cut)| Damage { file, bytes, cut })
}

fn damaged(sound: &[u8], damage: &Damage) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    for (at, value) in &damage.bytes {
        let at = at.index(bytes.len());
        bytes[at] = *value;
    }
    if let Some((a, b)) = &damage.cut {
        let (a, b) = (a.index(bytes.len()), b.index(bytes.len()));
        // From a to b: cut out, or (b before a) doubled.
        bytes = [&bytes[..a], &bytes[b..]].concat();
    }
    bytes
}

fn survive(sound: &'static OnceLock<Sound>, files: [&str; 3], make: fn() -> Sound, damage: &Damage) {
    let sound = sound.get_or_init(make);
    let path = sound.folder.join(files[damage.file]);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, damaged(&bytes, damage)).unwrap();
    let result = std::panic::catch_unwind(|| try_out(&sound.folder));
    std::fs::write(&path, bytes).unwrap();
    if let Err(panic) = result {
        std::panic::resume_unwind(panic);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn binary_models_survive(damage in damage()) {
        static SOUND: OnceLock<Sound> = OnceLock::new();
        survive(&SOUND, BINARY, || sound(false), &damage);
    }

    #[test]
    fn text_models_survive(damage in damage()) {
        static SOUND: OnceLock<Sound> = OnceLock::new();
        survive(&SOUND, TEXT, || sound(true), &damage);
    }

    #[test]
    fn transforms_and_their_files_survive(damage in damage()) {
        static SOUND: OnceLock<Sound> = OnceLock::new();
        survive(&SOUND, ["transforms.json", "points.ply", "depths/view 01.npy"], nerfstudio, &damage);
    }
}

fn nerfstudio() -> Sound {
    let sound = sound(false);
    let folder = &sound.folder;
    std::fs::remove_dir_all(folder.join("sparse")).unwrap();
    let frame = |i: usize| {
        let turn = [[0.0, -1.0, 0.0, 1.5], [1.0, 0.0, 0.0, i as f64], [0.0, 0.0, 1.0, 0.5], [0.0, 0.0, 0.0, 1.0]];
        serde_json::json!({"file_path": format!("images/view {i:02}.png"), "transform_matrix": turn})
    };
    let file = serde_json::json!({
        "w": 160, "h": 120, "fl_x": 130.5, "cx": 77.5, "k1": -0.1, "p1": 0.001, "camera_model": "OPENCV",
        "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]], "ply_file_path": "points.ply",
        "frames": [frame(0), frame(1), frame(2)],
    });
    std::fs::write(folder.join("transforms.json"), file.to_string()).unwrap();
    let head = "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
                property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
    std::fs::write(folder.join("points.ply"), [head.as_bytes(), &[63; 45]].concat()).unwrap();
    std::fs::create_dir(folder.join("depths")).unwrap();
    let head = "{'descr': '<f4', 'fortran_order': False, 'shape': (12, 16), }\n";
    let npy =
        [b"\x93NUMPY\x01\x00", (head.len() as u16).to_le_bytes().as_slice(), head.as_bytes(), &[63; 768]].concat();
    std::fs::write(folder.join("depths/view 01.npy"), npy).unwrap();
    sound
}
