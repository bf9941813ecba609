//! The loop on hands that are not there: how it ends, what it counts, what it writes down.

use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use drex_hw::control::{
    ControlLoop, ControlOptions, Controller, Derating, EStop, JointFault, Joints, StopReason, Trajectory, Waypoint,
    run, telemetry, write_csv,
};
use drex_hw::{Clock, EffortUnit, Error, Hand, HandCommand, HandState, JointStatus, Result};
use drex_recording::JointLog;
use drex_recording::readers::read_joint_log_csv;

/// What the tests see and change of a hand.
#[derive(Default)]
struct World {
    now: Duration,
    on: bool,
    turned_off: u32,
    cycles: u32,
    told: HandCommand,
    celsius: Option<f64>,
    exchange: Duration,
    /// Most that a joint moves in a cycle, rad, and where it cannot go on.
    step: Option<f64>,
    wall: Option<f64>,
    fail_at: Option<u32>,
    fail_for: u32,
    panic_at: Option<u32>,
    slow_at: Option<u32>,
    sleep_at: Option<Duration>,
    deaf_to_off: bool,
    mute: bool,
    /// Status of joint b in the cycles from the first to the last.
    fault: Option<(u32, u32, JointStatus)>,
    reads: Option<f64>,
}

/// Two joints that are at once where they are told.
struct Fake {
    world: Arc<Mutex<World>>,
    names: Vec<String>,
}

#[derive(Clone)]
struct FakeClock(Arc<Mutex<World>>);

impl Clock for FakeClock {
    fn now(&self) -> Duration {
        self.0.lock().unwrap().now
    }

    fn wait_until(&self, then: Duration) {
        let mut world = self.0.lock().unwrap();
        world.now = world.now.max(then);
        // The program is stopped for a second between two cycles.
        if world.sleep_at.is_some_and(|at| at <= then) {
            world.sleep_at = None;
            world.now += Duration::from_secs(1);
        }
    }
}

impl Hand for Fake {
    fn joints(&self) -> &[String] {
        &self.names
    }

    fn limits(&self) -> &[(f64, f64)] {
        &[(-1.0, 1.0); 2]
    }

    fn effort_unit(&self) -> EffortUnit {
        EffortUnit::NewtonMetre
    }

    fn effort_caps(&self) -> &[f64] {
        &[0.4; 2]
    }

    fn turn_on(&mut self) -> Result<()> {
        self.world.lock().unwrap().on = true;
        Ok(())
    }

    fn turn_off(&mut self) -> Result<()> {
        let mut world = self.world.lock().unwrap();
        world.turned_off += 1;
        if world.deaf_to_off {
            return Err(Error::Silent { id: 7 });
        }
        world.on = false;
        Ok(())
    }

    fn cycle(&mut self, command: Option<&HandCommand>, state: &mut HandState) -> Result<()> {
        let mut world = self.world.lock().unwrap();
        world.cycles += 1;
        let n = Some(world.cycles);
        if world.panic_at == n {
            drop(world);
            panic!("a bug in the driver");
        }
        if world.fail_at.is_some_and(|at| (at..=at + world.fail_for).contains(&world.cycles)) {
            return Err(Error::Silent { id: 7 });
        }
        let took = world.exchange * if world.slow_at == n { 10 } else { 1 };
        world.now += took;
        if let Some(command) = command {
            command.check(&self.names)?;
            world.told.clone_from(command);
            let step = world.step.unwrap_or(f64::INFINITY);
            for (q, goal) in state.position.iter_mut().zip(&command.position) {
                *q = goal.clamp(*q - step, *q + step).min(world.wall.unwrap_or(f64::INFINITY));
            }
            state.velocity[1] = world.reads.unwrap_or(0.0);
        }
        state.age.fill(if world.mute { u32::MAX } else { 0 });
        state.status.fill(JointStatus::Driven);
        if let Some((_, _, status)) = world.fault.filter(|(a, b, _)| (*a..=*b).contains(&world.cycles)) {
            state.status[1] = status;
        }
        state.temperature_c.fill(world.celsius);
        Ok(())
    }
}

fn fake() -> (Arc<Mutex<World>>, Fake, FakeClock) {
    let world = Arc::new(Mutex::new(World { exchange: Duration::from_micros(500), ..World::default() }));
    let hand = Fake { world: world.clone(), names: vec!["a".into(), "b".into()] };
    (world.clone(), hand, FakeClock(world))
}

