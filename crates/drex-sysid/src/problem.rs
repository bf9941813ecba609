//! One push as a least-squares problem: simulate it with a mass and a friction, compare with the track.
//!
//! Residuals are geodesic: translation in the world, rotation vector of q_sim⁻¹ q_obs in the body, each over its
//! standard deviation. Constant errors of the track (position, rotation, clock) are nuisances with priors; they never
//! need a new simulation.

use std::sync::Arc;

use drex_core::pose::pose_difference;
use drex_core::push::{Drive, ForceProfile, PoseNoise, PushRecording};
use drex_core::{Pose, Trajectory};
use drex_diffsim::{
    AppliedForce, Body, Collider, ContactOptions, ConvexPiece, Dual, Fixed, ForcePoint, Model, Mover, Part, Record,
    Scalar, Scene, State, rollout, tangents,
};
use nalgebra::{Point3, SMatrix, SVector, Vector3, Vector6};

use crate::{IdentifyOptions, ObjectModel, Result, SysidError, finger, noise};

/// Nuisances: clock offset, position bias (3), rotation bias (3).
pub(crate) const NUISANCES: usize = 7;
pub(crate) type Nuisance = SVector<f64, NUISANCES>;
type NuisanceMatrix = SMatrix<f64, NUISANCES, NUISANCES>;

/// Squared whitened residual of a frame (six numbers) from which on it counts as suspicious (Cauchy's loss).
const CAUCHY: f64 = 40.0;
/// Spacing of the dense record that nuisances are solved on, seconds.
const DENSE_S: f64 = 2e-3;

/// The parameters that need simulation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Parameters {
    pub log_mass: f64,
    pub log_friction: f64,
}

/// What acts on the object.
#[derive(Debug, Clone)]
pub(crate) enum Action {
    /// A known force at a point.
    Force {
        times_s: Vec<f64>,
        forces_n: Vec<Vector3<f64>>,
        /// Standard deviation of white noise on each sample, newtons per axis.
        noise_n: f64,
        point: ForcePoint,
    },
    /// A sphere on a prescribed path.
    Pusher { radius_m: f64, friction: f64, times_s: Vec<f64>, centers: Vec<Point3<f64>> },
    /// Nothing.
    Nothing,
}

/// A push ready to be simulated.
#[derive(Debug, Clone)]
pub(crate) struct Problem {
    pub name: String,
    pub times_s: Vec<f64>,
    pub observed: Vec<Pose>,
    pub noise: PoseNoise,
    pub start: Pose,
    pub start_velocity: Vector3<f64>,
    pub start_spin: Vector3<f64>,
    pub action: Action,
    prior: Nuisance,
    /// Contact and step, open for variation.
    pub contact: ContactOptions,
    pub dt_s: f64,
    gravity: Vector3<f64>,
    table_height_m: f64,
    boxes: Vec<drex_core::push::SupportBox>,
    unit: drex_core::MassProperties,
    collider: Arc<Collider>,
}

/// Fit of the nuisances at fixed parameters.
#[derive(Debug, Clone)]
pub(crate) struct Fit {
    pub cost: f64,
    pub nuisance: Nuisance,
    /// Whitened residual per frame.
    pub residuals: Vec<Vector6<f64>>,
    /// Weight per frame.
    pub weights: Vec<f64>,
}

/// Residuals with their derivatives by (log mass, log friction) and the nuisances.
pub(crate) struct Linear {
    pub residuals: Vec<Vector6<f64>>,
    pub by_parameters: Vec<SMatrix<f64, 6, 2>>,
    pub by_nuisances: Vec<SMatrix<f64, 6, NUISANCES>>,
}

