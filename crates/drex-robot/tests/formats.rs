//! Readers: what they understand, how they refuse, and that nothing makes them panic.
#![allow(clippy::unwrap_used, missing_docs, reason = "a test that fails by panic is what tests are")]

use std::f64::consts::FRAC_PI_2;
use std::fs;
use std::path::Path;

use drex_robot::{ActuatorKind, GeomRole, JointKind, Robot, Shape};
use nalgebra::{Isometry3, Point3, Vector3};
use proptest::prelude::*;

const TETRAHEDRON: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";

fn mjcf(body: &str) -> drex_robot::Result<Robot> {
    Robot::from_mjcf_str(&format!("<mujoco>{body}</mujoco>"), None)
}

fn near(a: &Vector3<f64>, b: [f64; 3]) -> bool {
    (a - Vector3::from(b)).norm() < 1e-12
}

#[test]
fn orientations_in_all_their_spellings() {
    // A quarter turn about z, five ways, in degrees.
    for attribute in [
        r#"quat="1 0 0 1""#,
        r#"axisangle="0 0 2 90""#,
        r#"euler="0 0 90""#,
        r#"xyaxes="0 3 0 -1 1 0""#,
        r#"quat="0.5 0 0 0.5""#,
    ] {
        let robot = mjcf(&format!(r#"<worldbody><body name="a" pos="1 2 3" {attribute}/></worldbody>"#)).unwrap();
        let x = robot.file_world_from_base.rotation * Vector3::x();
        assert!(near(&x, [0.0, 1.0, 0.0]), "{attribute}: {x}");
        assert!(near(&robot.file_world_from_base.translation.vector, [1.0, 2.0, 3.0]));
    }
    let robot = mjcf(r#"<worldbody><body name="a" zaxis="1 0 0"/></worldbody>"#).unwrap();
    assert!(near(&(robot.file_world_from_base.rotation * Vector3::z()), [1.0, 0.0, 0.0]));
    // x then y about moving axes against fixed axes.
    let turned = |sequence: &str| {
        let text =
            format!(r#"<compiler eulerseq="{sequence}"/><worldbody><body name="a" euler="90 90 0"/></worldbody>"#);
        mjcf(&text).unwrap().file_world_from_base.rotation * Vector3::z()
    };
    assert!(near(&turned("xyz"), [1.0, 0.0, 0.0]));
    assert!(near(&turned("XYZ"), [0.0, -1.0, 0.0]));
}

#[test]
fn default_classes_nest_and_elements_override_them() {
    let robot = mjcf(
        r#"<compiler angle="radian"/>
        <default>
          <joint damping="0.5" axis="0 1 0"/>
          <geom friction="0.7" euler="0 0 1"/>
          <position kp="3" kv="0.1"/>
          <default class="finger">
            <joint range="-1 1"/>
            <general forcerange="-2 2"/>
            <default class="tip"><joint range="0 2" armature="0.01"/><geom type="box" size="1 2 3" mass="0.4"/></default>
          </default>
        </default>
        <worldbody><body name="base"><geom size="0.1" quat="1 0 0 0"/>
          <body name="one" childclass="finger"><joint name="a"/><geom size="0.1"/>
            <body name="two"><joint name="b" class="tip" damping="0.9"/><geom class="tip"/></body>
            <frame pos="0 0 1" childclass="tip"><body name="three"><joint name="c"/><geom/></body></frame>
          </body></body></worldbody>
        <actuator>
          <position name="p" joint="a" class="finger"/>
          <motor name="m" joint="b" gear="5"/>
          <general name="g" joint="c" gainprm="7" biastype="affine" biasprm="1 -2 -3" ctrlrange="-1 1" ctrllimited="false"/>
          <velocity name="v" joint="c" kv="4"/>
        </actuator>"#,
    )
    .unwrap();
    let joint = |n: &str| &robot.joints[robot.joint_index(n).unwrap()];
    assert_eq!((joint("a").limits, joint("a").damping, joint("a").armature), (Some((-1.0, 1.0)), 0.5, 0.0));
    assert_eq!((joint("b").limits, joint("b").damping, joint("b").armature), (Some((0.0, 2.0)), 0.9, 0.01));
    assert_eq!(joint("c").limits, Some((0.0, 2.0)));
    assert!(near(&joint("c").axis, [0.0, 1.0, 0.0]));
    let link = |n: &str| &robot.links[robot.link_index(n).unwrap()];
    assert_eq!(link("base").geoms[0].link_from_geom.rotation.angle(), 0.0);
    assert!((link("one").geoms[0].link_from_geom.rotation.angle() - 1.0).abs() < 1e-15);
    assert_eq!(link("two").geoms[0].friction, Some(0.7));
    assert_eq!(link("two").inertial.unwrap().mass_kg, 0.4);
    assert_eq!(link("three").parent_from_link.translation.z, 1.0);
    let drive = |n: &str| robot.actuators.iter().find(|a| a.name == n).unwrap();
    assert_eq!(drive("p").kind, ActuatorKind::Position { kp: 3.0, kv: 0.1 });
    assert_eq!((drive("p").force_range, joint("a").effort_limit), (Some((-2.0, 2.0)), Some(2.0)));
    assert_eq!((drive("m").kind, drive("m").gear), (ActuatorKind::Motor { gain: 1.0 }, 5.0));
    assert_eq!(drive("g").kind, ActuatorKind::Affine { gain: 7.0, bias: [1.0, -2.0, -3.0] });
    assert_eq!((drive("g").ctrl_range, drive("v").kind), (None, ActuatorKind::Velocity { kv: 4.0 }));
}

#[test]
fn limits_angles_and_kinds_of_joints() {
    let robot = mjcf(
        r#"<worldbody><body name="base"><body name="a"><joint name="h" range="-90 90"/><geom size="1"/>
        <body name="b"><joint name="s" type="slide" range="-0.1 0.2" axis="0 3 4"/><geom size="1"/>
        <body name="c"><joint name="u" range="-1 1" limited="false"/><geom size="1" contype="0" conaffinity="0"/></body></body></body></body></worldbody>"#,
    )
    .unwrap();
    assert_eq!(robot.joints[0].limits, Some((-FRAC_PI_2, FRAC_PI_2)));
    assert_eq!((robot.joints[1].kind, robot.joints[1].limits), (JointKind::Prismatic, Some((-0.1, 0.2))));
    assert!(near(&robot.joints[1].axis, [0.0, 0.6, 0.8]));
    assert_eq!(robot.joints[2].limits, None);
    assert_eq!(robot.collision_geoms().count(), 2);
    let strict = mjcf(
        r#"<compiler autolimits="false"/><worldbody><body name="o"><body name="a"><joint name="h" range="-90 90"/></body></body></worldbody>"#,
    );
    assert_eq!(strict.unwrap().joints[0].limits, None);
}

#[test]
fn the_base_is_found_in_a_scene() {
    let scene = mjcf(
        r#"<worldbody><geom type="plane" size="1 1 0.1"/><light/>
        <body name="cube"><freejoint/><geom size="0.1"/></body>
        <body name="arm"><body name="l1"><joint name="j"/><geom size="0.1"/></body></body></worldbody>"#,
    )
    .unwrap();
    assert_eq!(scene.links[0].name, "arm");
    assert!(scene.unsupported.iter().any(|r| r.contains("cube")), "{:?}", scene.unsupported);
    // A moving body on the world: the world is the base and keeps its shapes.
    let door =
        mjcf(r#"<worldbody><geom size="1"/><body name="door"><joint name="j"/><geom size="0.1"/></body></worldbody>"#)
            .unwrap();
    assert_eq!((door.links[0].name.as_str(), door.links[0].geoms.len()), ("world", 1));
    // A floating base has the pose that the caller gives it.
    let floating =
        mjcf(r#"<worldbody><body name="torso" pos="0 0 1"><freejoint/><geom size="0.1"/></body></worldbody>"#).unwrap();
    assert_eq!((floating.dof(), floating.file_world_from_base.translation.z), (0, 1.0));
}

#[test]
fn includes_meshes_and_their_reference_pose() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    };
    write("assets/tetra.obj", TETRAHEDRON);
    write(
        "parts/defaults.xml",
        r#"<mujocoinclude><default><geom type="mesh" density="600"/></default></mujocoinclude>"#,
    );
    write(
        "parts/finger.xml",
        r#"<mujocoinclude><body name="f" pos="1 0 0"><joint name="j"/><geom mesh="tetra"/></body></mujocoinclude>"#,
    );
    write(
        "robot.xml",
        r#"<mujoco model="m"><compiler meshdir="assets"/><include file="parts/defaults.xml"/>
        <asset><mesh file="tetra.obj" scale="2 2 2" refpos="0.5 0 0"/>
        <mesh name="gone" file="gone.obj"/></asset>
        <worldbody><body name="b"><include file="parts/finger.xml"/><geom mesh="gone" contype="0" conaffinity="0"/></body></worldbody></mujoco>"#,
    );
    let robot = Robot::load(&folder.path().join("robot.xml")).unwrap();
    let geom = &robot.links[1].geoms[0];
    let Shape::Mesh(mesh) = &geom.shape else { panic!("{geom:?}") };
    assert_eq!(mesh.vertices[0], Point3::new(-1.0, 0.0, 0.0));
    let body = robot.links[1].inertial.unwrap();
    assert!((body.mass_kg - 600.0 * 8.0 / 6.0).abs() < 1e-9);
    assert!((body.center_of_mass - Point3::new(-0.5, 0.5, 0.5)).norm() < 1e-12);
    assert!(robot.unsupported.iter().any(|r| r.contains("gone.obj")), "{:?}", robot.unsupported);

    // The same mesh missing where it matters, a circle, a missing include: errors that name the file.
    let refuses = |text: &str, part: &str| {
        write("bad.xml", text);
        let message = Robot::load(&folder.path().join("bad.xml")).unwrap_err().to_string();
        assert!(message.contains("bad.xml") && message.contains(part), "{message}");
    };
    refuses(
        r#"<mujoco><asset><mesh name="gone" file="gone.obj"/></asset><worldbody><body name="b"><geom type="mesh" mesh="gone"/></body></worldbody></mujoco>"#,
        "gone.obj",
    );
    refuses(r#"<mujoco><include file="bad.xml"/></mujoco>"#, "includes itself");
    refuses(r#"<mujoco><include file="no.xml"/></mujoco>"#, "no.xml");
}

#[test]
fn refusals_name_line_element_and_attribute() {
    let cases = [
        (
            "<worldbody><body name=\"a\">\n<joint name=\"j\" axis=\"0 0 0\"/></body></worldbody>",
            &["line 2", "joint name=\"j\"", "axis"][..],
        ),
        (
            "<worldbody><body name=\"a\"><geom type=\"box\" size=\"1 x 1\"/></body></worldbody>",
            &["geom", "size", "\"x\""],
        ),
        ("<worldbody><body name=\"a\"><geom type=\"box\" size=\"1 1\"/></body></worldbody>", &["box needs 3 sizes"]),
        ("<worldbody><body name=\"a\"><geom type=\"blob\"/></body></worldbody>", &["type=\"blob\""]),
        ("<worldbody><body name=\"a\"><geom class=\"no\"/></body></worldbody>", &["no default class \"no\"", "main"]),
        ("<worldbody><body name=\"a\"><body name=\"a\"/></body></worldbody>", &["name=\"a\"", "twice"]),
        ("<worldbody><body name=\"a\"><body name=\"b\"><joint type=\"ball\"/></body></body></worldbody>", &["ball"]),
        ("<worldbody><body name=\"a\"><geom type=\"mesh\" mesh=\"m\"/></body></worldbody>", &["no mesh \"m\""]),
        (
            "<worldbody><body name=\"a\"/></worldbody><actuator><motor joint=\"k\"/></actuator>",
            &["joint=\"k\"", "no such joint"],
        ),
        (
            "<worldbody><body name=\"a\"/></worldbody><contact><exclude body1=\"a\" body2=\"z\"/></contact>",
            &["body2=\"z\""],
        ),
        ("<compiler coordinate=\"global\"/><worldbody><body name=\"a\"/></worldbody>", &["global"]),
        (
            "<worldbody><body name=\"a\"><inertial mass=\"1\" fullinertia=\"1 1 -1 0 0 0\"/></body></worldbody>",
            &["negative principal moment"],
        ),
        ("<wolrdbody/>", &["wolrdbody"]),
        ("", &["no bodies"]),
    ];
    for (text, parts) in cases {
        let message = mjcf(text).unwrap_err().to_string();
        assert!(message.contains("line "), "{message}");
        for part in parts {
            assert!(message.contains(part), "{text}\n{message}");
        }
    }
}

#[test]
fn what_is_not_read_is_said() {
    let robot = mjcf(
        r#"<option timestep="0.001"/><worldbody><body name="a"><site/><geom size="1" condim="4"/><geom size="1" condim="4"/>
        <body name="b"><joint name="j" stiffness="2"/></body></body></worldbody>
        <tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>
        <actuator><motor name="pull" tendon="t"/><muscle joint="j"/></actuator>"#,
    )
    .unwrap();
    let all = robot.unsupported.join("\n");
    for part in [
        "<option>",
        "<site>",
        "<tendon>",
        "\"pull\"",
        "<muscle>",
        "condim of <geom> is not read (2 times",
        "stiffness of <joint>",
    ] {
        assert!(all.contains(part), "{part} is missing in\n{all}");
    }
    assert!(Robot::bundled("leap_right").unwrap().unsupported.is_empty());
    assert!(Robot::bundled("allegro_right").unwrap().unsupported.is_empty());
}

fn urdf(folder: &Path, body: &str) -> drex_robot::Result<Robot> {
    let path = folder.join("r.urdf");
    fs::write(&path, format!("<robot name=\"r\">{body}</robot>")).unwrap();
    Robot::load(&path)
}

#[test]
fn urdf_joints_shapes_and_masses() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir_all(folder.path().join("meshes")).unwrap();
    fs::write(folder.path().join("meshes/t.obj"), TETRAHEDRON).unwrap();
    let robot = urdf(
        folder.path(),
        r#"<material name="red"><color rgba="1 0 0 1"/></material>
        <link name="tip"><collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
        <link name="base"><inertial><origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><mass value="2"/>
          <inertia ixx="1" iyy="2" izz="3" ixy="0" ixz="0" iyz="0"/></inertial>
          <visual><geometry><mesh filename="gone.dae"/></geometry></visual>
          <visual><geometry><sphere radius="0.1"/></geometry><material name="red"/></visual></link>
        <link name="mid"><collision><origin xyz="0 0 1"/><geometry><mesh filename="package://some/where/meshes/t.obj" scale="1 1 -1"/></geometry></collision></link>
        <joint name="j1" type="revolute"><parent link="base"/><child link="mid"/><origin xyz="1 0 0" rpy="0.1 0.2 0.3"/><axis xyz="0 0 2"/>
          <limit lower="-1" upper="2" effort="3" velocity="4"/><dynamics damping="0.1" friction="0.2"/></joint>
        <joint name="j2" type="continuous"><parent link="mid"/><child link="tip"/><mimic joint="j1" multiplier="-2" offset="0.5"/></joint>"#,
    )
    .unwrap();
    let names: Vec<&str> = robot.links.iter().map(|l| l.name.as_str()).collect();
    assert_eq!(names, ["base", "mid", "tip"]);
    let j = &robot.joints[0];
    assert_eq!(
        (j.limits, j.effort_limit, j.velocity_limit, j.damping, j.friction_loss),
        (Some((-1.0, 2.0)), Some(3.0), Some(4.0), 0.1, 0.2)
    );
    assert_eq!((robot.joints[1].limits, robot.joints[1].axis), (None, Vector3::x()));
    let mut q = vec![0.25, 9.0];
    robot.apply_mimic(&mut q);
    assert_eq!(q, [0.25, 0.0]);
    // The inertia is turned into the link's axes.
    let base = robot.links[0].inertial.unwrap();
    assert!((base.inertia[(0, 0)] - 2.0).abs() < 1e-12 && base.center_of_mass == Point3::new(0.0, 0.0, 1.0));
    assert_eq!(robot.links[0].geoms[0].rgba, Some([1.0, 0.0, 0.0, 1.0]));
    assert_eq!(robot.links[0].geoms[0].role, GeomRole::Visual);
    assert!((robot.links[2].inertial.unwrap().mass_kg - 8.0).abs() < 1e-12);
    assert!((robot.links[1].inertial.unwrap().mass_kg - 1000.0 / 6.0).abs() < 1e-9);
    assert!(
        robot.unsupported.iter().any(|r| r.contains("gone.dae"))
            && robot.unsupported.iter().any(|r| r.contains("\"tip\" has no mass"))
    );
    let turned = Isometry3::rotation(Vector3::zeros()) * robot.links[1].parent_from_link;
    assert_eq!(turned.rotation, nalgebra::UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3));

    for (text, part) in [
        (
            "<link name=\"a\"><collision><geometry><mesh filename=\"gone.stl\"/></geometry></collision></link>",
            "gone.stl",
        ),
        ("<link name=\"a\"/><link name=\"b\"/>", "second link without a parent"),
        (
            "<link name=\"a\"/><joint name=\"j\" type=\"fixed\"><parent link=\"a\"/><child link=\"c\"/></joint>",
            "link=\"c\"",
        ),
        (
            "<link name=\"a\"/><link name=\"b\"/><joint name=\"j\" type=\"planar\"><parent link=\"a\"/><child link=\"b\"/></joint>",
            "type=\"planar\"",
        ),
        (
            "<link name=\"a\"/><link name=\"b\"/><joint name=\"j\" type=\"revolute\"><parent link=\"a\"/><child link=\"b\"/></joint>",
            "no <limit>",
        ),
        (
            "<link name=\"a\"/><link name=\"b\"/><link name=\"c\"/><joint name=\"j\" type=\"fixed\"><parent link=\"b\"/><child link=\"c\"/></joint><joint name=\"k\" type=\"fixed\"><parent link=\"c\"/><child link=\"b\"/></joint>",
            "circle",
        ),
    ] {
        let message = urdf(folder.path(), text).unwrap_err().to_string();
        assert!(message.contains("r.urdf") && message.contains("line 1") && message.contains(part), "{message}");
    }
}

/// Numbers, tags and attributes shuffled about, text cut anywhere: an answer or an error, never a panic.
fn damaged(text: &'static str) -> impl Strategy<Value = String> {
    let bytes = text.len();
    (
        0..bytes,
        0..bytes,
        prop::sample::select(vec![
            "",
            "-",
            "\"",
            "<",
            ">",
            "/",
            "0",
            "1e999",
            "nan",
            " ",
            "class=\"x\"",
            "<body/>",
            "<joint type=\"slide\"/>",
            "type=\"mesh\"",
            "<include file=\"x\"/>",
            "&lt;",
            "é",
        ]),
        0..4usize,
    )
        .prop_map(move |(a, b, piece, mode)| {
            let clip = |i: usize| (0..=i).rev().find(|k| text.is_char_boundary(*k)).unwrap_or(0);
            let (a, b) = (clip(a.min(b)), clip(a.max(b)));
            match mode {
                0 => text[..b].to_owned(),
                1 => format!("{}{piece}{}", &text[..a], &text[a..]),
                2 => format!("{}{piece}{}", &text[..a], &text[clip((a + 12).min(text.len()))..]),
                _ => format!("{}{}{}", &text[..a], &text[b..], piece),
            }
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn damaged_models_never_panic(text in damaged(Robot::bundled_mjcf("leap_right").unwrap())) {
        if let Ok(robot) = Robot::from_mjcf_str(&text, None) {
            let poses = robot.forward_kinematics(&robot.mid_range(), &Isometry3::identity());
            prop_assert_eq!(poses.len(), robot.links.len());
            let _ = (robot.fingers(), robot.palm_normal(), robot.grasp_center(), robot.mass_matrix(&robot.mid_range()));
        }
    }

    #[test]
    fn damaged_urdf_never_panics(text in damaged(r#"<robot name="r"><link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial><collision><geometry><box size="1 1 1"/></geometry></collision></link><link name="b"><collision><origin rpy="1 2 3"/><geometry><cylinder radius="0.1" length="1"/></geometry></collision></link><joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/><limit lower="0" upper="1"/><mimic joint="j"/></joint></robot>"#)) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.urdf");
        fs::write(&path, text).unwrap();
        if let Ok(robot) = Robot::load(&path) {
            let _ = (robot.fingers(), robot.forward_kinematics(&robot.mid_range(), &Isometry3::identity()));
        }
    }

    #[test]
    fn damaged_meshes_never_panic(
        lines in prop::collection::vec("(v|f|vertex|facet) (-?[0-9]{1,3}(/[0-9])? ?|nan |1e400 |x ){0,5}", 0..20),
        bytes in prop::collection::vec(any::<u8>(), 0..300),
        faces in 0..5u32,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let text = lines.join("\n");
        let mut binary = bytes.clone();
        if let Some(count) = binary.get_mut(80..84) {
            count.copy_from_slice(&faces.to_le_bytes());
            binary.resize(84 + 50 * faces as usize, 7);
        }
        let contents = [("a.obj", text.clone().into_bytes()), ("b.stl", format!("solid\n{text}").into_bytes()), ("c.stl", binary), ("d.stl", bytes)];
        for (name, content) in contents {
            fs::write(folder.path().join(name), content).unwrap();
            let xml = format!(r#"<mujoco><asset><mesh name="m" file="{name}"/></asset><worldbody><body name="a"><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"#);
            if let Ok(robot) = Robot::from_mjcf_str(&xml, Some(folder.path())) {
                let _ = (robot.surface_samples(0, 50.0), robot.links[0].geoms[0].shape.signed_distance(&Point3::origin()));
            }
        }
    }
}
