//! A bounding volume hierarchy over triangles: nearest point, first hit of a ray, generalised winding number.

use nalgebra::{Matrix3, Point3, Vector3};

use drex_core::TriMesh;
use drex_core::mesh::nearest_on_triangle;

/// Largest number of triangles in a leaf.
const LEAF: usize = 4;
/// A subtree is replaced by its moments when the query is farther than this many of its radii.
const FAR: f64 = 2.0;
/// Meshes with fewer faces are searched quickly enough as they are.
const FEW: usize = 256;
/// Slivers, longer than this many times their height, are cut where they are longer than this part of the mesh.
const SLENDER: f64 = 8.0;
const LONG: f64 = 1.0 / 32.0;
/// Median splits halve the triangle count, so 2^64 triangles would be needed to go deeper.
const STACK: usize = 64;

/// Axis-aligned bounding box.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Aabb {
    pub lo: Point3<f64>,
    pub hi: Point3<f64>,
}

impl Aabb {
    pub fn empty() -> Self {
        Self { lo: Point3::from([f64::INFINITY; 3]), hi: Point3::from([f64::NEG_INFINITY; 3]) }
    }

    pub fn of(points: &[Point3<f64>]) -> Self {
        points.iter().fold(Self::empty(), |b, p| b.grown(p))
    }

    pub fn grown(self, p: &Point3<f64>) -> Self {
        Self { lo: self.lo.inf(p), hi: self.hi.sup(p) }
    }

    pub fn union(self, o: &Self) -> Self {
        Self { lo: self.lo.inf(&o.lo), hi: self.hi.sup(&o.hi) }
    }

    pub fn fattened(self, by: f64) -> Self {
        let d = Vector3::repeat(by);
        Self { lo: self.lo - d, hi: self.hi + d }
    }

    pub fn overlaps(&self, o: &Self) -> bool {
        (0..3).all(|k| self.lo[k] <= o.hi[k] && o.lo[k] <= self.hi[k])
    }

    pub fn contains(&self, o: &Self) -> bool {
        (0..3).all(|k| self.lo[k] <= o.lo[k] && o.hi[k] <= self.hi[k])
    }

    fn distance_squared(&self, p: &Point3<f64>) -> f64 {
        (0..3).map(|k| (self.lo[k] - p[k]).max(p[k] - self.hi[k]).max(0.0).powi(2)).sum()
    }

    /// Entry parameter of a ray, if it meets the box before `t_max`.
    fn ray_entry(&self, origin: &Point3<f64>, inverse: &Vector3<f64>, t_max: f64) -> Option<f64> {
        let (mut t0, mut t1) = (0.0_f64, t_max);
        for k in 0..3 {
            let a = (self.lo[k] - origin[k]) * inverse[k];
            let b = (self.hi[k] - origin[k]) * inverse[k];
            // A ray inside a slab's plane gives NaN (0 · ∞) for that plane and says nothing about the other one.
            if a.is_nan() || b.is_nan() {
                continue;
            }
            t0 = t0.max(a.min(b));
            t1 = t1.min(a.max(b));
        }
        (t0 <= t1).then_some(t0)
    }
}

#[derive(Debug, Clone)]
struct Node {
    bounds: Aabb,
    /// First triangle (leaf) or right child (inner node; the left child follows its parent).
    first: u32,
    /// Number of triangles; 0 for an inner node.
    count: u32,
    /// Area-weighted centre of the triangles and how far their corners are from it.
    center: Point3<f64>,
    radius: f64,
    far: Far,
}

/// The winding number of a group of triangles seen from far away: with m = x - centre, the moments
/// ∫ n dA, ∫ m nᵀ dA and ∫ m mᵀ ⊗ n dA, the last as the two contractions that the Taylor series asks for.
#[derive(Debug, Clone)]
struct Far {
    first: Vector3<f64>,
    second: Matrix3<f64>,
    /// 2 Σ_j ∫ m_i m_j n_j + Σ_j ∫ m_j m_j n_i.
    traces: Vector3<f64>,
    /// Coefficients of the cubic form Σ ∫ m_i m_j n_k u_i u_j u_k: xxx xxy xxz xyy xyz xzz yyy yyz yzz zzz.
    cubic: [f64; 10],
}

