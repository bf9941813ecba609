//! Grasps that a network trained on many objects proposes, placed on the object at hand.

use std::ops::ControlFlow;

use drex_core::Object;
use drex_grasp::{FingerClosing, Grasp, GraspOrigin};
use drex_policy::Query;
use drex_policy::proposal::ProposalNetwork;
use drex_robot::Robot;
use drex_trial::{Assumed, FindOptions, Proposal, TriedGrasp, Uncertainty, find_grasp_among, find_grasp_watched};
use nalgebra::Point3;

use crate::Result;

/// Proposals of the network for each grasp that is wanted, and neighbours of one that are tried to place it.
const PROPOSED_PER_GRASP: usize = 5;
const NEIGHBOURS: usize = 12;

/// Grasps that are placed for one that is simulated.
const PLACED_PER_SIMULATED: usize = 2;
/// Points of the object that the network sees.
const POINTS: usize = 1024;
/// Share of the conditions of the selection under which a proposed grasp has to hold, else a search may find a better one. Nothing is chosen by the trials, which
/// would no longer say how often it holds.
const GOOD_ENOUGH: f64 = 0.9;
/// About the share of the work that is done when proposals were tried.
const PROPOSALS_PART: f64 = 0.3;

/// Finds a grasp of the object by the hand that holds in simulation, as [`drex_trial::find_grasp_watched`] does, first among those that the network
/// for this hand proposes, if one ships ([`ProposalNetwork::bundled`]). Where none of them holds under nine tenths of the selection's conditions a search follows, and the better grasp of
/// the two by these conditions is taken. The same for any number of threads.
///
/// # Errors
/// As [`drex_trial::find_grasp_watched`].
pub fn find_grasp(
    object: &Object,
    hand: &Robot,
    options: &FindOptions,
    watch: &(dyn Fn(f64) -> ControlFlow<()> + Sync),
) -> Result<Option<TriedGrasp>> {
    let network = ProposalNetwork::bundled(&hand.name).filter(|n| hand.joint_names() == n.hand().joint_names);
    let Some(network) = network else { return Ok(find_grasp_watched(object, hand, options, watch)?) };
    let assumed = Assumed { mass_kg: object.mass_kg(), friction: object.friction };
    // Refuses what is no mass or no friction, in the words of a search.
    Uncertainty::new(vec![assumed.mass_kg], (assumed.friction, assumed.friction))?;
    let points = object.point_cloud(POINTS, options.seed);
    let seen: Vec<Point3<f64>> = points.iter().map(|p| object.world_from_object * p).collect();
    let closing = FingerClosing::new(hand)?;
    let most = PLACED_PER_SIMULATED * options.simulated;
    let placed = proposals(&network, &closing, object, &seen, &assumed, most, options.seed)?;
    let grasps: Vec<Grasp> = placed.into_iter().map(|p| p.grasp).collect();
    let mut best = find_grasp_among(object, hand, &grasps, options, &|part| watch(PROPOSALS_PART * part))?;
    let share = |found: &Option<TriedGrasp>| found.as_ref().map_or(0.0, |f| f.selected_share);
    if share(&best) < GOOD_ENOUGH {
        let rest = |part| watch(PROPOSALS_PART + (1.0 - PROPOSALS_PART) * part);
        let searched = find_grasp_watched(object, hand, options, &rest)?;
        if share(&searched) > share(&best) {
            best = searched;
        }
    }
    let _ = watch(1.0);
    Ok(best)
}

/// At most `most` grasps of an object at rest, the most promising first: what the network proposes for the points that are `seen` of it (world, z up, metres),
/// for the mass and the friction that are assumed, each moved until its fingers touch the object and hold it. Proposals that cannot be placed are left out.
///
/// # Errors
/// If the points are too few, or none, or the network is for another hand.
pub fn proposals(
    network: &ProposalNetwork,
    closing: &FingerClosing<'_>,
    object: &Object,
    seen: &[Point3<f64>],
    assumed: &Assumed,
    most: usize,
    seed: u64,
) -> Result<Vec<Proposal>> {
    let query = Query::new(seen, assumed.mass_kg, assumed.friction);
    let object_from_world = object.world_from_object.inverse();
    let mut placed = Vec::new();
    for (i, p) in network.propose(&query, PROPOSED_PER_GRASP * most)?.into_iter().enumerate() {
        if placed.len() == most {
            break;
        }
        let mut grasp = Grasp::new(closing.robot(), p.joints, object_from_world * p.object_from_base);
        (grasp.hand, grasp.joint_names) = (network.hand().name.clone(), network.hand().joint_names.clone());
        grasp.origin = GraspOrigin::Predicted;
        let near = closing.placed_near(object, &grasp, NEIGHBOURS, seed, i as u64)?;
        placed.extend(near.map(|grasp| Proposal { grasp, grip_force_n: p.grip_force_n, weight: p.weight }));
    }
    Ok(placed)
}
