//! What a robot, its state and its controls must be to be simulated; names instead of indices.

use nalgebra::{Matrix3, SymmetricEigen};

use super::{ActuatorKind, Articulation, ArticulationState, TreeWork, joint_error};
use crate::{Error, Result, Scalar};

/// Share of a diagonal entry of the mass matrix below which its pivot counts as zero.
const SINGULAR: f64 = 1e-12;

impl<T: Scalar> Articulation<T> {
    /// Checks every number, and that the mass matrix can be inverted: a joint that moves neither mass nor the inertia
    /// of a drive has no defined acceleration.
    ///
    /// # Errors
    /// Names the link, joint or drive and the value.
    pub fn check(&self) -> Result<()> {
        for (link, m) in self.robot.links.iter().zip(&self.links) {
            let mass = m.mass_kg.value();
            let finite = m.center_of_mass.iter().chain(m.inertia.iter()).all(|x| x.value().is_finite());
            let inertia = m.inertia.map(|x| x.value());
            if !(finite && mass.is_finite() && mass >= 0.0 && exists(&inertia)) {
                return Err(Error::Joint {
                    robot: self.robot.name.clone(),
                    joint: format!("link {}", link.name),
                    what: format!("mass {mass} kg, inertia {:?} are no rigid body's", inertia.as_slice()),
                    remedy: "give finite numbers, no negative mass, and a symmetric inertia none of whose principal moments \
                             is negative or above the sum of the others"
                        .into(),
                });
            }
        }
        for (j, p) in self.robot.joints.iter().zip(&self.joints) {
            let numbers = [("armature", &p.armature), ("damping", &p.damping), ("friction_loss", &p.friction_loss)];
            for (what, x) in numbers.map(|(what, x)| (what, x.value())) {
                if !(x.is_finite() && x >= 0.0) {
                    return Err(joint_error(
                        &self.robot,
                        &j.name,
                        format!("{what} is {x}"),
                        "give a finite number, zero at least",
                    ));
                }
            }
            if !(p.presliding.is_finite() && p.presliding > 0.0) {
                let what = format!("presliding is {}", p.presliding);
                return Err(joint_error(&self.robot, &j.name, what, "give a small positive number"));
            }
            if let Some((lo, hi)) = p.limits.filter(|(lo, hi)| !(lo <= hi)) {
                return Err(joint_error(
                    &self.robot,
                    &j.name,
                    format!("limits {lo} to {hi}"),
                    "give the lower one first",
                ));
            }
        }
        for a in &self.actuators {
            self.check_actuator(a)?;
        }
        self.check_mass_matrix()
    }

    fn check_actuator(&self, a: &super::ActuatorParams<T>) -> Result<()> {
        let fail = |what: String, remedy: &str| {
            let name = self.robot.joints.get(a.joint).map_or("", |j| j.name.as_str());
            Err(joint_error(&self.robot, name, format!("drive \"{}\": {what}", a.name), remedy))
        };
        if a.joint >= self.joints.len() {
            return fail(format!("there is no joint {}", a.joint), "give the index of a joint");
        }
        let gains: &[T] = match &a.kind {
            ActuatorKind::Motor { gain: x } | ActuatorKind::Velocity { kv: x } => std::slice::from_ref(x),
            ActuatorKind::Position { kp, kv } => &[*kp, *kv],
            ActuatorKind::Affine { gain, bias: [a, b, c] } => &[*gain, *a, *b, *c],
        };
        if gains.iter().chain([&a.gear]).any(|x| !x.value().is_finite()) {
            return fail("a gain or the gear is not finite".into(), "give finite numbers");
        }
        if let Some((lo, hi)) = a.force_range.as_ref().map(|(lo, hi)| (lo.value(), hi.value()))
            && !(lo <= hi)
        {
            return fail(format!("efforts {lo} to {hi}"), "give the lower one first");
        }
        match a.ctrl_range {
            Some((lo, hi)) if !(lo <= hi) => fail(format!("controls {lo} to {hi}"), "give the lower one first"),
            _ => Ok(()),
        }
    }

    /// Checks a state of this robot.
    ///
    /// # Errors
    /// If it has not one finite number per joint, or the base is not finite.
    pub fn check_state(&self, state: &ArticulationState<T>) -> Result<()> {
        let n = self.joints.len();
        for (what, values) in
            [("position", &state.q), ("velocity", &state.velocities), ("friction stretch", &state.friction)]
        {
            if values.len() != n {
                return Err(Error::Series {
                    what: format!("robot \"{}\" has {n} joints but {} values of {what}", self.robot.name, values.len()),
                    remedy: "give one value per joint, in the order of the robot".into(),
                });
            }
            if let Some(i) = values.iter().position(|x| !x.value().is_finite()) {
                let what = format!("its {what} is {}", values[i].value());
                return Err(joint_error(&self.robot, &self.robot.joints[i].name, what, "give a finite number"));
            }
        }
        let b = &state.base;
        let pose = b.world_from_base.translation.vector.iter().chain(b.world_from_base.rotation.coords.iter());
        if pose.chain(b.velocity.iter()).chain(b.angular_velocity.iter()).any(|x| !x.value().is_finite()) {
            return Err(Error::NotFinite { what: format!("robot \"{}\": the state of the base", self.robot.name) });
        }
        Ok(())
    }

