//! From a file's triangles to consistent shells: weld, drop what is degenerate, double or a loose component, wind outwards.

use std::collections::BTreeMap;

use serde::Serialize;

use drex_core::TriMesh;
use drex_core::sets::DisjointSets;

use crate::bvh::{Aabb, Bvh, segment_triangle_distance};
use crate::fill::{Filled, fill_holes};
use crate::intersect::meeting_faces;
use crate::orient::{Shell, align_patches, nesting, orient_shells};
use crate::topology::{NONE, Topology, split_pinched};
use crate::weld::drop_duplicates;
use crate::weld::{compact, weld};
use crate::{Error, Result};

/// Settings of [`repair`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RepairOptions {
    /// Vertices closer than this become one. `None`: 1e-7 of the bounding box's diagonal, a few steps of
    /// single precision.
    pub weld_m: Option<f64>,
    /// Shells closer than this belong to one body. `None`: 1e-3 of the bounding box's diagonal.
    pub touching_m: Option<f64>,
    /// Closed bodies with less than this share of the volume are dropped.
    pub smallest_volume_share: f64,
    /// Bodies that are not closed are dropped if they hold less than this share of the area.
    pub smallest_area_share: f64,
    /// Openings up to this wide are filled, wider ones stay open. `None`: 1/20 of the bounding box's diagonal.
    pub fill_narrower_m: Option<f64>,
    /// Whether sheets that meet at a common edge or vertex get vertices of their own.
    pub split_pinched: bool,
}

impl Default for RepairOptions {
    fn default() -> Self {
        // A fifth of the size by volume, a seventh by area.
        Self {
            weld_m: None,
            touching_m: None,
            smallest_volume_share: 0.01,
            smallest_area_share: 0.02,
            fill_narrower_m: None,
            split_pinched: true,
        }
    }
}

/// What [`repair`] found and did.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RepairReport {
    /// Vertices in the input.
    pub vertices_before: usize,
    /// Faces in the input.
    pub faces_before: usize,
    /// Vertices in the result.
    pub vertices: usize,
    /// Faces in the result.
    pub faces: usize,
    /// Faces dropped because two corners coincide or the corners lie on a line.
    pub degenerate_faces: usize,
    /// Faces dropped because the same triangle was there already.
    pub duplicate_faces: usize,
    /// Faces whose winding was turned round.
    pub flipped_faces: usize,
    /// Pieces of surface connected over edges.
    pub shells: usize,
    /// Shells that are closed.
    pub closed_shells: usize,
    /// Closed shells wound inwards inside another one: cavities.
    pub cavities: usize,
    /// Groups of shells that touch, overlap or contain each other.
    pub bodies: usize,
    /// Openings that were filled.
    pub filled_holes: usize,
    /// Area that was filled, m².
    pub filled_area_m2: f64,
    /// Edges without a face on the other side, before filling.
    pub open_edges_before: usize,
    /// Edges without a face on the other side.
    pub open_edges: usize,
    /// Edges at which more than two faces meet, before they were split.
    pub crowded_edges: usize,
    /// Vertices that were doubled because several sheets met in them.
    pub split_vertices: usize,
    /// Pairs of faces that cross or touch each other ([`crate::self_intersections`]). They stay as they are.
    pub self_intersections: usize,
    /// Bodies dropped because they hold too little volume or area.
    pub dropped: Vec<DroppedComponent>,
}

/// A loose component that was dropped.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct DroppedComponent {
    /// Its share of the volume of all shells; `None` if it is not closed.
    pub volume_share: Option<f64>,
    /// Its share of the mesh's area.
    pub area_share: f64,
    /// Its faces.
    pub faces: usize,
    /// Centre of its bounding box, metres.
    pub center_m: [f64; 3],
    /// Sides of its bounding box, metres.
    pub size_m: [f64; 3],
}

