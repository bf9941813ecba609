//! The marker in rendered photos of another renderer, with exact cameras (shared data).

use std::path::{Path, PathBuf};

use drex_core::Pose;
use drex_core::camera::Camera;
use drex_core::pose::pose_from_wxyz;
use drex_sfm::marker::{Detection, Marker, Sighting, detect, metric, refine};
use nalgebra::{Point2, Point3};

/// Poses (camera from world) by name of photo.
type Poses = Vec<(String, Pose)>;

/// The set of photos and its cameras by name; `None`, with a word, without shared data.
fn plain50() -> Option<(PathBuf, Camera, Poses)> {
    let Some(shared) = std::env::var_os("DREX_SHARED") else {
        eprintln!("skipped: DREX_SHARED does not name the folder of shared data");
        return None;
    };
    let folder = Path::new(&shared).join("data/sfm/plain50");
    let Ok(cameras) = std::fs::read_to_string(folder.join("truth/cameras.txt")) else {
        eprintln!("skipped: {} is not there", folder.display());
        return None;
    };
    let line: Vec<&str> = cameras.lines().find(|l| !l.starts_with('#')).unwrap().split(' ').collect();
    let params: Vec<f64> = line[4..].iter().map(|v| v.parse().unwrap()).collect();
    let camera =
        Camera::from_colmap_name(line[1], line[2].parse().unwrap(), line[3].parse().unwrap(), &params).unwrap();
    let images = std::fs::read_to_string(folder.join("truth/images.txt")).unwrap();
    let poses = images
        .lines()
        .filter(|l| !l.starts_with('#') && !l.is_empty())
        .map(|l| {
            let words: Vec<&str> = l.split(' ').collect();
            let v: Vec<f64> = words[1..8].iter().map(|v| v.parse().unwrap()).collect();
            (words[9].to_string(), pose_from_wxyz([v[4], v[5], v[6]], [v[0], v[1], v[2], v[3]]).unwrap())
        })
        .collect();
    Some((folder, camera, poses))
}

/// Corners from `marker.json`: side 60 mm, centre (0.12, -0.11, 0.0008), yaw 0.4, its picture drawn upright by OpenCV, which
/// begins at the other end of the diagonal.
fn truth() -> [Point3<f64>; 4] {
    let (sin, cos) = 0.4_f64.sin_cos();
    [(1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(|(x, y)| {
        let (x, y) = (0.03 * x, 0.03 * y);
        Point3::new(0.12 + cos * x - sin * y, -0.11 + sin * x + cos * y, 0.0008)
    })
}

#[test]
fn scale_of_plain50_from_true_cameras() {
    let Some((folder, camera, poses)) = plain50() else { return };
    let marker: Marker = "tag36h11:11:0.06".parse().unwrap();
    let (mut plain, mut errors, mut sightings, mut outward, mut seconds) = (vec![], vec![], vec![], vec![], 0.0);
    for (name, pose) in &poses {
        let photo = image::open(folder.join("images").join(name)).unwrap().to_luma8();
        let (w, h) = (photo.width() as usize, photo.height() as usize);
        let start = std::time::Instant::now();
        let found = detect(&photo, w, h, &marker);
        seconds += start.elapsed().as_secs_f64();
        let Some(found) = found else { continue };
        let refined = refine(&photo, w, h, &marker, &found, &camera).expect("found above");
        let at = truth().map(|c| camera.project(&(pose * c)).unwrap());
        let middle = Point2::from(at.iter().map(|p| p.coords).sum::<nalgebra::Vector2<f64>>() / 4.0);
        let off = |d: &Detection| [0, 1, 2, 3].map(|k| Point2::from(d.corners[k]) - at[k]);
        plain.extend(off(&found).map(|e| e.norm()));
        errors.extend(off(&refined).map(|e| e.norm()));
        outward.extend(off(&refined).iter().zip(&at).map(|(e, p)| e.dot(&(p - middle).normalize())));
        sightings.push(Sighting { camera: camera.clone(), camera_from_world: *pose, corners: refined.corners });
    }
    let quantile = |v: &[f64], q| drex_core::stats::quantile(v.iter().copied(), q).unwrap();
    let fit = metric(&sightings, &marker).unwrap();
    let lean = fit.up.dot(&nalgebra::Vector3::z()).clamp(-1.0, 1.0).acos().to_degrees();
    let report = format!(
        "{} of {} photos in {seconds:.2} s; corners median {:.3} px, 90 % {:.3}, worst {:.3}, with the lens {:.3}, {:.3}, {:.3}, outward \
         {:.3}; scale {:.5} +- {:.5}, up {lean:.3} deg, centre {:.3} mm off, rms {:.3} px, spread {:.2} %, used {}, {:?}",
        sightings.len(),
        poses.len(),
        quantile(&plain, 0.5),
        quantile(&plain, 0.9),
        quantile(&plain, 1.0),
        quantile(&errors, 0.5),
        quantile(&errors, 0.9),
        quantile(&errors, 1.0),
        outward.iter().sum::<f64>() / outward.len() as f64,
        fit.scale,
        fit.scale_sigma,
        1e3 * (fit.centre - Point3::new(0.12, -0.11, 0.0008)).norm(),
        fit.rms_px,
        100.0 * fit.spread,
        fit.used.len(),
        fit.warning,
    );
    eprintln!("{report}");
    // OpenCV 4 finds the tag in 40 photos, corners at 0.49 px (median).
    assert!(sightings.len() >= 40 && quantile(&errors, 0.5) < 0.4, "{report}");
    assert!((fit.scale - 1.0).abs() < 0.005 && lean < 0.3, "{report}");
}
