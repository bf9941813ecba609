//! Frames of a video, with ffmpeg played by small shell scripts, and with ffmpeg itself where it is installed.
#![cfg(unix)]

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::programs::{alone, script};
use drex_core::capture::photos_under;
use drex_sfm::video::{Frames, VideoOptions, are_frames, choose_frames, choose_from};

const SIZE: [usize; 2] = [192, 144];

/// A picture of a painted plane that the camera has moved over by `at` pixels.
fn view(at: f64) -> Vec<u8> {
    let speck = |x: i64, y: i64| {
        let h = (x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663)).wrapping_mul(2_654_435_761);
        ((h >> 13) & 0xff) as f64
    };
    let paint = |x: f64, y: i64| {
        let (i, t) = (x.floor() as i64, x - x.floor());
        speck(i, y) * (1.0 - t) + speck(i + 1, y) * t
    };
    let value = |x: usize, y: usize| {
        let [u, v] = [(at + x as f64) / 7.0, y as f64 / 7.0];
        let t = v - v.floor();
        (20.0 + 0.8 * (paint(u, v.floor() as i64) * (1.0 - t) + paint(u, v.floor() as i64 + 1) * t)) as u8
    };
    (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| value(x, y))).collect()
}

/// The frames as ffmpeg prints them.
fn film(at: impl IntoIterator<Item = f64>) -> Vec<u8> {
    let mut bytes = format!("YUV4MPEG2 W{} H{} F25:1 Ip A1:1 Cmono\n", SIZE[0], SIZE[1]).into_bytes();
    for at in at {
        bytes.extend_from_slice(b"FRAME\n");
        bytes.extend(view(at));
    }
    bytes
}

/// 20 frames that move, 20 at rest, 60 that move: two pixels a frame.
fn walk() -> Vec<f64> {
    let mut at: Vec<f64> = (0..20).map(|i| 2.0 * f64::from(i)).collect();
    at.extend(std::iter::repeat_n(38.0, 20));
    at.extend((1..=60).map(|i| 38.0 + 2.0 * f64::from(i)));
    at
}

fn picture(path: &Path, at: f64) {
    image::GrayImage::from_raw(SIZE[0] as u32, SIZE[1] as u32, view(at)).unwrap().save(path).unwrap();
}

/// An ffmpeg that prints `film`, and writes as many frames as it is asked for.
fn player(folder: &Path, film: &[u8]) -> PathBuf {
    std::fs::write(folder.join("film.y4m"), film).unwrap();
    picture(&folder.join("frame.jpg"), 0.0);
    let text = format!(
        "echo \"$@\" >> '{0}/calls'; echo 'Stream #0:0: Video: h264, 24 fps, 24 tbr' >&2\n\
         for last; do :; done\n\
         case \"$*\" in *yuv4mpegpipe*) cat '{0}/film.y4m'; exit;; esac\n\
         n=$(echo \"$*\" | grep -o 'eq(n' | wc -l); i=0\n\
         while [ $i -lt $n ]; do i=$((i+1)); cp '{0}/frame.jpg' \"$(dirname \"$last\")/$(printf part_%05d.jpg $i)\"; done\n",
        folder.display()
    );
    script(folder, "ffmpeg", &text)
}

fn names(folder: &Path) -> Vec<String> {
    photos_under(folder).into_iter().map(|p| p.name).collect()
}

fn check(frames: &Frames, folder: &Path) {
    assert_eq!(frames.decoded, 100);
    let expected: Vec<String> = frames.indices.iter().map(|i| format!("frame_{i:04}.jpg")).collect();
    assert_eq!(names(folder), expected);
    let at = walk();
    let steps: Vec<f64> = frames.indices.windows(2).map(|w| (at[w[1] - 1] - at[w[0] - 1]) / SIZE[0] as f64).collect();
    // Narrowed to a quarter, as there are few.
    assert!(steps.len() >= 30 && steps.iter().all(|s| (0.009..0.045).contains(s)), "{steps:?}");
}

