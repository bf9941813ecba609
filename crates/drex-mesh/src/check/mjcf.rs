//! The part of an MJCF file that the rules ask about.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use drex_core::{MassProperties, Pose, PrimitiveShape};
use nalgebra::{Matrix3, Point3, Quaternion, UnitQuaternion, Vector3};
use roxmltree::Node;

use crate::Result;

/// Objects of an MJCF file: the bodies under free joints (or all with meshes, if none is free).
#[derive(Debug, Default)]
pub(super) struct Mjcf {
    pub meshes: BTreeMap<String, MeshFile>,
    pub bodies: Vec<Body>,
    pub geoms: Vec<Geom>,
    /// Files of meshes, textures and includes as they are written, with the folder they are looked up in.
    pub files: Vec<(String, PathBuf)>,
    /// Names that occur twice among elements of one kind.
    pub repeated: Vec<String>,
    /// What this reader does not understand and a rule would need.
    pub unclear: Vec<String>,
}

#[derive(Debug)]
pub(super) struct MeshFile {
    pub path: PathBuf,
    pub scale: Vector3<f64>,
}

#[derive(Debug)]
pub(super) struct Body {
    pub name: String,
    pub world_from_body: Pose,
    pub inertial: Option<MassProperties>,
    /// Whether it hangs under a free joint.
    pub free: bool,
}

#[derive(Debug)]
pub(super) struct Geom {
    /// Position in [`Mjcf::bodies`].
    pub body: usize,
    /// Name of its mesh, if it has no shape of its own.
    pub mesh: String,
    pub shape: Option<PrimitiveShape>,
    pub collides: bool,
    pub body_from_geom: Pose,
}

/// Attributes of geoms per default class, those of the parents included.
type Classes<'a> = BTreeMap<String, BTreeMap<&'a str, &'a str>>;

struct Walk<'a> {
    path: &'a Path,
    degrees: bool,
    classes: Classes<'a>,
    out: Mjcf,
}

pub(super) fn parse(path: &Path, text: &str) -> Result<Mjcf> {
    let bad = |line: Option<usize>, what: String| {
        drex_core::Error::content(path, line, what, "check that this is an MJCF file")
    };
    let document = roxmltree::Document::parse(text).map_err(|e| bad(Some(e.pos().row as usize), e.to_string()))?;
    let root = document.root_element();
    if root.tag_name().name() != "mujoco" {
        return Err(bad(Some(1), format!("the root is <{}>, not <mujoco>", root.tag_name().name())).into());
    }
    let compiler = |name: &str| {
        root.children().filter(|n| n.has_tag_name("compiler")).find_map(|n| n.attribute(name).map(str::to_string))
    };
    let folder = path.parent().unwrap_or_else(|| Path::new(""));
    let of = |name: &str| folder.join(compiler(name).or_else(|| compiler("assetdir")).unwrap_or_default());
    let degrees = compiler("angle").is_none_or(|a| a == "degree");
    let mut walk = Walk { path, degrees, classes: Classes::new(), out: Mjcf::default() };
    for n in root.children().filter(|n| n.has_tag_name("default")) {
        walk.defaults(n, None);
    }
    for asset in root.children().filter(|n| n.has_tag_name("asset")).flat_map(|n| n.children()) {
        let Some(file) = asset.attribute("file") else { continue };
        match asset.tag_name().name() {
            "mesh" => {
                let at = of("meshdir").join(file);
                let stem = Path::new(file).file_stem().map(|s| s.to_string_lossy().into_owned());
                let name = asset.attribute("name").map(str::to_string).or(stem).unwrap_or_default();
                let scale = walk.numbers::<3>(asset, "scale")?.unwrap_or([1.0; 3]);
                walk.out.files.push((file.into(), of("meshdir")));
                walk.out.meshes.insert(name, MeshFile { path: at, scale: scale.into() });
            }
            "texture" => walk.out.files.push((file.into(), of("texturedir"))),
            _ => {}
        }
    }
    for include in root.descendants().filter(|n| n.has_tag_name("include")) {
        walk.out.files.push((include.attribute("file").unwrap_or_default().into(), folder.to_path_buf()));
    }
    for world in root.children().filter(|n| n.has_tag_name("worldbody")) {
        walk.body(world, None, &Pose::identity(), "main", false)?;
    }
    let mut out = walk.out;
    if out.bodies.iter().any(|b| b.free) {
        out.geoms.retain(|g| out.bodies[g.body].free);
    }
    out.repeated = repeated(root);
    Ok(out)
}

