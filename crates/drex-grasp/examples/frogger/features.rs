//! What may predict whether a pick succeeds: from contacts, mass and the cone programme, never from the stored metric.

use drex_core::{SignedDistance, Surface};
use drex_grasp::{
    ClosureOptions, Contact, GripForceProblem, TorqueLimits, distribute, force_closure, maximum_grip_force, min_weight,
    minimum_grip_force, required_grip_force, shake_loads,
};
use nalgebra::{DVector, Matrix3, Point3, SMatrix, SVector, Unit, UnitQuaternion, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::data::{FRICTION, Grasp, Kinematics, Object, TIP_RADIUS_M, Tips, contacts};

/// The direction from which FRoGGeR takes the tangents of its pyramids.
pub const TANGENT: [f64; 3] = [1.2, 2.3, 3.4];
/// Normals are averaged over a ring this wide to undo the facets of a decimated mesh, metres.
const FACET_M: f64 = 0.001;
const TORQUE_LIMIT_NM: f64 = 0.7;

/// The first so many of [`NAMES`] are min-weights.
pub const MIN_WEIGHTS: usize = 6;

/// Names of [`features`].
pub const NAMES: &[&str] = &[
    "min-weight",
    "min-weight, normals over 5 mm",
    "min-weight, normals over 10 mm",
    "min-weight, sphere contacts",
    "min-weight, fingertips off by 2 mm: mean",
    "the same: worst of 12",
    "epsilon",
    "grip force per weight",
    "friction margin",
    "grip force for shakes per weight",
    "slack at the controller's grip force",
    "maximum grip force",
    "worst gap",
    "mean gap",
    "normals: worst change over 5 mm",
    "pad against sphere normal: worst",
    "controller: force left over",
    "controller: torque left over",
    "controller: worst tangential share",
    "controller: the same at the sphere contacts",
    "contacts over the centre",
    "contacts beside the centre",
    "mass",
    "palm facing down",
    "reach of the weakest finger",
    "angular acceleration left over",
];

/// Min-weight the way FRoGGeR computes it.
pub fn frogger_min_weight(object: &Object, tips: &Tips) -> f64 {
    weight(&fine_contacts(object, tips))
}

/// The same with normals averaged over a ring of `radius_m`.
pub fn wide_min_weight(object: &Object, tips: &Tips, radius_m: f64) -> f64 {
    weight(&smoothed(object, tips, radius_m))
}

/// The contacts that their optimiser plans, without the facets of our meshes.
pub fn fine_contacts(object: &Object, tips: &Tips) -> Vec<Contact> {
    smoothed(object, tips, FACET_M)
}

/// One number per name in [`NAMES`]; `seed` draws the errors of the fingertips.
pub fn features(object: &Object, kinematics: &Kinematics, grasp: &Grasp, seed: u64) -> Vec<f64> {
    let tips = kinematics.tips(&grasp.q, &object.world_from_object);
    let fine = fine_contacts(object, &tips);
    let wide = smoothed(object, &tips, 0.005);
    let spheres = smoothed_at(object, &tips.centers, 0.003);
    let up = object.world_from_object.rotation.inverse() * Vector3::z();
    // Their simulation puts the centre of mass at the origin of the mesh.
    let center = Point3::origin();

    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let shifted: Vec<f64> = (0..12)
        .map(|_| {
            let mut moved = Tips { pads: tips.pads, centers: tips.centers, jacobians: tips.jacobians.clone(), ..tips };
            for p in &mut moved.pads {
                *p += Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0)) * 0.002;
            }
            weight(&smoothed(object, &moved, 0.003))
        })
        .collect();

    let problem = GripForceProblem::new(wide.clone(), object.mass_kg, center, up * -9.81);
    let mg = object.mass_kg * 9.81;
    let rest = minimum_grip_force(&problem).ok();
    let loads = shake_loads(object.mass_kg, 4.9, &problem.gravity);
    let shaken = required_grip_force(&problem, &loads).map_or(50.0, |s| (s.total_n / mg).min(50.0));
    let command = rest.as_ref().map_or(4.0, |s| s.total_n).max(4.0) * 1.05;
    let slack = distribute(&problem, command).map_or(-0.2, |d| d.slack_n / command);
    let limited = problem.clone().with_torques(TorqueLimits {
        jacobians: tips.jacobians.to_vec(),
        limits_nm: vec![(-TORQUE_LIMIT_NM, TORQUE_LIMIT_NM); 16],
        gravity_nm: DVector::zeros(16),
    });
    let largest = maximum_grip_force(&limited).map_or(0.1, |l| l.clamp(0.1, 1e4));
    let mut closure = ClosureOptions::about(center);
    closure.length_m = Some(0.05);
    let epsilon = force_closure(&wide, &closure).map_or(0.0, |c| c.epsilon);

    let gaps: Vec<f64> = tips.centers.iter().map(|p| object.sdf.signed_distance(p).distance_m - TIP_RADIUS_M).collect();
    let turn = |a: &[Contact], b: &[Contact]| {
        a.iter().zip(b).map(|(a, b)| a.normal.dot(&b.normal).clamp(-1.0, 1.0).acos()).fold(0.0, f64::max)
    };
    let pushed = controller(&fine, object.mass_kg, &up);
    let mut wrench = Vector6::zeros();
    for (c, f) in fine.iter().zip(&pushed) {
        let t = c.point.coords.cross(f);
        wrench += Vector6::new(f.x, f.y, f.z, t.x, t.y, t.z);
    }
    let force_left = (wrench.fixed_rows::<3>(0) - up * mg).norm();
    let torque_left = wrench.fixed_rows::<3>(3).norm();
    let share = |contacts: &[Contact]| {
        let each = contacts.iter().zip(&pushed).map(|(c, f)| {
            let n = f.dot(&c.normal);
            if n > 0.0 { ((f - c.normal * n).norm() / n).min(2.0) } else { 2.0 }
        });
        each.fold(0.0, f64::max)
    };
    let size = {
        let (a, b) = object.sdf.bounds();
        (b - a).norm()
    };
    let middle = Point3::from(fine.iter().map(|c| c.point.coords).sum::<Vector3<f64>>() / 4.0);
    let off = middle - center;
    let reach = tips.jacobians.iter().map(|j| {
        let j = Matrix3::from(j * j.transpose());
        j.symmetric_eigenvalues().min().max(0.0).sqrt()
    });
    vec![
        frogger_min_weight(object, &tips),
        weight(&wide),
        wide_min_weight(object, &tips, 0.010),
        weight(&spheres),
        shifted.iter().sum::<f64>() / 12.0,
        shifted.iter().copied().fold(f64::INFINITY, f64::min),
        epsilon,
        rest.as_ref().map_or(50.0, |s| (s.total_n / mg).min(50.0)).ln(),
        rest.as_ref().map_or(-0.2, |s| s.friction_margin),
        shaken.ln(),
        slack,
        largest.ln(),
        gaps.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        gaps.iter().sum::<f64>() / 4.0,
        turn(&fine, &wide),
        turn(&fine, &spheres),
        (force_left / mg + 1e-3).ln(),
        (torque_left / (mg * size) + 1e-4).ln(),
        share(&wide),
        share(&spheres),
        off.dot(&up) / size,
        (off - up * off.dot(&up)).norm() / size,
        object.mass_kg.ln(),
        -tips.palm_facing.dot(&up),
        reach.fold(f64::INFINITY, f64::min),
        (torque_left / (object.mass_kg * size * size) + 1e-2).ln(),
    ]
}

