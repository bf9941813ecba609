//! Training: what it must reach, that it can stop and go on, and what it refuses.

use std::sync::Arc;

use drex_core::Pose;
use drex_core::camera::PinholeCamera;
use drex_core::capture::Photo;
use drex_splat::loss::MaskMode;
use drex_splat::raster::Cpu;
use drex_splat::train::{Adaptive, Coarse, Density, Mcmc, TrainOptions, VisualHull, from_points};
use drex_splat::{Gaussians, Kind, Rasterizer, RenderOptions, Trainer};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const WIDTH: usize = 64;
const HEIGHT: usize = 48;
const EXTENT: f64 = 3.0;

/// A ball of coloured splats on black, photographed from a ring, with masks.
struct World {
    photos: Vec<Arc<Photo>>,
    points: Vec<[f64; 3]>,
}

impl World {
    fn new() -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let points: Vec<[f64; 3]> = (0..200)
            .map(|_| {
                let p: [f64; 3] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
                let r = p.iter().map(|v| v * v).sum::<f64>().sqrt().max(0.1);
                p.map(|v| 0.5 * v / r)
            })
            .collect();
        let colours: Vec<[u8; 3]> = points.iter().map(|p| p.map(|v| (128.0 + 250.0 * v) as u8)).collect();
        let truth = from_points(&points, &colours, Kind::Ellipsoid, 0, 0.9);
        let photos = cameras(12).into_iter().map(|camera| Arc::new(photo_of(&truth, camera))).collect();
        Self { photos, points }
    }

    /// Grey Gaussians near the points: what structure from motion gives, worse.
    fn first(&self, kind: Kind) -> Gaussians {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let points: Vec<_> = self.points.iter().map(|p| p.map(|v| v + rng.random_range(-0.02..0.02))).collect();
        from_points(&points, &vec![[128; 3]; points.len()], kind, 1, 0.1)
    }
}

fn cameras(n: usize) -> Vec<PinholeCamera> {
    (0..n)
        .map(|i| {
            let angle = std::f64::consts::TAU * i as f64 / n as f64;
            let eye = nalgebra::Point3::new(2.0 * angle.cos(), 2.0 * angle.sin(), 0.6 * (2.0 * angle).sin());
            let back = nalgebra::Isometry3::look_at_rh(&eye, &nalgebra::Point3::origin(), &nalgebra::Vector3::z());
            // From y up, z backward to y down, z forward.
            let turn = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::x_axis(), std::f64::consts::PI);
            let camera_from_world = Pose::from_parts(Default::default(), turn) * back;
            PinholeCamera { camera_from_world, fx: 60.0, fy: 62.0, cx: 31.0, cy: 25.0, width: WIDTH, height: HEIGHT }
        })
        .collect()
}

fn photo_of(set: &Gaussians, camera: PinholeCamera) -> Photo {
    let (render, _) = Cpu.forward(set, &camera, &RenderOptions::default()).unwrap();
    let byte = |v: f32| (255.0 * v.clamp(0.0, 1.0)).round() as u8;
    Photo {
        rgb: render.rgb.iter().map(|c| c.map(byte)).collect(),
        mask: Some(render.alpha.iter().map(|&a| if a > 0.5 { 255 } else { 0 }).collect()),
        depth: None,
        confidence: None,
        normal: None,
        camera,
    }
}

fn options(kind: Kind, iterations: u32, density: Density) -> TrainOptions {
    let mut o = TrainOptions::default();
    o.kind = kind;
    o.iterations = iterations;
    o.sh_degree = 1;
    o.density = density;
    o.max_gaussians = 400;
    o.seed = 3;
    o
}

fn trainer(world: &World, options: TrainOptions) -> Trainer<'_, Vec<Arc<Photo>>, Cpu> {
    let trained = (0..world.photos.len()).filter(|i| i % 4 != 0).collect();
    Trainer::new(&world.photos, trained, Cpu, world.first(options.kind), EXTENT, options).unwrap()
}

