//! What the stages wrote about grasps.

use drex_twin::records::{Evaluation, ExecutionFile, FitFile, Training, TrialFile};

/// Demonstrations, training, evaluation, trial and execution of a twin.
pub(crate) struct Learned {
    pub fits: FitFile,
    pub training: Training,
    pub evaluation: Evaluation,
    pub trial: TrialFile,
    pub execution: ExecutionFile,
}
