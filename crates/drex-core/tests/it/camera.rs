//! Camera models against their inverse and against finite differences.

use drex_core::camera::{Camera, CameraModel};
use nalgebra::{Point2, Point3, Vector3};
use proptest::prelude::*;

/// Cameras as calibrations give them: distortion coefficients in the ranges of real phone, action and fisheye lenses.
fn cameras() -> impl Strategy<Value = Camera> {
    let coefficients = prop::collection::vec(-1.0..1.0f64, 8);
    (0..11i32, 300.0..1500.0f64, 0.9..1.1f64, -30.0..30.0f64, coefficients).prop_map(|(id, f, aspect, shift, c)| {
        let model = CameraModel::from_id(id).unwrap();
        let fisheye = matches!(
            model,
            CameraModel::OpenCvFisheye
                | CameraModel::SimpleRadialFisheye
                | CameraModel::RadialFisheye
                | CameraModel::ThinPrismFisheye
        );
        let mut c = c.into_iter();
        let params: Vec<f64> = model
            .parameter_names()
            .iter()
            .map(|name| match *name {
                "f" | "fx" => f,
                "fy" => f * aspect,
                "cx" => 320.0 + shift,
                "cy" => 240.0 - shift,
                "omega" => 0.9 + 0.4 * c.next().unwrap(),
                "p1" | "p2" | "sx1" | "sy1" => 0.005 * c.next().unwrap(),
                "k" | "k1" => (if fisheye { 0.05 } else { 0.15 }) * c.next().unwrap(),
                _ => 0.01 * c.next().unwrap(),
            })
            .collect();
        Camera::new(model, 640, 480, &params).unwrap()
    })
}

proptest! {
    #[test]
    fn a_pixel_looks_along_the_ray_it_came_from(camera in cameras(), x in -0.6..0.6f64, y in -0.5..0.5f64, z in 0.2..5.0f64) {
        let point = Point3::new(x * z, y * z, z);
        let pixel = camera.project(&point).unwrap();
        let ray = camera.unproject(&pixel).unwrap();
        prop_assert!((ray - point.coords.normalize()).norm() < 1e-9, "{}: {ray} for {point}", camera.model());
        let again = camera.project(&Point3::from(ray * 3.0)).unwrap();
        prop_assert!((again - pixel).norm() < 1e-7);
    }

    #[test]
    fn jacobians_agree_with_finite_differences(camera in cameras(), x in -0.6..0.6f64, y in -0.5..0.5f64, z in 0.5..3.0f64) {
        let point = Point3::new(x * z, y * z, z);
        let (_, jacobian) = camera.project_with_jacobian(&point).unwrap();
        let h = 1e-6;
        for k in 0..3 {
            let mut step = Vector3::zeros();
            step[k] = h;
            let (ahead, behind) = (camera.project(&(point + step)).unwrap(), camera.project(&(point - step)).unwrap());
            let numeric = (ahead - behind) / (2.0 * h);
            prop_assert!(
                (numeric - jacobian.column(k)).norm() < 1e-5 * (1.0 + jacobian.norm()),
                "{}: {numeric} against {}", camera.model(), jacobian.column(k)
            );
        }
    }

    #[test]
    fn any_parameters_and_any_pixel_are_survived(
        id in 0..11i32,
        params in prop::collection::vec(prop_oneof![Just(0.0), -1e3..1e3f64, prop::num::f64::ANY], 12),
        pixel in (prop::num::f64::ANY, prop::num::f64::ANY),
        near in (-700.0..1400.0f64, -700.0..1400.0f64),
    ) {
        let model = CameraModel::from_id(id).unwrap();
        let n = model.parameter_names().len();
        if let Ok(camera) = Camera::new(model, 640, 480, &params[..n]) {
            for (u, v) in [pixel, near] {
                if let Some(ray) = camera.unproject(&Point2::new(u, v)) {
                    prop_assert!((ray.norm() - 1.0).abs() < 1e-9);
                }
            }
        }
    }
}

#[test]
fn the_optical_axis_hits_the_principal_point() {
    for model in CameraModel::ALL {
        let params: Vec<f64> = model
            .parameter_names()
            .iter()
            .map(|n| {
                if n.starts_with('f') {
                    500.0
                } else if n.starts_with('c') {
                    300.0
                } else {
                    0.01
                }
            })
            .collect();
        let camera = Camera::from_colmap_name(model.name(), 640, 480, &params).unwrap();
        let pixel = camera.project(&Point3::new(0.0, 0.0, 2.0)).unwrap();
        assert_eq!((pixel.x, pixel.y), (300.0, 300.0), "{model}");
        assert!((camera.unproject(&pixel).unwrap() - Vector3::z()).norm() < 1e-12);
        // Close to the axis, where series take over, the map is smooth.
        let near = camera.project(&Point3::new(1e-7, -1e-7, 1.0)).unwrap();
        assert!((near - pixel).norm() < 1e-3);
    }
}

