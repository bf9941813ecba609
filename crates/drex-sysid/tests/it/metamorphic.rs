//! What cannot change the mass does not: metamorphic relations of pushes, of primitives and of scanned meshes.
//!
//! Pushes of scans are simulated here, with noise: what is compared are answers with answers, not with the truth.

use std::collections::BTreeMap;
use std::path::Path;

use crate::common::{box_mesh, normals, object_at, object_of, shared, simulated};
use drex_core::trajectory::PoseNoise;
use drex_core::{Object, Pose, Trajectory, TriMesh};
use drex_diffsim::{AppliedForce, Body, Collider, ConvexPolyhedron, ForcePoint, Model, Part, Scene, State, rollout};
use drex_recording::convert::mujoco_push::{self, Inputs};
use drex_recording::{Drive, ForceProfile, PushRecording};
use drex_sysid::{Identification, IdentifyOptions, Verdict, identify};
use nalgebra::{Point3, UnitQuaternion, Vector3};

const G: f64 = 9.81;
/// Scans, each of which is slid or tilted.
const SCANS: [&str; 7] = [
    "002_master_chef_can",
    "006_mustard_bottle",
    "007_tuna_fish_can",
    "009_gelatin_box",
    "010_potted_meat_can",
    "061_foam_brick",
    "077_rubiks_cube",
];
/// Those of them that stand firmly: the coffee can and the mustard bottle rock on bumps.
const FIRM: std::ops::Range<usize> = 2..7;

/// A push and the mesh that it is of.
#[derive(Clone)]
struct Push {
    recording: PushRecording,
    mesh: TriMesh,
}

