//! The 21 key points of a human hand, and the frame of the operator that they define.

use drex_core::Pose;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Number of key points.
pub const KEYPOINTS: usize = 21;

/// Key points in the order of MediaPipe and OpenPose: wrist, then from the palm to the tip thumb, index, middle, ring and
/// little finger, four each. `None` is a point that was not seen.
pub type KeyPoints = [Option<Point3<f64>>; KEYPOINTS];

/// Key point from which each key point's bone comes; the wrist's is the wrist itself.
pub(crate) const PARENT: [usize; KEYPOINTS] = [0, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 0, 13, 14, 15, 0, 17, 18, 19];

/// Side of a hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The right hand.
    Right,
    /// The left hand.
    Left,
}

impl Side {
    /// The name as files write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::Left => "left",
        }
    }

    /// The other hand.
    pub fn other(self) -> Self {
        match self {
            Self::Right => Self::Left,
            Self::Left => Self::Right,
        }
    }
}

impl std::fmt::Display for Side {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if *self == Self::Right { "right" } else { "left" })
    }
}

/// A human finger.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum HumanFinger {
    /// Key points 1 to 4.
    Thumb,
    /// Key points 5 to 8.
    Index,
    /// Key points 9 to 12.
    Middle,
    /// Key points 13 to 16.
    Ring,
    /// Key points 17 to 20.
    Little,
}

impl HumanFinger {
    /// All five, thumb first.
    pub const ALL: [Self; 5] = [Self::Thumb, Self::Index, Self::Middle, Self::Ring, Self::Little];

    /// Index of the fingertip's key point.
    pub fn tip(self) -> usize {
        4 * (self as usize) + 4
    }

    /// Index of the key point two joints before the tip: the thumb's knuckle (MCP), the middle joint (PIP) of the others.
    pub fn middle(self) -> usize {
        4 * (self as usize) + 2
    }

    /// Index of the key point where the finger leaves the palm.
    pub fn base(self) -> usize {
        4 * (self as usize) + 1
    }

    /// The name as files write it.
    pub fn name(self) -> &'static str {
        ["thumb", "index", "middle", "ring", "little"][self as usize]
    }
}

/// Why key points define no operator frame.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OperatorFrameError {
    /// One of the three points is missing.
    #[error("key point {0} (of wrist 0, index knuckle 5 and middle knuckle 9) is missing")]
    Missing(usize),
    /// The three points lie on a line.
    #[error("wrist, index knuckle and middle knuckle lie on a line")]
    Collinear,
}

/// `source_from_operator`: the operator frame of a hand. Its origin is the wrist, x points out of the palm, z from the wrist to
/// the fingertips, y from the little finger to the thumb (right hand) or from the thumb to the little finger (left hand).
///
/// From wrist, index knuckle and middle knuckle, as in dex-retargeting 0.5.0 (`single_hand_detector.py`): in the plane of the
/// three, z points from the middle knuckle to the wrist, turned around; the sense of the normal follows from the index knuckle.
///
/// # Errors
/// If one of the three points is missing or they lie on a line.
pub fn operator_frame(points: &KeyPoints, side: Side) -> Result<Pose, OperatorFrameError> {
    let (wrist, axes) = operator_axes(points, side)?;
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Ok(Isometry3::from_parts(Translation3::from(wrist.coords), rotation))
}

/// The points in their operator frame ([`operator_frame`]): the wrist is the origin. The mirror image of a hand ([`mirrored`]) as
/// the other side gives the same numbers but for the sign of y, to the last bit.
///
/// # Errors
/// As [`operator_frame`].
pub fn canonical(points: &KeyPoints, side: Side) -> Result<KeyPoints, OperatorFrameError> {
    let (wrist, axes) = operator_axes(points, side)?;
    Ok(points.map(|p| p.map(|p| Point3::from(axes.tr_mul(&(p - wrist))))))
}

/// Wrist and axes (columns) of the operator frame. Nothing here depends on the handedness of the source frame, so that mirrored
/// points are rounded alike.
fn operator_axes(points: &KeyPoints, side: Side) -> Result<(Point3<f64>, Matrix3<f64>), OperatorFrameError> {
    let at = |i: usize| points[i].filter(|p| p.iter().all(|v| v.is_finite())).ok_or(OperatorFrameError::Missing(i));
    let (wrist, index, middle) = (at(0)?, at(5)?, at(9)?);
    let (along, across) = (middle - wrist, index - middle);
    let tips = along.try_normalize(f64::MIN_POSITIVE).ok_or(OperatorFrameError::Collinear)?;
    // The index knuckle lies on the thumb's side of the middle finger.
    let aside = across - tips * tips.dot(&across);
    // Single-precision key points of a hand on a line are this far off it.
    if !(aside.norm() > COLLINEAR * along.norm()) {
        return Err(OperatorFrameError::Collinear);
    }
    let thumb_side = aside.normalize();
    let y = match side {
        Side::Right => thumb_side,
        Side::Left => -thumb_side,
    };
    Ok((wrist, Matrix3::from_columns(&[y.cross(&tips), y, tips])))
}

/// A triangle of wrist and knuckles this thin is a line.
const COLLINEAR: f64 = 1e-3;

