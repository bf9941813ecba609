//! Why a report cannot be made.

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong while a report is made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// What a stage wrote cannot be shown; the message says what is wrong.
    #[error("{0}")]
    Refused(String),
    /// The twin's object or records cannot be read.
    #[error(transparent)]
    Twin(#[from] drex_twin::Error),
    /// A file could not be read or written.
    #[error(transparent)]
    Core(#[from] drex_core::Error),
    /// A record cannot be put into the page.
    #[error("{0}")]
    Json(String),
    /// The hand's model cannot be read.
    #[error(transparent)]
    Robot(#[from] drex_robot::Error),
    /// A mesh cannot be drawn.
    #[error(transparent)]
    Mesh(#[from] drex_mesh::Error),
    /// The photos of the scan cannot be read.
    #[error(transparent)]
    Splat(#[from] drex_splat::Error),
    /// A picture cannot be encoded.
    #[error("cannot encode the picture as PNG: {0}")]
    Png(String),
}
