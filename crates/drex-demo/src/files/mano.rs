//! Key points from MANO parameters (Romero, Tzionas and Black, "Embodied Hands", 2017), with the user's own copy of the model.

use std::path::Path;

use drex_core::{Error, Result, fsutil};
use nalgebra::{DMatrix, DVector, Matrix3, Point3, UnitQuaternion, Vector3};

use super::LoadOptions;
use super::npz::Npz;
use super::order::openpose_from_mano;
use crate::{KEYPOINTS, KeyPoints};

/// Joints of the model: wrist and three for each finger.
const JOINTS: usize = 16;
/// Vertices at the tips of thumb, index, middle, ring and little finger (smplx, `vertex_ids`).
const TIP_VERTICES: [usize; 5] = [744, 320, 443, 554, 671];

/// MANO's hand model: what key points need of it. Not part of this crate: its licence is its own, and non-commercial.
#[derive(Debug, Clone)]
pub struct ManoModel {
    /// Parent of each joint; the wrist has none.
    parents: [Option<usize>; JOINTS],
    /// Joints of the mean shape and their change per shape parameter: J(beta) = joints + joint_shapes beta.
    joints: DVector<f64>,
    joint_shapes: DMatrix<f64>,
    /// The same of the tip vertices, and their change per entry of (R_1 - I, …, R_15 - I).
    tips: DVector<f64>,
    tip_shapes: DMatrix<f64>,
    tip_poses: DMatrix<f64>,
    /// Skinning weights of the tips.
    weights: [[f64; JOINTS]; 5],
    /// Mean of the fingers' axis-angle parameters.
    mean_pose: [f64; 45],
}

/// MANO's parameters of one frame.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ManoPose {
    /// Rotation of the wrist, `source_from_wrist`.
    pub global_orient: UnitQuaternion<f64>,
    /// Rotations of the 15 finger joints, each in its parent's frame: index, middle, little, ring, thumb, three each.
    pub hand_pose: HandPose,
    /// Shape parameters; missing ones are zero.
    pub betas: Vec<f64>,
    /// Added to every point, m.
    pub translation: Vector3<f64>,
}

/// Rotations of MANO's fingers.
#[derive(Debug, Clone, PartialEq)]
pub enum HandPose {
    /// As rotations: the joints' own.
    Rotations(Box<[UnitQuaternion<f64>; 15]>),
    /// As axis times angle, rad: offsets from the flat hand or from the model's mean pose.
    AxisAngles(Box<[f64; 45]>),
}

impl ManoPose {
    /// From 48 axis-angle numbers, wrist first.
    ///
    /// # Errors
    /// If there are not 48, all finite: principal components cannot be told from angles.
    pub fn from_axis_angles(pose: &[f64], betas: &[f64], translation: Vector3<f64>) -> Result<Self> {
        let Some((wrist, fingers)) = pose.split_at_checked(3) else { return Err(not_48(pose.len())) };
        let fingers: [f64; 45] = fingers.try_into().map_err(|_| not_48(pose.len()))?;
        if pose.iter().chain(betas).chain(&translation).any(|v| !v.is_finite()) {
            return Err(Error::value("a MANO parameter is not finite", "leave the frame out"));
        }
        Ok(Self {
            global_orient: UnitQuaternion::from_scaled_axis(Vector3::new(wrist[0], wrist[1], wrist[2])),
            hand_pose: HandPose::AxisAngles(Box::new(fingers)),
            betas: betas.to_vec(),
            translation,
        })
    }

    /// From rotations of the wrist and the 15 joints.
    pub fn from_rotations(
        global_orient: UnitQuaternion<f64>,
        hand_pose: [UnitQuaternion<f64>; 15],
        betas: &[f64],
        translation: Vector3<f64>,
    ) -> Self {
        Self { global_orient, hand_pose: HandPose::Rotations(Box::new(hand_pose)), betas: betas.to_vec(), translation }
    }
}

fn not_48(n: usize) -> Error {
    Error::value(
        format!("{n} MANO pose parameters"),
        "give 3 of the wrist and 45 axis-angle numbers of the fingers, not principal components",
    )
}

