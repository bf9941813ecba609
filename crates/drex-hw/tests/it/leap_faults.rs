//! Faults of motors and cables: who is not concerned goes on, who is comes back.

use std::time::Duration;

use drex_hw::dynamixel::{Bus, Timing};
use drex_hw::emulator::leap::{EmulatorPort, Fault, LeapEmulator};
use drex_hw::leap::table::{self, hardware_error};
use drex_hw::leap::{LeapHand, LeapOptions};
use drex_hw::{Clock, Error, Hand, HandCommand, HandState, JointStatus};
use drex_robot::Robot;

const CYCLE: Duration = Duration::from_millis(2);

struct Rig {
    hand: LeapEmulator,
    leap: LeapHand<EmulatorPort>,
    command: HandCommand,
    state: HandState,
}

impl Rig {
    /// A hand that pushes against a wall with 200 mA everywhere.
    fn new(options: LeapOptions) -> Self {
        let hand = LeapEmulator::new();
        (0..16).for_each(|id| hand.set_wall(id, f64::NEG_INFINITY, 2100.0));
        let options = options.with_soft_start(Duration::ZERO).with_timing(Timing::for_latency(Duration::ZERO));
        let robot = Robot::bundled("leap_right").expect("bundled");
        let mut leap = LeapHand::connect(hand.port(), &robot, options).expect("connects");
        leap.turn_on().expect("on");
        let command = HandCommand { position: vec![0.5; 16], effort_limit: vec![200.0; 16] };
        let mut rig = Self { hand, leap, command, state: HandState::new(16) };
        for _ in 0..100 {
            rig.cycle().expect("exchange");
        }
        assert_eq!(rig.state.effort, vec![200.0; 16]);
        rig
    }

    fn cycle(&mut self) -> drex_hw::Result<()> {
        let done = self.leap.cycle(Some(&self.command), &mut self.state);
        self.hand.pass(CYCLE);
        done
    }

    /// Exchanges until `reached`, at most for 3 s; how long it took.
    fn until(&mut self, what: &str, reached: impl Fn(&HandState) -> bool) -> Duration {
        let begun = self.hand.now();
        while !reached(&self.state) {
            self.cycle().expect("exchange");
            assert!(self.hand.now() - begun < Duration::from_secs(3), "{what}: {:?}", self.state.status);
        }
        self.hand.now() - begun
    }

    /// Index of the joint that motor `id` moves.
    fn joint(&self, id: u8) -> usize {
        let name = &LeapOptions::right().joints[usize::from(id)].name;
        self.leap.joints().iter().position(|n| n == name).expect("there")
    }

    fn old(&self) -> Vec<usize> {
        (0..16).filter(|j| self.state.age[*j] > 0).collect()
    }

    /// All but `j` push as they were told.
    fn others_hold(&self, j: usize) {
        for i in (0..16).filter(|i| *i != j) {
            assert_eq!((self.state.effort[i], self.state.status[i]), (200.0, JointStatus::Driven), "joint {i}");
        }
    }
}

#[test]
fn a_motor_that_is_mute_once_is_the_only_one_that_is_old() {
    let mut rig = Rig::new(LeapOptions::right());
    let j = rig.joint(7);
    let (before, follow_ups) = (rig.hand.now(), rig.leap.bus_stats().follow_ups);
    rig.hand.inject(Fault::Mute(7), 1);
    rig.cycle().expect("no error");
    assert_eq!(rig.old(), [j]);
    assert_eq!(rig.state.status[j], JointStatus::Silent);
    assert_eq!(rig.leap.bus_stats().follow_ups, follow_ups + 1);
    assert!(rig.hand.now() - before < Duration::from_millis(30), "{:?}", rig.hand.now() - before);
    rig.others_hold(j);
    rig.cycle().expect("no error");
    assert_eq!(rig.old(), [0; 0]);
    assert_eq!(rig.state.status[j], JointStatus::Driven);
}

#[test]
fn damage_costs_at_most_the_motor_it_hit_and_one_exchange() {
    let mut rig = Rig::new(LeapOptions::right());
    for id in 0..16 {
        for fault in [Fault::Corrupt(id), Fault::Truncate(id), Fault::Duplicate(id), Fault::Noise] {
            let j = rig.joint(id);
            rig.hand.inject(fault, 1);
            rig.cycle().expect("no error");
            assert!(rig.old().iter().all(|old| *old == j), "{fault:?}: {:?}", rig.old());
            rig.others_hold(j);
            rig.cycle().expect("no error");
            assert_eq!(rig.old(), [0; 0], "{fault:?}");
            assert_eq!(rig.state.effort, vec![200.0; 16]);
        }
    }
}

