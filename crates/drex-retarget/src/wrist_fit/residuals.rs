//! What a good wrist pose makes small, with derivatives by the six of the wrist and the joints.
//!
//! Every residual is in units of "a millimetre of gap". Points are chosen anew at each evaluation (the nearest point of a pad,
//! the deepest of a link, the lowest of a link): minima over fixed points, hence piecewise smooth.

use drex_core::{Object, Pose, TablePlane};
use drex_grasp::HandSurface;
use nalgebra::{DMatrix, DVector, Matrix3, Point3, Vector3};

use super::hand::Recorded;
use super::{HandModel, WristFitOptions};
use crate::levenberg_marquardt::{HandState, LeastSquares, Schedule};
use crate::self_collision::{CLEARANCE_M, LinkProximity};

/// One residual unit of gap, of penetration, and of height below the table, metres.
const GAP_M: f64 = 0.001;
const PENETRATION_M: f64 = 0.0005;
const TABLE_M: f64 = 0.001;
/// The hand keeps this distance from the table while searching, metres.
const TABLE_MARGIN_M: f64 = 0.002;
/// Gaps much beyond this pull with fading strength while it is open which fingers will touch, metres.
const FADE_M: f64 = 0.012;
/// Weight of unbalanced unit normal forces (thumb against fingers), and the length their torque is divided by, metres.
const BALANCE: f64 = 3.0;
const BALANCE_LENGTH_M: f64 = 0.04;
/// Weight of a pad that pushes the object away from the palm, and the cosine up to which that is left alone.
const PUSHED_AWAY: f64 = 2.0;
pub(crate) const PUSH_FREE: f64 = 0.3;
/// Weight of a correction as large as allowed.
const CORRECTION: f64 = 1.5;
/// Longest step: rotation, rad, and translation, m.
const MAX_TURN_RAD: f64 = 0.35;
const MAX_SHIFT_M: f64 = 0.03;
/// Step for the curvature of the distance field, metres.
const CURVATURE_STEP_M: f64 = 0.002;

/// Everything that does not change during a fit.
#[derive(Clone, Copy)]
pub(crate) struct Problem<'a> {
    pub(crate) hand: &'a HandModel<'a>,
    pub(crate) object: &'a Object,
    pub(crate) table: TablePlane,
    /// Lower and upper corner of the object's bounding box, metres.
    pub(crate) bounds: (Point3<f64>, Point3<f64>),
    pub(crate) options: &'a WristFitOptions,
    pub(crate) recorded: &'a Recorded,
    pub(crate) stage: Stage,
}

/// How the search looks at the fingers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Stage {
    /// Few points on the hand; every finger is drawn to the surface, far ones weakly.
    Rough,
    /// All points; the fingers of this bit set are drawn with full strength, the others not at all.
    Final { fingers: u32 },
}

impl Stage {
    /// How much finger `finger` takes part, 0 to 1, at `distance` (m) from the surface.
    fn weight(self, finger: usize, distance: f64) -> f64 {
        match self {
            Self::Final { fingers } => f64::from(fingers >> finger & 1),
            Self::Rough => 1.0 / (1.0 + (distance / FADE_M).powi(2)),
        }
    }
}

/// A point of the hand that a residual depends on.
struct Active {
    link: usize,
    point: Point3<f64>,
    distance: f64,
    gradient: Vector3<f64>,
}

/// The active points of a state.
#[derive(Default)]
pub(crate) struct View {
    poses: Vec<Pose>,
    /// Nearest point of each finger's pad.
    pads: Vec<Active>,
    /// Deepest point of each link that is inside.
    inside: Vec<Active>,
    /// Links inside each other, or nearly.
    close: Vec<LinkProximity>,
    /// Lowest points under the margin: link, point, height over the table.
    low: Vec<(usize, Point3<f64>, f64)>,
}