fn there(time_s: f64, q: f64) -> Trajectory {
    Trajectory::new(vec![Waypoint { time_s, position: vec![q, -q] }], vec![0.3; 2]).unwrap()
}

/// Tells the joints what a function of the time says.
struct Say<F>(F);

impl<F: FnMut(f64, &mut HandCommand) + Send> Controller for Say<F> {
    fn begin(&mut self, _: &Joints<'_>, _: &HandState) -> Result<()> {
        Ok(())
    }

    fn command(&mut self, time_s: f64, _: &HandState, command: &mut HandCommand) -> Result<ControlFlow<()>> {
        self.0(time_s, command);
        Ok(ControlFlow::Continue(()))
    }
}

#[test]
fn a_trajectory_is_followed_at_the_rate_and_ends_with_torque_off() {
    let (world, mut hand, clock) = fake();
    let mut trajectory = there(1.0, 0.8);
    let (recorder, mut reader) = telemetry(2, 1000);
    let report = run(&mut hand, &mut trajectory, &clock, ControlOptions::default().with_recorder(recorder));
    assert!(matches!(report.stop_reason, StopReason::Done) && report.torque_off.is_ok(), "{:?}", report.stop_reason);
    // One every 2.5 ms from 0 to 1 s, both included.
    assert_eq!((report.stats.cycles, report.stats.missed, report.unrecorded), (401, 0, 0));
    assert!((report.stats.rate_hz - 400.0).abs() < 1e-6);
    assert!(report.stats.late.max_s == 0.0 && (report.stats.busy.p50_s - 500e-6).abs() < 20e-6);
    assert_eq!(report.state.position, [0.8, -0.8]);
    let world = world.lock().unwrap();
    assert!(!world.on && world.told.effort_limit == [0.3; 2]);

    let mut middle = None;
    while let Ok(Some(())) = reader.next(Duration::ZERO, |s| {
        if s.time_s < 0.5 {
            middle = Some((s.time_s, s.command.position[0]));
        }
    }) {}
    let (time, goal) = middle.unwrap();
    assert!((goal - 0.8 * time).abs() < 0.8 * 1e-3, "{goal} at {time} s");
}

#[test]
fn a_trajectory_waits_for_joints_that_lag_but_not_for_those_that_stopped() {
    let run_with = |change: fn(&mut World), settle_s: f64| {
        let (world, mut hand, clock) = fake();
        change(&mut world.lock().unwrap());
        let report = run(&mut hand, &mut there(1.0, 0.8).with_settle_s(settle_s), &clock, ControlOptions::default());
        assert!(matches!(report.stop_reason, StopReason::Done), "{:?}", report.stop_reason);
        (report.stats.cycles, report.state.position[0])
    };
    // 0.7 rad/s for 0.8 rad: 0.1 rad are missing after a second.
    let slow: fn(&mut World) = |w| w.step = Some(0.7 / 400.0);
    let (cycles, q) = run_with(slow, 0.5);
    assert!((430..450).contains(&cycles) && (0.77..0.78).contains(&q), "{cycles} cycles to {q} rad");
    assert_eq!(run_with(slow, 0.0).0, 401);
    // Much too slow: half a second more, and no longer.
    let (cycles, _) = run_with(|w| w.step = Some(0.3 / 400.0), 0.5);
    assert!((600..603).contains(&cycles), "{cycles} cycles");
    // One joint on a wall: a tenth of a second more.
    let (cycles, q) = run_with(|w| w.wall = Some(0.4), 0.5);
    assert!((440..445).contains(&cycles) && q == 0.4, "{cycles} cycles");
    for bad in [f64::NAN, -1.0, f64::INFINITY] {
        let (_, mut hand, clock) = fake();
        let report = run(&mut hand, &mut there(1.0, 0.8).with_settle_s(bad), &clock, ControlOptions::default());
        assert!(matches!(report.stop_reason, StopReason::Failed(Error::Value { .. })));
    }
}

