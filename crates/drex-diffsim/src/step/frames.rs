//! What the methods of stepping share: bodies at the start of a step, what a contact did, poses at its end.

use drex_core::Pose;
use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};

use super::{BodyFrame, Workspace};
use crate::articulation::TreeWork;
use crate::collide::Frame;
use crate::contact::{Contact, ContactForce};
use crate::math::{apply, apply_constant, congruent, cross_columns, exp, lift_rotation, renormalized, skew, solve3};
use crate::solve::Mode;
use crate::solve::contact_model::ContactModel;
use crate::state::Anchor;
use crate::{Body, Error, Model, Motion, Part, Result, Scalar, Scene, State};

/// Speed beyond which a rollout is called diverged, m/s or rad/s.
const SPEED_LIMIT: f64 = 1e4;

/// Kinematics at the start of the step, and velocities that smooth forces alone would lead to.
pub(crate) fn begin<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &State<T>,
    work: &mut Workspace<T>,
    dt: f64,
) -> Result<()> {
    let t = state.time_s;
    let h = T::lift(dt);
    work.motions.clear();
    work.motions.extend(scene.kinematic_bodies.iter().map(|m| m.path.at(t)));
    work.frames.clear();
    for (index, (body, s)) in model.bodies.iter().zip(&state.bodies).enumerate() {
        let frame = Frame::of(&s.world_from_body);
        let com = frame.p + apply(&frame.r, &body.center_of_mass.coords);
        let (mut linear, mut moment) = (scene.gravity, Vector3::zeros());
        for force in scene.forces.iter().filter(|f| f.on == Part::Body(index as u32)) {
            let f = force.mean(t, dt);
            if f == Vector3::zeros() {
                continue;
            }
            let f = f.map(T::lift) * (force.gain / body.mass_kg);
            match force.world_point(t + 0.5 * dt, &s.world_from_body) {
                Some(p) => {
                    linear += f;
                    moment += (p - com).cross(&f);
                }
                None => moment += f,
            }
        }
        work.frames.push(BodyFrame {
            plain: frame.value(),
            com,
            inertia: congruent(&frame.r, &body.unit_inertia),
            free: (s.velocity + linear * h, spin(&body.unit_inertia, &frame.r, &s.angular_velocity, &moment, dt)),
            frame,
            speed: s.velocity.map(|x| x.value()).norm() + s.angular_velocity.map(|x| x.value()).norm() * body.reach(),
        });
    }
    work.trees.resize_with(model.articulations.len(), TreeWork::default);
    work.joint_forces.resize_with(model.articulations.len(), Vec::new);
    for ((arm, s), tree) in model.articulations.iter().zip(&state.articulations).zip(&mut work.trees) {
        arm.kinematics(s, t, dt, tree);
    }
    Ok(())
}

/// The mass that a patch between two parts carries.
pub(crate) fn patch_mass<T: Scalar>(model: &Model<T>, a: Part, b: Part) -> T {
    let body = |part: Part| match part {
        Part::Body(i) => Some(model.bodies[i as usize].mass_kg),
        _ => None,
    };
    let link = |part: Part| match part {
        Part::Link { articulation: arm, link } => Some(model.articulations[arm as usize].contact_mass(link as usize)),
        _ => None,
    };
    match (body(a), body(b)) {
        (Some(x), Some(y)) => x * y / (x + y),
        (Some(x), None) | (None, Some(x)) => x,
        (None, None) => match (link(a), link(b)) {
            (Some(x), Some(y)) => x * y / (x + y),
            (Some(x), None) | (None, Some(x)) => x,
            (None, None) => T::one(),
        },
    }
}

/// Velocity and spin about the normal of a support on a path, at a contact.
pub(crate) fn carried<T: Scalar>(motion: Option<&Motion>, c: &Contact<T>) -> (Vector3<T>, T) {
    motion.map_or((Vector3::zeros(), T::zero()), |m| {
        let w = m.angular_velocity.map(T::lift);
        let arm = c.point - m.pose.translation.vector.map(T::lift);
        (m.velocity.map(T::lift) + w.cross(&arm), w.dot(&c.normal))
    })
}

pub(crate) fn kinematic_motion(motions: &[Motion], part: Part) -> Option<&Motion> {
    match part {
        Part::Kinematic(i) => motions.get(i as usize),
        _ => None,
    }
}

/// Rotation of a part's frame at the start of the step; `None` for what is fixed.
pub(crate) fn rotation_of<T: Scalar>(
    state: &State<T>,
    trees: &[TreeWork<T>],
    motions: &[Motion],
    part: Part,
) -> Option<UnitQuaternion<T>> {
    match part {
        Part::Static(_) => None,
        Part::Kinematic(i) => motions.get(i as usize).map(|m| lift_rotation(&m.pose.rotation)),
        Part::Body(i) => Some(state.bodies[i as usize].world_from_body.rotation),
        Part::Link { articulation: arm, link } => {
            Some(trees[arm as usize].links[link as usize].world_from_link.rotation)
        }
    }
}

