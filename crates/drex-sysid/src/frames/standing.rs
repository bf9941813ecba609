//! On which faces a solid can stand: the faces of its convex hull with the centre of mass above them.

use drex_core::mesh::convex_hull;
use drex_core::{MassProperties, Object, TriMesh};
use nalgebra::{Matrix3, Point3, Vector3};

use crate::{Result, SysidError};

/// Ways to stand that differ by less count as one, radians: scans have rough bottoms.
const SAME: f64 = 0.26;
/// Ways to stand that are kept at most; a lying cylinder alone has 36.
const MOST: usize = 48;

/// A solid as far as standing and tipping need it, in the frame of its mesh.
#[derive(Debug, Clone)]
pub struct Standing {
    /// Convex hull, outward.
    pub hull: TriMesh,
    /// Mass properties at 1 kg and uniform density.
    pub unit: MassProperties,
    /// Ways to stand, lowest centre of mass first.
    pub faces: Vec<StandingFace>,
}

/// One way to stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandingFace {
    /// Up while it stands so, unit vector.
    pub up: Vector3<f64>,
    /// Height of the centre of mass above the table, metres.
    pub height_m: f64,
}

impl Standing {
    /// Hull, centre of mass and ways to stand of an object that is prepared for simulation.
    ///
    /// # Errors
    /// If it is flat or empty.
    pub fn of(object: &Object) -> Result<Self> {
        let points: Vec<Point3<f64>> = object.corners().copied().collect();
        let hull = convex_hull(&points).map_err(|_| SysidError::Object {
            what: "is flat or empty".into(),
            remedy: "give the surface of a solid, in metres".into(),
        })?;
        let unit = object.mass_properties.with_mass(1.0);
        let faces = ways_to_stand(&hull, &unit.center_of_mass);
        Ok(Self { hull, unit, faces })
    }

    /// Diagonal of the bounding box, metres.
    pub fn size_m(&self) -> f64 {
        self.hull.bounds().map_or(0.0, |(lo, hi)| (hi - lo).norm())
    }

    /// The least of `up · v` over the hull, metres: where the table is if `up` is up (mesh frame).
    pub fn lowest(&self, up: &Vector3<f64>) -> f64 {
        lowest(&self.hull, up)
    }

    /// The way to stand nearest to `up`; `up` itself where there is none nearby. A stated up is often an axis of the mesh, and the
    /// bottom of a scan is not square to it.
    pub fn firm(&self, up: &Vector3<f64>) -> Vector3<f64> {
        let nearest = self.faces.iter().min_by(|a, b| a.up.angle(up).total_cmp(&b.up.angle(up)));
        nearest.filter(|f| f.up.angle(up) < SAME).map_or(*up, |f| f.up)
    }

    /// How far the foot reaches from below the centre of mass in the horizontal direction `towards`, metres: over the
    /// points of the hull that are within `rise_m` of the lowest one. The object tips about that edge.
    pub fn foot_reach(&self, up: &Vector3<f64>, towards: &Vector3<f64>, rise_m: f64) -> f64 {
        let low = self.lowest(up);
        let com = self.unit.center_of_mass.coords;
        let foot = self.hull.vertices.iter().filter(|v| up.dot(&v.coords) <= low + rise_m);
        foot.map(|v| towards.dot(&(v.coords - com))).fold(f64::NEG_INFINITY, f64::max)
    }
}

