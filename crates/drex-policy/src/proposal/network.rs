//! A network that proposes grasps for objects it has not seen, and its file.

use std::path::Path;

use drex_core::Pose;
use drex_core::pose::upright;
use nalgebra::{Point3, Translation3, Unit};
use serde::{Deserialize, Serialize};

use super::forward::Forward;
use super::prototypes::Prototype;
use super::scene::Scene;
use super::weights::Layout;
use crate::data::GRAVITY_M_S2;
use crate::{Error, PredictedGrasp, Query, Result, tensors};

/// Rates of places and prototypes that are decoded for one grasp that is proposed.
const DECODED_PER_GRASP: usize = 12;
/// Grasps that differ by less are one: shift of the base, metres, its turn and that of any joint, rad.
const SAME_M: f64 = 0.012;
const SAME_RAD: f64 = 0.25;
/// Objects whose points are farther apart are taken for a mistake in the units, metres.
const LARGEST_M: f64 = 2.0;
/// Numbers of a prototype besides its joints: translation, quaternion (w, x, y, z), force ratio.
const POSE: usize = 7;

/// The hand that a network is for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandCard {
    /// Name of its model.
    pub name: String,
    /// Names of the joints, model order.
    pub joint_names: Vec<String>,
    /// Lower and upper limit of each, rad.
    pub joint_limits_rad: Vec<(f64, f64)>,
}

/// What the arrays of a file mean.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Card {
    format: String,
    version: u32,
    hand: HandCard,
    layout: Layout,
    /// Objects that it was trained on, and grasps of them.
    objects: usize,
    grasps: usize,
    seed: u64,
}

/// Networks that ship with the crate, by the name of the hand's model.
const BUNDLED: [(&str, &[u8]); 2] = [
    ("leap_right", include_bytes!("../../weights/leap_right.safetensors")),
    ("allegro_right", include_bytes!("../../weights/allegro_right.safetensors")),
];

/// Says what a file is; the number is raised when the meaning of an array changes.
const FORMAT: &str = "drex-grasp-proposals";
const VERSION: u32 = 1;

/// A network trained on grasps of many objects ([`train`](super::train)).
///
/// It looks at an object from places on its surface. There its frame has z up and x away from the middle of the object, so that proposals turn with the
/// object about the vertical. For each place a PointNet (Qi et al. 2017) says for each of K prototypes at which rate a search would find
/// grasps like it that carry the mass at the friction: a Poisson process whose rate is learned from what was found for other objects. The most
/// frequent ones are changed by what a second head says and merged where several places propose the same.
#[derive(Debug, Clone, PartialEq)]
pub struct ProposalNetwork {
    card: Card,
    pub(super) prototypes: Vec<Prototype>,
    pub(super) arrays: Vec<Vec<f32>>,
}

impl ProposalNetwork {
    pub(super) fn new(
        hand: HandCard,
        prototypes: Vec<Prototype>,
        arrays: Vec<Vec<f32>>,
        (objects, grasps): (usize, usize),
        seed: u64,
    ) -> Self {
        let layout = Layout { joints: hand.joint_names.len(), prototypes: prototypes.len() };
        let card = Card { format: FORMAT.into(), version: VERSION, hand, layout, objects, grasps, seed };
        Self { card, prototypes, arrays }
    }

    /// The network that ships with the crate for a hand model of this name, if there is one: for `leap_right` and `allegro_right`. How they were trained stands
    /// in `weights/README.md`.
    pub fn bundled(hand: &str) -> Option<Self> {
        let (_, bytes) = BUNDLED.iter().find(|(name, _)| *name == hand)?;
        // A test reads each of them.
        Self::from_bytes(bytes).ok()
    }

    /// The hand that it proposes grasps for.
    pub fn hand(&self) -> &HandCard {
        &self.card.hand
    }

    /// Objects that it was trained on.
    pub fn trained_objects(&self) -> usize {
        self.card.objects
    }

