//! What stands for the GPU in a build without one.

use drex_core::{Error, Result};

use crate::kernel::Window;
use crate::patchmatch::{Field, Matcher, Pass};

/// A GPU that nobody has.
pub(crate) enum Gpu {}

impl Gpu {
    /// # Errors
    /// Always.
    pub fn new<const G: usize>(_: &Window<G>) -> Result<Self> {
        Err(Error::Gpu {
            what: "this program was built without a GPU".into(),
            remedy: "build it with `--features wgpu`, or use the processor".into(),
        })
    }

    pub fn passes<const G: usize>(&self, _: &Matcher<'_, G>, _: &mut Field, _: &[Pass]) -> Result<()> {
        match *self {}
    }

    pub fn deviations<const G: usize>(&self, _: &Matcher<'_, G>, _: &Field) -> Result<Vec<f32>> {
        match *self {}
    }
}
