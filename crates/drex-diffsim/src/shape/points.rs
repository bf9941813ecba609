//! A mesh surface as points with areas, in a tree of boxes.

use drex_core::TriMesh;
use nalgebra::{Point3, Vector3};

use crate::{Error, Result};

/// Points in a leaf of the tree at most.
const LEAF: usize = 8;

/// Points on a surface, each standing for a part of its area.
#[derive(Debug, Clone)]
pub struct SurfacePoints {
    tree: Tree,
    areas_m2: Vec<f64>,
}

impl SurfacePoints {
    /// The vertices of a mesh, each with a third of the area of its triangles. Vertices at one place are one point;
    /// vertices without area are left out. The order is that of the tree, not that of the mesh.
    ///
    /// # Errors
    /// If a vertex is not finite, a face names one that does not exist, or the mesh has no area.
    pub fn from_mesh(mesh: &TriMesh) -> Result<Self> {
        if mesh.vertices.iter().any(|p| p.iter().any(|c| !c.is_finite())) {
            return Err(Error::NotFinite { what: "a vertex of a surface".into() });
        }
        if mesh.faces.iter().flatten().any(|&v| v as usize >= mesh.vertices.len()) {
            return Err(Error::Shape {
                what: "a face of a surface names a vertex that does not exist".into(),
                remedy: "repair the mesh".into(),
            });
        }
        let mut areas = vec![0.0; mesh.vertices.len()];
        for face in 0..mesh.faces.len() {
            let [a, b, c] = mesh.triangle(face);
            let third = (b - a).cross(&(c - a)).norm() / 6.0;
            mesh.faces[face].iter().for_each(|&v| areas[v as usize] += third);
        }
        let mut points: Vec<(Point3<f64>, f64)> =
            mesh.vertices.iter().copied().zip(areas).filter(|(_, area)| *area > 0.0).collect();
        let key = |p: &Point3<f64>| [p.x, p.y, p.z];
        points.sort_by(|a, b| key(&a.0).partial_cmp(&key(&b.0)).unwrap_or(std::cmp::Ordering::Equal));
        points.dedup_by(|later, first| {
            later.0 == first.0 && {
                first.1 += later.1;
                true
            }
        });
        if points.is_empty() {
            return Err(Error::Shape { what: "a surface has no area".into(), remedy: "give its triangles".into() });
        }
        let (tree, order) = Tree::new(points.iter().map(|(p, _)| p.coords).collect());
        Ok(Self { tree, areas_m2: order.iter().map(|&i| points[i as usize].1).collect() })
    }

    /// The points, metres.
    pub fn points(&self) -> impl ExactSizeIterator<Item = Point3<f64>> + '_ {
        self.tree.points.iter().map(|p| Point3::from(*p))
    }

    /// The area of each point, m².
    pub fn areas_m2(&self) -> &[f64] {
        &self.areas_m2
    }

    pub(crate) fn tree(&self) -> &Tree {
        &self.tree
    }
}

/// Points in a binary tree of bounding boxes.
#[derive(Debug, Clone)]
pub(crate) struct Tree {
    pub points: Vec<Vector3<f64>>,
    /// In preorder: the first child of an inner node follows it.
    pub nodes: Vec<Node>,
}

/// A box around some points.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    pub center: Vector3<f64>,
    pub half: Vector3<f64>,
    /// Its points, a range.
    pub points: [u32; 2],
    /// The second child; zero for a leaf.
    pub second: u32,
}

impl Tree {
    /// The tree, and which point each of its points was.
    pub fn new(points: Vec<Vector3<f64>>) -> (Self, Vec<u32>) {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let mut nodes = Vec::new();
        split(&points, &mut order, 0, &mut nodes);
        (Self { points: order.iter().map(|&i| points[i as usize]).collect(), nodes }, order)
    }

