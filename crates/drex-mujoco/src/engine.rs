//! MuJoCo behind the same calls.

use drex_core::Pose;
use drex_diffsim::{
    ArticulationState, Base, BaseState, BodyState, ContactForce, ContactKey, Control, Error as SimulationError, Model,
    Part, Record, Scene, State,
};
use mujoco_rs::wrappers::{MjData, MjModel};
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};

use crate::layout::{FreeSlots, Layout};
use crate::mjcf::write;
use crate::sections::PRESCRIBED_GYRATION_M2;
use crate::{Error, MjcfOptions, Result};

/// The version whose structures the bindings know.
const VERSION: &str = "3.17.0";
/// Speed beyond which a motion is called diverged, m/s or rad/s.
const SPEED_LIMIT: f64 = 1e4;
/// Share of the bound from which friction counts as slipping.
const SLIPPING: f64 = 0.999;

/// A model and a scene compiled by MuJoCo, and the state they are in.
pub struct MujocoEngine {
    data: MjData<Box<MjModel>>,
    model: Model<f64>,
    scene: Scene<f64>,
    layout: Layout,
    dt_s: f64,
    start_s: f64,
    steps: u64,
    prescribed_kg: f64,
}

/// Where something is and how it moves; velocities of its frame's origin, in the world.
#[derive(Debug, Clone, Copy)]
struct Prescribed {
    pose: Pose,
    velocity: Vector3<f64>,
    angular_velocity: Vector3<f64>,
}

impl MujocoEngine {
    /// Compiles the model and the scene at the state `start`. Friction springs of the start are not carried over:
    /// MuJoCo has none.
    ///
    /// # Errors
    /// As [`to_mjcf`](crate::to_mjcf); if the library that was loaded is not the version that the bindings are for; if
    /// MuJoCo refuses the model.
    pub fn new(model: &Model<f64>, scene: &Scene<f64>, start: &State<f64>, options: &MjcfOptions) -> Result<Self> {
        let linked = mujoco_rs::mujoco_version();
        if linked != VERSION {
            let what = format!("the MuJoCo library that was loaded is version {linked}");
            return Err(Error::Unsupported {
                what,
                remedy: format!("put version {VERSION} first on the library path"),
            });
        }
        let written = write(model, scene, start, options)?;
        let refused = |e: &dyn std::fmt::Display| Error::Unsupported {
            what: format!("MuJoCo does not take the model: {e}"),
            remedy: "check shapes and inertias; to_mjcf gives the text that it was given".into(),
        };
        let compiled = MjModel::from_xml_string(&written.text).map_err(|e| refused(&e))?;
        let layout = Layout::new(&compiled, model, scene, written.owners)?;
        let mut data = MjData::new(Box::new(compiled));
        data.reset_keyframe(0).map_err(|e| refused(&e))?;
        data.forward();
        Ok(Self {
            data,
            model: model.clone(),
            scene: scene.clone(),
            layout,
            dt_s: options.step_s(model.dt_s),
            start_s: start.time_s,
            steps: 0,
            prescribed_kg: written.prescribed_kg,
        })
    }

    /// Time of the state, seconds.
    pub fn time_s(&self) -> f64 {
        self.start_s + self.steps as f64 * self.dt_s
    }

    /// Replaces the controls of the scene: one per articulation, from the coming step on.
    pub fn set_controls(&mut self, controls: Vec<Control>) {
        self.scene.controls = controls;
    }

    /// One step of MuJoCo under the scene's forces and controls, with what follows a path on its path.
    ///
    /// # Errors
    /// If the motion diverges, or a control does not fit its articulation.
    pub fn step(&mut self) -> Result<()> {
        self.prescribe();
        self.control()?;
        self.apply_forces();
        self.data.step();
        if let Some(i) = self.data.qvel().iter().position(|v| v.is_nan() || v.abs() >= SPEED_LIMIT) {
            let (body, speed) = (self.layout.name_of_velocity(i), self.data.qvel()[i].abs());
            return Err(SimulationError::Diverged { body, time_s: self.time_s(), speed }.into());
        }
        self.steps += 1;
        Ok(())
    }

    /// State of all bodies and articulations; friction springs are those of a new state.
    pub fn state(&self) -> State<f64> {
        let body = |(slots, body): (&FreeSlots, &drex_diffsim::Body<f64>)| {
            let it = self.free(slots);
            let mut pose = it.pose;
            pose.translation.vector -= pose.rotation * body.center_of_mass.coords;
            BodyState { world_from_body: pose, velocity: it.velocity, angular_velocity: it.angular_velocity }
        };
        let bodies = self.layout.bodies.iter().zip(&self.model.bodies).map(body).collect();
        let mut arms = Vec::with_capacity(self.layout.articulations.len());
        for (slots, arm) in self.layout.articulations.iter().zip(&self.model.articulations) {
            let base = match (&arm.base, &slots.base) {
                (Base::Free, Some(free)) => {
                    let it = self.free(free);
                    let (velocity, angular_velocity) = (it.velocity, it.angular_velocity);
                    BaseState { world_from_base: it.pose, velocity, angular_velocity }
                }
                _ => arm.prescribed_base(self.time_s()),
            };
            let q = slots.joints.iter().map(|j| self.data.qpos()[j.0]).collect();
            let velocities = slots.joints.iter().map(|j| self.data.qvel()[j.1]).collect();
            arms.push(ArticulationState { base, q, velocities, friction: vec![0.0; slots.joints.len()] });
        }
        State { time_s: self.time_s(), ..State::new(bodies, arms) }
    }

