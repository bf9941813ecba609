//! The compiler section, and the orientations whose meaning it sets.

use drex_core::Pose;
use nalgebra::{Matrix3, Quaternion, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::Result;
use crate::unsupported::Unsupported;
use crate::xml::{Attributes, Node};

const USED: [&str; 17] = [
    "angle",
    "eulerseq",
    "meshdir",
    "assetdir",
    "texturedir",
    "autolimits",
    "inertiafromgeom",
    "inertiagrouprange",
    "balanceinertia",
    "boundmass",
    "boundinertia",
    "settotalmass",
    "strippath",
    "discardvisual",
    "fusestatic",
    "usethread",
    "exactmeshinertia",
];

/// Where inertia comes from when a body could have both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum InertiaSource {
    /// The `<inertial>` element only.
    Explicit,
    /// The element, or the shapes where there is none.
    Auto,
    /// The shapes always.
    Shapes,
}

/// Settings of `<compiler>`, MuJoCo's defaults where the file is silent.
#[derive(Debug, Clone)]
pub(super) struct Compiler {
    radians: bool,
    euler_sequence: Vec<char>,
    pub mesh_folder: String,
    pub strip_path: bool,
    pub auto_limits: bool,
    pub inertia_source: InertiaSource,
    pub inertia_groups: (i64, i64),
    pub balance_inertia: bool,
    pub least_mass_kg: f64,
    pub least_inertia: f64,
    pub total_mass_kg: Option<f64>,
    pub discard_visual: bool,
}

impl Compiler {
    pub fn read(root: &Node, unsupported: &mut Unsupported) -> Result<Self> {
        let mut c = Self {
            radians: false,
            euler_sequence: vec!['x', 'y', 'z'],
            mesh_folder: String::new(),
            strip_path: false,
            auto_limits: true,
            inertia_source: InertiaSource::Auto,
            inertia_groups: (0, 5),
            balance_inertia: false,
            least_mass_kg: 0.0,
            least_inertia: 0.0,
            total_mass_kg: None,
            discard_visual: false,
        };
        for node in root.children_called("compiler") {
            let a = node.with_defaults(None);
            match a.get("angle") {
                Some("radian") => c.radians = true,
                Some("degree") => c.radians = false,
                None => {}
                Some(_) => return Err(a.fault("angle", "neither \"radian\" nor \"degree\"", "use one of them")),
            }
            if let Some(sequence) = a.get("eulerseq") {
                c.euler_sequence = sequence.chars().collect();
                if c.euler_sequence.len() != 3 || !c.euler_sequence.iter().all(|k| "xyzXYZ".contains(*k)) {
                    return Err(a.fault("eulerseq", "not three of x, y, z, X, Y, Z", "write for example \"xyz\""));
                }
            }
            if a.get("coordinate").is_some_and(|v| v != "local") {
                return Err(a.fault(
                    "coordinate",
                    "global coordinates are not read",
                    "save the model with local coordinates",
                ));
            }
            if let Some(folder) = a.get("meshdir").or(a.get("assetdir")) {
                c.mesh_folder = folder.to_owned();
            }
            c.inertia_source = match a.truth("inertiafromgeom")? {
                Some(true) => InertiaSource::Shapes,
                Some(false) => InertiaSource::Explicit,
                None if a.get("inertiafromgeom").is_some() => InertiaSource::Auto,
                None => c.inertia_source,
            };
            if let Some((lo, hi)) = a.range("inertiagrouprange")? {
                c.inertia_groups = (lo as i64, hi as i64);
            }
            c.auto_limits = a.truth("autolimits")?.unwrap_or(c.auto_limits);
            c.strip_path = a.truth("strippath")?.unwrap_or(c.strip_path);
            c.balance_inertia = a.truth("balanceinertia")?.unwrap_or(c.balance_inertia);
            c.discard_visual = a.truth("discardvisual")?.unwrap_or(c.discard_visual);
            c.least_mass_kg = a.number("boundmass")?.unwrap_or(c.least_mass_kg);
            c.least_inertia = a.number("boundinertia")?.unwrap_or(c.least_inertia);
            c.total_mass_kg = a.number("settotalmass")?.filter(|m| *m > 0.0).or(c.total_mass_kg);
            unsupported.attributes(node, &[&USED[..], &["coordinate"]].concat());
        }
        Ok(c)
    }

    /// An angle of the file in radians.
    pub fn angle(&self, value: f64) -> f64 {
        if self.radians { value } else { value.to_radians() }
    }

    /// Position and orientation attributes as a pose.
    pub fn pose(&self, a: &Attributes<'_>) -> Result<Pose> {
        let position = a.vector("pos")?.unwrap_or_default();
        Ok(Pose::from_parts(
            Translation3::from(position),
            self.orientation(a)?.unwrap_or_else(UnitQuaternion::identity),
        ))
    }

    /// The orientation attribute of an element, whichever of the five it is.
    pub fn orientation(&self, a: &Attributes<'_>) -> Result<Option<UnitQuaternion<f64>>> {
        let too_short = |name: &str| a.fault(name, "a direction of length zero", "give a direction");
        if let Some(q) = a.numbers("quat", 4..=4)? {
            return Unit::try_new(Quaternion::new(q[0], q[1], q[2], q[3]), 1e-12)
                .map(Some)
                .ok_or_else(|| too_short("quat"));
        }
        if let Some(v) = a.numbers("axisangle", 4..=4)? {
            let axis = Unit::try_new(Vector3::new(v[0], v[1], v[2]), 1e-12).ok_or_else(|| too_short("axisangle"))?;
            return Ok(Some(UnitQuaternion::from_axis_angle(&axis, self.angle(v[3]))));
        }
        if let Some(v) = a.vector("euler")? {
            let mut rotation = UnitQuaternion::identity();
            for (k, axis_name) in self.euler_sequence.iter().enumerate() {
                let axis = match axis_name.to_ascii_lowercase() {
                    'x' => Vector3::x_axis(),
                    'y' => Vector3::y_axis(),
                    _ => Vector3::z_axis(),
                };
                let turn = UnitQuaternion::from_axis_angle(&axis, self.angle(v[k]));
                // Lower case turns about the moving axes, upper case about the fixed ones.
                rotation = if axis_name.is_ascii_lowercase() { rotation * turn } else { turn * rotation };
            }
            return Ok(Some(rotation));
        }
        if let Some(v) = a.numbers("xyaxes", 6..=6)? {
            let x = Vector3::new(v[0], v[1], v[2]).try_normalize(1e-12).ok_or_else(|| too_short("xyaxes"))?;
            let y = Vector3::new(v[3], v[4], v[5]);
            let y = (y - x * x.dot(&y)).try_normalize(1e-12).ok_or_else(|| too_short("xyaxes"))?;
            let matrix = Matrix3::from_columns(&[x, y, x.cross(&y)]);
            return Ok(Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))));
        }
        if let Some(z) = a.vector("zaxis")? {
            return rotation_to_z(&z).map(Some).ok_or_else(|| too_short("zaxis"));
        }
        Ok(None)
    }
}

/// The smallest rotation that turns the z axis into direction `z`; `None` for a vector of length zero.
pub(super) fn rotation_to_z(z: &Vector3<f64>) -> Option<UnitQuaternion<f64>> {
    let z = z.try_normalize(1e-12)?;
    let across = Vector3::z().cross(&z);
    let angle = across.norm().atan2(z.z);
    // Straight down leaves the axis open; MuJoCo turns about x.
    let axis = Unit::try_new(across, 1e-12).unwrap_or_else(Vector3::x_axis);
    Some(UnitQuaternion::from_axis_angle(&axis, angle))
}
