//! The robot model: links in a tree, joints between them, shapes on them, actuators behind them.

use std::sync::Arc;

use drex_core::{MassProperties, Pose, TriMesh};
use nalgebra::{Point3, Vector3};

use crate::{Error, Result};

/// A robot as a tree of rigid links.
///
/// `links[0]` is the base; its pose in the world is the caller's to choose (`world_from_base`). A parent comes
/// before its children. One joint coordinate per entry of `joints`, in that order: rad for revolute joints, m for
/// prismatic ones. Joints that a file couples (URDF `mimic`, MJCF `equality`) are coordinates of their own.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Robot {
    /// Name that the file gives the model.
    pub name: String,
    /// Links, parents first.
    pub links: Vec<Link>,
    /// Joints, in the order of the links that they move.
    pub joints: Vec<Joint>,
    /// Actuators in file order.
    pub actuators: Vec<Actuator>,
    /// Pairs of links that must not be checked for collision with each other, smaller index first.
    pub excluded_pairs: Vec<(usize, usize)>,
    /// Pose of the base that the file itself gives (identity for URDF).
    pub file_world_from_base: Pose,
    /// What the file has and this reader does not use, one sentence each, for the user to see.
    pub unsupported: Vec<String>,
}

/// A rigid link.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Link {
    /// Name, unique in the model.
    pub name: String,
    /// Index of the parent link; `None` for the base only.
    pub parent: Option<usize>,
    /// The joint that moves this link against its parent: none (rigidly attached) or one. A body with several
    /// joints in MJCF becomes a chain of links of which the last keeps the name.
    pub joints: Vec<usize>,
    /// Pose of the link in its parent while its joint is at its reference position.
    pub parent_from_link: Pose,
    /// Mass, centre of mass and inertia in the link frame; `None` for a link without mass.
    pub inertial: Option<MassProperties>,
    /// Shapes fixed to the link.
    pub geoms: Vec<Geom>,
}

/// How a joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum JointKind {
    /// Turns about its axis; coordinate in rad.
    Revolute,
    /// Slides along its axis; coordinate in m.
    Prismatic,
}

/// A joint with one coordinate. Units: rad, N m, rad/s for revolute joints, m, N, m/s for prismatic ones.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Joint {
    /// Name, unique in the model.
    pub name: String,
    /// How it moves.
    pub kind: JointKind,
    /// The link that it moves against that link's parent.
    pub link: usize,
    /// Unit axis in the link frame.
    pub axis: Vector3<f64>,
    /// A point on the axis in the link frame, m.
    pub anchor: Point3<f64>,
    /// Lowest and highest coordinate; `None` without limits.
    pub limits: Option<(f64, f64)>,
    /// Coordinate at which the link stands at `parent_from_link` (MJCF `ref`; 0 in URDF).
    pub reference: f64,
    /// Inertia added by the drive, kg m² (kg for prismatic joints).
    pub armature: f64,
    /// Viscous damping, N m s/rad (N s/m).
    pub damping: f64,
    /// Dry friction, N m (N).
    pub friction_loss: f64,
    /// The joint that this one should follow, if the file says so.
    pub mimic: Option<Mimic>,
    /// Largest effort of the drive, N m (N).
    pub effort_limit: Option<f64>,
    /// Largest speed of the drive, rad/s (m/s).
    pub velocity_limit: Option<f64>,
}

/// A coupling: coordinate = multiplier · (coordinate of `joint`) + offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mimic {
    /// Index of the leading joint.
    pub joint: usize,
    /// Factor.
    pub multiplier: f64,
    /// Added constant, rad (m).
    pub offset: f64,
}

/// What a shape is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum GeomRole {
    /// Touches other bodies, is not drawn.
    Collision,
    /// Is drawn, touches nothing.
    Visual,
    /// Is drawn and touches other bodies.
    Both,
}

/// A shape fixed to a link.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Geom {
    /// Name in the file.
    pub name: Option<String>,
    /// Pose of the shape's frame in the link. A mesh keeps the frame of its file.
    pub link_from_geom: Pose,
    /// The shape, in its own frame.
    pub shape: Shape,
    /// What it is for.
    pub role: GeomRole,
    /// Coefficient of sliding friction; `None` where the format has none (URDF).
    pub friction: Option<f64>,
    /// Colour, red green blue alpha in 0..=1.
    pub rgba: Option<[f32; 4]>,
}