#[test]
fn only_the_chosen_frames_are_written() {
    let _turn = alone();
    let guard = tempfile::tempdir().unwrap();
    let (out, video) = (guard.path().join("scan/images"), guard.path().join("push.mp4"));
    std::fs::write(&video, b"film").unwrap();
    let mut options = VideoOptions::default();
    options.program = player(guard.path(), &film(walk()));
    let mut lines = 0;
    check(&choose_frames(&video, &out, &options, &mut |_| lines += 1).unwrap(), &out);
    assert_eq!(lines, 2);
    let calls = std::fs::read_to_string(guard.path().join("calls")).unwrap();
    assert!(calls.lines().all(|c| c.contains(&format!("-i file:{}", video.display()))), "{calls}");
    let choose = |options: &VideoOptions| choose_frames(&video, &out, options, &mut |_| ()).map_err(|e| e.to_string());
    assert!(choose(&options).unwrap_err().contains("has frame_0001.jpg already"));
    std::fs::remove_dir_all(&out).unwrap();
    // A limit to their number.
    options.most = 10;
    assert!(choose(&options).unwrap().indices.len() <= 10);
    options.most = 150;

    let refused = |program: PathBuf, words: &[&str]| {
        let _ = std::fs::remove_dir_all(guard.path().join("scan"));
        let mut options = options.clone();
        options.program = program;
        let message = choose(&options).unwrap_err();
        assert!(words.iter().all(|w| message.contains(w)), "{message}");
        // Nothing is left, not even half of it.
        assert!(std::fs::read_dir(guard.path().join("scan")).into_iter().flatten().next().is_none(), "{message}");
    };
    refused("/nowhere/ffmpeg".into(), &["/nowhere/ffmpeg was not found", "apt install ffmpeg"]);
    refused(player(guard.path(), &film([0.0, 9.0, 18.0])), &["push.mp4 has only 3 frames"]);
    refused(player(guard.path(), &film([5.0; 90])), &["the camera hardly moves", "push.mp4", "90 frames"]);
    refused(player(guard.path(), b""), &["no frames in", "push.mp4"]);
    refused(player(guard.path(), b"Usage: play FILE\n"), &["are no frames", "name ffmpeg"]);
    refused(script(guard.path(), "fails", "echo what a film >&2; exit 3"), &["ffmpeg failed", "what a film"]);
    // It breaks off while it writes; it writes too few.
    let text = std::fs::read_to_string(player(guard.path(), &film(walk()))).unwrap();
    refused(script(guard.path(), "full", &format!("{text}exit 1\n")), &["ffmpeg failed"]);
    refused(script(guard.path(), "short", &text.replace("i=0", "i=2")), &["ffmpeg wrote"]);
    let message = choose_frames(Path::new("/nowhere/film.mp4"), &out, &options, &mut |_| ()).unwrap_err().to_string();
    assert!(message.contains("/nowhere/film.mp4 is no file"), "{message}");
    for window in [[0.0, 0.1], [0.2, 0.1], [f64::NAN, 0.1], [0.1, f64::INFINITY]] {
        options.window = window;
        assert!(choose(&options).unwrap_err().contains("a window of"), "{window:?}");
    }
}

#[test]
fn an_ffmpeg_that_does_not_end_is_ended() {
    let _turn = alone();
    let guard = tempfile::tempdir().unwrap();
    let video = guard.path().join("push.mp4");
    std::fs::write(&video, b"film").unwrap();
    let mut options = VideoOptions::default();
    options.time_limit = Duration::from_millis(300);
    let begun = Instant::now();
    for (i, hang) in ["exec sleep 600", "while :; do echo x; done", "sleep 30; exit 0"].iter().enumerate() {
        options.program = script(guard.path(), &format!("ffmpeg{i}"), hang);
        let message = choose_frames(&video, &guard.path().join("out"), &options, &mut |_| ()).unwrap_err().to_string();
        assert!(message.contains("ffmpeg had not ended") && !guard.path().join("out").exists(), "{hang}: {message}");
    }
    assert!(begun.elapsed() < Duration::from_secs(60));
}

