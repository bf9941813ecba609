//! A trained policy and what it predicts.

use drex_core::Pose;
use nalgebra::{Point3, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::cloud::box_centre;
use crate::density::{log_student, log_sum_exp};
use crate::loss::sigmoid;
use crate::norm::{FRICTION_MARGIN, MASS_MARGIN, Normalisation, STRETCH, joint_intervals, wrist_pose};
use crate::view::{Frame, View};
use crate::weights::{Layout, Weights};
use crate::{Dataset, Error, Result, TrainOptions, net};

/// The largest force that the paper's number stands for, N.
pub const PAPER_FORCE_N: f64 = 5.0;

/// A grip force as the normalised number of the D-REX paper: over 5 N, between 0 and 1 (its label m g n / f_max is such a sum of forces).
pub fn normalised_grip_force(grip_force_n: f64) -> f64 {
    (grip_force_n / PAPER_FORCE_N).clamp(0.0, 1.0)
}

/// Objects larger than this many lengths of a hand are taken for a mistake in the units.
pub(crate) const LARGEST_OBJECT: f64 = 20.0;

/// What a policy is asked: an object on a table, its mass and its friction.
#[derive(Debug, Clone, Copy)]
pub struct Query<'a> {
    /// Points on the surface, m, in any frame.
    pub points: &'a [Point3<f64>],
    /// Upwards in that frame, of any length.
    pub up: Vector3<f64>,
    /// Height of the centre of the points' box above the table, m; none if the table touches the lowest point.
    pub table_below_m: Option<f64>,
    /// kg.
    pub mass_kg: f64,
    /// Coefficient of friction between fingers and object.
    pub friction: f64,
}

impl<'a> Query<'a> {
    /// An object that stands with its lowest point on the table; up is z.
    pub fn new(points: &'a [Point3<f64>], mass_kg: f64, friction: f64) -> Self {
        Self { points, up: Vector3::z(), table_below_m: None, mass_kg, friction }
    }

    /// Sets [`up`](Self::up).
    #[must_use]
    pub fn with_up(mut self, up: Vector3<f64>) -> Self {
        self.up = up;
        self
    }

    /// Sets [`table_below_m`](Self::table_below_m).
    #[must_use]
    pub fn with_table_below_m(mut self, height_m: f64) -> Self {
        self.table_below_m = Some(height_m);
        self
    }
}

/// One grasp that the policy proposes.
#[derive(Debug, Clone, PartialEq)]
pub struct PredictedGrasp {
    /// Joint angles in rad, in the order of [`GraspPolicy::joint_names`], inside the limits.
    pub joints: Vec<f64>,
    /// Pose of the hand's base in the frame the object's points were given in.
    pub object_from_base: Pose,
    /// Probability of each finger to touch, in the order of [`GraspPolicy::fingers`].
    pub contacts: Vec<f64>,
    /// Total grip force, sum of normal forces, N.
    pub grip_force_n: f64,
    /// Probability of this grasp among those proposed; they sum to one.
    pub weight: f64,
}

/// What the weights mean: everything about a policy except the weights themselves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Card {
    pub hand: String,
    pub joint_names: Vec<String>,
    pub joint_limits_rad: Vec<(f64, f64)>,
    pub fingers: Vec<String>,
    pub points: usize,
    pub network: Layout,
    pub normalisation: Normalisation,
    pub training: TrainOptions,
    /// Hash of the training data, so that a policy can be traced to it.
    pub dataset_sha256: String,
}

impl Card {
    pub fn new(data: &Dataset, options: &TrainOptions, network: Layout, normalisation: Normalisation) -> Self {
        Self {
            hand: data.hand.clone(),
            joint_names: data.joint_names.clone(),
            joint_limits_rad: data.joint_limits.clone(),
            fingers: data.fingers.clone(),
            points: options.points,
            network,
            normalisation,
            training: options.clone(),
            dataset_sha256: data.sha256(),
        }
    }
}

/// An object ready for the network.
#[derive(Debug, Clone)]
pub(crate) struct Scene {
    pub frame: Frame,
    pub encoded: Vec<f32>,
}

