//! One process at a time works on a folder: by a lock of the file system, or where there is none by a file that says who works there.
//!
//! Network file systems often have no locks, or, as NFS, none on a file that is open for reading. There `twin.busy` lies beside
//! `twin.toml` as long as somebody works. It names the process, which writes it again every [`HEARTBEAT`], and it is stale when that process
//! has ended; where this cannot be told from here (another host, a damaged file), when it was not written for [`STALE`].

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, SystemTime};

use drex_core::fsutil;
use serde::{Deserialize, Serialize};

use crate::error::Context;
use crate::{Error, Result};

/// Age after which a lock file is stale, unless its process is known to live.
const STALE: Duration = Duration::from_secs(600);
/// Time between two signs of life: some may get lost, and a network file system may show them a minute late.
const HEARTBEAT: Duration = Duration::from_secs(30);
/// Bytes of a lock file that are read.
const LONGEST: u64 = 1 << 12;

/// The right to work on a folder, which nobody else has until the value is dropped.
#[derive(Debug)]
pub struct Alone {
    _lock: File,
    _busy: Option<BusyFile>,
}

impl Alone {
    /// Takes the right to work on `folder` by a lock on `file`, which lies in it and which all who work there name. Where the file system
    /// has no locks, a file of the same name that ends in `.busy` takes its place.
    ///
    /// # Errors
    /// [`Error::Busy`] if another process works there; also if `file` cannot be opened, or the lock file not be written.
    pub fn take(file: &Path, folder: &Path) -> Result<Self> {
        Self::take_by(file, folder, File::try_lock, HEARTBEAT)
    }

    fn take_by(
        file: &Path,
        folder: &Path,
        try_lock: fn(&File) -> Result<(), TryLockError>,
        heartbeat: Duration,
    ) -> Result<Self> {
        let lock = File::open(file).with_context(|| format!("cannot read {}", file.display()))?;
        let busy = match try_lock(&lock) {
            Ok(()) => None,
            Err(TryLockError::WouldBlock) => {
                let who =
                    fsutil::lock_holder(&lock).unwrap_or_else(|| "a process that the system does not name".into());
                return Err(Error::Busy { folder: folder.to_path_buf(), who });
            }
            Err(TryLockError::Error(_)) => {
                let name = format!("{}.busy", file.file_stem().unwrap_or_default().to_string_lossy());
                Some(BusyFile::create(folder, &name, heartbeat)?)
            }
        };
        Ok(Self { _lock: lock, _busy: busy })
    }
}

/// The lock file of this process, written again and again until the value is dropped, which removes it.
#[derive(Debug)]
struct BusyFile {
    path: PathBuf,
    text: String,
    /// The heartbeat, which ends when the sender is dropped.
    heart: Option<(Sender<()>, JoinHandle<()>)>,
}

impl BusyFile {
    fn create(folder: &Path, name: &str, heartbeat: Duration) -> Result<Self> {
        let holder = toml::to_string(&Holder::this()).map_err(|e| Error::Refused(format!("{name}: {e}")))?;
        let text =
            format!("# Written by drex: who works on this folder. Delete it only if that process has ended.\n{holder}");
        let path = create_alone(folder, name, &text)?;
        let mut busy = Self { path: path.clone(), text: text.clone(), heart: None };
        let (stop, stopped) = channel::<()>();
        let beat = move || {
            while stopped.recv_timeout(heartbeat) == Err(RecvTimeoutError::Timeout) {
                // One that fails (server away, disk full) is made up for by the next.
                let _ = write_again(&path, &text);
            }
        };
        let thread = Builder::new().name("heartbeat".into()).spawn(beat).context("cannot start a thread")?;
        busy.heart = Some((stop, thread));
        Ok(busy)
    }
}