type Relation = (&'static str, f64, fn(&Push) -> Push);

/// Changes of a push that cannot matter, and the factor that each puts on the mass.
const RELATIONS: [Relation; 7] = [
    ("corners in another order", 1.0, permuted),
    ("corners moved by a micrometre", 1.0, jittered),
    ("mirrored", 1.0, mirrored),
    ("the world turned", 1.0, turned),
    ("later", 1.0, later),
    ("the start moved by a micrometre", 1.0, moved),
    ("mass and forces threefold", 3.0, threefold),
];

/// As many of the relations, from the given one on, in turn. In a test that always runs each push is changed in some ways only, so that
/// each relation is seen on several pushes; `every_relation_holds_for_every_push` changes all in all ways.
fn some_relations(from: usize, count: usize) -> Vec<Relation> {
    RELATIONS.iter().cycle().skip(from % RELATIONS.len()).take(count).copied().collect()
}

fn permuted(push: &Push) -> Push {
    let last = push.mesh.vertices.len() as u32 - 1;
    let vertices = push.mesh.vertices.iter().rev().copied().collect();
    let faces = push.mesh.faces.iter().rev().map(|f| f.map(|k| last - k)).collect();
    Push { mesh: TriMesh::new(vertices, faces).unwrap(), ..push.clone() }
}

fn jittered(push: &Push) -> Push {
    let mut random = normals(7);
    let mut out = push.clone();
    // Corners of one place stay together, so that the mesh stays closed.
    let mut moved = BTreeMap::new();
    for v in &mut out.mesh.vertices {
        let by = moved.entry(v.coords.map(f64::to_bits).data.0).or_insert_with(|| Vector3::from_fn(|_, _| random()));
        *v += 1e-6 * *by;
    }
    out
}

fn turned(push: &Push) -> Push {
    let by = Pose::from_parts(Vector3::new(0.3, -0.2, 0.0).into(), UnitQuaternion::from_euler_angles(0.0, 0.0, 1.1));
    changed(push, |p| by * p, |f| by.rotation * f)
}

fn mirrored(push: &Push) -> Push {
    let point = |p: &Point3<f64>| Point3::new(p.x, -p.y, p.z);
    let pose = |p: &Pose| {
        let q = p.rotation.quaternion();
        let q = nalgebra::Quaternion::new(q.w, -q.i, q.j, -q.k);
        let t = p.translation.vector;
        Pose::from_parts(Vector3::new(t.x, -t.y, t.z).into(), UnitQuaternion::from_quaternion(q))
    };
    let mut out = changed(push, pose, |f| Vector3::new(f.x, -f.y, f.z));
    out.mesh.vertices.iter_mut().for_each(|v| *v = point(v));
    out.mesh.faces.iter_mut().for_each(|f| f.swap(1, 2));
    if let Drive::Force(force) = &mut out.recording.drive {
        force.point_in_object = point(&force.point_in_object);
    }
    out
}

fn later(push: &Push) -> Push {
    let mut out = push.clone();
    let times: Vec<f64> = push.recording.track.times_s().iter().map(|t| t + 100.0).collect();
    out.recording.track = Trajectory::from_samples(&times, push.recording.track.poses()).unwrap();
    if let Drive::Force(force) = &mut out.recording.drive {
        force.times_s.iter_mut().for_each(|t| *t += 100.0);
    }
    out
}

/// The stated start, or every tracked one.
fn moved(push: &Push) -> Push {
    let by = Pose::translation(1e-6, -1e-6, 0.0);
    if push.recording.initial_pose.is_none() {
        return changed(push, |p| by * p, |f| f);
    }
    let mut out = push.clone();
    out.recording.initial_pose = push.recording.initial_pose.map(|p| by * p);
    out
}

fn threefold(push: &Push) -> Push {
    changed(push, |p| *p, |f| 3.0 * f)
}

/// A push with other poses and forces.
fn changed(push: &Push, pose: impl Fn(&Pose) -> Pose, force: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Push {
    let mut out = push.clone();
    let poses: Vec<Pose> = push.recording.track.poses().iter().map(&pose).collect();
    out.recording.track = Trajectory::from_samples(push.recording.track.times_s(), &poses).unwrap();
    out.recording.initial_pose = push.recording.initial_pose.as_ref().map(&pose);
    if let Drive::Force(drive) = &mut out.recording.drive {
        drive.forces_n.iter_mut().for_each(|f| *f = force(*f));
    }
    out
}

fn weigh(push: &Push, object: &Object) -> Identification {
    identify(std::slice::from_ref(&push.recording), object, &IdentifyOptions::default()).unwrap()
}

/// A push of a scan that stands as its mesh does, its start withheld: a tilt, or a slide, by a known force, with noise.
fn pushed(mesh: TriMesh, tilts: bool, seed: u64) -> Push {
    let object: Object = object_of(&mesh);
    let (lo, hi) = mesh.bounds().unwrap();
    let (mass_kg, friction) = (0.2, if tilts { 0.8 } else { 0.35 });
    let center = object.mass_properties.center_of_mass;
    let height = if tilts { 0.8 } else { 0.25 } * (hi.z - lo.z);
    let point = Point3::new(lo.x, center.y, lo.z + height);
    let balance = if tilts { (hi.x - center.x) / height } else { friction };
    let force_n = mass_kg * G * balance * if tilts { 1.3 } else { 1.7 };
    let times: Vec<f64> = (0..160).map(|k| f64::from(k) * 0.01).collect();
    let frames: Vec<f64> = (0..48).map(|k| f64::from(k) / 30.0).collect();
    // What touches the table is the scan itself, however it is cut into pieces.
    let hull = Collider::convex(vec![ConvexPolyhedron::from_points(&mesh.vertices).unwrap()]);
    let model = Model::new(vec![Body::new(&object.mass_properties, mass_kg, hull.into())]);
    let start = State::at_rest(Pose::translation(0.0, 0.0, -lo.z));
    let pulse = |duration: f64| -> Vec<Vector3<f64>> {
        let acts = |t: f64| if (0.7..0.7 + duration).contains(&t) { 1.0 } else { 0.0 };
        times.iter().map(|t| Vector3::x() * acts(*t) * force_n).collect()
    };
    // The longest push after which it stands again.
    let (exact, poses) = [0.255, 0.205, 0.155, 0.125, 0.105, 0.085, 0.065, 0.045, 0.025]
        .into_iter()
        .map(|duration| {
            let exact = pulse(duration);
            let mut scene = Scene::on_table(friction);
            scene.forces.push(AppliedForce::new(Part::Body(0), &times, &exact, ForcePoint::Body(point)).unwrap());
            (exact, rollout(&model, &scene, &start, &frames).unwrap().bodies[0].poses.clone())
        })
        .find(|(_, poses)| poses.iter().all(|p| p.rotation.angle() < 0.35))
        .unwrap();
    let mut random = normals(seed);
    let mut noise = |sd: f64| Vector3::from_fn(|_, _| sd * random());
    // What settles on the table first is not recorded.
    let seen = frames.iter().zip(&poses).filter(|(t, _)| **t > 0.4);
    let (frames, poses): (Vec<f64>, Vec<Pose>) = seen
        .map(|(t, p)| {
            let rotation = UnitQuaternion::from_scaled_axis(noise(0.0175)) * p.rotation;
            (*t, Pose::from_parts((p.translation.vector + noise(0.002)).into(), rotation))
        })
        .unzip();
    let forces_n = exact.iter().map(|f| f + noise(0.03 * force_n)).collect();
    let track = Trajectory::from_samples(&frames, &poses).unwrap();
    let drive = Drive::Force(ForceProfile { times_s: times, forces_n, torques_nm: Vec::new(), point_in_object: point });
    let mut recording = PushRecording::new("scan", "scan.obj", track, drive);
    recording.support.friction = Some(friction);
    recording.starts_at_rest = true;
    recording.noise = Some(PoseNoise { position_m: 0.002, rotation_rad: 0.0175 });
    Push { recording, mesh }
}

/// Compares what relations make of a push with the push; returns those that disagree.
fn disagreements(name: &str, push: &Push, relations: &[Relation]) -> Vec<String> {
    let object = object_of(&push.mesh);
    let a = weigh(push, &object);
    assert_eq!(a.verdict, Verdict::Identified, "{name}: {}", a.reason);
    let ([low, high], m) = (a.ci95_kg.unwrap(), a.mass_kg.unwrap());
    let width = (high / low).ln();
    eprintln!("{name}: {m:.4} kg, {low:.4} to {high:.4}, {:.1} s", a.seconds);
    let mut found = Vec::new();
    for (what, times, change) in relations {
        let other = change(push);
        let b = if other.mesh == push.mesh { weigh(&other, &object) } else { weigh(&other, &object_of(&other.mesh)) };
        assert_eq!(b.verdict, a.verdict, "{name}, {what}: {}", b.reason);
        let moved = |a: f64, b: f64| (b / a / times).ln() / width;
        let ([l, h], m) = (b.ci95_kg.unwrap(), moved(m, b.mass_kg.unwrap()));
        let (l, h) = (moved(low, l), moved(high, h));
        eprintln!("  {what}: {m:+.3} of the interval, its ends {l:+.3} and {h:+.3}");
        if !(m.abs() < 0.1 && l.abs() < 0.2 && h.abs() < 0.2) {
            found.push(format!("{name}, {what}: {m:+.3}, {l:+.3}, {h:+.3}"));
        }
    }
    found
}

#[test]
fn relations_hold_for_a_block() {
    let recording =
        simulated(0.2, 0.9, Vector3::x() * 0.2 * G * (0.025 / 0.075) * 1.25, Point3::new(-0.025, 0.0, 0.035));
    let mesh = box_mesh(Vector3::new(0.025, 0.03, 0.04), Vector3::zeros());
    assert_eq!(disagreements("block", &Push { recording, mesh }, &RELATIONS), [""; 0]);
}

/// Disagreements about recorded pushes, each under as many relations.
fn of_recordings(relations: usize) -> Vec<String> {
    let of = |(k, push): (usize, &str)| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/pushes").join(push);
        let mut recording = mujoco_push::load(&folder, Inputs::default()).unwrap();
        recording.initial_pose = None;
        let mesh = TriMesh::read(&recording.mesh).unwrap();
        disagreements(push, &Push { recording, mesh }, &some_relations(4 * k, relations))
    };
    ["box004/slide_force", "T000/lift_force"].into_iter().enumerate().flat_map(of).collect()
}

#[test]
fn relations_hold_for_recordings() {
    assert_eq!(of_recordings(4), [""; 0]);
}

/// Disagreements about pushes of scans, each under as many relations.
fn of_scans(which: std::ops::Range<usize>, relations: usize) -> Vec<String> {
    let Some(shared) = shared() else { return Vec::new() };
    let of = |k: usize| {
        let mesh = TriMesh::read(&shared.join(format!("data/objects/{}.obj", SCANS[k]))).unwrap();
        let push = pushed(mesh, k.is_multiple_of(2), k as u64);
        disagreements(SCANS[k], &push, &some_relations(2 * k, relations))
    };
    which.flat_map(of).collect()
}

#[test]
fn relations_hold_for_scans_that_stand_firmly() {
    assert_eq!(of_scans(FIRM, 2), [""; 0]);
}

#[test]
#[ignore = "minutes: all seven relations of all pushes, of which the other tests take some each"]
fn every_relation_holds_for_every_push() {
    let all = RELATIONS.len();
    let found = [of_recordings(all), of_scans(FIRM, all), disagreements("demo", &of_photos(), &RELATIONS)];
    assert_eq!(found.concat(), [""; 0]);
}

#[test]
#[ignore = "the mustard bottle may be refused, the coffee can moves by 0.15 of its interval"]
fn relations_hold_for_scans_that_rock() {
    assert_eq!(of_scans(0..FIRM.start, RELATIONS.len()), [""; 0]);
}

/// The push and the mesh of the demo, whose mesh is made of photos.
fn of_photos() -> Push {
    let recording = PushRecording::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/demo")).unwrap();
    assert_eq!(recording.mesh_sd_m, Some(0.0009));
    let mesh = TriMesh::read(&recording.mesh).unwrap();
    Push { recording, mesh }
}

#[test]
fn relations_hold_for_a_mesh_of_photos() {
    assert_eq!(disagreements("demo", &of_photos(), &some_relations(5, 3)), [""; 0]);
}

/// Nobody says how well the mesh is known: its surface does. As exact, the interval ends at 166 g.
#[test]
fn a_rough_mesh_is_not_exact() {
    let mut push = of_photos();
    push.recording.mesh_sd_m = None;
    let object = object_of(&push.mesh);
    let answer = weigh(&push, &object);
    let [low, high] = answer.ci95_kg.unwrap();
    assert!(low < 0.168 && 0.168 < high && high - low > 0.1 * 0.168, "{low} {high}");
    assert!(answer.assumptions.iter().any(|s| s.contains("since it is rough")), "{:?}", answer.assumptions);
    push.recording.mesh_sd_m = Some(0.0);
    let [low, high] = weigh(&push, &object).ci95_kg.unwrap();
    assert!(high - low < 0.07 * 0.168, "{low} {high}");
}

/// The pushes are of one mesh: what the `push.toml` of one says about it holds for all.
#[test]
fn one_push_says_how_well_the_mesh_is_known() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/pushes/L003/lift_force");
    let unstated = mujoco_push::load(&folder, Inputs::default()).unwrap();
    let object = object_at(&unstated.mesh);
    let mut stated = unstated.clone();
    stated.mesh_sd_m = Some(0.002);
    let weigh = |pushes: &[PushRecording]| identify(pushes, &object, &IdentifyOptions::default()).unwrap();
    let [none, one, both] =
        [[&unstated; 2], [&unstated, &stated], [&stated; 2]].map(|two| weigh(&two.map(Clone::clone)));
    assert_eq!((one.mass_kg, one.ci95_kg, &one.assumptions), (both.mass_kg, both.ci95_kg, &both.assumptions));
    assert_ne!(one.ci95_kg, none.ci95_kg);
}
