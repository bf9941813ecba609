//! Random objects: what is said of them is so.
#![allow(clippy::unwrap_used, missing_docs)] // tests: a panic is the report

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::fs;

use drex_bench::generate::{
    FRICTION_RANGE, Kind, MASS_RANGE_KG, MassClass, MassDistribution, RandomObject, random_object,
};
use drex_core::{MassProperties, Primitive, PrimitiveShape, TriMesh};
use drex_mesh::solid_properties;
use nalgebra::{Matrix3, Point3, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

const CLASSES: [MassClass; 3] = [MassClass::Solid, MassClass::Hollow, MassClass::OffCentre];
const SEED: u64 = 900;

/// Objects of all kinds, `of_each` of each kind.
fn objects(class: MassClass, of_each: usize) -> Vec<RandomObject> {
    let mut found: BTreeMap<&str, Vec<RandomObject>> = BTreeMap::new();
    for number in 0..40 * of_each as u64 {
        let object = random_object(SEED, number, class);
        let of_kind = found.entry(object.kind.as_str()).or_default();
        if of_kind.len() < of_each {
            of_kind.push(object);
        }
    }
    assert!(found.len() == Kind::ALL.len() && found.values().all(|f| f.len() == of_each));
    found.into_values().flatten().collect()
}

fn holds(primitive: &Primitive, point: &Point3<f64>) -> bool {
    let own = primitive.object_from_shape.inverse_transform_point(point);
    primitive.shape.signed_distance(&own).distance_m < 0.0
}

fn volume(primitive: &Primitive) -> f64 {
    match primitive.shape {
        PrimitiveShape::Box { half_m: [x, y, z] } => 8.0 * x * y * z,
        PrimitiveShape::Cylinder { radius_m, half_length_m } => 2.0 * PI * radius_m * radius_m * half_length_m,
        other => panic!("{other:?}"),
    }
}

fn bounds(object: &RandomObject) -> (Point3<f64>, Point3<f64>) {
    object.to_object().unwrap().mesh.bounds().unwrap()
}

/// A uniform body of `mass_kg` in what `inside` holds of a box, by one random point in each of n³ cells.
fn integrated(
    (low, high): (Point3<f64>, Point3<f64>),
    n: usize,
    mass_kg: f64,
    inside: impl Fn(&Point3<f64>) -> bool,
) -> MassProperties {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let (mut count, mut first, mut second) = (0.0, Vector3::zeros(), Matrix3::zeros());
    for cell in 0..n.pow(3) {
        let corner = [cell % n, cell / n % n, cell / n / n];
        let share = corner.map(|k| (k as f64 + random.random_range(0.0..1.0)) / n as f64);
        let p = low + (high - low).component_mul(&Vector3::from(share));
        if inside(&p) {
            count += 1.0;
            first += p.coords;
            second += p.coords * p.coords.transpose();
        }
    }
    let c = first / count;
    let central = (second / count - c * c.transpose()) * mass_kg;
    let inertia = Matrix3::identity() * central.trace() - central;
    MassProperties { mass_kg, center_of_mass: c.into(), inertia }
}

#[test]
fn the_same_seed_writes_the_same_bytes_and_another_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |seed: u64, number: u64, class: MassClass, to: &str| {
        let object = random_object(seed, number, class);
        object.write(&folder.path().join(to)).unwrap();
        ["object.obj", "object.json"].map(|f| fs::read(folder.path().join(to).join(&object.name).join(f)).unwrap())
    };
    for class in CLASSES {
        for number in [0, 7, 1234] {
            assert_eq!(bytes(5, number, class, "a"), bytes(5, number, class, "b"));
            assert_ne!(bytes(5, number, class, "a"), bytes(6, number, class, "c"));
            assert_ne!(bytes(5, number, class, "a"), bytes(5, number + 1, class, "d"));
        }
    }
}

