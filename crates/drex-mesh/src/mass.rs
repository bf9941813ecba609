//! What follows from mass properties: principal axes, whether a real body can have them, and hollow bodies.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use serde::Serialize;

use drex_core::{MassProperties, SdfSample, SignedDistance, TriMesh};

use crate::boundary::{Boundary, Moments, boundary};
use crate::sdf::MeshSdf;
use crate::solid::{Enclosed, close};
use crate::topology::{NONE, Topology, ends};
use crate::{Error, Result};
use drex_core::mesh::convex_hull;

/// Principal moments of inertia, kg m², ascending, and `body_from_principal`: the rotation whose columns are the axes.
///
/// The axes are right-handed; of the first two the largest component is positive, so that the same tensor always gives
/// the same axes. I = R diag(moments) Rᵀ.
pub fn principal(properties: &MassProperties) -> (Vector3<f64>, UnitQuaternion<f64>) {
    let eigen = (0.5 * (properties.inertia + properties.inertia.transpose())).symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    let axis = |k: usize| {
        let a: Vector3<f64> = eigen.eigenvectors.column(order[k]).into_owned();
        a * a[a.iamax()].signum()
    };
    let (x, y) = (axis(0), axis(1));
    let axes = Matrix3::from_columns(&[x, y, x.cross(&y)]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    (Vector3::from(order.map(|i| eigen.eigenvalues[i])), rotation)
}

/// Checks that a real body with these corners can have these mass properties: mass positive, inertia symmetric and
/// positive definite, A + B >= C for the principal moments, the centre of mass inside the convex hull.
///
/// # Errors
/// With the condition that fails and its numbers.
pub fn check_mass_properties(properties: &MassProperties, corners: &[Point3<f64>]) -> Result<()> {
    let refuse = |what: String, remedy: &str| Err(Error::value(what, remedy));
    let p = properties;
    if !(p.mass_kg > 0.0 && p.mass_kg.is_finite()) {
        return refuse(format!("the mass is {} kg", p.mass_kg), "give a positive mass");
    }
    let skew = (p.inertia - p.inertia.transpose()).norm();
    if !(skew <= 1e-9 * p.inertia.norm()) {
        return refuse(format!("the inertia is not symmetric (by {skew:.3e} kg m²)"), "give Ixy = Iyx and so on");
    }
    let (moments, _) = principal(p);
    let [a, b, c] = moments.into();
    if !(a > 0.0) {
        return refuse(
            format!("the inertia is not positive definite: a principal moment is {a:.3e} kg m²"),
            "give the tensor about the centre of mass, with off-diagonal entries minus the products of inertia",
        );
    }
    if !(a + b >= c * (1.0 - 1e-9)) {
        return refuse(
            format!("no body has the principal moments {a:.3e}, {b:.3e}, {c:.3e} kg m²: A + B < C"),
            "check the tensor's off-diagonal signs and that it is about the centre of mass",
        );
    }
    let hull = convex_hull(corners)?;
    let size = hull.bounds().map_or(0.0, |(lo, hi)| (hi - lo).norm());
    let outside = (0..hull.faces.len())
        .filter_map(|f| {
            let [a, b, c] = hull.triangle(f);
            let n = (b - a).cross(&(c - a)).try_normalize(0.0)?;
            Some(n.dot(&(p.center_of_mass - a)))
        })
        .fold(f64::NEG_INFINITY, f64::max);
    if !(outside <= 1e-9 * size) {
        return refuse(
            format!("the centre of mass lies {outside:.3e} m outside of the convex hull"),
            "give the centre in the mesh's frame, in metres",
        );
    }
    Ok(())
}

/// How the mass properties of a hollow body were obtained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum HollowModel {
    /// The solid minus the set deeper than the wall thickness, integrated over the distance field.
    Offset,
    /// The wall is thin beside the size: an integral over the surface, right to second order in the thickness.
    ThinWall,
    /// The body is nowhere deeper than the wall: it is solid.
    Solid,
}

/// Mass properties of a hollow body at 1 kg/m³ of its material.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct Hollow {
    /// Mass properties of the wall at a density of 1 kg/m³: the mass is the wall's volume.
    pub properties: MassProperties,
    /// Volume of the wall, m³.
    pub volume_m3: f64,
    /// How it was obtained.
    pub model: HollowModel,
}

/// Cells along the longest side down to which the distance field is integrated.
const FINEST: f64 = 256.0;

