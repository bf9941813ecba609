//! COLMAP, another program, for the cameras of photos; and how such programs are run.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use drex_core::camera::CameraModel;
use drex_core::capture::{Capture, CaptureOptions, PhotoFile, photo_size, photos_in};
use drex_core::fsutil::{argument, output_path, write_atomic};
use drex_core::program::{self, Outcome};
use drex_core::{Error, Result};

/// How COLMAP is run.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ColmapOptions {
    /// The program, a name on the path or a file.
    pub program: PathBuf,
    /// Longest side at which features are looked for, pixels.
    pub max_side: usize,
    /// Features per photo.
    pub max_features: usize,
    /// The lens that is fitted.
    pub lens: CameraModel,
    /// Whether photos of one folder and size share a camera; not for photos taken with zoom, or cropped.
    pub shared_lens: bool,
    /// Match each photo with its neighbours by name only, as for the frames of a video; `None` does so above 200 photos.
    pub sequential: Option<bool>,
    /// Threads; 0 for all.
    pub threads: usize,
    /// Whether COLMAP may use a GPU. Not every build can.
    pub gpu: bool,
    /// Share of the photos, 0 to 1, that must get a camera that is no outlier.
    pub least_registered: f64,
    /// Each of COLMAP's steps is stopped after this time.
    pub time_limit: Duration,
}

/// Time for a step of COLMAP or for a video, where nobody says otherwise.
pub(crate) const TIME_LIMIT: Duration = Duration::from_secs(12 * 3600);

impl Default for ColmapOptions {
    fn default() -> Self {
        Self {
            program: "colmap".into(),
            max_side: 1600,
            max_features: 4096,
            lens: CameraModel::SimpleRadial,
            shared_lens: true,
            sequential: None,
            threads: 0,
            gpu: false,
            least_registered: 0.6,
            time_limit: TIME_LIMIT,
        }
    }
}

/// Lets COLMAP find the cameras of the photos in `folder` (`images`, or `photos`, `input`, or the folder itself) and
/// loads what it found. COLMAP works in `work/attempt`; a model that is good enough moves to `work/sparse`, replacing the one
/// there. Nothing is written beside the photos.
///
/// `progress` gets each line that COLMAP prints.
///
/// # Errors
/// If COLMAP is not installed, fails or takes too long, or if it finds cameras for too few photos; the message names those
/// without.
pub fn find_cameras(
    folder: &Path,
    work: &Path,
    capture: &CaptureOptions,
    options: &ColmapOptions,
    progress: &mut dyn FnMut(&str),
) -> Result<Capture> {
    let Some((root, photos)) = photos_in(folder, capture) else {
        return refuse(format!("{} has no photos", folder.display()), "put at least three into the folder images");
    };
    if photos.len() < 3 {
        let what =
            format!("{} has only {} photo{}", root.display(), photos.len(), if photos.len() == 1 { "" } else { "s" });
        return refuse(what, "take photos all round the object, each showing most of what the one before showed");
    }
    let (attempt, sparse) = (output_path(work, "attempt")?, output_path(work, "sparse")?);
    clear(&attempt)?;
    let found = attempt.join("sparse");
    let made: Vec<&Path> = attempt.ancestors().skip(1).take_while(|f| !f.exists()).collect();
    std::fs::create_dir_all(&found).map_err(|e| Error::io("create", &found, e))?;
    run_all(options, &root, &photos, &attempt, progress).inspect_err(|_| {
        // Nothing half-written; of the folders round it only empty ones go, and one that stays is no error.
        drop(clear(&attempt));
        made.iter().for_each(|f| drop(std::fs::remove_dir(f)));
    })?;

    let mut within = capture.clone();
    within.images = Some(root);
    let Some(mut result) = Capture::load_model(folder, &found, &within)? else {
        return refuse(
            format!("COLMAP found no cameras for the {} photos of {}", photos.len(), folder.display()),
            "take sharp photos with texture in view, each overlapping the one before by two thirds",
        );
    };
    let report = result.report()?;
    let outliers = report.outlier_cameras();
    let good = result.views.len() - outliers.len();
    let without =
        |names: &[String]| if names.is_empty() { String::new() } else { format!("; without: {}", names.join(", ")) };
    let likely_wrong = |names: &[&str]| {
        if names.is_empty() { String::new() } else { format!("; likely wrong: {}", names.join(", ")) }
    };
    let summary = format!(
        "COLMAP found cameras for {} of {} photos{}{}",
        result.views.len(),
        photos.len(),
        without(&result.unregistered),
        likely_wrong(&outliers)
    );
    if (good as f64) < options.least_registered * photos.len() as f64 {
        return refuse(
            format!("{summary}; {:.0} % are needed", 100.0 * options.least_registered),
            "take more photos between these and the others, or lower the share that is needed",
        );
    }
    clear(&sparse)?;
    std::fs::rename(&found, &sparse).map_err(|e| Error::io("move", &found, e))?;
    result.notes.push(format!("{summary}."));
    Ok(result)
}

/// Removes a folder that may not be there.
pub(crate) fn clear(folder: &Path) -> Result<()> {
    match std::fs::remove_dir_all(folder) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io("remove", folder, e)),
        _ => Ok(()),
    }
}

const INSTALL: &str = "install COLMAP (Debian, Ubuntu: apt install colmap; macOS: brew install colmap; \
                       Windows: https://colmap.github.io/install.html), or put a model into sparse/0";