#[test]
fn the_classes_of_a_number_share_shape_and_friction() {
    for number in 0..50 {
        let [solid, hollow, off_centre] = CLASSES.map(|c| random_object(SEED, number, c));
        for other in [&hollow, &off_centre] {
            assert_eq!((&solid.name, &solid.solids, solid.friction), (&other.name, &other.solids, other.friction));
        }
        assert!((solid.mass_properties.mass_kg / off_centre.mass_properties.mass_kg - 1.0).abs() < 1e-12);
    }
}

#[test]
fn numbers_are_within_their_ranges_and_fill_them() {
    let within = |x: f64, [low, high]: [f64; 2]| x >= low * (1.0 - 1e-12) && x <= high * (1.0 + 1e-12);
    for class in CLASSES {
        let all: Vec<RandomObject> = (0..500).map(|n| random_object(SEED, n, class)).collect();
        for (number, o) in all.iter().enumerate() {
            let m = &o.mass_properties;
            assert!(o.name.starts_with(o.kind.as_str()) && o.name.ends_with(&format!("{number:03}")), "{}", o.name);
            assert!(within(m.mass_kg, MASS_RANGE_KG) && within(o.friction, FRICTION_RANGE), "{o:?}");
            assert!((o.first_guess_kg / m.mass_kg).ln().abs() <= 1.0);
            assert!(m.is_physical(), "{o:?}");
            let (low, high) = bounds(o);
            assert!((low + high.coords).coords.norm() < 1e-9, "{}: the origin is not in the middle", o.name);
            let c = m.center_of_mass;
            assert!((0..3).all(|i| c[i] > low[i] && c[i] < high[i]), "{}: {c}", o.name);
            // Above the base, so that it stands.
            let base = o.solids.iter().min_by(|a, b| foot(a).total_cmp(&foot(b))).unwrap();
            let under = Point3::new(c.x, c.y - base.object_from_shape.translation.y, 0.0);
            assert!(base.shape.signed_distance(&under).distance_m < -0.002, "{}: {c} is beside the base", o.name);
        }
        for kind in Kind::ALL {
            assert!(all.iter().filter(|o| o.kind == kind).count() > 40, "{kind:?}");
        }
        let share = |f: &dyn Fn(f64) -> bool| {
            all.iter().filter(|o| f(o.mass_properties.mass_kg)).count() as f64 / all.len() as f64
        };
        assert!(share(&|m| m <= MASS_RANGE_KG[0]) < 0.1 && share(&|m| m >= MASS_RANGE_KG[1]) < 0.1);
        assert!(share(&|m| m < 0.06) > 0.1 && share(&|m| m > 0.3) > 0.1, "{class:?}");
    }
}

/// Height of the lower end, metres.
fn foot(primitive: &Primitive) -> f64 {
    let half = match primitive.shape {
        PrimitiveShape::Box { half_m } => half_m[2],
        PrimitiveShape::Cylinder { half_length_m, .. } => half_length_m,
        other => panic!("{other:?}"),
    };
    primitive.object_from_shape.translation.z - half
}

#[test]
fn meshes_are_closed_and_have_the_volume_of_the_solids() {
    for o in objects(MassClass::Solid, 2) {
        let mesh = o.to_object().unwrap().mesh;
        let solid = solid_properties(&mesh).unwrap();
        assert_eq!((solid.open_edges, solid.closed), (0, true), "{}", o.name);
        // A prism of 32 sides in a cylinder.
        let share = 16.0 * (PI / 16.0).sin() / PI;
        let facets = |p: &Primitive| if matches!(p.shape, PrimitiveShape::Box { .. }) { 1.0 } else { share };
        let expected: f64 = o.solids.iter().map(|p| facets(p) * volume(p)).sum();
        let enclosed = mesh.mass_properties(1.0).unwrap().mass_kg;
        assert!((enclosed / expected - 1.0).abs() < 1e-9, "{}: {enclosed} {expected}", o.name);
    }
}

