//! A camera over a painted plane: it walks, rests, jerks and goes round.

use super::choose::{Measured, Rules, choose, moved, quality, shrunk};
use super::track::Tracker;
use super::{Broken, by_number, measure, rate_of, read_frames};
use crate::photos::Grey;
use drex_core::capture::PhotoFile;

const SIZE: [usize; 2] = [320, 180];

/// A number from 0 to 1 for each whole place.
fn speck(x: i64, y: i64) -> f64 {
    let mut h = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((h ^ (h >> 32)) & 0xffff) as f64 / 65535.0
}

/// Spots of two sizes, smooth between.
fn paint(x: f64, y: f64) -> f64 {
    let spots = |cell: f64, shift: i64| {
        let [u, v] = [x / cell, y / cell];
        let [i, j] = [u.floor() as i64 + shift, v.floor() as i64];
        let ease = |t: f64| t * t * (3.0 - 2.0 * t);
        let [a, b] = [ease(u - u.floor()), ease(v - v.floor())];
        let row = |j| speck(i, j) * (1.0 - a) + speck(i + 1, j) * a;
        row(j) * (1.0 - b) + row(j + 1) * b
    };
    40.0 + 110.0 * spots(23.0, 0) + 70.0 * spots(4.0, 1000)
}

/// What a camera sees that stands at `at` and is smeared over `smear` pixels, with noise of its own.
fn view(at: [f64; 2], smear: [f64; 2], seed: i64) -> Grey {
    let [width, height] = SIZE;
    let samples = if smear == [0.0; 2] { 1 } else { 7 };
    let value = |x: usize, y: usize| {
        let sum: f64 = (0..samples)
            .map(|k| {
                let t = k as f64 / 6.0 - 0.5;
                let t = if samples == 1 { 0.0 } else { t };
                paint(at[0] + x as f64 + smear[0] * t, at[1] + y as f64 + smear[1] * t)
            })
            .sum();
        sum / f64::from(samples) + 4.0 * (speck(x as i64 + 7919 * seed, y as i64) - 0.5)
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| value(x, y) as u8).collect();
    Grey { width, height, pixels }
}

/// Measures at 30 frames per second.
fn recording(frames: impl IntoIterator<Item = Grey>) -> Vec<Measured> {
    let mut tracker = Tracker::default();
    frames.into_iter().enumerate().map(|(i, f)| measure(&f, i as f64 / 30.0, &mut tracker)).collect()
}

fn rules(number: [usize; 2]) -> Rules {
    Rules { window: [0.04, 0.08], least_sharpness: 0.5, number }
}

/// Shares of the longer side between chosen frames.
fn steps(chosen: &[usize], at: &[[f64; 2]]) -> Vec<f64> {
    chosen.windows(2).map(|w| (at[w[1]][0] - at[w[0]][0]).hypot(at[w[1]][1] - at[w[0]][1]) / SIZE[0] as f64).collect()
}

#[test]
fn a_pause_gives_one_frame_and_points_move_as_the_camera_does() {
    let mut at: Vec<[f64; 2]> = (0..50).map(|i| [2.3 * f64::from(i), 0.0]).collect();
    at.extend(std::iter::repeat_n([115.0, 0.0], 60));
    at.extend((1..50).map(|i| [115.0, 2.0 * f64::from(i)]));
    let frames = recording(at.iter().enumerate().map(|(i, p)| view(*p, [0.0; 2], i as i64)));
    for (a, b) in [(0, 1), (3, 15), (20, 40), (60, 105)] {
        let truth = steps(&[a, b], &at)[0];
        let found = moved(&frames[a], &frames[b], 0.5).unwrap();
        assert!((found - truth).abs() < 0.001, "{a} {b}: {found} for {truth}");
    }
    let chosen = choose(&frames, &rules([1, 150]), 0.5);
    let in_pause = chosen.iter().filter(|i| (50..110).contains(*i)).count();
    assert!(in_pause <= 1, "{chosen:?}");
    let steps = steps(&chosen, &at);
    assert!(steps.len() >= 8 && steps.iter().all(|s| (0.039..0.081).contains(s)), "{steps:?}");
    // All of it at rest: one.
    assert_eq!(choose(&frames[52..108], &rules([60, 150]), 0.5).len(), 1);
}

