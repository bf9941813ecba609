//! Grasps that a network trained on many objects proposes, placed on the object at hand.

use drex_core::Object;
use drex_grasp::{FingerClosing, Grasp, GraspOrigin};
use drex_policy::Query;
use drex_policy::proposal::ProposalNetwork;
use drex_trial::{Assumed, Proposal};
use nalgebra::Point3;

use crate::Result;

/// Proposals of the network for each grasp that is wanted, and neighbours of one that are tried to place it.
const PROPOSED_PER_GRASP: usize = 5;
const NEIGHBOURS: usize = 12;

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
