//! An object as the policy looks at it: z up, origin in the middle of its box, with the table somewhere below.

use nalgebra::{Isometry3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::cloud::{box_centre, encode, farthest_points};
use drex_core::Pose;
use drex_core::pose::upright;

/// The points of an object, turned so that up is z.
#[derive(Debug, Clone)]
pub(crate) struct View {
    /// Turns the frame the points were given in until up is z; the identity where it already was.
    upright: UnitQuaternion<f64>,
    points: Vec<Point3<f64>>,
    /// Those that enter the network.
    cloud: Vec<Point3<f64>>,
}

/// A view from one side: what stays to be said besides the points.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    /// Points and poses of the object's frame in that of the network.
    pub network_from_object: Pose,
    /// Height of the object's centre above the table, m.
    pub table_m: f64,
}

impl View {
    /// `count` of the points, farthest from each other, enter the network.
    pub fn new(points: &[Point3<f64>], up: Unit<Vector3<f64>>, count: usize) -> Self {
        let upright = upright(&up);
        let points: Vec<_> = points.iter().map(|p| upright * p).collect();
        let cloud = farthest_points(&points, &box_centre(&points), count);
        Self { upright, points, cloud }
    }

    /// The object turned by `turn`, its centre taken to be off by `shift`; the table under its lowest point, or where it is said to be.
    pub fn frame(&self, turn: &UnitQuaternion<f64>, shift: &Vector3<f64>, table_m: Option<f64>) -> Frame {
        // The box of the turned object is another box: a prediction will see its centre, not the turned one.
        let turned: Vec<_> = self.points.iter().map(|p| turn * p).collect();
        let centre = box_centre(&turned) + shift;
        let lowest = turned.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
        let table_m = table_m.unwrap_or(centre.z - lowest);
        let network_from_object = Isometry3::from_parts(Translation3::from(-centre), turn * self.upright);
        Frame { network_from_object, table_m }
    }

    /// The encoded cloud of [`frame`](Self::frame), N x E; `noise` moves each point.
    pub fn encode(
        &self,
        frame: &Frame,
        length_m: f64,
        frequencies: usize,
        mut noise: impl FnMut() -> Vector3<f64>,
    ) -> Vec<f32> {
        let network_from_upright = frame.network_from_object * self.upright.inverse();
        let mut encoded = Vec::with_capacity(self.cloud.len() * crate::cloud::encoding_width(frequencies));
        for p in &self.cloud {
            encode(&((network_from_upright * p).coords + noise()), length_m, frequencies, &mut encoded);
        }
        encoded
    }
}

/// A turn about the vertical and a lean of `lean` rad towards where it points.
pub(crate) fn turn(yaw: f64, lean: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(lean) * UnitQuaternion::from(Rotation3::from_axis_angle(&Vector3::z_axis(), yaw))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slab() -> Vec<Point3<f64>> {
        (0..8)
            .map(|i| Point3::new(f64::from(i & 1) * 0.1, f64::from(i >> 1 & 1) * 0.2, f64::from(i >> 2) * 0.04))
            .collect()
    }

    #[test]
    fn the_table_follows_the_object() {
        let table = |up: Vector3<f64>, turned: UnitQuaternion<f64>| {
            View::new(&slab(), Unit::new_normalize(up), 8).frame(&turned, &Vector3::zeros(), None).table_m
        };
        let none = UnitQuaternion::identity();
        for (up, half) in [(Vector3::x(), 0.05), (-Vector3::x(), 0.05), (Vector3::y(), 0.1), (-Vector3::z(), 0.02)] {
            assert!((table(up, none) - half).abs() < 1e-12, "{up:?}");
        }
        // Yaw leaves the height; a lean by a about x raises the centre to (0.2 sin a + 0.04 cos a) / 2.
        assert!((table(Vector3::z(), turn(1.1, Vector3::zeros())) - 0.02).abs() < 1e-12);
        let expected = (0.2 * 0.3f64.sin() + 0.04 * 0.3f64.cos()) / 2.0;
        assert!((table(Vector3::z(), turn(0.0, Vector3::x() * 0.3)) - expected).abs() < 1e-12);
    }

    #[test]
    fn up_becomes_z_and_the_frame_leads_back() {
        for up in [Vector3::x(), Vector3::new(0.3, -0.5, 0.2), -Vector3::z()] {
            let view = View::new(&slab(), Unit::new_normalize(up), 8);
            let frame = view.frame(&UnitQuaternion::identity(), &Vector3::zeros(), None);
            assert!((frame.network_from_object.rotation * up.normalize() - Vector3::z()).norm() < 1e-12);
            let encoded = view.encode(&frame, 1.0, 0, Vector3::zeros);
            for (row, p) in encoded.chunks(3).zip(&view.cloud) {
                let back = frame.network_from_object.inverse() * Point3::new(row[0], row[1], row[2]).cast::<f64>();
                assert!(slab().iter().any(|q| (q - back).norm() < 1e-7), "{p:?}");
            }
        }
    }
}
