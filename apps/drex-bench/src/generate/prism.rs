//! Upright boxes and cylinders, of which everything is made.

use std::f64::consts::PI;

use drex_core::{MassProperties, Pose, Primitive, PrimitiveShape};
use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

/// An upright box or cylinder in the frame of its object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Prism {
    pub section: Section,
    pub center: Point3<f64>,
    pub half_height_m: f64,
}

/// Horizontal section of a prism, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Section {
    /// Half of the sides along x and y.
    Rectangle([f64; 2]),
    /// The radius.
    Disc(f64),
}

impl Prism {
    /// From height `low` to height `high`, its axis at `y`.
    pub fn new(section: Section, y: f64, low: f64, high: f64) -> Self {
        Self { section, center: Point3::new(0.0, y, 0.5 * (low + high)), half_height_m: 0.5 * (high - low) }
    }

    pub fn primitive(&self) -> Primitive {
        let shape = match self.section {
            Section::Rectangle([x, y]) => PrimitiveShape::Box { half_m: [x, y, self.half_height_m] },
            Section::Disc(radius_m) => PrimitiveShape::Cylinder { radius_m, half_length_m: self.half_height_m },
        };
        let at = Translation3::from(self.center);
        Primitive { shape, object_from_shape: Pose::from_parts(at, UnitQuaternion::identity()) }
    }

    pub fn volume_m3(&self) -> f64 {
        let area = match self.section {
            Section::Rectangle([x, y]) => 4.0 * x * y,
            Section::Disc(radius) => PI * radius * radius,
        };
        2.0 * self.half_height_m * area
    }

    /// Of a uniform body of this mass.
    pub fn mass_properties(&self, mass_kg: f64) -> MassProperties {
        // Mean squares of the coordinates about the centre.
        let [x, y] = match self.section {
            Section::Rectangle(half) => half.map(|h| h * h / 3.0),
            Section::Disc(radius) => [0.25 * radius * radius; 2],
        };
        let z = self.half_height_m * self.half_height_m / 3.0;
        let inertia = Matrix3::from_diagonal(&Vector3::new(y + z, x + z, x + y)) * mass_kg;
        MassProperties { mass_kg, center_of_mass: self.center, inertia }
    }

    /// A copy about the same centre.
    pub fn scaled(&self, factor: f64) -> Self {
        let section = match self.section {
            Section::Rectangle(half) => Section::Rectangle(half.map(|h| factor * h)),
            Section::Disc(radius) => Section::Disc(factor * radius),
        };
        Self { section, half_height_m: factor * self.half_height_m, ..*self }
    }

    /// A smaller copy of this prism, moved to a random place inside it.
    pub fn with_moved_inside(&self, copy: Self, random: &mut ChaCha8Rng) -> Self {
        let mut side = || random.random_range(-1.0..1.0);
        let z = side() * (self.half_height_m - copy.half_height_m);
        let [x, y] = match (self.section, copy.section) {
            (Section::Rectangle(a), Section::Rectangle(b)) => [0, 1].map(|i| side() * (a[i] - b[i])),
            (Section::Disc(a), Section::Disc(b)) => {
                let (sin, cos) = (PI * side()).sin_cos();
                let room = (a - b) * side().abs().sqrt();
                [room * cos, room * sin]
            }
            // A copy has the section of what it is a copy of.
            _ => [0.0; 2],
        };
        Self { center: self.center + Vector3::new(x, y, z), ..copy }
    }

    /// Whether the point lies above or below the middle `share` of the section.
    pub fn is_below(&self, point: &Point3<f64>, share: f64) -> bool {
        let d = point - self.center;
        match self.section {
            Section::Rectangle([x, y]) => d.x.abs() <= share * x && d.y.abs() <= share * y,
            Section::Disc(radius) => d.xy().norm() <= share * radius,
        }
    }
}
