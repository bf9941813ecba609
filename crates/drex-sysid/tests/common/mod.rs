//! Objects and recordings for the tests.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock};

use drex_core::mesh::convex_hull;
use drex_core::trajectory::PoseNoise;
use drex_core::{ConvexPart, MassProperties, Object, Pose, Trajectory, TriMesh};
use drex_diffsim::{AppliedForce, Body, Collider, ForcePoint, Model, Part, Scene, State, rollout};
use drex_mesh::{AssetOptions, asset_from_mesh};
use drex_recording::{Drive, ForceProfile, PushRecording};
use nalgebra::{Matrix3, Point3, Vector3};

/// The folder of shared data, or `None` with a note that the test is skipped.
pub fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("DREX_SHARED").map(PathBuf::from);
    if folder.is_none() {
        eprintln!("skipped: DREX_SHARED is not set");
    }
    folder
}

/// A closed box mesh.
pub fn box_mesh(half: Vector3<f64>, center: Vector3<f64>) -> TriMesh {
    let vertices = (0..8)
        .map(|i| {
            Point3::from(
                center + half.component_mul(&Vector3::from_fn(|k, _| if i >> k & 1 == 0 { -1.0 } else { 1.0 })),
            )
        })
        .collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let faces = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    TriMesh::new(vertices, faces).unwrap()
}

/// The object of a mesh in metres, made as `drex identify` makes it.
pub fn object_of(mesh: &TriMesh) -> Object {
    asset_from_mesh(mesh, &AssetOptions::in_metres()).unwrap().to_exact_object("").unwrap()
}

/// The same of a mesh file; each is made once, also where two tests ask for it at once, since scans take up to half a minute.
pub fn object_at(mesh: &Path) -> Object {
    static MADE: Mutex<BTreeMap<PathBuf, Arc<OnceLock<Object>>>> = Mutex::new(BTreeMap::new());
    let made = MADE.lock().unwrap().entry(mesh.canonicalize().unwrap()).or_default().clone();
    made.get_or_init(|| object_of(&TriMesh::read(mesh).unwrap())).clone()
}

/// A block of 5 x 6 x 8 cm.
pub fn block() -> Object {
    object_of(&box_mesh(Vector3::new(0.025, 0.03, 0.04), Vector3::zeros()))
}

/// A push of that block, simulated with `mass_kg`, under `force` between 0.3 and 0.45 s at `point`.
pub fn simulated(mass_kg: f64, friction: f64, force: Vector3<f64>, point: Point3<f64>) -> PushRecording {
    pushed_until(0.45, mass_kg, friction, force, point)
}

/// The same with the end of the force chosen.
pub fn pushed_until(end: f64, mass_kg: f64, friction: f64, force: Vector3<f64>, point: Point3<f64>) -> PushRecording {
    pushed_by(&block(), end, mass_kg, friction, [force, Vector3::zeros()], point)
}

/// The same of any object that stands with the middle of its mesh above the origin, by a force and a torque about its point.
pub fn pushed_by(
    object: &Object,
    end: f64,
    mass_kg: f64,
    friction: f64,
    wrench: [Vector3<f64>; 2],
    point: Point3<f64>,
) -> PushRecording {
    let shape = Arc::new(Collider::of_parts(&object.convex_parts).unwrap());
    let mut model = Model::new(vec![Body::new(&object.mass_properties, mass_kg, shape)]);
    // An eighth of the estimator's own step: what its step is worth is part of what is tested.
    model.dt_s /= 8.0;
    let mut scene = Scene::on_table(friction);
    let times: Vec<f64> = (0..120).map(|k| f64::from(k) * 0.01).collect();
    let [forces, torques] = wrench.map(|w| -> Vec<_> {
        times.iter().map(|t| if (0.3..end - 1e-4).contains(t) { w } else { Vector3::zeros() }).collect()
    });
    scene.forces.push(AppliedForce::new(Part::Body(0), &times, &forces, ForcePoint::Body(point)).unwrap());
    scene.forces.push(AppliedForce::new(Part::Body(0), &times, &torques, ForcePoint::Couple).unwrap());
    let (low, _) = object.bounds_at(&Pose::identity()).unwrap();
    let start = Pose::translation(0.0, 0.0, -low.z);
    let frames: Vec<f64> = (0..36).map(|k| f64::from(k) / 30.0).collect();
    let record = rollout(&model, &scene, &State::at_rest(start), &frames).unwrap();
    let track = Trajectory::from_samples(&frames, &record.bodies[0].poses).unwrap();
    let drive =
        Drive::Force(ForceProfile { times_s: times, forces_n: forces, torques_nm: torques, point_in_object: point });
    let mut push = PushRecording::new("block", "block.obj", track, drive);
    push.support.friction = Some(friction);
    push.initial_pose = Some(start);
    push.starts_at_rest = true;
    push.noise = Some(PoseNoise { position_m: 1e-3, rotation_rad: 0.01 });
    push.mass_prior_kg = Some(1.0);
    push
}

/// Mass properties of a solid box around `points` at 1 kg, for objects whose solid does not matter.
pub fn bounding_solid(points: Vec<Point3<f64>>) -> Object {
    let (lo, hi) = points.iter().fold((points[0], points[0]), |(a, b), p| (a.inf(p), b.sup(p)));
    let s = (hi - lo).component_mul(&(hi - lo)) / 12.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: nalgebra::center(&lo, &hi), inertia };
    Object::of_parts(vec![ConvexPart::of_hull(convex_hull(&points).unwrap())], unit)
}

/// Standard normal deviates from a seed: sums of twelve uniforms of a linear congruential generator.
pub fn normals(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(0x1234_5678_9ABC_DEF1);
    move || {
        (0..12)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1_u64 << 53) as f64
            })
            .sum::<f64>()
            - 6.0
    }
}
