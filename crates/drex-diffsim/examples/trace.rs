#[path = "pick.rs"]
#[allow(dead_code, missing_docs)]
mod pick;
use drex_diffsim::{Workspace, step};
fn main() {
    let a: Vec<f64> = std::env::args().skip(1).map(|x| x.parse().unwrap()).collect();
    let (model, scene, mut s) = pick::scene(&pick::Pick { mass_kg: a[0], friction: a[1], cap_nm: a[2], squeeze: a[3], dt_s: 1e-3 }).unwrap();
    let mut w = Workspace::default();
    let mut next = 0.0;
    while s.time_s < 1.2 {
        step(&model, &scene, &mut s, &mut w).unwrap();
        if s.time_s >= next {
            next += a[4];
            let b = &s.bodies[0].world_from_body;
            println!("t {:.3} box {:.4?} rot {:.3?}", s.time_s, b.translation.vector.as_slice(), b.rotation.scaled_axis().as_slice());
            for c in w.contacts() { println!("   {:?} g{} {} site {:x} f {:.3?} n {:.2?} d {:.2e} slips {}", c.key.b, c.key.geom_b, c.key.geom_a, c.key.site, c.force.as_slice(), c.normal.as_slice(), c.depth, c.slips); }
        }
    }
}
