//! A push that is simulated and recorded as a laboratory would.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use drex_core::{MassProperties, Pose, TriMesh, fsutil, pose};
use drex_diffsim::{
    AppliedForce, Body, Collider, ConvexPolyhedron, ForcePoint, Model, Part, Scene, State, StaticBody, rollout,
};
use drex_recording::{
    ClockConfig, ForceConfig, FrameKind, PoseConfig, PushConfig, StartConfig, Support, TrackConfig, TrackFormat,
};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::normal3;

/// Noise of the simulated tracker and of the force record.
const POSITION_SD_M: f64 = 0.002;
const ROTATION_SD_RAD: f64 = PI / 180.0;
const FORCE_SD_N: f64 = 0.02;
/// Step of the simulation, shorter than the estimator's.
const STEP_S: f64 = 1e-4;
const GRAVITY_M_S2: f64 = 9.81;

/// A push that rocks a tin about the edge at its far side: two pulses of a horizontal force along +x, near its top.
#[derive(Debug, Clone)]
pub struct TiltPush<'a> {
    /// Convex shells of the tin in the frame of its mesh; one density.
    pub shells: &'a [TriMesh],
    /// Frame of the mesh from that of the tin, which stands on z = 0 around the z axis.
    pub mesh_from_tin: Pose,
    /// True mass, kg.
    pub mass_kg: f64,
    /// True friction against the table (a coefficient).
    pub friction: f64,
    /// Natural frequency of the contact with the table, rad/s: that of the estimator is 1e4, so that less is softer than it assumes.
    pub contact_rad_s: f64,
    /// Distance of the edge from the axis, which is that of the point where the force acts too, metres.
    pub half_width_m: f64,
    /// Height at which the force acts, metres.
    pub height_m: f64,
    /// The pulses.
    pub pulses: [Pulse; 2],
    /// First guess of the mass in the `push.toml`, kg.
    pub prior_kg: f64,
    /// Path of the mesh in the `push.toml`.
    pub mesh: &'a str,
    /// Seed of the noise.
    pub seed: u64,
}

/// Half a sine of force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pulse {
    /// When it begins, seconds.
    pub start_s: f64,
    /// How long it lasts, seconds.
    pub length_s: f64,
    /// Its peak in units of the force that tips the tin.
    pub peak: f64,
}

/// A recorded push: the text of its files, and what happened.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedPush {
    /// `push.toml`.
    pub config: String,
    /// `poses.csv`.
    pub poses: String,
    /// `force.csv`.
    pub force: String,
    /// How far the tin leaned at most, rad.
    pub largest_lean_rad: f64,
    /// Force that tips the tin, N.
    pub tipping_n: f64,
}

