//! Weighs the object of one push by a known force with phyz: its convex contacts, its adjoint. `../weigh.py` writes the input and reads the
//! one line of JSON that this prints.
//!
//!     weigh-with-phyz PUSH.txt [SCANNED_MASSES]
//!
//! The origin of the object's body is the point at which the force acts, and it hangs from three slides and a ball: so the force on the
//! slides is the world's, whatever the object does, as phyz's adjoint demands of a control. That adjoint takes objectives of the final state
//! alone; the sum over the frames is made of one rollout per camera frame, each of which hands its `dJ/dq0, dJ/dv0` to the one before.

use std::cell::RefCell;
use std::error::Error;
use std::io::Write;
use std::time::Instant;

use phyz::diff::{
    ConvexAdjointError, ConvexContactRollout, FinalStateObjective, convex_adjoint_gradient, convex_rollout_objective,
};
use phyz::math::{DVec, Quat, quat_exp, quat_log};
use phyz::model::{SolImp, SolRef};
use phyz::{
    ContactMaterial, ContactSolverConfig, GeomInstance, Geometry, Mat3, Model, ModelBuilder, SpatialInertia,
    SpatialTransform, Vec3,
};

const POSITION_M: f64 = 2e-3;
const ROTATION_RAD: f64 = std::f64::consts::PI / 180.0;
const STEP_S: f64 = 1e-3;
/// Index of the object among the bodies: three slides come before it.
const OBJECT: usize = 3;
const COORDINATES: usize = 6;
/// Of the logarithm of the mass, where the adjoint refuses and differences must do.
const SPAN: f64 = 1e-3;
const ITERATIONS: usize = 25;
const SMALL: f64 = 1e-4;
const SCAN_TIMES_GUESS: [f64; 2] = [0.1, 10.0];

struct Frame {
    /// Steps from the start.
    step: usize,
    position: Vec3,
    rotation: Quat,
}

#[derive(Default)]
struct Push {
    guess_kg: f64,
    friction: f64,
    gravity: Vec3,
    /// Centre of mass and the moments of inertia about it (xx, yy, zz, xy, xz, yz), per kilogram, in the mesh frame.
    com: Vec3,
    inertia_per_kg: [f64; 6],
    /// Where the force acts, in the mesh frame.
    point: Vec3,
    start: Vec<f64>,
    shapes: Vec<(Geometry, Vec3, Quat)>,
    /// A box under the object: half extents and centre.
    support: Option<(Vec3, Vec3)>,
    frames: Vec<Frame>,
    force_times_s: Vec<f64>,
    forces_n: Vec<Vec3>,
}

impl Push {
    fn read(text: &str) -> Result<Self, Box<dyn Error>> {
        let mut push = Self::default();
        for line in text.lines() {
            let mut words = line.split_whitespace();
            let key = words.next().ok_or("an empty line")?;
            let x = words.map(str::parse).collect::<Result<Vec<f64>, _>>()?;
            let vector = |i: usize| Vec3::new(x[i], x[i + 1], x[i + 2]);
            match key {
                "guess_kg" => push.guess_kg = x[0],
                "friction" => push.friction = x[0],
                "gravity" => push.gravity = vector(0),
                "com" => push.com = vector(0),
                "inertia_per_kg" => push.inertia_per_kg.copy_from_slice(&x),
                "point" => push.point = vector(0),
                "start" => push.start = x,
                "box" => push.shapes.push((Geometry::Box { half_extents: vector(0) }, vector(3), quat(&x[6..]))),
                "cylinder" => {
                    let shape = Geometry::Cylinder { radius: x[0], height: 2.0 * x[1] };
                    push.shapes.push((shape, vector(2), quat(&x[5..])));
                }
                "support" => push.support = Some((vector(0), vector(3))),
                "pose" => push.frames.push(Frame {
                    step: (x[0] / STEP_S).round() as usize,
                    position: vector(1),
                    rotation: quat(&x[4..]),
                }),
                "force" => {
                    push.force_times_s.push(x[0]);
                    push.forces_n.push(vector(1));
                }
                _ => return Err(format!("no key {key}").into()),
            }
        }
        Ok(push)
    }

    fn model(&self, kg: f64) -> Model {
        let nothing = SpatialInertia::new(0.0, Vec3::zeros(), Mat3::from_diagonal(&Vec3::zeros()));
        let [xx, yy, zz, xy, xz, yz] = self.inertia_per_kg.map(|i| i * kg);
        let inertia = Mat3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let here = SpatialTransform::identity();
        let mut model = ModelBuilder::new()
            .gravity(self.gravity)
            .dt(STEP_S)
            .add_prismatic_body("x", -1, here, Vec3::new(1.0, 0.0, 0.0), nothing)
            .add_prismatic_body("y", 0, here, Vec3::new(0.0, 1.0, 0.0), nothing)
            .add_prismatic_body("z", 1, here, Vec3::new(0.0, 0.0, 1.0), nothing)
            .add_spherical_body("object", 2, here, SpatialInertia::new(kg, self.com - self.point, inertia));
        if let Some((_, centre)) = self.support {
            let there = SpatialTransform::new(Mat3::identity(), centre);
            model = model.add_fixed_body("support", -1, there, nothing);
        }
        let mut model = model.build();
        if let Some((half_extents, _)) = self.support {
            model.bodies[OBJECT + 1].geometry = Some(Geometry::Box { half_extents });
        }
        model.bodies[OBJECT].collisions = self
            .shapes
            .iter()
            .map(|(shape, at, turn)| {
                let body_to_shape = SpatialTransform::new(turn.to_matrix().transpose(), *at - self.point);
                GeomInstance::new(shape.clone(), body_to_shape)
            })
            .collect();
        model
    }

