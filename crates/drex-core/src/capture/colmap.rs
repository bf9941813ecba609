//! COLMAP's sparse models, binary and text, as written by COLMAP 3.x and 4.x (`rigs.bin` and `frames.bin` repeat what the
//! images say and are not read).
//!
//! World to camera, x right, y down, z forward; keypoints have the centre of the first pixel at (0.5, 0.5).

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::camera::{Camera, CameraModel};
use crate::fsutil::{read_bytes, read_text};
use crate::pose::pose_from_wxyz;
use crate::{Error, Pose, Result};

/// A sparse model with COLMAP's own ids.
#[derive(Debug, Clone, Default)]
pub(super) struct Model {
    pub(super) images: Vec<Image>,
    pub(super) points: Vec<Point>,
}

/// One registered image.
#[derive(Debug, Clone)]
pub(super) struct Image {
    pub(super) id: u32,
    pub(super) name: String,
    pub(super) lens: Camera,
    pub(super) camera_from_world: Pose,
    /// x, y in pixels and the id of the point seen there.
    pub(super) keypoints: Vec<([f64; 2], Option<u64>)>,
}

/// One triangulated point.
#[derive(Debug, Clone)]
pub(super) struct Point {
    pub(super) id: u64,
    pub(super) position: [f64; 3],
    pub(super) rgb: [u8; 3],
    pub(super) error_px: f64,
    /// Image id and index of the keypoint.
    pub(super) track: Vec<(u32, u32)>,
}

const REMEDY: &str = "export the model again with `colmap model_converter`";

impl Model {
    /// Whether `folder` holds the cameras and images of a model.
    pub(super) fn is_in(folder: &Path) -> bool {
        format_of(folder).is_some()
    }

    /// Reads the model in `folder`; binary files win over text. A model without points3D is one without points.
    pub(super) fn load(folder: &Path) -> Result<Self> {
        let Some(extension) = format_of(folder) else {
            return Err(Error::content(
                folder,
                None,
                "no cameras and images of a COLMAP model",
                "give the folder with cameras.bin and images.bin, or .txt",
            ));
        };
        let file = |stem: &str| folder.join(format!("{stem}.{extension}"));
        let points_file = file("points3D");
        let has_points = points_file.is_file();
        if extension == "bin" {
            let cameras = cameras_bin(&file("cameras"))?;
            let images = images_bin(&file("images"), &cameras)?;
            let points = if has_points { points_bin(&points_file)? } else { Vec::new() };
            Ok(Self { images, points })
        } else {
            let cameras = cameras_txt(&file("cameras"))?;
            let images = images_txt(&file("images"), &cameras)?;
            let points = if has_points { points_txt(&points_file)? } else { Vec::new() };
            Ok(Self { images, points })
        }
    }
}

fn format_of(folder: &Path) -> Option<&'static str> {
    ["bin", "txt"]
        .into_iter()
        .find(|e| ["cameras", "images"].iter().all(|stem| folder.join(format!("{stem}.{e}")).is_file()))
}

type Cameras = BTreeMap<u32, Camera>;

fn cameras_bin(path: &Path) -> Result<Cameras> {
    let mut file = Binary::open(path)?;
    let mut cameras = Cameras::new();
    for _ in 0..file.count("cameras", 24)? {
        let id = file.u32("camera id")?;
        let model = CameraModel::from_id(file.u32("camera model")? as i32).map_err(|e| Error::at(path, None, e))?;
        let (width, height) = (file.u64("image width")?, file.u64("image height")?);
        let params = (0..model.parameter_names().len()).map(|_| file.f64("camera parameter"));
        let params = params.collect::<Result<Vec<_>>>()?;
        cameras.insert(id, camera(path, None, id, model, [width, height], &params)?);
    }
    file.end()?;
    Ok(cameras)
}

fn camera(
    path: &Path,
    line: Option<usize>,
    id: u32,
    model: CameraModel,
    size: [u64; 2],
    params: &[f64],
) -> Result<Camera> {
    let [Ok(width), Ok(height)] = size.map(u32::try_from) else {
        let what = format!("camera {id} has images of {} x {} pixels", size[0], size[1]);
        return Err(Error::content(path, line, what, REMEDY));
    };
    Camera::new(model, width, height, params).map_err(|e| Error::at(path, line, e))
}

fn images_bin(path: &Path, cameras: &Cameras) -> Result<Vec<Image>> {
    let mut file = Binary::open(path)?;
    // Id, pose, camera, an empty name and the number of keypoints.
    let count = file.count("images", 4 + 56 + 4 + 1 + 8)?;
    let mut images = Vec::with_capacity(count);
    for _ in 0..count {
        let id = file.u32("image id")?;
        let pose = file.numbers::<7>("pose")?;
        let camera = file.u32("camera id")?;
        let name = file.name()?;
        let keypoints = (0..file.count("keypoints", 24)?).map(|_| {
            let at = file.numbers("keypoint")?;
            // COLMAP's "no point" is the largest 64-bit number.
            Ok((at, Some(file.u64("point id")?).filter(|id| *id != u64::MAX)))
        });
        let keypoints = keypoints.collect::<Result<Vec<_>>>()?;
        images.push(image(path, None, id, &pose, camera, name, keypoints, cameras)?);
    }
    file.end()?;
    Ok(images)
}