/// Welds the vertices, drops degenerate and duplicate faces, winds the faces of each shell consistently and closed
/// shells outwards, drops bodies that hold little volume (or area, if they are not closed), separates sheets that meet in
/// an edge or a vertex, fills small openings and counts faces that cross each other.
///
/// Shells that touch, overlap or contain each other are one body. A closed shell inside another keeps its winding
/// relative to it: wound the other way it is a cavity, wound the same way it is a part of the solid. Open surfaces
/// are turned as a whole so that they face away from their middle. If most of the area is there twice, facing both
/// ways (a double-sided export), one side is kept.
///
/// # Errors
/// If the mesh has no triangles, a vertex is not finite or a face names a vertex that does not exist.
pub fn repair(mesh: &TriMesh, options: &RepairOptions) -> Result<(TriMesh, RepairReport)> {
    if mesh.faces.is_empty() {
        return Err(Error::Empty { subject: "the mesh".into() });
    }
    let checked = TriMesh::new(mesh.vertices.clone(), mesh.faces.clone())?;
    let diagonal = checked.bounds().map_or(0.0, |(lo, hi)| (hi - lo).norm());
    let weld_m = options.weld_m.unwrap_or(1e-7 * diagonal);
    let touching_m = options.touching_m.unwrap_or(1e-3 * diagonal);

    let (mut clean, degenerate_faces) = weld(&checked, weld_m);
    let duplicate_faces = drop_duplicates(&mut clean);
    if clean.faces.is_empty() {
        return Err(Error::NoVolume {
            subject: "the mesh".into(),
            reason: format!("all {degenerate_faces} triangles have no area"),
        });
    }
    let mut turned = vec![false; clean.faces.len()];
    align_patches(&mut clean, &mut turned);
    let topology = Topology::new(&clean);
    let (labels, count) = topology.shells();
    let shells = describe_shells(&clean, &topology, &labels, count);
    let parents = nesting(&clean, &shells);
    let cavities = orient_shells(&mut clean, &shells, &parents, &mut turned);
    let bodies = group_bodies(&clean, &shells, &parents, touching_m);
    let (kept, dropped) = drop_components(&mut clean, &shells, &bodies, options);
    compact(&mut clean);

    let topology = Topology::new(&clean);
    let (open_edges_before, crowded_edges) = (topology.open_edges, topology.crowded_edges);
    let split_vertices = if options.split_pinched { split_pinched(&mut clean, &topology) } else { 0 };
    let filled = match options.fill_narrower_m.unwrap_or(0.05 * diagonal) {
        narrower_m if open_edges_before > 0 && narrower_m > 0.0 => fill_holes(&mut clean, narrower_m),
        _ => Filled::default(),
    };
    let topology = Topology::new(&clean);
    let (labels, count) = topology.shells();
    let body_count = kept.iter().map(|&s| bodies[s]).collect::<std::collections::BTreeSet<_>>().len();
    let report = RepairReport {
        vertices_before: mesh.vertices.len(),
        faces_before: mesh.faces.len(),
        vertices: clean.vertices.len(),
        faces: clean.faces.len(),
        degenerate_faces,
        duplicate_faces,
        flipped_faces: turned.iter().filter(|&&t| t).count(),
        shells: count,
        closed_shells: topology.closed_shells(&labels, count),
        cavities: kept.iter().filter(|&&s| cavities[s]).count(),
        bodies: body_count,
        filled_holes: filled.holes,
        filled_area_m2: filled.area_m2,
        open_edges_before,
        open_edges: topology.open_edges,
        crowded_edges,
        split_vertices,
        self_intersections: meeting_faces(&clean).0,
        dropped,
    };
    Ok((clean, report))
}

pub(crate) fn describe_shells(mesh: &TriMesh, topology: &Topology, labels: &[u32], count: usize) -> Vec<Shell> {
    let mut shells =
        vec![Shell { faces: Vec::new(), closed: true, bounds: Aabb::empty(), area_m2: 0.0, volume_m3: 0.0 }; count];
    for (f, &label) in labels.iter().enumerate() {
        let shell = &mut shells[label as usize];
        shell.faces.push(f as u32);
        shell.closed &= topology.partner[3 * f..3 * f + 3].iter().all(|&p| p != NONE);
        shell.bounds = shell.bounds.union(&Aabb::of(&mesh.triangle(f)));
    }
    for shell in &mut shells {
        let middle = nalgebra::center(&shell.bounds.lo, &shell.bounds.hi);
        for &f in &shell.faces {
            let [a, b, c] = mesh.triangle(f as usize).map(|p| p - middle);
            shell.area_m2 += (b - a).cross(&(c - a)).norm() * 0.5;
            shell.volume_m3 += a.dot(&b.cross(&c)) / 6.0;
        }
    }
    shells
}

