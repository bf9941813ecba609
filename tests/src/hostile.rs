//! Small files that ask for much: memory by what they announce or unpack to, time by how they are built. Each with the `drex`
//! command that reads it; `tests/budgets` runs them all.

use std::fmt::Write;
use std::path::Path;

use crate::bytes::{glb, gzip, npy, npz, spz_header, stl};
use crate::seeds;

/// A file, or what lies in a folder, and how `drex` is asked to read it.
pub struct Case {
    /// What it is, for tables.
    pub name: &'static str,
    /// Files and their bytes, relative to the folder of the case.
    pub files: Vec<(&'static str, Vec<u8>)>,
    /// Arguments of `drex`, run in the folder of the case.
    pub command: &'static str,
}

fn one(name: &'static str, file: &'static str, bytes: impl Into<Vec<u8>>, command: &'static str) -> Case {
    Case { name, files: vec![(file, bytes.into())], command }
}

/// All cases, one after the other, so that only one is in memory. Sizes are those of real attempts: up to 100 MB.
pub fn cases() -> Vec<fn() -> Case> {
    vec![
        || one("GLB, 2000 materials with one picture of 4 MB", "a.glb", many_materials(2000, 1), "mesh check a.glb"),
        || one("GLB, 2000 pictures of the same 4 MB", "a.glb", many_materials(2000, 2000), "mesh check a.glb"),
        || one("GLB, 2000 buffers over the same 4 MB", "a.glb", many_buffers(2000), "mesh check a.glb"),
        || {
            one(
                "GLB, 4000 nodes with one mesh of 100,000 corners",
                "a.glb",
                instances(100_000, 4000),
                "mesh check a.glb",
            )
        },
        || one("GLB, 300,000 nodes with one triangle", "a.glb", instances(3, 300_000), "mesh check a.glb"),
        || one("glTF, nodes nested 100,000 deep", "a.gltf", deep_nodes(100_000), "mesh check a.gltf"),
        || one("glTF, 90 MB of empty objects", "a.gltf", empty_objects(90_000_000), "mesh check a.gltf"),
        || one("PLY header, 4e9 vertices", "a.ply", ply_header(4_000_000_000), "mesh check a.ply"),
        || one("PLY header, 500,000 properties", "a.ply", ply_properties(500_000), "render a.ply --out out"),
        || one("STL header, 4e9 triangles", "a.stl", stl(u32::MAX, &[[[0.0; 3]; 3]]), "mesh check a.stl"),
        || one("STL, 2 million triangles (100 MB)", "a.stl", grid_stl(1000), "mesh check a.stl"),
        || one("OBJ, 12 million faces (96 MB)", "a.obj", same_face(12_000_000), "mesh check a.obj"),
        || one("OBJ, one line of 50 MB", "a.obj", [b"v ".as_slice(), &[b'1'; 50_000_000]].concat(), "mesh check a.obj"),
        || one("OBJ, a name of 2 MB and 200,000 faces", "a.obj", long_name(2_000_000, 200_000), "mesh check a.obj"),
        || one("OBJ, 300,000 materials", "a.obj", obj_materials(300_000), "mesh check a.obj"),
        || one("OBJ, a prism whose ends have 2000 corners", "a.obj", prism(2000), "mesh check a.obj"),
        || one("OBJ, a prism whose ends have 100,000 corners", "a.obj", prism(100_000), "mesh check a.obj"),
        || one("STL, ends of 2000 slivers round one corner", "a.stl", fans(2000), "mesh check a.stl"),
        || one("STL, ends of 20,000 slivers round one corner", "a.stl", fans(20_000), "mesh check a.stl"),
        || one("OBJ, a bowl with a ragged rim of 1500 edges", "a.obj", bowl(1500, 0.1, None), "mesh check a.obj"),
        || {
            one(
                "OBJ, a thick bowl without its rim of 2 x 1500 edges",
                "a.obj",
                bowl(1500, 0.0, Some(0.9)),
                "mesh check a.obj",
            )
        },
        || one("OBJ, 20,000 separate tetrahedra", "a.obj", tetrahedra(20_000), "mesh check a.obj"),
        || one("OBJ, 2000 crumbs inside of a ball of 160,000 faces", "a.obj", crumbs(400, 2000), "mesh check a.obj"),
        || {
            one(
                "a picture of 8192 pixels a side",
                "a.obj",
                seeds::obj().remove(0),
                "mesh picture a.obj --size 8192 --out a.png",
            )
        },
        || one("--threads 1000000000", "a.obj", seeds::obj().remove(0), "mesh check a.obj --threads 1000000000"),
        || {
            one(
                "SPZ, 10 million Gaussians in 632 kB",
                "a.spz",
                spz(10_000_000),
                "render a.spz --out out --orbit 1 --size 64x64",
            )
        },
        || {
            one(
                "splat, 3 million Gaussians (96 MB)",
                "a.splat",
                vec![1; 96_000_000],
                "render a.splat --out out --orbit 1 --size 64x64",
            )
        },
        || {
            one(
                "npy header, 4e9 frames",
                "d.npy",
                npy("<f8", "(4000000000, 21, 3)", &[]),
                "retarget d.npy --hand leap --out o.json",
            )
        },
        || {
            one(
                "npy, 90 MB of bytes",
                "d.npy",
                npy("|u1", "(1428571, 21, 3)", &vec![1; 89_999_973]),
                "retarget d.npy --hand leap --out o.json",
            )
        },
        || one("npz, 1 GB of zeros in 1 MB", "d.npz", zip_bomb(1 << 30), "retarget d.npz --hand leap --out o.json"),
        || {
            one(
                "JSON, arrays nested 50 million deep",
                "d.json",
                vec![b'['; 50_000_000],
                "retarget d.json --hand leap --out o.json",
            )
        },
        || {
            one(
                "JSON, 100 MB of small objects",
                "d.json",
                small_objects(14_000_000),
                "retarget d.json --hand leap --out o.json",
            )
        },
        || {
            one(
                "CSV, 40 million rows",
                "d.csv",
                [b"t\n".as_slice(), &b"1\n".repeat(40_000_000)].concat(),
                "retarget d.csv --hand leap --out o.json",
            )
        },
        || one("CSV, 2 million columns", "d.csv", wide_csv(2_000_000), "retarget d.csv --hand leap --out o.json"),
        || demo_with("URDF, a chain of 40,000 links", "h.urdf", urdf(40_000, true)),
        || demo_with("URDF, a star of 40,000 links", "h.urdf", urdf(40_000, false)),
        || demo_with("MJCF, 40,000 bodies side by side", "h.xml", mjcf(40_000)),
        || demo_with("MJCF, 30,000 default classes over 2000 attributes", "h.xml", classes(2000, 30_000)),
        || demo_with("URDF, elements nested 3 million deep", "h.urdf", b"<a>".repeat(3_000_000)),
        || {
            demo_with(
                "URDF, 10 million empty elements",
                "h.urdf",
                [b"<robot>".as_slice(), &b"<a/>".repeat(10_000_000), b"</robot>"].concat(),
            )
        },
        || demo_with("XML, entities that grow a billion times", "h.urdf", laughs()),
        || {
            one(
                "TOML, arrays nested 1 million deep",
                "push.toml",
                [b"a = ".as_slice(), &[b'['; 1_000_000]].concat(),
                "identify push.toml",
            )
        },
        || one("TOML, 5 million entries", "push.toml", entries(5_000_000), "identify push.toml"),
        || Case {
            name: "PNG, 30,000 x 30,000 pixels in 110 kB",
            files: vec![("transforms.json", seeds::one_view()), ("images/0.png", png_bomb(30_000))],
            command: "reconstruct . --out out --iterations 1",
        },
        || {
            one(
                "COLMAP, 1e18 cameras announced",
                "sparse/0/cameras.bin",
                1_000_000_000_000_000_000_u64.to_le_bytes(),
                "reconstruct . --out out --iterations 1",
            )
        },
    ]
}

fn many_materials(materials: usize, images: usize) -> Vec<u8> {
    let list = |n: usize, item: &dyn Fn(usize) -> String| (0..n).map(item).collect::<Vec<_>>().join(",");
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}}],"materials":[{}],"textures":[{}],"images":[{}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}],
"bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":4000000}}],"buffers":[{{"byteLength":4000036}}]}}"#,
        list(materials, &|k| format!(r#"{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":{k}}}}}}}"#)),
        list(materials, &|k| format!(r#"{{"source":{}}}"#, k % images)),
        list(images, &|_| r#"{"bufferView":1,"mimeType":"image/png"}"#.to_owned()),
    );
    let mut binary = triangle();
    binary.resize(4_000_036, 7);
    glb(&json, &binary)
}

fn triangle() -> Vec<u8> {
    [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|c| c.to_le_bytes()).collect()
}

fn many_buffers(n: usize) -> Vec<u8> {
    let buffers = vec![r#"{"byteLength":4000036}"#; n].join(",");
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}}],
"bufferViews":[{{"buffer":0,"byteLength":36}}],"buffers":[{buffers}]}}"#
    );
    let mut binary = triangle();
    binary.resize(4_000_036, 7);
    glb(&json, &binary)
}

