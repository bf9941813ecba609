//! Parts and joints of an object that is not rigid: a stapler, scissors, a box with a lid.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use drex_core::{Error, Result};

/// A rigid part of an articulated object. All parts share the object's mesh frame and unit, at the joints' zero.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartConfig {
    /// Name: letters, digits, `_` and `-`.
    pub name: String,
    /// Its mesh.
    pub mesh: PathBuf,
    /// Its mass, kg, if it was weighed alone.
    pub mass_kg: Option<f64>,
}

/// How two parts move against each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JointKind {
    /// A turn about the axis, radians.
    Hinge,
    /// A shift along the axis, metres.
    Slide,
    /// No motion.
    Fixed,
}

/// A joint between two parts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointConfig {
    /// Name: letters, digits, `_` and `-`.
    pub name: String,
    /// How the child moves against the parent.
    pub kind: JointKind,
    /// Part nearer to the root.
    pub parent: String,
    /// Part that moves with the joint.
    pub child: String,
    /// Direction of the axis in the mesh frame; positive turns are right-handed about it.
    #[serde(default = "z_axis")]
    pub axis: [f64; 3],
    /// A point of the axis in the mesh frame, metres.
    #[serde(default)]
    pub origin: [f64; 3],
    /// Lowest and highest position, radians or metres; the meshes are given at 0. A slide must have one.
    pub range: Option<[f64; 2]>,
    /// Viscous damping, N m s/rad or N s/m.
    #[serde(default)]
    pub damping: f64,
    /// Dry friction, N m or N.
    #[serde(default)]
    pub friction_loss: f64,
    /// Stiffness of a spring that pulls to 0, N m/rad or N/m.
    #[serde(default)]
    pub stiffness: f64,
}

fn z_axis() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

/// Checks that parts and joints are one tree, and gives the joints from the root outwards, in the order in which the
/// parts are named.
///
/// # Errors
/// If a name is empty, unusual or used twice, a joint names a part that does not exist, a part has two parents, there
/// is not exactly one root, joints form a circle, or a number of a joint makes no sense.
pub fn joint_tree(parts: &[&str], joints: &[JointConfig]) -> Result<(usize, Vec<JointConfig>)> {
    let refuse = |what: String, remedy: &str| Err(Error::value(what, remedy));
    if parts.is_empty() {
        return refuse("there are joints but no parts".into(), "name the parts and their meshes");
    }
    let mut names = BTreeSet::new();
    for (what, name) in parts.iter().map(|n| ("part", *n)).chain(joints.iter().map(|j| ("joint", j.name.as_str()))) {
        if name.is_empty() || !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-') {
            return refuse(
                format!("{name:?} is no name for a {what}"),
                "use letters, digits, _ and - (the name becomes part of file names)",
            );
        }
        if !names.insert((what, name)) {
            return refuse(format!("two {what}s are called {name:?}"), "give each its own name");
        }
    }
    let number: BTreeMap<&str, usize> = parts.iter().zip(0..).map(|(n, i)| (*n, i)).collect();
    let mut parent_joint: Vec<Option<&JointConfig>> = vec![None; parts.len()];
    for joint in joints {
        check_joint(joint)?;
        for end in [&joint.parent, &joint.child] {
            if !number.contains_key(end.as_str()) {
                return refuse(
                    format!("joint {:?} names the part {end:?}, which does not exist", joint.name),
                    &format!("use one of {}", parts.join(", ")),
                );
            }
        }
        if joint.parent == joint.child {
            return refuse(format!("joint {:?} joins {:?} to itself", joint.name, joint.child), "name two parts");
        }
        if let Some(other) = parent_joint[number[joint.child.as_str()]].replace(joint) {
            return refuse(
                format!("part {:?} is the child of two joints, {:?} and {:?}", joint.child, other.name, joint.name),
                "give each part one parent: closed loops of joints are not supported",
            );
        }
    }
    let roots: Vec<usize> = (0..parts.len()).filter(|&i| parent_joint[i].is_none()).collect();
    let &[root] = &roots[..] else {
        return if roots.is_empty() {
            refuse("every part is the child of a joint: the joints form a circle".into(), "leave one part as the root")
        } else {
            let free = roots.iter().map(|&i| parts[i]).collect::<Vec<_>>().join(", ");
            refuse(format!("the parts {free} are not joined to each other"), "join all but one of them to a parent")
        };
    };
    let mut ordered = Vec::with_capacity(joints.len());
    let mut reached = vec![root];
    let mut next = 0;
    while let Some(&at) = reached.get(next) {
        next += 1;
        for (child, joint) in parent_joint.iter().enumerate() {
            if let Some(joint) = joint.filter(|j| j.parent == parts[at]) {
                ordered.push(joint.clone());
                reached.push(child);
            }
        }
    }
    if let Some(lost) = (0..parts.len()).find(|i| !reached.contains(i)) {
        return refuse(
            format!("part {:?} hangs on a circle of joints, not on the root {:?}", parts[lost], parts[root]),
            "join one part of the circle to a parent outside of it",
        );
    }
    Ok((root, ordered))
}