/// The primitive of a geom's type and size; `None` for planes, for fields of heights and for what has too few sizes.
fn shape(kind: &str, size: &[f64]) -> Option<PrimitiveShape> {
    match (kind, size) {
        ("sphere", &[radius_m, ..]) => Some(PrimitiveShape::Sphere { radius_m }),
        ("capsule", &[radius_m, half_length_m, ..]) => Some(PrimitiveShape::Capsule { radius_m, half_length_m }),
        ("cylinder", &[radius_m, half_length_m, ..]) => Some(PrimitiveShape::Cylinder { radius_m, half_length_m }),
        ("box", &[x, y, z]) => Some(PrimitiveShape::Box { half_m: [x, y, z] }),
        _ => None,
    }
}

/// Names that occur twice among elements with the same tag.
fn repeated(root: Node<'_, '_>) -> Vec<String> {
    let mut seen = BTreeMap::new();
    for n in root.descendants().filter(|n| n.is_element()) {
        // Joints of both kinds share one list of names; references in other sections are no definitions.
        let kind = n.tag_name().name().replace("freejoint", "joint");
        let defines = matches!(
            kind.as_str(),
            "body" | "geom" | "joint" | "site" | "camera" | "light" | "mesh" | "material" | "texture"
        );
        if let Some(name) = n.attribute("name").filter(|_| defines) {
            *seen.entry(format!("{kind} {name:?}")).or_insert(0) += 1;
        }
    }
    seen.into_iter().filter(|(_, n)| *n > 1).map(|(name, _)| name).collect()
}

impl<'a> Walk<'a> {
    fn defaults(&mut self, node: Node<'a, '_>, parent: Option<&str>) {
        let name = node.attribute("class").unwrap_or("main").to_string();
        let mut attributes = parent.and_then(|p| self.classes.get(p)).cloned().unwrap_or_default();
        for geom in node.children().filter(|n| n.has_tag_name("geom")) {
            attributes.extend(geom.attributes().map(|a| (a.name(), a.value())));
        }
        self.classes.insert(name.clone(), attributes);
        for child in node.children().filter(|n| n.has_tag_name("default")) {
            self.defaults(child, Some(&name));
        }
    }

