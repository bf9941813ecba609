//! What a robot can do.

use drex_recording::FingerImpedance;
use drex_robot::{Finger, Robot};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use crate::{Result, SysidError};

/// What the robot that pushes can do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotLimits {
    /// From the moment at which the object has moved enough to the moment at which the robot lets go or stops, seconds.
    #[serde(default = "RobotLimits::usual_reaction")]
    pub reaction_s: f64,
    /// A pusher whose force on the object is controlled and measured.
    pub force: Option<ForceLimits>,
    /// A compliant fingertip on a commanded path.
    pub finger: Option<FingerLimits>,
}

/// A pusher whose force is measured, at its wrist for instance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceLimits {
    /// Largest force, newtons.
    pub max_n: f64,
    /// Standard deviation of the white noise of a sample at 100 Hz, newtons per axis.
    pub noise_n: f64,
    /// Whether it can pull up on the object (a hook, a string, a suction cup), not only push.
    pub lifts: bool,
}

/// A fingertip: a sphere on three slides with position servos.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FingerLimits {
    /// Largest force at the tip, newtons; of a hand, see [`tip_force_limit`].
    pub max_n: f64,
    /// Fastest tip, m/s.
    pub max_speed_m_s: f64,
    /// Longest way of the tip, metres.
    pub stroke_m: f64,
    /// Sphere radius, m.
    pub radius_m: f64,
    /// Moving mass, kg.
    pub mass_kg: f64,
    /// Reflected inertia of the drive, kg.
    pub armature_kg: f64,
    /// Joint damping, N s/m.
    pub damping_ns_m: f64,
    /// Position gain, N/m.
    pub kp_n_m: f64,
    /// Velocity gain, N s/m.
    pub kv_ns_m: f64,
    /// Friction of the tip on the object.
    pub friction: f64,
    /// Standard deviation of the encoder, metres at the tip; `None`: its readings are not recorded.
    pub encoder_m: Option<f64>,
}

impl RobotLimits {
    fn usual_reaction() -> f64 {
        0.03
    }

    pub(super) fn check(&self) -> Result<()> {
        if self.force.is_none() && self.finger.is_none() {
            return refuse("has neither a measured force nor a fingertip; state what it can push with");
        }
        let mut positive = Vec::new();
        let mut least_zero = vec![("reaction_s", self.reaction_s)];
        if let Some(f) = &self.force {
            positive.push(("force.max_n", f.max_n));
            least_zero.push(("force.noise_n", f.noise_n));
        }
        if let Some(f) = &self.finger {
            positive.extend([
                ("finger.max_n", f.max_n),
                ("finger.max_speed_m_s", f.max_speed_m_s),
                ("finger.stroke_m", f.stroke_m),
                ("finger.radius_m", f.radius_m),
                ("finger.kp_n_m", f.kp_n_m),
                ("finger.mass_kg + finger.armature_kg", f.mass_kg + f.armature_kg),
            ]);
            positive.extend(f.encoder_m.map(|e| ("finger.encoder_m", e)));
            least_zero.extend([
                ("finger.mass_kg", f.mass_kg),
                ("finger.armature_kg", f.armature_kg),
                ("finger.damping_ns_m", f.damping_ns_m),
                ("finger.kv_ns_m", f.kv_ns_m),
                ("finger.friction", f.friction),
            ]);
        }
        if let Some((name, x)) = positive.into_iter().find(|(_, x)| !(*x > 0.0 && x.is_finite())) {
            return refuse(&format!("cannot have {name} = {x}; give a positive number"));
        }
        if let Some((name, x)) = least_zero.into_iter().find(|(_, x)| !(*x >= 0.0 && x.is_finite())) {
            return refuse(&format!("cannot have {name} = {x}; give zero or a positive number"));
        }
        Ok(())
    }
}

impl FingerLimits {
    pub(super) fn impedance(&self, home_m: [f64; 3]) -> FingerImpedance {
        FingerImpedance {
            radius_m: self.radius_m,
            mass_kg: self.mass_kg,
            armature_kg: self.armature_kg,
            damping_ns_m: self.damping_ns_m,
            kp_n_m: self.kp_n_m,
            kv_ns_m: self.kv_ns_m,
            friction: self.friction,
            home_m,
        }
    }
}

fn refuse<T>(what: &str) -> Result<T> {
    Err(SysidError::Option { option: "robot", what: what.into() })
}

/// The largest force, newtons, that the strongest finger of a hand can exert with its tip in every direction at the joint
/// coordinates `q`: |τ_j| = |J_jᵀ f| within the limit of each joint that leads to the tip. Joints without a limit count as
/// rigid; `None` if no limit is known.
///
/// # Errors
/// If the length of `q` is not the number of joints.
pub fn tip_force_limit(hand: &Robot, q: &[f64]) -> Result<Option<f64>> {
    if q.len() != hand.dof() {
        return refuse(&format!("has {} joints, but {} coordinates were given", hand.dof(), q.len()));
    }
    let ranges = hand.effort_ranges();
    let limit = |j: usize| Some(ranges[j].1.min(-ranges[j].0)).filter(|x| *x > 0.0 && x.is_finite());
    let poses = hand.forward_kinematics(q, &Isometry3::identity());
    let of_finger = |finger: Finger| {
        let tip = poses[finger.tip_link] * finger.tip_point;
        let (linear, _) = hand.jacobian(&poses, finger.tip_link, &tip);
        let forces = finger.joints.iter().filter_map(|&j| Some(limit(j)? / linear.column(j).norm().max(1e-9)));
        forces.reduce(f64::min)
    };
    Ok(hand.fingers().into_iter().filter_map(of_finger).reduce(f64::max))
}
