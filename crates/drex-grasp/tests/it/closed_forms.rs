//! Every public number of the crate against a formula on paper, also where a sign, a side or a limit could be the other one.

use crate::support;

use crate::support::{G, down};
use drex_core::TablePlane;
use drex_grasp::{
    ClosureOptions, Contact, GripForceError, GripForcePolicy, GripForceProblem, Rolling, RollingError, TorqueLimits,
    characteristic_length_m, distribute, force_closure, grasp_map, maximum_grip_force, min_weight, minimum_grip_force,
    paper_force, required_grip_force, rolling_path, shake_loads, smallest_forces,
};
use nalgebra::{DVector, Isometry3, Matrix3xX, Point3, Rotation3, Unit, UnitQuaternion, Vector3, Vector6};

/// The thumb (finger 1) at −x against the palm at +x, 6 cm apart, friction 0.5.
fn against_the_palm() -> Vec<Contact> {
    vec![
        Contact::new(Point3::new(-0.03, 0.0, 0.0), Vector3::x(), 0.5).by_finger(1),
        Contact::new(Point3::new(0.03, 0.0, 0.0), -Vector3::x(), 0.5),
    ]
}

fn carrying(mass_kg: f64) -> GripForceProblem {
    GripForceProblem::new(against_the_palm(), mass_kg, Point3::origin(), down())
}

/// Joint 0 moves the thumb along its normal by 5 cm per radian, joint 1 against it by 2 cm per radian.
fn two_joints(limits_nm: [(f64, f64); 2], own_nm: [f64; 2]) -> TorqueLimits {
    let thumb = Matrix3xX::from_columns(&[Vector3::x() * 0.05, Vector3::x() * -0.02]);
    TorqueLimits {
        jacobians: vec![thumb, Matrix3xX::zeros(2)],
        limits_nm: limits_nm.to_vec(),
        gravity_nm: DVector::from_column_slice(&own_nm),
    }
}

#[test]
fn the_table_is_where_the_lowest_point_is_and_gravity_points_into_it() {
    let up = Vector3::new(0.0, 3.0, 4.0);
    let points = [Point3::new(5.0, 0.1, 0.2), Point3::new(-7.0, -0.1, 0.0), Point3::new(0.0, 0.3, -0.05)];
    let table = TablePlane::under(&points, up).unwrap();
    assert!((table.height_m - (-0.1 * 0.6)).abs() < 1e-15);
    assert!((table.gravity() - Vector3::new(0.0, -0.6 * G, -0.8 * G)).norm() < 1e-12);
    assert!(TablePlane::under(&points, Vector3::zeros()).is_none());
    assert!(TablePlane::under(&[], up).is_none());
}

#[test]
fn contact_axes_are_a_right_handed_frame_that_begins_with_the_normal() {
    for normal in [Vector3::x(), -Vector3::y(), Vector3::new(0.1, -0.2, 3.0), Vector3::new(-1.0, 1.0, 1.0)] {
        let contact = Contact::new(Point3::origin(), normal, 0.5);
        let axes = contact.axes();
        assert!((contact.normal - normal.normalize()).norm() < 1e-15);
        assert!((axes.column(0) - contact.normal).norm() < 1e-15);
        assert!((axes.transpose() * axes - nalgebra::Matrix3::identity()).norm() < 1e-14);
        assert!((axes.determinant() - 1.0).abs() < 1e-14);
    }
}

