//! The same object as a coarse, a fine and a very fine mesh is pushed alike.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use crate::recorded::engine;
use drex_core::{MassProperties, Pose};
use drex_diffsim::{Collider, ConvexPolyhedron};
use nalgebra::{Matrix3, Point3, Vector3};

/// Vertices of the meshes, roughly.
const SIZES: [usize; 3] = [1_000, 13_000, 68_000];
const MASS_KG: f64 = 0.3;

/// A surface of about `vertices` points: rings over s from 0 to 1, with one at each fifth, `ratio` times as many points
/// around as along.
fn lathe(vertices: usize, ratio: f64, point: impl Fn(f64, f64) -> Point3<f64>) -> Vec<Point3<f64>> {
    let fifth = ((vertices as f64 / ratio).sqrt() / 5.0).round() as usize;
    let rings = 5 * fifth + 1;
    let around = vertices / rings / 4 * 4;
    let ring = |j: usize| {
        let (s, point) = (j as f64 / (rings - 1) as f64, &point);
        (0..around).map(move |i| point(TAU * i as f64 / around as f64, s))
    };
    (0..rings).flat_map(ring).collect()
}

/// A bottle: a foot of 5 cm, a slanted part, a straight wall of 6 cm width, a round shoulder, 16 cm high.
fn bottle(vertices: usize) -> Vec<Point3<f64>> {
    lathe(vertices, 1.0, |azimuth, s| {
        let (r, z) = profile(s);
        Point3::new(r * azimuth.cos(), r * azimuth.sin(), z - 0.08)
    })
}

/// Radius and height along the outline of the bottle, s from 0 at the foot's centre to 1 at the top's.
fn profile(s: f64) -> (f64, f64) {
    let arc = (s - 0.6) / 0.4 * PI / 2.0;
    match s {
        s if s < 0.2 => (0.025 * s / 0.2, 0.0),
        s if s < 0.4 => (0.025 + 0.005 * (s - 0.2) / 0.2, 0.01 * (s - 0.2) / 0.2),
        s if s < 0.6 => (0.03, 0.01 + 0.12 * (s - 0.4) / 0.2),
        _ => (0.03 * arc.cos(), 0.13 + 0.03 * arc.sin()),
    }
}

/// A bar of soap: an ellipsoid of 12 x 8 x 5 cm cut flat above and below at 3 cm.
fn soap(vertices: usize) -> Vec<Point3<f64>> {
    lathe(vertices, 2.0, |azimuth, s| {
        let cut = 0.6_f64.acos();
        let (side, z) = match s {
            s if s < 0.2 => (0.8 * s / 0.2, 0.6),
            s if s > 0.8 => (0.8 * (1.0 - s) / 0.2, -0.6),
            s => {
                let polar = cut + (PI - 2.0 * cut) * (s - 0.2) / 0.6;
                (polar.sin(), polar.cos())
            }
        };
        Point3::new(0.06 * side * azimuth.cos(), 0.04 * side * azimuth.sin(), 0.025 * z)
    })
}

/// A domino of 2.4 x 4.8 x 0.8 cm with a grid on every face.
fn domino(vertices: usize) -> Vec<Point3<f64>> {
    let n = (vertices as f64 / 6.0).sqrt().round() as usize;
    let half = Vector3::new(0.012, 0.024, 0.004);
    let mut out = Vec::new();
    for (axis, side, i, j) in (0..3)
        .flat_map(|axis| [-1.0, 1.0].map(|s| (axis, s)))
        .flat_map(|(axis, side)| (0..n).flat_map(move |i| (0..n).map(move |j| (axis, side, i, j))))
    {
        let mut x = Vector3::zeros();
        x[axis] = side;
        x[(axis + 1) % 3] = 2.0 * i as f64 / (n - 1) as f64 - 1.0;
        x[(axis + 2) % 3] = 2.0 * j as f64 / (n - 1) as f64 - 1.0;
        out.push(Point3::from(x.component_mul(&half)));
    }
    out
}

struct Case {
    object: &'static str,
    name: &'static str,
    height_m: f64,
    friction: f64,
    force: Vector3<f64>,
    at: Point3<f64>,
    end_s: f64,
    /// Whether the bar is held against it.
    held: bool,
}

