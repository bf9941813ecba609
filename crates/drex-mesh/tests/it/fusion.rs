//! Depth fusion against shapes whose surface and volume are known.

use std::fs;
use std::path::PathBuf;

use drex_core::pose::pose_from_matrix;
use drex_core::{Pose, Surface, TriMesh};
use drex_mesh::{
    CompareOptions, DecimateOptions, DepthCamera, DepthMap, EvidenceKind, Fused, FusionOptions, Support, cast_depth,
    compare_surfaces, decimate, fuse, read_mesh, write_evidence,
};
use nalgebra::{Isometry3, Matrix4, Point3, Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A closed solid of revolution about z; the profile (r, z) runs so that the solid is on its left.
fn revolve(profile: &[[f64; 2]], around: usize) -> TriMesh {
    let (n, mut mesh) = (profile.len(), TriMesh::default());
    for &[r, z] in profile {
        for i in 0..around {
            let a = i as f64 / around as f64 * std::f64::consts::TAU;
            mesh.vertices.push(Point3::new(r * a.cos(), r * a.sin(), z));
        }
    }
    for k in 0..n {
        for i in 0..around {
            let j = (i + 1) % around;
            let at = |p: usize, i: usize| ((p % n) * around + i) as u32;
            mesh.faces.extend([[at(k, i), at(k, j), at(k + 1, j)], [at(k, i), at(k + 1, j), at(k + 1, i)]]);
        }
    }
    mesh
}

/// A cup without handle; the tiny holes along its axis are a thousandth of its radius wide.
fn cup(radius: f64, height: f64, wall: f64) -> TriMesh {
    let axis = radius * 1e-3;
    revolve(
        &[[axis, 0.0], [radius, 0.0], [radius, height], [radius - wall, height], [radius - wall, wall], [axis, wall]],
        96,
    )
}

fn cuboid(lo: [f64; 3], hi: [f64; 3]) -> TriMesh {
    let vertices = (0..8)
        .map(|i| Point3::new([lo[0], hi[0]][i & 1], [lo[1], hi[1]][i >> 1 & 1], [lo[2], hi[2]][i >> 2]))
        .collect();
    let quads: [[u32; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    TriMesh { vertices, faces: quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect() }
}

fn joined(a: &TriMesh, b: &TriMesh) -> TriMesh {
    let (mut out, base) = (a.clone(), a.vertices.len() as u32);
    out.vertices.extend(&b.vertices);
    out.faces.extend(b.faces.iter().map(|f| f.map(|v| v + base)));
    out
}

fn camera(width_px: u32, height_px: u32, focal_px: f64) -> DepthCamera {
    let (cx_px, cy_px) = (f64::from(width_px) / 2.0, f64::from(height_px) / 2.0);
    DepthCamera { width_px, height_px, fx_px: focal_px, fy_px: focal_px, cx_px, cy_px }
}

/// Cameras on a Fibonacci sphere that look at `center`; only those higher than `lowest` (cosine from the top, -1 for all).
fn around(center: Point3<f64>, distance: f64, count: usize, lowest: f64) -> Vec<Pose> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..count)
        .map(|i| (i as f64 * golden, 1.0 - (2 * i + 1) as f64 / count as f64))
        .filter(|&(_, z)| z > lowest)
        .map(|(a, z)| {
            let r = (1.0 - z * z).sqrt();
            let from = Vector3::new(r * a.cos(), r * a.sin(), z);
            // face_towards turns z to the target and keeps y close to "up": with up = -z, y points down.
            Isometry3::face_towards(&(center + from * distance), &center, &-(Vector3::z() + Vector3::x() * 1e-3))
        })
        .collect()
}

fn cast(mesh: &TriMesh, camera: &DepthCamera, poses: &[Pose]) -> Vec<DepthMap> {
    poses.iter().map(|p| cast_depth(mesh, camera, p)).collect()
}

/// Independent normal noise on hit pixels.
fn noisy(maps: &[DepthMap], sigma_m: f64, seed: u64) -> Vec<DepthMap> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut maps = maps.to_vec();
    for z in maps.iter_mut().flat_map(|m| &mut m.depth_m).filter(|z| **z > 0.0) {
        let (a, b) = (1.0 - rng.random::<f64>(), rng.random::<f64>());
        *z += (sigma_m * (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()) as f32;
    }
    maps
}

fn rendered() -> FusionOptions {
    let mut options = FusionOptions::default();
    options.background_is_empty = true;
    options
}

fn volume(mesh: &TriMesh) -> f64 {
    mesh.mass_properties(1.0).unwrap().mass_kg
}

/// Closed, one part, evidence per vertex.
fn is_whole(fused: &Fused) {
    let (mesh, report) = drex_mesh::repair(&fused.mesh, &Default::default()).unwrap();
    assert_eq!((report.open_edges, report.crowded_edges, report.shells, fused.report.parts), (0, 0, 1, 1));
    assert!(volume(&mesh) > 0.0);
    assert_eq!(fused.evidence.len(), fused.mesh.vertices.len());
}

fn f_at_1_mm(fused: &Fused, truth: &TriMesh) -> f64 {
    let mut options = CompareOptions::default();
    options.samples = 20_000;
    compare_surfaces(&fused.mesh, truth, &options).unwrap().f_score[1].1
}

fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("DREX_SHARED").map(|s| PathBuf::from(s).join("data/golden/mesh"));
    if folder.is_none() {
        println!("skipped: DREX_SHARED is not set");
    }
    folder
}

