//! Penalty forces at the old state: the scheme of the D-REX paper and its ablation. Free bodies only.
//!
//! f = max(0, k depth + c rate) and a friction spring with return mapping, both from the old pose and velocity. The
//! semi-implicit scheme moves poses with the new velocities, the explicit one with the old. Substeps are as short as
//! the stiffness asks for. Where their number is given and too small, the step is refused: a body on springs that are
//! too stiff for the step does not fly off, it hops about without end, and nothing in its motion says that it is wrong.

use nalgebra::{Matrix3, Vector3};

use crate::contact::{Contact, ContactForce};
use crate::math::solve3;
use crate::solve::Mode;
use crate::solve::contact_model::ContactModel;
use crate::solve::prepare_patch;
use crate::state::Anchor;
use crate::step::frames::{advanced, begin, carried, check_speeds, kinematic_motion, patch_mass, record, rotation_of};
use crate::step::pairs;
use crate::{Error, Model, Part, Result, Scalar, Scene, Scheme, State, Workspace};

/// h √(K/m) and h D/m of a body on its patch stay below this where the substeps are chosen here; rocking is up to three
/// times as stiff.
const STABLE: f64 = 0.5;
/// More substeps than this are refused.
const MOST_SUBSTEPS: u32 = 10_000;
/// Power iterations per substep in the search for a mode that is not stable.
const ITERATIONS: usize = 6;

/// Buffers that a substep reuses.
#[derive(Debug)]
pub(crate) struct Buffers<T: Scalar> {
    /// Contact force and moment per body.
    acting: Vec<(Vector3<T>, Vector3<T>)>,
    /// Closed contacts on values, and a motion of all bodies before and after a power iteration.
    springs: Vec<Spring>,
    motion: [Vec<Twist>; 2],
}

type Twist = (Vector3<f64>, Vector3<f64>);

/// A closed contact as springs and dampers.
#[derive(Debug)]
struct Spring {
    parts: [Part; 2],
    point: Vector3<f64>,
    /// h² K + 2 h C (or 2 h C - h² K for the explicit scheme), N per m/s² of the contact.
    strength: Matrix3<f64>,
}

impl<T: Scalar> Default for Buffers<T> {
    fn default() -> Self {
        Self { acting: Vec::new(), springs: Vec::new(), motion: [Vec::new(), Vec::new()] }
    }
}

/// One step in `substeps`, or in as many as are stable.
///
/// # Errors
/// If a motion grows whatever its size ([`Error::Stiff`], [`Error::Undamped`]), or the motion diverges.
pub(crate) fn step<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
    scheme: Scheme,
    substeps: Option<u32>,
) -> Result<()> {
    let mut count = match substeps {
        Some(n) => n.max(1),
        None => stable_substeps(model, scheme)?,
    };
    if scheme == Scheme::Explicit {
        check_damping(model, model.dt_s / f64::from(count))?;
    }
    if substeps.is_some() {
        return run(model, scene, state, work, scheme, count);
    }
    // A body between several others is on more springs than one patch has.
    let before = state.clone();
    loop {
        match run(model, scene, state, work, scheme, count) {
            Err(Error::Stiff { .. }) if 2 * count <= MOST_SUBSTEPS => {
                count *= 2;
                state.clone_from(&before);
            }
            result => return result,
        }
    }
}

fn run<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
    scheme: Scheme,
    count: u32,
) -> Result<()> {
    let h = model.dt_s / f64::from(count);
    let start = state.time_s;
    let mut buffers = std::mem::take(&mut work.ablation.penalty);
    let mut result = Ok(());
    for k in 0..count {
        state.time_s = start + h * f64::from(k);
        result = substep(model, scene, state, work, &mut buffers, (scheme, h)).and_then(|()| check_speeds(state));
        if result.is_err() {
            break;
        }
    }
    work.ablation.penalty = buffers;
    state.time_s = start;
    result
}

