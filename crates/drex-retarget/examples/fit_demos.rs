//! Solves the wrist poses of recorded grasps and says how many make a grasp.
//!
//! ```text
//! fit_demos MESH GRASPS [--robot leap_right] [--order leap_sdk] [--up 0,0,1] [--mass 0.2] [--first N] [--out DIR]
//! ```
//! With `--out` the fits are written as `fits.json` and each hand with its object as an OBJ file to look at.
#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)] // a program for the terminal

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use drex_core::{Object, Pose, TablePlane, TriMesh};
use drex_grasp::{EvaluationOptions, HandSurface, evaluate_with};
use drex_mesh::{GridOptions, RepairOptions, read_mesh, repair, solid_object};
use drex_recording::readers::read_grasps;
use drex_retarget::{WristFit, WristFitOptions, fit_wrists};
use drex_robot::{Robot, Shape, joint_order};
use nalgebra::{Point3, Vector3};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let option = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1)).cloned();
    let [mesh_path, grasps_path] = [0, 1].map(|i| PathBuf::from(args.get(i).cloned().unwrap_or_default()));
    let robot = Robot::bundled(&option("--robot").unwrap_or_else(|| "leap_right".into()))?;
    let order: Vec<String> = joint_order::require(&option("--order").unwrap_or_else(|| "leap_sdk".into()))?
        .iter()
        .map(|s| s.to_string())
        .collect();
    let up: Vec<f64> =
        option("--up").unwrap_or_else(|| "0,0,1".into()).split(',').map(|v| v.parse()).collect::<Result<_, _>>()?;
    let mass_kg: f64 = option("--mass").unwrap_or_else(|| "0.2".into()).parse()?;

    let clock = Instant::now();
    let (mesh, _) = repair(&read_mesh(&mesh_path)?, &RepairOptions::default())?;
    let bounds = mesh.bounds().ok_or("the mesh is empty")?;
    let table = TablePlane::under(&mesh.vertices, Vector3::new(up[0], up[1], up[2])).ok_or("no up direction")?;
    let mut grid = GridOptions::default();
    grid.margin_m = Some(0.1);
    let object = solid_object("object", &mesh, &grid)?.with_table(&table).with_mass(mass_kg);
    println!(
        "object ready in {:.1} s, extents {:?} m",
        clock.elapsed().as_secs_f64(),
        (bounds.1 - bounds.0).as_slice()
    );

    let table_of_grasps = read_grasps(&grasps_path, Some(&order))?;
    let mut rows = Vec::new();
    for row in &table_of_grasps.rows {
        rows.push(robot.joint_vector_full(&table_of_grasps.names, row)?);
    }
    if let Some(first) = option("--first") {
        rows.truncate(first.parse()?);
    }
    let mut options = WristFitOptions::default();
    if let Some(starts) = option("--starts") {
        options.initial_guesses = starts.parse()?;
    }
    let clock = Instant::now();
    let fits = fit_wrists(&robot, &rows, &object, &options)?;
    let seconds = clock.elapsed().as_secs_f64();
    println!("{} grasps in {seconds:.1} s, {:.0} ms each", fits.len(), 1e3 * seconds / fits.len() as f64);
    spread("recorded distance of thumb tip and furthest fingertip, mm", rows.iter().map(|q| opening_mm(&robot, q)));
    report(&robot, &fits, &object)?;
    if let Some(out) = option("--out") {
        write(Path::new(&out), &robot, &mesh, &fits)?;
    }
    Ok(())
}

