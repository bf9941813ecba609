//! Drives: motor, position, velocity and general actuators on a joint.

use crate::Result;
use crate::model::{Actuator, ActuatorKind};
use crate::unsupported::Unsupported;
use crate::xml::{Attributes, Node};

use super::Builder;

const DRIVES: [&str; 4] = ["general", "motor", "position", "velocity"];
const USED: [&str; 23] = [
    "name",
    "class",
    "group",
    "joint",
    "jointinparent",
    "tendon",
    "site",
    "body",
    "slidersite",
    "cranksite",
    "gear",
    "ctrllimited",
    "forcelimited",
    "ctrlrange",
    "forcerange",
    "kp",
    "kv",
    "gaintype",
    "biastype",
    "gainprm",
    "biasprm",
    "dyntype",
    "inheritrange",
];

/// Whether elements called `tag` are drives that the reader understands.
pub(super) fn is_drive(tag: &str) -> bool {
    DRIVES.contains(&tag)
}

/// Everything that a drive element or a default class says about a drive. MuJoCo keeps one such record for all drive
/// elements of a class: `<position kp="3"/>` there also sets the gain of a `<general>`.
#[derive(Debug, Clone)]
pub(super) struct Settings {
    gain: f64,
    bias: [f64; 3],
    gain_is_fixed: bool,
    bias_is_affine: bool,
    bias_is_known: bool,
    dynamics: Option<String>,
    gear: f64,
    force_range: Option<(f64, f64)>,
    force_limited: Option<bool>,
    ctrl_range: Option<(f64, f64)>,
    ctrl_limited: Option<bool>,
    inherit_range: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            gain: 1.0,
            bias: [0.0; 3],
            gain_is_fixed: true,
            bias_is_affine: false,
            bias_is_known: true,
            dynamics: None,
            gear: 1.0,
            force_range: None,
            force_limited: None,
            ctrl_range: None,
            ctrl_limited: None,
            inherit_range: 0.0,
        }
    }
}

impl Settings {
    /// Takes over what `node` says.
    pub fn apply(&mut self, node: &Node, unsupported: &mut Unsupported) -> Result<()> {
        let a = node.with_defaults(None);
        if let Some(gear) = a.numbers("gear", 1..=6)? {
            self.gear = gear[0];
        }
        self.force_range = a.range("forcerange")?.or(self.force_range);
        self.ctrl_range = a.range("ctrlrange")?.or(self.ctrl_range);
        self.force_limited = self.limited(&a, "forcelimited", self.force_limited)?;
        self.ctrl_limited = self.limited(&a, "ctrllimited", self.ctrl_limited)?;
        self.inherit_range = a.number("inheritrange")?.unwrap_or(self.inherit_range);
        match node.tag.as_str() {
            "motor" => {
                (self.gain, self.bias) = (1.0, [0.0; 3]);
                (self.gain_is_fixed, self.bias_is_affine, self.bias_is_known) = (true, false, true);
            }
            "position" => {
                self.gain = a.number("kp")?.unwrap_or(self.gain);
                let kv = a.number("kv")?.unwrap_or(if self.bias_is_affine { -self.bias[2] } else { 0.0 });
                self.bias = [0.0, -self.gain, -kv];
                (self.gain_is_fixed, self.bias_is_affine, self.bias_is_known) = (true, true, true);
                self.dynamics = None;
            }
            "velocity" => {
                self.gain = a.number("kv")?.unwrap_or(self.gain);
                self.bias = [0.0, 0.0, -self.gain];
                (self.gain_is_fixed, self.bias_is_affine, self.bias_is_known) = (true, true, true);
            }
            _ => {
                if let Some(v) = a.numbers("gainprm", 1..=10)? {
                    self.gain = v[0];
                }
                if let Some(v) = a.numbers("biasprm", 1..=10)? {
                    self.bias = [0, 1, 2].map(|k| v.get(k).copied().unwrap_or(0.0));
                }
                if let Some(kind) = a.get("gaintype") {
                    self.gain_is_fixed = kind == "fixed";
                }
                if let Some(kind) = a.get("biastype") {
                    self.bias_is_affine = kind == "affine";
                    self.bias_is_known = kind == "affine" || kind == "none";
                }
                if let Some(kind) = a.get("dyntype") {
                    self.dynamics = (kind != "none").then(|| kind.to_owned());
                }
            }
        }
        unsupported.attributes(node, &USED);
        Ok(())
    }

    fn limited(&self, a: &Attributes<'_>, name: &str, inherited: Option<bool>) -> Result<Option<bool>> {
        Ok(if a.get(name).is_some() { a.truth(name)? } else { inherited })
    }

    /// What kind of drive the numbers make, or why none that is read.
    fn kind(&self) -> std::result::Result<ActuatorKind, String> {
        if let Some(kind) = &self.dynamics {
            return Err(format!("its activation dynamics \"{kind}\" are not read"));
        }
        if !self.gain_is_fixed || !self.bias_is_known {
            return Err("its gain or bias is of a type that is not read".into());
        }
        let [constant, position, velocity] = if self.bias_is_affine { self.bias } else { [0.0; 3] };
        Ok(if constant == 0.0 && position == 0.0 && velocity == 0.0 {
            ActuatorKind::Motor { gain: self.gain }
        } else if constant == 0.0 && position == -self.gain {
            ActuatorKind::Position { kp: self.gain, kv: -velocity }
        } else if constant == 0.0 && position == 0.0 && velocity == -self.gain {
            ActuatorKind::Velocity { kv: self.gain }
        } else {
            ActuatorKind::Affine { gain: self.gain, bias: self.bias }
        })
    }
}

impl Builder {
    /// The drive that `node` describes; `None` (and a remark) for one that is not read.
    pub(super) fn read_actuator(&mut self, node: &Node) -> Result<Option<Actuator>> {
        if !is_drive(&node.tag) {
            self.unsupported.element(node);
            return Ok(None);
        }
        let mut s = self.defaults.class(node, None)?.actuator.clone();
        s.apply(node, &mut self.unsupported)?;
        let name = node.get("name").unwrap_or_default().to_owned();
        let attribute = if node.get("jointinparent").is_some() { "jointinparent" } else { "joint" };
        let Some(joint_name) = node.get(attribute) else {
            self.unsupported.note(format!("actuator \"{name}\" (line {}) drives no joint and is not read", node.line));
            return Ok(None);
        };
        let joint = self.joint_by_name(node, attribute, joint_name)?;
        let kind = match s.kind() {
            Ok(kind) => kind,
            Err(why) => {
                self.unsupported.note(format!("actuator \"{name}\" (line {}) is not read: {why}", node.line));
                return Ok(None);
            }
        };
        let auto = self.compiler.auto_limits;
        let limit = |range: Option<(f64, f64)>, limited: Option<bool>| range.filter(|_| limited.unwrap_or(auto));
        let mut ctrl_range = limit(s.ctrl_range, s.ctrl_limited);
        if s.inherit_range > 0.0
            && s.ctrl_range.is_none()
            && let Some((lo, hi)) = self.joints[joint].limits
        {
            let (middle, reach) = (0.5 * (lo + hi), 0.5 * (hi - lo) * s.inherit_range);
            ctrl_range = Some((middle - reach, middle + reach));
        }
        Ok(Some(Actuator {
            name,
            joint,
            kind,
            force_range: limit(s.force_range, s.force_limited),
            ctrl_range,
            gear: s.gear,
        }))
    }
}