/// An oscillator k, k τ grows under explicit Euler unless h < τ.
fn check_damping<T: Scalar>(model: &Model<T>, h: f64) -> Result<()> {
    let c = &model.contact;
    let tau = c.relaxation_s.value().min(c.tangential_relaxation_s.value());
    if tau <= 0.0 {
        return Err(Error::Undamped);
    }
    if !(h < tau) {
        return Err(Error::Stiff { dt_s: model.dt_s, substeps: (model.dt_s / tau).floor() + 1.0, limit_s: tau });
    }
    Ok(())
}

/// Number of substeps that keeps the scheme stable.
///
/// # Errors
/// If the contact is so stiff that more than 10 000 are needed.
fn stable_substeps<T: Scalar>(model: &Model<T>, scheme: Scheme) -> Result<u32> {
    let c = &model.contact;
    let (tau, tau_t) = (c.relaxation_s.value(), c.tangential_relaxation_s.value());
    let mut fastest = match scheme {
        Scheme::SemiImplicit => 0.0,
        Scheme::Explicit if tau.min(tau_t) > 0.0 => 1.0 / tau.min(tau_t),
        Scheme::Explicit => return Err(Error::Undamped),
    };
    for body in &model.bodies {
        let k = c.patch_stiffness(T::one(), body.mass_kg).value();
        let kt = k * c.tangential_ratio.value();
        fastest = fastest.max(k.sqrt()).max(kt.sqrt()).max(k * tau).max(kt * tau_t);
    }
    let count = (model.dt_s * fastest / STABLE).ceil().max(1.0);
    if !(count <= f64::from(MOST_SUBSTEPS)) {
        return Err(Error::Stiff { dt_s: model.dt_s, substeps: count, limit_s: STABLE / fastest });
    }
    Ok(count as u32)
}

