//! Random objects whose mass, centre of mass and inertia are exact.
//!
//! An object is a union of primitives that touch but do not overlap. Its mass is spread evenly, or over a wall, or between a body and a
//! heavy insert; the outer shape is the same in all three. Numbers are drawn by ChaCha8 from a seed and the object's number, so that
//! the same two numbers give the same object, and the three mass classes of one number have one shape and one friction.

mod file;
mod prism;
mod shapes;

use drex_core::{ConvexPart, MassProperties, Object, Pose, Primitive, Result};
use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;

use self::prism::Prism;
use self::shapes::Shape;

/// Least and greatest mass of an object, kg.
pub const MASS_RANGE_KG: [f64; 2] = [0.02, 1.5];
/// Least and greatest friction of an object (a coefficient).
pub const FRICTION_RANGE: [f64; 2] = [0.25, 0.6];

/// Densities of bodies, from foam to stone, kg/m³.
const BODY_KG_M3: [f64; 2] = [120.0, 3000.0];
/// Densities of walls, from light plastic to steel, kg/m³.
const WALL_KG_M3: [f64; 2] = [500.0, 8000.0];
/// Thickness of walls, metres.
const WALL_M: [f64; 2] = [0.001, 0.004];
/// Share of an insert in the mass of its object.
const INSERT_SHARE: [f64; 2] = [0.3, 0.7];
/// Density that an insert adds to the body around it, that of lead, kg/m³.
const INSERT_KG_M3: f64 = 11_340.0;
/// Largest size of an insert against that of the solid it is in.
const LARGEST_INSERT: f64 = 0.9;
/// The centre of mass lies above this much of the base, so that the object stands.
const STANDING_SHARE: f64 = 0.75;
/// Places that are tried for an insert.
const PLACES: usize = 100;
/// Range of the logarithm of a first guess against the mass.
const GUESS_LN: f64 = 1.0;

/// Kind of an outer shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Kind {
    /// A box.
    Box,
    /// An upright cylinder.
    Cylinder,
    /// A letter L: a foot and a stem at its end.
    LetterL,
    /// A letter T: a stem and a bar on it.
    LetterT,
    /// A letter U: a foot and a stem at either end.
    LetterU,
    /// A body, a neck and a cap, all round.
    Bottle,
}

/// How the mass of an object is to be spread.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, clap::ValueEnum)]
pub enum MassClass {
    /// Evenly.
    Solid,
    /// Over a wall of 1 to 4 mm, closed or open at the top.
    Hollow,
    /// Evenly, with an insert of 30 to 70 % of the mass somewhere inside.
    OffCentre,
}

/// How the mass of an object is spread.
#[derive(Debug, Clone, PartialEq)]
pub enum MassDistribution {
    /// The density is the same everywhere in the solids.
    Solid,
    /// The mass is in a wall of one density; surface and contacts are those of the solids, even where the top is open.
    Hollow {
        /// Thickness of the wall, metres.
        wall_m: f64,
        /// Whether there is no wall at the top.
        open_top: bool,
        /// What is empty inside the solids, in the object's frame; cavities do not overlap.
        cavities: Vec<Primitive>,
    },
    /// The density is the same everywhere in the solids but for an insert, whose mass is added to that of the body in its place.
    OffCentre {
        /// The insert, in the object's frame; it lies inside one of the solids.
        insert: Primitive,
        /// Mass that the insert adds to that of the body, kg.
        insert_kg: f64,
    },
}

/// An object that was drawn at random.
#[derive(Debug, Clone, PartialEq)]
pub struct RandomObject {
    /// Name: kind and number, as `letter_t007`.
    pub name: String,
    /// Kind of the outer shape.
    pub kind: Kind,
    /// Outer shape: primitives that touch but do not overlap, in the object's frame.
    pub solids: Vec<Primitive>,
    /// How the mass is spread.
    pub mass_distribution: MassDistribution,
    /// Mass, centre of mass and inertia about it, exact, in the object's frame.
    pub mass_properties: MassProperties,
    /// Friction against the support (a coefficient).
    pub friction: f64,
    /// A guess of the mass by somebody who has not weighed the object, wrong by up to a factor of e, kg.
    pub first_guess_kg: f64,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 6] = [Self::Box, Self::Cylinder, Self::LetterL, Self::LetterT, Self::LetterU, Self::Bottle];

    /// Its name in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Box => "box",
            Self::Cylinder => "cylinder",
            Self::LetterL => "letter_l",
            Self::LetterT => "letter_t",
            Self::LetterU => "letter_u",
            Self::Bottle => "bottle",
        }
    }
}