/// A shape in its own frame, metres.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Shape {
    /// A ball about the origin.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// A cylinder along z with half balls on both ends.
    Capsule {
        /// Radius.
        radius: f64,
        /// Half the length of the cylindrical part.
        half_length: f64,
    },
    /// A cylinder along z.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Half the height.
        half_length: f64,
    },
    /// A box along the axes.
    Box {
        /// Half extents.
        half: Vector3<f64>,
    },
    /// An ellipsoid along the axes.
    Ellipsoid {
        /// Radii along x, y, z.
        radii: Vector3<f64>,
    },
    /// A triangle mesh, scale applied.
    Mesh(Arc<TriMesh>),
    /// The plane z = 0 with its outside at z > 0.
    Plane,
}

/// What an actuator does with its control.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum ActuatorKind {
    /// effort = gain · control.
    Motor {
        /// Factor.
        gain: f64,
    },
    /// effort = kp · (control − position) − kv · velocity.
    Position {
        /// Stiffness.
        kp: f64,
        /// Damping.
        kv: f64,
    },
    /// effort = kv · (control − velocity).
    Velocity {
        /// Damping.
        kv: f64,
    },
    /// effort = gain · control + b₀ + b₁ · position + b₂ · velocity.
    Affine {
        /// Factor of the control.
        gain: f64,
        /// b₀, b₁, b₂.
        bias: [f64; 3],
    },
}

/// A drive on one joint. Position and velocity of the drive are `gear` times those of the joint, the joint's effort
/// is `gear` times that of the drive.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Actuator {
    /// Name; empty if the file gives none.
    pub name: String,
    /// Index of the joint.
    pub joint: usize,
    /// What it does.
    pub kind: ActuatorKind,
    /// Lowest and highest effort before the gear, N m (N).
    pub force_range: Option<(f64, f64)>,
    /// Lowest and highest control.
    pub ctrl_range: Option<(f64, f64)>,
    /// Ratio.
    pub gear: f64,
}

impl Robot {
    /// Number of joint coordinates.
    pub fn dof(&self) -> usize {
        self.joints.len()
    }

    /// Index of the joint called `name`.
    pub fn joint_index(&self, name: &str) -> Option<usize> {
        self.joints.iter().position(|j| j.name == name)
    }

    /// Index of the link called `name`.
    pub fn link_index(&self, name: &str) -> Option<usize> {
        self.links.iter().position(|l| l.name == name)
    }

    /// Joint names in the order of the joint vector.
    pub fn joint_names(&self) -> Vec<&str> {
        self.joints.iter().map(|j| j.name.as_str()).collect()
    }

    /// [`Robot::joint_index`] with an error that tells the user which names there are.
    ///
    /// # Errors
    /// If the model has no such joint.
    pub fn require_joint(&self, name: &str) -> Result<usize> {
        self.joint_index(name).ok_or_else(|| Error::UnknownJoint {
            robot: self.name.clone(),
            joint: name.into(),
            known: self.joint_names().join(", "),
        })
    }

    /// [`Robot::link_index`] with an error that tells the user which names there are.
    ///
    /// # Errors
    /// If the model has no such link.
    pub fn require_link(&self, name: &str) -> Result<usize> {
        self.link_index(name).ok_or_else(|| Error::UnknownLink {
            robot: self.name.clone(),
            link: name.into(),
            known: self.links.iter().map(|l| l.name.as_str()).collect::<Vec<_>>().join(", "),
        })
    }

    /// The joint vector from values by name; joints that are not named stay at their reference position.
    ///
    /// # Errors
    /// If a name is not in the model or is given twice, or a value is not finite.
    pub fn joint_vector<S: AsRef<str>>(&self, named: impl IntoIterator<Item = (S, f64)>) -> Result<Vec<f64>> {
        let mut q = self.reference_position();
        let mut seen = vec![false; q.len()];
        for (name, value) in named {
            let name = name.as_ref();
            let i = self.require_joint(name)?;
            if seen[i] {
                return Err(Error::value(format!("joint \"{name}\" is given twice"), "give each joint once"));
            }
            if !value.is_finite() {
                return Err(Error::value(format!("the value of joint \"{name}\" is not finite"), "repair the record"));
            }
            seen[i] = true;
            q[i] = value;
        }
        Ok(q)
    }

