//! A model of some photos while it is being refined: poses, lenses, points and where the photos show them.
//!
//! Pixel coordinates are the engine's: the centre of the first pixel is (0, 0).

use drex_core::Pose;
use drex_core::camera::CameraModel;
use nalgebra::{Matrix2, Matrix2x3, Point2, Point3, SMatrix, Translation3, UnitQuaternion, Vector2};
use openmvg_core::camera::{RadialDistortion, TangentialDistortion};
use openmvg_sfm::Camera;

use crate::mapping::Mapped;

/// A photo with its pose.
#[derive(Debug, Clone)]
pub(crate) struct View {
    /// Index of the photo among all.
    pub(crate) photo: usize,
    pub(crate) camera_from_world: Pose,
    /// Index of its lens in [`Model::lenses`].
    pub(crate) lens: usize,
}

impl View {
    /// Where the camera stands.
    pub(crate) fn centre(&self) -> Point3<f64> {
        self.camera_from_world.inverse().translation.vector.into()
    }
}

/// How many numbers a lens has.
pub(crate) const LENS_NUMBERS: usize = 7;

/// A lens and the size of its photos.
///
/// With x = X/Z, y = Y/Z, r² = x² + y², ρ = 1 + k1 r² + k2 r⁴: u = f (x ρ + 2 p1 x y + p2 (r² + 2 x²)) + cx and
/// v = f a (y ρ + p1 (r² + 2 y²) + 2 p2 x y) + cy, COLMAP's OPENCV model.
#[derive(Debug, Clone)]
pub(crate) struct Lens {
    /// f, cx, cy (pixels), k1, k2, p1, p2.
    pub(crate) numbers: [f64; LENS_NUMBERS],
    /// a, the second focal length in units of the first.
    pub(crate) aspect: f64,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl Lens {
    pub(crate) fn new(camera: &Camera, width: u32, height: u32) -> Self {
        let (fx, fy) = camera.focal_lengths().unwrap_or((1.0, 1.0));
        let mut numbers = [fx, 0.5 * f64::from(width) - 0.5, 0.5 * f64::from(height) - 0.5, 0.0, 0.0, 0.0, 0.0];
        match camera {
            Camera::Pinhole(own) => (numbers[1], numbers[2]) = (own.principal_x(), own.principal_y()),
            Camera::BrownConrady(own) => {
                let (radial, tangential) = (own.radial_distortion(), own.tangential_distortion());
                (numbers[1], numbers[2]) = (own.principal_x(), own.principal_y());
                (numbers[3], numbers[4]) = (radial.k1(), radial.k2());
                (numbers[5], numbers[6]) = (tangential.p1(), tangential.p2());
            }
            _ => {}
        }
        Self { numbers, aspect: fy / fx, width, height }
    }

    /// The lens of a camera of the workspace, whose first pixel has its centre at (0.5, 0.5); `None` for lenses with more than these numbers.
    pub(crate) fn of_camera(camera: &drex_core::camera::Camera) -> Option<Self> {
        let p = camera.params();
        let (k, aspect) = match camera.model() {
            CameraModel::SimplePinhole => ([0.0; 4], 1.0),
            CameraModel::Pinhole => ([0.0; 4], p[1] / p[0]),
            CameraModel::SimpleRadial => ([p[3], 0.0, 0.0, 0.0], 1.0),
            CameraModel::Radial => ([p[3], p[4], 0.0, 0.0], 1.0),
            CameraModel::OpenCv => ([p[4], p[5], p[6], p[7]], p[1] / p[0]),
            _ => return None,
        };
        let middle = camera.principal_point_px();
        let numbers = [p[0], middle.x - 0.5, middle.y - 0.5, k[0], k[1], k[2], k[3]];
        Some(Self { numbers, aspect, width: camera.width_px(), height: camera.height_px() })
    }

    /// The same lens as a camera of the engine.
    pub(crate) fn engine_camera(&self) -> Option<Camera> {
        let [f, cx, cy, k1, k2, p1, p2] = self.numbers;
        let (radial, tangential) = (RadialDistortion::K1K2(k1, k2), TangentialDistortion::P1P2(p1, p2));
        Camera::try_brown_conrady(f, f * self.aspect, cx, cy, radial, tangential).ok()
    }

    /// The same lens as a camera of the workspace.
    pub(crate) fn to_camera(&self) -> drex_core::Result<drex_core::camera::Camera> {
        use drex_core::camera::Camera;
        let [f, cx, cy, k1, k2, p1, p2] = self.numbers;
        let (cx, cy, size) = (cx + 0.5, cy + 0.5, (self.width, self.height));
        if self.aspect == 1.0 && [k2, p1, p2] == [0.0; 3] {
            return Camera::new(CameraModel::SimpleRadial, size.0, size.1, &[f, cx, cy, k1]);
        }
        Camera::new(CameraModel::OpenCv, size.0, size.1, &[f, f * self.aspect, cx, cy, k1, k2, p1, p2])
    }

    /// The pixel of a point in the camera's frame; `None` behind the camera or where the polynomial folds back.
    pub(crate) fn project(&self, p: &Point3<f64>) -> Option<Point2<f64>> {
        self.project_with_jacobians(p).map(|(pixel, ..)| pixel.into())
    }

    /// The pixel with its derivatives by the point and by [`Lens::numbers`].
    pub(crate) fn project_with_jacobians(
        &self,
        p: &Point3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>, SMatrix<f64, 2, LENS_NUMBERS>)> {
        if !(p.z > 1e-9) {
            return None;
        }
        let [f, cx, cy, k1, k2, p1, p2] = self.numbers;
        let (x, y) = (p.x / p.z, p.y / p.z);
        let r2 = x * x + y * y;
        let (radial, slope) = (1.0 + r2 * (k1 + r2 * k2), k1 + 2.0 * r2 * k2);
        if !(radial + 2.0 * r2 * slope > 0.0) {
            return None;
        }
        let bent = Vector2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let mixed = 2.0 * (x * y * slope + p1 * x + p2 * y);
        let bent_by_plane = Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            mixed,
            mixed,
            radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        let plane_by_point = Matrix2x3::new(1.0, 0.0, -x, 0.0, 1.0, -y) / p.z;
        let focal = Vector2::new(f, f * self.aspect);
        let pixel = bent.component_mul(&focal) + Vector2::new(cx, cy);
        let mut by_lens = SMatrix::<f64, 2, LENS_NUMBERS>::zeros();
        by_lens.set_column(0, &Vector2::new(bent.x, self.aspect * bent.y));
        by_lens[(0, 1)] = 1.0;
        by_lens[(1, 2)] = 1.0;
        let columns = [
            Vector2::new(x, y) * r2,
            Vector2::new(x, y) * r2 * r2,
            Vector2::new(2.0 * x * y, r2 + 2.0 * y * y),
            Vector2::new(r2 + 2.0 * x * x, 2.0 * x * y),
        ];
        for (k, column) in columns.iter().enumerate() {
            by_lens.set_column(3 + k, &column.component_mul(&focal));
        }
        Some((pixel, Matrix2::from_diagonal(&focal) * bent_by_plane * plane_by_point, by_lens))
    }
}

/// Where a photo shows a point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Observation {
    /// Index in [`Model::views`].
    pub(crate) view: usize,
    /// Index of the keypoint in the photo.
    pub(crate) keypoint: usize,
    pub(crate) pixel: Point2<f64>,
    /// Whether the pixel was found by aligning patches.
    pub(crate) aligned: bool,
}