impl LeastSquares for Problem<'_> {
    type View = View;
    const SCHEDULE: Schedule = Schedule {
        damping: 1e-2,
        decrease: (0.3, 1e-9),
        increase: (4.0, 1e9),
        tries: 6,
        promise: f64::NEG_INFINITY,
        slow: (1e-5, 1),
    };

    fn evaluate(&self, state: &HandState, view: &mut View) -> f64 {
        *view = View::new(self, state);
        0.5 * residuals(self, state, view, None).norm_squared()
    }

    fn normal(&self, state: &HandState, view: &View, hessian: &mut DMatrix<f64>, gradient: &mut DVector<f64>) {
        let (r, j) = linearised(self, state, view);
        *gradient = j.tr_mul(&r);
        *hessian = j.tr_mul(&j);
    }

    fn pivot(&self, _: &View) -> Point3<f64> {
        self.object.center_of_mass()
    }

    fn intervals(&self) -> &[(f64, f64)] {
        &self.recorded.intervals
    }

    /// Variables that no residual sees are damped, too: one residual unit per 10 cm, radian or joint radian, scaled down.
    fn damped(&self, k: usize, entry: f64, damping: f64) -> f64 {
        let scale = match k {
            0..3 => 10.0,
            3..6 => 1e3,
            _ => 1.0,
        };
        entry + damping * (entry + scale)
    }

    fn shorten(&self, step: &mut DVector<f64>) {
        let (turn, shift) = (step.rows(0, 3).norm(), step.rows(3, 3).norm());
        *step *= (MAX_TURN_RAD / turn.max(1e-12)).min(MAX_SHIFT_M / shift.max(1e-12)).min(1.0);
    }
}

/// Residuals and their derivatives (columns: rotation, translation, joints).
pub(crate) fn linearised(problem: &Problem<'_>, state: &HandState, view: &View) -> (DVector<f64>, DMatrix<f64>) {
    let mut rows = Vec::new();
    let r = residuals(problem, state, view, Some(&mut rows));
    let columns = 6 + state.q.len();
    let mut j = DMatrix::zeros(rows.len(), columns);
    for (i, row) in rows.iter().enumerate() {
        j.row_mut(i).copy_from(&row.transpose());
    }
    (r, j)
}

/// Bit set of the thumb and the fingers whose pads are within reach: all below the fade length, at least as many as needed.
pub(crate) fn nearest_fingers(problem: &Problem<'_>, state: &HandState) -> u32 {
    let view = View::new(problem, state);
    let mut others: Vec<usize> = (0..view.pads.len()).filter(|&f| f != problem.hand.thumb).collect();
    others.sort_by(|&a, &b| view.pads[a].distance.abs().total_cmp(&view.pads[b].distance.abs()));
    let mut set = 1_u32 << problem.hand.thumb;
    for (rank, &finger) in others.iter().enumerate() {
        if rank < problem.options.limits.min_fingers || view.pads[finger].distance.abs() < 0.5 * FADE_M {
            set |= 1 << finger;
        }
    }
    set
}

impl View {
    pub(crate) fn new(problem: &Problem<'_>, state: &HandState) -> Self {
        let hand = problem.hand;
        let (surface, pads): (&HandSurface, _) = match problem.stage {
            Stage::Rough => (&hand.rough, &hand.pads[0]),
            Stage::Final { .. } => (&hand.fine, &hand.pads[1]),
        };
        let poses = hand.robot.forward_kinematics(&state.q, &state.object_from_base);
        let sdf = &*problem.object.geometry;
        let active = |link: usize, point: Point3<f64>, distance: f64| Active {
            link,
            point,
            distance,
            gradient: sdf.signed_distance(&point).gradient,
        };
        // A pad without points would have been refused when the hand was made.
        let pads = pads.iter().filter_map(|pad| pad.nearest(&poses, sdf)).map(|(l, p, d)| active(l, p, d)).collect();
        let mut inside = Vec::new();
        let mut low = Vec::new();
        let up = problem.table.up.into_inner();
        let floor = problem.table.height_m + problem.options.limits.min_table_clearance_m + TABLE_MARGIN_M;
        for (link, (part, pose)) in surface.links.iter().zip(&poses).enumerate() {
            let (center, radius) = part.ball();
            if box_distance(problem.bounds, &(pose * center)) < radius
                && let Some((i, distance)) = part.nearest(pose, sdf, 0.0)
            {
                inside.push(active(link, pose * part.samples()[i].0, distance));
            }
            if let Some((i, height)) = part.lowest(pose, &up, floor) {
                low.push((link, pose * part.samples()[i].0, height - floor));
            }
        }
        let mut close = Vec::new();
        hand.shapes.proximities(&poses, CLEARANCE_M, &mut close);
        Self { poses, pads, inside, close, low }
    }
}