    /// At most `count` grasps for what is seen of an object, the most promising first; their weights sum to one, and nothing is known of their
    /// contacts. The table is at the lowest of the points or as the query says. The points may be those that one camera sees.
    ///
    /// # Errors
    /// [`Error::Query`] for fewer than 16 points, points that are not finite or metres apart, an up that is none, a mass or a friction that is not
    /// positive.
    pub fn propose(&self, query: &Query<'_>, count: usize) -> Result<Vec<PredictedGrasp>> {
        let scene_from_points = scene_from_points(query)?;
        let points: Vec<Point3<f64>> = query.points.iter().map(|p| scene_from_points * p).collect();
        let scene = Scene::new(&points);
        let anchors = scene.anchors();
        let (mut patches, mut scalars) = (Vec::new(), Vec::new());
        for anchor in &anchors {
            scene.patch(anchor, &mut patches);
            scene.scalars(anchor, query.mass_kg, query.friction, &mut scalars);
        }
        let forward = Forward::new(&self.card.layout, &self.arrays);
        let places = forward.places(&patches, &scalars);
        let mut pairs: Vec<(f32, (usize, usize))> = Vec::new();
        for (place, rates) in places.log_rates.column_iter().enumerate() {
            pairs.extend(rates.iter().enumerate().map(|(prototype, rate)| (*rate, (place, prototype))));
        }
        let most = (DECODED_PER_GRASP * count).min(pairs.len());
        if most == 0 {
            return Ok(Vec::new());
        }
        let order = |a: &(f32, (usize, usize)), b: &(f32, (usize, usize))| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1));
        pairs.select_nth_unstable_by(most - 1, order);
        pairs.truncate(most);
        pairs.sort_unstable_by(order);
        let (rates, pairs): (Vec<f32>, Vec<(usize, usize)>) = pairs.into_iter().unzip();
        let changes = forward.changes(&places.features, &pairs);
        let points_from_scene = scene_from_points.inverse();
        let weight_n = query.mass_kg * GRAVITY_M_S2;
        let mut found: Vec<PredictedGrasp> = Vec::new();
        for ((rate, (place, prototype)), change) in rates.iter().zip(&pairs).zip(changes.column_iter()) {
            let prototype = &self.prototypes[*prototype];
            let (mut joints, anchor_from_base) = prototype.changed(change.iter().copied());
            for (q, (lo, hi)) in joints.iter_mut().zip(&self.card.hand.joint_limits_rad) {
                *q = q.clamp(*lo, *hi);
            }
            let object_from_base = points_from_scene * anchors[*place] * anchor_from_base;
            let weight = f64::from(*rate).exp();
            // Votes of several places for one grasp are one grasp with the sum of their rates.
            match found.iter_mut().find(|f| is_same(f, &joints, &object_from_base)) {
                Some(same) => same.weight += weight,
                None => found.push(PredictedGrasp {
                    joints,
                    object_from_base,
                    contacts: Vec::new(),
                    grip_force_n: prototype.force_ratio * weight_n / query.friction,
                    weight,
                }),
            }
        }
        found.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        found.truncate(count);
        let total: f64 = found.iter().map(|g| g.weight).sum();
        found.iter_mut().for_each(|g| g.weight /= total);
        Ok(found)
    }

    /// Writes a safetensors file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        Ok(drex_core::fsutil::write_atomic(path, &self.to_bytes()?)?)
    }

    /// Reads what [`save`](Self::save) wrote.
    ///
    /// # Errors
    /// If the file cannot be read or is no such network.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = drex_core::fsutil::read_bytes(path)?;
        let remedy = "train it again, or take a copy that is whole";
        Self::from_bytes(&bytes).map_err(|what| Error::file(path, what, remedy))
    }

    pub(super) fn to_bytes(&self) -> Result<Vec<u8>> {
        let note = serde_json::to_string(&self.card).map_err(|e| Error::Backend { what: e.to_string() })?;
        let k = self.prototypes.len();
        let joints: Vec<f32> = self.prototypes.iter().flat_map(|p| p.joints.iter().map(|q| *q as f32)).collect();
        let poses: Vec<f32> = self
            .prototypes
            .iter()
            .flat_map(|p| {
                let (t, q) = (p.anchor_from_base.translation.vector, p.anchor_from_base.rotation.quaternion());
                [t.x, t.y, t.z, q.w, q.i, q.j, q.k].map(|v| v as f32)
            })
            .collect();
        let ratios: Vec<f32> = self.prototypes.iter().map(|p| p.force_ratio as f32).collect();
        let named = self.card.layout.arrays().into_iter().zip(&self.arrays);
        let mut arrays: Vec<tensors::Array<'_>> = named.map(|((n, s), v)| (n.to_owned(), s, v.as_slice())).collect();
        arrays.push(("prototype.joints".into(), [k, self.card.layout.joints], &joints));
        arrays.push(("prototype.pose".into(), [k, POSE], &poses));
        arrays.push(("prototype.force_ratio".into(), [k, 1], &ratios));
        Ok(tensors::to_bytes(&arrays, Some(&note)))
    }

    pub(super) fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let card: Card = serde_json::from_str(&tensors::note(bytes)?).map_err(|e| format!("its card: {e}"))?;
        if card.format != FORMAT || card.version != VERSION {
            return Err(format!("it is {} {}, not {FORMAT} {VERSION}", card.format, card.version));
        }
        let Layout { joints, prototypes } = card.layout;
        if joints != card.hand.joint_names.len() || joints != card.hand.joint_limits_rad.len() {
            return Err(format!("its card has {joints} joints and names others"));
        }
        if card.hand.joint_limits_rad.iter().any(|(lo, hi)| !(lo <= hi)) {
            return Err("a joint of its card has no range".into());
        }
        // The header is no longer than the file, but sizes in it may be anything.
        if joints > 1000 || prototypes == 0 || prototypes > 100_000 {
            return Err(format!("its card has {joints} joints and {prototypes} prototypes"));
        }
        let mut expected: Vec<_> = card.layout.arrays().into_iter().map(|(n, s)| (n.to_owned(), s)).collect();
        expected.push(("prototype.joints".into(), [prototypes, joints]));
        expected.push(("prototype.pose".into(), [prototypes, POSE]));
        expected.push(("prototype.force_ratio".into(), [prototypes, 1]));
        let mut arrays = tensors::from_bytes(&expected, bytes)?;
        let rest = arrays.split_off(arrays.len() - 3);
        let [q, poses, ratios] = &rest[..] else { return Err("its prototypes are missing".into()) };
        let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
        let prototype = |k: usize| {
            let p = wide(&poses[k * POSE..(k + 1) * POSE]);
            let pose = drex_core::PoseRecord { translation_m: [p[0], p[1], p[2]], quat_wxyz: [p[3], p[4], p[5], p[6]] };
            Ok(Prototype {
                joints: wide(&q[k * joints..(k + 1) * joints]),
                anchor_from_base: pose.to_pose().map_err(|e| format!("prototype {k}: {e}"))?,
                force_ratio: f64::from(ratios[k]),
            })
        };
        let prototypes = (0..prototypes).map(prototype).collect::<Result<_, String>>()?;
        Ok(Self { card, prototypes, arrays })
    }
}

