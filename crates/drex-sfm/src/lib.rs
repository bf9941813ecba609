//! Cameras and sparse points from photos of an object, or a verdict that says why not.

mod adjust;
mod cameras;
mod features;
mod mapping;
pub mod masks;
mod matching;
mod model;
mod photos;
pub mod programs;
mod subpixel;
mod verify;

pub use cameras::FocalSource;
pub use photos::PhotoFile;

use rayon::prelude::*;
use std::time::Instant;

/// Prototype.
pub fn prototype(photos: &[PhotoFile], out: &std::path::Path) -> Result<(), String> {
    let t = Instant::now();
    let headers: Vec<_> = photos.iter().map(|p| photos::read_header(&p.path)).collect::<Result<_, _>>()?;
    let (mut groups, camera_of) = cameras::group(&headers);
    let feats: Vec<features::Features> = photos
        .par_iter()
        .map(|p| {
            let grey = photos::read_grey(&p.path)?;
            let mask = p.mask.as_ref().map(|m| photos::read_grey(m)).transpose()?;
            features::extract(&grey, mask.as_ref(), 8000)
        })
        .collect::<Result<_, String>>()?;
    let n: usize = feats.iter().map(|f| f.keypoints.len()).sum();
    eprintln!("{:.1} features {} each; finest {:?}", t.elapsed().as_secs_f64(), n / feats.len(), feats.iter().take(5).map(|f| f.finest_px).collect::<Vec<_>>());
    let matcher = matching::Matcher::new(&feats, 0);
    eprintln!("{:.1} index", t.elapsed().as_secs_f64());
    let all: Vec<[usize; 2]> = (0..feats.len()).flat_map(|i| (i + 1..feats.len()).map(move |j| [i, j])).collect();
    let matches = matcher.pairs(&all, &|| {});
    eprintln!("{:.1} matched, {} matches", t.elapsed().as_secs_f64(), matches.iter().map(|m| m.matches.len()).sum::<usize>());
    for (g, group) in groups.iter_mut().enumerate() {
        let own: Vec<&matching::PairMatches> = matches.iter().filter(|m| m.views.iter().all(|&v| camera_of[v] == g)).collect();
        let v = cameras::vote(group, &own, &feats, 0);
        eprintln!("group {g}: {group:?} vote {v:?}");
        if let (Some(f), FocalSource::Guess) = (v, group.source) {
            group.focal_px = f;
            group.source = FocalSource::Vote;
        }
    }
    let cams: Vec<_> = groups.iter().map(cameras::Group::camera).collect::<Result<_, _>>()?;
    eprintln!("{:.1} voted", t.elapsed().as_secs_f64());
    let pairs: Vec<verify::Pair> = matches
        .par_iter()
        .filter_map(|m| verify::verify(m, &feats, m.views.map(|v| &cams[camera_of[v]]), 0))
        .collect();
    let kinds = pairs.iter().fold([0; 3], |mut k, p| {
        k[match p.geometry {
            verify::Geometry::Epipolar { .. } => 0,
            verify::Geometry::Plane { .. } => 1,
            verify::Geometry::Turn { .. } => 2,
        }] += 1;
        k
    });
    eprintln!("{:.1} verified: {kinds:?}", t.elapsed().as_secs_f64());
    let names: Vec<String> = photos.iter().map(|p| p.name.clone()).collect();
    let sizes: Vec<[u32; 2]> = headers.iter().map(|h| [h.width, h.height]).collect();
    let scene = mapping::Scene { names: &names, sizes: &sizes, features: &feats, cameras: &cams, camera_of: &camera_of, calibrated: false, seed: 0 };
    let refs: Vec<&verify::Pair> = pairs.iter().collect();
    let everyone: Vec<usize> = (0..photos.len()).collect();
    let mapped = mapping::map(&scene, &refs, &everyone)?;
    let r = mapped.reconstruction();
    eprintln!("{:.1} mapped: {} views, {} points", t.elapsed().as_secs_f64(), r.registered_view_count(), r.point_count());
    let mut model = model::Model::new(&mapped, &sizes);
    let show = |what: &str, model: &model::Model| {
        let e = model.errors();
        let m = drex_core::stats::upper_median(e.iter().copied());
        eprintln!("{:.1} {what}: {} points, {} observations, median {m:?}", t.elapsed().as_secs_f64(), model.points.len(), e.len());
    };
    show("model", &model);
    let greys: Vec<photos::Grey> = model.views.par_iter().map(|v| photos::read_grey(&photos[v.photo].path)).collect::<Result<_, _>>()?;
    if std::env::var("NOSUB").is_err() {
        let share = subpixel::refine(&mut model, &greys);
        eprintln!("{:.1} aligned {share}", t.elapsed().as_secs_f64());
    }
    let r = adjust::adjust(&mut model, adjust::LensFreedom::Simple, 20)?;
    eprintln!("{r:?}");
    show("simple", &model);
    let free = if std::env::var("SIMPLE").is_err() { adjust::LensFreedom::Full } else { adjust::LensFreedom::Simple };
    let r = adjust::adjust(&mut model, free, 20)?;
    eprintln!("{r:?}");
    show("full", &model);
    for _ in 0..2 {
        adjust::drop_outliers(&mut model);
        let r = adjust::adjust(&mut model, free, 20)?;
        eprintln!("{r:?}");
        show("last", &model);
    }
    let sigmas = adjust::pose_sigmas(&model, free);
    eprintln!("{:.1} {:?}", t.elapsed().as_secs_f64(), sigmas.map(|s| s[..3.min(s.len())].to_vec()));
    let mut text = String::new();
    for (k, v) in model.views.iter().enumerate() {
        let q = v.camera_from_world.rotation;
        let t = v.camera_from_world.translation.vector;
        text += &format!("{} {} {} {} {} {} {} {} {} {}\n\n", k + 1, q.w, q.i, q.j, q.k, t.x, t.y, t.z, v.lens + 1, names[v.photo]);
    }
    std::fs::create_dir_all(out).map_err(|e| e.to_string())?;
    std::fs::write(out.join("images.txt"), text).map_err(|e| e.to_string())?;
    let mut text = String::new();
    for (k, c) in model.lenses.iter().enumerate() {
        let f = c.numbers[0];
        eprintln!("{:?}", c);
        text += &format!("{} PINHOLE {} {} {f} {f} {} {}\n", k + 1, c.width, c.height, c.width / 2, c.height / 2);
    }
    std::fs::write(out.join("cameras.txt"), text).map_err(|e| e.to_string())?;
    std::fs::write(out.join("points3D.txt"), "").map_err(|e| e.to_string())?;
    Ok(())
}