/// The camera and the poses of a golden shape, and what its depth maps must look like.
fn golden(shape: &str) -> Option<(TriMesh, DepthCamera, Vec<Pose>, serde_json::Value)> {
    let folder = shared()?;
    let views: serde_json::Value = serde_json::from_slice(&std::fs::read(folder.join("views.json")).unwrap()).unwrap();
    let k = |r: usize, c: usize| views["K"][r][c].as_f64().unwrap();
    let camera =
        DepthCamera { width_px: 640, height_px: 480, fx_px: k(0, 0), fy_px: k(1, 1), cx_px: k(0, 2), cy_px: k(1, 2) };
    let pose = |m: &serde_json::Value| pose_from_matrix(&Matrix4::from_fn(|r, c| m[r][c].as_f64().unwrap())).unwrap();
    let poses = views["shapes"][shape]["world_from_camera"].as_array().unwrap().iter().map(pose).collect();
    let mesh = TriMesh::read(&folder.join(format!("{shape}.obj"))).unwrap();
    Some((mesh, camera, poses, views["shapes"][shape]["depth_check"].clone()))
}

#[test]
fn cast_depth_is_that_of_the_reference() {
    let Some((mesh, camera, poses, check)) = golden("bracket") else { return };
    for (i, pose) in poses.iter().enumerate().step_by(5) {
        let hit: Vec<f64> =
            cast_depth(&mesh, &camera, pose).depth_m.iter().filter(|z| **z > 0.0).map(|&z| z.into()).collect();
        let expected: Vec<f64> = check[i].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        assert!((hit.len() as f64 - expected[0]).abs() <= 3.0, "view {i}: {} of {}", hit.len(), expected[0]);
        let mean = hit.iter().sum::<f64>() / hit.len() as f64;
        let least = hit.iter().copied().fold(f64::INFINITY, f64::min);
        let most = hit.iter().copied().fold(0.0, f64::max);
        for (ours, theirs) in [mean, least, most].iter().zip(&expected[1..]) {
            assert!((ours - theirs).abs() < 2e-6, "view {i}: {ours} {theirs}");
        }
    }
}

#[test]
fn noisy_views_of_a_mug_with_a_thin_wall_and_a_handle() {
    let Some((mesh, camera, poses, _)) = golden("mug") else { return };
    let mut options = rendered();
    options.voxel_m = Some(1.5e-3);
    let fused = fuse(&noisy(&cast(&mesh, &camera, &poses), 1e-3, 1), &options).unwrap();
    is_whole(&fused);
    let (f, error) = (f_at_1_mm(&fused, &mesh), volume(&fused.mesh) / volume(&mesh) - 1.0);
    println!("F at 1 mm {f:.4}, volume {:+.2} %, {:?}", 100.0 * error, fused.report);
    assert!(f >= 0.99 && error.abs() <= 0.01, "{f} {error}");
    assert!((fused.report.noise_m - 1e-3).abs() < 5e-5);
    assert!((fused.report.wall_m.unwrap() - 4e-3).abs() < 0.5e-3);
}

