//! Which hands there are drivers for.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Kinds of hands that there are drivers for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HandKind {
    /// LEAP hand.
    Leap,
    /// Allegro hand.
    Allegro,
}

impl HandKind {
    /// Name of the bundled model of a side.
    pub fn model(self, side: Side) -> &'static str {
        match (self, side) {
            (Self::Leap, Side::Right) => "leap_right",
            (Self::Leap, Side::Left) => "leap_left",
            (Self::Allegro, Side::Right) => "allegro_right",
            (Self::Allegro, Side::Left) => "allegro_left",
        }
    }

    /// The kind and side of the hand with this model.
    ///
    /// # Errors
    /// If there is no driver for it.
    pub fn of_model(model: &str) -> Result<(Self, Side)> {
        let all = [Self::Leap, Self::Allegro].into_iter().flat_map(|k| [Side::Right, Side::Left].map(|s| (k, s)));
        all.into_iter().find(|(kind, side)| kind.model(*side) == model).ok_or_else(|| {
            Error::NotAllowed(format!(
                "no driver for the hand \"{model}\": there are leap_right, leap_left, allegro_right and allegro_left"
            ))
        })
    }
}

/// Side of a hand.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Left hand.
    Left,
    /// Right hand.
    #[default]
    Right,
}
