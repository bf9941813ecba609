//! What a bus needs of a port, and a pair of ports in memory.

use std::collections::VecDeque;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::{Clock, SystemClock};

/// How much of a hand is on, as its driver knows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Torque {
    /// The hand confirmed that its torque is off, or nobody has switched it on yet.
    #[default]
    Off,
    /// Switched on without torque: to be switched off when the program ends.
    Ready,
    /// Torque is on, or is about to be: to be taken off also when the program falls silent.
    On,
}

/// A stream of bytes to motors and back, and the clock that its waits are counted by.
pub trait Port: Clock {
    /// Name for messages.
    fn name(&self) -> &str;

    /// Reads what there is, waiting at most `wait` for a first byte. 0 means that nothing came.
    ///
    /// # Errors
    /// If the port is gone.
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize>;

    /// Writes all of `bytes`.
    ///
    /// # Errors
    /// If the port is gone or does not take the bytes.
    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Throws away what has arrived and was not read.
    ///
    /// # Errors
    /// If the port is gone.
    fn clear_input(&mut self) -> io::Result<()>;

    /// Sets the speed in baud.
    ///
    /// # Errors
    /// If the port cannot run at this speed.
    fn set_baud(&mut self, baud: u32) -> io::Result<()>;

    /// The speed in baud; `None` for a port that has none.
    fn baud(&self) -> Option<u32> {
        None
    }

    /// Opens the port again after it went away, at the same speed.
    ///
    /// # Errors
    /// If it is not back yet, or somebody else has it.
    fn reopen(&mut self) -> io::Result<()>;

    /// Is told by the driver how much of the hand is on, before it switches more on and after less is confirmed: a
    /// [guard](crate::guard) watches over it, other ports do nothing.
    ///
    /// # Errors
    /// If the port is gone.
    fn torque(&mut self, torque: Torque) -> io::Result<()> {
        let _ = torque;
        Ok(())
    }

    /// File in which the system keeps how long the adapter holds received bytes back before it hands them on, ms; only FTDI
    /// adapters have one.
    fn latency_file(&self) -> Option<PathBuf> {
        None
    }

    /// How long the adapter holds received bytes back, if the system tells.
    fn latency(&self) -> Option<Duration> {
        let text = std::fs::read_to_string(self.latency_file()?).ok()?;
        text.trim().parse().ok().map(Duration::from_millis)
    }
}

impl<P: Port + ?Sized> Port for Box<P> {
    fn name(&self) -> &str {
        (**self).name()
    }
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        (**self).read(buffer, wait)
    }
    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        (**self).write_all(bytes)
    }
    fn clear_input(&mut self) -> io::Result<()> {
        (**self).clear_input()
    }
    fn set_baud(&mut self, baud: u32) -> io::Result<()> {
        (**self).set_baud(baud)
    }
    fn baud(&self) -> Option<u32> {
        (**self).baud()
    }
    fn reopen(&mut self) -> io::Result<()> {
        (**self).reopen()
    }
    fn torque(&mut self, torque: Torque) -> io::Result<()> {
        (**self).torque(torque)
    }
    fn latency_file(&self) -> Option<PathBuf> {
        (**self).latency_file()
    }
    fn latency(&self) -> Option<Duration> {
        (**self).latency()
    }
}

/// Bytes on their way in one direction.
#[derive(Debug, Default)]
struct Pipe {
    bytes: Mutex<(VecDeque<u8>, bool)>,
    came: Condvar,
}

impl Pipe {
    /// The bytes and whether an end is closed. A panic elsewhere leaves them usable.
    fn lock(&self) -> MutexGuard<'_, (VecDeque<u8>, bool)> {
        self.bytes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One end of a pair of ports in memory, for two threads.
#[derive(Debug)]
pub struct MemoryPort {
    input: Arc<Pipe>,
    output: Arc<Pipe>,
    clock: SystemClock,
}

/// Two ports, each of which reads what the other writes.
pub fn memory_pair() -> (MemoryPort, MemoryPort) {
    let (a, b) = (Arc::new(Pipe::default()), Arc::new(Pipe::default()));
    let clock = SystemClock::default();
    (MemoryPort { input: a.clone(), output: b.clone(), clock }, MemoryPort { input: b, output: a, clock })
}

impl Clock for MemoryPort {
    fn now(&self) -> Duration {
        self.clock.now()
    }
}

impl Port for MemoryPort {
    fn name(&self) -> &str {
        "memory"
    }

    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        let (mut pipe, _) = self
            .input
            .came
            .wait_timeout_while(self.input.lock(), wait, |(bytes, closed)| bytes.is_empty() && !*closed)
            .unwrap_or_else(PoisonError::into_inner);
        if pipe.0.is_empty() && pipe.1 {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        let n = buffer.len().min(pipe.0.len());
        buffer.iter_mut().zip(pipe.0.drain(..n)).for_each(|(to, from)| *to = from);
        Ok(n)
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut pipe = self.output.lock();
        if pipe.1 {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        pipe.0.extend(bytes);
        drop(pipe);
        self.output.came.notify_all();
        Ok(())
    }

    fn clear_input(&mut self) -> io::Result<()> {
        self.input.lock().0.clear();
        Ok(())
    }

    fn set_baud(&mut self, _: u32) -> io::Result<()> {
        Ok(())
    }

    fn reopen(&mut self) -> io::Result<()> {
        if self.input.lock().1 { Err(io::ErrorKind::NotFound.into()) } else { Ok(()) }
    }
}

impl Drop for MemoryPort {
    fn drop(&mut self) {
        for pipe in [&self.input, &self.output] {
            pipe.lock().1 = true;
            pipe.came.notify_all();
        }
    }
}
