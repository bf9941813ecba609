//! A person's hand on a robot hand.

use std::path::{Path, PathBuf};

use drex_demo::{
    DemoUnit, Demonstration, HandFrame, HumanFinger, KEYPOINTS, KeyPointOrder, KeyPoints, LoadOptions, Side,
};
use drex_retarget::{Objective, RetargetOptions, RetargetedFrame, Scale, TargetHand};
use nalgebra::Point3;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arrays::{Numbers, column, out1, plain, pose_row, table};
use crate::failure::{Failure, Result, refused};
use crate::robot::text_of;
use crate::watch::watched;

/// The hand that is asked for.
fn hand_of(hand: &Path, mapping: Option<&Path>) -> Result<TargetHand> {
    let Some(mapping) = mapping else { return Ok(TargetHand::resolve(text_of(hand)?)?) };
    if hand.is_file() {
        return Ok(TargetHand::load(hand, Some(mapping))?);
    }
    let robot = TargetHand::resolve(text_of(hand)?)?.robot;
    Ok(TargetHand::with_mapping(robot, mapping, &drex_core::fsutil::read_text(mapping)?)?)
}

fn side_of(name: &str) -> Result<Side> {
    match name {
        "right" => Ok(Side::Right),
        "left" => Ok(Side::Left),
        other => refused(format!("side is {other:?}; give \"right\" or \"left\"")),
    }
}

fn options_of(objective: &str, scale: Option<f64>, low_pass_alpha: Option<f64>) -> Result<RetargetOptions> {
    let objective = match objective {
        "vector" => Objective::Vector,
        "dexpilot" => Objective::DexPilot,
        "position" => Objective::Position,
        other => {
            return refused(format!(
                "objective is {other:?}; give \"vector\", \"dexpilot\" or \"position\" (\"grasp\" is in the command line: drex retarget)"
            ));
        }
    };
    let mut options = RetargetOptions::new(objective);
    if let Some(scale) = scale {
        options.scale = Scale::Fixed(scale);
    }
    options.low_pass_alpha = low_pass_alpha.unwrap_or(options.low_pass_alpha);
    Ok(options)
}

/// Joint names of a hand.
fn joint_names(hand: &TargetHand) -> Vec<String> {
    hand.robot.joints.iter().map(|j| j.name.clone()).collect()
}

/// Millimetres that each fingertip is off; NaN where the person's was not seen.
fn residuals(frame: &RetargetedFrame) -> impl Iterator<Item = f64> + '_ {
    frame.fingers.iter().map(|f| f.residual_mm.unwrap_or(f64::NAN))
}

/// A clip on a robot hand.
#[pyclass(module = "drex", frozen)]
pub(crate) struct Retargeting {
    clip: drex_retarget::Retargeting,
    hand: String,
    fingers: Vec<HumanFinger>,
    notes: Vec<String>,
}

impl Retargeting {
    fn rows<'py>(
        &self,
        py: Python<'py>,
        columns: usize,
        row: impl Fn(&RetargetedFrame) -> Vec<f64>,
    ) -> Result<Bound<'py, PyArray2<f64>>> {
        table(py, self.clip.frames.iter().flat_map(row).collect(), columns)
    }
}

#[pymethods]
impl Retargeting {
    /// Name of the robot's model.
    #[getter]
    fn hand(&self) -> &str {
        &self.hand
    }

    /// Joint names in the order of the columns of `q`.
    #[getter]
    fn joint_names(&self) -> Vec<String> {
        self.clip.joint_names.clone()
    }

