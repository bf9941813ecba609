//! Semi-implicit Euler with implicit contact: the default method.

use nalgebra::Vector3;

use super::frames::{advanced, begin, carried, kinematic_motion, patch_mass, record, rotation_of};
use super::{BodyFrame, Workspace, pairs};
use crate::articulation::{Column, JointForce, LinkForce};
use crate::contact::ContactForce;
use crate::math::lift_rotation;
use crate::solve::free::{self, Lever};
use crate::solve::island::Island;
use crate::solve::prepare_patch;
use crate::state::{Anchor, BodyState};
use crate::{Body, Model, Part, Result, Scalar, Scene, State};

/// One step.
pub(super) fn step<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
) -> Result<()> {
    let dt = model.dt_s;
    begin(model, scene, state, work, dt)?;
    pairs::find(model, scene, work, dt);
    group(model, work);
    work.anchors.clear();
    work.forces.clear();
    if !work.forgets_forces {
        work.forces.extend(work.contacts.iter().map(ContactForce::of));
    }
    work.anchors.extend(work.contacts.iter().map(Anchor::slack));
    for root in 0..work.islands.len() {
        if work.islands[root] != root {
            continue;
        }
        let alone = work.islands.iter().filter(|&&r| r == root).count() == 1;
        let solved = match root.checked_sub(model.articulations.len()) {
            Some(body) if alone => free_body(model, state, work, body, dt),
            _ => false,
        };
        if !solved {
            island(model, scene, state, work, root, dt)?;
        }
    }
    std::mem::swap(&mut state.anchors, &mut work.anchors);
    for (body, s) in model.bodies.iter().zip(&mut state.bodies) {
        s.world_from_body = advanced(body, &s.world_from_body, &s.velocity, &s.angular_velocity, T::lift(dt));
    }
    Ok(())
}

/// Units that touch, directly or through others, are one island.
fn group<T: Scalar>(model: &Model<T>, work: &mut Workspace<T>) {
    let arms = model.articulations.len();
    work.islands.clear();
    work.islands.extend(0..arms + model.bodies.len());
    for c in &work.contacts {
        if let (Some(a), Some(b)) = (unit_of(c.key.a, arms), unit_of(c.key.b, arms)) {
            let (a, b) = (work.islands[a], work.islands[b]);
            let (low, high) = (a.min(b), a.max(b));
            work.islands.iter_mut().filter(|r| **r == high).for_each(|r| *r = low);
        }
    }
}

/// A body that touches nothing that answers. False if the contact equations were not solved.
fn free_body<T: Scalar>(
    model: &Model<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
    index: usize,
    dt: f64,
) -> bool {
    let part = Part::Body(index as u32);
    let from = work.contacts.partition_point(|c| c.key.a < part);
    let to = from + work.contacts[from..].partition_point(|c| c.key.a == part);
    let (frame, body) = (&work.frames[index], &model.bodies[index]);
    let s = &mut state.bodies[index];
    if from == to {
        (s.velocity, s.angular_velocity) = frame.free;
        return true;
    }
    work.models.clear();
    work.levers.clear();
    let stiffness = model.contact.patch_stiffness(T::one(), body.mass_kg);
    for patch in work.contacts[from..to].chunk_by(|x, y| x.key.b == y.key.b) {
        let motion = kinematic_motion(&work.motions, patch[0].key.b);
        let rotation = motion.map(|m| lift_rotation(&m.pose.rotation));
        prepare_patch(patch, stiffness, &model.contact, dt, &state.anchors, rotation.as_ref(), &mut work.models);
        work.levers.extend(patch.iter().map(|c| {
            let (support, support_spin) = carried(motion, c);
            Lever { arm: c.point - frame.com, support, support_spin }
        }));
    }
    if let Some(soft) = &model.contact.soft {
        for ((contact_model, lever), contact) in work.models.iter_mut().zip(&work.levers).zip(&work.contacts[from..to])
        {
            let (u, _) = lever.relative(contact_model, &s.velocity, &s.angular_velocity);
            contact_model.soften(soft, contact, u, T::one(), dt);
        }
    }
    let guess = (&s.velocity, &s.angular_velocity);
    let Some((v, w)) =
        free::solve(&work.models, &work.levers, dt, &frame.inertia, frame.free, guess, &mut work.buffers)
    else {
        return false;
    };
    (s.velocity, s.angular_velocity) = (v, w);
    for (k, (contact_model, lever)) in work.models.iter().zip(&work.levers).enumerate() {
        let (u, spin) = lever.relative(contact_model, &v, &w);
        let rotation =
            kinematic_motion(&work.motions, work.contacts[from + k].key.b).map(|m| lift_rotation(&m.pose.rotation));
        record(
            work.forces.get_mut(from + k),
            &mut work.anchors[from + k],
            contact_model,
            (&u, spin),
            body.mass_kg,
            rotation,
            dt,
        );
    }
    true
}

