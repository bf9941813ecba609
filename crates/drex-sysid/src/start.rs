//! Where an object at rest stood before its push, from its track and from what it stands on.
//!
//! The track is noisy, the support is not: place and heading are those of the frames at rest, and the object stands on
//! the face of its hull that the track shows it to stand on.

use drex_core::pose::pose_difference;
use drex_core::stats::median;
use drex_core::{Object, Pose};
use drex_diffsim::ConvexPolyhedron;
use drex_recording::{Drive, PushRecording};
use nalgebra::{Point3, UnitQuaternion, Vector3, Vector6};

use crate::checks::support_top;

/// Frames are those of an object at rest until this long before something acts: the clock of the track may be late or early.
const BEFORE_S: f64 = 0.03;
/// Frames that are looked at, at least.
const LEAST_FRAMES: usize = 3;
/// Farthest that the axis of a standing object is tracked beside the vertical, rad: noise, and the bias of a tracker.
const MOST_TILT_RAD: f64 = 0.15;
/// Faces that an object can stand on and whose normals differ by no less and no more than this are facets of something round.
const FACETS_RAD: [f64; 2] = [0.02, 0.4];

/// The start of a push whose recording does not state it: the median of the frames at rest, put onto the support.
pub(crate) fn at_rest(recording: &PushRecording, onset_s: f64, object: &Object) -> Option<Pose> {
    let (times, poses) = (recording.track.times_s(), recording.track.poses());
    let until = times.partition_point(|t| *t <= onset_s - BEFORE_S);
    let frames = until.clamp(LEAST_FRAMES, poses.len().max(LEAST_FRAMES)).min(poses.len());
    let first = poses.first()?;
    let mut mean = *first;
    // The tangent space of the first frame is not that of the median: a second round is.
    for _ in 0..2 {
        let apart: Vec<Vector6<f64>> = poses[..frames].iter().map(|p| pose_difference(&mean, p)).collect();
        let middle = Vector6::from_fn(|i, _| median(apart.iter().map(|d| d[i])).unwrap_or(0.0));
        let turn = UnitQuaternion::from_scaled_axis(middle.fixed_rows::<3>(3).into_owned());
        mean = Pose::from_parts((mean.translation.vector + middle.fixed_rows::<3>(0)).into(), mean.rotation * turn);
    }
    Some(standing(recording, &mean, object).unwrap_or(mean))
}

/// When something first acts, seconds.
pub(crate) fn onset_s(drive: &Drive) -> Option<f64> {
    match drive {
        Drive::Finger(f) => {
            let first = f.commands.first()?;
            f.commands.iter().position(|c| c != first).and_then(|k| f.command_times_s.get(k)).copied()
        }
        _ => None,
    }
}