/// Mean PSNR on the photos held out.
fn held_out(world: &World, trainer: &Trainer<'_, Vec<Arc<Photo>>, Cpu>) -> f64 {
    let scores: Vec<f64> = world
        .photos
        .iter()
        .step_by(4)
        .map(|photo| {
            let render = trainer.render(&photo.camera, [0.0; 3]).unwrap();
            drex_splat::metrics::psnr(&render.rgb, &photo.rgb).unwrap()
        })
        .collect();
    scores.iter().sum::<f64>() / scores.len() as f64
}

fn adaptive() -> Density {
    Density::Adaptive(Adaptive { every: 50, ..Adaptive::default() })
}

fn mcmc() -> Density {
    Density::Mcmc(Mcmc { every: 50, ..Mcmc::default() })
}

#[test]
fn every_kind_and_density_learns_the_scene() {
    let world = World::new();
    for (kind, density, least_gain) in [
        (Kind::Ellipsoid, Density::Fixed, 6.0),
        (Kind::Ellipsoid, adaptive(), 6.0),
        (Kind::Ellipsoid, mcmc(), 6.0),
        (Kind::Surfel, adaptive(), 5.0),
        (Kind::Surfel, mcmc(), 5.0),
    ] {
        let mut trainer = trainer(&world, options(kind, 400, density));
        let before = held_out(&world, &trainer);
        while !trainer.is_done() {
            trainer.step().unwrap();
        }
        let after = held_out(&world, &trainer);
        eprintln!("{kind:?} {density:?}: {before:.1} to {after:.1} dB, {} Gaussians", trainer.gaussians().len());
        assert!(after > before + least_gain, "{kind:?} {density:?}: {before:.2} to {after:.2} dB");
        assert!(trainer.gaussians().len() <= 400);
        assert!(trainer.gaussians().check().is_ok());
    }
}

#[test]
fn a_run_that_stopped_goes_on_to_the_same_bytes() {
    let world = World::new();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("run.checkpoint");
    for density in [adaptive(), mcmc()] {
        let mut o = options(Kind::Ellipsoid, 240, density);
        o.exposure = true;
        o.refine_poses = true;
        o.masks = MaskMode::Transparent;
        o.background = None;
        o.coarse = vec![Coarse { divisor: 2, until: 0.3 }];
        let mut whole = trainer(&world, o.clone());
        while !whole.is_done() {
            whole.step().unwrap();
            if whole.steps_done() == 117 {
                whole.save(&file).unwrap();
            }
        }
        let trained = (0..world.photos.len()).filter(|i| i % 4 != 0).collect();
        let mut resumed = Trainer::resume(&world.photos, trained, Cpu, EXTENT, &file).unwrap();
        assert_eq!(resumed.steps_done(), 117);
        while !resumed.is_done() {
            resumed.step().unwrap();
        }
        assert_eq!(whole.gaussians(), resumed.gaussians());

        let refused = Trainer::resume(&world.photos, vec![0, 1, 2], Cpu, EXTENT, &file).unwrap_err().to_string();
        assert!(refused.contains("9 photos") && refused.contains("3 now"), "{refused}");
    }
    // Damaged files are refused by name, whatever is cut off or changed.
    let bytes = std::fs::read(&file).unwrap();
    for cut in [0, 5, 12, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&file, &bytes[..cut]).unwrap();
        let trained = (0..world.photos.len()).filter(|i| i % 4 != 0).collect();
        let refused = Trainer::resume(&world.photos, trained, Cpu, EXTENT, &file).unwrap_err().to_string();
        assert!(refused.contains("run.checkpoint"), "{refused}");
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let world = World::new();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut trainer = trainer(&world, options(Kind::Surfel, 120, mcmc()));
            while !trainer.is_done() {
                trainer.step().unwrap();
            }
            trainer.gaussians().clone()
        })
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(5));
}

