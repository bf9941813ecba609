//! From the tag's plane to the photo: a homography, and the lens where it is known.

use drex_core::camera::Camera;
use nalgebra::{Matrix2, Matrix3, Point2, Point3, SMatrix, SVector, Vector2};

use super::tag36h11::SIDE;

/// Half the tag's side, cells.
const HALF: f64 = SIDE as f64 / 2.0;

/// Corners of the border's outer edge, cells from its top left corner, x right, y down, clockwise from the top left.
pub(super) const CORNERS: [Point2<f64>; 4] = [
    Point2::new(0.0, 0.0),
    Point2::new(2.0 * HALF, 0.0),
    Point2::new(2.0 * HALF, 2.0 * HALF),
    Point2::new(0.0, 2.0 * HALF),
];

/// How the plane of the homography reaches the photo.
#[derive(Clone, Copy)]
pub(super) enum Lens<'a> {
    /// The plane is the photo, in pixels: straight edges stay straight.
    Unknown,
    /// The plane lies at depth one before this camera.
    Known(&'a Camera),
}

impl Lens<'_> {
    /// The pixel of a point of the plane, and its derivative.
    fn pixel(self, plane: Point2<f64>) -> Option<(Point2<f64>, Matrix2<f64>)> {
        match self {
            Self::Unknown => Some((plane, Matrix2::identity())),
            Self::Known(camera) => {
                let (pixel, j) = camera.project_with_jacobian(&Point3::new(plane.x, plane.y, 1.0))?;
                Some((pixel, j.fixed_columns::<2>(0).into()))
            }
        }
    }

    /// The point of the plane that a pixel shows.
    pub(super) fn plane(self, pixel: Point2<f64>) -> Option<Point2<f64>> {
        match self {
            Self::Unknown => Some(pixel),
            Self::Known(camera) => {
                let ray = camera.unproject(&pixel)?;
                (ray.z > 1e-3).then(|| Point2::new(ray.x / ray.z, ray.y / ray.z))
            }
        }
    }
}

/// Homography from the tag (cells) to the plane: `middle + size h(u)` with u = cell/4 - 1, so that the numbers of h are near
/// one and its last is one.
#[derive(Clone)]
pub(super) struct Warp<'a> {
    lens: Lens<'a>,
    h: Matrix3<f64>,
    middle: Point2<f64>,
    size: f64,
}

/// The image of a point of the tag and what moves it.
pub(super) struct Imaged {
    pub(super) pixel: Point2<f64>,
    /// Derivative by the tag's coordinates, pixels per cell.
    pub(super) by_tag: Matrix2<f64>,
    /// Derivative by the first eight numbers of h, row by row, pixels.
    pub(super) by_h: SMatrix<f64, 2, 8>,
}

impl<'a> Warp<'a> {
    /// The warp that takes [`CORNERS`] to these pixels. `None` if they are not the corners of a convex quadrilateral.
    pub(super) fn new(corners: &[Point2<f64>; 4], lens: Lens<'a>) -> Option<Self> {
        let [a, b, c, d] = *corners;
        let plane = [lens.plane(a)?, lens.plane(b)?, lens.plane(c)?, lens.plane(d)?];
        let middle = Point2::from(plane.iter().map(|p| p.coords).sum::<Vector2<f64>>() / 4.0);
        let size = plane.iter().map(|p| (p - middle).norm()).fold(0.0, f64::max);
        let (mut m, mut y) = (SMatrix::<f64, 8, 8>::zeros(), SVector::<f64, 8>::zeros());
        for (i, (corner, at)) in CORNERS.iter().zip(plane).enumerate() {
            let u = corner.coords / HALF - Vector2::repeat(1.0);
            let p = (at - middle) / size;
            for axis in 0..2 {
                let row = 2 * i + axis;
                m.view_mut((row, 3 * axis), (1, 3)).copy_from(&SMatrix::<f64, 1, 3>::new(u.x, u.y, 1.0));
                m[(row, 6)] = -p[axis] * u.x;
                m[(row, 7)] = -p[axis] * u.y;
                y[row] = p[axis];
            }
        }
        let h = m.lu().solve(&y).filter(|h| h.iter().all(|v| v.is_finite()))?;
        let warp = Self { lens, h: Matrix3::from_fn(|r, c| h.get(3 * r + c).copied().unwrap_or(1.0)), middle, size };
        warp.is_sound().then_some(warp)
    }

    /// Whether the whole tag with its white margin lies before the camera, not mirrored.
    fn is_sound(&self) -> bool {
        let (far, near) = (1.0 + 1.0 / HALF, 1e-3);
        let all_before = [(-far, -far), (far, -far), (far, far), (-far, far)]
            .iter()
            .all(|(x, y)| self.h[(2, 0)] * x + self.h[(2, 1)] * y + 1.0 > near);
        all_before && self.h.determinant() > 0.0
    }

    /// The pixel of a point of the tag, cells.
    pub(super) fn pixel(&self, tag: Point2<f64>) -> Option<Point2<f64>> {
        self.image(tag).map(|i| i.pixel)
    }

    pub(super) fn image(&self, tag: Point2<f64>) -> Option<Imaged> {
        let u = tag.coords / HALF - Vector2::repeat(1.0);
        let q = self.h * u.push(1.0);
        if !(q.z > 0.0) {
            return None;
        }
        let p = q.xy() / q.z;
        let plane = self.middle + p * self.size;
        let (pixel, by_plane) = self.lens.pixel(plane)?;
        let by_u = (self.h.fixed_view::<2, 2>(0, 0) - p * self.h.fixed_view::<1, 2>(2, 0)) / q.z;
        let row = u.push(1.0).transpose() / q.z;
        let mut by_h = SMatrix::<f64, 2, 8>::zeros();
        for axis in 0..2 {
            by_h.view_mut((axis, 3 * axis), (1, 3)).copy_from(&row);
            by_h.view_mut((axis, 6), (1, 2)).copy_from(&(-p[axis] * row.fixed_columns::<2>(0)));
        }
        let to_pixel = by_plane * self.size;
        Some(Imaged { pixel, by_tag: to_pixel * by_u / HALF, by_h: to_pixel * by_h })
    }

    /// This warp with the first eight numbers of h moved. `None` if that turns it over.
    pub(super) fn moved(&self, step: &SVector<f64, 8>) -> Option<Self> {
        let h = Matrix3::from_fn(|r, c| self.h[(r, c)] + step.get(3 * r + c).copied().unwrap_or(0.0));
        let moved = Self { h, ..self.clone() };
        (h.iter().all(|v| v.is_finite()) && moved.is_sound()).then_some(moved)
    }

    /// Pixels of the tag's corners.
    pub(super) fn corners(&self) -> Option<[Point2<f64>; 4]> {
        let [a, b, c, d] = CORNERS;
        Some([self.pixel(a)?, self.pixel(b)?, self.pixel(c)?, self.pixel(d)?])
    }
}
