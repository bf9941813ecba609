//! The tests of this crate in one binary, which is built and linked once; those that count allocations, raise signals or start themselves are beside it.
#![allow(clippy::unwrap_used)] // a test may stop at the first surprise

mod allegro;
mod allegro_pty;
mod bus;
mod can;
mod control;
mod grasp;
mod leap;
mod leap_emulator;
mod leap_faults;
mod leap_findings;
mod leap_grasp;
mod leap_inspection;
mod leap_off;
mod leap_properties;
mod leap_stall;
mod leap_unconfirmed;
mod limits;
mod second_opinion;
mod torque_current;
