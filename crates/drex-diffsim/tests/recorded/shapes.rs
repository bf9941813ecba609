//! The shapes of a recorded object: the primitives of its scene, or the convex parts of its mesh.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use drex_core::Pose;
use drex_diffsim::{ConvexPolyhedron, Geom, Shape};
use nalgebra::{Point3, Vector3};

/// Vertices closer than this are one, metres; the files have six digits.
const WELD_M: f64 = 2e-6;

/// Boxes and cylinders of class `obj` in a scene; they are placed along the body's axes.
pub fn primitives(path: &Path) -> Vec<Geom> {
    let text = std::fs::read_to_string(path).unwrap();
    let document = roxmltree::Document::parse(&text).unwrap();
    let geoms = document.descendants().filter(|n| n.has_tag_name("geom") && n.attribute("class") == Some("obj"));
    geoms
        .map(|geom| {
            let list = |key: &str| -> Vec<f64> {
                geom.attribute(key).unwrap().split_whitespace().map(|x| x.parse().unwrap()).collect()
            };
            let (size, p, turn) = (list("size"), list("pos"), list("euler"));
            assert!(turn.iter().all(|x| *x == 0.0), "{}: a turned shape", path.display());
            let shape = match geom.attribute("type") {
                Some("box") => Shape::Box { half_m: Vector3::from_vec(size) },
                Some("cylinder") => Shape::Cylinder { radius_m: size[0], half_length_m: size[1] },
                other => panic!("{}: {other:?}", path.display()),
            };
            Geom::new(shape).at(Pose::translation(p[0], p[1], p[2]))
        })
        .collect()
}

/// Distance of a point outside of boxes and cylinders, in front of their nearest face.
pub fn gap(shapes: &[Geom], point: &Point3<f64>) -> f64 {
    let one = |geom: &Geom| {
        let x = geom.body_from_shape.inverse() * point;
        match &geom.shape {
            Shape::Box { half_m } => (x.coords.abs() - half_m).max(),
            Shape::Cylinder { radius_m, half_length_m } => {
                (x.coords.xy().norm() - radius_m).max(x.z.abs() - half_length_m)
            }
            _ => f64::MAX,
        }
    };
    shapes.iter().map(one).fold(f64::MAX, f64::min)
}

/// The closed parts of a mesh as convex polyhedra.
pub fn pieces(path: &Path) -> Vec<Geom> {
    let piece = |points: Vec<Point3<f64>>| ConvexPolyhedron::from_points(&points).unwrap();
    closed_shells(path).into_iter().map(|p| Geom::new(Shape::Convex(Arc::new(piece(p))))).collect()
}

/// Points of each closed surface, in the order of the file: a part ends with the face that leaves no edge open.
fn closed_shells(path: &Path) -> Vec<Vec<Point3<f64>>> {
    let text = std::fs::read_to_string(path).unwrap();
    let (mut points, mut welded) = (Vec::<Point3<f64>>::new(), Vec::<usize>::new());
    let (mut open, mut shell, mut shells) = (BTreeSet::new(), BTreeSet::<usize>::new(), Vec::new());
    for line in text.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let x: Vec<f64> = words.map(|w| w.parse().unwrap()).collect();
                let p = Point3::new(x[0], x[1], x[2]);
                welded.push(points.iter().position(|q| (q - p).norm() < WELD_M).unwrap_or(points.len()));
                points.push(p);
            }
            Some("f") => {
                let index = |w: &str| w.split('/').next().unwrap().parse::<usize>().unwrap() - 1;
                let f: Vec<usize> = words.map(|w| welded[index(w)]).collect();
                shell.extend(&f);
                for k in 0..3 {
                    let (a, b) = (f[k], f[(k + 1) % 3]);
                    if !open.remove(&(b, a)) {
                        open.insert((a, b));
                    }
                }
                if open.is_empty() {
                    shells.push(std::mem::take(&mut shell).into_iter().map(|i| points[i]).collect());
                }
            }
            _ => {}
        }
    }
    assert!(open.is_empty(), "{} is not closed", path.display());
    shells
}
