//! Painted solids on a table in a room, and the rays that meet them.

use std::sync::Arc;

use drex_core::Pose;
use nalgebra::{Point3, Vector2, Vector3};

use super::paint::Picture;

/// Shape of a solid, by half axes along its own x, y, z.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// A box.
    Box,
    /// An ellipsoid.
    Ellipsoid,
    /// A round cylinder along z; its half axes along x and y are equal.
    Cylinder,
}

/// What a solid is to whoever looks for the object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Part of the thing that is captured; turns with the disc where there is one.
    Object,
    /// Table, paper, things in the background.
    Still,
}

/// How a surface looks.
#[derive(Clone)]
pub struct Paint {
    /// Colours, laid out in metres and repeated.
    pub picture: Arc<Picture>,
    /// Where each face begins in the picture, metres.
    pub shifts_m: [Vector2<f64>; 6],
    /// Strength of the highlight.
    pub specular: f64,
    /// Exponent of the highlight.
    pub hardness: f64,
    /// Share of the mirrored room in what is seen at a right angle.
    pub mirror: f64,
}

impl Paint {
    /// A dull surface whose faces all begin at the corner of the picture.
    #[must_use]
    pub fn dull(picture: Arc<Picture>) -> Self {
        Self { picture, shifts_m: [Vector2::zeros(); 6], specular: 0.02, hardness: 20.0, mirror: 0.0 }
    }
}

/// A painted solid.
#[derive(Clone)]
pub struct Solid {
    /// Its shape.
    pub shape: Shape,
    /// Half axes, metres.
    pub half_m: Vector3<f64>,
    /// Where it is.
    pub world_from_part: Pose,
    /// What it is.
    pub role: Role,
    /// How it looks.
    pub paint: Paint,
}

/// The room: an upright box seen from inside. Faces: -x, +x, -y, +y, floor, ceiling.
#[derive(Clone)]
pub struct Room {
    /// Lowest corner, metres.
    pub low_m: Vector3<f64>,
    /// Highest corner, metres.
    pub high_m: Vector3<f64>,
    /// One paint per face.
    pub paints: [Paint; 6],
}

/// A round lamp that faces down.
#[derive(Clone, Copy, Debug)]
pub struct Lamp {
    /// Its centre, metres.
    pub centre_m: Point3<f64>,
    /// Its radius, metres.
    pub radius_m: f64,
    /// Light on a surface that faces it from the distance of the table's origin.
    pub strength: f64,
    /// Light that comes from everywhere.
    pub ambient: f64,
}

/// Everything that is seen.
#[derive(Clone)]
pub struct Scene {
    /// Table and things.
    pub solids: Vec<Solid>,
    /// What is behind them.
    pub room: Room,
    /// What lights them.
    pub lamp: Lamp,
}

/// Where a ray meets a surface.
#[derive(Clone, Copy)]
pub struct Hit {
    /// Distance along the unit ray, metres.
    pub distance_m: f64,
    /// Outward unit normal, world.
    pub normal: Vector3<f64>,
    /// Place on the painted face, metres.
    pub on_face_m: Vector2<f64>,
    /// Number of the face, 0 to 5.
    pub face: usize,
    /// Index of the solid; `None` for the room.
    pub solid: Option<usize>,
}

/// A scene made ready for rays: inverse poses and a sphere about everything but the largest solids.
pub struct Traced<'a> {
    scene: &'a Scene,
    parts: Vec<Part>,
    /// Indices into `parts`: those inside the sphere, then the others.
    small: Vec<usize>,
    large: Vec<usize>,
    centre: Point3<f64>,
    radius2: f64,
}

struct Part {
    shape: Shape,
    half: Vector3<f64>,
    world_from_part: nalgebra::Matrix3<f64>,
    part_from_world: nalgebra::Matrix3<f64>,
    centre: Point3<f64>,
    /// Of the sphere about it.
    radius2: f64,
}