#[test]
fn a_smeared_frame_is_not_chosen() {
    let at: Vec<[f64; 2]> = (0..120).map(|i| [2.0 * f64::from(i), 0.7 * f64::from(i)]).collect();
    let smeared = |i: usize| i % 7 == 3 || (60..75).contains(&i);
    for smear in [[9.0, 0.0], [0.0, 9.0], [6.0, -6.0]] {
        let frames = recording((0..at.len()).map(|i| view(at[i], if smeared(i) { smear } else { [0.0; 2] }, i as i64)));
        let sharp: Vec<f64> = quality(&frames).iter().map(|q| q.sharpness).collect();
        let worst = (0..at.len()).filter(|&i| !smeared(i)).map(|i| sharp[i]).fold(f64::INFINITY, f64::min);
        let best = (0..at.len()).filter(|&i| smeared(i)).map(|i| sharp[i]).fold(0.0, f64::max);
        assert!(best < 0.5 && worst > 0.7, "{smear:?}: {best} {worst}");
        let chosen = choose(&frames, &rules([1, 150]), 0.5);
        assert!(chosen.len() >= 8 && chosen.iter().all(|&i| !smeared(i)), "{smear:?}: {chosen:?}");
        // A light smear is no reason to drop a frame, but its sharper neighbour is taken.
        let light = |i: usize| i % 4 != 1;
        let smear = smear.map(|s| s / 4.0);
        let frames = recording((0..60).map(|i| view(at[i], if light(i) { smear } else { [0.0; 2] }, i as i64)));
        let chosen = choose(&frames, &rules([1, 150]), 0.5);
        assert!(chosen.len() >= 4 && chosen.iter().all(|&i| !light(i)), "{smear:?}: {chosen:?}");
    }
}

#[test]
fn rounds_keep_their_spacing() {
    // Two rounds that begin slowly: no fixed stride would do.
    let angle = |i: usize| 4.0 * std::f64::consts::PI * (i as f64 / 239.0).powf(1.4);
    let at: Vec<[f64; 2]> = (0..240).map(|i| [70.0 * angle(i).cos(), 70.0 * angle(i).sin()]).collect();
    let frames = recording(at.iter().enumerate().map(|(i, p)| view(*p, [0.0; 2], i as i64)));
    let chosen = choose(&frames, &rules([1, 150]), 0.5);
    let spacing = steps(&chosen, &at);
    assert!(spacing.iter().all(|s| (0.039..0.081).contains(s)), "{spacing:?}");
    let first = chosen.iter().filter(|&&i| angle(i) < 2.0 * std::f64::consts::PI).count();
    assert!(first.abs_diff(chosen.len() - first) <= 4, "{first} of {}", chosen.len());

    // Fewer frames: further apart, as evenly. More frames: closer, down to a quarter.
    let few = choose(&frames, &rules([1, 12]), 0.5);
    let spacing = steps(&few, &at);
    assert!((8..=12).contains(&few.len()) && spacing.iter().all(|s| (0.08..0.4).contains(s)), "{spacing:?}");
    let many = choose(&frames, &rules([60, 150]), 0.5);
    assert!(chosen.len() < 60 && (60..100).contains(&many.len()), "{} {}", chosen.len(), many.len());
    let most = choose(&frames, &rules([10_000, 20_000]), 0.5);
    assert!(steps(&most, &at).iter().all(|s| *s > 0.0099), "{:?}", steps(&most, &at));
}

#[test]
fn a_turning_object_before_a_still_background_is_followed() {
    let frames = recording((0..60).map(|i| {
        let mut still = view([0.0; 2], [0.0; 2], i);
        let moving = view([1000.0 + 2.0 * i as f64, 0.0], [0.0; 2], i);
        for y in 50..130 {
            let row = y * SIZE[0];
            still.pixels[row + 90..row + 230].copy_from_slice(&moving.pixels[row + 90..row + 230]);
        }
        still
    }));
    assert_eq!(choose(&frames, &rules([1, 150]), 0.5).len(), 1);
    assert!(choose(&frames, &rules([1, 150]), super::MOVING_SHARE).len() >= 4);
}

#[test]
fn frames_without_common_points_are_all_kept() {
    let frames = recording((0..40).map(|i| view([1000.0 * f64::from(i), 0.0], [0.0; 2], i64::from(i))));
    assert_eq!(choose(&frames, &rules([1, 150]), 0.5).len(), 40);
    assert_eq!(choose(&frames, &rules([1, 10]), 0.5).len(), 10);
}

