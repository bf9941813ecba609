//! Makes an asset of a mesh file: `cargo run -p drex-mesh --example asset -- MESH OUT [MASS_KG]`.
#![allow(clippy::print_stdout)] // an example talks to a person

use std::path::Path;
use std::time::Instant;

use drex_mesh::{AssetOptions, build_asset};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [mesh, out, mass @ ..] = &arguments[..] else {
        return Err("usage: asset MESH OUT [MASS_KG]".into());
    };
    let mut options = AssetOptions::default();
    options.mass_kg = mass.first().map(|m| m.parse()).transpose()?;
    let start = Instant::now();
    let asset = build_asset(Path::new(mesh), &options)?;
    asset.write(Path::new(out))?;
    println!("{}", serde_json::to_string_pretty(&asset.report)?);
    println!("{:.2} s", start.elapsed().as_secs_f64());
    Ok(())
}