impl<'a> Traced<'a> {
    /// Makes `scene` ready, with everything of the object turned by `turn_rad` about the world's z axis.
    #[must_use]
    pub fn new(scene: &'a Scene, turn_rad: f64) -> Self {
        let turn = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn_rad);
        let parts: Vec<Part> = scene
            .solids
            .iter()
            .map(|s| {
                let pose = if s.role == Role::Object { turn * s.world_from_part } else { s.world_from_part };
                let world_from_part = pose.rotation.to_rotation_matrix().into_inner();
                Part {
                    shape: s.shape,
                    half: s.half_m,
                    world_from_part,
                    part_from_world: world_from_part.transpose(),
                    centre: pose.translation.vector.into(),
                    radius2: s.half_m.norm_squared(),
                }
            })
            .collect();
        let (small, large): (Vec<usize>, Vec<usize>) =
            (0..parts.len()).partition(|i| scene.solids[*i].role == Role::Object);
        let count = small.len().max(1) as f64;
        let centre = Point3::from(small.iter().map(|i| parts[*i].centre.coords).sum::<Vector3<f64>>() / count);
        let reach = |p: &Part| (p.centre - centre).norm() + p.radius2.sqrt();
        let radius2 = small.iter().map(|i| reach(&parts[*i])).fold(0.0, f64::max).powi(2);
        Self { scene, parts, small, large, centre, radius2 }
    }

    /// The scene behind it.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        self.scene
    }

    /// The first surface that the ray from `eye` along the unit vector `ray` meets.
    #[must_use]
    pub fn first_hit(&self, eye: &Point3<f64>, ray: &Vector3<f64>) -> Hit {
        let mut nearest = f64::INFINITY;
        let mut found = None;
        for i in self.candidates(eye, ray) {
            let p = &self.parts[i];
            let (o, d) = (p.part_from_world * (eye - p.centre), p.part_from_world * ray);
            if let Some((t, face)) = p.enter(&o, &d)
                && t < nearest
            {
                nearest = t;
                found = Some((i, face, o + d * t));
            }
        }
        let Some((i, face, at)) = found else { return self.room_hit(eye, ray) };
        let p = &self.parts[i];
        let (normal, on_face_m, face) = p.surface(&at, face);
        Hit { distance_m: nearest, normal: p.world_from_part * normal, on_face_m, face, solid: Some(i) }
    }

    /// Whether a solid stands between `from` and the point `reach_m` along the unit vector `ray`.
    #[must_use]
    pub fn blocked(&self, from: &Point3<f64>, ray: &Vector3<f64>, reach_m: f64) -> bool {
        self.candidates(from, ray).any(|i| {
            let p = &self.parts[i];
            let (o, d) = (p.part_from_world * (from - p.centre), p.part_from_world * ray);
            p.enter(&o, &d).is_some_and(|(t, _)| t < reach_m)
        })
    }

    fn candidates(&self, eye: &Point3<f64>, ray: &Vector3<f64>) -> impl Iterator<Item = usize> {
        let near = may_meet(&self.centre, self.radius2, eye, ray);
        let small = if near { &self.small[..] } else { &[] };
        let meets = move |i: &usize| may_meet(&self.parts[*i].centre, self.parts[*i].radius2, eye, ray);
        small.iter().chain(&self.large).copied().filter(meets)
    }

    fn room_hit(&self, eye: &Point3<f64>, ray: &Vector3<f64>) -> Hit {
        let room = &self.scene.room;
        let (mut nearest, mut axis) = (f64::INFINITY, 0);
        for a in 0..3 {
            let wall = if ray[a] > 0.0 { room.high_m[a] } else { room.low_m[a] };
            let t = (wall - eye[a]) / ray[a];
            if t < nearest {
                (nearest, axis) = (t, a);
            }
        }
        let at = eye + ray * nearest;
        let mut normal = Vector3::zeros();
        normal[axis] = -ray[axis].signum();
        let high = ray[axis] > 0.0;
        // Seen from inside, text on every wall reads from left to right and upright.
        let on_face_m = match (axis, high) {
            (0, true) => Vector2::new(room.high_m.y - at.y, room.high_m.z - at.z),
            (0, false) => Vector2::new(at.y - room.low_m.y, room.high_m.z - at.z),
            (1, true) => Vector2::new(at.x - room.low_m.x, room.high_m.z - at.z),
            (1, false) => Vector2::new(room.high_m.x - at.x, room.high_m.z - at.z),
            _ => Vector2::new(at.x - room.low_m.x, room.high_m.y - at.y),
        };
        Hit { distance_m: nearest, normal, on_face_m, face: 2 * axis + usize::from(high), solid: None }
    }
}

/// Whether the ray from `eye` along the unit vector `ray` may meet a sphere; one that it just misses may count.
fn may_meet(centre: &Point3<f64>, radius2: f64, eye: &Point3<f64>, ray: &Vector3<f64>) -> bool {
    let to_centre = centre - eye;
    let (along, distance2) = (to_centre.dot(ray), to_centre.norm_squared());
    // Rays have a length of one to single precision.
    let radius2 = radius2 + 1e-6 * distance2;
    distance2 < radius2 || (along > 0.0 && distance2 - along * along < radius2)
}

