//! Where geoms touch: the search on plain numbers for pairs of features, and what these say with derivatives.
//!
//! [`find`] lists the pairs of features that are closer than a margin. [`Touch::evaluate`] gives point, normal and depth
//! of a pair at poses of any scalar, so derivatives are those of the pair that was found.

mod ball;
mod capsule;
mod cylinder;
mod feature;
mod geom;
mod manifold;
mod points;
mod sat;
mod solid;
#[cfg(test)]
mod tests;

#[cfg(test)]
use feature::Place;
pub(crate) use feature::{Frame, Side, Touch};
use geom::Cylinder;
pub(crate) use geom::{CollisionGeom, Kind};

use crate::Shape;

/// Buffers that a search reuses; they hold nothing between calls.
#[derive(Debug, Default)]
pub(crate) struct CollideWork {
    sat: sat::Buffers,
    planes: Vec<feature::Plane>,
    spots: manifold::Spots,
}

/// Whether these two shapes can touch.
pub(crate) fn supported(a: &Shape, b: &Shape) -> bool {
    !matches!(
        (a, b),
        (Shape::Plane, Shape::Plane) | (Shape::Sdf(_), Shape::Sdf(_)) | (Shape::Points(_), Shape::Points(_))
    )
}

/// Appends all touches of `a` against `b` whose depth is more than `-margin`, by increasing site.
pub(crate) fn find(
    a: &CollisionGeom,
    world_from_a: &Frame<f64>,
    b: &CollisionGeom,
    world_from_b: &Frame<f64>,
    margin: f64,
    work: &mut CollideWork,
    out: &mut Vec<Touch>,
) {
    let swapped = rank(&a.kind) > rank(&b.kind);
    let ((a, world_from_a), (b, world_from_b)) =
        if swapped { ((b, world_from_b), (a, world_from_a)) } else { ((a, world_from_a), (b, world_from_b)) };
    let gap = match &a.kind {
        Kind::Plane(plane) => {
            let (n, d) = world_from_a.plane(plane);
            n.dot(&world_from_b.point(&b.center)) - d - b.radius
        }
        _ => (world_from_a.point(&a.center) - world_from_b.point(&b.center)).norm() - a.radius - b.radius,
    };
    // Written so that poses that are not finite touch nothing.
    if !(gap <= margin) {
        return;
    }
    let first = out.len();
    Pair { a_from_b: world_from_a.inverse().then(world_from_b), margin, out }.search(&a.kind, &b.kind, work);
    let found = &mut out[first..];
    if swapped {
        found.iter_mut().for_each(|t| t.feature.flip());
    }
    if !found.is_sorted_by(|s, t| s.site < t.site) {
        found.sort_by_key(|t| t.site);
        let mut kept = first;
        for i in first..out.len() {
            if i == first || out[i].site != out[kept - 1].site {
                out.swap(i, kept);
                kept += 1;
            }
        }
        out.truncate(kept);
    }
}

/// Pairs are searched with the lower rank first.
fn rank(kind: &Kind) -> u8 {
    match kind {
        Kind::Plane(_) => 0,
        Kind::Sphere { .. } => 1,
        Kind::Capsule { .. } => 2,
        Kind::Cylinder(_) => 3,
        Kind::Poly(_) => 4,
        Kind::Sdf { .. } => 5,
        Kind::Points { .. } => 6,
    }
}

/// A search under way.
struct Pair<'a> {
    a_from_b: Frame<f64>,
    margin: f64,
    out: &'a mut Vec<Touch>,
}

impl Pair<'_> {
    fn search(&mut self, a: &Kind, b: &Kind, work: &mut CollideWork) {
        match (a, b) {
            (Kind::Plane(plane), Kind::Poly(poly)) => self.plane_poly(plane, poly),
            (Kind::Plane(_), Kind::Sphere { center, radius }) => self.ball(Side::B, center, *radius, a, 0),
            (Kind::Plane(_), Kind::Capsule { ends, radius }) => {
                self.ball(Side::B, &ends[0], *radius, a, 0);
                self.ball(Side::B, &ends[1], *radius, a, 1);
            }
            (Kind::Points { .. }, _) => {}
            (_, Kind::Points { points, body_from_shape }) => self.points(a, points, body_from_shape, work),
            (Kind::Plane(plane), Kind::Sdf { sdf, shape_from_body }) => self.plane_sdf(plane, sdf, shape_from_body),
            (Kind::Cylinder(Cylinder { prism: poly, .. }) | Kind::Poly(poly), Kind::Sdf { sdf, shape_from_body }) => {
                self.poly_sdf(poly, sdf, shape_from_body);
            }
            (Kind::Sphere { center, radius }, _) => self.ball(Side::A, center, *radius, b, 0),
            (Kind::Capsule { ends, radius }, _) => {
                let start = self.out.len();
                self.ball(Side::A, &ends[0], *radius, b, 0);
                self.ball(Side::A, &ends[1], *radius, b, 1);
                match b {
                    Kind::Capsule { ends: other, radius: other_radius } => {
                        self.capsule_capsule(ends, *radius, a, other, *other_radius, start);
                    }
                    Kind::Cylinder(cylinder) => self.capsule_cylinder(ends, *radius, cylinder, b),
                    Kind::Sdf { .. } => self.capsule_sdf(ends, *radius, b),
                    Kind::Poly(poly) => {
                        let rod = capsule::Rod::new(ends, *radius, Side::A);
                        self.rod_poly(&rod, poly, 2, None);
                        if self.out.len() == start {
                            self.rod_through(&rod, poly);
                        }
                    }
                    _ => {}
                }
            }
            (Kind::Plane(plane), Kind::Cylinder(cylinder)) => self.plane_cylinder(plane, cylinder),
            (Kind::Cylinder(c), Kind::Cylinder(d)) => self.cylinder_cylinder(c, d, work),
            (Kind::Cylinder(cylinder), Kind::Poly(poly)) => self.cylinder_poly(cylinder, poly, work),
            (Kind::Poly(p), Kind::Poly(q)) => self.poly_poly(p, q, work),
            _ => {}
        }
    }
}