#[test]
fn walls_of_any_thickness_survive() {
    let poses = around(Point3::new(0.0, 0.0, 0.03), 0.28, 40, -1.0);
    let camera = camera(400, 300, 500.0);
    for (i, wall) in [2e-3, 3e-3, 6e-3].into_iter().enumerate() {
        let truth = cup(0.03, 0.06, wall);
        for sigma in [0.0, 1e-3].into_iter().skip(i % 2) {
            let mut options = rendered();
            options.voxel_m = Some(1.5e-3);
            let fused = fuse(&noisy(&cast(&truth, &camera, &poses), sigma, i as u64), &options).unwrap();
            is_whole(&fused);
            let (f, error) = (f_at_1_mm(&fused, &truth), volume(&fused.mesh) / volume(&truth) - 1.0);
            println!("wall {wall} noise {sigma}: F {f:.4} volume {:+.2} % {:?}", 100.0 * error, fused.report);
            assert!(f >= 0.99, "{wall} {sigma} {f}");
            // A wall of 1.3 voxels is below the resolution, which the report says.
            let allowed = if fused.report.wall_below_resolution { 0.03 } else { 0.01 };
            assert!(error.abs() <= allowed, "{wall} {sigma} {error}");
            assert_eq!(fused.report.wall_below_resolution, wall < 2.5e-3);
        }
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let truth = cup(0.03, 0.05, 4e-3);
    let maps =
        noisy(&cast(&truth, &camera(200, 150, 250.0), &around(Point3::new(0.0, 0.0, 0.025), 0.25, 20, -1.0)), 5e-4, 3);
    let in_pool = |n: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| fuse(&maps, &rendered()).unwrap())
    };
    assert_eq!(in_pool(1), in_pool(3));
}

#[test]
fn a_block_on_a_table_is_cut_at_the_table_and_the_cut_is_marked() {
    let block = cuboid([-0.03, -0.02, 0.0], [0.03, 0.02, 0.04]);
    let scene = joined(&block, &cuboid([-0.2, -0.2, -0.02], [0.2, 0.2, 0.0]));
    // RGB-D from above: nothing but depth, no background.
    let maps = cast(&scene, &camera(320, 240, 400.0), &around(Point3::new(0.0, 0.0, 0.02), 0.3, 40, 0.2));
    let mut options = FusionOptions::default();
    options.voxel_m = Some(1.5e-3);
    options.region = Some((Point3::new(-0.06, -0.06, -0.01), Point3::new(0.06, 0.06, 0.08)));
    options.support = Some(Support { point: Point3::new(0.0, 0.0, 0.0015), up: Vector3::z_axis() });
    let fused = fuse(&maps, &options).unwrap();
    is_whole(&fused);
    let truth = 0.06 * 0.04 * (0.04 - 0.0015);
    assert!((volume(&fused.mesh) / truth - 1.0).abs() < 0.02, "{}", volume(&fused.mesh) / truth);
    assert!(fused.mesh.vertices.iter().all(|v| v.z > 0.0015 - 1e-9));
    for (v, e) in fused.mesh.vertices.iter().zip(&fused.evidence) {
        assert_eq!(e.kind == EvidenceKind::Support, v.z < 0.0015 + 0.05 * 1.5e-3, "{v} {e:?}");
    }
    let bottom = 0.06 * 0.04 / (2.0 * 0.06 * 0.04 + 2.0 * 0.1 * 0.04);
    assert!((fused.report.support_share - bottom).abs() < 0.03, "{:?} {bottom}", fused.report);
    // Of a simpler mesh the same is known, and a file says so.
    let mut simpler = DecimateOptions::default();
    simpler.max_error_m = Some(1e-4);
    let (mesh, _) = decimate(&fused.mesh, &simpler).unwrap();
    let evidence = fused.evidence_of(&mesh);
    assert!(mesh.vertices.len() < fused.mesh.vertices.len() / 4);
    for (v, e) in mesh.vertices.iter().zip(&evidence) {
        let clear = (v.z - 0.0015 - 0.05 * 1.5e-3).abs() > 1e-3 || v.z < 0.0015 + 1e-9;
        assert!(!clear || (e.kind == EvidenceKind::Support) == (v.z < 0.002), "{v} {e:?}");
    }
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("evidence.ply");
    write_evidence(&file, &mesh, &evidence).unwrap();
    assert_eq!(read_mesh(&file).unwrap(), mesh);
    // Behind the head: three doubles, colour and kind, a short and a float per vertex.
    let bytes = fs::read(&file).unwrap();
    let head = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let kinds = bytes[head..].chunks_exact(34).take(mesh.vertices.len()).map(|v| v[27]);
    assert!(kinds.eq(evidence.iter().map(|e| e.kind as u8)));
    assert!(write_evidence(&file, &mesh, &evidence[1..]).unwrap_err().to_string().contains("one entry per vertex"));
}