/// The residual vector; with `rows`, one derivative row per residual is added to it.
pub(crate) fn residuals(
    problem: &Problem<'_>,
    state: &HandState,
    view: &View,
    mut rows: Option<&mut Vec<DVector<f64>>>,
) -> DVector<f64> {
    let mut r = Vec::new();
    let pivot = problem.pivot(view);
    let motion = |link: usize, point: &Point3<f64>| point_motion(problem, view, link, point, &pivot, state.q.len());

    // Pads on the surface.
    let (pulls, slopes): (Vec<f64>, Vec<f64>) =
        view.pads.iter().enumerate().map(|(f, pad)| pull(problem.stage, f, pad.distance)).unzip();
    for (pad, (&pulled, &slope)) in view.pads.iter().zip(pulls.iter().zip(&slopes)) {
        r.push(pulled);
        if let Some(rows) = rows.as_deref_mut() {
            rows.push(motion(pad.link, &pad.point).tr_mul(&pad.gradient) * slope);
        }
    }
    // Nothing inside the object.
    for a in &view.inside {
        r.push(a.distance / PENETRATION_M);
        if let Some(rows) = rows.as_deref_mut() {
            rows.push(motion(a.link, &a.point).tr_mul(&a.gradient) / PENETRATION_M);
        }
    }
    // No link in another.
    for c in &view.close {
        r.push((c.distance_m - CLEARANCE_M) / PENETRATION_M);
        if let Some(rows) = rows.as_deref_mut() {
            let apart = motion(c.links.0, &c.point) - motion(c.links.1, &c.point);
            rows.push(apart.tr_mul(&c.normal) / PENETRATION_M);
        }
    }
    // Nothing below the table.
    for (link, point, height) in &view.low {
        r.push(height / TABLE_M);
        if let Some(rows) = rows.as_deref_mut() {
            rows.push(motion(*link, point).tr_mul(&problem.table.up.into_inner()) / TABLE_M);
        }
    }
    // The thumb's normal force against the fingers', each finger with its share.
    balance(problem, view, &motion, &mut r, rows.as_deref_mut());
    // No pad pushes the object out of the hand.
    caging(problem, view, &motion, &mut r, rows.as_deref_mut());
    // Small corrections.
    let unit = CORRECTION / problem.options.max_finger_correction_rad.max(1e-6);
    for (k, (q, recorded)) in state.q.iter().zip(&problem.recorded.joints).enumerate() {
        r.push((q - recorded) * unit);
        if let Some(rows) = rows.as_deref_mut() {
            let mut row = DVector::zeros(6 + state.q.len());
            row[6 + k] = unit;
            rows.push(row);
        }
    }
    DVector::from_vec(r)
}

/// Residual of a gap and its slope. Far fingers of the rough stage pull like the square root of a logarithm (Cauchy's loss).
fn pull(stage: Stage, finger: usize, distance: f64) -> (f64, f64) {
    match stage {
        Stage::Final { fingers } if fingers & (1 << finger) == 0 => (0.0, 0.0),
        Stage::Final { .. } => (distance / GAP_M, 1.0 / GAP_M),
        Stage::Rough => {
            let x = distance / FADE_M;
            let r = (1.0 + x * x).ln().sqrt();
            let slope = if r > 1e-6 { x.abs() / ((1.0 + x * x) * r) } else { 1.0 };
            (distance.signum() * r * FADE_M / GAP_M, slope / GAP_M)
        }
    }
}

/// Σ aᵢ nᵢ and Σ aᵢ (pᵢ − c) × nᵢ with the thumb's share one and the fingers' shares adding up to one (differentiable force
/// closure: Liu et al. 2021, with fixed shares).
fn balance(
    problem: &Problem<'_>,
    view: &View,
    motion: &dyn Fn(usize, &Point3<f64>) -> DMatrix<f64>,
    r: &mut Vec<f64>,
    rows: Option<&mut Vec<DVector<f64>>>,
) {
    let thumb = problem.hand.thumb;
    // Shares are held fixed for the derivative: they only move slowly.
    let weight = |f: usize| problem.stage.weight(f, view.pads[f].distance);
    let total: f64 = (0..view.pads.len()).filter(|&f| f != thumb).map(weight).sum();
    let share = |f: usize| if f == thumb { 1.0 } else { weight(f) / total.max(1e-9) };
    // Torques about the middle of the contacts: the weight's own arm is left to the cone programme.
    let middle = view.pads.iter().enumerate().map(|(f, p)| p.point.coords * share(f)).sum::<Vector3<f64>>() / 2.0;
    let (mut force, mut torque) = (Vector3::zeros(), Vector3::zeros());
    for (f, pad) in view.pads.iter().enumerate() {
        force += pad.gradient * share(f);
        torque += (pad.point.coords - middle).cross(&pad.gradient) * (share(f) / BALANCE_LENGTH_M);
    }
    r.extend(force.iter().chain(torque.iter()).map(|v| v * BALANCE));
    let Some(rows) = rows else { return };
    let columns = 6 + problem.recorded.joints.len();
    let mut d = DMatrix::zeros(6, columns);
    for (f, pad) in view.pads.iter().enumerate().filter(|(f, _)| share(*f) > 0.0) {
        let m = motion(pad.link, &pad.point);
        let turn = curvature(problem, &pad.point) * &m;
        let arm = (pad.point.coords - middle).cross_matrix();
        let mut top = d.rows_mut(0, 3);
        top += &turn * share(f);
        let mut bottom = d.rows_mut(3, 3);
        // The middle moves along by half of every share.
        let with_middle = (force.cross_matrix() * 0.5 - pad.gradient.cross_matrix()) * m;
        bottom += (arm * turn + with_middle) * (share(f) / BALANCE_LENGTH_M);
    }
    rows.extend((0..6).map(|k| d.row(k).transpose() * BALANCE));
}