impl Far {
    fn none() -> Self {
        Self { first: Vector3::zeros(), second: Matrix3::zeros(), traces: Vector3::zeros(), cubic: [0.0; 10] }
    }

    /// Adds a triangle, corners relative to the centre.
    fn add(&mut self, [a, b, c]: [Vector3<f64>; 3]) {
        let n = (b - a).cross(&(c - a)) * 0.5;
        let s = a + b + c;
        self.first += n;
        self.second += s * n.transpose() / 3.0;
        // ∫ m mᵀ over a triangle of unit area.
        let m = (s * s.transpose() + a * a.transpose() + b * b.transpose() + c * c.transpose()) / 12.0;
        self.traces += m * n * 2.0 + n * m.trace();
        let t = |i: usize, j: usize, k: usize| m[(i, j)] * n[k];
        let pair = |i: usize, k: usize| 2.0 * t(i, k, i) + t(i, i, k);
        let terms = [
            t(0, 0, 0),
            pair(0, 1),
            pair(0, 2),
            pair(1, 0),
            2.0 * (t(0, 1, 2) + t(0, 2, 1) + t(1, 2, 0)),
            pair(2, 0),
            t(1, 1, 1),
            pair(1, 2),
            pair(2, 1),
            t(2, 2, 2),
        ];
        for (sum, term) in self.cubic.iter_mut().zip(terms) {
            *sum += term;
        }
    }

    /// Solid angle seen from a point; `u` and `d` are direction and distance from there to the centre.
    fn solid_angle(&self, u: &Vector3<f64>, d: f64) -> f64 {
        let (x, y, z) = (u.x, u.y, u.z);
        let k = &self.cubic;
        let cubic = x * (x * (k[0] * x + k[1] * y + k[2] * z) + y * (k[3] * y + k[4] * z) + k[5] * z * z)
            + y * (y * (k[6] * y + k[7] * z) + k[8] * z * z)
            + k[9] * z * z * z;
        let inverse = 1.0 / d;
        let order_1 = self.second.trace() - 3.0 * u.dot(&(self.second * u));
        let order_2 = 7.5 * cubic - 1.5 * self.traces.dot(u);
        inverse * inverse * (self.first.dot(u) + inverse * (order_1 + inverse * order_2))
    }
}

/// A nearest point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Nearest {
    pub face: u32,
    pub point: Point3<f64>,
    pub distance_squared: f64,
}

/// Triangles of one mesh in a tree. Faces keep their numbers in the mesh; one that was cut is there several times.
#[derive(Debug, Clone)]
pub(crate) struct Bvh {
    nodes: Vec<Node>,
    /// Corners in tree order and the face each came from.
    triangles: Vec<[Point3<f64>; 3]>,
    faces: Vec<u32>,
}

impl Bvh {
    /// Builds the tree over all faces of `mesh`.
    pub fn new(mesh: &TriMesh) -> Self {
        Self::over(mesh, (0..mesh.faces.len() as u32).collect())
    }

    /// Builds the tree over some faces of `mesh`.
    pub fn over(mesh: &TriMesh, faces: Vec<u32>) -> Self {
        let triangles = faces.iter().map(|&f| mesh.triangle(f as usize)).collect();
        Self::of_triangles(triangles, &faces)
    }

    /// As [`Bvh::new`], with slivers cut across.
    ///
    /// The slivers of a fan all reach from its hub to its rim, so that no box holds few of them: a query near the fan would
    /// have to look at each. For nearest points, rays and winding numbers the parts of a face do as well as the face.
    pub fn cut(mesh: &TriMesh) -> Self {
        Self::cut_over(mesh, (0..mesh.faces.len() as u32).collect())
    }

