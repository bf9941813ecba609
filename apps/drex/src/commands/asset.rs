//! `drex asset`: a mesh becomes a sim-ready asset.

use anyhow::Result;
use drex_mesh::{AssetOptions, build_asset};
use nalgebra::Vector3;

use crate::cli::AssetArgs;
use crate::ui::Ui;

/// Builds the asset, writes it, answers with its report.
pub fn run(args: &AssetArgs, ui: &Ui) -> Result<()> {
    let mut options = AssetOptions::default();
    options.unit = args.unit;
    options.up_in_mesh = args.up.map(Vector3::from);
    options.friction = args.friction;
    options.mass_kg = args.mass;
    let spinner = ui.spinner("asset");
    let asset = build_asset(&args.mesh, &options)?;
    asset.write(&args.out)?;
    spinner.finish_and_clear();
    let r = &asset.report;
    let p = &asset.properties;
    let mut text = format!(
        "{}\n  volume   {:.2} cm3 ({})\n  mass     {:.1} g{}\n  centre   {:.2}, {:.2}, {:.2} mm\n  pieces   {} convex\n",
        args.mesh.display(),
        1e6 * r.volume_m3,
        crate::report::closing_text(r),
        1e3 * p.mass_kg,
        if args.mass.is_some() { "" } else { " at 1000 kg/m3: give --mass for the real one" },
        1e3 * p.center_of_mass.x,
        1e3 * p.center_of_mass.y,
        1e3 * p.center_of_mass.z,
        asset.pieces.len()
    );
    for warning in &r.warnings {
        text += &format!("  note     {warning}\n");
    }
    text += &format!("  written  {}", args.out.join("asset").join("object.xml").display());
    ui.answer(r, text)
}
