//! Small inputs of every format, each made here and each read without complaint: where mutations begin.
#![allow(clippy::unwrap_used)] // writers of pictures and of Gaussians into memory, on input that is made here

use std::fmt::Write;

use drex_splat::{Gaussians, Kind, Label};

use crate::bytes::{glb as framed_glb, npy, npy_numbers, npz, spz_header, stl as binary_stl};

type Seeds = Vec<Vec<u8>>;

fn texts<const N: usize>(texts: [&str; N]) -> Seeds {
    texts.map(|t| t.as_bytes().to_vec()).into()
}

const TETRAHEDRON: &str = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n";

/// Wavefront OBJ.
pub fn obj() -> Seeds {
    texts([
        TETRAHEDRON,
        "mtllib a.mtl\no box\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nv 0 1 0 1 1 1\nvt 0 0\nvt 1 1\n\
         usemtl red\nf 1/1 2/2 3/1 4/2\ng back\nf -1 -2 -3 # comment\n",
    ])
}

/// STL, text and binary.
pub fn stl() -> Seeds {
    let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n";
    let t = [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]];
    vec![text.as_bytes().to_vec(), binary_stl(2, &t)]
}

/// PLY meshes, text and binary.
pub fn ply() -> Seeds {
    let header = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment made here\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 2\n\
             property list uchar int vertex_indices\nend_header\n"
        )
    };
    let mut text = header("ascii");
    let mut binary = header("binary_little_endian").into_bytes();
    for [x, y, z] in [[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.5]] {
        writeln!(text, "{x} {y} {z} 9 8 7").unwrap();
        binary.extend([x, y, z].iter().flat_map(|c| c.to_le_bytes()));
        binary.extend([9, 8, 7]);
    }
    text += "4 0 1 2 3\n3 0 2 1\n";
    for face in [&[0_i32, 1, 2, 3][..], &[0, 2, 1]] {
        binary.push(face.len() as u8);
        binary.extend(face.iter().flat_map(|i| i.to_le_bytes()));
    }
    vec![text.into_bytes(), binary]
}

fn gltf_json(uri: &str) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
"nodes":[{{"translation":[1,2,3],"children":[1]}},{{"matrix":[-1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],"mesh":0}}],
"meshes":[{{"name":"m","primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":2}},"indices":1,"material":0}}]}}],
"materials":[{{"name":"red","pbrMetallicRoughness":{{"baseColorFactor":[1,0,0,1],"baseColorTexture":{{"index":0}}}}}}],
"textures":[{{"source":0}}],"images":[{{"bufferView":3,"mimeType":"image/png"}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,1]}},
{{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}},{{"bufferView":2,"componentType":5126,"count":3,"type":"VEC2"}}],
"bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":6}},
{{"buffer":0,"byteOffset":44,"byteLength":24}},{{"buffer":0,"byteOffset":68,"byteLength":8}}],
"buffers":[{{{uri}"byteLength":76}}]}}"#
    )
}

fn gltf_buffer() -> Vec<u8> {
    let mut out: Vec<u8> =
        [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0].iter().flat_map(|c| c.to_le_bytes()).collect();
    out.extend([0, 0, 1, 0, 2, 0, 0, 0]);
    out.extend([0.0_f32, 0.0, 1.0, 0.0, 0.0, 1.0].iter().flat_map(|c| c.to_le_bytes()));
    out.extend(b"\x89PNG\r\n\x1a\n");
    out
}

/// glTF with its buffer inside.
pub fn gltf() -> Seeds {
    // The 76 bytes of the buffer, in base64.
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for chunk in gltf_buffer().chunks(3) {
        let bits = chunk.iter().fold(0_u32, |n, &b| n << 8 | u32::from(b)) << (8 * (3 - chunk.len()));
        for k in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * k) & 63) as usize];
            text.push(if k > chunk.len() { '=' } else { char::from(digit) });
        }
    }
    vec![gltf_json(&format!("\"uri\":\"data:application/octet-stream;base64,{text}\",")).into_bytes()]
}

