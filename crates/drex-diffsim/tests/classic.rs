//! The problems of mechanics that every simulator is measured by. Run with `--nocapture` to see each deviation beside
//! what is allowed (the table in docs/diffsim.md).
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)] // a test may panic, and prints what it measured

mod common;

mod classic {
    mod balls;
    mod belt;
    mod contact;
    mod finger;
    mod free;
    mod lift;
    mod push;
    mod rod;
    mod rolling;
}
