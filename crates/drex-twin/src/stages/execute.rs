//! The grasp of `drex deploy`, carried out by an emulated hand through the drivers and the control loop of a real one.

use std::path::PathBuf;

use crate::Result;
use drex_hw::control::EStop;
use drex_hw::driver::HandKind;

use crate::Progress;
use crate::Twin;
use crate::deploy::{DeployOptions, DeployTo, Deployed, deploy};
use crate::predict::{PredictOptions, Predictor};
use crate::records::{EXECUTION, EXECUTION_LOG, ExecutionFile, write_json};

pub(crate) fn make(twin: &Twin, progress: &dyn Progress) -> Result<Vec<PathBuf>> {
    let (file, log) = (twin.output(EXECUTION)?, twin.output(EXECUTION_LOG)?);
    let options = DeployOptions { to: DeployTo::Emulated, log: Some(log.clone()), ..DeployOptions::default() };
    let predictor = Predictor::of_twin(twin, &PredictOptions::default())?;
    let prediction = predictor.predict()?;
    twin.took("network", 1e-3 * prediction.network_ms);
    twin.took("force", 1e-3 * prediction.force_ms);
    let mut execution = ExecutionFile {
        schema: 1,
        hand: prediction.grasp.hand.clone(),
        emulated: true,
        not_driven: HandKind::of_model(&prediction.grasp.hand)
            .err()
            .map(|e| e.to_string())
            .or(prediction.cannot_hold.clone()),
        unit: String::new(),
        joint_names: Vec::new(),
        open_rad: Vec::new(),
        closed_rad: Vec::new(),
        closing_limits: Vec::new(),
        force_limits: Vec::new(),
        held: false,
        contacts: Vec::new(),
    };
    if execution.not_driven.is_some() {
        write_json(&file, &execution)?;
        return Ok(vec![file]);
    }
    let Deployed { file: commanded, reach, limits, done } =
        deploy(&predictor, &prediction, &options, &EStop::new(), progress)?;
    (execution.unit, execution.joint_names) = (limits.unit.to_owned(), prediction.grasp.joint_names.clone());
    (execution.open_rad, execution.closed_rad) = (reach.open, reach.closed);
    (execution.closing_limits, execution.force_limits) = (limits.closing, limits.force);
    if let Some(done) = done {
        (execution.held, execution.contacts) = (done.held(), done.contacts(&prediction.grasp.joint_names));
    }
    write_json(&file, &execution)?;
    Ok(vec![commanded, file, log])
}
