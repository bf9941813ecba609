//! An emulated LEAP hand behind a pseudo-terminal, until its standard input ends or a line is typed.
//!
//!     cargo run --release -p drex-hw --example leap_emulator -- LINK [BAUD]
//!
//! Programs open LINK as the serial port of a hand. With BAUD it is as slow as a bus of that speed.
#![allow(clippy::print_stdout)] // an example talks to a person

#[cfg(unix)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    use drex_hw::emulator::leap::LeapEmulator;
    use drex_hw::emulator::pty::PtyServer;

    let mut arguments = std::env::args().skip(1);
    let link = arguments.next().ok_or("say where the link is to be: leap_emulator LINK [BAUD]")?;
    let hand = LeapEmulator::new().in_real_time();
    let link = std::path::Path::new(&link);
    let server = match arguments.next() {
        Some(baud) => PtyServer::serve(hand.paced(baud.parse()?), Some(link))?,
        None => PtyServer::serve(hand, Some(link))?,
    };
    println!("{}", server.path().display());
    std::io::stdin().read_line(&mut String::new())?;
    Ok(())
}

#[cfg(not(unix))]
fn main() {
    eprintln!("there are no pseudo-terminals on this system");
}