fn instances(corners: usize, nodes: usize) -> Vec<u8> {
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[{}]}}],"nodes":[{}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":{corners},"type":"VEC3","min":[0,0,0],"max":[1,1,1]}}],
"bufferViews":[{{"buffer":0,"byteLength":{bytes}}}],"buffers":[{{"byteLength":{bytes}}}]}}"#,
        (0..nodes).map(|k| k.to_string()).collect::<Vec<_>>().join(","),
        (0..nodes).map(|k| format!(r#"{{"mesh":0,"translation":[{k},0,0]}}"#)).collect::<Vec<_>>().join(","),
        bytes = 12 * corners
    );
    let binary: Vec<u8> = (0..3 * corners).flat_map(|k| ((k * 7919 % 1000) as f32 / 1000.0).to_le_bytes()).collect();
    glb(&json, &binary)
}

fn deep_nodes(n: usize) -> Vec<u8> {
    let nodes = (0..n).map(|k| format!(r#"{{"children":[{}]}}"#, k + 1)).collect::<Vec<_>>().join(",");
    format!(r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{nodes},{{}}]}}"#).into_bytes()
}

fn empty_objects(bytes: usize) -> Vec<u8> {
    let nodes = "{},".repeat(bytes / 3);
    format!(r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{nodes}{{}}]}}"#).into_bytes()
}

