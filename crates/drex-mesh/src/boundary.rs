//! The boundary of the solid {winding number > 1/2}: which parts of which faces of a closed mesh belong to it.

use drex_core::sets::DisjointSets;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use drex_core::{MassProperties, TriMesh};

use crate::bvh::Bvh;
use crate::intersect::meeting_faces;
use crate::topology::{edges, ends};

/// A triangle that bounds the solid, and how often it counts.
///
/// The weight is (H(inside) - H(outside)) / (inside - outside), with H(w) = 1 for w > 1/2 and w the winding numbers just
/// behind and in front of the face: 1 for an ordinary face, 0 for a wall inside the solid, 1/2 for each of two faces
/// of overlapping parts that lie in one plane.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fragment {
    pub corners: [Point3<f64>; 3],
    pub weight: f64,
}

/// The boundary of the solid.
#[derive(Debug, Clone)]
pub(crate) struct Boundary {
    pub fragments: Vec<Fragment>,
    /// Face of the mesh each fragment comes from.
    pub faces: Vec<u32>,
    /// Whether every face counts once: then the mesh itself is the boundary.
    pub whole: bool,
    /// Whether the winding number is 0 or 1 everywhere: shells may touch, but none overlap. Then the integrals over all
    /// faces are exact.
    pub simple: bool,
    /// Share of the mesh's area that is no boundary (walls inside the solid, hidden parts of overlapping shells).
    pub hidden_area_share: f64,
}

struct Probe<'a> {
    tree: &'a Bvh,
    /// Set when a winding number other than 0 or 1 turns up.
    layered: AtomicBool,
    /// How far from the face the winding number is asked.
    step: f64,
    /// Triangles with longer sides are divided before they are judged, so that no overlap slips between the probes.
    coarse: f64,
    /// Faces of the mesh with shorter sides (the triangles of scans) are judged by one probe.
    small: f64,
    /// So are longer ones that are narrower than this: a lid over a ragged rim is thousands of slices.
    narrow: f64,
    /// Parts of larger faces are divided no further than this.
    fine: f64,
}

enum Verdict {
    Uniform(f64),
    Mixed(Vec<Fragment>),
}

/// Finds the boundary of the solid bounded by `mesh`, whose openings are capped; `tree` is over all its faces.
///
/// Faces longer than 1/100 of the mesh are divided until each part has one weight or is smaller than 1/1000 of the mesh (1/60
/// where lids take part, and slices narrower than that get one probe); faces with one weight stay whole.
pub(crate) fn boundary(mesh: &TriMesh, tree: &Bvh, has_lids: bool) -> Boundary {
    let diagonal = mesh.bounds().map_or(0.0, |(lo, hi)| (hi - lo).norm());
    // Lids are a guess; finer parts would not make it better.
    let fine = diagonal / if has_lids { 60.0 } else { 1000.0 };
    let layered = AtomicBool::new(false);
    let narrow = if has_lids { fine } else { 0.0 };
    let (step, coarse, small) = (1e-6 * diagonal, diagonal / 24.0, diagonal / 100.0);
    let probe = Probe { tree, layered, step, coarse, small, narrow, fine };
    let known = probe.weights_of_patches(mesh);
    let verdicts: Vec<Verdict> = (0..mesh.faces.len())
        .into_par_iter()
        .map(|f| {
            if let Some(weight) = known[f] {
                return Verdict::Uniform(weight);
            }
            let t = mesh.triangle(f);
            let (across, longest) = ((t[1] - t[0]).cross(&(t[2] - t[0])), longest_side(&t));
            let small = longest <= probe.small || across.norm() < probe.narrow * longest;
            match across.try_normalize(0.0) {
                Some(normal) if small => Verdict::Uniform(probe.weight(&middle(&t), &normal)),
                Some(normal) => probe.evaluate(&t, &normal),
                None => Verdict::Uniform(0.0),
            }
        })
        .collect();
    let area = |t: &[Point3<f64>; 3]| (t[1] - t[0]).cross(&(t[2] - t[0])).norm() * 0.5;
    let mut out = Boundary {
        fragments: Vec::new(),
        faces: Vec::new(),
        whole: true,
        simple: !probe.layered.into_inner(),
        hidden_area_share: 0.0,
    };
    let mut odd = 0.0;
    for (f, verdict) in verdicts.into_iter().enumerate() {
        let fragments = match verdict {
            Verdict::Uniform(weight) => vec![Fragment { corners: mesh.triangle(f), weight }],
            Verdict::Mixed(fragments) => fragments,
        };
        for p in fragments {
            let a = area(&p.corners);
            odd += if p.weight == 1.0 { 0.0 } else { a };
            out.hidden_area_share += a * (1.0 - p.weight.clamp(0.0, 1.0));
            if p.weight != 0.0 {
                out.fragments.push(p);
                out.faces.push(f as u32);
            }
        }
    }
    let total = mesh.area();
    out.hidden_area_share /= total;
    // A probe may land on the wrong side of a blade thinner than the step: a millionth of the area says nothing.
    if odd <= 1e-6 * total {
        out.whole = true;
        out.fragments = (0..mesh.faces.len()).map(|f| Fragment { corners: mesh.triangle(f), weight: 1.0 }).collect();
        out.faces = (0..mesh.faces.len() as u32).collect();
    } else {
        out.whole = false;
    }
    out
}

