//! The objects of the bench, made here of a few numbers, or read from a list.
//!
//! Masses are those that the paper gives. Sizes are ours where the paper gives none: ordinary goods of that mass.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use drex_core::{TriMesh, fsutil};
use drex_mesh::{AssetOptions, LengthUnit, metric_mesh};
use nalgebra::Vector3;
use serde::Deserialize;

use super::shapes::{extrusion, flat_side, lathe, loft, rounded_box};

/// Thickness of the letters, metres.
const LETTER_M: f64 = 0.045;
/// Objects heavier than this are no objects for a hand, kg.
const HEAVIEST_KG: f64 = 20.0;

/// An object, before anything was computed of it.
#[derive(Debug, Clone)]
pub struct ObjectSpec {
    /// Its name, which files are called by.
    pub name: String,
    /// Closed, metres.
    pub mesh: TriMesh,
    pub mass_kg: f64,
    /// Friction between hand and object where it is known; the protocol's spread where not.
    pub friction: Option<f64>,
    /// Largest normal force of a finger before it is damaged, N, which the hand is told.
    pub max_force_n: Option<f64>,
    /// The same where nobody tells the hand.
    pub damaged_at_n: Option<f64>,
    /// Up in the mesh while it stands; `None`: in its most probable resting pose.
    pub up: Option<Vector3<f64>>,
}

/// Things whose limit somebody has stated: name, largest normal force of a fingertip in N, mass in kg.
///
/// Expanded polystyrene stays elastic up to 1 % strain, at 40, 50 and 75 kPa for the types EPS19, EPS22 and EPS29 (ASTM D6817, table 1), here on the pad of a
/// fingertip, 1 cm². 10 N of a fingertip "can crack an egg or crush a soda can" (ROS, `pr2_gripper_sensor_msgs/PR2GripperForceServoCommand`).
///
/// The mass is the one at which the limit is [`damaged_by_half_as_much_again`] for an even pinch; a hand that presses otherwise is given another.
const FRAGILE: [(&str, f64, f64); 4] = [
    ("foam_letter_a", 4.0, 0.144),
    ("foam_letter_u", 5.0, 0.180),
    ("foam_letter_y", 7.5, 0.270),
    ("soda_can", 10.0, 0.360),
];
/// The mass in kg of something that stands `limit_n` on each side: a grip of `per_weight` weights in all, half of it on each side, and half a weight of a shake
/// that is added on one of them, stay below the limit by as large a factor as a grip for half as much again is above it.
pub fn damaged_by_half_as_much_again(limit_n: f64, per_weight: f64) -> f64 {
    let pressed = |factor: f64| 0.5 * factor * per_weight + 0.5;
    limit_n / (9.81 * (pressed(1.0) * pressed(1.5)).sqrt())
}

/// Friction of fragile things: the middle of the protocol's spread, as for the letters of `cross-mass`.
pub const FRAGILE_FRICTION: f64 = 0.55;

/// The fragile things.
pub fn fragile() -> Result<Vec<ObjectSpec>> {
    FRAGILE.iter().map(|(name, ..)| named(name)).collect()
}

/// The eight objects of the paper's figure, lightest first.
pub fn eight() -> Result<Vec<ObjectSpec>> {
    ["light_bulb", "cube", "letter_a", "cookie_tin", "spam_can", "nutella_jar", "spray_bottle", "ketchup_bottle"]
        .into_iter()
        .map(named)
        .collect()
}

