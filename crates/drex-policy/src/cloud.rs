//! The object as the network sees it: a fixed number of surface points, centred, scaled and encoded.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};

/// The centre of the bounding box. It depends less on how densely a part was sampled than the mean of the points does.
pub(crate) fn box_centre(points: &[Point3<f64>]) -> Vector3<f64> {
    let mut least = Vector3::repeat(f64::INFINITY);
    let mut most = Vector3::repeat(f64::NEG_INFINITY);
    for p in points {
        least = least.inf(&p.coords);
        most = most.sup(&p.coords);
    }
    (least + most) / 2.0
}

/// `count` of `points`, each next one farthest from those taken (Eldar et al. 1997). The first is the one farthest from
/// `centre`, so that the choice depends on the shape and not on the order of the points.
/// All points if there are no more than `count`.
pub(crate) fn farthest_points(points: &[Point3<f64>], centre: &Vector3<f64>, count: usize) -> Vec<Point3<f64>> {
    if points.len() <= count {
        return points.to_vec();
    }
    let mut gap: Vec<f64> = vec![f64::INFINITY; points.len()];
    let mut next = farthest(points.iter().map(|p| (p.coords - centre).norm_squared()));
    let mut taken = Vec::with_capacity(count);
    while taken.len() < count {
        let chosen = points[next];
        taken.push(chosen);
        for (g, p) in gap.iter_mut().zip(points) {
            *g = g.min((p - chosen).norm_squared());
        }
        next = farthest(gap.iter().copied());
    }
    taken
}

/// Index of the largest value, the first of equals; zero for none.
fn farthest(values: impl Iterator<Item = f64>) -> usize {
    let mut best = (0, f64::NEG_INFINITY);
    for (i, v) in values.enumerate() {
        if v > best.1 {
            best = (i, v);
        }
    }
    best.0
}

/// Numbers per point after [`encode`]: the coordinates themselves, then sine and cosine of each at each frequency.
pub(crate) fn encoding_width(frequencies: usize) -> usize {
    3 * (1 + 2 * frequencies)
}

/// Appends the positional encoding of a centred point (Mildenhall et al. 2020, equation 4): x/l, then sin(2^k π x/l), cos(2^k π x/l)
/// for k = 0 .. `frequencies`, per coordinate.
pub(crate) fn encode(point: &Vector3<f64>, length_m: f64, frequencies: usize, out: &mut Vec<f32>) {
    for x in point.iter() {
        let x = x / length_m;
        out.push(x as f32);
        let (mut sin, mut cos) = (PI * x).sin_cos();
        for _ in 0..frequencies {
            out.extend([sin as f32, cos as f32]);
            // Twice the angle: ten doublings lose three of f64's sixteen digits, and f32 keeps seven.
            (sin, cos) = (2.0 * sin * cos, (cos - sin) * (cos + sin));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_has_the_formula_and_the_order() {
        let mut out = Vec::new();
        encode(&Vector3::new(0.025, 0.0, -0.05), 0.1, 2, &mut out);
        assert_eq!(out.len(), encoding_width(2));
        let h = std::f32::consts::FRAC_1_SQRT_2;
        let expected = [0.25, h, h, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, -0.5, -1.0, 0.0, 0.0, -1.0];
        for (a, b) in out.iter().zip(expected) {
            assert!((a - b).abs() < 1e-6, "{out:?}");
        }
    }

    #[test]
    fn farthest_points_cover_the_shape_whatever_the_order() {
        // A line of 101 points: five of them must be the ends, the middle and the quarters.
        let mut points: Vec<_> = (0..=100).map(|i| Point3::new(f64::from(i) * 0.01, 0.0, 0.0)).collect();
        let centre = box_centre(&points);
        let sorted = |points: &[Point3<f64>]| {
            let mut xs: Vec<f64> = farthest_points(points, &centre, 5).iter().map(|p| p.x).collect();
            xs.sort_by(f64::total_cmp);
            xs
        };
        let forward = sorted(&points);
        points.reverse();
        let backward = sorted(&points);
        for (xs, name) in [(forward, "forward"), (backward, "backward")] {
            for (x, expected) in xs.iter().zip([0.0, 0.25, 0.5, 0.75, 1.0]) {
                assert!((x - expected).abs() < 1e-9, "{name}: {xs:?}");
            }
        }
    }

    #[test]
    fn few_points_are_kept() {
        let points = vec![Point3::origin(), Point3::new(1.0, 0.0, 0.0)];
        assert_eq!(farthest_points(&points, &Vector3::zeros(), 5), points);
    }
}