/// The object of a number, its mass spread as `class` says.
pub fn random_object(seed: u64, number: u64, class: MassClass) -> RandomObject {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(number);
    let kind = Kind::ALL[random.random_range(0..Kind::ALL.len())];
    let shape = Shape::draw(kind, &mut random);
    let density = random.random_range(0.0..1.0);
    let guess = random.random_range(-GUESS_LN..GUESS_LN).exp();
    let friction = (1e3 * between(FRICTION_RANGE, &mut random)).round() * 1e-3;

    // What follows depends on the class; what all classes share is drawn.
    let [least, greatest] = MASS_RANGE_KG;
    let outer: Vec<Prism> = shape.parts().collect();
    let mass = |densities: [f64; 2], volume: f64| {
        let [low, high] = densities.map(f64::ln);
        ((low + density * (high - low)).exp() * volume).clamp(least, greatest)
    };
    let (mass_distribution, mass_properties) = match class {
        MassClass::Solid => {
            let mass_kg = mass(BODY_KG_M3, volume(&outer));
            (MassDistribution::Solid, together(&spread(&outer, mass_kg)))
        }
        MassClass::Hollow => {
            let wall_m = shapes::on_grid(between(WALL_M, &mut random));
            let open_top = random.random_range(0..2) == 1;
            let cavities: Vec<Prism> = shape.cavities(wall_m, open_top).collect();
            let (full, empty) = (volume(&outer), volume(&cavities));
            let density = mass(WALL_KG_M3, full - empty) / (full - empty);
            // What is missing is a body of negative mass.
            let mut bodies = spread(&outer, density * full);
            bodies.extend(spread(&cavities, -density * empty));
            let cavities = cavities.iter().map(Prism::primitive).collect();
            (MassDistribution::Hollow { wall_m, open_top, cavities }, together(&bodies))
        }
        MassClass::OffCentre => {
            let mass_kg = mass(BODY_KG_M3, volume(&outer));
            let insert_kg = mass_kg * between(INSERT_SHARE, &mut random);
            let body = spread(&outer, mass_kg - insert_kg);
            let with = |insert: &Prism| together(&[body.as_slice(), &[insert.mass_properties(insert_kg)]].concat());
            let stands = |insert: &Prism| shape.base().is_below(&with(insert).center_of_mass, STANDING_SHARE);
            let insert = (0..PLACES)
                .map(|_| place(&outer, insert_kg / INSERT_KG_M3, &mut random))
                .find(stands)
                .unwrap_or_else(|| scaled(&shape.base(), insert_kg / INSERT_KG_M3));
            (MassDistribution::OffCentre { insert: insert.primitive(), insert_kg }, with(&insert))
        }
    };
    RandomObject {
        name: format!("{}{number:03}", kind.as_str()),
        kind,
        solids: outer.iter().map(Prism::primitive).collect(),
        mass_distribution,
        mass_properties,
        friction,
        first_guess_kg: guess * mass_properties.mass_kg,
    }
}

impl RandomObject {
    /// The object as other crates take it: its solids as convex parts, a closed mesh of one shell per solid (a round one has 32 sides),
    /// standing on the table z = 0.
    ///
    /// # Errors
    /// As [`Primitive::hull`], which cannot happen to an object of [`random_object`].
    pub fn to_object(&self) -> Result<Object> {
        let parts = self.solids.iter().map(|s| ConvexPart::of_primitive(*s)).collect::<Result<_>>()?;
        let mut object = Object::of_parts(parts, self.mass_properties);
        object.name.clone_from(&self.name);
        object.friction = self.friction;
        let lowest = object.bounds_at(&Pose::identity()).map_or(0.0, |(low, _)| low.z);
        Ok(object.with_rest_pose(Pose::translation(0.0, 0.0, -lowest)))
    }
}

fn between([low, high]: [f64; 2], random: &mut ChaCha8Rng) -> f64 {
    random.random_range(low..high)
}

fn volume(prisms: &[Prism]) -> f64 {
    prisms.iter().map(Prism::volume_m3).sum()
}

/// One body per prism, all of one density.
fn spread(prisms: &[Prism], mass_kg: f64) -> Vec<MassProperties> {
    let density = mass_kg / volume(prisms);
    prisms.iter().map(|p| p.mass_properties(density * p.volume_m3())).collect()
}

fn together(bodies: &[MassProperties]) -> MassProperties {
    // There is a mass: walls have a volume, and densities are positive.
    MassProperties::combined(bodies).expect("an object has a mass")
}

/// A copy of a prism about its centre, smaller, of this volume.
fn scaled(prism: &Prism, volume_m3: f64) -> Prism {
    prism.scaled((volume_m3 / prism.volume_m3()).cbrt())
}

/// An insert of this volume anywhere inside a solid: a smaller copy of it, large solids being hit more often.
fn place(solids: &[Prism], volume_m3: f64, random: &mut ChaCha8Rng) -> Prism {
    let weight = |s: &Prism| if s.volume_m3() * LARGEST_INSERT.powi(3) < volume_m3 { 0.0 } else { s.volume_m3() };
    let mut at = random.random_range(0.0..1.0) * solids.iter().map(weight).sum::<f64>();
    let hit = solids.iter().position(|s| {
        at -= weight(s);
        at < 0.0
    });
    let solid = solids[hit.unwrap_or(0)];
    solid.with_moved_inside(scaled(&solid, volume_m3), random)
}
