//! A desk in a room: sizes, pictures, things, lamp.

use std::sync::Arc;

use drex_core::Pose;
use drex_core::camera::Camera;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::objects::{Body, companions, thing};
use super::paint::{Order, Picture, Style, draw};
use super::scene::{Lamp, Paint, Role, Room, Scene, Shape, Solid};
use super::tag::Marker;

/// What the surfaces of a desk have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// Texture everywhere, each surface its own.
    Rich,
    /// As `Rich`, with loose small things around.
    Loose,
    /// Table and walls repeat a picture; opposite walls are equal.
    Echo,
    /// A disc with weak texture before a rich background.
    Turntable,
    /// A thing without texture on wood, a tag beside it.
    Plain,
    /// A shiny thing, nothing with texture.
    Gloss,
    /// One pattern everywhere.
    Repeat,
}

/// Measures of a desk.
#[derive(Debug, Clone)]
pub struct Desk {
    /// What its surfaces have.
    pub look: Look,
    /// Longest side of the thing, metres.
    pub size_m: f64,
    /// The thing's solids on z = 0.
    pub bodies: Vec<Body>,
    /// Point that photos aim at.
    pub target: Point3<f64>,
    /// Usual distance of the camera from it, metres.
    pub distance_m: f64,
    /// What a pixel covers at that distance, metres.
    pub unit_m: f64,
    /// Height of the table top, metres: 0 but under a disc.
    pub table_m: f64,
    /// Direction in which a tripod stands.
    pub tripod_rad: f64,
    /// The printed tag.
    pub marker: Option<Marker>,
    most_texels: usize,
}

impl Desk {
    /// Draws the measures of a desk that suits `camera`.
    #[must_use]
    pub fn random(look: Look, camera: &Camera, most_texels: usize, rng: &mut ChaCha8Rng) -> Self {
        let range: std::ops::Range<f64> = match look {
            Look::Plain => 0.12..0.26,
            Look::Turntable => 0.08..0.25,
            _ => 0.06..0.34,
        };
        let size_m = range.start * (range.end / range.start).powf(rng.random_range(0.0..1.0));
        let mut bodies = thing(size_m, rng);
        if look == Look::Loose {
            let near = radius(&bodies) * rng.random_range(0.9..1.1);
            let count = rng.random_range(2..5);
            bodies.extend(companions(count, near, 0.35 * size_m, rng));
        }
        let mut table_m = 0.0;
        if look == Look::Turntable {
            let thick = rng.random_range(0.008..0.025);
            let r = radius(&bodies) * rng.random_range(1.1..1.35);
            let half_m = Vector3::new(r, r, 0.5 * thick);
            let world_from_part = Pose::translation(0.0, 0.0, -0.5 * thick);
            bodies.push(Body { shape: Shape::Cylinder, half_m, world_from_part });
            table_m = -thick;
        }
        let top = bodies.iter().map(Body::top).fold(0.0, f64::max);
        let reach = radius(&bodies).hypot(0.5 * top);
        let focal = camera.focal_px().x;
        // A tag beside the thing must be in the picture too.
        let share = if look == Look::Plain { rng.random_range(0.5..0.62) } else { rng.random_range(0.6..0.82) };
        let distance_m = 2.0 * reach * focal / (share * f64::from(camera.height_px()));
        let target = Point3::new(0.0, 0.0, 0.42 * top);
        let marker = (look == Look::Plain).then(|| beside(&bodies, size_m, rng));
        Self {
            look,
            size_m,
            bodies,
            target,
            distance_m,
            unit_m: distance_m / focal,
            table_m,
            tripod_rad: rng.random_range(0.0..std::f64::consts::TAU),
            marker,
            most_texels,
        }
    }
}

