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
/// And its sine.
const FLAT_SIN: f64 = 0.0346;
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

/// A face, and how far the other is in front of it (negative: they overlap).
#[derive(Debug, Clone, Copy)]
struct Axis {
    gap: f64,
    face: u32,
}

/// Where two polyhedra overlap least.
#[derive(Debug, Clone, Copy)]
pub(super) struct Overlap {
    /// Negative: minus the overlap.
    pub gap: f64,
    /// From the first to the second, in the frame of the first.
    pub normal: Vector3<f64>,
    /// Gaps that differ by less are alike.
    alike: f64,
    least: Least,
    /// Its touches have been appended already.
    pub done: bool,
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
        work.edges.iter_mut().for_each(Vec::clear);
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

    /// The face along whose normal they overlap least; `None` if they are farther apart than `margin`.
    fn best_face(&self, margin: f64) -> Option<Overlap> {
        let [p, q] = &self.halves;
        let (on_p, on_q) = match (&p.poly.box_faces, &q.poly.box_faces) {
            (Some(p_faces), Some(q_faces)) => {
                let gaps = BoxGaps::new(p.poly, q.poly, &q.frame);
                (gaps.face(&gaps.along_p, &gaps.between, p_faces), gaps.face(&gaps.along_q, &-gaps.seen_by_q, q_faces))
            }
            _ => (
                best_face(p.planes, q.vertices, &q.frame.point(&q.poly.middle), margin)?,
                best_face(q.planes, p.vertices, &p.poly.middle, margin)?,
            ),
        };
        let gap = on_p.gap.max(on_q.gap);
        if gap > margin {
            return None;
        }
        let alike = ALIKE * gap.abs() + 1e-7 * p.poly.half.norm().min(q.poly.half.norm());
        let first = if (on_p.gap - on_q.gap).abs() <= alike {
            p.poly.areas[on_p.face as usize] >= q.poly.areas[on_q.face as usize] * (1.0 - 1e-9)
        } else {
            on_p.gap > on_q.gap
        };
        let (which, face) = if first { (0, on_p.face) } else { (1, on_q.face) };
        let normal = if first { p.planes[face as usize].0 } else { -q.planes[face as usize].0 };
        Some(Overlap { gap, normal, alike, least: Least::Face(which, face), done: false })
    }

    /// The overlap of two edges, if it is less than that of all faces; `None` if they are farther apart than `margin`.
    fn with_edges(&mut self, faces: Overlap, margin: f64) -> Option<Overlap> {
        let [p, q] = &self.halves;
        near_edges(p, q, &faces, margin, self.edges);
        let found = best_edges(self.edges, [p.vertices, q.vertices], faces.gap + faces.alike);
        let Some((gap, normal, i, j)) = found else { return Some(faces) };
        if gap > margin {
            return None;
        }
        let (e, f) = (&self.edges[0][i], &self.edges[1][j]);
        // A face that lies flat on the edge is touched at more than one point.
        let sides = [(e.n[0], 0, 0), (e.n[1], 0, 1), (-f.n[0], 1, 0), (-f.n[1], 1, 1)];
        let flattest = sides.into_iter().max_by(|a, b| a.0.dot(&normal).total_cmp(&b.0.dot(&normal)));
        let flat = flattest.filter(|(n, _, _)| n.dot(&normal) > FLAT_COS).map(|(_, which, k)| {
            let edge = [e.index, f.index][which];
            (which, self.halves[which].poly.edges[edge as usize].faces[k])
        });
        Some(Overlap { gap, normal, least: Least::Edges([i, j], flat), ..faces })
    }
}

