//! Weighs a block by Gauss-Newton: a push of known force is simulated with the true mass, and found again from another one.
//!
//!     cargo run --release -p drex-diffsim --example weigh

use std::sync::Arc;

use drex_core::{MassProperties, Pose};
use drex_diffsim::{
    AppliedForce, Body, Collider, Dual, ForcePoint, Geom, Model, Part, Result, Scalar, Scene, Shape, State, parameter,
    rollout, tangents,
};
use nalgebra::{Matrix2, Matrix3, Point3, UnitQuaternion, Vector2, Vector3};

const HALF: Vector3<f64> = Vector3::new(0.03, 0.03, 0.04);
const TRUTH: [f64; 2] = [0.2, 0.45];

/// Where the block is at 30 frames per second while it is pushed and slides to rest.
fn push<T: Scalar>(mass_kg: T, friction: T) -> Result<Vec<T>> {
    let s = HALF.component_mul(&HALF) / 3.0;
    let inertia = Matrix3::from_diagonal(&Vector3::new(s.y + s.z, s.z + s.x, s.x + s.y));
    let unit = MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia };
    let collider = Collider::new(&[Geom::new(Shape::Box { half_m: HALF })])?;
    let model = Model::new(vec![Body::new(&unit, mass_kg, Arc::new(collider))]);
    let mut scene = Scene::on_table(friction);
    let low = ForcePoint::Body(Point3::new(-HALF.x, 0.0, -0.02));
    scene.forces.push(AppliedForce::new(Part::Body(0), &[0.1, 0.3], &[Vector3::x() * 2.2, Vector3::zeros()], low)?);
    let position = Vector3::new(0.0, 0.0, HALF.z).map(T::lift);
    let start = State::at_rest(Pose::from_parts(position.into(), UnitQuaternion::identity()));
    let frames: Vec<f64> = (0..30).map(|k| f64::from(k) / 30.0).collect();
    let record = rollout(&model, &scene, &start, &frames)?;
    Ok(record.bodies[0].poses.iter().map(|p| p.translation.vector.x).collect())
}

#[allow(clippy::print_stdout)] // the output is the point of an example
fn main() -> Result<()> {
    let observed = push(TRUTH[0], TRUTH[1])?;
    // Logarithms: both are positive, and a step is a factor.
    let mut guess = Vector2::new(0.3_f64.ln(), 0.35_f64.ln());
    for iteration in 0..8 {
        let parameters: [Dual<2>; 2] = [0, 1].map(|i| parameter(guess[i], i).exp());
        let (mut hessian, mut gradient, mut cost) = (Matrix2::zeros(), Vector2::zeros(), 0.0);
        for (x, y) in push(parameters[0], parameters[1])?.iter().zip(&observed) {
            let (row, miss) = (tangents(x), x.re - y);
            hessian += row * row.transpose();
            gradient += row * miss;
            cost += miss * miss;
        }
        println!(
            "{iteration}: {:8.4} g, friction {:.5}, RMS {:.2e} m",
            1e3 * guess[0].exp(),
            guess[1].exp(),
            (cost / observed.len() as f64).sqrt()
        );
        let Some(step) = hessian.cholesky().map(|c| c.solve(&gradient)) else { break };
        guess -= step.map(|s| s.clamp(-0.5, 0.5));
    }
    Ok(())
}