fn ply_header(count: u64) -> Vec<u8> {
    format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    .into_bytes()
}

fn ply_properties(n: usize) -> Vec<u8> {
    let mut text = "ply\nformat ascii 1.0\nelement vertex 1\n".to_owned();
    for k in 0..n {
        let _ = writeln!(text, "property float p{k}");
    }
    text += "end_header\n";
    text.into_bytes()
}

/// A square of n x n cells with hills, and no underside.
fn grid_stl(n: usize) -> Vec<u8> {
    let at = |i: usize, j: usize| {
        let (x, y) = (i as f32 / n as f32, j as f32 / n as f32);
        [0.1 * x, 0.1 * y, 0.002 * (40.0 * x).sin() * (30.0 * y).cos()]
    };
    let cells = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
    let triangles: Vec<[[f32; 3]; 3]> = cells
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect();
    stl(triangles.len() as u32, &triangles)
}

fn same_face(n: usize) -> Vec<u8> {
    let mut text = String::from_utf8(seeds::obj().remove(0)).unwrap_or_default();
    text += &"f 1 2 3\n".repeat(n);
    text.into_bytes()
}

fn long_name(bytes: usize, faces: usize) -> Vec<u8> {
    format!("v 0 0 0\nv 1 0 0\nv 0 1 0\no {}\n{}", "a".repeat(bytes), "f 1 2 3\n".repeat(faces)).into_bytes()
}