/// Mass properties of the object if it is hollow, with a wall of the given thickness inside its surface.
///
/// The wall is the set of points of the solid no deeper than `wall_m` under its boundary; openings are closed by fans. A wall thicker than 1/128 of the
/// longest side is integrated over the distance field (an octree down to half the wall or 1/64 of the size, whichever
/// is finer; about 1e-3 of the wall's volume); a thinner one by Steiner's formula over the surface: area times
/// thickness, less t² tan(θ/2) per length of a convex edge with exterior angle θ, plus t² θ/2 per length of a concave
/// one; what is left out is of the order of t³.
///
/// # Errors
/// If the thickness is not positive, or the mesh encloses no volume.
pub fn shell_properties(mesh: &TriMesh, wall_m: f64) -> Result<Hollow> {
    if !(wall_m > 0.0 && wall_m.is_finite()) {
        return Err(Error::value(format!("the wall thickness is {wall_m} m"), "give a positive thickness"));
    }
    let enclosed = Enclosed::new(mesh)?;
    let open = enclosed.capped.openings > 0;
    // The wall lies between two surfaces, so the outer one must be that of the distances: with fans for lids.
    let closed = if open { enclosed.capped.mesh.mass_properties(1.0).ok() } else { None };
    let solid = closed.unwrap_or(enclosed.solid.properties);
    let (lo, hi) = mesh.bounds().unwrap_or_default();
    let side = (hi - lo).max();
    if wall_m < 2.0 * side / FINEST {
        return thin_wall(mesh, wall_m);
    }
    // Lids are a guess: which parts of a ragged one bound the solid is not worth the search.
    let sdf = if open { MeshSdf::of_whole(enclosed.capped.mesh)? } else { MeshSdf::new(mesh)? };
    let cell = (0.5 * wall_m).min(side / 64.0);
    let levels = (side / cell).log2().ceil() as u32;
    let mut core = Moments::about(nalgebra::center(&lo, &hi));
    let field = Depth { sdf: &sdf, wall_m };
    let center = nalgebra::center(&lo, &hi);
    let sample = field.sample(&center, None);
    field.add_core(Cube { center, half: 0.5 * side, sample, levels, extra: 3 }, None, &mut core);
    let hollow = core.mass_properties().and_then(|core| difference(&solid, &core));
    let (properties, how) = match hollow {
        Some(wall) => (wall, HollowModel::Offset),
        None => (solid, HollowModel::Solid),
    };
    Ok(Hollow { properties, volume_m3: properties.mass_kg, model: how })
}

/// What is left of a body when a part of it is taken out, both at the same density.
fn difference(whole: &MassProperties, part: &MassProperties) -> Option<MassProperties> {
    let minus = MassProperties { mass_kg: -part.mass_kg, inertia: -part.inertia, ..*part };
    MassProperties::combined(&[*whole, minus]).filter(MassProperties::is_physical)
}

struct Depth<'a> {
    sdf: &'a MeshSdf,
    wall_m: f64,
}

struct Cube {
    center: Point3<f64>,
    half: f64,
    /// The field at its centre.
    sample: SdfSample,
    /// How often it may be divided, and how often more where the field bends.
    levels: u32,
    extra: u32,
}

impl Depth<'_> {
    fn sample(&self, p: &Point3<f64>, inside: Option<bool>) -> SdfSample {
        match inside {
            Some(true) => self.sdf.distance_inside(p),
            Some(false) => self.sdf.distance_outside(p),
            None => self.sdf.signed_distance(p),
        }
    }

    /// Adds the part of a cube that is deeper than the wall. `inside` is known once the surface misses the cube.
    fn add_core(&self, cube: Cube, inside: Option<bool>, out: &mut Moments) {
        let Cube { center, half, sample, levels, extra } = cube;
        let beyond = -sample.distance_m - self.wall_m;
        let reach = half * 3.0_f64.sqrt();
        if beyond <= -reach {
            return;
        }
        if beyond >= reach {
            out.add_cube(&center, 2.0 * half, 1.0);
            return;
        }
        if levels > 0 {
            let inside = inside.or((sample.distance_m.abs() > reach).then_some(sample.distance_m < 0.0));
            let sign = |k: usize, bit: usize| if k >> bit & 1 == 1 { 0.5 * half } else { -0.5 * half };
            let centers = [0, 1, 2, 3, 4, 5, 6, 7].map(|k| center + Vector3::new(sign(k, 0), sign(k, 1), sign(k, 2)));
            let samples = centers.map(|c| self.sample(&c, inside));
            // Where the nearest wall changes (along inner edges), the field bends: a few more levels.
            let bent = levels == 1 && samples.iter().any(|s| s.gradient.dot(&sample.gradient) < 0.95);
            let (levels, extra) = if bent && extra > 0 { (levels, extra - 1) } else { (levels - 1, extra) };
            for (center, sample) in centers.into_iter().zip(samples) {
                self.add_core(Cube { center, half: 0.5 * half, sample, levels, extra }, inside, out);
            }
            return;
        }
        // The field is as good as linear here: beyond - ∇sd · x.
        const N: i32 = 4;
        let step = 2.0 * half / f64::from(N);
        let slope = sample.gradient.abs().sum() * step;
        let at = |i: i32| (f64::from(i) + 0.5) * step - half;
        for (i, j, k) in (0..N * N * N).map(|n| (n % N, n / N % N, n / (N * N))) {
            let d = Vector3::new(at(i), at(j), at(k));
            let share = ((beyond - sample.gradient.dot(&d)) / slope + 0.5).clamp(0.0, 1.0);
            out.add_cube(&(center + d), step, share);
        }
    }
}

