//! Cylinders. They are round where they lie or roll: the lowest points of their rims over a face, their side against
//! edges, corners and other sides. Where they stand, and where a rim meets an edge, the prism stands for them.

use nalgebra::Vector3;

use super::ball::{Target, nearest};
use super::capsule::{Rod, crossing, in_cone};
use super::feature::{Ball, Feature, Frame, Line, Plane, Side, Touch};
use super::geom::{Cylinder, Kind, Poly};
use super::manifold::{BESIDE, Spots};
use super::sat::{Overlap, Search, boxes_gap};
use super::{CollideWork, Pair};

/// Sine of the tilt up to which a cylinder stands on a patch, points around its rim.
const STANDING: f64 = 0.2;
/// Sine of the tilt from which the lowest point of the rim is told apart from those points.
const TILTED: f64 = 0.02;
/// Sine of the angle between a normal and the side's normals up to which the side carries it.
const ON_SIDE: f64 = 0.05;
/// Cosine of the angle within which a normal is that of a face.
const ON_FACE: f64 = 0.99;
/// Sine of the angle within which two lines touch along a stretch, not at a point.
const PARALLEL: f64 = 0.035;

/// Sine of the tilt up to which a capsule lies flat on the end of a cylinder.
const LEVEL: f64 = 0.005;

