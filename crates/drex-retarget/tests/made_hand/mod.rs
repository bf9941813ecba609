//! A hand as URDF text, and what tests of hands ask.
#![allow(clippy::unwrap_used, dead_code)]

use std::path::{Path, PathBuf};

use drex_core::Pose;
use drex_demo::HumanFinger;
use drex_retarget::{LinkPoint, TargetHand};
use nalgebra::Point3;

pub fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("DREX_SHARED").map(|f| PathBuf::from(f).join("data/robots"));
    if folder.is_none() {
        eprintln!("skipped: DREX_SHARED is not set");
    }
    folder
}

/// Tips and middle points of the fingers in the operator frame at joint vector `q`.
pub fn points(hand: &TargetHand, q: &[f64]) -> Vec<(HumanFinger, Point3<f64>, Point3<f64>)> {
    let poses = hand.robot.forward_kinematics(q, &Pose::identity());
    let to = hand.base_from_operator.inverse();
    let at = |p: &LinkPoint| to * (poses[p.link] * p.point);
    hand.fingers.iter().map(|f| (f.human, at(&f.tip), at(&f.middle))).collect()
}

pub fn zero(hand: &TargetHand) -> Vec<f64> {
    let mut q = vec![0.0; hand.robot.dof()];
    hand.robot.clamp_to_limits(&mut q);
    q
}

/// A person-like hand as URDF text, its operator frame where `base_from_operator` says.
pub struct Synthetic {
    pub side: f64,
    pub base_from_operator: Pose,
    /// Names of thumb, index, middle, ring, little.
    pub names: [&'static str; 5],
    /// Joints turn about the other way, with limits turned around.
    pub reversed: bool,
    pub wrist_link: bool,
    pub arm: bool,
    pub coupled: bool,
}

impl Default for Synthetic {
    fn default() -> Self {
        Self {
            side: 1.0,
            base_from_operator: Pose::identity(),
            names: ["thumb", "index", "middle", "ring", "pinky"],
            reversed: false,
            wrist_link: false,
            arm: false,
            coupled: true,
        }
    }
}

/// Lengths of the phalanges, m.
pub const BONES: [f64; 3] = [0.045, 0.027, 0.022];

impl Synthetic {
    pub fn urdf(&self) -> String {
        let t = self.base_from_operator.translation;
        let (r, p, y) = self.base_from_operator.rotation.euler_angles();
        let origin = format!("<origin xyz=\"{} {} {}\" rpy=\"{r} {p} {y}\"/>", t.x, t.y, t.z);
        let mount = match self.arm {
            true => {
                "type=\"revolute\"><axis xyz=\"0 0 1\"/><limit lower=\"0.3\" upper=\"2\" effort=\"1\" velocity=\"1\"/>"
            }
            false => "type=\"fixed\">",
        };
        let mut text = format!(
            "<robot name=\"synthetic\"><link name=\"mount\"/><link name=\"palm\"><collision><origin xyz=\"0 0 0.045\"/>\
             <geometry><box size=\"0.03 0.08 0.09\"/></geometry></collision></link>\
             <joint name=\"mounting\" {mount}<parent link=\"mount\"/><child link=\"palm\"/>{origin}</joint>"
        );
        if self.wrist_link {
            text += "<link name=\"hand_wrist\"/><joint name=\"w\" type=\"fixed\"><parent link=\"palm\"/><child link=\"hand_wrist\"/></joint>";
        }
        for (i, name) in self.names.iter().enumerate() {
            let across = self.side * (0.03 - 0.02 * (i as f64 - 1.0));
            let place = match i {
                0 => format!("xyz=\"0.01 {} 0.03\" rpy=\"{} 0 0\"", 0.04 * self.side, -0.9 * self.side),
                _ => format!("xyz=\"0 {across} 0.09\""),
            };
            let limits = |lo: f64, hi: f64| match self.reversed {
                true => format!("<limit lower=\"{}\" upper=\"{}\" effort=\"1\" velocity=\"1\"/>", -hi, -lo),
                false => format!("<limit lower=\"{lo}\" upper=\"{hi}\" effort=\"1\" velocity=\"1\"/>"),
            };
            let sign = if self.reversed { -1 } else { 1 };
            let mut joint = |k: usize, parent: &str, place: &str, axis: &str, rest: &str| {
                text += &format!(
                    "<link name=\"{name}_{k}\"/><joint name=\"{name}_j{k}\" type=\"revolute\"><parent link=\"{parent}\"/>\
                     <child link=\"{name}_{k}\"/><origin {place}/><axis xyz=\"{axis}\"/>{rest}</joint>"
                );
            };
            let flex = format!("0 {sign} 0");
            joint(0, "palm", &place, &format!("{sign} 0 0"), &limits(-0.3, 0.3));
            joint(1, &format!("{name}_0"), "xyz=\"0 0 0\"", &flex, &limits(-0.2, 1.5));
            joint(2, &format!("{name}_1"), &format!("xyz=\"0 0 {}\"", BONES[0]), &flex, &limits(0.0, 1.6));
            let mimic = format!("<mimic joint=\"{name}_j2\" multiplier=\"0.7\" offset=\"0\"/>");
            let coupling = if self.coupled { mimic.as_str() } else { "" };
            joint(3, &format!("{name}_2"), &format!("xyz=\"0 0 {}\"", BONES[1]), &flex, &(limits(0.0, 1.2) + coupling));
            text += &format!(
                "<link name=\"{name}_end\"/><joint name=\"{name}_tip\" type=\"fixed\"><parent link=\"{name}_3\"/>\
                 <child link=\"{name}_end\"/><origin xyz=\"0 0 {}\"/></joint>",
                BONES[2]
            );
        }
        text + "</robot>"
    }

    /// The file, under a name of its own.
    pub fn file(&self, name: &str) -> PathBuf {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("hands_{name}.urdf"));
        std::fs::write(&path, self.urdf()).unwrap();
        path
    }
}
