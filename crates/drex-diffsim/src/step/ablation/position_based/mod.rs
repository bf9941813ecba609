//! Position-based dynamics of rigid bodies (XPBD) after Müller, Macklin, Chentanez, Jeschke and Kim, "Detailed Rigid Body
//! Simulation with Extended Position Based Dynamics", SCA 2020. Free bodies only.
//!
//! A substep predicts poses from what is known without contact, moves bodies until their contacts are satisfied, one
//! contact after the other (Gauss-Seidel), and takes the new velocities from the way they went. What is our own:
//!
//! - A contact is not rigid but has the compliance 1/k, and damping over stiffness τ as Macklin, Müller and Chentanez
//!   (2016) put it into the constraint. Its multiplier is then the force of the contact model that the other methods use,
//!   f = k (depth + τ rate), with the depth of the pose at the end of the substep.
//! - Static friction pulls back to where the contact stuck, which the state keeps, and not to the start of the substep.
//!   Its multiplier is held at the Coulomb bound instead of dropped beyond it. Both keep a loaded block from creeping.
//! - A fixed number of sweeps starts from the force of the springs at the old pose, so that what rests stays exactly
//!   where it is. They alternate in direction, which favours no contact.
//!
//! Forces are per mass of their patch, so that a mass which cannot be seen leaves no trace.

mod row;

use nalgebra::Vector3;

use crate::collide::Touch;
use crate::contact::{Contact, ContactForce};
use crate::math::{exp, lift_rotation, renormalized};
use crate::solve::contact_model::ContactModel;
use crate::solve::prepare_patch;
use crate::state::Anchor;
use crate::step::ablation::log;
use crate::step::ablation::penalty::relative;
use crate::step::frames::{begin, check_speeds, patch_mass, rotation_of};
use crate::step::pairs;
use crate::{Model, Part, Result, Scalar, Scene, State, Workspace};
use row::{Against, Grip, Moving, Row, bounded, clamped, inverse, push, scaled, support};

/// Sweeps over all contacts per substep. For the same work more substeps are more exact than more sweeps.
const SWEEPS: usize = 8;

/// Buffers that a substep reuses.
#[derive(Debug)]
pub(crate) struct Buffers<T: Scalar> {
    features: Vec<Touch>,
    bodies: Vec<Moving<T>>,
    rows: Vec<Row<T>>,
}

impl<T: Scalar> Default for Buffers<T> {
    fn default() -> Self {
        Self { features: Vec::new(), bodies: Vec::new(), rows: Vec::new() }
    }
}

/// One step in `substeps`.
pub(crate) fn step<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
    substeps: u32,
) -> Result<()> {
    let count = substeps.max(1);
    let h = model.dt_s / f64::from(count);
    let start = state.time_s;
    let mut buffers = std::mem::take(&mut work.ablation.position);
    let mut result = Ok(());
    for k in 0..count {
        state.time_s = start + h * f64::from(k);
        result = substep(model, scene, state, work, &mut buffers, h).and_then(|()| check_speeds(state));
        if result.is_err() {
            break;
        }
    }
    work.ablation.position = buffers;
    state.time_s = start;
    result
}

fn substep<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
    buffers: &mut Buffers<T>,
    h: f64,
) -> Result<()> {
    begin(model, scene, state, work, h)?;
    pairs::find_features(model, scene, work, h, &mut buffers.features);
    let Buffers { features, bodies, rows } = buffers;
    bodies.clear();
    bodies.extend(model.bodies.iter().zip(&work.frames).zip(&state.bodies).map(|((body, frame), s)| Moving {
        com: frame.com,
        center: body.center_of_mass.coords,
        rotation: s.world_from_body.rotation,
        inverse: inverse(&frame.inertia),
        moved: scaled(&frame.free.0, h),
        turned: exp(&scaled(&frame.free.1, h)),
    }));
    prepare(model, scene, state, work, bodies, rows, h);

    for row in rows.iter_mut() {
        start(
            row,
            &work.contacts[row.index],
            &work.models[row.index],
            relative(state, work, &work.contacts[row.index]),
            h,
        );
        let (n, f) = (work.contacts[row.index].normal, row.across);
        push(bodies, row, &(n * row.normal + f), &(n * row.torque), h);
    }
    for sweep in 0..SWEEPS {
        for i in 0..rows.len() {
            let i = if sweep % 2 == 0 { i } else { rows.len() - 1 - i };
            let row = &mut rows[i];
            correct(row, &features[row.index], &work.contacts[row.index], &work.models[row.index], bodies, h);
        }
    }

    for (s, b) in state.bodies.iter_mut().zip(bodies.iter()) {
        s.velocity = scaled(&b.moved, 1.0 / h);
        s.angular_velocity = scaled(&log(&b.turned), 1.0 / h);
        let rotation = renormalized(b.turned * b.rotation);
        s.world_from_body.rotation = rotation;
        s.world_from_body.translation.vector = b.com + b.moved - rotation * b.center;
    }
    for row in rows.iter_mut().filter(|r| r.slips) {
        rub(row, &work.contacts[row.index], state, bodies, h);
    }
    read_out(model, state, work, bodies, rows, h);
    std::mem::swap(&mut state.anchors, &mut work.anchors);
    Ok(())
}

