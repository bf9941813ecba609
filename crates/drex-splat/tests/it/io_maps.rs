//! Maps and pictures: npy, exr, png.

use crate::support;

use std::path::Path;

use drex_core::npy::{npy_bytes, parse_npy};
use drex_splat::Render;
use drex_splat::io::{exr, picture};
use proptest::prelude::*;

#[test]
fn npy_files_of_numpy_are_read() {
    let Some(folder) = support::shared("golden/splat") else { return };
    let bytes = std::fs::read(folder.join("ssim.npz")).unwrap();
    let golden = support::parse_npz(&bytes);
    for (name, array) in &golden {
        let read = parse_npy(Path::new("ssim.npz"), support::npz_members(&bytes)[name]).unwrap();
        assert_eq!((read.numbers().unwrap(), &read.shape), (&array.values[..], &array.shape), "{name}");
    }
}

/// Reads back what the layout says, independently of how it was written.
fn read_exr(bytes: &[u8]) -> (Vec<String>, [i32; 4], Vec<Vec<f32>>) {
    let i32_at = |p: usize| i32::from_le_bytes(bytes[p..p + 4].try_into().unwrap());
    let text = |p: &mut usize| {
        let end = *p + bytes[*p..].iter().position(|&b| b == 0).unwrap();
        let text = String::from_utf8(bytes[*p..end].to_vec()).unwrap();
        *p = end + 1;
        text
    };
    assert_eq!((i32_at(0), i32_at(4)), (0x0131_2f76, 2));
    let (mut p, mut names, mut window, mut seen) = (8, Vec::new(), [0; 4], Vec::new());
    loop {
        let name = text(&mut p);
        if name.is_empty() {
            break;
        }
        let (_, size) = (
            text(&mut p),
            i32_at({
                seen.push(name.clone());
                p
            }) as usize,
        );
        p += 4;
        match name.as_str() {
            "channels" => {
                let mut q = p;
                while bytes[q] != 0 {
                    names.push(text(&mut q));
                    assert_eq!([i32_at(q), i32_at(q + 8), i32_at(q + 12)], [2, 1, 1]);
                    q += 16;
                }
                assert_eq!(q + 1, p + size);
            }
            "dataWindow" => window = [0, 4, 8, 12].map(|k| i32_at(p + k)),
            "compression" => assert_eq!(bytes[p], 0),
            _ => {}
        }
        p += size;
    }
    for name in [
        "channels",
        "compression",
        "dataWindow",
        "displayWindow",
        "lineOrder",
        "pixelAspectRatio",
        "screenWindowCenter",
        "screenWindowWidth",
    ] {
        assert!(seen.iter().any(|s| s == name), "{name} is required");
    }
    let (w, h) = ((window[2] + 1) as usize, (window[3] + 1) as usize);
    let mut planes = vec![Vec::new(); names.len()];
    for y in 0..h {
        let mut q = u64::from_le_bytes(bytes[p + 8 * y..p + 8 * y + 8].try_into().unwrap()) as usize;
        assert_eq!([i32_at(q), i32_at(q + 4)], [y as i32, (4 * w * names.len()) as i32]);
        q += 8;
        for plane in &mut planes {
            plane.extend(bytes[q..q + 4 * w].chunks_exact(4).map(|c| f32::from_le_bytes(c.try_into().unwrap())));
            q += 4 * w;
        }
    }
    (names, window, planes)
}

