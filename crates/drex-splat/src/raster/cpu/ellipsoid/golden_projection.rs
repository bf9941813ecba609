//! The projection against the goldens, splat by splat.
#![allow(clippy::unwrap_used)]

#[path = "../../../../tests/support/mod.rs"]
mod support;

use drex_core::pose::pose_from_matrix;

use super::*;
use crate::{Kind, Label};
use support::Golden;

#[test]
fn projections_of_the_goldens() {
    for name in ["3dgs_a", "3dgs_a_antialias", "3dgs_b", "3dgs_c_garden"] {
        let Some(golden) = Golden::load(name) else { return };
        check(&golden);
    }
}

fn check(golden: &Golden) {
    let means: Vec<[f32; 3]> = golden.f32s("means").as_chunks().0.to_vec();
    let n = means.len();
    let scene = Gaussians {
        kind: Kind::Ellipsoid,
        sh_degree: golden.scalar("sh_degree") as usize,
        rotations: golden.f32s("quats").as_chunks().0.to_vec(),
        log_scales: golden.f32s("log_scales").as_chunks().0.to_vec(),
        logit_opacities: golden.f32s("logit_opacities"),
        sh: golden.f32s("sh"),
        labels: vec![Label::OBJECT; n],
        means,
    };
    let view = nalgebra::Matrix4::from_row_slice(&golden.get("viewmat").values);
    let k = &golden.get("intrinsics").values;
    let camera = PinholeCamera {
        camera_from_world: pose_from_matrix(&view).unwrap(),
        fx: k[0],
        fy: k[1],
        cx: k[2],
        cy: k[3],
        width: golden.scalar("width") as usize,
        height: golden.scalar("height") as usize,
    };
    let options = RenderOptions { antialias: golden.scalar("antialias") != 0.0, ..RenderOptions::default() };
    let view = View::new(&camera, &options);
    let splats: Vec<Splat> = (0..n).map(|i| view.project(&scene, i).0).collect();
    let radius = &golden.get("proj_radius").values;
    // The goldens cull at 3.33 standard deviations, we where opacity ends: a splat just outside the image may be in one only.
    let drawn = |i: usize| splats[i].depth > 0.0 && radius[2 * i] > 0.0;
    assert!((0..n).filter(|&i| splats[i].depth > 0.0 && radius[2 * i] == 0.0).count() <= 2);
    assert!((0..n).filter(|&i| drawn(i)).count() > n / 3);

    let two_ln2 = 2.0 * std::f64::consts::LN_2;
    let flat = |f: &dyn Fn(usize) -> Vec<f32>| (0..n).flat_map(f).collect::<Vec<f32>>();
    let conic = flat(&|i| {
        let [a, b, c] = splats[i].whiten.map(f64::from);
        [a * a, a * b, b * b + c * c].map(|v| (v * two_ln2) as f32).to_vec()
    });
    let compare = |name: &str, values: &[f32], per: usize| golden.compare(name, values, 1e-5, 1e-2, |k| drawn(k / per));
    compare("proj_mean2d", &flat(&|i| splats[i].mean.to_vec()), 2);
    compare("proj_conic", &conic, 3);
    compare("proj_depth", &flat(&|i| vec![splats[i].depth]), 1);
    compare("proj_colour", &flat(&|i| splats[i].colour.to_vec()), 3);
    if options.antialias {
        let compensation = flat(&|i| vec![splats[i].log2_opacity.exp2() / scene.opacity(i)]);
        compare("proj_compensation", &compensation, 1);
    }
}
