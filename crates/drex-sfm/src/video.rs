//! Frames of a video, or of a folder of its frames, chosen by sharpness and parallax.
//!
//! ```text
//! video ─► ffmpeg: small grey frames ─► sharpness, points followed ─► choice ─► ffmpeg: these frames only
//! ```
//! A fixed stride would take copies where the camera rests and smeared frames where it jerks. Here each frame that is kept
//! is the sharpest of those in which the picture has moved by some per cent since the last one that was kept.

mod choose;
#[cfg(test)]
mod tests;
mod track;

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc;
use std::time::Duration;

use drex_core::capture::{PhotoFile, photo_size, photos_under};
use drex_core::fsutil::{argument, temporary_path};
use drex_core::{Error, Result};
use rayon::prelude::*;

use crate::photos::{Grey, read_grey};
use crate::programs::{TIME_LIMIT, clear, refuse, run};
use crate::verdict::count;
use choose::{Measured, Rules, choose, moved, quality, shrunk};
use track::Tracker;

/// How frames are chosen.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct VideoOptions {
    /// ffmpeg, a name on the path or a file.
    pub program: PathBuf,
    /// Longest side of the frames that are written, pixels; larger ones are scaled down.
    pub max_side: usize,
    /// How far the picture has moved from one frame to the next that is kept: median over followed points, least and most, in
    /// shares of the longer side.
    pub window: [f64; 2],
    /// Fewest frames: the window is narrowed, to a quarter at most, until there are as many.
    pub fewest: usize,
    /// Most frames: the window is widened until there are no more.
    pub most: usize,
    /// Frames with less than this share of the sharpness that is usual within a second are never kept.
    pub least_sharpness: f64,
    /// ffmpeg is stopped after this time, each of the two times that it is run.
    pub time_limit: Duration,
}

impl Default for VideoOptions {
    fn default() -> Self {
        Self {
            program: "ffmpeg".into(),
            max_side: 1920,
            window: [0.04, 0.08],
            fewest: 70,
            most: 150,
            least_sharpness: 0.5,
            time_limit: TIME_LIMIT,
        }
    }
}

/// What was chosen of a video.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Frames {
    /// Which frames, counted from 1 as they are decoded; frame 12 is the file `frame_0012.jpg`.
    pub indices: Vec<usize>,
    /// How many frames the video has.
    pub decoded: usize,
    /// How many of them are too blurred to be kept.
    pub blurred: usize,
}

/// Longest side of the frames that are looked at, pixels.
const SMALL_SIDE: usize = 640;
/// Fewer frames make no model.
const LEAST: usize = 5;
/// Frames per second where nobody says how many.
const USUAL_RATE: f64 = 25.0;
/// More frames than anybody walks round an object for; each takes some kilobytes.
const MOST_DECODED: usize = 100_000;
/// Where the median point rests, the object may turn before a background that does not: then this one is asked.
const MOVING_SHARE: f64 = 0.85;
/// ffmpeg has ended and its last frame is being looked at.
const PATIENCE: Duration = Duration::from_secs(60);

const INSTALL: &str = "install ffmpeg (Debian, Ubuntu: apt install ffmpeg; macOS: brew install ffmpeg) or take photos";

/// Chooses frames of `video` and writes them, and no others, as `frame_0012.jpg`… into the folder `out`, which must be
/// empty or missing; ffmpeg turns them as the video's metadata says. The folder is there with all of them or not at all.
///
/// `progress` gets each line that ffmpeg prints.
///
/// # Errors
/// If ffmpeg is not installed, fails or takes too long; if the video has too few frames or too little motion; or if there is
/// something in `out`.
pub fn choose_frames(
    video: &Path,
    out: &Path,
    options: &VideoOptions,
    progress: &mut dyn FnMut(&str),
) -> Result<Frames> {
    check(options)?;
    if !video.is_file() {
        return refuse(format!("{} is no file", video.display()), "give a video");
    }
    let there = std::fs::read_dir(out).into_iter().flatten().filter_map(|e| Some(e.ok()?.file_name()));
    if let Some(name) = there.min() {
        return refuse(
            format!("{} has {} already", out.display(), name.display()),
            "give an empty folder, so that no frames of two videos are mixed",
        );
    }
    let measured = look_through(video, options, progress)?;
    let chosen = pick(&measured, &video.display().to_string(), options)?;

    // Half of a video's frames would look like a whole scan to the next run: they get their name when all are there.
    let part = temporary_path(out);
    std::fs::create_dir_all(&part).map_err(|e| Error::io("create", &part, e))?;
    let written = write_frames(video, &chosen, &part, options, progress);
    if written.is_err() {
        clear(&part)?;
    }
    written?;
    // An empty one may be there; not every system replaces it.
    let _ = std::fs::remove_dir(out);
    std::fs::rename(&part, out).map_err(|e| Error::io("move", &part, e))?;
    let blurred = quality(&measured).iter().filter(|q| q.sharpness < options.least_sharpness).count();
    Ok(Frames { indices: chosen.iter().map(|i| i + 1).collect(), decoded: measured.len(), blurred })
}

