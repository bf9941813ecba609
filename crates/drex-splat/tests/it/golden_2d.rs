//! Surfels on the processor against the golden arrays: images, counts, every gradient, the camera's motion.

use crate::goldens::surfels;
use drex_splat::Cpu;
use drex_splat::raster::DepthKind;

#[test]
fn few_surfels_as_gsplat_draws_them() {
    surfels(&Cpu, "2dgs_d", DepthKind::Centre);
}

#[test]
fn depth_along_the_ray() {
    surfels(&Cpu, "2dgs_d", DepthKind::Ray);
    surfels(&Cpu, "2dgs_e", DepthKind::Ray);
}

#[test]
fn few_surfels_as_the_paper_draws_them_with_distortion() {
    surfels(&Cpu, "2dgs_d_paper", DepthKind::Ray);
}

#[test]
fn many_small_surfels() {
    surfels(&Cpu, "2dgs_e", DepthKind::Centre);
}
