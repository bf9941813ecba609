//! Grasps of one object by one hand, measured and kept in a file.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use drex_core::{Pose, fsutil};
use drex_grasp::{ContactOptions, HandSurface, SearchOptions, holds_any_load, search_grasps, squeeze_per_weight};
use drex_mesh::sample_surface;
use drex_retarget::TargetHand;
use drex_robot::Robot;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::people::{self, PeopleOptions};
use super::postures::Postures;
use super::thing::Thing;
use super::wraps::{self, Closer, WrapOptions};
use crate::twin::PoseRecord;

/// Points of the surface from which opposite ones are searched.
const SURFACE_POINTS: usize = 3000;
/// Of so many hands that a search for pinches looks at, one is laid on the object: closing a hand takes longer, and more of those that are closed hold.
const PINCHES_FOR_ONE: usize = 50;
/// Deepest that a hand may be inside the object, mm.
const MAX_PENETRATION_MM: f64 = 2.0;

/// Where a grasp comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// As it was demonstrated, retargeted; in the bench by a made-up person.
    Retargeted,
    /// Made of a demonstrated one: by the object's symmetries and noise, or by variations in practice.
    Refined,
    /// The palm laid on the object and the fingers closed around it.
    Wrapped,
    /// Searched for between opposite points of the surface.
    Searched,
}

impl Kind {
    /// The kind of a variation. One of a grasp that nobody demonstrated is still one that was found.
    pub fn varied(self) -> Self {
        match self {
            Self::Retargeted | Self::Refined => Self::Refined,
            Self::Wrapped | Self::Searched => self,
        }
    }
}

/// How many grasps come from where.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Origins {
    /// As somebody showed them.
    pub demonstrated: usize,
    /// Made of demonstrated ones.
    pub refined: usize,
    /// Found without a demonstration: by laying the palm on the object, or between opposite points.
    pub searched: usize,
}

impl Origins {
    /// Of grasps of these kinds.
    pub fn of(kinds: impl IntoIterator<Item = Kind>) -> Self {
        let mut origins = Self::default();
        for kind in kinds {
            match kind {
                Kind::Retargeted => origins.demonstrated += 1,
                Kind::Refined => origins.refined += 1,
                Kind::Wrapped | Kind::Searched => origins.searched += 1,
            }
        }
        origins
    }

    /// All of them.
    pub fn total(&self) -> usize {
        self.demonstrated + self.refined + self.searched
    }
}

impl fmt::Display for Origins {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} demonstrated, {} refined, {} searched", self.demonstrated, self.refined, self.searched)
    }
}

/// One grasp.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Grasp {
    pub kind: Kind,
    /// The demonstration that it comes from.
    pub clip: usize,
    /// Model order, rad.
    pub joints_rad: Vec<f64>,
    pub object_from_palm: PoseRecord,
    /// Contacts of each finger, in the model's order, then of the palm.
    pub contacts: Vec<usize>,
    /// Smallest sum of normal forces that carries it at rest, in units of its weight, at the friction of the library.
    pub squeeze_per_weight: f64,
    /// Lowest point of the hand above the table, mm.
    pub clearance_mm: f64,
    /// Deepest point of the hand inside the object, mm.
    pub penetration_mm: f64,
}

impl Grasp {
    /// A grasp with its measures; `None` if it does not touch with the thumb and another finger, is too deep, or is not in force closure.
    pub fn measured(
        thing: &Thing,
        robot: &Robot,
        surface: &HandSurface,
        joints: &[f64],
        object_from_palm: &Pose,
        friction: f64,
    ) -> Result<Option<Self>> {
        let links = robot.forward_kinematics(joints, object_from_palm);
        let lowest = surface.lowest(&links, &thing.table.up).into_iter().fold(f64::INFINITY, f64::min);
        let exact = thing.sdf.exact();
        let depth = surface.depths(&links, exact, 0.0).into_iter().fold(0.0, f64::max);
        let contacts =
            surface.contacts(robot, joints, object_from_palm, exact, &ContactOptions::with_friction(friction))?;
        let count = |f: Option<usize>| contacts.iter().filter(|c| c.finger == f).count();
        let fingers: Vec<usize> =
            (0..surface.fingers.len()).map(Some).chain(std::iter::once(None)).map(count).collect();
        let thumb = surface.thumb().is_none_or(|t| fingers[t] > 0);
        let touching = fingers[..surface.fingers.len()].iter().filter(|n| **n > 0).count();
        let center = thing.center_of_mass();
        if 1e3 * depth > MAX_PENETRATION_MM || !thumb || touching < 2 || !holds_any_load(&contacts, &center)? {
            return Ok(None);
        }
        let squeeze = squeeze_per_weight(&contacts, center, thing.table.up)?;
        Ok(squeeze.map(|squeeze_per_weight| Self {
            kind: Kind::Retargeted,
            clip: 0,
            joints_rad: joints.to_vec(),
            object_from_palm: PoseRecord::from(object_from_palm),
            contacts: fingers,
            squeeze_per_weight,
            clearance_mm: 1e3 * (lowest - thing.table.height_m),
            penetration_mm: 1e3 * depth,
        }))
    }

    /// Where the palm is in the object's frame.
    pub fn pose(&self) -> Result<Pose> {
        self.object_from_palm.to_pose()
    }
}

/// What a library is made with.
#[derive(Debug, Clone, PartialEq)]
pub struct LibraryOptions {
    pub people: PeopleOptions,
    /// See [`found`].
    pub candidates: usize,
}