#[test]
fn a_side_nobody_saw_is_closed_and_marked() {
    let block = cuboid([-0.03, -0.02, 0.0], [0.03, 0.02, 0.04]);
    let maps = cast(&block, &camera(320, 240, 400.0), &around(Point3::new(0.0, 0.0, 0.02), 0.3, 40, 0.1));
    let fused = fuse(&maps, &rendered()).unwrap();
    is_whole(&fused);
    assert!((volume(&fused.mesh) / 96e-6 - 1.0).abs() < 0.03);
    for (v, e) in fused.mesh.vertices.iter().zip(&fused.evidence) {
        if v.x.abs() < 0.025 && v.y.abs() < 0.015 {
            let (kind, cosine) = if v.z < 0.02 { (EvidenceKind::Unseen, 0.0) } else { (EvidenceKind::Seen, 0.8) };
            assert!(e.kind == kind && e.best_cosine >= cosine && e.best_cosine <= 1.0, "{v} {e:?}");
        }
    }
}

#[test]
fn sharp_edges_reach_the_edges_of_a_block() {
    let block = cuboid([-0.03, -0.02, 0.0], [0.03, 0.02, 0.04]);
    let maps = cast(&block, &camera(320, 240, 400.0), &around(Point3::new(0.0, 0.0, 0.02), 0.3, 30, -1.0));
    let maps = noisy(&maps, 1e-3, 5);
    // Mean distance from points of the edges to the mesh.
    let at_edges = |sharp_edges: bool| {
        let mut options = rendered();
        options.voxel_m = Some(1.5e-3);
        options.sharp_edges = sharp_edges;
        let fused = fuse(&maps, &options).unwrap();
        is_whole(&fused);
        assert!((volume(&fused.mesh) / volume(&block) - 1.0).abs() < 0.01);
        assert!(f_at_1_mm(&fused, &block) > 0.999);
        let surface = drex_mesh::MeshSdf::new(&fused.mesh).unwrap();
        let edges = (0..100).map(|i| f64::from(i) / 99.0).flat_map(|t| {
            [[0.06 * t - 0.03, 0.02, 0.04], [0.03, 0.04 * t - 0.02, 0.0], [-0.03, -0.02, 0.04 * t]].map(Point3::from)
        });
        edges.map(|p| (surface.nearest(&p).point - p).norm()).sum::<f64>() / 300.0
    };
    let (round, sharp) = (at_edges(false), at_edges(true));
    assert!(sharp < 0.7 * round && sharp < 0.4e-3, "{round} {sharp}");
}

