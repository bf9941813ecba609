//! Things to stand on the table: solids that touch, from a seed.

use std::f64::consts::TAU;

use drex_core::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::scene::Shape;

/// A solid without its paint.
#[derive(Debug, Clone)]
pub struct Body {
    /// Its shape.
    pub shape: Shape,
    /// Half axes, metres.
    pub half_m: Vector3<f64>,
    /// Where it is on the table.
    pub world_from_part: Pose,
}

impl Body {
    fn new(shape: Shape, half: [f64; 3], at: [f64; 3]) -> Self {
        Self { shape, half_m: half.into(), world_from_part: Pose::translation(at[0], at[1], at[2]) }
    }

    fn turned(mut self, axis: Vector3<f64>, angle_rad: f64) -> Self {
        let turn = UnitQuaternion::from_axis_angle(&nalgebra::Unit::new_normalize(axis), angle_rad);
        self.world_from_part.rotation = turn * self.world_from_part.rotation;
        self
    }

    /// Half the extent along the world's z.
    #[must_use]
    pub fn half_height(&self) -> f64 {
        let row = self.world_from_part.rotation.to_rotation_matrix().into_inner().row(2).transpose();
        let h = &self.half_m;
        match self.shape {
            Shape::Box => row.abs().dot(h),
            Shape::Ellipsoid => row.component_mul(h).norm(),
            Shape::Cylinder => row.xy().norm() * h.x + row.z.abs() * h.z,
        }
    }

    /// Height of its highest point, metres.
    #[must_use]
    pub fn top(&self) -> f64 {
        self.world_from_part.translation.z + self.half_height()
    }

    /// Height of its lowest point, metres.
    #[must_use]
    pub fn bottom(&self) -> f64 {
        self.world_from_part.translation.z - self.half_height()
    }
}

/// A thing of three to seven solids, at most `size_m` tall or wide, its lowest point on the table z = 0.
pub fn thing(size_m: f64, rng: &mut ChaCha8Rng) -> Vec<Body> {
    let mut bodies = match rng.random_range(0..6) {
        0 => stack(rng),
        1 => mug(rng),
        2 => bottle(rng),
        3 => lying(rng),
        4 => cluster(rng),
        _ => figure(rng),
    };
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(0.0..TAU));
    for b in &mut bodies {
        b.world_from_part = Pose::from_parts(Translation3::identity(), yaw) * b.world_from_part;
    }
    fit(&mut bodies, size_m);
    bodies
}

/// Loose small things close around, each on the table.
pub fn companions(count: usize, near_m: f64, size_m: f64, rng: &mut ChaCha8Rng) -> Vec<Body> {
    let start: f64 = rng.random_range(0.0..TAU);
    (0..count)
        .map(|i| {
            let around = start + TAU * (i as f64 + rng.random_range(-0.2..0.2)) / count as f64;
            let half = Vector3::from_fn(|_, _| size_m * rng.random_range(0.3..0.55));
            let (shape, half) = match rng.random_range(0..3) {
                0 => (Shape::Box, half),
                1 => (Shape::Ellipsoid, half),
                _ => (Shape::Cylinder, Vector3::new(half.x, half.x, half.z)),
            };
            let far = near_m + half.xy().norm();
            let at = [far * around.cos(), far * around.sin(), half.z];
            Body::new(shape, half.into(), at).turned(Vector3::z(), rng.random_range(0.0..TAU))
        })
        .collect()
}

/// Lifts what reaches below the table, then scales and shifts so that the thing stands on z = 0 about the origin and its longest side is `size_m`.
fn fit(bodies: &mut [Body], size_m: f64) {
    for b in bodies.iter_mut() {
        b.world_from_part.translation.z -= b.bottom().min(0.0);
    }
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for b in bodies.iter() {
        let rotation = b.world_from_part.rotation.to_rotation_matrix().into_inner();
        let reach = rotation.abs() * b.half_m;
        let at = b.world_from_part.translation.vector;
        low = low.inf(&(at - reach));
        high = high.sup(&(at + reach));
    }
    let scale = size_m / (high - low).max();
    let floor = bodies.iter().map(Body::bottom).fold(f64::INFINITY, f64::min);
    let middle = 0.5 * (low + high);
    let origin = Vector3::new(middle.x, middle.y, floor);
    for b in bodies {
        b.half_m *= scale;
        b.world_from_part.translation.vector = (b.world_from_part.translation.vector - origin) * scale;
    }
}