/// The frame of the points in that of the scene: z up, the table at zero.
fn scene_from_points(query: &Query<'_>) -> Result<Pose> {
    let bounds = |points: &mut dyn Iterator<Item = Point3<f64>>| {
        points.fold((Point3::from([f64::INFINITY; 3]), Point3::from([f64::NEG_INFINITY; 3])), |(lo, hi), p| {
            (lo.inf(&p), hi.sup(&p))
        })
    };
    let points = query.points;
    if points.len() < 16 || points.iter().any(|p| !p.iter().all(|v| v.is_finite())) {
        let what = format!("{} points, or one that is not finite", points.len());
        return Err(Error::query(what, "give at least 16 finite points of the object's surface, in metres"));
    }
    let (lo, hi) = bounds(&mut points.iter().copied());
    if (hi - lo).norm() > LARGEST_M {
        let what = format!("the points are {:.1} m apart", (hi - lo).norm());
        return Err(Error::query(what, "give metres, and the points of the object alone"));
    }
    let Some(up) = Unit::try_new(query.up, 1e-9).filter(|u| u.iter().all(|v| v.is_finite())) else {
        return Err(Error::query("up has no direction", "give the direction against gravity"));
    };
    for (name, value) in [("mass", query.mass_kg), ("friction", query.friction)] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(Error::query(format!("a {name} of {value}"), "give a positive number"));
        }
    }
    let turn = upright(&up);
    let (lo, hi) = bounds(&mut points.iter().map(|p| turn * p));
    let table_m = match query.table_below_m {
        Some(below_m) if below_m.is_finite() => 0.5 * (lo.z + hi.z) - below_m,
        Some(below_m) => return Err(Error::query(format!("a table {below_m} m below"), "give metres, or none")),
        None => lo.z,
    };
    Ok(Translation3::new(0.0, 0.0, -table_m) * turn)
}

