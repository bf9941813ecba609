//! Meshes that contradict their scan: each contradiction is named by its rule.

use crate::support::cuboid;
use drex_core::{ConvexPart, Pose, PoseRecord, TriMesh};
use drex_mesh::{
    AssetOptions, CheckOptions, DepthCamera, Outcome, RuleResult, ScanCamera, ScanEvidence, Silhouette,
    SupportEvidence, asset_from_mesh, cast_depth, check_asset, check_scan, read_mesh, rebuild_asset, write_mesh,
};
use nalgebra::{Point3, Vector3};

const CAMERA: DepthCamera =
    DepthCamera { width_px: 160, height_px: 120, fx_px: 140.0, fy_px: 140.0, cx_px: 80.0, cy_px: 60.0 };

fn block() -> TriMesh {
    cuboid([-0.03, -0.02, 0.0], [0.03, 0.02, 0.05])
}

/// Twelve cameras on a ring of 0.3 m that look at the block.
fn ring() -> Vec<Pose> {
    let camera = |k: usize| {
        let (sin, cos) = (k as f64 * std::f64::consts::TAU / 12.0).sin_cos();
        let (eye, target) = (Point3::new(0.3 * cos, 0.3 * sin, 0.2), Point3::new(0.0, 0.0, 0.02));
        Pose::face_towards(&eye, &target, &-Vector3::z())
    };
    (0..12).map(camera).collect()
}

/// What a good scan of a mesh says of it.
fn evidence(of: &TriMesh) -> ScanEvidence {
    let mut out = ScanEvidence {
        support: Some(SupportEvidence { point_m: [0.2, 0.1, 0.0], up: [0.0, 0.0, 1.0], rms_px: Some(0.5) }),
        region_m: Some([[-0.05, -0.04, 0.0], [0.05, 0.04, 0.08]]),
        voxel_m: 0.001,
        ..ScanEvidence::default()
    };
    for (k, pose) in ring().iter().enumerate() {
        out.cameras.push(ScanCamera {
            width_px: CAMERA.width_px,
            height_px: CAMERA.height_px,
            focal_px: [CAMERA.fx_px, CAMERA.fy_px],
            principal_px: [CAMERA.cx_px, CAMERA.cy_px],
            world_from_camera: PoseRecord::from(pose),
        });
        let mask = cast_depth(of, &CAMERA, pose).depth_m.iter().map(|z| *z > 0.0).collect();
        out.silhouettes.push(Silhouette {
            camera: CAMERA,
            world_from_camera: *pose,
            mask,
            name: format!("photo_{k:02}.jpg"),
        });
    }
    out
}

fn rule(mesh: &TriMesh, evidence: &ScanEvidence, number: u8) -> RuleResult {
    let parts = [ConvexPart::of_hull(block())];
    let all = check_scan(mesh, &parts, evidence);
    assert_eq!(all.iter().map(|r| r.number).collect::<Vec<_>>(), (17..=23).collect::<Vec<_>>());
    let found = all.into_iter().find(|r| r.number == number).unwrap();
    assert_eq!(found.fix.is_some(), matches!(found.outcome, Outcome::Doubt | Outcome::Fail), "{found:?}");
    found
}

fn outcome(mesh: &TriMesh, evidence: &ScanEvidence, number: u8) -> Outcome {
    rule(mesh, evidence, number).outcome
}

#[test]
fn a_mesh_that_agrees_with_its_scan_passes_all() {
    for r in check_scan(&block(), &[ConvexPart::of_hull(block())], &evidence(&block())) {
        assert_eq!(r.outcome, Outcome::Pass, "{r:?}");
    }
    for r in check_scan(&block(), &[], &ScanEvidence::default()) {
        assert_eq!(r.outcome, Outcome::NotApplicable, "{r:?}");
    }
}

#[test]
fn a_support_that_does_not_fit_its_points() {
    let mut bad = evidence(&block());
    for (px, expected) in [(3.0, Outcome::Doubt), (8.0, Outcome::Fail), (f64::NAN, Outcome::Fail)] {
        bad.support = bad.support.map(|s| SupportEvidence { rms_px: Some(px), ..s });
        assert_eq!(outcome(&block(), &bad, 18), expected);
    }
}

#[test]
fn cameras_below_the_support() {
    let mut wall = evidence(&block());
    wall.support = wall.support.map(|s| SupportEvidence { up: [1.0, 0.0, 0.0], point_m: [0.0; 3], ..s });
    assert_eq!(outcome(&block(), &wall, 19), Outcome::Fail);
    let mut one = evidence(&block());
    one.cameras[3].world_from_camera.translation_m[2] = -0.1;
    assert_eq!(outcome(&block(), &one, 19), Outcome::Doubt);
}

#[test]
fn an_object_that_touches_the_border_of_its_region() {
    let mut cut = evidence(&block());
    cut.region_m = Some([[-0.05, -0.04, 0.0], [0.03, 0.04, 0.08]]);
    assert_eq!(outcome(&block(), &cut, 20), Outcome::Fail);
    cut.region_given = true;
    assert_eq!(outcome(&block(), &cut, 20), Outcome::Doubt);
    // The bottom is at the border because the support is.
    let mut standing = evidence(&block());
    standing.region_m = Some([[-0.05, -0.04, 0.0], [0.05, 0.04, 0.08]]);
    assert_eq!(outcome(&block(), &standing, 20), Outcome::Pass);
}

