use std::time::Instant;

use super::*;
use crate::Dual;

/// Nanoseconds per search and per evaluation; run with `--ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn nanoseconds_per_pair() {
    let down = |z: f64| turned(V::new(0.01, 0.02, z), V::z() * 0.3);
    let table = cuboid(0.3, 0.3, 0.05);
    let brick = cuboid(0.02, 0.03, 0.01);
    let low = at(0.0, 0.0, -0.05);
    let capsule = Shape::Capsule { radius_m: 0.01, half_length_m: 0.04 };
    let ball = Shape::Sphere { radius_m: 0.01 };
    let prism = Shape::Convex(std::sync::Arc::new(ConvexPolyhedron::prism(0.03, 0.05, 38)));
    let lying = turned(V::new(0.0, 0.0, 0.01 - 1e-5), V::y() * std::f64::consts::FRAC_PI_2);
    let origin = Pose::identity();
    let side = turned(V::x() * 0.5, V::new(0.3, 0.2, 0.1));
    let lumps = brought_together(&lump(2000), &origin, &lump(2000), &side, &V::new(0.5, 0.3, 0.7).normalize(), 1e-5);
    let cases: Vec<(&str, Shape, Pose, Shape, Pose)> = vec![
        ("box on plane", brick.clone(), down(0.01 - 1e-6), Shape::Plane, origin),
        ("box on box", brick.clone(), down(0.01 - 1e-6), table.clone(), low),
        ("box overhanging", brick.clone(), at(0.29, 0.0, 0.01 - 1e-6), table.clone(), low),
        ("box over box, apart", brick.clone(), down(0.02), table.clone(), low),
        ("stacked equal boxes", brick.clone(), at(0.0, 0.0, 0.02 - 1e-6), brick.clone(), origin),
        ("prism 38 on box", prism.clone(), down(0.05 - 1e-6), table.clone(), low),
        ("prism 38 on prism 38", prism.clone(), at(0.0, 0.0, 0.1 - 1e-6), prism.clone(), origin),
        ("lump 128 on plane", lump(2000), down(0.0195), Shape::Plane, origin),
        ("lump 128 on box", lump(2000), down(0.0195), table.clone(), low),
        ("lump 128 on lump 128", lump(2000), origin, lump(2000), lumps),
        ("ball on box", ball.clone(), down(0.01 - 1e-6), table.clone(), low),
        ("ball on lump 128", ball.clone(), at(0.0, 0.0, 0.0291), lump(2000), origin),
        ("ball on ball", ball.clone(), at(0.0, 0.0, 0.0199), ball, origin),
        ("capsule on box", capsule.clone(), lying, table, low),
        ("capsule on lump 128", capsule.clone(), turned(V::z() * 0.029, V::y() * 1.5), lump(2000), origin),
        ("capsule on capsule", capsule.clone(), lying, capsule, turned(V::z() * -0.01, V::x() * 1.57)),
    ];
    let can = Shape::Cylinder { radius_m: 0.03, half_length_m: 0.05 };
    let rolling = turned(V::new(0.0, 0.0, 0.03 - 1e-6), V::y() * std::f64::consts::FRAC_PI_2);
    let more: Vec<(&str, Shape, Pose, Shape, Pose)> = vec![
        ("can standing on plane", can.clone(), down(0.05 - 1e-6), Shape::Plane, origin),
        ("can lying on plane", can.clone(), rolling, Shape::Plane, origin),
        ("can standing on box", can.clone(), down(0.05 - 1e-6), cuboid(0.3, 0.3, 0.05), low),
        ("can lying on box", can.clone(), rolling, cuboid(0.3, 0.3, 0.05), low),
        ("can on can, stacked", can.clone(), at(0.0, 0.0, 0.1 - 1e-6), can.clone(), origin),
        ("can beside can", can.clone(), at(0.06 - 1e-6, 0.0, 0.0), can.clone(), origin),
        ("ball beside can", Shape::Sphere { radius_m: 0.01 }, at(0.04 - 1e-6, 0.0, 0.0), can.clone(), origin),
        (
            "capsule across can",
            Shape::Capsule { radius_m: 0.01, half_length_m: 0.04 },
            turned(V::x() * (0.04 - 1e-6), V::x()),
            can,
            origin,
        ),
        ("ball on solid", Shape::Sphere { radius_m: 0.01 }, at(0.0, 0.0, 0.0399), solids::sdf_ball(0.03), origin),
        ("solid ball on box", solids::sdf_ball(0.03), at(0.0, 0.0, 0.0298), cuboid(0.3, 0.3, 0.05), low),
        ("1k points on box", solids::ball_points(0.05, 16), at(0.0, 0.0, 0.0499), cuboid(0.3, 0.3, 0.05), low),
        ("69k points on box", solids::ball_points(0.05, 132), at(0.0, 0.0, 0.049999), cuboid(0.3, 0.3, 0.05), low),
        ("69k points on plane", solids::ball_points(0.05, 132), at(0.0, 0.0, 0.049999), Shape::Plane, origin),
        ("69k points on solid", solids::ball_points(0.05, 132), at(0.0, 0.0, 0.079999), solids::sdf_ball(0.03), origin),
    ];
    for (name, a, pa, b, pb) in cases.into_iter().chain(more) {
        measure(name, &a, &pa, &b, &pb);
    }
}

pub(super) fn measure(name: &str, a: &Shape, pa: &Pose, b: &Shape, pb: &Pose) {
    let (ga, gb) = (geom(a), geom(b));
    let mut work = CollideWork::default();
    let mut out = Vec::new();
    let mut best = f64::INFINITY;
    for _ in 0..20 {
        let n = 200;
        let start = Instant::now();
        for _ in 0..n {
            out.clear();
            find(&ga, std::hint::black_box(pa), &gb, pb, 1e-6, &mut work, &mut out);
        }
        best = best.min(start.elapsed().as_secs_f64() / f64::from(n));
    }
    let frames = (Frame::of(&pa.cast::<Dual<3>>()), Frame::of(&pb.cast::<Dual<3>>()));
    let start = Instant::now();
    for _ in 0..200 {
        out.iter().for_each(|t| {
            std::hint::black_box(t.evaluate(&frames.0, &frames.1));
        });
    }
    let each = start.elapsed().as_secs_f64() / 200.0 / out.len().max(1) as f64;
    #[allow(clippy::print_stdout)] // a measurement prints
    {
        println!("{name:28} {:8.0} ns, {:3} touches, {:5.0} ns each in Dual<3>", best * 1e9, out.len(), each * 1e9);
    }
}
