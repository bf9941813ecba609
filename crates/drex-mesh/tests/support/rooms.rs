//! Made scans of rooms: a table with things on it, walls, posters and a floor, cameras round the object, and the points that
//! a structure from motion would find.

use std::f64::consts::TAU;

use drex_core::Pose;
use drex_core::camera::{Camera, CameraModel};
use drex_mesh::{Scene, ScenePoint, SceneView, Similarity};
use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A box, turned about z; metres, the world's z is up and the table's top is z = 0.
#[derive(Debug, Clone)]
pub struct Block {
    pub centre: Point3<f64>,
    pub half: Vector3<f64>,
    pub yaw: f64,
}

/// A made scan in arbitrary axes and unit.
pub struct Room {
    pub scene: Scene,
    /// Metres, z up, table at z = 0.
    pub world_from_scan: Similarity,
    /// What the object is made of.
    pub object: Vec<Block>,
    /// Other things on the table.
    pub others: Vec<Block>,
}

impl Block {
    fn local(&self, p: &Point3<f64>) -> Vector3<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -self.yaw) * (p - self.centre)
    }

    /// Whether the segment from a to b passes through the box, ends left out.
    fn hides(&self, a: &Point3<f64>, b: &Point3<f64>) -> bool {
        let (a, b) = (self.local(a), self.local(b));
        let d = b - a;
        let (mut t0, mut t1) = (0.0f64, 1.0f64 - 1e-4);
        for k in 0..3 {
            if d[k].abs() < 1e-12 {
                if a[k].abs() > self.half[k] {
                    return false;
                }
                continue;
            }
            let (u, v) = ((-self.half[k] - a[k]) / d[k], (self.half[k] - a[k]) / d[k]);
            (t0, t1) = (t0.max(u.min(v)), t1.min(u.max(v)));
        }
        t0 < t1
    }

    fn world(&self, local: &Vector3<f64>) -> Point3<f64> {
        self.centre + UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw) * local
    }

    /// Its corners.
    pub fn corners(&self) -> Vec<Point3<f64>> {
        let sign = |k: usize, bit: usize| if k >> bit & 1 == 0 { -1.0 } else { 1.0 };
        (0..8)
            .map(|k| self.world(&self.half.component_mul(&Vector3::new(sign(k, 0), sign(k, 1), sign(k, 2)))))
            .collect()
    }

    /// Points of its faces with their outward normals, so many per square metre; not of the bottom.
    fn surface(&self, per_m2: f64, random: &mut ChaCha8Rng, out: &mut Vec<(Point3<f64>, Vector3<f64>)>) {
        for k in 0..3 {
            let (u, v) = ((k + 1) % 3, (k + 2) % 3);
            for side in [-1.0, 1.0] {
                if k == 2 && side < 0.0 {
                    continue;
                }
                let n = (4.0 * self.half[u] * self.half[v] * per_m2) as usize;
                for _ in 0..n {
                    let mut local = Vector3::zeros();
                    local[k] = side * self.half[k];
                    local[u] = self.half[u] * random.random_range(-1.0..1.0);
                    local[v] = self.half[v] * random.random_range(-1.0..1.0);
                    let normal = self.world(&Vector3::ith(k, side)) - self.centre;
                    out.push((self.world(&local), normal));
                }
            }
        }
    }
}

fn log_uniform(random: &mut ChaCha8Rng, lo: f64, hi: f64) -> f64 {
    random.random_range(lo.ln()..hi.ln()).exp()
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    let (u, a) = (random.random_range(0.0..1.0), random.random_range(0.0..TAU));
    drex_core::stats::normal_pair(u, a)[0]
}