/// Contact models and rows of all contacts.
fn prepare<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &State<T>,
    work: &mut Workspace<T>,
    bodies: &[Moving<T>],
    rows: &mut Vec<Row<T>>,
    h: f64,
) {
    work.models.clear();
    rows.clear();
    let mut from = 0;
    while let Some(key) = work.contacts.get(from).map(|c| c.key) {
        let to = from + work.contacts[from..].partition_point(|c| (c.key.a, c.key.b) <= (key.a, key.b));
        let patch = &work.contacts[from..to];
        let mass = patch_mass(model, key.a, key.b);
        let rotation = rotation_of(state, &work.trees, &work.motions, key.b);
        let stiffness = model.contact.patch_stiffness(T::one(), mass);
        prepare_patch(patch, stiffness, &model.contact, h, &state.anchors, rotation.as_ref(), &mut work.models);
        let grip = |part: Part, other: Part, c: &Contact<T>| match part {
            Part::Body(i) => {
                let body = i as usize;
                // The mass of the patch is that of the body if the other side has none.
                let share = if matches!(other, Part::Body(_)) { mass / model.bodies[body].mass_kg } else { T::one() };
                Some(Grip { body, share, arm: c.point - bodies[body].com })
            }
            _ => None,
        };
        for (k, c) in patch.iter().enumerate() {
            let Some(a) = grip(key.a, key.b, c) else { continue };
            let b = grip(key.b, key.a, c).map_or_else(|| support(scene, work, state.time_s + h, c), Against::Body);
            let mut row = Row {
                index: from + k,
                a,
                b,
                normal_mobility: T::zero(),
                across_mobility: T::zero(),
                turn_mobility: T::zero(),
                normal: T::zero(),
                across: Vector3::zeros(),
                torque: T::zero(),
                slips: false,
                turns: false,
            };
            let mut add = |grip: &Grip<T>| {
                let inverse = &bodies[grip.body].inverse;
                let turning = |axis: &Vector3<T>| {
                    let moment = grip.arm.cross(axis);
                    moment.dot(&(inverse * moment))
                };
                let along = turning(&c.normal);
                let trace = (0..3).map(|k| turning(&Vector3::ith(k, T::one()))).fold(T::zero(), |s, x| s + x);
                row.normal_mobility += grip.share * (T::one() + along);
                row.across_mobility += grip.share * (T::one() + trace - along);
                row.turn_mobility += grip.share * c.normal.dot(&(inverse * c.normal));
            };
            add(&row.a);
            if let Against::Body(grip) = &row.b {
                add(grip);
            }
            rows.push(row);
        }
        from = to;
    }
}

/// The forces that the sweeps start from: those of the springs at the old pose, less what the damper takes from a contact
/// that opens.
fn start<T: Scalar>(row: &mut Row<T>, c: &Contact<T>, model: &ContactModel<T>, (u, _): (Vector3<T>, T), h: f64) {
    if c.depth.value() <= 0.0 {
        return;
    }
    let elastic = model.preload;
    let relaxation = model.kappa_n - (model.preload / c.depth).scaled(h);
    let damped = elastic - relaxation * u.dot(&c.normal);
    row.normal = if !(damped.value() > 0.0) {
        T::zero()
    } else if damped.value() < elastic.value() {
        damped
    } else {
        elastic
    };
    (row.across, _) = bounded(-(model.stretch * model.k_t), model.friction * row.normal);
    (row.torque, _) = clamped(-(model.twist * model.k_r), model.friction * row.normal.scaled(model.lever));
}

