//! Turning a round object on a table by rolling it under a fingertip or palm, for objects that must be touched gently.

use drex_core::Pose;
use nalgebra::{Point3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::GraspError;

/// A ball or cylinder on a table, and what may be done to it. World frame, SI units.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Rolling {
    /// Radius, metres; the object's frame has its origin on the axis.
    pub radius_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Inertia about the rolling axis over m r²: 2/5 for a ball, 1/2 for a cylinder, 1 for a shell that rolls.
    pub inertia_factor: f64,
    /// Out of the table.
    pub table_normal: Unit<Vector3<f64>>,
    /// Gravity, m/s²; a table that leans is one whose normal is not against it.
    pub gravity: Vector3<f64>,
    /// Rolling resistance, metres: the table's force acts that far ahead of the contact.
    pub resistance_m: f64,
    /// Friction of finger on object.
    pub finger_friction: f64,
    /// Friction of object on table.
    pub table_friction: f64,
    /// Largest acceleration of the centre when starting and stopping, m/s².
    pub acceleration_m_s2: f64,
    /// Least force across the contact, N, so that the finger knows it touches.
    pub touch_n: f64,
    /// What the object stands, N: the finger's whole force stays below it.
    pub max_force_n: f64,
}

/// Where object and finger are, and how the finger pushes, at one moment.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RollingWaypoint {
    /// Pose of the object, `world_from_object`.
    pub object: Pose,
    /// Where the finger touches: the top of the object, world frame, metres.
    pub contact: Point3<f64>,
    /// How far the finger's surface has moved along the table so far, metres: twice as far as the centre.
    pub finger_travel_m: f64,
    /// Force of the finger on the object at steady speed, world frame, N.
    pub force: Vector3<f64>,
}

/// A way to roll.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RollingPath {
    /// From the start to the goal's orientation, evenly in angle.
    pub waypoints: Vec<RollingWaypoint>,
    /// Force across the contact, N: constant along the path.
    pub press_n: f64,
    /// Largest force of the finger, N, starting and stopping included.
    pub force_n: f64,
}

/// Why the object cannot be rolled.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RollingError {
    /// The rotation turns about the table's normal, which rolling does not.
    #[error(
        "the goal turns {spin_deg:.1} degrees about the table's normal, which rolling cannot do: turn the hand by that much instead"
    )]
    Spin {
        /// Angle about the normal, degrees.
        spin_deg: f64,
    },
    /// The finger slides over the object however hard it presses.
    #[error(
        "friction {friction} of the finger cannot overcome a rolling resistance of {resistance_m} m at radius {radius_m} m, however hard it presses"
    )]
    FingerSlips {
        /// Friction of finger on object.
        friction: f64,
        /// Rolling resistance, metres.
        resistance_m: f64,
        /// Radius, metres.
        radius_m: f64,
    },
    /// The object slides over the table instead of rolling.
    #[error(
        "the object needs {needed_n:.3} N of friction from the table and gets {available_n:.3} N: roll more slowly or on a rougher table"
    )]
    TableSlips {
        /// Friction needed, N.
        needed_n: f64,
        /// Friction there is, N.
        available_n: f64,
    },
    /// The force that rolls it is more than it stands.
    #[error(
        "rolling needs {needed_n:.3} N of the finger and the object stands {limit_n:.3} N: roll more slowly, or lay the table level"
    )]
    TooMuch {
        /// Force needed, N.
        needed_n: f64,
        /// The limit, N.
        limit_n: f64,
    },
    /// A number makes no sense.
    #[error(transparent)]
    Input(#[from] GraspError),
}

impl Rolling {
    /// A ball of `radius_m` and `mass_kg` that stands `max_force_n`, on a level table with z up: friction 0.5, rolling
    /// resistance 0.5 mm, accelerations up to 0.1 m/s², a touch of 0.05 N.
    pub fn new(radius_m: f64, mass_kg: f64, max_force_n: f64) -> Self {
        Self {
            radius_m,
            mass_kg,
            inertia_factor: 0.4,
            table_normal: Vector3::z_axis(),
            gravity: Vector3::new(0.0, 0.0, -9.81),
            resistance_m: 5e-4,
            finger_friction: 0.5,
            table_friction: 0.5,
            acceleration_m_s2: 0.1,
            touch_n: 0.05,
            max_force_n,
        }
    }
}