fn substep<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    state: &mut State<T>,
    work: &mut Workspace<T>,
    buffers: &mut Buffers<T>,
    (scheme, dt): (Scheme, f64),
) -> Result<()> {
    let h = T::lift(dt);
    begin(model, scene, state, work, dt)?;
    pairs::find(model, scene, work, dt);
    work.contacts.retain(|c| c.depth.value() > 0.0);
    work.forces.clear();
    work.forces.extend(work.contacts.iter().map(ContactForce::of));
    work.anchors.clear();
    work.anchors.extend(work.contacts.iter().map(Anchor::slack));
    let Buffers { acting, springs, .. } = buffers;
    acting.clear();
    acting.resize(model.bodies.len(), (Vector3::zeros(), Vector3::zeros()));
    springs.clear();
    let mut from = 0;
    while from < work.contacts.len() {
        let key = work.contacts[from].key;
        let to = from + work.contacts[from..].partition_point(|c| (c.key.a, c.key.b) <= (key.a, key.b));
        work.models.clear();
        let stiffness = model.contact.patch_stiffness(patch_mass(model, key.a, key.b), T::one());
        let rotation = rotation_of(state, &work.trees, &work.motions, key.b);
        let patch = &work.contacts[from..to];
        prepare_patch(patch, stiffness, &model.contact, 0.0, &state.anchors, rotation.as_ref(), &mut work.models);
        for (k, contact_model) in work.models.iter().enumerate() {
            let c = &work.contacts[from + k];
            let (u, spin) = relative(state, work, c);
            record(
                work.forces.get_mut(from + k),
                &mut work.anchors[from + k],
                contact_model,
                (&u, spin),
                T::one(),
                rotation,
                dt,
            );
            springs.extend(Spring::of(c, contact_model, (&u, spin), scheme, dt));
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
    check_modes(model, work, springs, &mut buffers.motion, dt)?;
    std::mem::swap(&mut state.anchors, &mut work.anchors);
    let sums = buffers.acting.iter();
    for (((body, s), frame), (force, moment)) in model.bodies.iter().zip(&mut state.bodies).zip(&work.frames).zip(sums)
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
        _ => carried(kinematic_motion(&work.motions, part), c),
    };
    let ((va, wa), (vb, wb)) = (motion(c.key.a), motion(c.key.b));
    (va - vb, wa - wb)
}

impl Spring {
    /// The springs that act at the moment; `None` for a contact that carries nothing.
    fn of<T: Scalar>(
        c: &Contact<T>,
        contact_model: &ContactModel<T>,
        (u, spin): (&Vector3<T>, T),
        scheme: Scheme,
        h: f64,
    ) -> Option<Self> {
        let mode = contact_model.reaction(u, spin).mode;
        let k = contact_model.preload.value() / c.depth.value();
        let strength = |k: f64, damping: f64| match scheme {
            Scheme::SemiImplicit => h * h * k + 2.0 * h * damping,
            Scheme::Explicit => 2.0 * h * damping - h * h * k,
        };
        let n = c.normal.map(|x| x.value());
        let along = n * n.transpose();
        let mut total = along * strength(k, contact_model.kappa_n.value());
        match mode {
            Mode::Open => return None,
            Mode::Sticks => {
                total +=
                    (Matrix3::identity() - along) * strength(contact_model.k_t.value(), contact_model.kappa_t.value())
            }
            Mode::Slips => {}
        }
        Some(Self { parts: [c.key.a, c.key.b], point: c.point.map(|x| x.value()), strength: total })
    }
}

/// Refuses a step in which a motion of the bodies is certain to grow: one with φᵀ(h² K + 2 h C)φ > 4 φᵀMφ. Then
/// 4 M - h² K - 2 h C, the matrix polynomial of the scheme at z = -1, is not positive, so that it has a root z < -1.
/// The explicit scheme has - h² K instead. φ comes from a few power iterations.
fn check_modes<T: Scalar>(
    model: &Model<T>,
    work: &Workspace<T>,
    springs: &[Spring],
    [motion, pulled]: &mut [Vec<Twist>; 2],
    h: f64,
) -> Result<()> {
    if springs.is_empty() {
        return Ok(());
    }
    motion.clear();
    motion.extend(work.frames.iter().map(|frame| {
        // Any motion with a part of everything in it.
        let radius = frame.inertia.trace().value().sqrt();
        (Vector3::new(0.4, -0.5, 1.0), Vector3::new(1.0, 0.8, -0.3) / radius)
    }));
    let mut quotient = 0.0;
    for _ in 0..ITERATIONS {
        pulled.clear();
        pulled.resize(motion.len(), (Vector3::zeros(), Vector3::zeros()));
        let mut energy = 0.0;
        for spring in springs {
            let arm = |i: u32| spring.point - work.frames[i as usize].com.map(|x| x.value());
            let mut u = Vector3::zeros();
            for (part, sign) in spring.parts.iter().zip([1.0, -1.0]) {
                if let Part::Body(i) = *part {
                    let (v, w) = motion[i as usize];
                    u += (v + w.cross(&arm(i))) * sign;
                }
            }
            let f = spring.strength * u;
            energy += f.dot(&u);
            for (part, sign) in spring.parts.iter().zip([1.0, -1.0]) {
                if let Part::Body(i) = *part {
                    pulled[i as usize].0 += f * sign;
                    pulled[i as usize].1 += arm(i).cross(&f) * sign;
                }
            }
        }
        let mut inertial = 0.0;
        for (((v, w), (f, moment)), (body, frame)) in
            motion.iter_mut().zip(pulled.iter()).zip(model.bodies.iter().zip(&work.frames))
        {
            let (mass, inertia) = (body.mass_kg.value(), frame.inertia.map(|x| x.value()));
            inertial += mass * (v.norm_squared() + w.dot(&(inertia * *w)));
            (*v, *w) = (f / mass, solve3(&inertia, moment) / mass);
        }
        quotient = energy / inertial;
        let size = motion.iter().map(|(v, w)| v.norm_squared() + w.norm_squared()).sum::<f64>().sqrt();
        motion.iter_mut().for_each(|(v, w)| {
            *v /= size;
            *w /= size;
        });
    }
    if quotient > 4.0 {
        // What grows with h² asks for less than what is printed here; it is an upper bound of the step.
        let limit_s = h * 4.0 / quotient;
        return Err(Error::Stiff { dt_s: model.dt_s, substeps: (model.dt_s / limit_s).ceil(), limit_s });
    }
    Ok(())
}
