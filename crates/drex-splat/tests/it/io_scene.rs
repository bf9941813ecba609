//! Sets that move, and cameras round them.

use drex_core::{Pose, Trajectory};
use drex_splat::orbit::look_at;
use drex_splat::transform::{ShRotation, sh_basis};
use drex_splat::{Attachment, Gaussians, Kind, Label, Orbit, Scene};
use nalgebra::{Matrix3, Point3, Quaternion, Similarity3, UnitQuaternion, Vector3};
use proptest::prelude::*;

fn set(kind: Kind, sh_degree: usize, n: usize) -> Gaussians {
    let number = |i: usize, k: usize| ((i * 37 + k * 101 + 13) % 97) as f32 / 48.5 - 1.0;
    let mut g = Gaussians::new(kind, sh_degree);
    for i in 0..n {
        g.means.push([number(i, 0), number(i, 1), number(i, 2)]);
        g.rotations.push([number(i, 3) + 1.5, number(i, 4), number(i, 5), number(i, 6)]);
        g.log_scales.push([number(i, 7) - 3.0, number(i, 8) - 3.0, number(i, 9) - 3.0]);
        g.logit_opacities.push(3.0 * number(i, 10));
        g.sh.extend((0..3 * (sh_degree + 1).pow(2)).map(|k| number(i, 11 + k)));
        g.labels.push(Label((i % 2) as u8));
    }
    g
}

/// Colour of Gaussian `i` in the unit direction `d`, before it is clamped.
fn colour(g: &Gaussians, i: usize, d: &Vector3<f64>) -> Vector3<f64> {
    let sh = &g.sh[i * g.sh_stride()..(i + 1) * g.sh_stride()];
    sh.chunks_exact(3).zip(sh_basis(d)).fold(Vector3::repeat(0.5), |sum, (c, y)| {
        sum + Vector3::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2])) * y
    })
}

fn covariance(g: &Gaussians, i: usize) -> Matrix3<f64> {
    let [w, x, y, z] = g.rotations[i].map(f64::from);
    let r = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix();
    let m = r.matrix() * Matrix3::from_diagonal(&Vector3::from(g.log_scales[i].map(|s| f64::from(s).exp())));
    m * m.transpose()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Moving a set moves centres, shapes and colours together.
    #[test]
    fn a_moved_set_looks_the_same_from_the_moved_side(
        rotation in prop::array::uniform3(-3.0..3.0f64),
        translation in prop::array::uniform3(-5.0..5.0f64),
        scale in 0.01..20.0f64,
        direction in prop::array::uniform3(-1.0..1.0f64),
        degree in 0usize..=3,
    ) {
        let d = Vector3::from(direction);
        prop_assume!(d.norm() > 0.1);
        let d = d.normalize();
        let r = UnitQuaternion::from_scaled_axis(rotation.into());
        let a_from_b = Similarity3::from_parts(Vector3::from(translation).into(), r, scale);
        let g = set(Kind::Ellipsoid, degree, 5);
        let moved = g.transformed(&a_from_b).unwrap();
        for i in 0..g.len() {
            prop_assert!((colour(&moved, i, &(r * d)) - colour(&g, i, &d)).amax() < 1e-5);
            let p = a_from_b * Point3::from(g.means[i].map(f64::from));
            prop_assert!((Point3::from(moved.means[i].map(f64::from)) - p).norm() < 1e-5 * (1.0 + scale));
            let m = r.to_rotation_matrix().into_inner() * scale;
            let expected = m * covariance(&g, i) * m.transpose();
            prop_assert!((covariance(&moved, i) - expected).amax() < 1e-5 * expected.amax());
        }
        prop_assert_eq!(&moved.labels, &g.labels);
        let back = moved.transformed(&a_from_b.inverse()).unwrap();
        prop_assert!(back.sh.iter().zip(&g.sh).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}

#[test]
fn half_a_turn_about_x_only_flips_signs() {
    // y -> -y, z -> -z: a function is kept or flipped by how often y and z stand in it.
    let flips = [-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1].map(|s| s as f32);
    let mut sh: Vec<f32> = (0..48).map(|k| (k + 1) as f32).collect();
    ShRotation::new(&UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI)).apply(&mut sh);
    for k in 0..48 {
        let expected = (k + 1) as f32 * if k < 3 { 1.0 } else { flips[k / 3 - 1] };
        assert!((sh[k] - expected).abs() < 1e-4, "{k}: {} {expected}", sh[k]);
    }
}

#[test]
fn transforms_that_make_no_sense_are_refused() {
    let g = set(Kind::Surfel, 1, 3);
    let mut t = Similarity3::identity();
    t.isometry.translation.x = f64::NAN;
    assert!(g.transformed(&t).unwrap_err().to_string().contains("not finite"));
}

#[test]
fn sets_of_different_degree_join_and_labels_select() {
    let (a, b) = (set(Kind::Ellipsoid, 1, 4), set(Kind::Ellipsoid, 3, 3));
    let both = Gaussians::merged(&[&a, &b]).unwrap();
    both.check().unwrap();
    assert_eq!((both.len(), both.sh_degree), (7, 3));
    let d = Vector3::new(0.6, 0.0, 0.8);
    assert_eq!(colour(&both, 2, &d), colour(&a, 2, &d));
    assert_eq!(colour(&both, 5, &d), colour(&b, 1, &d));
    assert_eq!(both.with_sh_degree(1).sh[..a.sh.len()], a.sh);
    assert_eq!(both.labelled(Label::OBJECT).len(), 3);
    assert!(Gaussians::merged(&[&a, &set(Kind::Surfel, 1, 1)]).is_err() && Gaussians::merged(&[]).is_err());
}

#[test]
fn bound_gaussians_follow_their_body() {
    let quarter = UnitQuaternion::from_scaled_axis(Vector3::z() * std::f64::consts::FRAC_PI_2);
    let poses = [Pose::identity(), Pose::from_parts(Vector3::new(0.2, 0.0, 0.0).into(), quarter)];
    let track = Trajectory::from_samples(&[1.0, 2.0], &poses).unwrap();
    let (background, object) = (set(Kind::Ellipsoid, 0, 2), set(Kind::Ellipsoid, 2, 3));
    // The object was trained in centimetres.
    let bound = Attachment::new(&object, &Similarity3::from_scaling(0.01), track).unwrap();
    let scene = Scene { background: background.clone(), objects: vec![bound] };
    assert_eq!(scene.span_s(), Some((1.0, 2.0)));
    let (before, half, after) = (scene.posed(0.0).unwrap(), scene.posed(1.5).unwrap(), scene.posed(9.0).unwrap());
    for at in [&before, &half, &after] {
        at.check().unwrap();
        assert_eq!(at.means[..2], background.means[..]);
        assert!((at.log_scales[3][0] - object.log_scales[1][0] - 0.01f32.ln()).abs() < 1e-5);
    }
    let p = object.means[1].map(|v| 0.01 * v);
    let close = |a: [f32; 3], b: [f32; 3]| a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-6);
    assert!(close(before.means[3], p));
    assert!(close(after.means[3], [0.2 - p[1], p[0], p[2]]));
    let c = std::f32::consts::FRAC_1_SQRT_2;
    assert!(close(half.means[3], [0.1 + c * (p[0] - p[1]), c * (p[0] + p[1]), p[2]]));
    assert!(scene.posed(f64::NAN).is_err());
    assert!(Attachment::new(&object, &Similarity3::identity(), Trajectory::default()).is_err());
}

