//! Fingers, palm and grasp frame, found in the tree and the shapes; nothing here knows a particular hand.

use std::collections::BTreeSet;

use drex_core::Pose;
use nalgebra::{Isometry3, Point3, Vector3};

use crate::model::{JointKind, Robot, Shape};

/// Nearer than this to the last joint, the frame of a tip link says nothing about where the tip is, m.
const SAME_PLACE: f64 = 1e-3;

/// One finger: the chain of links from the palm to a tip.
#[derive(Debug, Clone, PartialEq)]
pub struct Finger {
    /// Common beginning of the link names (`index` of `index_base`, `index_tip`), or the name of the first link.
    pub name: String,
    /// Links from the one on the palm to the tip.
    pub links: Vec<usize>,
    /// Joints from the palm to the tip.
    pub joints: Vec<usize>,
    /// The last link.
    pub tip_link: usize,
    /// The fingertip in the frame of `tip_link`, m: the origin of a frame that the file puts beyond the last joint, else
    /// the end of the shapes there.
    pub tip_point: Point3<f64>,
    /// Whether this is the thumb: by name, else the one of at least three fingers that points elsewhere.
    pub is_thumb: bool,
}

impl Robot {
    /// The fingers: one chain for each branch with joints off the palm, in the order of their links. Empty for a robot
    /// without such a palm (an arm).
    pub fn fingers(&self) -> Vec<Finger> {
        let Some(palm) = self.palm_link() else { return Vec::new() };
        let mut fingers: Vec<Finger> =
            self.jointed_children(palm).into_iter().flat_map(|first| self.fingers_from(vec![first], 0)).collect();
        if !fingers.iter().any(|f| f.is_thumb)
            && let Some(thumb) = self.thumb_by_direction(&fingers)
        {
            fingers[thumb].is_thumb = true;
        }
        fingers
    }

    /// The link that the fingers branch off: the first one up the tree with at least two branches that have joints.
    pub fn palm_link(&self) -> Option<usize> {
        let mut at = 0;
        loop {
            match self.jointed_children(at)[..] {
                [] => return None,
                [only] => at = only,
                _ => return Some(at),
            }
        }
    }

    /// Unit vector out of the palm, towards what the hand would hold, in the frame of [`Robot::palm_link`].
    ///
    /// The direction in which the fingertips move from straight (all coordinates zero, within limits) to mid-range,
    /// at right angles to the fingers and to the row of knuckles. A gripper whose fingers do not curl has the
    /// direction from the finger bases to the tips.
    pub fn palm_normal(&self) -> Option<Vector3<f64>> {
        let palm = self.palm_link()?;
        let all = self.fingers();
        let mut fingers: Vec<&Finger> = all.iter().filter(|f| !f.is_thumb).collect();
        if fingers.is_empty() {
            fingers = all.iter().collect();
        }
        let mut straight_q = vec![0.0; self.dof()];
        self.clamp_to_limits(&mut straight_q);
        let straight = self.poses_in(palm, &straight_q);
        let bent = self.poses_in(palm, &self.mid_range());
        let mean = |points: Vec<Vector3<f64>>| points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
        let base = mean(fingers.iter().map(|f| self.finger_base(f, &straight)).collect());
        let tip = |poses: &[Pose]| mean(fingers.iter().map(|f| (poses[f.tip_link] * f.tip_point).coords).collect());
        let along = (tip(&straight) - base).try_normalize(1e-9)?;
        let mut curl = tip(&bent) - tip(&straight);
        if let (Some(first), Some(last)) = (fingers.first(), fingers.last())
            && let Some(row) =
                (self.finger_base(first, &straight) - self.finger_base(last, &straight)).try_normalize(1e-9)
        {
            curl -= row * row.dot(&curl);
            let across = (along - row * row.dot(&along)).try_normalize(1e-9).unwrap_or(along);
            curl -= across * across.dot(&curl);
        } else {
            curl -= along * along.dot(&curl);
        }
        curl.try_normalize(SAME_PLACE).or(Some(along))
    }

    /// Where the hand would hold a thing: mean of the fingertips at mid-range, in the frame of [`Robot::palm_link`], m.
    pub fn grasp_center(&self) -> Option<Point3<f64>> {
        let palm = self.palm_link()?;
        let fingers = self.fingers();
        let poses = self.poses_in(palm, &self.mid_range());
        let sum: Vector3<f64> = fingers.iter().map(|f| (poses[f.tip_link] * f.tip_point).coords).sum();
        Some(Point3::from(sum / fingers.len().max(1) as f64))
    }