/// Ways to stand: each face of the hull that has the centre of mass above it, and each axis, moved to where the foot is
/// firmest nearby, because the bottom of a scan is rough. Those that hardly differ are merged, the firmest stays.
fn ways_to_stand(hull: &TriMesh, com: &Point3<f64>) -> Vec<StandingFace> {
    let size = hull.bounds().map_or(0.0, |(lo, hi)| (hi - lo).norm());
    let foot = Foot { hull, com, rise: 0.015 * size };
    let faces = (0..hull.faces.len()).filter_map(|f| {
        let [a, b, c] = hull.triangle(f);
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0)?;
        let height = normal.dot(&(a - com));
        let below = com + normal * height;
        let inside = [(a, b), (b, c), (c, a)].iter().all(|(p, q)| normal.dot(&(q - p).cross(&(below - p))) >= 0.0);
        (inside && height > 0.0).then_some((height, -normal))
    });
    let mut starts: Vec<(f64, Vector3<f64>)> = faces.collect();
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut directions: Vec<Vector3<f64>> = Vec::new();
    for (_, up) in starts {
        if directions.len() < MOST && directions.iter().all(|d| d.angle(&up) > SAME) {
            directions.push(up);
        }
    }
    directions.extend([Vector3::x(), Vector3::y(), Vector3::z()].into_iter().flat_map(|a| [a, -a]));
    let mut firm: Vec<(f64, Vector3<f64>)> =
        directions.into_iter().map(|up| foot.firmest_near(up)).filter(|f| f.0 > 0.0).collect();
    firm.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<StandingFace> = Vec::new();
    for (_, up) in firm {
        if kept.iter().all(|k| k.up.angle(&up) > SAME) {
            kept.push(StandingFace { up, height_m: up.dot(&com.coords) - lowest(hull, &up) });
        }
    }
    kept.sort_by(|a, b| a.height_m.total_cmp(&b.height_m));
    kept
}

fn lowest(hull: &TriMesh, up: &Vector3<f64>) -> f64 {
    hull.vertices.iter().map(|v| up.dot(&v.coords)).fold(f64::INFINITY, f64::min)
}

/// What touches the table, roughly: the points within `rise` of the lowest.
struct Foot<'a> {
    hull: &'a TriMesh,
    com: &'a Point3<f64>,
    rise: f64,
}

impl Foot<'_> {
    /// By how much the object must be turned to tip over the nearest edge of its foot, rad; negative if it falls by itself.
    fn firmness(&self, up: &Vector3<f64>) -> f64 {
        let low = lowest(self.hull, up);
        let across = if up.x.abs() < 0.7 { up.cross(&Vector3::x()) } else { up.cross(&Vector3::y()) }.normalize();
        let along = up.cross(&across);
        let points: Vec<[f64; 2]> = self
            .hull
            .vertices
            .iter()
            .filter(|v| up.dot(&v.coords) <= low + self.rise)
            .map(|v| v - self.com)
            .map(|d| [across.dot(&d), along.dot(&d)])
            .collect();
        margin(points).atan2(up.dot(&self.com.coords) - low)
    }

    /// The firmest way to stand within some ten degrees of `up`, with its firmness.
    fn firmest_near(&self, up: Vector3<f64>) -> (f64, Vector3<f64>) {
        let (mut best, mut value) = (up, self.firmness(&up));
        let mut step = 0.08;
        while step > 0.004 {
            let side =
                if best.x.abs() < 0.7 { best.cross(&Vector3::x()) } else { best.cross(&Vector3::y()) }.normalize();
            let other = best.cross(&side);
            let moved = (0..8).map(|k| {
                let (s, c) = (std::f64::consts::FRAC_PI_4 * f64::from(k)).sin_cos();
                (best + (side * c + other * s) * step).normalize()
            });
            let next = moved.map(|d| (self.firmness(&d), d)).max_by(|a, b| a.0.total_cmp(&b.0));
            match next {
                Some((v, d)) if v > value + 1e-9 && d.angle(&up) < 0.35 => (value, best) = (v, d),
                _ => step *= 0.5,
            }
        }
        // Firmness says little about the direction in which the foot is long; the plane through the foot does.
        for _ in 0..3 {
            match self.plane(&best).map(|d| (self.firmness(&d), d)) {
                Some((v, d)) if v > 0.8 * value && d.angle(&up) < 0.35 => best = d,
                _ => break,
            }
        }
        (self.firmness(&best), best)
    }

    /// The plane nearest to the points of the foot, as its normal on the side of `up`.
    fn plane(&self, up: &Vector3<f64>) -> Option<Vector3<f64>> {
        let low = lowest(self.hull, up);
        let points: Vec<&Point3<f64>> =
            self.hull.vertices.iter().filter(|v| up.dot(&v.coords) <= low + self.rise).collect();
        let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len() as f64;
        let scatter: Matrix3<f64> = points.iter().map(|p| (p.coords - mean) * (p.coords - mean).transpose()).sum();
        let eigen = scatter.symmetric_eigen();
        let order = eigen.eigenvalues.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1))?;
        let normal: Vector3<f64> = eigen.eigenvectors.column(order.0).into();
        // Points on a line or few points have no plane.
        let mut sizes: Vec<f64> = eigen.eigenvalues.iter().copied().collect();
        sizes.sort_by(f64::total_cmp);
        (points.len() >= 3 && sizes[1] > 20.0 * sizes[0].max(0.0)).then(|| normal * normal.dot(up).signum())
    }
}

