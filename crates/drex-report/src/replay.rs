//! A push again: the simulated object and the tracked one, and what pushed it.

use crate::Result;
use drex_core::{Pose, TriMesh, pose};
use drex_mesh::Asset;
use drex_recording::{Drive, ForceProfile, PushRecording};
use drex_sysid::PushReport;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use super::object::{OBJECT_COLOR, still};
use super::page::Page;
use super::viewer::{Look, Placed, Scene};
use crate::picture::plot::{COLORS, Plot, Series};
use drex_twin::Twin;
use drex_twin::records::MassFile;

/// Faces of the simulated object.
const FACES: usize = 4000;
/// Faces of the tracked object, whose edges are drawn.
const WIRE_FACES: usize = 400;
const TRACKED_COLOR: [f64; 3] = [0.0, 0.45, 0.70];
const FORCE_COLOR: [f64; 3] = [0.80, 0.20, 0.18];
/// Length of the arrow of the largest force, as a share of the object's size.
const ARROW: f64 = 0.6;
/// A smaller share of the largest force is not drawn: the noise of the record at rest would flicker.
const SMALL_FORCE: f64 = 0.05;

/// A push that was both tracked and simulated.
pub struct Replay {
    scene: Scene,
    picture: Vec<u8>,
    caption: String,
    force: Option<ForceProfile>,
    name: String,
}

/// One for each push; none for those that were not simulated.
pub fn of(twin: &Twin, asset: &Asset, mass: &MassFile) -> Result<Vec<Option<Replay>>> {
    let Some(result) = &mass.identification else { return Ok(Vec::new()) };
    let mut replays = Vec::new();
    for (i, push) in result.pushes.iter().enumerate() {
        let recording = match twin.manifest.mass.identify.get(i) {
            Some(path) => PushRecording::load(&twin.path(path)).ok(),
            None => None,
        };
        replays.push(replay(asset, push, recording.filter(|r| r.name == push.name).as_ref())?);
    }
    Ok(replays)
}

fn replay(asset: &Asset, push: &PushReport, recording: Option<&PushRecording>) -> Result<Option<Replay>> {
    let poses = |rows: &[[f64; 7]]| -> Result<Vec<Pose>> {
        rows.iter().map(|p| Ok(pose::pose_from_wxyz([p[0], p[1], p[2]], [p[3], p[4], p[5], p[6]])?)).collect()
    };
    if push.simulated.len() < 2 || push.simulated.len() != push.times_s.len() || push.hand.is_some() {
        return Ok(None);
    }
    let bias = Translation3::from(-Vector3::from(push.position_bias_m.unwrap_or_default()));
    let simulated = poses(&push.simulated)?;
    let tracked: Vec<Pose> = poses(&push.observed)?.iter().map(|p| bias * p).collect();
    let mesh = &asset.visual;
    let (azimuth, elevation) = (-0.9, 0.3);
    let table_m = lowest(mesh, &simulated[0]);
    let force = match recording.map(|r| &r.drive) {
        Some(Drive::Force(force)) => Some(force.clone()),
        _ => None,
    };
    let arrows = force.as_ref().and_then(|f| arrows(f, &push.times_s, &simulated));
    // Opened where the force is largest.
    let hardest = arrows.as_ref().and_then(|all| (0..all.len()).max_by(|&a, &b| all[a].scale.total_cmp(&all[b].scale)));
    let start_s = hardest.map(|i| push.times_s[i]);
    let mut scene = Scene::new(azimuth, elevation).on_table(table_m).timed(&push.times_s, start_s)?;
    if let Some(part) = scene.mesh(mesh, FACES) {
        scene.part(part, Look::Solid, OBJECT_COLOR, &placed(&simulated))?;
    }
    if let Some(part) = scene.mesh(mesh, WIRE_FACES) {
        scene.part(part, Look::Wire, TRACKED_COLOR, &placed(&tracked))?;
    }
    let size = asset.report.size_m.iter().copied().fold(0.0, f64::max);
    let mut caption = "solid: simulated with the estimated mass; blue edges: tracked".to_owned();
    if push.position_bias_m.is_some() {
        caption += ", less the constant error that was estimated";
    }
    if let Some(arrows) = arrows
        && let Some(part) = scene.mesh(&arrow(ARROW * size), 400)
    {
        scene.part(part, Look::Solid, FORCE_COLOR, &arrows)?;
        caption += "; red: the force that was measured";
    }
    let picture = still(mesh, &simulated[simulated.len() / 2], azimuth, elevation)?;
    Ok(Some(Replay { scene, picture, caption, force, name: push.name.clone() }))
}

impl Replay {
    /// Writes the scene, and gives its name.
    pub fn show(&self, page: &mut Page) -> String {
        page.viewers(&[(self.scene.clone(), self.picture.clone(), self.caption.clone())])
    }