#[test]
fn exposure_may_change() {
    let mut frames: Vec<Grey> = (0..40).map(|i| view([2.0 * f64::from(i), 0.0], [0.0; 2], i64::from(i))).collect();
    for (i, frame) in frames.iter_mut().enumerate() {
        frame.pixels.iter_mut().for_each(|v| *v = (f64::from(*v) * (0.8 + 0.01 * (i % 20) as f64)) as u8);
    }
    let frames = recording(frames);
    let found = moved(&frames[5], &frames[15], 0.5).unwrap();
    assert!((found - 20.0 / 320.0).abs() < 0.002, "{found}");
}

#[test]
fn odd_frames_do_no_harm() {
    assert!(choose(&[], &rules([60, 150]), 0.5).is_empty());
    let sizes = (0..14).chain([40, 333]).flat_map(|w| (0..14).chain([40]).map(move |h| (w, h)));
    let odd: Vec<Grey> = sizes
        .map(|(width, height)| Grey { width, height, pixels: (0..width * height).map(|i| (i * 37) as u8).collect() })
        .collect();
    for frame in &odd {
        let small = shrunk(frame, 10);
        assert!(small.width.max(small.height) <= 10 && small.pixels.len() == small.width * small.height);
    }
    let frames = recording(odd);
    let _ = choose(&frames, &rules([60, 150]), 0.5);
    // Black, white, one colour: nothing to follow, nothing sharp.
    let flat = recording([0u8, 255, 9, 9, 9].map(|v| Grey { width: 64, height: 48, pixels: vec![v; 64 * 48] }));
    assert!(flat.iter().all(|f| f.points.is_empty()));
    let _ = choose(&flat, &rules([0, 0]), 1.0);
    let mean = shrunk(&Grey { width: 4, height: 2, pixels: vec![0, 10, 100, 200, 20, 30, 100, 0] }, 2);
    assert_eq!((mean.width, mean.height, mean.pixels), (2, 1, vec![15, 100]));
}

#[test]
fn what_ffmpeg_prints_is_read_or_refused() {
    let mut recording = b"YUV4MPEG2 W32 H24 F25:1 Ip A1:1 Cmono XCOLORRANGE=FULL\n".to_vec();
    for i in 0..3u8 {
        recording.extend_from_slice(b"FRAME\n");
        recording.extend((0..32 * 24).map(|k| (k as u8).wrapping_mul(i)));
    }
    assert_eq!(read_frames(&mut recording.as_slice()).unwrap().len(), 3);
    for end in 0..recording.len() {
        if let Ok(frames) = read_frames(&mut &recording[..end]) {
            assert!(frames.len() <= 2, "{end}");
        }
    }
    let no_video = |text: &str| assert_eq!(read_frames(&mut text.as_bytes()), Err(Broken::NoVideo), "{text}");
    no_video("hello\n");
    no_video(&"x".repeat(1 << 20));
    no_video("YUV4MPEG2 W0 H24 Cmono\nFRAME\n");
    no_video("YUV4MPEG2 W99999999999999999999 H24 Cmono\nFRAME\n");
    no_video("YUV4MPEG2 W4097 H4096 Cmono\nFRAME\n");
    no_video("YUV4MPEG2 W2 H2 C420\nFRAME\n....");
    no_video("YUV4MPEG2 W2 H2 Cmono\nframe\n....");
    assert_eq!(read_frames(&mut &b""[..]), Ok(Vec::new()));

    let stream =
        "  Stream #0:0(und): Video: h264 (High), yuv420p, 640x480 [SAR 1:1], 1132 kb/s, 29.97 fps, 30 tbr, 12288 tbn";
    assert_eq!(rate_of(stream), Some(29.97));
    assert_eq!(rate_of("frame=  240 fps= 14 q=-0.0"), None);
    assert_eq!(rate_of("Stream #0:0: Video: h264, 0 fps, x"), None);
}

#[test]
fn names_go_by_their_numbers() {
    let names = ["f10.jpg", "f9.jpg", "f009b.jpg", "e11.jpg", "f123456789012345678901.jpg", "", "f2.jpg", "7"];
    let photos: Vec<PhotoFile> = names.map(|n| PhotoFile { name: n.into(), path: n.into() }).into();
    let order: Vec<&str> = by_number(&photos).into_iter().map(|i| names[i]).collect();
    assert_eq!(order, ["", "7", "e11.jpg", "f2.jpg", "f9.jpg", "f009b.jpg", "f10.jpg", "f123456789012345678901.jpg"]);
}