#[allow(clippy::too_many_arguments)] // the columns of the file
fn image(
    path: &Path,
    line: Option<usize>,
    id: u32,
    pose: &[f64; 7],
    camera: u32,
    name: String,
    keypoints: Vec<([f64; 2], Option<u64>)>,
    cameras: &Cameras,
) -> Result<Image> {
    let refuse = |what: String| Err(Error::content(path, line, what, REMEDY));
    let [qw, qx, qy, qz, tx, ty, tz] = *pose;
    // Text files round the quaternion; COLMAP normalises on reading as well.
    let norm = [qw, qx, qy, qz].iter().map(|v| v * v).sum::<f64>().sqrt();
    let camera_from_world = match pose_from_wxyz([tx, ty, tz], [qw / norm, qx / norm, qy / norm, qz / norm]) {
        Ok(pose) => pose,
        Err(e) => return refuse(format!("image {name}: {e}")),
    };
    let Some(lens) = cameras.get(&camera) else {
        return refuse(format!("image {name} was taken by camera {camera}, which the model does not have"));
    };
    if let Some(i) = keypoints.iter().position(|(at, _)| !at.iter().all(|v| v.is_finite())) {
        return refuse(format!("keypoint {i} of image {name} is not finite"));
    }
    Ok(Image { id, name, lens: lens.clone(), camera_from_world, keypoints })
}

fn points_bin(path: &Path) -> Result<Vec<Point>> {
    let mut file = Binary::open(path)?;
    let count = file.count("points", 8 + 24 + 3 + 8 + 8)?;
    let mut points = Vec::with_capacity(count);
    for _ in 0..count {
        let id = file.u64("point id")?;
        let position = file.numbers("position")?;
        let rgb = file.take::<3>("colour")?;
        let error_px = file.f64("reprojection error")?;
        let length = file.count("track", 8)?;
        let track = (0..length).map(|_| Ok((file.u32("image id")?, file.u32("keypoint index")?)));
        let track = track.collect::<Result<Vec<_>>>()?;
        points.push(finite_point(path, None, Point { id, position, rgb, error_px, track })?);
    }
    file.end()?;
    Ok(points)
}

fn finite_point(path: &Path, line: Option<usize>, point: Point) -> Result<Point> {
    if point.position.iter().all(|v| v.is_finite()) {
        return Ok(point);
    }
    Err(Error::content(path, line, format!("the position of point {} is not finite", point.id), REMEDY))
}

/// A little-endian file, read from front to back; no count is believed beyond the bytes that are left.
struct Binary {
    path: PathBuf,
    bytes: Vec<u8>,
    at: usize,
}

impl Binary {
    fn open(path: &Path) -> Result<Self> {
        Ok(Self { path: path.into(), bytes: read_bytes(path)?, at: 0 })
    }

    fn refuse<T>(&self, what: impl Into<String>) -> Result<T> {
        Err(Error::content(&self.path, None, what, REMEDY))
    }

    fn take<const N: usize>(&mut self, what: &str) -> Result<[u8; N]> {
        match self.bytes[self.at..].first_chunk::<N>() {
            Some(chunk) => {
                self.at += N;
                Ok(*chunk)
            }
            None => self.refuse(format!("the file ends in the middle of a {what}, at byte {}", self.bytes.len())),
        }
    }

    fn u32(&mut self, what: &str) -> Result<u32> {
        Ok(u32::from_le_bytes(self.take(what)?))
    }

    fn u64(&mut self, what: &str) -> Result<u64> {
        Ok(u64::from_le_bytes(self.take(what)?))
    }

    fn f64(&mut self, what: &str) -> Result<f64> {
        Ok(f64::from_le_bytes(self.take(what)?))
    }

    fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for v in &mut values {
            *v = self.f64(what)?;
        }
        Ok(values)
    }

    /// The number of records that follow, each of at least `bytes_each`.
    fn count(&mut self, what: &str, bytes_each: usize) -> Result<usize> {
        let count = self.u64(what)?;
        let left = self.bytes.len() - self.at;
        match usize::try_from(count) {
            Ok(n) if n <= left / bytes_each => Ok(n),
            _ => self.refuse(format!("{count} {what} are announced, but only {left} bytes are left")),
        }
    }

    /// A name that ends with a zero byte.
    fn name(&mut self) -> Result<String> {
        let rest = &self.bytes[self.at..];
        let Some(end) = rest.iter().position(|b| *b == 0) else {
            return self.refuse("the file ends in the middle of a name");
        };
        let Ok(name) = std::str::from_utf8(&rest[..end]) else {
            return self.refuse(format!("the image name at byte {} is not UTF-8", self.at));
        };
        let name = name.to_owned();
        self.at += end + 1;
        Ok(name)
    }

    fn end(&self) -> Result<()> {
        match self.bytes.len() - self.at {
            0 => Ok(()),
            left => self.refuse(format!("{left} bytes follow the last record")),
        }
    }
}

