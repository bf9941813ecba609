//! The points of a surface against another shape: only those whose boxes are near it are looked at.

use nalgebra::Vector3;

use super::ball::{distance_within, nearest};
use super::feature::{Ball, Feature, Frame, Plane, Side, Touch};
use super::geom::Kind;
use super::{CollideWork, Pair};
use crate::SurfacePoints;
use crate::shape::Node;

/// A distance that is interpolated on a grid may grow by this factor faster than space.
pub(super) const STEEPEST: f64 = 1.1;

impl Pair<'_> {
    /// Sites: the points, in the order of their tree. The weight of a touch is the area of its point, m².
    pub fn points(
        &mut self,
        other: &Kind,
        surface: &SurfacePoints,
        body_from_shape: &Frame<f64>,
        work: &mut CollideWork,
    ) {
        let a_from_shape = self.a_from_b.then(body_from_shape);
        let margin = self.margin;
        let planes = &mut work.planes;
        planes.clear();
        let shape_from_a = a_from_shape.inverse();
        match other {
            Kind::Plane(plane) => planes.push(shape_from_a.plane(plane)),
            Kind::Poly(poly) => planes.extend(poly.planes.iter().map(|plane| shape_from_a.plane(plane))),
            _ => {}
        }
        let near = |node: &Node| {
            if !planes.is_empty() {
                return planes.iter().all(|plane| lowest(node, plane) <= margin);
            }
            let (center, reach) = (a_from_shape.point(&node.center), node.half.norm());
            let gap = match other {
                Kind::Sdf { sdf, shape_from_body } => {
                    let x = shape_from_body.point(&center);
                    distance_within(sdf, &x, reach + margin).map_or(f64::INFINITY, |d| d / STEEPEST)
                }
                _ => nearest(other, &center, f64::INFINITY).map_or(f64::INFINITY, |found| found.0),
            };
            gap <= reach + margin
        };
        let out = &mut *self.out;
        surface.tree().visit(near, |i, p| {
            let x = a_from_shape.point(p);
            let ball = Ball { center: body_from_shape.point(p), radius: 0.0 };
            let feature = if let Kind::Sdf { sdf, shape_from_body } = other {
                let inside = |y: &Vector3<f64>| distance_within(sdf, y, margin).is_some_and(|d| d < margin);
                inside(&shape_from_body.point(&x)).then(|| Feature::BallSdf {
                    on: Side::B,
                    ball,
                    sdf: sdf.clone(),
                    shape_from_body: *shape_from_body,
                })
            } else {
                nearest(other, &x, margin)
                    .filter(|(distance, target)| *distance < margin && !target.is_sharp())
                    .map(|(_, target)| target.feature(Side::B, ball))
            };
            if let Some(feature) = feature {
                out.push(Touch { site: i, weight: surface.areas_m2()[i as usize], feature });
            }
        });
    }
}

/// Height of the lowest point of a box over a plane.
fn lowest(node: &Node, (n, d): &Plane) -> f64 {
    n.dot(&node.center) - d - n.abs().dot(&node.half)
}
