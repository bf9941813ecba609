//! A grasp for an object that stands somewhere: the network's proposals, a dry run of closing the hand for each, and the grip force of the first
//! that then holds.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use drex_core::{Object, Pose, PoseRecord};
use drex_grasp::{FingerContacts, Grasp, GripForcePolicy, paper_force};
use drex_mesh::{AssetOptions, LengthUnit, asset_from_mesh, metric_mesh};
use drex_policy::{GraspPolicy, Query};
use drex_robot::Robot;
use drex_trial::{Assumed, Command, Engine, GraspPath, PlannedGrasp, Reach, TrialEvaluator, TrialOptions, Uncertainty};
use nalgebra::{Point3, Vector3};
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

use crate::error::{Context, refuse};
use crate::hand::with_torque_cap;
use crate::learn::propose;
use crate::records::POLICY;
use crate::{Result, Twin};

/// File that makes a folder that of a policy.
pub(crate) const POLICY_CARD: &str = "policy.json";

/// What is known of the object and the hand beyond the twin; what is left out is the twin's.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PredictOptions {
    /// Hand that will grasp: the name of a bundled model or a file.
    pub hand: Option<String>,
    /// Pose of the object's mesh frame in the world.
    pub world_from_object: Option<Pose>,
    /// Mass of the object, kg.
    pub mass_kg: Option<f64>,
    /// Lowest and highest coefficient of friction between hand and object; the same number twice where it is known to a tenth. Without a friction
    /// of the twin either it is [`Uncertainty::ANY_FRICTION`].
    pub friction: Option<(f64, f64)>,
    /// Largest torque of any joint, N m.
    pub torque_cap_nm: Option<f64>,
}

/// A policy, its hand and an object: all that a prediction takes.
pub struct Predictor {
    /// The network.
    pub policy: GraspPolicy,
    /// Folder of the network.
    pub folder: PathBuf,
    /// Folder of the twin, or that of a policy that has none.
    pub root: PathBuf,
    /// Model of the hand.
    pub robot: Robot,
    /// The object with its mass, where it stands.
    pub object: Object,
    /// Lowest and highest friction that is reckoned with; the same number twice where it is known to a tenth.
    pub friction: (f64, f64),
    /// Masses that are as likely as each other, kg; without any it is the object's.
    masses_kg: Vec<f64>,
    points: Vec<Point3<f64>>,
}

/// A grasp that was chosen for an object, with its grip force.
#[derive(Debug, Clone, Serialize)]
pub struct Prediction {
    /// Hand, joints and where the hand is on the object. What it touches once it is closed is in `contacts`.
    #[serde(flatten, serialize_with = "hand_and_joints")]
    pub grasp: Grasp,
    /// Pose of the hand's base in the world.
    pub world_from_base: PoseRecord,
    /// Probability by the network.
    pub weight: f64,
    /// Place among the proposals in the order in which they are tried, from 1.
    pub place: usize,
    /// Mass that was assumed, kg.
    pub mass_kg: f64,
    /// Coefficient of friction that was assumed; of an interval the one that the grip force is for.
    pub friction: f64,
    /// The interval, where friction is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub friction_range: Option<[f64; 2]>,
    /// Probability that the object asks for more than it is gripped for, where friction is not known and there is a grip force: 0.05, or more where
    /// motors or object do not bear the force that this takes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub risk: Option<f64>,
    /// Grip force by the network, sum of normal forces, N.
    #[serde(rename = "squeeze_n")]
    pub grip_force_n: f64,
    /// Grip force by the grip-force policy at the contacts of the closed hand, N; absent where they cannot carry the object.
    #[serde(rename = "needed_squeeze_n")]
    pub needed_grip_force_n: Option<f64>,
    /// Contacts of each finger once the hand has closed, the palm last.
    pub contacts: Vec<FingerContacts>,
    /// Joint torques of the grip force with the hand's own weight, N m; empty where there is no grip force.
    pub joint_torques_nm: Vec<f64>,
    /// The paper's normalised force: m g n / 5 N, at most 1.
    pub paper_force: f64,
    /// Why there is no grip force, where there is none.
    pub cannot_hold: Option<String>,
    /// What the hand is told, where there is a grip force, with the object above the world's origin ([`Object::at_world_origin`]).
    #[serde(skip)]
    pub command: Option<Command>,
    /// How the fingers open before the grasp and close onto the object.
    #[serde(skip)]
    pub reach: Reach,
    /// Time of the network, ms; not in files, as it differs from run to run.
    #[serde(skip)]
    pub network_ms: f64,
    /// Time of closing the hand in a dry run, and of the grip force, ms.
    #[serde(skip)]
    pub force_ms: f64,
}

