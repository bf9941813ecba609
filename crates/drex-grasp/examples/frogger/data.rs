//! FRoGGeR's grasps of YCB objects with an FR3 arm and an Allegro hand: files, kinematics, fingertip contacts.

use std::collections::BTreeMap;
use std::error::Error;
use std::path::{Path, PathBuf};

use drex_core::{SignedDistance, TriMesh};
use drex_grasp::Contact;
use drex_mesh::MeshSdf;
use nalgebra::{Isometry3, Matrix3, Matrix3xX, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;

pub type Outcome<T> = Result<T, Box<dyn Error>>;

/// Radius of a fingertip, metres.
pub const TIP_RADIUS_M: f64 = 0.012;
/// Friction of the stored metrics and of the pick controller.
pub const FRICTION: f64 = 0.5;
const HAND_JOINTS: usize = 16;

/// One object with its labelled grasps.
pub struct Object {
    pub sdf: MeshSdf,
    /// Mass of their simulation, kg.
    pub mass_kg: f64,
    pub world_from_object: Isometry3<f64>,
    pub grasps: Vec<Grasp>,
}

/// A labelled grasp. The stored value is kept for comparison only.
pub struct Grasp {
    pub q: Vec<f64>,
    pub succeeded: bool,
    pub stored_min_weight: f64,
}

/// The fingertips of a posed hand, object frame.
pub struct Tips {
    /// Centres of the four fingertip spheres: index, middle, ring, thumb.
    pub centers: [Point3<f64>; 4],
    /// The points of the spheres that FRoGGeR puts on the surface: 60 degrees from the tip towards the pad.
    pub pads: [Point3<f64>; 4],
    /// Velocity of each pad point per speed of the hand's 16 joints.
    pub jacobians: [Matrix3xX<f64>; 4],
    /// Where the palm faces.
    pub palm_facing: Vector3<f64>,
}

/// Joint tree of the arm and hand.
pub struct Kinematics {
    joints: Vec<Joint>,
    palm: Isometry3<f64>,
    tips: [(usize, Vector3<f64>); 4],
}

struct Joint {
    parent: Option<usize>,
    on_palm: bool,
    parent_from_joint: Isometry3<f64>,
    axis: Vector3<f64>,
    joint_from_child: Isometry3<f64>,
}

/// The folder with the grasps, if the reference data is there.
pub fn folder() -> Option<PathBuf> {
    let folder = Path::new(&std::env::var_os("DREX_SHARED")?).join("data/grasps/frogger_fr3_allegro");
    folder.is_dir().then_some(folder)
}

/// All objects that have a mesh, with their labelled grasps, in the order of their names.
pub fn load(folder: &Path) -> Outcome<(Kinematics, Vec<Object>)> {
    let kinematics = Kinematics::read(&folder.join("kinematics.json"))?;
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)?.map(|e| Ok(e?.path())).collect::<Outcome<_>>()?;
    files.retain(|f| f.file_stem().is_some_and(|s| s.to_string_lossy().contains("__")));
    files.sort();
    let mut objects: BTreeMap<String, Object> = BTreeMap::new();
    for file in files {
        let value: Value = serde_json::from_slice(&std::fs::read(&file)?)?;
        let name = value["object"].as_str().ok_or("no object name")?.to_string();
        let grasps = grasps(&value)?;
        if grasps.is_empty() {
            continue;
        }
        if let Some(object) = objects.get_mut(&name) {
            object.grasps.extend(grasps);
            continue;
        }
        let candidates = [folder.join("meshes"), folder.join("../../objects")].map(|f| f.join(format!("{name}.obj")));
        let Some(mesh) = candidates.iter().find(|f| f.is_file()) else { continue };
        let mesh = TriMesh::read(mesh)?;
        let object = Object {
            sdf: MeshSdf::new(&mesh)?,
            mass_kg: value["sim_mass_kg"].as_f64().ok_or("no mass")?,
            world_from_object: transform(&value["X_WO"])?,
            grasps,
        };
        objects.insert(name, object);
    }
    Ok((kinematics, objects.into_values().collect()))
}

fn grasps(value: &Value) -> Outcome<Vec<Grasp>> {
    let q = value["q"].as_array().ok_or("no joint angles")?;
    let mut list = Vec::new();
    for (i, q) in q.iter().enumerate() {
        let Some(label) = value["pick_success"].get(i).and_then(Value::as_f64) else { continue };
        let stored_min_weight = value["min_weight"][i].as_f64().ok_or("no stored metric")?;
        list.push(Grasp { q: numbers(q)?, succeeded: label > 0.5, stored_min_weight });
    }
    Ok(list)
}