#[test]
fn the_grasp_map_is_the_power_of_contact_forces_under_any_twist() {
    let origin = Point3::new(0.02, -0.01, 0.005);
    let contacts: Vec<Contact> = [[0.03, 0.01, -0.02], [-0.04, 0.0, 0.01], [0.0, 0.05, 0.02]]
        .map(|p| Contact::new(Point3::from(Vector3::from(p)), Vector3::new(p[1], 0.3 - p[0], p[2]), 0.5))
        .to_vec();
    let g = grasp_map(&contacts, &origin);
    assert_eq!((g.nrows(), g.ncols()), (6, 9));
    let force = nalgebra::DVector::from_fn(9, |i, _| 0.7 + (i as f64).sin());
    let wrench = &g * &force;
    // The object moves a little along and about each axis through the origin: work is force times way.
    let h = 1e-6;
    for axis in 0..6 {
        let unit = Vector3::ith(axis % 3, h);
        let way = |p: &Point3<f64>| {
            if axis < 3 { unit } else { Rotation3::new(unit) * (p - origin) - (p - origin) }
        };
        let work: f64 = contacts
            .iter()
            .enumerate()
            .map(|(i, c)| (c.axes() * force.fixed_rows::<3>(3 * i)).dot(&way(&c.point)))
            .sum();
        assert!((work / h - wrench[axis]).abs() < 1e-6, "axis {axis}: {} {}", work / h, wrench[axis]);
    }
    assert!((characteristic_length_m(&contacts, &origin) - (contacts[2].point - origin).norm()).abs() < 1e-15);
    // Not less than a millimetre.
    assert_eq!(characteristic_length_m(&[Contact::new(origin, Vector3::z(), 0.5)], &origin), 1e-3);
    assert_eq!(characteristic_length_m(&[], &origin), 1e-3);
}

#[test]
fn shakes_have_their_order_and_their_axes() {
    let loads = shake_loads(2.0, 3.0, &down());
    // Rest, up, down; then right-angled to gravity and to each other, there and back.
    let force = |i: usize| Vector3::from(loads[i].fixed_rows::<3>(0));
    assert!((force(0) - Vector3::z() * -2.0 * G).norm() < 1e-12);
    assert!((force(1) - Vector3::z() * -2.0 * (G + 3.0)).norm() < 1e-12);
    assert!((force(2) - Vector3::z() * -2.0 * (G - 3.0)).norm() < 1e-12);
    let side = |i: usize| force(i) - force(0);
    for (a, b) in [(3, 4), (5, 6)] {
        assert!((side(a) + side(b)).norm() < 1e-12 && (side(a).norm() - 6.0).abs() < 1e-12);
        assert!(side(a).z.abs() < 1e-12);
    }
    assert!(side(3).dot(&side(5)).abs() < 1e-12);
    assert!(loads.iter().all(|l| l.fixed_rows::<3>(3).norm() == 0.0));
}

#[test]
fn fingers_and_palm_are_added_up_apart() {
    let s = minimum_grip_force(&carrying(0.2)).unwrap();
    let each = 0.2 * G / (2.0 * 0.5);
    assert_eq!(s.per_finger_n.len(), 2);
    assert!(s.per_finger_n[0] == 0.0 && (s.per_finger_n[1] - each).abs() < 1e-6 && (s.palm_n - each).abs() < 1e-6);
    assert!(s.joint_torques_nm.is_empty() && s.torque_margin == 1.0 && s.binding_load.is_none());
    // The same, shared; two contacts of one finger are one sum.
    let mut contacts = against_the_palm();
    contacts.push(Contact::new(Point3::new(-0.03, 0.01, 0.0), Vector3::x(), 0.5).by_finger(1));
    contacts[0].point.y = -0.01;
    let d = distribute(&GripForceProblem::new(contacts, 0.2, Point3::origin(), down()), 6.0).unwrap();
    assert!((d.per_finger_n[1] - 3.0).abs() < 1e-5 && (d.palm_n - 3.0).abs() < 1e-5, "{d:?}");
    assert!((d.normal_n[0] - 1.5).abs() < 1e-3 && (d.normal_n[2] - 1.5).abs() < 1e-3, "{d:?}");
}

