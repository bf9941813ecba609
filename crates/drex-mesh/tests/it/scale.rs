//! Scale and up: made-up cameras with known answers, and the photos of a pot on a printed sheet.

use std::collections::BTreeMap;

use crate::support::{ColmapModel, json, shared};
use drex_core::Pose;
use drex_core::camera::{Camera, CameraModel};
use drex_mesh::{
    KnownDistance, Scene, ScenePoint, SceneView, Sighting, Similarity, SupportOptions, read_marks,
    scale_from_distances, sheet_from_marks, support_plane, triangulate, triangulate_marks,
};
use nalgebra::{Matrix4, Point2, Point3, UnitQuaternion, Vector3};
use proptest::prelude::*;

fn camera() -> Camera {
    Camera::new(CameraModel::SimpleRadial, 1000, 740, &[880.0, 500.0, 370.0, -0.02]).unwrap()
}

/// Cameras on a ring of radius 0.5 m, 0.4 m up, looking at the origin.
fn ring(n: usize) -> Vec<Pose> {
    (0..n)
        .map(|i| {
            let a = std::f64::consts::TAU * i as f64 / n as f64;
            let eye = Point3::new(0.5 * a.cos(), 0.5 * a.sin(), 0.4);
            let z = -eye.coords.normalize();
            let x = z.cross(&Vector3::z()).normalize();
            let r = nalgebra::Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
            Pose::from_parts(eye.coords.into(), UnitQuaternion::from_rotation_matrix(&r))
        })
        .collect()
}

fn sightings<'a>(camera: &'a Camera, poses: &[Pose], p: &Point3<f64>, noise: f64) -> Vec<Sighting<'a>> {
    let wobble =
        |i: usize| Point2::new(((i * 7919) % 13) as f64 - 6.0, ((i * 104_729) % 11) as f64 - 5.0) * (noise / 6.0);
    poses
        .iter()
        .enumerate()
        .map(|(i, pose)| Sighting {
            camera,
            world_from_camera: *pose,
            pixel: camera.project(&pose.inverse_transform_point(p)).unwrap() + wobble(i).coords,
        })
        .collect()
}

#[test]
fn a_point_is_found_from_two_photos_and_from_many() {
    let camera = camera();
    let p = Point3::new(0.03, -0.02, 0.05);
    for n in [2, 3, 12, 150] {
        let found = triangulate(&sightings(&camera, &ring(n + 1)[..n], &p, 0.0)).unwrap();
        assert!((found.point - p).norm() < 1e-12 && found.rms_px < 1e-9 && found.left_out.is_empty(), "{n}: {found:?}");
    }
    let noisy = triangulate(&sightings(&camera, &ring(12), &p, 0.8)).unwrap();
    assert!((noisy.point - p).norm() < 3e-4 && noisy.rms_px > 0.2 && noisy.rms_px < 1.0, "{noisy:?}");
}

#[test]
fn bad_sightings_are_left_out() {
    let camera = camera();
    let p = Point3::new(0.03, -0.02, 0.05);
    for (n, bad) in [(4, vec![1]), (12, vec![0, 5, 6, 11])] {
        let mut seen = sightings(&camera, &ring(n), &p, 0.3);
        bad.iter().for_each(|&i| seen[i].pixel += Vector3::new(90.0, -40.0, 0.0).xy());
        let found = triangulate(&seen).unwrap();
        assert_eq!(found.left_out, bad);
        assert!((found.point - p).norm() < 5e-4, "{found:?}");
    }
}

