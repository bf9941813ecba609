//! Locks of the system on files.

use std::fs::File;

/// The process that holds the `flock` lock on `file`, such as "process 4242 (drex)", where the system lists locks: on Linux.
pub fn lock_holder(file: &File) -> Option<String> {
    let inode = format!(":{}", inode(file)?);
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

#[cfg(unix)]
fn inode(file: &File) -> Option<u64> {
    Some(std::os::unix::fs::MetadataExt::ino(&file.metadata().ok()?))
}

#[cfg(not(unix))]
fn inode(_file: &File) -> Option<u64> {
    None
}