#[test]
fn the_margin_on_the_weight_and_a_further_load_add_up() {
    let plain = minimum_grip_force(&carrying(0.2)).unwrap().total_n;
    let margin = minimum_grip_force(&carrying(0.2).with_gamma(1.5)).unwrap().total_n;
    assert!((margin - 1.5 * plain).abs() < 1e-6);
    // 1 N more downwards, not scaled by the margin.
    let mut more = carrying(0.2).with_gamma(1.5);
    more.extra_wrench = Vector6::new(0.0, 0.0, -1.0, 0.0, 0.0, 0.0);
    let total = minimum_grip_force(&more).unwrap().total_n;
    assert!((total - (1.5 * 0.2 * G + 1.0) / 0.5).abs() < 1e-6, "{total}");
    // Another load in place of both.
    let other = minimum_grip_force(&more.under(&Vector6::new(0.0, 0.8, 0.0, 0.0, 0.0, 0.0))).unwrap().total_n;
    assert!((other - 0.8 / 0.5).abs() < 1e-6, "{other}");
}

#[test]
fn each_joint_has_a_limit_either_way_and_carries_its_own_weight() {
    // Each side carries 0.981 N by friction: 1.962 N of normal force. Joint 0 gets 5 cm of it, joint 1 −2 cm.
    let force = 0.2 * G / (2.0 * 0.5);
    let wide = [(-1.0, 1.0); 2];
    let s = minimum_grip_force(&carrying(0.2).with_torques(two_joints(wide, [0.01, 0.003]))).unwrap();
    assert!((s.joint_torques_nm[0] - (0.05 * force + 0.01)).abs() < 1e-7);
    assert!((s.joint_torques_nm[1] - (-0.02 * force + 0.003)).abs() < 1e-7);
    // The margin is that of the joint nearest to its limit, on the side to which it turns.
    let limits = [(-0.2, 0.5), (-0.05, 9.0)];
    let s = minimum_grip_force(&carrying(0.2).with_torques(two_joints(limits, [0.0, 0.0]))).unwrap();
    assert!((s.torque_margin - (1.0 - 0.02 * force / 0.05)).abs() < 1e-6, "{}", s.torque_margin);
    // A joint beyond its lower limit is named with that; of two the one that is further beyond, in units of its limit.
    let refused = |limits, own| minimum_grip_force(&carrying(0.2).with_torques(two_joints(limits, own))).unwrap_err();
    let error = refused([(-1.0, 1.0), (-0.03, 1.0)], [0.0, 0.0]);
    assert!(
        matches!(error, GripForceError::Torque { joint: 1, needed_nm, limit_nm: -0.03 } if (needed_nm + 0.02 * force).abs() < 1e-6),
        "{error:?}"
    );
    let error = refused([(-1.0, 0.09), (-0.02, 1.0)], [0.0, 0.0]);
    assert!(matches!(error, GripForceError::Torque { joint: 1, .. }), "{error:?}");
    let error = refused([(-1.0, 0.04), (-0.03, 1.0)], [0.0, 0.0]);
    assert!(matches!(error, GripForceError::Torque { joint: 0, limit_nm: 0.04, .. }), "{error:?}");
    // The hand's own weight counts, and a joint that cannot hold it has no grip force even for nothing.
    let error = refused([(-1.0, 0.1), (-1.0, 1.0)], [0.01, 0.0]);
    assert!(matches!(error, GripForceError::Torque { joint: 0, .. }), "{error:?}");
    let idle = |own| minimum_grip_force(&carrying(0.0).with_torques(two_joints([(-0.1, 0.1); 2], [own, 0.0])));
    assert_eq!(idle(0.09).unwrap().total_n, 0.0);
    assert!(matches!(idle(0.11), Err(GripForceError::Torque { joint: 0, .. })));
    assert!(matches!(idle(-0.11), Err(GripForceError::Torque { joint: 0, limit_nm: -0.1, .. })));
}