#[test]
fn lengths_have_six_digits() {
    for number in 0..200 {
        for solid in random_object(SEED, number, MassClass::Solid).solids {
            let mut lengths: Vec<f64> = solid.object_from_shape.translation.vector.iter().copied().collect();
            match solid.shape {
                PrimitiveShape::Box { half_m } => lengths.extend(half_m),
                PrimitiveShape::Cylinder { radius_m, half_length_m } => lengths.extend([radius_m, half_length_m]),
                other => panic!("{other:?}"),
            }
            for x in lengths {
                assert!((1e6 * x - (1e6 * x).round()).abs() < 1e-8, "{x}");
            }
        }
    }
}

#[test]
fn solids_and_cavities_do_not_overlap_and_stay_inside() {
    for class in CLASSES {
        for o in objects(class, 2) {
            let (low, high) = bounds(&o);
            let mut random = ChaCha8Rng::seed_from_u64(2);
            for _ in 0..20_000 {
                let share: [f64; 3] = std::array::from_fn(|_| random.random_range(0.0..1.0));
                let p = low + (high - low).component_mul(&Vector3::from(share));
                let solids = o.solids.iter().filter(|s| holds(s, &p)).count();
                assert!(solids <= 1, "{}: {p} is in {solids} solids", o.name);
                match &o.mass_distribution {
                    MassDistribution::Solid => {}
                    MassDistribution::Hollow { cavities, .. } => {
                        let empty = cavities.iter().filter(|c| holds(c, &p)).count();
                        assert!(empty <= solids, "{}: {p} is in {empty} cavities and {solids} solids", o.name);
                    }
                    MassDistribution::OffCentre { .. } => {}
                }
            }
        }
    }
}

#[test]
fn an_insert_lies_inside_one_solid() {
    for number in 0..200 {
        let o = random_object(SEED, number, MassClass::OffCentre);
        let MassDistribution::OffCentre { insert, .. } = &o.mass_distribution else { panic!("{o:?}") };
        let center = Point3::from(insert.object_from_shape.translation.vector);
        let corners = insert.hull().unwrap().vertices;
        let inside = |s: &Primitive| corners.iter().all(|c| holds(s, &(center + (c - center) * (1.0 - 1e-9))));
        assert_eq!(o.solids.iter().filter(|s| inside(s)).count(), 1, "{}: {insert:?}", o.name);
    }
}

/// What is a wall inside the outer surface is empty, also where solids meet, and nothing else is.
#[test]
fn cavities_begin_where_the_wall_ends() {
    let steps = [-1.0, 0.0, 1.0];
    for o in objects(MassClass::Hollow, 4) {
        let MassDistribution::Hollow { wall_m, open_top, cavities } = &o.mass_distribution else { panic!("{o:?}") };
        let (low, high) = bounds(&o);
        // Whether the solids hold a point, and above an open top everything that is over them.
        let solid = |p: Point3<f64>| {
            let z = if *open_top { p.z.min(high.z - 1e-9) } else { p.z };
            o.solids.iter().any(|s| holds(s, &Point3::new(p.x, p.y, z)))
        };
        let reaches = |p: &Point3<f64>, by: f64, corners: bool| {
            let moves =
                steps.iter().flat_map(|x| steps.iter().flat_map(move |y| steps.map(|z| Vector3::new(*x, *y, z))));
            moves.filter(|m| corners || m.norm() < 1.1).all(|m| solid(p + m * by))
        };
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut empty = 0;
        for _ in 0..20_000 {
            let share: [f64; 3] = std::array::from_fn(|_| random.random_range(0.0..1.0));
            let p = low + (high - low).component_mul(&Vector3::from(share));
            if cavities.iter().any(|c| holds(c, &p)) {
                empty += 1;
                assert!(reaches(&p, wall_m * 0.999, false), "{}: the wall is thinner at {p}", o.name);
            } else {
                assert!(!reaches(&p, wall_m * 1.001, true), "{}: the wall is thicker at {p}", o.name);
            }
        }
        assert!(empty > 1000, "{}", o.name);
    }
}