    /// The person's fingers in the order of the columns of `residuals_mm`.
    #[getter]
    fn fingers(&self) -> Vec<&'static str> {
        self.fingers.iter().map(|f| f.name()).collect()
    }

    /// Times of the frames, shape (T,), seconds.
    #[getter]
    fn times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        out1(py, self.clip.frames.iter().map(|f| f.t_s))
    }

    /// Joint angles within the limits, shape (T, dof), rad.
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        self.rows(py, self.clip.joint_names.len(), |f| f.q.clone())
    }

    /// The same after the low-pass filter, shape (T, dof), rad.
    #[getter]
    fn q_filtered<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        self.rows(py, self.clip.joint_names.len(), |f| f.q_filtered.clone())
    }

    /// How far each fingertip is from where the person's is, scaled, shape (T, fingers), mm; NaN where that was not seen.
    #[getter]
    fn residuals_mm<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        self.rows(py, self.fingers.len(), |f| residuals(f).collect())
    }

    /// Pose of the robot's base in the frame of the key points, shape (T, 7): x, y, z, qw, qx, qy, qz; NaN before the first hand.
    #[getter]
    fn source_from_base<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyArray2<f64>>> {
        self.rows(py, 7, |f| f.source_from_base.map_or([f64::NAN; 7], |p| pose_row(&p)).to_vec())
    }

    /// What is wrong with each frame: a list per frame of dicts with "flag" and what belongs to it. A frame with the flag "no_hand"
    /// repeats the joint angles before.
    #[getter]
    fn flags<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.clip.frames.iter().map(|f| &f.flags).collect::<Vec<_>>())
    }

    /// Factor on the person's vectors.
    #[getter]
    fn scale(&self) -> f64 {
        self.clip.scale.scale
    }

    /// What the reader remarked and what was derived from the model, one sentence each.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    fn __len__(&self) -> usize {
        self.clip.frames.len()
    }

    fn __repr__(&self) -> String {
        format!(
            "Retargeting({} frames to {}, {} joints)",
            self.clip.frames.len(),
            self.hand,
            self.clip.joint_names.len()
        )
    }
}

/// Maps the key points of a person's hand to joint angles of a robot hand.
///
/// `demo` is a file (JSON, NPY, NPZ or CSV, see docs/demonstrations.md) or an array (T, 21, 3): wrist, then thumb, index, middle,
/// ring and little finger from the palm to the tip, in any frame; NaN is a point that was not seen. `times_s` (T,) or `fps` give an
/// array its times (30 frames per second if left out). `hand` is "leap", "allegro", a URDF, MJCF or mapping file; its mirror image is
/// used for the person's other hand. `objective` is "vector", "dexpilot" or "position". `side` and `unit` ("m", "cm", "mm")
/// overrule the file. `scale` is found automatically if left out, but for "position", where it is 1.
#[pyfunction]
#[pyo3(signature = (demo, *, hand=PathBuf::from("leap"), objective="vector", side=None, unit=None, order="openpose", mirrored=false,
    fps=None, times_s=None, scale=None, low_pass_alpha=None, mapping=None))]
pub(crate) fn retarget(
    py: Python<'_>,
    demo: &Bound<'_, PyAny>,
    hand: PathBuf,
    objective: &str,
    side: Option<&str>,
    unit: Option<&str>,
    order: &str,
    mirrored: bool,
    fps: Option<f64>,
    times_s: Option<&Bound<'_, PyAny>>,
    scale: Option<f64>,
    low_pass_alpha: Option<f64>,
    mapping: Option<PathBuf>,
) -> Result<Retargeting> {
    let mut load = LoadOptions::default();
    load.side = side.map(side_of).transpose()?;
    load.unit = match unit {
        None => None,
        Some("m") => Some(DemoUnit::M),
        Some("cm") => Some(DemoUnit::Cm),
        Some("mm") => Some(DemoUnit::Mm),
        Some(other) => return refused(format!("unit is {other:?}; give \"m\", \"cm\" or \"mm\"")),
    };
    load.order = match order {
        "openpose" => KeyPointOrder::OpenPose,
        "mano" => KeyPointOrder::Mano,
        other => return refused(format!("order is {other:?}; give \"openpose\" or \"mano\"")),
    };
    load.mirrored = mirrored;
    load.fps = fps;
    let options = options_of(objective, scale, low_pass_alpha)?;
    let source = match demo.extract::<PathBuf>() {
        Ok(path) if times_s.is_none() => Source::File(path),
        Ok(_) => return refused("times_s is for arrays; a file has its own times, or give fps"),
        Err(_) => Source::array(demo, times_s, &mut load)?,
    };
    watched(py, None, move |_| {
        let demo = source.read(&load)?;
        let mut target = hand_of(&hand, mapping.as_deref())?;
        if target.side != demo.side {
            target = target.mirrored();
        }
        let clip = drex_retarget::retarget(&demo, &target, &options)?;
        let notes = demo.notes.iter().chain(&target.notes).cloned().chain(clip.scale.note()).collect();
        let fingers = target.fingers.iter().map(|f| f.human).collect();
        Ok(Retargeting { clip, hand: target.robot.name.clone(), fingers, notes })
    })
}