#[test]
fn the_largest_grip_force_is_where_the_first_joint_or_the_skin_gives_out() {
    // Joint 0: 0.05 F + 0.01 <= 0.3; joint 1: −0.02 F + 0.003 >= −0.1. The first ends at 5.8 N, the second at 5.15 N.
    let problem = carrying(0.2).with_torques(two_joints([(-1.0, 0.3), (-0.1, 1.0)], [0.01, 0.003]));
    assert!((maximum_grip_force(&problem).unwrap() - 2.0 * 0.103 / 0.02).abs() < 1e-5);
    let problem = carrying(0.2).with_torques(two_joints([(-1.0, 0.2), (-0.1, 1.0)], [0.01, 0.003]));
    assert!((maximum_grip_force(&problem).unwrap() - 2.0 * 0.19 / 0.05).abs() < 1e-5);
    assert!((maximum_grip_force(&problem.with_max_normal_n(2.5)).unwrap() - 5.0).abs() < 1e-5);
}

#[test]
fn a_limit_on_the_force_names_the_contact_that_needs_most() {
    // Three contacts: the one alone on its side bears as much as the other two together, 2 N per unit of the friction they share.
    let contacts = support::thumb_against(2, 0.5);
    let problem = GripForceProblem::new(contacts, 0.2, Point3::origin(), down());
    let mut limited = problem.clone().with_max_normal_n(1.5);
    limited.min_normal_n = 0.1;
    let error = smallest_forces(&limited).unwrap_err();
    let alone = 0.2 * G / (2.0 * 0.5);
    assert!(
        matches!(error, GripForceError::NormalForce { contact: 0, needed_n, min_n: 0.1, max_n: 1.5 } if (needed_n - alone).abs() < 1e-5),
        "{error:?}"
    );
    // Only a floor: the other side has to bear both.
    let floor = minimum_grip_force(&problem.with_min_normal_n(3.0)).unwrap();
    assert!((floor.total_n - 12.0).abs() < 1e-5 && (floor.normal_n[0] - 6.0).abs() < 1e-5, "{floor:?}");
}

#[test]
fn soft_fingers_share_a_twist_and_its_slack() {
    // A torque of 6 mN m about the pinch, 4 mm of torsion: 2 · 0.004 f >= 0.006.
    let mut problem = carrying(0.0).with_torsion_m(0.004);
    problem.extra_wrench = Vector6::new(0.0, 0.0, 0.0, 0.006, 0.0, 0.0);
    let s = minimum_grip_force(&problem).unwrap();
    assert!((s.total_n - 0.006 / 0.004).abs() < 1e-6, "{}", s.total_n);
    // Slack counts against the torsion as against friction.
    let d = distribute(&problem, 3.0).unwrap();
    assert!((d.slack_n - (1.5 - 0.75)).abs() < 3e-3, "{}", d.slack_n);
    // Torsional friction falls with the other frictions.
    let margin = minimum_grip_force(&problem.with_max_normal_n(1.0)).unwrap().friction_margin;
    assert!((margin - 0.25).abs() < 2e-3, "{margin}");
}

#[test]
fn contacts_without_friction_have_all_of_their_force_as_slack() {
    // Two that press against each other carry nothing.
    let mut contacts: Vec<Contact> = [1.0, -1.0]
        .map(|side| Contact::new(Point3::new(0.03 * side, 0.0, 0.0), -Vector3::x() * side, 0.0).by_finger(0))
        .to_vec();
    contacts[1].finger = Some(1);
    let d = distribute(&GripForceProblem::new(contacts, 0.0, Point3::origin(), down()), 4.0).unwrap();
    assert!((d.slack_n - 2.0).abs() < 2e-3, "{}", d.slack_n);
    assert!(d.forces.iter().all(|f| f.y.abs() < 1e-6 && f.z.abs() < 1e-6));
}