/// Notes what a contact did, and keeps its springs. Forces of the contact model are per `unit` of mass.
pub(crate) fn record<T: Scalar>(
    out: Option<&mut ContactForce<T>>,
    anchor: &mut Anchor<T>,
    contact_model: &ContactModel<T>,
    (u, spin): (&Vector3<T>, T),
    unit: T,
    rotation: Option<UnitQuaternion<T>>,
    dt: f64,
) {
    let reaction = contact_model.reaction(u, spin);
    let (stretch, twist) = contact_model.springs(&reaction, u, spin, dt);
    if let Some(out) = out {
        out.force = reaction.force * unit;
        out.torque = reaction.torque * unit;
        out.slips = reaction.mode == Mode::Slips;
        out.velocity = *u;
        out.stretch = stretch;
    }
    anchor.stretch = rotation.map_or(stretch, |r| r.inverse_transform_vector(&stretch));
    anchor.twist = twist;
}

/// The pose of a body after moving for `h` at constant velocities.
pub(crate) fn advanced<T: Scalar>(body: &Body<T>, pose: &Pose<T>, v: &Vector3<T>, w: &Vector3<T>, h: T) -> Pose<T> {
    let com = pose.translation.vector + pose.rotation * body.center_of_mass.coords + v * h;
    let rotation = renormalized(exp(&(w * h)) * pose.rotation);
    Pose::from_parts(Translation3::from(com - rotation * body.center_of_mass.coords), rotation)
}

/// The new angular velocity in the world: one Newton step on J (w' - w) + h w' x J w' = h tau in the body's frame,
/// that is w' = w - x with K x = h (w x J w - tau) and K = J + h ([w] J - [J w]).
fn spin<T: Scalar>(inertia: &Matrix3<T>, r: &Matrix3<T>, w: &Vector3<T>, moment: &Vector3<T>, dt: f64) -> Vector3<T> {
    let value = |v: &Vector3<T>| v.map(|x| x.value());
    let back = r.transpose();
    let (w, tau) = (apply(&back, w), apply(&back, moment));
    let momentum = apply(inertia, &w);
    let right = (w.cross(&momentum) - tau).map(|x| x.scaled(dt));
    let (j, w0) = (inertia.map(|x| x.value()), value(&w));
    let k = j + (cross_columns(&w0, &j) - skew(&value(&momentum))) * dt;
    let x = solve3(&k, &value(&right));
    let change = if T::TANGENTS == 0 {
        x.map(T::lift)
    } else {
        // Derivatives of the solution: K dx = d(right) - dK x.
        let jx = apply_constant(inertia, &x);
        let turned = w.cross(&jx) - momentum.cross(&x.map(T::lift));
        let kx = jx + turned.map(|y| y.scaled(dt));
        let inverse = k.try_inverse().unwrap_or_else(Matrix3::zeros);
        let left = right - kx;
        Vector3::from_fn(|row, _| {
            T::with_tangents(x[row], |i| (0..3).map(|c| inverse[(row, c)] * left[c].tangent(i)).sum())
        })
    };
    apply(r, &(w - change))
}

pub(crate) fn check_speeds<T: Scalar>(state: &State<T>) -> Result<()> {
    for (body, s) in state.bodies.iter().enumerate() {
        let speed = s.velocity.map(|x| x.value()).norm() + s.angular_velocity.map(|x| x.value()).norm();
        if speed.is_nan() || speed >= SPEED_LIMIT {
            return Err(Error::Diverged { body: format!("body {body}"), time_s: state.time_s, speed });
        }
    }
    for (arm, s) in state.articulations.iter().enumerate() {
        let speed =
            s.velocities.iter().map(|x| x.value().abs()).fold(0.0, |a: f64, b| if b.is_nan() { b } else { a.max(b) });
        if speed.is_nan() || speed >= SPEED_LIMIT {
            return Err(Error::Diverged { body: format!("articulation {arm}"), time_s: state.time_s, speed });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // a test may panic
    use std::sync::Arc;

    use drex_core::MassProperties;
    use nalgebra::Point3;

    use super::*;
    use crate::{Collider, Geom, Shape};

    #[test]
    fn two_bodies_share_the_reduced_mass_and_one_has_its_own() {
        let ball = Arc::new(Collider::new(&[Geom::new(Shape::Sphere { radius_m: 0.01 })]).unwrap());
        let unit =
            MassProperties { mass_kg: 1.0, center_of_mass: Point3::origin(), inertia: Matrix3::identity() * 4e-5 };
        let body = |mass_kg| Body::new(&unit, mass_kg, Arc::clone(&ball));
        let model = Model::<f64>::new(vec![body(2.0), body(6.0)]);
        let mass = |a, b| patch_mass(&model, a, b);
        assert_eq!(mass(Part::Body(0), Part::Body(1)), 1.5);
        assert_eq!([mass(Part::Body(1), Part::Static(0)), mass(Part::Kinematic(0), Part::Body(0))], [6.0, 2.0]);
    }

    #[test]
    fn speeds_along_and_about_add_up_to_the_limit() {
        let state = |speed: f64| {
            let mut state = State::<f64>::at_rest(Pose::identity());
            state.bodies[0].velocity.x = -speed;
            state.bodies[0].angular_velocity.z = speed;
            state
        };
        check_speeds(&state(0.4 * SPEED_LIMIT)).unwrap();
        let error = check_speeds(&state(0.6 * SPEED_LIMIT)).unwrap_err();
        assert!(matches!(error, Error::Diverged { speed, .. } if speed == 1.2 * SPEED_LIMIT), "{error}");
    }
}