impl Part {
    /// Where the ray `o + t d` (part axes) enters the solid from outside, t > 0, and for boxes and cylinders the axis
    /// of the face (for a cylinder 2 is a lid, 0 the side).
    fn enter(&self, o: &Vector3<f64>, d: &Vector3<f64>) -> Option<(f64, usize)> {
        let h = &self.half;
        match self.shape {
            Shape::Box => {
                let (mut t_in, mut t_out, mut axis) = (f64::NEG_INFINITY, f64::INFINITY, 0);
                for a in 0..3 {
                    let inverse = 1.0 / d[a];
                    let (near, far) =
                        ((-h[a] * inverse.signum() - o[a]) * inverse, (h[a] * inverse.signum() - o[a]) * inverse);
                    if near > t_in {
                        (t_in, axis) = (near, a);
                    }
                    t_out = t_out.min(far);
                }
                (t_in < t_out && t_in > 0.0).then_some((t_in, axis))
            }
            Shape::Ellipsoid => {
                let (o, d) = (o.component_div(h), d.component_div(h));
                let (a, b, c) = (d.norm_squared(), o.dot(&d), o.norm_squared() - 1.0);
                let under_root = b * b - a * c;
                if under_root < 0.0 {
                    return None;
                }
                let t = (-b - under_root.sqrt()) / a;
                (t > 0.0).then_some((t, 0))
            }
            Shape::Cylinder => {
                let (a, b) = (d.xy().norm_squared(), o.xy().dot(&d.xy()));
                let c = o.xy().norm_squared() - h.x * h.x;
                let under_root = b * b - a * c;
                if under_root < 0.0 {
                    return None;
                }
                let root = under_root.sqrt();
                let (side_in, side_out) =
                    if a > 0.0 { ((-b - root) / a, (-b + root) / a) } else { (f64::NEG_INFINITY, f64::INFINITY) };
                let inverse = 1.0 / d.z;
                let lid_in = (-h.z * inverse.signum() - o.z) * inverse;
                let lid_out = (h.z * inverse.signum() - o.z) * inverse;
                let t_in = side_in.max(lid_in);
                (t_in < side_out.min(lid_out) && t_in > 0.0).then_some((t_in, if lid_in > side_in { 2 } else { 0 }))
            }
        }
    }

    /// Outward normal (part axes), place on the painted face and its number, at a point of the surface.
    fn surface(&self, at: &Vector3<f64>, axis: usize) -> (Vector3<f64>, Vector2<f64>, usize) {
        let h = &self.half;
        match self.shape {
            Shape::Box => {
                let mut normal = Vector3::zeros();
                normal[axis] = at[axis].signum();
                let (on_face, face) = on_box(at, h, axis);
                (normal, on_face, face)
            }
            Shape::Ellipsoid => {
                // Six pictures projected from the circumscribed cube: no poles.
                let unit = at.component_div(h);
                let axis = unit.iamax();
                let on_cube = (unit / unit[axis].abs()).component_mul(h);
                let (on_face, face) = on_box(&on_cube, h, axis);
                (unit.component_div(h).normalize(), on_face, face)
            }
            Shape::Cylinder if axis == 2 => {
                let (on_face, face) = on_box(at, h, 2);
                (Vector3::new(0.0, 0.0, at.z.signum()), on_face, face)
            }
            Shape::Cylinder => {
                let normal = Vector3::new(at.x / h.x, at.y / h.x, 0.0);
                let around = at.y.atan2(at.x) + std::f64::consts::PI;
                (normal, Vector2::new(around * h.x, h.z - at.z), 0)
            }
        }
    }
}

/// Place on the face of a box across `axis`, metres from its corner, and the face's number; upright seen from outside.
fn on_box(at: &Vector3<f64>, h: &Vector3<f64>, axis: usize) -> (Vector2<f64>, usize) {
    let sign = at[axis].signum();
    let on_face = match axis {
        0 => Vector2::new(h.y + sign * at.y, h.z - at.z),
        1 => Vector2::new(h.x - sign * at.x, h.z - at.z),
        _ => Vector2::new(h.x + at.x, h.y - sign * at.y),
    };
    (on_face, 2 * axis + usize::from(sign > 0.0))
}
