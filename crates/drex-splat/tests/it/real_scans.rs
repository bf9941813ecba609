//! Reconstruction of real photos, small and short: what must hold at any size.

use crate::support;

use drex_core::capture::{Capture, CaptureOptions, PhotoOptions, Photos};
use drex_splat::reconstruct::{ReconstructOptions, reconstruct};
use drex_splat::train::Preset;
use drex_splat::{Cpu, Gaussians, Kind, io};

/// A reconstruction at `side` pixels with `iterations` steps, every 8th photo held out.
fn run(capture: &Capture, side: usize, iterations: u32, out: &std::path::Path) -> drex_splat::Reconstruction {
    let mut options = ReconstructOptions::default();
    options.preset = Preset::Fast;
    options.max_side = Some(side);
    options.iterations = Some(iterations);
    options.hold_out = Some(8);
    let report = capture.report().unwrap();
    reconstruct(capture, &report, &Cpu, out, &options, &mut |_, _, _| {}).unwrap()
}

#[test]
fn a_marble_head_stays_inside_its_masks() {
    let Some(scans) = support::shared("scans") else { return };
    let capture = Capture::load(&scans.join("alexander54"), &CaptureOptions::default()).unwrap();
    let out = tempfile::tempdir().unwrap();
    let found = run(&capture, 252, 150, out.path());
    assert!(found.object_only);
    assert_eq!((found.photos_trained, found.photos_held_out), (46, 7));
    assert_eq!(found.left_out.len(), 1);
    assert!(found.left_out[0].contains("DSC05138"), "{:?}", found.left_out);
    let photos = Photos::new(&capture, PhotoOptions::default()).unwrap();
    let gaussians = io::read_gaussians(&out.path().join("splat/appearance.ply"), Kind::Ellipsoid).unwrap();
    let solid: Vec<usize> = (0..gaussians.len()).filter(|&i| gaussians.opacity(i) > 0.05).collect();
    assert!(solid.len() > 1000, "{}", solid.len());
    let outside = outside_masks(&capture, &photos, &gaussians, &solid, "DSC05138");
    assert_eq!(outside, 0, "{outside} of {} centres are outside a mask by more than 3 px", solid.len());
    let score = found.appearance.held_out.mean().unwrap().similarity.psnr;
    assert!(score > 18.0, "{score:.2} dB on the photos held out");
}

/// How many centres lie outside a mask, taken at full size, by more than 3 px; the mask of `bad` does not count.
fn outside_masks(capture: &Capture, photos: &Photos, gaussians: &Gaussians, which: &[usize], bad: &str) -> usize {
    let mut outside = vec![false; gaussians.len()];
    for v in (0..capture.views.len()).filter(|&v| !capture.views[v].name.contains(bad)) {
        let photo = photos.get(v).unwrap();
        let (mask, camera) = (photo.mask.as_ref().unwrap(), &photo.camera);
        for &i in which {
            let centre = nalgebra::Point3::from(gaussians.means[i].map(f64::from));
            let Some(([x, y], _)) = camera.project(&centre) else { continue };
            if !(x >= 0.0 && y >= 0.0 && x < camera.width as f64 && y < camera.height as f64) {
                continue;
            }
            let near = |c: f64, n: usize| (c - 3.0).max(0.0) as usize..=((c + 3.0) as usize).min(n - 1);
            let inside = near(y, camera.height).any(|v| {
                near(x, camera.width).any(|u| {
                    let off = (u as f64 + 0.5 - x).hypot(v as f64 + 0.5 - y);
                    off <= 3.5 && mask[v * camera.width + u] >= 128
                })
            });
            outside[i] |= !inside;
        }
    }
    outside.iter().filter(|&&o| o).count()
}

#[test]
fn a_mouse_on_a_desk_is_learnt_in_a_hundred_steps() {
    let Some(scans) = support::shared("scans") else { return };
    let capture = Capture::load(&scans.join("mouse56"), &CaptureOptions::default()).unwrap();
    let out = tempfile::tempdir().unwrap();
    let found = run(&capture, 160, 250, out.path());
    assert!(!found.object_only);
    let score = found.appearance.held_out.mean().unwrap().similarity;
    assert!(score.psnr > 19.0 && score.ssim > 0.8, "{score:?}");
    assert_eq!(found.photos_trained + found.photos_held_out, 56);
}