/// Chooses among photos that are frames of one video, all of one size, as [`choose_frames`] does; returns their indices in
/// `photos`, in the order of the numbers in their names. Files that cannot be read are passed over.
///
/// # Errors
/// If there are too few frames, frames of two sizes, or too little motion.
pub fn choose_from(photos: &[PhotoFile], options: &VideoOptions, progress: &mut dyn FnMut(&str)) -> Result<Vec<usize>> {
    check(options)?;
    let order = by_number(photos);
    let (mut tracker, mut measured, mut read) = (Tracker::default(), Vec::new(), Vec::new());
    let mut size = None;
    // Whole photos are large: only as many as are decoded at the same time are held.
    for some in order.chunks(rayon::current_num_threads().clamp(1, 8)) {
        let looked_at: Vec<_> = some.par_iter().map(|&i| small(&photos[i].path)).collect();
        for (&i, frame) in some.iter().zip(looked_at) {
            let Some((frame_size, frame)) = frame else {
                progress(&format!("{} cannot be read", photos[i].name));
                continue;
            };
            let [width, height] = *size.get_or_insert(frame_size);
            if frame_size != [width, height] {
                let name = &photos[i].name;
                return refuse(
                    format!(
                        "{name} is no frame of one video: it has {} x {} pixels, others {width} x {height}",
                        frame_size[0], frame_size[1]
                    ),
                    "put the photos of other sizes into another folder",
                );
            }
            measured.push(measure(&frame, read.len() as f64 / USUAL_RATE, &mut tracker));
            read.push(i);
        }
        progress(&format!("{} of {} frames looked at", read.len(), photos.len()));
    }
    let chosen = pick(&measured, "this folder", options)?;
    Ok(chosen.into_iter().map(|k| read[k]).collect())
}

/// Whether so many photos of one size follow each other so closely that they are frames of a video and [`choose_from`]
/// should choose among them.
pub fn are_frames(photos: &[PhotoFile]) -> bool {
    const MORE_THAN: usize = 150;
    const SAMPLES: usize = 12;
    let options = VideoOptions::default();
    if photos.len() <= MORE_THAN {
        return false;
    }
    let sizes: Vec<_> = photos.par_iter().map(|p| photo_size(&p.path).ok()).collect();
    if sizes.iter().flatten().any(|s| Some(s) != sizes.iter().flatten().next()) {
        return false;
    }
    let order = by_number(photos);
    let alike = |sample: &usize| {
        let at = sample * (order.len() - 2) / (SAMPLES - 1);
        let mut tracker = Tracker::default();
        let pair: Option<Vec<_>> = order[at..at + 2]
            .iter()
            .map(|&i| small(&photos[i].path).map(|(_, frame)| measure(&frame, 0.0, &mut tracker)))
            .collect();
        pair.is_some_and(|p| moved(&p[0], &p[1], 0.5).is_some_and(|d| d < options.window[1]))
    };
    (0..SAMPLES).filter(alike).count() * 4 >= SAMPLES * 3
}

fn check(options: &VideoOptions) -> Result<()> {
    let [near, far] = options.window;
    if !(near > 0.0 && far >= near && far.is_finite()) {
        return refuse(
            format!("a window of {near} to {far}"),
            "give two shares of the longer side, such as 0.04 and 0.08",
        );
    }
    if !(0.0..=1.0).contains(&options.least_sharpness) {
        return refuse(format!("a least sharpness of {}", options.least_sharpness), "give a number from 0 to 1");
    }
    Ok(())
}

