//! Nothing: `Cargo.toml` names the features of dependencies that all crates of the workspace together have.
