//! Triangle meshes as plain data, and the exact mass properties of the solid they bound.

mod hull;
mod obj;
mod roughness;
mod sample;
mod stl;
mod weld;

use std::path::Path;

pub use self::hull::{convex_hull, convex_hull_faces};
pub use self::obj::{parse_obj, read_obj};
pub use self::sample::{farthest_points, sample_surface};
pub use self::stl::{parse_stl, read_stl};
pub use self::weld::coincident;
use nalgebra::{Matrix3, Point3, Vector3};

use crate::{Error, Pose, Result};

/// An indexed triangle mesh, metres. Faces wind counter-clockwise seen from outside.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TriMesh {
    /// Vertex positions.
    pub vertices: Vec<Point3<f64>>,
    /// Vertex indices of each triangle.
    pub faces: Vec<[u32; 3]>,
}

/// Mass, centre of mass and inertia of a rigid body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MassProperties {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the body's frame, metres.
    pub center_of_mass: Point3<f64>,
    /// Inertia tensor about the centre of mass along the body's axes, kg m². Off-diagonal entries are
    /// the tensor's own (minus the products of inertia).
    pub inertia: Matrix3<f64>,
}

impl TriMesh {
    /// A mesh whose face indices are checked against its vertices.
    ///
    /// # Errors
    /// If a vertex is not finite or a face names a vertex that does not exist.
    pub fn new(vertices: Vec<Point3<f64>>, faces: Vec<[u32; 3]>) -> Result<Self> {
        if let Some(i) = vertices.iter().position(|v| v.iter().any(|c| !c.is_finite())) {
            return Err(Error::value(format!("vertex {i} is not finite"), "repair the mesh"));
        }
        let n = vertices.len();
        if let Some(i) = faces.iter().position(|f| f.iter().any(|&v| v as usize >= n)) {
            return Err(Error::value(format!("face {i} names a vertex beyond the {n} there are"), "repair the mesh"));
        }
        Ok(Self { vertices, faces })
    }

    /// Reads a mesh by the ending of its name: `.stl` (binary or text) or `.obj`. Coordinates are taken as metres.
    ///
    /// # Errors
    /// If the file cannot be read, its ending is another, or its content is malformed.
    pub fn read(path: &Path) -> Result<Self> {
        match path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).as_deref() {
            Some("stl") => read_stl(path),
            Some("obj") => read_obj(path),
            _ => Err(Error::content(
                path,
                None,
                "meshes are read from .stl and .obj",
                "convert the mesh to one of these",
            )),
        }
    }

    /// The same mesh with every coordinate multiplied, as from millimetres to metres (0.001).
    pub fn scaled(&self, factor: f64) -> Self {
        Self { vertices: self.vertices.iter().map(|v| v * factor).collect(), faces: self.faces.clone() }
    }

    /// Corner points of face `f`.
    pub fn triangle(&self, f: usize) -> [Point3<f64>; 3] {
        self.faces[f].map(|v| self.vertices[v as usize])
    }

    /// Lower and upper corner of the bounding box; `None` for a mesh without vertices.
    pub fn bounds(&self) -> Option<(Point3<f64>, Point3<f64>)> {
        let first = *self.vertices.first()?;
        Some(self.vertices.iter().fold((first, first), |(lo, hi), v| (lo.inf(v), hi.sup(v))))
    }

    /// Total area, m².
    pub fn area(&self) -> f64 {
        (0..self.faces.len())
            .map(|f| {
                let [a, b, c] = self.triangle(f);
                0.5 * (b - a).cross(&(c - a)).norm()
            })
            .sum()
    }

    /// The mesh seen from another frame: every vertex mapped by `a_from_b`.
    pub fn transformed(&self, a_from_b: &Pose) -> Self {
        Self { vertices: self.vertices.iter().map(|v| a_from_b * v).collect(), faces: self.faces.clone() }
    }

    /// Exact mass properties of the solid that the mesh bounds, at uniform `density_kg_m3`.
    ///
    /// Signed tetrahedra from a reference point near the mesh (Eberly, "Polyhedral Mass Properties", 2002).
    /// The mesh must be closed: for an open one the answer would depend on the reference point.
    ///
    /// # Errors
    /// If the enclosed volume is not positive (open, flat or wound inwards).
    pub fn mass_properties(&self, density_kg_m3: f64) -> Result<MassProperties> {
        let Some((lo, hi)) = self.bounds() else {
            return Err(Error::value("the mesh has no vertices", "give a mesh of a solid"));
        };
        let reference = nalgebra::center(&lo, &hi);
        let mut volume = 0.0;
        let mut first = Vector3::zeros();
        let mut second = Matrix3::zeros();
        for f in 0..self.faces.len() {
            let [a, b, c] = self.triangle(f).map(|p| p - reference);
            let v = a.dot(&b.cross(&c)) / 6.0;
            let s = a + b + c;
            volume += v;
            first += s * (v / 4.0);
            // ∫ x xᵀ over a tetrahedron with one corner at the origin.
            second += (s * s.transpose() + a * a.transpose() + b * b.transpose() + c * c.transpose()) * (v / 20.0);
        }
        let extent = (hi - lo).norm();
        if !(volume > 1e-12 * extent.powi(3)) {
            return Err(Error::value(
                format!("the mesh encloses no volume ({volume:.3e} m³)"),
                "close its openings and wind its faces outwards",
            ));
        }
        let c = first / volume;
        let central = second - c * c.transpose() * volume;
        let inertia = (Matrix3::identity() * central.trace() - central) * density_kg_m3;
        Ok(MassProperties { mass_kg: density_kg_m3 * volume, center_of_mass: reference + c, inertia })
    }
}

