use super::*;
use crate::math::exp;
use crate::{Dual, Scalar, parameter, tangents};

/// A pose moved by a world translation and then turned about its origin.
fn moved<T: Scalar>(pose: &Pose, twist: &[T; 6]) -> Pose<T> {
    let pose: Pose<T> = pose.cast();
    let [x, y, z, a, b, c] = *twist;
    let p = pose.translation.vector + Vector3::new(x, y, z);
    Pose::from_parts(Translation3::from(p), exp(&Vector3::new(a, b, c)) * pose.rotation)
}

fn numbers(p: &Place<f64>) -> Vec<f64> {
    p.point.iter().chain(p.normal.iter()).copied().chain([p.depth]).collect()
}

/// Compares the derivatives by the twist of one body with central differences.
pub(in crate::collide) fn check(
    touch: &Touch,
    pa: &Pose,
    pb: &Pose,
    tolerance: f64,
) -> std::result::Result<(), TestCaseError> {
    let dual: [Dual<6>; 6] = std::array::from_fn(|k| parameter(0.0, k));
    for first in [true, false] {
        let place = if first {
            touch.at_poses(&moved(pa, &dual), &pb.cast())
        } else {
            touch.at_poses(&pa.cast(), &moved(pb, &dual))
        };
        let all: Vec<Dual<6>> = place.point.iter().chain(place.normal.iter()).copied().chain([place.depth]).collect();
        for k in 0..6 {
            let h = 1e-6;
            let shifted = |h: f64| {
                let mut twist = [0.0; 6];
                twist[k] = h;
                let p = moved(if first { pa } else { pb }, &twist);
                numbers(&if first { touch.at_poses(&p, pb) } else { touch.at_poses(pa, &p) })
            };
            let (ahead, behind) = (shifted(h), shifted(-h));
            for (i, x) in all.iter().enumerate() {
                let difference = (ahead[i] - behind[i]) / (2.0 * h);
                let exact = tangents(x)[k];
                prop_assert!(
                    (exact - difference).abs() < tolerance * (1.0 + difference.abs()),
                    "number {i} by {k} of body {first}: {exact} against {difference}, {:?}",
                    touch.feature
                );
            }
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(80))]

    #[test]
    fn duals_agree_with_finite_differences(
        a in any_solid(), b in any_solid(), pa in any_pose(0.1), turn in any_pose(0.0), u in any_direction(),
    ) {
        let pb = brought_together(&a, &pa, &b, &turn, &u, 1e-3);
        let found = touches(&a, &pa, &b, &pb, 1e-4);
        prop_assert!(!found.is_empty());
        for touch in &found {
            check(touch, &pa, &pb, 1e-5)?;
        }
        let plane = turned(pa.translation.vector, V::new(u.x, u.y, 0.3));
        let inside = plane * at(0.01, -0.02, 0.01) * pa.rotation;
        for touch in touches(&b, &inside, &Shape::Plane, &plane, 0.0) {
            check(&touch, &inside, &plane, 1e-5)?;
        }
    }

    #[test]
    fn order_and_common_motion_do_not_matter(
        a in any_solid(), b in any_solid(), pa in any_pose(0.1), turn in any_pose(0.0), u in any_direction(),
        common in any_pose(1.0),
    ) {
        let mut pb = brought_together(&a, &pa, &b, &turn, &u, 1e-4);
        // Away from where the prism of a cylinder takes over from its side.
        pb.translation.vector -= u * 3e-4;
        let found = touches(&a, &pa, &b, &pb, 1e-5);
        let place = |t: &Touch| t.at_poses(&pa, &pb);
        let swapped = touches(&b, &pb, &a, &pa, 1e-5);
        prop_assert_eq!(found.len(), swapped.len());
        for t in &found {
            let p = place(t);
            let twin = swapped.iter().map(|s| s.at_poses(&pb, &pa)).find(|q| (q.point - p.point).norm() < 1e-9);
            prop_assert!(twin.is_some_and(|q| (q.normal + p.normal).norm() < 1e-9 && (q.depth - p.depth).abs() < 1e-12));
        }
        let (ca, cb) = (common * pa, common * pb);
        let moved = touches(&a, &ca, &b, &cb, 1e-5);
        prop_assert_eq!(found.iter().map(|t| t.site).collect::<Vec<_>>(), moved.iter().map(|t| t.site).collect::<Vec<_>>());
        for (t, m) in found.iter().zip(&moved) {
            let (p, q) = (place(t), m.at_poses(&ca, &cb));
            prop_assert!((common * Point3::from(p.point) - Point3::from(q.point)).norm() < 1e-7);
            prop_assert!((common * p.normal - q.normal).norm() < 1e-7 && (q.depth - p.depth).abs() < 1e-12);
        }
    }
}
