//! A build without a backend answers with an error instead of a panic.
#![cfg(not(feature = "flex"))]

use crate::common;

use std::ops::ControlFlow;

use drex_policy::{Error, GraspPolicy};

#[test]
fn training_says_which_feature_is_missing() {
    let trained = GraspPolicy::train(&common::toy(6, &[0.2]), &common::small(), &mut |_| ControlFlow::Continue(()));
    assert!(matches!(&trained, Err(Error::NoBackend)));
    assert!(trained.unwrap_err().to_string().contains("flex"));
}