#[test]
fn masks_carve_what_depth_does_not_say() {
    // An object seen from above on a table; the mask keeps the table out.
    let object = cup(0.03, 0.05, 5e-3);
    let scene = joined(&object, &cuboid([-0.2, -0.2, -0.02], [0.2, 0.2, -1e-4]));
    let (camera, poses) = (camera(320, 240, 400.0), around(Point3::new(0.0, 0.0, 0.025), 0.3, 40, 0.0));
    let mut maps = cast(&scene, &camera, &poses);
    for (map, alone) in maps.iter_mut().zip(cast(&object, &camera, &poses)) {
        map.mask = Some(alone.depth_m.iter().map(|&z| z > 0.0).collect());
    }
    let mut options = FusionOptions::default();
    options.voxel_m = Some(1.5e-3);
    let fused = fuse(&maps, &options).unwrap();
    is_whole(&fused);
    assert!((volume(&fused.mesh) / volume(&object) - 1.0).abs() < 0.03, "{}", volume(&fused.mesh) / volume(&object));
}

/// A mesh with silhouettes, and with depth where it is not bare, fused at 1.5 mm.
fn with_bare_parts(mesh: &TriMesh, poses: &[Pose], bare: fn(&Point3<f64>) -> bool, support: Option<Support>) -> Fused {
    let mut maps = cast(mesh, &camera(320, 240, 400.0), poses);
    for map in &mut maps {
        map.mask = Some(map.depth_m.iter().map(|z| *z > 0.0).collect());
        let (camera, pose) = (map.camera, map.world_from_camera);
        for (at, z) in map.depth_m.iter_mut().enumerate() {
            let point = pose * Point3::from(camera.ray(at as u32 % 320, at as u32 / 320) * f64::from(*z));
            *z = if bare(&point) { 0.0 } else { *z };
        }
    }
    let mut options = rendered();
    (options.voxel_m, options.support) = (Some(1.5e-3), support);
    fuse(&maps, &options).unwrap()
}

#[test]
fn what_has_no_depth_ends_where_silhouettes_do() {
    // A block on a table, the upper half of which is too bare for depth.
    let block = cuboid([-0.03, -0.02, 0.0], [0.03, 0.02, 0.06]);
    let table = Support { point: Point3::origin(), up: Vector3::z_axis() };
    let fused_from = |poses: &[Pose]| with_bare_parts(&block, poses, |p| p.z > 0.03, Some(table));
    let centre = Point3::new(0.0, 0.0, 0.03);
    let around = around(centre, 0.3, 80, 0.05);
    let fused = fused_from(&around);
    is_whole(&fused);
    let (lo, hi) = fused.mesh.bounds().unwrap();
    // The hull is a pixel and a voxel larger all round.
    assert!((hi - lo - Vector3::new(0.06, 0.04, 0.06)).amax() < 4.5e-3 && lo.z > -1e-9, "{lo} {hi}");
    let ratio = volume(&fused.mesh) / volume(&block);
    assert!((0.97..1.1).contains(&ratio), "{ratio}");
    let top = fused.mesh.vertices.iter().zip(&fused.evidence).filter(|(v, _)| v.z > 0.05);
    assert!(top.clone().count() > 100 && top.clone().all(|(_, e)| e.kind == EvidenceKind::Unseen));
    // From one side nobody sees where it ends at the back: no farther than what was measured.
    let front: Vec<Pose> = around.iter().filter(|p| p.translation.x > 0.8 * 0.3 * 0.9).copied().collect();
    let (lo, hi) = fused_from(&front).mesh.bounds().unwrap();
    assert!(front.len() > 3 && hi.x - lo.x < 0.065 && hi.z > 0.05, "{} {lo} {hi}", front.len());
}

#[test]
fn silhouettes_end_what_has_no_depth_on_sides_that_are_looked_at_without_a_table_too() {
    // The upper half and the far end are too bare for depth; from all round, and from above alone.
    let block = cuboid([-0.03, -0.02, 0.0], [0.03, 0.02, 0.06]);
    let fused_from =
        |poses: &[Pose]| with_bare_parts(&block, poses, |p| p.z > 0.03 || p.x < -0.01, None).mesh.bounds().unwrap();
    let centre = Point3::new(0.0, 0.0, 0.03);
    let (lo, hi) = fused_from(&around(centre, 0.3, 80, -1.0));
    assert!((hi - lo - Vector3::new(0.06, 0.04, 0.06)).amax() < 4.5e-3, "{lo} {hi}");
    // Nobody looks from below: what could be there ends where the measured points do.
    let (lo, hi) = fused_from(&around(centre, 0.3, 80, 0.05));
    assert!((hi.x - lo.x - 0.06).abs() < 4.5e-3 && (hi.z - 0.06).abs() < 4e-3 && lo.z > -4e-3, "{lo} {hi}");
}