    /// A body and what hangs on it; `free` is inherited.
    fn body(&mut self, node: Node<'a, '_>, index: Option<usize>, world: &Pose, class: &str, free: bool) -> Result<()> {
        for child in node.children().filter(Node::is_element) {
            match child.tag_name().name() {
                "body" => {
                    let class = child.attribute("childclass").unwrap_or(class);
                    let world_from_body = world * self.pose(child)?;
                    let own = child.children().any(|n| {
                        n.has_tag_name("freejoint") || (n.has_tag_name("joint") && n.attribute("type") == Some("free"))
                    });
                    let inertial = match child.children().find(|n| n.has_tag_name("inertial")) {
                        Some(n) => self.inertial(n)?,
                        None => None,
                    };
                    let name = child.attribute("name").unwrap_or("unnamed").to_string();
                    self.out.bodies.push(Body { name, world_from_body, inertial, free: free || own });
                    let index = self.out.bodies.len() - 1;
                    self.body(child, Some(index), &world_from_body, class, free || own)?;
                }
                "frame" => {
                    let class = child.attribute("childclass").unwrap_or(class);
                    self.out.unclear.push("a <frame> element".into());
                    self.body(child, index, world, class, free)?;
                }
                "geom" => {
                    let class = child.attribute("class").unwrap_or(class);
                    let default = self.classes.get(class).cloned().unwrap_or_default();
                    let value = |name: &str| child.attribute(name).or_else(|| default.get(name).copied());
                    let size = value("size").map(|text| self.list(child, "size", text)).transpose()?;
                    // A class of meshes has a type too; a size of its own makes a primitive.
                    let shape = child.attribute("type").and_then(|kind| shape(kind, &size.unwrap_or_default()));
                    let mesh = value("mesh").filter(|_| shape.is_none());
                    let Some(body) = index.filter(|_| mesh.is_some() || shape.is_some()) else { continue };
                    let mesh = mesh.unwrap_or_default();
                    let mask = |name: &str| value(name).is_none_or(|v| v.trim() != "0");
                    let collides = mask("contype") || mask("conaffinity");
                    let body_from_geom = self.pose(child)?;
                    self.out.geoms.push(Geom { body, mesh: mesh.into(), shape, collides, body_from_geom });
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn pose(&mut self, node: Node<'_, '_>) -> Result<Pose> {
        let t = self.numbers::<3>(node, "pos")?.unwrap_or_default();
        let q = match (self.numbers::<4>(node, "quat")?, self.numbers::<4>(node, "axisangle")?) {
            (Some([w, x, y, z]), _) => UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9)
                .ok_or_else(|| self.bad(node, "quat is zero"))?,
            (None, Some([x, y, z, angle])) => {
                let axis = nalgebra::Unit::try_new(Vector3::new(x, y, z), 1e-9);
                let axis = axis.ok_or_else(|| self.bad(node, "the axis is zero"))?;
                UnitQuaternion::from_axis_angle(&axis, if self.degrees { angle.to_radians() } else { angle })
            }
            (None, None) => UnitQuaternion::identity(),
        };
        for name in ["euler", "xyaxes", "zaxis"].iter().filter(|n| node.has_attribute(**n)) {
            self.out.unclear.push(format!("an orientation given as {name}"));
        }
        Ok(Pose::from_parts(Vector3::from(t).into(), q))
    }

    fn inertial(&mut self, node: Node<'_, '_>) -> Result<Option<MassProperties>> {
        let Some([mass_kg]) = self.numbers::<1>(node, "mass")? else { return Ok(None) };
        let pose = self.pose(node)?;
        let center_of_mass = Point3::from(pose.translation.vector);
        let own = match (self.numbers::<6>(node, "fullinertia")?, self.numbers::<3>(node, "diaginertia")?) {
            (Some([xx, yy, zz, xy, xz, yz]), _) => Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
            (None, Some(d)) => Matrix3::from_diagonal(&Vector3::from(d)),
            (None, None) => return Ok(None),
        };
        let r = pose.rotation.to_rotation_matrix();
        let inertia = r.matrix() * own * r.matrix().transpose();
        Ok(Some(MassProperties { mass_kg, center_of_mass, inertia }))
    }

    fn numbers<const N: usize>(&self, node: Node<'_, '_>, name: &str) -> Result<Option<[f64; N]>> {
        let Some(text) = node.attribute(name) else { return Ok(None) };
        match self.list(node, name, text)?.try_into() {
            Ok(array) => Ok(Some(array)),
            Err(_) => Err(self.bad(node, &format!("{name}=\"{text}\" is not {N} numbers"))),
        }
    }

    fn list(&self, node: Node<'_, '_>, name: &str, text: &str) -> Result<Vec<f64>> {
        let values: Option<Vec<f64>> =
            text.split_ascii_whitespace().map(|w| w.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        values.ok_or_else(|| self.bad(node, &format!("{name}=\"{text}\" is no list of numbers")))
    }

    fn bad(&self, node: Node<'_, '_>, what: &str) -> crate::Error {
        let line = node.document().text_pos_at(node.range().start).row as usize;
        drex_core::Error::content(self.path, line, what, "correct the model").into()
    }
}
