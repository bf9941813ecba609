//! Casts depth maps of the shapes in a folder from the cameras of its `views.json`, fuses them and scores the meshes:
//!
//! ```text
//! RAYON_NUM_THREADS=1 cargo run --release -p drex-mesh --example fuse_views -- FOLDER
//!     [--shapes mug,box] [--noise-mm 0,1] [--seed 0] [--voxel-mm 1.5 | auto] [--sharp] [--rounds 5] [--step]
//!     [--write-views OUT] [--write-meshes OUT]
//! ```
//!
//! Prints one JSON object per shape and noise. `--step` waits for a line on standard input before each round, so that
//! another program can take turns; `--write-views` writes the depth maps (float32, row by row) for it.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::path::{Path, PathBuf};
use std::time::Instant;

use drex_core::pose::pose_from_matrix;
use drex_mesh::{
    CompareOptions, DepthCamera, DepthMap, Fused, FusionOptions, cast_depth, compare_surfaces, fuse, write_ply,
};
use nalgebra::Matrix4;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = PathBuf::from(arguments.first().ok_or("usage: fuse_views FOLDER [options], see the source")?);
    let value = |name: &str| arguments.iter().position(|a| a == name).and_then(|i| arguments.get(i + 1)).cloned();
    let flag = |name: &str| arguments.iter().any(|a| a == name);
    let views: Value = serde_json::from_slice(&std::fs::read(folder.join("views.json"))?)?;
    let shapes = value("--shapes").unwrap_or_else(|| "mug,bottle,bracket,box".into());
    let noise = value("--noise-mm").unwrap_or_else(|| "0,1".into());
    let seed: u64 = value("--seed").map_or(Ok(0), |s| s.parse())?;
    let rounds: usize = value("--rounds").map_or(Ok(1), |s| s.parse())?;
    let mut options = FusionOptions::default();
    options.background_is_empty = true;
    options.sharp_edges = flag("--sharp");
    options.voxel_m = match value("--voxel-mm").as_deref() {
        Some("auto") => None,
        Some(mm) => Some(mm.parse::<f64>()? * 1e-3),
        None => Some(1.5e-3),
    };
    for shape in shapes.split(',') {
        let truth = drex_core::TriMesh::read(&folder.join(format!("{shape}.obj")))?;
        let exact = cast(&truth, &views, shape)?;
        for mm in noise.split(',') {
            let sigma: f64 = mm.parse::<f64>()? * 1e-3;
            let maps = noisy(&exact, sigma, seed);
            let name = format!("{shape}_{mm}mm");
            if let Some(out) = value("--write-views") {
                write_views(&maps, &Path::new(&out).join(&name))?;
            }
            let base = memory("VmRSS:");
            let mut seconds = Vec::new();
            let mut fused = None;
            for _ in 0..rounds {
                if flag("--step") {
                    std::io::stdin().read_line(&mut String::new())?;
                }
                let start = Instant::now();
                fused = Some(fuse(&maps, &options)?);
                seconds.push(start.elapsed().as_secs_f64());
                if flag("--step") {
                    println!("{}", json!({ "round_s": seconds.last() }));
                }
            }
            let Some(Fused { mesh, report, .. }) = fused else { continue };
            let peak = memory("VmHWM:");
            let score = compare_surfaces(&mesh, &truth, &CompareOptions::default())?;
            let exact_volume = truth.mass_properties(1.0)?.mass_kg;
            seconds.sort_by(f64::total_cmp);
            let f: Vec<f64> = score.f_score.iter().map(|f| f.1).collect();
            println!(
                "{}",
                json!({
                    "shape": shape, "noise_mm": sigma * 1e3, "f_05": f[0], "f_1": f[1], "f_2": f[2],
                    "chamfer_mm": score.chamfer_m * 1e3,
                    "volume_error_pct": 100.0 * (report.volume_m3 / exact_volume - 1.0),
                    "closed": drex_mesh::repair(&mesh, &Default::default())?.1.open_edges == 0,
                    "components": report.parts, "faces": mesh.faces.len(),
                    "seconds": seconds[seconds.len() / 2],
                    // The peak is that of the process: it counts for the first run only.
                    "memory_mb": peak.saturating_sub(base) as f64 / 1024.0,
                    "report": report,
                })
            );
            if let Some(out) = value("--write-meshes") {
                write_ply(&Path::new(&out).join(format!("{name}.ply")), &mesh)?;
            }
        }
    }
    Ok(())
}

fn cast(truth: &drex_core::TriMesh, views: &Value, shape: &str) -> Result<Vec<DepthMap>, Failure> {
    let number = |v: &Value| v.as_f64().ok_or("views.json: a number is missing");
    let k = |r: usize, c: usize| number(&views["K"][r][c]);
    let camera = DepthCamera {
        width_px: number(&views["width"])? as u32,
        height_px: number(&views["height"])? as u32,
        fx_px: k(0, 0)?,
        fy_px: k(1, 1)?,
        cx_px: k(0, 2)?,
        cy_px: k(1, 2)?,
    };
    let poses = views["shapes"][shape]["world_from_camera"].as_array().ok_or("views.json does not have the shape")?;
    poses
        .iter()
        .map(|rows| {
            let mut m = Matrix4::zeros();
            for r in 0..4 {
                for c in 0..4 {
                    m[(r, c)] = number(&rows[r][c])?;
                }
            }
            Ok(cast_depth(truth, &camera, &pose_from_matrix(&m)?))
        })
        .collect()
}

/// Independent normal noise on hit pixels (Box and Muller 1958).
fn noisy(maps: &[DepthMap], sigma_m: f64, seed: u64) -> Vec<DepthMap> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut maps = maps.to_vec();
    for z in maps.iter_mut().flat_map(|m| &mut m.depth_m).filter(|z| **z > 0.0) {
        let (a, b) = (1.0 - rng.random::<f64>(), rng.random::<f64>());
        *z += (sigma_m * (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()) as f32;
    }
    maps
}

fn write_views(maps: &[DepthMap], folder: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(folder)?;
    for (i, map) in maps.iter().enumerate() {
        let bytes: Vec<u8> = map.depth_m.iter().flat_map(|z| z.to_le_bytes()).collect();
        std::fs::write(folder.join(format!("{i:03}.f32")), bytes)?;
    }
    Ok(())
}

/// A line of /proc/self/status in kB; 0 where there is none.
fn memory(name: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix(name));
    line.and_then(|l| l.split_whitespace().next()).and_then(|kb| kb.parse().ok()).unwrap_or(0)
}