    /// The force record.
    pub fn force_plot(&self) -> Option<String> {
        let force = self.force.as_ref()?;
        let of = |axis: usize| force.forces_n.iter().map(|f| f[axis]).collect();
        let axes: [Vec<f64>; 3] = [of(0), of(1), of(2)];
        let series = ["x", "y", "z"]
            .into_iter()
            .zip(&axes)
            .zip(COLORS)
            .map(|((label, y), color)| Series { label, x: &force.times_s, y, color, dots: false })
            .collect();
        let title = format!("{}: force that was measured", self.name);
        Some(Plot { title: &title, x_label: "time, s", y_label: "N", series, ..Plot::default() }.to_svg())
    }
}

fn placed(poses: &[Pose]) -> Vec<Placed> {
    poses.iter().map(|p| (*p).into()).collect()
}

fn lowest(mesh: &TriMesh, world_from_mesh: &Pose) -> f64 {
    mesh.vertices.iter().map(|v| (world_from_mesh * v).z).fold(f64::INFINITY, f64::min).min(1e6)
}

/// The arrow in each frame: its tip where the force acts, its length in proportion. `None` for a force that is always nil.
fn arrows(force: &ForceProfile, times_s: &[f64], object: &[Pose]) -> Option<Vec<Placed>> {
    let most = force.forces_n.iter().map(|f| f.norm()).fold(0.0, f64::max);
    if !(most > 0.0 && most.is_finite()) {
        return None;
    }
    let at = |t: f64| {
        // Held from each sample to the next, nil before the first and after the last.
        let next = force.times_s.partition_point(|s| *s <= t);
        let beyond = next == 0 || force.times_s.last().is_none_or(|end| t > *end);
        if beyond { Vector3::zeros() } else { force.forces_n.get(next - 1).copied().unwrap_or_else(Vector3::zeros) }
    };
    let one = |(t, pose): (&f64, &Pose)| {
        let f = at(*t);
        let share = f.norm() / most;
        let turn = UnitQuaternion::rotation_between(&Vector3::z(), &f)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let tip = pose * force.point_in_object;
        Placed {
            pose: Pose::from_parts(tip.into(), if share > 0.0 { turn } else { UnitQuaternion::identity() }),
            scale: if share < SMALL_FORCE { 0.0 } else { share },
        }
    };
    Some(times_s.iter().zip(object).map(one).collect())
}

/// An arrow along z that ends at the origin.
fn arrow(length: f64) -> TriMesh {
    const SIDES: u32 = 16;
    // Radius and height of the rings from the tail to the tip.
    let rings = [(0.0, -1.0), (0.025, -1.0), (0.025, -0.28), (0.075, -0.28), (0.0, 0.0)];
    let mut vertices = Vec::new();
    for (r, z) in rings {
        for k in 0..SIDES {
            let (s, c) = (std::f64::consts::TAU * f64::from(k) / f64::from(SIDES)).sin_cos();
            vertices.push(Point3::new(length * r * c, length * r * s, length * z));
        }
    }
    let mut faces = Vec::new();
    for ring in 0..rings.len() as u32 - 1 {
        for k in 0..SIDES {
            let [a, b] = [k, (k + 1) % SIDES].map(|k| ring * SIDES + k);
            faces.extend([[a, b, b + SIDES], [a, b + SIDES, a + SIDES]]);
        }
    }
    TriMesh { vertices, faces }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arrow_ends_where_the_force_acts_and_points_along_it() {
        let force = ForceProfile {
            times_s: vec![0.0, 1.0, 2.0],
            forces_n: vec![Vector3::zeros(), Vector3::new(0.0, 2.0, 0.0), Vector3::new(0.0, 0.0, -4.0)],
            torques_nm: vec![],
            point_in_object: Point3::new(0.1, 0.0, 0.0),
        };
        let object = vec![Pose::translation(0.0, 0.0, 1.0); 5];
        let seen = arrows(&force, &[0.5, 1.0, 1.9, 2.0, 2.5], &object).unwrap();
        assert_eq!(seen.iter().map(|p| p.scale).collect::<Vec<_>>(), [0.0, 0.5, 0.5, 1.0, 0.0]);
        let tip = Point3::new(0.1, 0.0, 1.0);
        for (placed, along) in seen.iter().zip([Vector3::z(), Vector3::y(), Vector3::y(), -Vector3::z(), Vector3::z()])
        {
            assert!((placed.pose * Point3::origin() - tip).norm() < 1e-12);
            assert!((placed.pose * Vector3::z() - along).norm() < 1e-9, "{along}");
        }
        let nil = ForceProfile { forces_n: vec![Vector3::zeros(); 3], ..force };
        assert!(arrows(&nil, &[0.5], &object[..1]).is_none());
    }

    #[test]
    fn the_arrow_ends_at_the_origin() {
        let (lo, hi) = arrow(0.2).bounds().unwrap();
        assert!((lo.z + 0.2).abs() < 1e-12 && hi.z == 0.0);
    }
}