impl Pair<'_> {
    /// Sites: the vertices of the polyhedron with more of them, those of the other, then pairs of edges.
    pub fn poly_poly(&mut self, a: &Poly, b: &Poly, work: &mut CollideWork) {
        if boxes_gap(a, b, &self.a_from_b) > self.margin {
            return;
        }
        let mut search = Search::new(a, b, &self.a_from_b, &mut work.sat);
        if let Some(overlap) = self.least_overlap(&mut search, self.margin, &mut work.spots)
            && !overlap.done
        {
            self.overlap(&search, &overlap, &mut work.spots);
        }
    }

    /// Where two polyhedra overlap least; `None` if they are farther apart than `margin`.
    pub fn least_overlap(&mut self, search: &mut Search<'_>, margin: f64, spots: &mut Spots) -> Option<Overlap> {
        let faces = search.best_face(margin)?;
        // In a direction far from the normal, two bodies overlap by the width of what they have in common. Where that is
        // wide and thin, no pair of edges overlaps less.
        if faces.gap < 0.0
            && let Least::Face(which, face) = faces.least
        {
            let start = self.out.len();
            self.manifold(&search.halves[which], &search.halves[1 - which], face, spots);
            if spots.width() * FLAT_SIN > -3.0 * faces.gap {
                return Some(Overlap { done: true, ..faces });
            }
            self.out.truncate(start);
        }
        search.with_edges(faces, margin)
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
                    && let Some((_, normal, i, j)) =
                        best_edges(search.edges, [p.vertices, q.vertices], f64::NEG_INFINITY)
                {
                    self.edge_pair(halves, (&near_p[i], &near_q[j]), &normal);
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
    let gaps = BoxGaps::new(p, q, p_from_q);
    gaps.along_p.max().max(gaps.along_q.max())
}

/// How far two boxes are apart along their sides, and the middle of the second seen from the first, in either's axes.
struct BoxGaps {
    along_p: Vector3<f64>,
    along_q: Vector3<f64>,
    between: Vector3<f64>,
    seen_by_q: Vector3<f64>,
}

impl BoxGaps {
    fn new(p: &Poly, q: &Poly, p_from_q: &Frame<f64>) -> Self {
        let turned = p.axes.tr_mul(&(p_from_q.r * q.axes));
        let between = p.axes.tr_mul(&(p_from_q.point(&q.middle) - p.middle));
        let seen_by_q = turned.tr_mul(&between);
        let size = turned.abs();
        let along_p = between.abs() - p.half - size * q.half;
        let along_q = seen_by_q.abs() - q.half - size.tr_mul(&p.half);
        Self { along_p, along_q, between, seen_by_q }
    }

    /// The face of a box that is farthest from the other, whose middle is `towards`.
    fn face(&self, gaps: &Vector3<f64>, towards: &Vector3<f64>, faces: &[[u32; 2]; 3]) -> Axis {
        let k = gaps.imax();
        Axis { gap: gaps[k], face: faces[k][usize::from(towards[k] > 0.0)] }
    }
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
    let mut first = (f64::NEG_INFINITY, 0);
    for (f, (n, d)) in planes.iter().enumerate() {
        let front = n.dot(hint) - d;
        if front > first.0 {
            first = (front, f);
        }
    }
    let (n, d) = planes.get(first.1)?;
    let (height, v) = lowest(n);
    let mut best = Axis { gap: height - d, face: first.1 as u32 };
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
            best = Axis { gap: height - d, face: f as u32 };
        }
    }
    (best.gap <= margin).then_some(best)
}

/// The edges of both that can carry an overlap not larger than that of `faces`; none if one of them has none.
fn near_edges(p: &Half<'_>, q: &Half<'_>, faces: &Overlap, margin: f64, out: &mut NearEdges) {
    let reach = (-faces.gap).max(0.0) + margin + 1e-9 * p.poly.half.max();
    let n = &faces.normal;
    let (p_lo, p_hi) = p.bounds();
    let (q_lo, q_hi) = q.bounds();
    let (lo, hi) = (p_lo.sup(&q_lo).add_scalar(-reach), p_hi.inf(&q_hi).add_scalar(reach));
    let heights = |half: &Half<'_>| half.vertices.iter().map(|v| n.dot(v)).fold(f64::INFINITY, f64::min);
    // Where they meet, the first is no farther than `reach` from the second, and the other way round.
    let q_least = heights(q);
    let p_most = q_least - faces.gap;
    let slab = [(q_least - reach, 1.0), (-(p_most + reach), -1.0)];
    out.iter_mut().for_each(Vec::clear);
    // The second has fewer edges.
    for k in [1, 0] {
        let (half, (least, sign)) = ([p, q][k], slab[k]);
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
            out[k].push(Near {
                index: index as u32,
                start: v,
                along: half.frame.direction(&edge.along),
                lo: from,
                hi: to,
                n: normals,
                arc: normals[1].cross(&normals[0]),
            });
        }
        if out[k].is_empty() {
            return out.iter_mut().for_each(Vec::clear);
        }
    }
}

/// The pair of edges whose cross product separates the most, if it does so by more than `least`.
/// Gap, normal, and the place of the two among the edges.
fn best_edges(
    edges: &NearEdges,
    vertices: [&[Vector3<f64>]; 2],
    least: f64,
) -> Option<(f64, Vector3<f64>, usize, usize)> {
    let mut best = None;
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
                best = Some((gap, normal, i, j));
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
