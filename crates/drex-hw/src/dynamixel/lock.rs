//! One process per serial device: a lock on the device that also binds root, and who holds it.

use std::fs::File;
use std::io;
use std::path::Path;

use drex_core::fsutil::lock_holder;
use rustix::fs::{FlockOperation, Mode, OFlags, flock, open};

/// Locks `device` for this process until the file is dropped.
///
/// # Errors
/// If the device is not there or somebody else has it; then the message says who.
pub(crate) fn lock_device(device: &Path) -> io::Result<File> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let file = File::from(open(device, flags, Mode::empty())?);
    match flock(&file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => Ok(file),
        Err(rustix::io::Errno::WOULDBLOCK) => {
            let who = lock_holder(&file).unwrap_or_else(|| "another process".into());
            Err(io::Error::new(io::ErrorKind::ResourceBusy, format!("in use by {who}")))
        }
        Err(e) => Err(e.into()),
    }
}