/// Pads whose push on the object points out of the palm: a hand that holds an object has it between its fingers, not before them.
fn caging(
    problem: &Problem<'_>,
    view: &View,
    motion: &dyn Fn(usize, &Point3<f64>) -> DMatrix<f64>,
    r: &mut Vec<f64>,
    mut rows: Option<&mut Vec<DVector<f64>>>,
) {
    let (_, palm) = problem.hand.palm(&view.poses);
    for (f, pad) in view.pads.iter().enumerate() {
        let weight = problem.stage.weight(f, pad.distance) * PUSHED_AWAY;
        let push = -pad.gradient.dot(&palm) - PUSH_FREE;
        if push <= 0.0 || weight == 0.0 {
            continue;
        }
        r.push(weight * push);
        if let Some(rows) = rows.as_deref_mut() {
            let mut row = (curvature(problem, &pad.point) * motion(pad.link, &pad.point)).tr_mul(&palm) * -weight;
            // The palm turns with the wrist: d palm = ω × palm.
            let turn = palm.cross(&pad.gradient) * -weight;
            for k in 0..3 {
                row[k] += turn[k];
            }
            rows.push(row);
        }
    }
}

/// Mean over the touching pads (bit set) of how much they push the object out of the palm, 0 to 1.
pub(crate) fn pushed_away(problem: &Problem<'_>, state: &HandState, fingers: u32) -> f64 {
    let view = View::new(&Problem { stage: Stage::Final { fingers }, ..*problem }, state);
    let (_, palm) = problem.hand.palm(&view.poses);
    let touching = view.pads.iter().enumerate().filter(|(f, _)| fingers >> f & 1 == 1);
    let (sum, n) = touching.fold((0.0, 0), |(s, n), (_, p)| (s + (-p.gradient.dot(&palm) - PUSH_FREE).max(0.0), n + 1));
    sum / f64::from(n.max(1))
}

/// Derivative of the gradient of the distance, by central differences.
fn curvature(problem: &Problem<'_>, point: &Point3<f64>) -> Matrix3<f64> {
    let sdf = &*problem.object.geometry;
    let columns = [0, 1, 2].map(|k| {
        let step = Vector3::ith(k, CURVATURE_STEP_M);
        (sdf.signed_distance(&(point + step)).gradient - sdf.signed_distance(&(point - step)).gradient)
            / (2.0 * CURVATURE_STEP_M)
    });
    Matrix3::from_columns(&columns)
}

/// Distance of a point from a box, a cheap lower bound of the distance from what is in it.
fn box_distance((lo, hi): (Point3<f64>, Point3<f64>), point: &Point3<f64>) -> f64 {
    (lo - point).sup(&(point - hi)).sup(&Vector3::zeros()).norm()
}

/// Velocity of a point of a link per unit of each unknown, 3 × (6 + joints), object frame.
fn point_motion(
    problem: &Problem<'_>,
    view: &View,
    link: usize,
    point: &Point3<f64>,
    pivot: &Point3<f64>,
    joints: usize,
) -> DMatrix<f64> {
    let mut m = DMatrix::zeros(3, 6 + joints);
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&-(point - pivot).cross_matrix());
    m.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
    m.columns_mut(6, joints).copy_from(&problem.hand.robot.jacobian(&view.poses, link, point).0);
    m
}