fn stack(rng: &mut ChaCha8Rng) -> Vec<Body> {
    let mut bodies: Vec<Body> = Vec::new();
    let mut top = 0.0;
    let mut wide: f64 = rng.random_range(0.7..1.0);
    for level in 0..rng.random_range(3..5) {
        let tall = rng.random_range(0.25..0.6);
        let slim = rng.random_range(0.65..1.0);
        let shift = if level == 0 { 0.0 } else { 0.2 * wide };
        let at = [rng.random_range(-1.0..1.0) * shift, rng.random_range(-1.0..1.0) * shift, top + tall];
        let body = match rng.random_range(0..3) {
            0 => Body::new(Shape::Box, [wide, slim * wide, tall], at),
            // A round thing sinks into what it stands on: a union without a needle's eye.
            1 => Body::new(Shape::Ellipsoid, [wide, slim * wide, tall], [at[0], at[1], at[2] - 0.25 * tall]),
            _ => Body::new(Shape::Cylinder, [slim * wide, slim * wide, tall], at),
        };
        bodies.push(body.turned(Vector3::z(), rng.random_range(0.0..TAU)));
        top = bodies[bodies.len() - 1].top() - 0.05;
        wide *= rng.random_range(0.55..0.85);
    }
    let knob = rng.random_range(0.15..0.3);
    let side: f64 = rng.random_range(0.0..TAU);
    let first = bodies[0].half_m;
    let reach = first.xy().min() * 0.95;
    bodies.push(Body::new(
        Shape::Ellipsoid,
        [knob, knob, 1.3 * knob],
        [reach * side.cos(), reach * side.sin(), first.z],
    ));
    bodies
}

fn mug(rng: &mut ChaCha8Rng) -> Vec<Body> {
    let (r, h) = (rng.random_range(0.45..0.75), rng.random_range(0.5..0.9));
    let bar = rng.random_range(0.06..0.12);
    let out = r + rng.random_range(0.25..0.45);
    let low = h * rng.random_range(0.4..0.7);
    let high = 2.0 * h - low * rng.random_range(0.4..0.8);
    vec![
        Body::new(Shape::Cylinder, [r, r, h], [0.0, 0.0, h]),
        Body::new(Shape::Cylinder, [1.1 * r, 1.1 * r, 0.07], [0.0, 0.0, 2.0 * h]),
        Body::new(Shape::Box, [0.5 * out, 1.6 * bar, bar], [0.5 * out, 0.0, low]),
        Body::new(Shape::Box, [0.5 * out, 1.6 * bar, bar], [0.5 * out, 0.0, high]),
        Body::new(Shape::Box, [bar, 1.6 * bar, 0.5 * (high - low) + bar], [out, 0.0, 0.5 * (low + high)]),
        Body::new(Shape::Ellipsoid, [0.25, 0.25, 0.16], [0.0, 0.0, 2.0 * h + 0.1]),
    ]
}