/// A made object.
///
/// # Errors
/// If there is none of that name.
pub fn named(name: &str) -> Result<ObjectSpec> {
    let z = Some(Vector3::z());
    let (mesh, mass_kg, up) = match name {
        // An A60 lamp; it lies, as lamps do.
        "light_bulb" => (
            lathe(&[
                [0.009, 0.0],
                [0.0135, 0.004],
                [0.0135, 0.028],
                [0.0165, 0.037],
                [0.024, 0.054],
                [0.0285, 0.068],
                [0.03, 0.080],
                [0.0285, 0.092],
                [0.024, 0.101],
                [0.015, 0.108],
                [0.005, 0.111],
            ]),
            0.037,
            None,
        ),
        "cube" => (rounded_box([0.057; 3], 0.002)?, 0.120, z),
        "letter_a" => (letter_a()?, 0.134, z),
        "letter_u" => (letter_u()?, 0.125, z),
        "letter_y" => (letter_y()?, 0.206, z),
        // A flat tin.
        "cookie_tin" => (lathe(&[[0.0425, 0.0], [0.0425, 0.034]]), 0.210, z),
        // Half a litre of meat: 102 x 60 x 84 mm.
        "spam_can" => (rounded_box([0.102, 0.060, 0.084], 0.012)?, 0.365, z),
        // A jar of 350 g with its glass: 80 mm wide with a lid of 66 mm. The can that stands in for it in open sets is 103 mm wide.
        "nutella_jar" => (lathe(&[[0.036, 0.0], [0.04, 0.006], [0.04, 0.066], [0.033, 0.078], [0.033, 0.1]]), 0.414, z),
        // A body of 90 x 58 mm, a neck of 28 mm and a head.
        "spray_bottle" => (
            loft(&[
                [0.042, 0.026, 0.0],
                [0.045, 0.029, 0.006],
                [0.045, 0.029, 0.120],
                [0.030, 0.022, 0.160],
                [0.014, 0.014, 0.175],
                [0.014, 0.014, 0.195],
                [0.040, 0.014, 0.205],
                [0.040, 0.014, 0.235],
            ]),
            0.548,
            z,
        ),
        "ketchup_bottle" => (
            loft(&[
                [0.045, 0.030, 0.0],
                [0.0485, 0.0335, 0.010],
                [0.0485, 0.0335, 0.100],
                [0.038, 0.028, 0.140],
                [0.018, 0.018, 0.160],
                [0.018, 0.018, 0.190],
            ]),
            0.726,
            z,
        ),
        "foam_letter_a" => (letter_a()?, 0.0, z),
        "foam_letter_u" => (letter_u()?, 0.0, z),
        "foam_letter_y" => (letter_y()?, 0.0, z),
        // 330 ml: 66 mm wide, 115 mm high, a lid of 54 mm.
        "soda_can" => (lathe(&[[0.025, 0.0], [0.033, 0.009], [0.033, 0.100], [0.027, 0.115]]), 0.0, z),
        "screwdriver" => (screwdriver(1.0), 0.097, Some(flat_side())),
        "small_screwdriver" => (screwdriver(0.75), 0.041, Some(flat_side())),
        _ => bail!(
            "there is no made object \"{name}\"; there are light_bulb, cube, letter_a, letter_u, letter_y, cookie_tin, spam_can, \
             nutella_jar, spray_bottle, ketchup_bottle, foam_letter_a, foam_letter_u, foam_letter_y, soda_can, screwdriver and small_screwdriver"
        ),
    };
    let spec =
        ObjectSpec { name: name.to_owned(), mesh, mass_kg, friction: None, max_force_n: None, damaged_at_n: None, up };
    Ok(match FRAGILE.iter().find(|(fragile, ..)| *fragile == name) {
        Some(&(_, limit_n, mass_kg)) => {
            ObjectSpec { mass_kg, friction: Some(FRAGILE_FRICTION), damaged_at_n: Some(limit_n), ..spec }
        }
        None => spec,
    })
}

impl ObjectSpec {
    /// How its asset is made.
    pub fn asset_options(&self) -> AssetOptions {
        let mut options = AssetOptions::default();
        (options.mass_kg, options.up_in_mesh, options.unit) = (Some(self.mass_kg), self.up, LengthUnit::Metre);
        options.partition.most_corners = CORNERS;
        options
    }
}

/// Corners of a convex piece: what is round has to be round for fingers, whose hold depends on the normals. A jar of 64 corners has walls up to
/// 20 degrees apart.
const CORNERS: usize = 256;

/// Strokes of 20 mm: two legs, a bar and a triangle above it.
fn letter_a() -> Result<TriMesh> {
    let (w, h, stroke) = (0.0445_f64, 0.0486, 0.020);
    // Width of a leg along x: its edges run from the foot (w, -h) to the top (0.012, h).
    let slope = (w - 0.012) / (2.0 * h);
    let leg = stroke * (1.0 + slope * slope).sqrt();
    let inner = |y: f64| w - leg - slope * (y + h);
    let (low, high) = (-0.018, 0.002);
    let apex = (w - leg) / slope - h;
    let outline = [
        [-w, -h],
        [leg - w, -h],
        [-inner(low), low],
        [inner(low), low],
        [w - leg, -h],
        [w, -h],
        [0.012, h],
        [-0.012, h],
    ];
    let hole = [[-inner(high), high], [0.0, apex], [inner(high), high]];
    extrusion(&outline, &hole, LETTER_M)
}