    /// Checks a control vector.
    ///
    /// # Errors
    /// If it has not one finite number per drive.
    pub fn check_control(&self, control: &[f64]) -> Result<()> {
        let n = self.actuators.len();
        let fail = |what: String, remedy: &str| {
            Err(Error::Control { robot: self.robot.name.clone(), what, remedy: remedy.into() })
        };
        if control.len() != n {
            return fail(format!("{n} drives but {} controls", control.len()), "give one per drive, in their order");
        }
        match control.iter().position(|x| !x.is_finite()) {
            Some(i) => fail(
                format!("the control of drive {i} (\"{}\") is {}", self.drive_name(i), control[i]),
                "give a finite number",
            ),
            None => Ok(()),
        }
    }

    /// The control vector from values by drive name, or by the name of the joint that one drive moves; drives that are
    /// not named get `other`.
    ///
    /// # Errors
    /// If a name is neither a drive nor a joint with one drive, or a value is not finite.
    pub fn control<S: AsRef<str>>(&self, named: impl IntoIterator<Item = (S, f64)>, other: f64) -> Result<Vec<f64>> {
        let mut out = vec![other; self.actuators.len()];
        for (name, value) in named {
            let name = name.as_ref();
            let by_joint = |a: &super::ActuatorParams<T>| self.robot.joints[a.joint].name == name;
            let found = self.actuators.iter().position(|a| a.name == name).or_else(|| {
                let first = self.actuators.iter().position(by_joint)?;
                (!self.actuators[first + 1..].iter().any(by_joint)).then_some(first)
            });
            let Some(i) = found else {
                let known: Vec<_> = (0..out.len()).map(|i| self.drive_name(i)).collect();
                return Err(Error::Control {
                    robot: self.robot.name.clone(),
                    what: format!("no drive \"{name}\", nor a joint of that name with one drive"),
                    remedy: format!("its drives are {}", known.join(", ")),
                });
            };
            out[i] = value;
        }
        self.check_control(&out)?;
        Ok(out)
    }

    /// Index of the joint called `name`.
    ///
    /// # Errors
    /// If there is none; the error lists those there are.
    pub fn joint_index(&self, name: &str) -> Result<usize> {
        self.robot.joint_index(name).ok_or_else(|| {
            let known = format!("its joints are {}", self.robot.joint_names().join(", "));
            joint_error(&self.robot, name, "there is no such joint".into(), &known)
        })
    }

    /// Name of a drive, or of its joint if it has none.
    pub(crate) fn drive_name(&self, index: usize) -> &str {
        let Some(a) = self.actuators.get(index) else { return "" };
        let joint = self.robot.joints.get(a.joint).map_or("", |j| j.name.as_str());
        if a.name.is_empty() { joint } else { &a.name }
    }

    /// Whether the mass matrix at the reference position is positive definite.
    fn check_mass_matrix(&self) -> Result<()> {
        let plain = self.map(|x| x.value());
        let n = plain.dof();
        let state = plain.at_rest(&plain.robot.reference_position(), 0.0)?;
        let mut work = TreeWork::default();
        plain.kinematics(&state, 0.0, 0.0, &mut work);
        let mut m = vec![0.0; n * n];
        plain.mass_matrix(&work, &mut m);
        let whole: Vec<f64> = (0..n).map(|k| m[k * n + k]).collect();
        // Gaussian elimination from the last row up: what is left of a joint when those below it are free to move.
        for k in (0..n).rev() {
            let pivot = m[k * n + k];
            if !(pivot > SINGULAR * whole[k] && pivot > 0.0) {
                let base = plain.base_dof();
                let name = k.checked_sub(base).map_or("the free base", |j| plain.robot.joints[j].name.as_str());
                return Err(joint_error(
                    &plain.robot,
                    name,
                    format!("it moves no inertia ({:.3e}, and {pivot:.3e} if the joints beyond it give way)", whole[k]),
                    "give a link beyond it mass, or the joint armature",
                ));
            }
            for i in 0..k {
                let factor = m[i * n + k] / pivot;
                for j in 0..k {
                    m[i * n + j] -= factor * m[k * n + j];
                }
            }
        }
        Ok(())
    }
}

/// Whether some arrangement of masses has this inertia: symmetric, no negative principal moment, none above the sum of
/// the others. All zero is the inertia of a point.
fn exists(inertia: &Matrix3<f64>) -> bool {
    let slack = 1e-9 * inertia.norm();
    let moments = SymmetricEigen::new(*inertia).eigenvalues;
    (inertia - inertia.transpose()).amax() <= slack
        && moments.min() >= -slack
        && 2.0 * moments.max() <= moments.sum() * (1.0 + 1e-6) + slack
}