/// Largest polygon that becomes a fan round its first corner.
const LARGEST_FAN: usize = 8;

/// The n - 2 triangles of a polygon with `corners` corners, wound like it, as positions in the polygon; none for fewer than
/// three.
///
/// Up to eight corners make a fan round the first one. Of larger ones every second corner is cut off, again and again:
/// as right for convex polygons as a fan is, and its triangles are small and round where those of a fan are thousands of slivers
/// that all meet in one corner.
pub fn polygon_triangles(corners: usize) -> Vec<[usize; 3]> {
    if corners <= LARGEST_FAN {
        return (2..corners).map(|k| [0, k - 1, k]).collect();
    }
    let mut out = Vec::with_capacity(corners - 2);
    let mut left: Vec<usize> = (0..corners).collect();
    while left.len() > LARGEST_FAN {
        let mut kept = Vec::with_capacity(left.len() / 2 + 1);
        for pair in left.chunks(2) {
            kept.push(pair[0]);
            if let [from, off] = *pair {
                // The corner after the last one is the first.
                let to = left.get(2 * kept.len()).copied().unwrap_or(left[0]);
                out.push([from, off, to]);
            }
        }
        left = kept;
    }
    out.extend(left.windows(2).skip(1).map(|w| [left[0], w[0], w[1]]));
    out
}

/// The point of the triangle nearest to `p` (Ericson, *Real-Time Collision Detection*, 2004, section 5.1.5).
pub fn nearest_on_triangle(p: &Point3<f64>, [a, b, c]: &[Point3<f64>; 3]) -> Point3<f64> {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 > d3 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 > d6 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    let (u, v) = (d4 - d3, d5 - d6);
    if va <= 0.0 && u >= 0.0 && v >= 0.0 && u + v > 0.0 {
        return b + (c - b) * (u / (u + v));
    }
    let sum = va + vb + vc;
    if sum == 0.0 { *a } else { a + ab * (vb / sum) + ac * (vc / sum) }
}

impl MassProperties {
    /// The same body with another mass at the same shape: inertia scales along.
    pub fn with_mass(&self, mass_kg: f64) -> Self {
        let k = mass_kg / self.mass_kg;
        Self { mass_kg, center_of_mass: self.center_of_mass, inertia: self.inertia * k }
    }

    /// The same body described in frame a.
    pub fn transformed(&self, a_from_b: &Pose) -> Self {
        let r = a_from_b.rotation.to_rotation_matrix();
        Self {
            mass_kg: self.mass_kg,
            center_of_mass: a_from_b * self.center_of_mass,
            inertia: r.matrix() * self.inertia * r.matrix().transpose(),
        }
    }

    /// Several rigid parts as one body, all in the same frame. `None` if there is no mass.
    pub fn combined(parts: &[Self]) -> Option<Self> {
        let mass_kg: f64 = parts.iter().map(|p| p.mass_kg).sum();
        if !(mass_kg > 0.0) {
            return None;
        }
        let com = parts.iter().map(|p| p.center_of_mass.coords * p.mass_kg).sum::<Vector3<f64>>() / mass_kg;
        let inertia = parts
            .iter()
            .map(|p| {
                let d = p.center_of_mass.coords - com;
                p.inertia + (Matrix3::identity() * d.norm_squared() - d * d.transpose()) * p.mass_kg
            })
            .sum();
        Some(Self { mass_kg, center_of_mass: com.into(), inertia })
    }

    /// Whether a real body can have this inertia: positive definite and A + B >= C for the principal moments.
    pub fn is_physical(&self) -> bool {
        let mut e: Vec<f64> = self.inertia.symmetric_eigenvalues().iter().copied().collect();
        e.sort_by(f64::total_cmp);
        self.mass_kg > 0.0 && e[0] > 0.0 && e[0] + e[1] >= e[2] * (1.0 - 1e-9)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polygon_of_any_size_is_covered_once_by_triangles_without_slivers() {
        assert_eq!(polygon_triangles(5), [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
        assert!((0..3).all(|n| polygon_triangles(n).is_empty()));
        for n in [9, 10, 17, 100, 2001] {
            let angle = |k: usize| std::f64::consts::TAU * k as f64 / n as f64;
            let at = |k: usize| [angle(k).cos(), angle(k).sin()];
            let triangles = polygon_triangles(n);
            assert_eq!(triangles.len(), n - 2, "{n}");
            let areas: Vec<f64> = triangles
                .iter()
                .map(|t| {
                    let [a, b, c] = t.map(at);
                    0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
                })
                .collect();
            assert!(areas.iter().all(|&a| a > 0.0), "{n}: all wound like the polygon");
            let whole = 0.5 * n as f64 * angle(1).sin();
            assert!((areas.iter().sum::<f64>() - whole).abs() < 1e-9, "{n}");
            // Half of all triangles span two edges, a quarter four: their lengths add up to a few rounds.
            let span = |t: &[usize; 3]| (at(t[2])[0] - at(t[0])[0]).hypot(at(t[2])[1] - at(t[0])[1]);
            assert!(triangles.iter().map(span).sum::<f64>() < 7.0 * (n as f64).log2(), "{n}");
        }
    }
}