#[test]
fn however_it_ends_the_torque_goes_off() {
    let ends = |change: fn(&mut World)| {
        let (world, mut hand, clock) = fake();
        change(&mut world.lock().unwrap());
        let report = run(&mut hand, &mut there(1.0, 0.5), &clock, ControlOptions::default());
        let on = world.lock().unwrap().on;
        (report, on)
    };
    let (report, on) = ends(|w| w.fail_at = Some(50));
    assert!(
        matches!(report.stop_reason, StopReason::Failed(Error::Silent { id: 7 })) && !on && report.torque_off.is_ok()
    );
    assert_eq!(report.stats.cycles, 48);
    let (report, on) = ends(|w| w.panic_at = Some(50));
    assert!(matches!(report.stop_reason, StopReason::Panicked(text) if text == "a bug in the driver") && !on);
    let (report, on) = ends(|w| w.fail_at = Some(1));
    assert!(matches!(report.stop_reason, StopReason::Failed(_)) && !on);
    let (report, on) = ends(|w| w.reads = Some(f64::NAN));
    assert!(
        matches!(report.stop_reason, StopReason::Failed(Error::Value { what, .. }) if what.contains("joint b")) && !on
    );
    let (report, on) = ends(|w| w.mute = true);
    let StopReason::Failed(error) = report.stop_reason else { panic!("{:?}", report.stop_reason) };
    assert!(error.to_string().contains("read of a, b") && !on);
    // A hand that cannot be reached is tried more than once, and the report says so.
    let (report, on) = ends(|w| w.deaf_to_off = true);
    assert!(matches!(report.stop_reason, StopReason::Done) && on && report.torque_off.is_err());
}

#[test]
fn an_outage_is_borne_if_it_is_short_and_nothing_jumps_after_it() {
    let run_with = |outage: Duration| {
        let (world, mut hand, clock) = fake();
        {
            let mut world = world.lock().unwrap();
            (world.fail_at, world.fail_for) = (Some(100), 39);
        }
        let (recorder, mut reader) = telemetry(2, 1000);
        let options = ControlOptions::default().with_outage(outage).with_recorder(recorder);
        let report = run(&mut hand, &mut there(1.0, 0.8), &clock, options);
        let (mut last, mut jump, mut rows) = (0.0, 0.0_f64, 0);
        while let Ok(Some(())) = reader.next(Duration::ZERO, |s| {
            jump = jump.max((s.command.position[0] - last).abs());
            (last, rows) = (s.command.position[0], rows + 1);
        }) {}
        (report, jump, rows)
    };
    let (report, jump, rows) = run_with(Duration::from_millis(200));
    assert!(matches!(report.stop_reason, StopReason::Done) && report.torque_off.is_ok(), "{:?}", report.stop_reason);
    assert_eq!((report.stats.failed, report.state.position[0]), (40, 0.8));
    assert!(report.stats.outages == 1 && (report.stats.outage_s - 0.1).abs() < 0.01, "{:?}", report.stats);
    // 0.8 rad/s at 400 Hz.
    assert!(jump < 1.01 * 0.002 && rows == 401, "{jump} rad in {rows} rows");
    let (report, ..) = run_with(Duration::from_millis(50));
    assert!(matches!(report.stop_reason, StopReason::Failed(Error::Silent { .. })));
}

#[test]
fn nothing_jumps_after_a_stall() {
    let run_with = |change: fn(&mut World)| {
        let (world, mut hand, clock) = fake();
        change(&mut world.lock().unwrap());
        let (recorder, mut reader) = telemetry(2, 1000);
        let options = ControlOptions::default().with_recorder(recorder);
        let report = run(&mut hand, &mut there(1.0, 0.8), &clock, options);
        assert!(
            matches!(report.stop_reason, StopReason::Done) && report.state.position[0] == 0.8,
            "{:?}",
            report.stop_reason
        );
        let (mut last, mut jump) = (0.0, 0.0_f64);
        while let Ok(Some(())) = reader.next(Duration::ZERO, |s| {
            jump = jump.max((s.command.position[0] - last).abs());
            last = s.command.position[0];
        }) {}
        (report.stats.stalls, jump)
    };
    // 0.8 rad/s at 400 Hz; the cycle after a stall may be one period ahead.
    let (stalls, jump) = run_with(|w| w.sleep_at = Some(Duration::from_millis(500)));
    assert!(stalls == 1 && jump < 2.01 * 0.002, "{stalls} stalls, {jump} rad");
    // Within an exchange.
    let (stalls, jump) = run_with(|w| (w.slow_at, w.exchange) = (Some(20), Duration::from_millis(20)));
    assert!(stalls == 1 && jump < 0.8 * 0.0226, "{stalls} stalls, {jump} rad");
    // A long outage is no stall, and is not counted twice.
    let (world, mut hand, clock) = fake();
    world.lock().unwrap().sleep_at = Some(Duration::from_millis(500));
    {
        let mut world = world.lock().unwrap();
        (world.fail_at, world.fail_for) = (Some(195), 20);
    }
    let options = ControlOptions::default().with_outage(Duration::from_secs(2));
    let report = run(&mut hand, &mut there(1.0, 0.8), &clock, options);
    let now = world.lock().unwrap().now.as_secs_f64();
    assert!(matches!(report.stop_reason, StopReason::Done) && report.stats.stalls == 1);
    assert!((now - 2.05).abs() < 0.02, "{now} s for one second of trajectory, one asleep, and 21 lost cycles");
}