#[test]
fn an_overloaded_motor_is_started_again_while_the_others_hold() {
    let mut rig = Rig::new(LeapOptions::right());
    let j = rig.joint(6);
    rig.hand.fail(6, hardware_error::OVERLOAD);
    rig.until("fault", |s| matches!(s.status[j], JointStatus::Faulted(32) | JointStatus::Recovering));
    assert!(rig.leap.faults().any(|(i, what)| i == j && what == "overload"));
    rig.others_hold(j);
    rig.hand.record_writes();
    let mut took = Duration::ZERO;
    let begun = rig.hand.now();
    while rig.state.status[j] != JointStatus::Driven {
        rig.cycle().expect("exchange");
        rig.others_hold(j);
        took = rig.hand.now() - begun;
        assert!(took < Duration::from_secs(1), "{:?}", rig.state.status[j]);
    }
    let log: Vec<_> = rig.hand.take_writes().into_iter().filter(|w| w.id == 6).collect();
    let at = |address| log.iter().position(|w| w.address == address);
    let on = log.iter().position(|w| w.address == 64 && w.data == [1]).expect("torque");
    assert!(at(102).expect("current") < on && at(116).expect("goal") < on && at(168).expect("map") < on);
    assert_eq!(rig.hand.get(6, table::BUS_WATCHDOG), Some(2));
    rig.until("contact", |s| s.effort[j] == 200.0);
    rig.command.effort_limit[j] = 150.0;
    rig.until("it follows", |s| s.effort[j] == 150.0);
    assert!(took > Duration::from_millis(150), "it was deaf for so long: {took:?}");
}

#[test]
fn one_motor_that_froze_is_found_and_freed() {
    let mut rig = Rig::new(LeapOptions::right());
    let j = rig.joint(5);
    // It has heard nothing for a while, and nobody noticed: its answers came from before.
    rig.hand.set(5, table::BUS_WATCHDOG, 255);
    rig.command.effort_limit[j] = 150.0;
    rig.cycle().expect("exchange");
    rig.cycle().expect("exchange");
    assert_eq!(rig.state.effort[j], 200.0, "it takes no orders");
    rig.until("freed", |s| s.effort[j] == 150.0);
    assert_eq!(rig.hand.get(5, table::BUS_WATCHDOG), Some(2));
}

#[test]
fn a_motor_that_keeps_overloading_is_left_alone_in_the_end() {
    let mut rig = Rig::new(LeapOptions::right());
    let j = rig.joint(2);
    for _ in 0..3 {
        rig.hand.fail(2, hardware_error::OVERLOAD);
        rig.until("fault", |s| s.status[j] != JointStatus::Driven);
        rig.until("back", |s| s.status[j] == JointStatus::Driven);
    }
    rig.hand.fail(2, hardware_error::OVERLOAD);
    (0..300).for_each(|_| rig.cycle().expect("exchange"));
    assert_eq!(rig.state.status[j], JointStatus::Faulted(32));
    rig.others_hold(j);
    rig.leap.restart(j).expect("port");
    rig.until("back", |s| s.status[j] == JointStatus::Driven);
    assert!(rig.leap.restart(16).is_err());
}

#[test]
fn a_hot_motor_is_not_started_again_by_itself() {
    let mut rig = Rig::new(LeapOptions::right());
    let j = rig.joint(10);
    rig.hand.fail(10, hardware_error::OVERHEAT);
    (0..300).for_each(|_| rig.cycle().expect("exchange"));
    assert_eq!(rig.state.status[j], JointStatus::Faulted(hardware_error::OVERHEAT));
    rig.others_hold(j);
    // An error that does not switch off is told and costs nothing.
    rig.hand.fail(3, hardware_error::VOLTAGE);
    let asked = rig.leap.bus_stats().questions;
    (0..40).for_each(|_| rig.cycle().expect("exchange"));
    assert!(rig.leap.bus_stats().questions - asked < 45, "it is looked at once");
    let i = rig.joint(3);
    assert_eq!(rig.state.status[i], JointStatus::Driven);
    assert!(rig.leap.faults().any(|(k, what)| k == i && what.contains("voltage")));
}

#[test]
fn temperature_and_voltage_are_known() {
    let mut rig = Rig::new(LeapOptions::right());
    assert_eq!(rig.state.temperature_c, [Some(31.0); 16], "from the beginning");
    rig.hand.set(5, table::PRESENT_TEMPERATURE, 61);
    rig.hand.set(5, table::PRESENT_VOLTAGE, 47);
    (0..60).for_each(|_| rig.cycle().expect("exchange"));
    let j = rig.joint(5);
    assert_eq!((rig.leap.temperatures_c()[j], rig.state.temperature_c[j]), (Some(61.0), Some(61.0)));
    let health = rig.leap.health().nth(j).flatten().expect("known");
    assert_eq!((health.voltage_v, health.hardware_error), (4.7, 0));
}

#[test]
fn a_motor_without_power_for_a_moment_is_set_up_again() {
    let mut rig = Rig::new(LeapOptions::right());
    let j = rig.joint(12);
    // It comes back with a stale goal, the other mode's gains and no torque.
    rig.hand.power_cycle(12);
    rig.cycle().expect("exchange");
    rig.until("noticed", |s| s.status[j] == JointStatus::Recovering);
    rig.until("back", |s| s.status[j] == JointStatus::Driven && s.effort[j] == 200.0);
    assert_eq!(rig.hand.get(12, table::POSITION_P), Some(600));
    assert_eq!(rig.hand.get(12, table::TORQUE_ENABLE), Some(1));
}

