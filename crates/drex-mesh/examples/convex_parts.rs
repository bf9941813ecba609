//! Convex pieces of a mesh and how far their union is from it, as one line of JSON:
//! `cargo run --release -p drex-mesh --example convex_parts -- FILE [--pieces N] [--out DIR] [--vhacd] [--score DIR]`.
//!
//! `--vhacd` uses parry's V-HACD in place of this crate's method, `--score DIR` measures the OBJ files in a folder.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::path::{Path, PathBuf};

use drex_core::mesh::convex_hull;
use drex_core::{ConvexPart, TriMesh};
use drex_mesh::{PartitionOptions, convex_parts, read_mesh, repair, union_distance, write_obj};
use nalgebra::Point3;
use parry3d_f64::math::Vector;
use parry3d_f64::transformation::vhacd::{VHACD, VHACDParameters};

type Any<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Any<()> {
    let mut arguments = std::env::args().skip(1);
    let (mut file, mut out, mut score, mut vhacd, mut samples) = (None, None, None, false, 100_000);
    let mut options = PartitionOptions::default();
    while let Some(a) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{a} needs a value"));
        match a.as_str() {
            "--pieces" => options.most_parts = value()?.parse()?,
            "--corners" => options.most_corners = value()?.parse()?,
            "--concavity" => options.concavity = value()?.parse()?,
            "--out" => out = Some(PathBuf::from(value()?)),
            "--score" => score = Some(PathBuf::from(value()?)),
            "--samples" => samples = value()?.parse()?,
            "--vhacd" => vhacd = true,
            _ => file = Some(PathBuf::from(a)),
        }
    }
    let file =
        file.ok_or("usage: convex_parts FILE [--pieces N] [--concavity SHARE] [--out DIR] [--vhacd] [--score DIR]")?;
    let (mesh, _) = repair(&read_mesh(&file)?, &Default::default())?;
    let start = cpu_seconds();
    let pieces = match &score {
        Some(folder) => read_folder(folder)?,
        None if vhacd => parry(&mesh, options.most_parts as u32),
        None => convex_parts(&mesh, &options)?,
    };
    let seconds = cpu_seconds() - start;
    if let Some(out) = out {
        std::fs::create_dir_all(&out)?;
        for (k, piece) in pieces.iter().enumerate() {
            write_obj(&out.join(format!("piece_{k:03}.obj")), &piece.hull)?;
        }
    }
    let d = union_distance(&mesh, &pieces, samples, 1)?;
    let round = |v: f64| (v * 1e4).round() / 1e4;
    let line = serde_json::json!({
        "file": file.file_name().map(|n| n.to_string_lossy().into_owned()),
        "pieces": pieces.len(),
        "most_corners": pieces.iter().map(|p| p.corners().len()).max(),
        "mean_mm": round(1e3 * d.mean_m),
        "p99_mm": round(1e3 * d.p99_m),
        "max_mm": round(1e3 * d.max_m),
        "uncovered_share": round(d.uncovered_share),
        "volume_ratio": round(d.volume_ratio),
        "cpu_s": round(seconds),
    });
    println!("{line}");
    Ok(())
}

/// CPU seconds of this process so far (0 where the system does not tell).
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |k: usize| fields.get(k).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

fn read_folder(folder: &Path) -> Any<Vec<ConvexPart>> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)?.map(|e| e.map(|e| e.path())).collect::<Result<_, _>>()?;
    files.sort();
    let obj = files.iter().filter(|f| f.extension().is_some_and(|e| e == "obj"));
    Ok(obj.map(|f| read_mesh(f).map(ConvexPart::of_hull)).collect::<Result<_, _>>()?)
}

/// parry's V-HACD with its defaults.
fn parry(mesh: &TriMesh, most: u32) -> Vec<ConvexPart> {
    let points: Vec<Vector> = mesh.vertices.iter().map(|p| Vector::new(p.x, p.y, p.z)).collect();
    let parameters = VHACDParameters { resolution: 64, max_convex_hulls: most, ..VHACDParameters::default() };
    let found = VHACD::decompose(&parameters, &points, &mesh.faces, true);
    let hull = |part: &Vec<Vector>| {
        let points: Vec<_> = part.iter().map(|v| Point3::new(v.x, v.y, v.z)).collect();
        convex_hull(&points).ok().map(ConvexPart::of_hull)
    };
    found.compute_primitive_intersections(&points, &mesh.faces).iter().filter_map(hull).collect()
}
