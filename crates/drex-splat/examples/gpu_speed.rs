//! Iterations a second (forward and backward) of the processor and of the GPU, side by side, for the points of a capture:
//! `gpu_speed FOLDER [--side N] [--seconds N]`. Core-seconds tell what a GPU drawn in software costs.
#![allow(clippy::print_stdout)]

use std::path::Path;
use std::time::Instant;

use drex_core::camera::PinholeCamera;
use drex_core::capture::{Capture, CaptureOptions};
use drex_splat::raster::{Cpu, Gpu};
use drex_splat::train::from_points;
use drex_splat::{Gaussians, Kind, Rasterizer, RenderGradients, RenderOptions, Result, usage};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| arguments.iter().position(|a| a == name).and_then(|i| arguments.get(i + 1));
    let folder = arguments.first().ok_or("give a capture's folder")?;
    let side = value("--side").map(|v| v.parse()).transpose()?;
    let seconds: f64 = value("--seconds").map_or(Ok(5.0), |v| v.parse())?;

    let capture = Capture::load(Path::new(folder), &CaptureOptions::default())?;
    let cameras = (0..capture.views.len()).map(|v| Ok(capture.pinhole(v, side)?)).collect::<Result<Vec<_>>>()?;
    let (points, colours): (Vec<_>, Vec<_>) = capture.points.iter().map(|p| (p.position, p.rgb)).unzip();
    let gpu = Gpu::new()?;
    println!(
        "{} Gaussians, {} x {} pixels; milliseconds an iteration",
        points.len(),
        cameras[0].width,
        cameras[0].height
    );
    for kind in [Kind::Ellipsoid, Kind::Surfel] {
        let scene = from_points(&points, &colours, kind, 3, 0.1);
        println!(
            "{kind:?}, processor ({} threads): {}",
            rayon::current_num_threads(),
            measure(&Cpu, &scene, &cameras, seconds)?
        );
        println!("{kind:?}, {}: {}", gpu.adapter_name(), measure(&gpu, &scene, &cameras, seconds)?);
    }
    Ok(())
}

/// Repeats until the time is over, camera by camera.
fn measure<R: Rasterizer>(raster: &R, scene: &Gaussians, cameras: &[PinholeCamera], seconds: f64) -> Result<String> {
    let options = RenderOptions::default();
    let iteration = |camera: &PinholeCamera, backward: bool| -> Result<()> {
        let (render, saved) = raster.forward(scene, camera, &options)?;
        // A gradient of the size and the roughness of a photometric one.
        let scale = 1.0 / render.rgb.len() as f32;
        let rgb = render.rgb.iter().map(|c| c.map(|v| scale * (17.0 * v).sin())).collect();
        let gradients = RenderGradients { rgb, ..RenderGradients::default() };
        if backward {
            raster.backward(scene, camera, &options, &render, &saved, &gradients)?;
        }
        Ok(())
    };
    let mut text = Vec::new();
    for (name, backward) in [("forward", false), ("forward and backward", true)] {
        iteration(&cameras[0], backward)?;
        let (start, cpu) = (Instant::now(), usage::core_seconds().unwrap_or(f64::NAN));
        let mut calls = 0.0;
        for camera in cameras.iter().cycle() {
            iteration(camera, backward)?;
            calls += 1.0;
            if start.elapsed().as_secs_f64() > seconds {
                break;
            }
        }
        let (wall, cpu) = (start.elapsed().as_secs_f64(), usage::core_seconds().unwrap_or(f64::NAN) - cpu);
        text.push(format!(
            "{name} {:.1} core-ms, {:.1} ms wall, {:.1} it/s",
            1e3 * cpu / calls,
            1e3 * wall / calls,
            calls / wall
        ));
    }
    Ok(text.join("; "))
}
