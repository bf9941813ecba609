//! Where a body touches its surroundings, and the forces there, per unit mass of the body.
//!
//! Normal: k depth + c rate, never pulling. Friction: a spring per contact that sticks, returned to the Coulomb cone
//! when it slips (elastic predictor, return mapping), so that a loaded contact below the cone does not creep.
//! The stiffness of one site is shared with the sites that carry load beside it, weighed by how evenly they carry
//! (participation ratio), so the total does not grow with the number of points.

use drex_core::Pose;
use nalgebra::{Matrix3, Point3, Vector3};

use crate::model::{Anchor, Body, BodyState, ContactOptions};
use crate::{Scalar, Scene};

/// Number of sites that carry a flat face at full stiffness: the corners of a box face.
const FACE_SITES: f64 = 4.0;

/// Touching vertices nearer to one another than this part of the piece's radius stand for one place.
const NEAR: f64 = 0.4;

/// A closed contact.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Contact<T: Scalar> {
    site: u32,
    /// From the centre of mass to the contact, world.
    arm: Vector3<T>,
    /// Out of the support.
    normal: Vector3<T>,
    depth: T,
    friction: T,
    /// Velocity of the support there.
    support_velocity: Vector3<f64>,
}

/// Real parts of a pose, for the search; only what is found is computed with derivatives.
struct Frame {
    r: Matrix3<f64>,
    p: Vector3<f64>,
}

impl Frame {
    fn of<T: Scalar>(pose: &Pose<T>) -> Self {
        let q = nalgebra::UnitQuaternion::new_unchecked(pose.rotation.quaternion().map_value());
        Self { r: q.to_rotation_matrix().into_inner(), p: pose.translation.vector.map(|x| x.value()) }
    }
    fn map(&self, v: &Point3<f64>) -> Vector3<f64> {
        self.r * v.coords + self.p
    }
}

/// Value parts of a quaternion.
trait MapValue {
    fn map_value(&self) -> nalgebra::Quaternion<f64>;
}
impl<T: Scalar> MapValue for nalgebra::Quaternion<T> {
    fn map_value(&self) -> nalgebra::Quaternion<f64> {
        nalgebra::Quaternion::new(self.w.value(), self.i.value(), self.j.value(), self.k.value())
    }
}

/// All closed contacts of `body`, by increasing site. `com` is its centre of mass in the world, `t` the time.
pub(crate) fn find<T: Scalar>(
    body: &Body<T>,
    state: &BodyState<T>,
    scene: &Scene<T>,
    com: &Vector3<T>,
    t: f64,
    touching: &mut Vec<(usize, f64)>,
    out: &mut Vec<Contact<T>>,
) {
    out.clear();
    let frame = Frame::of(&state.world_from_body);
    let up = Vector3::new(T::zero(), T::zero(), T::one());
    let exact = |v: &Point3<f64>| (state.world_from_body * v.map(T::lift)).coords;
    let mut base = 0_u32;
    if let Some(table) = &scene.table {
        let (up_row, height) = (frame.r.row(2).transpose(), table.height_m - frame.p.z);
        for piece in body.shape.iter() {
            touching.clear();
            for (i, v) in piece.vertices().iter().enumerate() {
                let depth = height - up_row.dot(&v.coords);
                if depth > 0.0 {
                    touching.push((i, depth));
                }
            }
            reduce(touching, piece, base, &up_row, &state.anchors);
            for &(i, _) in touching.iter() {
                let x = exact(&piece.vertices()[i]);
                let depth = T::lift(table.height_m) - x.z;
                out.push(Contact { site: base + i as u32, arm: x - com, normal: up, depth, friction: table.friction, support_velocity: Vector3::zeros() });
            }
            base += piece.vertices().len() as u32;
        }
    }
    for fixed in &scene.boxes {
        let (lo, hi) = (fixed.center.coords - fixed.half, fixed.center.coords + fixed.half);
        for piece in body.shape.iter() {
            let corners = piece.vertices();
            let world: Vec<Vector3<f64>> = corners.iter().map(|v| frame.map(v)).collect();
            let far = |k: usize| world.iter().all(|w| w[k] > hi[k]) || world.iter().all(|w| w[k] < lo[k]);
            let sites = (corners.len() + 4 * piece.edges().len()) as u32;
            if far(0) || far(1) || far(2) {
                base += sites;
                continue;
            }
            for (i, (v, w)) in corners.iter().zip(&world).enumerate() {
                if (0..3).all(|k| w[k] > lo[k] && w[k] < hi[k]) {
                    let (depth, normal) = box_depth(&exact(v), &lo, &hi);
                    out.push(Contact { site: base + i as u32, arm: exact(v) - com, normal, depth, friction: fixed.friction, support_velocity: Vector3::zeros() });
                }
            }
            base += corners.len() as u32;
            // Where edges of the piece cross the sides of the box below its top: the piece rests on an edge of the box.
            for [a, b] in piece.edges() {
                let (wa, wb) = (&world[*a as usize], &world[*b as usize]);
                for (s, (axis, bound)) in [(0, lo.x), (0, hi.x), (1, lo.y), (1, hi.y)].into_iter().enumerate() {
                    if (wa[axis] - bound) * (wb[axis] - bound) >= 0.0 {
                        continue;
                    }
                    let w = wa + (wb - wa) * ((bound - wa[axis]) / (wb[axis] - wa[axis]));
                    let other = 1 - axis;
                    if w.z < hi.z && w.z > lo.z && w[other] > lo[other] && w[other] < hi[other] {
                        let (xa, xb) = (exact(&corners[*a as usize]), exact(&corners[*b as usize]));
                        let x = xa + (xb - xa) * ((T::lift(bound) - xa[axis]) / (xb[axis] - xa[axis]));
                        let depth = T::lift(hi.z) - x.z;
                        // Deeper below the top than the side is away: the piece lies beside the box, not on it.
                        if depth.value() < 0.25 * (hi.z - lo.z) {
                            out.push(Contact { site: base + s as u32, arm: x - com, normal: up, depth, friction: fixed.friction, support_velocity: Vector3::zeros() });
                        }
                    }
                }
                base += 4;
            }
        }
    }
    for pusher in &scene.pushers {
        let (center, support_velocity) = pusher.at(t);
        for piece in body.shape.iter() {
            if let Some(contact) = against_sphere(piece, state, &frame, &center, pusher.radius_m, com) {
                out.push(Contact { site: base, friction: pusher.friction, support_velocity, ..contact });
            }
            base += 1;
        }
    }
}