/// Length of a human hand, metres: wrist, knuckle, joints and tip of the middle finger along the bones, so that it does not
/// depend on how far the finger bends. Of the index or ring finger where the middle finger is missing.
pub fn hand_length_m(points: &KeyPoints) -> Option<f64> {
    [HumanFinger::Middle, HumanFinger::Index, HumanFinger::Ring].into_iter().find_map(|finger| {
        let mut length = 0.0;
        let mut from = points[0]?;
        for i in finger.base()..=finger.tip() {
            let to = points[i]?;
            length += (to - from).norm();
            from = to;
        }
        (length.is_finite() && length > 0.0).then_some(length)
    })
}

/// The points in another frame.
pub fn transformed(points: &KeyPoints, to_from: &Pose) -> KeyPoints {
    points.map(|p| p.map(|p| to_from * p))
}

/// The mirror image (x turned around in the source frame): a left hand becomes a right one.
pub fn mirrored(points: &KeyPoints) -> KeyPoints {
    points.map(|p| p.map(|p| Point3::from(Vector3::new(-p.x, p.y, p.z))))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// A flat hand: fingers along +y, the index finger's knuckle at +x.
    fn flat() -> KeyPoints {
        let mut points = [None; KEYPOINTS];
        points[0] = Some(Point3::origin());
        points[5] = Some(Point3::new(0.02, 0.09, 0.0));
        points[9] = Some(Point3::new(0.0, 0.09, 0.0));
        points
    }

    #[test]
    fn the_axes_are_palm_thumb_and_tips() {
        // Fingers along +y, thumb towards +x: with the palm up (+z) that is a right hand.
        let frame = operator_frame(&flat(), Side::Right).unwrap();
        assert!((frame * Vector3::z() - Vector3::y()).norm() < 1e-12);
        assert!((frame * Vector3::y() - Vector3::x()).norm() < 1e-12);
        assert!((frame * Vector3::x() - Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn a_left_hand_is_the_mirror_image() {
        let right = operator_frame(&flat(), Side::Right).unwrap();
        let left = operator_frame(&mirrored(&flat()), Side::Left).unwrap();
        let flip = |v: Vector3<f64>| Vector3::new(-v.x, v.y, v.z);
        assert!((left * Vector3::x() - flip(right * Vector3::x())).norm() < 1e-12);
        assert!((left * Vector3::z() - flip(right * Vector3::z())).norm() < 1e-12);
        assert!((left * Vector3::y() + flip(right * Vector3::y())).norm() < 1e-12);
    }

    /// Neither the place in the hand nor the length depends on where the camera is.
    #[test]
    fn moved_points_have_the_same_place_in_the_hand() {
        for side in [Side::Right, Side::Left] {
            let frame = &crate::HandSkeleton { side, size: 0.9 }.moving(20).frames[19];
            let camera = Isometry3::new(Vector3::new(0.3, -2.0, 1.0), Vector3::new(2.0, -0.3, 0.7));
            let moved = transformed(&frame.points, &camera);
            let own = |points: &KeyPoints, side| transformed(points, &operator_frame(points, side).unwrap().inverse());
            let (a, b) = (own(&frame.points, side), own(&moved, side));
            assert!(a.iter().zip(&b).all(|(a, b)| (a.unwrap() - b.unwrap()).norm() < 1e-14));
            assert!((hand_length_m(&moved).unwrap() - hand_length_m(&frame.points).unwrap()).abs() < 1e-14);
            // A hand that is taken for the other one faces the other way.
            let wrong = own(&frame.points, side.other());
            assert!(a.iter().zip(&wrong).all(|(a, b)| (a.unwrap().x + b.unwrap().x).abs() < 1e-14));
        }
    }

    #[test]
    fn points_that_are_not_there() {
        let mut points = crate::HandSkeleton::new(Side::Right).moving(1).frames[0].points;
        points[11] = None;
        // Of the index finger: 95.1 mm from the wrist to its knuckle, and its bones.
        assert!((hand_length_m(&points).unwrap() - (0.024_f64.hypot(0.092) + 0.086)).abs() < 1e-12);
        for finger in [HumanFinger::Index, HumanFinger::Ring] {
            points[finger.tip()] = Some(Point3::new(f64::NAN, 0.0, 0.0));
        }
        assert_eq!(hand_length_m(&points), None);
        points[0] = Some(Point3::new(f64::INFINITY, 0.0, 0.0));
        assert_eq!(operator_frame(&points, Side::Right), Err(OperatorFrameError::Missing(0)));
        points[0] = points[9];
        assert_eq!(operator_frame(&points, Side::Right), Err(OperatorFrameError::Collinear));
    }

    #[test]
    fn canonical_points_are_mirrored_to_the_last_bit() {
        let sequence = crate::HandSkeleton::new(Side::Right).moving(30);
        for frame in &sequence.frames {
            let right = canonical(&frame.points, Side::Right).unwrap();
            let left = canonical(&mirrored(&frame.points), Side::Left).unwrap();
            let to = operator_frame(&frame.points, Side::Right).unwrap().inverse();
            for ((p, q), source) in right.iter().zip(&left).zip(&frame.points) {
                let (p, q) = (p.unwrap(), q.unwrap());
                assert_eq!(Point3::new(p.x, -p.y, p.z), q);
                assert!((to * source.unwrap() - p).norm() < 1e-14);
            }
        }
    }

    /// Neither the frame nor the length depends on where the camera is.

    #[test]
    fn a_line_is_no_hand() {
        let mut points = flat();
        points[5] = Some(Point3::new(0.0, 0.05, 0.0));
        assert_eq!(operator_frame(&points, Side::Right), Err(OperatorFrameError::Collinear));
        points[5] = None;
        assert_eq!(operator_frame(&points, Side::Right), Err(OperatorFrameError::Missing(5)));
    }
}