#[test]
fn what_cannot_be_triangulated_is_named() {
    let camera = camera();
    let p = Point3::new(0.03, -0.02, 0.05);
    let seen = sightings(&camera, &ring(4), &p, 0.0);
    let refused = |s: &[Sighting<'_>], word: &str| {
        let message = triangulate(s).unwrap_err().to_string();
        assert!(message.contains(word), "{message}");
    };
    refused(&seen[..1], "seen in 1 photos");
    refused(&[seen[0], seen[0]], "parallel");
    // Both cameras turned round: the rays meet behind them.
    let back = |s: &Sighting<'_>| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::PI);
        let turned = s.world_from_camera.rotation * turn;
        Pose::from_parts(s.world_from_camera.translation, turned)
    };
    let mirrored = Point2::new(1000.0 - seen[0].pixel.x, seen[0].pixel.y);
    let behind = [
        Sighting { world_from_camera: back(&seen[0]), pixel: mirrored, ..seen[0] },
        Sighting {
            world_from_camera: back(&seen[1]),
            pixel: Point2::new(1000.0 - seen[1].pixel.x, seen[1].pixel.y),
            ..seen[1]
        },
    ];
    refused(&behind, "behind");
    refused(&[Sighting { pixel: Point2::new(f64::NAN, 0.0), ..seen[0] }, seen[1]], "no ray");
}

#[test]
fn several_distances_share_one_scale() {
    let marks: BTreeMap<String, Point3<f64>> = [("A", [0.0, 0.0, 0.0]), ("B", [2.0, 0.0, 0.0]), ("C", [0.0, 3.0, 0.0])]
        .map(|(n, p)| (n.into(), p.into()))
        .into();
    let distance = |from: &str, to: &str, distance_m| KnownDistance { from: from.into(), to: to.into(), distance_m };
    let one = scale_from_distances(&marks, &[distance("A", "B", 0.1)]).unwrap();
    assert!((one.metres_per_unit - 0.05).abs() < 1e-15 && (one.distances[0].model_m - 0.1).abs() < 1e-15);
    let two = scale_from_distances(&marks, &[distance("A", "B", 0.1), distance("A", "C", 0.156)]).unwrap();
    // (2 · 0.1 + 3 · 0.156) / (4 + 9)
    assert!((two.metres_per_unit - 0.668 / 13.0).abs() < 1e-15);
    for (bad, word) in [
        (distance("A", "X", 0.1), "use one of A, B, C"),
        (distance("A", "A", 0.1), "two different marks"),
        (distance("A", "B", -0.1), "positive distance"),
    ] {
        let message = scale_from_distances(&marks, &[bad]).unwrap_err().to_string();
        assert!(message.contains(word), "{message}");
    }
    assert!(scale_from_distances(&marks, &[]).is_err());
}

#[test]
fn mirrored_frames_are_refused() {
    let s = Similarity {
        scale: 0.03,
        rotation: UnitQuaternion::from_euler_angles(0.3, -1.0, 2.0),
        translation: Vector3::new(1.0, 2.0, 3.0),
    };
    let again = Similarity::from_matrix(&s.to_matrix()).unwrap();
    assert!((again.to_matrix() - s.to_matrix()).norm() < 1e-12);
    let mut mirror = s.to_matrix();
    mirror.column_mut(0).neg_mut();
    let message = Similarity::from_matrix(&mirror).unwrap_err().to_string();
    assert!(message.contains("mirrors") && message.contains("right-handed"), "{message}");
    let mut sheared = s.to_matrix();
    sheared[(0, 0)] *= 1.1;
    assert!(Similarity::from_matrix(&sheared).unwrap_err().to_string().contains("shears"));
    assert!(Similarity::from_matrix(&Matrix4::zeros()).is_err());
    assert!(Similarity::from_matrix(&Matrix4::repeat(f64::NAN)).is_err());

    let solid: Vec<Point3<f64>> =
        [[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3]].map(Point3::from).to_vec();
    let mirrored: Vec<Point3<f64>> = solid.iter().map(|p| Point3::new(-p.x, p.y, p.z)).collect();
    assert!(Similarity::between(&solid, &mirrored).unwrap_err().to_string().contains("mirror"));
    let line: Vec<Point3<f64>> = (0..4).map(|i| Point3::new(f64::from(i), 0.0, 0.0)).collect();
    assert!(Similarity::between(&line, &line).unwrap_err().to_string().contains("line"));
    assert!(Similarity::between(&solid[..2], &solid[..2]).is_err());
}