/// 80 x 90 mm, strokes of 20 mm.
fn letter_u() -> Result<TriMesh> {
    let (w, h, s) = (0.04, 0.045, 0.020);
    let outline = [[-w, -h], [w, -h], [w, h], [w - s, h], [w - s, s - h], [s - w, s - h], [s - w, h], [-w, h]];
    extrusion(&outline, &[], LETTER_M)
}

/// A foot and two arms at 40 degrees from upright, strokes of 20 mm.
fn letter_y() -> Result<TriMesh> {
    let (half, foot, top) = (0.010, -0.045, 0.045_f64);
    let (sin, cos) = 40.0_f64.to_radians().sin_cos();
    // The fork is at the origin; the arms' outer edges meet the foot's sides, the inner ones meet above.
    let reach = |y: f64, side: f64| (y * sin + side * half) / cos;
    let fork = half / sin;
    let knee = (half * cos - half) / sin;
    let outline = [
        [-half, foot],
        [half, foot],
        [half, knee],
        [reach(top, 1.0), top],
        [reach(top, -1.0), top],
        [0.0, fork],
        [-reach(top, -1.0), top],
        [-reach(top, 1.0), top],
        [-half, knee],
    ];
    extrusion(&outline, &[], LETTER_M)
}

/// A handle of 33 mm and 105 mm, a blade of 8 mm and 90 mm.
fn screwdriver(size: f64) -> TriMesh {
    let profile: [[f64; 2]; 8] = [
        [0.010, 0.0],
        [0.015, 0.005],
        [0.0165, 0.030],
        [0.0145, 0.070],
        [0.0165, 0.090],
        [0.010, 0.105],
        [0.004, 0.108],
        [0.004, 0.195],
    ];
    lathe(&profile.map(|p| p.map(|v| v * size)))
}

/// A list of objects: `[[object]]` with `name`, `mesh`, `mass_kg` and perhaps `friction`, `max_force_n`, `damaged_at_n`, `up`,
/// `unit`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    #[serde(default)]
    object: Vec<Entry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: String,
    mesh: PathBuf,
    mass_kg: f64,
    friction: Option<f64>,
    max_force_n: Option<f64>,
    damaged_at_n: Option<f64>,
    up: Option<[f64; 3]>,
    unit: Option<String>,
}

/// The objects of a TOML file; meshes are relative to it.
///
/// # Errors
/// If the file or a mesh cannot be read, a name is no file name or appears twice, or a number is out of range.
pub fn read(path: &Path) -> Result<Vec<ObjectSpec>> {
    let list: List = fsutil::from_toml(path, &fsutil::read_text(path)?)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    if list.object.is_empty() {
        bail!("{} lists no object: add [[object]] with name, mesh and mass_kg", path.display());
    }
    let mut objects: Vec<ObjectSpec> = Vec::new();
    for entry in list.object {
        let spec = entry.load(folder).with_context(|| format!("object \"{}\" of {}", entry.name, path.display()))?;
        if objects.iter().any(|o| o.name == spec.name) {
            bail!("{} lists the object \"{}\" twice: rename one", path.display(), spec.name);
        }
        objects.push(spec);
    }
    Ok(objects)
}