#[test]
fn values_by_hand() {
    // OPENCV, x' = 0.2, y' = -0.1, r² = 0.05: ρ = 1 + 0.1·0.05 + 0.2·0.0025 = 1.0055.
    let camera = Camera::from_colmap_id(4, 640, 480, &[500.0, 600.0, 320.0, 240.0, 0.1, 0.2, 0.01, -0.02]).unwrap();
    let pixel = camera.project(&Point3::new(0.4, -0.2, 2.0)).unwrap();
    let u = 0.2 * 1.0055 + 2.0 * 0.01 * 0.2 * -0.1 + -0.02 * (0.05 + 2.0 * 0.04);
    let v = -0.1 * 1.0055 + 2.0 * -0.02 * 0.2 * -0.1 + 0.01 * (0.05 + 2.0 * 0.01);
    assert!((pixel - Point2::new(500.0 * u + 320.0, 600.0 * v + 240.0)).norm() < 1e-10);
    // OPENCV_FISHEYE without distortion is equidistant: 45 degrees lie at f π/4; it also sees sideways and backwards.
    let fisheye = Camera::from_colmap_id(5, 640, 480, &[200.0, 200.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
    let pixel = fisheye.project(&Point3::new(1.0, 0.0, 1.0)).unwrap();
    assert!((pixel.x - (320.0 + 50.0 * std::f64::consts::PI)).abs() < 1e-10);
    let behind = Vector3::new(0.6, 0.0, -0.8);
    let pixel = fisheye.project(&Point3::from(behind)).unwrap();
    assert!((fisheye.unproject(&pixel).unwrap() - behind).norm() < 1e-12);
    // FOV leaves the radius 1/2 where it is, whatever ω.
    let fov = Camera::from_colmap_id(7, 640, 480, &[100.0, 100.0, 0.0, 0.0, 1.2]).unwrap();
    let pixel = fov.project(&Point3::new(1.0, 0.0, 2.0)).unwrap();
    assert!((pixel.x - 50.0).abs() < 1e-10);
}

#[test]
fn beyond_the_fold_there_is_no_ray_and_wrong_parameters_are_refused() {
    // r (1 - 0.5 r²) has its largest value 0.544 at r = 0.816: a pixel beyond it has no ray.
    let camera = Camera::from_colmap_id(2, 640, 480, &[100.0, 0.0, 0.0, -0.5]).unwrap();
    assert!(camera.unproject(&Point2::new(54.0, 0.0)).is_some());
    assert!(camera.unproject(&Point2::new(55.0, 0.0)).is_none());
    assert!(camera.project(&Point3::new(0.81, 0.0, 1.0)).is_some());
    assert!(camera.project(&Point3::new(0.82, 0.0, 1.0)).is_none());
    assert!(camera.project(&Point3::new(1.5, 0.0, 1.0)).is_none(), "it would come back on the other side");
    assert!(camera.project(&Point3::new(0.0, 0.0, -1.0)).is_none());
    let message = Camera::from_colmap_id(4, 640, 480, &[500.0; 4]).unwrap_err().to_string();
    assert!(message.contains("OPENCV") && message.contains("fx, fy, cx, cy, k1, k2, p1, p2"), "{message}");
    assert!(Camera::from_colmap_id(99, 640, 480, &[]).is_err() && Camera::from_colmap_name("X", 1, 1, &[]).is_err());
    assert!(Camera::from_colmap_id(0, 640, 480, &[-1.0, 0.0, 0.0]).is_err());
    assert!(Camera::from_colmap_id(0, 0, 480, &[1.0, 0.0, 0.0]).is_err());
}

#[test]
fn a_resized_camera_scales_its_pixels() {
    let camera = Camera::from_colmap_id(4, 640, 480, &[500.0, 510.0, 320.5, 239.0, 0.1, -0.2, 0.001, 0.002]).unwrap();
    let half = camera.resized(320, 240).unwrap();
    let point = Point3::new(0.2, -0.1, 1.0);
    let (a, b) = (camera.project(&point).unwrap(), half.project(&point).unwrap());
    assert!((a.coords * 0.5 - b.coords).norm() < 1e-10);
}
