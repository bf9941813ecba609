//! Registers a folder of photos and writes COLMAP models: `register PHOTOS OUT [MASKS]`.
use std::path::{Path, PathBuf};

use drex_core::capture::{CaptureOptions, find_mask, photos_in};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let folder = Path::new(&args[1]);
    let mut options = CaptureOptions::default();
    options.masks = args.get(3).map(PathBuf::from);
    let (_, files) = photos_in(folder, &options).ok_or("no photos")?;
    let photo = |p: drex_core::capture::PhotoFile| drex_sfm::InputPhoto {
        mask: args.get(3).and_then(|_| find_mask(folder, &p.name, &options)),
        name: p.name,
        path: p.path,
    };
    let photos: Vec<_> = files.into_iter().map(photo).collect();
    let begun = std::time::Instant::now();
    let told = std::sync::Mutex::new("");
    let progress = |s: drex_sfm::Step| {
        let mut last = told.lock().unwrap();
        if *last != s.stage {
            *last = s.stage;
            eprintln!("{:6.1} {} of {}", begun.elapsed().as_secs_f64(), s.stage, s.total);
        }
    };
    let done = drex_sfm::register(&photos, &drex_sfm::RegisterOptions::default(), &progress)?;
    eprintln!("{:6.1} done", begun.elapsed().as_secs_f64());
    for (k, model) in done.models.iter().enumerate() {
        let dir = Path::new(&args[2]).join(format!("sparse/{k}"));
        std::fs::create_dir_all(&dir)?;
        let (mut im, mut ca) = (String::new(), String::new());
        for (i, v) in model.views.iter().enumerate() {
            let (q, t) = (v.camera_from_world.rotation, v.camera_from_world.translation.vector);
            im += &format!("{} {} {} {} {} {} {} {} {} {}\n\n", i + 1, q.w, q.i, q.j, q.k, t.x, t.y, t.z, i + 1, v.name);
            let p = v.lens.params().iter().map(|x| x.to_string()).collect::<Vec<_>>().join(" ");
            ca += &format!("{} {} {} {} {p}\n", i + 1, v.lens.model().name(), v.lens.width_px(), v.lens.height_px());
        }
        std::fs::write(dir.join("images.txt"), im)?;
        std::fs::write(dir.join("cameras.txt"), ca)?;
        let mut po = String::new();
        for (i, p) in model.points.iter().enumerate() {
            po += &format!("{} {} {} {} {} {} {} {}", i + 1, p.position[0], p.position[1], p.position[2], p.rgb[0], p.rgb[1], p.rgb[2], p.error_px);
            for (v, k) in &p.track {
                po += &format!(" {} {}", v + 1, k);
            }
            po += "\n";
        }
        std::fs::write(dir.join("points3D.txt"), po)?;
    }
    let mut report = done.report;
    std::fs::write(Path::new(&args[2]).join("report.json"), serde_json::to_string_pretty(&report)?)?;
    report.photos.clear();
    println!("{}", serde_json::to_string_pretty(&report)?);
    Ok(())
}
