//! Times what a network proposes for an object that it has not seen, for `tests/peers/proposal_speed.py`.
//!
//!     cargo run --release -p drex-policy --example propose_speed -- [HAND] [COUNT]
//!
//! A can of 1024 points, COUNT proposals (10) of the network that ships for HAND (leap_right), on one core. Prints one JSON line: median and least ms of 100.
#![allow(clippy::print_stdout)] // an example talks to its caller

use std::f64::consts::TAU;
use std::time::Instant;

use drex_policy::Query;
use drex_policy::proposal::ProposalNetwork;
use nalgebra::Point3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let hand = arguments.next().unwrap_or("leap_right".into());
    let count = arguments.next().map_or(Ok(10), |n| n.parse())?;
    let network = ProposalNetwork::bundled(&hand).ok_or("no network ships for this hand")?;
    let around = |i: u32| (TAU * f64::from(i % 32) / 32.0, f64::from(i / 32) * 0.1 / 31.0);
    let points: Vec<Point3<f64>> =
        (0..1024).map(around).map(|(a, z)| Point3::new(0.03 * a.cos(), 0.03 * a.sin(), z)).collect();
    let mut times = Vec::new();
    for i in 0..100 {
        let query = Query::new(&points, 0.05 + 0.002 * f64::from(i), 0.5);
        let started = Instant::now();
        network.propose(&query, count)?;
        times.push(1e3 * started.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    println!(
        "{}",
        serde_json::json!({ "hand": hand, "proposals": count, "median_ms": times[50], "least_ms": times[0] })
    );
    Ok(())
}