/// Bodies and articulations that touch each other.
fn island<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
    root: usize,
    dt: f64,
) -> Result<()> {
    let arms = model.articulations.len();
    work.island.clear();
    work.offsets.clear();
    work.offsets.resize(work.islands.len(), usize::MAX);
    let units: Vec<usize> = (0..work.islands.len()).filter(|&u| work.islands[u] == root).collect();
    let mut n = 0;
    for &unit in &units {
        work.offsets[unit] = n;
        n += if unit < arms { model.articulations[unit].dof() } else { 6 };
    }
    work.island.n = n;
    work.island.mass.resize(n * n, T::zero());
    for &unit in &units {
        match unit.checked_sub(arms) {
            Some(body) => add_body(
                &model.bodies[body],
                &work.frames[body],
                &state.bodies[body],
                &mut work.island,
                work.offsets[unit],
            ),
            None => add_arm(model, scene, state, work, unit, dt)?,
        }
    }
    let mut from = 0;
    while from < work.contacts.len() {
        let (a, b) = (work.contacts[from].key.a, work.contacts[from].key.b);
        let to = from + work.contacts[from..].partition_point(|c| (c.key.a, c.key.b) <= (a, b));
        let unit = unit_of(a, arms).or_else(|| unit_of(b, arms));
        if unit.is_some_and(|u| work.islands[u] == root) {
            add_patch(model, state, work, from..to, dt);
        }
        from = to;
    }
    work.solver.solve(&work.island, dt);
    work.unconverged += usize::from(!work.solver.converged);

    let u = &work.solver.velocities;
    let mut k = 0;
    for (index, c) in work.contacts.iter().enumerate() {
        let unit = unit_of(c.key.a, arms).or_else(|| unit_of(c.key.b, arms));
        if unit.is_some_and(|u| work.islands[u] == root) {
            let (v, spin) = work.island.relative(k, u);
            let rotation = rotation_of(state, &work.trees, &work.motions, c.key.b);
            let contact_model = &work.island.models[k];
            record(
                work.forces.get_mut(index),
                &mut work.anchors[index],
                contact_model,
                (&v, spin),
                T::one(),
                rotation,
                dt,
            );
            k += 1;
        }
    }
    for &unit in &units {
        let o = work.offsets[unit];
        match unit.checked_sub(arms) {
            Some(body) => {
                state.bodies[body].velocity = Vector3::new(u[o], u[o + 1], u[o + 2]);
                state.bodies[body].angular_velocity = Vector3::new(u[o + 3], u[o + 4], u[o + 5]);
            }
            None => {
                let arm = &model.articulations[unit];
                let (forces, tree) = (&work.joint_forces[unit], &mut work.trees[unit]);
                arm.advance(&mut state.articulations[unit], &u[o..o + arm.dof()], (state.time_s, dt), forces, tree);
            }
        }
    }
    Ok(())
}

fn add_body<T: Scalar>(body: &Body<T>, frame: &BodyFrame<T>, s: &BodyState<T>, island: &mut Island<T>, o: usize) {
    let n = island.n;
    for i in 0..3 {
        island.mass[(o + i) * n + o + i] = body.mass_kg;
        for j in 0..3 {
            island.mass[(o + 3 + i) * n + o + 3 + j] = frame.inertia[(i, j)] * body.mass_kg;
        }
    }
    let (v, w) = &frame.free;
    island.reference.extend(v.iter().chain(w.iter()));
    island.impulse.extend([T::zero(); 6]);
    island.start.extend(s.velocity.iter().chain(s.angular_velocity.iter()));
}

