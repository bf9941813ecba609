//! What a running stage tells whoever waits for it.

/// Receives how far work is. All methods may be called from several threads.
///
/// The unit type hears nothing: `twin.run(&options, &())`.
pub trait Progress: Sync {
    /// Says something worth reading: what was done, skipped or assumed.
    fn note(&self, _text: &str) {}

    /// Work of `steps` steps begins, or of an unknown number of them. Work that was at hand before is done.
    fn begin(&self, _label: &str, _steps: Option<u64>) {}

    /// The work at hand is after step `done`; `message` says how it goes, or is empty.
    fn at(&self, _done: u64, _message: &str) {}

    /// One more step of the work at hand is done.
    fn step(&self) {}

    /// The work at hand is done.
    fn end(&self) {}
}

impl Progress for () {}