/// Steiner's formula for the inner parallel body, to second order in the thickness.
fn thin_wall(mesh: &TriMesh, wall_m: f64) -> Result<Hollow> {
    let (capped, tree) = close(mesh)?;
    let boundary = match capped.openings {
        0 => boundary(&capped.mesh, &tree, false),
        _ => Boundary::of_whole(&capped.mesh),
    };
    let Some(first) = boundary.fragments.first() else {
        return Err(Error::NoVolume { subject: "the mesh".into(), reason: "no face bounds a solid".into() });
    };
    let mut moments = Moments::about(first.corners[0]);
    for fragment in &boundary.fragments {
        let [a, b, c] = fragment.corners;
        let n = (b - a).cross(&(c - a));
        let inward = -n.try_normalize(0.0).unwrap_or_default() * wall_m;
        moments.add_prism(&fragment.corners, &inward, 0.5 * n.norm() * wall_m * fragment.weight);
    }
    if boundary.whole {
        add_edges(&capped.mesh, wall_m, &mut moments);
    }
    let properties = moments
        .mass_properties()
        .ok_or_else(|| Error::NoVolume { subject: "the mesh".into(), reason: "its wall has no volume".into() })?;
    Ok(Hollow { properties, volume_m3: properties.mass_kg, model: HollowModel::ThinWall })
}

