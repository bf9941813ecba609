//! An emulated Allegro hand at a pseudo-terminal, for programs that speak slcan: `allegro_emulator v3|v4|v5 [LINK] [WALL_RAD]`.
//!
//! Prints the terminal's name. A line on stdin prints angles (rad) and contact torques (N m) as JSON; the end of stdin ends the program.
#![allow(clippy::print_stdout, missing_docs)] // a program for the terminal

#[cfg(unix)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    use std::io::BufRead;
    use std::path::PathBuf;

    use drex_hw::allegro::AllegroVersion;
    use drex_hw::can::SlcanAdapter;
    use drex_hw::emulator::allegro::AllegroEmulator;
    use drex_hw::emulator::pty::PtyServer;

    let mut arguments = std::env::args().skip(1);
    let version = match arguments.next().as_deref() {
        Some("v3") => AllegroVersion::V3,
        Some("v4") => AllegroVersion::V4,
        Some("v5") => AllegroVersion::V5,
        _ => return Err("usage: allegro_emulator v3|v4|v5 [LINK] [WALL_RAD]".into()),
    };
    let link = arguments.next().map(PathBuf::from);
    let wall = arguments.next().map(|w| w.parse::<f64>()).transpose()?;

    let hand = AllegroEmulator::new(version).in_real_time();
    if let Some(wall) = wall {
        (0..16).for_each(|joint| hand.set_wall(joint, f64::NEG_INFINITY, wall));
    }
    let server = PtyServer::serve(SlcanAdapter::new(hand.bus()), link.as_deref())?;
    println!("{}", server.path().display());
    for line in std::io::stdin().lock().lines() {
        line?;
        println!("{{\"q\": {:?}, \"contact_nm\": {:?}}}", hand.positions(), hand.contact_torques_nm());
    }
    Ok(())
}

#[cfg(not(unix))]
fn main() {
    eprintln!("there are no pseudo-terminals on this system");
}