/// Distance of the farthest point from the vertical axis through the origin, about.
fn radius(bodies: &[Body]) -> f64 {
    bodies
        .iter()
        .map(|b| {
            let rows = b.world_from_part.rotation.to_rotation_matrix().into_inner();
            let reach = (rows.abs() * b.half_m).xy().norm() * if b.shape == Shape::Box { 1.0 } else { 0.75 };
            b.world_from_part.translation.vector.xy().norm() + reach
        })
        .fold(0.0, f64::max)
}

fn beside(bodies: &[Body], size_m: f64, rng: &mut ChaCha8Rng) -> Marker {
    let side_m = (1e3 * size_m * rng.random_range(0.28..0.42)).round() / 1e3;
    let around: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let far = radius(bodies) + 0.9 * side_m;
    let centre = [far * around.cos(), far * around.sin(), 2.0 * PAPER_HALF_M];
    Marker::new(rng.random_range(0..100), side_m, centre, rng.random_range(-3.0..3.0))
}

const PAPER_HALF_M: f64 = 0.0004;

/// Paints and lights the desk.
#[must_use]
pub fn build(desk: &Desk, rng: &mut ChaCha8Rng) -> Scene {
    let d = desk.distance_m;
    let half = Vector2::from_fn(|_, _| (d * rng.random_range(1.3..1.85)).max(0.3));
    let mut painter = Painter { desk, motif: rng.random() };
    let mut solids = Vec::new();
    let table_thick = 0.03;
    let table = painter.table(half, rng);
    solids.push(Solid {
        shape: Shape::Box,
        half_m: Vector3::new(half.x, half.y, 0.5 * table_thick),
        world_from_part: Pose::translation(0.0, 0.0, desk.table_m - 0.5 * table_thick),
        role: Role::Still,
        paint: table,
    });
    for (i, body) in desk.bodies.iter().enumerate() {
        let disc = desk.look == Look::Turntable && i + 1 == desk.bodies.len();
        let paint = painter.part(body, disc, rng);
        solids.push(solid(body, Role::Object, paint));
    }
    if let Some(marker) = &desk.marker {
        solids.push(sheet(marker));
    }
    if desk.look == Look::Turntable {
        for body in background(desk, half, rng) {
            let paint = painter.still(&body, rng);
            solids.push(solid(&body, Role::Still, paint));
        }
    }
    let room_half = half.map(|h| h + rng.random_range(0.1..0.9) * (0.5 + d));
    let (floor, ceiling) = (desk.table_m - 0.72, desk.table_m + (3.2 * d).max(1.7));
    let low_m = Vector3::new(-room_half.x, -room_half.y, floor);
    let high_m = Vector3::new(room_half.x, room_half.y, ceiling);
    let paints = painter.room(low_m, high_m, rng);
    let swing = rng.random_range(0.0..std::f64::consts::TAU);
    let off = rng.random_range(0.15..0.5) * (ceiling - desk.table_m);
    let height = desk.table_m + rng.random_range(0.75..0.95) * (ceiling - desk.table_m);
    let lamp = Lamp {
        centre_m: Point3::new(
            (off * swing.cos()).clamp(-0.9 * room_half.x, 0.9 * room_half.x),
            (off * swing.sin()).clamp(-0.9 * room_half.y, 0.9 * room_half.y),
            height,
        ),
        radius_m: height * rng.random_range(0.06..0.16),
        strength: rng.random_range(0.75..1.0),
        ambient: rng.random_range(0.35..0.55),
    };
    Scene { solids, room: Room { low_m, high_m, paints }, lamp }
}

fn solid(body: &Body, role: Role, paint: Paint) -> Solid {
    Solid { shape: body.shape, half_m: body.half_m, world_from_part: body.world_from_part, role, paint }
}

fn sheet(marker: &Marker) -> Solid {
    let half = 0.5 * marker.sheet_m();
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), marker.yaw_rad);
    let [x, y, z] = marker.centre_m;
    Solid {
        shape: Shape::Box,
        half_m: Vector3::new(half, half, PAPER_HALF_M),
        world_from_part: Pose::from_parts(Translation3::new(x, y, z - PAPER_HALF_M), turn),
        role: Role::Still,
        paint: Paint::dull(Arc::new(marker.picture())),
    }
}

