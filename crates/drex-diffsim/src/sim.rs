//! Stepping in time.

use drex_core::Pose;
use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};

#[cfg(feature = "ablation")]
use crate::ablation::{penalty, position_based};
use crate::articulation::{Column, LinkForce, ScalarLaw, TreeWork};
use crate::collide::{CollideWork, Frame, Touch};
use crate::contact::{Contact, ContactForce};
use crate::math::{apply, apply_constant, congruent, cross_columns, exp, lift_rotation, renormalized, skew, solve3};
use crate::pairs;
use crate::solve::free::{self, Lever};
use crate::solve::island::{Island, Solver};
use crate::solve::law::{Law, Mode};
use crate::solve::prepare_patch;
use crate::state::{Anchor, BodyState};
use crate::{Body, Method, Model, Motion, Part, Result, Scalar, Scene, SimError, State};

/// Speed beyond which a rollout is called diverged, m/s or rad/s.
const SPEED_LIMIT: f64 = 1e4;

/// Buffers that a step reuses, and what the last step did. Nothing in it influences the next step.
#[derive(Debug)]
pub struct Workspace<T: Scalar> {
    pub(crate) frames: Vec<BodyFrame<T>>,
    pub(crate) trees: Vec<TreeWork<T>>,
    /// Poses of movers at the start of the step.
    pub(crate) movers: Vec<crate::Motion>,
    pub(crate) collide: CollideWork,
    pub(crate) touches: Vec<Touch>,
    pub(crate) contacts: Vec<Contact<T>>,
    pub(crate) forces: Vec<ContactForce<T>>,
    pub(crate) anchors: Vec<Anchor<T>>,
    /// Island of each unit (articulations, then bodies): index of the first unit in it.
    islands: Vec<usize>,
    pub(crate) laws: Vec<Law<T>>,
    levers: Vec<Lever<T>>,
    buffers: free::Buffers,
    island: Island<T>,
    solver: Solver<T>,
    mass: Vec<T>,
    bias: Vec<T>,
    external: Vec<LinkForce<T>>,
    /// Laws of the joints, per articulation.
    joint_laws: Vec<Vec<ScalarLaw<T>>>,
    /// First velocity of each unit in its island.
    offsets: Vec<usize>,
    #[cfg(feature = "ablation")]
    pub(crate) ablation: crate::ablation::Buffers<T>,
    unconverged: usize,
}

impl<T: Scalar> Default for Workspace<T> {
    fn default() -> Self {
        Self {
            frames: Vec::new(),
            trees: Vec::new(),
            movers: Vec::new(),
            collide: CollideWork::default(),
            touches: Vec::new(),
            contacts: Vec::new(),
            forces: Vec::new(),
            anchors: Vec::new(),
            islands: Vec::new(),
            laws: Vec::new(),
            levers: Vec::new(),
            buffers: free::Buffers::default(),
            island: Island::default(),
            solver: Solver::default(),
            mass: Vec::new(),
            bias: Vec::new(),
            external: Vec::new(),
            joint_laws: Vec::new(),
            offsets: Vec::new(),
            #[cfg(feature = "ablation")]
            ablation: crate::ablation::Buffers::default(),
            unconverged: 0,
        }
    }
}

impl<T: Scalar> Workspace<T> {
    /// Contacts of the last step that carry something: where, between what, and with which force.
    pub fn contacts(&self) -> impl Iterator<Item = &ContactForce<T>> {
        self.forces.iter().filter(|c| c.force.iter().any(|f| f.value() != 0.0))
    }

    /// Steps so far in which the contact equations were not solved to full precision.
    pub fn unconverged_steps(&self) -> usize {
        self.unconverged
    }
}

/// A free body at the start of a step.
#[derive(Debug, Clone)]
pub(crate) struct BodyFrame<T: Scalar> {
    /// Pose of the body's frame, and the same without derivatives.
    pub frame: Frame<T>,
    pub plain: Frame<f64>,
    /// Centre of mass, world.
    pub com: Vector3<T>,
    /// Inertia per unit mass about it, world.
    pub inertia: Matrix3<T>,
    /// Velocities at the end of the step if nothing touches.
    pub free: (Vector3<T>, Vector3<T>),
    /// How fast a point of it can move, m/s.
    pub speed: f64,
}

