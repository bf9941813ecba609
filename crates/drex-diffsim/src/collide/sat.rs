//! Two convex polyhedra: the direction in which they overlap least, among the normals of faces and the cross products of
//! edges (separating axis theorem, with the Gauss map to tell which edges can meet; D. Gregorius, "The separating axis
//! test between convex polyhedra", GDC 2013).

use nalgebra::Vector3;

use super::capsule::crossing;
use super::feature::{Feature, Frame, Line, Plane, Side, Touch};
use super::geom::Poly;
use super::manifold::{BESIDE, Half, Spots};
use super::{CollideWork, Pair};

/// Edges whose angle has a smaller sine are parallel: the normals of faces stand for them.
const PARALLEL: f64 = 1e-3;
/// Cosine of the angle within which an edge lies flat on a face and touches it at both ends.
const FLAT_COS: f64 = 0.9994;
/// Overlaps that differ by less (relatively) are alike; the face of larger area is taken then.
const ALIKE: f64 = 0.02;

/// Buffers of the search.
#[derive(Debug, Default)]
pub(crate) struct Buffers {
    moved: Moved,
    edges: NearEdges,
}

/// The second polyhedron in the frame of the first.
#[derive(Debug, Default)]
struct Moved {
    vertices: Vec<Vector3<f64>>,
    planes: Vec<Plane>,
}

/// Edges of both near the overlap.
pub(super) type NearEdges = [Vec<Near>; 2];

/// An edge near the overlap, in the frame of the first body.
#[derive(Debug, Clone, Copy)]
pub(super) struct Near {
    index: u32,
    start: Vector3<f64>,
    along: Vector3<f64>,
    /// Box around it.
    lo: Vector3<f64>,
    hi: Vector3<f64>,
    /// Normals of its faces, and their cross product.
    n: [Vector3<f64>; 2],
    arc: Vector3<f64>,
}

/// A direction from the first to the second, and how far they are apart along it (negative: they overlap).
#[derive(Debug, Clone, Copy)]
struct Axis {
    gap: f64,
    normal: Vector3<f64>,
    face: u32,
}

/// Where two polyhedra overlap least.
#[derive(Debug, Clone, Copy)]
pub(super) struct Overlap {
    /// Negative: minus the overlap.
    gap: f64,
    /// From the first to the second, in the frame of the first.
    pub normal: Vector3<f64>,
    /// Gaps that differ by less are alike.
    alike: f64,
    least: Least,
}

/// Which features overlap least.
#[derive(Debug, Clone, Copy)]
enum Least {
    /// A face of the first (0) or the second (1).
    Face(usize, u32),
    /// Two edges, by their place among those near the overlap; and a face of one of them that the other lies flat on.
    Edges([usize; 2], Option<(usize, u32)>),
}

/// Two polyhedra in a common frame.
pub(super) struct Search<'a> {
    pub halves: [Half<'a>; 2],
    pub edges: &'a mut NearEdges,
}

impl<'a> Search<'a> {
    /// The one with fewer vertices is moved into the frame of the other.
    pub fn new(a: &'a Poly, b: &'a Poly, a_from_b: &Frame<f64>, work: &'a mut Buffers) -> Self {
        let (p, q, p_from_q, on) = if a.vertices.len() >= b.vertices.len() {
            (a, b, *a_from_b, [Side::A, Side::B])
        } else {
            (b, a, a_from_b.inverse(), [Side::B, Side::A])
        };
        let Moved { vertices, planes } = &mut work.moved;
        vertices.clear();
        vertices.extend(q.vertices.iter().map(|v| p_from_q.point(v)));
        planes.clear();
        planes.extend(q.planes.iter().map(|plane| p_from_q.plane(plane)));
        let first_site = p.vertices.len() as u32;
        let second = Half { poly: q, vertices, planes, frame: p_from_q, on: on[1], first_site };
        let frame = Frame { r: nalgebra::Matrix3::identity(), p: Vector3::zeros() };
        let first = Half { poly: p, vertices: &p.vertices, planes: &p.planes, frame, on: on[0], first_site: 0 };
        Self { halves: [first, second], edges: &mut work.edges }
    }