/// Things that stand still behind the disc, seen from the tripod.
fn background(desk: &Desk, half: Vector2<f64>, rng: &mut ChaCha8Rng) -> Vec<Body> {
    let disc = radius(&desk.bodies);
    let size = 0.9 * desk.size_m;
    let mut things = Vec::new();
    for (i, body) in companions(4, 0.0, size, rng).into_iter().enumerate() {
        let mut body = body;
        let around = desk.tripod_rad + std::f64::consts::PI + 0.55 * (i as f64 - 1.5 + rng.random_range(-0.25..0.25));
        let far = disc + body.half_m.xy().norm() + rng.random_range(0.2..0.9) * desk.size_m;
        // The table may be too narrow in this direction.
        let far = far.min(0.92 * half.min());
        if far < disc + body.half_m.xy().norm() {
            continue;
        }
        let z = body.world_from_part.translation.z + desk.table_m;
        body.world_from_part.translation = Translation3::new(far * around.cos(), far * around.sin(), z);
        things.push(body);
    }
    things
}

struct Painter<'a> {
    desk: &'a Desk,
    /// Seed of the one motif of a repeating desk.
    motif: u64,
}

const RICH: [Style; 6] = [Style::Print, Style::Confetti, Style::Terrazzo, Style::Quilt, Style::Confetti, Style::Clouds];
const TABLES: [Style; 6] = [Style::Print, Style::Confetti, Style::Terrazzo, Style::Quilt, Style::Wood, Style::Clouds];
const WALLS: [Style; 6] = [Style::Spines, Style::Confetti, Style::Print, Style::Quilt, Style::Spines, Style::Clouds];

fn pick(styles: &[Style], rng: &mut ChaCha8Rng) -> Style {
    styles.choose(rng).copied().unwrap_or(Style::Confetti)
}

