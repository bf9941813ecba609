//! From a video to key points, by a detector that runs beside this program.
//!
//! A detector is anything that takes a video and gives a [`Demonstration`]: [`MediaPipe`] by its Python wheel, or any command that writes a
//! file which [`Demonstration::load`] reads ([`ExternalDetector`]). A detector inside this program would be one more
//! implementation of [`HandDetector`].

mod temporary;

use std::collections::VecDeque;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use drex_core::fsutil::argument;
use drex_core::program::{self, Outcome};
use drex_core::{Error, Result};

use crate::{Demonstration, LoadOptions, Side};

/// Finds a hand in a video.
pub trait HandDetector {
    /// Name for messages and for the record of where key points come from.
    fn name(&self) -> &str;

    /// Key points of one hand in `video`. The options are those of [`Demonstration::load`]; side and mirroring also tell the detector
    /// which hand to look for.
    ///
    /// # Errors
    /// If the detector is not installed, fails, takes too long, or finds no hand in any frame.
    fn detect(&self, video: &Path, options: &LoadOptions) -> Result<Demonstration>;
}

/// The Python program that [`MediaPipe`] runs; it can be used by itself and says how.
pub const MEDIAPIPE_SCRIPT: &str = include_str!("mediapipe_hands.py");
/// The Python program that writes HaMeR's output as a file that is read here; it runs in HaMeR's environment and says how.
pub const HAMER_SCRIPT: &str = include_str!("hamer_export.py");

/// Exit states of our scripts that explain themselves in their last line.
const EXPLAINED: std::ops::RangeInclusive<i32> = 3..=5;
/// Lines of a failed command's messages that are shown.
const SHOWN_LINES: usize = 12;

/// A command that takes a video and writes a file of key points.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct ExternalDetector {
    /// Name for messages.
    pub name: String,
    /// Program.
    pub program: OsString,
    /// Arguments; `{video}` and `{out}` stand for the video and for the file to write, both absolute, so that no name is
    /// taken for an option.
    pub args: Vec<String>,
    /// Written to the program's standard input.
    pub stdin: Option<String>,
    /// Ending of the file it writes: `json`, `npz`, `npy` or `csv`.
    pub format: String,
    /// The program is ended after this time.
    pub timeout: Duration,
    /// What to do where the program is missing, for messages.
    pub install: String,
}

impl ExternalDetector {
    /// A detector that runs `program` with `args`, writes `.json`, and may take an hour.
    ///
    /// ```
    /// use drex_demo::ExternalDetector;
    ///
    /// let mut hamer = ExternalDetector::new("hamer", "/opt/hamer/venv/bin/python", &["hamer_export.py", "{video}", "{out}"]);
    /// hamer.format = "npz".into();
    /// ```
    pub fn new(name: impl Into<String>, program: impl Into<OsString>, args: &[&str]) -> Self {
        let (name, program) = (name.into(), program.into());
        let install = format!("install {} or give its path", program.to_string_lossy());
        Self {
            name,
            program,
            args: args.iter().map(|a| (*a).to_owned()).collect(),
            stdin: None,
            format: "json".into(),
            timeout: Duration::from_secs(3600),
            install,
        }
    }

    fn error(&self, what: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::value(format!("{}: {}", self.name, what.into()), remedy)
    }

