//! What a run has cost so far, where the system tells, and how it may cost less.

/// Processor time of this process, all threads, seconds; `None` where the system does not tell (Linux does).
pub fn core_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // After the name in parentheses: state, 10 numbers, then user and system time in ticks of 1/100 s.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / 100.0)
}

/// The most memory this process has held, bytes; `None` where the system does not tell (Linux does).
pub fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse::<u64>().ok().map(|kib| kib * 1024)
}

/// Makes glibc's allocator keep the images of one step for the next: it gives blocks back to the system, and has them
/// mapped and cleared anew, until it has seen a larger one freed. A tenth of the time of training; other allocators are
/// not touched by it.
pub(crate) fn keep_freed_blocks() {
    drop(std::hint::black_box(vec![0_u8; 31 << 20]));
}