    /// The half that is on the body `on`.
    pub fn half(&self, on: Side) -> &Half<'a> {
        &self.halves[usize::from(self.halves[0].on != on)]
    }

    /// The first site that is no vertex and no pair of edges.
    pub fn sites(&self) -> u32 {
        let [p, q] = [self.halves[0].poly, self.halves[1].poly];
        (p.vertices.len() + q.vertices.len() + p.edges.len() * q.edges.len()) as u32
    }

    /// Where they overlap least; `None` if they are farther apart than `margin`.
    pub fn least_overlap(&mut self, margin: f64) -> Option<Overlap> {
        let [p, q] = &self.halves;
        let on_p = best_face(p.planes, q.vertices, &q.frame.point(&q.poly.middle), margin)?;
        let on_q = best_face(q.planes, p.vertices, &p.poly.middle, margin)?;
        let on_q = Axis { normal: -on_q.normal, ..on_q };
        let widest = if on_p.gap >= on_q.gap { &on_p } else { &on_q };
        let alike = ALIKE * widest.gap.abs() + 1e-7 * p.poly.half.norm().min(q.poly.half.norm());
        near_edges(p, q, widest, margin, self.edges);
        if let Some((axis, i, j)) = best_edges(self.edges, [p.vertices, q.vertices], widest.gap + alike) {
            if axis.gap > margin {
                return None;
            }
            let (e, f) = (&self.edges[0][i], &self.edges[1][j]);
            // A face that lies flat on the edge is touched at more than one point.
            let faces = [(e.n[0], 0, 0), (e.n[1], 0, 1), (-f.n[0], 1, 0), (-f.n[1], 1, 1)];
            let flattest = faces.into_iter().max_by(|a, b| a.0.dot(&axis.normal).total_cmp(&b.0.dot(&axis.normal)));
            let flat = flattest.filter(|(n, _, _)| n.dot(&axis.normal) > FLAT_COS).map(|(_, which, k)| {
                let edge = [e.index, f.index][which];
                (which, self.halves[which].poly.edges[edge as usize].faces[k])
            });
            return Some(Overlap { gap: axis.gap, normal: axis.normal, alike, least: Least::Edges([i, j], flat) });
        }
        let first = if (on_p.gap - on_q.gap).abs() <= alike {
            p.poly.areas[on_p.face as usize] >= q.poly.areas[on_q.face as usize] * (1.0 - 1e-9)
        } else {
            on_p.gap > on_q.gap
        };
        let (which, axis) = if first { (0, on_p) } else { (1, on_q) };
        Some(Overlap { gap: axis.gap, normal: axis.normal, alike, least: Least::Face(which, axis.face) })
    }
}