    /// As [`Bvh::over`], with slivers cut across.
    pub fn cut_over(mesh: &TriMesh, faces: Vec<u32>) -> Self {
        if faces.len() < FEW {
            return Self::over(mesh, faces);
        }
        let sliver = |t: &[Point3<f64>; 3]| {
            let (_, longest) = longest_side(t);
            let height = (t[1] - t[0]).cross(&(t[2] - t[0])).norm() / longest;
            (longest > SLENDER * height).then_some(longest)
        };
        let of_faces = || faces.iter().map(|&f| mesh.triangle(f as usize));
        let bounds = of_faces().fold(Aabb::empty(), |b, t| b.union(&Aabb::of(&t)));
        let total: f64 = of_faces().filter_map(|t| sliver(&t)).sum();
        // No more parts than some per face, whatever the mesh.
        let long = (LONG * (bounds.hi - bounds.lo).norm()).max(total / (4 * faces.len()) as f64);
        let (mut triangles, mut numbers) = (Vec::with_capacity(faces.len()), Vec::with_capacity(faces.len()));
        let mut open = Vec::new();
        for &f in &faces {
            open.push(mesh.triangle(f as usize));
            while let Some(t) = open.pop() {
                if sliver(&t).is_some_and(|longest| longest > long) {
                    let (k, _) = longest_side(&t);
                    let (p, q, apex) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
                    let middle = nalgebra::center(&p, &q);
                    open.extend([[middle, q, apex], [p, middle, apex]]);
                } else {
                    triangles.push(t);
                    numbers.push(f);
                }
            }
        }
        Self::of_triangles(triangles, &numbers)
    }

    /// Builds the tree; `numbers` says of which face each triangle is.
    fn of_triangles(triangles: Vec<[Point3<f64>; 3]>, numbers: &[u32]) -> Self {
        let mut order: Vec<u32> = (0..triangles.len() as u32).collect();
        let mut nodes = Vec::with_capacity(2 * order.len() / LEAF + 1);
        if !order.is_empty() {
            build(&triangles, &mut order, 0, &mut nodes);
        }
        let faces = order.iter().map(|&t| numbers[t as usize]).collect();
        Self { nodes, triangles: order.iter().map(|&t| triangles[t as usize]).collect(), faces }
    }

    /// The nearest point of the mesh closer than `within` (use infinity for "anywhere").
    pub fn nearest(&self, p: &Point3<f64>, within: f64) -> Option<Nearest> {
        let mut best = within * within;
        let mut found = None;
        let mut stack = [(0u32, 0.0_f64); STACK];
        let mut top = usize::from(!self.nodes.is_empty());
        while top > 0 {
            top -= 1;
            let (id, bound) = stack[top];
            if bound >= best {
                continue;
            }
            let node = &self.nodes[id as usize];
            if node.count > 0 {
                for t in node.first as usize..(node.first + node.count) as usize {
                    let q = nearest_on_triangle(p, &self.triangles[t]);
                    let d = (p - q).norm_squared();
                    if d < best {
                        best = d;
                        found = Some(Nearest { face: self.faces[t], point: q, distance_squared: d });
                    }
                }
                continue;
            }
            let near = (id + 1, self.nodes[id as usize + 1].bounds.distance_squared(p));
            let far = (node.first, self.nodes[node.first as usize].bounds.distance_squared(p));
            let (near, far) = if near.1 <= far.1 { (near, far) } else { (far, near) };
            for child in [far, near] {
                if child.1 < best {
                    stack[top] = child;
                    top += 1;
                }
            }
        }
        found
    }

    /// The first face hit by `origin + t direction`, 0 <= t <= `t_max`, with its t.
    pub fn ray(&self, origin: &Point3<f64>, direction: &Vector3<f64>, t_max: f64) -> Option<(u32, f64)> {
        let inverse = direction.map(|d| 1.0 / d);
        let mut best = t_max;
        let mut found = None;
        let mut stack = [0u32; STACK];
        let mut top = usize::from(!self.nodes.is_empty());
        while top > 0 {
            top -= 1;
            let id = stack[top];
            let node = &self.nodes[id as usize];
            if node.bounds.ray_entry(origin, &inverse, best).is_none() {
                continue;
            }
            if node.count > 0 {
                for t in node.first as usize..(node.first + node.count) as usize {
                    if let Some(hit) = ray_triangle(origin, direction, &self.triangles[t])
                        && hit <= best
                    {
                        best = hit;
                        found = Some((self.faces[t], hit));
                    }
                }
                continue;
            }
            stack[top] = node.first;
            stack[top + 1] = id + 1;
            top += 2;
        }
        found
    }