#[test]
fn what_a_hand_must_not_do_ends_the_loop() {
    for bad in [f64::NAN, f64::INFINITY] {
        let (world, mut hand, clock) = fake();
        let mut say = Say(|t: f64, c: &mut HandCommand| c.position[1] = if t > 0.1 { bad } else { 0.0 });
        let report = run(&mut hand, &mut say, &clock, ControlOptions::default());
        assert!(matches!(report.stop_reason, StopReason::Failed(Error::Value { .. })) && !world.lock().unwrap().on);
        assert_eq!(world.lock().unwrap().told.position[1], 0.0);
    }
    for rate in [0.0, -1.0, f64::NAN, 1e9] {
        let (world, mut hand, clock) = fake();
        let report = run(&mut hand, &mut there(1.0, 0.5), &clock, ControlOptions::default().with_rate_hz(rate));
        assert!(matches!(report.stop_reason, StopReason::Failed(Error::Value { .. })));
        assert!(world.lock().unwrap().cycles == 0);
    }
}

#[test]
fn the_emergency_stop_acts_within_one_cycle() {
    let (world, mut hand, clock) = fake();
    let estop = EStop::new();
    let pressed = estop.clone();
    let seen = world.clone();
    let mut say = Say(move |t: f64, _: &mut HandCommand| {
        if t >= 0.25 && !pressed.is_stopped() {
            pressed.stop();
            seen.lock().unwrap().cycles = 0;
        }
    });
    let report = run(&mut hand, &mut say, &clock, ControlOptions::default().with_estop(&estop));
    assert!(matches!(report.stop_reason, StopReason::Stopped) && !world.lock().unwrap().on);
    assert_eq!(world.lock().unwrap().cycles, 1, "cycles after the stop was pressed");
    // A button that is pressed does not let a hand go on at all.
    let (world, mut hand, clock) = fake();
    let report = run(&mut hand, &mut there(1.0, 0.5), &clock, ControlOptions::default().with_estop(&estop));
    assert!(matches!(report.stop_reason, StopReason::Stopped) && world.lock().unwrap().cycles == 0);
}

#[test]
fn cycles_that_were_missed_are_counted_and_not_made_up_for() {
    let (world, mut hand, clock) = fake();
    world.lock().unwrap().slow_at = Some(100);
    world.lock().unwrap().exchange = Duration::from_millis(1);
    let report = run(&mut hand, &mut there(1.0, 0.5), &clock, ControlOptions::default());
    // Ten milliseconds are four periods: the next cycle begins on time, three are left out.
    assert_eq!((report.stats.cycles, report.stats.missed), (398, 3));
    assert!((report.stats.busy.max_s - 10e-3).abs() < 1e-9 && report.stats.busy.p99_s < 1.1e-3);
    assert_eq!(report.stats.late.max_s, 0.0);
    // A little too slow is late, not missed.
    let (world, mut hand, clock) = fake();
    world.lock().unwrap().slow_at = Some(100);
    world.lock().unwrap().exchange = Duration::from_micros(300);
    let report = run(&mut hand, &mut there(1.0, 0.5), &clock, ControlOptions::default());
    assert_eq!((report.stats.cycles, report.stats.missed), (401, 0));
    assert!((report.stats.late.max_s - 0.5e-3).abs() < 1e-9);
}