/// The body (group of touching, overlapping or nested shells) of each shell.
fn group_bodies(mesh: &TriMesh, shells: &[Shell], parents: &[Option<usize>], touching_m: f64) -> Vec<u32> {
    let mut sets = DisjointSets::new(shells.len());
    for (i, parent) in parents.iter().enumerate() {
        if let Some(j) = parent {
            sets.join(i as u32, *j as u32);
        }
    }
    let mut shell_of = vec![0u32; mesh.faces.len()];
    for (i, shell) in shells.iter().enumerate() {
        shell.faces.iter().for_each(|&f| shell_of[f as usize] = i as u32);
    }
    if shells.len() > 1 {
        let tree = Bvh::new(mesh);
        for f in 0..mesh.faces.len() {
            let (tri, shell) = (mesh.triangle(f), shell_of[f]);
            for k in 0..3 {
                let (p, q) = (tri[k], tri[(k + 1) % 3]);
                tree.any_in(&Aabb::of(&[p, q]).fattened(touching_m), |g, t| {
                    let other = shell_of[g as usize];
                    if sets.find(shell) != sets.find(other) && segment_triangle_distance(&p, &q, t) <= touching_m {
                        sets.join(shell, other);
                    }
                    false
                });
            }
        }
    }
    sets.labels().0
}

