//! Penalty forces at the old state: the scheme of the D-REX paper and its ablation. Free bodies only.
//!
//! f = max(0, k depth + c rate) and a friction spring with return mapping, both from the old pose and velocity. The
//! semi-implicit scheme moves poses with the new velocities, the explicit one with the old. Substeps are as short as
//! the stiffness asks for.

use nalgebra::Vector3;

use crate::contact::{Contact, ContactForce};
use crate::math::solve3;
use crate::sim::{advanced, begin, carried, mover, record, rotation_of};
use crate::solve::prepare_patch;
use crate::state::Anchor;
use crate::{Model, Part, Result, Scalar, Scene, Scheme, SimError, State, Workspace, pairs};

/// h √(K/m) and h D/m stay below this: explicit Euler with critical damping is stable up to 2, and the rotation of a
/// body on the edge of a patch is up to three times as stiff as its translation.
const STABLE: f64 = 0.5;
/// More substeps than this are refused.
const MOST_SUBSTEPS: u32 = 10_000;

/// One step in `substeps`, or in as many as are stable.
pub(crate) fn step<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
    scheme: Scheme,
    substeps: Option<u32>,
) -> Result<()> {
    let count = match substeps {
        Some(n) => n.max(1),
        None => stable_substeps(model)?,
    };
    let h = model.dt_s / f64::from(count);
    let start = state.time_s;
    for k in 0..count {
        state.time_s = start + h * f64::from(k);
        substep(model, scene, state, work, scheme, h)?;
        crate::sim::check_speeds(state)?;
    }
    state.time_s = start;
    Ok(())
}

/// Number of substeps that keeps the scheme stable.
///
/// # Errors
/// If the contact is so stiff that more than 10 000 are needed.
fn stable_substeps<T: Scalar>(model: &Model<T>) -> Result<u32> {
    let c = &model.contact;
    let mut fastest = 0.0_f64;
    for body in &model.bodies {
        let k = c.patch_stiffness(T::one(), body.mass_kg).value();
        let (kt, tau_t) = (k * c.tangential_ratio.value(), c.tangential_relaxation_s.value());
        fastest = fastest.max(k.sqrt()).max(kt.sqrt()).max(k * c.relaxation_s.value()).max(kt * tau_t);
    }
    let count = (model.dt_s * fastest / STABLE).ceil().max(1.0);
    if count > f64::from(MOST_SUBSTEPS) {
        return Err(SimError::Stiff { dt_s: model.dt_s, substeps: count, limit_s: STABLE / fastest });
    }
    Ok(count as u32)
}

fn substep<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
    scheme: Scheme,
    dt: f64,
) -> Result<()> {
    let h = T::lift(dt);
    begin(model, scene, state, work, dt)?;
    pairs::find(model, scene, state, work, dt);
    work.contacts.retain(|c| c.depth.value() > 0.0);
    work.forces.clear();
    work.forces.extend(work.contacts.iter().map(ContactForce::of));
    work.anchors.clear();
    work.anchors.extend(work.contacts.iter().map(Anchor::slack));
    // Force and moment per body.
    let mut acting: Vec<(Vector3<T>, Vector3<T>)> = vec![(Vector3::zeros(), Vector3::zeros()); model.bodies.len()];
    let mut from = 0;
    while from < work.contacts.len() {
        let key = work.contacts[from].key;
        let to = from + work.contacts[from..].partition_point(|c| (c.key.a, c.key.b) <= (key.a, key.b));
        work.laws.clear();
        let stiffness = model.contact.patch_stiffness(crate::sim::patch_mass(model, key.a, key.b), T::one());
        let rotation = rotation_of(state, &work.trees, &work.movers, key.b);
        let patch = &work.contacts[from..to];
        prepare_patch(patch, stiffness, &model.contact, 0.0, &state.anchors, rotation.as_ref(), &mut work.laws);
        for (k, law) in work.laws.iter().enumerate() {
            let c = &work.contacts[from + k];
            let (u, spin) = relative(state, work, c);
            record(&mut work.forces[from + k], &mut work.anchors[from + k], law, (&u, spin), T::one(), rotation, dt);
            let (force, torque) = (work.forces[from + k].force, c.normal * work.forces[from + k].torque);
            for (part, sign) in [(key.a, T::one()), (key.b, -T::one())] {
                if let Part::Body(i) = part {
                    let arm = c.point - work.frames[i as usize].com;
                    acting[i as usize].0 += force * sign;
                    acting[i as usize].1 += (arm.cross(&force) + torque) * sign;
                }
            }
        }
        from = to;
    }
    std::mem::swap(&mut state.anchors, &mut work.anchors);
    for (((body, s), frame), (force, moment)) in model.bodies.iter().zip(&mut state.bodies).zip(&work.frames).zip(&acting)
    {
        let (v0, w0) = (s.velocity, s.angular_velocity);
        let unit = h / body.mass_kg;
        s.velocity = frame.free.0 + force * unit;
        s.angular_velocity = frame.free.1 + solve3(&frame.inertia, moment) * unit;
        let (v, w) = match scheme {
            Scheme::SemiImplicit => (s.velocity, s.angular_velocity),
            Scheme::Explicit => (v0, w0),
        };
        s.world_from_body = advanced(body, &s.world_from_body, &v, &w, h);
    }
    Ok(())
}

/// Velocity and spin about the normal of a contact, at the old velocities.
pub(crate) fn relative<T: Scalar>(state: &State<T>, work: &Workspace<T>, c: &Contact<T>) -> (Vector3<T>, T) {
    let motion = |part: Part| match part {
        Part::Body(i) => {
            let (s, frame) = (&state.bodies[i as usize], &work.frames[i as usize]);
            let w = s.angular_velocity;
            (s.velocity + w.cross(&(c.point - frame.com)), w.dot(&c.normal))
        }
        _ => carried(mover(&work.movers, part), c),
    };
    let ((va, wa), (vb, wb)) = (motion(c.key.a), motion(c.key.b));
    (va - vb, wa - wb)
}
