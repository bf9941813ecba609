//! Sets of Gaussians out and in: ply, spz, splat.

use std::path::Path;

use drex_splat::io::{self, ply, splat, spz};
use drex_splat::{Gaussians, Kind, Label};
use proptest::prelude::*;

fn set(kind: Kind, sh_degree: usize, n: usize, seed: u64) -> Gaussians {
    use rand::{RngExt as _, SeedableRng as _};
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut g = Gaussians::new(kind, sh_degree);
    let mut number = |scale: f32| rng.random_range(-scale..scale);
    for i in 0..n {
        g.means.push([number(2.0), number(2.0), number(2.0)]);
        g.rotations.push([number(1.0), number(1.0), number(1.0), number(1.0)]);
        g.log_scales.push([-4.0 + number(2.0), -4.0 + number(2.0), -4.0 + number(2.0)]);
        g.logit_opacities.push(number(4.0));
        let stride = g.sh_stride();
        g.sh.extend((0..stride).map(|_| number(0.8)));
        g.labels.push(Label((i % 3) as u8));
    }
    g
}

fn name() -> &'static Path {
    Path::new("test.ply")
}

/// Header lines and the bytes after them.
fn split(bytes: &[u8]) -> (Vec<String>, Vec<u8>) {
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    (String::from_utf8(bytes[..end].to_vec()).unwrap().lines().map(str::to_owned).collect(), bytes[end..].to_vec())
}

#[test]
fn ply_keeps_every_bit_of_ellipsoids() {
    for degree in 0..=3 {
        let g = set(Kind::Ellipsoid, degree, 50, 7 + degree as u64);
        let back = ply::parse(name(), &ply::to_bytes(&g).unwrap(), Kind::Surfel).unwrap();
        assert_eq!(back.kind, Kind::Surfel, "nothing in the file says otherwise");
        assert_eq!(Gaussians { kind: Kind::Ellipsoid, ..back }, g);
    }
}

#[test]
fn ply_of_ellipsoids_has_the_published_layout() {
    let mut g = set(Kind::Ellipsoid, 3, 2, 1);
    g.labels.fill(Label::BACKGROUND);
    let (header, body) = split(&ply::to_bytes(&g).unwrap());
    let mut expected: Vec<String> =
        ["ply", "format binary_little_endian 1.0", "element vertex 2"].map(String::from).into();
    let mut names: Vec<String> =
        ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(String::from).into();
    names.extend((0..45).map(|i| format!("f_rest_{i}")));
    names.extend(["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"].map(String::from));
    expected.extend(names.iter().map(|n| format!("property float {n}")));
    expected.push("end_header".into());
    assert_eq!(header, expected);
    let values: Vec<f32> = body.chunks_exact(4).map(|c| f32::from_le_bytes(c.try_into().unwrap())).collect();
    assert_eq!(values.len(), 2 * 62);
    let at = |name: &str| values[62 + names.iter().position(|n| n == name).unwrap()];
    // Gaussian 1: coefficient k of channel c is f_rest_{15 c + k - 1}.
    assert_eq!(at("f_rest_0"), g.sh[48 + 3]);
    assert_eq!(at("f_rest_14"), g.sh[48 + 3 * 15]);
    assert_eq!(at("f_rest_15"), g.sh[48 + 3 + 1]);
    assert_eq!(at("f_rest_44"), g.sh[48 + 3 * 15 + 2]);
    assert_eq!(
        [at("x"), at("nx"), at("opacity"), at("scale_2"), at("rot_0")],
        [g.means[1][0], 0.0, g.logit_opacities[1], g.log_scales[1][2], g.rotations[1][0]]
    );
}

