//! Ellipsoids on the processor against an independent float64 reference: images, and the derivative by every input.

use crate::goldens::ellipsoids;
use drex_splat::Cpu;

#[test]
fn smooth_scene() {
    ellipsoids(&Cpu, "3dgs_a");
}

#[test]
fn smooth_scene_with_compensated_opacity() {
    ellipsoids(&Cpu, "3dgs_a_antialias");
}

#[test]
fn dense_scene_that_stops_and_clamps() {
    ellipsoids(&Cpu, "3dgs_b");
}

#[test]
fn garden() {
    ellipsoids(&Cpu, "3dgs_c_garden");
}
