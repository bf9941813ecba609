//! Mass matrix (composite rigid bodies) and bias force (recursive Newton-Euler), as in Featherstone, *Rigid Body
//! Dynamics Algorithms* (2008), chapters 5 and 6; the recursions keep accelerations of points and moments about the
//! base's origin, all along the world's axes.

use nalgebra::Vector3;

use super::{Articulation, TreeWork};
use crate::Scalar;
use crate::math::solve3;

/// A force and a moment on a link, in the world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LinkForce<T: Scalar> {
    pub link: usize,
    /// Where the force acts.
    pub point: Vector3<T>,
    pub force: Vector3<T>,
    pub moment: Vector3<T>,
}

/// What the base does in a pass of Newton and Euler.
struct Drive<T: Scalar> {
    /// Added to the angular velocity of every link.
    spin: Vector3<T>,
    /// Acceleration of the base's origin less gravity.
    linear: Vector3<T>,
    angular: Vector3<T>,
}

impl<T: Scalar> Articulation<T> {
    /// The mass matrix of the configuration in `work`, armature included, into `out` (dof x dof by rows, every entry
    /// written). Entries between joints of which neither moves the other are exactly zero.
    pub(crate) fn mass_matrix(&self, work: &TreeWork<T>, out: &mut [T]) {
        let (base, n) = (self.base_dof(), self.dof());
        out.fill(T::zero());
        let mut put = |i: usize, j: usize, x: T| (out[i * n + j], out[j * n + i]) = (x, x);
        if base > 0 {
            let b = &work.base;
            let (c, second) = (&b.first, b.second.matrix());
            for k in 0..3 {
                put(k, k, b.mass);
                for l in k..3 {
                    put(3 + k, 3 + l, second[(k, l)]);
                }
            }
            // Momentum m v + w x first: the block of linear rows and angular columns is -[first].
            for (k, l, x) in [(0, 1, c.z), (0, 2, -c.y), (1, 0, -c.z), (1, 2, c.x), (2, 0, c.y), (2, 1, -c.x)] {
                put(k, 3 + l, x);
            }
        }
        for (j, motion) in work.joints.iter().enumerate() {
            put(base + j, base + j, motion.inertia);
            if base > 0 {
                for k in 0..3 {
                    put(k, base + j, motion.linear[k]);
                    put(3 + k, base + j, motion.angular[k]);
                }
            }
            let mut at = motion.above;
            while let Some(i) = at {
                put(base + i, base + j, work.joints[i].along(&motion.linear, &motion.angular));
                at = work.joints[i].above;
            }
        }
    }

    /// The bias force of the configuration in `work` into `out` (dof numbers): M u' + bias = tau, with gravity,
    /// Coriolis, centrifugal and gyroscopic forces, the acceleration of a base on a path, and `external` forces.
    /// Armature does not gyrate: it is an inertia along the joint's axis alone.
    pub(crate) fn bias(&self, work: &mut TreeWork<T>, gravity: &Vector3<T>, external: &[LinkForce<T>], out: &mut [T]) {
        let drive = Drive {
            spin: Vector3::zeros(),
            linear: work.base.acceleration - gravity,
            angular: work.base.angular_acceleration,
        };
        self.newton_euler(work, &drive, external, out);
    }

    /// The bias force that a step of length `h` is taken with: M (u⁺ - u) + h bias = h tau. `mass` is the mass matrix.
    ///
    /// For fixed and prescribed bases it is [`Articulation::bias`]. For a free base it differs by terms of order h:
    /// - the base's velocity is taken along with that of the robot's centre of mass, which
    ///   [`Articulation::advance`] carries over to the new configuration, so that linear momentum is kept exactly;
    /// - velocity forces are taken at the angular velocity of the base that they lead to, by one Newton step on
    ///   M (u⁺ - u) + h bias(w⁺) = 0, which takes energy from a tumbling body instead of feeding it.
    ///
    /// A robot of one link then moves as a free body does.
    pub(crate) fn step_bias(
        &self,
        work: &mut TreeWork<T>,
        gravity: &Vector3<T>,
        external: &[LinkForce<T>],
        (mass, h): (&[T], f64),
        out: &mut [T],
    ) {
        self.bias(work, gravity, external, out);
        if self.base_dof() == 0 || !(h > 0.0) {
            return;
        }
        let n = self.dof();
        let (o, half) = (Vector3::zeros(), T::lift(0.5));
        // Velocity forces alone, and their derivatives by the angular velocity: they are quadratic in the velocity, so
        // half the difference of two values around it is exact.
        let mut columns = std::mem::take(&mut work.column);
        columns.clear();
        columns.resize(5 * n, T::zero());
        let (own, rest) = columns.split_at_mut(n);
        let (turn, other) = rest.split_at_mut(3 * n);
        self.newton_euler(work, &Drive { spin: o, linear: o, angular: o }, &[], own);
        for k in 0..3 {
            let spin = Vector3::ith(k, T::one());
            let column = &mut turn[k * n..(k + 1) * n];
            self.newton_euler(work, &Drive { spin, linear: o, angular: o }, &[], column);
            self.newton_euler(work, &Drive { spin: -spin, linear: o, angular: o }, &[], other);
            column.iter_mut().zip(&*other).for_each(|(a, b)| *a = (*a - *b) * half);
            self.rest_center(mass, column, None);
        }
        self.rest_center(mass, own, Some(out));
        // Velocity w' - w of (M + h D Eᵀ) (u' - u) = -h bias, by the factors of M.
        own.copy_from_slice(out);
        factor(mass, n, &mut work.factor);
        let h = T::lift(h);
        solve(&work.factor, n, own);
        let y = Vector3::new(own[3], own[4], own[5]) * h;
        let mut a = nalgebra::Matrix3::identity();
        for k in 0..3 {
            other.copy_from_slice(&turn[k * n..(k + 1) * n]);
            solve(&work.factor, n, other);
            for i in 0..3 {
                a[(i, k)] += other[3 + i] * h;
            }
        }
        let change = solve3(&a, &-y);
        for k in 0..3 {
            out.iter_mut().zip(&turn[k * n..(k + 1) * n]).for_each(|(b, d)| *b += *d * change[k]);
        }
        work.column = columns;
    }

