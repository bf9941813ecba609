//! Positions of chosen points of a robot and how they move with its joints, worked out link by link and nothing else.

use drex_core::Pose;
use drex_robot::{JointKind, Robot};
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

/// The chains to a set of points: links without joints are folded into their children, links that no point needs are left out.
#[derive(Debug, Clone)]
pub(crate) struct Chains {
    steps: Vec<Step>,
    /// Step and place on it of each point.
    points: Vec<(Option<usize>, Point3<f64>)>,
    /// Per point, the steps that move it.
    movers: Vec<Vec<usize>>,
}

/// One joint.
#[derive(Debug, Clone)]
struct Step {
    parent: Option<usize>,
    /// Pose of the joint's link, at the joint's reference position, in the parent step's link.
    parent_from_link: Pose,
    joint: usize,
    axis: Unit<Vector3<f64>>,
    anchor: Vector3<f64>,
    reference: f64,
    turns: bool,
}

/// Poses of the steps at one joint vector.
#[derive(Debug, Clone, Default)]
pub(crate) struct ChainState {
    poses: Vec<Pose>,
    /// Axis and a point on it.
    axes: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// The chosen points.
    pub(crate) points: Vec<Point3<f64>>,
}

impl Chains {
    /// The chains to `points` (link and place in it) of `robot`.
    pub(crate) fn new(robot: &Robot, points: &[(usize, Point3<f64>)]) -> Self {
        let mut needed = vec![false; robot.links.len()];
        for (link, _) in points {
            for l in robot.path_to(*link) {
                needed[l] = true;
            }
        }
        let mut steps: Vec<Step> = Vec::new();
        // Per link, the step that carries it and its pose there.
        let mut places: Vec<(Option<usize>, Pose)> = vec![(None, Pose::identity()); robot.links.len()];
        for (i, link) in robot.links.iter().enumerate() {
            if !needed[i] {
                continue;
            }
            let Some(parent) = link.parent else { continue };
            let (mut step, mut pose) = places[parent];
            pose *= link.parent_from_link;
            for &j in &link.joints {
                let joint = &robot.joints[j];
                steps.push(Step {
                    parent: step,
                    parent_from_link: pose,
                    joint: j,
                    axis: Unit::new_normalize(joint.axis),
                    anchor: joint.anchor.coords,
                    reference: joint.reference,
                    turns: joint.kind == JointKind::Revolute,
                });
                step = Some(steps.len() - 1);
                pose = Pose::identity();
            }
            places[i] = (step, pose);
        }
        let points: Vec<_> = points.iter().map(|(link, p)| (places[*link].0, places[*link].1 * p)).collect();
        let movers =
            points.iter().map(|(step, _)| std::iter::successors(*step, |&s| steps[s].parent).collect()).collect();
        Self { steps, points, movers }
    }

    /// Places everything at joint vector `q` (model order) with the base at `base`, in the frame that `base` leads to.
    pub(crate) fn place(&self, base: &Pose, q: &[f64], state: &mut ChainState) {
        state.poses.clear();
        state.axes.clear();
        for step in &self.steps {
            let travel = q[step.joint] - step.reference;
            let at = match step.parent {
                Some(parent) => state.poses[parent] * step.parent_from_link,
                None => base * step.parent_from_link,
            };
            let motion = if step.turns {
                let rotation = UnitQuaternion::from_axis_angle(&step.axis, travel);
                Isometry3::from_parts(Translation3::from(step.anchor - rotation * step.anchor), rotation)
            } else {
                Isometry3::from_parts(Translation3::from(step.axis.into_inner() * travel), UnitQuaternion::identity())
            };
            state.axes.push((at.rotation * step.axis.into_inner(), (at * Point3::from(step.anchor)).coords));
            state.poses.push(at * motion);
        }
        state.points.clear();
        state.points.extend(self.points.iter().map(|(step, p)| step.map_or(*base, |s| state.poses[s]) * p));
    }

    /// The joints that move point `point`, from the point to the base: joint, axis of its rotation (zero for a slide) and the
    /// point's velocity per unit of joint velocity, in the frame of [`Chains::place`].
    pub(crate) fn movers<'s>(
        &'s self,
        state: &'s ChainState,
        point: usize,
    ) -> impl Iterator<Item = (usize, Vector3<f64>, Vector3<f64>)> + 's {
        self.movers[point].iter().map(move |&s| {
            let (axis, anchor) = &state.axes[s];
            let step = &self.steps[s];
            if step.turns {
                (step.joint, *axis, axis.cross(&(state.points[point].coords - anchor)))
            } else {
                (step.joint, Vector3::zeros(), *axis)
            }
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn agrees_with_the_robot_model() {
        for name in ["leap_right", "allegro_right"] {
            let robot = Robot::bundled(name).unwrap();
            let points: Vec<_> = (0..robot.links.len()).map(|l| (l, Point3::new(0.01, -0.02, 0.03))).collect();
            let chains = Chains::new(&robot, &points);
            let q: Vec<f64> = robot.mid_range().iter().enumerate().map(|(i, m)| m + 0.1 * (i as f64).sin()).collect();
            let mut state = ChainState::default();
            chains.place(&Pose::identity(), &q, &mut state);
            let poses = robot.forward_kinematics(&q, &Pose::identity());
            for (i, (link, p)) in points.iter().enumerate() {
                let expected = poses[*link] * p;
                assert!((state.points[i] - expected).norm() < 1e-12);
                let jacobian = robot.jacobian(&poses, *link, &expected).0;
                let mut ours = jacobian.clone() * 0.0;
                for (joint, _, velocity) in chains.movers(&state, i) {
                    ours.set_column(joint, &velocity);
                }
                assert!((ours - jacobian).norm() < 1e-12);
            }
        }
    }
}
