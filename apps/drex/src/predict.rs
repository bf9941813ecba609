//! A grasp for an object that stands somewhere: the network's proposals, the one that the hand can hold, and its force.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use drex_core::twin::{ASSUMED_FRICTION, GraspsConfig};
use drex_core::{MassProperties, Pose};
use drex_grasp::{ContactOptions, ForceCommand, HandSurface, SqueezeProblem, TablePlane, TorqueLimits, paper_force};
use drex_mesh::{
    AssetOptions, GridSdf, LengthUnit, MeshSdf, asset_from_mesh, farthest_points, metric_mesh, sample_surface,
};
use drex_policy::{GraspPolicy, PredictedGrasp, Query};
use drex_robot::Robot;
use drex_trial::{Reach, TrialOptions, needed_force, plan_reach};
use nalgebra::{Point3, Unit, Vector3};
use serde::Serialize;

use crate::choice;
use crate::cli::{GraspArgs, HandArg};
use crate::twin::{MassFile, PoseRecord, Twin, files};

/// A predicted hand touches what it is this near to, metres: nearer than the fingers move when they close.
const TOUCH_M: f64 = 0.006;

/// A policy, its hand and an object.
pub struct Ready {
    pub policy: GraspPolicy,
    /// Folder of the policy.
    pub folder: PathBuf,
    /// Folder of the twin, or that of a policy that has none.
    pub root: PathBuf,
    pub robot: Robot,
    pub mass_kg: f64,
    pub friction: f64,
    /// The object's pose.
    pub world_from_object: Pose,
    sdf: GridSdf,
    body: MassProperties,
    points: Vec<Point3<f64>>,
}

/// The grasp that was chosen.
#[derive(Debug, Clone, Serialize)]
pub struct Prediction {
    pub hand: String,
    pub joint_names: Vec<String>,
    pub joints_rad: Vec<f64>,
    /// Where the palm goes.
    pub world_from_palm: PoseRecord,
    /// How probable the network thinks it is, and its place among the proposals as they are tried, from 1.
    pub weight: f64,
    pub place: usize,
    pub mass_kg: f64,
    pub friction: f64,
    /// What the network says, sum of normal forces, N.
    pub squeeze_n: f64,
    /// What the force law asks for at the contacts as predicted; absent where they cannot carry the object.
    pub needed_squeeze_n: Option<f64>,
    /// Contacts of each finger, the palm last.
    pub contacts: Vec<FingerContact>,
    /// Joint torques of the squeeze with the hand's own weight, N m; empty where there is no squeeze.
    pub joint_torques_nm: Vec<f64>,
    /// The paper's normalised force: m g n / 5 N, at most 1.
    pub paper_force: f64,
    /// Why the force law has no squeeze, where it has none.
    pub cannot_hold: Option<String>,
    /// Time of the network and of the force law, ms; not in files, as it is another in every run.
    #[serde(skip)]
    pub network_ms: f64,
    #[serde(skip)]
    pub force_ms: f64,
}

/// A finger that touches.
#[derive(Debug, Clone, Serialize)]
pub struct FingerContact {
    pub finger: String,
    pub contacts: usize,
    pub normal_n: f64,
}

impl Ready {
    /// Loads what a prediction takes.
    ///
    /// # Errors
    /// If there is no policy yet, it is for another hand, or the object cannot be read.
    pub fn of(args: &GraspArgs, seed: Option<u64>) -> Result<Self> {
        let path = &args.twin_or_policy;
        if path.join("policy.json").is_file() {
            return Self::of_policy(args, path, seed.unwrap_or(0));
        }
        Self::of_twin(&Twin::open(path, seed)?, args)
    }

