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
    use drex_hw::can::SlcanAdapter;
    use drex_hw::emulator::allegro::AllegroEmulator;
    use drex_hw::emulator::leap::LeapEmulator;
    use drex_hw::emulator::pty::PtyServer;

    use super::{angles, fault, stop_button};
    use crate::cli::{HandArg, LinkArgs, MotorArg};
    use drex_hw::driver::{Setup, allegro_scene, leap_scene};
    use drex_hw::leap::table::MotorModel;

    let stop = stop_button()?;
    let setup =
        Setup::of(args.hand.into(), &LinkArgs { allegro: Some(args.allegro), ..LinkArgs::default() }.options())?;
    let names: Vec<String> = setup.robot.joint_names().into_iter().map(str::to_owned).collect();
    let walls = args.wall.as_deref().map_or_else(|| Ok(Vec::new()), |w| angles(w, &names))?;
    let closing = |(j, rad): &(usize, f64)| (names[*j].as_str(), f64::NEG_INFINITY, *rad);
    let walls: Vec<(&str, f64, f64)> = walls.iter().map(closing).collect();
    let link = args.link.as_deref();
    let server = match args.hand {
        HandArg::Leap => {
            let model = match args.motors {
                MotorArg::Xc330 => MotorModel::Xc330M288,
                MotorArg::Xl330 => MotorModel::Xl330M288,
            };
            let hand = LeapEmulator::with_model(model).in_real_time();
            leap_scene(&hand, &setup.leap, &[], &walls);
            let latency = fault::play(&hand, &setup.leap, &args.fault)?;
            match (args.baud, latency.is_zero()) {
                (Some(baud), _) => PtyServer::serve(hand.paced(baud).with_latency(latency), link)?,
                (None, false) => PtyServer::serve(hand.behind_adapter(latency), link)?,
                (None, true) => PtyServer::serve(hand, link)?,
            }
        }
        HandArg::Allegro => {
            if let Some(fault) = args.fault.first() {
                anyhow::bail!("--fault {fault}: faults are played by the LEAP hand alone");
            }
            let hand = AllegroEmulator::with_options(setup.allegro.clone()).in_real_time();
            allegro_scene(&hand, &setup.allegro, &[], &walls);
            PtyServer::serve(SlcanAdapter::new(hand.bus()), link)?
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