/// A point of the scene.
#[derive(Debug, Clone)]
pub(crate) struct Point {
    pub(crate) position: Point3<f64>,
    pub(crate) rgb: [u8; 3],
    /// Sorted by view.
    pub(crate) observations: Vec<Observation>,
}

/// Poses, lenses and points.
#[derive(Debug, Clone)]
pub(crate) struct Model {
    pub(crate) views: Vec<View>,
    pub(crate) lenses: Vec<Lens>,
    pub(crate) points: Vec<Point>,
}

impl Model {
    /// What the engine found; `sizes` are those of all photos.
    pub(crate) fn new(mapped: &Mapped, sizes: &[[u32; 2]]) -> Self {
        let found = mapped.reconstruction();
        let mut index = vec![None; mapped.photos.len()];
        let (mut views, mut lenses): (Vec<View>, Vec<Option<Lens>>) =
            (Vec::new(), vec![None; found.camera_models().len()]);
        for (id, pose) in found.registered_views() {
            let (photo, lens) = (mapped.photos[id.index()], found.views()[id.index()].intrinsic_id.index());
            let [width, height] = sizes[photo];
            let camera = &found.camera_models()[lens];
            lenses[lens].get_or_insert_with(|| Lens::new(camera, width, height));
            index[id.index()] = Some(views.len());
            let rotation = UnitQuaternion::from_rotation_matrix(pose.pose.rotation());
            let camera_from_world = Pose::from_parts(Translation3::from(pose.pose.translation()), rotation);
            views.push(View { photo, camera_from_world, lens });
        }
        // Lenses of photos that have no pose go.
        let mut new_lens = vec![0; lenses.len()];
        let mut kept = 0;
        for (k, lens) in lenses.iter().enumerate() {
            new_lens[k] = kept;
            kept += usize::from(lens.is_some());
        }
        views.iter_mut().for_each(|v| v.lens = new_lens[v.lens]);
        let mut points: Vec<Point> = Vec::new();
        let mut last = None;
        for o in found.observations() {
            let Some(view) = index[o.view.index()] else { continue };
            if last != Some(o.landmark) {
                let Some(landmark) = found.landmarks().get(o.landmark) else { continue };
                points.push(Point { position: landmark.point, rgb: [0; 3], observations: Vec::new() });
                last = Some(o.landmark);
            }
            if let Some(point) = points.last_mut() {
                point.observations.push(Observation {
                    view,
                    keypoint: o.feature.index(),
                    pixel: o.pixel,
                    aligned: false,
                });
            }
        }
        points.iter_mut().for_each(|p| p.observations.sort_by_key(|o| o.view));
        Self { views, lenses: lenses.into_iter().flatten().collect(), points }
    }

    /// Where a view sees a point of the world, in pixels; `None` behind it or beyond its lens.
    pub(crate) fn project(&self, view: usize, position: &Point3<f64>) -> Option<Point2<f64>> {
        let View { camera_from_world, lens, .. } = &self.views[view];
        self.lenses[*lens].project(&(camera_from_world * position))
    }
}