    /// The same of a twin that is open.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn of_twin(twin: &Twin, args: &GraspArgs) -> Result<Self> {
        let folder = twin.path(files::POLICY);
        if !folder.join("policy.json").is_file() {
            bail!("{} has no policy yet: run `drex train {0}` first", twin.root.display());
        }
        let mass_kg = match args.mass {
            Some(mass) => mass,
            None => files::read_json::<MassFile>(&twin.path(files::MASS))?.grip_kg,
        };
        let asset = twin.asset()?.clone();
        let friction = args.friction.unwrap_or_else(|| twin.friction());
        let policy = GraspPolicy::load(&folder)?;
        let robot = hand(args, &policy, twin.manifest.grasps.as_ref(), &twin.root)?;
        let (mass, rest) = (asset.properties, asset.world_from_mesh_at_rest);
        let folders = (folder, twin.root.clone());
        Self::new(policy, folders, robot, &asset.visual, mass, rest, (mass_kg, friction), args.pose, twin.seed)
    }

    fn of_policy(args: &GraspArgs, folder: &Path, seed: u64) -> Result<Self> {
        let Some(mesh) = &args.mesh else {
            bail!("{} is the folder of a policy: say what is grasped with --mesh FILE and --mass KG", folder.display());
        };
        let mass_kg = args.mass.context("say what the object weighs: --mass KG")?;
        let (mesh, _) = metric_mesh(mesh, LengthUnit::Metre)?;
        let mut options = AssetOptions::default();
        (options.mass_kg, options.unit) = (Some(mass_kg), LengthUnit::Metre);
        let asset = asset_from_mesh(&mesh, &options)?;
        let policy = GraspPolicy::load(folder)?;
        let robot = hand(args, &policy, None, folder)?;
        let friction = args.friction.unwrap_or(ASSUMED_FRICTION);
        let (mass, rest) = (asset.properties, asset.world_from_mesh_at_rest);
        let folders = (folder.to_path_buf(), folder.to_path_buf());
        Self::new(policy, folders, robot, &asset.visual, mass, rest, (mass_kg, friction), args.pose, seed)
    }

    #[allow(clippy::too_many_arguments)] // both callers have all of them at hand
    fn new(
        policy: GraspPolicy,
        (folder, root): (PathBuf, PathBuf),
        robot: Robot,
        mesh: &drex_core::TriMesh,
        body: MassProperties,
        rest: Pose,
        (mass_kg, friction): (f64, f64),
        pose: Option<Pose>,
        seed: u64,
    ) -> Result<Self> {
        let dense: Vec<_> = sample_surface(mesh, 8 * policy.points(), seed).into_iter().map(|s| s.point).collect();
        let points = farthest_points(&dense, policy.points()).into_iter().map(|i| dense[i]).collect();
        let sdf = GridSdf::new(MeshSdf::new(mesh)?)?;
        let body = body.with_mass(mass_kg);
        let world_from_object = pose.unwrap_or(rest);
        Ok(Self { policy, folder, root, robot, mass_kg, friction, world_from_object, sdf, body, points })
    }

    /// The first grasp, as [`choice::sort`] has them, that the hand can hold; the first one, with the reason, if none can.
    ///
    /// # Errors
    /// If the policy is not defined for this mass or object.
    pub fn predict(&self) -> Result<Prediction> {
        let start = Instant::now();
        let up = self.world_from_object.rotation.inverse() * Vector3::z();
        let query = Query::new(&self.points, self.mass_kg, self.friction).with_up(up);
        let grasps = choice::proposals(&self.policy, &query)?;
        let network_ms = 1e3 * start.elapsed().as_secs_f64();
        let start = Instant::now();
        let surface = HandSurface::new(&self.robot, ContactOptions::default().spacing_m)?;
        let mut first = None;
        for (place, grasp) in grasps.iter().enumerate() {
            let prediction = self.judged(&surface, grasp, place + 1)?;
            let holds = prediction.cannot_hold.is_none();
            if holds || first.is_none() {
                first = Some(prediction);
            }
            if holds {
                break;
            }
        }
        let mut prediction = first.context("the policy proposes no grasp")?;
        (prediction.network_ms, prediction.force_ms) = (network_ms, 1e3 * start.elapsed().as_secs_f64());
        Ok(prediction)
    }

    /// How the fingers open before the grasp and close onto the object.
    ///
    /// # Errors
    /// If the hand has no shapes.
    pub fn reach(&self, grasp: &Prediction) -> Result<Reach> {
        let surface = HandSurface::new(&self.robot, ContactOptions::default().spacing_m)?;
        let object_from_palm = self.world_from_object.inverse() * grasp.world_from_palm.to_pose()?;
        let object = self.sdf.exact();
        Ok(plan_reach(&self.robot, &surface, &grasp.joints_rad, &object_from_palm, object, &self.world_from_object))
    }

    fn judged(&self, surface: &HandSurface, grasp: &PredictedGrasp, place: usize) -> Result<Prediction> {
        let Self { robot, sdf, .. } = self;
        let mut options = ContactOptions::with_friction(self.friction);
        options.max_gap_m = TOUCH_M;
        let contacts = surface.contacts(robot, &grasp.joints, &grasp.object_from_palm, sdf.exact(), &options)?;
        let object_from_world = self.world_from_object.rotation.inverse();
        let up = Unit::new_normalize(object_from_world * Vector3::z());
        let gravity = TablePlane { up, height_m: 0.0 }.gravity();
        let torques = TorqueLimits::of_robot(robot, &grasp.joints, &grasp.object_from_palm, &contacts, &gravity)?;
        let problem =
            SqueezeProblem::new(contacts, self.mass_kg, self.body.center_of_mass, gravity).with_torques(torques);
        let (force, cannot_hold) = match needed_force(robot, &TrialOptions::default().law, &problem) {
            Ok(force) => (Some(force), None),
            Err(reason) => (None, Some(reason.to_string())),
        };
        let of = |f: Option<usize>| problem.contacts.iter().filter(move |c| c.finger == f).count();
        let share = |f: Option<usize>| share_of(force.as_ref(), f);
        let mut fingers: Vec<FingerContact> = surface
            .fingers
            .iter()
            .enumerate()
            .map(|(i, f)| FingerContact { finger: f.name.clone(), contacts: of(Some(i)), normal_n: share(Some(i)) })
            .collect();
        fingers.push(FingerContact { finger: "palm".into(), contacts: of(None), normal_n: share(None) });
        let touching = fingers.iter().filter(|f| f.contacts > 0).count();
        Ok(Prediction {
            hand: robot.name.clone(),
            joint_names: robot.joint_names().into_iter().map(str::to_owned).collect(),
            joints_rad: grasp.joints.clone(),
            world_from_palm: PoseRecord::from(&(self.world_from_object * grasp.object_from_palm)),
            weight: grasp.weight,
            place,
            mass_kg: self.mass_kg,
            friction: self.friction,
            squeeze_n: grasp.squeeze_n,
            needed_squeeze_n: force.as_ref().map(|f| f.total_n),
            contacts: fingers,
            joint_torques_nm: force.map(|f| f.distribution.joint_torques_nm).unwrap_or_default(),
            paper_force: paper_force(self.mass_kg, 9.81, touching),
            cannot_hold,
            network_ms: 0.0,
            force_ms: 0.0,
        })
    }
}