fn bottle(rng: &mut ChaCha8Rng) -> Vec<Body> {
    let (r, h) = (rng.random_range(0.4..0.6), rng.random_range(0.7..1.2));
    let neck = r * rng.random_range(0.3..0.5);
    let lean = rng.random_range(0.15..0.3);
    let tag = [0.35 * r, 0.2 * r, rng.random_range(0.3..0.6) * h];
    vec![
        Body::new(Shape::Cylinder, [r, r, h], [0.0, 0.0, h]),
        Body::new(Shape::Ellipsoid, [r, r, 0.7 * r], [0.0, 0.0, 2.0 * h]),
        Body::new(Shape::Cylinder, [neck, neck, 0.3], [0.0, 0.0, 2.0 * h + 0.7 * r + 0.15]),
        Body::new(Shape::Cylinder, [1.4 * neck, 1.4 * neck, 0.1], [0.0, 0.0, 2.0 * h + 0.7 * r + 0.45]),
        Body::new(Shape::Box, tag, [1.05 * r, 0.0, tag[2]]).turned(Vector3::y(), -lean),
        Body::new(Shape::Box, [0.5 * r, 0.5 * r, 0.25 * h], [-0.6 * r, 0.7 * r, 0.25 * h]).turned(Vector3::z(), 0.5),
    ]
}

fn lying(rng: &mut ChaCha8Rng) -> Vec<Body> {
    let (r, long) = (rng.random_range(0.25..0.4), rng.random_range(0.7..1.0));
    let across = std::f64::consts::FRAC_PI_2;
    let head = r * rng.random_range(1.2..1.6);
    let foot = rng.random_range(0.2..0.35);
    vec![
        Body::new(Shape::Cylinder, [r, r, long], [0.0, 0.0, r + 0.1]).turned(Vector3::y(), across),
        Body::new(Shape::Ellipsoid, [0.8 * head, head, head], [long, 0.0, head]),
        Body::new(Shape::Box, [foot, 1.3 * r, 0.5 * r], [-0.6 * long, 0.0, 0.5 * r]),
        Body::new(Shape::Box, [0.3, 0.18, 0.25], [-0.1, 0.3 * r, 2.0 * r + 0.2]).turned(Vector3::x(), 0.4),
        Body::new(Shape::Cylinder, [0.12, 0.12, 0.3], [-0.5 * long, -0.2 * r, 2.0 * r + 0.25]),
    ]
}

fn cluster(rng: &mut ChaCha8Rng) -> Vec<Body> {
    let mut bodies = vec![Body::new(Shape::Box, [0.6, 0.45, 0.35], [0.0, 0.0, 0.35])];
    for _ in 0..rng.random_range(3..6) {
        let half = [0; 3].map(|_| rng.random_range(0.18..0.4));
        let around: f64 = rng.random_range(0.0..TAU);
        let up = rng.random_range(0.2..0.9);
        let body = Body::new(Shape::Box, half, [0.55 * around.cos(), 0.42 * around.sin(), up]);
        let tilt = Vector3::new(rng.random_range(-0.3..0.3), rng.random_range(-0.3..0.3), 1.0);
        let body = body.turned(tilt, rng.random_range(-0.8..0.8));
        bodies.push(body);
    }
    bodies
}

fn figure(rng: &mut ChaCha8Rng) -> Vec<Body> {
    let belly = [0; 3].map(|_| rng.random_range(0.35..0.55));
    let plinth = rng.random_range(0.12..0.25);
    let waist = 2.0 * plinth + 0.85 * belly[2];
    let head = rng.random_range(0.22..0.36);
    let neck = waist + belly[2] + 0.7 * head;
    let arm = rng.random_range(0.08..0.13);
    let mut bodies = vec![
        Body::new(Shape::Box, [0.6, 0.5, plinth], [0.0, 0.0, plinth]),
        Body::new(Shape::Ellipsoid, belly, [0.0, 0.0, waist]),
        Body::new(Shape::Ellipsoid, [head, 0.9 * head, 1.15 * head], [0.05, 0.0, neck]),
    ];
    for side in [-1.0, 1.0] {
        let lift = rng.random_range(0.3..1.2);
        let at = [0.05, side * belly[1], waist];
        bodies.push(Body::new(Shape::Cylinder, [arm, arm, 0.35], at).turned(Vector3::x(), side * lift));
    }
    if rng.random_bool(0.6) {
        bodies.push(Body::new(Shape::Cylinder, [0.7 * head, 0.7 * head, 0.15], [0.05, 0.0, neck + 1.1 * head]));
    }
    bodies
}