impl ManoModel {
    /// Reads a model that its owner converted from `MANO_RIGHT.pkl` or `MANO_LEFT.pkl` (mano.is.tue.mpg.de, registration needed):
    ///
    /// ```sh
    /// pip install numpy scipy chumpy
    /// python -c "import pickle, numpy as np; d = pickle.load(open('MANO_RIGHT.pkl', 'rb'), encoding='latin1'); \
    ///   a = lambda v: np.array(v.todense() if hasattr(v, 'todense') else getattr(v, 'r', v), float); \
    ///   np.savez('MANO_RIGHT.npz', **{k: a(d[k]) for k in ['v_template', 'shapedirs', 'posedirs', 'J_regressor', \
    ///   'weights', 'kintree_table', 'hands_mean']})"
    /// ```
    ///
    /// # Errors
    /// If the file cannot be read or an array is missing or of another shape.
    pub fn read_npz(path: &Path) -> Result<Self> {
        Self::parse_npz(path, &fsutil::read_bytes(path)?)
    }

    /// As [`ManoModel::read_npz`], from memory. The number of vertices is the file's; the tips are vertices 744, 320, 443, 554, 671.
    ///
    /// # Errors
    /// As [`ManoModel::read_npz`].
    pub fn parse_npz(path: &Path, bytes: &[u8]) -> Result<Self> {
        let mut npz = Npz::open(path, bytes)?;
        let refuse = |what: String| Error::content(path, None, what, "convert the model again, as documented");
        let mut get = |name: &str, shape: &[Option<usize>]| -> Result<(Vec<f64>, Vec<usize>)> {
            let table = npz.table(name)?;
            let fits = table.shape.len() == shape.len()
                && table.shape.iter().zip(shape).all(|(d, want)| want.is_none_or(|w| w == *d));
            if !fits {
                return Err(refuse(format!("{name} of shape {:?}", table.shape)));
            }
            Ok((table.numbers, table.shape))
        };
        let (template, shape) = get("v_template", &[None, Some(3)])?;
        let vertices = shape[0];
        if vertices <= TIP_VERTICES[0] {
            return Err(refuse(format!("{vertices} vertices are no MANO model")));
        }
        let (shapedirs, shape) = get("shapedirs", &[Some(vertices), Some(3), None])?;
        let betas = shape[2];
        let (posedirs, _) = get("posedirs", &[Some(vertices), Some(3), Some(9 * (JOINTS - 1))])?;
        let (regressor, _) = get("J_regressor", &[Some(JOINTS), Some(vertices)])?;
        let (weights, _) = get("weights", &[Some(vertices), Some(JOINTS)])?;
        let (kintree, _) = get("kintree_table", &[Some(2), Some(JOINTS)])?;
        let (mean, _) = get("hands_mean", &[Some(45)])?;
        let all = [&template, &shapedirs, &posedirs, &regressor, &weights, &mean];
        if all.iter().any(|a| a.iter().any(|v| !v.is_finite())) {
            return Err(refuse("a number of the model is not finite".into()));
        }
        // A joint's parent comes before it; the wrist's is a number that is none.
        let mut parents = [None; JOINTS];
        for (j, parent) in parents.iter_mut().enumerate().skip(1) {
            let p = kintree[j];
            if !(p >= 0.0 && p < j as f64) {
                return Err(refuse(format!("kintree_table gives joint {j} the parent {p}")));
            }
            *parent = Some(p as usize);
        }
        let regressed = |values: &[f64], width: usize| {
            // J[j, c] = sum over vertices of regressor[j, v] values[v, c].
            let at =
                |j: usize, c: usize| (0..vertices).map(|v| regressor[j * vertices + v] * values[v * width + c]).sum();
            (0..JOINTS * width).map(|i| at(i / width, i % width)).collect::<Vec<f64>>()
        };
        let of_tips = |values: &[f64], width: usize| -> Vec<f64> {
            TIP_VERTICES.iter().flat_map(|v| values[v * width..(v + 1) * width].iter().copied()).collect()
        };
        let mut mean_pose = [0.0; 45];
        mean_pose.copy_from_slice(&mean);
        Ok(Self {
            parents,
            joints: DVector::from_vec(regressed(&template, 3)),
            joint_shapes: DMatrix::from_row_slice(3 * JOINTS, betas, &regressed(&shapedirs, 3 * betas)),
            tips: DVector::from_vec(of_tips(&template, 3)),
            tip_shapes: DMatrix::from_row_slice(15, betas, &of_tips(&shapedirs, 3 * betas)),
            tip_poses: DMatrix::from_row_slice(15, 9 * (JOINTS - 1), &of_tips(&posedirs, 3 * 9 * (JOINTS - 1))),
            weights: TIP_VERTICES.map(|v| std::array::from_fn(|j| weights[v * JOINTS + j])),
            mean_pose,
        })
    }

