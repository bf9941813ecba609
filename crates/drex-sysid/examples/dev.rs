//! dev
use drex_core::push::*; use drex_core::*; use drex_diffsim::*; use drex_sysid::*; use std::path::Path; use std::sync::Arc; use nalgebra::*;
fn main() {
    let e = |s: &str, d: f64| std::env::var(s).ok().map_or(d, |s| s.parse().unwrap());
    let verbose = std::env::var("V").is_ok();
    for a in std::env::args().skip(1) {
        let c = InputChoice { poses: PoseChoice::Clean, force: ForceChoice::Exact, encoder: true };
        let r = PushRecording::load(Path::new(&a), &c).unwrap();
        let text = std::fs::read_to_string(&r.mesh).unwrap();
        let (mut v, mut f) = (vec![], vec![]);
        for l in text.lines() { let n: Vec<&str> = l.split_whitespace().collect(); match n.first() { Some(&"v") => v.push(Point3::new(n[1].parse().unwrap(), n[2].parse().unwrap(), n[3].parse().unwrap())), Some(&"f") => f.push([1, 2, 3].map(|i| n[i].parse::<u32>().unwrap() - 1)), _ => {} } }
        let o = ObjectModel::from_mesh(&TriMesh::new(v, f).unwrap()).unwrap();
        let t: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(Path::new(&a).join("truth.json")).unwrap()).unwrap();
        let shape = Arc::new(o.pieces.iter().map(|p| ConvexPiece::from_points(p).unwrap()).collect::<Vec<_>>());
        let mut model = Model::new(vec![Body::new(&o.unit, t["mass"].as_f64().unwrap() * e("MF", 1.0), shape)]);
        model.contact.frequency_rad_s = e("W", model.contact.frequency_rad_s); model.contact.relaxation_s = e("Z", model.contact.relaxation_s); model.contact.tangential_ratio = e("KT", 1.0); model.contact.tangential_relaxation_s = e("ZT", model.contact.tangential_relaxation_s); model.dt_s = e("DT", model.dt_s);
        let mu = r.support.friction.unwrap();
        let mut scene = Scene::on_table(mu);
        scene.boxes = r.support.boxes.iter().map(|b| FixedBox { center: b.center_m.into(), half: b.half_m.into(), friction: mu }).collect();
        let Drive::Force(ff) = &r.drive else { continue };
        scene.forces.push(AppliedForce::new(0, &ff.times_s, &ff.forces_n, ForcePoint::Body(ff.point_in_object)).unwrap());
        let t0 = std::time::Instant::now();
        let rec = rollout(&model, &scene, &State::at_rest(r.initial_pose.unwrap()), r.track.times_s()).unwrap();
        let s = t0.elapsed().as_secs_f64();
        let (mut aa, mut bb) = (0.0, 0.0);
        let q0 = r.initial_pose.unwrap().rotation.inverse();
        for (k, (p, q)) in rec.poses.iter().zip(r.track.poses()).enumerate() {
            let d = pose::pose_difference(p, q);
            aa += d.fixed_rows::<3>(0).norm_squared(); bb += d.fixed_rows::<3>(3).norm_squared();
            if verbose { let f = |v: Vector3<f64>| format!("{:6.2} {:6.2} {:6.2}", v.x, v.y, v.z); println!("{:.3} sim {} obs {} | rot sim {} obs {}", r.track.times_s()[k], f(p.translation.vector * 1e3), f(q.translation.vector * 1e3), f((p.rotation * q0).scaled_axis() * 57.3), f((q.rotation * q0).scaled_axis() * 57.3)); }
        }
        let n = rec.poses.len() as f64;
        println!("{:30} pos {:7.3} mm  rot {:7.3} deg   {:.1} ms", r.name, (aa / n).sqrt() * 1e3, (bb / n).sqrt().to_degrees(), s * 1e3);
    }
}