impl Painter<'_> {
    fn picture(&self, style: Style, size_m: [f64; 2], unit_m: f64, rng: &mut ChaCha8Rng) -> Arc<Picture> {
        let order = Order { style, size_m, unit_m, most_texels: self.desk.most_texels };
        Arc::new(draw(&order, rng))
    }

    /// The one motif, in a size that suits `unit_m`.
    fn cloth(&self, unit_m: f64) -> Arc<Picture> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.motif);
        self.picture(Style::Cloth, [150.0 * unit_m; 2], unit_m, &mut rng)
    }

    fn table(&mut self, half: Vector2<f64>, rng: &mut ChaCha8Rng) -> Paint {
        let unit_m = self.desk.unit_m;
        let whole = [2.0 * half.x, 2.0 * half.y];
        let picture = match self.desk.look {
            Look::Echo => {
                let style = pick(&TABLES[..4], rng);
                let tile = 2.0 * half.min() / rng.random_range(4.0..6.5);
                self.picture(style, [tile, tile * rng.random_range(0.8..1.25)], unit_m, rng)
            }
            Look::Plain => self.picture(Style::Wood, whole, unit_m, rng),
            Look::Gloss => self.picture(Style::Plain, whole, unit_m, rng),
            Look::Repeat => self.cloth(unit_m),
            Look::Loose => {
                let style = if rng.random_bool(0.3) { Style::Cloth } else { pick(&TABLES, rng) };
                self.picture(style, whole, unit_m, rng)
            }
            Look::Turntable => {
                self.picture(pick(&[Style::Wood, Style::Print, Style::Confetti], rng), whole, unit_m, rng)
            }
            Look::Rich => self.picture(pick(&TABLES, rng), whole, unit_m, rng),
        };
        Paint { specular: rng.random_range(0.0..0.04), ..Paint::dull(picture) }
    }

    fn part(&mut self, body: &Body, disc: bool, rng: &mut ChaCha8Rng) -> Paint {
        let unit_m = self.desk.unit_m;
        // Faces lie apart in the picture, so that no two show the same.
        let side = 2.0 * body.half_m.max();
        let size = [(3.2 * side).max(40.0 * unit_m), (2.1 * side).max(40.0 * unit_m)];
        let style = match self.desk.look {
            Look::Plain | Look::Gloss => Style::Plain,
            Look::Repeat => Style::Cloth,
            Look::Turntable if disc => Style::Clouds,
            Look::Turntable => pick(&[Style::Clouds, Style::Quilt, Style::Confetti, Style::Print], rng),
            _ => pick(&RICH, rng),
        };
        let picture = match style {
            Style::Cloth => self.cloth(unit_m),
            _ => self.picture(style, size, unit_m, rng),
        };
        let mut paint = Paint::dull(picture);
        paint.shifts_m =
            std::array::from_fn(|f| Vector2::new((f % 3) as f64 * size[0] / 3.0, (f / 3) as f64 * size[1] / 2.0));
        paint.specular = rng.random_range(0.01..0.07);
        paint.hardness = rng.random_range(15.0..60.0);
        if self.desk.look == Look::Gloss {
            (paint.specular, paint.hardness, paint.mirror) = (0.35, 250.0, rng.random_range(0.2..0.4));
        }
        paint
    }

    fn still(&mut self, body: &Body, rng: &mut ChaCha8Rng) -> Paint {
        let side = 2.0 * body.half_m.max();
        let size = [3.2 * side, 2.1 * side];
        let picture = self.picture(pick(&RICH[..5], rng), size, self.desk.unit_m, rng);
        let mut paint = Paint::dull(picture);
        paint.shifts_m =
            std::array::from_fn(|f| Vector2::new((f % 3) as f64 * size[0] / 3.0, (f / 3) as f64 * size[1] / 2.0));
        paint
    }

    fn room(&mut self, low: Vector3<f64>, high: Vector3<f64>, rng: &mut ChaCha8Rng) -> [Paint; 6] {
        let extent = high - low;
        // The far wall is seen across the table, from beyond its middle.
        let far = 0.5 * extent.xy().min() + self.desk.distance_m;
        let unit_m = self.desk.unit_m * far / self.desk.distance_m;
        let wall = |axis: usize| [extent[1 - axis], extent.z];
        let floor = self.picture(Style::Clouds, [extent.x, extent.y], 2.0 * unit_m, rng);
        let ceiling = self.picture(Style::Plain, [extent.x, extent.y], 4.0 * unit_m, rng);
        let walls: [Arc<Picture>; 4] = match self.desk.look {
            Look::Plain | Look::Gloss => {
                std::array::from_fn(|i| self.picture(Style::Plain, wall(i / 2), 4.0 * unit_m, rng))
            }
            Look::Repeat => {
                let cloth = self.cloth(unit_m);
                std::array::from_fn(|_| Arc::clone(&cloth))
            }
            Look::Echo => {
                let style = pick(&[Style::Print, Style::Confetti, Style::Spines], rng);
                let tile = extent.x.min(extent.y) / rng.random_range(2.5..4.0);
                let picture = self.picture(style, [tile, tile * rng.random_range(0.7..1.0)], unit_m, rng);
                let across = if rng.random_bool(0.5) {
                    Arc::clone(&picture)
                } else {
                    self.picture(style, [tile, tile], unit_m, rng)
                };
                [Arc::clone(&picture), picture, Arc::clone(&across), across]
            }
            _ => std::array::from_fn(|i| self.picture(pick(&WALLS, rng), wall(i / 2), unit_m, rng)),
        };
        let [a, b, c, d] = walls;
        [a, b, c, d, floor, ceiling].map(Paint::dull)
    }
}
