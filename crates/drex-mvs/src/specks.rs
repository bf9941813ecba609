//! Small pieces of a depth map that stand apart from what is round them.

use crate::depth_map::DepthMap;

/// Pixels whose depths differ by less than so many of their widths are of one surface.
const TOGETHER_PX: f32 = 5.0;
/// Smaller pieces are dropped,
const LEAST_PIXELS: usize = 60;
/// and those with less than this share of all pixels that are seen as if through a window: a highlight on a round thing shows the lamp
/// behind its surface, and all photos agree about it.
const WINDOW_SHARE: f64 = 0.03;
/// That much of the rim of such a piece has something nearer beside it,
const BEHIND_SHARE: f64 = 0.7;
/// so many pixels away at the most.
const REACH_PX: usize = 8;

/// Drops them.
pub(crate) fn drop_specks(map: &mut DepthMap) {
    let (width, height) = (map.camera.width, map.camera.height);
    let focal = map.camera.fx as f32;
    let together = |a: f32, b: f32| a > 0.0 && b > 0.0 && (a - b).abs() < TOGETHER_PX * a.min(b) / focal;
    let found = map.depth.iter().filter(|z| **z > 0.0).count();
    let window = (WINDOW_SHARE * found as f64) as usize;
    // Pieces by number, from 1.
    let mut piece = vec![0u32; width * height];
    let mut pieces: Vec<Vec<usize>> = Vec::new();
    for start in 0..width * height {
        if piece[start] > 0 || !(map.depth[start] > 0.0) {
            continue;
        }
        let number = pieces.len() as u32 + 1;
        piece[start] = number;
        let mut members = vec![start];
        let mut next = 0;
        while let Some(&at) = members.get(next) {
            next += 1;
            for beside in neighbours(at, width, height) {
                if piece[beside] == 0 && together(map.depth[at], map.depth[beside]) {
                    piece[beside] = number;
                    members.push(beside);
                }
            }
        }
        pieces.push(members);
    }
    for (number, members) in pieces.iter().enumerate().filter(|(_, m)| m.len() < LEAST_PIXELS.max(window)) {
        let number = number as u32 + 1;
        let seen_through = || {
            let (mut rim, mut behind) = (0usize, 0usize);
            for &at in members {
                for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                    match beside(map, &piece, at, (dx, dy), number) {
                        Beside::Same => {}
                        Beside::Nothing => rim += 1,
                        Beside::Other(z) => {
                            rim += 1;
                            behind += usize::from(z < map.depth[at]);
                        }
                    }
                }
            }
            behind as f64 >= BEHIND_SHARE * rim as f64
        };
        if members.len() < LEAST_PIXELS || seen_through() {
            for &at in members {
                (map.depth[at], map.normal[at], map.confidence[at]) = (0.0, [0.0; 3], 0.0);
            }
        }
    }
}

/// What is next to a pixel of a piece in a direction.
enum Beside {
    Same,
    Nothing,
    /// Another piece at this depth.
    Other(f32),
}

fn beside(map: &DepthMap, piece: &[u32], at: usize, (dx, dy): (isize, isize), own: u32) -> Beside {
    let (width, height) = (map.camera.width, map.camera.height);
    let (mut x, mut y) = (at % width, at / width);
    for step in 0..REACH_PX {
        let (Some(u), Some(v)) = (x.checked_add_signed(dx), y.checked_add_signed(dy)) else { return Beside::Nothing };
        if u >= width || v >= height {
            return Beside::Nothing;
        }
        (x, y) = (u, v);
        let there = v * width + u;
        if piece[there] == own {
            // Beyond a gap it is the piece itself again.
            return if step == 0 { Beside::Same } else { Beside::Nothing };
        }
        if piece[there] > 0 {
            return Beside::Other(map.depth[there]);
        }
    }
    Beside::Nothing
}

fn neighbours(at: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (at % width, at / width);
    [
        (x > 0).then(|| at - 1),
        (x + 1 < width).then(|| at + 1),
        (y > 0).then(|| at - width),
        (y + 1 < height).then(|| at + width),
    ]
    .into_iter()
    .flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use drex_core::Pose;
    use drex_core::camera::PinholeCamera;

    /// A wall at depth 1, with squares at other depths: left, top, side, depth.
    fn wall(squares: &[(usize, usize, usize, f32)]) -> DepthMap {
        let (width, height) = (100, 80);
        let camera = PinholeCamera {
            camera_from_world: Pose::identity(),
            fx: 100.0,
            fy: 100.0,
            cx: 50.0,
            cy: 40.0,
            width,
            height,
        };
        let mut depth = vec![1.0; width * height];
        for &(left, top, side, z) in squares {
            (0..side * side).for_each(|i| depth[(top + i / side) * width + left + i % side] = z);
        }
        let n = width * height;
        DepthMap { camera, corner: [0, 0], depth, normal: vec![[0.0, 0.0, -1.0]; n], confidence: vec![1.0; n] }
    }

    #[test]
    fn what_is_small_or_seen_through_a_window_goes_and_what_stands_before_stays() {
        // Fewer than 60 pixels; a highlight's 144; a knob of as many before the wall; a hole too large for a highlight.
        let squares = [(5, 5, 7, 0.8), (20, 5, 12, 1.2), (40, 5, 12, 0.8), (60, 20, 30, 1.2)];
        let mut map = wall(&squares);
        drop_specks(&mut map);
        let left_of = |&(left, top, side, _): &(usize, usize, usize, f32)| {
            (0..side * side).filter(|i| map.depth[(top + i / side) * 100 + left + i % side] > 0.0).count()
        };
        assert_eq!(squares.iter().map(left_of).collect::<Vec<_>>(), [0, 0, 144, 900]);
        let gone = map.depth.iter().filter(|z| **z == 0.0).count();
        assert!(gone == 49 + 144 && map.confidence.iter().filter(|c| **c == 0.0).count() == gone);
    }
}