#[test]
fn a_load_that_limits_forbid_says_how_large_it_is() {
    let loads = [Vector6::new(0.0, 0.0, -1.0, 0.0, 0.0, 0.0), Vector6::new(0.0, 3.0, -4.0, 0.0, 0.0, 0.0)];
    // 1 N needs 1 N of each side, 5 N need 5 N.
    let s = required_grip_force(&carrying(9.0).with_max_normal_n(5.1), &loads).unwrap();
    assert!((s.total_n - 10.0).abs() < 1e-5 && s.binding_load == Some(1), "{s:?}");
    assert!((s.forces[0] + s.forces[1] + Vector3::new(0.0, 3.0, -4.0)).norm() < 1e-6);
    let error = required_grip_force(&carrying(9.0).with_max_normal_n(4.9), &loads).unwrap_err();
    assert!(
        matches!(error, GripForceError::Load { load: 1, force_n, torque_nm: 0.0, .. } if (force_n - 5.0).abs() < 1e-12),
        "{error:?}"
    );
    // A push of 4 N along the pinch leaves one side 4 N more than the other: with 5 N at most they are 6 N in all, which is too little for a
    // load that needs 8.
    let along = Vector6::new(4.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    let heavy = Vector6::new(0.0, 0.0, -4.0, 0.0, 0.0, 0.0);
    let error = required_grip_force(&carrying(0.0).with_max_normal_n(5.0), &[along, heavy]).unwrap_err();
    let GripForceError::Load { load: 0, force_n, reason, .. } = &error else { panic!("{error:?}") };
    assert!((force_n - 4.0).abs() < 1e-12);
    assert!(
        matches!(**reason, GripForceError::Total { total_n, smallest_n, largest_n }
            if (total_n - 8.0).abs() < 1e-5 && (smallest_n - 4.0).abs() < 1e-5 && (largest_n - 6.0).abs() < 1e-5),
        "{error:?}"
    );
}

#[test]
fn the_law_counts_the_margin_on_the_weight_and_a_further_load_in_every_shake() {
    let law = GripForcePolicy::default();
    let lowest = 0.9 * 0.5;
    let mut problem = carrying(0.3).with_gamma(1.2);
    problem.extra_wrench = Vector6::new(0.0, 0.0, -0.7, 0.0, 0.0, 0.0);
    let command = law.command(&problem).unwrap();
    assert!((command.required_n - (1.2 * 0.3 * 1.5 * G + 0.7) / lowest).abs() < 1e-5, "{}", command.required_n);
    assert!((command.distribution.normal_n.iter().sum::<f64>() - command.total_n).abs() < 1e-4);
    assert!((law.friction_share() - 0.72).abs() < 1e-15);
    // Without weight and shake there is nothing to be survived: the floor is all.
    let idle = law.with_shake_m_s2(0.0).with_floor_n(2.5).command(&carrying(0.0)).unwrap();
    assert!((idle.total_n - 2.5).abs() < 1e-9 && idle.margin.is_infinite() && idle.required_n == 0.0);
    // The tighter of two damage limits holds.
    for (own, law_n) in [(2.0, 9.0), (9.0, 2.0)] {
        let refused = law.with_max_contact_n(law_n).command(&carrying(0.3).with_max_normal_n(own)).unwrap_err();
        assert!(
            matches!(&refused, GripForceError::Load { load: 1, reason, .. }
                if matches!(**reason, GripForceError::NormalForce { max_n: 2.0, .. })),
            "{refused:?}"
        );
    }
    // The paper's number: m g n / 5 N.
    assert!((paper_force(0.1, 9.0, 3) - 0.54).abs() < 1e-15 && paper_force(1.0, 9.0, 1) == 1.0);
    for good in [law.with_margin(1.0), law.with_friction_uncertainty(0.0), law.with_floor_n(0.0)] {
        good.command(&carrying(0.2)).unwrap();
    }
    for bad in [law.with_shake_m_s2(-1.0), law.with_shake_m_s2(f64::INFINITY), law.with_floor_n(-0.1)] {
        assert!(matches!(bad.command(&carrying(0.2)), Err(GripForceError::Input(_))), "{bad:?}");
    }
}

#[test]
fn what_makes_no_problem_is_refused_in_every_field() {
    let good = carrying(0.2).with_torques(two_joints([(-1.0, 1.0); 2], [0.0; 2]));
    minimum_grip_force(&good).unwrap();
    let refused = |word: &str, change: &dyn Fn(&mut GripForceProblem)| {
        let mut bad = good.clone();
        change(&mut bad);
        let error = minimum_grip_force(&bad).unwrap_err();
        assert!(matches!(error, GripForceError::Input(_)) && error.to_string().contains(word), "{word}: {error}");
    };
    refused("mass", &|p| p.mass_kg = -1e-9);
    refused("mass", &|p| p.mass_kg = f64::INFINITY);
    refused("gamma", &|p| p.gamma = -0.1);
    refused("gamma", &|p| p.gamma = f64::INFINITY);
    refused("extra wrench", &|p| p.extra_wrench[5] = f64::NAN);
    refused("gravity", &|p| p.gravity.y = f64::INFINITY);
    refused("centre of mass", &|p| p.center_of_mass.x = f64::NAN);
    refused("limits", &|p| p.min_normal_n = -1.0);
    refused("limits", &|p| p.min_normal_n = f64::NAN);
    refused("torsional", &|p| p.torsion_m = Some(-1e-3));
    refused("torsional", &|p| p.torsion_m = Some(f64::INFINITY));
    refused("contact 1", &|p| p.contacts[1].point.z = f64::NAN);
    refused("contact 0", &|p| p.contacts[0].friction = f64::INFINITY);
    refused("joints", &|p| p.torques.as_mut().unwrap().gravity_nm = DVector::zeros(3));
    refused("joints", &|p| p.torques.as_mut().unwrap().jacobians[1] = Matrix3xX::zeros(1));
    refused("joint 1", &|p| p.torques.as_mut().unwrap().limits_nm[1] = (0.2, 0.1));
    refused("finite", &|p| p.torques.as_mut().unwrap().jacobians[0][(2, 1)] = f64::NAN);
    refused("finite", &|p| p.torques.as_mut().unwrap().gravity_nm[0] = f64::NAN);
    assert!(matches!(distribute(&good, -1.0), Err(GripForceError::Input(_))));
    // What is at the edge of sense is none of that.
    let mut edge = good.clone();
    (edge.gamma, edge.torsion_m, edge.max_normal_n, edge.min_normal_n) = (0.0, Some(0.0), Some(0.5), 0.5);
    edge.torques.as_mut().unwrap().limits_nm[1] = (f64::NEG_INFINITY, f64::INFINITY);
    assert!((minimum_grip_force(&edge).unwrap().total_n - 1.0).abs() < 1e-6);
}

/// Six contacts without friction: each direction and each turn of a cube has one each way.
fn frictionless_cage(length_m: f64) -> Vec<Contact> {
    let mut contacts = Vec::new();
    for axis in 0..3 {
        for sense in [1.0, -1.0] {
            for side in [1.0, -1.0] {
                // Through the middle of a face, off the axis by the length: a force, and a torque of that length times it.
                let normal = Vector3::ith(axis, sense);
                let arm = Vector3::ith((axis + 1) % 3, side * length_m);
                contacts.push(Contact::new(Point3::from(arm - normal * 0.05), normal, 0.0));
            }
        }
    }
    contacts
}

#[test]
fn the_ball_of_a_frictionless_cage_is_known_and_scales_with_the_length() {
    let contacts = frictionless_cage(0.02);
    let mut options = ClosureOptions::default();
    options.length_m = Some(0.02);
    let evaluation = force_closure(&contacts, &options).unwrap();
    assert!(evaluation.closed && evaluation.length_m == 0.02);
    // Each axis has the wrenches (±1, ±1) of a force and a torque: the hull reaches max over the axes of |f| + |t|, which on the unit
    // sphere is least where each axis has a third of the square, all in one of the two.
    let least = (1.0_f64 / 3.0).sqrt();
    assert!((evaluation.epsilon - least).abs() < 1e-5, "{}", evaluation.epsilon);
    // All edges weigh alike: one of twelve each.
    assert!((evaluation.min_weight - 1.0 / 12.0).abs() < 1e-6);
    assert!((min_weight(&contacts, &options).unwrap() - 1.0 / 12.0).abs() < 1e-6);
    // Torques divided by twice the length count half: |f| + |t| / 2 is least for torques alone.
    options.length_m = Some(0.04);
    let halved = force_closure(&contacts, &options).unwrap().epsilon;
    assert!((halved - 0.5 * least).abs() < 1e-5, "{halved}");
    // Without one of its twelve it leaks.
    assert!(!force_closure(&contacts[1..], &options).unwrap().closed);
}

#[test]
fn closure_does_not_depend_on_where_the_object_frame_is() {
    let here = frictionless_cage(0.02);
    let at = Point3::new(0.3, -0.2, 0.1);
    let there: Vec<Contact> = here.iter().map(|c| Contact { point: c.point + at.coords, ..c.clone() }).collect();
    let (a, b) = (
        force_closure(&here, &ClosureOptions::default()).unwrap(),
        force_closure(&there, &ClosureOptions::about(at)).unwrap(),
    );
    assert!(a.closed && b.closed && (a.epsilon - b.epsilon).abs() < 1e-5 && (a.length_m - b.length_m).abs() < 1e-12);
}

fn level() -> Rolling {
    let mut r = Rolling::new(0.03, 0.05, 2.0);
    (r.resistance_m, r.acceleration_m_s2) = (0.0, 0.0);
    r
}

fn roll(r: &Rolling, steps: usize) -> Result<drex_grasp::RollingPath, RollingError> {
    let goal = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.8);
    rolling_path(r, &Isometry3::identity(), &goal, steps)
}

