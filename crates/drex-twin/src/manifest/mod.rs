//! `twin.toml`: the manifest of one object's twin folder.
//!
//! The manifest says what is given: the scan, the mass or the pushes that tell it, the grasps, and settings. What the
//! stages make from it lies beside it in the folder and is never written into the manifest.

mod click;
mod grasps;
mod scan;

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

pub use self::click::ObjectClick;
pub use self::grasps::{GraspsConfig, RecordedAs};
pub use self::scan::{ScanConfig, ScanPreset};
use drex_core::{ASSUMED_FRICTION, Error, Result, fsutil};
use drex_mesh::{AssetOptions, ContactConfig, JointConfig, PartConfig, joint_tree};

/// Name of the manifest in a twin folder.
pub const MANIFEST: &str = "twin.toml";

/// A `twin.toml`. Paths are relative to its folder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwinManifest {
    /// Version of this format: 1.
    pub schema: u32,
    /// Name of the object.
    pub name: String,
    /// Seed of everything random.
    #[serde(default)]
    pub seed: u64,
    /// Photos or a recording that the mesh is made of; none where the mesh is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scan: Option<ScanConfig>,
    /// The object.
    pub object: ObjectConfig,
    /// What is known of its mass.
    pub mass: MassConfig,
    /// Recorded grasps.
    pub grasps: Option<GraspsConfig>,
    /// Settings of the training, where they differ from the defaults.
    pub train: Option<TrainConfig>,
}

/// The object as it was scanned.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectConfig {
    /// The scanned mesh; where there is a `[scan]`, the file that is made of it.
    pub mesh: PathBuf,
    /// Unit of the mesh's coordinates.
    #[serde(default)]
    pub unit: LengthUnit,
    /// Up in the mesh frame while the object stands on the table.
    #[serde(default = "z_up")]
    pub up_in_mesh: [f64; 3],
    /// Coulomb friction of the object against hand and table; [`ASSUMED_FRICTION`] if left out.
    pub friction: Option<f64>,
    /// The other contact parameters of the simulation asset; their defaults if left out.
    pub contact: Option<ContactConfig>,
    /// Convex parts at most; the default of the mesh kit if left out.
    #[serde(rename = "pieces")]
    pub convex_parts: Option<usize>,
    /// Parts of an articulated object, segmented from `mesh`; none for a rigid one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<PartConfig>,
    /// Joints between the parts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joints: Vec<JointConfig>,
}

impl ObjectConfig {
    /// The settings of the object's asset at this friction.
    pub fn asset_options(&self, friction: f64) -> AssetOptions {
        let mut options = AssetOptions::default();
        options.unit = self.unit.into();
        options.up_in_mesh = Some(Vector3::from(self.up_in_mesh));
        options.friction = friction;
        options.partition.most_parts = self.convex_parts.unwrap_or(options.partition.most_parts);
        options.contact = self.contact.clone().unwrap_or_default();
        options
    }
}

fn z_up() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

/// Unit of length of the mesh file in a manifest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LengthUnit {
    /// Metre.
    #[default]
    M,
    /// Millimetre.
    Mm,
    /// Centimetre.
    Cm,
}

impl From<LengthUnit> for drex_mesh::LengthUnit {
    fn from(unit: LengthUnit) -> Self {
        match unit {
            LengthUnit::M => Self::Metre,
            LengthUnit::Mm => Self::Millimetre,
            LengthUnit::Cm => Self::Centimetre,
        }
    }
}

/// What is known of the mass: a prior (weighed or guessed) and the pushes, whose product later stages use.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MassConfig {
    /// Pushes that tell the mass: folders that hold a `push.toml`, or such files.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub identify: Vec<PathBuf>,
    /// Weighed mass, kg: a prior that is right to 1 %, in place of a guess.
    pub weighed_kg: Option<f64>,
    /// First guess, kg.
    pub prior_kg: Option<f64>,
    /// First guess: the material of a solid object ("wood"); its volume is that of the mesh.
    pub prior_material: Option<String>,
    /// First guess: a JSON file with somebody's answer, such as a vision-language model's.
    pub prior_file: Option<PathBuf>,
    /// Standard deviation of the logarithm of the mass about the first guess; where it is left out, that of the guess's source, mostly ln 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prior_sd_log: Option<f64>,
}