#[test]
fn a_table_among_clutter() {
    // A table of 3000 points, an object and a wall of 1000 each, in arbitrary axes and units.
    let to_model = Similarity {
        scale: 30.0,
        rotation: UnitQuaternion::from_euler_angles(0.8, 0.4, -1.2),
        translation: Vector3::new(-3.0, 8.0, 1.0),
    };
    let mut random = 7u64;
    let mut next = || {
        random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (random >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let mut points = Vec::new();
    for i in 0..5000 {
        let p = match i % 5 {
            0..3 => Point3::new(0.3 * next(), 0.3 * next(), 5e-4 * next()),
            3 => Point3::new(0.05 * next(), 0.05 * next(), 0.04 + 0.08 * next()),
            _ => Point3::new(0.5, 0.8 * next(), 0.3 + 0.6 * next()),
        };
        points.push(to_model.point(&p));
    }
    let view = |c: &Pose| SceneView { lens: camera(), world_from_camera: to_model.pose(c) };
    let views: Vec<SceneView> = ring(12).iter().map(view).collect();
    let points: Vec<ScenePoint> = points.into_iter().map(ScenePoint::at).collect();
    let scene = Scene::new(points.clone(), views.clone()).unwrap();
    let table = support_plane(&scene, &SupportOptions::default()).unwrap().chosen.table;
    assert!(table.up.angle(&(to_model.rotation * Vector3::z())) < 0.05_f64.to_radians());
    assert!((table.rms / 30.0 - 5e-4 / 12.0_f64.sqrt()).abs() < 1e-4 && table.inliers > 2800, "{table:?}");
    let metric = Similarity::of_table(
        1.0 / 30.0,
        &table,
        &to_model.point(&Point3::origin()),
        &(to_model.rotation * Vector3::x()),
    )
    .unwrap();
    let back = metric.point(&to_model.point(&Point3::new(0.1, 0.05, 0.02)));
    assert!((back - Point3::new(0.1, 0.05, 0.02)).norm() < 5e-4, "{back}");
    assert_eq!(table, support_plane(&scene, &SupportOptions::default()).unwrap().chosen.table);

    assert!(Scene::new(points[..3].to_vec(), Vec::new()).is_err() && Scene::new(points[..2].to_vec(), views).is_err());
}

#[test]
fn the_sheet_of_the_flower_pot() {
    let Some(data) = shared() else { return };
    let scan = data.join("scans/flowerpot");
    let model = ColmapModel::read(&scan.join("sparse/0"));
    let truth = json(&scan.join("scale.json"));
    let marks = read_marks(&scan.join("marks.json")).unwrap();
    let found = triangulate_marks(&marks, |name| model.photos.get(name).map(|(c, p)| (c, *p))).unwrap();
    let places: BTreeMap<String, Point3<f64>> = found.iter().map(|(n, t)| (n.clone(), t.point)).collect();
    let distance = |from: &str, to: &str| KnownDistance { from: from.into(), to: to.into(), distance_m: 0.12 };
    let fit = scale_from_distances(&places, &[distance("A", "C")]).unwrap();
    let bd = (places["B"] - places["D"]).norm() * fit.metres_per_unit;
    let table = support_plane(&model.scene(), &SupportOptions::default()).unwrap().chosen.table;
    let up = truth["table_plane"]["normal_up_in_model"].as_array().unwrap();
    let up = Vector3::from_iterator(up.iter().map(|c| c.as_f64().unwrap()));
    let tilt = table.up.angle(&up).to_degrees();
    eprintln!(
        "scale {:.6} m per unit, B-D {:.2} mm, table {tilt:.3} degrees off, {} points, {:.3} mm rms",
        fit.metres_per_unit,
        1e3 * bd,
        table.inliers,
        1e3 * table.rms * fit.metres_per_unit
    );
    for (name, t) in &found {
        eprintln!("{name}: {:.2} px rms, {} left out", t.rms_px, t.left_out.len());
    }
    for seed in 2..8 {
        let mut options = SupportOptions::default();
        options.seed = seed;
        let again = support_plane(&model.scene(), &options).unwrap().chosen.table;
        assert!(again.up.angle(&up).to_degrees() < 0.2, "seed {seed}: {}", again.up.angle(&up).to_degrees());
    }
    assert!((fit.metres_per_unit / truth["metres_per_unit"].as_f64().unwrap() - 1.0).abs() < 2e-3);
    assert!((bd - 0.12).abs() < 0.0012 && tilt < 0.5);

    // The same from the layout of the sheet: the marks lie 60 mm from its middle.
    let layout: BTreeMap<String, [f64; 2]> =
        [("A", [0.0, -0.06]), ("B", [0.06, 0.0]), ("C", [0.0, 0.06]), ("D", [-0.06, 0.0])]
            .map(|(n, p)| (n.into(), p))
            .into();
    let (sheet, rms) = sheet_from_marks(&places, &layout, &model.cameras()).unwrap();
    assert!(rms < 5e-4 && (sheet.scale / fit.metres_per_unit - 1.0).abs() < 5e-3, "{rms} {sheet:?}");
    assert!((sheet.rotation * table.up.into_inner()).angle(&Vector3::z()) < 0.5_f64.to_radians());
    let flipped = layout.iter().map(|(n, [x, y])| (n.clone(), [*x, -*y])).collect();
    assert!(sheet_from_marks(&places, &flipped, &model.cameras()).unwrap_err().to_string().contains("mirrored"));
}

#[test]
fn broken_files_of_marks_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("marks.json");
    for (text, word) in [
        ("{\"a.jpg\": {\"A\": [1.0]}}", "marks.json"),
        ("[1, 2]", "marks.json"),
        ("{\"a.jpg\": {\"A\": [1e999, 2]}}", "marks.json"),
        ("{\"a.jpg\": ", "line 1"),
    ] {
        std::fs::write(&path, text).unwrap();
        let message = read_marks(&path).unwrap_err().to_string();
        assert!(message.contains(word), "{message}");
    }
    let marks = BTreeMap::from([("a.jpg".to_string(), BTreeMap::from([("A".to_string(), [1.0, 2.0])]))]);
    let message = triangulate_marks(&marks, |_| None).unwrap_err().to_string();
    assert!(message.contains("mark A"), "{message}");
}

proptest! {
    #[test]
    fn a_similarity_is_found_from_its_points(
        angles in proptest::array::uniform3(-3.0..3.0f64),
        shift in proptest::array::uniform3(-5.0..5.0f64),
        scale in 1e-3..1e3f64,
        cloud in proptest::collection::vec(proptest::array::uniform3(-1.0..1.0f64), 4..20),
        flat in any::<bool>(),
    ) {
        let truth = Similarity {
            scale,
            rotation: UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]),
            translation: shift.into(),
        };
        let b: Vec<Point3<f64>> = cloud.iter().map(|p| Point3::new(p[0], p[1], if flat { 0.0 } else { p[2] })).collect();
        let a: Vec<Point3<f64>> = b.iter().map(|p| truth.point(p)).collect();
        let (found, rms) = Similarity::between(&b, &a).unwrap();
        prop_assert!(rms < 1e-9 * scale.max(1.0));
        for p in &b {
            prop_assert!((found.point(p) - truth.point(p)).norm() < 1e-8 * scale.max(1.0));
            prop_assert!((found.inverse().point(&truth.point(p)) - p).norm() < 1e-7);
        }
    }
}