#[test]
fn masked_training_stays_inside_the_hull() {
    let world = World::new();
    let mut o = options(Kind::Ellipsoid, 300, adaptive());
    o.masks = MaskMode::Transparent;
    o.background = None;
    let mut trainer = trainer(&world, o);
    let mut hull = VisualHull::new();
    for photo in &world.photos {
        hull.add(&photo.camera, photo.mask.as_ref().unwrap(), 1);
    }
    trainer.set_hull(hull.clone());
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    trainer.cut(&hull);
    let set = trainer.gaussians();
    assert!(set.len() > 100);
    assert!(set.means.iter().all(|m| hull.contains(m)));
    let photo = &world.photos[0];
    let render = trainer.render(&photo.camera, [0.0; 3]).unwrap();
    let outside: f64 = mean_where(&render.alpha, |i| photo.mask.as_ref().unwrap()[i] == 0);
    let inside: f64 = mean_where(&render.alpha, |i| photo.mask.as_ref().unwrap()[i] == 255);
    assert!(outside < 0.1 && inside > 0.8, "opacity {outside:.3} outside, {inside:.3} inside");
}

fn mean_where(values: &[f32], which: impl Fn(usize) -> bool) -> f64 {
    let kept: Vec<f64> = values.iter().enumerate().filter(|(i, _)| which(*i)).map(|(_, &v)| f64::from(v)).collect();
    kept.iter().sum::<f64>() / kept.len() as f64
}

#[test]
fn refined_poses_move_towards_the_true_ones() {
    let world = World::new();
    let mut wrong = world.photos.clone();
    for (i, photo) in wrong.iter_mut().enumerate() {
        let turn = nalgebra::Vector3::new(0.0, 0.0, if i % 2 == 0 { 0.02 } else { -0.02 });
        let mut moved = Photo::clone(photo);
        moved.camera.camera_from_world =
            Pose::new(nalgebra::Vector3::new(0.03, -0.02, 0.0), turn) * moved.camera.camera_from_world;
        *photo = Arc::new(moved);
    }
    let run = |refine: bool| {
        let mut o = options(Kind::Ellipsoid, 400, Density::Fixed);
        o.refine_poses = refine;
        o.rates.pose = 5e-4;
        let mut trainer =
            Trainer::new(&wrong, (0..12).collect(), Cpu, world.first(Kind::Ellipsoid), EXTENT, o).unwrap();
        let mut last = Vec::new();
        while !trainer.is_done() {
            last.push(trainer.step().unwrap().psnr);
        }
        last[388..].iter().sum::<f64>() / 12.0
    };
    let (fixed, refined) = (run(false), run(true));
    assert!(refined > fixed + 0.5, "{fixed:.2} dB with the wrong poses, {refined:.2} dB refined");
}

#[test]
fn exposure_of_each_photo_is_taken_up() {
    let world = World::new();
    let mut exposed = world.photos.clone();
    for (i, photo) in exposed.iter_mut().enumerate() {
        let gain = 0.8 + 0.03 * i as f32;
        let mut changed = Photo::clone(photo);
        changed.rgb.iter_mut().for_each(|c| *c = c.map(|v| (f32::from(v) * gain).min(255.0) as u8));
        *photo = Arc::new(changed);
    }
    let run = |exposure: bool| {
        let mut o = options(Kind::Ellipsoid, 400, Density::Fixed);
        o.exposure = exposure;
        o.rates.exposure = 5e-3;
        let mut trainer =
            Trainer::new(&exposed, (0..12).collect(), Cpu, world.first(Kind::Ellipsoid), EXTENT, o).unwrap();
        let mut last = Vec::new();
        while !trainer.is_done() {
            last.push(trainer.step().unwrap().loss);
        }
        last[388..].iter().sum::<f64>() / 12.0
    };
    let (without, with) = (run(false), run(true));
    assert!(with < 0.9 * without, "loss {without:.4} without, {with:.4} with an exposure a photo");
}