impl MassConfig {
    /// Whether there is a first guess.
    pub fn has_prior(&self) -> bool {
        self.prior_kg.is_some() || self.prior_material.is_some() || self.prior_file.is_some()
    }
}

/// Settings of the training; what is left out keeps its default.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainConfig {
    /// Passes over the grasps.
    pub epochs: Option<usize>,
    /// Step size.
    pub learning_rate: Option<f64>,
    /// Number of grasp modes that the network chooses from.
    pub modes: Option<usize>,
    /// Width of the hidden layers.
    pub hidden: Option<usize>,
    /// Grasps that are tried in simulation before the best of them are learned, those that need least force; none if left out.
    pub practice: Option<u32>,
    /// Hands that a search looks at to find more grasps for the practice, and fifty times as many as are laid on the object palm first; none if
    /// left out.
    pub search: Option<usize>,
}

impl TwinManifest {
    /// A manifest with the given mesh and mass, defaults elsewhere.
    pub fn new(name: impl Into<String>, mesh: impl Into<PathBuf>, mass: MassConfig) -> Self {
        let object = ObjectConfig {
            mesh: mesh.into(),
            unit: LengthUnit::M,
            up_in_mesh: z_up(),
            friction: None,
            contact: None,
            convex_parts: None,
            parts: Vec::new(),
            joints: Vec::new(),
        };
        Self { schema: 1, name: name.into(), seed: 0, scan: None, object, mass, grasps: None, train: None }
    }

    /// Reads and checks a manifest: a `twin.toml`, or the folder that holds one.
    ///
    /// # Errors
    /// If it cannot be read, is no TOML, has an unknown, missing or ill-typed entry (with line and column), or fails
    /// [`TwinManifest::check`].
    pub fn load(path: &Path) -> Result<Self> {
        let file = if path.is_dir() { path.join(MANIFEST) } else { path.to_path_buf() };
        if !file.exists() {
            let remedy = "give a twin.toml or the folder that holds it; docs/formats.md says what is written into one";
            return Err(Error::content(&file, None, "there is no such file", remedy));
        }
        Self::parse(&file, &fsutil::read_text(&file)?)
    }

    /// As [`TwinManifest::load`], from memory; `path` is for messages.
    ///
    /// # Errors
    /// As [`TwinManifest::load`].
    pub fn parse(path: &Path, text: &str) -> Result<Self> {
        let manifest: Self = fsutil::from_toml(path, text)?;
        manifest.check().map_err(|e| Error::at(path, None, e))?;
        Ok(manifest)
    }

    /// The text of the file.
    ///
    /// # Errors
    /// If a path is not Unicode or the seed is beyond what TOML can hold (2⁶³ - 1).
    pub fn to_toml_string(&self) -> Result<String> {
        toml::to_string(self).map_err(|e| {
            Error::value(
                format!("the manifest cannot be written as TOML: {e}"),
                "use paths in Unicode and a smaller seed",
            )
        })
    }

    /// Friction of the object and whether it is assumed rather than stated.
    pub fn friction(&self) -> (f64, bool) {
        self.object.friction.map_or((ASSUMED_FRICTION, true), |f| (f, false))
    }