/// Removes the faces of bodies with too little volume or area; returns the shells that stay.
fn drop_components(
    mesh: &mut TriMesh,
    shells: &[Shell],
    bodies: &[u32],
    options: &RepairOptions,
) -> (Vec<usize>, Vec<DroppedComponent>) {
    /// Area, volume and whether all shells are closed.
    #[derive(Clone, Copy)]
    struct Body(f64, f64, bool);
    let mut of: BTreeMap<u32, Body> = BTreeMap::new();
    for (s, &b) in shells.iter().zip(bodies) {
        let body = of.entry(b).or_insert(Body(0.0, 0.0, true));
        *body = Body(body.0 + s.area_m2, body.1 + s.volume_m3.abs(), body.2 && s.closed);
    }
    let area: f64 = of.values().map(|b| b.0).sum();
    let volume: f64 = of.values().map(|b| b.1).sum();
    let share = |b: u32| {
        let Body(a, v, closed) = of[&b];
        (a / area, (closed && volume > 0.0).then_some(v / volume))
    };
    let largest = of.values().map(|b| b.0).fold(0.0, f64::max);
    let stays = |b: u32| match share(b) {
        _ if of[&b].0 >= largest => true,
        (_, Some(v)) => v >= options.smallest_volume_share,
        (a, None) => a >= options.smallest_area_share,
    };
    let mut gone = vec![false; mesh.faces.len()];
    let mut dropped = Vec::new();
    for &b in of.keys().filter(|&&b| !stays(b)) {
        let mut bounds = Aabb::empty();
        let mut faces = 0;
        for (s, _) in shells.iter().zip(bodies).filter(|&(_, &body)| body == b) {
            bounds = bounds.union(&s.bounds);
            faces += s.faces.len();
            s.faces.iter().for_each(|&f| gone[f as usize] = true);
        }
        dropped.push(DroppedComponent {
            area_share: share(b).0,
            volume_share: share(b).1,
            faces,
            center_m: nalgebra::center(&bounds.lo, &bounds.hi).into(),
            size_m: (bounds.hi - bounds.lo).into(),
        });
    }
    dropped.sort_by(|a, b| b.area_share.total_cmp(&a.area_share));
    let mut f = 0;
    mesh.faces.retain(|_| {
        f += 1;
        !gone[f - 1]
    });
    ((0..shells.len()).filter(|&s| stays(bodies[s])).collect(), dropped)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::shapes::{cuboid, flipped, joined, sphere};

    fn fixed(mesh: &TriMesh) -> (TriMesh, RepairReport) {
        repair(mesh, &RepairOptions::default()).unwrap()
    }

    fn volume(mesh: &TriMesh) -> f64 {
        mesh.mass_properties(1.0).unwrap().mass_kg
    }

    fn soup(mesh: &TriMesh) -> TriMesh {
        let vertices = (0..mesh.faces.len()).flat_map(|f| mesh.triangle(f)).collect();
        TriMesh { vertices, faces: (0..mesh.faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect() }
    }

    #[test]
    fn a_soup_becomes_a_closed_mesh() {
        let (m, r) = fixed(&soup(&sphere(0.05, 3)));
        assert_eq!((m.vertices.len(), r.open_edges, r.shells, r.bodies), (258, 0, 1, 1));
    }

    #[test]
    fn inverted_doubled_and_mixed_winding_are_put_right() {
        let good = sphere(0.05, 3);
        let v = volume(&good);
        let mut mixed = good.clone();
        mixed.faces.iter_mut().step_by(3).for_each(|f| f.swap(0, 1));
        let mut twice = good.clone();
        twice.faces.extend(good.faces.iter().map(|&[a, b, c]| [b, c, a]));
        let mut both_sides = good.clone();
        both_sides.faces.extend(flipped(&good).faces);
        for bad in [flipped(&good), mixed, twice, both_sides] {
            let (m, r) = fixed(&bad);
            assert!((volume(&m) - v).abs() < 1e-15, "{r:?}");
            assert_eq!(r.open_edges, 0);
        }
    }

    #[test]
    fn one_inverted_box_of_two_touching_ones_is_turned() {
        let t =
            joined(&[cuboid([-3.0, 0.0, 0.0], [3.0, 2.0, 1.0]), flipped(&cuboid([-1.0, -4.0, 0.0], [1.0, 0.0, 1.0]))]);
        let (m, r) = fixed(&t);
        assert_eq!((r.shells, r.bodies, r.flipped_faces), (2, 1, 12));
        assert!((volume(&m) - 20.0).abs() < 1e-12);
    }

    #[test]
    fn a_cavity_stays_a_cavity_even_in_an_inverted_file() {
        let ball = joined(&[sphere(0.05, 3), flipped(&sphere(0.03, 3))]);
        for mesh in [ball.clone(), flipped(&ball)] {
            let (m, r) = fixed(&mesh);
            assert_eq!((r.cavities, r.bodies, r.shells), (1, 1, 2));
            let hollow = volume(&sphere(0.05, 3)) - volume(&sphere(0.03, 3));
            assert!((volume(&m) - hollow).abs() < 1e-15);
        }
    }

    #[test]
    fn loose_bits_go_and_are_listed_but_touching_ones_stay() {
        let body = cuboid([0.0; 3], [0.1; 3]);
        let crumb = |x: f64| cuboid([x, 0.0, 0.0], [x + 0.005, 0.005, 0.005]);
        let (m, r) = fixed(&joined(&[body.clone(), crumb(0.15)]));
        assert_eq!((m.faces.len(), r.dropped.len(), r.dropped[0].faces), (12, 1, 12));
        assert!((r.dropped[0].center_m[0] - 0.1525).abs() < 1e-12);
        let (m, r) = fixed(&joined(&[body, crumb(0.1)]));
        assert_eq!((m.faces.len(), r.dropped.len(), r.bodies), (24, 0, 1));
    }

    #[test]
    fn crossing_bars_are_one_body_although_no_corner_is_inside_the_other() {
        let plus = joined(&[cuboid([-3.0, -1.0, -1.0], [3.0, 1.0, 1.0]), cuboid([-1.0, -3.0, -0.5], [1.0, 3.0, 0.5])]);
        let stacked = joined(&[cuboid([-3.0, -1.0, 0.0], [3.0, 1.0, 1.0]), cuboid([-1.0, -3.0, 1.0], [1.0, 3.0, 2.0])]);
        for mesh in [plus, stacked] {
            assert_eq!(fixed(&mesh).1.bodies, 1);
        }
    }

    #[test]
    fn nothing_and_not_a_number_are_refused() {
        assert!(matches!(repair(&TriMesh::default(), &RepairOptions::default()), Err(Error::Empty { .. })));
        let mut m = cuboid([0.0; 3], [1.0; 3]);
        m.vertices[3].y = f64::NAN;
        assert!(repair(&m, &RepairOptions::default()).unwrap_err().to_string().contains("vertex 3"));
        m.vertices = vec![Point3::origin(); 8];
        assert!(matches!(repair(&m, &RepairOptions::default()), Err(Error::NoVolume { .. })));
    }
}