#[test]
fn a_mesh_larger_than_what_the_photos_show() {
    // The wrong asset of a wall: the cameras are inside of its box.
    let room = cuboid([-1.0, -1.0, -0.5], [1.0, -0.9, 1.0]);
    let scan = evidence(&block());
    let both = crate::support::joined(&[room, block()]);
    assert_eq!(outcome(&both, &scan, 21), Outcome::Fail);
    // Beside the object, outside of the pictures.
    let beam = cuboid([-0.03, -0.02, -0.9], [0.03, 0.02, 0.05]);
    let found = rule(&beam, &scan, 21);
    assert_eq!(found.outcome, Outcome::Fail, "{found:?}");
}

#[test]
fn a_volume_outside_the_visual_hull() {
    let scan = evidence(&block());
    let larger = cuboid([-0.04, -0.02, 0.0], [0.04, 0.02, 0.05]);
    let found = rule(&larger, &scan, 22);
    assert_eq!(found.outcome, Outcome::Fail, "{found:?}");
    // One mask of twelve is of something else.
    let mut odd = scan.clone();
    odd.silhouettes[4].mask.iter_mut().enumerate().for_each(|(i, m)| *m = i % 160 < 20);
    assert_eq!(outcome(&block(), &odd, 22), Outcome::Pass);
}

#[test]
fn photos_at_odds_with_the_silhouette() {
    let elsewhere = cuboid([0.0, -0.02, 0.0], [0.06, 0.02, 0.05]);
    let found = rule(&elsewhere, &evidence(&block()), 23);
    assert!(found.outcome == Outcome::Fail && found.reason.contains("photo_"), "{found:?}");
    let thicker = cuboid([-0.0325, -0.0225, 0.0], [0.0325, 0.0225, 0.053]);
    assert_eq!(outcome(&thicker, &evidence(&block()), 23), Outcome::Doubt);
    let mut other_size = evidence(&block());
    other_size.silhouettes.iter_mut().for_each(|s| s.mask.truncate(7));
    assert_eq!(outcome(&block(), &other_size, 23), Outcome::NotApplicable);
}

#[test]
fn convex_parts_that_do_not_cover_the_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = folder.path().join("block.obj");
    write_mesh(&mesh, &block()).unwrap();
    let mut options = AssetOptions::default();
    options.unit = drex_mesh::LengthUnit::Metre;
    // A box would be written as one, without its mesh.
    options.partition.primitive_tolerance = 0.0;
    asset_from_mesh(&block(), &options).unwrap().write(folder.path()).unwrap();
    let good = check_asset(folder.path(), &CheckOptions::default()).unwrap();
    assert_eq!(good.rule(17).unwrap().outcome, Outcome::Pass, "{good}");
    // Too small by a little on every side: near enough for rule 13, but a sixth of the object is gone.
    let part = folder.path().join("mesh/collision_00.obj");
    let mut small = read_mesh(&part).unwrap();
    let middle = Point3::new(0.0, 0.0, 0.025);
    small.vertices.iter_mut().for_each(|v| *v = middle + (*v - middle) * 0.94);
    write_mesh(&part, &small).unwrap();
    let found = check_asset(folder.path(), &CheckOptions::default()).unwrap();
    assert_eq!(
        (found.rule(13).unwrap().outcome, found.rule(17).unwrap().outcome),
        (Outcome::Pass, Outcome::Fail),
        "{found}"
    );
    let message = rebuild_asset(&mesh, &options, folder.path()).unwrap_err().to_string();
    assert!(message.contains("in no convex part") && message.contains("block.obj"), "{message}");
}

#[test]
fn the_scan_of_an_asset_on_disk_is_asked() {
    let folder = tempfile::tempdir().unwrap();
    asset_from_mesh(&block(), &AssetOptions::default()).unwrap().write(folder.path()).unwrap();
    let mut wrong = evidence(&block());
    wrong.region_m = Some([[-0.05, -0.04, 0.0], [0.03, 0.04, 0.08]]);
    let file = folder.path().join("mesh/scan.json");
    std::fs::write(&file, serde_json::json!({ "scan": {}, "evidence": wrong }).to_string()).unwrap();
    let report = check_asset(folder.path(), &CheckOptions::default()).unwrap();
    let outcomes: Vec<Outcome> = report.rules[17..].iter().map(|r| r.outcome).collect();
    use Outcome::{Fail, NotApplicable, Pass};
    assert_eq!(outcomes, [Pass, Pass, Fail, Pass, NotApplicable, NotApplicable], "{report}");
    assert!(!report.passed() && report.to_string().contains("--region"), "{report}");
    std::fs::write(&file, "{").unwrap();
    assert!(check_asset(folder.path(), &CheckOptions::default()).unwrap_err().to_string().contains("scan.json"));
}