fn is_same(grasp: &PredictedGrasp, joints: &[f64], object_from_base: &Pose) -> bool {
    let between = grasp.object_from_base.inverse() * object_from_base;
    between.translation.vector.norm() < SAME_M
        && between.rotation.angle() < SAME_RAD
        && grasp.joints.iter().zip(joints).all(|(a, b)| (a - b).abs() < SAME_RAD)
}

#[cfg(all(test, feature = "flex"))]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::ops::ControlFlow;

    use nalgebra::Vector3;

    use super::super::{GraspedObject, LABELLED_KG, LabelledGrasp, ProposalOptions, train};
    use super::*;

    /// A box of these half sides on the table, turned.
    fn surface([x, y, z]: [f64; 3], turn: &Pose) -> Vec<Point3<f64>> {
        let mut points = Vec::new();
        for i in 0..12 {
            for j in 0..12 {
                let [a, b] = [i, j].map(|k| f64::from(k) / 5.5 - 1.0);
                for side in [-1.0, 1.0] {
                    points.extend([[a * x, b * y, side * z], [a * x, side * y, b * z], [side * x, a * y, b * z]]);
                }
            }
        }
        // A little off: among points that are equally far the farthest would be a matter of rounding.
        let off = |i: usize| Vector3::from_fn(|k, _| 5e-4 * (1.7 * (3 * i + k) as f64).sin());
        let point = |(i, p): (usize, [f64; 3])| turn * (Point3::from(p) + Vector3::z() * z + off(i));
        points.into_iter().enumerate().map(point).collect()
    }

    /// Two fingers, one joint each, that come from above and pinch across the y of the box: a joint is as far open as the box is wide.
    fn pinched(number: usize) -> GraspedObject {
        let half = [0.03, 0.012 + 0.001 * number as f64, 0.025 + 0.002 * (number % 5) as f64];
        let turn = Pose::rotation(Vector3::z() * (0.7 * number as f64));
        let narrow = |p: Point3<f64>| <[f64; 3]>::from(p.coords).map(|v| v as f32);
        let grasp = |flip: bool| {
            let world_from_base = turn
                * Pose::translation(0.0, 0.0, half[2] + 0.06)
                * Pose::rotation(Vector3::z() * if flip { std::f64::consts::PI } else { 0.0 });
            let keys = [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, half[1], -0.06], [0.0, -half[1], -0.06]];
            LabelledGrasp {
                joints_rad: vec![(10.0 * half[1]) as f32; 2],
                world_from_base,
                key_points: keys.map(|k| narrow(world_from_base * Point3::from(k))).to_vec(),
                contacts: [1.0, -1.0].map(|s| narrow(turn * Point3::new(0.0, s * half[1], half[2]))).to_vec(),
                least_friction: vec![Some(0.2); LABELLED_KG.len()],
                grip_force_n: LABELLED_KG.map(|m| Some((m * GRAVITY_M_S2 / 0.2) as f32)).to_vec(),
                stands_for: 1.0,
                held: Some(true),
            }
        };
        let points = surface(half, &turn).into_iter().map(narrow).collect();
        GraspedObject {
            name: format!("box {number}"),
            points,
            views: Vec::new(),
            grasps: vec![grasp(false), grasp(true)],
        }
    }

    fn hand() -> HandCard {
        let joint_names = ["left", "right"].map(String::from).to_vec();
        HandCard { name: "pincher".into(), joint_names, joint_limits_rad: vec![(0.0, 1.0); 2] }
    }

    fn toy(steps: usize) -> ProposalNetwork {
        let objects: Vec<GraspedObject> = (0..12).map(pinched).collect();
        let options = ProposalOptions { prototypes: 16, steps, scenes: 2, places: 24, learning_rate: 3e-3, seed: 4 };
        train(&objects, hand(), &options, &mut |_| ControlFlow::Continue(())).unwrap()
    }

    #[test]
    fn a_toy_learns_to_pinch_a_box_that_it_has_not_seen_whichever_way_it_is_turned() {
        let network = toy(200);
        let propose = |half_width: f64, turn: &Pose| {
            let half = [0.03, half_width, 0.03];
            let points = surface(half, turn);
            let found = network.propose(&Query::new(&points, 0.2, 0.5), 2).unwrap();
            found.into_iter().map(|g| (turn.inverse() * g.object_from_base, g)).collect::<Vec<_>>()
        };
        let found = propose(0.0175, &Pose::identity());
        let total: f64 = found.iter().map(|(_, g)| g.weight).sum();
        assert!((total - 1.0).abs() < 1e-9 && found[0].1.weight >= found[1].1.weight);
        let (pose, best) = &found[0];
        // Over the middle, across y one way or the other, as wide as the box, and with m g / mu.
        let (at, across) = (pose.translation.vector, pose.rotation * Vector3::y());
        assert!((at - Vector3::new(0.0, 0.0, 0.09)).norm() < 0.012, "{at}");
        assert!(across.y.abs() > 0.95, "{across}");
        let open = |half_width: f64| propose(half_width, &Pose::identity())[0].1.joints.iter().sum::<f64>() / 2.0;
        let (thin, wide) = (open(0.0135), open(0.0215));
        assert!((thin - 0.135).abs() < 0.06 && (wide - 0.215).abs() < 0.06 && wide - thin > 0.01, "{thin} {wide}");
        assert!((best.grip_force_n - 0.2 * GRAVITY_M_S2 / 0.5).abs() < 1e-3, "{}", best.grip_force_n);
        let turned = propose(0.0175, &Pose::new(Vector3::new(0.4, 0.1, 0.0), Vector3::z() * 1.234));
        for ((a, g), (b, h)) in found.iter().zip(&turned) {
            assert!(
                (a.translation.vector - b.translation.vector).norm() < 1e-4 && a.rotation.angle_to(&b.rotation) < 1e-3
            );
            assert!((g.weight - h.weight).abs() < 1e-3);
        }
    }

    #[test]
    fn what_is_saved_is_what_is_loaded_and_what_is_damaged_is_refused() {
        let network = toy(3);
        let bytes = network.to_bytes().unwrap();
        let loaded = ProposalNetwork::from_bytes(&bytes).unwrap();
        assert_eq!(loaded.to_bytes().unwrap(), bytes);
        assert_eq!((loaded.hand(), loaded.trained_objects()), (&hand(), 12));
        let points = surface([0.03, 0.02, 0.03], &Pose::identity());
        let ask =
            |n: &ProposalNetwork, points: &[Point3<f64>], mass_kg: f64| n.propose(&Query::new(points, mass_kg, 0.5), 5);
        // Poses of prototypes are kept in single precision.
        let (a, b) = (ask(&network, &points, 0.2).unwrap(), ask(&loaded, &points, 0.2).unwrap());
        assert!(!a.is_empty() && a.len() == b.len());
        assert!(a.iter().zip(&b).all(|(a, b)| a.joints.iter().zip(&b.joints).all(|(p, q)| (p - q).abs() < 1e-5)));
        for end in [0, 7, 8, 100, bytes.len() / 2, bytes.len() - 1] {
            assert!(ProposalNetwork::from_bytes(&bytes[..end]).is_err(), "{end} bytes");
        }
        let text = String::from_utf8_lossy(&bytes).replace("drex-grasp-proposals", "drex-grasp-proposalz");
        assert!(ProposalNetwork::from_bytes(text.as_bytes()).is_err());
        for (points, mass_kg) in
            [(&points[..3], 0.2), (&points[..], f64::NAN), (&[Point3::new(f64::NAN, 0.0, 0.0); 20][..], 0.2)]
        {
            assert!(ask(&network, points, mass_kg).is_err());
        }
        let far = [Point3::origin(), Point3::new(5.0, 0.0, 0.0)].repeat(10);
        assert!(ask(&network, &far, 0.2).unwrap_err().to_string().contains("metres"));
    }

    #[test]
    fn the_shipped_networks_propose_grasps_that_turn_with_the_object() {
        assert!(ProposalNetwork::bundled("no_hand").is_none());
        for (hand, bytes) in BUNDLED {
            assert!(bytes.len() < 5_000_000, "{hand}: {} bytes", bytes.len());
            let network = ProposalNetwork::bundled(hand).unwrap();
            assert!(network.hand().name == hand && network.trained_objects() >= 300);
            let half = [0.025, 0.02, 0.05];
            let ask = |turn: &Pose, mass_kg: f64, friction: f64| {
                let points = surface(half, turn);
                network.propose(&Query::new(&points, mass_kg, friction), 10).unwrap()
            };
            let turn = Pose::new(Vector3::new(0.2, 0.1, 0.0), Vector3::z() * 2.4);
            let (found, turned) = (ask(&Pose::identity(), 0.1, 0.5), ask(&turn, 0.1, 0.5));
            assert_eq!(found.len(), 10);
            for (a, b) in found.iter().zip(&turned) {
                let apart = (turn * a.object_from_base).inverse() * b.object_from_base;
                assert!(apart.translation.vector.norm() < 1e-3 && apart.rotation.angle() < 0.01, "{apart}");
                assert!(a.joints.iter().zip(&network.hand().joint_limits_rad).all(|(q, (lo, hi))| q >= lo && q <= hi));
            }
            // What is heavier and smoother is held otherwise, and harder.
            let heavy = ask(&Pose::identity(), 0.5, 0.3);
            assert!(heavy[0].object_from_base != found[0].object_from_base || heavy[0].joints != found[0].joints);
            let force = |all: &[PredictedGrasp]| all.iter().map(|g| g.grip_force_n).sum::<f64>();
            assert!(force(&heavy) > 3.0 * force(&found), "{} {}", force(&heavy), force(&found));
        }
    }

    #[test]
    fn data_that_do_not_fit_are_refused() {
        let refused = |change: fn(&mut GraspedObject)| {
            let mut object = pinched(0);
            change(&mut object);
            let options = ProposalOptions { steps: 1, ..ProposalOptions::default() };
            train(&[object], hand(), &options, &mut |_| ControlFlow::Continue(())).unwrap_err().to_string()
        };
        assert!(refused(|o| o.grasps.clear()).contains("no object has a grasp"));
        assert!(refused(|o| o.grasps[1].joints_rad.push(0.0)).contains("\"box 0\""));
        assert!(refused(|o| o.views.push(vec![9999])).contains("\"box 0\""));
        assert!(refused(|o| o.points.truncate(3)).contains("\"box 0\""));
    }
}
