//! Recipes: what each kind of capture shows and how it is taken.

use std::str::FromStr;

use drex_core::camera::{Camera, CameraModel};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::desk::{Desk, Look, build};
use super::render::{Lens, Photo, Sensor, Shot, take};
use super::scene::Scene;
use super::shots::shots;
use super::tag::Marker;
use super::write::Exif;
use super::{Outcome, hash};

/// Kind of a capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A thing on a table in a room, three rings and close-ups.
    Orbit,
    /// As `Orbit`, but the pictures on table and walls repeat and opposite walls are equal.
    Echo,
    /// The thing turns on a disc before a tripod; the rest stands still and has more texture. With masks.
    Turntable,
    /// Frames of a film by hand.
    Video,
    /// A thing with next to no texture on wood, with a printed tag beside it.
    Plain,
    /// The camera only turns.
    Spin,
    /// Every photo smeared.
    Blur,
    /// Two photos.
    Few,
    /// Every photo of another desk.
    Apart,
    /// Two desks in one folder.
    Two,
    /// A shiny thing without texture on a table without texture. With masks.
    Gloss,
    /// One small pattern on every surface.
    Repeat,
}

impl Kind {
    /// Every kind with its name.
    pub const ALL: [(&'static str, Self); 12] = [
        ("orbit", Self::Orbit),
        ("echo", Self::Echo),
        ("turntable", Self::Turntable),
        ("video", Self::Video),
        ("plain", Self::Plain),
        ("spin", Self::Spin),
        ("blur", Self::Blur),
        ("few", Self::Few),
        ("apart", Self::Apart),
        ("two", Self::Two),
        ("gloss", Self::Gloss),
        ("repeat", Self::Repeat),
    ];

    /// Usual number and size of its photos.
    #[must_use]
    pub fn size(self) -> Size {
        let (photos, width_px, height_px) = match self {
            Self::Orbit => (60, 960, 720),
            Self::Echo => (60, 720, 540),
            Self::Turntable => (72, 800, 600),
            Self::Video => (240, 640, 480),
            Self::Plain => (50, 800, 600),
            Self::Spin => (16, 640, 480),
            Self::Blur => (20, 640, 480),
            Self::Few => (2, 640, 480),
            Self::Apart => (12, 640, 480),
            Self::Two => (24, 640, 480),
            Self::Gloss | Self::Repeat => (40, 800, 600),
        };
        Size { photos, width_px, height_px }
    }

    fn look(self) -> Look {
        match self {
            Self::Echo => Look::Echo,
            Self::Turntable => Look::Turntable,
            Self::Plain => Look::Plain,
            Self::Gloss => Look::Gloss,
            Self::Repeat => Look::Repeat,
            Self::Video | Self::Two | Self::Spin => Look::Loose,
            _ => Look::Rich,
        }
    }
}

impl FromStr for Kind {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let names = Self::ALL.map(|(n, _)| n).join(", ");
        Self::ALL
            .iter()
            .find(|(n, _)| *n == name)
            .map(|(_, kind)| *kind)
            .ok_or_else(|| format!("no kind of capture is called {name:?}; give one of {names}"))
    }
}

/// Number and size of photos.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Number of photos.
    pub photos: usize,
    /// Width, pixels.
    pub width_px: u32,
    /// Height, pixels.
    pub height_px: u32,
}

/// A capture before its photos are taken.
pub struct Capture {
    /// The scenes: one, but for `Apart` and `Two`.
    pub scenes: Vec<Scene>,
    /// The camera.
    pub lens: Lens,
    /// What it does to the light.
    pub sensor: Sensor,
    /// The photos, each with the index of its scene.
    pub shots: Vec<(usize, Shot)>,
    /// What stands in the photos' EXIF.
    pub exif: Option<Exif>,
    /// The printed tag.
    pub marker: Option<Marker>,
    /// Height of the plane on which the object and its disc stand, metres.
    pub floor_m: f64,
    /// Whether masks belong to the capture.
    pub with_masks: bool,
    seed: u64,
}