/// Where walls meet: what they share along convex edges, what they lack along concave ones.
fn add_edges(mesh: &TriMesh, t: f64, moments: &mut Moments) {
    let topology = Topology::new(mesh);
    let normal = |f: u32| {
        let [a, b, c] = mesh.triangle(f as usize);
        (b - a).cross(&(c - a)).try_normalize(0.0)
    };
    for half in 0..3 * mesh.faces.len() as u32 {
        let partner = topology.partner[half as usize];
        if partner == NONE || partner < half {
            continue;
        }
        let (Some(m), Some(n)) = (normal(half / 3), normal(partner / 3)) else { continue };
        let (i, j) = ends(mesh, half);
        let [p, q] = [i, j].map(|v| mesh.vertices[v as usize]);
        let along = q - p;
        let theta = m.angle(&n);
        let convex = m.cross(&n).dot(&along) > 0.0;
        // The walls cannot share more than they have: a fold is not sharper than a right angle here.
        let area =
            if convex { -t * t * (0.5 * theta).min(std::f64::consts::FRAC_PI_4).tan() } else { 0.5 * t * t * theta };
        let inward = -(m + n).try_normalize(0.0).unwrap_or_default() * (0.5 * t);
        for s in [0.5 - 0.5 / 3.0_f64.sqrt(), 0.5 + 0.5 / 3.0_f64.sqrt()] {
            moments.add_point(&(p + along * s + inward), 0.5 * area * along.norm());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, sphere};
    use crate::solid_properties;

    fn unit(mesh: &TriMesh) -> MassProperties {
        solid_properties(mesh).unwrap().properties
    }

    fn relative(a: &MassProperties, b: &MassProperties) -> (f64, f64) {
        ((a.mass_kg / b.mass_kg - 1.0).abs(), (a.inertia - b.inertia).norm() / b.inertia.norm())
    }

    #[test]
    fn principal_axes_of_a_turned_box() {
        let turn = UnitQuaternion::from_euler_angles(0.4, -0.9, 2.1);
        let mesh = cuboid([0.0; 3], [0.02, 0.05, 0.11])
            .transformed(&drex_core::Pose::from_parts(Vector3::zeros().into(), turn));
        let p = unit(&mesh);
        let (moments, axes) = principal(&p);
        let v = 0.02 * 0.05 * 0.11;
        for (m, (a, b)) in moments.iter().zip([(0.02, 0.05), (0.02, 0.11), (0.05, 0.11)]) {
            assert!((m / (v / 12.0 * (a * a + b * b)) - 1.0).abs() < 1e-10);
        }
        let r = axes.to_rotation_matrix();
        let again = r.matrix() * Matrix3::from_diagonal(&moments) * r.matrix().transpose();
        assert!((again - p.inertia).norm() < 1e-12 * p.inertia.norm());
        assert!((r.matrix().determinant() - 1.0).abs() < 1e-12);
        // The smallest moment is about the longest side.
        assert!((axes * Vector3::x()).cross(&(turn * Vector3::z())).norm() < 1e-9);
    }

    #[test]
    fn impossible_bodies_are_refused_by_name() {
        let mesh = cuboid([0.0; 3], [0.1, 0.05, 0.02]);
        let good = unit(&mesh).with_mass(0.3);
        check_mass_properties(&good, &mesh.vertices).unwrap();
        let diagonal = |d: [f64; 3]| Matrix3::from_diagonal(&Vector3::from(d));
        let skewed = Matrix3::new(1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
        for (bad, word) in [
            (MassProperties { mass_kg: 0.0, ..good }, "mass is 0"),
            (MassProperties { inertia: diagonal([1.0, 1.0, -1.0]), ..good }, "positive definite"),
            (MassProperties { inertia: diagonal([1.0, 1.0, 2.1]), ..good }, "A + B < C"),
            (MassProperties { inertia: skewed, ..good }, "symmetric"),
            (MassProperties { center_of_mass: Point3::new(0.05, 0.025, 0.03), ..good }, "outside"),
            (MassProperties { inertia: diagonal([f64::NAN; 3]), ..good }, "inertia"),
        ] {
            let message = check_mass_properties(&bad, &mesh.vertices).unwrap_err().to_string();
            assert!(message.contains(word), "{message}");
        }
    }

    #[test]
    fn shells_of_boxes() {
        let size: [f64; 3] = [0.1, 0.06, 0.04];
        let mesh = cuboid([0.0; 3], size);
        for (t, tolerance, how) in [
            (0.01, 2e-3, HollowModel::Offset),
            (0.004, 2e-3, HollowModel::Offset),
            (0.001, 2e-3, HollowModel::Offset),
            (0.0005, 5e-4, HollowModel::ThinWall),
        ] {
            let wall = shell_properties(&mesh, t).unwrap();
            let core = unit(&cuboid([t; 3], size.map(|s| s - t)));
            let (dv, di) = relative(&wall.properties, &difference(&unit(&mesh), &core).unwrap());
            eprintln!("box, wall {t}: volume {dv:.1e}, inertia {di:.1e}");
            assert!(wall.model == how && dv < tolerance && di < tolerance, "{t}: {dv} {di} {:?}", wall.model);
            assert!((wall.properties.center_of_mass - Point3::new(0.05, 0.03, 0.02)).norm() < 1e-5);
        }
        assert_eq!(shell_properties(&mesh, 0.03).unwrap().model, HollowModel::Solid);
        assert!(shell_properties(&mesh, 0.0).is_err() && shell_properties(&mesh, f64::NAN).is_err());
    }

    #[test]
    fn a_missing_side_is_part_of_the_wall() {
        let size: [f64; 3] = [0.1, 0.06, 0.04];
        let mut open = cuboid([0.0; 3], size);
        open.faces.drain(2..4);
        for t in [0.004, 0.0005] {
            let (open, whole) =
                (shell_properties(&open, t).unwrap(), shell_properties(&cuboid([0.0; 3], size), t).unwrap());
            assert!(
                (open.volume_m3 / whole.volume_m3 - 1.0).abs() < 1e-3,
                "{t}: {} {}",
                open.volume_m3,
                whole.volume_m3
            );
            assert_eq!(open.model, whole.model);
        }
    }

    #[test]
    fn shells_of_spheres() {
        let mesh = sphere(0.05, 5);
        for t in [0.008, 0.002, 0.0005, 0.0001] {
            let wall = shell_properties(&mesh, t).unwrap();
            // The polyhedron's inner parallel body is the polyhedron with the inner radius.
            let core = unit(&mesh.scaled(1.0 - t / 0.05));
            let (dv, di) = relative(&wall.properties, &difference(&unit(&mesh), &core).unwrap());
            eprintln!("sphere, wall {t}: volume {dv:.1e}, inertia {di:.1e}, {:?}", wall.model);
            assert!(dv < 2e-3 && di < 2e-3, "{t}: {dv} {di}");
        }
    }
}
