//! Is this ready for a simulator, and does it agree with its scan? 23 rules, each with a verdict, a reason and a remedy.

mod asset;
mod hulls;
mod mjcf;
mod rules;
mod scan;

use std::fmt;
use std::path::Path;

use serde::Serialize;

use drex_core::TriMesh;

pub use self::asset::check_asset;
pub use self::scan::{ScanCamera, ScanEvidence, Silhouette, SupportEvidence, check_scan};
use crate::io::extension;
use crate::{AssetOptions, LengthUnit, Result, read_mesh, read_model};

/// Settings of [`check_mesh`], [`check_file`] and [`check_asset`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct CheckOptions {
    /// How an asset would be made of the mesh: unit, mass or density, up, repair and convex parts.
    pub asset: AssetOptions,
    /// Corners that a hull may have.
    pub most_corners: usize,
    /// Hulls that an object may have.
    pub most_parts: usize,
    /// Distance between hulls and visual mesh that 99 % of the surface must keep, relative to the diagonal of the bounding box.
    pub hull_distance: f64,
    /// Faces that a mesh may have (MuJoCo reads STL files up to 200,000).
    pub most_faces: usize,
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self {
            asset: AssetOptions::default(),
            most_corners: 64,
            most_parts: 64,
            hull_distance: 0.03,
            most_faces: 200_000,
        }
    }
}

/// What became of a rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Outcome {
    /// It holds.
    Pass,
    /// It does not hold in the file, but is made to hold (or made harmless) when an asset is made of it.
    Repaired,
    /// It holds so poorly that a person should look.
    Doubt,
    /// It does not hold.
    Fail,
    /// It cannot be asked of this file, or an earlier failure leaves nothing to ask it of.
    NotApplicable,
}

/// One rule's verdict.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RuleResult {
    /// 1 to 23.
    pub number: u8,
    /// What the rule asks for.
    pub name: &'static str,
    /// Its verdict.
    pub outcome: Outcome,
    /// What was found.
    pub reason: String,
    /// What to do, if something is to be done.
    pub fix: Option<String>,
}

/// The verdicts on all rules, in order: 1 to 17 of the mesh, 18 to 23 of what its scan says of it. `Display` makes a table of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CheckReport {
    /// The file, or "the mesh".
    pub subject: String,
    /// One result per rule.
    pub rules: Vec<RuleResult>,
}

/// What the rules ask for, rule 1 first.
const NAMES: [&str; 23] = [
    "closed",
    "wound outwards",
    "manifold, no degenerate or duplicate faces",
    "one component",
    "no cavities or double skins",
    "no self-intersections",
    "inertia physical, centre of mass inside",
    "mass plausible and stated",
    "scale plausible",
    "up axis and origin stated",
    "right-handed",
    "hulls convex and small",
    "hulls follow the visual mesh",
    "rests on a plane",
    "paths and textures",
    "face counts and names",
    "hulls cover the mesh",
    "support fits its points",
    "cameras above the support",
    "inside its region",
    "seen by the photos",
    "inside the visual hull of the masks",
    "silhouettes agree with the masks",
];
/// The first rule that asks a scan.
const FIRST_OF_SCAN: usize = 18;

impl CheckReport {
    fn new(subject: impl Into<String>) -> Self {
        let rule = |(i, &name)| RuleResult {
            number: i as u8 + 1,
            name,
            outcome: Outcome::NotApplicable,
            reason: if i + 1 < FIRST_OF_SCAN { "an earlier rule failed" } else { "there is no scan to ask" }.into(),
            fix: None,
        };
        Self { subject: subject.into(), rules: NAMES.iter().enumerate().map(rule).collect() }
    }

    fn set(&mut self, number: usize, outcome: Outcome, reason: impl Into<String>, fix: Option<&str>) {
        let rule = &mut self.rules[number - 1];
        (rule.outcome, rule.reason, rule.fix) = (outcome, reason.into(), fix.map(Into::into));
    }

    /// Whether no rule failed.
    pub fn passed(&self) -> bool {
        self.rules.iter().all(|r| r.outcome != Outcome::Fail)
    }

    /// The result of rule `number`, 1 to 23.
    pub fn rule(&self, number: usize) -> Option<&RuleResult> {
        self.rules.get(number.checked_sub(1)?)
    }
}

impl fmt::Display for CheckReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.subject)?;
        let asked = |r: &&RuleResult| usize::from(r.number) < FIRST_OF_SCAN || r.outcome != Outcome::NotApplicable;
        for r in self.rules.iter().filter(asked) {
            let outcome = match r.outcome {
                Outcome::Pass => "pass",
                Outcome::Repaired => "repaired",
                Outcome::Doubt => "DOUBT",
                Outcome::Fail => "FAIL",
                Outcome::NotApplicable => "-",
            };
            writeln!(f, "{:>2}  {:<42}  {outcome:<8}  {}", r.number, r.name, r.reason)?;
            if let Some(fix) = &r.fix {
                writeln!(f, "{:58}-> {fix}", "")?;
            }
        }
        let count = |outcome| self.rules.iter().filter(|r| r.outcome == outcome).count();
        let (failed, repaired) = (count(Outcome::Fail), count(Outcome::Repaired));
        let asked = self.rules.len() - count(Outcome::NotApplicable);
        match failed {
            0 => write!(f, "ready for simulation, {repaired} of {asked} rules by repair")?,
            n => write!(f, "not ready: {n} of {asked} rules fail, {repaired} are repaired")?,
        }
        match count(Outcome::Doubt) {
            0 => Ok(()),
            n => write!(f, ", {n} in doubt"),
        }
    }
}

/// Judges a mesh as what an asset made of it would be: repaired, closed, divided into convex parts, stood on a plane.
///
/// Rule 14 is judged by statics: the centre of mass over the support polygon of the pieces in the pose at rest. A simulator can
/// be asked with `tests/peers/mujoco_rest.py`.
pub fn check_mesh(mesh: &TriMesh, options: &CheckOptions) -> CheckReport {
    let mut report = CheckReport::new("the mesh");
    rules::evaluate_mesh(mesh, options, &mut report);
    report
}

/// As [`check_mesh`], from a file, whose textures are looked at too.
///
/// # Errors
/// If the file cannot be read or is damaged.
pub fn check_file(path: &Path, options: &CheckOptions) -> Result<CheckReport> {
    let mesh = read_mesh(path)?;
    let mut options = options.clone();
    let mut report = CheckReport::new(path.display().to_string());
    let gltf = matches!(extension(path).as_str(), "gltf" | "glb");
    if gltf {
        options.asset.up_in_mesh = options.asset.up_in_mesh.or(Some(nalgebra::Vector3::y()));
        if options.asset.unit == LengthUnit::Auto {
            options.asset.unit = LengthUnit::Metre;
        }
    }
    rules::evaluate_mesh(&mesh, &options, &mut report);
    match read_model(path) {
        Ok(model) => {
            let textured = model.parts.iter().filter(|p| p.uv.is_some()).count();
            let pictures = model.materials.iter().filter(|m| m.texture.is_some()).count();
            if textured > 0 || pictures > 0 {
                let reason = format!("{textured} parts with texture coordinates, {pictures} pictures, all readable");
                report.set(15, Outcome::Pass, reason, None);
            }
        }
        Err(e) => report.set(15, Outcome::Fail, e.to_string(), Some("repair the materials of the file")),
    }
    Ok(report)
}