fn obj_materials(n: usize) -> Vec<u8> {
    let mut text = "v 0 0 0\nv 1 0 0\nv 0 1 0\n".to_owned();
    for k in 0..n {
        let _ = writeln!(text, "usemtl m{k}\nf 1 2 3");
    }
    text.into_bytes()
}

fn circle(n: usize, k: usize) -> [f64; 2] {
    let (sin, cos) = (std::f64::consts::TAU * k as f64 / n as f64).sin_cos();
    [0.05 * cos, 0.05 * sin]
}

fn prism(n: usize) -> Vec<u8> {
    let mut text = String::new();
    for z in [0.0, 0.05] {
        for k in 0..n {
            let [x, y] = circle(n, k);
            let _ = writeln!(text, "v {x} {y} {z}");
        }
    }
    let list = |corners: &mut dyn Iterator<Item = usize>| corners.map(|c| format!(" {c}")).collect::<String>();
    let _ = writeln!(text, "f{}\nf{}", list(&mut (1..=n).rev()), list(&mut (n + 1..=2 * n)));
    for k in 0..n {
        let next = (k + 1) % n;
        let _ = writeln!(text, "f {} {} {} {}", k + 1, next + 1, n + next + 1, n + k + 1);
    }
    text.into_bytes()
}

/// The prism with its ends as fans round their first corners.
fn fans(n: usize) -> Vec<u8> {
    let at = |k: usize, z: f32| {
        let [x, y] = circle(n, k % n);
        [x as f32, y as f32, z]
    };
    let mut triangles = Vec::with_capacity(4 * n);
    for k in 0..n {
        triangles.push([at(k, 0.0), at(k + 1, 0.0), at(k + 1, 0.05)]);
        triangles.push([at(k, 0.0), at(k + 1, 0.05), at(k, 0.05)]);
        if (1..n - 1).contains(&k) {
            triangles.push([at(0, 0.0), at(k + 1, 0.0), at(k, 0.0)]);
            triangles.push([at(0, 0.05), at(k, 0.05), at(k + 1, 0.05)]);
        }
    }
    stl(triangles.len() as u32, &triangles)
}

/// Half a sphere open at its top, the rim ragged by a share of its radius; with `inner` a second one inside it, facing inwards.
fn bowl(rim: usize, ragged: f64, inner: Option<f64>) -> Vec<u8> {
    const RINGS: usize = 6;
    let mut text = String::new();
    let noise = |k: usize| ((k * 7919 + 13) % 1009) as f64 / 1009.0 - 0.5;
    for radius in std::iter::once(1.0).chain(inner) {
        let _ = writeln!(text, "v 0 0 {}", -0.05 * radius);
        for ring in 1..=RINGS {
            let (sin, cos) = (std::f64::consts::FRAC_PI_2 * ring as f64 / RINGS as f64).sin_cos();
            for k in 0..rim {
                let [x, y] = circle(rim, k);
                let off = if ring == RINGS { ragged * noise(k) } else { 0.0 };
                let scale = radius * (sin + off);
                let _ = writeln!(text, "v {} {} {}", scale * x, scale * y, 0.05 * radius * (noise(k + 1) * off - cos));
            }
        }
    }
    for side in 0..1 + usize::from(inner.is_some()) {
        let base = 1 + side * (1 + RINGS * rim);
        let at = |ring: usize, k: usize| base + 1 + (ring - 1) * rim + k % rim;
        let mut face = |corners: [usize; 3]| {
            let [a, b, c] = corners;
            let _ = if side == 0 { writeln!(text, "f {a} {b} {c}") } else { writeln!(text, "f {a} {c} {b}") };
        };
        for k in 0..rim {
            face([base, at(1, k + 1), at(1, k)]);
            for ring in 1..RINGS {
                face([at(ring, k), at(ring, k + 1), at(ring + 1, k + 1)]);
                face([at(ring, k), at(ring + 1, k + 1), at(ring + 1, k)]);
            }
        }
    }
    text.into_bytes()
}