    /// Contacts of the last step and what they carried. `site` counts the contacts of a pair of shapes; springs, which
    /// MuJoCo does not have, are not stretched.
    pub fn contacts(&self) -> Vec<ContactForce<f64>> {
        let mut out: Vec<ContactForce<f64>> = Vec::new();
        for (i, c) in self.data.contact().iter().enumerate() {
            let owner = |g: i32| usize::try_from(g).ok().and_then(|g| self.layout.owners.get(g)).copied();
            let (Some(first), Some(second), Ok(f)) =
                (owner(c.geom[0]), owner(c.geom[1]), self.data.try_contact_force(i))
            else {
                continue;
            };
            let axis = |k: usize| Vector3::from_column_slice(&c.frame[3 * k..3 * k + 3]);
            let force = axis(0) * f[0] + axis(1) * f[1] + axis(2) * f[2];
            // MuJoCo's normal points from the first into the second, and so does the force.
            let flip = rank(first.0) < rank(second.0);
            let ((a, b), sign) = if flip { ((first, second), -1.0) } else { ((second, first), 1.0) };
            let same = |o: &&ContactForce<f64>| (o.key.a, o.key.b, o.key.geom_a, o.key.geom_b) == (a.0, b.0, a.1, b.1);
            let site = out.iter().filter(same).count() as u32;
            out.push(ContactForce {
                key: ContactKey { a: a.0, b: b.0, geom_a: a.1, geom_b: b.1, site },
                point: Vector3::from(c.pos),
                normal: axis(0) * sign,
                depth: -c.dist,
                force: force * sign,
                torque: f[3],
                velocity: (self.velocity_at(c.geom[1], &c.pos) - self.velocity_at(c.geom[0], &c.pos)) * sign,
                stretch: Vector3::zeros(),
                slips: f[0] > 0.0 && f[1].hypot(f[2]) >= SLIPPING * c.friction[0] * f[0],
            });
        }
        out
    }

    /// Velocity of the body that a geom is on, at a point of the world, at the end of the step.
    fn velocity_at(&self, geom: i32, point: &[f64; 3]) -> Vector3<f64> {
        let body = usize::try_from(geom).ok().and_then(|g| self.data.model().geom_bodyid().get(g)).copied();
        let Some(Ok((jacobian, _))) =
            body.and_then(|b| usize::try_from(b).ok()).map(|b| self.data.try_jac(true, false, point, b))
        else {
            return Vector3::zeros();
        };
        let u = self.data.qvel();
        Vector3::from_fn(|k, _| {
            jacobian.chunks_exact(u.len()).nth(k).map_or(0.0, |row| row.iter().zip(u).map(|(j, u)| j * u).sum())
        })
    }