#[test]
fn a_bad_map_drills_no_hole_and_bits_in_the_air_are_dropped() {
    let block = cuboid([-0.03, -0.02, 0.0], [0.03, 0.02, 0.04]);
    let (camera, poses) = (camera(320, 240, 400.0), around(Point3::new(0.0, 0.0, 0.02), 0.3, 30, -1.0));
    let mut maps = cast(&block, &camera, &poses);
    let clean = fuse(&maps, &rendered()).unwrap();
    // One map sees through the middle of the block; another one sees a bit in the air.
    maps[7].depth_m.iter_mut().enumerate().filter(|(i, _)| i % 320 > 150 && i % 320 < 170).for_each(|(_, z)| *z = 0.0);
    maps[11]
        .depth_m
        .iter_mut()
        .enumerate()
        .filter(|(i, _)| i / 320 > 118 && i / 320 < 124)
        .for_each(|(_, z)| *z *= 0.8);
    let fused = fuse(&maps, &rendered()).unwrap();
    is_whole(&fused);
    assert!((volume(&fused.mesh) / volume(&clean.mesh) - 1.0).abs() < 0.01);
    let (lo, hi) = fused.mesh.bounds().unwrap();
    assert!((hi - lo - Vector3::new(0.06, 0.04, 0.04)).norm() < 3e-3);
}

#[test]
fn a_small_part_stays_where_it_was_measured_as_the_large_one_was() {
    // Of the two small blocks, each with 4 % of the volume, 8 of 40 views show the second.
    let large = cuboid([-0.03, -0.02, 0.0], [0.03, 0.02, 0.04]);
    let small = |x: f64| cuboid([x - 0.008, -0.008, 0.0], [x + 0.008, 0.008, 0.016]);
    let (camera, poses) = (camera(320, 240, 320.0), around(Point3::new(0.0, 0.0, 0.02), 0.3, 40, 0.0));
    let mut maps = cast(&joined(&large, &joined(&small(0.06), &small(-0.06))), &camera, &poses);
    for (i, map) in maps.iter_mut().enumerate().filter(|(i, _)| i % 5 != 0) {
        map.depth_m = cast(&joined(&large, &small(0.06)), &camera, &poses[i..=i]).swap_remove(0).depth_m;
    }
    let with = |least_views_share: f64| {
        let mut options = rendered();
        (options.background_is_empty, options.least_views_share) = (false, least_views_share);
        fuse(&maps, &options).unwrap()
    };
    let all = with(0.0);
    assert_eq!(all.report.parts, 3);
    let fused = with(0.5);
    assert_eq!((fused.report.parts, fused.report.dropped_parts), (2, all.report.dropped_parts + 1));
    let dropped = &fused.report.dropped[0];
    assert!(dropped.center_m[0] < -0.05 && !dropped.unseen, "{dropped:?}");
}

