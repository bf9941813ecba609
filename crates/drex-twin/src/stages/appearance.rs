//! Gaussians that show what the photos of the scan show, born on the mesh.

use std::path::{Path, PathBuf};

use drex_core::capture::read_rgb;
use drex_mesh::{ModelPart, Similarity, read_model};
use drex_splat::ReconstructOptions;
use drex_splat::train::SurfacePoint;
use nalgebra::{Matrix4, Point3, Vector3};

use super::scan::photos_of;
use crate::error::Context;
use crate::reconstruct::train_gaussians;
use crate::records::{HELD_OUT, SCAN, SPLAT_REPORT, ScanFile, read_json};
use crate::{Progress, Result, Twin};

/// Gaussians that are born on the mesh.
const BORN: usize = 30_000;
/// Every so many photos one is not trained on but measured against.
const HOLD_OUT: usize = 8;

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let config = twin.manifest.scan.as_ref().context("the manifest has no [scan]")?;
    let made: ScanFile = read_json(&twin.path(SCAN))?;
    let photos = photos_of(twin, &made)?;
    if photos.views.iter().all(|v| v.depth.is_some()) {
        // The frames of a depth camera: nothing is trained on them.
        return Ok(Vec::new());
    }
    let mesh_from_scan = Similarity::from_matrix(&Matrix4::from_fn(|r, c| made.scan.mesh_from_scan[r][c]))?;
    let mut options = ReconstructOptions::default();
    options.born = points_on(&twin.path("mesh/visual.obj"), &mesh_from_scan)?;
    options.preset = config.preset.of_training();
    (options.iterations, options.seed, options.surface) = (config.iterations, twin.seed, false);
    options.hold_out = Some(HOLD_OUT);
    train_gaussians(&photos, &twin.root, &options, false, progress)?;
    ["splat/appearance.ply", SPLAT_REPORT, HELD_OUT].into_iter().map(|name| twin.output(name)).collect()
}

/// Points spread over a mesh in the colours of the picture on it, in the frame and unit of the scan; none if there is no picture.
fn points_on(file: &Path, mesh_from_scan: &Similarity) -> Result<Vec<SurfacePoint>> {
    let picture = file.with_extension("png");
    if !picture.is_file() {
        return Ok(Vec::new());
    }
    let ([width, height], rgb) = read_rgb(&picture)?;
    let color = |[u, v]: [f64; 2]| {
        let pixel = |t: f64, n: usize| ((t * n as f64).max(0.0) as usize).min(n.saturating_sub(1));
        rgb[pixel(v, height) * width + pixel(u, width)]
    };
    let scan_from_mesh = mesh_from_scan.inverse();
    let mut out = Vec::with_capacity(BORN);
    for part in read_model(file)?.parts {
        let point = |(at, normal, uv): (Point3<f64>, Vector3<f64>, [f64; 2])| {
            let position = scan_from_mesh.point(&at).into();
            SurfacePoint { position, normal: (scan_from_mesh.rotation * normal).into(), rgb: color(uv) }
        };
        out.extend(spread(&part, BORN).into_iter().map(point));
    }
    Ok(out)
}

/// About `count` points of a surface with texture coordinates, each standing for the same area, with the coordinates there.
fn spread(part: &ModelPart, count: usize) -> Vec<(Point3<f64>, Vector3<f64>, [f64; 2])> {
    let Some(uv) = &part.uv else { return Vec::new() };
    let across = |f: usize| {
        let [a, b, c] = part.mesh.triangle(f);
        (b - a).cross(&(c - a))
    };
    let area = |f: usize| 0.5 * across(f).norm();
    let each = (0..part.mesh.faces.len()).map(area).sum::<f64>() / count as f64;
    let (mut out, mut owed) = (Vec::new(), 0.5);
    for (f, face) in part.mesh.faces.iter().enumerate() {
        owed += area(f) / each;
        while owed >= 1.0 {
            owed -= 1.0;
            // A sequence that fills the unit square evenly (Roberts 2018, the plastic number), uniform over the triangle (Osada et al. 2002, 4.2).
            let at = |step: f64| (step * (out.len() + 1) as f64).fract();
            let (s, t) = (at(0.754_877_666_246_693).sqrt(), at(0.569_840_290_998_053));
            let weights = [1.0 - s, s * (1.0 - t), s * t];
            let corners = part.mesh.triangle(f);
            let at = (0..3).map(|k| corners[k].coords * weights[k]).sum::<Vector3<f64>>();
            let along = |i: usize| (0..3).map(|k| weights[k] * f64::from(uv[face[k] as usize][i])).sum();
            out.push((at.into(), across(f).normalize(), [along(0), along(1)]));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::TriMesh;

    #[test]
    fn points_lie_evenly_on_the_surface_and_where_the_picture_says() {
        // A strip of two squares, the second four times as fine; u and v are x and y of a quarter of the length.
        let mut vertices = vec![];
        let mut faces = vec![];
        for (x0, side, n) in [(0.0, 1.0, 2), (1.0, 1.0, 8)] {
            for i in 0..n {
                for j in 0..n {
                    let h = side / f64::from(n);
                    let (x, y) = (x0 + h * f64::from(i), h * f64::from(j));
                    let first = vertices.len() as u32;
                    vertices
                        .extend([[x, y], [x + h, y], [x + h, y + h], [x, y + h]].map(|[x, y]| Point3::new(x, y, 0.0)));
                    faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
                }
            }
        }
        let uv = vertices.iter().map(|v: &Point3<f64>| [v.x as f32 / 4.0, v.y as f32 / 4.0]).collect();
        let mesh = TriMesh::new(vertices, faces).unwrap();
        let part = ModelPart { mesh, uv: Some(uv), ..ModelPart::default() };
        let points = spread(&part, 400);
        assert!(points.len().abs_diff(400) <= 1, "{}", points.len());
        for (p, n, [u, v]) in &points {
            assert!((n - Vector3::z()).norm() < 1e-9, "{n}");
            assert!((p.x / 4.0 - u).abs() < 1e-6 && (p.y / 4.0 - v).abs() < 1e-6, "{p} {u} {v}");
        }
        let left = points.iter().filter(|(p, ..)| p.x < 1.0).count();
        assert!(left.abs_diff(200) < 6, "{left} of {} on the coarse half", points.len());
        assert!(spread(&ModelPart { uv: None, ..part }, 400).is_empty());
    }
}