    /// The model that the options name, for a recording that has parameters only.
    pub(super) fn of_options(recording: &Path, options: &LoadOptions) -> Result<Self> {
        let path = options.mano_model.as_ref().ok_or_else(|| {
            Error::content(
                recording,
                None,
                "the recording has MANO parameters but no key points",
                "give the MANO model of this hand, converted to .npz as documented (register at mano.is.tue.mpg.de for \
                 MANO_RIGHT.pkl), or a recording with key points",
            )
        })?;
        Self::read_npz(path)
    }

    /// The 21 key points in OpenPose's order, m (equations 2 to 5 of the paper): shape and pose blended into the template, joints
    /// regressed from the shape, turned down the kinematic tree, the five tip vertices by linear blend skinning.
    ///
    /// Axis-angle parameters are offsets from the flat hand if `flat_hand`, else from the model's mean pose.
    pub fn key_points(&self, pose: &ManoPose, flat_hand: bool) -> KeyPoints {
        let betas = DVector::from_fn(self.joint_shapes.ncols(), |i, _| pose.betas.get(i).copied().unwrap_or(0.0));
        let joints = &self.joints + &self.joint_shapes * &betas;
        let joint = |j: usize| Vector3::new(joints[3 * j], joints[3 * j + 1], joints[3 * j + 2]);
        let mut local = [Matrix3::identity(); JOINTS];
        local[0] = *pose.global_orient.to_rotation_matrix().matrix();
        for (j, slot) in local.iter_mut().enumerate().skip(1) {
            let rotation = match &pose.hand_pose {
                HandPose::Rotations(r) => r[j - 1],
                HandPose::AxisAngles(a) => {
                    let mean = |k: usize| if flat_hand { 0.0 } else { self.mean_pose[k] };
                    UnitQuaternion::from_scaled_axis(Vector3::from_fn(|c, _| {
                        let k = 3 * (j - 1) + c;
                        a[k] + mean(k)
                    }))
                }
            };
            *slot = *rotation.to_rotation_matrix().matrix();
        }
        // Pose of each joint: G_j = G_parent [R_j | J_j - J_parent].
        let mut turned = [(Matrix3::identity(), Vector3::zeros()); JOINTS];
        for j in 0..JOINTS {
            turned[j] = match self.parents[j] {
                None => (local[j], joint(j)),
                Some(p) => (turned[p].0 * local[j], turned[p].0 * (joint(j) - joint(p)) + turned[p].1),
            };
        }
        // R_j - I of the fingers' joints, row by row.
        let bend = DVector::from_fn(9 * (JOINTS - 1), |i, _| {
            let (j, r, c) = (1 + i / 9, i % 9 / 3, i % 3);
            local[j][(r, c)] - f64::from(u8::from(r == c))
        });
        let tips = &self.tips + &self.tip_shapes * &betas + &self.tip_poses * bend;
        let mut points = [None; KEYPOINTS];
        for (j, (_, at)) in turned.iter().enumerate() {
            points[j] = Some(Point3::from(at + pose.translation));
        }
        for (t, weights) in self.weights.iter().enumerate() {
            let rest = Vector3::new(tips[3 * t], tips[3 * t + 1], tips[3 * t + 2]);
            let skinned: Vector3<f64> = weights
                .iter()
                .zip(&turned)
                .enumerate()
                .map(|(j, (w, (r, at)))| (r * (rest - joint(j)) + at) * *w)
                .sum();
            points[JOINTS + t] = Some(Point3::from(skinned + pose.translation));
        }
        openpose_from_mano(&points)
    }
}