fn share_of(force: Option<&ForceCommand>, finger: Option<usize>) -> f64 {
    force.map_or(0.0, |f| {
        let d = &f.distribution;
        finger.map_or(d.palm_n, |i| d.per_finger_n.get(i).copied().unwrap_or(0.0))
    })
}

/// The hand with its motors' torques known, none above the cap if there is one.
///
/// # Errors
/// If its model does not say what its motors give, and there is no cap.
pub fn with_torques(robot: Robot, cap_nm: Option<f64>) -> Result<Robot> {
    let robot = match cap_nm {
        Some(cap) => robot.with_effort_cap(cap)?,
        None => robot,
    };
    robot.effort_limits()?;
    Ok(robot)
}

/// The hand that will grasp, which has to be the policy's.
fn hand(args: &GraspArgs, policy: &GraspPolicy, own: Option<&GraspsConfig>, folder: &Path) -> Result<Robot> {
    let (name, folder) = match (&args.hand, own) {
        (Some(name), _) => (name.as_str(), Path::new(".")),
        (None, Some(own)) => (own.hand.as_str(), folder),
        (None, None) => (policy.hand(), folder),
    };
    // A hand by its family's name is its right one.
    let name = HandArg::of_family(name).map_or(name, |h| h.robot());
    let robot = Robot::resolve(name, folder)?;
    if robot.name != policy.hand() || robot.joint_names() != policy.joint_names() {
        bail!(
            "the policy is for the hand \"{}\" with {} joints, not for \"{}\" with {}: train one for this hand, or name the other",
            policy.hand(),
            policy.joint_names().len(),
            robot.name,
            robot.dof()
        );
    }
    with_torques(robot, args.torque_cap.or(own.and_then(|g| g.torque_cap_nm)))
}