    /// Checks what the types cannot.
    ///
    /// # Errors
    /// With the entry that is wrong.
    pub fn check(&self) -> Result<()> {
        let refuse = |what: String, remedy: &str| Err(Error::value(what, remedy));
        if self.schema != 1 {
            return refuse(
                format!("schema {} of twin.toml is not known", self.schema),
                "write schema = 1 or use a newer drex",
            );
        }
        if self.name.trim().is_empty() {
            return refuse("name is empty".into(), "name the object");
        }
        if self.seed > i64::MAX as u64 {
            return refuse(format!("seed {} does not fit into TOML", self.seed), "use a seed below 2^63");
        }
        let up = nalgebra::Vector3::from(self.object.up_in_mesh);
        if !(up.iter().all(|c| c.is_finite()) && up.norm() > 1e-9) {
            return refuse(
                "[object] up_in_mesh is no direction".into(),
                "give a vector that is not zero, such as [0, 0, 1]",
            );
        }
        if let Some(friction) = self.object.friction
            && !(0.0..=10.0).contains(&friction)
        {
            return refuse(
                format!("[object] friction = {friction}"),
                "give a coefficient between 0 and 10, usually 0.2 to 1",
            );
        }
        self.object.contact.as_ref().map_or(Ok(()), ContactConfig::check)?;
        if self.object.convex_parts == Some(0) {
            return refuse("[object] pieces = 0".into(), "allow at least one convex piece, or leave it out");
        }
        self.check_parts()?;
        if let Some(scan) = &self.scan {
            scan.check()?;
            let made = self.object.mesh.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj"));
            if !made || self.object.unit != LengthUnit::M {
                return refuse(
                    format!("[scan] makes an OBJ file in metres, and [object] mesh is {}", self.object.mesh.display()),
                    "write mesh = \"splat/object.obj\" and leave unit out",
                );
            }
        }
        let m = &self.mass;
        if m.identify.is_empty() && m.weighed_kg.is_none() && !m.has_prior() {
            return refuse(
                "[mass] says nothing".into(),
                "give identify = [\"push/<name>\"] with a recorded push, or weighed_kg, or at least a guess as prior_kg",
            );
        }
        let guesses = [m.prior_kg.is_some(), m.prior_material.is_some(), m.prior_file.is_some()];
        if guesses.into_iter().filter(|g| *g).count() > 1 {
            return refuse(
                "[mass] has several first guesses".into(),
                "keep one of prior_kg, prior_material and prior_file",
            );
        }
        if let Some(sd) = m.prior_sd_log {
            if !(sd > 0.0 && sd < 10.0) {
                return refuse(
                    format!("[mass] prior_sd_log = {sd}"),
                    "give the standard deviation of the logarithm of the mass: 0.69 is a factor of 2 either way",
                );
            }
            if !m.has_prior() && m.identify.is_empty() {
                return refuse(
                    format!("[mass] prior_sd_log = {sd} without a first guess"),
                    "add prior_kg, or leave it out",
                );
            }
        }
        for (entry, value) in [("weighed_kg", m.weighed_kg), ("prior_kg", m.prior_kg)] {
            if let Some(value) = value
                && !(value > 0.0 && value < 1e3)
            {
                return refuse(format!("[mass] {entry} = {value}"), "give kilograms of an object that a hand can lift");
            }
        }
        self.grasps.as_ref().map_or(Ok(()), GraspsConfig::check)?;
        let train = self.train.clone().unwrap_or_default();
        for (entry, value) in [("epochs", train.epochs), ("modes", train.modes), ("hidden", train.hidden)] {
            if value == Some(0) {
                return refuse(format!("[train] {entry} = 0"), "give a positive number or leave it out");
            }
        }
        if train.search.is_some() && train.practice.unwrap_or(0) == 0 {
            return refuse(
                "[train] search without practice".into(),
                "add practice = 40: what a search finds must be tried before it is learned",
            );
        }
        if let Some(rate) = train.learning_rate
            && !(rate > 0.0 && rate.is_finite())
        {
            return refuse(format!("[train] learning_rate = {rate}"), "give a small positive number, such as 1e-3");
        }
        Ok(())
    }