#[test]
fn what_is_trusted_little_says_little() {
    let block = cuboid([-0.03, -0.02, 0.0], [0.03, 0.02, 0.04]);
    let (camera, poses) = (camera(320, 240, 400.0), around(Point3::new(0.0, 0.0, 0.02), 0.3, 30, -1.0));
    let mut options = rendered();
    (options.voxel_m, options.truncation_m, options.empty_votes) = (Some(1.5e-3), Some(6e-3), 3.0);
    let clean = fuse(&cast(&block, &camera, &poses), &options).unwrap();
    // Every third map sees a block that is 2 mm larger on all sides, and through its middle.
    let large = cuboid([-0.032, -0.022, -0.002], [0.032, 0.022, 0.042]);
    let wrong = |trust: f32| {
        let mut maps = cast(&block, &camera, &poses);
        for (k, map) in maps.iter_mut().enumerate() {
            map.trust = Some(vec![1.0; camera.pixels()]);
            if k % 3 == 0 {
                *map = cast_depth(&large, &camera, &poses[k]);
                let middle = |i: &usize| (140..180).contains(&(i % 320)) && (105..135).contains(&(i / 320));
                (0..camera.pixels()).filter(middle).for_each(|i| map.depth_m[i] *= 1.5);
                map.trust = Some(vec![trust; camera.pixels()]);
            }
        }
        fuse(&maps, &options).unwrap().mesh
    };
    let off = |mesh: &TriMesh| (volume(mesh) / volume(&clean.mesh) - 1.0).abs();
    let [fully, little] = [1.0, 0.1].map(|trust| off(&wrong(trust)));
    assert!(
        little < 0.01 && fully > 5.0 * little,
        "{fully} where all are trusted, {little} where the wrong ones are not"
    );
}

#[test]
fn wrong_input_is_refused_with_the_view_and_the_reason() {
    let block = cuboid([-0.03, -0.02, 0.0], [0.03, 0.02, 0.04]);
    let good = cast(&block, &camera(80, 60, 100.0), &around(Point3::origin(), 0.3, 6, -1.0));
    let refused = |change: &dyn Fn(&mut Vec<DepthMap>, &mut FusionOptions), words: &[&str]| {
        let (mut maps, mut options) = (good.clone(), rendered());
        change(&mut maps, &mut options);
        let message = fuse(&maps, &options).unwrap_err().to_string();
        assert!(words.iter().all(|w| message.contains(w)), "{message} lacks one of {words:?}");
    };
    assert!(fuse(&good, &rendered()).is_ok());
    refused(&|m, _| m.clear(), &["no depth maps"]);
    refused(&|m, _| m[2].depth_m.truncate(9), &["view 2", "depth_m has 9 entries", "80 x 60"]);
    refused(&|m, _| m[3].mask = Some(vec![true]), &["view 3", "mask has 1 entries"]);
    refused(&|m, _| m[5].trust = Some(vec![0.5]), &["view 5", "trust has 1 entries"]);
    refused(&|m, _| m[5].trust = Some(vec![f32::NAN; 4800]), &["view 5", "not finite"]);
    refused(&|m, _| m[1].camera.fx_px = 0.0, &["view 1", "focal"]);
    refused(&|m, _| m[1].camera.cx_px = f64::NAN, &["view 1", "principal point"]);
    refused(&|m, _| m[4].world_from_camera.translation.x = f64::INFINITY, &["view 4", "pose"]);
    refused(&|m, _| m.iter_mut().for_each(|m| m.depth_m.fill(f32::NAN)), &["none of the 6 views"]);
    refused(&|m, _| m.iter_mut().for_each(|m| m.mask = Some(vec![false; 4800])), &["none of the 6 views", "mask"]);
    refused(&|_, o| o.region = Some((Point3::new(1.0, 1.0, 1.0), Point3::new(2.0, 2.0, 2.0))), &["region"]);
    refused(&|_, o| o.region = Some((Point3::new(1.0, 1.0, 1.0), Point3::origin())), &["no box"]);
    refused(&|_, o| o.voxel_m = Some(1e-6), &["voxels of 0.000001 m", "take voxels of"]);
    refused(&|_, o| o.voxel_m = Some(-1.0), &["voxel_m"]);
    refused(&|_, o| o.empty_votes = 0.0, &["empty_votes"]);
    refused(&|_, o| o.smallest_volume_share = f64::NAN, &["smallest_volume_share"]);
    refused(&|_, o| o.least_views_share = 1.5, &["least_views_share is 1.5"]);
    let up = Unit::new_unchecked(Vector3::new(f64::NAN, 0.0, 1.0));
    refused(&|_, o| o.support = Some(Support { point: Point3::origin(), up }), &["support"]);
    refused(
        &|_, o| o.support = Some(Support { point: Point3::new(0.0, 0.0, 1.0), up: Vector3::z_axis() }),
        &["fused volume"],
    );
}