fn add_arm<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &State<T>,
    work: &mut Workspace<T>,
    index: usize,
    dt: f64,
) -> Result<()> {
    let (arm, s, tree) = (&model.articulations[index], &state.articulations[index], &mut work.trees[index]);
    let (o, n, dof) = (work.offsets[index], work.island.n, arm.dof());
    let island = &mut work.island;
    work.mass.clear();
    work.mass.resize(dof * dof, T::zero());
    arm.mass_matrix(tree, &mut work.mass);
    for (i, row) in work.mass.chunks_exact(dof).enumerate() {
        island.mass[(o + i) * n + o..(o + i) * n + o + dof].copy_from_slice(row);
    }
    work.external.clear();
    for force in &scene.forces {
        if let Part::Link { articulation: arm, link } = force.on
            && arm as usize == index
        {
            let (link, t) = (link as usize, state.time_s);
            let f = force.mean(t, dt).map(T::lift) * force.gain;
            let pose = tree.links[link].world_from_link;
            let (point, force, moment) = match force.world_point(t + 0.5 * dt, &pose) {
                Some(point) => (point, f, Vector3::zeros()),
                None => (pose.translation.vector, Vector3::zeros(), f),
            };
            work.external.push(LinkForce { link, point, force, moment });
        }
    }
    work.bias.clear();
    work.bias.resize(dof, T::zero());
    arm.step_bias(tree, &scene.gravity, &work.external, (&work.mass, dt), &mut work.bias);
    let h = T::lift(dt);
    island.impulse.extend(work.bias.iter().map(|b| -*b * h));
    let start = island.reference.len();
    arm.velocity(s, &mut island.reference);
    island.start.extend_from_slice(&island.reference[start..]);
    let control = scene.controls.get(index).map_or(&[][..], |c| c.at(state.time_s));
    arm.check_control(control)?;
    let forces = &mut work.joint_forces[index];
    arm.joint_forces(s, tree, control, dt, forces);
    island.scalars.extend(forces.iter().map(|f| JointForce { dof: f.dof + o, ..*f }));
    Ok(())
}

/// The contacts of one pair of parts.
fn add_patch<T: Scalar>(
    model: &Model<T>,
    state: &State<T>,
    work: &mut Workspace<T>,
    range: std::ops::Range<usize>,
    dt: f64,
) {
    let patch = &work.contacts[range];
    let Some(key) = patch.first().map(|c| c.key) else { return };
    let island = &mut work.island;
    let stiffness = model.contact.patch_stiffness(patch_mass(model, key.a, key.b), T::one());
    let rotation = rotation_of(state, &work.trees, &work.motions, key.b);
    prepare_patch(patch, stiffness, &model.contact, dt, &state.anchors, rotation.as_ref(), &mut island.models);
    let motion = kinematic_motion(&work.motions, key.b);
    for c in patch {
        let (mut support, mut spin) = carried(motion, c);
        for (part, sign) in [(key.a, T::one()), (key.b, -T::one())] {
            let first = island.columns.len();
            let mut offset = 0;
            match part {
                Part::Body(i) => {
                    offset = work.offsets[model.articulations.len() + i as usize];
                    let arm = c.point - work.frames[i as usize].com;
                    for dof in 0..3 {
                        let axis = Vector3::ith(dof, T::one());
                        island.columns.push(Column { dof, linear: axis, angular: Vector3::zeros() });
                    }
                    for dof in 0..3 {
                        let axis = Vector3::ith(dof, T::one());
                        island.columns.push(Column { dof: 3 + dof, linear: axis.cross(&arm), angular: axis });
                    }
                }
                Part::Link { articulation: arm, link } => {
                    let (arm, link) = (arm as usize, link as usize);
                    offset = work.offsets[arm];
                    model.articulations[arm].columns(&work.trees[arm], link, &c.point, &mut island.columns);
                    let (v, w) = model.articulations[arm].prescribed_velocity(&work.trees[arm], &c.point);
                    support -= v * sign;
                    spin -= w.dot(&c.normal) * sign;
                }
                Part::Static(_) | Part::Kinematic(_) => {}
            }
            for column in &mut island.columns[first..] {
                column.dof += offset;
                column.linear *= sign;
                column.angular *= sign;
            }
        }
        island.supports.push((support, spin));
        island.ends.push(island.columns.len());
    }
    if let Some(soft) = &model.contact.soft {
        let mass = patch_mass(model, key.a, key.b);
        let first = island.models.len() - patch.len();
        for (k, contact) in patch.iter().enumerate() {
            let (u, _) = island.relative(first + k, &island.start);
            island.models[first + k].soften(soft, contact, u, mass, dt);
        }
    }
}

fn unit_of(part: Part, arms: usize) -> Option<usize> {
    match part {
        Part::Link { articulation: arm, .. } => Some(arm as usize),
        Part::Body(i) => Some(arms + i as usize),
        Part::Static(_) | Part::Kinematic(_) => None,
    }
}
