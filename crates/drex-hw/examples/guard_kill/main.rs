//! How long torque stays on after the program that drives an emulated hand was killed, stopped or hung up, after its guard was killed, and
//! after a mute motor can be reached again, at random moments.
//!
//!     cargo run -p drex-hw --example guard_kill -- [MOMENTS] [SEED]
#![allow(clippy::print_stdout)] // an example talks to a person

#[cfg(unix)]
mod bench;

#[cfg(unix)]
fn main() -> Result<(), bench::Fault> {
    use std::time::Duration;

    use bench::{Bench, Event, Model};

    fn role(name: &str) -> Vec<String> {
        vec![name.into()]
    }

    let mut arguments = std::env::args().skip(1);
    let first = arguments.next();
    match first.as_deref() {
        Some("guard") => return Ok(drex_hw::guard::serve()?),
        Some("drive") => {
            eprintln!("{}", bench::drive(role)?);
            return Ok(());
        }
        _ => {}
    }
    let moments: usize = first.map_or(Ok(100), |n| n.parse())?;
    let mut seed: u64 = arguments.next().map_or(Ok(1), |n| n.parse())?;
    // xorshift64*: moments of 20 to 320 ms after the joints began to press.
    let mut moment = move || {
        seed = seed.max(1);
        seed ^= seed >> 12;
        seed ^= seed << 25;
        seed ^= seed >> 27;
        Duration::from_micros(20_000 + (seed.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32) % 300_000)
    };
    let heartbeat = Duration::from_millis(40);
    println!("| hand | what happened | moments | off within: median | 90 % | worst | torque off before |");
    println!("|---|---|---|---|---|---|---|");
    let mut worst = Duration::ZERO;
    for model in [Model::Leap, Model::AllegroV4, Model::AllegroV5] {
        let bench = Bench::new(model)?;
        let mut events = vec![
            (Event::Kill, "program killed (SIGKILL)"),
            (Event::Stop, "program stopped (SIGSTOP), later continued"),
            (Event::HangUp, "program hung up (SIGHUP)"),
            (Event::GuardKilled, "guard killed (SIGKILL)"),
            (Event::GuardStopped, "guard stopped (SIGSTOP)"),
            (Event::GuardTold, "guard told to end (SIGTERM)"),
        ];
        if model == Model::Leap {
            events.push((Event::MuteKill, "mute motor is back, program killed before"));
            events.push((Event::MuteHangUp, "mute motor is back, program hung up before"));
        }
        for (event, text) in events {
            let (mut times, mut early) = (Vec::new(), 0);
            while times.len() < moments {
                match bench.trial(event, moment(), heartbeat, role)? {
                    Some(took) => times.push(took),
                    None => early += 1,
                }
                if early > 10 + moments {
                    return Err("this machine is too busy: the guard takes over before anything happens".into());
                }
            }
            times.sort();
            let ms =
                |share: f64| 1e3 * times[((share * times.len() as f64) as usize).min(times.len() - 1)].as_secs_f64();
            println!(
                "| {model:?} | {text} | {} | {:.1} ms | {:.1} ms | {:.1} ms | {early} |",
                times.len(),
                ms(0.5),
                ms(0.9),
                ms(1.0)
            );
            worst = worst.max(times[times.len() - 1]);
        }
    }
    println!("\nworst of all: {:.1} ms, heartbeat {} ms", 1e3 * worst.as_secs_f64(), heartbeat.as_millis());
    Ok(())
}

#[cfg(not(unix))]
fn main() {
    eprintln!("there are no pseudo-terminals on this system");
}