#[test]
fn outer_walls_have_their_thickness_or_are_missing_at_the_top() {
    let mut open = 0;
    for o in objects(MassClass::Hollow, 3) {
        let MassDistribution::Hollow { wall_m, open_top, cavities } = &o.mass_distribution else { panic!("{o:?}") };
        assert!((0.001..=0.004).contains(wall_m));
        open += usize::from(*open_top);
        let (low, high) = bounds(&o);
        let reach = |side: f64, axis: usize| {
            let axis = Vector3::ith(axis, side);
            cavities
                .iter()
                .map(|c| c.shape.support(&axis) + c.object_from_shape.translation.vector.dot(&axis))
                .fold(f64::NEG_INFINITY, f64::max)
        };
        for i in 0..3 {
            // The mesh of a round object stands back by its facets.
            let slack = if i < 2 && matches!(o.kind, Kind::Cylinder | Kind::Bottle) { 3e-4 } else { 1e-9 };
            assert!((reach(-1.0, i) + low[i] + wall_m).abs() < slack, "{}: {i}", o.name);
            let upper = if i == 2 && *open_top { 0.0 } else { *wall_m };
            assert!((high[i] - reach(1.0, i) - upper).abs() < slack, "{}: {i}", o.name);
        }
    }
    assert!(open > 3 && open < 15, "{open} of 18 are open");
}

#[test]
fn mass_properties_agree_with_an_integration() {
    for class in CLASSES {
        for o in objects(class, 1) {
            let m = o.mass_properties;
            let whole = bounds(&o);
            let solid = |p: &Point3<f64>| o.solids.iter().any(|s| holds(s, p));
            let expected = match &o.mass_distribution {
                MassDistribution::Solid => integrated(whole, 70, m.mass_kg, solid),
                MassDistribution::Hollow { cavities, .. } => {
                    integrated(whole, 100, m.mass_kg, |p| solid(p) && !cavities.iter().any(|c| holds(c, p)))
                }
                MassDistribution::OffCentre { insert, insert_kg } => {
                    let share = insert_kg / m.mass_kg;
                    assert!((0.3..=0.7).contains(&share), "{share}");
                    let mesh = insert.hull().unwrap();
                    MassProperties::combined(&[
                        integrated(whole, 70, m.mass_kg - insert_kg, solid),
                        integrated(mesh.bounds().unwrap(), 40, *insert_kg, |p| holds(insert, p)),
                    ])
                    .unwrap()
                }
            };
            let size = (whole.1 - whole.0).norm();
            let moved = (m.center_of_mass - expected.center_of_mass).norm();
            assert!(moved < 2e-3 * size, "{class:?} {}: the centre is {moved} m away", o.name);
            let scale = m.inertia.norm();
            let off = (m.inertia - expected.inertia).norm();
            assert!(off < 5e-3 * scale, "{class:?} {}: {} against {}", o.name, m.inertia, expected.inertia);
        }
    }
}

/// Of what has flat faces only the mesh tells mass properties exactly; a cavity is a mesh turned inside out.
#[test]
fn mass_properties_of_boxes_and_letters_are_those_of_their_meshes() {
    for o in [MassClass::Solid, MassClass::Hollow].into_iter().flat_map(|class| objects(class, 3)) {
        if matches!(o.kind, Kind::Cylinder | Kind::Bottle) {
            continue;
        }
        let mut mesh = TriMesh::clone(&o.to_object().unwrap().mesh);
        if let MassDistribution::Hollow { cavities, .. } = &o.mass_distribution {
            for cavity in cavities {
                let mut hull = cavity.hull().unwrap();
                hull.faces.iter_mut().for_each(|f| f.reverse());
                mesh.append(&hull);
            }
        }
        let expected = mesh.mass_properties(1.0).unwrap().with_mass(o.mass_properties.mass_kg);
        let (m, n) = (o.mass_properties, o.mass_properties.inertia.norm());
        assert!((m.center_of_mass - expected.center_of_mass).norm() < 1e-12, "{}", o.name);
        assert!((m.inertia - expected.inertia).norm() < 1e-9 * n, "{}: {} {}", o.name, m.inertia, expected.inertia);
    }
}
