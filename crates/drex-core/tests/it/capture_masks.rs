//! Misplaced masks: the one in a real scan, masks moved by hand, masks turned inside out.

use std::path::Path;

use drex_core::camera::CameraModel;
use drex_core::capture::{Capture, CaptureOptions};
use image::{GrayImage, Luma};
use nalgebra::Point3;

use crate::capture_support::{lens, on_disk, ring};

fn misplaced(folder: &Path, masks: &Path) -> Vec<String> {
    let mut options = CaptureOptions::default();
    options.masks = Some(masks.to_path_buf());
    let report = Capture::load(folder, &options).unwrap().report().unwrap();
    report.misplaced_masks().into_iter().map(String::from).collect()
}

/// A mask moved by whole pixels; what comes in is background.
fn moved(mask: &GrayImage, by: [i64; 2]) -> GrayImage {
    GrayImage::from_fn(mask.width(), mask.height(), |x, y| {
        let [x, y] = [i64::from(x) - by[0], i64::from(y) - by[1]].map(u32::try_from);
        let value = x.ok().zip(y.ok()).and_then(|(x, y)| mask.get_pixel_checked(x, y));
        value.copied().unwrap_or(Luma([0]))
    })
}

#[test]
fn the_misplaced_mask_of_a_real_scan() {
    let Some(scans) = crate::shared("scans") else { return };
    let scan = scans.join("alexander54");
    let masks = tempfile::tempdir().unwrap();
    // Every ninth mask is moved by a tenth of the picture, in turn to each side.
    let mut expected = vec!["DSC05138.jpg".to_owned()];
    let capture = Capture::load(&scan, &CaptureOptions::default()).unwrap();
    for (i, view) in capture.views.iter().enumerate() {
        let path = view.mask.as_ref().unwrap();
        let to = masks.path().join(path.file_name().unwrap());
        if i % 9 == 4 {
            let by = [[100, 0], [0, 100], [-100, 0], [0, -100]][i / 9 % 4];
            moved(&image::open(path).unwrap().to_luma8(), by).save(to).unwrap();
            expected.push(view.name.clone());
        } else {
            std::fs::copy(path, to).unwrap();
        }
    }
    expected.sort();
    assert_eq!(misplaced(&scan, masks.path()), expected);
    let report = capture.report().unwrap();
    assert_eq!(report.misplaced_masks(), ["DSC05138.jpg"]);
    assert!(report.to_string().contains("DSC05138.jpg: the mask looks misplaced; 12 %"), "{report}");
}

/// A ball of points is the object, in the middle of background points on a shell.
#[test]
fn masks_too_wide_and_inside_out() {
    let mut model = ring(&lens(CameraModel::OpenCv), 8, 300);
    for (i, point) in model.points.iter_mut().enumerate() {
        let scale = if i % 2 == 0 { 0.3 } else { 1.0 };
        let r = Point3::from(point.position).coords.norm();
        point.position = point.position.map(|v| v * scale / if i % 2 == 0 { 0.8 } else { r });
    }
    for image in &mut model.images {
        let lens = &model.cameras[0].1;
        for (x, y, id) in image.keypoints.iter_mut().filter(|k| k.2 >= 0) {
            let point = model.points.iter().find(|p| p.id as i64 == *id).unwrap();
            let pixel = lens.project(&(image.camera_from_world * Point3::from(point.position))).unwrap();
            (*x, *y) = (pixel.x, pixel.y);
        }
    }
    let (_guard, folder) = on_disk(&model);
    let masks = folder.join("masks");
    std::fs::create_dir(&masks).unwrap();
    let write = |kind: &dyn Fn(usize, f64) -> bool| {
        for (i, image) in model.images.iter().enumerate() {
            let lens = &model.cameras[0].1;
            let middle = lens.project(&(image.camera_from_world * Point3::origin())).unwrap();
            let picture = GrayImage::from_fn(160, 120, |x, y| {
                let at = Point3::new(f64::from(x) + 0.5, f64::from(y) + 0.5, 0.0).xy();
                Luma([if kind(i, (at - middle).norm()) { 255 } else { 0 }])
            });
            picture.save(masks.join(&image.name)).unwrap();
        }
    };
    // The ball has a radius of 10 px in the pictures, the shell of 33.
    write(&|_, r| r < 12.0);
    assert_eq!(misplaced(&folder, &masks), [""; 0]);
    // A silhouette drawn a little tight or wide is none that is misplaced.
    write(&|i, r| r < if i == 3 { 9.5 } else { 14.0 });
    assert_eq!(misplaced(&folder, &masks), [""; 0]);
    write(&|i, r| r < 12.0 || i == 5);
    assert_eq!(misplaced(&folder, &masks), ["view 05.png"]);
    write(&|i, r| (r < 12.0) != (i == 2));
    assert_eq!(misplaced(&folder, &masks), ["view 02.png"]);
    write(&|i, r| r < 12.0 && i != 6);
    assert_eq!(misplaced(&folder, &masks), ["view 06.png"]);
    // Masks that say nothing accuse nobody.
    write(&|_, _| true);
    assert_eq!(misplaced(&folder, &masks), [""; 0]);
    write(&|_, _| false);
    assert_eq!(misplaced(&folder, &masks), [""; 0]);
}