/// The room of a seed.
pub fn room(seed: u64) -> Room {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let r = &mut random;
    let block = |x: f64, y: f64, half: Vector3<f64>, base: f64, yaw: f64| Block {
        centre: Point3::new(x, y, base + half.z),
        half,
        yaw,
    };
    // The object: a box, often with a second one on top or beside it.
    let half = Vector3::new(r.random_range(0.025..0.07), r.random_range(0.02..0.06), r.random_range(0.015..0.09));
    let yaw = r.random_range(0.0..3.0);
    let mut object = vec![block(0.0, 0.0, half, 0.0, yaw)];
    if r.random_bool(0.6) {
        let top = half.component_mul(&Vector3::new(r.random_range(0.4..0.95), r.random_range(0.4..0.95), 0.8));
        object.push(block(0.0, 0.0, top, 2.0 * half.z, yaw));
    }
    if r.random_bool(0.4) {
        object.push(block(half.x + 0.01, 0.0, Vector3::new(0.015, 0.015, 0.02), 0.0, 0.0));
    }
    let tall = object.iter().map(|b| b.centre.z + b.half.z).fold(0.0, f64::max);
    let size = tall.max(2.0 * half.x).max(2.0 * half.y);
    // Other things, further off.
    let others: Vec<Block> = (0..r.random_range(0..4))
        .map(|_| {
            let (far, turn) = (r.random_range(0.14..0.4) + size, r.random_range(0.0..TAU));
            let half = Vector3::new(r.random_range(0.02..0.05), r.random_range(0.02..0.05), r.random_range(0.01..0.1));
            block(far * turn.cos(), far * turn.sin(), half, 0.0, turn)
        })
        .collect();
    // The table is a slab over a floor; walls stand behind its edges.
    let table_half = Vector3::new(r.random_range(0.3..0.9), r.random_range(0.3..0.7), 0.015);
    let shift = Vector3::new(
        r.random_range(-0.5..0.5) * (table_half.x - 0.2),
        r.random_range(-0.5..0.5) * (table_half.y - 0.2),
        -0.015,
    );
    let table = Block { centre: Point3::from(shift), half: table_half, yaw: 0.0 };
    let floor_z = -r.random_range(0.4..0.8);
    let wall_x = shift.x - table_half.x - log_uniform(r, 0.02, 1.5);
    let wall_y = shift.y + table_half.y + log_uniform(r, 0.02, 1.5);
    let mut surface: Vec<(Point3<f64>, Vector3<f64>)> = Vec::new();
    let object_density = log_uniform(r, 4e3, 6e4);
    object.iter().for_each(|b| b.surface(object_density, r, &mut surface));
    others.iter().for_each(|b| b.surface(log_uniform(r, 4e3, 4e4), r, &mut surface));
    table.surface(log_uniform(r, 600.0, 8e3), r, &mut surface);
    let mut sheet = |n: usize, lo: Point3<f64>, hi: Point3<f64>, normal: Vector3<f64>, r: &mut ChaCha8Rng| {
        for _ in 0..n {
            let at = |k: usize, r: &mut ChaCha8Rng| lo[k] + (hi[k] - lo[k]) * r.random_range(0.0..1.0);
            surface.push((Point3::new(at(0, r), at(1, r), at(2, r)), normal));
        }
    };
    let n = |r: &mut ChaCha8Rng| log_uniform(r, 100.0, 3000.0) as usize;
    let (count_x, count_y, count_floor, poster) = (n(r), n(r), n(r), r.random_range(0..2500));
    sheet(count_x, Point3::new(wall_x, -2.0, floor_z), Point3::new(wall_x, 2.0, 1.5), Vector3::x(), r);
    sheet(count_y, Point3::new(-2.0, wall_y, floor_z), Point3::new(2.0, wall_y, 1.5), -Vector3::y(), r);
    sheet(count_floor, Point3::new(-2.0, -2.0, floor_z), Point3::new(2.0, 2.0, floor_z), Vector3::z(), r);
    sheet(poster, Point3::new(wall_x, -0.4, 0.0), Point3::new(wall_x, 0.4, 0.6), Vector3::x(), r);

    // Cameras: a ring or an arc at one to three heights, held by hand.
    let views: Vec<Pose> = {
        let (count, arc) = (r.random_range(24..60), if r.random_bool(0.7) { TAU } else { r.random_range(1.8..4.5) });
        let from = if arc > 6.0 { 0.0 } else { r.random_range(0.0..TAU) };
        let rings: Vec<f64> = (0..r.random_range(1..4)).map(|_| r.random_range(0.2..1.2)).collect();
        let distance = size * r.random_range(2.2..4.5);
        (0..count)
            .map(|k| {
                let a = from + arc * f64::from(k) / f64::from(count) * rings.len() as f64;
                let elevation: f64 = rings[(k as usize * rings.len()) / count as usize] + 0.05 * normal(r);
                let far = distance * r.random_range(0.85..1.15);
                let eye = Point3::new(
                    far * elevation.cos() * a.cos(),
                    far * elevation.cos() * a.sin(),
                    0.4 * tall + far * elevation.sin(),
                );
                let mut aim = || 0.12 * size * normal(r);
                let target = Point3::new(aim(), aim(), 0.45 * tall + aim());
                let held = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.06 * normal(r));
                Pose::face_towards(&eye, &target, &-Vector3::z()) * Pose::from_parts(Translation3::identity(), held)
            })
            .collect()
    };
    // Walls do not stand in front of the cameras: those beyond one are left out.
    let views: Vec<Pose> =
        views.into_iter().filter(|v| v.translation.x > wall_x + 0.02 && v.translation.y < wall_y - 0.02).collect();
    let lens = Camera::new(CameraModel::SimplePinhole, 960, 720, &[720.0, 480.0, 360.0]).unwrap();
    let to_scan = Similarity {
        scale: log_uniform(r, 0.5, 30.0),
        rotation: UnitQuaternion::from_euler_angles(normal(r), normal(r), normal(r)),
        translation: Vector3::new(normal(r), normal(r), normal(r)) * 3.0,
    };
    let solids: Vec<&Block> = object.iter().chain(&others).chain([&table]).collect();
    let noise_px = r.random_range(0.3..0.9);
    let mut points = Vec::new();
    for (p, out) in &surface {
        let mut seen = Vec::new();
        for (i, pose) in views.iter().enumerate() {
            let eye = Point3::from(pose.translation.vector);
            let ray = eye - p;
            // Oblique, hidden or outside: not seen; and a detector misses much.
            if ray.dot(out) < 0.2 * ray.norm()
                || !lens.project(&pose.inverse_transform_point(p)).is_some_and(|px| lens.contains(&px))
                || solids.iter().any(|s| s.hides(&(p + out * 1e-5), &eye))
                || r.random_bool(0.6)
            {
                continue;
            }
            seen.push(i);
        }
        // A track breaks as the view turns.
        if seen.len() > 12 {
            let first = r.random_range(0..seen.len() - 8);
            seen = seen[first..first + 8].to_vec();
        }
        let directions: Vec<Vector3<f64>> =
            seen.iter().map(|&i| (views[i].translation.vector - p.coords).normalize()).collect();
        let widest = directions.iter().flat_map(|a| directions.iter().map(move |b| a.angle(b))).fold(0.0, f64::max);
        if seen.len() < 3 || widest < 0.03 {
            continue;
        }
        let mut information = Matrix3::zeros();
        for (&i, d) in seen.iter().zip(&directions) {
            let far = (views[i].translation.vector - p.coords).norm();
            information += (720.0 / far / noise_px).powi(2) * (Matrix3::identity() - d * d.transpose());
        }
        let Some(root) = information.try_inverse().and_then(|c| c.cholesky()) else { continue };
        let mut place = p + root.l() * Vector3::new(normal(r), normal(r), normal(r));
        if r.random_bool(0.01) {
            place += 0.1 * Vector3::new(normal(r), normal(r), normal(r));
        }
        points.push(ScenePoint { position: to_scan.point(&place), views: seen, object_share: None });
    }
    let views = views.iter().map(|v| SceneView { lens: lens.clone(), world_from_camera: to_scan.pose(v) }).collect();
    let scene = Scene::new(points, views).unwrap();
    Room { scene, world_from_scan: to_scan.inverse(), object, others }
}