#[test]
fn a_folder_of_frames() {
    let guard = tempfile::tempdir().unwrap();
    let at = walk();
    for (i, at) in at.iter().enumerate() {
        picture(&guard.path().join(format!("frame_{}.png", i + 1)), *at);
    }
    std::fs::write(guard.path().join("frame_50.png"), b"no picture").unwrap();
    let photos = photos_under(guard.path());
    let options = VideoOptions::default();
    let mut unreadable = Vec::new();
    let chosen = choose_from(&photos, &options, &mut |line| {
        if line.contains("cannot be read") {
            unreadable.push(line.to_owned());
        }
    })
    .unwrap();
    assert_eq!(unreadable, ["frame_50.png cannot be read"]);
    let number = |i: usize| photos[i].name[6..photos[i].name.len() - 4].parse::<usize>().unwrap();
    let numbers: Vec<usize> = chosen.iter().map(|&i| number(i)).collect();
    assert!(numbers.is_sorted() && numbers.len() >= 30 && !numbers.contains(&50), "{numbers:?}");
    assert!(numbers.iter().filter(|n| (21..=40).contains(*n)).count() <= 1, "{numbers:?}");
    // The same at any number of threads.
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(one.install(|| choose_from(&photos, &options, &mut |_| ())).unwrap(), chosen);

    assert!(choose_from(&[], &options, &mut |_| ()).unwrap_err().to_string().contains("only 0 frames"));
    let rest: Vec<_> =
        photos.iter().filter(|p| (22..40).any(|n| p.name == format!("frame_{n}.png"))).cloned().collect();
    let message = choose_from(&rest, &options, &mut |_| ()).unwrap_err().to_string();
    assert!(message.contains("the camera hardly moves in this folder: of its 18 frames only 1"), "{message}");
    image::GrayImage::new(40, 30).save(guard.path().join("frame_70.png")).unwrap();
    let message = choose_from(&photos, &options, &mut |_| ()).unwrap_err().to_string();
    assert!(message.contains("frame_70.png is no frame of one video: it has 40 x 30 pixels"), "{message}");
}

#[test]
fn video_frames_and_photos_are_distinguished() {
    let guard = tempfile::tempdir().unwrap();
    let [film, album] = ["film", "album"].map(|n| guard.path().join(n));
    for folder in [&film, &album] {
        std::fs::create_dir(folder).unwrap();
    }
    for i in 0..160 {
        picture(&film.join(format!("{i}.png")), 1.5 * f64::from(i));
        picture(&album.join(format!("{i}.png")), 60.0 * f64::from(i));
    }
    assert!(are_frames(&photos_under(&film)));
    assert!(!are_frames(&photos_under(&album)));
    assert!(!are_frames(&photos_under(&film)[..150]) && !are_frames(&[]));
    image::GrayImage::new(40, 30).save(film.join("70.png")).unwrap();
    assert!(!are_frames(&photos_under(&film)));
}

#[test]
fn frames_that_ffmpeg_writes_are_those_of_their_names() {
    let guard = tempfile::tempdir().unwrap();
    let video = guard.path().join("50 % of it.avi");
    let making = Command::new("ffmpeg")
        .args([
            "-loglevel",
            "error",
            "-f",
            "yuv4mpegpipe",
            "-i",
            "-",
            "-c:v",
            "mjpeg",
            "-q:v",
            "2",
            "-pix_fmt",
            "yuvj420p",
        ])
        .arg(&video)
        .stdin(Stdio::piped())
        .spawn();
    let Ok(mut making) = making else {
        eprintln!("skipped: ffmpeg is not installed");
        return;
    };
    making.stdin.take().unwrap().write_all(&film(walk())).unwrap();
    assert!(making.wait().unwrap().success());
    let out = guard.path().join("50 %d/images");
    let mut lines = Vec::new();
    let frames = choose_frames(&video, &out, &VideoOptions::default(), &mut |l| lines.push(l.to_owned()))
        .unwrap_or_else(|e| {
            panic!("{e}; {lines:#?}");
        });
    check(&frames, &out);
    let at = walk();
    for index in &frames.indices {
        let seen = image::open(out.join(format!("frame_{index:04}.jpg"))).unwrap().into_luma8().into_raw();
        let off = |at: f64| view(at).iter().zip(&seen).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>();
        let own = off(at[index - 1]);
        assert!([-2.0, 2.0].iter().all(|step| off(at[index - 1] + step) > 2.0 * own), "{index}");
    }
}