fn tetrahedra(n: usize) -> Vec<u8> {
    let mut text = String::new();
    for k in 0..n {
        tetrahedron(&mut text, [(k % 200) as f64 * 0.01, (k / 200) as f64 * 0.01, 0.0], 0.005);
    }
    text.into_bytes()
}

fn tetrahedron(text: &mut String, [x, y, z]: [f64; 3], side: f64) {
    for [dx, dy, dz] in [[0.0, 0.0, 0.0], [side, 0.0, 0.0], [0.0, side, 0.0], [0.0, 0.0, side]] {
        let _ = writeln!(text, "v {} {} {}", x + dx, y + dy, z + dz);
    }
    *text += "f -4 -2 -3\nf -4 -3 -1\nf -3 -2 -1\nf -4 -1 -2\n";
}

/// A ball whose equator has `around` corners, and crumbs in it as a fusion of depth maps leaves them.
fn crumbs(around: usize, count: usize) -> Vec<u8> {
    const RADIUS: f64 = 0.05; // as that of `circle`
    let mut text = format!("v 0 0 {RADIUS}\nv 0 0 -{RADIUS}\n");
    let rings = around / 2 - 1;
    for ring in 1..=rings {
        let (sin, cos) = (std::f64::consts::PI * ring as f64 / (rings + 1) as f64).sin_cos();
        for k in 0..around {
            let [x, y] = circle(around, k);
            let _ = writeln!(text, "v {} {} {}", sin * x, sin * y, RADIUS * cos);
        }
    }
    let at = |ring: usize, k: usize| 3 + (ring - 1) * around + k % around;
    for k in 0..around {
        let _ = writeln!(text, "f 1 {} {}", at(1, k), at(1, k + 1));
        let _ = writeln!(text, "f 2 {} {}", at(rings, k + 1), at(rings, k));
        for ring in 1..rings {
            let (a, b, c, d) = (at(ring, k), at(ring + 1, k), at(ring + 1, k + 1), at(ring, k + 1));
            let _ = writeln!(text, "f {a} {b} {c}\nf {a} {c} {d}");
        }
    }
    for k in 0..count {
        // A lattice that fills a cube within.
        let place = [0.754_877_666, 0.569_840_291, 0.430_159_709].map(|g| ((k as f64 * g).fract() - 0.5) * RADIUS);
        tetrahedron(&mut text, place, 0.01 * RADIUS);
    }
    text.into_bytes()
}

/// An SPZ of so many Gaussians, all zero.
pub fn spz(n: u32) -> Vec<u8> {
    let mut body = spz_header(3, n, 3, 12);
    body.resize(16 + n as usize * 65, 0);
    gzip(&body)
}

/// An archive of key points, all zero, that unpacks to so many bytes.
pub fn zip_bomb(bytes: usize) -> Vec<u8> {
    let frames = bytes / (63 * 8);
    npz(&[("keypoints", &npy("<f8", &format!("({frames}, 21, 3)"), &vec![0; frames * 63 * 8]))])
}

