//! A textured mesh as coloured points, and how well these show photos that it was not made of.

use drex_core::capture::{Capture, PhotoOptions, Photos};
use drex_core::stats::median;
use drex_core::{Result, TriMesh};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use super::display;
use super::shot::{Shot, linear};

/// Colours that are compared to tell exposures lie above this, linear light.
const USABLE: f32 = 0.004;

/// A place on a textured mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TexturedPoint {
    /// Index of its face.
    pub face: usize,
    /// Frame of the mesh.
    pub position: Point3<f64>,
    /// Unit normal of the face.
    pub normal: Vector3<f64>,
    /// Colour of the picture there, sRGB.
    pub rgb: [u8; 3],
}

/// About `count` points of a mesh, each standing for the same area, in the colours of a picture of `[width, height]` pixels. `uv` are the texture
/// coordinates of the corners of each face, as [`super::Texture`] has them.
pub fn textured_points(
    mesh: &TriMesh,
    uv: &[[[f32; 2]; 3]],
    ([width, height], rgb): ([usize; 2], &[[u8; 3]]),
    count: usize,
) -> Vec<TexturedPoint> {
    let across = |f: usize| {
        let [a, b, c] = mesh.triangle(f);
        (b - a).cross(&(c - a))
    };
    let pixel = |t: f64, n: usize| ((t * n as f64).max(0.0) as usize).min(n.saturating_sub(1));
    let area = |f: usize| 0.5 * across(f).norm();
    let each = (0..mesh.faces.len()).map(area).sum::<f64>() / count as f64;
    let (mut out, mut owed) = (Vec::with_capacity(count), 0.5);
    for (face, uv) in uv.iter().enumerate().take(mesh.faces.len()) {
        owed += area(face) / each;
        while owed >= 1.0 {
            owed -= 1.0;
            // A sequence that fills the unit square evenly (Roberts 2018, the plastic number), uniform over the triangle (Osada et al. 2002, 4.2).
            let at = |step: f64| (step * (out.len() + 1) as f64).fract();
            let (s, t) = (at(0.754_877_666_246_693).sqrt(), at(0.569_840_290_998_053));
            let weights = [1.0 - s, s * (1.0 - t), s * t];
            let corners = mesh.triangle(face);
            let position = (0..3).map(|k| corners[k].coords * weights[k]).sum::<Vector3<f64>>().into();
            let [u, v] = [0, 1].map(|i| (0..3).map(|k| weights[k] * f64::from(uv[k][i])).sum::<f64>());
            let rgb = rgb.get(pixel(v, height) * width + pixel(u, width)).copied().unwrap_or_default();
            out.push(TexturedPoint { face, position, normal: across(face).normalize(), rgb });
        }
    }
    out
}

/// How well points in their colours show photos.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[non_exhaustive]
pub struct Prediction {
    /// Pixels that show them.
    pub pixels: f64,
    /// Sum of their square differences of colour, sRGB from 0 to 1.
    pub square_error: f64,
}

/// How well coloured points of a mesh show the photos of `capture`, for each of `regions` parts of it; `region_of` has the part of each face, or none. What
/// is in front of what the mesh says. Each photo has an exposure per channel, found on the other faces, or on all where it shows few others.
///
/// # Errors
/// If a photo cannot be read.
pub fn prediction(
    mesh: &TriMesh,
    points: &[TexturedPoint],
    region_of: &[Option<usize>],
    regions: usize,
    capture: &Capture,
) -> Result<Vec<Prediction>> {
    let mut options = PhotoOptions::default();
    options.memory_bytes = 0;
    let photos = Photos::new(capture, options)?;
    let area = mesh.area() / points.len().max(1) as f64;
    let mut out = vec![Prediction::default(); regions];
    let level: [f32; 256] = std::array::from_fn(|v| linear(v as f32 / 255.0));
    for i in 0..photos.len() {
        let Some(shot) = Shot::new(&*photos.get(i)?, mesh, 0.0) else { continue };
        let sample = |p: &TexturedPoint| {
            let s = shot.sample(&p.position, &p.normal)?;
            let pixels = area * f64::from(s.resolution * s.resolution * s.cosine);
            let region = region_of.get(p.face).copied().flatten().filter(|r| *r < regions);
            Some((region, p.rgb.map(|v| level[usize::from(v)]), s.full, pixels))
        };
        let seen: Vec<_> = points.par_iter().filter_map(sample).collect();
        let others = seen.iter().filter(|s| s.0.is_none()).count();
        let few = 4 * others < seen.len();
        let ratio = |k: usize| {
            let of = seen.iter().filter(|s| (few || s.0.is_none()) && s.1[k].min(s.2[k]) > USABLE);
            median(of.map(|s| f64::from(s.2[k] / s.1[k]))).unwrap_or(1.0) as f32
        };
        let gain = [0, 1, 2].map(ratio);
        for (region, own, shown, pixels) in &seen {
            let Some(part) = region.and_then(|r| out.get_mut(r)) else { continue };
            let off = |k: usize| f64::from(display(own[k] * gain[k]) - display(shown[k])).powi(2) / 3.0;
            part.square_error += pixels * (0..3).map(off).sum::<f64>();
            part.pixels += pixels;
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_evenly_on_the_surface_and_where_the_picture_says() {
        // A strip of two squares, the second four times as fine; u and v are x and y of a quarter of the length.
        let (mut vertices, mut faces) = (vec![], vec![]);
        for (x0, n) in [(0.0, 2), (1.0, 8)] {
            for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
                let h = 1.0 / f64::from(n);
                let (x, y) = (x0 + h * f64::from(i), h * f64::from(j));
                let first = vertices.len() as u32;
                vertices.extend([[x, y], [x + h, y], [x + h, y + h], [x, y + h]].map(|[x, y]| Point3::new(x, y, 0.0)));
                faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            }
        }
        let mesh = TriMesh::new(vertices, faces).unwrap();
        let at = |v: u32| mesh.vertices[v as usize];
        let uv: Vec<_> = mesh.faces.iter().map(|f| f.map(|v| [at(v).x as f32 / 4.0, at(v).y as f32 / 4.0])).collect();
        let picture: Vec<[u8; 3]> = (0..40 * 40).map(|i| [(i % 40) as u8, (i / 40) as u8, 7]).collect();
        let points = textured_points(&mesh, &uv, ([40, 40], &picture), 400);
        assert!(points.len().abs_diff(400) <= 1, "{}", points.len());
        for p in &points {
            assert!((p.normal - Vector3::z()).norm() < 1e-9, "{p:?}");
            let [a, b, c] = mesh.triangle(p.face);
            assert!((p.position - nalgebra::center(&a, &nalgebra::center(&b, &c))).norm() < 0.6, "{p:?}");
            let expected = [10.0 * p.position.x, 10.0 * p.position.y].map(|v| v + 1e-4);
            assert!((0..2).all(|k| (f64::from(p.rgb[k]) - expected[k].floor()).abs() < 1.5), "{p:?}");
        }
        let left = points.iter().filter(|p| p.position.x < 1.0).count();
        assert!(left.abs_diff(200) < 6, "{left} of {} on the coarse half", points.len());
    }
}