/// The choice, or what is wrong with `what`.
fn pick(frames: &[Measured], what: &str, options: &VideoOptions) -> Result<Vec<usize>> {
    if frames.len() < LEAST {
        return refuse(
            format!("{what} has only {}, too few to choose photos from", count(frames.len(), "frame")),
            "film the object for half a minute while you walk round it, or take photos",
        );
    }
    let rules = Rules {
        window: options.window,
        least_sharpness: options.least_sharpness,
        number: [options.fewest, options.most],
    };
    let mut chosen = choose(frames, &rules, 0.5);
    if chosen.len() < LEAST.min(options.most) {
        chosen = choose(frames, &rules, MOVING_SHARE);
    }
    if chosen.len() < LEAST.min(options.most) {
        return refuse(
            format!(
                "the camera hardly moves in {what}: of its {} frames only {} would show anything new",
                frames.len(),
                chosen.len()
            ),
            "film while you walk slowly round the object, in light that gives sharp frames, or take photos",
        );
    }
    Ok(chosen)
}

fn measure(frame: &Grey, time_s: f64, tracker: &mut Tracker) -> Measured {
    Measured { points: tracker.add(frame), time_s }
}

/// A photo's size, and the photo made small.
fn small(path: &Path) -> Option<([usize; 2], Grey)> {
    let grey = read_grey(path).ok()?;
    Some(([grey.width, grey.height], shrunk(&grey, SMALL_SIDE)))
}

/// Indices in the order of the names, numbers in them by value: `frame_9` before `frame_10`.
fn by_number(photos: &[PhotoFile]) -> Vec<usize> {
    let key = |&i: &usize| -> Vec<(String, usize, String)> {
        let mut parts = Vec::new();
        let mut rest = photos[i].name.as_str();
        while !rest.is_empty() {
            let text_end = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
            let (text, after) = rest.split_at(text_end);
            let digits_end = after.find(|c: char| !c.is_ascii_digit()).unwrap_or(after.len());
            let (digits, after) = after.split_at(digits_end);
            let digits = digits.trim_start_matches('0');
            // A longer number is a larger one.
            parts.push((text.to_owned(), digits.len(), digits.to_owned()));
            rest = after;
        }
        parts
    };
    let mut order: Vec<usize> = (0..photos.len()).collect();
    order.sort_by_cached_key(key);
    order
}

/// ffmpeg with the video as its input. Frames are counted as they are decoded: the clock of each is set anew, so that none is
/// doubled or left out to keep a rate.
fn ffmpeg(video: &Path, filter: &str, options: &VideoOptions) -> Command {
    let mut command = Command::new(&options.program);
    // With its protocol named, no part of the video's name is taken for one.
    let mut input = OsString::from("file:");
    input.push(argument(video));
    command.args(["-nostdin", "-hide_banner", "-y", "-i"]).arg(input);
    // The first stream that is no cover picture.
    command.args(["-map", "0:V:0", "-vf", &format!("{filter},setpts=N/(25*TB)"), "-r", "25"]);
    command
}

/// Decodes the whole video, small and grey, and measures each frame.
fn look_through(video: &Path, options: &VideoOptions, progress: &mut dyn FnMut(&str)) -> Result<Vec<Measured>> {
    let side = SMALL_SIDE;
    let filter =
        format!("scale='if(gte(iw,ih),min({side},iw),-1)':'if(gte(iw,ih),-1,min({side},ih))':flags=area,format=gray");
    let mut command = ffmpeg(video, &filter, options);
    let (reader, writer) = std::io::pipe().map_err(|e| Error::io("make a pipe for the frames of", video, e))?;
    command.args(["-f", "yuv4mpegpipe", "-strict", "-1", "-"]).stdout(Stdio::from(writer));
    let (sender, result) = mpsc::channel();
    // Nobody waits for ever for this thread, as what ffmpeg started may hold the pipe open.
    std::thread::spawn(move || {
        let mut reader = BufReader::new(reader);
        let measured = read_frames(&mut reader);
        if matches!(measured, Err(Broken::NoVideo)) {
            // Whatever prints this is to end by itself.
            let _ = std::io::copy(&mut reader, &mut std::io::sink());
        }
        let _ = sender.send(measured);
    });
    let mut rate = None;
    let ran = run(command, "ffmpeg", INSTALL, options.time_limit, &mut |line| {
        rate = rate.or_else(|| rate_of(line));
        progress(line);
    });
    if ran.is_err() && !matches!(result.try_recv(), Ok(Err(Broken::TooLong))) {
        ran?;
    }
    match result.recv_timeout(PATIENCE) {
        Ok(Ok(mut frames)) if !frames.is_empty() => {
            let rate = rate.unwrap_or(USUAL_RATE);
            frames.iter_mut().enumerate().for_each(|(i, f)| f.time_s = i as f64 / rate);
            Ok(frames)
        }
        Ok(Ok(_)) => refuse(format!("ffmpeg found no frames in {}", video.display()), "give another video, or photos"),
        Ok(Err(Broken::TooLong)) => refuse(
            format!("{} has more than {MOST_DECODED} frames", video.display()),
            "cut out the minutes that show the object",
        ),
        Ok(Err(Broken::NoVideo)) | Err(_) => refuse(
            format!("what {} printed are no frames", options.program.display()),
            "name ffmpeg itself, version 4 or later",
        ),
    }
}