#[test]
fn a_motor_that_stays_away_does_not_slow_the_others_down_and_is_found_again() {
    let mut rig = Rig::new(LeapOptions::right());
    let j = rig.joint(9);
    rig.hand.inject(Fault::Mute(9), 40);
    (0..30).for_each(|_| rig.cycle().expect("exchange"));
    assert_eq!(rig.state.status[j], JointStatus::Silent);
    let timeouts = rig.leap.bus_stats().timeouts;
    (0..40).for_each(|_| rig.cycle().expect("exchange"));
    rig.others_hold(j);
    assert!(rig.leap.bus_stats().timeouts - timeouts <= 2, "it is only looked for now and then");
    rig.until("found", |s| s.status[j] == JointStatus::Driven && s.effort[j] == 200.0);
}

#[test]
fn a_supply_that_fails_is_an_error_and_its_return_is_seen() {
    let mut rig = Rig::new(LeapOptions::right());
    (0..16).for_each(|id| rig.hand.power_cycle(id));
    let (begun, mut told) = (rig.hand.now(), 0);
    while told == 0 || rig.state.effort != [200.0; 16] || rig.state.status != [JointStatus::Driven; 16] {
        match rig.cycle() {
            Err(Error::NoMotors { .. }) => told += 1,
            other => other.expect("no other error"),
        }
        assert!(rig.hand.now() - begun < Duration::from_secs(1), "{:?}", rig.state.status);
    }
    assert!(told > 0, "a hand that does not answer at all is told of");
    assert_eq!(rig.hand.under_torque(), 16);
}

#[test]
fn a_pulled_plug_is_told_and_the_hand_goes_on_when_it_is_back() {
    let mut rig = Rig::new(LeapOptions::right());
    rig.hand.unplug();
    for _ in 0..10 {
        assert!(matches!(rig.cycle(), Err(Error::Port { .. })));
        rig.hand.pass(Duration::from_millis(28));
    }
    assert_eq!(rig.old().len(), 16);
    // Without instructions the motors froze; one of them lost its power as well.
    assert_eq!(rig.hand.get(0, table::BUS_WATCHDOG), Some(255));
    rig.hand.power_cycle(4);
    rig.hand.pass(Duration::from_millis(200));
    rig.hand.plug();
    rig.cycle().expect("back");
    assert_eq!(rig.leap.reconnects(), 1);
    rig.until("all hold again", |s| s.status == [JointStatus::Driven; 16] && s.effort == [200.0; 16]);
    assert_eq!(rig.hand.under_torque(), 16);
    assert_eq!(rig.hand.get(0, table::BUS_WATCHDOG), Some(2));
}

#[test]
fn torque_goes_off_after_a_plug_was_pulled_if_the_hand_is_dropped_later() {
    let mut rig = Rig::new(LeapOptions::right());
    rig.hand.unplug();
    assert!(rig.cycle().is_err());
    rig.hand.plug();
    drop(rig.leap);
    assert_eq!(rig.hand.under_torque(), 0);
}

#[test]
fn torque_that_could_not_be_taken_off_is_taken_off_when_the_plug_is_back() {
    let mut rig = Rig::new(LeapOptions::right());
    rig.hand.unplug();
    assert!(matches!(rig.leap.turn_off(), Err(Error::Port { .. })));
    rig.hand.plug();
    assert_eq!(rig.hand.under_torque(), 16);
    (0..60).for_each(|_| rig.cycle().expect("exchange"));
    assert_eq!(rig.hand.under_torque(), 0);
    assert_eq!(rig.state.status, [JointStatus::TorqueOff; 16]);
}

#[test]
fn turning_off_while_a_motor_starts_again_leaves_none_under_torque() {
    let mut rig = Rig::new(LeapOptions::right());
    let j = rig.joint(6);
    rig.hand.fail(6, hardware_error::OVERLOAD);
    rig.until("reboot", |s| s.status[j] == JointStatus::Recovering);
    rig.leap.turn_off().expect("off");
    assert_eq!(rig.hand.under_torque(), 0);
    for _ in 0..400 {
        rig.cycle().expect("exchange");
        assert_eq!(rig.hand.under_torque(), 0);
    }
    assert_eq!(rig.state.status, [JointStatus::TorqueOff; 16]);
    rig.leap.turn_on().expect("on again");
    rig.until("contact", |s| s.effort == [200.0; 16]);
}

#[test]
fn another_program_that_switches_a_motor_on_is_noticed() {
    let mut rig = Rig::new(LeapOptions::right());
    rig.leap.turn_off().expect("off");
    let mut other = Bus::new(rig.hand.port(), Timing::for_latency(Duration::ZERO));
    other.set(8, table::TORQUE_ENABLE, 1).expect("done");
    (0..60).for_each(|_| rig.cycle().expect("exchange"));
    assert_eq!(rig.hand.under_torque(), 0);
}
