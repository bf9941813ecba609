//! Which of the grasps that a policy proposes is tried first.

use std::cmp::Ordering;

use crate::Result;
use drex_policy::{GraspPolicy, PredictedGrasp, Query};

/// A grasp at least this many times as probable as the most probable one is as good as that: what a network thinks of grasps that all held
/// differs by less.
const AS_GOOD: f64 = 0.5;

/// What the policy proposes, in the order of [`sort`].
///
/// # Errors
/// If the policy is not defined for what is asked.
pub fn proposals(policy: &GraspPolicy, query: &Query<'_>) -> Result<Vec<PredictedGrasp>> {
    let mut grasps = policy.predict(query)?;
    sort(&mut grasps, |g| g.weight, |g| g.grip_force_n);
    Ok(grasps)
}

/// Sorts proposals: those as good as the most probable one by how little they grip, `grip_force_n`, then the others by how probable they are,
/// `weight`. What needs less force leaves more of the motors, and presses less on the object.
pub fn sort<T>(proposals: &mut [T], weight: impl Fn(&T) -> f64, grip_force_n: impl Fn(&T) -> f64) {
    let most = proposals.iter().map(&weight).fold(0.0, f64::max);
    let good = |p: &T| weight(p) >= AS_GOOD * most;
    proposals.sort_by(|a, b| match (good(a), good(b)) {
        (true, true) => grip_force_n(a).total_cmp(&grip_force_n(b)),
        (false, false) => weight(b).total_cmp(&weight(a)),
        (true, false) => Ordering::Less,
        (false, true) => Ordering::Greater,
    });
}

#[cfg(test)]
mod tests {
    use super::sort;

    #[test]
    fn of_what_is_as_probable_the_gentlest_comes_first() {
        // Weight and newtons.
        let mut proposals = [(0.1, 1.0), (0.3, 5.0), (0.4, 9.0), (0.15, 0.5), (0.25, 6.0)];
        sort(&mut proposals, |p| p.0, |p| p.1);
        assert_eq!(proposals, [(0.3, 5.0), (0.25, 6.0), (0.4, 9.0), (0.15, 0.5), (0.1, 1.0)]);
    }
}
