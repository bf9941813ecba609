//! `report.html`: what was made of the twin, with which inputs, and how far it can be trusted.

pub mod page;
