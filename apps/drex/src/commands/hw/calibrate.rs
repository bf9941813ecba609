//! `drex hw calibrate`: the law of current and torque from measured pairs.

use anyhow::{Context, Result, bail};
use drex_core::fsutil;
use drex_hw::torque_current::{Approach, Sample, fit};

use crate::cli::CalibrateArgs;
use crate::ui::Ui;

/// Reads, fits, writes.
pub fn run(args: &CalibrateArgs, ui: &Ui) -> Result<()> {
    let text = fsutil::read_text(&args.pairs)?;
    let samples = pairs(&text, args.lever).with_context(|| format!("cannot use {}", args.pairs.display()))?;
    let law = fit(&samples, args.source.clone(), args.date.clone())?;
    fsutil::write_atomic(&args.out, &serde_json::to_vec_pretty(&law)?)?;
    let p = law.provenance();
    let milli = |nm: Option<f64>| nm.map_or_else(|| "-".into(), |v| format!("{:.1}", 1e3 * v));
    let answer = format!(
        "{:?}\n  pairs     {}\n  residual  {} mN m, {} mN m on pairs that the fit has not seen\n  written   {}",
        law.curve(),
        p.pairs,
        milli(p.residual_nm),
        milli(p.cross_validated_nm),
        args.out.display()
    );
    ui.answer(&serde_json::json!({ "law": law, "out": args.out }), answer)
}

/// Pairs of a table with a head.
fn pairs(text: &str, lever_m: Option<f64>) -> Result<Vec<Sample>> {
    let mut lines = text.lines().map(str::trim).enumerate().filter(|(_, l)| !l.is_empty() && !l.starts_with('#'));
    let (_, head) = lines.next().context("the file is empty")?;
    let head: Vec<&str> = head.split(',').map(str::trim).collect();
    let find = |name: &str| head.iter().position(|h| *h == name);
    let current = find("current_ma").context(
        "there is no column current_ma; the first line names the columns: current_ma,torque_nm or current_ma,force_n",
    )?;
    let (load, lever_m) = match (find("torque_nm"), find("force_n"), lever_m) {
        (Some(torque), _, _) => (torque, None),
        (None, Some(force), Some(lever)) => (force, Some(lever)),
        (None, Some(_), None) => bail!("a column of forces needs the lever arm: --lever M"),
        (None, None, _) => bail!("there is neither a column torque_nm nor force_n; add the one that was measured"),
    };
    let approach = find("approach");
    lines
        .map(|(number, line)| {
            let fields: Vec<&str> = line.split(',').map(str::trim).collect();
            let number = |column: usize| -> Result<f64> {
                let field = fields.get(column).with_context(|| format!("line {} has too few columns", number + 1))?;
                field.parse().with_context(|| format!("line {}: \"{field}\" is no number", number + 1))
            };
            let (current_ma, load) = (number(current)?, number(load)?);
            let sample = match lever_m {
                Some(lever) => Sample::from_force(current_ma, load, lever),
                None => Sample::from_torque(current_ma, load),
            };
            Ok(sample.with_approach(match approach.and_then(|c| fields.get(c)).copied() {
                Some("loading") => Approach::Loading,
                Some("unloading") => Approach::Unloading,
                Some("") | None => Approach::Unknown,
                Some(other) => bail!("approach \"{other}\" is neither loading nor unloading"),
            }))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forces_need_a_lever_and_lines_are_named() {
        let forces = "current_ma,force_n,approach\n100,1.0,loading\n\n200,2.0,\n";
        let samples = pairs(forces, Some(0.05)).unwrap();
        assert_eq!(samples[1], Sample::from_force(200.0, 2.0, 0.05));
        assert_eq!(samples[0].approach, Approach::Loading);
        assert!(pairs(forces, None).unwrap_err().to_string().contains("--lever"));
        let bad = "current_ma,torque_nm\n100,x\n";
        assert!(format!("{:#}", pairs(bad, None).unwrap_err()).contains("line 2: \"x\""));
    }
}