#[test]
fn ply_of_surfels_is_thin_for_others_and_surfels_for_us() {
    let g = set(Kind::Surfel, 1, 20, 3);
    let bytes = ply::to_bytes(&g).unwrap();
    let back = ply::parse(name(), &bytes, Kind::Ellipsoid).unwrap();
    assert_eq!(back.kind, Kind::Surfel);
    assert_eq!(back.labels, g.labels);
    for i in 0..g.len() {
        assert_eq!(back.log_scales[i][..2], g.log_scales[i][..2]);
        let thin = back.log_scales[i][2] - g.log_scales[i][0].min(g.log_scales[i][1]);
        assert!((thin.exp() - 0.01).abs() < 1e-6);
    }
    // The label comes last, so that the order of the rest is the published one.
    let (header, _) = split(&bytes);
    assert_eq!(header[header.len() - 3..], ["property uchar label", "comment drex kind surfel", "end_header"]);
}

#[test]
fn ply_with_two_scales_is_surfels() {
    let g = set(Kind::Surfel, 0, 3, 4);
    let (header, body) = split(&ply::to_bytes(&Gaussians { labels: vec![Label(0); 3], ..g.clone() }).unwrap());
    let kept: Vec<String> = header.into_iter().filter(|l| !l.contains("scale_2") && !l.contains("comment")).collect();
    let mut bytes = (kept.join("\n") + "\n").into_bytes();
    for row in body.chunks_exact(4 * 17) {
        bytes.extend(&row[..4 * 12]);
        bytes.extend(&row[4 * 13..]);
    }
    let back = ply::parse(name(), &bytes, Kind::Ellipsoid).unwrap();
    assert_eq!((back.kind, back.means, back.rotations), (Kind::Surfel, g.means, g.rotations));
    assert_eq!(back.log_scales[2], [g.log_scales[2][0], g.log_scales[2][1], f32::NEG_INFINITY]);
}

#[test]
fn ply_in_text_any_order_any_type_and_with_more_in_it() {
    let text = "ply\r\nformat ascii 1.0\r\ncomment made by hand\nobj_info x\nelement camera 2\nproperty float f\nelement vertex 1\n\
        property double rot_3\nproperty float rot_2\nproperty float rot_1\nproperty float rot_0\nproperty int confidence\n\
        property uchar label\nproperty float z\nproperty float y\nproperty float x\nproperty float opacity\n\
        property float scale_2\nproperty float scale_1\nproperty float scale_0\nproperty float f_dc_2\nproperty float f_dc_1\n\
        property float f_dc_0\nelement face 7\nproperty list uchar int vertex_indices\nend_header\n1\n2\n\
        4 3 2 1 99 5 30 20 10 -1.5 -3 -2 -1 0.3 0.2 0.1\n";
    let g = ply::parse(name(), text.as_bytes(), Kind::Ellipsoid).unwrap();
    assert_eq!(g.means, [[10.0, 20.0, 30.0]]);
    assert_eq!(g.rotations, [[1.0, 2.0, 3.0, 4.0]]);
    assert_eq!(g.log_scales, [[-1.0, -2.0, -3.0]]);
    assert_eq!((g.sh, g.logit_opacities, g.labels), (vec![0.1, 0.2, 0.3], vec![-1.5], vec![Label(5)]));
    let error = ply::parse(name(), text.replace("-1.5", "much").as_bytes(), Kind::Ellipsoid).unwrap_err().to_string();
    assert!(error.contains("test.ply, line 29") && error.contains("opacity"), "{error}");
    let error = ply::parse(name(), text.replace("vertex 1", "vertex 2").as_bytes(), Kind::Ellipsoid).unwrap_err();
    assert!(error.to_string().contains("line 30"), "{error}");
}

#[test]
fn ply_big_endian() {
    let g = Gaussians { labels: vec![Label(0); 5], ..set(Kind::Ellipsoid, 2, 5, 9) };
    let (header, body) = split(&ply::to_bytes(&g).unwrap());
    let mut bytes = (header.join("\n").replace("little", "big") + "\n").into_bytes();
    bytes.extend(body.chunks_exact(4).flat_map(|c| [c[3], c[2], c[1], c[0]]));
    assert_eq!(ply::parse(name(), &bytes, Kind::Ellipsoid).unwrap(), g);
}