impl Kinematics {
    fn read(path: &Path) -> Outcome<Self> {
        let value: Value = serde_json::from_slice(&std::fs::read(path)?)?;
        let mut joints: Vec<Joint> = Vec::new();
        let mut child_of: BTreeMap<String, usize> = BTreeMap::new();
        for j in value["joints"].as_array().ok_or("no joints")? {
            let parent = j["parent"].as_str().ok_or("no parent")?;
            let axis = numbers(&j["axis_in_joint"])?;
            child_of.insert(j["child"].as_str().ok_or("no child")?.into(), joints.len());
            joints.push(Joint {
                parent: child_of.get(parent).copied(),
                on_palm: parent == "algr_rh_palm",
                parent_from_joint: transform(&j["T_parent_joint"])?,
                axis: Vector3::from_column_slice(&axis),
                joint_from_child: transform(&j["T_joint_child"])?,
            });
        }
        let mut tips = [(0, Vector3::zeros()); 4];
        for (tip, finger) in tips.iter_mut().zip(["if", "mf", "rf", "th"]) {
            let link = format!("algr_rh_{finger}_ds");
            let center = numbers(&value["tip_sphere"][&link])?;
            *tip = (*child_of.get(&link).ok_or("no fingertip")?, Vector3::from_column_slice(&center[..3]));
        }
        Ok(Self { joints, palm: transform(&value["fixed"][0]["T_parent_child"])?, tips })
    }

    /// Fingertips at joint angles `q` (arm, then hand), object frame.
    pub fn tips(&self, q: &[f64], world_from_object: &Isometry3<f64>) -> Tips {
        let object_from_world = world_from_object.inverse();
        let arm = self.joints.len() - HAND_JOINTS;
        let mut links: Vec<Isometry3<f64>> = Vec::new();
        let mut axes = Vec::new();
        let mut palm = Isometry3::identity();
        for (joint, angle) in self.joints.iter().zip(q) {
            let parent = match joint.parent {
                Some(p) => links[p],
                None if joint.on_palm => palm,
                None => object_from_world,
            };
            let frame = parent * joint.parent_from_joint;
            let turn = UnitQuaternion::from_scaled_axis(joint.axis * *angle);
            axes.push((Point3::from(frame.translation.vector), frame * joint.axis));
            links.push(frame * turn * joint.joint_from_child);
            if links.len() == arm {
                palm = links[arm - 1] * self.palm;
            }
        }
        let (s, c) = std::f64::consts::FRAC_PI_3.sin_cos();
        let to_pad = Vector3::new(s, 0.0, c) * TIP_RADIUS_M;
        let pads = self.tips.map(|(link, center)| links[link] * Point3::from(center + to_pad));
        let jacobian = |finger: usize| {
            let mut j = Matrix3xX::zeros(HAND_JOINTS);
            let mut joint = Some(self.tips[finger].0);
            while let Some(k) = joint.filter(|&k| k >= arm) {
                let (at, axis) = axes[k];
                j.set_column(k - arm, &axis.cross(&(pads[finger] - at)));
                joint = self.joints[k].parent;
            }
            j
        };
        Tips {
            centers: self.tips.map(|(link, center)| links[link] * Point3::from(center)),
            pads,
            jacobians: [0, 1, 2, 3].map(jacobian),
            palm_facing: palm * Vector3::x(),
        }
    }
}

/// Four contacts at the surface points nearest to `points`, normals against the gradient of the distance there.
pub fn contacts(sdf: &MeshSdf, points: &[Point3<f64>; 4], friction: f64) -> Vec<Contact> {
    points
        .iter()
        .enumerate()
        .map(|(finger, p)| {
            let s = sdf.signed_distance(p);
            let mut contact = Contact::new(p - s.gradient * s.distance_m, -s.gradient, friction).by_finger(finger);
            contact.depth_m = -s.distance_m;
            contact
        })
        .collect()
}

fn numbers(value: &Value) -> Outcome<Vec<f64>> {
    let list = value.as_array().ok_or("a list of numbers is missing")?;
    list.iter().map(|v| v.as_f64().ok_or_else(|| "a number is missing".into())).collect()
}

/// Row-major 3 x 4 or 4 x 4.
fn transform(value: &Value) -> Outcome<Isometry3<f64>> {
    let rows = [numbers(&value[0])?, numbers(&value[1])?, numbers(&value[2])?];
    let r = Matrix3::from_fn(|i, j| rows[i][j]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&r));
    Ok(Isometry3::from_parts(Translation3::new(rows[0][3], rows[1][3], rows[2][3]), rotation))
}