/// Rolls the object from `start` to the orientation `goal` along the shortest turn (slerp), in `steps` equal parts.
///
/// Without slip the centre moves by radius times angle, across the axis of the turn, and the finger on top twice as far; where
/// the object ends follows. The press is the least that rolls, starts and stops it: with the finger's tangential
/// force F, the moment about the table contact is 2 r F + m r (g·d) − b N = ± (1 + k) m r a for rolling direction d, rolling
/// resistance b, table force N = P − m (g·n), inertia k m r² and acceleration a; and |F| <= μ P.
///
/// # Errors
/// [`RollingError`] if the goal needs a spin about the normal (more than a degree), finger or table slip, the force is
/// above the limit, or a number makes no sense.
pub fn rolling_path(
    rolling: &Rolling,
    start: &Pose,
    goal: &UnitQuaternion<f64>,
    steps: usize,
) -> Result<RollingPath, RollingError> {
    check(rolling, start, goal, steps)?;
    let n = rolling.table_normal.into_inner();
    let turn = (goal * start.rotation.inverse()).scaled_axis();
    let spin_deg = turn.dot(&n).to_degrees();
    if spin_deg.abs() > 1.0 {
        return Err(RollingError::Spin { spin_deg });
    }
    let direction = turn.cross(&n).try_normalize(1e-12).unwrap_or_else(Vector3::zeros);
    let (press_n, steady_n, force_n) = forces(rolling, &direction)?;
    let travel = rolling.radius_m * (turn - n * turn.dot(&n)).norm();
    let waypoints = (0..=steps)
        .map(|i| {
            let part = i as f64 / steps as f64;
            let center = start.translation.vector + direction * (travel * part);
            let rotation = UnitQuaternion::from_scaled_axis(turn * part) * start.rotation;
            RollingWaypoint {
                object: Pose::from_parts(Translation3::from(center), rotation),
                contact: Point3::from(center + n * rolling.radius_m),
                finger_travel_m: 2.0 * travel * part,
                force: direction * steady_n - n * press_n,
            }
        })
        .collect();
    Ok(RollingPath { waypoints, press_n, force_n })
}

/// Press, tangential force at steady speed, and the largest whole force, N.
fn forces(rolling: &Rolling, direction: &Vector3<f64>) -> Result<(f64, f64, f64), RollingError> {
    let Rolling { radius_m: r, mass_kg: m, resistance_m: b, finger_friction: mu, .. } = *rolling;
    let weight = -m * rolling.gravity.dot(&rolling.table_normal);
    let along = m * rolling.gravity.dot(direction);
    let inertia = (1.0 + rolling.inertia_factor) * m * rolling.acceleration_m_s2;
    let share = b / (2.0 * r);
    // F at press P is offset + share P, for starting (+), stopping (−) and steady rolling.
    let offset = |sign: f64| share * weight - 0.5 * along + 0.5 * sign * inertia;
    if mu <= share && offset(1.0) > 0.0 {
        return Err(RollingError::FingerSlips { friction: mu, resistance_m: b, radius_m: r });
    }
    let start = if offset(1.0) > 0.0 { offset(1.0) / (mu - share) } else { 0.0 };
    let stop = if mu + share > 0.0 { -offset(-1.0) / (mu + share) } else { 0.0 };
    let press = rolling.touch_n.max(start).max(stop);
    let mut largest = 0.0_f64;
    for sign in [1.0, -1.0] {
        let f = offset(sign) + share * press;
        if f.abs() > mu * press * (1.0 + 1e-9) {
            return Err(RollingError::FingerSlips { friction: mu, resistance_m: b, radius_m: r });
        }
        largest = largest.max(f.hypot(press));
        let needed_n = (sign * m * rolling.acceleration_m_s2 - f - along).abs();
        let available_n = rolling.table_friction * (press + weight);
        if needed_n > available_n {
            return Err(RollingError::TableSlips { needed_n, available_n });
        }
    }
    if largest > rolling.max_force_n {
        return Err(RollingError::TooMuch { needed_n: largest, limit_n: rolling.max_force_n });
    }
    Ok((press, offset(0.0) + share * press, largest))
}

fn check(rolling: &Rolling, start: &Pose, goal: &UnitQuaternion<f64>, steps: usize) -> Result<(), GraspError> {
    let bad = |what: String, remedy| Err(GraspError::value(what, remedy));
    let positive = [rolling.radius_m, rolling.mass_kg, rolling.max_force_n];
    if positive.iter().any(|v| !(*v > 0.0 && v.is_finite())) {
        return bad(format!("radius, mass and force limit are {positive:?}"), "give finite numbers above zero");
    }
    let others = [
        rolling.inertia_factor,
        rolling.resistance_m,
        rolling.finger_friction,
        rolling.table_friction,
        rolling.acceleration_m_s2,
        rolling.touch_n,
    ];
    if others.iter().any(|v| !(*v >= 0.0 && v.is_finite())) {
        return bad(
            format!("inertia, resistance, frictions, acceleration and touch are {others:?}"),
            "give zero or more",
        );
    }
    if !(rolling.gravity.dot(&rolling.table_normal) < 0.0 && rolling.gravity.norm().is_finite()) {
        return bad("gravity does not press the object on the table".into(), "give a table normal that points up");
    }
    let numbers = start.translation.vector.iter().chain(start.rotation.coords.iter()).chain(goal.coords.iter());
    if numbers.copied().any(|v| !v.is_finite()) || steps == 0 {
        return bad(format!("a pose that is not finite, or {steps} steps"), "give finite poses and at least one step");
    }
    Ok(())
}