fn small_objects(n: usize) -> Vec<u8> {
    format!(r#"{{"hand_joints":[],"x":[{}{{}}]}}"#, r#"{"":0},"#.repeat(n)).into_bytes()
}

fn wide_csv(n: usize) -> Vec<u8> {
    let header: String = (0..n).map(|k| format!(",position_{k}")).collect();
    format!("t{header}\n0{}\n", ",0".repeat(n)).into_bytes()
}

fn demo_with(name: &'static str, file: &'static str, model: Vec<u8>) -> Case {
    let command = if file == "h.urdf" {
        "retarget d.json --hand h.urdf --out o.json"
    } else {
        "retarget d.json --hand h.xml --out o.json"
    };
    Case { name, files: vec![("d.json", seeds::demo_json().remove(0)), (file, model)], command }
}

/// Links without mass but with a shape, one below the other or all below the first.
pub fn urdf(n: usize, chain: bool) -> Vec<u8> {
    let mut text = "<robot name=\"r\">".to_owned();
    for k in 0..n {
        let _ = write!(
            text,
            "<link name=\"l{k}\"><collision><geometry><sphere radius=\"0.01\"/></geometry></collision></link>"
        );
        if k > 0 {
            let parent = if chain { k - 1 } else { 0 };
            let _ = write!(
                text,
                "<joint name=\"j{k}\" type=\"continuous\"><parent link=\"l{parent}\"/><child link=\"l{k}\"/><mimic joint=\"j{}\"/></joint>",
                n - k
            );
        }
    }
    text += "</robot>";
    text.into_bytes()
}

/// A robot of so many bodies side by side, each with a drive.
pub fn mjcf(n: usize) -> Vec<u8> {
    let mut text = "<mujoco><worldbody><body name=\"base\">".to_owned();
    (0..n).for_each(|_| text += "<body><joint/><geom size=\"0.01\"/></body>");
    text += "</body></worldbody><actuator>";
    for k in 0..n {
        let _ = write!(text, "<motor joint=\"body_{}_joint\"/>", k + 1);
    }
    text += "</actuator></mujoco>";
    text.into_bytes()
}

/// Default classes that each inherit all attributes.
pub fn classes(attributes: usize, n: usize) -> Vec<u8> {
    let mut text = "<mujoco><default><geom".to_owned();
    for k in 0..attributes {
        let _ = write!(text, " a{k}=\"\"");
    }
    text += "/>";
    for k in 0..n {
        let _ = write!(text, "<default class=\"c{k}\"/>");
    }
    text += "</default><worldbody/></mujoco>";
    text.into_bytes()
}

/// Entities that are each ten of the one before.
pub fn laughs() -> Vec<u8> {
    let mut text = "<!DOCTYPE robot [<!ENTITY a0 \"ha\">".to_owned();
    for k in 1..10 {
        let _ = write!(text, "<!ENTITY a{k} \"{}\">", format!("&a{};", k - 1).repeat(10));
    }
    text += "]><robot name=\"&a9;\"/>";
    text.into_bytes()
}

fn entries(n: usize) -> Vec<u8> {
    let mut text = String::new();
    for k in 0..n {
        let _ = writeln!(text, "a{k} = 1");
    }
    text.into_bytes()
}

/// A PNG of one bit per pixel, all black.
fn png_bomb(side: u32) -> Vec<u8> {
    use std::io::Write;
    let row = 1 + side as usize / 8;
    let mut data = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    // Writing into memory fails only if memory ends.
    for _ in 0..side {
        let _ = data.write_all(&vec![0; row]);
    }
    let data = data.finish().unwrap_or_default();
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8], body: &[u8]| {
        let mut crc = flate2::Crc::new();
        crc.update(kind);
        crc.update(body);
        out.extend((body.len() as u32).to_be_bytes());
        out.extend(kind);
        out.extend(body);
        out.extend(crc.sum().to_be_bytes());
    };
    chunk(b"IHDR", &[&side.to_be_bytes()[..], &side.to_be_bytes(), &[1, 0, 0, 0, 0]].concat());
    chunk(b"IDAT", &data);
    chunk(b"IEND", &[]);
    out
}

/// Writes the files of `case` into `folder`; their bytes in all.
///
/// # Errors
/// If a file cannot be written.
pub fn write(case: &Case, folder: &Path) -> std::io::Result<u64> {
    for (name, bytes) in &case.files {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap_or(folder))?;
        std::fs::write(path, bytes)?;
    }
    Ok(case.files.iter().map(|(_, bytes)| bytes.len() as u64).sum())
}
