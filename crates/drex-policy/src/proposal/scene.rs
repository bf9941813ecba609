//! An object as the network looks at it: from places on its surface, each in a frame that turns with the object.

use drex_core::Pose;
use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::cloud::farthest_points;

/// Points of the object that are looked at, and of these the places that grasps are proposed for.
pub(crate) const POINTS: usize = 256;
pub(crate) const ANCHORS: usize = 64;
/// Points around a place that the network sees, and how far they are from it at most, metres.
pub(crate) const PATCH: usize = 96;
pub(crate) const REACH_M: f64 = 0.12;
/// Numbers of a place beside its points.
pub(crate) const SCALARS: usize = 5;
/// Where logarithms of mass and friction are zero.
const MIDDLE_KG: f64 = 0.15;
const MIDDLE_FRICTION: f64 = 0.5;
/// Lengths are in units of this, metres.
const LENGTH_M: f64 = 0.1;

/// An object on the table z = 0, z up, metres.
#[derive(Debug, Clone)]
pub(crate) struct Scene {
    cloud: Vec<Point3<f64>>,
    middle: Point3<f64>,
}

impl Scene {
    /// Takes the points apart from each other.
    pub fn new(points: &[Point3<f64>]) -> Self {
        let mean = |points: &[Point3<f64>]| {
            points.iter().fold(Vector3::zeros(), |sum, p| sum + p.coords) / points.len().max(1) as f64
        };
        let cloud = farthest_points(points, &mean(points), POINTS);
        // Of points that are spread evenly: how densely a side was sampled does not count.
        let middle = Point3::from(mean(&cloud));
        Self { cloud, middle }
    }

    /// Places spread over what is seen of the surface: frames of [`Scene::frame`].
    pub fn anchors(&self) -> Vec<Pose> {
        self.cloud.iter().take(ANCHORS).map(|p| self.frame(p)).collect()
    }

    /// The frame at a point of the surface in the scene's: z up, x level and away from the middle of the object.
    pub fn frame(&self, at: &Point3<f64>) -> Pose {
        let out = at - self.middle;
        Pose::from_parts(at.coords.into(), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), out.y.atan2(out.x)))
    }

    /// Appends what the network sees from a frame: [`PATCH`] points.
    pub fn patch(&self, anchor: &Pose, out: &mut Vec<f32>) {
        let from = anchor.inverse();
        let at = Point3::from(anchor.translation.vector);
        let near = || self.cloud.iter().filter(|p| (**p - at).norm_squared() <= REACH_M * REACH_M);
        // Farthest points come first, so that the first ones cover all there is. The place itself is always among them.
        let points: Vec<&Point3<f64>> = near().take(PATCH).collect();
        for p in points.iter().cycle().take(PATCH) {
            out.extend((from * **p).coords.iter().map(|v| (v / LENGTH_M) as f32));
        }
    }

    /// Appends the numbers of a frame: its height over the table, where the middle of the object is, mass and friction.
    pub fn scalars(&self, anchor: &Pose, mass_kg: f64, friction: f64, out: &mut Vec<f32>) {
        let to = self.middle - Point3::from(anchor.translation.vector);
        let numbers = [
            anchor.translation.z / LENGTH_M,
            to.xy().norm() / LENGTH_M,
            to.z / LENGTH_M,
            (mass_kg / MIDDLE_KG).ln() / 2.0,
            (friction / MIDDLE_FRICTION).ln(),
        ];
        out.extend(numbers.map(|v| v as f32));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_seen_turns_with_the_object() {
        let points: Vec<Point3<f64>> = (0..700)
            .map(|i| {
                let a = f64::from(i);
                Point3::new(
                    0.05 * (0.7 * a).sin(),
                    0.03 * (1.3 * a).cos() * (0.1 * a).sin(),
                    0.06 + 0.05 * (0.37 * a).sin(),
                )
            })
            .collect();
        let turn = Pose::new(Vector3::new(0.3, -0.2, 0.0), Vector3::z() * 2.1);
        let turned: Vec<Point3<f64>> = points.iter().map(|p| turn * p).collect();
        let (a, b) = (Scene::new(&points), Scene::new(&turned));
        let look = |scene: &Scene| {
            let (mut patches, mut scalars) = (Vec::new(), Vec::new());
            for anchor in scene.anchors() {
                scene.patch(&anchor, &mut patches);
                scene.scalars(&anchor, 0.3, 0.4, &mut scalars);
            }
            (patches, scalars)
        };
        let ((p, s), (q, t)) = (look(&a), look(&b));
        assert_eq!((p.len(), s.len()), (ANCHORS * PATCH * 3, ANCHORS * SCALARS));
        assert!(p.iter().zip(&q).chain(s.iter().zip(&t)).all(|(x, y)| (x - y).abs() < 1e-5));
        assert!(p.iter().any(|x| x.abs() > 0.3));
    }
}
