//! Which order the key points are in, and how a hand is told from a jumble.

use drex_core::{Error, Result};

use super::RawFrame;
use super::options::{KeyPointOrder, MANO_INDEX};
use crate::keypoints::PARENT;
use crate::{KEYPOINTS, KeyPoints};

/// A hand read in the wrong order has longer bones by at least this factor (measured on five recordings: 1.33 and more over a sequence,
/// 1.07 in the worst single frame, a fist).
const CLEARLY_LONGER: f64 = 1.1;

/// Points of MANO's own order in that of OpenPose.
pub(super) fn openpose_from_mano(points: &KeyPoints) -> KeyPoints {
    MANO_INDEX.map(|i| points[i])
}

/// Puts every frame in OpenPose's order. The order is stated, never guessed: but a statement that the bones contradict is
/// refused. In the wrong order the fingers' chains run across the hand, so that the bones' total length grows by a third.
pub(super) fn put_in_order(path: &std::path::Path, frames: &mut [RawFrame], order: KeyPointOrder) -> Result<()> {
    let total = |other: fn(&KeyPoints) -> KeyPoints| frames.iter().filter_map(|f| tree_length(&other(&f.points))).sum();
    let (as_openpose, as_mano): (f64, f64) = (total(|p| *p), total(openpose_from_mano));
    let (stated, other, name, option) = match order {
        KeyPointOrder::OpenPose => (as_openpose, as_mano, "MANO", "mano"),
        KeyPointOrder::Mano => (as_mano, as_openpose, "OpenPose", "openpose"),
    };
    if stated > CLEARLY_LONGER * other && other > 0.0 {
        return Err(Error::content(
            path,
            None,
            format!("the bones of the hand are {:.0} % longer than in {name}'s order", 100.0 * (stated / other - 1.0)),
            format!("the key points seem to be in the order of {name}: state the order \"{option}\""),
        ));
    }
    if order == KeyPointOrder::Mano {
        frames.iter_mut().for_each(|f| f.points = openpose_from_mano(&f.points));
    }
    Ok(())
}

/// Total length of the bones; `None` if a point is missing, so that both orders are compared over the same frames.
fn tree_length(points: &KeyPoints) -> Option<f64> {
    let mut sum = 0.0;
    for i in 1..KEYPOINTS {
        sum += (points[i]? - points[PARENT[i]]?).norm();
    }
    sum.is_finite().then_some(sum)
}

/// Names of the key points in OpenPose's order, as files write them.
pub(crate) const NAMES: [&str; KEYPOINTS] = [
    "wrist",
    "thumb_cmc",
    "thumb_mcp",
    "thumb_ip",
    "thumb_tip",
    "index_mcp",
    "index_pip",
    "index_dip",
    "index_tip",
    "middle_mcp",
    "middle_pip",
    "middle_dip",
    "middle_tip",
    "ring_mcp",
    "ring_pip",
    "ring_dip",
    "ring_tip",
    "little_mcp",
    "little_pip",
    "little_dip",
    "little_tip",
];

/// The key point that a file calls `name`.
pub(super) fn key_point_named(name: &str) -> Option<usize> {
    let name = name.trim().to_ascii_lowercase().replace([' ', '-', '.'], "_");
    let name = name.replace("pinky", "little").replace("_finger", "").replace("_metacarpal", "_cmc");
    NAMES.iter().position(|n| *n == name)
}

/// The 21 points of the 25 nodes of a Manus glove: the metacarpal bases of the four fingers are left out.
pub(super) const MANUS_NODES: [usize; KEYPOINTS] =
    [0, 1, 2, 3, 4, 6, 7, 8, 9, 11, 12, 13, 14, 16, 17, 18, 19, 21, 22, 23, 24];

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::path::Path;

    use super::*;
    use crate::files::normalize::tests::open_hand;

    /// The inverse of [`openpose_from_mano`].
    pub(crate) fn mano_from_openpose(points: &KeyPoints) -> KeyPoints {
        let mut out = [None; KEYPOINTS];
        for (i, &m) in MANO_INDEX.iter().enumerate() {
            out[m] = points[i];
        }
        out
    }

    #[test]
    fn the_two_orders_are_inverse_and_name_the_same_points() {
        let points = open_hand();
        assert_eq!(openpose_from_mano(&mano_from_openpose(&points)), points);
        // MANO's joint 13 is the thumb's base, vertex tip 16 the thumb's.
        let mano = mano_from_openpose(&points);
        assert_eq!((mano[13], mano[16], mano[1], mano[20]), (points[1], points[4], points[5], points[20]));
    }

    #[test]
    fn a_wrong_order_is_refused_and_the_right_one_is_put_right() {
        let points = open_hand();
        let path = Path::new("a.npy");
        let mut wrong = vec![RawFrame::new(mano_from_openpose(&points)); 3];
        let said = put_in_order(path, &mut wrong, KeyPointOrder::OpenPose).unwrap_err().to_string();
        assert!(said.contains("state the order \"mano\""), "{said}");
        put_in_order(path, &mut wrong, KeyPointOrder::Mano).unwrap();
        assert_eq!(wrong[0].points, points);
        let said = put_in_order(path, &mut wrong, KeyPointOrder::Mano).unwrap_err().to_string();
        assert!(said.contains("\"openpose\""), "{said}");
    }

    #[test]
    fn names_of_other_programs_are_known() {
        assert_eq!(key_point_named("Pinky Finger Tip"), Some(20));
        assert_eq!(key_point_named("INDEX_FINGER_MCP"), Some(5));
        assert_eq!(key_point_named("PINKY_DIP"), Some(19));
        assert_eq!(key_point_named("elbow"), None);
    }
}