fn report(robot: &Robot, fits: &[WristFit], object: &Object) -> Result<(), Box<dyn std::error::Error>> {
    let accepted: Vec<&WristFit> = fits.iter().filter(|f| f.evaluation.passed).collect();
    let held = accepted.iter().filter(|f| f.grasp.grip_force_n.is_some()).count();
    let clipped = fits.iter().filter(|f| f.clipped_rad.iter().any(|c| *c != 0.0)).count();
    let closed = accepted.iter().filter(|f| f.evaluation.force_closure).count();
    println!(
        "{} of {} survive, {held} of them carry the object, {closed} are in force closure; {clipped} were outside joint limits",
        accepted.len(),
        fits.len()
    );
    let mut reasons: BTreeMap<String, usize> = BTreeMap::new();
    for fit in fits {
        for failure in &fit.evaluation.failures {
            *reasons.entry(kind(failure)).or_default() += 1;
        }
    }
    println!("reasons: {reasons:?}");
    spread("penetration of all, mm", fits.iter().map(|f| f.evaluation.penetration_mm));
    spread("largest correction of survivors, rad", accepted.iter().map(|f| f.largest_correction_rad()));
    spread(
        "touching fingers of survivors",
        accepted.iter().map(|f| f.evaluation.fingers.iter().filter(|g| g.touches).count() as f64),
    );
    spread("pushed out of the hand", accepted.iter().map(|f| f.pushed_out));
    let per_weight = |f: &WristFit| f.grasp.grip_force_n.map(|n| n / object.weight_n());
    let good = accepted.iter().filter(|f| f.pushed_out < 0.1 && per_weight(f).is_some_and(|s| s < 4.0)).count();
    println!("{good} survivors have the object between the fingers and carry it with less than four times its weight");
    spread("grip force per weight", accepted.iter().filter_map(|f| per_weight(f)));

    let surface = HandSurface::new(robot, 0.003)?;
    let mut options = EvaluationOptions::default();
    options.gamma = 1.5;
    let mut checks = Vec::new();
    for fit in &accepted {
        checks.push(evaluate_with(&surface, &fit.grasp, object, robot, &options)?);
    }
    println!(
        "evaluation (gamma 1.5, motors, mu 0.5): {} of {} pass",
        checks.iter().filter(|c| c.passed).count(),
        checks.len()
    );
    let mut failures: BTreeMap<String, usize> = BTreeMap::new();
    for failure in checks.iter().flat_map(|c| &c.failures) {
        *failures.entry(kind(failure)).or_default() += 1;
    }
    println!("failures: {failures:#?}");
    spread("grip force, N", checks.iter().filter_map(|c| c.grip_force_n));
    spread("friction margin", checks.iter().filter_map(|c| c.friction_margin));
    spread("torque margin", checks.iter().filter_map(|c| c.torque_margin));
    spread("epsilon", checks.iter().filter_map(|c| c.epsilon));
    Ok(())
}

/// The beginning of a sentence without its numbers, for counting.
fn kind(failure: &str) -> String {
    failure.chars().filter(|c| !c.is_ascii_digit()).take(48).collect()
}

/// Largest distance between the tip of the thumb and that of a finger.
fn opening_mm(robot: &Robot, q: &[f64]) -> f64 {
    let poses = robot.forward_kinematics(q, &Pose::identity());
    let tips: Vec<(bool, Point3<f64>)> =
        robot.fingers().iter().map(|f| (f.is_thumb, poses[f.tip_link] * f.tip_point)).collect();
    let thumb = tips.iter().find(|t| t.0).map_or_else(Point3::origin, |t| t.1);
    1e3 * tips.iter().filter(|t| !t.0).map(|t| (t.1 - thumb).norm()).fold(0.0, f64::max)
}

fn spread(what: &str, values: impl Iterator<Item = f64>) {
    let mut v: Vec<f64> = values.collect();
    v.sort_by(f64::total_cmp);
    if v.is_empty() {
        return;
    }
    let at = |p: f64| v[((v.len() - 1) as f64 * p).round() as usize];
    println!(
        "{what}: min {:.3}, quartiles {:.3} {:.3} {:.3}, max {:.3}",
        at(0.0),
        at(0.25),
        at(0.5),
        at(0.75),
        at(1.0)
    );
}

