//! URDF: links, joints, shapes. Read from the same XML layer as MJCF, so that errors name lines and attributes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use drex_core::{MassProperties, Pose, TriMesh};
use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion, Vector3};

use crate::model::{Geom, GeomRole, Joint, JointKind, Link, Mimic, Robot, Shape};
use crate::shape::is_finite;
use crate::unsupported::Unsupported;
use crate::xml::Node;
use crate::{Result, meshfile};

/// Density of a link that has shapes but no inertial, kg/m³ (that of water, as in MuJoCo).
const DEFAULT_DENSITY: f64 = 1000.0;

/// Reads a parsed file; meshes are looked for from the folder of `path`.
pub(crate) fn read(root: &Node, path: &Path) -> Result<Robot> {
    if root.tag != "robot" {
        return Err(root.error("this is no URDF model", "the root element must be <robot>"));
    }
    let mut reader = Reader {
        folder: path.parent().map(Path::to_path_buf).unwrap_or_default(),
        unsupported: Unsupported::default(),
        materials: BTreeMap::new(),
        meshes: BTreeMap::new(),
    };
    for child in &root.children {
        match child.tag.as_str() {
            "link" | "joint" => {}
            "material" => {
                reader.read_material(child)?;
            }
            _ => reader.unsupported.element(child),
        }
    }
    let tree = Tree::read(root)?;
    let mut links = Vec::with_capacity(tree.order.len());
    let mut joints: Vec<Joint> = Vec::new();
    let mut followers = Vec::new();
    for (index, &(node, parent, joint)) in tree.order.iter().enumerate() {
        let mut link = Link {
            name: node.require("name")?.to_owned(),
            parent,
            joints: Vec::new(),
            parent_from_link: joint.map_or(Ok(Pose::identity()), origin)?,
            inertial: None,
            geoms: Vec::new(),
        };
        reader.read_link(node, &mut link)?;
        if let Some(node) = joint
            && let Some(joint) = reader.read_joint(node, index)?
        {
            link.joints.push(joints.len());
            if let Some(mimic) = node.child("mimic") {
                followers.push((joints.len(), mimic));
            }
            joints.push(joint);
        }
        links.push(link);
    }
    let number_of: BTreeMap<String, usize> = joints.iter().zip(0..).map(|(j, k)| (j.name.clone(), k)).collect();
    for (follower, node) in followers {
        let name = node.require("joint")?;
        let Some(&lead) = number_of.get(name) else {
            return Err(node.fault("joint", "there is no such movable joint", "name a joint of the model"));
        };
        let a = node.with_defaults(None);
        joints[follower].mimic = Some(Mimic {
            joint: lead,
            multiplier: a.number("multiplier")?.unwrap_or(1.0),
            offset: a.number("offset")?.unwrap_or(0.0),
        });
    }
    Ok(Robot {
        name: root.get("name").unwrap_or("robot").to_owned(),
        links,
        joints,
        actuators: Vec::new(),
        excluded_pairs: Vec::new(),
        file_world_from_base: Pose::identity(),
        unsupported: reader.unsupported.sentences(),
    })
}

/// Links from the root down, each with its parent's index and the joint between them; siblings in file order.
struct Tree<'a> {
    order: Vec<(&'a Node, Option<usize>, Option<&'a Node>)>,
}