/// Of many touching vertices of a round or finely meshed face, keeps at most four that span it: the deepest, the one
/// farthest from it, and the farthest on either side of the line between them. Vertices near a kept one stand for the
/// same place. What stuck before is preferred, so that the choice does not flicker.
fn reduce<T: Scalar>(touching: &mut Vec<(usize, f64)>, piece: &crate::ConvexPiece, base: u32, up: &Vector3<f64>, anchors: &[Anchor<T>]) {
    let p = |i: usize| piece.vertices()[i].coords;
    let favour = |i: usize| if anchors.binary_search_by_key(&(base + i as u32), |a| a.site).is_ok() { 1.2 } else { 1.0 };
    let best = |score: &dyn Fn(usize, f64) -> f64| {
        touching.iter().map(|&(i, d)| (i, score(i, d) * favour(i))).max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))
    };
    if touching.len() < 2 {
        return;
    }
    let Some((a, _)) = best(&|_, d| d) else { return };
    let Some((b, _)) = best(&|i, _| (p(i) - p(a)).norm()) else { return };
    let line = p(b) - p(a);
    let across = up.cross(&line).try_normalize(0.0).unwrap_or_default();
    let near = NEAR * piece.radius();
    let mut keep = vec![a];
    if line.norm() > near {
        keep.push(b);
        for sign in [1.0, -1.0] {
            if let Some((c, side)) = best(&|i, _| sign * across.dot(&(p(i) - p(a)))) {
                if side > near && !keep.contains(&c) {
                    keep.push(c);
                }
            }
        }
    }
    touching.retain(|(i, _)| keep.contains(i));
}

/// Depth below the nearest face of a box, and that face's normal.
fn box_depth<T: Scalar>(x: &Vector3<T>, lo: &Vector3<f64>, hi: &Vector3<f64>) -> (T, Vector3<T>) {
    let mut best = (T::lift(hi.z) - x.z, Vector3::z());
    for k in 0..3 {
        for (depth, sign) in [(T::lift(hi[k]) - x[k], 1.0), (x[k] - T::lift(lo[k]), -1.0)] {
            if depth.value() < best.0.value() {
                best = (depth, Vector3::ith(k, T::lift(sign)));
            }
        }
    }
    best
}