    /// The joint vector of a table row: `names[i]` has `values[i]`. Every joint of the model must be there.
    ///
    /// # Errors
    /// As [`Robot::joint_vector`], and if a joint is missing or there are not as many names as values.
    pub fn joint_vector_full<S: AsRef<str>>(&self, names: &[S], values: &[f64]) -> Result<Vec<f64>> {
        if names.len() != values.len() {
            return Err(Error::value(
                format!("{} joint names but {} values", names.len(), values.len()),
                "give one value per joint",
            ));
        }
        // A name that the model does not have explains better what is wrong than the one that is missing for it.
        let q = self.joint_vector(names.iter().map(AsRef::as_ref).zip(values.iter().copied()))?;
        if let Some(j) = self.joints.iter().find(|j| !names.iter().any(|n| n.as_ref() == j.name)) {
            return Err(Error::value(
                format!("robot \"{}\" has a joint \"{}\" that the data does not name", self.name, j.name),
                "give every joint of the model, or name the order of the columns",
            ));
        }
        Ok(q)
    }

    /// Every joint at its reference position (0 unless the file says otherwise), whether within limits or not.
    pub fn reference_position(&self) -> Vec<f64> {
        self.joints.iter().map(|j| j.reference).collect()
    }

    /// Every joint in the middle of its range; joints without limits at their reference position.
    pub fn mid_range(&self) -> Vec<f64> {
        self.joints.iter().map(|j| j.limits.map_or(j.reference, |(lo, hi)| 0.5 * (lo + hi))).collect()
    }

    /// Moves every coordinate of `q` into its joint's limits; returns how many had to move.
    pub fn clamp_to_limits(&self, q: &mut [f64]) -> usize {
        let mut moved = 0;
        for (joint, value) in self.joints.iter().zip(q) {
            if let Some((lo, hi)) = joint.limits {
                let inside = value.max(lo).min(hi);
                moved += usize::from(inside != *value);
                *value = inside;
            }
        }
        moved
    }

    /// Sets every joint that follows another (URDF `mimic`) to what it should be.
    pub fn apply_mimic(&self, q: &mut [f64]) {
        for (i, joint) in self.joints.iter().enumerate() {
            if let Some(m) = joint.mimic
                && let Some(&lead) = q.get(m.joint)
                && let Some(value) = q.get_mut(i)
            {
                *value = m.multiplier * lead + m.offset;
            }
        }
    }

    /// The shapes that touch other bodies, with the index of their link.
    pub fn collision_geoms(&self) -> impl Iterator<Item = (usize, &Geom)> {
        self.links.iter().enumerate().flat_map(|(i, l)| l.geoms.iter().filter(|g| g.collides()).map(move |g| (i, g)))
    }

    /// Mass of all links, kg.
    pub fn total_mass_kg(&self) -> f64 {
        self.links.iter().filter_map(|l| l.inertial.as_ref()).map(|m| m.mass_kg).sum()
    }

    /// Indices of the links from the base to `link`, both included.
    pub fn path_to(&self, link: usize) -> Vec<usize> {
        let mut path = vec![link];
        let mut at = link;
        while let Some(parent) = self.links.get(at).and_then(|l| l.parent) {
            path.push(parent);
            at = parent;
        }
        path.reverse();
        path
    }

    /// Whether a collision between the two links counts: not the same link, not parent and child, not excluded by the
    /// file. Links that are rigidly attached to one another count as one; links without shapes between two others, such
    /// as those between the joints of one body, do not separate them.
    pub fn may_collide(&self, a: usize, b: usize) -> bool {
        let (ra, rb) = (self.rigid_root(a), self.rigid_root(b));
        ra != rb
            && self.shaped_parent(ra) != Some(rb)
            && self.shaped_parent(rb) != Some(ra)
            && !self.excluded_pairs.contains(&(a.min(b), a.max(b)))
    }

    /// The next rigid group with shapes up the tree from the group that begins with `root`; the base at the latest.
    fn shaped_parent(&self, root: usize) -> Option<usize> {
        let mut at = self.rigid_root(self.links[root].parent?);
        while let Some(above) = self.links[at].parent
            && !(at..self.links.len()).any(|l| !self.links[l].geoms.is_empty() && self.rigid_root(l) == at)
        {
            at = self.rigid_root(above);
        }
        Some(at)
    }

    /// The first link up the tree that a joint moves (or the base).
    fn rigid_root(&self, mut link: usize) -> usize {
        while self.links[link].joints.is_empty()
            && let Some(parent) = self.links[link].parent
        {
            link = parent;
        }
        link
    }
}

impl Geom {
    /// Whether the shape touches other bodies.
    pub fn collides(&self) -> bool {
        self.role != GeomRole::Visual
    }
}
