//! The static check of a grasp: would it hold, on paper? It is a calculation at rest, not a success rate.

use drex_core::{MassProperties, Pose, SignedDistance, TablePlane};
use drex_robot::Robot;
use serde::{Deserialize, Serialize};

use crate::{
    ClosureOptions, ContactOptions, GripForceError, GripForceProblem, HandSurface, Result, TorqueLimits, force_closure,
    minimum_grip_force,
};

/// A grasp to be checked.
#[derive(Clone, Copy)]
pub struct StaticGrasp<'a> {
    /// The hand.
    pub robot: &'a Robot,
    /// Joint vector, model order, rad.
    pub joints: &'a [f64],
    /// Pose of the robot's base in the object's frame.
    pub object_from_base: Pose,
    /// The object.
    pub object: &'a dyn SignedDistance,
    /// Its mass and centre of mass, object frame.
    pub body: &'a MassProperties,
    /// The table; it also says where down is.
    pub table: TablePlane,
}

/// What is asked of a grasp.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct CheckOptions {
    /// What counts as a contact.
    pub contact: ContactOptions,
    /// Margin on the weight.
    pub gamma: f64,
    /// Deepest penetration allowed, metres: hand in object.
    pub max_penetration_m: f64,
    /// Deepest the hand may be below the table top, metres.
    pub max_table_penetration_m: f64,
    /// Fingers that have to touch besides the thumb.
    pub min_fingers: usize,
    /// Whether the thumb has to touch (if the model has one).
    pub thumb: bool,
    /// Soft fingers: torsional friction, metres.
    pub torsion_m: Option<f64>,
    /// Damage limit per contact, N.
    pub max_normal_n: Option<f64>,
    /// Whether joint torques are limited to what the motors give.
    pub motors: bool,
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self {
            contact: ContactOptions::default(),
            gamma: 1.0,
            max_penetration_m: 0.002,
            max_table_penetration_m: 0.001,
            min_fingers: 2,
            thumb: true,
            torsion_m: None,
            max_normal_n: None,
            motors: true,
        }
    }
}

/// Contacts of one finger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FingerContacts {
    /// Name of the finger, or `palm`.
    pub finger: String,
    /// Number of contacts.
    pub contacts: usize,
    /// Sum of the normal forces in the minimum grip force, N; zero without one.
    pub normal_n: f64,
}

/// The outcome of [`static_check`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct StaticCheck {
    /// Whether nothing is in `failures`.
    pub passed: bool,
    /// What is wrong, one sentence each.
    pub failures: Vec<String>,
    /// Contacts per finger, the palm last.
    pub contacts: Vec<FingerContacts>,
    /// Deepest point of the hand inside the object, mm; zero or more.
    pub penetration_mm: f64,
    /// Deepest point of the hand below the table top, mm; zero or more.
    pub table_penetration_mm: f64,
    /// Whether the contacts are in force closure.
    pub force_closure: bool,
    /// Ferrari-Canny quality about the centre of mass; see [`crate::ForceClosure`].
    pub epsilon: f64,
    /// Min-weight quality; see [`crate::ForceClosure`].
    pub min_weight: f64,
    /// The minimum grip force, N: sum of the normal forces; `None` if there is none.
    #[serde(rename = "squeeze_n")]
    pub grip_force_n: Option<f64>,
    /// By which fraction friction may fall; `None` without a grip force.
    pub friction_margin: Option<f64>,
    /// Least share of a motor's torque left; `None` without a grip force.
    pub torque_margin: Option<f64>,
    /// The mass that was carried, kg.
    pub mass_kg: f64,
    /// The friction that was assumed.
    pub friction: f64,
    /// The margin on the weight.
    pub gamma: f64,
}

/// Checks a grasp at rest: contacts per finger, penetration of object and table, force closure, and the minimum grip force that
/// carries the object's weight.
///
/// # Errors
/// If the joint vector does not fit the robot, an option is invalid or the solver gives up. A bad grasp is not an error.
pub fn static_check(grasp: &StaticGrasp<'_>, options: &CheckOptions) -> Result<StaticCheck> {
    let surface = HandSurface::new(grasp.robot, options.contact.spacing_m)?;
    static_check_with(&surface, grasp, options)
}