/// A trained network with the numbers and names that give its output a meaning.
#[derive(Debug, Clone, PartialEq)]
pub struct GraspPolicy {
    pub(crate) card: Card,
    pub(crate) weights: Weights,
}

impl GraspPolicy {
    /// The grasps for what `query` tells of, the most probable first. The wrist comes back in the frame of the points.
    ///
    /// At least [`points`](Self::points) points are needed; more are thinned by farthest-point sampling.
    /// The grip force is m g / μ times a ratio that the network bounds by twice the range seen in training; outside the masses and the
    /// frictions seen it grows in proportion.
    ///
    /// # Errors
    /// [`Error::Query`] for too few points, points that are not finite or metres apart, an up or a table that is none, a mass
    /// that is not positive or is more than ten times outside [`mass_range_kg`](Self::mass_range_kg), a friction more than three times
    /// outside [`friction_range`](Self::friction_range).
    pub fn predict(&self, query: &Query<'_>) -> Result<Vec<PredictedGrasp>> {
        let scene = self.scene(query)?;
        let mut grasps = self.propose(&scene, &[(query.mass_kg, query.friction)])?.pop().unwrap_or_default();
        grasps.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        Ok(grasps)
    }

    /// ln of the density of a grasp, in nats: over rad^J of the joints, and m³ rad³ of the wrist if `object_from_base` is given;
    /// otherwise the density of the joints whatever the wrist.
    ///
    /// # Errors
    /// As [`predict`](Self::predict), and [`Error::Query`] if the number of joints is not that of the hand.
    pub fn log_density(&self, query: &Query<'_>, joints: &[f64], object_from_base: Option<&Pose>) -> Result<f64> {
        if joints.len() != self.joint_names().len() {
            let what = format!("{} joint angles for {} joints", joints.len(), self.joint_names().len());
            return Err(Error::query(what, "give one angle per joint, in the order of the policy's joint names"));
        }
        Ok(self.log_density_of(&self.predict(query)?, joints, object_from_base))
    }

    pub(crate) fn log_density_of(&self, grasps: &[PredictedGrasp], joints: &[f64], pose: Option<&Pose>) -> f64 {
        let spread = self.spread();
        let log_joints: f64 = spread.joints_rad.iter().map(|s| s.ln()).sum();
        let log_wrist = 3.0 * (spread.wrist_m.ln() + spread.wrist_rad.ln());
        log_sum_exp(grasps.iter().map(|g| {
            let z = |(a, (b, s)): (&f64, (&f64, &f64))| ((a - b) / s).powi(2);
            let own: f64 = g.joints.iter().zip(joints.iter().zip(&spread.joints_rad)).map(z).sum();
            let log = match pose {
                None => log_student(own, log_joints, joints.len()),
                Some(pose) => {
                    let gap = (g.object_from_base.translation.vector - pose.translation.vector).norm() / spread.wrist_m;
                    let turn = g.object_from_base.rotation.angle_to(&pose.rotation) / spread.wrist_rad;
                    log_student(own + gap * gap + turn * turn, log_joints + log_wrist, joints.len() + 6)
                }
            };
            g.weight.ln() + log
        }))
    }

    /// How widely grasps scatter about a mode: the scales of its Student's t.
    pub fn spread(&self) -> Spread {
        let of = |i: usize| f64::from(self.weights.log_spread()[i]).exp();
        let joints = self.card.network.joints;
        Spread {
            joints_rad: (0..joints).map(of).collect(),
            wrist_m: of(joints) * self.card.normalisation.length_m,
            wrist_rad: of(joints + 1),
        }
    }