/// The steps of a reconstruction, one after the other.
fn run_all(
    options: &ColmapOptions,
    root: &Path,
    photos: &[PhotoFile],
    work: &Path,
    progress: &mut dyn FnMut(&str),
) -> Result<()> {
    let (root, work) = (&argument(root), &argument(work));
    let threads = if options.threads == 0 { "-1".to_owned() } else { options.threads.to_string() };
    let gpu = if options.gpu { "1" } else { "0" };

    // Photos of one folder and size share a camera; COLMAP is run once for each such group.
    for group in groups(photos)? {
        let list = work.join("photos.txt");
        if let Some(name) = group.iter().find(|name| name.contains(['\n', '\r'])) {
            return refuse(format!("the photo {name:?} has a line break in its name"), "rename it");
        }
        write_atomic(&list, group.join("\n").as_bytes())?;
        let mut extract = Step::new(options, "feature_extractor", work)?;
        extract.command.arg("--image_path").arg(root).arg("--image_list_path").arg(list);
        extract.set(&["ImageReader"], "camera_model", options.lens.name());
        extract.set(&["ImageReader"], "single_camera", if options.shared_lens { "1" } else { "0" });
        extract.set(&["FeatureExtraction", "SiftExtraction"], "use_gpu", gpu);
        extract.set(&["FeatureExtraction", "SiftExtraction"], "num_threads", &threads);
        extract.set(&["FeatureExtraction", "SiftExtraction"], "max_image_size", &options.max_side.to_string());
        extract.set(&["SiftExtraction"], "max_num_features", &options.max_features.to_string());
        extract.run(progress)?;
    }

    let sequential = options.sequential.unwrap_or(photos.len() > 200);
    let matcher = if sequential { "sequential_matcher" } else { "exhaustive_matcher" };
    let mut match_up = Step::new(options, matcher, work)?;
    match_up.set(&["FeatureMatching", "SiftMatching"], "use_gpu", gpu);
    match_up.set(&["FeatureMatching", "SiftMatching"], "num_threads", &threads);
    match_up.run(progress)?;

    let mut map = Step::new(options, "mapper", work)?;
    map.command.arg("--image_path").arg(root).arg("--output_path").arg(work.join("sparse"));
    map.set(&["Mapper"], "num_threads", &threads);
    map.run(progress)
}

/// One step of COLMAP. Its options change names from version to version, so its help is read first.
struct Step {
    name: String,
    command: Command,
    help: String,
    limit: Duration,
}

impl Step {
    fn new(options: &ColmapOptions, step: &str, work: &Path) -> Result<Self> {
        let start = || {
            let mut command = Command::new(&options.program);
            // Its library for windows must not look for a screen.
            command.env("QT_QPA_PLATFORM", "offscreen").arg(step).stdout(Stdio::piped());
            command
        };
        let name = format!("COLMAP's {step}");
        let mut ask = start();
        ask.arg("--help");
        let mut help = String::new();
        run(ask, &name, INSTALL, options.time_limit, &mut |line| {
            help.push_str(line);
            help.push('\n');
        })?;
        let mut command = start();
        command.arg("--database_path").arg(work.join("database.db"));
        Ok(Self { name, command, help, limit: options.time_limit })
    }

    /// Sets an option under the first of its prefixes that this version knows; one that it does not know keeps its default.
    fn set(&mut self, prefixes: &[&str], option: &str, value: &str) {
        let known = |prefix: &&str| self.help.contains(&format!("--{prefix}.{option} "));
        if let Some(prefix) = prefixes.iter().find(|p| known(p)) {
            self.command.args([&format!("--{prefix}.{option}"), value]);
        }
    }

    fn run(self, progress: &mut dyn FnMut(&str)) -> Result<()> {
        progress(&format!("{} starts.", self.name));
        run(self.command, &self.name, INSTALL, self.limit, progress)
    }
}

/// Names of the photos that are of one folder and one size, group by group.
fn groups(photos: &[PhotoFile]) -> Result<Vec<Vec<&str>>> {
    let mut groups = BTreeMap::<_, Vec<_>>::new();
    for PhotoFile { name, path } in photos {
        let size = photo_size(path)?;
        groups.entry((path.parent(), size)).or_default().push(name.as_str());
    }
    Ok(groups.into_values().collect())
}

/// Runs a program to its end; each line of its errors, and of its output if that is piped, goes to `progress`.
pub(crate) fn run(
    mut command: Command,
    name: &str,
    install: &str,
    limit: Duration,
    progress: &mut dyn FnMut(&str),
) -> Result<()> {
    const LAST_LINES: usize = 12;
    let program = command.get_program().to_owned();
    command.stderr(Stdio::piped());
    let mut last = VecDeque::new();
    let outcome = program::run(command, None, limit, &mut |line| {
        progress(line);
        if last.len() == LAST_LINES {
            last.pop_front();
        }
        last.push_back(line.to_owned());
    });
    let fail = |what: String, remedy: &str| Err(Error::tool(what, remedy));
    let mut said = || match last.make_contiguous() {
        [] => String::new(),
        lines => format!("; it said last:\n{}\n", lines.join("\n")),
    };
    match outcome {
        Ok(Outcome::Ended(status)) if status.success() => Ok(()),
        Ok(Outcome::Ended(status)) => {
            fail(format!("{name} failed ({status}){}", said()), "read these lines for the reason")
        }
        Ok(Outcome::TimedOut) => {
            let minutes = limit.as_secs_f64() / 60.0;
            let what = format!("{name} had not ended after {minutes:.2} minutes and was stopped{}", said());
            fail(what, "give it less to do, or more time (drex: --tool-limit MINUTES)")
        }
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            fail(format!("{name} is not installed ({} was not found)", program.display()), install)
        }
        Err(e) => fail(format!("{name} cannot be run: {e}"), install),
    }
}

/// Shorthand for an error about a capture.
pub(crate) fn refuse<T>(what: impl Into<String>, remedy: impl Into<String>) -> Result<T> {
    Err(Error::capture(what, remedy))
}