    /// Calls `visit` with every face whose box overlaps `region`, until it answers true.
    pub fn any_in(&self, region: &Aabb, mut visit: impl FnMut(u32, &[Point3<f64>; 3]) -> bool) -> bool {
        let mut stack = [0u32; STACK];
        let mut top = usize::from(!self.nodes.is_empty());
        while top > 0 {
            top -= 1;
            let id = stack[top];
            let node = &self.nodes[id as usize];
            if !node.bounds.overlaps(region) {
                continue;
            }
            if node.count > 0 {
                for t in node.first as usize..(node.first + node.count) as usize {
                    let tri = &self.triangles[t];
                    if Aabb::of(tri).overlaps(region) && visit(self.faces[t], tri) {
                        return true;
                    }
                }
                continue;
            }
            stack[top] = node.first;
            stack[top + 1] = id + 1;
            top += 2;
        }
        false
    }

    /// Generalised winding number at `q` (Jacobson et al. 2013), far subtrees by a Taylor series to second
    /// order (Barill et al., "Fast Winding Numbers for Soups and Clouds", 2018, section 3).
    pub fn winding(&self, q: &Point3<f64>) -> f64 {
        let mut sum = 0.0;
        let mut near = AngleSum::new();
        let mut stack = [0u32; STACK];
        let mut top = usize::from(!self.nodes.is_empty());
        while top > 0 {
            top -= 1;
            let id = stack[top];
            let node = &self.nodes[id as usize];
            let r = node.center - q;
            let d2 = r.norm_squared();
            if d2 > (FAR * node.radius).powi(2) {
                let d = d2.sqrt();
                sum += node.far.solid_angle(&(r / d), d);
                continue;
            }
            if node.count > 0 {
                for t in node.first as usize..(node.first + node.count) as usize {
                    let (sine, cosine) = half_solid_angle(q, &self.triangles[t]);
                    near.add(sine, cosine);
                }
                continue;
            }
            stack[top] = node.first;
            stack[top + 1] = id + 1;
            top += 2;
        }
        (sum + 2.0 * near.total()) / (4.0 * std::f64::consts::PI)
    }
}

/// A sum of angles between -π and π, each given by multiples of its sine and cosine: one arc tangent for all of them.
struct AngleSum {
    /// The sum's sine and cosine, scaled, and how often it went round.
    sine: f64,
    cosine: f64,
    turns: i32,
}

impl AngleSum {
    fn new() -> Self {
        Self { sine: 0.0, cosine: 1.0, turns: 0 }
    }

    fn add(&mut self, sine: f64, cosine: f64) {
        let (s, c) = (self.sine * cosine + self.cosine * sine, self.cosine * cosine - self.sine * sine);
        let scale = s.abs() + c.abs();
        if !(scale > 0.0) {
            return; // the query is a corner of the triangle
        }
        match (self.sine < 0.0, sine < 0.0, s < 0.0) {
            (false, false, true) => self.turns += 1,
            (true, true, false) => self.turns -= 1,
            _ => {}
        }
        (self.sine, self.cosine) = (s / scale, c / scale);
    }

    fn total(&self) -> f64 {
        self.sine.atan2(self.cosine) + 2.0 * std::f64::consts::PI * f64::from(self.turns)
    }
}

/// The side of a triangle that is longest, counted by the corner where it begins, and its length.
fn longest_side(t: &[Point3<f64>; 3]) -> (usize, f64) {
    let length = |k: usize| (t[(k + 1) % 3] - t[k]).norm();
    (1..3).fold((0, length(0)), |best, k| if length(k) > best.1 { (k, length(k)) } else { best })
}

