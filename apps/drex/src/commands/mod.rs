//! One file per subcommand.

pub mod asset;
pub mod batch;
pub mod calibrate_hand;
pub mod demo;
pub mod deploy;
pub mod doctor;
pub mod grasp;
pub mod hands;
pub mod hw;
pub mod identify;
pub mod import;
pub mod masks;
pub mod mesh;
pub mod plan_push;
pub mod reconstruct;
pub mod render;
pub mod retarget;
pub mod run;
pub mod sfm;
pub mod shell;