impl Pair<'_> {
    /// Sites: the vertices of the polyhedron with more of them, those of the other, then pairs of edges.
    pub fn poly_poly(&mut self, a: &Poly, b: &Poly, work: &mut CollideWork) {
        if boxes_gap(a, b, &self.a_from_b) > self.margin {
            return;
        }
        let mut search = Search::new(a, b, &self.a_from_b, &mut work.sat);
        if let Some(overlap) = search.least_overlap(self.margin) {
            self.overlap(&search, &overlap, &mut work.spots);
        }
    }

    /// The touches of two polyhedra that overlap least in this way.
    pub fn overlap(&mut self, search: &Search<'_>, overlap: &Overlap, spots: &mut Spots) {
        let halves = &search.halves;
        let [near_p, near_q] = &*search.edges;
        match overlap.least {
            Least::Edges([i, j], flat) => {
                let start = self.out.len();
                if let Some((which, face)) = flat
                    && self.manifold(&halves[which], &halves[1 - which], face, spots)
                        >= -0.5 * overlap.gap - overlap.alike
                {
                    return;
                }
                self.out.truncate(start);
                self.edge_pair(halves, (&near_p[i], &near_q[j]), &overlap.normal);
            }
            Least::Face(which, face) => {
                let found = self.manifold(&halves[which], &halves[1 - which], face, spots);
                // Nothing over the face: two edges, whose overlap is hardly less.
                if found == f64::NEG_INFINITY
                    && overlap.gap < 0.0
                    && let [p, q] = halves
                    && let Some((axis, i, j)) = best_edges(search.edges, [p.vertices, q.vertices], f64::NEG_INFINITY)
                {
                    self.edge_pair(halves, (&near_p[i], &near_q[j]), &axis.normal);
                }
            }
        }
    }

    /// Two edges, if they cross within their lengths.
    fn edge_pair(&mut self, [p, q]: &[Half<'_>; 2], (e, f): (&Near, &Near), normal: &Vector3<f64>) {
        let Some((s, t)) = crossing((&e.start, &e.along), (&f.start, &f.along)) else { return };
        let beside = BESIDE * p.poly.half.norm().min(q.poly.half.norm());
        let line = |half: &Half<'_>, edge: u32, s: f64| {
            let edge = &half.poly.edges[edge as usize];
            let length = (half.poly.vertex(edge.ends[1]) - half.poly.vertex(edge.ends[0])).norm();
            let line = Line { origin: *half.poly.vertex(edge.ends[0]), along: edge.along, radius: 0.0 };
            (s > -beside && s < length + beside).then_some(line)
        };
        let (Some(line), Some(other)) = (line(p, e.index, s), line(q, f.index, t)) else { return };
        // The normal of the contact points from the second towards the first.
        let sign = if e.along.cross(&f.along).dot(normal) < 0.0 { 1.0 } else { -1.0 };
        let vertices = (p.poly.vertices.len() + q.poly.vertices.len()) as u32;
        let site = vertices + e.index * q.poly.edges.len() as u32 + f.index;
        self.out.push(Touch::new(site, Feature::LineLine { on: p.on, line, other, sign }));
    }
}

/// How far the bounding boxes are apart, at the best of the directions of their sides.
pub(super) fn boxes_gap(p: &Poly, q: &Poly, p_from_q: &Frame<f64>) -> f64 {
    let turned = p.axes.tr_mul(&p_from_q.r) * q.axes;
    let between = p.axes.tr_mul(&(p_from_q.point(&q.middle) - p.middle));
    let size = turned.abs();
    let along_p = between.abs() - p.half - size * q.half;
    let along_q = turned.tr_mul(&between).abs() - q.half - size.tr_mul(&p.half);
    along_p.max().max(along_q.max())
}

/// The face plane that all `vertices` are farthest in front of; `None` if farther than `margin`. `hint` is a point amid
/// the vertices.
fn best_face(planes: &[Plane], vertices: &[Vector3<f64>], hint: &Vector3<f64>, margin: f64) -> Option<Axis> {
    let lowest = |n: &Vector3<f64>| {
        let mut best = (f64::INFINITY, 0);
        for (i, v) in vertices.iter().enumerate() {
            let height = n.dot(v);
            if height < best.0 {
                best = (height, i);
            }
        }
        best
    };
    let front = |f: &usize| planes[*f].0.dot(hint) - planes[*f].1;
    let first = (0..planes.len()).max_by(|i, j| front(i).total_cmp(&front(j)))?;
    let (height, v) = lowest(&planes[first].0);
    let mut best = Axis { gap: height - planes[first].1, normal: planes[first].0, face: first as u32 };
    let mut witness = [vertices[v], *hint];
    for (f, (n, d)) in planes.iter().enumerate() {
        if best.gap > margin {
            return None;
        }
        // Any point of the other body bounds the gap from above.
        if witness.iter().any(|w| n.dot(w) - d <= best.gap) {
            continue;
        }
        let (height, v) = lowest(n);
        witness = [vertices[v], witness[0]];
        if height - d > best.gap {
            best = Axis { gap: height - d, normal: *n, face: f as u32 };
        }
    }
    (best.gap <= margin).then_some(best)
}

