//! Force closure and its measures on grasps whose answer is known.

use drex_grasp::{ClosureOptions, Contact, force_closure, min_weight};
use nalgebra::{Point3, Rotation3, Vector3};
use proptest::prelude::*;

fn closure(contacts: &[Contact]) -> drex_grasp::ForceClosure {
    force_closure(contacts, &ClosureOptions::default()).unwrap()
}

/// `n` contacts around a circle in the x-y plane, pushing to its centre.
fn ring(n: usize, mu: f64) -> Vec<Contact> {
    (0..n)
        .map(|k| {
            let (s, c) = (std::f64::consts::TAU * k as f64 / n as f64).sin_cos();
            Contact::new(Point3::new(0.04 * c, 0.04 * s, 0.0), Vector3::new(-c, -s, 0.0), mu)
        })
        .collect()
}

#[test]
fn two_soft_fingers_close_and_two_points_do_not() {
    let pinch = ring(2, 0.5);
    let points = closure(&pinch);
    assert!(!points.closed && points.epsilon == 0.0 && points.min_weight == 0.0);
    let soft = force_closure(&pinch, &ClosureOptions::default().with_torsion_m(0.005)).unwrap();
    assert!(soft.closed);
    // Soft or not, fingers on the same side do not.
    let same = [pinch[0].clone(), pinch[0].clone()];
    assert!(!force_closure(&same, &ClosureOptions::default().with_torsion_m(0.005)).unwrap().closed);
    // Nothing but torsion turns about their common line: epsilon is the torsion over the length.
    assert!((soft.epsilon - 0.005 / 0.04).abs() < 1e-6, "{}", soft.epsilon);
}

#[test]
fn soft_fingers_whose_line_leaves_the_friction_cones_do_not_close() {
    for (slope, closes) in [(0.3, true), (0.7, false), (0.9, false)] {
        let lean = Vector3::new(0.0, 0.0, slope);
        let mut pinch = ring(2, 0.5);
        for c in &mut pinch {
            c.normal = (c.normal + lean).normalize();
        }
        let soft = force_closure(&pinch, &ClosureOptions::default().with_torsion_m(0.005)).unwrap();
        assert_eq!(soft.closed, closes, "{slope}");
    }
}

#[test]
fn the_pyramids_turn_with_their_tangent() {
    // No symmetry to hide behind.
    let mut contacts = ring(4, 0.5);
    contacts[0].point += Vector3::new(0.0, 0.01, 0.015);
    contacts[1].normal = Vector3::new(0.2, -1.0, 0.15).normalize();
    contacts[2].point += Vector3::new(0.0, -0.005, 0.01);
    let with = |contacts: &[Contact], t: Vector3<f64>| {
        min_weight(contacts, &ClosureOptions::default().with_tangent(t)).unwrap()
    };
    let tangent = Vector3::new(1.2, 2.3, 3.4);
    let turn = Rotation3::from_euler_angles(0.3, -0.9, 1.4);
    let turned: Vec<Contact> =
        contacts.iter().map(|c| Contact::new(turn * c.point, turn * c.normal, c.friction)).collect();
    // Turned together with the grasp nothing changes; a length, its sign and a quarter turn change nothing either.
    let value = with(&contacts, tangent);
    assert!(value > 0.01);
    assert!((with(&turned, turn * tangent) - value).abs() < 1e-7);
    assert!((with(&contacts, -2.0 * tangent) - value).abs() < 1e-7);
    // The pyramid alone on the spot does change it.
    assert!((with(&turned, tangent) - value).abs() > 1e-4);
    // With the contact's own tangent it is the value of the whole evaluation.
    let own = min_weight(&contacts, &ClosureOptions::default()).unwrap();
    assert!((own - closure(&contacts).min_weight).abs() < 1e-9);
    assert_eq!(min_weight(&[], &ClosureOptions::default()).unwrap(), f64::NEG_INFINITY);
    assert!(min_weight(&contacts, &ClosureOptions::default().with_tangent(Vector3::zeros())).is_err());
}

#[test]
fn three_points_with_friction_close_and_without_do_not() {
    let three = closure(&ring(3, 0.5));
    assert!(three.closed && three.epsilon > 0.0 && three.min_weight > 0.0);
    assert!(!closure(&ring(3, 0.0)).closed);
    assert!(!closure(&[]).closed);
}

#[test]
fn frictionless_points_close_a_box_from_seven_and_never_from_six() {
    // Reuleaux/Somov: seven frictionless contacts are the least for a body in space. Two per face of a box, offset to turn both ways.
    let box_of = |skip: Option<usize>| -> Vec<Contact> {
        let mut list = Vec::new();
        for axis in 0..3 {
            for side in [1.0, -1.0] {
                for turn in [1.0, -1.0] {
                    let normal = Vector3::ith(axis, -side);
                    let along = Vector3::ith((axis + 1) % 3, 0.01 * turn);
                    list.push(Contact::new(Point3::from(Vector3::ith(axis, 0.03 * side) + along), normal, 0.0));
                }
            }
        }
        if let Some(face) = skip {
            list.drain(2 * face..2 * face + 2);
        }
        list
    };
    assert!(closure(&box_of(None)).closed);
    assert!(!closure(&box_of(Some(5))).closed, "nothing pushes one way");
    assert!(!closure(&box_of(None)[..6]).closed);
    // A sphere can always spin: frictionless contacts never close it.
    let tetrahedron: Vec<Contact> = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]
        .map(|p| {
            let p = Vector3::from(p).normalize();
            Contact::new(Point3::from(p * 0.03), -p, 0.0)
        })
        .to_vec();
    assert!(!closure(&tetrahedron).closed);
    let rough: Vec<Contact> = tetrahedron
        .into_iter()
        .map(|mut c| {
            c.friction = 0.3;
            c
        })
        .collect();
    assert!(closure(&rough).closed);
}