#[test]
fn what_cannot_be_trained_is_refused_by_name() {
    let world = World::new();
    let refused = |indices: Vec<usize>, first: Gaussians, extent: f64, o: TrainOptions| {
        Trainer::new(&world.photos, indices, Cpu, first, extent, o).unwrap_err().to_string()
    };
    let o = || options(Kind::Ellipsoid, 10, Density::Fixed);
    let first = || world.first(Kind::Ellipsoid);
    assert!(refused(vec![0], first(), EXTENT, o()).contains("photos to train on: 1"));
    assert!(refused(vec![0, 99], first(), EXTENT, o()).contains("photo 99"));
    assert!(refused(vec![0, 1], first(), f64::NAN, o()).contains("extent"));
    assert!(refused(vec![0, 1], first(), 0.0, o()).contains("extent"));
    assert!(refused(vec![0, 1], Gaussians::new(Kind::Ellipsoid, 1), EXTENT, o()).contains("0 Gaussians"));
    assert!(refused(vec![0, 1], world.first(Kind::Surfel), EXTENT, o()).contains("different kinds"));
    let mut broken = first();
    broken.means[17][1] = f32::NAN;
    assert!(refused(vec![0, 1], broken, EXTENT, o()).contains("Gaussian 17"));
    let mut few = o();
    few.max_gaussians = 10;
    assert!(refused(vec![0, 1], first(), EXTENT, few).contains("at most 10"));
    let mut bad = o();
    bad.ssim_weight = 1.5;
    assert!(refused(vec![0, 1], first(), EXTENT, bad).contains("ssim_weight is 1.5"));

    let unmasked: Vec<Arc<Photo>> =
        world.photos.iter().map(|p| Arc::new(Photo { mask: Some(vec![0; p.rgb.len()]), ..Photo::clone(p) })).collect();
    let mut masked = o();
    masked.masks = MaskMode::Transparent;
    let mut trainer = Trainer::new(&unmasked, vec![0, 1, 2], Cpu, first(), EXTENT, masked).unwrap();
    let said = trainer.step().unwrap_err().to_string();
    assert!(said.contains("mask"), "{said}");
}

#[test]
fn pictures_of_another_size_than_their_camera_are_refused() {
    let world = World::new();
    let too_few: [fn(&mut Photo); 4] = [
        |p| p.rgb.truncate(5),
        |p| p.mask = Some(vec![255; 3]),
        |p| p.depth = Some(vec![1.0]),
        |p| p.normal = Some(Vec::new()),
    ];
    for spoil in too_few {
        let spoilt = |photo: &Arc<Photo>| {
            let mut photo = Photo::clone(photo);
            spoil(&mut photo);
            Arc::new(photo)
        };
        let photos: Vec<Arc<Photo>> = world.photos.iter().map(spoilt).collect();
        let o = options(Kind::Ellipsoid, 10, Density::Fixed);
        let first = world.first(Kind::Ellipsoid);
        let said = Trainer::new(&photos, (0..12).collect(), Cpu, first, EXTENT, o).unwrap().step().unwrap_err();
        assert!(said.to_string().contains("pixels, its camera"), "{said}");
    }
}

#[test]
fn a_black_photo_is_refused() {
    let world = World::new();
    let black: Vec<Arc<Photo>> =
        world.photos.iter().map(|p| Arc::new(Photo { rgb: vec![[0; 3]; p.rgb.len()], ..Photo::clone(p) })).collect();
    let o = options(Kind::Ellipsoid, 10, Density::Fixed);
    let mut trainer = Trainer::new(&black, (0..12).collect(), Cpu, world.first(Kind::Ellipsoid), EXTENT, o).unwrap();
    let said = trainer.step().unwrap_err().to_string();
    assert!(said.contains("the photo number") && said.contains("black all over"), "{said}");
}