fn write(out: &Path, robot: &Robot, mesh: &TriMesh, fits: &[WristFit]) -> Result<(), Box<dyn std::error::Error>> {
    std::fs::create_dir_all(out)?;
    let mut list = Vec::new();
    for (i, fit) in fits.iter().enumerate() {
        list.push(serde_json::json!({
            "grasp": i, "hand": fit.grasp, "evaluation": fit.evaluation, "pushed_out": fit.pushed_out, "correction_rad": fit.correction_rad,
        }));
        std::fs::write(
            out.join(format!("hand_{i:03}.obj")),
            hand_obj(robot, &fit.grasp.joints_rad, &fit.grasp.object_from_base),
        )?;
    }
    std::fs::write(out.join("fits.json"), serde_json::to_string_pretty(&list)?)?;
    let mut text = String::new();
    append(&mut text, &mut 0, "object", &mesh.vertices, &mesh.faces);
    std::fs::write(out.join("object.obj"), text)?;
    Ok(())
}

/// The collision shapes as boxes and the points of round shapes' hulls: enough to look at.
fn hand_obj(robot: &Robot, q: &[f64], object_from_base: &Pose) -> String {
    let poses = robot.forward_kinematics(q, object_from_base);
    let mut text = String::new();
    let mut base = 0;
    for (link, geom) in robot.collision_geoms() {
        let pose = poses[link] * geom.link_from_geom;
        let (points, faces) = shape_mesh(&geom.shape);
        let points: Vec<Point3<f64>> = points.iter().map(|p| pose * p).collect();
        append(&mut text, &mut base, &robot.links[link].name, &points, &faces);
    }
    text
}

fn append(text: &mut String, base: &mut u32, name: &str, points: &[Point3<f64>], faces: &[[u32; 3]]) {
    use std::fmt::Write as _;
    let _ = writeln!(text, "o {name}");
    for p in points {
        let _ = writeln!(text, "v {:.6} {:.6} {:.6}", p.x, p.y, p.z);
    }
    for f in faces {
        let _ = writeln!(text, "f {} {} {}", base_index(*base, f[0]), base_index(*base, f[1]), base_index(*base, f[2]));
    }
    *base += points.len() as u32;
}

fn base_index(base: u32, i: u32) -> u32 {
    base + i + 1
}

/// A latitude-longitude mesh stretched over the shape's support points.
fn shape_mesh(shape: &Shape) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    if let Shape::Mesh(mesh) = shape {
        return (mesh.vertices.clone(), mesh.faces.clone());
    }
    if let Shape::Box { half } = shape {
        let points = (0..8)
            .map(|k| Point3::from(Vector3::from_fn(|a, _| if k >> a & 1 == 1 { half[a] } else { -half[a] })))
            .collect();
        let quads: [[u32; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        return (points, quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect());
    }
    let (rings, around) = (12_u32, 16_u32);
    let mut points = Vec::new();
    for i in 0..=rings {
        let latitude = std::f64::consts::PI * (f64::from(i) / f64::from(rings) - 0.5);
        for k in 0..around {
            let (s, c) = (std::f64::consts::TAU * f64::from(k) / f64::from(around)).sin_cos();
            let n = Vector3::new(latitude.cos() * c, latitude.cos() * s, latitude.sin());
            points.push(Point3::from(match shape {
                Shape::Sphere { radius } => n * *radius,
                Shape::Capsule { radius, half_length } => n * *radius + Vector3::z() * half_length.copysign(n.z),
                Shape::Cylinder { radius, half_length } => {
                    let flat = if i == 0 || i == rings { 0.0 } else { *radius };
                    Vector3::new(flat * c, flat * s, half_length.copysign(n.z))
                }
                Shape::Ellipsoid { radii } => n.component_mul(radii),
                _ => Vector3::zeros(),
            }));
        }
    }
    let mut faces = Vec::new();
    for i in 0..rings {
        for k in 0..around {
            let (a, b) = (i * around + k, i * around + (k + 1) % around);
            faces.push([a, b, b + around]);
            faces.push([a, b + around, a + around]);
        }
    }
    (points, faces)
}