/// GLB.
pub fn glb() -> Seeds {
    vec![framed_glb(&gltf_json(""), &gltf_buffer())]
}

/// Marks in photos.
pub fn marks() -> Seeds {
    texts([r#"{"00.jpg":{"A":[136.8,159.1],"B":[113.6,232.4]},"05.jpg":{"A":[275.5,163.8]}}"#])
}

/// Arrays of NumPy.
pub fn npy_arrays() -> Seeds {
    vec![
        npy_numbers("(2, 3)", &[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
        npy("<f4", "(2, 2)", &[0; 16]),
        npy("|u1", "(4,)", &[1, 2, 3, 4]),
        npy("<U3", "(2,)", &[65; 24]),
    ]
}

/// Tables of poses, forces, commands, joints, and BOP's.
pub fn csv() -> Seeds {
    texts([
        "t,x,y,z,qw,qx,qy,qz\n0.0,0.1,0.2,0.3,1,0,0,0\n0.1,0.1,0.2,0.31,1,0,0,0\n",
        "t,fx,fy,fz,tx,ty,tz\n0,0.1,0,0,0,0,0\n0.01,0.2,0,0,0,0,0.01\n",
        "t,x_cmd,y_cmd,z_cmd\n0,0,0,0\n0.1,0.01,0,0\n",
        "t,x,y,z,vx,vy,vz\n0,0,0,0,0,0,0\n0.1,0.01,0,0,0.1,0,0\n",
        "timestamp,position_a,position_b,velocity_a,velocity_b\n0,0.1,0.2,0,0\n0.1,0.11,0.21,0.1,0.1\n",
        "scene_id,im_id,obj_id,score,R,t,time\n1,1,2,0.9,1 0 0 0 1 0 0 0 1,10 20 300,-1\n1,2,2,0.8,1 0 0 0 1 0 0 0 1,11 20 300,-1\n",
    ])
}

/// FoundationPose's log, and a matrix of its folders.
pub fn pose_log() -> Seeds {
    texts([
        "2025-04-17T18:59:37.5 - Final transform:\n[[1 0 0 0]\n [0 1 0 0]\n [0 0 1 0]\n [0 0 0 1]]\n\
         2025-04-17T18:59:37.5 - Pose:\ntensor([[[ 1.0, 0.0, 0.0, 0.1],\n [0.0, 1.0, 0.0, 0.2],\n [0.0, 0.0, 1.0, 8e-1],\n \
         [0.0, 0.0, 0.0, 1.0]]], device='cuda:0')\n",
        "1 0 0 0.1\n0 1 0 0.2\n0 0 1 0.5\n0 0 0 1\n",
    ])
}

/// Grasps as JSON.
pub fn grasps_json() -> Seeds {
    texts([
        r#"{"schema":1,"joint_names":["a","b"],"unit":"rad","grasps":[[0.1,0.2],[0.3,0.4]],"object":"tin","wrist":[[0,0,0,1,0,0,0],[0,0,0.1,1,0,0,0]]}"#,
    ])
}

/// A push.
pub fn push_toml() -> Seeds {
    texts([
        "schema = 1\nname = \"tilt\"\nmesh = \"tin.obj\"\nmass_prior_kg = 0.5\n[track]\nfile = \"poses.csv\"\nformat = \"pose_csv\"\n\
         frame = \"world\"\n[track.clock]\nkind = \"relative\"\n[support]\ntable_height_m = 0.0\n[force]\nfile = \"force.csv\"\n\
         point_in_object_m = [-0.031, 0.0, 0.066]\n[force.clock]\nkind = \"relative\"\n[parameters]\nmass = \"free\"\n",
        "schema = 1\nmesh = \"k.stl\"\n[track]\nfile = \"o.txt\"\nformat = \"foundation_pose_log\"\n\
         clock = { kind = \"local_iso\", utc_offset = \"-07:00\" }\nframe = \"camera\"\nup_in_mesh = [0, 0, -1]\n[hand]\n\
         robot = \"allegro_right\"\nworld_from_base = { position_m = [0.14, -0.08, 0.25], quat_wxyz = [0, 0, -1, 0] }\n\
         joints = \"j.csv\"\njoint_names = [\"ffj0\", \"ffj1\"]\nclock = { kind = \"unix\" }\n",
    ])
}

/// A twin.
pub fn twin_toml() -> Seeds {
    texts([
        "schema = 1\nname = \"tea tin\"\nseed = 1\n[scan]\nphotos = \"scan\"\ndistances_m = { \"A-C\" = 0.1697 }\niterations = 1500\n\
         [object]\nmesh = \"splat/object.obj\"\npieces = 6\nfriction = 0.5\n[mass]\nidentify = [\"push/tilt\"]\nprior_kg = 0.5\n\
         [grasps]\nfile = \"demos\"\nrecorded = \"human\"\nhand = \"leap_right\"\naugment = 20\n[train]\npractice = 24\nsearch = 20000\n",
    ])
}

/// Robots as URDF.
pub fn urdf() -> Seeds {
    texts([
        "<robot name=\"r\"><material name=\"m\"><color rgba=\"1 0 0 1\"/></material><link name=\"a\"><inertial><origin xyz=\"0 0 0.1\"/>\
         <mass value=\"1\"/><inertia ixx=\"0.1\" ixy=\"0\" ixz=\"0\" iyy=\"0.1\" iyz=\"0\" izz=\"0.1\"/></inertial>\
         <collision><origin rpy=\"0.1 0 0\"/><geometry><box size=\"0.1 0.2 0.3\"/></geometry></collision></link>\
         <link name=\"b\"><collision><geometry><cylinder radius=\"0.1\" length=\"0.2\"/></geometry></collision></link>\
         <joint name=\"j\" type=\"revolute\"><parent link=\"a\"/><child link=\"b\"/><origin xyz=\"0 0 0.1\"/><axis xyz=\"0 0 1\"/>\
         <limit lower=\"-1\" upper=\"1\" effort=\"2\" velocity=\"3\"/></joint><link name=\"c\"/><joint name=\"k\" type=\"prismatic\">\
         <parent link=\"b\"/><child link=\"c\"/><limit lower=\"0\" upper=\"0.1\"/><mimic joint=\"j\" multiplier=\"0.5\"/></joint></robot>",
    ])
}

/// Robots and objects as MJCF.
pub fn mjcf() -> Seeds {
    texts([
        "<mujoco model=\"r\"><compiler angle=\"radian\"/><default><joint damping=\"0.1\"/><default class=\"f\"><geom friction=\"0.8\"/>\
         </default></default><asset><mesh name=\"t\" vertex=\"0 0 0 1 0 0 0 1 0 0 0 1\"/></asset><worldbody><body name=\"a\" pos=\"0 0 1\">\
         <geom type=\"box\" size=\"0.1 0.1 0.1\"/><body name=\"b\" childclass=\"f\"><joint name=\"j\" axis=\"0 1 0\" range=\"-1 1\"/>\
         <geom type=\"mesh\" mesh=\"t\"/><frame euler=\"0 0 0.1\"><geom type=\"capsule\" fromto=\"0 0 0 0 0 0.1\" size=\"0.01\"/></frame></body>\
         </body></worldbody><contact><exclude body1=\"a\" body2=\"b\"/></contact><actuator><position joint=\"j\" kp=\"3\"/></actuator></mujoco>",
        "<mujoco model=\"object\"><worldbody><body name=\"object\"><freejoint/><inertial pos=\"0 0 0\" mass=\"0.2\" diaginertia=\"1e-4 1e-4 1e-4\"/>\
         <geom name=\"visual\" type=\"box\" size=\"0.03 0.03 0.05\"/></body></worldbody></mujoco>",
    ])
}

fn gaussians() -> Gaussians {
    let mut out = Gaussians::new(Kind::Ellipsoid, 1);
    for i in 0..3 {
        out.means.push([0.1 * i as f32, 0.2, 0.3]);
        out.rotations.push([1.0, 0.1 * i as f32, 0.0, 0.0]);
        out.log_scales.push([-3.0, -3.0, -4.0]);
        out.logit_opacities.push(0.5);
        out.sh.extend((0..12).map(|k| 0.01 * k as f32));
        out.labels.push(Label::BACKGROUND);
    }
    out
}

/// Gaussians as PLY.
pub fn gaussians_ply() -> Seeds {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    drex_splat::io::ply::write(&path, &gaussians()).unwrap();
    vec![std::fs::read(&path).unwrap()]
}

/// Gaussians as SPZ, both versions.
pub fn spz() -> Seeds {
    use drex_splat::io::spz::{Version, to_bytes};
    vec![to_bytes(&gaussians(), Version::V2).unwrap(), to_bytes(&gaussians(), Version::V3).unwrap()]
}

/// Gaussians as SPZ before it is compressed.
pub fn spz_body() -> Seeds {
    let body = |version: u32, each: usize| [spz_header(version, 3, 1, 12), vec![100; 3 * (each + 9)]].concat();
    vec![body(2, 19), body(3, 20)]
}

/// Gaussians as .splat.
pub fn splat() -> Seeds {
    vec![drex_splat::io::splat::to_bytes(&gaussians()).unwrap()]
}

/// The files of a COLMAP model of three photos.
pub struct Colmap {
    /// cameras.bin.
    pub cameras: Vec<u8>,
    /// images.bin.
    pub images: Vec<u8>,
    /// points3D.bin.
    pub points: Vec<u8>,
}

/// A COLMAP model of three photos of 32 x 24 pixels, and two points.
pub fn colmap() -> Colmap {
    fn numbers(out: &mut Vec<u8>, values: &[f64]) {
        out.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    }
    let count = |n: u64| n.to_le_bytes().to_vec();
    let (mut cameras, mut images, mut points) = (count(1), count(3), count(2));
    cameras.extend([1_u32, 1].iter().flat_map(|v| v.to_le_bytes()));
    cameras.extend([32_u64, 24].iter().flat_map(|v| v.to_le_bytes()));
    numbers(&mut cameras, &[30.0, 30.0, 16.0, 12.0]);
    for i in 0..3_u32 {
        images.extend((i + 1).to_le_bytes());
        numbers(&mut images, &[1.0, 0.0, 0.0, 0.0, 0.1 * f64::from(i), 0.0, 1.0]);
        images.extend(1_u32.to_le_bytes());
        images.extend(format!("{i}.png\0").bytes());
        images.extend(2_u64.to_le_bytes());
        for p in 0..2_u64 {
            numbers(&mut images, &[10.0 + p as f64, 11.0]);
            images.extend(p.to_le_bytes());
        }
    }
    for p in 0..2_u32 {
        points.extend(u64::from(p).to_le_bytes());
        numbers(&mut points, &[0.1 * f64::from(p), 0.0, 0.5]);
        points.extend([1, 2, 3]);
        numbers(&mut points, &[0.5]);
        points.extend(3_u64.to_le_bytes());
        (0..3_u32).for_each(|i| points.extend([i + 1, p].iter().flat_map(|v| v.to_le_bytes())));
    }
    Colmap { cameras, images, points }
}

/// The same as text, cameras, images and points divided by `%`.
pub fn colmap_text() -> Seeds {
    texts([
        "1 PINHOLE 32 24 30 30 16 12\n%1 1 0 0 0 0 0 1 1 0.png\n10 11 0 11 11 1\n2 1 0 0 0 0.1 0 1 1 1.png\n\n%0 0 0 0.5 1 2 3 0.5 1 0\n",
    ])
}

/// A PNG.
pub fn picture(width: u32, height: u32) -> Vec<u8> {
    let mut out = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_fn(width, height, |x, y| image::Rgba([x as u8, y as u8, 9, 255]))
        .write_to(&mut out, image::ImageFormat::Png)
        .unwrap();
    out.into_inner()
}

/// Pictures with and without opacity, and of 16 bits.
pub fn png() -> Seeds {
    let encoded = |picture: image::DynamicImage| {
        let mut out = std::io::Cursor::new(Vec::new());
        picture.write_to(&mut out, image::ImageFormat::Png).unwrap();
        out.into_inner()
    };
    vec![
        picture(32, 24),
        encoded(image::DynamicImage::new_luma16(32, 24)),
        encoded(image::DynamicImage::new_rgb8(32, 24)),
    ]
}

/// transforms.json of a single view.
pub fn one_view() -> Vec<u8> {
    br#"{"camera_model":"PINHOLE","w":32,"h":24,"fl_x":30,"fl_y":30,"cx":16,"cy":12,
"frames":[{"file_path":"images/0.png","transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,1],[0,0,0,1]]}]}"#
        .to_vec()
}

/// transforms.json.
pub fn transforms_json() -> Seeds {
    let two = br#"{"camera_model":"OPENCV","w":32,"h":24,"fl_x":30,"fl_y":30,"cx":16,"cy":12,"k1":0.01,"k2":0,"p1":0,"p2":0,
"applied_transform":[[1,0,0,0],[0,1,0,0],[0,0,1,0]],
"frames":[{"file_path":"images/0.png","transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,1],[0,0,0,1]]},
{"file_path":"./images/1","mask_path":"images/1.png","fl_x":31,"transform_matrix":[[1,0,0,0.1],[0,1,0,0],[0,0,1,1],[0,0,0,1]]}]}"#;
    vec![one_view(), two.to_vec()]
}

/// 21 key points of a hand, metres.
fn hand(frame: usize) -> Vec<[f64; 3]> {
    let mut points = vec![[0.0; 3]];
    for f in 0..5 {
        for j in 0..4 {
            let (f, j) = (f as f64, j as f64);
            points.push([0.045 - 0.02 * f, 0.05 + 0.03 * j - 0.01 * (f - 2.0).abs(), 0.002 * frame as f64 * j]);
        }
    }
    points
}

fn hands() -> Vec<f64> {
    (0..3).flat_map(hand).flatten().collect()
}

/// Demonstrations as JSON.
pub fn demo_json() -> Seeds {
    let points = |i: usize| serde_json::to_string(&hand(i)).unwrap();
    let whole = format!(
        r#"{{"format":"drex-hand-demo/1","hand":"right","units":"m","source":"made here","up":[0,0,1],"frames":[{{"t":0.0,"keypoints":{}}},{{"t":0.1,"keypoints":{},"object_pose":[0,0,0.1,1,0,0,0]}}]}}"#,
        points(0),
        points(1)
    );
    let lines =
        format!("{{\"t\":0,\"keypoints\":{}}}\n{{\"t\":0.1,\"keypoints\":{},\"score\":0.5}}\n", points(0), points(1));
    let excerpt = format!(
        r#"{{"hand_joints":[{},{}],"object_poses":[[0,0,0.1,1,0,0,0],[0,0,0.1,1,0,0,0]]}}"#,
        points(0),
        points(1)
    );
    vec![whole.into_bytes(), lines.into_bytes(), excerpt.into_bytes()]
}

/// A demonstration as a table.
pub fn demo_csv() -> Seeds {
    let joints = ["cmc", "mcp", "ip", "tip"];
    let names = ["thumb", "index", "middle", "ring", "little"].iter().flat_map(|f| {
        let joints = if *f == "thumb" { joints } else { ["mcp", "pip", "dip", "tip"] };
        joints.map(|j| format!("{f}_{j}"))
    });
    let columns: Vec<String> = std::iter::once("wrist".to_owned())
        .chain(names)
        .flat_map(|n| ["x", "y", "z"].map(|k| format!("{n}_{k}")))
        .collect();
    let mut text = format!("t,{}\n", columns.join(","));
    for i in 0..2 {
        let row: Vec<String> = hand(i).iter().flatten().map(f64::to_string).collect();
        writeln!(text, "{},{}", 0.1 * i as f64, row.join(",")).unwrap();
    }
    vec![text.into_bytes()]
}

/// Key points as arrays.
pub fn demo_npy() -> Seeds {
    vec![npy_numbers("(3, 21, 3)", &hands()), npy_numbers("(3, 63)", &hands())]
}

/// Key points, and MANO's parameters, in archives.
pub fn demo_npz() -> Seeds {
    vec![
        npz(&[("keypoints", &npy_numbers("(3, 21, 3)", &hands()))]),
        npz(&[
            ("pred_keypoints_3d", &npy_numbers("(3, 21, 3)", &hands())),
            ("pred_cam", &npy_numbers("(3, 3)", &[0.9; 9])),
            ("global_orient", &npy_numbers("(3, 3)", &[0.1; 9])),
            ("is_right", &npy_numbers("(3,)", &[1.0; 3])),
        ]),
    ]
}

/// MANO's model, with as many vertices as name the tips of the fingers.
pub fn mano_npz() -> Seeds {
    let n = 778;
    let zeros = |count: usize| vec![0.001; count];
    vec![npz(&[
        ("v_template", &npy_numbers(&format!("({n}, 3)"), &zeros(3 * n))),
        ("shapedirs", &npy_numbers(&format!("({n}, 3, 10)"), &zeros(30 * n))),
        ("posedirs", &npy_numbers(&format!("({n}, 3, 135)"), &zeros(405 * n))),
        ("J_regressor", &npy_numbers(&format!("(16, {n})"), &zeros(16 * n))),
        ("weights", &npy_numbers(&format!("({n}, 16)"), &zeros(16 * n))),
        ("kintree_table", &npy_numbers("(2, 16)", &[0.0; 32])),
        ("hands_mean", &npy_numbers("(45,)", &zeros(45))),
    ])]
}

/// Clouds of points.
pub fn points() -> Seeds {
    let mut all = texts([TETRAHEDRON, "0 0 0\n0.1 0 0\n0 0.1 0\n"]);
    all.extend(ply());
    all.extend(npy_arrays());
    all
}

/// A mapping of a person's hand to a robot's.
pub fn hand_mapping() -> Seeds {
    texts(["side = \"right\"\n[wrist]\nlink = \"palm\"\npoint_m = [0, 0, 0.1]\npalm = [1, 0, 0]\ntips = [0, 0, 1]\n\
         [fingers.thumb]\ntip = { link = \"thumb_distal\", point_m = [0, 0, 0.02] }\n[fingers.index]\ntip = { link = \"index_distal\" }\n"])
}

/// A torque-current model.
pub fn torque_law() -> Seeds {
    let law =
        drex_hw::torque_current::TorqueCurrentModel::nominal(drex_hw::torque_current::Nominal::Xc330Linear).unwrap();
    vec![serde_json::to_vec(&law).unwrap()]
}

/// What a person says of the mass.
pub fn mass_prior() -> Seeds {
    texts([r#"{"mass_kg":0.5,"range_kg":[0.3,0.8]}"#, r#"{"density_kg_m3":950}"#, r#"{"material":"wood"}"#])
}

/// Lines of an slcan adapter.
pub fn slcan() -> Seeds {
    texts(["t1238AABBCCDDEEFF0011\rz\rr1234\r\u{7}V1013\rT0012345680011223344556677\r"])
}

/// Identifiers and data of CAN frames.
pub fn allegro_frames() -> Seeds {
    vec![
        (0..64_u16).flat_map(|id| [id.to_le_bytes().to_vec(), vec![7; 8]].concat()).collect(),
        vec![0x21, 0x02, 1, 2, 3, 4],
    ]
}

/// Packets of Dynamixel motors.
pub fn dynamixel() -> Seeds {
    use drex_hw::dynamixel::{encode, instruction};
    let packet = |id: u8, params: &[u8]| {
        let mut buffer = [0; 128];
        let length = encode(&mut buffer, id, instruction::STATUS, params).unwrap();
        buffer[..length].to_vec()
    };
    vec![
        packet(1, &[0, 6, 4, 38]),
        packet(2, &[0, 0xff, 0xff, 0xfd, 1, 2]),
        [packet(1, &[0]), packet(3, &[0, 1, 2, 3, 4])].concat(),
    ]
}