/// A sphere against a convex piece, by the face that the centre is farthest in front of.
fn against_sphere<T: Scalar>(
    piece: &crate::ConvexPiece,
    state: &BodyState<T>,
    frame: &Frame,
    center: &Point3<f64>,
    radius: f64,
    com: &Vector3<T>,
) -> Option<Contact<T>> {
    let local = frame.r.transpose() * (center.coords - frame.p);
    let (n, d) = piece.planes().iter().max_by(|a, b| {
        (a.0.dot(&local) - a.1).total_cmp(&(b.0.dot(&local) - b.1))
    })?;
    if n.dot(&local) - d >= radius {
        return None;
    }
    let pose = &state.world_from_body;
    let n_world = pose.rotation * n.map(T::lift);
    let c = center.coords.map(T::lift);
    let gap = n_world.dot(&(c - pose.translation.vector)) - T::lift(*d);
    let x = c - n_world * gap;
    // The sphere pushes into the body, against the outward normal of the face.
    Some(Contact { site: 0, arm: x - com, normal: -n_world, depth: T::lift(radius) - gap, friction: T::zero(), support_velocity: Vector3::zeros() })
}

/// Sum of contact force and moment about the centre of mass, per unit mass; replaces the anchors of `state`.
pub(crate) fn forces<T: Scalar>(
    contacts: &[Contact<T>],
    options: &ContactOptions,
    gravity: f64,
    dt: f64,
    state: &mut BodyState<T>,
    spare: &mut Vec<Anchor<T>>,
) -> (Vector3<T>, Vector3<T>) {
    spare.clear();
    let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
    if contacts.is_empty() {
        state.anchors.clear();
        return (force, moment);
    }
    let w = options.frequency_rad_s;
    let (mut sum, mut squares) = (T::zero(), T::zero());
    for c in contacts {
        sum += c.depth;
        squares += c.depth * c.depth;
    }
    let ratio = sum * sum / squares * T::lift(1.0 / FACE_SITES);
    let share = if ratio.value() > 1.0 { T::one() / ratio } else { T::one() } * T::lift(1.0 / FACE_SITES);
    let k_n = share * T::lift(w * w);
    let c_n = share * T::lift(2.0 * options.damping_ratio * w);
    let k_t = k_n * T::lift(options.tangential_ratio);
    let c_t = share * T::lift(2.0 * options.tangential_damping_ratio * options.tangential_ratio.sqrt() * w);
    // Damping grows in over a fraction of the rest depth, so that contact begins without a jump.
    let onset = T::lift(0.1 * gravity / (w * w));
    let mut old = state.anchors.iter().peekable();
    for c in contacts {
        let velocity = state.velocity + state.angular_velocity.cross(&c.arm) - c.support_velocity.map(T::lift);
        let rate = velocity.dot(&c.normal);
        let normal = k_n * c.depth - c_n * rate * (c.depth / (c.depth + onset));
        while old.next_if(|a| a.site < c.site).is_some() {}
        let kept = old.next_if(|a| a.site == c.site).map_or_else(Vector3::zeros, |a| a.stretch);
        if !(normal.value() > 0.0) {
            spare.push(Anchor { site: c.site, stretch: Vector3::zeros() });
            continue;
        }
        let slide = velocity - c.normal * rate;
        let stretch = kept - c.normal * kept.dot(&c.normal) + slide * T::lift(dt);
        let trial = -(stretch * k_t + slide * c_t);
        let (size2, bound) = (trial.norm_squared(), c.friction * normal);
        let (tangential, stretch) = if size2.value() > (bound * bound).value() {
            let f = trial * (bound / size2.sqrt());
            (f, f * (-T::one() / k_t))
        } else {
            (trial, stretch)
        };
        let f = c.normal * normal + tangential;
        force += f;
        moment += c.arm.cross(&f);
        spare.push(Anchor { site: c.site, stretch });
    }
    std::mem::swap(&mut state.anchors, spare);
    (force, moment)
}

/// How deep the start pose sinks into its support, and into which; for the check of a scene.
pub(crate) fn start_depth<T: Scalar>(body: &Body<T>, state: &BodyState<T>, scene: &Scene<T>) -> Option<(f64, String)> {
    let frame = Frame::of(&state.world_from_body);
    let table = scene.table.as_ref().map(|t| {
        let lowest = body.shape.iter().flat_map(|p| p.vertices()).map(|v| frame.map(v).z).fold(f64::INFINITY, f64::min);
        (t.height_m - lowest, "the table".to_owned())
    });
    let boxes = scene.boxes.iter().enumerate().filter_map(|(i, b)| {
        let (lo, hi) = (b.center.coords - b.half, b.center.coords + b.half);
        body.shape
            .iter()
            .flat_map(|p| p.vertices())
            .map(|v| frame.map(v))
            .filter(|w| (0..3).all(|k| w[k] > lo[k] && w[k] < hi[k]))
            .map(|w| box_depth(&w, &lo, &hi).0)
            .max_by(f64::total_cmp)
            .map(|d| (d, format!("box {i}")))
    });
    table.into_iter().chain(boxes).max_by(|a, b| a.0.total_cmp(&b.0))
}