#[test]
fn starting_and_stopping_a_roll_are_newtons_law() {
    // Level and without resistance: 2 F = (1 + k) m a either way, so stopping needs the press that starting needs.
    for k in [0.4, 0.5, 1.0] {
        let mut r = level();
        (r.inertia_factor, r.acceleration_m_s2) = (k, 1.5);
        let path = roll(&r, 4).unwrap();
        let f = 0.5 * (1.0 + k) * 0.05 * 1.5;
        assert!((path.press_n - f / 0.5).abs() < 1e-12, "{k}");
        assert!((path.force_n - f.hypot(f / 0.5)).abs() < 1e-12);
        // At steady speed nothing pushes along.
        assert!((path.waypoints[1].force - Vector3::new(0.0, 0.0, -path.press_n)).norm() < 1e-12);
    }
    // Downhill stopping needs more than starting: 2 F = −m g sin s − (1 + k) m a.
    let s: f64 = 0.1;
    let mut r = level();
    r.acceleration_m_s2 = 0.5;
    r.table_normal = Unit::new_normalize(Vector3::new(s.sin(), 0.0, s.cos()));
    let goal = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.8);
    let path = rolling_path(&r, &Isometry3::identity(), &goal, 2).unwrap();
    let f = 0.5 * (0.05 * G * s.sin() + 1.4 * 0.05 * 0.5);
    assert!((path.press_n - f / 0.5).abs() < 1e-12, "{}", path.press_n);
    let steady = -0.5 * 0.05 * G * s.sin();
    let along = Vector3::new(s.cos(), 0.0, -s.sin());
    assert!((path.waypoints[0].force.dot(&along) - steady).abs() < 1e-12);
}