impl Pair<'_> {
    /// Sites: the corners of the prism, then the lowest points of the two rims.
    pub fn plane_cylinder(&mut self, plane: &Plane, c: &Cylinder) {
        let here = self.a_from_b.inverse().plane(plane);
        let tilt = here.0.cross(&c.axis).norm();
        if tilt < STANDING {
            self.plane_poly(plane, &c.prism);
        }
        if tilt > TILTED {
            self.rims(c, Side::B, &here, plane, c.prism.vertices.len() as u32, |_| true);
        }
    }

    /// The lowest points of the rims over a plane (`here` in the frame of the cylinder, `there` in that of its body), if
    /// they lie `within` (in the frame of the cylinder).
    fn rims(
        &mut self,
        c: &Cylinder,
        on: Side,
        here: &Plane,
        there: &Plane,
        site: u32,
        within: impl Fn(&Vector3<f64>) -> bool,
    ) {
        let (n, d) = here;
        let down = -(n - c.axis * n.dot(&c.axis)).normalize() * c.radius;
        for (k, origin) in c.ends().into_iter().enumerate() {
            let lowest = origin + down;
            if n.dot(&lowest) - d < self.margin && within(&lowest) {
                let axis = Line { origin, along: c.axis, radius: c.radius };
                self.out.push(Touch::new(site + k as u32, Feature::RimPlane { on, axis, plane: *there }));
            }
        }
    }

    /// Sites: those of two polyhedra, and after them the rims, edges and vertices against the side, and ends of the side
    /// along edges.
    pub fn cylinder_poly(&mut self, c: &Cylinder, poly: &Poly, work: &mut CollideWork) {
        let margin = self.margin + c.sagitta();
        if boxes_gap(&c.prism, poly, &self.a_from_b) > margin {
            return;
        }
        let mut search = Search::new(&c.prism, poly, &self.a_from_b, &mut work.sat);
        let start = self.out.len();
        if let Some(overlap) = self.least_overlap(&mut search, margin, &mut work.spots) {
            self.cylinder_on(c, Side::A, &search, &overlap, &mut work.spots, start);
        }
    }

    /// Sites: as for a polyhedron; where sides meet, after these.
    pub fn cylinder_cylinder(&mut self, c: &Cylinder, d: &Cylinder, work: &mut CollideWork) {
        let margin = self.margin + c.sagitta() + d.sagitta();
        if boxes_gap(&c.prism, &d.prism, &self.a_from_b) > margin {
            return;
        }
        let mut search = Search::new(&c.prism, &d.prism, &self.a_from_b, &mut work.sat);
        let start = self.out.len();
        let Some(overlap) = self.least_overlap(&mut search, margin, &mut work.spots) else { return };
        // The prism with as many vertices comes first: the common frame is that of a.
        let along = |axis: &Vector3<f64>| overlap.normal.dot(axis).abs();
        match (along(&c.axis), along(&self.a_from_b.direction(&d.axis))) {
            (x, y) if x < ON_SIDE && y < ON_SIDE => {
                self.out.truncate(start);
                self.sides(c, d, search.sites() + 1000);
                self.prism_if_deeper(&search, &overlap, &mut work.spots, start);
            }
            (x, y) if x < ON_SIDE || y > x => self.cylinder_on(c, Side::A, &search, &overlap, &mut work.spots, start),
            _ => self.cylinder_on(d, Side::B, &search, &overlap, &mut work.spots, start),
        }
    }

    /// A cylinder on the body `on` against the polyhedron of the other body. Touches from `start` on are those of its
    /// prism, if they have been found already.
    fn cylinder_on(
        &mut self,
        c: &Cylinder,
        on: Side,
        search: &Search<'_>,
        overlap: &Overlap,
        spots: &mut Spots,
        start: usize,
    ) {
        let (mine, other) = (search.half(on), search.half(on.other()));
        let (poly, site) = (other.poly, search.sites());
        // Out of the polyhedron, in the common frame and in that of the polyhedron.
        let n = if search.halves[0].on == on { -overlap.normal } else { overlap.normal };
        let towards = other.frame.r.tr_mul(&n);
        let axial = n.dot(&mine.frame.direction(&c.axis)).abs();
        let face = (0..poly.planes.len())
            .max_by(|&i, &j| poly.planes[i].0.dot(&towards).total_cmp(&poly.planes[j].0.dot(&towards)))
            .filter(|&f| poly.planes[f].0.dot(&towards) > ON_FACE);
        let tilt = (1.0 - axial * axial).max(0.0).sqrt();
        let as_prism = axial >= ON_SIDE && (face.is_none() || tilt < STANDING);
        if !as_prism {
            self.out.truncate(start);
        } else if !overlap.done {
            self.overlap(search, overlap, spots);
        }
        if let Some(f) = face.filter(|_| tilt > TILTED) {
            let sides = poly.sides(f as u32);
            let mine_from_other = mine.frame.inverse().then(&other.frame);
            let here = mine_from_other.plane(&poly.planes[f]);
            let beside = BESIDE * poly.half.norm().min(c.prism.half.norm());
            let within = |x: &Vector3<f64>| {
                sides.iter().all(|s| {
                    let (m, d) = mine_from_other.plane(&s.cut);
                    m.dot(x) - d <= beside
                })
            };
            self.rims(c, on, &here, &poly.planes[f], site, within);
        }
        if axial < ON_SIDE {
            let rod = Rod::new(&c.ends(), c.radius, on);
            self.rod_poly(&rod, poly, site + 2, Some(towards));
            let site = site + 2 + (poly.edges.len() + poly.vertices.len()) as u32;
            self.side_along_edges(&rod, poly, site, &towards);
        }
        if !as_prism {
            self.prism_if_deeper(search, overlap, spots, start);
        }
    }

    /// The touches of the prism instead of those from `start` on, if these are less deep than the two overlap.
    fn prism_if_deeper(&mut self, search: &Search<'_>, overlap: &Overlap, spots: &mut Spots, start: usize) {
        let here = Frame { r: nalgebra::Matrix3::identity(), p: Vector3::zeros() };
        let depths = self.out[start..].iter().map(|t| t.evaluate(&here, &self.a_from_b).depth);
        let deepest = depths.fold(f64::NEG_INFINITY, f64::max);
        if deepest < -0.7 * overlap.gap - self.margin {
            self.out.truncate(start);
            self.overlap(search, overlap, spots);
        }
    }

    /// The two ends of the side along edges that are parallel to it. Sites: two for each edge.
    fn side_along_edges(&mut self, rod: &Rod, poly: &Poly, site: u32, towards: &Vector3<f64>) {
        let poly_from_rod = match rod.on {
            Side::A => self.a_from_b.inverse(),
            Side::B => self.a_from_b,
        };
        let along = poly_from_rod.direction(&rod.line.along);
        for (i, edge) in poly.edges.iter().enumerate() {
            if edge.along.cross(&along).norm() > PARALLEL {
                continue;
            }
            let (v, w) = (poly.vertex(edge.ends[0]), poly.vertex(edge.ends[1]));
            for k in 0..2 {
                let center = rod.line.origin + rod.line.along * (f64::from(k) * rod.length);
                let x = poly_from_rod.point(&center);
                let t = edge.along.dot(&(x - v));
                let apart = x - v - edge.along * t;
                let distance = apart.norm();
                if t >= 0.0
                    && t <= (w - v).norm()
                    && distance < rod.line.radius + self.margin
                    && apart.dot(towards) > 0.5 * distance
                    && in_cone(poly, edge, &(apart / distance))
                {
                    let ball = Ball { center, radius: rod.line.radius };
                    let line = Line { origin: *v, along: edge.along, radius: 0.0 };
                    let feature = Feature::BallLine { on: rod.on, ball, line };
                    self.out.push(Touch::new(site + 2 * i as u32 + k, feature));
                }
            }
        }
    }

    /// Two sides. Sites: where they cross, then the ends of a along b and of b along a.
    fn sides(&mut self, c: &Cylinder, d: &Cylinder, site: u32) {
        let rods = [Rod::new(&c.ends(), c.radius, Side::A), Rod::new(&d.ends(), d.radius, Side::B)];
        self.rods_cross(&rods, site);
        let far = self.a_from_b.direction(&d.axis);
        if c.axis.cross(&far).norm() < PARALLEL {
            self.rod_ends(&rods[0], &rods[1], site + 1);
            self.rod_ends(&rods[1], &rods[0], site + 3);
        }
    }

    /// Where two thick segments cross, if they do.
    fn rods_cross(&mut self, [a, b]: &[Rod; 2], site: u32) {
        let (y, f) = (self.a_from_b.point(&b.line.origin), self.a_from_b.direction(&b.line.along));
        let (x, e) = (a.line.origin, a.line.along);
        let Some((s, t)) = crossing((&x, &e), (&y, &f)) else { return };
        let apart = x + e * s - y - f * t;
        if (0.0..=a.length).contains(&s)
            && (0.0..=b.length).contains(&t)
            && apart.norm() < a.line.radius + b.line.radius + self.margin
        {
            let sign = if e.cross(&f).dot(&apart) < 0.0 { -1.0 } else { 1.0 };
            let feature = Feature::LineLine { on: a.on, line: a.line, other: b.line, sign };
            self.out.push(Touch::new(site, feature));
        }
    }

    /// The ends of a rod, as balls, along the side of a rod parallel to it.
    fn rod_ends(&mut self, rod: &Rod, side: &Rod, site: u32) {
        let side_from_rod = match rod.on {
            Side::A => self.a_from_b.inverse(),
            Side::B => self.a_from_b,
        };
        for k in 0..2 {
            let center = rod.line.origin + rod.line.along * (f64::from(k) * rod.length);
            let w = side_from_rod.point(&center) - side.line.origin;
            let s = w.dot(&side.line.along);
            let distance = (w - side.line.along * s).norm();
            if (0.0..=side.length).contains(&s) && distance < rod.line.radius + side.line.radius + self.margin {
                let ball = Ball { center, radius: rod.line.radius };
                let feature = Feature::BallLine { on: rod.on, ball, line: side.line };
                self.out.push(Touch::new(site + k, feature));
            }
        }
    }

    /// The middle of a capsule against a cylinder; its ends are balls. Sites: 2 where it crosses the side, 3 and 4 the
    /// ends of the side along it, 5 and 6 the rims, then the edges and vertices of the prism.
    pub fn capsule_cylinder(&mut self, ends: &[Vector3<f64>; 2], radius: f64, c: &Cylinder, kind: &Kind) {
        let capsule = Rod::new(ends, radius, Side::A);
        let b_from_a = self.a_from_b.inverse();
        let at = |s: f64| nearest(kind, &b_from_a.point(&(ends[0] + capsule.line.along * s)), f64::INFINITY);
        // The distance along the capsule is a convex function: golden section.
        let ratio = (5.0_f64.sqrt() - 1.0) / 2.0;
        let (mut lo, mut hi) = (0.0, capsule.length);
        let distance = |s: f64| at(s).map_or(f64::INFINITY, |f| f.0);
        let (mut s, mut t) = (hi - ratio * (hi - lo), lo + ratio * (hi - lo));
        let (mut fs, mut ft) = (distance(s), distance(t));
        for _ in 0..40 {
            if fs < ft {
                (hi, t, ft) = (t, s, fs);
                s = hi - ratio * (hi - lo);
                fs = distance(s);
            } else {
                (lo, s, fs) = (s, t, ft);
                t = lo + ratio * (hi - lo);
                ft = distance(t);
            }
        }
        let middle = 0.5 * (lo + hi);
        let Some((gap, target)) = at(middle) else { return };
        if gap > radius + self.margin {
            return;
        }
        let inside = middle > 1e-6 * radius && middle < capsule.length - 1e-6 * radius;
        let start = self.out.len();
        let side = Rod::new(&c.ends(), c.radius, Side::B);
        let along = self.a_from_b.direction(&c.axis);
        let parallel = capsule.line.along.cross(&along).norm() < PARALLEL;
        let flat = capsule.line.along.dot(&along).abs() < LEVEL;
        match target {
            Target::Line(_) => {
                self.rods_cross(&[capsule, side], 2);
                if parallel {
                    self.rod_ends(&side, &capsule, 3);
                }
            }
            // Flat on the end it crosses the rim twice.
            _ if flat => self.rod_poly(&capsule, &c.prism, 7, None),
            Target::Rim(axis) if inside => {
                let site = if (axis.origin - c.center).dot(&c.axis) < 0.0 { 5 } else { 6 };
                let feature = Feature::LineRim { on: Side::A, line: capsule.line, axis, at: middle };
                self.out.push(Touch::new(site, feature));
            }
            _ => {}
        }
        // Its axis is inside, between an end and the side.
        if gap < 0.0 && inside && self.out.len() == start {
            let ball = Ball { center: ends[0] + capsule.line.along * middle, radius };
            self.out.push(Touch::new(2, target.feature(Side::A, ball)));
        }
    }
}