/// Moves both sides of a contact towards its contact model: first along the normal, then across it, then about it.
fn correct<T: Scalar>(
    row: &mut Row<T>,
    feature: &Touch,
    c: &Contact<T>,
    model: &ContactModel<T>,
    bodies: &mut [Moving<T>],
    h: f64,
) {
    let (zero, none) = (T::zero(), Vector3::zeros());
    let frame_b = match &row.b {
        Against::Body(grip) => bodies[grip.body].frame(),
        Against::Support { frame, .. } => *frame,
    };
    let depth = feature.evaluate(&bodies[row.a.body].frame(), &frame_b).depth;
    let wanted = model.preload + model.kappa_n * (depth - c.depth).scaled(1.0 / h);
    let mut normal = row.normal + (wanted - row.normal) / (T::one() + (model.kappa_n * row.normal_mobility).scaled(h));
    if !(normal.value() > 0.0) {
        // Nothing to take back from a contact that stays open.
        if row.normal.value() == 0.0 {
            return;
        }
        normal = zero;
    }
    push(bodies, row, &(c.normal * (normal - row.normal)), &none, h);
    row.normal = normal;

    let bound = model.friction * normal;
    let (way, turn) = row.way(bodies, c, model.lever > 0.0);
    let wanted = -(model.stretch * model.k_t + scaled(&way, 1.0 / h) * model.kappa_t);
    let gain = T::one() / (T::one() + (model.kappa_t * row.across_mobility).scaled(h));
    let (across, slips) = bounded(row.across + (wanted - row.across) * gain, bound);
    push(bodies, row, &(across - row.across), &none, h);
    (row.across, row.slips) = (across, slips);

    if model.lever > 0.0 {
        let wanted = -(model.twist * model.k_r + turn.scaled(1.0 / h) * model.kappa_r);
        let gain = T::one() / (T::one() + (model.kappa_r * row.turn_mobility).scaled(h));
        let (torque, turns) = clamped(row.torque + (wanted - row.torque) * gain, bound.scaled(model.lever));
        push(bodies, row, &none, &(c.normal * (torque - row.torque)), h);
        (row.torque, row.turns) = (torque, turns);
    }
}

/// Dynamic friction of a contact that slips: it is turned against the velocity that the contact has in the end. One that
/// already slips the other way is left alone: its spring lets go in the next substep, and a push that stopped it at once
/// would wind the spring up backwards.
fn rub<T: Scalar>(row: &mut Row<T>, c: &Contact<T>, state: &mut State<T>, bodies: &[Moving<T>], h: f64) {
    let velocity = row.velocity(state, h);
    let v = velocity - c.normal * velocity.dot(&c.normal);
    if !(row.across.dot(&v).value() < 0.0) {
        return;
    }
    let bound = row.across.norm();
    let (across, _) = bounded(row.across - scaled(&v, 1.0 / h) / row.across_mobility, bound);
    let change = scaled(&(across - row.across), h);
    let mut kick = |grip: &Grip<T>, sign: T| {
        let s = &mut state.bodies[grip.body];
        let share = grip.share * sign;
        s.velocity += change * share;
        s.angular_velocity += bodies[grip.body].inverse * grip.arm.cross(&change) * share;
    };
    kick(&row.a, T::one());
    if let Against::Body(grip) = &row.b {
        kick(grip, -T::one());
    }
    row.across = across;
}

/// Notes what the contacts did, and keeps their springs.
fn read_out<T: Scalar>(
    model: &Model<T>,
    state: &State<T>,
    work: &mut Workspace<T>,
    bodies: &[Moving<T>],
    rows: &[Row<T>],
    h: f64,
) {
    work.forces.clear();
    work.forces.extend(work.contacts.iter().map(ContactForce::of));
    work.anchors.clear();
    work.anchors.extend(work.contacts.iter().map(Anchor::slack));
    for row in rows {
        let (c, contact_model) = (&work.contacts[row.index], &work.models[row.index]);
        let (out, anchor) = (&mut work.forces[row.index], &mut work.anchors[row.index]);
        out.velocity = row.velocity(state, h);
        if !(row.normal.value() > 0.0) {
            continue;
        }
        let mass = patch_mass(model, c.key.a, c.key.b);
        out.force = (c.normal * row.normal + row.across) * mass;
        out.torque = row.torque * mass;
        out.slips = row.slips;
        let (way, turn) = row.way(bodies, c, contact_model.lever > 0.0);
        out.stretch =
            if row.slips { row.across * (-T::one() / contact_model.k_t) } else { contact_model.stretch + way };
        if contact_model.lever > 0.0 {
            anchor.twist = if row.turns { -row.torque / contact_model.k_r } else { contact_model.twist + turn };
        }
        // The frame of the support as it was when the stretch was brought into the world.
        anchor.stretch = match c.key.b {
            Part::Body(i) => bodies[i as usize].rotation.inverse_transform_vector(&out.stretch),
            Part::Kinematic(i) => {
                lift_rotation(&work.motions[i as usize].pose.rotation).inverse_transform_vector(&out.stretch)
            }
            Part::Static(_) | Part::Link { .. } => out.stretch,
        };
    }
}