#[test]
fn hostile_ply_is_a_named_error() {
    let start = "ply\nformat binary_little_endian 1.0\n";
    let cases = [
        ("", "line 1"),
        ("PLY\n", "line 1"),
        ("ply\n\u{0}", "line 2"),
        (&format!("ply\nformat binary {}", "x".repeat(1 << 16)), "line 2"),
        (&format!("{start}element vertex -3\n"), "line 3"),
        (&format!("{start}element vertex 99999999999999999999999\n"), "line 3"),
        (&format!("{start}property float x\n"), "line 3"),
        (&format!("{start}element vertex 1\nproperty float x\nproperty float x\n"), "twice"),
        (&format!("{start}element vertex 1\nproperty list uchar int x\nend_header\n"), "lists"),
        (&format!("{start}element vertex 1\nproperty quad x\n"), "quad"),
        (&format!("{start}element face 1\nend_header\n"), "no element vertex"),
        (&format!("{start}element vertex 1\nproperty float x\nend_header\n"), "no property y"),
        ("ply\nelement vertex 0\nend_header\n", "no format"),
    ];
    for (text, word) in cases {
        let error = ply::parse(name(), text.as_bytes(), Kind::Ellipsoid).unwrap_err().to_string();
        assert!(error.contains(word) && error.starts_with("test.ply"), "{word}: {error}");
    }
    // Counts that no memory holds, in binary, in text, and in an element before the vertices.
    let g = set(Kind::Ellipsoid, 3, 1, 5);
    let (header, body) = split(&ply::to_bytes(&g).unwrap());
    let header = header.join("\n") + "\n";
    for (from, to) in [
        ("vertex 1", "vertex 18446744073709551615"),
        ("vertex 1", "vertex 2"),
        ("element vertex 1", "element pad 9999999999999999999\nproperty double p\nelement vertex 1"),
    ] {
        for format in ["binary_little_endian", "ascii"] {
            let text = header.replace(from, to).replace("binary_little_endian", format);
            let bytes = [text.as_bytes(), &body].concat();
            assert!(ply::parse(name(), &bytes, Kind::Ellipsoid).is_err(), "{to} {format}");
        }
    }
    let mut bad = body;
    bad[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    let error = ply::parse(name(), &[header.as_bytes(), &bad].concat(), Kind::Ellipsoid).unwrap_err().to_string();
    assert!(error.contains("test.ply") && error.contains("Gaussian 0"), "{error}");
}

#[test]
fn splat_keeps_what_it_has_room_for() {
    let g = set(Kind::Ellipsoid, 2, 100, 11);
    let bytes = splat::to_bytes(&g).unwrap();
    assert_eq!(bytes.len(), 3200);
    let back = splat::parse(Path::new("t.splat"), &bytes, Kind::Ellipsoid).unwrap();
    assert_eq!((back.sh_degree, &back.means), (0, &g.means));
    for i in 0..g.len() {
        for k in 0..3 {
            assert!((back.log_scales[i][k] - g.log_scales[i][k]).abs() < 2e-6);
            let c = (0.5 + 0.282_094_8 * g.sh[27 * i + k]).clamp(0.0, 1.0);
            assert!((0.5 + 0.282_094_8 * back.sh[3 * i + k] - c).abs() < 0.502 / 255.0);
        }
        assert!((back.opacity(i) - g.opacity(i)).abs() < 0.502 / 255.0);
        assert!(angle(back.rotations[i], g.rotations[i]) < 0.016);
    }
    assert!(splat::parse(Path::new("t.splat"), &bytes[1..], Kind::Ellipsoid).unwrap_err().to_string().contains("3199"));
    let zero = Gaussians { rotations: vec![[0.0; 4]; 100], ..g };
    assert!(splat::to_bytes(&zero).unwrap_err().to_string().contains("Gaussian 0"));
}

#[test]
fn spz_keeps_what_it_says() {
    let g = set(Kind::Ellipsoid, 3, 500, 12);
    for version in [spz::Version::V2, spz::Version::V3] {
        let bytes = spz::to_bytes(&g, version).unwrap();
        let back = spz::parse(Path::new("t.spz"), &bytes, Kind::Ellipsoid).unwrap();
        assert_eq!((back.len(), back.sh_degree), (500, 3));
        for i in 0..g.len() {
            for k in 0..3 {
                // Coordinates stay below 2, so 22 of 24 bits could stand after the point; 20 are written.
                assert!((back.means[i][k] - g.means[i][k]).abs() < 0.51 / f32::from(1u16 << 10).powi(2));
                assert!((back.log_scales[i][k] - g.log_scales[i][k]).abs() < 0.0313);
                assert!((back.sh[48 * i + k] - g.sh[48 * i + k]).abs() < 0.5001 / 255.0 / 0.15);
            }
            for k in 3..48 {
                let (off, half) = ((back.sh[48 * i + k] - g.sh[48 * i + k]).abs(), if k < 12 { 4.0 } else { 8.0 });
                assert!(off < (half + 0.01) / 128.0, "{k}: {off}");
            }
            assert!((back.opacity(i) - g.opacity(i)).abs() < 0.501 / 255.0);
            // Version 2 derives w from the others, which is ill-conditioned near half a turn.
            let norm = g.rotations[i].iter().map(|q| q * q).sum::<f32>().sqrt();
            let turn = match version {
                spz::Version::V2 if g.rotations[i][0].abs() / norm > 0.3 => 0.05,
                spz::Version::V2 => 0.35,
                spz::Version::V3 => 0.005,
            };
            let off = angle(back.rotations[i], g.rotations[i]);
            assert!(off < turn, "{version:?}: {off} rad of {:?}", g.rotations[i]);
        }
        let again = spz::to_bytes(&back, version).unwrap();
        assert_eq!(spz::parse(Path::new("t.spz"), &again, Kind::Ellipsoid).unwrap().sh, back.sh);
    }
}

/// A file put together by hand from the published description of the format, not by our writer.
#[test]
fn spz_of_known_bytes() {
    let version_3 = |rotation: u32| {
        let mut b = b"NGSP\x03\0\0\0\x01\0\0\0\x01\x0c\x01\0".to_vec();
        b.extend([0, 16, 0, 0, 0xf0, 0xff, 0, 32, 0]); // 1, -1, 2 in right, up, back
        b.extend([128, 255, 0, 128, 160, 144, 176]); // opacity, colour, scales 0, -1, 1
        b.extend(rotation.to_le_bytes());
        b.extend([192, 128, 128, 128, 192, 128, 128, 128, 64]); // -C1 y red, C1 z green, -C1 x blue
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut gzip, &b).unwrap();
        gzip.finish().unwrap()
    };
    // Largest: w (3). x = 511/511 √½, y = -√½ 256/511, z = 0.
    let bytes = version_3(3 << 30 | 511 << 20 | (512 + 256) << 10);
    let g = spz::parse(Path::new("t.spz"), &bytes, Kind::Ellipsoid).unwrap();
    assert_eq!(g.means, [[1.0, 1.0, -2.0]]);
    assert_eq!(g.log_scales, [[0.0, -1.0, 1.0]]);
    assert_eq!(g.sh[3..], [-0.5, 0.0, 0.0, 0.0, -0.5, 0.0, 0.0, 0.0, -0.5]);
    assert!((g.opacity(0) - 128.0 / 255.0).abs() < 1e-6 && (g.sh[0] - 0.5 / 0.15).abs() < 1e-6);
    let x = std::f32::consts::FRAC_1_SQRT_2;
    let y = x * 256.0 / 511.0;
    let expected = [(1.0 - x * x - y * y).sqrt(), x, y, 0.0];
    assert!(g.rotations[0].iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6), "{:?}", g.rotations);
}