    /// Hands every point to `visit` whose boxes all pass `near`, in order. Allocates nothing.
    pub fn visit(&self, mut near: impl FnMut(&Node) -> bool, mut visit: impl FnMut(u32, &Vector3<f64>)) {
        // A tree of 2^32 points is not deeper.
        let mut stack = [0_u32; 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let index = stack[depth];
            let node = &self.nodes[index as usize];
            if !near(node) {
                continue;
            }
            if node.second == 0 {
                (node.points[0]..node.points[1]).for_each(|i| visit(i, &self.points[i as usize]));
            } else {
                stack[depth] = node.second;
                stack[depth + 1] = index + 1;
                depth += 2;
            }
        }
    }
}

/// Appends the node of `order` and those below it; halves along the longest side.
fn split(points: &[Vector3<f64>], order: &mut [u32], start: usize, nodes: &mut Vec<Node>) {
    let Some(&first) = order.first() else { return };
    let first = points[first as usize];
    let (lo, hi) = order.iter().map(|&i| points[i as usize]).fold((first, first), |(l, h), p| (l.inf(&p), h.sup(&p)));
    let index = nodes.len();
    let range = [start as u32, (start + order.len()) as u32];
    nodes.push(Node { center: (lo + hi) / 2.0, half: (hi - lo) / 2.0, points: range, second: 0 });
    if order.len() > LEAF {
        let axis = (hi - lo).imax();
        let middle = order.len() / 2;
        order.select_nth_unstable_by(middle, |&a, &b| {
            points[a as usize][axis].total_cmp(&points[b as usize][axis]).then(a.cmp(&b))
        });
        let (below, above) = order.split_at_mut(middle);
        split(points, below, start, nodes);
        nodes[index].second = nodes.len() as u32;
        split(points, above, start + middle, nodes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of 2 n² triangles, each with vertices of its own.
    fn loose_square(n: u32) -> TriMesh {
        let (mut vertices, mut faces) = (Vec::new(), Vec::new());
        let at = |i: u32, j: u32| Point3::new(f64::from(i), f64::from(j), 0.0) / f64::from(n);
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            for t in [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]] {
                faces.push([0, 1, 2].map(|k| vertices.len() as u32 + k));
                vertices.extend(t);
            }
        }
        vertices.push(Point3::new(9.0, 9.0, 9.0));
        TriMesh::new(vertices, faces).unwrap()
    }

    #[test]
    fn areas_add_up_and_doubled_vertices_are_one() {
        let points = SurfacePoints::from_mesh(&loose_square(20)).unwrap();
        assert_eq!(points.points().len(), 21 * 21);
        assert!((points.areas_m2().iter().sum::<f64>() - 1.0).abs() < 1e-12);
        let corner = points.points().position(|p| p == Point3::origin()).unwrap();
        assert!((points.areas_m2()[corner] - 2.0 / 6.0 / 400.0).abs() < 1e-15);
    }

    #[test]
    fn a_visit_sees_what_is_near_and_little_else() {
        let points = SurfacePoints::from_mesh(&loose_square(200)).unwrap();
        let (mut boxes, mut seen) = (0, Vec::new());
        points.tree().visit(
            |n| {
                boxes += 1;
                n.center.x - n.half.x < 0.0101 && n.center.y - n.half.y < 0.0101
            },
            |i, p| seen.push((i, *p)),
        );
        assert_eq!(seen.iter().filter(|(_, p)| p.x < 0.0101 && p.y < 0.0101).count(), 9);
        assert!(seen.len() < 40 && boxes < 60, "{} points, {boxes} boxes", seen.len());
        assert!(seen.windows(2).all(|w| w[0].0 < w[1].0), "in order");
    }

    #[test]
    fn broken_surfaces_are_refused() {
        let mut mesh = loose_square(2);
        mesh.vertices[0].x = f64::NAN;
        assert!(matches!(SurfacePoints::from_mesh(&mesh), Err(Error::NotFinite { .. })));
        assert!(SurfacePoints::from_mesh(&TriMesh::default()).is_err());
        let wild = TriMesh { vertices: vec![Point3::origin(); 3], faces: vec![[0, 1, 7]] };
        assert!(matches!(SurfacePoints::from_mesh(&wild), Err(Error::Shape { .. })));
    }
}
