#![allow(clippy::unwrap_used)]

use nalgebra::Point3;

use super::*;

const FINGERS: [HumanFinger; 4] = [HumanFinger::Thumb, HumanFinger::Index, HumanFinger::Middle, HumanFinger::Ring];

/// Fingertips on a line, this far from the thumb's.
fn tips(index: f64, middle: f64, ring: f64) -> KeyPoints {
    let mut points = [None; drex_demo::KEYPOINTS];
    for (finger, x) in FINGERS.iter().zip([0.0, index, middle, ring]) {
        points[finger.tip()] = Some(Point3::new(x, 0.0, 0.1));
    }
    points
}

fn terms(projection: &mut Projection, points: &KeyPoints) -> Vec<Term> {
    let mut terms = Vec::new();
    dexpilot_terms(&mut terms, projection, &FINGERS, points, &Pose::identity(), 1.6);
    terms
}

#[test]
fn a_pinch_closes_at_3_cm_and_opens_at_5_cm() {
    let mut projection = Projection::default();
    let thumb_index = |projection: &mut Projection, x| terms(projection, &tips(x, 0.1, 0.2))[0].weight * 10.0;
    assert_eq!(thumb_index(&mut projection, 0.031), 1.0);
    assert_eq!(thumb_index(&mut projection, 0.029), 200.0);
    assert_eq!(thumb_index(&mut projection, 0.049), 200.0);
    assert_eq!(thumb_index(&mut projection, 0.051), 1.0);
    assert_eq!(thumb_index(&mut projection, 0.049), 1.0);
}

#[test]
fn two_fingers_that_pinch_are_kept_apart() {
    let mut projection = Projection::default();
    let all = terms(&mut projection, &tips(0.02, -0.009, 0.2));
    let pair = all.iter().find(|t| t.task == 1 && t.origin == Some(2)).unwrap();
    assert_eq!(pair.weight * 10.0, 400.0);
    assert!((pair.target.x - 3e-2).abs() < 2e-6);
    // The thumb's pair is drawn together; another keeps its scaled length.
    assert!((all[0].target.norm() - 1e-4).abs() < 1e-8);
    assert!((all[2].target.norm() - 1.6 * 0.2).abs() < 1e-12);
    // Wrist vectors come last and weigh as many as there are vectors.
    assert_eq!(all.len(), 10);
    assert!(all[6..].iter().all(|t| t.origin.is_none() && (t.weight - 1.0).abs() < 1e-12));
}

#[test]
fn a_missing_fingertip_takes_its_vectors_along() {
    let mut points = tips(0.02, 0.1, 0.2);
    points[HumanFinger::Middle.tip()] = None;
    let all = terms(&mut Projection::default(), &points);
    assert_eq!(all.len(), 6);
    assert!(all.iter().all(|t| t.task != 2 && t.origin != Some(2)));
}
