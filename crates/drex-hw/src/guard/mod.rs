//! A guard: a small process that owns the port, relays packets between the program and the hand, and takes the torque off when the program
//! dies, hangs, or the guard is told to end by a signal.
//!
//! A LEAP hand whose program was killed freezes by its bus watchdog with the torque on; an Allegro hand goes on pressing. Behind a guard both
//! lose their torque. Because the guard owns the port, a program that was stopped and wakes up cannot write to it any more: every call gives
//! an error that holds [`TakenOver`](crate::TakenOver), see [`Error::taken_over`](crate::Error::taken_over). When the guard dies first, the program opens the port
//! itself and takes the torque off.
//!
//! A program can be its own guard with one line at its beginning, and one option where it opens the hand:
//!
//! ```no_run
//! use drex_hw::guard::{GuardOptions, serve};
//! use drex_hw::leap::{LeapHand, LeapOptions};
//! use drex_robot::Robot;
//!
//! # fn main() -> drex_hw::Result<()> {
//! if std::env::args().nth(1).as_deref() == Some("guard") {
//!     return serve();
//! }
//! let guard = GuardOptions::this_program(["guard"])?;
//! let robot = Robot::bundled("leap_right")?;
//! let hand = LeapHand::open_guarded("/dev/ttyUSB0", &robot, LeapOptions::right(), &guard)?;
//! # drop(hand);
//! # Ok(())
//! # }
//! ```

mod device;
mod message;
mod off;
mod open;
mod options;
mod port;
mod serve;

pub use off::{SwitchOff, SwitchedOff, switch_off};
pub use options::GuardOptions;
pub use port::GuardedPort;
pub use serve::serve;