#[test]
fn the_table_has_to_give_what_the_finger_does_not() {
    // Level, without resistance: the centre's m a is F from the finger, (1 + k) / 2 of it, and the rest from the table.
    let mut r = level();
    (r.acceleration_m_s2, r.touch_n) = (2.0, 0.3);
    let needed = 0.05 * 2.0 * (1.0 - 0.7);
    let press = (0.7 * 0.05 * 2.0_f64 / 0.5).max(0.3);
    let pressed = press + 0.05 * G;
    r.table_friction = 1.001 * needed / pressed;
    let path = roll(&r, 2).unwrap();
    assert!((path.press_n - press).abs() < 1e-12);
    r.table_friction = 0.999 * needed / pressed;
    let error = roll(&r, 2).unwrap_err();
    assert!(
        matches!(error, RollingError::TableSlips { needed_n, available_n }
            if (needed_n - needed).abs() < 1e-12 && (available_n - 0.999 * needed).abs() < 1e-12),
        "{error:?}"
    );
    // The force limit is on the whole force.
    r.table_friction = 0.5;
    r.max_force_n = path.force_n * 1.0001;
    roll(&r, 2).unwrap();
    r.max_force_n = path.force_n * 0.9999;
    let error = roll(&r, 2).unwrap_err();
    assert!(
        matches!(error, RollingError::TooMuch { needed_n, limit_n } if (needed_n - path.force_n).abs() < 1e-12 && limit_n == r.max_force_n),
        "{error:?}"
    );
}

