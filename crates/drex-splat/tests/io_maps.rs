//! Maps and pictures: npy, exr, png.
#![allow(clippy::unwrap_used, missing_docs)] // tests: a panic is the report

mod support;

use std::path::Path;

use drex_splat::Render;
use drex_splat::io::{exr, npy, picture};
use proptest::prelude::*;

#[test]
fn npy_round_trips_and_starts_as_numpy_wants() {
    let values: Vec<f32> = (0..24).map(|i| i as f32 * 0.1 - 1.0).collect();
    for shape in [vec![4, 6], vec![2, 4, 3], vec![24], vec![24, 1, 1]] {
        let bytes = npy::to_bytes(&shape, &values).unwrap();
        assert_eq!((bytes.len() - 96) % 64, 0);
        assert_eq!(npy::parse(Path::new("a.npy"), &bytes).unwrap(), npy::Array { shape, values: values.clone() });
    }
    let header = b"\x93NUMPY\x01\0v\0{'descr': '<f4', 'fortran_order': False, 'shape': (24,), }";
    assert!(npy::to_bytes(&[24], &values).unwrap().starts_with(header));
    assert!(npy::to_bytes(&[], &values[..1]).unwrap().windows(11).any(|w| w == b"'shape': ()"));
    assert!(npy::to_bytes(&[5, 5], &values).is_err() && npy::to_bytes(&[usize::MAX, 2], &values).is_err());
}

#[test]
fn npy_files_of_numpy_are_read() {
    let Some(folder) = support::shared("golden/splat") else { return };
    // Members of an uncompressed npz are npy files as numpy writes them.
    let bytes = std::fs::read(folder.join("ssim.npz")).unwrap();
    let golden = support::parse_npz(&bytes);
    let starts: Vec<usize> = (0..bytes.len() - 6).filter(|&p| &bytes[p..p + 6] == b"\x93NUMPY").collect();
    let read: Vec<npy::Array> =
        starts.iter().filter_map(|&p| npy::parse(Path::new("ssim.npz"), &bytes[p..]).ok()).collect();
    for (name, array) in &golden {
        let values: Vec<f32> = array.values.iter().map(|&v| v as f32).collect();
        assert!(read.iter().any(|r| r.shape == array.shape && r.values == values), "{name} {:?}", array.shape);
    }
}

#[test]
fn npy_knows_types_and_names_what_it_does_not() {
    let file = |descr: &str, order: &str, shape: &str, data: &[u8]| {
        let header = format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x02\0".to_vec();
        bytes.extend((header.len() as u32).to_le_bytes());
        bytes.extend(header.bytes());
        bytes.extend(data);
        npy::parse(Path::new("a.npy"), &bytes)
    };
    let half = [0x3c00u16, 0xc100, 0x0001, 0x7c00, 0x7bff].map(u16::to_le_bytes);
    let values = file("'<f2'", "False", "(5,)", half.as_flattened()).unwrap().values;
    assert_eq!(values, [1.0, -2.5, 2f32.powi(-24), f32::INFINITY, 65504.0]);
    assert_eq!(file("'<u2'", "False", "(1, 1)", &[1, 2]).unwrap().values, [513.0]);
    assert_eq!(file("'<f8'", "False", "()", &0.5f64.to_le_bytes()).unwrap().values, [0.5]);
    assert_eq!(file("'|u1'", "False", "(2, 0)", &[]).unwrap().shape, [2, 0]);
    for (result, word) in [
        (file("'>f4'", "False", "(1,)", &[0; 4]), ">f4"),
        (file("[('a', '<f4')]", "False", "(1,)", &[0; 4]), "several fields"),
        (file("'<f4'", "True", "(1,)", &[0; 4]), "C order"),
        (file("'<f4'", "False", "(-1,)", &[0; 4]), "shape"),
        (file("'<f4'", "False", "(2,)", &[0; 4]), "ends before"),
        (file("'<f4'", "False", "(18446744073709551615, 9)", &[0; 4]), "ends before"),
        (npy::parse(Path::new("a.npy"), b"\x93NUMPY\x09"), "no .npy"),
    ] {
        let error = result.unwrap_err().to_string();
        assert!(error.contains(word) && error.contains("a.npy"), "{error}");
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
        let mut bytes = npy::to_bytes(&[3, 4], &[1.5; 12]).unwrap();
        let len = bytes.len();
        bytes[at % len] = byte;
        bytes.truncate(if cut % 2 == 0 { cut % len } else { len });
        let _ = npy::parse(Path::new("a.npy"), &bytes);
    }
}
