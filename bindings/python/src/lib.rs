//! The Python package `drex`: the pipeline of a twin, masses from recorded pushes, grasps and their trials, hands of people on robot
//! hands, sim-ready assets, simulation with derivatives, kinematics. What it offers is in `python/drex/_drex.pyi`, how to use it in `README.md`.

mod arrays;
mod batch;
mod failure;
mod grasp;
mod mesh;
mod policy;
mod retarget;
mod robot;
mod simulate;
mod sysid;
mod trial;
mod twin;
mod watch;

/// The compiled part of the package `drex`.
#[pyo3::pymodule]
mod _drex {
    #[pymodule_export]
    use crate::batch::{Batch, Runner};
    #[pymodule_export]
    use crate::failure::{Busy, Error, NoCommand};
    #[pymodule_export]
    use crate::grasp::{Grasp, PredictedGrasp};
    #[pymodule_export]
    use crate::mesh::{Asset, MeshCheck, mesh_asset, mesh_check};
    #[pymodule_export]
    use crate::policy::Policy;
    #[pymodule_export]
    use crate::retarget::{Retargeter, Retargeting, retarget};
    #[pymodule_export]
    use crate::robot::Robot;
    #[pymodule_export]
    use crate::simulate::{Motion, simulate};
    #[pymodule_export]
    use crate::sysid::{Identification, Push, PushReport, identify};
    #[pymodule_export]
    use crate::trial::{Command, Outcome, Trial, TriedGrasp, find_grasp};
    #[pymodule_export]
    use crate::twin::{Mass, Prediction, Twin};

    /// The version of the package, where Python looks for it.
    #[pymodule_init]
    fn init(module: &pyo3::Bound<'_, pyo3::types::PyModule>) -> pyo3::PyResult<()> {
        use pyo3::types::PyModuleMethods;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