#[test]
fn heat_and_the_limiter_take_and_never_add() {
    let told = |celsius: Option<f64>, options: ControlOptions| {
        let (world, mut hand, clock) = fake();
        world.lock().unwrap().celsius = celsius;
        let report = run(&mut hand, &mut there(0.1, 0.1), &clock, options);
        assert!(matches!(report.stop_reason, StopReason::Done));
        world.lock().unwrap().told.effort_limit.clone()
    };
    let options = ControlOptions::default;
    assert_eq!(told(None, options()), [0.3; 2]);
    assert_eq!(told(Some(40.0), options()), [0.3; 2]);
    let warm = Derating { from_c: 50.0, to_c: 60.0, ..Derating::default() };
    let half = told(Some(55.0), options().with_derating(Some(warm)));
    assert!(half.iter().all(|l| (l - 0.55 * 0.4).abs() < 1e-12), "{half:?}");
    let hot = told(Some(99.0), options().with_derating(Some(warm)));
    assert!(hot.iter().all(|l| (l - 0.04).abs() < 1e-12));
    assert_eq!(told(Some(99.0), options().with_derating(None)), [0.3; 2]);
    assert_eq!(told(None, options().with_limiter(|_, l| l.copy_from_slice(&[0.2, 5.0]))), [0.2, 0.3]);
    assert_eq!(told(None, options().with_limiter(|_, l| l.copy_from_slice(&[f64::NAN, -1.0]))), [0.0, 0.0]);
}

#[test]
fn joints_in_trouble_are_named_in_the_report() {
    let faults = |change: fn(&mut World)| {
        let (world, mut hand, clock) = fake();
        change(&mut world.lock().unwrap());
        run(&mut hand, &mut there(0.1, 0.1), &clock, ControlOptions::default()).faults
    };
    assert_eq!(faults(|_| ()), []);
    let faulted = JointStatus::Faulted(32);
    let recovered = JointFault::Recovered { from: faulted, cycles: 5 };
    assert_eq!(recovered.to_string(), "faulted (error 0x20) for 5 cycles, well again");
    assert_eq!(faults(|w| w.fault = Some((10, 14, JointStatus::Faulted(32)))), [(1, recovered)]);
    let ended = faults(|w| w.fault = Some((10, 1000, JointStatus::Silent)));
    assert_eq!(ended, [(1, JointFault::Lasting(JointStatus::Silent))]);
    // What is silent when the controller is done may be heard a moment later.
    let late = JointFault::Recovered { from: JointStatus::Silent, cycles: 8 };
    assert_eq!(faults(|w| w.fault = Some((38, 45, JointStatus::Silent))), [(1, late)]);
    // A loop that ends by an error tells too.
    let ended = faults(|w| (w.fault, w.fail_at) = (Some((10, 12, JointStatus::Faulted(32))), Some(13)));
    assert_eq!(ended, [(1, JointFault::Lasting(faulted))]);
    let hot = faults(|w| w.celsius = Some(68.0));
    let [(0, JointFault::Derated { celsius: 68.0, share }), (1, _)] = hot[..] else { panic!("{hot:?}") };
    assert!((share - 0.1).abs() < 1e-12);
    // Warm, but not so that the limit asked for would have to fall.
    assert_eq!(faults(|w| w.celsius = Some(56.0)), []);
}