#[test]
fn cameras_on_an_orbit_see_its_centre_in_the_middle() {
    let orbit = Orbit {
        centre: Point3::new(0.3, -0.2, 1.0),
        up: Vector3::z(),
        radius: 2.0,
        elevation: 0.4,
        field_of_view: 1.0,
        width: 64,
        height: 48,
    };
    let cameras = orbit.cameras(4).unwrap();
    for camera in &cameras {
        let (pixel, depth) = camera.project(&orbit.centre).unwrap();
        assert!((pixel[0] - 32.0).abs() < 1e-9 && (pixel[1] - 24.0).abs() < 1e-9 && (depth - 2.0).abs() < 1e-12);
        assert!((camera.centre().z - 1.0 - 2.0 * 0.4f64.sin()).abs() < 1e-12);
        // What is higher is higher in the picture.
        assert!(camera.project(&(orbit.centre + Vector3::z() * 0.1)).unwrap().0[1] < 23.0);
        // The angle of view reaches from edge to edge.
        assert!((camera.ray([64.0, 24.0]).x - 0.5f64.tan()).abs() < 1e-12);
    }
    let step = (cameras[0].centre() - orbit.centre).xy().angle(&(cameras[1].centre() - orbit.centre).xy());
    assert!((step - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    for up in [Vector3::x(), Vector3::new(0.1, -1.0, 0.2)] {
        assert!(Orbit { up, ..orbit.clone() }.cameras(7).is_ok());
    }
    for bad in [
        Orbit { radius: 0.0, ..orbit.clone() },
        Orbit { elevation: 1.6, ..orbit.clone() },
        Orbit { field_of_view: f64::NAN, ..orbit.clone() },
        Orbit { up: Vector3::zeros(), ..orbit.clone() },
        Orbit { width: 0, ..orbit.clone() },
        Orbit { centre: Point3::new(f64::NAN, 0.0, 0.0), ..orbit.clone() },
    ] {
        assert!(bad.cameras(3).is_err(), "{bad:?}");
    }
    assert!(look_at(&Point3::origin(), &Point3::new(0.0, 0.0, 3.0), &Vector3::z()).is_err());
    assert!(look_at(&Point3::origin(), &Point3::origin(), &Vector3::z()).is_err());
}

#[test]
fn an_orbit_round_a_set_shows_it_whole() {
    let g = set(Kind::Surfel, 0, 90);
    let solid: Vec<usize> = (0..g.len()).filter(|&i| g.opacity(i) >= 0.5).collect();
    for (width, height) in [(64, 48), (48, 96)] {
        let orbit = Orbit::round(&g, Vector3::y(), 0.3, 0.8, width, height).unwrap();
        let mut inside = 0;
        for camera in orbit.cameras(5).unwrap() {
            inside += solid
                .iter()
                .filter(|&&i| {
                    camera.project(&Point3::from(g.means[i].map(f64::from))).is_some_and(|([u, v], _)| {
                        (0.0..width as f64).contains(&u) && (0.0..height as f64).contains(&v)
                    })
                })
                .count();
        }
        assert!(inside as f64 > 0.89 * 5.0 * solid.len() as f64, "{inside} of 5 x {}", solid.len());
    }
    assert!(Orbit::round(&set(Kind::Surfel, 0, 0), Vector3::y(), 0.3, 0.8, 64, 48).is_err());
    assert!(Orbit::round(&set(Kind::Surfel, 0, 1), Vector3::y(), 0.3, 0.8, 64, 48).is_ok());
}
