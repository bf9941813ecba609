//! Chooses frames of a video or of a folder of its frames: `frames VIDEO|FOLDER OUT`.
use std::path::Path;

use drex_core::capture::photos_under;
use drex_sfm::video::{VideoOptions, are_frames, choose_frames, choose_from};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, from, out] = args.as_slice() else { return Err("frames VIDEO|FOLDER OUT".into()) };
    let (from, out) = (Path::new(from), Path::new(out));
    let options = VideoOptions::default();
    let begun = std::time::Instant::now();
    if from.is_dir() {
        let photos = photos_under(from);
        eprintln!("looks like a video: {}", are_frames(&photos));
        let chosen = choose_from(&photos, &options, &mut |_| ())?;
        std::fs::create_dir_all(out)?;
        for &i in &chosen {
            std::fs::copy(&photos[i].path, out.join(&photos[i].name))?;
        }
        eprintln!("{} of {} in {:.1} s", chosen.len(), photos.len(), begun.elapsed().as_secs_f64());
    } else {
        let frames = choose_frames(from, out, &options, &mut |_| ())?;
        eprintln!("{frames:?} in {:.1} s", begun.elapsed().as_secs_f64());
    }
    Ok(())
}
