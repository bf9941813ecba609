//! One process per serial device: a lock on the device that also binds root, and who holds it.

use std::fs::File;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

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
            let who = holder(&file).unwrap_or_else(|| "another process".into());
            Err(io::Error::new(io::ErrorKind::ResourceBusy, format!("in use by {who}")))
        }
        Err(e) => Err(e.into()),
    }
}

/// The process that holds the lock on `file`, as the system's list of locks has it.
fn holder(file: &File) -> Option<String> {
    let inode = format!(":{}", file.metadata().ok()?.ino());
    let locks = std::fs::read_to_string("/proc/locks").ok()?;
    // "1: FLOCK  ADVISORY  WRITE 4242 00:18:3 0 EOF"
    let pid = locks.lines().find_map(|line| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let (kind, pid, place) = (words.get(1)?, words.get(4)?, words.get(5)?);
        (*kind == "FLOCK" && place.ends_with(&inode)).then(|| (*pid).to_owned())
    })?;
    let name = std::fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
    Some(format!("process {pid} ({})", name.trim()))
}