    /// Poses of all links in the frame of link `of`.
    fn poses_in(&self, of: usize, q: &[f64]) -> Vec<Pose> {
        let poses = self.forward_kinematics(q, &Isometry3::identity());
        let to = poses[of].inverse();
        poses.into_iter().map(|p| to * p).collect()
    }

    /// Children with a joint of their own or below them.
    fn jointed_children(&self, link: usize) -> Vec<usize> {
        let mut jointed = vec![false; self.links.len()];
        for (i, l) in self.links.iter().enumerate().rev() {
            jointed[i] |= !l.joints.is_empty();
            if let Some(parent) = l.parent {
                jointed[parent] |= jointed[i];
            }
        }
        (0..self.links.len()).filter(|&i| self.links[i].parent == Some(link) && jointed[i]).collect()
    }

    /// Number of joints on the longest chain that starts with `link`.
    fn joints_below(&self, link: usize) -> usize {
        let below = (0..self.links.len()).filter(|&i| self.links[i].parent == Some(link)).map(|i| self.joints_below(i));
        self.links[link].joints.len() + below.max().unwrap_or(0)
    }

    /// The fingers that begin with `links`, of which the first `shared` are not theirs alone. Where they divide into parts with
    /// several joints each (a link that carries ring and little finger), each part is a finger.
    fn fingers_from(&self, mut links: Vec<usize>, shared: usize) -> Vec<Finger> {
        while let Some(&at) = links.last() {
            let jointed = self.jointed_children(at);
            let parts: Vec<usize> = jointed.iter().copied().filter(|&c| self.joints_below(c) >= 2).collect();
            if parts.len() >= 2 {
                let with = |part: usize| links.iter().copied().chain([part]).collect();
                return parts.iter().flat_map(|&part| self.fingers_from(with(part), links.len())).collect();
            }
            // Of a side branch, the part with more joints goes on; ties go to the earlier link.
            let next = jointed
                .iter()
                .copied()
                .max_by_key(|&c| (self.joints_below(c), std::cmp::Reverse(c)))
                .or_else(|| self.tip_frame(at));
            let Some(next) = next else { break };
            links.push(next);
        }
        let Some(&tip_link) = links.last() else { return Vec::new() };
        let joints: Vec<usize> = links.iter().flat_map(|&l| self.links[l].joints.iter().copied()).collect();
        vec![Finger {
            name: self.finger_name(&links[shared..]),
            is_thumb: self.is_called_thumb(&links[shared..], &joints),
            tip_point: self.tip_point(&links, &joints),
            tip_link,
            links,
            joints,
        }]
    }

    /// The rigid child that reaches farthest beyond `link`.
    fn tip_frame(&self, link: usize) -> Option<usize> {
        let reach = |i: usize| {
            let own = self.links[i].parent_from_link.translation.vector.norm();
            own + self.links[i].geoms.iter().map(|g| g.link_from_geom.translation.vector.norm()).fold(0.0, f64::max)
        };
        (0..self.links.len())
            .filter(|&i| self.links[i].parent == Some(link))
            .max_by(|&a, &b| reach(a).total_cmp(&reach(b)))
    }

    fn finger_name(&self, links: &[usize]) -> String {
        let first = &self.links[links[0]].name;
        let prefix = first.split('_').next().unwrap_or(first);
        let all_begin = links.iter().all(|&l| self.links[l].name.split('_').next() == Some(prefix));
        let others = (0..self.links.len())
            .filter(|l| !links.contains(l))
            .any(|l| self.links[l].name.split('_').next() == Some(prefix));
        if links.len() > 1 && all_begin && !others { prefix.to_owned() } else { first.clone() }
    }

    fn is_called_thumb(&self, links: &[usize], joints: &[usize]) -> bool {
        let names = links.iter().map(|&l| &self.links[l].name).chain(joints.iter().map(|&j| &self.joints[j].name));
        let words: BTreeSet<String> = names
            .flat_map(|n| n.split(|c: char| !c.is_ascii_alphabetic()).map(str::to_ascii_lowercase).collect::<Vec<_>>())
            .collect();
        words.iter().any(|w| w.starts_with("thumb") || w.ends_with("thumb") || w == "th" || w == "thj")
    }