    /// The table's material: the friction that is stated, and the softness that the recording simulator was given.
    fn material(&self) -> ContactMaterial {
        ContactMaterial {
            friction: self.friction,
            solref: SolRef { timeconst: 0.004, dampratio: 1.0 },
            solimp: SolImp { dmin: 0.95, dmax: 0.99, width: 0.0005, midpoint: 0.5, power: 2.0 },
            restitution: 0.0,
            margin: 5e-4,
            ..ContactMaterial::default()
        }
    }

    fn start(&self) -> (DVec, DVec) {
        let turn = quat(&self.start[3..]);
        let at = Vec3::new(self.start[0], self.start[1], self.start[2]) + turn.rotate(self.point);
        let w = quat_log(&turn);
        (DVec::from_slice(&[at.x, at.y, at.z, w.x, w.y, w.z]), DVec::zeros(COORDINATES))
    }

    fn force(&self, step: usize) -> DVec {
        let t = step as f64 * STEP_S + 1e-9;
        let held = self.force_times_s.partition_point(|&at| at <= t).saturating_sub(1);
        let f = self.forces_n[held];
        DVec::from_slice(&[f.x, f.y, f.z, 0.0, 0.0, 0.0])
    }

    /// Half the sum of squares of what the frame says against a configuration, in standard deviations of the noise.
    fn loss(&self, frame: &Frame, q: &[f64]) -> f64 {
        let turn = quat_exp(&Vec3::new(q[3], q[4], q[5]));
        let at = Vec3::new(q[0], q[1], q[2]) - turn.rotate(self.point);
        let off = at - frame.position;
        let mut between = frame.rotation.conjugate().mul(&turn);
        if between.w < 0.0 {
            between = Quat::new(-between.w, -between.v.x, -between.v.y, -between.v.z);
        }
        let angle = quat_log(&between);
        0.5 * (off.dot(off) / POSITION_M.powi(2) + angle.dot(angle) / ROTATION_RAD.powi(2))
    }

    fn loss_slope(&self, frame: &Frame, q: &[f64]) -> Vec<f64> {
        let h = 1e-6;
        (0..COORDINATES)
            .map(|i| {
                let (mut more, mut less) = (q.to_vec(), q.to_vec());
                more[i] += h;
                less[i] -= h;
                (self.loss(frame, &more) - self.loss(frame, &less)) / (2.0 * h)
            })
            .collect()
    }
}

fn quat(x: &[f64]) -> Quat {
    Quat::new(x[0], x[1], x[2], x[3])
}

/// A fit of one push, and what it cost.
struct Fit<'a> {
    push: &'a Push,
    rollouts: usize,
    adjoints: usize,
    refused: usize,
}

