//! `twin.toml`: the manifest of one object's twin folder.