impl TiltPush<'_> {
    /// What a tracker (30 poses a second) and a force gauge (100 readings a second) record of it in 1.6 s, with noise, in the frame of the mesh.
    ///
    /// # Errors
    /// If the shells enclose no volume or the mass is not positive.
    pub fn simulate(&self) -> Result<RecordedPush> {
        let parts = self.shells.iter().map(|s| s.mass_properties(1.0)).collect::<Result<Vec<_>, _>>()?;
        let body = MassProperties::combined(&parts).context("the tin has no volume")?.with_mass(self.mass_kg);
        let pieces = self.shells.iter().map(|s| ConvexPolyhedron::from_points(&s.vertices));
        let collider = Arc::new(Collider::convex(pieces.collect::<Result<Vec<_>, _>>()?));

        let mut model = Model::new(vec![Body::new(&body, self.mass_kg, collider)]);
        model.dt_s = STEP_S;
        model.contact.frequency_rad_s = self.contact_rad_s;
        let mut scene: Scene<f64> = Scene::empty();
        scene.static_bodies.push(StaticBody::table(0.0, self.friction));
        let tipping_n = self.mass_kg * GRAVITY_M_S2 * self.half_width_m / self.height_m;
        let point = self.mesh_from_tin * Point3::new(-self.half_width_m, 0.0, self.height_m);
        let forward = self.mesh_from_tin * Vector3::x();
        let times: Vec<f64> = (0..=160).map(|i| f64::from(i) / 100.0).collect();
        let forces: Vec<Vector3<f64>> =
            times.iter().map(|&t| forward * tipping_n * (self.pulses[0].at(t) + self.pulses[1].at(t))).collect();
        scene.forces.push(AppliedForce::new(Part::Body(0), &times, &forces, ForcePoint::Body(point))?);
        let frames: Vec<f64> = (0..48).map(|i| f64::from(i) / 30.0).collect();
        let record = rollout(&model, &scene, &State::at_rest(Pose::identity()), &frames)?;
        let simulated = &record.bodies[0].poses;

        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        let mut poses = String::from("t,x,y,z,qw,qx,qy,qz\n");
        for (t, p) in frames.iter().zip(simulated) {
            let shake = UnitQuaternion::from_scaled_axis(normal3(&mut random) * ROTATION_SD_RAD);
            let position = p.translation.vector + normal3(&mut random) * POSITION_SD_M;
            let (x, q) = pose::to_wxyz(&Pose::from_parts(position.into(), shake * p.rotation));
            let _ = writeln!(
                poses,
                "{t:.4},{:.5},{:.5},{:.5},{:.6},{:.6},{:.6},{:.6}",
                x[0], x[1], x[2], q[0], q[1], q[2], q[3]
            );
        }
        let mut force = String::from("t,fx,fy,fz\n");
        for (t, f) in times.iter().zip(&forces) {
            let f = f + normal3(&mut random) * FORCE_SD_N;
            let _ = writeln!(force, "{t:.2},{:.4},{:.4},{:.4}", f.x, f.y, f.z);
        }
        Ok(RecordedPush {
            config: self.config(point).to_toml_string()?,
            poses,
            force,
            largest_lean_rad: simulated.iter().map(|p| p.rotation.angle()).fold(0.0, f64::max),
            tipping_n,
        })
    }

    fn config(&self, point: Point3<f64>) -> PushConfig {
        PushConfig {
            schema: 1,
            name: Some("tilt".into()),
            mesh: self.mesh.into(),
            gravity_m_s2: [0.0, 0.0, -GRAVITY_M_S2],
            mass_prior_kg: Some(self.prior_kg),
            mesh_sd_m: None,
            track: TrackConfig {
                file: "poses.csv".into(),
                format: TrackFormat::PoseCsv,
                fps: None,
                scene_id: None,
                obj_id: None,
                clock: ClockConfig::default(),
                frame: FrameKind::World,
                world_from_camera: None,
                up_in_mesh: None,
                push_in_mesh: None,
                tracked_from_mesh: None,
                noise: None,
            },
            support: Support { table_height_m: 0.0, friction: None, boxes: Vec::new() },
            start: StartConfig {
                pose: Some(PoseConfig { position_m: [0.0; 3], quat_wxyz: [1.0, 0.0, 0.0, 0.0] }),
                at_rest: true,
                time_s: Some(0.0),
                nominal_position_m: None,
            },
            force: Some(ForceConfig {
                file: "force.csv".into(),
                point_in_object_m: point.into(),
                clock: ClockConfig::default(),
            }),
            finger: None,
            hand: None,
            parameters: BTreeMap::new(),
        }
    }
}

impl Pulse {
    /// The force at a time, in units of the force that tips the tin.
    fn at(&self, t: f64) -> f64 {
        let s = (t - self.start_s) / self.length_s;
        if (0.0..=1.0).contains(&s) { self.peak * (PI * s).sin() } else { 0.0 }
    }
}

impl RecordedPush {
    /// Writes `push.toml`, `poses.csv` and `force.csv` into `folder`.
    ///
    /// # Errors
    /// If a file cannot be written; an old one stays.
    pub fn write(&self, folder: &Path) -> Result<()> {
        for (name, text) in [("poses.csv", &self.poses), ("force.csv", &self.force), ("push.toml", &self.config)] {
            fsutil::write_atomic(&folder.join(name), text.as_bytes())?;
        }
        Ok(())
    }
}