    fn scene(&self, query: &Query<'_>) -> Result<Scene> {
        let points = query.points;
        if points.len() < self.card.points {
            let what = format!("{} points, but the policy takes {}", points.len(), self.card.points);
            return Err(Error::query(what, "sample the surface more densely"));
        }
        if let Some(i) = points.iter().position(|p| p.iter().any(|v| !v.is_finite())) {
            return Err(Error::query(format!("point {i} is not finite"), "repair the mesh or the sampling"));
        }
        check_size(points, self.card.normalisation.length_m)
            .map_err(|what| Error::query(what, "give the points in metres"))?;
        let up = Unit::try_new(query.up, 1e-9).filter(|u| u.iter().all(|v| v.is_finite()));
        let up = up.ok_or_else(|| {
            let what = format!("up is {:?}, no direction", query.up.as_slice());
            Error::query(what, "give the direction away from the table, e.g. (0, 0, 1)")
        })?;
        let largest = LARGEST_OBJECT * self.card.normalisation.length_m;
        if query.table_below_m.is_some_and(|t| !(t >= 0.0 && t <= largest)) {
            let what = format!("the table is {:?} m below the object's centre", query.table_below_m);
            return Err(Error::query(what, format!("give a height from 0 to {largest} m, or none")));
        }
        let ranges = [
            ("mass", query.mass_kg, " kg", self.mass_range_kg(), MASS_MARGIN),
            ("friction", query.friction, "", self.friction_range(), FRICTION_MARGIN),
        ];
        for (name, value, unit, (least, most), margin) in ranges {
            // Written so that a NaN is refused as well.
            if !(value >= least / margin && value <= most * margin) {
                let what = format!(
                    "{name} {value}{unit} is too far from the {least} .. {most}{unit} the policy was trained on"
                );
                return Err(Error::query(what, format!("check the unit, or train with this {name} among the samples")));
            }
        }
        Ok(self.look(&View::new(points, up, self.card.points), query.table_below_m))
    }

    /// The object as the network sees it.
    pub(crate) fn look(&self, view: &View, table_below_m: Option<f64>) -> Scene {
        let frame = view.frame(&UnitQuaternion::identity(), &Vector3::zeros(), table_below_m);
        let (length, frequencies) = (self.card.normalisation.length_m, self.card.network.frequencies);
        Scene { frame, encoded: view.encode(&frame, length, frequencies, Vector3::zeros) }
    }

    /// [`predict`](Self::predict) for several (mass, friction) at once, without checks, modes in their own order.
    pub(crate) fn propose(&self, scene: &Scene, loads: &[(f64, f64)]) -> Result<Vec<Vec<PredictedGrasp>>> {
        let norm = &self.card.normalisation;
        let scalars: Vec<f32> = loads.iter().flat_map(|&(m, f)| norm.scalars(m, f, scene.frame.table_m)).collect();
        let outputs = net::outputs(&self.weights, &scene.encoded, &scalars)?;
        let rows = outputs.chunks_exact(self.card.network.modes * self.card.network.mode_width());
        Ok(rows.zip(loads).map(|(row, load)| self.decode(row, scene, *load)).collect())
    }

    /// The grasps that one row of outputs stands for, modes in their own order.
    pub(crate) fn decode(&self, row: &[f32], scene: &Scene, (mass_kg, friction): (f64, f64)) -> Vec<PredictedGrasp> {
        let (norm, layout) = (&self.card.normalisation, &self.card.network);
        let modes = row.chunks_exact(layout.mode_width());
        let log_z = log_sum_exp(modes.clone().map(|m| f64::from(m[layout.logit()])));
        let intervals = joint_intervals(&self.card.joint_limits_rad);
        let object_from_network = scene.frame.network_from_object.inverse();
        let grasp = |m: &[f32]| {
            let at = |i: usize| f64::from(m[i]);
            let angle = |j: usize| {
                let ((middle, half), (lower, upper)) = (intervals[j], self.card.joint_limits_rad[j]);
                (middle + half * STRETCH * at(j).tanh()).clamp(lower, upper)
            };
            let wrist: [f64; 9] = std::array::from_fn(|i| at(layout.wrist() + i));
            PredictedGrasp {
                joints: (0..layout.joints).map(angle).collect(),
                object_from_base: object_from_network * wrist_pose(&wrist, norm.length_m),
                contacts: (0..layout.fingers).map(|f| sigmoid(at(layout.contacts() + f))).collect(),
                grip_force_n: norm.grip_force_n(at(layout.force()), mass_kg, friction),
                weight: (at(layout.logit()) - log_z).exp(),
            }
        };
        modes.map(grasp).collect()
    }

    /// Whether this policy is for that hand, with its joints in that order.
    ///
    /// # Errors
    /// [`Error::Hand`] with what differs.
    pub fn check_hand(&self, hand: &str, joint_names: &[String]) -> Result<()> {
        same_hand((&self.card.hand, &self.card.joint_names), (hand, joint_names))
    }

