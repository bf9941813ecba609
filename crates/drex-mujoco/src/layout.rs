//! Where what is ours lies in MuJoCo's arrays.

use drex_diffsim::{Base, Model, Part, Scene};
use mujoco_rs::wrappers::{MjModel, MjtObjBase};

use crate::articulation::name_in;
use crate::{Error, Result};

/// A body with a free joint.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FreeSlots {
    pub body: usize,
    /// First of seven coordinates and of six velocities.
    pub qpos: usize,
    pub qvel: usize,
}

/// An articulation.
#[derive(Debug, Clone)]
pub(crate) struct ArticulationSlots {
    /// Its base, unless that is fixed.
    pub base: Option<FreeSlots>,
    /// Coordinate and velocity of each joint.
    pub joints: Vec<(usize, usize)>,
    /// Body of each link.
    pub links: Vec<usize>,
    /// First of its controls.
    pub ctrl: usize,
}

/// Everything.
#[derive(Debug)]
pub(crate) struct Layout {
    pub bodies: Vec<FreeSlots>,
    pub kinematic_bodies: Vec<FreeSlots>,
    pub articulations: Vec<ArticulationSlots>,
    /// Part and index in its collider of every geom.
    pub owners: Vec<(Part, u16)>,
}

impl Layout {
    pub fn new(
        compiled: &MjModel,
        model: &Model<f64>,
        scene: &Scene<f64>,
        owners: Vec<(String, Part, u16)>,
    ) -> Result<Self> {
        let many = |prefix: &str, n: usize| -> Result<Vec<FreeSlots>> {
            (0..n).map(|i| format!("{prefix}_{i}")).map(|name| free(compiled, &name, &name)).collect()
        };
        let mut articulations = Vec::with_capacity(model.articulations.len());
        let mut ctrl = 0;
        for (i, arm) in model.articulations.iter().enumerate() {
            let link = |name: &str| id(compiled, MjtObjBase::mjOBJ_BODY, &name_in(i, name));
            let joint = |name: &str| -> Result<(usize, usize)> {
                let joint = id(compiled, MjtObjBase::mjOBJ_JOINT, &name_in(i, name))?;
                Ok((at(compiled.jnt_qposadr(), joint), at(compiled.jnt_dofadr(), joint)))
            };
            let base = match (&arm.base, arm.robot.links.first()) {
                (Base::Fixed(_), _) | (_, None) => None,
                (_, Some(first)) => Some(free(compiled, &format!("arm_{i}"), &name_in(i, &first.name))?),
            };
            articulations.push(ArticulationSlots {
                base,
                joints: arm.robot.joints.iter().map(|j| joint(&j.name)).collect::<Result<_>>()?,
                links: arm.robot.links.iter().map(|l| link(&l.name)).collect::<Result<_>>()?,
                ctrl,
            });
            ctrl += arm.actuators.len();
        }
        let mut by_geom = vec![(Part::Static(0), 0); owners.len()];
        for (name, part, k) in owners {
            let geom = id(compiled, MjtObjBase::mjOBJ_GEOM, &name)?;
            if let Some(slot) = by_geom.get_mut(geom) {
                *slot = (part, k);
            }
        }
        let (bodies, kinematic_bodies) =
            (many("body", model.bodies.len())?, many("mover", scene.kinematic_bodies.len())?);
        Ok(Self { bodies, kinematic_bodies, articulations, owners: by_geom })
    }

    /// What a velocity of MuJoCo belongs to.
    pub fn name_of_velocity(&self, index: usize) -> String {
        let free = |s: &FreeSlots| (s.qvel..s.qvel + 6).contains(&index);
        if let Some(i) = self.bodies.iter().position(free) {
            return format!("body {i}");
        }
        if let Some(i) = self.kinematic_bodies.iter().position(free) {
            return format!("kinematic body {i}");
        }
        let index =
            self.articulations.iter().position(|a| a.base.iter().any(free) || a.joints.iter().any(|j| j.1 == index));
        index.map_or_else(|| "the model".into(), |i| format!("articulation {i}"))
    }
}

fn free(compiled: &MjModel, joint: &str, body: &str) -> Result<FreeSlots> {
    let joint = id(compiled, MjtObjBase::mjOBJ_JOINT, joint)?;
    Ok(FreeSlots {
        body: id(compiled, MjtObjBase::mjOBJ_BODY, body)?,
        qpos: at(compiled.jnt_qposadr(), joint),
        qvel: at(compiled.jnt_dofadr(), joint),
    })
}

fn at(addresses: &[i32], joint: usize) -> usize {
    addresses.get(joint).and_then(|&a| usize::try_from(a).ok()).unwrap_or(0)
}

fn id(compiled: &MjModel, kind: MjtObjBase, name: &str) -> Result<usize> {
    compiled.name_to_id(kind, name).ok_or_else(|| Error::Unsupported {
        what: format!("MuJoCo's model has no {name}"),
        remedy: "give links and joints names without control characters".into(),
    })
}