/// Why frames cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Broken {
    NoVideo,
    TooLong,
}

/// Frames in YUV4MPEG2 of one channel: a line that names width and height, then for each frame a line and its bytes.
fn read_frames(from: &mut impl BufRead) -> std::result::Result<Vec<Measured>, Broken> {
    const LARGEST: usize = 4096;
    let Some(header) = line(from) else { return Ok(Vec::new()) };
    let number = |letter: char| header.split(' ').skip(1).find_map(|w| w.strip_prefix(letter)?.parse::<usize>().ok());
    let (Some(width @ 1..=LARGEST), Some(height @ 1..=LARGEST)) = (number('W'), number('H')) else {
        return Err(Broken::NoVideo);
    };
    if !header.starts_with("YUV4MPEG2 ") || !header.contains(" Cmono") {
        return Err(Broken::NoVideo);
    }
    let (mut tracker, mut measured) = (Tracker::default(), Vec::new());
    while let Some(start) = line(from) {
        if !start.starts_with("FRAME") {
            return Err(Broken::NoVideo);
        }
        let mut frame = Grey { width, height, pixels: vec![0; width * height] };
        if from.read_exact(&mut frame.pixels).is_err() {
            break; // cut off: ffmpeg says why
        }
        if measured.len() == MOST_DECODED {
            return Err(Broken::TooLong);
        }
        measured.push(measure(&frame, 0.0, &mut tracker));
    }
    Ok(measured)
}

/// A short line of text without its end; `None` at the end of the stream.
fn line(from: &mut impl BufRead) -> Option<String> {
    const LONGEST: u64 = 1024;
    let mut bytes = Vec::new();
    let read = from.by_ref().take(LONGEST).read_until(b'\n', &mut bytes).ok()?;
    (read > 0).then(|| String::from_utf8_lossy(&bytes).trim_end().to_owned())
}

/// Frames per second, where this line of ffmpeg's describes a video stream.
fn rate_of(line: &str) -> Option<f64> {
    let (_, about) = line.split_once(" Video: ")?;
    let rate = about.split(", ").find_map(|part| part.strip_suffix(" fps"))?;
    rate.parse::<f64>().ok().filter(|r| *r > 0.0 && r.is_finite())
}

/// Decodes the video again and writes the frames of these indices, counted from 0.
fn write_frames(
    video: &Path,
    chosen: &[usize],
    folder: &Path,
    options: &VideoOptions,
    progress: &mut dyn FnMut(&str),
) -> Result<()> {
    let side = options.max_side.max(1);
    let which: Vec<String> = chosen.iter().map(|i| format!("eq(n,{i})")).collect();
    let filter = format!(
        "select='{}',scale='min({side},iw)':'min({side},ih)':force_original_aspect_ratio=decrease",
        which.join("+")
    );
    let mut command = ffmpeg(video, &filter, options);
    command.args(["-qscale:v", "2"]).arg(pattern(folder)).stdout(Stdio::piped());
    run(command, "ffmpeg", INSTALL, options.time_limit, progress)?;
    let written = photos_under(folder);
    if written.len() != chosen.len() {
        return refuse(
            format!("ffmpeg wrote {} of {} frames of {}", written.len(), chosen.len(), video.display()),
            "see whether the disk is full; else convert the video, as with: ffmpeg -i VIDEO -c:v libx264 NEW.mp4",
        );
    }
    for (photo, index) in written.iter().zip(chosen) {
        let path = folder.join(format!("frame_{:04}.jpg", index + 1));
        std::fs::rename(&photo.path, &path).map_err(|e| Error::io("move", &photo.path, e))?;
    }
    Ok(())
}

/// What ffmpeg makes names of frames in `folder` from; a `%` in the folder's own name is doubled.
fn pattern(folder: &Path) -> PathBuf {
    let folder = argument(folder);
    folder.to_str().map_or_else(|| folder.clone(), |name| name.replace('%', "%%").into()).join("part_%05d.jpg")
}