#[test]
fn a_finger_overcomes_resistance_only_with_friction_above_half_of_it_over_the_radius() {
    // F >= b (P + m g) / (2 r) and F <= μ P: possible for μ > b / (2 r) = 1/8.
    let mut r = level();
    (r.radius_m, r.resistance_m) = (1.0 / 32.0, 1.0 / 128.0);
    (r.max_force_n, r.table_friction, r.finger_friction) = (1e6, 1.0, 0.126);
    let path = roll(&r, 2).unwrap();
    assert!((path.press_n - 0.125 * 0.05 * G / 0.001).abs() < 1e-6, "{}", path.press_n);
    r.finger_friction = 0.125;
    let error = roll(&r, 2).unwrap_err();
    assert!(matches!(error, RollingError::FingerSlips { friction: 0.125, .. }), "{error:?}");
}

#[test]
fn rolling_refuses_each_number_that_makes_no_sense() {
    let good = level();
    roll(&good, 1).unwrap();
    for (k, value) in [0.0, -1.0, f64::NAN, f64::INFINITY].into_iter().enumerate() {
        for field in 0..3 {
            let mut bad = good.clone();
            *[&mut bad.radius_m, &mut bad.mass_kg, &mut bad.max_force_n][field] = value;
            assert!(matches!(roll(&bad, 1), Err(RollingError::Input(_))), "{field} {value}");
        }
        for field in 0..6 {
            let mut bad = good.clone();
            *[
                &mut bad.inertia_factor,
                &mut bad.resistance_m,
                &mut bad.finger_friction,
                &mut bad.table_friction,
                &mut bad.acceleration_m_s2,
                &mut bad.touch_n,
            ][field] = value;
            let refused = matches!(roll(&bad, 1), Err(RollingError::Input(_)));
            assert_eq!(refused, k > 0, "{field} {value}");
        }
    }
    let mut sideways = good.clone();
    sideways.gravity = Vector3::x() * G;
    assert!(matches!(roll(&sideways, 1), Err(RollingError::Input(_))));
    let nowhere = Isometry3::translation(f64::NAN, 0.0, 0.0);
    let error = rolling_path(&good, &nowhere, &UnitQuaternion::identity(), 1);
    assert!(matches!(error, Err(RollingError::Input(_))));
    // A spin of less than a degree is left out, of more refused, whichever way it turns.
    for sign in [1.0, -1.0] {
        let spun = |degrees: f64| {
            let goal = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.5, sign * degrees.to_radians()));
            rolling_path(&good, &Isometry3::identity(), &goal, 3)
        };
        let path = spun(0.9).unwrap();
        assert!((path.waypoints[3].finger_travel_m - 2.0 * 0.03 * 0.5).abs() < 1e-9);
        assert!(matches!(spun(1.1), Err(RollingError::Spin { spin_deg }) if (spin_deg - sign * 1.1).abs() < 1e-9));
    }
}