impl<'a> Tree<'a> {
    fn read(root: &'a Node) -> Result<Self> {
        let mut links: BTreeMap<&str, &Node> = BTreeMap::new();
        for node in root.children_called("link") {
            if links.insert(node.require("name")?, node).is_some() {
                return Err(node.fault("name", "two links have this name", "names of links are unique"));
            }
        }
        let mut names: BTreeMap<&str, ()> = BTreeMap::new();
        let mut joint_above: BTreeMap<&str, &Node> = BTreeMap::new();
        let mut joints_below: BTreeMap<&str, Vec<&Node>> = BTreeMap::new();
        for node in root.children_called("joint") {
            if names.insert(node.require("name")?, ()).is_some() {
                return Err(node.fault("name", "two joints have this name", "names of joints are unique"));
            }
            let end = |tag: &str| -> Result<&'a str> {
                let Some(child) = node.child(tag) else {
                    return Err(node.error(format!("the joint has no <{tag}>"), "add it"));
                };
                let name = child.require("link")?;
                if !links.contains_key(name) {
                    return Err(child.fault("link", "there is no such link", "name a link of the model"));
                }
                Ok(name)
            };
            let (parent, child) = (end("parent")?, end("child")?);
            if joint_above.insert(child, node).is_some() {
                return Err(node.error(format!("link \"{child}\" has two parents"), "links form a tree"));
            }
            joints_below.entry(parent).or_default().push(node);
        }
        let mut roots =
            root.children_called("link").filter(|l| l.get("name").is_some_and(|n| !joint_above.contains_key(n)));
        let Some(base) = roots.next() else {
            return Err(root.error("there is no link without a parent", "links form a tree with one root"));
        };
        if let Some(second) = roots.next() {
            return Err(second.error("a second link without a parent", "connect it by a joint"));
        }
        let mut tree = Self { order: Vec::with_capacity(links.len()) };
        let mut stack = vec![(base, None, None)];
        while let Some((node, parent, joint)) = stack.pop() {
            let index = tree.order.len();
            tree.order.push((node, parent, joint));
            let below = node.get("name").and_then(|n| joints_below.get(n));
            for &joint in below.into_iter().flatten().rev() {
                if let Some(&child) = joint.child("child").and_then(|c| c.get("link")).and_then(|n| links.get(n)) {
                    stack.push((child, Some(index), Some(joint)));
                }
            }
        }
        if tree.order.len() < links.len() {
            return Err(root.error("some joints form a circle", "links form a tree with one root"));
        }
        Ok(tree)
    }
}

struct Reader {
    folder: PathBuf,
    unsupported: Unsupported,
    materials: BTreeMap<String, [f32; 4]>,
    meshes: BTreeMap<String, Shape>,
}

impl Reader {
    fn read_material(&mut self, node: &Node) -> Result<Option<[f32; 4]>> {
        let own = match node.child("color") {
            Some(color) => color.with_defaults(None).numbers("rgba", 4..=4)?.map(|c| [0, 1, 2, 3].map(|k| c[k] as f32)),
            None => None,
        };
        let Some(name) = node.get("name") else { return Ok(own) };
        match own {
            Some(color) => {
                self.materials.entry(name.to_owned()).or_insert(color);
                Ok(own)
            }
            None => Ok(self.materials.get(name).copied()),
        }
    }

    fn read_link(&mut self, node: &Node, link: &mut Link) -> Result<()> {
        for child in &node.children {
            match child.tag.as_str() {
                "inertial" => link.inertial = read_inertial(child)?,
                "visual" | "collision" => link.geoms.extend(self.read_geom(child)?),
                _ => self.unsupported.element(child),
            }
        }
        if link.inertial.is_some_and(|m| !is_finite(&m)) {
            return Err(node.error("the inertia is not finite", "repair the model"));
        }
        let collides = |g: &&Geom| g.role == GeomRole::Collision;
        if link.inertial.is_none() && link.geoms.iter().any(|g| collides(&g)) {
            let parts: Vec<MassProperties> = link
                .geoms
                .iter()
                .filter(collides)
                .filter_map(|g| Some(g.shape.mass_properties(DEFAULT_DENSITY)?.transformed(&g.link_from_geom)))
                .collect();
            link.inertial = MassProperties::combined(&parts);
            self.unsupported.note(format!(
                "link \"{}\" has no mass: that of its collision shapes at {DEFAULT_DENSITY} kg/m³ is used",
                link.name
            ));
        }
        Ok(())
    }