/// [`static_check`] with the hand already sampled, for many grasps of one hand.
///
/// # Errors
/// As [`static_check`].
pub fn static_check_with(
    surface: &HandSurface,
    grasp: &StaticGrasp<'_>,
    options: &CheckOptions,
) -> Result<StaticCheck> {
    let StaticGrasp { robot, joints, object_from_base, object, body, table } = grasp;
    let contacts = surface.contacts(robot, joints, object_from_base, *object, &options.contact)?;
    let poses = robot.forward_kinematics(joints, object_from_base);
    let depth = surface.depths(&poses, *object, 0.0).into_iter().fold(0.0, f64::max);
    let lowest = surface.lowest(&poses, &table.up).into_iter().fold(f64::INFINITY, f64::min);
    let below = (table.height_m - lowest).max(0.0);

    let mut failures = Vec::new();
    let count = |finger: Option<usize>| contacts.iter().filter(|c| c.finger == finger).count();
    touching_fingers(surface, options, &|f| count(Some(f)), &mut failures);
    if depth > options.max_penetration_m {
        failures.push(format!("the hand is {:.1} mm inside the object", 1e3 * depth));
    }
    if below > options.max_table_penetration_m {
        failures.push(format!("the hand is {:.1} mm below the table top", 1e3 * below));
    }

    let mut closure = ClosureOptions::about(body.center_of_mass);
    closure.torsion_m = options.torsion_m;
    let closure = force_closure(&contacts, &closure)?;
    if !closure.closed {
        failures.push("the contacts are not in force closure".into());
    }

    let gravity = table.gravity();
    let mut problem =
        GripForceProblem::new(contacts.clone(), body.mass_kg, body.center_of_mass, gravity).with_gamma(options.gamma);
    problem.torsion_m = options.torsion_m;
    problem.max_normal_n = options.max_normal_n;
    if options.motors {
        problem.torques = Some(TorqueLimits::of_robot(robot, joints, object_from_base, &contacts, &gravity)?);
    }
    let grip_force = match minimum_grip_force(&problem) {
        Ok(grip_force) => Some(grip_force),
        Err(GripForceError::Input(error)) => return Err(error),
        Err(GripForceError::Torque { joint, needed_nm, limit_nm }) => {
            let name = &robot.joints[joint].name;
            failures.push(format!("joint \"{name}\" would need {needed_nm:.3} N m and has {limit_nm:.3} N m"));
            None
        }
        Err(reason) => {
            failures.push(reason.to_string());
            None
        }
    };

    let force = |finger: Option<usize>| {
        grip_force.as_ref().map_or(0.0, |s| match finger {
            Some(f) => s.per_finger_n.get(f).copied().unwrap_or(0.0),
            None => s.palm_n,
        })
    };
    let row = |name: &str, finger: Option<usize>| FingerContacts {
        finger: name.into(),
        contacts: count(finger),
        normal_n: force(finger),
    };
    let mut rows: Vec<FingerContacts> =
        surface.fingers.iter().enumerate().map(|(i, f)| row(&f.name, Some(i))).collect();
    rows.push(row("palm", None));
    Ok(StaticCheck {
        passed: failures.is_empty(),
        failures,
        contacts: rows,
        penetration_mm: 1e3 * depth,
        table_penetration_mm: 1e3 * below,
        force_closure: closure.closed,
        epsilon: closure.epsilon,
        min_weight: closure.min_weight,
        grip_force_n: grip_force.as_ref().map(|s| s.total_n),
        friction_margin: grip_force.as_ref().map(|s| s.friction_margin),
        torque_margin: grip_force.as_ref().map(|s| s.torque_margin),
        mass_kg: body.mass_kg,
        friction: options.contact.friction,
        gamma: options.gamma,
    })
}

/// Whether enough fingers touch, the thumb among them.
fn touching_fingers(
    surface: &HandSurface,
    options: &CheckOptions,
    contacts_of: &dyn Fn(usize) -> usize,
    failures: &mut Vec<String>,
) {
    let thumb = surface.thumb();
    if options.thumb
        && let Some(t) = thumb
        && contacts_of(t) == 0
    {
        failures.push("the thumb does not touch the object".into());
    }
    let others: Vec<usize> = (0..surface.fingers.len()).filter(|&f| Some(f) != thumb).collect();
    let touching = others.iter().filter(|&&f| contacts_of(f) > 0).count();
    if touching < options.min_fingers {
        let missing: Vec<&str> =
            others.iter().filter(|&&f| contacts_of(f) == 0).map(|&f| surface.fingers[f].name.as_str()).collect();
        failures.push(format!(
            "{touching} of {} fingers touch the object, {} are asked for (not touching: {})",
            others.len(),
            options.min_fingers,
            missing.join(", ")
        ));
    }
}