    /// Takes from the velocity forces `from` (and from `out` if given) what accelerates the base so that the centre of
    /// mass is not accelerated: M's first three columns times the mean acceleration.
    fn rest_center(&self, mass: &[T], from: &mut [T], out: Option<&mut [T]>) {
        let n = self.dof();
        let per_mass = T::one() / mass[0];
        let a = [from[0] * per_mass, from[1] * per_mass, from[2] * per_mass];
        let take = |target: &mut [T]| {
            for (i, x) in target.iter_mut().enumerate() {
                let row = &mass[i * n..i * n + 3];
                *x -= row[0] * a[0] + row[1] * a[1] + row[2] * a[2];
            }
        };
        match out {
            Some(out) => take(out),
            None => take(from),
        }
    }

    /// Generalised forces of the links' inertia at zero generalised acceleration, less `external`.
    fn newton_euler(&self, work: &mut TreeWork<T>, drive: &Drive<T>, external: &[LinkForce<T>], out: &mut [T]) {
        let TreeWork { links, joints, base, pairs, .. } = work;
        // Out to the leaves: angular acceleration, and acceleration of the origin.
        pairs.clear();
        for (i, node) in self.tree.iter().enumerate() {
            let at = &links[i];
            let (alpha, accel) = match node.parent {
                None => (drive.angular, drive.linear),
                Some(p) => {
                    let (up, [alpha0, accel0]) = (&links[p], pairs[p]);
                    let w0 = up.angular_velocity + drive.spin;
                    let moved =
                        |w: &Vector3<T>, alpha: &Vector3<T>, d: &Vector3<T>| alpha.cross(d) + w.cross(&w.cross(d));
                    match &node.joint {
                        Some(j) if j.prismatic => {
                            let slide = w0.cross(&joints[j.index].rate);
                            (alpha0, accel0 + moved(&w0, &alpha0, &(at.origin - up.origin)) + slide + slide)
                        }
                        Some(j) => {
                            let joint = &joints[j.index];
                            let alpha = alpha0 + w0.cross(&joint.rate);
                            let mut accel = accel0 + moved(&w0, &alpha0, &(joint.anchor - up.origin));
                            if j.anchor.is_some() {
                                let w = at.angular_velocity + drive.spin;
                                accel += moved(&w, &alpha, &(at.origin - joint.anchor));
                            }
                            (alpha, accel)
                        }
                        None => (alpha0, accel0 + moved(&w0, &alpha0, &(at.origin - up.origin))),
                    }
                }
            };
            pairs.push([alpha, accel]);
        }
        // What moves each link: moment about the base's origin, and force.
        for (at, pair) in links.iter().zip(pairs.iter_mut()) {
            let [alpha, accel] = *pair;
            let (w, d) = (at.angular_velocity + drive.spin, at.center - at.origin);
            let force = (accel + alpha.cross(&d) + w.cross(&w.cross(&d))) * at.mass;
            let moment = at.inertia.times(&alpha) + w.cross(&at.inertia.times(&w)) + at.center.cross(&force);
            *pair = [moment, force];
        }
        for f in external {
            let offset = f.point - base.world_from_base.translation.vector;
            if let Some([moment, force]) = pairs.get_mut(f.link) {
                *force -= f.force;
                *moment -= f.moment + offset.cross(&f.force);
            }
        }
        // Back to the base.
        let first = self.base_dof();
        for i in (0..pairs.len()).rev() {
            let [moment, force] = pairs[i];
            let node = &self.tree[i];
            if let Some(j) = &node.joint {
                out[first + j.index] = joints[j.index].along(&force, &moment);
            }
            match node.parent {
                Some(p) => {
                    pairs[p][0] += moment;
                    pairs[p][1] += force;
                }
                None if first > 0 => {
                    for k in 0..3 {
                        (out[k], out[3 + k]) = (force[k], moment[k]);
                    }
                }
                None => {}
            }
        }
    }
}

/// A = L D Lᵀ of a symmetric matrix by rows, L below the diagonal, D on it.
fn factor<T: Scalar>(a: &[T], n: usize, out: &mut Vec<T>) {
    out.clear();
    out.extend_from_slice(a);
    for j in 0..n {
        for k in 0..j {
            let l = out[j * n + k] * out[k * n + k];
            for i in j..n {
                let x = out[i * n + k] * l;
                out[i * n + j] -= x;
            }
        }
        let d = T::one() / out[j * n + j];
        for i in j + 1..n {
            out[i * n + j] *= d;
        }
    }
}

/// x of L D Lᵀ x = b, in place.
fn solve<T: Scalar>(factors: &[T], n: usize, x: &mut [T]) {
    for i in 0..n {
        for k in 0..i {
            let y = factors[i * n + k] * x[k];
            x[i] -= y;
        }
    }
    for i in 0..n {
        x[i] /= factors[i * n + i];
    }
    for i in (0..n).rev() {
        for k in i + 1..n {
            let y = factors[k * n + i] * x[k];
            x[i] -= y;
        }
    }
}
