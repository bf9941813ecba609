//! Demonstrations to learn from: grasps of one or several objects, with the grip force each needs at a given mass and friction.

use drex_core::Pose;
use nalgebra::{Point3, Unit, Vector3};
use sha2::{Digest, Sha256};

use crate::{Error, Result};

/// Standard gravity as the whole workspace uses it, m/s².
pub const GRAVITY_M_S2: f64 = 9.81;

/// How far a demonstration may lie outside a joint limit, rad: rounding of files, no more.
pub const LIMIT_TOLERANCE_RAD: f64 = 1e-6;

/// Grip forces of less or more than this many times the weight are taken for a mistake in the units: friction coefficients of 0.01 to 10
/// lead to ratios of 0.1 to 100.
const GRIP_FORCE_PER_WEIGHT: (f64, f64) = (1e-3, 1e4);

/// Masses that a hand can have to do with, kg.
pub const MASS_RANGE_KG: (f64, f64) = (1e-3, 100.0);

/// Coefficients of friction between a finger and an object.
pub const FRICTION_RANGE: (f64, f64) = (0.02, 5.0);

/// One grasp at one mass and friction.
///
/// The same grasp (same joints, same wrist) usually appears once per mass, each time with the grip force that this mass needs.
#[derive(Debug, Clone, PartialEq)]
pub struct GraspSample {
    /// Which of [`Dataset::objects`] is grasped.
    pub object: usize,
    /// Joint angles in rad, in the order of [`Dataset::joint_names`].
    pub joints: Vec<f64>,
    /// Pose of the hand's base in the frame of the object's mesh.
    pub object_from_base: Pose,
    /// Which finger touches, in the order of [`Dataset::fingers`].
    pub contacts: Vec<bool>,
    /// The smallest total grip force that carries the object at `mass_kg` and `friction`: sum of normal forces, N.
    pub grip_force_n: f64,
    /// Mass of the object for which `grip_force_n` holds, kg.
    pub mass_kg: f64,
    /// Coefficient of friction for which `grip_force_n` holds.
    pub friction: f64,
}

/// The surface of an object.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectCloud {
    /// Name, for messages.
    pub name: String,
    /// N points on the surface (vertices of the collision mesh or samples), m, in the frame of the mesh.
    pub points: Vec<Point3<f64>>,
    /// Upwards in that frame, of any length. The table is taken to touch the lowest point.
    pub up: Vector3<f64>,
}

impl ObjectCloud {
    /// An object that stands upright in the frame of its mesh: up is z.
    pub fn upright(name: impl Into<String>, points: Vec<Point3<f64>>) -> Self {
        Self { name: name.into(), points, up: Vector3::z() }
    }

    pub(crate) fn up(&self) -> Unit<Vector3<f64>> {
        Unit::try_new(self.up, 1e-9).unwrap_or_else(Vector3::z_axis)
    }
}

/// Grasps by one hand.
#[derive(Debug, Clone, PartialEq)]
pub struct Dataset {
    /// Name of the hand model, e.g. `leap_right`.
    pub hand: String,
    /// Names of the hand's joints.
    pub joint_names: Vec<String>,
    /// Lower and upper limit of each joint, rad, in the order of `joint_names`.
    pub joint_limits: Vec<(f64, f64)>,
    /// Names of the fingers whose contacts are known, e.g. thumb, index, middle, ring.
    pub fingers: Vec<String>,
    /// What is grasped.
    pub objects: Vec<ObjectCloud>,
    /// The demonstrations.
    pub samples: Vec<GraspSample>,
}

impl Dataset {
    /// Whether the data can be trained on: lengths agree, every number is finite, joints are inside their limits,
    /// grip forces and masses are positive.
    ///
    /// # Errors
    /// [`Error::Dataset`] with the sample and the joint concerned.
    pub fn validate(&self) -> Result<()> {
        let count = self.joint_names.len();
        if count == 0 {
            return Err(self.wrong(None, None, "there are no joints", "name the joints of the hand"));
        }
        if let Some(name) =
            self.joint_names.iter().enumerate().find_map(|(i, n)| self.joint_names[..i].contains(n).then_some(n))
        {
            return Err(self.wrong(None, Some(name), "the name appears twice", "give each joint once"));
        }
        if self.joint_limits.len() != count {
            let what = format!("{count} joint names but {} joint limits", self.joint_limits.len());
            return Err(self.wrong(None, None, what, "give one (lower, upper) pair per joint"));
        }
        for (name, &(lower, upper)) in self.joint_names.iter().zip(&self.joint_limits) {
            if !(lower.is_finite() && upper.is_finite() && lower <= upper) {
                let what = format!("limits ({lower}, {upper}) rad are no interval");
                return Err(self.wrong(None, Some(name), what, "give finite limits with lower <= upper"));
            }
        }
        if self.samples.is_empty() {
            return Err(self.wrong(None, None, "there are no demonstrations", "give at least one grasp"));
        }
        if self.fingers.is_empty() {
            return Err(self.wrong(None, None, "there are no fingers", "name the fingers of the hand"));
        }
        if let Some(name) =
            self.fingers.iter().enumerate().find_map(|(i, n)| self.fingers[..i].contains(n).then_some(n))
        {
            return Err(self.wrong(None, None, format!("finger '{name}' appears twice"), "give each finger once"));
        }
        if self.objects.is_empty() {
            return Err(self.wrong(None, None, "there are no objects", "give the surface of what is grasped"));
        }
        for object in &self.objects {
            let name = &object.name;
            if let Some(i) = object.points.iter().position(|p| p.iter().any(|v| !v.is_finite())) {
                let what = format!("object '{name}': surface point {i} is not finite");
                return Err(self.wrong(None, None, what, "repair the mesh or the sampling"));
            }
            if Unit::try_new(object.up, 1e-9).is_none_or(|up| up.iter().any(|v| !v.is_finite())) {
                let what = format!("object '{name}': up is {:?}, no direction", object.up.as_slice());
                return Err(self.wrong(None, None, what, "give the direction away from the table, e.g. (0, 0, 1)"));
            }
        }
        self.samples.iter().enumerate().try_for_each(|(i, s)| self.validate_sample(i, s))
    }