impl Entry {
    fn load(&self, folder: &Path) -> Result<ObjectSpec> {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if self.name.is_empty() || !self.name.chars().all(plain) {
            bail!("the name becomes a file name: use letters, digits, - and _");
        }
        if !(self.mass_kg > 0.0 && self.mass_kg <= HEAVIEST_KG) {
            bail!(
                "mass_kg = {} is no mass of something for a hand: give kilograms, at most {HEAVIEST_KG}",
                self.mass_kg
            );
        }
        let limits = [
            ("friction", self.friction, 5.0),
            ("max_force_n", self.max_force_n, 1e4),
            ("damaged_at_n", self.damaged_at_n, 1e4),
        ];
        for (key, value, most) in limits {
            if value.is_some_and(|v| !(v > 0.0 && v <= most)) {
                bail!("{key} = {} is out of range: give more than 0 and at most {most}", value.unwrap_or(f64::NAN));
            }
        }
        let up = self.up.map(Vector3::from);
        if up.is_some_and(|u| !(u.norm() > 1e-9)) {
            bail!("up has no length: give a direction such as [0, 0, 1]");
        }
        let unit: LengthUnit = self.unit.as_deref().unwrap_or("auto").parse()?;
        let (mesh, _) = metric_mesh(&folder.join(&self.mesh), unit)?;
        Ok(ObjectSpec {
            name: self.name.clone(),
            mesh,
            mass_kg: self.mass_kg,
            friction: self.friction,
            max_force_n: self.max_force_n,
            damaged_at_n: self.damaged_at_n,
            up: up.or(Some(Vector3::z())),
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use drex_mesh::solid_properties;

    #[test]
    fn made_objects_are_closed_and_of_the_sizes_told() {
        let all = ["letter_u", "letter_y", "screwdriver", "small_screwdriver"].map(|n| named(n).unwrap());
        let all = all.into_iter().chain(fragile().unwrap());
        let sizes = [
            ("letter_a", [0.089, 0.0972, 0.045]),
            ("letter_u", [0.080, 0.090, 0.045]),
            ("spam_can", [0.102, 0.060, 0.084]),
        ];
        for spec in eight().unwrap().into_iter().chain(all) {
            let solid = solid_properties(&spec.mesh).unwrap();
            assert_eq!(solid.open_edges, 0, "{}", spec.name);
            // Between foam and solid metal... of goods: 30 to 3000 kg/m³.
            let density = spec.mass_kg / solid.volume_m3;
            assert!((30.0..3000.0).contains(&density), "{}: {density:.0} kg/m³", spec.name);
            if let Some((_, size)) = sizes.iter().find(|s| s.0 == spec.name) {
                let (lo, hi) = spec.mesh.bounds().unwrap();
                assert!(((hi - lo) - Vector3::from(*size)).norm() < 1e-3, "{}: {}", spec.name, hi - lo);
            }
        }
        assert!(named("teapot").unwrap_err().to_string().contains("light_bulb"));
    }

    #[test]
    fn damage_limits_lie_between_the_forces_for_the_mass_and_for_half_as_much_again() {
        for spec in fragile().unwrap() {
            let (limit_n, weight_n) = (spec.damaged_at_n.unwrap(), spec.mass_kg * 9.81);
            // What the grip-force policy asks of an even pinch.
            let per_weight = 1.25 * 1.5 / (0.9 * FRAGILE_FRICTION);
            let pressed = |factor: f64| weight_n * (factor * 0.5 * per_weight + 0.5);
            assert!(spec.max_force_n.is_none() && pressed(1.0) < limit_n && limit_n < pressed(1.5), "{}", spec.name);
            let kg = damaged_by_half_as_much_again(limit_n, per_weight);
            assert!((spec.mass_kg - kg).abs() < 6e-4, "{}: {kg}", spec.name);
        }
    }

    #[test]
    fn a_list_without_objects_says_what_to_add() {
        let file = tempfile::NamedTempFile::with_suffix(".toml").unwrap();
        let error = read(file.path()).unwrap_err().to_string();
        assert!(error.contains("add [[object]] with name, mesh and mass_kg"), "{error}");
    }

    #[test]
    fn strokes_are_20_mm_and_volumes_known() {
        let volume = |name: &str| solid_properties(&named(name).unwrap().mesh).unwrap().volume_m3;
        // Two uprights of 90 mm and a bar of 40 mm.
        assert!((volume("letter_u") - (2.0 * 0.09 + 0.04) * 0.02 * 0.045).abs() < 1e-12);
        // Foot to the knee and two arms of stroke width: compare with the area of the strokes' middle lines.
        let y = volume("letter_y") / 0.045 / 0.02;
        assert!((0.13..0.18).contains(&y), "{y}");
        assert!((150e-6..220e-6).contains(&volume("letter_a")), "{}", volume("letter_a"));
    }
}