/// Distance from the origin to the nearest edge of the convex hull of `points`, negative outside of it.
fn margin(mut points: Vec<[f64; 2]>) -> f64 {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let turn = |o: [f64; 2], a: [f64; 2], b: [f64; 2]| (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut out: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while out.len() > 1 && turn(out[out.len() - 2], out[out.len() - 1], p) <= 0.0 {
                out.pop();
            }
            out.push(p);
        }
        out
    };
    let lower = chain(&mut points.iter().copied());
    let upper = chain(&mut points.iter().rev().copied());
    let edges = lower.windows(2).chain(upper.windows(2));
    let distance = |w: &[[f64; 2]]| {
        let length = (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1]);
        turn(w[0], w[1], [0.0, 0.0]) / length.max(1e-12)
    };
    // A point or a line carries nothing.
    if lower.len() + upper.len() < 5 { -1.0 } else { edges.map(distance).fold(f64::INFINITY, f64::min) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::ConvexPart;

    fn standing(hull: TriMesh) -> Standing {
        let properties = hull.mass_properties(1000.0).unwrap();
        Standing::of(&Object::of_parts(vec![ConvexPart::of_hull(hull)], properties)).unwrap()
    }

    /// A box of half extents `h` about `c`.
    fn cuboid(h: [f64; 3], c: [f64; 3]) -> TriMesh {
        let corner =
            |i: usize| Point3::from(Vector3::from_fn(|k, _| c[k] + if i >> k & 1 == 0 { -h[k] } else { h[k] }));
        convex_hull(&(0..8).map(corner).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn a_box_stands_on_six_faces_and_tips_over_its_edges() {
        let s = standing(cuboid([0.01, 0.02, 0.05], [0.3, 0.0, 0.1]));
        assert_eq!(s.faces.len(), 6, "{:?}", s.faces);
        assert!((s.unit.center_of_mass - Point3::new(0.3, 0.0, 0.1)).norm() < 1e-12);
        assert!((s.faces[0].height_m - 0.01).abs() < 1e-12 && s.faces[0].up.x.abs() > 0.99, "{:?}", s.faces);
        assert!((s.faces[5].height_m - 0.05).abs() < 1e-12 && s.faces[5].up.z.abs() > 0.99);
        assert!((s.foot_reach(&Vector3::z(), &Vector3::x(), 1e-3) - 0.01).abs() < 1e-12);
        assert!((s.lowest(&Vector3::z()) - 0.05).abs() < 1e-12);
    }

    #[test]
    fn a_leaning_tower_does_not_stand_on_its_small_foot() {
        // The top is sheared so far that the centre of mass is outside the foot.
        let mut mesh = cuboid([0.01, 0.01, 0.05], [0.0; 3]);
        for v in &mut mesh.vertices {
            v.x += 0.5 * v.z + 0.025;
        }
        let s = standing(mesh);
        assert!(s.faces.iter().all(|f| f.up.z < 0.99), "{:?}", s.faces);
    }
}