    fn read_geom(&mut self, node: &Node) -> Result<Option<Geom>> {
        let role = if node.tag == "visual" { GeomRole::Visual } else { GeomRole::Collision };
        let Some(geometry) = node.child("geometry") else {
            return Err(node.error("the shape has no <geometry>", "add it"));
        };
        let Some(kind) = geometry.children.first() else {
            return Err(geometry.error("no shape inside", "use box, cylinder, capsule, sphere or mesh"));
        };
        let a = kind.with_defaults(None);
        let positive = |attribute: &str| -> Result<f64> {
            kind.require(attribute)?;
            a.number(attribute)?
                .filter(|v| *v > 0.0)
                .ok_or_else(|| a.fault(attribute, "not a positive number", "sizes are positive, in metres"))
        };
        let shape = match kind.tag.as_str() {
            "sphere" => Shape::Sphere { radius: positive("radius")? },
            "cylinder" => Shape::Cylinder { radius: positive("radius")?, half_length: positive("length")? / 2.0 },
            "capsule" => Shape::Capsule { radius: positive("radius")?, half_length: positive("length")? / 2.0 },
            "box" => {
                kind.require("size")?;
                let size = a.vector("size")?.unwrap_or_default();
                if size.min() <= 0.0 {
                    return Err(a.fault("size", "not three positive numbers", "sizes are positive, in metres"));
                }
                Shape::Box { half: size / 2.0 }
            }
            "mesh" => match self.read_mesh(kind) {
                Ok(shape) => shape,
                // What is only seen is not needed; what touches is.
                Err(e) if role == GeomRole::Visual => {
                    self.unsupported.missing_visual(&e);
                    return Ok(None);
                }
                Err(e) => return Err(e),
            },
            _ => return Err(kind.error("no shape that is read", "use box, cylinder, capsule, sphere or mesh")),
        };
        let rgba = match node.child("material") {
            Some(material) => self.read_material(material)?,
            None => None,
        };
        Ok(Some(Geom {
            name: node.get("name").map(str::to_owned),
            link_from_geom: origin(node)?,
            shape,
            role,
            friction: None,
            rgba,
        }))
    }

    fn read_mesh(&mut self, node: &Node) -> Result<Shape> {
        let scale = node.with_defaults(None).vector("scale")?.unwrap_or_else(|| Vector3::repeat(1.0));
        let name = node.require("filename")?;
        let key = format!("{name} {scale:?}");
        if let Some(shape) = self.meshes.get(&key) {
            return Ok(shape.clone());
        }
        let path = find_mesh(&self.folder, name).ok_or_else(|| {
            node.fault(
                "filename",
                format!("no such file from {} upwards", shown(&self.folder)),
                "put the mesh where the model names it",
            )
        })?;
        let mesh =
            TriMesh::read(&path).map_err(|e| node.fault("filename", e.to_string(), "repair or replace the file"))?;
        let shape = Shape::Mesh(Arc::new(meshfile::scaled(mesh, &scale)));
        self.meshes.insert(key, shape.clone());
        Ok(shape)
    }

    fn read_joint(&mut self, node: &Node, link: usize) -> Result<Option<Joint>> {
        let unlimited;
        let kind = match node.require("type")? {
            "fixed" => return Ok(None),
            "revolute" => {
                unlimited = false;
                JointKind::Revolute
            }
            "continuous" => {
                unlimited = true;
                JointKind::Revolute
            }
            "prismatic" => {
                unlimited = false;
                JointKind::Prismatic
            }
            "floating" | "planar" => {
                return Err(node.fault("type", "this type is not read", "use revolute, prismatic and fixed joints"));
            }
            _ => return Err(node.fault("type", "no type of joint", "use revolute, continuous, prismatic or fixed")),
        };
        let axis = match node.child("axis") {
            Some(child) => {
                let axis = child.with_defaults(None).vector("xyz")?.unwrap_or_else(Vector3::x);
                axis.try_normalize(1e-12)
                    .ok_or_else(|| child.fault("xyz", "an axis of length zero", "give a direction"))?
            }
            None => Vector3::x(),
        };
        let (mut limits, mut effort_limit, mut velocity_limit) = (None, None, None);
        match node.child("limit") {
            Some(child) => {
                let a = child.with_defaults(None);
                let (lo, hi) = (a.number("lower")?.unwrap_or(0.0), a.number("upper")?.unwrap_or(0.0));
                if !unlimited {
                    if lo > hi {
                        return Err(child.fault("lower", "the lower limit is above the upper one", "swap them"));
                    }
                    limits = Some((lo, hi));
                }
                effort_limit = a.number("effort")?;
                velocity_limit = a.number("velocity")?;
            }
            None if !unlimited => {
                return Err(node.error("the joint has no <limit>", "add it, or make the joint continuous"));
            }
            None => {}
        }
        let (mut damping, mut friction_loss) = (0.0, 0.0);
        if let Some(child) = node.child("dynamics") {
            let a = child.with_defaults(None);
            damping = a.number("damping")?.unwrap_or(0.0);
            friction_loss = a.number("friction")?.unwrap_or(0.0);
        }
        for child in &node.children {
            if !["origin", "parent", "child", "axis", "limit", "dynamics", "mimic"].contains(&child.tag.as_str()) {
                self.unsupported.element(child);
            }
        }
        Ok(Some(Joint {
            name: node.require("name")?.to_owned(),
            kind,
            link,
            axis,
            anchor: Point3::origin(),
            limits,
            reference: 0.0,
            armature: 0.0,
            damping,
            friction_loss,
            mimic: None,
            effort_limit,
            velocity_limit,
        }))
    }
}

