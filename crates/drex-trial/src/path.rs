//! From grasps that are proposed to what the hand is commanded: the one path of tables, pipelines and hands.

use std::cmp::Ordering;

use drex_grasp::Grasp;

use crate::{Assumed, Error, Evaluator, GripForce, NoCommand, Result};

/// A grasp at least this many times as probable as the most probable one is as good as that: what a network thinks of grasps that all held
/// differs by less.
const AS_GOOD: f64 = 0.5;
/// Shares of the assumed friction at which a proposal is chosen: the first of them at which the hand has a force with any of the proposals. What carries an object
/// that is smoother survives more of what a rollout has that no plan knows. On 24 random objects on which this was chosen 85 of 144 rollouts held, 78 without.
const CAUTION: [f64; 4] = [0.6, 0.75, 0.9, 1.0];

/// A grasp that somebody proposes for an object.
#[derive(Debug, Clone, PartialEq)]
pub struct Proposal {
    /// The grasp.
    pub grasp: Grasp,
    /// Grip force by whoever proposes it, sum of the normal forces, N.
    pub grip_force_n: f64,
    /// Probability among those proposed.
    pub weight: f64,
}

/// How hard the hand of a [`GraspPath`] grips.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PathForce {
    /// With what the grip-force policy asks for at the contacts.
    Required,
    /// With what the proposal says.
    Proposed,
    /// With this many newtons, whatever is grasped.
    Fixed(f64),
}

/// Steps from proposals to a command. The default is what a hand does; the others say what each step is worth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GraspPath {
    /// Whether the hand is closed in a dry run. Without it the contacts are those of the proposed grasp as it is.
    pub dry_run: bool,
    /// Whether the proposal is taken that carries the object at the lowest friction, and not the first that carries it at the friction that is assumed.
    pub cautious: bool,
    /// How hard the hand grips.
    pub force: PathForce,
}

/// What the path leads to.
pub struct PlannedGrasp<E: Evaluator> {
    /// The proposal that was taken.
    pub proposal: Proposal,
    /// Its place in the order in which proposals are tried, from 1.
    pub place: usize,
    /// The hand, closed.
    pub closed: E::Closed,
    /// Place of what it is commanded for among the assumptions, from 0.
    pub turn: usize,
    /// Its command; else why none of the proposals has one: the reason of the first.
    pub command: std::result::Result<E::Command, NoCommand>,
}

impl Default for GraspPath {
    /// With a dry run, cautious, and with the force that its contacts require.
    fn default() -> Self {
        Self { dry_run: true, cautious: true, force: PathForce::Required }
    }
}

impl GraspPath {
    /// Takes the first of the proposals, as [`sort_proposals`] has them, for which the hand has a command at six, seven and a half, nine or ten tenths of the
    /// assumed friction, the lowest at which it has one for any; the command is for the whole of it. Without one it is the first proposal, with the reason.
    ///
    /// # Errors
    /// If there is no proposal, or one is no grasp of the hand, or a solver gives up.
    pub fn plan<E: Evaluator>(
        &self,
        evaluator: &E,
        proposals: Vec<Proposal>,
        assumed: &Assumed,
    ) -> Result<PlannedGrasp<E>> {
        self.plan_in_turn(evaluator, proposals, std::slice::from_ref(assumed))
    }

    /// [`GraspPath::plan`] where it is not known what to assume: for the first of these, the most cautious one, for which the hand has a command with any of
    /// the proposals. Each proposal is closed once, for the last of them.
    ///
    /// # Errors
    /// As [`GraspPath::plan`]; if nothing is assumed.
    pub fn plan_in_turn<E: Evaluator>(
        &self,
        evaluator: &E,
        mut proposals: Vec<Proposal>,
        assumptions: &[Assumed],
    ) -> Result<PlannedGrasp<E>> {
        sort_proposals(&mut proposals);
        let Some(last) = assumptions.last() else {
            return Err(Error::value("nothing is assumed of the object", "give a mass and a friction"));
        };
        let shares = if self.cautious && assumptions.len() == 1 { &CAUTION[..] } else { &[1.0] };
        let tried = assumptions.iter().enumerate().flat_map(|(turn, a)| {
            shares.iter().map(move |share| (turn, Assumed { friction: share * a.friction, ..*a }))
        });
        let mut closed: Vec<E::Closed> = Vec::with_capacity(proposals.len());
        let mut chosen = None;
        'chosen: for (turn, assumed) in tried {
            for (i, proposal) in proposals.iter().enumerate() {
                if closed.len() == i {
                    closed.push(match self.dry_run {
                        true => evaluator.close(&proposal.grasp, last)?,
                        false => evaluator.as_proposed(&proposal.grasp, last)?,
                    });
                }
                if evaluator.grip_force_n(&closed[i], &assumed, self.grip_force(proposal))?.is_ok() {
                    chosen = Some((i, turn));
                    break 'chosen;
                }
            }
        }
        if closed.is_empty() {
            return Err(Error::value(
                "no grasp is proposed",
                "ask a policy that has learned one, or search for grasps",
            ));
        }
        // Without one the first of them says why.
        let (i, turn) = chosen.unwrap_or_default();
        let command = evaluator.command(&closed[i], &assumptions[turn], self.grip_force(&proposals[i]))?;
        let (proposal, closed) = (proposals.swap_remove(i), closed.swap_remove(i));
        Ok(PlannedGrasp { proposal, place: i + 1, closed, turn, command })
    }

    /// How hard the hand grips with this proposal.
    pub fn grip_force(&self, proposal: &Proposal) -> GripForce {
        match self.force {
            PathForce::Required => GripForce::Required,
            PathForce::Proposed => GripForce::Total(proposal.grip_force_n),
            PathForce::Fixed(n) => GripForce::Total(n),
        }
    }
}