    /// Name of the hand model the grasps are for.
    pub fn hand(&self) -> &str {
        &self.card.hand
    }

    /// Names of the joints, in the order of [`PredictedGrasp::joints`].
    pub fn joint_names(&self) -> &[String] {
        &self.card.joint_names
    }

    /// Lower and upper limit of each joint, rad.
    pub fn joint_limits(&self) -> &[(f64, f64)] {
        &self.card.joint_limits_rad
    }

    /// Names of the fingers, in the order of [`PredictedGrasp::contacts`].
    pub fn fingers(&self) -> &[String] {
        &self.card.fingers
    }

    /// Least and largest coefficient of friction trained on.
    pub fn friction_range(&self) -> (f64, f64) {
        (self.card.normalisation.least_friction, self.card.normalisation.most_friction)
    }

    /// Points of the object that enter the network.
    pub fn points(&self) -> usize {
        self.card.points
    }

    /// K: how many grasps [`predict`](Self::predict) returns.
    pub fn modes(&self) -> usize {
        self.card.network.modes
    }

    /// Lightest and heaviest object trained on, kg.
    pub fn mass_range_kg(&self) -> (f64, f64) {
        (self.card.normalisation.least_mass_kg, self.card.normalisation.most_mass_kg)
    }

    /// The settings it was trained with, the seed among them.
    pub fn training(&self) -> &TrainOptions {
        &self.card.training
    }

    /// SHA-256 of the data it was trained on, in hexadecimal.
    pub fn dataset_sha256(&self) -> &str {
        &self.card.dataset_sha256
    }
}

/// How widely grasps scatter about a mode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Of each joint, rad.
    pub joints_rad: Vec<f64>,
    /// Of the wrist's translation, along each axis, m.
    pub wrist_m: f64,
    /// Of the wrist's rotation, about each axis, rad.
    pub wrist_rad: f64,
}

/// Whether two hands are one: `ours` is that of a policy or checkpoint, `given` that of who uses it.
pub(crate) fn same_hand(ours: (&str, &[String]), given: (&str, &[String])) -> Result<()> {
    let wrong = |what: String, remedy: &str| {
        Err(Error::Hand { policy: ours.0.to_owned(), given: given.0.to_owned(), what, remedy: remedy.to_owned() })
    };
    if ours.0 != given.0 {
        return wrong("these are two hands".into(), "use the policy of this hand, or train one");
    }
    if ours.1 == given.1 {
        return Ok(());
    }
    let sorted = |names: &[String]| {
        let mut names = names.to_vec();
        names.sort();
        names
    };
    if sorted(ours.1) == sorted(given.1) {
        let at = ours.1.iter().zip(given.1).position(|(a, b)| a != b).unwrap_or(0);
        let what = format!("joint {at} is '{}' here and '{}' there", ours.1[at], given.1[at]);
        return wrong(what, "give the joints in the order of the policy");
    }
    let missing = ours.1.iter().find(|n| !given.1.contains(n));
    let extra = given.1.iter().find(|n| !ours.1.contains(n));
    let name = |n: Option<&String>| n.map_or("none".to_owned(), |n| format!("'{n}'"));
    wrong(format!("missing joint {}, unknown joint {}", name(missing), name(extra)), "use the joints of the policy")
}

/// Whether the points are close enough together to be something that a hand grasps.
pub(crate) fn check_size(points: &[Point3<f64>], length_m: f64) -> Result<(), String> {
    let centre = box_centre(points);
    let radius = points.iter().map(|p| (p.coords - centre).norm()).fold(0.0, f64::max);
    let most = LARGEST_OBJECT * length_m;
    if 2.0 * radius <= most {
        return Ok(());
    }
    Err(format!(
        "the object is {:.3} m across, more than the {most} m that a hand of {length_m} m can deal with",
        2.0 * radius
    ))
}

#[cfg(test)]
mod tests {
    #[test]
    fn policies_cross_threads() {
        fn shared<T: Send + Sync>() {}
        shared::<super::GraspPolicy>();
        shared::<super::PredictedGrasp>();
        shared::<crate::Error>();
    }
}