/// The edges of both that can carry an overlap not larger than that along `axis`.
fn near_edges(p: &Half<'_>, q: &Half<'_>, axis: &Axis, margin: f64, out: &mut NearEdges) {
    let reach = (-axis.gap).max(0.0) + margin + 1e-9 * p.poly.half.max();
    let n = &axis.normal;
    let extent = |v: &[Vector3<f64>]| {
        v.iter().fold((v[0], v[0], n.dot(&v[0]), n.dot(&v[0])), |(lo, hi, least, most), x| {
            (lo.inf(x), hi.sup(x), least.min(n.dot(x)), most.max(n.dot(x)))
        })
    };
    let (p_lo, p_hi, _, p_most) = extent(p.vertices);
    let (q_lo, q_hi, q_least, _) = extent(q.vertices);
    let (lo, hi) = (p_lo.sup(&q_lo).add_scalar(-reach), p_hi.inf(&q_hi).add_scalar(reach));
    // Where they meet, the first is no farther than `reach` from the second, and the other way round.
    let slab = [(q_least - reach, 1.0), (-(p_most + reach), -1.0)];
    for ((half, (least, sign)), out) in [p, q].into_iter().zip(slab).zip(out) {
        out.clear();
        for (index, edge) in half.poly.edges.iter().enumerate() {
            let [v, w] = edge.ends.map(|i| half.vertices[i as usize]);
            if sign * n.dot(&v) < least && sign * n.dot(&w) < least {
                continue;
            }
            let (from, to) = (v.inf(&w).add_scalar(-0.5 * reach), v.sup(&w).add_scalar(0.5 * reach));
            if (0..3).any(|k| from[k] > hi[k] || to[k] < lo[k]) {
                continue;
            }
            let normals = edge.faces.map(|f| half.planes[f as usize].0);
            out.push(Near {
                index: index as u32,
                start: v,
                along: half.frame.direction(&edge.along),
                lo: from,
                hi: to,
                n: normals,
                arc: normals[1].cross(&normals[0]),
            });
        }
    }
}

/// The pair of edges whose cross product separates the most, if it does so by more than `least`.
fn best_edges(edges: &[Vec<Near>; 2], vertices: [&[Vector3<f64>]; 2], least: f64) -> Option<(Axis, usize, usize)> {
    let mut best: Option<(Axis, usize, usize)> = None;
    let mut least = least;
    for (i, e) in edges[0].iter().enumerate() {
        for (j, f) in edges[1].iter().enumerate() {
            if (0..3).any(|k| e.lo[k] > f.hi[k] || f.lo[k] > e.hi[k]) || !arcs_cross(e, f) {
                continue;
            }
            let cross = e.along.cross(&f.along);
            let sine = cross.norm();
            if sine < PARALLEL {
                continue;
            }
            let outwards = if cross.dot(&(e.n[0] + e.n[1])) < 0.0 { -1.0 } else { 1.0 };
            let normal = cross * (outwards / sine);
            let gap = normal.dot(&(f.start - e.start));
            if gap <= least {
                continue;
            }
            // Slivers have normals of no meaning: nothing may lie beyond the two edges.
            let most = vertices[0].iter().map(|v| normal.dot(v)).fold(f64::NEG_INFINITY, f64::max);
            let lowest = vertices[1].iter().map(|v| normal.dot(v)).fold(f64::INFINITY, f64::min);
            if (lowest - most - gap).abs() < 1e-9 * (1.0 + gap.abs()) + 1e-3 * gap.abs() {
                best = Some((Axis { gap, normal, face: 0 }, i, j));
                least = gap;
            }
        }
    }
    best
}

/// Whether the normals of e and the reversed normals of f have a direction in common: arcs on the unit sphere that cross.
fn arcs_cross(e: &Near, f: &Near) -> bool {
    let (c, d) = (-f.n[0], -f.n[1]);
    let (ec, ed) = (c.dot(&e.arc), d.dot(&e.arc));
    // d x c of the reversed normals is that of the normals.
    let (fa, fb) = (e.n[0].dot(&f.arc), e.n[1].dot(&f.arc));
    ec * ed < 0.0 && fa * fb < 0.0 && ec * fb > 0.0
}