impl Problem {
    pub(crate) fn new(
        recording: &PushRecording,
        object: &ObjectModel,
        shape: &[ConvexPiece],
        options: &IdentifyOptions,
        noise: PoseNoise,
    ) -> Result<Self> {
        let bad = |what: &str, remedy: &str| SysidError::Recording {
            push: recording.name.clone(),
            what: what.into(),
            remedy: remedy.into(),
        };
        let first = recording.track.poses().first().ok_or_else(|| bad("the track is empty", "record again"))?;
        let action = match &recording.drive {
            Drive::Force(ForceProfile { times_s, forces_n, point_in_object }) => {
                let noise_n = noise::significant(forces_n);
                let forces_n = noise::without_idle(forces_n, noise_n);
                Action::Force { times_s: times_s.clone(), forces_n, noise_n, point: ForcePoint::Body(*point_in_object) }
            }
            Drive::Finger(finger) => {
                let known = if options.finger_force { finger::known_force(recording, finger, shape) } else { None };
                known.unwrap_or_else(|| {
                    let (times_s, centers) = match &finger.encoder {
                        Some(e) => (e.times_s.clone(), e.positions.clone()),
                        None => (finger.command_times_s.clone(), finger.commands.clone()),
                    };
                    Action::Pusher {
                        radius_m: finger.impedance.radius_m,
                        friction: finger.impedance.friction,
                        times_s,
                        centers,
                    }
                })
            }
            _ => Action::Nothing,
        };
        let p = options.position_bias_m;
        let r = options.rotation_bias_rad;
        Ok(Self {
            name: recording.name.clone(),
            times_s: recording.track.times_s().to_vec(),
            observed: recording.track.poses().to_vec(),
            noise,
            start: recording.initial_pose.unwrap_or(*first),
            start_velocity: Vector3::zeros(),
            start_spin: Vector3::zeros(),
            action,
            prior: Nuisance::from([options.clock_offset_s, p, p, p, r, r, r]),
            contact: options.contact,
            dt_s: options.dt_s,
            gravity: recording.gravity,
            table_height_m: recording.support.table_height_m,
            boxes: recording.support.boxes.clone(),
            unit: object.unit,
            collider: Arc::new(Collider::convex(shape.to_vec())),
        })
    }

    /// The scene and model of the simulator at parameters of any scalar.
    fn build<T: Scalar>(&self, mass_kg: T, friction: T) -> Result<(Model<T>, Scene<T>, State<T>)> {
        let wrap = |source| SysidError::Simulation { push: self.name.clone(), source };
        let mut model = Model::new(vec![Body::new(&self.unit, mass_kg, Arc::clone(&self.collider))]);
        model.contact = self.contact.lift();
        model.dt_s = self.dt_s;
        let mut scene = Scene::empty();
        scene.gravity = self.gravity.map(T::lift);
        scene.fixed.push(Fixed::table(self.table_height_m, friction));
        for b in &self.boxes {
            scene.fixed.push(Fixed::cuboid(b.center_m.into(), b.half_m.into(), friction).map_err(wrap)?);
        }
        match &self.action {
            Action::Force { times_s, forces_n, point, .. } => {
                scene.forces.push(AppliedForce::new(Part::Body(0), times_s, forces_n, point.clone()).map_err(wrap)?);
            }
            Action::Pusher { radius_m, friction, times_s, centers } => {
                scene.movers.push(Mover::sphere(*radius_m, T::lift(*friction), times_s, centers).map_err(wrap)?);
            }
            Action::Nothing => {}
        }
        let pose = Pose::from_parts(
            self.start.translation.vector.map(T::lift).into(),
            nalgebra::UnitQuaternion::new_unchecked(self.start.rotation.into_inner().map_coords(T::lift)),
        );
        let mut state = State::at_rest(pose);
        state.bodies[0].velocity = self.start_velocity.map(T::lift);
        state.bodies[0].angular_velocity = self.start_spin.map(T::lift);
        Ok((model, scene, state))
    }

    /// The motion at `parameters`, densely recorded from the start to beyond the last pose.
    pub(crate) fn simulate(&self, parameters: &Parameters) -> Result<Motion> {
        let (model, scene, state) = self.build(parameters.log_mass.exp(), parameters.log_friction.exp())?;
        let end = self.times_s.last().copied().unwrap_or(0.0) + 3.0 * self.prior[0];
        let count = (end.max(0.0) / DENSE_S).ceil() as usize + 1;
        let times: Vec<f64> = (0..=count).map(|k| k as f64 * DENSE_S).collect();
        let record = rollout(&model, &scene, &state, &times)
            .map_err(|source| SysidError::Simulation { push: self.name.clone(), source })?;
        let path = Trajectory::from_samples(&record.times_s, &record.bodies[0].poses)?;
        Ok(Motion { path, record })
    }