fn weight(contacts: &[Contact]) -> f64 {
    let options = ClosureOptions::default().with_tangent(TANGENT.into());
    min_weight(contacts, &options).unwrap_or(f64::NEG_INFINITY).max(-0.05)
}

fn smoothed(object: &Object, tips: &Tips, radius_m: f64) -> Vec<Contact> {
    smoothed_at(object, &tips.pads, radius_m)
}

/// Contacts whose normals are the mean of the faces' normals on a ring around the contact.
fn smoothed_at(object: &Object, points: &[Point3<f64>; 4], radius_m: f64) -> Vec<Contact> {
    let mut list = contacts(&object.sdf, points, FRICTION);
    for c in &mut list {
        let axes = c.axes();
        let mut sum = object.sdf.nearest(&c.point).normal;
        for k in 0..8 {
            let (s, co) = (std::f64::consts::TAU * f64::from(k) / 8.0).sin_cos();
            sum += object.sdf.nearest(&(c.point + (axes.column(1) * co + axes.column(2) * s) * radius_m)).normal;
        }
        if let Some(mean) = Unit::try_new(-sum, 1e-6) {
            c.normal = mean.into_inner();
        }
    }
    list
}

/// The forces that the pick's controller asks for at the start: the least squares balance of the weight over pyramids inside
/// the friction cones with at least 1 N of normal force per finger (0.25 N below 10 g). Object frame, N.
fn controller(contacts: &[Contact], mass_kg: f64, up: &Vector3<f64>) -> Vec<Vector3<f64>> {
    let least = if mass_kg <= 0.01 { 0.25 } else { 1.0 };
    let mut edges = Vec::with_capacity(16);
    for c in contacts {
        let t = Vector3::from(TANGENT);
        let x = (t - c.normal * t.dot(&c.normal)).normalize();
        let y = c.normal.cross(&x);
        for quarter in 0..4 {
            // The corners of the square inside the circle.
            let around = UnitQuaternion::from_axis_angle(
                &Unit::new_unchecked(c.normal),
                f64::from(quarter) * std::f64::consts::FRAC_PI_2,
            );
            edges.push(c.normal + around * (x + y) * (FRICTION * 0.5_f64.sqrt()));
        }
    }
    let mut w = SMatrix::<f64, 6, 16>::zeros();
    for (k, e) in edges.iter().enumerate() {
        let t = contacts[k / 4].point.coords.cross(e);
        w.set_column(k, &Vector6::new(e.x, e.y, e.z, t.x, t.y, t.z));
    }
    let wanted = up * (mass_kg * 9.81);
    let wanted = Vector6::new(wanted.x, wanted.y, wanted.z, 0.0, 0.0, 0.0);
    // Accelerated projected gradient; torques count in N m as in their cost.
    let step = 1.0 / w.norm_squared();
    let mut c = SVector::<f64, 16>::from_element(0.25 * least);
    let (mut ahead, mut t) = (c, 1.0_f64);
    for _ in 0..4000 {
        let mut next = ahead - w.tr_mul(&(w * ahead - wanted)) * step - ahead * (1e-6 * step);
        for finger in 0..4 {
            to_floor(&mut next.as_mut_slice()[4 * finger..4 * finger + 4], least);
        }
        let t_next = 0.5 * (1.0 + (1.0 + 4.0 * t * t).sqrt());
        ahead = next + (next - c) * ((t - 1.0) / t_next);
        (c, t) = (next, t_next);
    }
    (0..4).map(|i| (0..4).map(|k| edges[4 * i + k] * c[4 * i + k]).sum()).collect()
}

/// The nearest point with no negative entry and a sum of at least `least`.
fn to_floor(c: &mut [f64], least: f64) {
    if c.iter().map(|v| v.max(0.0)).sum::<f64>() >= least {
        c.iter_mut().for_each(|v| *v = v.max(0.0));
        return;
    }
    let mut sorted = c.to_vec();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let (mut sum, mut shift) = (0.0, 0.0);
    for (k, v) in sorted.iter().enumerate() {
        sum += v;
        let s = (sum - least) / (k + 1) as f64;
        if v - s > 0.0 {
            shift = s;
        }
    }
    c.iter_mut().for_each(|v| *v = (*v - shift).max(0.0));
}
