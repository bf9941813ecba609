//! Shapes on bodies and the mass that they carry.

use drex_core::{MassProperties, Pose};
use nalgebra::{Translation3, Vector3};

use crate::Result;
use crate::model::{Geom, GeomRole, Shape};
use crate::xml::{Attributes, Node};

use super::Builder;
use super::compiler::rotation_to_z;

/// MuJoCo's density where the file gives neither mass nor density, kg/m³ (that of water).
const DEFAULT_DENSITY: f64 = 1000.0;
/// MuJoCo draws groups 0 to 2 unless told otherwise.
const LAST_DRAWN_GROUP: i64 = 2;

/// A shape as read, with what is needed to give its body a mass.
pub(super) struct ReadGeom {
    pub geom: Geom,
    pub group: i64,
    mass_kg: Option<f64>,
    density: f64,
    mesh: Option<String>,
    title: String,
    line: u32,
}

impl Builder {
    /// Reads a shape whose file coordinates are those of `frame`, given in the body. `None` for one that is left out.
    pub(super) fn read_geom(
        &mut self,
        node: &Node,
        frame: &Pose,
        childclass: Option<&str>,
    ) -> Result<Option<ReadGeom>> {
        let a = self.defaults.resolve(node, childclass)?;
        let touches = a.number("contype")?.unwrap_or(1.0) != 0.0 || a.number("conaffinity")?.unwrap_or(1.0) != 0.0;
        let group = a.number("group")?.unwrap_or(0.0) as i64;
        let role = match (touches, group <= LAST_DRAWN_GROUP) {
            (false, _) => GeomRole::Visual,
            (true, true) => GeomRole::Both,
            (true, false) => GeomRole::Collision,
        };
        let mesh = a.get("mesh").map(str::to_owned);
        let colour = match (a.numbers("rgba", 4..=4)?, a.get("material")) {
            (Some(c), _) => Some([0, 1, 2, 3].map(|k| c[k] as f32)),
            (None, Some(material)) => self.assets.material(material),
            (None, None) => None,
        };
        let friction = a.numbers("friction", 1..=3)?.map_or(1.0, |f| f[0]);
        let (mass_kg, density) = (a.number("mass")?, a.number("density")?.unwrap_or(DEFAULT_DENSITY));
        if mass_kg.is_some_and(|m| m < 0.0) || density < 0.0 {
            return Err(node.error("negative mass or density", "give positive numbers"));
        }
        let mut pose = self.compiler.pose(&a)?;
        let shape = match a.get("type").unwrap_or("sphere") {
            "mesh" | "sdf" => None,
            // A primitive that is to be fitted to a mesh: the mesh itself says more.
            _ if mesh.is_some() => {
                self.unsupported.note(format!(
                    "primitive shapes are not fitted to meshes (line {}): the mesh is used itself",
                    node.line
                ));
                None
            }
            kind => Some(primitive(kind, &a, &mut pose)?),
        };
        let shape = match (shape, &mesh) {
            (Some(Some(shape)), _) => shape,
            (Some(None), _) => {
                self.unsupported.note(format!("<{}> (line {}): height fields are not read", node.title(), node.line));
                return Ok(None);
            }
            (None, None) => return Err(node.error("a mesh geom names no mesh", "add the attribute \"mesh\"")),
            (None, Some(name)) => match self.assets.mesh(node, name) {
                Ok(mesh) => Shape::Mesh(mesh),
                // What is only seen is not needed; what carries mass or touches is.
                Err(e) if role == GeomRole::Visual => {
                    self.unsupported.missing_visual(&e);
                    return Ok(None);
                }
                Err(e) => return Err(e),
            },
        };
        Ok(Some(ReadGeom {
            geom: Geom {
                name: node.get("name").map(str::to_owned),
                link_from_geom: frame * pose,
                shape,
                role,
                friction: Some(friction),
                rgba: colour,
            },
            group,
            mass_kg,
            density,
            mesh,
            title: node.title(),
            line: node.line,
        }))
    }

    /// Mass properties of one shape in its body's frame; `None` without mass.
    pub(super) fn mass_of(&mut self, read: &ReadGeom) -> Option<MassProperties> {
        if read.mass_kg == Some(0.0) || (read.mass_kg.is_none() && read.density == 0.0) {
            return None;
        }
        let shape = match &read.mesh {
            Some(name) => self.assets.solid_of(name, &read.geom.shape),
            None => read.geom.shape.clone(),
        };
        if matches!(shape, Shape::Plane) {
            return None;
        }
        if !shape.is_closed() {
            self.unsupported.open_mesh(read.mesh.as_deref().unwrap_or_default());
        }
        let Some(body) = shape.mass_properties(read.density.max(f64::MIN_POSITIVE)) else {
            self.unsupported
                .note(format!("<{}> (line {}) has no volume and so carries no mass", read.title, read.line));
            return None;
        };
        let body = match read.mass_kg {
            Some(mass) => shape.mass_properties(DEFAULT_DENSITY).map_or(body, |b| b.with_mass(mass)),
            None => body,
        };
        Some(body.transformed(&read.geom.link_from_geom))
    }
}

/// A primitive; `fromto` also sets where it is. The inner `None` is a height field.
fn primitive(kind: &str, a: &Attributes<'_>, pose: &mut Pose) -> Result<Option<Shape>> {
    let needed = match kind {
        "sphere" => 1,
        "capsule" | "cylinder" => 2,
        "box" | "ellipsoid" => 3,
        "plane" => return Ok(Some(Shape::Plane)),
        "hfield" => return Ok(None),
        _ => {
            return Err(a.fault(
                "type",
                "no type of shape",
                "use sphere, capsule, cylinder, box, ellipsoid, plane or mesh",
            ));
        }
    };
    let mut size = a.numbers("size", 1..=3)?.unwrap_or_default();
    if let Some(ends) = a.numbers("fromto", 6..=6)? {
        if kind == "sphere" {
            return Err(a.fault("fromto", "a sphere has no two ends", "use a capsule"));
        }
        let from = Vector3::new(ends[0], ends[1], ends[2]);
        let to = Vector3::new(ends[3], ends[4], ends[5]);
        let Some(rotation) = rotation_to_z(&(from - to)) else {
            return Err(a.fault("fromto", "both ends are the same point", "give two points"));
        };
        *pose = Pose::from_parts(Translation3::from((from + to) / 2.0), rotation);
        let Some(&thickness) = size.first() else {
            return Err(a.node.error("the shape has no \"size\"", "add it"));
        };
        let half_length = (from - to).norm() / 2.0;
        size = if needed == 2 { vec![thickness, half_length] } else { vec![thickness, thickness, half_length] };
    }
    if size.len() < needed {
        return Err(a.node.error(
            format!("a {kind} needs {needed} sizes, {} given", size.len()),
            "give \"size\": radius, half length, or half extents",
        ));
    }
    if size[..needed].iter().any(|s| *s <= 0.0) {
        return Err(a.fault("size", "sizes must be positive", "repair the model"));
    }
    Ok(Some(match kind {
        "sphere" => Shape::Sphere { radius: size[0] },
        "capsule" => Shape::Capsule { radius: size[0], half_length: size[1] },
        "cylinder" => Shape::Cylinder { radius: size[0], half_length: size[1] },
        "box" => Shape::Box { half: Vector3::new(size[0], size[1], size[2]) },
        _ => Shape::Ellipsoid { radii: Vector3::new(size[0], size[1], size[2]) },
    }))
}
