//! The rules for files and assets: `cargo run --release -p drex-mesh --example check PATH...` (a mesh file, an MJCF file or
//! an asset folder each).
#![allow(clippy::print_stdout)] // a program

use std::path::Path;
use std::time::Instant;

use drex_mesh::{CheckOptions, check_asset, check_file};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let options = CheckOptions::default();
    for path in std::env::args().skip(1) {
        let start = Instant::now();
        let at = Path::new(&path);
        let asset = at.is_dir() || path.ends_with(".xml");
        let report = if asset { check_asset(at, &options)? } else { check_file(at, &options)? };
        println!("{report}\n{:.2} s\n", start.elapsed().as_secs_f64());
    }
    Ok(())
}