    fn check_parts(&self) -> Result<()> {
        let (parts, joints) = (&self.object.parts, &self.object.joints);
        if parts.is_empty() && joints.is_empty() {
            return Ok(());
        }
        let names: Vec<&str> = parts.iter().map(|p| p.name.as_str()).collect();
        joint_tree(&names, joints)?;
        if let Some(part) = parts.iter().find(|p| p.mass_kg.is_some_and(|m| !(m > 0.0 && m < 1e3))) {
            return Err(Error::value(
                format!("[[object.parts]] {}: mass_kg = {}", part.name, part.mass_kg.unwrap_or_default()),
                "give kilograms of a part that a hand can lift, or leave it out",
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use drex_mesh::JointKind;

    use super::*;

    const FULL: &str = r#"
schema = 1
name = "cookie"
[object]
mesh = "scan/cookie.stl"
unit = "mm"
up_in_mesh = [1, 0, 0]
[mass]
identify = ["push/push1"]
prior_kg = 0.5
[grasps]
file = "demos/grasps.json"
hand = "leap_right"
joint_order = "leap_sdk"
[train]
epochs = 200
"#;

    fn parse(text: &str) -> Result<TwinManifest> {
        TwinManifest::parse(Path::new("twin.toml"), text)
    }

    #[test]
    fn a_manifest_is_read_with_its_defaults() {
        let m = parse(FULL).unwrap();
        assert_eq!((m.seed, m.object.unit, m.object.up_in_mesh), (0, LengthUnit::Mm, [1.0, 0.0, 0.0]));
        assert_eq!(m.friction(), (ASSUMED_FRICTION, true));
        assert_eq!(parse(&m.to_toml_string().unwrap()).unwrap(), m);
    }

    #[test]
    fn an_articulated_object_is_read() {
        let stapler = r#"
[[object.parts]]
name = "base"
mesh = "scan/base.stl"
mass_kg = 0.09
[[object.parts]]
name = "arm"
mesh = "scan/arm.stl"
[[object.joints]]
name = "hinge"
kind = "hinge"
parent = "base"
child = "arm"
axis = [0, 1, 0]
origin = [-0.05, 0, 0.02]
range = [0, 1.2]
damping = 0.001
[mass]"#;
        let text = FULL.replace("[mass]", stapler);
        let m = parse(&text).unwrap();
        assert_eq!((m.object.parts.len(), m.object.joints[0].kind), (2, JointKind::Hinge));
        assert_eq!(parse(&m.to_toml_string().unwrap()).unwrap(), m);
        for (from, to, expected) in [
            ("parent = \"base\"", "parent = \"bass\"", "does not exist"),
            ("kind = \"hinge\"", "kind = \"ball\"", "line 18"),
            ("mass_kg = 0.09", "mass_kg = -1", "mass_kg = -1"),
            ("range = [0, 1.2]", "range = [1.2, 0]", "range"),
            ("damping = 0.001", "dumping = 0.001", "dumping"),
            ("[mass]", "[object.contact]\nimpedance = [0.9, 1.0]\n[mass]", "impedance = [0.9, 1]"),
            ("[mass]", "[object.contact]\ntime_constant_s = 0\n[mass]", "time_constant_s = 0"),
        ] {
            let message = parse(&text.replace(from, to)).unwrap_err().to_string();
            assert!(message.contains(expected) && message.starts_with("twin.toml"), "{message}");
        }
    }

    #[test]
    fn a_mesh_may_be_made_of_a_scan() {
        let scan = "[scan]\nphotos = \"scan\"\ndistances_m = { \"A-C\" = 0.12 }\n[object]";
        let text =
            FULL.replace("[object]", scan).replace("scan/cookie.stl", "splat/object.obj").replace("unit = \"mm\"", "");
        let m = parse(&text).unwrap();
        let scan = m.scan.clone().unwrap();
        assert_eq!(scan.distances().collect::<Vec<_>>(), [("A", "C", 0.12)]);
        assert_eq!((scan.preset, scan.iterations), (ScanPreset::Fast, None));
        assert_eq!(parse(&m.to_toml_string().unwrap()).unwrap(), m);
        for (from, to, expected) in [
            ("\"A-C\" = 0.12", "\"AC\" = 0.12", "\"AC\" = 0.12"),
            ("\"A-C\" = 0.12", "\"A-C\" = -1", "\"A-C\" = -1"),
            ("photos = \"scan\"", "photos = \"scan\"\nscale = 2", "keep one of them"),
            ("photos = \"scan\"", "photos = \"scan\"\npreset = \"slow\"", "line 6"),
            ("photos = \"scan\"", "photos = \"scan\"\nregion = [[0, 0, 0], [1, 1, 0]]", "region"),
            ("photos = \"scan\"", "photos = \"scan\"\nobject = \"5;5@a.jpg\"", "512,300@"),
            (
                "photos = \"scan\"",
                "photos = \"scan\"\nobject = \"5,5@a.jpg\"\nregion = [[0, 0, 0], [1, 1, 1]]",
                "region and object",
            ),
            ("object.obj", "object.stl", "object.stl"),
        ] {
            let message = parse(&text.replace(from, to)).unwrap_err().to_string();
            assert!(message.contains(expected) && message.starts_with("twin.toml"), "{message}");
        }
    }

    #[test]
    fn grasps_of_a_person_are_told_apart() {
        assert_eq!(parse(FULL).unwrap().grasps.unwrap().recorded, RecordedAs::Robot);
        let m = parse(&FULL.replace("joint_order = \"leap_sdk\"", "recorded = \"human\"\naugment = 200")).unwrap();
        let grasps = m.grasps.clone().unwrap();
        assert_eq!((grasps.recorded, grasps.augment), (RecordedAs::Human, Some(200)));
        let m = parse(&FULL.replace("joint_order = \"leap_sdk\"", "torque_cap_nm = 0.2")).unwrap();
        assert_eq!(m.grasps.as_ref().unwrap().torque_cap_nm, Some(0.2));
        assert_eq!(parse(&m.to_toml_string().unwrap()).unwrap(), m);
    }

    #[test]
    fn mistakes_are_named_with_their_place() {
        for (from, to, expected) in [
            ("epochs = 200", "epoch = 200", "line 16: column 1: unknown field `epoch`"),
            ("unit = \"mm\"", "unit = \"inch\"", "line 6"),
            ("prior_kg = 0.5", "prior_kg = -1", "prior_kg = -1"),
            ("prior_kg = 0.5", "prior_kg = 0.5\nprior_sd_log = 0", "prior_sd_log = 0"),
            (
                "identify = [\"push/push1\"]\nprior_kg = 0.5",
                "weighed_kg = 1\nprior_sd_log = 1",
                "without a first guess",
            ),
            ("unit = \"mm\"", "pieces = 0", "[object] pieces = 0"),
            ("identify = [\"push/push1\"]\nprior_kg = 0.5", "", "[mass] says nothing"),
            ("schema = 1", "schema = 2", "schema 2"),
            ("[1, 0, 0]", "[0, 0, 0]", "up_in_mesh"),
            ("name = \"cookie\"", "", "missing field `name`"),
            ("epochs = 200", "epochs = 0", "epochs = 0"),
            ("epochs = 200", "learning_rate = nan", "learning_rate"),
            ("epochs = 200", "search = 1000", "search without practice"),
            ("[train]", "augment = 9\n[train]", "[grasps] augment = 9"),
            ("[train]", "recorded = \"human\"\n[train]", "[grasps] joint_order"),
            ("joint_order = \"leap_sdk\"", "recorded = \"human\"\naugment = 0", "augment = 0"),
            ("joint_order = \"leap_sdk\"", "torque_cap_nm = 0", "torque_cap_nm = 0"),
            ("joint_order = \"leap_sdk\"", "torque_cap_nm = nan", "grasps.torque_cap_nm is not finite"),
            ("joint_order = \"leap_sdk\"", "recorded = \"glove\"", "line 14"),
        ] {
            let message = parse(&FULL.replace(from, to)).unwrap_err().to_string();
            assert!(message.contains(expected) && message.starts_with("twin.toml"), "{message}");
        }
    }
}