#[test]
fn hostile_spz_is_a_named_error() {
    let g = set(Kind::Ellipsoid, 1, 40, 13);
    let raw = {
        let mut raw = Vec::new();
        let bytes = spz::to_bytes(&g, spz::Version::V3).unwrap();
        std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(bytes.as_slice()), &mut raw).unwrap();
        raw
    };
    let error = |at: usize, byte: u8, len: usize| {
        let mut raw = raw.clone();
        raw[at] = byte;
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut gzip, &raw[..len]).unwrap();
        let bytes = gzip.finish().unwrap();
        spz::parse(Path::new("t.spz"), &bytes, Kind::Ellipsoid).unwrap_err().to_string()
    };
    let len = raw.len();
    for (at, byte, len, word) in [
        (0, b'X', len, "no .spz"),
        (4, 4, len, "version 4"),
        (4, 1, len, "version 1"),
        (11, 255, len, "Gaussians of degree"),
        (10, 100, len, "would take"),
        (12, 4, len, "degree 4"),
        (13, 64, len, "64 fractional"),
        (14, 2, len, "extensions"),
        (20, 0, len - 1, "ends before"),
        (0, b'N', 9, "no .spz"),
    ] {
        let error = error(at, byte, len);
        assert!(error.contains(word) && error.contains("t.spz"), "{error}");
    }
    let mut far = g.clone();
    far.means[7][1] = 1e9;
    assert!(spz::to_bytes(&far, spz::Version::V2).unwrap_err().to_string().contains("Gaussian 7"));
    far.means[7][1] = 1e6;
    let back = spz::parse(Path::new("t"), &spz::to_bytes(&far, spz::Version::V2).unwrap(), Kind::Ellipsoid).unwrap();
    assert!((back.means[7][1] - 1e6).abs() < 0.13);
}