/// Builds the subtree over some triangles (reordered), the first of which is in place `offset`.
fn build(triangles: &[[Point3<f64>; 3]], faces: &mut [u32], offset: usize, nodes: &mut Vec<Node>) -> usize {
    let id = nodes.len();
    nodes.push(describe(triangles, faces));
    if faces.len() <= LEAF {
        nodes[id].first = offset as u32;
        nodes[id].count = faces.len() as u32;
        return id;
    }
    let centroid = |f: u32| {
        let [a, b, c] = triangles[f as usize];
        (a.coords + b.coords + c.coords) / 3.0
    };
    let spread = faces.iter().fold(Aabb::empty(), |b, &f| b.grown(&centroid(f).into()));
    let axis = (spread.hi - spread.lo).imax();
    let middle = faces.len() / 2;
    // The face number breaks ties, so that the tree does not depend on the sort.
    faces.select_nth_unstable_by(middle, |&f, &g| centroid(f)[axis].total_cmp(&centroid(g)[axis]).then(f.cmp(&g)));
    let (left, right) = faces.split_at_mut(middle);
    build(triangles, left, offset, nodes);
    let second = build(triangles, right, offset + middle, nodes);
    nodes[id].first = second as u32;
    id
}

fn describe(triangles: &[[Point3<f64>; 3]], faces: &[u32]) -> Node {
    let mut bounds = Aabb::empty();
    let (mut area, mut weighted) = (0.0, Vector3::zeros());
    for &f in faces {
        let [a, b, c] = triangles[f as usize];
        bounds = bounds.union(&Aabb::of(&[a, b, c]));
        let s = (b - a).cross(&(c - a)).norm();
        area += s;
        weighted += (a.coords + b.coords + c.coords) * (s / 3.0);
    }
    let center = if area > 0.0 { Point3::from(weighted / area) } else { nalgebra::center(&bounds.lo, &bounds.hi) };
    let (mut far, mut radius) = (Far::none(), 0.0_f64);
    for &f in faces {
        let corners = triangles[f as usize].map(|p| p - center);
        far.add(corners);
        radius = corners.iter().fold(radius, |r, c| r.max(c.norm()));
    }
    Node { bounds, first: 0, count: 0, center, radius, far }
}

/// Sine and cosine of half the solid angle of a triangle seen from `q` (van Oosterom and Strackee 1983), positive from behind, both
/// times the same factor.
fn half_solid_angle(q: &Point3<f64>, [a, b, c]: &[Point3<f64>; 3]) -> (f64, f64) {
    let (a, b, c) = (a - q, b - q, c - q);
    let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
    let numerator = a.dot(&b.cross(&c));
    let denominator = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
    (numerator, denominator)
}

/// Ray parameter where the ray meets the triangle (Möller and Trumbore 1997), both sides.
fn ray_triangle(origin: &Point3<f64>, direction: &Vector3<f64>, [a, b, c]: &[Point3<f64>; 3]) -> Option<f64> {
    let (e1, e2) = (b - a, c - a);
    let p = direction.cross(&e2);
    let det = e1.dot(&p);
    if det == 0.0 {
        return None;
    }
    let s = origin - a;
    let u = s.dot(&p) / det;
    let q = s.cross(&e1);
    let v = direction.dot(&q) / det;
    // A hair of tolerance, so that rays through a shared edge do not slip between its triangles.
    let hair = -1e-12;
    (u >= hair && v >= hair && u + v <= 1.0 - hair).then(|| e2.dot(&q) / det).filter(|t| *t >= 0.0)
}

/// Distance between a segment and a triangle; zero if they meet.
pub(crate) fn segment_triangle_distance(p: &Point3<f64>, q: &Point3<f64>, tri: &[Point3<f64>; 3]) -> f64 {
    let along = q - p;
    if ray_triangle(p, &along, tri).is_some_and(|t| t <= 1.0) {
        return 0.0;
    }
    let ends = (p - nearest_on_triangle(p, tri)).norm().min((q - nearest_on_triangle(q, tri)).norm());
    (0..3).map(|k| segment_segment_distance(p, q, &tri[k], &tri[(k + 1) % 3])).fold(ends, f64::min)
}

