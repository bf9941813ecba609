//! A program that was held up: motors that froze go on from where they are, softly.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use drex_hw::dynamixel::{Port, Timing};
use drex_hw::emulator::leap::{EmulatorPort, LeapEmulator};
use drex_hw::leap::{LeapHand, LeapOptions, table};
use drex_hw::{Clock, Hand, HandCommand, HandState};
use drex_robot::Robot;

/// A port on which the next read takes so many milliseconds longer.
struct Stalling(EmulatorPort, LeapEmulator, Arc<AtomicU64>);

impl Clock for Stalling {
    fn now(&self) -> Duration {
        self.0.now()
    }
}

impl Port for Stalling {
    fn name(&self) -> &str {
        self.0.name()
    }
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> std::io::Result<usize> {
        if !wait.is_zero() {
            self.1.pass(Duration::from_millis(self.2.swap(0, Ordering::Relaxed)));
        }
        self.0.read(buffer, wait)
    }
    fn write_all(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.0.write_all(bytes)
    }
    fn clear_input(&mut self) -> std::io::Result<()> {
        self.0.clear_input()
    }
    fn set_baud(&mut self, baud: u32) -> std::io::Result<()> {
        self.0.set_baud(baud)
    }
    fn reopen(&mut self) -> std::io::Result<()> {
        self.0.reopen()
    }
}

fn all(position: f64) -> HandCommand {
    HandCommand { position: vec![position; 16], effort_limit: vec![400.0; 16] }
}

fn restarts_softly(hold_up: impl Fn(&mut dyn Hand, &LeapEmulator, &AtomicU64)) {
    let (hand, stall) = (LeapEmulator::new(), Arc::new(AtomicU64::new(0)));
    let options = LeapOptions::right()
        .with_cap_ma(550.0)
        .with_soft_start(Duration::from_millis(200))
        .with_timing(Timing::for_latency(Duration::ZERO));
    let robot = Robot::bundled("leap_right").expect("bundled");
    let port = Stalling(hand.port(), hand.clone(), stall.clone());
    let mut leap = LeapHand::connect(port, &robot, options).expect("connects");
    leap.turn_on().expect("on");
    let mut state = HandState::new(16);
    for _ in 0..150 {
        leap.cycle(Some(&all(0.2)), &mut state).expect("exchange");
        hand.pass(Duration::from_millis(2));
    }
    assert_eq!(hand.get(3, table::GOAL_CURRENT), Some(400));

    hold_up(&mut leap, &hand, &stall);
    assert_eq!(hand.get(3, table::BUS_WATCHDOG), Some(255), "it froze");
    // Something moved it meanwhile.
    hand.place(3, 2100.0);
    hand.record_writes();
    leap.cycle(Some(&all(0.9)), &mut state).expect("exchange");
    assert_eq!(hand.get(3, table::BUS_WATCHDOG), Some(2), "noticed at once");
    assert_eq!(hand.get(3, table::GOAL_POSITION), Some(2100), "from where it is");
    assert_eq!(hand.get(3, table::GOAL_CURRENT), Some(30));
    let log: Vec<_> = hand.take_writes().into_iter().filter(|w| w.id == 3).map(|w| (w.address, w.accepted)).collect();
    assert_eq!(log, [(98, true), (208, true), (98, true)]);

    let mut currents = Vec::new();
    for _ in 0..120 {
        leap.cycle(Some(&all(0.9)), &mut state).expect("exchange");
        currents.push(hand.get(3, table::GOAL_CURRENT).expect("there"));
        hand.pass(Duration::from_millis(2));
    }
    assert!(currents[0] < 60 && currents.is_sorted(), "{currents:?}");
    assert_eq!(currents.last(), Some(&400));
}

#[test]
fn after_a_pause_between_exchanges() {
    restarts_softly(|_, hand, _| hand.pass(Duration::from_millis(100)));
}

#[test]
fn after_a_stall_while_answers_were_awaited() {
    restarts_softly(|leap, _, stall| {
        stall.store(70, Ordering::Relaxed);
        leap.cycle(Some(&all(0.2)), &mut HandState::new(16)).expect("exchange");
    });
}

#[test]
fn one_motor_that_froze_alone_goes_on_softly_too() {
    let hand = LeapEmulator::new();
    let options = LeapOptions::right()
        .with_cap_ma(550.0)
        .with_soft_start(Duration::from_millis(200))
        .with_timing(Timing::for_latency(Duration::ZERO));
    let robot = Robot::bundled("leap_right").expect("bundled");
    let mut leap = LeapHand::connect(hand.port(), &robot, options).expect("connects");
    leap.turn_on().expect("on");
    let mut state = HandState::new(16);
    let mut least = i16::MAX;
    for cycle in 0..250 {
        leap.cycle(Some(&all(0.2)), &mut state).expect("exchange");
        if cycle == 150 {
            assert_eq!(hand.get(5, table::GOAL_CURRENT), Some(400));
            hand.set(5, table::BUS_WATCHDOG, 255);
        } else if cycle > 150 {
            least = least.min(hand.get(5, table::GOAL_CURRENT).expect("there"));
            assert_eq!(hand.get(6, table::GOAL_CURRENT), Some(400), "others go on");
        }
        hand.pass(Duration::from_millis(2));
    }
    assert_eq!(hand.get(5, table::BUS_WATCHDOG), Some(2));
    assert!(least < 60, "{least} mA");
}