    /// The one of at least three fingers whose straight direction agrees least with the others'.
    fn thumb_by_direction(&self, fingers: &[Finger]) -> Option<usize> {
        if fingers.len() < 3 {
            return None;
        }
        let poses = self.forward_kinematics(&vec![0.0; self.dof()], &Pose::identity());
        let directions: Vec<Vector3<f64>> = fingers
            .iter()
            .map(|f| {
                let tip = (poses[f.tip_link] * f.tip_point).coords;
                (tip - self.finger_base(f, &poses)).try_normalize(1e-9).unwrap_or_else(Vector3::zeros)
            })
            .collect();
        let agreement: Vec<f64> = directions.iter().map(|d| directions.iter().map(|e| d.dot(e)).sum()).collect();
        let least = agreement.iter().copied().fold(f64::INFINITY, f64::min);
        let most = agreement.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        // Fingers around a palm like petals all agree alike: then none is a thumb.
        (most - least > 0.2).then(|| agreement.iter().position(|&a| a == least))?
    }

    /// The first joint of the finger in the frame that `poses` are in.
    fn finger_base(&self, finger: &Finger, poses: &[Pose]) -> Vector3<f64> {
        match finger.joints.first() {
            Some(&j) => self.joint_axis(poses, j).1.coords,
            None => poses[finger.links[0]].translation.vector,
        }
    }

    fn tip_point(&self, links: &[usize], joints: &[usize]) -> Point3<f64> {
        let (Some(&tip), Some(&joint)) = (links.last(), joints.last()) else { return Point3::origin() };
        let moved = self.joints[joint].link;
        // Everything rigidly behind the last joint, in the frame of the link that it moves.
        let mut frames = vec![(moved, Pose::identity())];
        for i in moved + 1..self.links.len() {
            if let Some(parent) = self.links[i].parent
                && self.links[i].joints.is_empty()
                && let Some(&(_, pose)) = frames.iter().find(|(l, _)| *l == parent)
            {
                frames.push((i, pose * self.links[i].parent_from_link));
            }
        }
        let tip_frame = frames.iter().find(|(l, _)| *l == tip).map_or_else(Pose::identity, |(_, p)| *p);
        let (axis, anchor) = (self.joints[joint].axis, self.joints[joint].anchor);
        // Where along its axis a hinge has its anchor says nothing.
        let turns = self.joints[joint].kind == JointKind::Revolute;
        let from_axis = |d: Vector3<f64>| if turns { d - axis * axis.dot(&d) } else { d };
        if tip != moved && from_axis(tip_frame.translation.vector - anchor.coords).norm() > SAME_PLACE {
            return Point3::origin();
        }
        let points: Vec<Point3<f64>> = frames
            .iter()
            .flat_map(|(l, pose)| {
                self.links[*l].geoms.iter().filter(|g| g.collides()).map(move |g| (pose * g.link_from_geom, g))
            })
            .flat_map(|(pose, g)| corners(&g.shape).into_iter().map(move |c| pose * c))
            .collect();
        // From the joint through the middle of the shapes to their end, then again with the outer third of them only.
        let mut tip = anchor;
        let mut kept = points;
        for _ in 0..2 {
            let Some(center) = middle(&kept) else { break };
            let Some(direction) = from_axis(center - anchor).try_normalize(SAME_PLACE) else { break };
            let reach = |p: &Point3<f64>| direction.dot(&(p - anchor));
            let farthest = kept.iter().map(reach).fold(0.0, f64::max);
            tip = center + direction * (farthest - reach(&center));
            kept.retain(|p| reach(p) >= farthest * 2.0 / 3.0);
        }
        tip_frame.inverse() * tip
    }
}

/// Centre of the bounding box.
fn middle(points: &[Point3<f64>]) -> Option<Point3<f64>> {
    let first = *points.first()?;
    let (lo, hi) = points.iter().fold((first, first), |(lo, hi), p| (lo.inf(p), hi.sup(p)));
    Some(nalgebra::center(&lo, &hi))
}

/// Points that span a shape.
fn corners(shape: &Shape) -> Vec<Point3<f64>> {
    match shape {
        Shape::Mesh(mesh) => mesh.vertices.clone(),
        _ => shape.to_mesh(24).map(|m| m.vertices).unwrap_or_default(),
    }
}
