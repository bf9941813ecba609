//! Where a body touches its surroundings.

use drex_core::Pose;
use nalgebra::{Matrix3, Point3, Vector3};

use crate::model::{Body, BodyState};
use crate::{Scalar, Scene};

/// A closed contact.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Contact<T: Scalar> {
    pub site: u32,
    /// From the centre of mass to the contact, world.
    pub arm: Vector3<T>,
    /// Out of the support.
    pub normal: Vector3<T>,
    pub depth: T,
    pub friction: T,
    /// Velocity of the support there.
    pub support_velocity: Vector3<f64>,
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

/// All contacts of `body` that are closed or within `margin` of it, by increasing site. `com` is its centre of mass in
/// the world, `t` the time.
pub(crate) fn find<T: Scalar>(
    body: &Body<T>,
    state: &BodyState<T>,
    scene: &Scene<T>,
    com: &Vector3<T>,
    (t, margin): (f64, f64),
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
            for (i, v) in piece.vertices().iter().enumerate() {
                if height - up_row.dot(&v.coords) > -margin {
                    let x = exact(v);
                    let depth = T::lift(table.height_m) - x.z;
                    out.push(Contact {
                        site: base + i as u32,
                        arm: x - com,
                        normal: up,
                        depth,
                        friction: table.friction,
                        support_velocity: Vector3::zeros(),
                    });
                }
            }
            base += piece.vertices().len() as u32;
        }
    }
    for fixed in &scene.boxes {
        let (lo, hi) = (fixed.center.coords - fixed.half, fixed.center.coords + fixed.half);
        for piece in body.shape.iter() {
            let corners = piece.vertices();
            let world: Vec<Vector3<f64>> = corners.iter().map(|v| frame.map(v)).collect();
            let far = |k: usize| world.iter().all(|w| w[k] > hi[k] + margin) || world.iter().all(|w| w[k] < lo[k]);
            let sites = (corners.len() + 4 * piece.edges().len()) as u32;
            if far(0) || far(1) || far(2) {
                base += sites;
                continue;
            }
            for (i, (v, w)) in corners.iter().zip(&world).enumerate() {
                if (0..3).all(|k| w[k] > lo[k] && w[k] < hi[k] + if k == 2 { margin } else { 0.0 }) {
                    let (depth, normal) = box_depth(&exact(v), &lo, &hi);
                    out.push(Contact {
                        site: base + i as u32,
                        arm: exact(v) - com,
                        normal,
                        depth,
                        friction: fixed.friction,
                        support_velocity: Vector3::zeros(),
                    });
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
                    if w.z < hi.z + margin && w.z > lo.z && w[other] > lo[other] && w[other] < hi[other] {
                        let (xa, xb) = (exact(&corners[*a as usize]), exact(&corners[*b as usize]));
                        let x = xa + (xb - xa) * ((T::lift(bound) - xa[axis]) / (xb[axis] - xa[axis]));
                        let depth = T::lift(hi.z) - x.z;
                        // Deeper below the top than the side is away: the piece lies beside the box, not on it.
                        if depth.value() < 0.25 * (hi.z - lo.z) {
                            out.push(Contact {
                                site: base + s as u32,
                                arm: x - com,
                                normal: up,
                                depth,
                                friction: fixed.friction,
                                support_velocity: Vector3::zeros(),
                            });
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
            if let Some(contact) = against_sphere(piece, state, &frame, &center, pusher.radius_m, margin, com) {
                out.push(Contact { site: base, friction: pusher.friction, support_velocity, ..contact });
            }
            base += 1;
        }
    }
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
    margin: f64,
    com: &Vector3<T>,
) -> Option<Contact<T>> {
    let local = frame.r.transpose() * (center.coords - frame.p);
    let (n, d) = piece.planes().iter().max_by(|a, b| (a.0.dot(&local) - a.1).total_cmp(&(b.0.dot(&local) - b.1)))?;
    if n.dot(&local) - d >= radius + margin {
        return None;
    }
    let pose = &state.world_from_body;
    let n_world = pose.rotation * n.map(T::lift);
    let c = center.coords.map(T::lift);
    let gap = n_world.dot(&(c - pose.translation.vector)) - T::lift(*d);
    let x = c - n_world * gap;
    // The sphere pushes into the body, against the outward normal of the face.
    Some(Contact {
        site: 0,
        arm: x - com,
        normal: -n_world,
        depth: T::lift(radius) - gap,
        friction: T::zero(),
        support_velocity: Vector3::zeros(),
    })
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