/// The grasp of `policy` for an object of this mass that stands at this pose, with the bundled model of the policy's hand.
///
/// # Errors
/// If the policy's hand is not bundled, or the policy is not defined for this mass or object.
pub fn predict(object: &Object, policy: &GraspPolicy, world_from_object: Pose, mass_kg: f64) -> Result<Prediction> {
    let object = object.clone().with_mass(mass_kg).with_rest_pose(world_from_object);
    let robot = with_torque_cap(Robot::bundled(policy.hand())?, None)?;
    Predictor::new(policy.clone(), robot, object, 0).predict()
}

impl Twin {
    /// The network that the stage train made.
    ///
    /// # Errors
    /// If there is none yet, or it cannot be read.
    pub fn policy(&self) -> Result<GraspPolicy> {
        let folder = self.path(POLICY);
        if !folder.join(POLICY_CARD).is_file() {
            refuse!("{} has no policy yet: run `drex train {0}` first", self.root.display());
        }
        Ok(GraspPolicy::load(&folder)?)
    }
}

impl Predictor {
    /// A predictor for an object where it stands; the seed decides which points of it the network sees.
    pub fn new(policy: GraspPolicy, robot: Robot, object: Object, seed: u64) -> Self {
        let points = object.point_cloud(policy.points(), seed);
        let friction = (object.friction, object.friction);
        let (folder, root, masses_kg) = (PathBuf::new(), PathBuf::new(), Vec::new());
        Self { policy, folder, root, robot, object, friction, masses_kg, points }
    }

    /// A predictor for the object of a twin, or for a mesh (metres, z up) and the folder of a policy.
    ///
    /// # Errors
    /// If there is no policy yet, it is for another hand, or the object cannot be read.
    pub fn open(path: &Path, mesh: Option<&Path>, options: &PredictOptions, seed: Option<u64>) -> Result<Self> {
        if path.join(POLICY_CARD).is_file() {
            return Self::of_policy(path, mesh, options, seed.unwrap_or(0));
        }
        Self::of_twin(&Twin::open(path)?.with_seed(seed), options)
    }

    /// A predictor for the object of a twin.
    ///
    /// # Errors
    /// As [`Predictor::open`].
    pub fn of_twin(twin: &Twin, options: &PredictOptions) -> Result<Self> {
        let policy = twin.policy()?;
        let (mass_kg, masses_kg) = match options.mass_kg {
            Some(mass) => (mass, Vec::new()),
            None => {
                let mass = twin.mass()?;
                (mass.grip_kg, mass.likely_kg())
            }
        };
        let object = twin.object()?.with_mass(mass_kg);
        let friction = options.friction.unwrap_or_else(|| twin.friction_range());
        let own = twin.manifest.grasps.as_ref();
        let robot = hand(&policy, options, own.map(|g| (g.hand.as_str(), g.torque_cap_nm)), &twin.root)?;
        let (folder, root) = (twin.path(POLICY), twin.root.clone());
        Ok(Self { folder, root, friction, masses_kg, ..Self::new(policy, robot, placed(object, options), twin.seed) })
    }