impl Default for LibraryOptions {
    fn default() -> Self {
        Self { people: PeopleOptions::default(), candidates: 200_000 }
    }
}

/// `grasps/NAME.json`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Library {
    schema: u32,
    /// Of object, hand, options and program: another digest, other grasps.
    digest: String,
    pub object: String,
    pub hand: String,
    pub joint_names: Vec<String>,
    /// Friction at which they were measured.
    pub friction: f64,
    pub grasps: Vec<Grasp>,
}

/// The file of an object's library in the folder of the results, if there is one.
///
/// # Errors
/// If the object's name leads out of the folder.
pub fn file(out: Option<&Path>, object: &str) -> Result<Option<PathBuf>> {
    Ok(out.map(|out| fsutil::output_path(out, &format!("grasps/{object}.json"))).transpose()?)
}

/// Layout of the file; raised when grasps are made otherwise.
const SCHEMA: u32 = 3;

impl Library {
    /// The library of the file if it was made of the same things, else a new one, which is written there.
    ///
    /// # Errors
    /// If the hand cannot grasp at all, no grasp was found, or the file cannot be written.
    pub fn of(thing: &Thing, hand: &TargetHand, options: &LibraryOptions, file: Option<&Path>) -> Result<Self> {
        let digest = digest(thing, hand, options);
        if let Some(file) = file
            && let Ok(text) = fsutil::read_text(file)
            && let Ok(library) = serde_json::from_str::<Self>(&text)
            && library.digest == digest
        {
            return Ok(library);
        }
        let postures = Postures::of(hand, options.people.seed)?;
        let mut grasps = people::grasps(thing, hand, &postures, &options.people)?;
        grasps.extend(found(thing, &hand.robot, options.candidates, options.people.friction, options.people.seed)?);
        if grasps.is_empty() {
            bail!(
                "no grasp of \"{}\" was found for {}: it may be too large for the hand or too low over the table",
                thing.spec.name,
                hand.robot.name
            );
        }
        let library = Self {
            schema: SCHEMA,
            digest,
            object: thing.spec.name.clone(),
            hand: hand.robot.name.clone(),
            joint_names: hand.robot.joint_names().into_iter().map(str::to_owned).collect(),
            friction: options.people.friction,
            grasps,
        };
        if let Some(file) = file {
            fsutil::write_atomic(file, &serde_json::to_vec(&library)?)?;
        }
        Ok(library)
    }
}

/// Grasps that nobody demonstrated: of hands laid on the object, and of `candidates` that pinch it.
pub fn found(thing: &Thing, robot: &Robot, candidates: usize, friction: f64, seed: u64) -> Result<Vec<Grasp>> {
    let tries = candidates.div_ceil(PINCHES_FOR_ONE);
    let mut grasps = wraps::grasps(thing, robot, tries, seed, &WrapOptions { friction, ..WrapOptions::default() })?;
    grasps.extend(searched(thing, robot, candidates, friction, seed)?);
    Ok(grasps)
}

/// Grasps between opposite points of the surface, of so many hands that are looked at.
pub fn searched(thing: &Thing, robot: &Robot, candidates: usize, friction: f64, seed: u64) -> Result<Vec<Grasp>> {
    let mut search = SearchOptions::default();
    (search.candidates, search.seed) = (candidates, seed);
    (search.friction, search.min_fingers) = (friction, 1);
    let surface = HandSurface::new(robot, ContactOptions::default().spacing_m)?;
    let points = sample_surface(&thing.asset.visual, SURFACE_POINTS, seed);
    let closer = Closer::new(robot)?;
    let found =
        search_grasps(robot, &surface, thing.sdf.as_ref(), &points, &thing.center_of_mass(), &thing.table, &search)?;
    let mut out = Vec::new();
    for (clip, f) in found.into_iter().enumerate().filter(|(_, f)| f.closed && closer.keeps_off_itself(&f.joints)) {
        let measured = Grasp::measured(thing, robot, &surface, &f.joints, &f.object_from_base, search.friction)?;
        out.extend(measured.map(|g| Grasp { kind: Kind::Searched, clip, ..g }));
    }
    Ok(out)
}

fn digest(thing: &Thing, hand: &TargetHand, options: &LibraryOptions) -> String {
    let mut hash = Sha256::new();
    hash.update(format!("{SCHEMA} {} {options:?} {:?}", hand.robot.name, thing.table));
    thing.asset.visual.vertices.iter().flat_map(|v| v.iter()).for_each(|c| hash.update(c.to_bits().to_le_bytes()));
    thing.asset.visual.faces.iter().flatten().for_each(|i| hash.update(i.to_le_bytes()));
    drex_core::fsutil::hex(&hash.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_variation_of_a_demonstrated_grasp_was_not_demonstrated() {
        let kinds = [Kind::Retargeted, Kind::Wrapped, Kind::Searched, Kind::Refined, Kind::Searched];
        let tried = Origins::of(kinds);
        assert_eq!(tried, Origins { demonstrated: 1, refined: 1, searched: 3 });
        // Twice: what is varied again is still made of a demonstrated one, what was found is still found.
        let varied = Origins::of(kinds.map(Kind::varied).map(Kind::varied));
        assert_eq!(varied, Origins { demonstrated: 0, refined: 2, searched: 3 });
        assert_eq!((tried.total(), varied.total()), (5, 5));
        assert_eq!(varied.to_string(), "0 demonstrated, 2 refined, 3 searched");
    }
}
