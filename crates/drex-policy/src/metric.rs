//! How far two grasps are apart.

use drex_core::Pose;

/// Distance between two grasps in metres of fingertip displacement.
///
/// sqrt(l² · mean over joints (Δq)² + |Δt|² + l² · θ²) with the lever l = `length_m`, Δt the distance of the palms and θ the angle
/// between them: an angle error moves what it turns by angle times lever, so the three terms share a unit and need no tuned weights.
pub fn grasp_distance_m(a: (&[f64], &Pose), b: (&[f64], &Pose), length_m: f64) -> f64 {
    let joints = joint_rms_rad(a.0, b.0);
    let wrist = (a.1.translation.vector - b.1.translation.vector).norm_squared();
    let angle = a.1.rotation.angle_to(&b.1.rotation);
    (length_m.powi(2) * (joints * joints + angle * angle) + wrist).sqrt()
}

/// Root mean square of the differences of two sets of joint angles, rad; zero for no joints.
pub(crate) fn joint_rms_rad(a: &[f64], b: &[f64]) -> f64 {
    let count = a.len().min(b.len()).max(1);
    (a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>() / count as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Vector3};

    #[test]
    fn each_term_has_its_unit() {
        let origin = Pose::identity();
        let joints = [0.0, 0.0, 0.0, 0.0];
        let distance = |q: &[f64], pose: &Pose| grasp_distance_m((&joints, &origin), (q, pose), 0.1);
        // One of four joints off by 0.4 rad: RMS 0.2 rad, times the lever.
        assert!((distance(&[0.4, 0.0, 0.0, 0.0], &origin) - 0.02).abs() < 1e-12);
        assert!((distance(&joints, &Pose::translation(0.03, 0.0, 0.04)) - 0.05).abs() < 1e-12);
        assert!((distance(&joints, &Pose::rotation(Vector3::y() * 0.7)) - 0.07).abs() < 1e-12);
        let all = Isometry3::new(Vector3::new(0.03, 0.0, 0.04), Vector3::y() * 0.7);
        let expected = (0.02f64.powi(2) + 0.05f64.powi(2) + 0.07f64.powi(2)).sqrt();
        assert!((distance(&[0.4, 0.0, 0.0, 0.0], &all) - expected).abs() < 1e-12);
    }
}
