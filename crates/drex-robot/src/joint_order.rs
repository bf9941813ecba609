//! Joint orders that other programs use, as tables of the joint names of the bundled hands.
//!
//! Numbers in an array mean nothing without an order. A table says which joint of the bundled model each column is:
//!
//! | order | who uses it |
//! |---|---|
//! | `leap_sdk` | LEAP's Python/ROS drivers, motor ids 0..15: per finger side, forward, PIP, DIP; then the thumb |
//! | `leap_menagerie` | MuJoCo Menagerie's `leap_hand` and the bundled `leap_right`: per finger forward, side, PIP, DIP |
//! | `leap_urdf` | Pinocchio on the LEAP URDF (depth first, siblings by name): index, thumb, middle, ring |
//! | `allegro_ros` | Allegro's ROS drivers, joints 0..15: index, middle, ring, thumb |
//! | `allegro_menagerie` | MuJoCo Menagerie's `wonik_allegro` and the bundled `allegro_right`: the same |
//! | `allegro_urdf` | Pinocchio on the Allegro URDF: index, thumb, middle, ring |

use crate::{Error, Result};

/// Added to the model's angle of every joint it gives the angle of LEAP's drivers: their zero is half a turn away.
pub const LEAP_DRIVER_OFFSET_RAD: f64 = std::f64::consts::PI;

const LEAP_SDK: [&str; 16] = [
    "if_rot", "if_mcp", "if_pip", "if_dip", "mf_rot", "mf_mcp", "mf_pip", "mf_dip", "rf_rot", "rf_mcp", "rf_pip",
    "rf_dip", "th_cmc", "th_axl", "th_mcp", "th_ipl",
];
const LEAP_MENAGERIE: [&str; 16] = [
    "if_mcp", "if_rot", "if_pip", "if_dip", "mf_mcp", "mf_rot", "mf_pip", "mf_dip", "rf_mcp", "rf_rot", "rf_pip",
    "rf_dip", "th_cmc", "th_axl", "th_mcp", "th_ipl",
];
const LEAP_URDF: [&str; 16] = [
    "if_mcp", "if_rot", "if_pip", "if_dip", "th_cmc", "th_axl", "th_mcp", "th_ipl", "mf_mcp", "mf_rot", "mf_pip",
    "mf_dip", "rf_mcp", "rf_rot", "rf_pip", "rf_dip",
];
/// Joints of an Allegro hand in the order of its ROS drivers, its wire and the bundled model: index, middle, ring, thumb, each from
/// base to tip.
pub const ALLEGRO_ROS: [&str; 16] = [
    "ffj0", "ffj1", "ffj2", "ffj3", "mfj0", "mfj1", "mfj2", "mfj3", "rfj0", "rfj1", "rfj2", "rfj3", "thj0", "thj1",
    "thj2", "thj3",
];
const ALLEGRO_URDF: [&str; 16] = [
    "ffj0", "ffj1", "ffj2", "ffj3", "thj0", "thj1", "thj2", "thj3", "mfj0", "mfj1", "mfj2", "mfj3", "rfj0", "rfj1",
    "rfj2", "rfj3",
];

/// Names of all orders.
pub const NAMES: [&str; 6] =
    ["leap_sdk", "leap_menagerie", "leap_urdf", "allegro_ros", "allegro_menagerie", "allegro_urdf"];

/// Joint names of the bundled model in the order called `name`; see the table above.
pub fn find(name: &str) -> Option<&'static [&'static str]> {
    Some(match name {
        "leap_sdk" => &LEAP_SDK,
        "leap_menagerie" => &LEAP_MENAGERIE,
        "leap_urdf" => &LEAP_URDF,
        "allegro_ros" | "allegro_menagerie" => &ALLEGRO_ROS,
        "allegro_urdf" => &ALLEGRO_URDF,
        _ => return None,
    })
}

/// [`find`] with an error that tells the user which orders there are.
///
/// # Errors
/// If there is no such order.
pub fn require(name: &str) -> Result<&'static [&'static str]> {
    find(name).ok_or_else(|| {
        Error::value(format!("there is no joint order \"{name}\""), format!("use one of {}", NAMES.join(", ")))
    })
}

/// `values` in joint order `from`, rearranged to joint order `to`, by name.
///
/// # Errors
/// If the number of values is not the number of names, or `to` names a joint that `from` does not have.
pub fn convert<A: AsRef<str>, B: AsRef<str>>(values: &[f64], from: &[A], to: &[B]) -> Result<Vec<f64>> {
    if values.len() != from.len() {
        return Err(Error::value(
            format!("{} values in an order of {} joints", values.len(), from.len()),
            "give one value per joint of the order",
        ));
    }
    to.iter()
        .map(|name| {
            let name = name.as_ref();
            from.iter().position(|f| f.as_ref() == name).map(|i| values[i]).ok_or_else(|| {
                Error::value(
                    format!("joint \"{name}\" is not in the order the values are in"),
                    "convert between orders of the same hand",
                )
            })
        })
        .collect()
}

/// The joint of a bundled hand that other files call `foreign`: motor numbers `0`..`15` of LEAP's URDF for
/// `leap_right`, `joint_0.0`..`joint_15.0` of Allegro's URDF and ROS messages for `allegro_right`.
/// A name that the bundled model has itself is returned as it is.
pub fn alias(model: &str, foreign: &str) -> Option<&'static str> {
    let (table, number) = match model {
        "leap_right" => (&LEAP_SDK, foreign),
        "allegro_right" => {
            (&ALLEGRO_ROS, foreign.strip_prefix("joint_").and_then(|s| s.strip_suffix(".0")).unwrap_or(""))
        }
        _ => return None,
    };
    table
        .iter()
        .find(|n| **n == foreign)
        .or_else(|| number.parse::<usize>().ok().filter(|i| i.to_string() == number).and_then(|i| table.get(i)))
        .copied()
}

/// The joints of the bundled left hand `model` (`leap_left`, `allegro_left`) whose angles have the other sign in the vendor's left
/// model and drivers. The bundled left hands are mirror images, so that a left hand has the angles of a right one; the vendors
/// build left hands from the fingers of right ones, so that sideways stays the same way in space.
///
/// Allegro's URDF numbers the joints of a left hand from the ring finger on: `joint_0.0` is `rfj0`, `joint_8.0` is `ffj0`.
pub fn reversed_in_left(model: &str) -> Option<&'static [&'static str]> {
    match model {
        "leap_left" => Some(&["if_rot", "mf_rot", "rf_rot", "th_cmc", "th_axl"]),
        "allegro_left" => Some(&["ffj0", "mfj0", "rfj0"]),
        _ => None,
    }
}

/// Model angles of LEAP's joints from the angles of its drivers (any order): driver = model + π.
pub fn leap_model_from_driver(driver_rad: &[f64]) -> Vec<f64> {
    driver_rad.iter().map(|a| a - LEAP_DRIVER_OFFSET_RAD).collect()
}
