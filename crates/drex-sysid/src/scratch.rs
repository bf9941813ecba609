use super::*;
use crate::problem::*;
use drex_core::TriMesh;
use drex_core::push::*;
use nalgebra::Point3;
fn read_obj(path: &std::path::Path) -> TriMesh {
    let (mut vertices, mut faces) = (Vec::new(), Vec::new());
    for line in std::fs::read_to_string(path).unwrap().lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let number = |i: usize| words[i].parse::<f64>().unwrap();
        match words.first() {
            Some(&"v") => vertices.push(Point3::new(number(1), number(2), number(3))),
            Some(&"f") => faces.push([1, 2, 3].map(|i| words[i].parse::<u32>().unwrap() - 1)),
            _ => {}
        }
    }
    TriMesh::new(vertices, faces).unwrap()
}
#[test]
fn scratch() {
    let folder = std::env::var("PUSH").unwrap();
    let folder = std::path::Path::new(&folder);
    let choice = InputChoice { poses: PoseChoice::Clean, force: ForceChoice::Exact, encoder: true };
    let recording = PushRecording::load(folder, &choice).unwrap();
    let object = ObjectModel::from_mesh(&read_obj(&recording.mesh)).unwrap();
    let shape = object.shape().unwrap();
    let options = IdentifyOptions::default();
    let p = Problem::new(&recording, &object, &shape, &options, PoseNoise { position_m: 0.002, rotation_rad: 0.0175 })
        .unwrap();
    let text = std::fs::read_to_string(folder.join("truth.json")).unwrap();
    let t: serde_json::Value = serde_json::from_str(&text).unwrap();
    let f = |k: &str, d: f64| std::env::var(k).ok().and_then(|s| s.parse().ok()).unwrap_or(d);
    let mut v = p.stated(t["mass"].as_f64().unwrap() * f("M", 1.0), t["mu"].as_f64().unwrap() * f("MU", 1.0));
    v.named[parameters::Parameter::ContactDamping as usize] = f("D", 1.0).ln();
    v.named[parameters::Parameter::ContactStiffness as usize] = f("K", 1.0).ln();
    let m = p.simulate(&v, f("DT", 5e-4)).unwrap();
    if let Action::Finger(fi) = &p.action {
        for (k, q) in m.tips.iter().enumerate() {
            let r = (fi.encoder[k] - q) * 1e3;
            let t = fi.encoder_times_s[k];
            let c = fi.control.at(t);
            let x = m.at(t).translation.vector - m.at(0.0).translation.vector;
            let o = recording.track.at(t.min(*p.times_s.last().unwrap())).unwrap().translation.vector
                - recording.track.poses()[0].translation.vector;
            println!(
                "{t:.2} cmd {:.2} q {:.2} lag {:.3} res {:.3} f {:.3} {:.3}  obj sim {:.2} {:.2} obs {:.2} {:.2} mm",
                c[0] * 1e3,
                q * 1e3,
                (c[0] - q) * 1e3,
                r,
                c[1],
                c[2],
                x.x * 1e3,
                x.y * 1e3,
                o.x * 1e3,
                o.y * 1e3
            );
        }
    }
}
#[test]
fn timing() {
    let folder = std::env::var("PUSH").unwrap();
    let folder = std::path::Path::new(&folder);
    let choice = InputChoice::default();
    let recording = PushRecording::load(folder, &choice).unwrap();
    let object = ObjectModel::from_mesh(&read_obj(&recording.mesh)).unwrap();
    let shape = object.shape().unwrap();
    let options = IdentifyOptions::default();
    let cpu = || {
        let t = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
        t.split_whitespace().next().unwrap().parse::<f64>().unwrap() * 1e-6
    };
    let b = cpu();
    let p = Problem::new(&recording, &object, &shape, &options, PoseNoise { position_m: 0.002, rotation_rad: 0.0175 })
        .unwrap();
    println!("new {:.2} ms", cpu() - b);
    let text = std::fs::read_to_string(folder.join("truth.json")).unwrap();
    let t: serde_json::Value = serde_json::from_str(&text).unwrap();
    for scale in [0.1, 1.0, 10.0] {
        let v = p.stated(t["mass"].as_f64().unwrap() * scale, t["mu"].as_f64().unwrap());
        for dt in [5e-4, 1e-3, 2e-3] {
            let b = cpu();
            for _ in 0..5 {
                p.simulate(&v, dt).unwrap();
            }
            let sim = (cpu() - b) / 5.0;
            let m = p.simulate(&v, dt).unwrap();
            let b = cpu();
            for _ in 0..5 {
                p.fit(&m, None);
            }
            let fit = (cpu() - b) / 5.0;
            let f = p.fit(&m, None);
            let mut s = Vec::new();
            for n in [1, 2, 4, 8] {
                let slots: Vec<Slot> =
                    (0..n).map(|k| Slot::Named(parameters::Parameter::ALL[[0, 1, 2, 3, 4, 5, 6, 7][k]])).collect();
                let b = cpu();
                p.slopes(&v, &slots, &f, dt).unwrap();
                s.push(format!("{:.1}", cpu() - b));
            }
            println!(
                "scale {scale} dt {dt} sim {sim:.1} ms, fit {fit:.2} ms, slopes {s:?}, T {}",
                p.times_s.last().unwrap()
            );
        }
    }
}
#[test]
fn spans() {
    use crate::joint::*;
    let folder = std::env::var("PUSH").unwrap();
    let folder = std::path::Path::new(&folder);
    let recording = PushRecording::load(folder, &InputChoice::default()).unwrap();
    let object = ObjectModel::from_mesh(&read_obj(&recording.mesh)).unwrap();
    let shape = object.shape().unwrap();
    let options = IdentifyOptions::default();
    let p = Problem::new(&recording, &object, &shape, &options, recording.noise.unwrap()).unwrap();
    let mut joint = Joint::new(vec![p], &[recording.support.friction], &options);
    let e = joint.solve(&options).unwrap();
    let b = &e.best;
    println!("best {:?} cost {}", b.point, b.cost);
    let rows = joint.problems[0].row_weights(&b.fits[0]);
    let slots: Vec<Slot> = joint.coordinates.iter().map(|c| c.slot).collect();
    let mut exact = joint.problems[0].slopes(&joint.values(0, &b.point), &slots, &b.fits[0], options.dt_s).unwrap();
    joint.problems[0].eliminate(&b.motions[0], &b.fits[0], &mut exact);
    for (k, c) in joint.coordinates.iter().enumerate() {
        let spans: Vec<f64> = match c.slot {
            Slot::Named(_) => vec![0.1, 0.03, 0.01, 0.003, 0.001],
            _ => vec![3.0, 1.0, 0.3, 0.1],
        };
        let mut cols: Vec<Vec<f64>> = spans.iter().map(|s| joint.secant(b, 0, c.slot, *s, 5e-4).unwrap()).collect();
        joint.problems[0].eliminate(&b.motions[0], &b.fits[0], &mut cols);
        let n = |a: &Vec<f64>| weighted(&rows, a, a).sqrt();
        println!(
            "{:?} norms {:?} exact {:.1} cos to first {:?}",
            c.slot,
            cols.iter().map(|c| (n(c) * 10.0).round() / 10.0).collect::<Vec<_>>(),
            n(&exact[k]),
            cols.iter()
                .chain([&exact[k]])
                .map(|c| (weighted(&rows, c, &cols[0]) / n(c) / n(&cols[0]) * 1000.0).round() / 1000.0)
                .collect::<Vec<_>>()
        );
    }
}
#[test]
fn landscape() {
    use crate::joint::*;
    let folder = std::env::var("PUSH").unwrap();
    let folder = std::path::Path::new(&folder);
    let recording = PushRecording::load(folder, &InputChoice::default()).unwrap();
    let object = ObjectModel::from_mesh(&read_obj(&recording.mesh)).unwrap();
    let shape = object.shape().unwrap();
    let options = IdentifyOptions::default();
    let p = Problem::new(&recording, &object, &shape, &options, recording.noise.unwrap()).unwrap();
    let mut joint = Joint::new(vec![p], &[recording.support.friction], &options);
    let text = std::fs::read_to_string(folder.join("truth.json")).unwrap();
    let t: serde_json::Value = serde_json::from_str(&text).unwrap();
    let m = t["mass"].as_f64().unwrap();
    let all = joint.active(true);
    for k in -8..9 {
        let lm = (m * (1.0 + 0.005 * k as f64)).ln();
        joint.coordinates[0].prior = Some((lm, 1e-7));
        let mut pt = joint.start();
        pt[0] = lm;
        let a = joint.evaluate(pt.clone(), None, 5e-4);
        let a0 = a.cost;
        let d = joint.descend(a, &all[1..], Slopes::Mean, 25, 5e-4).unwrap();
        println!(
            "{:+.1} % cost at zero errors {:.2} adapted {:.2}: {:?} clock {:.4}",
            0.5 * k as f64,
            a0,
            d.cost,
            d.point[1..].iter().map(|x| (x * 100.0).round() / 100.0).collect::<Vec<_>>(),
            d.fits[0].nuisance[0]
        );
    }
}
#[test]
fn prof() {
    use crate::joint::*;
    let folder = std::env::var("PUSH").unwrap();
    let folder = std::path::Path::new(&folder);
    let recording = PushRecording::load(folder, &InputChoice::default()).unwrap();
    let object = ObjectModel::from_mesh(&read_obj(&recording.mesh)).unwrap();
    let shape = object.shape().unwrap();
    let options = IdentifyOptions::default();
    let text = std::fs::read_to_string(folder.join("truth.json")).unwrap();
    let t: serde_json::Value = serde_json::from_str(&text).unwrap();
    let m = t["mass"].as_f64().unwrap();
    let p = Problem::new(&recording, &object, &shape, &options, recording.noise.unwrap()).unwrap();
    let mut joint = Joint::new(vec![p], &[recording.support.friction], &options);
    let e = joint.solve(&options).unwrap();
    println!("best {:+.2} % cost {:.2}", 100.0 * (e.best.point[0].exp() / m - 1.0), e.best.cost);
    for (x, c) in &e.profile {
        if (x / m - 1.0).abs() < 0.1 {
            println!("{:+.2} % {:.2}", 100.0 * (x / m - 1.0), c);
        }
    }
}
#[test]
fn variants() {
    use crate::joint::*;
    let folder = std::env::var("PUSH").unwrap();
    let folder = std::path::Path::new(&folder);
    let recording = PushRecording::load(folder, &InputChoice::default()).unwrap();
    let object = ObjectModel::from_mesh(&read_obj(&recording.mesh)).unwrap();
    let shape = object.shape().unwrap();
    let mut options = IdentifyOptions::default();
    if std::env::var("FREE").is_ok() {
        options.parameters.set(Parameter::Friction, Knowledge::Free).unwrap();
    }
    let text = std::fs::read_to_string(folder.join("truth.json")).unwrap();
    let t: serde_json::Value = serde_json::from_str(&text).unwrap();
    let m = t["mass"].as_f64().unwrap();
    let p = Problem::new(&recording, &object, &shape, &options, recording.noise.unwrap()).unwrap();
    let mut joint = Joint::new(vec![p], &[recording.support.friction], &options);
    let e = joint.solve(&options).unwrap();
    println!("best {:+.2} % cost {:.2} sd {:.4}", 100.0 * (e.best.point[0].exp() / m - 1.0), e.best.cost, e.sd);
    let info = crate::information::Information::of(&joint, &e.best, &options).unwrap();
    for v in [
        [0.5, 1.0, 1.0, 1.0],
        [0.1, 1.0, 1.0, 1.0],
        [1.0, 0.6, 1.0, 1.0],
        [1.0, 1.0, 1.0, 0.5],
        [1.0, 1.0, 0.1, 1.0],
        [1.0, 1.0, 0.01, 1.0],
        [0.1, 2.0, 0.1, 1.0],
        [1.0, 1.0, 1e-3, 1.0],
        [1.0, 1.0, 1.0, 2.0],
    ] {
        println!("{v:?} shift {:+.2} %", 100.0 * joint.shift_by(&v, &e.best, &info, options.dt_s));
    }
}
