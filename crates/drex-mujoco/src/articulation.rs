//! A robot as a tree of MuJoCo's bodies.

use drex_diffsim::{ActuatorKind, ActuatorParams, Articulation, ArticulationState, Base, Part, Scalar};
use drex_robot::JointKind;
use nalgebra::{Matrix3, Vector3};

use crate::geoms::Masks;
use crate::sections::{Sections, named, value_of};
use crate::text::{Attribute, list, vector};
use crate::{Error, Result};

/// Mass and inertia of a link that a joint moves and that has none: MuJoCo wants some.
const LEAST_MASS_KG: f64 = 1e-9;
const LEAST_INERTIA: f64 = 1e-13;

/// Number `index` of the articulations at `state`.
pub(crate) fn write<T: Scalar>(
    s: &mut Sections,
    index: usize,
    arm: &Articulation<f64>,
    state: &ArticulationState<T>,
    control: &[f64],
) -> Result<()> {
    arm.check_control(control)?;
    let robot = &arm.robot;
    let mut children = vec![Vec::new(); robot.links.len()];
    for (i, link) in robot.links.iter().enumerate() {
        if let Some(parent) = link.parent {
            children[parent].push(i);
        }
    }
    let tree = Tree { index, arm, children };
    let velocity = (&state.base.velocity, &state.base.angular_velocity);
    let (v, w) = (velocity.0.map(|x| x.value()), velocity.1.map(|x| x.value()));
    let pose = value_of(&state.base.world_from_base);
    let mut attributes = named(&tree.link_name(0), &pose);
    if matches!(arm.base, Base::Path(_)) {
        attributes.push(("gravcomp", "1".into()));
    }
    s.world.open("body", &attributes);
    match arm.base {
        Base::Fixed(_) => tree.inertia(s, 0, false),
        Base::Path(_) => {
            s.free_joint(&format!("arm_{index}"), &pose, &v, &w);
            s.prescribed_inertia();
        }
        Base::Free => {
            s.free_joint(&format!("arm_{index}"), &pose, &v, &w);
            tree.inertia(s, 0, true);
        }
        _ => return Err(unknown(format!("the base of robot \"{}\"", robot.name))),
    }
    tree.inside(s, 0, state)?;
    s.world.close();
    if arm.self_collision {
        tree.exclusions(s);
    }
    for (i, (a, &c)) in arm.actuators.iter().zip(control).enumerate() {
        tree.actuator(s, i, a)?;
        s.start.ctrl.push(c);
    }
    Ok(())
}

/// Name of a link or joint of articulation `arm`.
pub(crate) fn name_in(arm: usize, name: &str) -> String {
    format!("arm_{arm}/{name}")
}

fn unknown(what: String) -> Error {
    Error::Unsupported {
        what: format!("{what} is of a kind without counterpart in MuJoCo"),
        remedy: "give another kind".into(),
    }
}

struct Tree<'a> {
    index: usize,
    arm: &'a Articulation<f64>,
    children: Vec<Vec<usize>>,
}

impl Tree<'_> {
    fn link_name(&self, link: usize) -> String {
        name_in(self.index, &self.arm.robot.links[link].name)
    }

    /// Shapes of a link whose body is open, and the links that hang on it.
    fn inside<T: Scalar>(&self, s: &mut Sections, link: usize, state: &ArticulationState<T>) -> Result<()> {
        let part = Part::Link { articulation: self.index as u32, link: link as u32 };
        let masks = Masks::articulation(self.index, self.arm.self_collision);
        let (collider, material) = (&self.arm.colliders[link], &self.arm.materials[link]);
        s.geoms.write(&mut s.world, (part, &self.link_name(link)), collider, &Vector3::zeros(), material, masks)?;
        for &child in &self.children[link] {
            let it = &self.arm.robot.links[child];
            s.world.open("body", &named(&self.link_name(child), &it.parent_from_link));
            for &joint in &it.joints {
                self.joint(s, joint);
                s.start.qpos.push(state.q[joint].value());
                s.start.qvel.push(state.velocities[joint].value());
            }
            self.inertia(s, child, !it.joints.is_empty());
            self.inside(s, child, state)?;
            s.world.close();
        }
        Ok(())
    }

    fn inertia(&self, s: &mut Sections, link: usize, moved: bool) {
        let m = &self.arm.links[link];
        if m.mass_kg > 0.0 {
            s.inertial(m.mass_kg, &m.center_of_mass.coords, &m.inertia);
        } else if moved {
            s.inertial(LEAST_MASS_KG, &Vector3::zeros(), &(Matrix3::identity() * LEAST_INERTIA));
        }
    }

    fn joint(&self, s: &mut Sections, index: usize) {
        let (joint, p) = (&self.arm.robot.joints[index], &self.arm.joints[index]);
        let kind = if joint.kind == JointKind::Prismatic { "slide" } else { "hinge" };
        let mut attributes: Vec<Attribute> = vec![
            ("name", name_in(self.index, &joint.name)),
            ("type", kind.into()),
            ("axis", vector(&joint.axis)),
            ("pos", vector(&joint.anchor.coords)),
            ("ref", list(&[joint.reference])),
            ("armature", list(&[p.armature])),
            ("damping", list(&[p.damping])),
            ("frictionloss", list(&[p.friction_loss])),
        ];
        attributes.extend(p.limits.map(|(lo, hi)| ("range", list(&[lo, hi]))));
        s.world.leaf("joint", &attributes);
    }

    /// Pairs of links that must not touch, of those that have shapes.
    fn exclusions(&self, s: &mut Sections) {
        let robot = &self.arm.robot;
        let shaped: Vec<usize> =
            (0..robot.links.len()).filter(|&l| !self.arm.colliders[l].geoms().is_empty()).collect();
        for (k, &a) in shaped.iter().enumerate() {
            for &b in shaped[k + 1..].iter().filter(|&&b| !robot.may_collide(a, b)) {
                s.contact.leaf("exclude", &[("body1", self.link_name(a)), ("body2", self.link_name(b))]);
            }
        }
    }

    fn actuator(&self, s: &mut Sections, index: usize, a: &ActuatorParams<f64>) -> Result<()> {
        let (gain, bias) = match a.kind {
            ActuatorKind::Motor { gain } => (gain, [0.0; 3]),
            ActuatorKind::Position { kp, kv } => (kp, [0.0, -kp, -kv]),
            ActuatorKind::Velocity { kv } => (kv, [0.0, 0.0, -kv]),
            ActuatorKind::Affine { gain, bias } => (gain, bias),
            _ => return Err(unknown(format!("drive \"{}\"", a.name))),
        };
        let mut attributes = vec![
            ("name", name_in(self.index, &format!("drive_{index}"))),
            ("joint", name_in(self.index, &self.arm.robot.joints[a.joint].name)),
            ("gear", list(&[a.gear])),
            ("gaintype", "fixed".into()),
            ("gainprm", list(&[gain])),
            ("biastype", "affine".into()),
            ("biasprm", list(&bias)),
        ];
        attributes.extend(a.ctrl_range.map(|(lo, hi)| ("ctrlrange", list(&[lo, hi]))));
        attributes.extend(a.force_range.map(|(lo, hi)| ("forcerange", list(&[lo, hi]))));
        s.actuator.leaf("general", &attributes);
        Ok(())
    }
}