/// The pose near `tracked` in which a face of the object's hull lies flat on the support, the centre of mass above it; what is round there, and
/// lies on any of its facets, is only put down as it is turned.
fn standing(recording: &PushRecording, tracked: &Pose, object: &Object) -> Option<Pose> {
    let center = &object.mass_properties.center_of_mass;
    let points: Vec<Point3<f64>> = object.corners().copied().collect();
    let hull = ConvexPolyhedron::from_points(&points).ok()?;
    let down = tracked.rotation.inverse() * -Vector3::z();
    let stable = |(face, plane): &(usize, &(Vector3<f64>, f64))| {
        let corners: Vec<Vector3<f64>> =
            hull.face(*face).iter().filter_map(|&v| hull.vertices().get(v as usize)).map(|p| p.coords).collect();
        (0..corners.len()).all(|k| {
            let (a, b) = (corners[k], corners[(k + 1) % corners.len()]);
            (b - a).cross(&(center.coords - a)).dot(&plane.0) >= 0.0
        })
    };
    let stands: Vec<Vector3<f64>> = hull.planes().iter().enumerate().filter(stable).map(|(_, (n, _))| *n).collect();
    let normal = stands
        .iter()
        .filter(|n| n.angle(&down) < MOST_TILT_RAD)
        .min_by(|a, b| a.angle(&down).total_cmp(&b.angle(&down)))?;
    let round = stands.iter().any(|n| (FACETS_RAD[0]..FACETS_RAD[1]).contains(&n.angle(normal)));
    // The shortest turn that puts the face flat, about the centre of mass, which stays above its place.
    let turn = match round {
        true => UnitQuaternion::identity(),
        false => UnitQuaternion::rotation_between(&(tracked.rotation * normal), &-Vector3::z())?,
    };
    let rotation = turn * tracked.rotation;
    let place = tracked * center;
    let mut pose = Pose::from_parts((place.coords - rotation * center.coords).into(), rotation);
    // What lies under the centre of mass carries the object.
    let top = support_top(&recording.support, &place, &place);
    pose.translation.vector.z += top - object.bounds_at(&pose)?.0.z;
    Some(pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::ConvexPart;
    use drex_core::Trajectory;
    use drex_core::mesh::convex_hull;
    use drex_recording::SupportBox;

    fn solid(points: &[Point3<f64>]) -> Object {
        let hull = convex_hull(points).unwrap();
        let properties = hull.mass_properties(1000.0).unwrap();
        Object::of_parts(vec![ConvexPart::of_hull(hull)], properties)
    }

    /// A block of 20 x 40 x 80 mm on a step of 50 mm, tracked at rest with a bias, noise, and a frame that is wild.
    #[test]
    fn a_noisy_track_of_a_block_at_rest_is_a_block_that_stands() {
        let corner = |k: i32| {
            let sign = |bit: i32| if k & bit == 0 { -1.0 } else { 1.0 };
            Point3::new(0.01 * sign(1), 0.02 * sign(2), 0.04 * sign(4))
        };
        let block = solid(&(0..8).map(corner).collect::<Vec<_>>());
        let truth = Pose::new(Vector3::new(0.3, -0.1, 0.09), Vector3::z() * 0.7);
        let times: Vec<f64> = (0..30).map(|k| f64::from(k) / 30.0).collect();
        let poses: Vec<Pose> = (0..30)
            .map(|k| {
                let wave = |i: i32| 0.002 * f64::from(k * (7 + i)).sin();
                let wild = if k == 4 { 0.5 } else { 0.0 };
                let error = Vector3::new(wave(0), wave(1), 0.008 + wave(2) + wild);
                let turn = Vector3::new(0.02 + 8.0 * wave(3), -0.02 + 8.0 * wave(4) + wild, 8.0 * wave(5));
                Pose::new(truth.translation.vector + error, Vector3::zeros())
                    * Pose::new(Vector3::zeros(), truth.rotation.scaled_axis())
                    * Pose::new(Vector3::zeros(), turn)
            })
            .collect();
        let track = Trajectory::from_samples(&times, &poses).unwrap();
        let mut recording = PushRecording::new("block", "block.obj", track, Drive::Nothing);
        recording.support.boxes.push(SupportBox { center_m: [0.3, 0.0, 0.025], half_m: [0.05, 0.5, 0.025] });
        let start = at_rest(&recording, 0.4, &block).unwrap();
        let off = pose_difference(&truth, &start);
        assert!(off.fixed_rows::<2>(0).norm() < 2e-3 && off[5].abs() < 0.02, "{off}");
        // What the support decides is exact.
        assert!(off[2].abs() < 1e-9 && off[3].abs() < 1e-9 && off[4].abs() < 1e-9, "{off}");
    }
    /// A can of 38 sides lies on its side, turned by less than half a side.
    #[test]
    fn what_lies_on_its_round_side_is_not_turned_onto_a_facet() {
        let rim = |k: i32, x: f64| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 38.0).sin_cos();
            Point3::new(x, 0.03 * cos, 0.03 * sin)
        };
        let can = solid(&(0..38).flat_map(|k| [rim(k, -0.05), rim(k, 0.05)]).collect::<Vec<_>>());
        for roll in [0.0, 0.03, 0.06, 0.1] {
            let tracked = Pose::new(Vector3::new(0.0, 0.0, 0.035), Vector3::x() * roll);
            let track = Trajectory::from_samples(&[0.0, 0.1, 0.2], &[tracked; 3]).unwrap();
            let recording = PushRecording::new("can", "can.obj", track, Drive::Nothing);
            let start = at_rest(&recording, 0.4, &can).unwrap();
            assert!(start.rotation.angle_to(&tracked.rotation) < 1e-9, "{roll}: {start:?}");
            assert!((0.0298..=0.03 + 1e-9).contains(&start.translation.z), "{roll}: {start:?}");
        }
    }
}