    /// Nuisances and weights that fit the track best to a motion, by iterated reweighting from `guess`.
    pub(crate) fn fit(&self, motion: &Motion, guess: Option<&Fit>) -> Fit {
        let mut nuisance = guess.map_or_else(Nuisance::zeros, |g| g.nuisance);
        let mut last = self.evaluate(motion, &nuisance);
        for _ in 0..8 {
            let columns = self.nuisance_columns(motion, &nuisance);
            let mut h = NuisanceMatrix::from_diagonal(&self.prior.map(|s| 1.0 / (s * s)));
            let mut g = -nuisance.component_div(&self.prior.component_mul(&self.prior));
            for ((r, w), j) in last.residuals.iter().zip(&last.weights).zip(&columns) {
                h += j.transpose() * j * *w;
                g -= j.transpose() * r * *w;
            }
            let Some(step) = h.cholesky().map(|c| c.solve(&g)) else { break };
            let mut next = self.evaluate(motion, &(nuisance + step));
            let mut shrink = 1.0;
            while next.cost > last.cost && shrink > 0.05 {
                shrink *= 0.4;
                next = self.evaluate(motion, &(nuisance + step * shrink));
            }
            let gain = last.cost - next.cost;
            if gain <= 0.0 {
                break;
            }
            nuisance = next.nuisance;
            last = next;
            if gain < 1e-6 * (1.0 + last.cost) {
                break;
            }
        }
        last
    }

    /// Residuals, weights and cost at given nuisances.
    fn evaluate(&self, motion: &Motion, nuisance: &Nuisance) -> Fit {
        let residuals: Vec<Vector6<f64>> = (0..self.times_s.len())
            .map(|k| self.residual(&motion.at(self.times_s[k] - nuisance[0]), k, nuisance))
            .collect();
        let prior = nuisance.component_div(&self.prior).norm_squared();
        let cost =
            0.5 * prior + residuals.iter().map(|r| 0.5 * CAUCHY * (r.norm_squared() / CAUCHY).ln_1p()).sum::<f64>();
        let weights = residuals.iter().map(|r| 1.0 / (1.0 + r.norm_squared() / CAUCHY)).collect();
        Fit { cost, nuisance: *nuisance, residuals, weights }
    }

    pub(crate) fn residual(&self, simulated: &Pose, k: usize, nuisance: &Nuisance) -> Vector6<f64> {
        let mut r = pose_difference(simulated, &self.observed[k]) - nuisance.fixed_rows::<6>(1);
        for i in 0..3 {
            r[i] /= self.noise.position_m;
            r[i + 3] /= self.noise.rotation_rad;
        }
        r
    }

    /// Derivative of each frame's residual by the nuisances. A later clock shows the motion of an earlier time: the
    /// column of the offset is the velocity.
    pub(crate) fn nuisance_columns(&self, motion: &Motion, nuisance: &Nuisance) -> Vec<SMatrix<f64, 6, NUISANCES>> {
        let (sp, sr) = (self.noise.position_m, self.noise.rotation_rad);
        self.times_s
            .iter()
            .map(|t| {
                let mut j = SMatrix::zeros();
                let (v, w) = motion.velocity_at(t - nuisance[0]);
                for i in 0..3 {
                    j[(i, 0)] = v[i] / sp;
                    j[(i + 3, 0)] = w[i] / sr;
                    j[(i, 1 + i)] = -1.0 / sp;
                    j[(i + 3, 4 + i)] = -1.0 / sr;
                }
                j
            })
            .collect()
    }

    /// Residuals and derivatives at `parameters` and the nuisances of `fit`, through dual numbers.
    pub(crate) fn linearize(&self, parameters: &Parameters, fit: &Fit, friction_free: bool) -> Result<Linear> {
        if friction_free {
            let m = drex_diffsim::parameter::<2>(parameters.log_mass, 0);
            let f = drex_diffsim::parameter::<2>(parameters.log_friction, 1);
            self.linearize_with(m.exp(), f.exp(), fit)
        } else {
            let m = drex_diffsim::parameter::<1>(parameters.log_mass, 0);
            self.linearize_with(m.exp(), Dual::from_re(parameters.log_friction.exp()), fit)
        }
    }