/// The `<origin>` inside `node`: position, and roll, pitch, yaw about the fixed axes.
fn origin(node: &Node) -> Result<Pose> {
    let Some(origin) = node.child("origin") else { return Ok(Pose::identity()) };
    let a = origin.with_defaults(None);
    let xyz = a.vector("xyz")?.unwrap_or_default();
    let rpy = a.vector("rpy")?.unwrap_or_default();
    Ok(Pose::from_parts(Translation3::from(xyz), UnitQuaternion::from_euler_angles(rpy.x, rpy.y, rpy.z)))
}

fn read_inertial(node: &Node) -> Result<Option<MassProperties>> {
    let number = |tag: &str, attribute: &str| -> Result<f64> {
        Ok(match node.child(tag) {
            Some(child) => child.with_defaults(None).number(attribute)?.unwrap_or(0.0),
            None => 0.0,
        })
    };
    let mass_kg = number("mass", "value")?;
    if mass_kg < 0.0 {
        return Err(node.error("the mass is negative", "give a positive mass"));
    }
    let [xx, yy, zz, xy, xz, yz] = ["ixx", "iyy", "izz", "ixy", "ixz", "iyz"].map(|a| number("inertia", a));
    let (xx, yy, zz, xy, xz, yz) = (xx?, yy?, zz?, xy?, xz?, yz?);
    let local = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    let pose = origin(node)?;
    let r = pose.rotation.to_rotation_matrix();
    Ok((mass_kg > 0.0).then(|| MassProperties {
        mass_kg,
        center_of_mass: Point3::from(pose.translation.vector),
        inertia: r.matrix() * local * r.matrix().transpose(),
    }))
}

/// The file that a mesh name means. A `package://` name is tried whole and then without its leading folders, from the
/// model's folder upwards: that finds the mesh in a ROS workspace and in a folder copied out of one.
fn find_mesh(folder: &Path, name: &str) -> Option<PathBuf> {
    let plain = name.strip_prefix("file://").unwrap_or(name);
    let Some(package) = name.strip_prefix("package://").or_else(|| name.strip_prefix("model://")) else {
        return Some(folder.join(plain)).filter(|p| p.is_file());
    };
    let parts: Vec<&str> = package.split('/').filter(|p| !p.is_empty() && *p != "..").collect();
    let folders: Vec<PathBuf> = folder
        .canonicalize()
        .unwrap_or_else(|_| folder.to_path_buf())
        .ancestors()
        .take(8)
        .map(Path::to_path_buf)
        .collect();
    (0..parts.len()).find_map(|skip| folders.iter().map(|f| f.join(parts[skip..].join("/"))).find(|p| p.is_file()))
}

fn shown(folder: &Path) -> String {
    if folder.as_os_str().is_empty() { "the current folder".into() } else { folder.display().to_string() }
}