    fn of_policy(folder: &Path, mesh: Option<&Path>, options: &PredictOptions, seed: u64) -> Result<Self> {
        let Some(mesh) = mesh else {
            refuse!(
                "{} is the folder of a policy: say what is grasped with --mesh FILE and --mass KG",
                folder.display()
            );
        };
        let mass_kg = options.mass_kg.context("say what the object weighs: --mass KG")?;
        let (mesh, _) = metric_mesh(mesh, LengthUnit::Metre)?;
        let mut asset_options = AssetOptions::default();
        (asset_options.mass_kg, asset_options.unit) = (Some(mass_kg), LengthUnit::Metre);
        let object = asset_from_mesh(&mesh, &asset_options)?.to_exact_object("object")?;
        let friction = options.friction.unwrap_or(Uncertainty::ANY_FRICTION);
        let policy = GraspPolicy::load(folder)?;
        let robot = hand(&policy, options, None, folder)?;
        let (folder, root) = (folder.to_path_buf(), folder.to_path_buf());
        Ok(Self { folder, root, friction, ..Self::new(policy, robot, placed(object, options), seed) })
    }

    /// The first grasp that the hand can hold on its [`GraspPath`]; the first one, with the reason, if it can hold none.
    ///
    /// # Errors
    /// If the policy is not defined for this mass or object.
    pub fn predict(&self) -> Result<Prediction> {
        let start = Instant::now();
        let up = self.object.table().up.into_inner();
        let assumptions = self.assumptions()?;
        let (assumed, risks): (Vec<Assumed>, Vec<Option<f64>>) =
            assumptions.into_iter().map(|(risk, a)| (a, risk)).unzip();
        let query = Query::new(&self.points, self.object.mass_kg(), assumed[0].friction).with_up(up);
        let proposals = propose(&self.policy, &query)?;
        let network_ms = 1e3 * start.elapsed().as_secs_f64();
        let start = Instant::now();
        let robot = Arc::new(self.robot.clone());
        let (options, standing) = (TrialOptions::default(), self.object.clone().at_world_origin());
        let evaluator = TrialEvaluator::new(&standing, &robot, &options, Engine::Diffsim)?;
        let planned = GraspPath::default().plan_in_turn(&evaluator, proposals, &assumed)?;
        let turn = planned.turn;
        let mut prediction = self.prediction(planned);
        prediction.risk = risks[turn];
        (prediction.mass_kg, prediction.friction) = (assumed[turn].mass_kg, assumed[turn].friction);
        if prediction.risk.is_some() {
            // The law takes it for lower than assumed: the interval says how much it can be.
            prediction.friction *= 1.0 - GripForcePolicy::default().friction_uncertainty;
            prediction.friction_range = Some([self.friction.0, self.friction.1]);
        }
        if prediction.cannot_hold.is_some() {
            // Nothing is gripped at any risk.
            prediction.risk = None;
        }
        (prediction.network_ms, prediction.force_ms) = (network_ms, 1e3 * start.elapsed().as_secs_f64());
        Ok(prediction)
    }

    /// What to assume in turn, each with its risk where friction is not known.
    fn assumptions(&self) -> Result<Vec<(Option<f64>, Assumed)>> {
        let (mass_kg, (low, high)) = (self.object.mass_kg(), self.friction);
        if low == high {
            return Ok(vec![(None, Assumed { mass_kg, friction: low })]);
        }
        let masses_kg = if self.masses_kg.is_empty() { vec![mass_kg] } else { self.masses_kg.clone() };
        let uncertainty = Uncertainty::new(masses_kg, self.friction)?.spoken_for_by(mass_kg)?;
        Ok(uncertainty.in_turn(&GripForcePolicy::default()).map(|(risk, assumed)| (Some(risk), assumed)).to_vec())
    }