/// Sorts proposals: those as good as the most probable one by how little they grip, then the others by how probable they are. What needs
/// less force leaves more of the motors, and presses less on the object.
pub fn sort_proposals(proposals: &mut [Proposal]) {
    let most = proposals.iter().map(|p| p.weight).fold(0.0, f64::max);
    let good = |p: &Proposal| p.weight >= AS_GOOD * most;
    proposals.sort_by(|a, b| match (good(a), good(b)) {
        (true, true) => a.grip_force_n.total_cmp(&b.grip_force_n),
        (false, false) => b.weight.total_cmp(&a.weight),
        (true, false) => Ordering::Less,
        (false, true) => Ordering::Greater,
    });
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use drex_core::Pose;
    use drex_robot::Robot;

    use super::*;
    use crate::formula::PinchByFirstJoint;

    /// As strong, N, as the first joint says, as probable as the weight says, with this force.
    fn proposals(of: &[(f64, f64, f64)]) -> Vec<Proposal> {
        let hand = Robot::bundled("leap_right").unwrap();
        let proposal = |&(strongest_n, weight, grip_force_n): &(f64, f64, f64)| Proposal {
            grasp: Grasp { joints_rad: vec![strongest_n], ..Grasp::new(&hand, Vec::new(), Pose::identity()) },
            grip_force_n,
            weight,
        };
        of.iter().map(proposal).collect()
    }

    #[test]
    fn the_first_that_has_a_command_is_taken_else_the_first_one_says_why() {
        // 100 g at friction 0.5 take 3.6 N.
        let assumed = Assumed { mass_kg: 0.1, friction: 0.5 };
        let plan = |of: &[(f64, f64, f64)], path: GraspPath| path.plan(&PinchByFirstJoint, proposals(of), &assumed);
        let four = [(3.0, 1.0, 1.0), (2.0, 1.0, 2.0), (50.0, 1.0, 3.0), (60.0, 1.0, 4.0)];
        let planned = plan(&four, GraspPath::default()).unwrap();
        assert_eq!((planned.place, planned.closed, planned.proposal.grip_force_n), (3, 50.0, 3.0));
        assert!((planned.command.unwrap() - 3.597).abs() < 1e-3);
        let none = plan(&four[..2], GraspPath::default()).unwrap();
        assert_eq!((none.place, none.closed), (1, 3.0));
        assert!(matches!(none.command, Err(NoCommand::TorqueLimit(_))));
        assert!(plan(&[], GraspPath::default()).err().unwrap().to_string().contains("no grasp is proposed"));

        let force = |force| plan(&four, GraspPath { force, ..GraspPath::default() }).unwrap();
        let proposed = force(PathForce::Proposed);
        assert_eq!((proposed.place, proposed.command), (1, Ok(1.0)));
        let fixed = force(PathForce::Fixed(20.0));
        assert_eq!((fixed.place, fixed.command), (3, Ok(20.0)));
    }

    #[test]
    fn of_what_carries_the_object_the_one_is_taken_that_would_carry_it_were_it_smoother() {
        // 3.6 N at 0.5, 4.8 N at 0.375, 6.0 N at 0.3.
        let assumed = Assumed { mass_kg: 0.1, friction: 0.5 };
        let plan = |of: &[(f64, f64, f64)], cautious: bool| {
            let path = GraspPath { cautious, ..GraspPath::default() };
            let planned = path.plan(&PinchByFirstJoint, proposals(of), &assumed).unwrap();
            (planned.place, planned.turn, (planned.command.unwrap() * 10.0).round())
        };
        let three = [(4.0, 1.0, 1.0), (5.0, 1.0, 2.0), (7.0, 1.0, 3.0)];
        assert_eq!(plan(&three, true), (3, 0, 36.0));
        assert_eq!(plan(&three[..2], true), (2, 0, 36.0));
        assert_eq!(plan(&three, false), (1, 0, 36.0));
    }

    #[test]
    fn the_most_cautious_assumption_with_a_command_is_taken_for_any_proposal() {
        let assume = |friction: f64| Assumed { mass_kg: 0.1, friction };
        let four = [(3.0, 1.0, 1.0), (2.0, 1.0, 2.0), (5.0, 1.0, 3.0), (6.5, 1.0, 4.0)];
        let plan = |assumptions: &[Assumed]| {
            GraspPath::default().plan_in_turn(&PinchByFirstJoint, proposals(&four), assumptions)
        };
        // 6.0 N at 0.3, which only the last one has, and 3.6 N at 0.5.
        let cautious = plan(&[assume(0.2), assume(0.3), assume(0.5)]).unwrap();
        assert_eq!((cautious.place, cautious.closed, cautious.turn), (4, 6.5, 1));
        let bold = plan(&[assume(0.5)]).unwrap();
        assert_eq!((bold.place, bold.closed, bold.turn), (4, 6.5, 0));
        let none = plan(&[assume(0.1), assume(0.2)]).unwrap();
        assert!(none.command.is_err() && (none.place, none.turn) == (1, 0));
        assert!(plan(&[]).err().unwrap().to_string().contains("nothing is assumed"));
    }

    #[test]
    fn of_what_is_as_probable_the_gentlest_comes_first() {
        let mut all =
            proposals(&[(0.0, 0.1, 1.0), (0.0, 0.3, 5.0), (0.0, 0.4, 9.0), (0.0, 0.15, 0.5), (0.0, 0.25, 6.0)]);
        sort_proposals(&mut all);
        let order: Vec<(f64, f64)> = all.iter().map(|p| (p.weight, p.grip_force_n)).collect();
        assert_eq!(order, [(0.3, 5.0), (0.25, 6.0), (0.4, 9.0), (0.15, 0.5), (0.1, 1.0)]);
    }
}
