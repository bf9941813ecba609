//! Registers a folder of photos.
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let folder = std::path::Path::new(&args[1]);
    let masks = args.get(3);
    let mut photos: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    photos.retain(|p| p.is_file());
    photos.sort();
    let photos: Vec<_> = photos
        .into_iter()
        .map(|path| {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            let mask = masks.map(|m| std::path::Path::new(m).join(format!("{name}.png")));
            drex_sfm::PhotoFile { name, path, mask }
        })
        .collect();
    drex_sfm::prototype(&photos, std::path::Path::new(&args[2])).unwrap();
}