impl Capture {
    /// Takes photo `i`.
    #[must_use]
    pub fn take(&self, i: usize) -> Photo {
        let (scene, shot) = &self.shots[i];
        take(&self.scenes[*scene], &self.lens, &self.sensor, shot, hash(self.seed ^ (i as u64) << 32))
    }
}

/// Plans the capture of a kind from a seed; the same seed gives other scenes to other kinds.
///
/// # Errors
/// If the lens folds back inside the picture, or the size is empty.
pub fn plan(kind: Kind, seed: u64, size: &Size) -> Outcome<Capture> {
    let mut rng = ChaCha8Rng::seed_from_u64(hash(seed ^ (kind as u64 + 1) << 48));
    let camera = camera(kind, size, &mut rng)?;
    let sensor = Sensor {
        vignetting: rng.random_range(0.1..0.35),
        blur_px: rng.random_range(0.4..0.6),
        full_well: rng.random_range(3000.0..9000.0),
        read_noise: rng.random_range(0.001..0.0025),
        jpeg_quality: rng.random_range(75..86),
    };
    let exif = exif(kind, &camera, &mut rng);
    let desks = match kind {
        Kind::Apart => size.photos.max(1),
        Kind::Two => 2,
        _ => 1,
    };
    let mut scenes = Vec::new();
    let mut plans = Vec::new();
    for _ in 0..desks {
        let desk = Desk::random(kind.look(), &camera, if desks > 2 { 1200 } else { 3072 }, &mut rng);
        scenes.push(build(&desk, &mut rng));
        plans.push(desk);
    }
    let shots = shots(kind, size, &plans, &camera, &mut rng);
    Ok(Capture {
        scenes,
        lens: Lens::new(camera)?,
        sensor,
        shots,
        exif,
        marker: plans[0].marker,
        floor_m: plans[0].table_m,
        with_masks: matches!(kind, Kind::Turntable | Kind::Gloss),
        seed: rng.random(),
    })
}

fn camera(kind: Kind, size: &Size, rng: &mut ChaCha8Rng) -> Outcome<Camera> {
    let (w, h) = (f64::from(size.width_px), f64::from(size.height_px));
    let focal = w * if kind == Kind::Turntable { rng.random_range(0.85..1.15) } else { rng.random_range(0.68..0.92) };
    let off = |rng: &mut ChaCha8Rng| 0.008 * w * rng.random_range(-1.0..1.0);
    let (cx, cy) = (0.5 * w + off(rng), 0.5 * h + off(rng));
    let k1 = rng.random_range(-0.13..0.05);
    let k2 = if k1 < 0.0 { -k1 * rng.random_range(0.2..0.5) } else { -k1 * rng.random_range(0.0..0.8) };
    let bend = |rng: &mut ChaCha8Rng| rng.random_range(-0.0015..0.0015);
    let parameters = [focal, focal, cx, cy, k1, k2, bend(rng), bend(rng)];
    Ok(Camera::new(CameraModel::OpenCv, size.width_px, size.height_px, &parameters)?)
}

/// Phones write the focal length; cameras of turntables here and films do not.
fn exif(kind: Kind, camera: &Camera, rng: &mut ChaCha8Rng) -> Option<Exif> {
    let (w, h) = (f64::from(camera.width_px()), f64::from(camera.height_px()));
    let focal = camera.focal_px().x;
    // Makers disagree whether the width or the diagonal of the film counts.
    let focal_35 = if rng.random_bool(0.5) { 36.0 * focal / w } else { 43.267 * focal / w.hypot(h) };
    let wanted = match kind {
        Kind::Orbit | Kind::Echo | Kind::Plain => true,
        Kind::Turntable | Kind::Video => false,
        _ => rng.random_bool(0.5),
    };
    let exif = Exif {
        make: String::from("Lumenworks"),
        model: format!("Field {}", rng.random_range(2..9)),
        focal_35mm: focal_35.round() as u16,
        focal_tenths_mm: (10.0 * focal_35 / 6.3).round() as u32,
    };
    wanted.then_some(exif)
}
