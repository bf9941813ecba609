//! Fits friction and rebound of the real cube on the odd-numbered tosses, judges them on the even-numbered ones, and
//! shows what bounds the prediction: `DREX_SHARED=... cargo run --release -p drex-diffsim --example fit_tosses`.
#![allow(clippy::unwrap_used, missing_docs, clippy::print_stdout)] // an example that prints; its helpers are a test's

#[path = "../tests/recorded/mod.rs"]
mod recorded;

use recorded::cube::{Toss, face_up, median, tosses};
use recorded::fit::{self, AHEAD_S, FROM_S, Parameters, REST_S};
use recorded::{engine, shared};

fn main() {
    let Some(shared) = shared() else { return };
    let seen: Vec<Toss> = tosses(&shared, 0.0).into_iter().filter(|t| t.number % 2 == 1).collect();
    let table_m = fit::table_height(&seen);
    let all = tosses(&shared, table_m);
    let (odd, even): (Vec<&Toss>, Vec<&Toss>) = all.iter().partition(|t| t.number % 2 == 1);
    println!("{} odd and {} even tosses; table at {:+.2} mm from the odd ones", odd.len(), even.len(), table_m * 1e3);

    let (best, _) = fit::fit(&odd);
    println!("\nodd tosses: mean distance {AHEAD_S} s after {FROM_S} s, mm (rows friction, columns damping ratio)");
    let starts = fit::starts(&odd);
    let mut row = f64::NAN;
    for p in fit::grid() {
        if p.friction != row {
            print!("\n{:.2} ", p.friction);
            row = p.friction;
        }
        print!(" {:.1}: {:5.1}  ", p.damping_ratio, fit::predict(&odd, &starts, &p, false).mean_mm());
    }
    println!("\nbest: {best:?}");

    for (name, set) in [("odd", &odd), ("even", &even)] {
        let starts = fit::starts(set);
        let (slides_on, stops) = fit::ballistic(set, &starts);
        let kept = fit::kept_face(set);
        println!("\n{name}: no contact: {slides_on:.1} mm sliding on, {stops:.1} mm stopping; face kept {kept:.1} %");
        for (label, p) in [("fitted", best), ("no friction", Parameters { friction: 0.0, ..best })] {
            let e = fit::predict(set, &starts, &p, true);
            let (mm, deg) = (median(e.mm.clone()), median(e.deg.clone()));
            println!(
                "{name}, {label}: median {mm:.1} mm, mean {:.1} mm, {deg:.1} deg, face {:.1} %",
                e.mean_mm(),
                e.face_percent()
            );
        }
    }
    bounds(&even, best);
}

/// What no choice of two parameters can do better.
fn bounds(tosses: &[&Toss], best: Parameters) {
    let starts = fit::starts(tosses);
    let each: Vec<Vec<f64>> = fit::grid().iter().map(|p| fit::predict(tosses, &starts, p, false).mm).collect();
    let own = (0..tosses.len()).map(|k| each.iter().map(|mm| mm[k]).fold(f64::MAX, f64::min)).collect();
    println!("\neven, each toss with its own best parameters of the grid: median {:.1} mm", median(own));

    // A track that a rigid cube on a plane cannot follow is wrong by at least as much as it sinks in.
    let inside = |t: &&Toss| -t.lowest_between(FROM_S, FROM_S + AHEAD_S).min(0.0) * 1e3;
    println!(
        "even, deepest corner of the track inside the table: median {:.1} mm",
        median(tosses.iter().map(inside).collect())
    );

    // The same prediction from states of windows half as long: what the choice of the state alone moves.
    let (properties, shape) = recorded::cube::cube();
    let constants = engine::Constants::damped(best.damping_ratio);
    let (mut mm, mut deg, mut flips) = (Vec::new(), Vec::new(), 0);
    for toss in tosses {
        let frames = toss.window(FROM_S);
        let late = &frames[(frames.len() / 2).min(frames.len() - 4)..];
        let ends = [&frames, late].map(|chosen| {
            let start = toss.fit(FROM_S, chosen);
            engine::toss(&properties, &shape, best.friction, &start, &[AHEAD_S, REST_S], &constants).unwrap()
        });
        mm.push((ends[0][0].translation.vector - ends[1][0].translation.vector).norm() * 1e3);
        deg.push(ends[0][0].rotation.angle_to(&ends[1][0].rotation).to_degrees());
        flips += usize::from(face_up(&ends[0][1]) != face_up(&ends[1][1]));
    }
    let flips = 100.0 * flips as f64 / tosses.len() as f64;
    println!(
        "even, moved by halving the window: median {:.1} mm, {:.1} deg, another face in {flips:.1} %",
        median(mm),
        median(deg)
    );

    let e = fit::predict(tosses, &starts, &best, true);
    for (name, flying) in [("still flying", true), ("touched before", false)] {
        let of = |k: &usize| tosses[*k].window(FROM_S).len() == tosses[*k].window_length(FROM_S);
        let group: Vec<usize> = (0..tosses.len()).filter(|k| of(k) == flying).collect();
        let right = group.iter().filter(|&&k| e.face[k]).count();
        println!(
            "even, {name} at the start: {} tosses, median {:.1} mm, face {:.1} %",
            group.len(),
            median(group.iter().map(|&k| e.mm[k]).collect()),
            100.0 * right as f64 / group.len() as f64
        );
    }
    let faces = fit::grid().into_iter().map(|p| fit::predict(tosses, &starts, &p, true).face_percent());
    let (lo, hi) = faces.fold((f64::MAX, f64::MIN), |(a, b), f| (a.min(f), b.max(f)));
    println!("even, face over the whole grid: {lo:.1} to {hi:.1} %");
}
