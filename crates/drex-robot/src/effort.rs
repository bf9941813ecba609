//! What the motors behind the joints can give.

use crate::{ActuatorKind, Error, Result, Robot};

/// Joints that an error names before it counts the others.
const NAMED: usize = 4;

impl Robot {
    /// Lowest and highest effort of each joint, N m (N), in the order of [`Robot::joints`].
    ///
    /// The narrowest range that the model names: the joint's effort limit, and the force range of its actuator times the gear, for a motor
    /// without one what its control range gives. A joint for which it names neither has an infinite range.
    pub fn effort_ranges(&self) -> Vec<(f64, f64)> {
        let own = |limit: Option<f64>| limit.map_or((f64::NEG_INFINITY, f64::INFINITY), |e| (-e, e));
        let mut ranges: Vec<(f64, f64)> = self.joints.iter().map(|j| own(j.effort_limit)).collect();
        for actuator in &self.actuators {
            let range = actuator.force_range.or(match actuator.kind {
                ActuatorKind::Motor { gain } => actuator.ctrl_range.map(|(lo, hi)| (gain * lo, gain * hi)),
                _ => None,
            });
            if let Some((lo, hi)) = range {
                let (a, b) = (lo * actuator.gear, hi * actuator.gear);
                let range = &mut ranges[actuator.joint];
                *range = (range.0.max(a.min(b)), range.1.min(a.max(b)));
            }
        }
        ranges
    }

    /// Largest effort of each joint, N m (N), that its motor gives in either direction: the smaller end of [`Robot::effort_ranges`].
    ///
    /// # Errors
    /// If the model names no effort above zero for a joint. There is no default: what one hand's motors give is wrong for another's.
    pub fn effort_limits(&self) -> Result<Vec<f64>> {
        let limits: Vec<f64> = self.effort_ranges().into_iter().map(|(lo, hi)| hi.min(-lo)).collect();
        let unnamed = |limit: &f64| !(*limit > 0.0 && limit.is_finite());
        let without: Vec<&str> =
            self.joints.iter().zip(&limits).filter(|(_, l)| unnamed(l)).map(|(j, _)| j.name.as_str()).collect();
        if without.is_empty() {
            return Ok(limits);
        }
        let more = match without.len().saturating_sub(NAMED) {
            0 => String::new(),
            n => format!(" and {n} more"),
        };
        Err(Error::value(
            format!(
                "the model of \"{}\" does not say what its motors give at {}{more}",
                self.name,
                without[..without.len().min(NAMED)].join(", ")
            ),
            "name the torque there (URDF: effort of <limit>; MJCF: forcerange), or give one for all joints in N m: --torque-cap, \
             torque_cap_nm under [grasps] of a twin.toml",
        ))
    }

    /// The same robot with no joint above `cap`, N m (N): a joint without an effort limit has this one, a stronger one is limited to it.
    ///
    /// # Errors
    /// If the cap is not a positive number.
    pub fn with_effort_cap(mut self, cap: f64) -> Result<Self> {
        if !(cap > 0.0 && cap.is_finite()) {
            return Err(Error::value(format!("a torque cap of {cap} N m"), "give a positive number"));
        }
        for joint in &mut self.joints {
            // A limit of zero is how exporters say that they know none.
            joint.effort_limit = Some(joint.effort_limit.filter(|e| *e > 0.0).map_or(cap, |e| e.min(cap)));
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// A slide and two hinges: each with its own way to say what its motor gives, or with none.
    fn arm(joints: [&str; 3], actuators: &str) -> Robot {
        let [a, b, c] = joints;
        let text = format!(
            "<mujoco model=\"arm\"><worldbody><body name=\"base\"><geom size=\"0.1\"/>\
             <body name=\"a\"><joint name=\"a\" {a}/><geom size=\"0.1\"/><body name=\"b\"><joint name=\"b\" {b}/><geom size=\"0.1\"/>\
             <body name=\"c\"><joint name=\"c\" {c}/><geom size=\"0.1\"/></body></body></body></body></worldbody>\
             <actuator>{actuators}</actuator></mujoco>"
        );
        Robot::from_mjcf_str(&text, None).unwrap()
    }

    #[test]
    fn the_narrowest_of_what_the_model_names_counts() {
        let robot = arm(
            ["type=\"slide\" actuatorfrcrange=\"-2 2\"", "", "actuatorfrcrange=\"-0.5 0.5\""],
            "<position joint=\"a\" forcerange=\"-3 1\" gear=\"-4\"/><motor joint=\"b\" gear=\"2\" ctrlrange=\"-0.1 0.3\"/>\
             <position joint=\"c\" forcerange=\"-0.7 0.7\"/>",
        );
        // a: from -4 to 12 by the actuator, cut to 2 by the joint. b: a motor without a force range gives what its control says.
        assert_eq!(robot.effort_ranges(), [(-2.0, 2.0), (-0.2, 0.6), (-0.5, 0.5)]);
        assert_eq!(robot.effort_limits().unwrap(), [2.0, 0.2, 0.5]);
        let capped = robot.with_effort_cap(0.3).unwrap();
        assert_eq!(capped.effort_limits().unwrap(), [0.3, 0.2, 0.3]);
    }

    #[test]
    fn a_joint_without_a_torque_is_refused_by_name() {
        let robot = arm(["", "actuatorfrcrange=\"-0.5 0.5\"", ""], "<position joint=\"c\" kp=\"3\"/>");
        let error = robot.effort_limits().unwrap_err().to_string();
        for word in ["\"arm\"", "a, c", "--torque-cap", "torque_cap_nm", "effort", "forcerange"] {
            assert!(error.contains(word), "{word}: {error}");
        }
        assert_eq!(robot.clone().with_effort_cap(0.8).unwrap().effort_limits().unwrap(), [0.8, 0.5, 0.8]);
        for cap in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(robot.clone().with_effort_cap(cap).is_err(), "{cap}");
        }
        // Exporters write zero where they know nothing.
        let mut silent = robot;
        silent.joints[1].effort_limit = Some(0.0);
        assert!(silent.effort_limits().unwrap_err().to_string().contains("a, b, c"));
        assert_eq!(silent.with_effort_cap(0.8).unwrap().effort_limits().unwrap(), [0.8; 3]);
    }
}