    fn free(&self, slots: &FreeSlots) -> Prescribed {
        let q = &self.data.qpos()[slots.qpos..slots.qpos + 7];
        let v = &self.data.qvel()[slots.qvel..slots.qvel + 6];
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(q[3], q[4], q[5], q[6]));
        Prescribed {
            pose: Pose::from_parts(Translation3::new(q[0], q[1], q[2]), rotation),
            velocity: Vector3::new(v[0], v[1], v[2]),
            angular_velocity: rotation * Vector3::new(v[3], v[4], v[5]),
        }
    }

    /// Puts what follows a path where it is at this time, with its velocity, and accelerates it to that of the next
    /// step; it is too heavy for anything else to move it.
    fn prescribe(&mut self) {
        let (t, dt) = (self.time_s(), self.dt_s);
        let mut all: Vec<(FreeSlots, [Prescribed; 2])> = Vec::new();
        for (slots, mover) in self.layout.kinematic_bodies.iter().zip(&self.scene.kinematic_bodies) {
            all.push((
                *slots,
                [t, t + dt].map(|t| {
                    let m = mover.path.at(t);
                    Prescribed { pose: m.pose, velocity: m.velocity, angular_velocity: m.angular_velocity }
                }),
            ));
        }
        for (slots, arm) in self.layout.articulations.iter().zip(&self.model.articulations) {
            if let (Some(base), Base::Path(_)) = (slots.base, &arm.base) {
                all.push((
                    base,
                    [t, t + dt].map(|t| {
                        let b = arm.prescribed_base(t);
                        let (velocity, angular_velocity) = (b.velocity, b.angular_velocity);
                        Prescribed { pose: b.world_from_base, velocity, angular_velocity }
                    }),
                ));
            }
        }
        for (slots, [now, next]) in &all {
            let (x, q) = (&now.pose.translation.vector, &now.pose.rotation);
            let local = |m: &Prescribed| m.pose.rotation.inverse_transform_vector(&m.angular_velocity);
            self.data.qpos_mut()[slots.qpos..slots.qpos + 7].copy_from_slice(&[x.x, x.y, x.z, q.w, q.i, q.j, q.k]);
            let (w, dv, dw) = (local(now), next.velocity - now.velocity, local(next) - local(now));
            let force = dv * (self.prescribed_kg / dt);
            let torque = dw * (self.prescribed_kg * PRESCRIBED_GYRATION_M2 / dt);
            for k in 0..3 {
                let (v, f) = (slots.qvel + k, slots.qvel + 3 + k);
                self.data.qvel_mut()[v] = now.velocity[k];
                self.data.qvel_mut()[f] = w[k];
                self.data.qfrc_applied_mut()[v] = force[k];
                self.data.qfrc_applied_mut()[f] = torque[k];
            }
        }
    }

    fn control(&mut self) -> Result<()> {
        let t = self.time_s();
        for (i, (slots, arm)) in self.layout.articulations.iter().zip(&self.model.articulations).enumerate() {
            let control = self.scene.controls.get(i).map_or(&[][..], |c| c.at(t));
            arm.check_control(control)?;
            self.data.ctrl_mut()[slots.ctrl..slots.ctrl + control.len()].copy_from_slice(control);
        }
        Ok(())
    }

    /// Mean force over the coming step at the pose before it, as force and moment at the centre of mass.
    fn apply_forces(&mut self) {
        let (t, dt) = (self.time_s(), self.dt_s);
        if self.scene.forces.iter().any(|f| matches!(f.on, Part::Link { .. })) {
            // A step leaves poses of links behind that are one step old.
            self.data.kinematics();
        }
        self.data.xfrc_applied_mut().fill([0.0; 6]);
        for applied in &self.scene.forces {
            let (at, pose, com) = match applied.on {
                Part::Body(i) => {
                    let (slots, body) = (&self.layout.bodies[i as usize], &self.model.bodies[i as usize]);
                    let mut pose = self.free(slots).pose;
                    let com = pose.translation.vector;
                    pose.translation.vector -= pose.rotation * body.center_of_mass.coords;
                    (slots.body, pose, com)
                }
                Part::Link { articulation: arm, link } => {
                    let at = self.layout.articulations[arm as usize].links[link as usize];
                    let ([w, i, j, k], p) = (self.data.xquat()[at], self.data.xpos()[at]);
                    let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, i, j, k));
                    (at, Pose::from_parts(Vector3::from(p).into(), rotation), Vector3::from(self.data.xipos()[at]))
                }
                Part::Static(_) | Part::Kinematic(_) => continue,
            };
            let f = applied.mean(t, dt) * applied.gain;
            let (force, moment) = match applied.world_point(t + 0.5 * dt, &pose) {
                Some(point) => (f, (point - com).cross(&f)),
                None => (Vector3::zeros(), f),
            };
            let sum = &mut self.data.xfrc_applied_mut()[at];
            sum.iter_mut().zip(force.iter().chain(moment.iter())).for_each(|(s, x)| *s += x);
        }
    }
}

impl std::fmt::Debug for MujocoEngine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (bodies, arms) = (self.layout.bodies.len(), self.layout.articulations.len());
        let mut out = f.debug_struct("MujocoEngine");
        out.field("time_s", &self.time_s()).field("bodies", &bodies).field("arms", &arms).finish_non_exhaustive()
    }
}

/// Does in MuJoCo what [`drex_diffsim::rollout`] does. Between two steps everything moves at the constant velocity of that step.
///
/// # Errors
/// As [`MujocoEngine::new`] and [`MujocoEngine::step`]; for times that decrease.
pub fn rollout(
    model: &Model<f64>,
    scene: &Scene<f64>,
    start: &State<f64>,
    times_s: &[f64],
    options: &MjcfOptions,
) -> Result<Record<f64>> {
    let mut engine = MujocoEngine::new(model, scene, start, options)?;
    drex_diffsim::record(model, start, times_s, engine.dt_s, |state| {
        engine.step()?;
        *state = engine.state();
        Ok(())
    })
}

/// Which of two parts a contact counts as its first, as our contact search does.
fn rank(part: Part) -> (u8, u32, u32) {
    match part {
        Part::Body(i) => (0, i, 0),
        Part::Link { articulation: arm, link } => (1, arm, link),
        Part::Static(i) => (2, i, 0),
        Part::Kinematic(i) => (3, i, 0),
    }
}