fn check_joint(joint: &JointConfig) -> Result<()> {
    let refuse = |what: String, remedy: &str| Err(Error::value(format!("joint {:?}: {what}", joint.name), remedy));
    let axis = Vector3::from(joint.axis);
    if !(axis.norm() > 1e-9 && axis.norm().is_finite()) {
        return refuse(format!("axis = {:?} is no direction", joint.axis), "give a vector that is not zero");
    }
    if joint.origin.iter().any(|c| !c.is_finite()) {
        return refuse(format!("origin = {:?}", joint.origin), "give a point of the axis in metres");
    }
    match (joint.kind, joint.range) {
        (_, Some([lo, hi])) if !(lo <= 0.0 && hi >= 0.0 && lo < hi && (hi - lo).is_finite()) => {
            return refuse(
                format!("range = [{lo}, {hi}]"),
                "give the lowest and the highest position; the meshes are at 0, which must lie between them",
            );
        }
        (JointKind::Slide, None) => return refuse("a slide without range".into(), "give range = [lo, hi] in metres"),
        _ => {}
    }
    for (entry, value) in
        [("damping", joint.damping), ("friction_loss", joint.friction_loss), ("stiffness", joint.stiffness)]
    {
        if !(value >= 0.0 && value.is_finite()) {
            return refuse(format!("{entry} = {value}"), "give 0 or a positive number");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hinge(name: &str, parent: &str, child: &str) -> JointConfig {
        JointConfig {
            name: name.into(),
            kind: JointKind::Hinge,
            parent: parent.into(),
            child: child.into(),
            axis: [0.0, 1.0, 0.0],
            origin: [0.0; 3],
            range: Some([0.0, 1.0]),
            damping: 0.0,
            friction_loss: 0.0,
            stiffness: 0.0,
        }
    }

    #[test]
    fn a_tree_is_ordered_from_its_root() {
        let joints = [hinge("j2", "b", "c"), hinge("j1", "a", "b"), hinge("j3", "a", "d")];
        let (root, ordered) = joint_tree(&["c", "b", "a", "d"], &joints).unwrap();
        assert_eq!((root, ordered.iter().map(|j| j.name.as_str()).collect::<Vec<_>>()), (2, vec!["j1", "j3", "j2"]));
        assert_eq!(joint_tree(&["alone"], &[]).unwrap().0, 0);
    }

    proptest::proptest! {
        #[test]
        fn trees_pass_and_what_passes_is_a_tree(
            parents in (0..1usize, 0..2usize, 0..3usize, 0..4usize),
            ends in proptest::collection::vec((0..5usize, 0..5usize), 0..6),
        ) {
            let parts = ["a", "b", "c", "d", "e"];
            let joined = |ends: &[(usize, usize)]| -> Vec<JointConfig> {
                ends.iter().enumerate().map(|(i, &(p, c))| hinge(&format!("j{i}"), parts[p], parts[c])).collect()
            };
            let tree = [(parents.3, 4), (parents.1, 2), (parents.0, 1), (parents.2, 3)];
            proptest::prop_assert!(joint_tree(&parts, &joined(&tree)).is_ok());
            if let Ok((root, ordered)) = joint_tree(&parts, &joined(&ends)) {
                // Every joint starts at a part that was reached before, so all parts hang on the root.
                let mut reached = BTreeSet::from([parts[root].to_string()]);
                for joint in &ordered {
                    proptest::prop_assert!(reached.contains(&joint.parent) && reached.insert(joint.child.clone()));
                }
                proptest::prop_assert_eq!(reached.len(), parts.len());
            }
        }
    }

    #[test]
    fn what_is_no_tree_is_named() {
        let j = hinge;
        let cases: Vec<(Vec<&str>, Vec<JointConfig>, &str)> = vec![
            (vec![], vec![], "no parts"),
            (vec!["a", "b"], vec![], "not joined"),
            (vec!["a", "a"], vec![j("j", "a", "a")], "two parts"),
            (vec!["a", "b"], vec![j("j", "a", "x")], "does not exist; use one of a, b"),
            (vec!["a", "b"], vec![j("j", "a", "a")], "to itself"),
            (vec!["a", "b"], vec![j("j", "a", "b"), j("k", "b", "a")], "circle"),
            (vec!["a", "b", "c"], vec![j("j", "c", "b"), j("k", "b", "c")], "circle"),
            (vec!["a", "b", "c"], vec![j("j", "a", "c"), j("k", "b", "c")], "two joints"),
            (vec!["a", "b", "c"], vec![j("j", "a", "b"), j("j", "b", "c")], "two joints are called"),
            (vec!["a", "../b"], vec![j("j", "a", "../b")], "no name"),
            (vec!["a", "b"], vec![JointConfig { axis: [0.0; 3], ..j("j", "a", "b") }], "no direction"),
            (vec!["a", "b"], vec![JointConfig { range: Some([0.5, 1.0]), ..j("j", "a", "b") }], "range"),
            (vec!["a", "b"], vec![JointConfig { range: Some([1.0, -1.0]), ..j("j", "a", "b") }], "range"),
            (vec!["a", "b"], vec![JointConfig { range: None, kind: JointKind::Slide, ..j("j", "a", "b") }], "slide"),
            (vec!["a", "b"], vec![JointConfig { damping: f64::NAN, ..j("j", "a", "b") }], "damping"),
            (vec!["a", "b"], vec![JointConfig { origin: [f64::INFINITY, 0.0, 0.0], ..j("j", "a", "b") }], "origin"),
        ];
        for (parts, joints, word) in cases {
            let message = joint_tree(&parts, &joints).unwrap_err().to_string();
            assert!(message.contains(word), "{word}: {message}");
        }
    }
}