/// Distance between two segments (Ericson, section 5.1.9).
fn segment_segment_distance(p1: &Point3<f64>, q1: &Point3<f64>, p2: &Point3<f64>, q2: &Point3<f64>) -> f64 {
    let (d1, d2, r) = (q1 - p1, q2 - p2, p1 - p2);
    let (a, e, f) = (d1.norm_squared(), d2.norm_squared(), d2.dot(&r));
    if a == 0.0 || e == 0.0 {
        return r.norm().min((q1 - p2).norm()).min((p1 - q2).norm());
    }
    let (b, c) = (d1.dot(&d2), d1.dot(&r));
    let denominator = a * e - b * b;
    let mut s = if denominator > 0.0 { ((b * f - c * e) / denominator).clamp(0.0, 1.0) } else { 0.0 };
    let mut t = (b * s + f) / e;
    if t < 0.0 {
        t = 0.0;
        s = (-c / a).clamp(0.0, 1.0);
    } else if t > 1.0 {
        t = 1.0;
        s = ((b - c) / a).clamp(0.0, 1.0);
    }
    ((p1 + d1 * s) - (p2 + d2 * t)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes;

    #[test]
    fn winding_of_a_sphere_is_one_inside_and_zero_outside() {
        let bvh = Bvh::new(&shapes::sphere(0.05, 4));
        for (r, expected) in [(0.0, 1.0), (0.03, 1.0), (0.0495, 1.0), (0.0505, 0.0), (0.2, 0.0)] {
            for d in [Vector3::x(), Vector3::new(0.6, 0.0, 0.8), Vector3::new(-0.48, 0.6, 0.64)] {
                let w = bvh.winding(&Point3::from(d * r));
                assert!((w - expected).abs() < 5e-3, "radius {r}: {w}");
            }
        }
    }

    #[test]
    fn rays_in_a_plane_of_box_sides_and_vertices_hit() {
        let bvh = Bvh::new(&shapes::sphere(0.05, 3));
        for i in 0..100 {
            let x = -0.049 + 0.098 * f64::from(i) / 99.0;
            let hit = bvh.ray(&Point3::new(x, 0.0, -1.0), &Vector3::z(), f64::INFINITY);
            assert!(hit.is_some_and(|(_, t)| t < 1.0), "{x} {hit:?}");
        }
    }

    #[test]
    fn fast_winding_agrees_with_the_exact_sum_on_an_open_mesh() {
        let mut mesh = shapes::sphere(0.05, 4);
        mesh.faces.retain(|f| f.iter().any(|&v| mesh.vertices[v as usize].z < 0.02));
        let bvh = Bvh::new(&mesh);
        let mut worst = 0.0_f64;
        for i in 0..500 {
            let p = Point3::from(shapes::low_discrepancy(i).map(|c| (c - 0.5) * 0.15));
            let half = |f: usize| {
                let (sine, cosine) = half_solid_angle(&p, &mesh.triangle(f));
                sine.atan2(cosine)
            };
            let exact = (0..mesh.faces.len()).map(half).sum::<f64>() / (2.0 * std::f64::consts::PI);
            worst = worst.max((bvh.winding(&p) - exact).abs());
        }
        assert!(worst < 5e-3, "{worst}");
    }

    #[test]
    fn nearest_and_ray_agree_with_brute_force() {
        let mesh = shapes::sphere(0.05, 3);
        let bvh = Bvh::new(&mesh);
        for i in 0..200 {
            let p = Point3::from(shapes::low_discrepancy(i).map(|c| (c - 0.5) * 0.2));
            let brute = (0..mesh.faces.len())
                .map(|f| (p - nearest_on_triangle(&p, &mesh.triangle(f))).norm_squared())
                .fold(f64::INFINITY, f64::min);
            assert_eq!(bvh.nearest(&p, f64::INFINITY).unwrap().distance_squared, brute);
            let d = Vector3::from(shapes::low_discrepancy(i + 1000).map(|c| c - 0.5)).normalize();
            let brute = (0..mesh.faces.len())
                .filter_map(|f| ray_triangle(&p, &d, &mesh.triangle(f)))
                .fold(f64::INFINITY, f64::min);
            assert_eq!(bvh.ray(&p, &d, f64::INFINITY).map_or(f64::INFINITY, |h| h.1), brute);
        }
    }
}