impl Drop for BusyFile {
    fn drop(&mut self) {
        if let Some((stop, thread)) = self.heart.take() {
            drop(stop);
            let _ = thread.join(); // It does not panic.
        }
        // A file that somebody took over is theirs; one that cannot be removed is stale when this process has ended.
        if fs::read_to_string(&self.path).is_ok_and(|text| text == self.text) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Writes the file's `text` over itself, so that the file system dates it; not over that of somebody who took it over.
fn write_again(path: &Path, text: &str) -> io::Result<()> {
    // Opened each time: some servers date a file when it is closed.
    let mut file = OpenOptions::new().read(true).write(true).open(path)?;
    let mut is = String::new();
    file.read_to_string(&mut is)?;
    if is == text {
        file.rewind()?;
        file.write_all(text.as_bytes())?;
    }
    Ok(())
}

/// Creates the lock file `name` in `folder`, also in place of a stale one; of several who try, one succeeds.
fn create_alone(folder: &Path, name: &str, text: &str) -> Result<PathBuf> {
    let path = fsutil::output_path(folder, name)?;
    loop {
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(mut file) => {
                let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
                if written.is_err() {
                    // Ours, and of no use half-written; the error that is handed on says why.
                    let _ = fs::remove_file(&path);
                }
                return written.map(|()| path.clone()).with_context(|| format!("cannot write {}", path.display()));
            }
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(e).with_context(|| format!("cannot create {}", path.display())),
        }
        if let Some(who) = at_work(&path)? {
            return Err(Error::Busy { folder: folder.to_path_buf(), who });
        }
        // One at a time looks again and removes it: a slow one could else remove what a quick one has put in its place.
        let takeover = create_alone(folder, &format!("{name}.takeover"), text)?;
        let removed = match at_work(&path) {
            Ok(None) if path.exists() => {
                fs::remove_file(&path).with_context(|| format!("cannot remove {}", path.display()))
            }
            other => other.map(drop),
        };
        fs::remove_file(&takeover).with_context(|| format!("cannot remove {}", takeover.display()))?;
        removed?;
    }
}

/// Who works by the lock file at `path`; `None` if it is stale or gone.
fn at_work(path: &Path) -> Result<Option<String>> {
    let failed = || format!("cannot read {}", path.display());
    let mut metadata = match fs::symlink_metadata(path) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        metadata => metadata.with_context(failed)?,
    };
    let mut text = String::new();
    // What is no file, or not readable, is damaged, and opening a pipe would wait for ever.
    if metadata.is_file()
        && let Ok(file) = File::open(path)
    {
        metadata = file.metadata().with_context(failed)?;
        let _ = file.take(LONGEST).read_to_string(&mut text);
    }
    let holder: Option<Holder> = toml::from_str(&text).ok();
    let who = match &holder {
        Some(Holder { pid, host, .. }) => format!("process {pid} of host {host:?}"),
        None => "a process that is not named".into(),
    };
    if let Some(lives) = holder.and_then(|h| h.lives()) {
        return Ok(lives.then_some(who));
    }
    let now = now_beside(path).with_context(|| format!("cannot write beside {}", path.display()))?;
    let age = now.duration_since(metadata.modified().with_context(failed)?).unwrap_or_default();
    let (seconds, limit, path) = (age.as_secs(), STALE.as_secs(), path.display());
    let seen =
        format!("{who}, which wrote {path} {seconds} s ago (after {limit} s without that it is taken to have ended)");
    Ok((age <= STALE).then_some(seen))
}

/// Now by the clock that dates the files beside `path`, which is another host's on a network file system.
fn now_beside(path: &Path) -> io::Result<SystemTime> {
    static PROBES: AtomicUsize = AtomicUsize::new(0);
    loop {
        let number = PROBES.fetch_add(1, Ordering::Relaxed).to_string();
        let probe = fsutil::temporary_path(&path.with_added_extension(number));
        let mut file = match OpenOptions::new().write(true).create_new(true).open(&probe) {
            // That of another host, where a process has this number, too.
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => continue,
            file => file?,
        };
        let now = file.write_all(b"\n").and_then(|()| file.sync_all()).and_then(|()| file.metadata()?.modified());
        let _ = fs::remove_file(&probe); // The next run removes what was left.
        return now;
    }
}

/// A process that works on a folder.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Holder {
    host: String,
    /// Start of the system and namespace within which the process id counts, where the system tells; containers may share a host name.
    system: String,
    pid: u32,
    /// Start of the process in ticks since that of the system, where it tells: process ids are used again.
    started: Option<u64>,
}

impl Holder {
    /// This process.
    fn this() -> Self {
        let boot = fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        let namespace = fs::read_link("/proc/self/ns/pid").unwrap_or_default();
        let pid = std::process::id();
        let started = state_and_start(pid).map(|(_, started)| started);
        Self { host: host(), system: format!("{} {}", boot.trim(), namespace.display()), pid, started }
    }

    /// Whether the process lives; `None` where this cannot be told from here.
    fn lives(&self) -> Option<bool> {
        let this = Self::this();
        if (&self.host, &self.system) != (&this.host, &this.system) {
            return None;
        }
        if has_ended(self.pid) {
            return Some(false);
        }
        let (state, started) = state_and_start(self.pid)?;
        // A zombie has ended, and waits for its parent.
        Some(!matches!(state, 'Z' | 'X') && self.started.is_none_or(|s| s == started))
    }
}

/// State of a process and its start in ticks since that of the system, on Linux.
fn state_and_start(pid: u32) -> Option<(char, u64)> {
    let stat = fs::read(format!("/proc/{pid}/stat")).ok()?;
    // "4242 (name, with any sign) S …": the state is the third field, the start the 22nd.
    let stat = String::from_utf8_lossy(&stat);
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    Some((fields.first()?.chars().next()?, fields.get(19)?.parse().ok()?))
}