#[test]
fn the_name_tells_the_format() {
    let folder = tempfile::tempdir().unwrap();
    let g = set(Kind::Ellipsoid, 2, 30, 14);
    for name in ["a.ply", "b.SPZ", "c.splat"] {
        let path = folder.path().join(name);
        io::write_gaussians(&path, &g).unwrap();
        assert_eq!(io::read_gaussians(&path, Kind::Ellipsoid).unwrap().len(), 30);
    }
    let error = io::write_gaussians(&folder.path().join("d.obj"), &g).unwrap_err().to_string();
    assert!(error.contains("d.obj") && error.contains(".spz"), "{error}");
    let error = io::read_gaussians(&folder.path().join("no.ply"), Kind::Ellipsoid).unwrap_err().to_string();
    assert!(error.contains("no.ply"), "{error}");
}

/// Angle between two rotations, radians.
fn angle(a: [f32; 4], b: [f32; 4]) -> f64 {
    let q = |q: [f32; 4]| {
        let [w, x, y, z] = q.map(f64::from);
        nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z))
    };
    q(a).angle_to(&q(b))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Whatever one changes in a file, the answer is a set that can be drawn or an error.
    #[test]
    fn damaged_files_never_panic(at in 0usize..2000, byte: u8, cut in 0usize..2000, which in 0usize..3) {
        let g = set(Kind::Surfel, 1, 6, 2);
        let mut bytes = [ply::to_bytes(&g).unwrap(), splat::to_bytes(&g).unwrap(), spz::to_bytes(&g, spz::Version::V3).unwrap()][which].clone();
        let len = bytes.len();
        bytes[at % len] = byte;
        bytes.truncate(if cut % 3 == 0 { cut % len } else { len });
        let read = [ply::parse, splat::parse, spz::parse][which](name(), &bytes, Kind::Ellipsoid);
        if let Ok(read) = read {
            prop_assert!(read.check().is_ok());
        }
    }
}