#[test]
fn dropping_the_handle_stops_the_thread_and_the_torque() {
    let (world, hand, _) = fake();
    world.lock().unwrap().exchange = Duration::ZERO;
    let estop = EStop::new();
    let running = ControlLoop::start(hand, there(1e6, 0.5), ControlOptions::default().with_estop(&estop)).unwrap();
    while world.lock().unwrap().cycles < 3 {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(running.is_running());
    drop(running);
    assert!(!world.lock().unwrap().on && world.lock().unwrap().turned_off > 0);
    assert!(!estop.is_stopped(), "a shared stop is for all loops, a handle for its own");

    let (world, hand, clock) = fake();
    let running = ControlLoop::start_with_clock(hand, there(1.0, 0.5), ControlOptions::default(), clock).unwrap();
    let (back, report) = running.wait();
    assert!(matches!(report.stop_reason, StopReason::Done) && back.is_some() && !world.lock().unwrap().on);
}

#[test]
fn telemetry_is_a_joint_log() {
    let (_, mut hand, clock) = fake();
    let names = hand.names.clone();
    let (recorder, mut reader) = telemetry(2, 1000);
    run(&mut hand, &mut there(1.0, 0.8), &clock, ControlOptions::default().with_recorder(recorder));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("joints.csv");
    let mut file = std::fs::File::create(&path).unwrap();
    assert_eq!(write_csv(&mut reader, &names, EffortUnit::NewtonMetre, &mut file).unwrap(), 401);
    let log = read_joint_log_csv(&path, None).unwrap();
    assert_eq!((log.names.len(), log.times_s.len(), log.velocities.len(), log.efforts.len()), (2, 401, 401, 401));
    assert_eq!(log.positions.last().unwrap(), &[0.8, -0.8]);
    // Currents are no torques: they do not pass for efforts.
    let (recorder, mut reader) = telemetry(2, 8);
    let options = ControlOptions::default().with_recorder(recorder);
    let report = run(&mut hand, &mut there(1.0, 0.8), &clock, options);
    assert_eq!(report.unrecorded, 401 - 8);
    let mut text = Vec::new();
    assert_eq!(write_csv(&mut reader, &names, EffortUnit::Milliampere, &mut text).unwrap(), 8);
    std::fs::write(&path, text).unwrap();
    assert!(read_joint_log_csv(&path, None).unwrap().efforts.is_empty());
}

#[test]
fn a_log_is_played_again_by_the_names_of_its_joints() {
    let log = JointLog {
        names: vec!["b".into(), "x".into(), "a".into()],
        times_s: vec![7.0, 8.0],
        positions: vec![vec![0.1, 9.0, 0.2], vec![0.3, 9.0, 0.4]],
        ..JointLog::default()
    };
    let (_, mut hand, clock) = fake();
    let mut play = Trajectory::from_log(&log, &hand.names, vec![0.1; 2], 0.5).unwrap();
    let report = run(&mut hand, &mut play, &clock, ControlOptions::default());
    assert_eq!(report.state.position, [0.4, 0.3]);
    assert_eq!(report.stats.cycles, 601);
    assert!(Trajectory::from_log(&log, &["c".into()], vec![0.1], 0.5).is_err());
}

#[test]
fn a_log_with_jitter_in_its_times_is_played_at_the_speed_that_is_allowed() {
    // 0.1 rad within a millisecond, 100 rad/s, between two ordinary steps.
    let log = JointLog {
        names: vec!["a".into(), "b".into()],
        times_s: vec![0.0, 0.1, 0.101, 0.2],
        positions: vec![vec![0.0, 0.0], vec![0.1, 0.0], vec![0.2, 0.0], vec![0.3, 0.0]],
        ..JointLog::default()
    };
    let (_, mut hand, clock) = fake();
    let (recorder, mut reader) = telemetry(2, 2000);
    let mut play = Trajectory::from_log(&log, &hand.names, vec![0.1; 2], 0.5).unwrap();
    let report = run(&mut hand, &mut play, &clock, ControlOptions::default().with_recorder(recorder));
    assert!(matches!(report.stop_reason, StopReason::Done), "{:?}", report.stop_reason);
    assert_eq!(report.state.position, [0.3, 0.0]);
    // 0.024 s more than the 0.7 s of approach and log, in cycles of 2.5 ms.
    assert_eq!(report.stats.cycles, 291);
    let (mut before, mut fastest) = (0.0, 0.0_f64);
    while let Ok(Some(())) = reader.next(Duration::ZERO, |s| {
        fastest = fastest.max((s.command.position[0] - before) / 0.0025);
        before = s.command.position[0];
    }) {}
    assert!((3.9..4.001).contains(&fastest), "{fastest} rad/s");
}

#[test]
fn trajectories_that_mean_nothing_are_refused() {
    let at = |time_s, q| Waypoint { time_s, position: vec![q, 0.0] };
    for bad in
        [vec![], vec![at(0.0, 0.1)], vec![at(1.0, 0.1), at(1.0, 0.2)], vec![at(f64::NAN, 0.0)], vec![at(1.0, f64::NAN)]]
    {
        assert!(Trajectory::new(bad, vec![0.1; 2]).is_err());
    }
    let ends = |waypoints, limits| {
        let (world, mut hand, clock) = fake();
        let mut trajectory = Trajectory::new(waypoints, limits).unwrap();
        let report = run(&mut hand, &mut trajectory, &clock, ControlOptions::default());
        assert!(!world.lock().unwrap().on);
        matches!(report.stop_reason, StopReason::Failed(Error::Value { .. }))
    };
    assert!(ends(vec![at(0.1, 0.9)], vec![0.1; 2]), "9 rad/s");
    assert!(ends(vec![at(1.0, 0.9)], vec![0.1; 3]));
    assert!(ends(vec![Waypoint { time_s: 1.0, position: vec![0.1] }], vec![0.1; 2]));
    assert!(ends(vec![at(1.0, 0.9)], vec![-0.1; 2]));
    assert!(!ends(vec![at(1.0, 0.9)], vec![0.1; 2]));
}