/// One step.
///
/// Semi-implicit Euler: forces at the old pose, new velocities, and with these the new pose. Contact forces, friction,
/// actuators and joint damping are found together with the velocities they lead to (implicit in the velocity). The
/// gyroscopic moment is taken at the new angular velocity (one Newton step in the body's frame), orientation moves by
/// the exponential map.
///
/// # Errors
/// If the state does not fit the model or is not finite, the time step is out of range, a control does not fit its
/// articulation, or the motion diverges. Masses, constants and scene are checked by [`crate::rollout`] alone, or by
/// [`Model::check`].
pub fn step<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
) -> Result<()> {
    model.check_step()?;
    state.check(model)?;
    match model.method {
        Method::SemiImplicit => semi_implicit(model, scene, state, work)?,
        #[cfg(feature = "ablation")]
        Method::Penalty { scheme, substeps } => penalty::step(model, scene, state, work, scheme, substeps)?,
        #[cfg(feature = "ablation")]
        Method::PositionBased { substeps } => position_based::step(model, scene, state, work, substeps)?,
    }
    state.time_s += model.dt_s;
    check_speeds(state)
}

fn semi_implicit<T: Scalar>(
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
    work.forces.extend(work.contacts.iter().map(ContactForce::of));
    work.anchors.extend(work.contacts.iter().map(Anchor::slack));
    for root in 0..work.islands.len() {
        if work.islands[root] != root {
            continue;
        }
        let alone = work.islands.iter().filter(|&&r| r == root).count() == 1;
        let solved = match root.checked_sub(model.arms.len()) {
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
    work.movers.clear();
    work.movers.extend(scene.movers.iter().map(|m| m.path.at(t)));
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
    work.trees.resize_with(model.arms.len(), TreeWork::default);
    work.joint_laws.resize_with(model.arms.len(), Vec::new);
    for ((arm, s), tree) in model.arms.iter().zip(&state.arms).zip(&mut work.trees) {
        arm.kinematics(s, t, dt, tree);
    }
    Ok(())
}

/// Units that touch, directly or through others, are one island.
fn group<T: Scalar>(model: &Model<T>, work: &mut Workspace<T>) {
    let arms = model.arms.len();
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
    work.laws.clear();
    work.levers.clear();
    let stiffness = model.contact.patch_stiffness(T::one(), body.mass_kg);
    for patch in work.contacts[from..to].chunk_by(|x, y| x.key.b == y.key.b) {
        let motion = mover(&work.movers, patch[0].key.b);
        let rotation = motion.map(|m| lift_rotation(&m.pose.rotation));
        prepare_patch(patch, stiffness, &model.contact, dt, &state.anchors, rotation.as_ref(), &mut work.laws);
        work.levers.extend(patch.iter().map(|c| {
            let (support, support_spin) = carried(motion, c);
            Lever { arm: c.point - frame.com, support, support_spin }
        }));
    }
    if let Some(soft) = &model.contact.soft {
        for ((law, lever), contact) in work.laws.iter_mut().zip(&work.levers).zip(&work.contacts[from..to]) {
            let (u, _) = lever.relative(law, &s.velocity, &s.angular_velocity);
            law.soften(soft, contact, u, T::one(), dt);
        }
    }
    let guess = (&s.velocity, &s.angular_velocity);
    let Some((v, w)) = free::solve(&work.laws, &work.levers, dt, &frame.inertia, frame.free, guess, &mut work.buffers)
    else {
        return false;
    };
    (s.velocity, s.angular_velocity) = (v, w);
    for (k, (law, lever)) in work.laws.iter().zip(&work.levers).enumerate() {
        let (u, spin) = lever.relative(law, &v, &w);
        let rotation = mover(&work.movers, work.contacts[from + k].key.b).map(|m| lift_rotation(&m.pose.rotation));
        record(&mut work.forces[from + k], &mut work.anchors[from + k], law, (&u, spin), body.mass_kg, rotation, dt);
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
    let arms = model.arms.len();
    work.island.clear();
    work.offsets.clear();
    work.offsets.resize(work.islands.len(), usize::MAX);
    let units: Vec<usize> = (0..work.islands.len()).filter(|&u| work.islands[u] == root).collect();
    let mut n = 0;
    for &unit in &units {
        work.offsets[unit] = n;
        n += if unit < arms { model.arms[unit].dof() } else { 6 };
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
            let rotation = rotation_of(state, &work.trees, &work.movers, c.key.b);
            let law = &work.island.laws[k];
            record(&mut work.forces[index], &mut work.anchors[index], law, (&v, spin), T::one(), rotation, dt);
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
                let arm = &model.arms[unit];
                let (laws, tree) = (&work.joint_laws[unit], &mut work.trees[unit]);
                arm.advance(&mut state.arms[unit], &u[o..o + arm.dof()], (state.time_s, dt), laws, tree);
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
    let (arm, s, tree) = (&model.arms[index], &state.arms[index], &mut work.trees[index]);
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
        if let Part::Link { arm, link } = force.on
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
    let laws = &mut work.joint_laws[index];
    arm.joint_laws(s, tree, control, dt, laws);
    island.scalars.extend(laws.iter().map(|law| ScalarLaw { dof: law.dof + o, ..*law }));
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
    let rotation = rotation_of(state, &work.trees, &work.movers, key.b);
    prepare_patch(patch, stiffness, &model.contact, dt, &state.anchors, rotation.as_ref(), &mut island.laws);
    let motion = mover(&work.movers, key.b);
    for c in patch {
        let (mut support, mut spin) = carried(motion, c);
        for (part, sign) in [(key.a, T::one()), (key.b, -T::one())] {
            let first = island.columns.len();
            let mut offset = 0;
            match part {
                Part::Body(i) => {
                    offset = work.offsets[model.arms.len() + i as usize];
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
                Part::Link { arm, link } => {
                    let (arm, link) = (arm as usize, link as usize);
                    offset = work.offsets[arm];
                    model.arms[arm].columns(&work.trees[arm], link, &c.point, &mut island.columns);
                    let (v, w) = model.arms[arm].prescribed_velocity(&work.trees[arm], &c.point);
                    support -= v * sign;
                    spin -= w.dot(&c.normal) * sign;
                }
                Part::Fixed(_) | Part::Mover(_) => {}
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
        let first = island.laws.len() - patch.len();
        for (k, contact) in patch.iter().enumerate() {
            let (u, _) = island.relative(first + k, &island.start);
            island.laws[first + k].soften(soft, contact, u, mass, dt);
        }
    }
}

/// The mass that a patch between two parts carries.
pub(crate) fn patch_mass<T: Scalar>(model: &Model<T>, a: Part, b: Part) -> T {
    let body = |part: Part| match part {
        Part::Body(i) => Some(model.bodies[i as usize].mass_kg),
        _ => None,
    };
    let link = |part: Part| match part {
        Part::Link { arm, link } => Some(model.arms[arm as usize].contact_mass(link as usize)),
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

pub(crate) fn mover(movers: &[Motion], part: Part) -> Option<&Motion> {
    match part {
        Part::Mover(i) => movers.get(i as usize),
        _ => None,
    }
}

fn unit_of(part: Part, arms: usize) -> Option<usize> {
    match part {
        Part::Link { arm, .. } => Some(arm as usize),
        Part::Body(i) => Some(arms + i as usize),
        Part::Fixed(_) | Part::Mover(_) => None,
    }
}

/// Rotation of a part's frame at the start of the step; `None` for what is fixed.
pub(crate) fn rotation_of<T: Scalar>(
    state: &State<T>,
    trees: &[TreeWork<T>],
    movers: &[Motion],
    part: Part,
) -> Option<UnitQuaternion<T>> {
    match part {
        Part::Fixed(_) => None,
        Part::Mover(i) => movers.get(i as usize).map(|m| lift_rotation(&m.pose.rotation)),
        Part::Body(i) => Some(state.bodies[i as usize].world_from_body.rotation),
        Part::Link { arm, link } => Some(trees[arm as usize].links[link as usize].world_from_link.rotation),
    }
}

/// Notes what a contact did, and keeps its springs. Forces of the law are per `unit` of mass.
pub(crate) fn record<T: Scalar>(
    out: &mut ContactForce<T>,
    anchor: &mut Anchor<T>,
    law: &Law<T>,
    (u, spin): (&Vector3<T>, T),
    unit: T,
    rotation: Option<UnitQuaternion<T>>,
    dt: f64,
) {
    let reaction = law.reaction(u, spin);
    let (stretch, twist) = law.springs(&reaction, u, spin, dt);
    out.force = reaction.force * unit;
    out.torque = reaction.torque * unit;
    out.slips = reaction.mode == Mode::Slips;
    out.velocity = *u;
    out.stretch = stretch;
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
            return Err(SimError::Diverged { body: format!("body {body}"), time_s: state.time_s, speed });
        }
    }
    for (arm, s) in state.arms.iter().enumerate() {
        let speed =
            s.velocities.iter().map(|x| x.value().abs()).fold(0.0, |a: f64, b| if b.is_nan() { b } else { a.max(b) });
        if speed.is_nan() || speed >= SPEED_LIMIT {
            return Err(SimError::Diverged { body: format!("articulation {arm}"), time_s: state.time_s, speed });
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
        assert_eq!([mass(Part::Body(1), Part::Fixed(0)), mass(Part::Mover(0), Part::Body(0))], [6.0, 2.0]);
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
        assert!(matches!(error, SimError::Diverged { speed, .. } if speed == 1.2 * SPEED_LIMIT), "{error}");
    }
}