fn cameras_txt(path: &Path) -> Result<Cameras> {
    let text = read_text(path)?;
    let mut cameras = Cameras::new();
    for mut row in rows(path, &text).filter(|row| !row.is_blank()) {
        let id = row.parse("camera id")?;
        let model = row.next("camera model")?.parse::<CameraModel>().map_err(|e| Error::at(path, row.line, e))?;
        let size = [row.parse("image width")?, row.parse("image height")?];
        let params = row.rest("camera parameter")?;
        cameras.insert(id, camera(path, Some(row.line), id, model, size, &params)?);
    }
    Ok(cameras)
}

fn images_txt(path: &Path, cameras: &Cameras) -> Result<Vec<Image>> {
    let text = read_text(path)?;
    let mut images = Vec::new();
    let mut lines = rows(path, &text);
    while let Some(mut row) = lines.next() {
        // The second line of an image may be empty, its first never is.
        if row.is_blank() {
            continue;
        }
        let id = row.parse("image id")?;
        let mut pose = [0.0; 7];
        for v in &mut pose {
            *v = row.parse("pose")?;
        }
        let camera = row.parse("camera id")?;
        let name = row.remainder("image name")?.to_owned();
        let keypoints = lines.next().map_or(Ok(Vec::new()), |mut second| second.keypoints())?;
        images.push(image(path, Some(row.line), id, &pose, camera, name, keypoints, cameras)?);
    }
    Ok(images)
}

fn points_txt(path: &Path) -> Result<Vec<Point>> {
    let text = read_text(path)?;
    let mut points = Vec::new();
    for mut row in rows(path, &text).filter(|row| !row.is_blank()) {
        let id = row.parse("point id")?;
        let position = [row.parse("x")?, row.parse("y")?, row.parse("z")?];
        let rgb = [row.parse("red")?, row.parse("green")?, row.parse("blue")?];
        let error_px = row.parse("reprojection error")?;
        let entries = row.rest::<i64>("track")?;
        let (pairs, []) = entries.as_chunks::<2>() else {
            return Err(Error::content(path, row.line, "a track with half an entry", REMEDY));
        };
        let track = pairs.iter().filter_map(|[i, k]| Some((u32::try_from(*i).ok()?, u32::try_from(*k).ok()?)));
        let point = Point { id, position, rgb, error_px, track: track.collect() };
        points.push(finite_point(path, Some(row.line), point)?);
    }
    Ok(points)
}

/// One line of a text file, read word by word.
struct Row<'a> {
    path: &'a Path,
    line: usize,
    left: &'a str,
}

fn rows<'a>(path: &'a Path, text: &'a str) -> impl Iterator<Item = Row<'a>> {
    let lines = text.lines().enumerate().filter(|(_, l)| !l.trim_start().starts_with('#'));
    lines.map(move |(i, left)| Row { path, line: i + 1, left })
}

impl<'a> Row<'a> {
    fn is_blank(&self) -> bool {
        self.left.trim().is_empty()
    }

    fn refuse<T>(&self, what: String) -> Result<T> {
        Err(Error::content(self.path, self.line, what, REMEDY))
    }

    fn next(&mut self, what: &str) -> Result<&'a str> {
        let text = self.left.trim_start();
        if text.is_empty() {
            return self.refuse(format!("the line ends where the {what} should be"));
        }
        let (word, left) = text.split_at(text.find(char::is_whitespace).unwrap_or(text.len()));
        self.left = left;
        Ok(word)
    }

    fn parse<T: std::str::FromStr>(&mut self, what: &str) -> Result<T> {
        let word = self.next(what)?;
        word.parse().or_else(|_| self.refuse(format!("`{word}` is no {what}")))
    }

    /// All words that are left.
    fn rest<T: std::str::FromStr>(&mut self, what: &str) -> Result<Vec<T>> {
        let mut values = Vec::new();
        while !self.is_blank() {
            values.push(self.parse(what)?);
        }
        Ok(values)
    }

    /// The rest of the line; image names may have spaces.
    fn remainder(&mut self, what: &str) -> Result<&'a str> {
        match self.left.trim() {
            "" => self.refuse(format!("the line ends where the {what} should be")),
            text => Ok(text),
        }
    }

    /// x, y, point id (-1 for none), again and again.
    fn keypoints(&mut self) -> Result<Vec<([f64; 2], Option<u64>)>> {
        let mut keypoints = Vec::new();
        while !self.is_blank() {
            let at = [self.parse("keypoint x")?, self.parse("keypoint y")?];
            let id: i64 = self.parse("point id")?;
            keypoints.push((at, u64::try_from(id).ok()));
        }
        Ok(keypoints)
    }
}