    fn validate_sample(&self, index: usize, sample: &GraspSample) -> Result<()> {
        let at = Some(index);
        if sample.object >= self.objects.len() {
            let what = format!("object {} of {}", sample.object, self.objects.len());
            return Err(self.wrong(at, None, what, "give the index of one of the objects"));
        }
        if sample.joints.len() != self.joint_names.len() {
            let what = format!("{} joint angles for {} joints", sample.joints.len(), self.joint_names.len());
            return Err(self.wrong(at, None, what, "give one angle per joint, in the order of the joint names"));
        }
        for (j, &angle) in sample.joints.iter().enumerate() {
            let (lower, upper) = self.joint_limits[j];
            let name = Some(&self.joint_names[j]);
            if !angle.is_finite() {
                return Err(self.wrong(
                    at,
                    name,
                    format!("the angle is {angle}"),
                    "remove the sample or repair the file",
                ));
            }
            if angle < lower - LIMIT_TOLERANCE_RAD || angle > upper + LIMIT_TOLERANCE_RAD {
                let what = format!("{angle:.6} rad is outside its limits {lower:.6} .. {upper:.6} rad");
                return Err(self.wrong(at, name, what, "clamp the grasp, or check joint order and units (rad)"));
            }
        }
        let pose = &sample.object_from_base;
        if pose.translation.vector.iter().chain(pose.rotation.coords.iter()).any(|v| !v.is_finite()) {
            return Err(self.wrong(
                at,
                None,
                "the wrist pose is not finite",
                "remove the sample or solve its wrist again",
            ));
        }
        if sample.contacts.len() != self.fingers.len() {
            let what = format!("{} contacts for {} fingers", sample.contacts.len(), self.fingers.len());
            return Err(self.wrong(
                at,
                None,
                what,
                "say of each finger whether it touches, in the order of the fingers",
            ));
        }
        if !sample.contacts.contains(&true) {
            let remedy = "leave out what is no grasp, or find its contacts again";
            return Err(self.wrong(at, None, "the contact set is empty: no finger touches", remedy));
        }
        for (what, value, unit) in [("grip force", sample.grip_force_n, "N"), ("mass", sample.mass_kg, "kg")] {
            if !(value.is_finite() && value > 0.0) {
                let text = format!("the {what} is {value} {unit}, not a positive number");
                return Err(self.wrong(at, None, text, "leave out grasps for which no grip force was found"));
            }
        }
        let ranges =
            [("mass", sample.mass_kg, " kg", MASS_RANGE_KG), ("friction", sample.friction, "", FRICTION_RANGE)];
        for (what, value, unit, (least, most)) in ranges {
            // Written so that a NaN is refused as well.
            if !(value >= least && value <= most) {
                let text = format!("the {what} is {value}{unit}, outside {least} .. {most}{unit}");
                return Err(self.wrong(at, None, text, "check the unit, or measure it again"));
            }
        }
        let ratio = sample.grip_force_n / (sample.mass_kg * GRAVITY_M_S2);
        let (least, most) = GRIP_FORCE_PER_WEIGHT;
        if !(ratio >= least && ratio <= most) {
            let what = format!(
                "a grip force of {} N for {} kg is {ratio:.3e} times the weight",
                sample.grip_force_n, sample.mass_kg
            );
            return Err(self.wrong(at, None, what, "check the units (N, kg)"));
        }
        Ok(())
    }

    /// SHA-256 over names, limits, points and samples, in hexadecimal.
    pub(crate) fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        // Lengths go in first, so that moving a name or a number from one list to the next changes the hash.
        let mut count = |c: usize| hash.update((c as u64).to_le_bytes());
        [self.joint_names.len(), self.fingers.len(), self.objects.len(), self.samples.len()]
            .into_iter()
            .for_each(&mut count);
        self.objects.iter().for_each(|o| count(o.points.len()));
        self.samples.iter().for_each(|s| count(s.object));
        let objects = self.objects.iter().map(|o| &o.name);
        for name in std::iter::once(&self.hand).chain(&self.joint_names).chain(&self.fingers).chain(objects) {
            hash.update((name.len() as u64).to_le_bytes());
            hash.update(name.as_bytes());
        }
        let mut number = |v: f64| hash.update(v.to_bits().to_le_bytes());
        self.joint_limits.iter().for_each(|(a, b)| [*a, *b].into_iter().for_each(&mut number));
        for o in &self.objects {
            o.points.iter().flat_map(|p| p.iter()).chain(o.up.iter()).copied().for_each(&mut number);
        }
        for s in &self.samples {
            let (translation, quaternion) = drex_core::pose::to_wxyz(&s.object_from_base);
            s.joints.iter().copied().chain(translation).chain(quaternion).for_each(&mut number);
            s.contacts.iter().for_each(|c| number(f64::from(u8::from(*c))));
            [s.grip_force_n, s.mass_kg, s.friction].into_iter().for_each(&mut number);
        }
        drex_core::fsutil::hex(&hash.finalize())
    }

    pub(crate) fn wrong(
        &self,
        sample: Option<usize>,
        joint: Option<&String>,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Error {
        Error::Dataset {
            hand: self.hand.clone(),
            sample,
            joint: joint.cloned(),
            what: what.into(),
            remedy: remedy.into(),
        }
    }
}