impl Fit<'_> {
    /// The states at the start of each segment, and the sum over the frames.
    fn forward(&mut self, log_mass: f64) -> (Vec<(DVec, DVec)>, f64) {
        self.rollouts += 1;
        let model = self.push.model(log_mass.exp());
        let (mut q, mut v) = self.push.start();
        let (mut states, mut sum, mut from) = (Vec::new(), 0.0, 0);
        for frame in &self.push.frames {
            states.push((q.clone(), v.clone()));
            let end = RefCell::new((q.clone(), v.clone()));
            let ctrl = |t: usize| self.push.force(from + t);
            let objective = FinalStateObjective {
                value: &|q: &[f64], v: &[f64]| {
                    *end.borrow_mut() = (DVec::from_slice(q), DVec::from_slice(v));
                    self.push.loss(frame, q)
                },
                gradient: &|_: &[f64], _: &[f64]| (vec![0.0; COORDINATES], vec![0.0; COORDINATES]),
            };
            sum += convex_rollout_objective(&self.rollout(&model, (q, v), frame.step - from, &ctrl), &objective);
            (q, v) = end.into_inner();
            from = frame.step;
        }
        (states, sum)
    }

    /// The sum over the frames and its derivative by the logarithm of the mass.
    fn slope(&mut self, log_mass: f64) -> (f64, f64) {
        let (states, sum) = self.forward(log_mass);
        self.adjoints += 1;
        let slope = self.adjoint(log_mass, &states).unwrap_or_else(|_| {
            self.refused += 1;
            (self.forward(log_mass + SPAN).1 - self.forward(log_mass - SPAN).1) / (2.0 * SPAN)
        });
        (sum, slope)
    }

    /// The derivative, or why phyz gives none.
    fn adjoint(&self, log_mass: f64, states: &[(DVec, DVec)]) -> Result<f64, ConvexAdjointError> {
        let model = self.push.model(log_mass.exp());
        let own = model.bodies[OBJECT].inertia;
        let own = phyz::diff::inertia_params(&own);
        let (mut by_q, mut by_v) = (vec![0.0; COORDINATES], vec![0.0; COORDINATES]);
        let mut slope = 0.0;
        for (k, frame) in self.push.frames.iter().enumerate().rev() {
            let from = if k == 0 { 0 } else { self.push.frames[k - 1].step };
            let ctrl = |t: usize| self.push.force(from + t);
            let (after_q, after_v) = (by_q.clone(), by_v.clone());
            let objective = FinalStateObjective {
                value: &|q: &[f64], _: &[f64]| self.push.loss(frame, q),
                gradient: &|q: &[f64], _: &[f64]| {
                    let here = self.push.loss_slope(frame, q);
                    (here.iter().zip(&after_q).map(|(a, b)| a + b).collect(), after_v.clone())
                },
            };
            let rollout = self.rollout(&model, states[k].clone(), frame.step - from, &ctrl);
            let gradient = convex_adjoint_gradient(&rollout, &objective)?;
            (by_q, by_v) = (gradient.d_q0.as_slice().to_vec(), gradient.d_v0.as_slice().to_vec());
            // Density is uniform: the moments of inertia go with the mass, the centre of mass stays.
            let d = gradient.d_inertia[OBJECT];
            slope += own[0] * d[0] + (4..10).map(|i| own[i] * d[i]).sum::<f64>();
        }
        Ok(slope)
    }

    fn rollout<'b>(
        &self,
        model: &'b Model,
        (q0, v0): (DVec, DVec),
        steps: usize,
        ctrl: &'b dyn Fn(usize) -> DVec,
    ) -> ConvexContactRollout<'b> {
        let material = self.push.material();
        // Made for the comparison with MuJoCo, whose friction creeps: MuJoCo recorded the push. With the preset `simulation` most contact
        // solves of a pressed box end a little above its tolerance, and the adjoint refuses them.
        let config = ContactSolverConfig::mujoco_compat();
        ConvexContactRollout { model, ground_height: 0.0, material, config, q0, v0, steps, ctrl }
    }

    /// The mass at the end of a descent by secants of the adjoint's slopes, and its iterations.
    fn descend(&mut self, start: f64) -> (f64, usize) {
        let mut x = start;
        let (mut sum, mut slope) = self.slope(x);
        let mut curvature = slope.abs() / 0.2;
        for iteration in 1..=ITERATIONS {
            let mut step = (-slope / curvature.max(1e-12)).clamp(-1.0, 1.0);
            let mut better = None;
            for _ in 0..8 {
                if step.abs() < SMALL {
                    break;
                }
                let (_, there) = self.forward(x + step);
                if there <= sum + 1e-4 * slope * step {
                    better = Some(x + step);
                    break;
                }
                step *= 0.3;
            }
            let Some(next) = better else { return (x, iteration) };
            let (there, slope_there) = self.slope(next);
            let bend = (slope_there - slope) / step;
            curvature = if bend > 0.0 { bend } else { curvature };
            (x, sum, slope) = (next, there, slope_there);
        }
        (x, ITERATIONS)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let path = args.next().ok_or("name the file of a push")?;
    let masses: usize = args.next().map_or(Ok(0), |n| n.parse())?;
    let mut push = Push::read(&std::fs::read_to_string(path)?)?;
    push.frames.retain(|f| f.step > 0);
    let begin = Instant::now();
    let mut fit = Fit { push: &push, rollouts: 0, adjoints: 0, refused: 0 };
    let mut start = push.guess_kg.ln();
    if masses > 1 {
        let [low, high] = SCAN_TIMES_GUESS.map(|times| (push.guess_kg * times).ln());
        let mut best = f64::INFINITY;
        for i in 0..masses {
            let x = low + (high - low) * i as f64 / (masses - 1) as f64;
            let sum = fit.forward(x).1;
            if sum < best {
                (best, start) = (sum, x);
            }
        }
    }
    let (log_mass, iterations) = fit.descend(start);
    let (kg, seconds) = (log_mass.exp(), begin.elapsed().as_secs_f64());
    let Fit { rollouts, adjoints, refused, .. } = fit;
    writeln!(
        std::io::stdout(),
        "{{\"mass_kg\": {kg}, \"iterations\": {iterations}, \"seconds\": {seconds}, \"rollouts\": {rollouts}, \
         \"adjoints\": {adjoints}, \"refused\": {refused}}}"
    )?;
    Ok(())
}
