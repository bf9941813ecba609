//! Fuses depth maps in the files of a folder and writes the mesh:
//!
//! ```text
//! RAYON_NUM_THREADS=1 cargo run --release -p drex-mesh --example fuse_maps -- FOLDER OUT.ply [--rounds 5] [--step]
//! ```
//!
//! FOLDER/maps.json: `voxel_m`; `region_m`, two corners, and `support`, its `point_m` and `up`, or null; `empty_votes`;
//! `least_views_share`; `views` of `width`, `height`, `fx`, `fy`, `cx`, `cy` and `world_from_camera` (4 x 4, OpenCV axes, metres), one for
//! each 000.f32, 001.f32, ... (float32, row by row, metres, 0 where nothing is known). With 000.u8, ... these are silhouettes, 0 outside; with
//! 000.trust.f32, ... those say how far each depth is to be trusted.
//!
//! Prints one JSON object: seconds and the report. `--step` waits for a line on standard input before each round, so that another program can
//! take turns.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::path::Path;
use std::time::Instant;

use drex_core::pose::pose_from_matrix;
use drex_mesh::{DepthCamera, DepthMap, Fused, FusionOptions, Support, fuse, write_ply};
use nalgebra::{Matrix4, Point3, Unit, Vector3};
use serde::Deserialize;
use serde_json::json;

type Failure = Box<dyn std::error::Error>;

#[derive(Deserialize)]
struct Maps {
    voxel_m: Option<f64>,
    region_m: Option<[[f64; 3]; 2]>,
    support: Option<Table>,
    empty_votes: f64,
    least_views_share: f64,
    views: Vec<View>,
}

#[derive(Deserialize)]
struct Table {
    point_m: [f64; 3],
    up: [f64; 3],
}

#[derive(Deserialize)]
struct View {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    world_from_camera: [[f64; 4]; 4],
}

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, out, ..] = arguments.as_slice() else { return Err("FOLDER OUT.ply [--rounds N] [--step]".into()) };
    let rounds = arguments.iter().position(|a| a == "--rounds").and_then(|i| arguments.get(i + 1));
    let rounds: usize = rounds.map_or(Ok(1), |n| n.parse())?;
    let step = arguments.iter().any(|a| a == "--step");
    let given: Maps = serde_json::from_slice(&std::fs::read(Path::new(folder).join("maps.json"))?)?;
    let maps = given.views.iter().enumerate().map(|(i, view)| read(Path::new(folder), i, view));
    let maps: Vec<DepthMap> = maps.collect::<Result<_, _>>()?;
    let mut options = FusionOptions::default();
    options.voxel_m = given.voxel_m;
    options.background_is_empty = maps.iter().all(|map| map.mask.is_some());
    options.region = given.region_m.map(|[lo, hi]| (lo.into(), hi.into()));
    let support = |t: Table| Support { point: Point3::from(t.point_m), up: Unit::new_normalize(Vector3::from(t.up)) };
    options.support = given.support.map(support);
    (options.empty_votes, options.least_views_share) = (given.empty_votes, given.least_views_share);
    let mut seconds = Vec::new();
    let mut fused = None;
    for _ in 0..rounds {
        if step {
            std::io::stdin().read_line(&mut String::new())?;
        }
        let start = Instant::now();
        fused = Some(fuse(&maps, &options)?);
        seconds.push(start.elapsed().as_secs_f64());
        if step {
            println!("{}", json!({ "round_s": seconds.last() }));
        }
    }
    let Some(Fused { mesh, report, .. }) = fused else { return Err("--rounds 0 fuses nothing".into()) };
    write_ply(Path::new(out), &mesh)?;
    println!("{}", json!({ "seconds": seconds, "report": report }));
    Ok(())
}

fn read(folder: &Path, i: usize, view: &View) -> Result<DepthMap, Failure> {
    let numbers = |bytes: Vec<u8>| bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect::<Vec<_>>();
    let depth_m = numbers(std::fs::read(folder.join(format!("{i:03}.f32")))?);
    let trust = std::fs::read(folder.join(format!("{i:03}.trust.f32"))).ok().map(numbers);
    let mask = std::fs::read(folder.join(format!("{i:03}.u8"))).ok();
    let rows = view.world_from_camera;
    Ok(DepthMap {
        camera: DepthCamera {
            width_px: view.width,
            height_px: view.height,
            fx_px: view.fx,
            fy_px: view.fy,
            cx_px: view.cx,
            cy_px: view.cy,
        },
        world_from_camera: pose_from_matrix(&Matrix4::from_fn(|r, c| rows[r][c]))?,
        depth_m,
        mask: mask.map(|mask| mask.iter().map(|v| *v > 0).collect()),
        trust,
    })
}