    fn prediction(&self, planned: PlannedGrasp<TrialEvaluator>) -> Prediction {
        let Self { robot, object, .. } = self;
        let PlannedGrasp { proposal, place, closed, command, .. } = planned;
        let (command, cannot_hold) = match command {
            Ok(command) => (Some(command), None),
            Err(reason) => (None, Some(reason.to_string())),
        };
        let links: Vec<usize> = match &command {
            Some(command) => command.contact_forces.iter().map(|f| f.link).collect(),
            None => closed.contacts().iter().map(|c| c.link).collect(),
        };
        let held = command.as_ref();
        let per_finger_n = held.map_or(&[][..], |c| &c.per_finger_n);
        let mut contacts: Vec<FingerContacts> = Vec::new();
        for (i, finger) in robot.fingers().into_iter().enumerate() {
            let count = links.iter().filter(|l| finger.links.contains(l)).count();
            contacts.push(FingerContacts {
                contacts: count,
                touches: count > 0,
                finger: finger.name,
                normal_n: per_finger_n.get(i).copied().unwrap_or(0.0),
            });
        }
        let of_fingers: usize = contacts.iter().map(|c| c.contacts).sum();
        let of_fingers_n: f64 = contacts.iter().map(|c| c.normal_n).sum();
        contacts.push(FingerContacts {
            finger: "palm".into(),
            contacts: links.len().saturating_sub(of_fingers),
            touches: false,
            normal_n: held.map_or(0.0, |c| (c.grip_force_n - of_fingers_n).max(0.0)),
        });
        let touching = contacts.iter().filter(|f| f.contacts > 0).count();
        let world_from_base = object.world_from_object * proposal.grasp.object_from_base;
        let down = world_from_base.rotation.inverse() * Vector3::new(0.0, 0.0, -9.81);
        let own_nm = robot.gravity_torque(closed.joints_rad(), &down);
        let joint_torques_nm =
            held.map(|c| c.torques_nm.iter().zip(own_nm.iter()).map(|(grip, own)| grip + own).collect());
        Prediction {
            grasp: proposal.grasp,
            world_from_base: PoseRecord::from(&world_from_base),
            weight: proposal.weight,
            place,
            mass_kg: object.mass_kg(),
            friction: 0.0,
            friction_range: None,
            risk: None,
            grip_force_n: proposal.grip_force_n,
            needed_grip_force_n: held.map(|c| c.grip_force_n),
            contacts,
            joint_torques_nm: joint_torques_nm.unwrap_or_default(),
            paper_force: paper_force(object.mass_kg(), 9.81, touching),
            cannot_hold,
            reach: closed.reach().clone(),
            command,
            network_ms: 0.0,
            force_ms: 0.0,
        }
    }
}

/// The keys of a grasp that an answer has at its top.
fn hand_and_joints<S: Serializer>(grasp: &Grasp, serializer: S) -> Result<S::Ok, S::Error> {
    let mut keys = serializer.serialize_map(Some(3))?;
    keys.serialize_entry("hand", &grasp.hand)?;
    keys.serialize_entry("joint_names", &grasp.joint_names)?;
    keys.serialize_entry("joints_rad", &grasp.joints_rad)?;
    keys.end()
}

/// The object where the options say that it stands.
fn placed(object: Object, options: &PredictOptions) -> Object {
    let pose = options.world_from_object.unwrap_or(object.world_from_object);
    object.with_rest_pose(pose)
}

/// The hand that will grasp, which has to be the policy's; `own` are name and torque cap of the twin's.
fn hand(
    policy: &GraspPolicy,
    options: &PredictOptions,
    own: Option<(&str, Option<f64>)>,
    folder: &Path,
) -> Result<Robot> {
    let (name, folder) = match (&options.hand, own) {
        (Some(name), _) => (name.as_str(), Path::new(".")),
        (None, Some((name, _))) => (name, folder),
        (None, None) => (policy.hand(), folder),
    };
    let robot = Robot::resolve(name, folder)?;
    if robot.name != policy.hand() || robot.joint_names() != policy.joint_names() {
        refuse!(
            "the policy is for the hand \"{}\" with {} joints, not for \"{}\" with {}: train one for this hand, or name the other",
            policy.hand(),
            policy.joint_names().len(),
            robot.name,
            robot.dof()
        );
    }
    with_torque_cap(robot, options.torque_cap_nm.or(own.and_then(|(_, cap)| cap)))
}