/// Where a demonstration comes from.
enum Source {
    File(PathBuf),
    /// As the bytes of an NPY file, so that arrays go through the same checks (order, unit, what can be a hand) as files.
    Array {
        npy: Vec<u8>,
        times_s: Option<Vec<f64>>,
    },
}

impl Source {
    fn array(demo: &Bound<'_, PyAny>, times_s: Option<&Bound<'_, PyAny>>, load: &mut LoadOptions) -> Result<Self> {
        let points = Numbers::of("the key points", demo)?;
        let &[frames, KEYPOINTS, 3] = points.shape() else {
            return points.wrong_shape("21 points per frame, shape (T, 21, 3)");
        };
        let times_s = times_s.map(|t| column("times_s", t)).transpose()?;
        if let Some(times_s) = &times_s {
            if load.fps.is_some() {
                return refused("both times_s and fps are given; give one of them");
            }
            if times_s.len() != frames {
                return refused(format!("there are {} times_s for {frames} frames; give one per frame", times_s.len()));
            }
            crate::sysid::increasing("times_s", times_s)?;
            // Times are set afterwards; this keeps the reader from remarking that there are none.
            load.fps = Some(30.0);
        }
        Ok(Self::Array { npy: npy(frames, &points.flat()), times_s })
    }

    fn read(&self, load: &LoadOptions) -> Result<Demonstration> {
        match self {
            Self::File(path) => Ok(Demonstration::load(path, load)?),
            Self::Array { npy, times_s } => {
                let mut demo = Demonstration::parse(Path::new("array.npy"), npy, load)?;
                for frame in &mut demo.frames {
                    if let Some(t) = times_s.as_ref().and_then(|t| t.get(frame.index)) {
                        frame.t_s = *t;
                    }
                }
                Ok(demo)
            }
        }
    }
}

/// Key points as an NPY file, version 1.0.
fn npy(frames: usize, points: &[f64]) -> Vec<u8> {
    let mut header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({frames}, {KEYPOINTS}, 3), }}");
    // Magic, version and length are ten bytes; all of it is a multiple of 64 and ends with a new line.
    while !(header.len() + 11).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((header.len() as u16).to_le_bytes());
    out.extend(header.as_bytes());
    out.extend(points.iter().flat_map(|x| x.to_le_bytes()));
    out
}

/// Retargets one frame after the other, for teleoperation.
///
/// Arguments as for `retarget`; `side` is the person's hand, "right" if left out. Key points are in metres unless the scale is
/// automatic, which takes any unit. Frames without `t_s` follow each other at `fps`.
#[pyclass(module = "drex")]
pub(crate) struct Retargeter {
    inner: drex_retarget::Retargeter,
    hand: TargetHand,
    fps: f64,
    last: Option<RetargetedFrame>,
}