#[test]
fn epsilon_of_a_frictionless_octahedron_is_known() {
    // Twelve frictionless contacts whose wrenches are (±e_i, ±r e_j): the hull is the product structure
    // {(f, t)}: |f|_1 <= 1 and, per axis, |t_j| <= |f_i| ... ; its support along a force axis is 1, along a torque axis r / L.
    let mut contacts = Vec::new();
    for axis in 0..3 {
        for side in [1.0, -1.0] {
            for turn in [1.0, -1.0] {
                let point = Vector3::ith(axis, 0.03 * side) + Vector3::ith((axis + 1) % 3, 0.01 * turn);
                contacts.push(Contact::new(Point3::from(point), Vector3::ith(axis, -side), 0.0));
            }
        }
    }
    // With torques divided by 1 cm every generator is (±e_a, ±e_b) with b determined by a: the hull is the set of points with
    // Σ_a max(|f_a|, |t_b(a)|) <= 1. Its polar is max_a (|u_a| + |v_a|) <= 1, whose furthest point from the origin has
    // length √3 (one entry of each pair), so the ball has radius 1/√3.
    let options = {
        let mut o = ClosureOptions::default();
        o.length_m = Some(0.01);
        o
    };
    let epsilon = force_closure(&contacts, &options).unwrap().epsilon;
    assert!((epsilon - 1.0 / 3f64.sqrt()).abs() < 2e-4, "{epsilon}");
}

#[test]
fn min_weight_of_a_symmetric_grasp_is_one_over_the_number_of_edges() {
    // Four contacts, four edges each, balanced by symmetry: all weights can be equal, 1/16.
    let four = closure(&ring(4, 0.5));
    assert!((four.min_weight - 1.0 / 16.0).abs() < 1e-6, "{}", four.min_weight);
}

#[test]
fn epsilon_of_a_ring_agrees_with_the_hull_of_its_pyramids() {
    // The hull of eight-sided pyramids, built facet by facet once, has radius 0.32689. The cones hold the pyramids and are
    // held by the pyramids widened by 1 / cos 22.5°.
    let e = closure(&ring(3, 0.6)).epsilon;
    assert!((0.32688..0.32689 / 22.5f64.to_radians().cos()).contains(&e), "{e}");
}

#[test]
fn bad_options_are_refused() {
    let mut options = ClosureOptions::default();
    options.min_weight_sides = 2;
    assert!(force_closure(&ring(3, 0.5), &options).is_err());
    options.min_weight_sides = 4;
    options.length_m = Some(0.0);
    assert!(force_closure(&ring(3, 0.5), &options).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// The ball must lie inside the hull: the cones reach at least epsilon along every direction, also along those that a
    /// descent from random starts finds; and turning the frame changes nothing.
    #[test]
    fn epsilon_is_the_least_reach_and_frame_free(
        jitter in prop::collection::vec(-1.0..1.0f64, 24),
        directions in prop::collection::vec(prop::array::uniform6(-1.0..1.0f64), 50),
        turn in prop::array::uniform3(-2.0..2.0f64),
    ) {
        let mut contacts = ring(4, 0.5);
        for (c, j) in contacts.iter_mut().zip(jitter.chunks(6)) {
            c.point += Vector3::new(j[0], j[1], j[2]) * 0.01;
            c.normal = Rotation3::new(Vector3::new(j[3], j[4], j[5]) * 0.3) * c.normal;
        }
        let here = closure(&contacts);
        let g = drex_grasp::grasp_map(&contacts, &Point3::origin());
        let reach = |u: &nalgebra::Vector6<f64>| contacts.iter().enumerate().map(|(i, c)| {
                let along = |k: usize| {
                    let w = g.column(3 * i + k);
                    (0..6).map(|r| w[r] * u[r] / if r < 3 { 1.0 } else { here.length_m }).sum::<f64>()
                };
                along(0) + c.friction * along(1).hypot(along(2))
            }).fold(f64::NEG_INFINITY, f64::max);
        for d in directions {
            let mut u = nalgebra::Vector6::from(d).normalize();
            // Random descent: keep a step if it lowers the reach.
            let mut r = reach(&u);
            for k in 0..400_usize {
                let step = nalgebra::Vector6::from_fn(|i, _| ((k * 7 + i * 3) as f64 * 1.618).sin() * 0.3 / (1.0 + 0.1 * k as f64));
                let v = (u + step).normalize();
                let rv = reach(&v);
                if rv < r {
                    (u, r) = (v, rv);
                }
            }
            prop_assert!(!here.closed || r >= here.epsilon * (1.0 - 1e-5), "{} {}", r, here.epsilon);
        }
        let r = Rotation3::new(Vector3::from(turn));
        for c in &mut contacts {
            c.point = r * c.point;
            c.normal = r * c.normal;
        }
        let there = closure(&contacts);
        prop_assert_eq!(here.closed, there.closed);
        prop_assert!((here.epsilon - there.epsilon).abs() <= 1e-4 * here.epsilon, "{} {}", here.epsilon, there.epsilon);
    }
}