/// Whether there is no process of this number; others that may not be seen are there.
#[cfg(unix)]
fn has_ended(pid: u32) -> bool {
    use rustix::process::{Pid, test_kill_process};
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
    pid.is_some_and(|pid| test_kill_process(pid) == Err(rustix::io::Errno::SRCH))
}

#[cfg(not(unix))]
fn has_ended(_pid: u32) -> bool {
    false
}

#[cfg(unix)]
pub(crate) fn host() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

#[cfg(not(unix))]
pub(crate) fn host() -> String {
    std::env::var("COMPUTERNAME").unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use tempfile::TempDir;

    use super::*;

    #[test]
    fn where_there_are_locks_the_system_names_who_holds_one() {
        let dir = folder();
        let take = || Alone::take(&dir.path().join("twin.toml"), dir.path());
        let held = take().unwrap();
        let who = if cfg!(target_os = "linux") { std::process::id().to_string() } else { "process".into() };
        refused(take(), &[&dir.path().display().to_string(), &who, "wait until it is done"]);
        assert_eq!(names(&dir), ["twin.toml"]);
        drop(held);
        take().unwrap();
    }

    #[test]
    fn where_there_are_none_a_file_says_who_works() {
        let dir = folder();
        let held = take(&dir).unwrap();
        assert_eq!(names(&dir), ["twin.busy", "twin.toml"]);
        refused(
            take(&dir),
            &[&format!("process {} of host {:?}", std::process::id(), host()), "wait until it is done"],
        );
        // Another file is another right.
        fs::write(dir.path().join("journal.csv"), "").unwrap();
        drop(Alone::take_by(&dir.path().join("journal.csv"), dir.path(), no_locks, HEARTBEAT).unwrap());
        drop(held);
        assert_eq!(names(&dir), ["journal.csv", "twin.toml"]);
        take(&dir).unwrap();
    }

    /// Not a test of its own: the process that the next one starts and kills.
    #[test]
    fn a_process_that_holds_a_folder() {
        let Some(folder) = std::env::var_os("DREX_TEST_HOLDS") else { return };
        let folder = Path::new(&folder);
        let _held = Alone::take_by(&folder.join("twin.toml"), folder, no_locks, HEARTBEAT).unwrap();
        std::thread::sleep(Duration::from_secs(60));
    }

    #[cfg(unix)]
    #[test]
    fn a_process_is_waited_for_until_it_is_killed() {
        let dir = folder();
        let mut child = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "alone::tests::a_process_that_holds_a_folder"])
            .env("DREX_TEST_HOLDS", dir.path())
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        let busy = dir.path().join("twin.busy");
        let mut text = String::new();
        eventually(|| {
            text = fs::read_to_string(&busy).unwrap_or_default();
            text.contains("pid = ")
        });
        refused(take(&dir), &[&format!("process {} ", child.id())]);
        // A known process need not give signs of life; it may have been stopped.
        if cfg!(target_os = "linux") {
            age(&busy, 2 * STALE);
            refused(take(&dir), &[&format!("process {} ", child.id())]);
        }
        child.kill().unwrap();
        if cfg!(target_os = "linux") {
            // Before anybody waited for it.
            eventually(|| take(&dir).is_ok());
        }
        child.wait().unwrap();
        fs::write(&busy, text).unwrap();
        take(&dir).unwrap();
        assert_eq!(names(&dir), ["twin.toml"]);
    }

    #[test]
    fn who_is_taken_to_have_ended() {
        let this = Holder::this();
        let elsewhere = Holder { host: "node7".into(), ..this.clone() };
        let restarted = Holder { system: "another".into(), ..this.clone() };
        let impossible = Holder { pid: u32::MAX, ..this.clone() };
        let mut cases = vec![
            (toml::to_string(&elsewhere).unwrap(), "of host \"node7\", which wrote"),
            (toml::to_string(&restarted).unwrap(), "which wrote"),
            (toml::to_string(&impossible).unwrap(), "which wrote"),
            (String::new(), "a process that is not named"),
            ("host = \"node7\"".into(), "a process that is not named"),
            ("\0".repeat(2 * LONGEST as usize), "a process that is not named"),
        ];
        if cfg!(target_os = "linux") {
            // That of this process, by a program that does not say since when it runs.
            cases.push((toml::to_string(&Holder { started: None, ..this.clone() }).unwrap(), ""));
        }
        for (text, who) in cases {
            let dir = folder();
            let busy = dir.path().join("twin.busy");
            fs::write(&busy, &text).unwrap();
            age(&busy, STALE - Duration::from_secs(60));
            refused(take(&dir), &[who]);
            assert_eq!(fs::read_to_string(&busy).unwrap(), text);
            age(&busy, STALE + Duration::from_secs(60));
            match who {
                "" => refused(take(&dir), &[]),
                _ => drop(take(&dir).unwrap()),
            }
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_number_that_another_process_has_now_is_stale_at_once() {
        let (dir, this) = (folder(), Holder::this());
        let reused = Holder { started: this.started.map(|s| s - 1), ..this };
        fs::write(dir.path().join("twin.busy"), toml::to_string(&reused).unwrap()).unwrap();
        take(&dir).unwrap();
    }

    #[test]
    fn of_many_who_find_a_stale_file_one_takes_over() {
        let stale = toml::to_string(&Holder { host: "node7".into(), ..Holder::this() }).unwrap();
        for round in 0..200 {
            let dir = folder();
            // In some rounds one was killed while it took over.
            for name in ["twin.busy", "twin.busy.takeover"].iter().take(1 + round % 2) {
                fs::write(dir.path().join(name), &stale).unwrap();
                age(&dir.path().join(name), 2 * STALE);
            }
            let barrier = Barrier::new(6);
            let taken: Vec<_> = std::thread::scope(|scope| {
                let one = || {
                    barrier.wait();
                    take(&dir)
                };
                let all: Vec<_> = (0..6).map(|_| scope.spawn(one)).collect();
                all.into_iter().map(|thread| thread.join().unwrap()).collect()
            });
            let (won, lost): (Vec<_>, Vec<_>) = taken.into_iter().partition(Result::is_ok);
            assert_eq!(won.len(), 1, "round {round}: {lost:?}");
            lost.into_iter().for_each(|other| refused(other, &[]));
            drop(won);
            assert_eq!(names(&dir), ["twin.toml"], "round {round}");
        }
    }

    #[test]
    fn who_works_gives_signs_of_life() {
        let dir = folder();
        let held =
            Alone::take_by(&dir.path().join("twin.toml"), dir.path(), no_locks, Duration::from_millis(5)).unwrap();
        let busy = dir.path().join("twin.busy");
        let text = fs::read_to_string(&busy).unwrap();
        age(&busy, 2 * STALE);
        let is_fresh = || fs::metadata(&busy).unwrap().modified().unwrap().elapsed().is_ok_and(|age| age < STALE);
        eventually(is_fresh);
        assert_eq!(fs::read_to_string(&busy).unwrap(), text);
        // Whoever took it over is left alone.
        fs::write(&busy, "another").unwrap();
        age(&busy, 2 * STALE);
        std::thread::sleep(Duration::from_millis(50));
        assert!(!is_fresh());
        drop(held);
        assert_eq!(fs::read_to_string(&busy).unwrap(), "another");
        assert!(HEARTBEAT * 4 <= STALE);
    }

    #[cfg(unix)]
    #[test]
    fn no_link_is_followed_and_no_pipe_is_waited_for() {
        let dir = folder();
        let busy = dir.path().join("twin.busy");
        let outside = tempfile::tempdir().unwrap();
        for target in ["there", "not there"] {
            fs::write(outside.path().join("there"), "kept").unwrap();
            std::os::unix::fs::symlink(outside.path().join(target), &busy).unwrap();
            let message = take(&dir).unwrap_err().to_string();
            assert!(message.contains("this is a link"), "{message}");
            assert_eq!(fs::read_to_string(outside.path().join("there")).unwrap(), "kept");
            assert!(!outside.path().join("not there").exists());
            fs::remove_file(&busy).unwrap();
        }
        assert!(std::process::Command::new("mkfifo").arg(&busy).status().unwrap().success());
        refused(take(&dir), &["a process that is not named"]);
    }

    /// A folder with a manifest.
    fn folder() -> TempDir {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("twin.toml"), "").unwrap();
        dir
    }

    /// As [`Alone::take`] where the file system has no locks.
    fn take(dir: &TempDir) -> Result<Alone> {
        Alone::take_by(&dir.path().join("twin.toml"), dir.path(), no_locks, HEARTBEAT)
    }

    fn no_locks(_: &File) -> Result<(), TryLockError> {
        Err(TryLockError::Error(io::ErrorKind::Unsupported.into()))
    }

    fn refused(taken: Result<Alone>, words: &[&str]) {
        let error = taken.unwrap_err();
        assert!(matches!(error, Error::Busy { .. }), "{error:?}");
        let message = error.to_string();
        assert!(words.iter().all(|word| message.contains(word)), "{words:?}: {message}");
    }

    fn names(dir: &TempDir) -> Vec<String> {
        let entries = fs::read_dir(dir.path()).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// Makes the file look as if it had been written so long ago.
    fn age(path: &Path, age: Duration) {
        File::options().write(true).open(path).unwrap().set_modified(SystemTime::now() - age).unwrap();
    }

    fn eventually(mut done: impl FnMut() -> bool) {
        let until = std::time::Instant::now() + Duration::from_secs(30);
        while !done() {
            assert!(std::time::Instant::now() < until, "it did not happen");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
