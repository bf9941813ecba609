//! `drex hw emulate`: a hand without hardware.

use std::time::{Duration, Instant};

use anyhow::Result;

use crate::cli::EmulateArgs;
use crate::ui::Ui;

/// How often the stop is looked at.
#[cfg(unix)]
const LOOK: Duration = Duration::from_millis(50);

/// Serves until somebody stops it.
#[cfg(unix)]
pub fn run(args: &EmulateArgs, ui: &Ui) -> Result<()> {
    use drex_hw::emulator::allegro::{AllegroEmulator, SlcanAdapter};
    use drex_hw::emulator::leap::LeapEmulator;
    use drex_hw::emulator::pty::PtyServer;
    use drex_robot::Robot;

    use super::scene::{allegro_scene, leap_scene};
    use super::{angles, stop_button, version};
    use crate::cli::HandArg;

    let stop = stop_button()?;
    let robot = Robot::bundled(args.hand.robot())?;
    let names: Vec<String> = robot.joint_names().into_iter().map(str::to_owned).collect();
    let walls = args.wall.as_deref().map_or_else(|| Ok(Vec::new()), |w| angles(w, &names))?;
    let closing = |(j, rad): &(usize, f64)| (names[*j].as_str(), f64::NEG_INFINITY, *rad);
    let walls: Vec<(&str, f64, f64)> = walls.iter().map(closing).collect();
    let link = args.link.as_deref();
    let server = match args.hand {
        HandArg::Leap => {
            let hand = LeapEmulator::new().in_real_time();
            leap_scene(&hand, &[], &walls);
            match args.baud {
                Some(baud) => PtyServer::serve(hand.paced(baud), link)?,
                None => PtyServer::serve(hand, link)?,
            }
        }
        HandArg::Allegro => {
            let hand = AllegroEmulator::new(version(args.allegro)).in_real_time();
            allegro_scene(&hand, &[], &walls);
            PtyServer::serve(SlcanAdapter::new(hand), link)?
        }
    };
    let path = server.path().display().to_string();
    ui.answer(&serde_json::json!({ "hand": args.hand.robot(), "port": path }), &path)?;
    ui.note("an emulated hand; Ctrl-C ends it");
    let begin = Instant::now();
    let over = || args.seconds.is_some_and(|s| begin.elapsed() >= Duration::from_secs_f64(s));
    while !stop.is_stopped() && !over() {
        std::thread::sleep(LOOK);
    }
    Ok(())
}

/// Pseudo-terminals are needed.
#[cfg(not(unix))]
pub fn run(_: &EmulateArgs, _: &Ui) -> Result<()> {
    anyhow::bail!("emulated hands sit behind pseudo-terminals, which this system does not have")
}
