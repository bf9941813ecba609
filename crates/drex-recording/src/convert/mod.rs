//! Plain recordings made of the layouts of published sets: a folder with a `push.toml` and all that it names.

pub mod allegro_run;
pub mod mujoco_push;

use std::path::{Path, PathBuf};

use drex_core::fsutil::{self, OutputFolder};
use drex_core::{Error, Result};

use crate::PushConfig;

/// Writes `config`, whose paths start at `from`, as a recording that stands alone: copies the files that it names to `out`
/// and then writes `out/push.toml`, which names the copies. With `mesh` the recording names that file where it stands, and
/// no mesh is copied. Returns the path of the `push.toml`.
///
/// # Errors
/// If the push cannot be loaded (as [`PushConfig::load`]; nothing is written then), two of its files have the same name, or
/// a file cannot be written.
pub fn write_push(config: &PushConfig, from: &Path, out: &Path, mesh: Option<&Path>) -> Result<PathBuf> {
    config.load(from)?;
    let mut config = config.clone();
    let mut files = OutputFolder::new(out);
    let path = files.file("push.toml")?;
    let mut copy = |file: &mut PathBuf| {
        let source = from.join(&*file);
        let Some(name) = source.file_name() else {
            return Err(Error::content(&source, None, "the path names no file", "name the recorded file itself"));
        };
        let name = name.to_string_lossy().into_owned();
        fsutil::write_atomic(&files.file(&name)?, &fsutil::read_bytes(&source)?)?;
        *file = name.into();
        Ok(())
    };
    match mesh {
        Some(mesh) => config.mesh = fsutil::relative_path(mesh, out),
        None => copy(&mut config.mesh)?,
    }
    config.files_mut().into_iter().try_for_each(&mut copy)?;
    fsutil::write_atomic(&path, config.to_toml_string()?.as_bytes())?;
    Ok(path)
}
