//! How much memory the content of a file may take: one limit for the process, asked before memory is taken.
//!
//! A header of a few bytes can announce gigabytes, and a compressed file can unpack to a thousand times its size. Readers ask
//! here first and refuse by name; the limit is [`max_memory`], 4 GiB unless a program raises it with [`set_max_memory`]
//! (`drex --max-memory GB`).

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::{Error, Result};

/// The limit unless one is set, bytes: 4 GiB.
pub const DEFAULT_MAX_MEMORY: u64 = 4 << 30;
/// A compressed file may unpack to this many times its size whatever that is.
const EXPANSION: u64 = 64;
/// A compressed file of any size may unpack to this part of the limit.
const SMALL_PART: u64 = 64;

static MAX_MEMORY: AtomicU64 = AtomicU64::new(DEFAULT_MAX_MEMORY);

/// Most memory that the content of one file may take, bytes.
pub fn max_memory() -> u64 {
    MAX_MEMORY.load(Ordering::Relaxed)
}

/// Sets [`max_memory`] for the whole process; meant to be called once, before files are read.
pub fn set_max_memory(bytes: u64) {
    MAX_MEMORY.store(bytes, Ordering::Relaxed);
}

/// Asks for `bytes` of memory for `what` ("67000000 corners") of the file `path`.
///
/// # Errors
/// If that is more than [`max_memory`]; the message says both and how to raise the limit.
pub fn allow(path: &Path, what: impl std::fmt::Display, bytes: u64) -> Result<()> {
    within(path, what, bytes, max_memory())
}

/// Asks to unpack `packed` bytes of the file `path` to `unpacked` bytes. Files may become 64 times as large; small ones
/// more, up to 1/64 of [`max_memory`] (64 MiB); nothing may exceed [`max_memory`].
///
/// # Errors
/// As [`allow`].
pub fn allow_unpacked(path: &Path, packed: u64, unpacked: u64) -> Result<()> {
    within(path, format_args!("{packed} compressed bytes"), unpacked, unpacked_limit(packed))
}

/// Most bytes to which `packed` bytes may unpack, see [`allow_unpacked`].
pub fn unpacked_limit(packed: u64) -> u64 {
    packed.saturating_mul(EXPANSION).max(max_memory() / SMALL_PART).min(max_memory())
}

fn within(path: &Path, what: impl std::fmt::Display, bytes: u64, limit: u64) -> Result<()> {
    if bytes <= limit {
        return Ok(());
    }
    let mb = |bytes: u64| (bytes as f64 / 1e6).ceil();
    let what = format!("{what} would take {} MB, the limit is {} MB", mb(bytes), mb(limit));
    // What raises a part of the limit raises all of it.
    let enough = max_memory() as f64 * (bytes as f64 / limit as f64) / f64::from(1 << 30);
    let remedy = format!("give a smaller file, or raise the limit with --max-memory {:.0} (GB)", enough.ceil());
    Err(Error::content(path, None, what, remedy))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_too_large_is_refused_with_the_limit_and_the_option() {
        let path = Path::new("a.glb");
        assert!(allow(path, "7 corners", DEFAULT_MAX_MEMORY).is_ok());
        let message = allow(path, "7 corners", 2 * DEFAULT_MAX_MEMORY).unwrap_err().to_string();
        for part in ["a.glb", "7 corners", "8590 MB", "4295 MB", "--max-memory 8"] {
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn small_files_may_unpack_to_more_times_their_size_than_large_ones() {
        assert_eq!(unpacked_limit(100), 64 << 20);
        assert_eq!(unpacked_limit(2 << 20), 128 << 20);
        assert_eq!(unpacked_limit(u64::MAX), DEFAULT_MAX_MEMORY);
        let message = allow_unpacked(Path::new("a.spz"), 632_000, 650_000_000).unwrap_err().to_string();
        assert!(message.contains("632000 compressed bytes would take 650 MB") && message.contains("--max-memory 39"));
    }
}
