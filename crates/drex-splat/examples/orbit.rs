//! A ring of Gaussians, drawn from all round, written as pictures and as ply and spz for any viewer.
//!
//!     cargo run --release -p drex-splat --example orbit -- OUT [FRAMES]
//!
//! Then it checks one entry of the derivative by a finite difference: how the mean brightness of a frame changes with an opacity.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::f64::consts::TAU;
use std::path::PathBuf;

use drex_splat::io::{picture, ply, spz};
use drex_splat::{Cpu, Gaussians, Kind, Orbit, Rasterizer, RenderGradients, RenderOptions, Result, train::from_points};
use nalgebra::Vector3;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let Some(out) = arguments.next().map(PathBuf::from) else {
        eprintln!("usage: orbit OUT [FRAMES]");
        std::process::exit(2);
    };
    let frames = arguments.next().and_then(|n| n.parse().ok()).unwrap_or(12);

    let set = ring(200);
    let mut options = RenderOptions::default();
    options.sh_degree = set.sh_degree;
    let cameras = Orbit::round(&set, Vector3::z(), 0.5, 0.9, 320, 240)?.cameras(frames)?;
    for (k, camera) in cameras.iter().enumerate() {
        let (render, _) = Cpu.forward(&set, camera, &options)?;
        picture::write_rgb(&out.join(format!("{k:03}.png")), render.width, render.height, &render.rgb)?;
    }
    ply::write(&out.join("ring.ply"), &set)?;
    spz::write(&out.join("ring.spz"), &set, spz::Version::V3)?;
    println!("{} Gaussians, {frames} frames, ring.ply and ring.spz in {}", set.len(), out.display());

    let Some(camera) = cameras.first() else { return Ok(()) };
    // A Gaussian is cut off where it covers less than 1/255, a step that no derivative sees but differences do: fade it out instead.
    options.smooth_cutoff = true;
    let brightness = |set: &Gaussians| -> Result<f64> {
        let (render, _) = Cpu.forward(set, camera, &options)?;
        Ok(render.rgb.as_flattened().iter().map(|&v| f64::from(v)).sum::<f64>() / (3 * render.rgb.len()) as f64)
    };
    let (render, saved) = Cpu.forward(&set, camera, &options)?;
    let each = 1.0 / (3 * render.rgb.len()) as f32;
    let by_picture = RenderGradients { rgb: vec![[each; 3]; render.rgb.len()], ..Default::default() };
    let exact = Cpu.backward(&set, camera, &options, &render, &saved, &by_picture)?.logit_opacities;
    let k = (0..set.len()).max_by(|&a, &b| exact[a].abs().total_cmp(&exact[b].abs())).unwrap_or(0);
    let nudged = |by: f32| {
        let mut set = set.clone();
        set.logit_opacities[k] += by;
        brightness(&set)
    };
    let differences = (nudged(0.05)? - nudged(-0.05)?) / 0.1;
    println!("brightness by the opacity of Gaussian {k}: {:.4e}, by finite differences {differences:.4e}", exact[k]);
    Ok(())
}

/// Gaussians of changing colour along a ring of 10 cm radius.
fn ring(n: usize) -> Gaussians {
    let angle = |k: usize| TAU * k as f64 / n as f64;
    let point = |a: f64| [0.1 * a.cos(), 0.1 * a.sin(), 0.02 * (3.0 * a).sin()];
    let colour = |a: f64| [0.0, TAU / 3.0, 2.0 * TAU / 3.0].map(|phase| (127.5 * (1.0 + (a + phase).cos())) as u8);
    let points: Vec<_> = (0..n).map(|k| point(angle(k))).collect();
    let colours: Vec<_> = (0..n).map(|k| colour(angle(k))).collect();
    from_points(&points, &colours, Kind::Ellipsoid, 0, 0.8)
}
