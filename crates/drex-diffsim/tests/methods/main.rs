//! The same cases with every method of stepping: the default one, and with the feature `ablation` all of them.
#![allow(clippy::unwrap_used, missing_docs)] // a test may panic

#[cfg(feature = "ablation")]
mod limits;
mod mass;
mod motion;

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
#[cfg(feature = "ablation")]
use drex_diffsim::Scheme;
use drex_diffsim::{AppliedForce, Body, Collider, ForcePoint, Geom, Method, Model, Part, Record, Scalar, Shape};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

const G: f64 = 9.81;
/// Contact of all cases: bodies sink in by g/ω² = 1.1 µm and do not rebound (τ > 2/ω). The penalty methods choose 9
/// substeps per step of 0.5 ms for it.
const FREQUENCY_RAD_S: f64 = 3e3;
const RELAXATION_S: f64 = 1e-3;

const IMPLICIT: Method = Method::SemiImplicit;
#[cfg(feature = "ablation")]
const PENALTY: Method = Method::Penalty { scheme: Scheme::SemiImplicit, substeps: None };
#[cfg(feature = "ablation")]
const EXPLICIT: Method = Method::Penalty { scheme: Scheme::Explicit, substeps: None };
#[cfg(feature = "ablation")]
const POSITIONS: Method = Method::PositionBased { substeps: 4 };
const ALL: &[Method] = &[
    IMPLICIT,
    #[cfg(feature = "ablation")]
    PENALTY,
    #[cfg(feature = "ablation")]
    EXPLICIT,
    #[cfg(feature = "ablation")]
    POSITIONS,
];

/// The longest substep of a method at the model's step. All are of first order: errors in time are proportional to it.
fn substep_s(method: Method, dt_s: f64) -> f64 {
    match method {
        Method::SemiImplicit => dt_s,
        #[cfg(feature = "ablation")]
        Method::PositionBased { substeps } => dt_s / f64::from(substeps),
        #[cfg(feature = "ablation")]
        Method::Penalty { substeps, .. } => dt_s / f64::from(substeps.unwrap_or(9)),
        _ => unreachable!("no other method"),
    }
}

fn is_explicit(method: Method) -> bool {
    ALL.get(2) == Some(&method)
}

/// A box of half extents `half` and mass `mass_kg`, stepped by `method`.
fn block<T: Scalar>(half: Vector3<f64>, mass_kg: T, method: Method) -> Model<T> {
    let mut model = Model::new(vec![body(half, mass_kg)]);
    model.contact.frequency_rad_s = T::lift(FREQUENCY_RAD_S);
    model.contact.relaxation_s = T::lift(RELAXATION_S);
    model.method = method;
    model
}

fn body<T: Scalar>(half: Vector3<f64>, mass_kg: T) -> Body<T> {
    let s = half.component_mul(&half) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    Body::new(&unit, mass_kg, Arc::new(Collider::new(&[Geom::new(Shape::Box { half_m: half })]).unwrap()))
}

fn force<T: Scalar>(f: Vector3<f64>, from: f64, to: f64, at: Point3<f64>) -> AppliedForce<T> {
    AppliedForce::new(Part::Body(0), &[from, to], &[f, Vector3::zeros()], ForcePoint::Body(at)).unwrap()
}

fn at<T: Scalar>(x: f64, y: f64, z: f64) -> Pose<T> {
    Pose::from_parts(Vector3::new(x, y, z).map(T::lift).into(), UnitQuaternion::identity())
}

fn place<T: Scalar>(record: &Record<T>, k: usize) -> Vector3<T> {
    record.bodies[0].poses[k].translation.vector
}