#[test]
fn exr_holds_every_bit() {
    let folder = tempfile::tempdir().unwrap();
    let (w, h) = (5, 3);
    let depth: Vec<f32> = (0..15).map(|i| 1.0 / (i as f32 + 0.3)).collect();
    let vectors: Vec<[f32; 3]> = depth.iter().map(|&z| [z, -2.0 * z, z * z]).collect();
    let (a, b) = (folder.path().join("deep/z.exr"), folder.path().join("n.exr"));
    exr::write_depth(&a, w, h, &depth).unwrap();
    exr::write_vectors(&b, w, h, &vectors).unwrap();
    assert_eq!(read_exr(&std::fs::read(a).unwrap()), (vec!["Z".into()], [0, 0, 4, 2], vec![depth]));
    let plane = |k: usize| vectors.iter().map(|v| v[k]).collect::<Vec<_>>();
    let expected = (["B", "G", "R"].map(String::from).to_vec(), [0, 0, 4, 2], vec![plane(2), plane(1), plane(0)]);
    assert_eq!(read_exr(&std::fs::read(b).unwrap()), expected);
    for (w, h, channels) in [
        (5, 3, vec![]),
        (0, 3, vec![("Z", &[][..])]),
        (2, 2, vec![("Z", &[0.0; 3][..])]),
        (1, 1, vec![("Z", &[0.0][..]), ("Z", &[0.0][..])]),
        (1, 1, vec![("", &[0.0][..])]),
        (usize::MAX, 2, vec![("Z", &[0.0][..])]),
    ] {
        assert!(exr::to_bytes(w, h, &channels).is_err(), "{w} {h} {channels:?}");
    }
}

#[test]
fn pictures_show_what_was_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    picture::write_rgb(&at("c.png"), 2, 1, &[[0.0, 0.5, 1.0], [-3.0, f32::NAN, 7.0]]).unwrap();
    picture::write_alpha(&at("a.png"), 1, 2, &[0.25, 1.0]).unwrap();
    // Colours are divided by the opacity they were drawn with.
    picture::write_rgba(&at("t.png"), 2, 1, &[[0.2, 0.1, 0.4], [0.0; 3]], &[0.4, 0.0]).unwrap();
    let transparent = image::open(at("t.png")).unwrap().to_rgba8();
    assert_eq!(transparent.as_raw()[..], [128, 64, 255, 102, 0, 0, 0, 0]);
    picture::write_depth(&at("z.png"), 3, 1, &[1.0, 3.0, 0.0], [1.0, 3.0]).unwrap();
    picture::write_normals(&at("n.png"), 2, 1, &[[0.0, 0.0, -0.5], [0.0, 0.0, 0.0]]).unwrap();
    let read = |name: &str| image::open(at(name)).unwrap().to_rgb8().into_raw();
    assert_eq!(read("c.png"), [0, 128, 255, 0, 0, 255]);
    assert_eq!(read("a.png"), [64, 64, 64, 255, 255, 255]);
    assert_eq!(read("z.png"), [253, 231, 37, 68, 1, 84, 0, 0, 0]);
    assert_eq!(read("n.png"), [128, 128, 255, 0, 0, 0]);
    let error = picture::write_rgb(&at("e.png"), 2, 2, &[[0.0; 3]; 3]).unwrap_err().to_string();
    assert!(error.contains("2 x 2") && error.contains('3'), "{error}");
    assert!(picture::write_alpha(&at("e.png"), 0, 0, &[]).is_err());
    std::fs::write(at("file"), b"").unwrap();
    assert!(picture::write_alpha(&at("file/e.png"), 1, 1, &[0.0]).unwrap_err().to_string().contains("file"));
}

#[test]
fn depth_is_normalised_and_its_range_ignores_outliers() {
    let render = Render { depth: vec![1.0, 0.0], alpha: vec![0.5, 0.0], ..Render::default() };
    assert_eq!(render.expected_depth(), [2.0, 0.0]);
    let render = Render { normal: vec![[0.0, -0.3, 0.4], [0.0; 3]], ..Render::default() };
    assert_eq!(render.unit_normals(), [[0.0, -0.6, 0.8], [0.0; 3]]);
    let mut depth: Vec<f32> = (1..=100).map(|i| i as f32).collect();
    depth.extend([0.0, f32::NAN]);
    assert_eq!(picture::depth_range(&depth), Some([3.0, 98.0]));
    assert_eq!(picture::depth_range(&[0.0, f32::INFINITY]), None);
}

proptest! {
    #[test]
    fn damaged_arrays_never_panic(at in 0usize..200, byte: u8, cut in 0usize..400) {
        let mut bytes = npy_bytes(&[3, 4], &[1.5; 12]).unwrap();
        let len = bytes.len();
        bytes[at % len] = byte;
        bytes.truncate(if cut % 2 == 0 { cut % len } else { len });
        let _ = parse_npy(Path::new("a.npy"), &bytes);
    }
}