    /// Runs the command and gives the bytes that it wrote and the path it was told.
    fn output(&self, video: &Path) -> Result<(PathBuf, Vec<u8>)> {
        if !video.is_file() {
            return Err(self.error(format!("{} is no file", video.display()), "give a video"));
        }
        let folder = temporary::temporary_folder().map_err(|e| self.error(e.to_string(), "check the disk"))?;
        let out = folder.path().join(format!("hand.{}", self.format));
        let video = argument(video);
        let fill = |arg: &String| -> OsString {
            match arg.as_str() {
                "{video}" => video.clone().into(),
                "{out}" => out.clone().into(),
                other => {
                    other.replace("{video}", &video.to_string_lossy()).replace("{out}", &out.to_string_lossy()).into()
                }
            }
        };
        let mut command = Command::new(&self.program);
        command.args(self.args.iter().map(fill)).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut last = VecDeque::new();
        let outcome = program::run(command, self.stdin.as_deref(), self.timeout, &mut |line| {
            if last.len() == SHOWN_LINES {
                last.pop_front();
            }
            last.push_back(line.trim_end().to_owned());
        });
        let lines = last.make_contiguous();
        let shown = if lines.is_empty() { String::new() } else { format!(":\n  {}\n", lines.join("\n  ")) };
        match outcome {
            Ok(Outcome::Ended(status)) if status.success() => {}
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
                let what = format!("the program {} is not there", self.program.to_string_lossy());
                return Err(self.error(what, self.install.clone()));
            }
            Err(e) => return Err(self.error(format!("it cannot be started: {e}"), self.install.clone())),
            Ok(Outcome::TimedOut) => {
                let what = format!("no end after {:.0} s, stopped{shown}", self.timeout.as_secs_f64());
                return Err(self.error(what, "give a shorter video or more time"));
            }
            Ok(Outcome::Ended(status))
                if status.code().is_some_and(|s| EXPLAINED.contains(&s)) && self.stdin.is_some() =>
            {
                // "what; what to do", written by our own script.
                let line = lines.last().map_or("no message", String::as_str);
                let (what, remedy) = line.split_once("; ").unwrap_or((line, "check the video"));
                return Err(self.error(what, remedy));
            }
            Ok(Outcome::Ended(status)) => {
                let status = status.code().map_or("a signal".into(), |s| format!("status {s}"));
                return Err(self.error(format!("it ended with {status}{shown}"), "run the command by hand to see why"));
            }
        }
        match std::fs::read(&out) {
            Ok(bytes) => Ok((out, bytes)),
            Err(e) => {
                let what = format!("it ended well but wrote no {} ({e}){shown}", out.display());
                Err(self.error(what, "have the command write its result to {out}"))
            }
        }
    }
}

impl HandDetector for ExternalDetector {
    fn name(&self) -> &str {
        &self.name
    }

    fn detect(&self, video: &Path, options: &LoadOptions) -> Result<Demonstration> {
        let (path, bytes) = self.output(video)?;
        let mut demo = Demonstration::parse(&path, &bytes, options)
            .map_err(|e| self.error(format!("what it wrote cannot be used: {e}"), "correct the command's output"))?;
        if demo.frames.iter().all(|f| f.points.iter().all(Option::is_none)) {
            let what = format!("{}: no hand found in {} frames", video.display(), demo.frames.len());
            return Err(self.error(what, "film one hand, whole, well lit and sharp"));
        }
        let name = video.file_name().unwrap_or_default();
        demo.source = format!("{} of {}", self.name, name.display());
        Ok(demo)
    }
}

/// MediaPipe's hand landmarks by its Python wheel: `pip install "mediapipe==0.10.14" opencv-python-headless`, the last line of wheels that
/// bring their models (0.10.21 is the last known to).
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct MediaPipe {
    /// The Python in which the packages are.
    pub python: OsString,
    /// Least confidence of a detection, 0 to 1.
    pub confidence: f64,
    /// The detector is ended after this time.
    pub timeout: Duration,
}

impl Default for MediaPipe {
    fn default() -> Self {
        Self { python: "python3".into(), confidence: 0.5, timeout: Duration::from_secs(3600) }
    }
}

impl MediaPipe {
    fn command(&self, options: &LoadOptions) -> ExternalDetector {
        let confidence = self.confidence.to_string();
        let mut args = vec!["-", "{video}", "{out}", "--confidence", &confidence];
        if options.mirrored {
            args.push("--mirrored");
        }
        match options.side {
            Some(Side::Right) => args.extend(["--side", "right"]),
            Some(Side::Left) => args.extend(["--side", "left"]),
            None => {}
        }
        let mut command = ExternalDetector::new(self.name(), &self.python, &args);
        command.stdin = Some(MEDIAPIPE_SCRIPT.into());
        command.timeout = self.timeout;
        command.install = "install Python 3.9 to 3.12, or give the path of one, then \
                           pip install \"mediapipe==0.10.14\" opencv-python-headless"
            .into();
        command
    }
}

impl HandDetector for MediaPipe {
    fn name(&self) -> &str {
        "mediapipe"
    }

    fn detect(&self, video: &Path, options: &LoadOptions) -> Result<Demonstration> {
        if !(0.0..=1.0).contains(&self.confidence) {
            return Err(Error::value(format!("a confidence of {}", self.confidence), "give 0 to 1"));
        }
        // The script turns mirrored pictures back before it looks at them.
        let load = LoadOptions { mirrored: false, ..options.clone() };
        self.command(options).detect(video, &load)
    }
}