#[pymethods]
impl Retargeter {
    #[new]
    #[pyo3(signature = (*, hand=PathBuf::from("leap"), objective="vector", side="right", fps=30.0, scale=None, low_pass_alpha=None,
        mapping=None))]
    fn new(
        hand: PathBuf,
        objective: &str,
        side: &str,
        fps: f64,
        scale: Option<f64>,
        low_pass_alpha: Option<f64>,
        mapping: Option<PathBuf>,
    ) -> Result<Self> {
        if !(fps > 0.0 && fps.is_finite()) {
            return refused(format!("fps is {fps}; give a positive number of frames per second"));
        }
        let hand = hand_of(&hand, mapping.as_deref())?.for_side(side_of(side)?);
        let inner = drex_retarget::Retargeter::new(&hand, options_of(objective, scale, low_pass_alpha)?)?;
        Ok(Self { inner, hand, fps, last: None })
    }

    /// Joint angles for the next frame after the low-pass filter, shape (dof,), rad.
    ///
    /// `keypoints` has the shape (21, 3); NaN is a point that was not seen. A frame that is no hand repeats the angles before: `flags`
    /// says so. `t_s` is the time of the frame, seconds.
    #[pyo3(signature = (keypoints, *, t_s=None))]
    fn step<'py>(
        &mut self,
        py: Python<'py>,
        keypoints: &Bound<'py, PyAny>,
        t_s: Option<f64>,
    ) -> Result<Bound<'py, PyArray1<f64>>> {
        let rows = Numbers::of("keypoints", keypoints)?.rows::<3>("21 points, shape (21, 3)")?;
        let rows = <[[f64; 3]; KEYPOINTS]>::try_from(rows)
            .map_err(|rows| Failure::Refused(format!("keypoints has {} points; give 21, shape (21, 3)", rows.len())))?;
        let seen = |p: [f64; 3]| p.iter().all(|x| x.is_finite()).then(|| Point3::from(p));
        let points: KeyPoints = rows.map(seen);
        let t_s = match t_s {
            Some(t) if !t.is_finite() => return refused(format!("t_s is {t}; give seconds")),
            Some(t) => t,
            None => self.last.as_ref().map_or(0.0, |f| f.t_s + 1.0 / self.fps),
        };
        let frame = self.inner.frame(&HandFrame::new(t_s, points));
        let q = out1(py, frame.q_filtered.iter().copied());
        self.last = Some(frame);
        Ok(q)
    }

    /// Forgets the frames so far; the person's size stays.
    fn reset(&mut self) {
        self.inner.reset();
        self.last = None;
    }

    /// Joint names in the order of the angles.
    #[getter]
    fn joint_names(&self) -> Vec<String> {
        joint_names(&self.hand)
    }

    /// The person's fingers in the order of `residuals_mm`.
    #[getter]
    fn fingers(&self) -> Vec<&'static str> {
        self.hand.fingers.iter().map(|f| f.human.name()).collect()
    }

    /// What was derived from the robot's model, one sentence each.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.hand.notes.clone()
    }

    /// Factor on the person's vectors that the next frame would use; None before the person was measured.
    #[getter]
    fn scale(&self) -> Option<f64> {
        self.inner.scale().map(|s| s.scale)
    }

    /// Time of the last frame, seconds; None before the first.
    #[getter]
    fn t_s(&self) -> Option<f64> {
        self.last.as_ref().map(|f| f.t_s)
    }

    /// Joint angles of the last frame before the filter, shape (dof,), rad; None before the first.
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.last.as_ref().map(|f| out1(py, f.q.iter().copied()))
    }

    /// How far each fingertip of the last frame is off, shape (fingers,), mm; NaN where the person's was not seen.
    #[getter]
    fn residuals_mm<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.last.as_ref().map(|f| out1(py, residuals(f)))
    }

    /// What is wrong with the last frame: dicts with "flag" and what belongs to it.
    #[getter]
    fn flags<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyAny>> {
        plain(py, &self.last.as_ref().map(|f| f.flags.as_slice()).unwrap_or_default())
    }

    fn __repr__(&self) -> String {
        format!("Retargeter({}, {} joints)", self.hand.robot.name, self.hand.robot.dof())
    }
}