fn middle(t: &[Point3<f64>; 3]) -> Point3<f64> {
    Point3::from((t[0].coords + t[1].coords + t[2].coords) / 3.0)
}

fn length(t: &[Point3<f64>; 3], side: usize) -> f64 {
    (t[(side + 1) % 3] - t[side]).norm()
}

fn longest_side(t: &[Point3<f64>; 3]) -> f64 {
    (0..3).map(|k| length(t, k)).fold(0.0, f64::max)
}

/// Faces of a patch that are asked for its weight.
const ASKED: usize = 8;

impl Probe<'_> {
    /// The weights of faces that follow from their neighbours'.
    ///
    /// Beside a face that meets no other one, the winding numbers change nowhere; nor do they across an edge with two such
    /// faces. So all faces of a patch of them have one weight, that of a few of its faces. `None` for faces that meet others
    /// and for patches whose faces disagree: something is nearer to one of them than the step.
    fn weights_of_patches(&self, mesh: &TriMesh) -> Vec<Option<f64>> {
        let (_, meets) = meeting_faces(mesh);
        let mut sets = DisjointSets::new(mesh.faces.len());
        for group in edges(mesh).chunk_by(|a, b| a.0 == b.0) {
            if let &[(_, g), (_, h)] = group
                && ends(mesh, g).0 != ends(mesh, h).0
                && !meets[g as usize / 3]
                && !meets[h as usize / 3]
            {
                sets.join(g / 3, h / 3);
            }
        }
        let (labels, count) = sets.labels();
        let mut patches = vec![Vec::new(); count];
        labels.iter().zip(0..).for_each(|(&label, f)| patches[label as usize].push(f));
        let mut weights = vec![None; mesh.faces.len()];
        let of_patches: Vec<Option<f64>> = patches
            .par_iter()
            .map(|patch| {
                // Faces without area have no sides, and those of the largest patches are spread over them.
                let normals = patch.iter().filter_map(|&f: &usize| {
                    let t = mesh.triangle(f);
                    Some((t, (t[1] - t[0]).cross(&(t[2] - t[0])).try_normalize(0.0)?))
                });
                let asked = normals.step_by(patch.len().div_ceil(ASKED));
                let mut found = asked.map(|(t, normal)| self.weight(&middle(&t), &normal));
                let first = found.next().filter(|_| !meets[patch[0]])?;
                found.all(|weight| weight == first).then_some(first)
            })
            .collect();
        for (patch, weight) in patches.iter().zip(of_patches) {
            patch.iter().for_each(|&f| weights[f] = weight);
        }
        weights
    }

    /// Weight of a triangle as seen at one point of it.
    fn weight(&self, at: &Point3<f64>, normal: &Vector3<f64>) -> f64 {
        let inside = self.tree.winding(&(at - normal * self.step)).round();
        let outside = self.tree.winding(&(at + normal * self.step)).round();
        if ![inside, outside].iter().all(|w| (0.0..=1.0).contains(w)) {
            self.layered.store(true, Ordering::Relaxed);
        }
        if inside == outside {
            return 0.0;
        }
        let filled = |w: f64| if w > 0.5 { 1.0 } else { 0.0 };
        (filled(inside) - filled(outside)) / (inside - outside)
    }

    fn evaluate(&self, t: &[Point3<f64>; 3], normal: &Vector3<f64>) -> Verdict {
        let side = longest_side(t);
        if side <= self.fine {
            return Verdict::Uniform(self.weight(&middle(t), normal));
        }
        if side <= self.coarse {
            let first = self.weight(&middle(t), normal);
            // A line that crosses the triangle leaves one of its corners alone.
            if t.iter().all(|corner| self.weight(&corner.lerp(&middle(t), 0.02), normal) == first) {
                return Verdict::Uniform(first);
            }
        }
        // Halving the longest side keeps the parts of long thin triangles (lids) few and makes them rounder.
        let k = (0..3).max_by(|&i, &j| length(t, i).total_cmp(&length(t, j))).unwrap_or(0);
        let (p, q, apex) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
        let m = nalgebra::center(&p, &q);
        let halves = [[p, m, apex], [m, q, apex]];
        let verdicts = halves.map(|h| self.evaluate(&h, normal));
        if let [Verdict::Uniform(a), Verdict::Uniform(b)] = verdicts
            && a == b
        {
            return Verdict::Uniform(a);
        }
        let mut fragments = Vec::new();
        for (corners, verdict) in halves.into_iter().zip(verdicts) {
            match verdict {
                Verdict::Uniform(weight) => fragments.push(Fragment { corners, weight }),
                Verdict::Mixed(more) => fragments.extend(more),
            }
        }
        Verdict::Mixed(fragments)
    }
}