    fn linearize_with<const N: usize>(&self, mass: Dual<N>, friction: Dual<N>, fit: &Fit) -> Result<Linear> {
        let (model, scene, state) = self.build(mass, friction)?;
        let times: Vec<f64> = self.times_s.iter().map(|t| (t - fit.nuisance[0]).max(0.0)).collect();
        let record = rollout(&model, &scene, &state, &times)
            .map_err(|source| SysidError::Simulation { push: self.name.clone(), source })?;
        let (sp, sr) = (self.noise.position_m, self.noise.rotation_rad);
        let mut out = Linear { residuals: Vec::new(), by_parameters: Vec::new(), by_nuisances: Vec::new() };
        let track = &record.bodies[0];
        for (k, pose) in track.poses.iter().enumerate() {
            let value = value_of(pose);
            out.residuals.push(self.residual(&value, k, &fit.nuisance));
            let q = pose.rotation.quaternion();
            let dp = [0, 1, 2].map(|i| tangents(&pose.translation.vector[i]));
            let dq = [q.w, q.i, q.j, q.k].map(|x| tangents(&x));
            let mut j = SMatrix::<f64, 6, 2>::zeros();
            for n in 0..N.min(2) {
                // The body rotation vector of a small change: 2 Im(q⁻¹ dq). The residual turns by its opposite.
                let change = nalgebra::Quaternion::new(dq[0][n], dq[1][n], dq[2][n], dq[3][n]);
                let turn = (value.rotation.quaternion().conjugate() * change).imag() * 2.0;
                for i in 0..3 {
                    j[(i, n)] = -dp[i][n] / sp;
                    j[(i + 3, n)] = -turn[i] / sr;
                }
            }
            out.by_parameters.push(j);
            let mut g = SMatrix::<f64, 6, NUISANCES>::zeros();
            let moving = self.times_s[k] - fit.nuisance[0] > 0.0;
            let v = track.velocities[k].map(|x| x.re);
            let w = value.rotation.inverse() * track.angular_velocities[k].map(|x| x.re);
            for i in 0..3 {
                if moving {
                    g[(i, 0)] = v[i] / sp;
                    g[(i + 3, 0)] = w[i] / sr;
                }
                g[(i, 1 + i)] = -1.0 / sp;
                g[(i + 3, 4 + i)] = -1.0 / sr;
            }
            out.by_nuisances.push(g);
        }
        Ok(out)
    }

    /// Whether the known force is that of a fingertip.
    pub(crate) fn is_pushed_by_finger(&self) -> bool {
        matches!(&self.action, Action::Force { point: ForcePoint::World(_), .. })
    }

    /// Whether something acts whose size does not scale with the mass.
    pub(crate) fn has_known_force(&self) -> bool {
        matches!(self.action, Action::Force { .. })
    }

    /// Centre of mass in the mesh frame.
    pub(crate) fn center_of_mass(&self) -> Point3<f64> {
        self.unit.center_of_mass
    }

    /// Whitening of the nuisances.
    pub(crate) fn prior_precision(&self) -> Nuisance {
        self.prior.map(|s| 1.0 / (s * s))
    }
}

/// A simulated motion.
pub(crate) struct Motion {
    path: Trajectory,
    record: Record<f64>,
}

impl Motion {
    /// The pose at time t; the first and the last pose hold before and after.
    pub(crate) fn at(&self, t: f64) -> Pose {
        let (a, b) = self.path.span_s().unwrap_or((0.0, 0.0));
        self.path.at(t.clamp(a, b)).unwrap_or_default()
    }

    /// Velocity of the frame's origin in the world and angular velocity in the body's frame at time t.
    fn velocity_at(&self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let k = (t / DENSE_S).floor();
        if k < 0.0 {
            return (Vector3::zeros(), Vector3::zeros());
        }
        let track = &self.record.bodies[0];
        let k = (k as usize + 1).min(track.poses.len() - 1);
        (track.velocities[k], track.poses[k].rotation.inverse() * track.angular_velocities[k])
    }
}

fn value_of<const N: usize>(pose: &Pose<Dual<N>>) -> Pose {
    let q = pose.rotation.quaternion();
    let q = nalgebra::Quaternion::new(q.w.re, q.i.re, q.j.re, q.k.re);
    Pose::from_parts(pose.translation.vector.map(|x| x.re).into(), nalgebra::UnitQuaternion::new_unchecked(q))
}

/// Entry-wise map of a quaternion.
trait MapCoords {
    fn map_coords<T: Scalar>(&self, f: impl Fn(f64) -> T) -> nalgebra::Quaternion<T>;
}
impl MapCoords for nalgebra::Quaternion<f64> {
    fn map_coords<T: Scalar>(&self, f: impl Fn(f64) -> T) -> nalgebra::Quaternion<T> {
        nalgebra::Quaternion::new(f(self.w), f(self.i), f(self.j), f(self.k))
    }
}
