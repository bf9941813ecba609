//! Properties of any manifest.
#![allow(clippy::unwrap_used, missing_docs)] // a test may stop at the first surprise

use std::path::{Path, PathBuf};

use drex_twin::manifest::{GraspsConfig, LengthUnit, MassConfig, RecordedAs, TrainConfig, TwinManifest};
use proptest::prelude::*;

fn manifests() -> impl Strategy<Value = TwinManifest> {
    let path = "[a-zA-Z0-9 _./äß-]{1,20}".prop_map(PathBuf::from);
    let positive = prop_oneof![1e-6..100.0f64, Just(0.1)];
    let mass = (prop::collection::vec(path.clone(), 0..3), prop::option::of(positive.clone()), positive.clone())
        .prop_map(|(identify, weighed_kg, prior)| MassConfig {
            identify,
            weighed_kg,
            prior_kg: Some(prior),
            prior_sd_log: Some(0.1 + prior.min(1.0)),
            ..MassConfig::default()
        });
    let recording = prop_oneof![
        prop::option::of("[a-z_]{1,10}").prop_map(|order| (RecordedAs::Robot, order, None)),
        prop::option::of(1..9999usize).prop_map(|augment| (RecordedAs::Human, None, augment)),
    ];
    let cap = prop::option::of(positive.clone());
    let grasps = prop::option::of((path.clone(), "[a-z_]{1,10}", recording, cap)).prop_map(|g| {
        g.map(|(file, hand, (recorded, joint_order, augment), torque_cap_nm)| GraspsConfig {
            file,
            recorded,
            hand,
            joint_order,
            augment,
            torque_cap_nm,
        })
    });
    let train = prop::option::of((prop::option::of(1..999usize), prop::option::of(1e-6..1.0f64)))
        .prop_map(|t| t.map(|(epochs, learning_rate)| TrainConfig { epochs, learning_rate, ..TrainConfig::default() }));
    let up = prop::array::uniform3(0.1..1.0f64);
    let unit = prop::sample::select(vec![LengthUnit::M, LengthUnit::Mm, LengthUnit::Cm]);
    let name = "[^\\s\\p{C}][^\\p{C}]{0,12}";
    (name, path, mass, grasps, train, up, unit, 0..=i64::MAX as u64, prop::option::of(0.0..2.0f64)).prop_map(
        |(name, mesh, mass, grasps, train, up, unit, seed, friction)| {
            let mut m = TwinManifest::new(name, mesh, mass);
            (m.seed, m.grasps, m.train) = (seed, grasps, train);
            (m.object.unit, m.object.up_in_mesh, m.object.friction) = (unit, up, friction);
            m
        },
    )
}

proptest! {
    #[test]
    fn a_manifest_survives_its_file(manifest in manifests()) {
        let text = manifest.to_toml_string().unwrap();
        prop_assert_eq!(TwinManifest::parse(Path::new("twin.toml"), &text).unwrap(), manifest);
    }
}