impl Boundary {
    /// All faces of a closed mesh, each once.
    pub fn of_whole(mesh: &TriMesh) -> Self {
        Self {
            fragments: (0..mesh.faces.len()).map(|f| Fragment { corners: mesh.triangle(f), weight: 1.0 }).collect(),
            faces: (0..mesh.faces.len() as u32).collect(),
            whole: true,
            simple: true,
            hidden_area_share: 0.0,
        }
    }

    /// Mass properties of the solid at density 1, by the divergence theorem over the fragments. `None` without volume.
    pub fn mass_properties(&self) -> Option<MassProperties> {
        let mut moments = Moments::about(self.fragments.first()?.corners[0]);
        for fragment in &self.fragments {
            moments.add_tetrahedron(&fragment.corners, fragment.weight);
        }
        moments.mass_properties()
    }

    /// The boundary as a mesh, every fragment once. Where faces of several parts lie in one plane, all of them are there.
    pub fn mesh(&self) -> TriMesh {
        let vertices = self.fragments.iter().flat_map(|p| p.corners).collect();
        let faces = (0..self.fragments.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        TriMesh { vertices, faces }
    }
}

/// Volume integrals of 1, x and x xᵀ about a reference point.
#[derive(Debug, Clone)]
pub(crate) struct Moments {
    reference: Point3<f64>,
    volume: f64,
    first: Vector3<f64>,
    second: nalgebra::Matrix3<f64>,
}

impl Moments {
    pub fn about(reference: Point3<f64>) -> Self {
        Self { reference, volume: 0.0, first: Vector3::zeros(), second: nalgebra::Matrix3::zeros() }
    }

    /// The tetrahedron between the reference point and a triangle, signed and weighted.
    pub fn add_tetrahedron(&mut self, corners: &[Point3<f64>; 3], weight: f64) {
        let [a, b, c] = corners.map(|p| p - self.reference);
        let v = weight * a.dot(&b.cross(&c)) / 6.0;
        let s = a + b + c;
        self.volume += v;
        self.first += s * (v / 4.0);
        self.second += (s * s.transpose() + a * a.transpose() + b * b.transpose() + c * c.transpose()) * (v / 20.0);
    }

    /// A small volume at a point.
    pub fn add_point(&mut self, p: &Point3<f64>, volume: f64) {
        let d = p - self.reference;
        self.volume += volume;
        self.first += d * volume;
        self.second += d * d.transpose() * volume;
    }

    /// A share of a cube.
    pub fn add_cube(&mut self, center: &Point3<f64>, side: f64, share: f64) {
        let volume = share * side.powi(3);
        self.add_point(center, volume);
        self.second += nalgebra::Matrix3::identity() * (volume * side * side / 12.0);
    }

    /// The volume that a triangle sweeps along a vector; exact by two Gauss points times the middles of the sides.
    pub fn add_prism(&mut self, corners: &[Point3<f64>; 3], sweep: &Vector3<f64>, volume: f64) {
        let gauss = 0.5 / 3.0_f64.sqrt();
        for k in 0..3 {
            let middle = nalgebra::center(&corners[k], &corners[(k + 1) % 3]);
            self.add_point(&(middle + sweep * (0.5 - gauss)), volume / 6.0);
            self.add_point(&(middle + sweep * (0.5 + gauss)), volume / 6.0);
        }
    }

    /// Mass properties at density 1. `None` without volume.
    pub fn mass_properties(&self) -> Option<MassProperties> {
        if !(self.volume > 0.0) {
            return None;
        }
        let c = self.first / self.volume;
        let central = self.second - c * c.transpose() * self.volume;
        let inertia = nalgebra::Matrix3::identity() * central.trace() - central;
        Some(MassProperties { mass_kg: self.volume, center_of_mass: self.reference + c, inertia })
    }
}