#[test]
fn a_push_does_not_depend_on_the_number_of_vertices() {
    let weight = MASS_KG * 9.81;
    let cases = [
        Case {
            object: "bottle",
            name: "slides",
            height_m: 0.08,
            friction: 0.2,
            force: Vector3::x() * 0.6 * weight,
            at: Point3::new(-0.03, 0.0, -0.02),
            end_s: 1.0,
            held: true,
        },
        Case {
            object: "bottle",
            name: "rocks",
            height_m: 0.08,
            friction: 0.6,
            force: Vector3::x() * 0.33 * weight,
            at: Point3::new(-0.03, 0.0, 0.04),
            end_s: 0.2,
            // A round foot that rocks stands on one of its corners: where it turns to depends on where they lie.
            held: false,
        },
        Case {
            object: "domino",
            name: "rocks",
            height_m: 0.004,
            friction: 0.6,
            force: Vector3::z() * 0.7 * weight,
            at: Point3::new(0.0, 0.024, 0.004),
            end_s: 0.2,
            held: true,
        },
        Case {
            object: "soap",
            name: "slides and turns",
            height_m: 0.015,
            friction: 0.3,
            force: Vector3::x() * 0.8 * weight,
            at: Point3::new(-0.03, 0.012, 0.0),
            end_s: 1.0,
            held: true,
        },
        Case {
            object: "domino",
            name: "slides and turns",
            height_m: 0.004,
            friction: 0.3,
            force: Vector3::x() * 0.8 * weight,
            at: Point3::new(-0.012, 0.006, 0.0),
            end_s: 1.0,
            held: true,
        },
    ];
    let mut failures = Vec::new();
    for (name, mesh) in [("bottle", bottle as fn(usize) -> Vec<Point3<f64>>), ("soap", soap), ("domino", domino)] {
        let objects: Vec<Object> = SIZES.iter().map(|&n| Object::new(&mesh(n))).collect();
        for case in cases.iter().filter(|c| c.object == name) {
            let start = Pose::translation(0.0, 0.0, case.height_m);
            let ends: Vec<Pose> = objects.iter().map(|o| o.pushed(case, start)).collect();
            let reference = ends[ends.len() - 1];
            let moved = (reference.translation.vector - start.translation.vector).norm();
            let turned = reference.rotation.angle_to(&start.rotation);
            for (end, object) in ends.iter().zip(&objects) {
                let off = (end.translation.vector - reference.translation.vector).norm() / moved;
                let twisted = end.rotation.angle_to(&reference.rotation) / turned.max(0.01);
                println!(
                    "{name:<7} {:<17}{:>6} vertices: {:7.3} mm {:7.3} deg; off by {:.2} % and {:.2} %",
                    case.name,
                    object.vertices,
                    (end.translation.vector - start.translation.vector).norm() * 1e3,
                    end.rotation.angle_to(&start.rotation).to_degrees(),
                    off * 100.0,
                    twisted * 100.0
                );
                if case.held && (off > 0.01 || twisted > 0.01) {
                    failures.push(format!("{name} {} with {}", case.name, object.vertices));
                }
            }
        }
    }
    assert!(failures.is_empty(), "{failures:?}");
}

/// A mesh as the simulator takes it, with a solid that does not depend on the mesh: a box of two thirds the size.
struct Object {
    vertices: usize,
    solid: MassProperties,
    shape: Arc<Collider>,
}

impl Object {
    fn new(points: &[Point3<f64>]) -> Self {
        let (lo, hi) = points.iter().fold((points[0], points[0]), |(a, b), p| (a.inf(p), b.sup(p)));
        let s = (hi - lo).map(|x| (1e4 * x).round() * 1e-4 * 0.67);
        let s = s.component_mul(&s) / 12.0;
        let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y)) * MASS_KG;
        let solid = MassProperties { mass_kg: MASS_KG, center_of_mass: Point3::origin(), inertia };
        Self {
            vertices: points.len(),
            solid,
            shape: Arc::new(Collider::convex(vec![ConvexPolyhedron::from_points(points).unwrap()])),
        }
    }

    /// The pose at the end of a push of a tenth of a second.
    fn pushed(&self, case: &Case, start: Pose) -> Pose {
        let force = (case.force, case.at, [0.1, 0.2]);
        engine::push(&self.solid, &self.shape, case.friction, start, force, &[case.end_s]).unwrap()[0]
    }
}
