//! What a grasp of one frame makes small. Every residual is in units of "a millimetre of gap".

use drex_core::{SdfSample, SignedDistance};
use nalgebra::{DMatrix, DVector, Point3, Vector3};

use super::hand::{GraspHand, Posed};
use super::surface_points::CellBound;
use crate::levenberg_marquardt::{HandState, LeastSquares, Schedule};
use crate::self_collision::{CLEARANCE_M, LinkProximity};

/// One residual unit of each kind: metres, radians.
const GAP_M: f64 = 0.001;
const TIP_M: f64 = 0.0004;
const THUMB_TIP_M: f64 = 0.00025;
const PENETRATION_M: f64 = 0.00012;
const COLLISION_M: f64 = 0.0002;
/// Pads aim to be this far inside, metres: on the surface for any measure.
const PRESS_M: f64 = 0.0;
/// The point of the fingertip may be this far from the surface before it is drawn there, metres.
const TIP_FREE_M: f64 = 0.0025;
/// The middle between thumb and fingers is inside the object by at least this, metres.
const ENCLOSED_M: f64 = 0.008;
const ENCLOSE_UNIT_M: f64 = 0.004;
/// The thumb is opposite the middle of the other fingers: one unit of sideways distance, metres.
const OPPOSE_UNIT_M: f64 = 0.012;
/// once the normals under them are opposed by this cosine.
const OPPOSED: f64 = -0.2;
/// Closeness to the human hand: joints, rad, wrist, metres and rad.
const JOINT_UNIT_RAD: f64 = 0.3;
const WRIST_UNIT: (f64, f64) = (0.06, 0.2);
/// Farther from the human hand's wrist than this costs more, m, and by how much.
const WRIST_FREE_M: f64 = 0.10;
const WRIST_FAR_UNIT_M: f64 = 0.003;
/// Smoothness between frames.
const STEP_UNIT_RAD: f64 = 0.1;
const WRIST_STEP_UNIT: (f64, f64) = (0.03, 0.4);
/// Fingers other than the thumb pull with full strength up to this gap, metres.
const FADE_M: f64 = 0.012;
/// Longest step: rotation and joints, rad, and translation, m.
const MAX_TURN_RAD: f64 = 0.3;
const MAX_SHIFT_M: f64 = 0.03;

/// One frame's problem.
pub(crate) struct Problem<'a> {
    pub(crate) hand: &'a GraspHand<'a>,
    pub(crate) object: &'a dyn SignedDistance,
    pub(crate) bounds: &'a (Point3<f64>, Point3<f64>),
    /// The human hand: plain vector result and its base.
    pub(crate) reference: &'a HandState,
    /// How much each finger is target_weights on the surface, 0 to 1.
    pub(crate) target_weights: &'a [f64],
    /// Whether far fingers let go.
    pub(crate) fades: bool,
    /// Where on the surface the fingers belong, and how far off is one unit, m.
    pub(crate) goals: &'a [Point3<f64>],
    pub(crate) goal_unit_m: f64,
    /// Joints and base that the frames beside suggest.
    pub(crate) beside: &'a [HandState],
    /// Interval of every joint.
    pub(crate) intervals: &'a [(f64, f64)],
    /// Whether joints move.
    pub(crate) joints_move: bool,
}

/// r and its gradient with respect to points of links: dr = Σ vᵢ · dpᵢ.
struct Row {
    r: f64,
    moves: std::ops::Range<usize>,
}

/// Everything that one evaluation found; buffers are reused.
#[derive(Default)]
pub(crate) struct View {
    posed: Option<Posed>,
    rows: Vec<Row>,
    moves: Vec<(usize, Point3<f64>, Vector3<f64>)>,
    close: Vec<LinkProximity>,
    /// Per link, what is known of the distances of its cells.
    bounds: Vec<Vec<CellBound>>,
    pub(crate) gaps: Vec<f64>,
    pub(crate) tip_gaps: Vec<f64>,
    pub(crate) cost: f64,
    /// Deepest point inside the object or inside another link, m; zero or more.
    pub(crate) deepest_m: f64,
    /// Least cosine between the line from the thumb to the middle of the other fingers and the normals at its ends.
    pub(crate) upright: f64,
    pivot: Point3<f64>,
}

impl Problem<'_> {
    /// The middle between thumb and fingers is inside, and the thumb is opposite the fingers along its normal.
    fn oppose(&self, touch: &[(usize, Point3<f64>, Vector3<f64>, f64)], view: &mut View) {
        let thumb = self.hand.thumb;
        let total: f64 = touch.iter().enumerate().filter(|(f, _)| *f != thumb).map(|(_, t)| t.3).sum();
        if total <= 1e-6 || touch[thumb].3 <= 0.0 {
            return;
        }
        let share = |f: usize| if f == thumb { 1.0 } else { -touch[f].3 / total };
        let middle: Vector3<f64> = touch.iter().enumerate().map(|(f, t)| t.1.coords * (0.5 * share(f).abs())).sum();
        let s = self.object.signed_distance(&Point3::from(middle));
        if s.distance_m > -ENCLOSED_M {
            let moves = touch
                .iter()
                .enumerate()
                .filter(|(_, t)| t.3 > 0.0)
                .map(|(f, t)| (t.0, t.1, s.gradient * (0.5 * share(f).abs() / ENCLOSE_UNIT_M)));
            view.push((s.distance_m + ENCLOSED_M) / ENCLOSE_UNIT_M, moves);
        }
        let between: Vector3<f64> = touch.iter().enumerate().map(|(f, t)| t.1.coords * share(f)).sum();
        let fingers: Vector3<f64> =
            touch.iter().enumerate().filter(|(f, _)| *f != thumb).map(|(f, t)| t.2 * -share(f)).sum();
        let (Some(front), Some(along)) = (fingers.try_normalize(1e-9), between.try_normalize(1e-9)) else { return };
        let back = touch[thumb].2;
        view.upright = front.dot(&-along).min(back.dot(&along));
        if front.dot(&back) > OPPOSED {
            return;
        }
        for normal in [back, front] {
            let side = normal.cross(&Vector3::ith(normal.iamin(), 1.0)).normalize();
            for axis in [side, normal.cross(&side)] {
                let moves = touch
                    .iter()
                    .enumerate()
                    .filter(|(_, t)| t.3 > 0.0)
                    .map(|(f, t)| (t.0, t.1, axis * (share(f) / OPPOSE_UNIT_M)));
                view.push(axis.dot(&between) / OPPOSE_UNIT_M, moves);
            }
        }
    }

    /// Cost of being away from the human hand and from the frames beside; adds to the normal equations if they are given.
    fn closeness(
        &self,
        state: &HandState,
        pivot: Point3<f64>,
        mut normal: Option<(&mut DMatrix<f64>, &mut DVector<f64>)>,
    ) -> f64 {
        let mut cost = 0.0;
        let wrist =
            |other: &HandState, unit: (f64, f64), normal: &mut Option<(&mut DMatrix<f64>, &mut DVector<f64>)>| {
                let turn = (state.object_from_base.rotation * other.object_from_base.rotation.inverse()).scaled_axis()
                    / unit.1;
                let shift =
                    (state.object_from_base.translation.vector - other.object_from_base.translation.vector) / unit.0;
                if let Some((a, g)) = normal {
                    // d shift = dt + ω × (base − pivot).
                    let arm = (state.object_from_base.translation.vector - pivot.coords).cross_matrix() * -1.0 / unit.0;
                    for k in 0..3 {
                        a[(k, k)] += 1.0 / (unit.1 * unit.1);
                        g[k] += turn[k] / unit.1;
                        a[(3 + k, 3 + k)] += 1.0 / (unit.0 * unit.0);
                        g[3 + k] += shift[k] / unit.0;
                    }
                    let cross = arm.transpose() / unit.0;
                    let square = arm.transpose() * arm;
                    let pull = arm.transpose() * shift;
                    for i in 0..3 {
                        g[i] += pull[i];
                        for k in 0..3 {
                            a[(i, k)] += square[(i, k)];
                            a[(i, 3 + k)] += cross[(i, k)];
                            a[(3 + k, i)] += cross[(i, k)];
                        }
                    }
                }
                0.5 * (turn.norm_squared() + shift.norm_squared())
            };
        cost += wrist(self.reference, WRIST_UNIT, &mut normal);
        for other in self.beside {
            cost += wrist(other, WRIST_STEP_UNIT, &mut normal);
        }
        let references = std::iter::once((&self.reference.q, JOINT_UNIT_RAD))
            .chain(self.beside.iter().map(|b| (&b.q, STEP_UNIT_RAD)));
        for (reference, unit) in references {
            for (j, (q, w)) in state.q.iter().zip(reference).enumerate() {
                let r = (q - w) / unit;
                cost += 0.5 * r * r;
                if let Some((a, g)) = &mut normal {
                    a[(6 + j, 6 + j)] += 1.0 / (unit * unit);
                    g[6 + j] += r / unit;
                }
            }
        }
        cost
    }
}

impl LeastSquares for Problem<'_> {
    type View = View;
    const SCHEDULE: Schedule = Schedule {
        damping: 1e-3,
        decrease: (0.2, 1e-7),
        increase: (6.0, 1e6),
        tries: 8,
        promise: 5e-4,
        slow: (2e-3, 2),
    };

    fn evaluate(&self, state: &HandState, view: &mut View) -> f64 {
        let hand = self.hand;
        let posed = hand.posed(&state.q, &state.object_from_base);
        view.rows.clear();
        view.upright = -1.0;
        view.deepest_m = 0.0;
        view.moves.clear();
        view.gaps.clear();
        view.tip_gaps.clear();
        let wants = self.target_weights.iter().any(|w| *w > 0.0);
        let mut touch: Vec<(usize, Point3<f64>, Vector3<f64>, f64)> = Vec::with_capacity(hand.fingers.len());
        for (f, pad) in hand.fingers.iter().enumerate() {
            let found = if self.target_weights[f] > 0.0 { pad.nearest(&posed, self.object) } else { None };
            let Some((link, point, SdfSample { distance_m: gap, gradient: n })) = found else {
                view.gaps.push(f64::INFINITY);
                view.tip_gaps.push(f64::INFINITY);
                touch.push((0, Point3::origin(), Vector3::zeros(), 0.0));
                continue;
            };
            let fade = if self.fades && f != hand.thumb { 1.0 / (1.0 + (gap / FADE_M).powi(2)) } else { 1.0 };
            let w = self.target_weights[f] * fade;
            view.push((gap + PRESS_M) * w / GAP_M, [(link, point, n * (w / GAP_M))]);
            let tip = pad.tip(&posed);
            let s = self.object.signed_distance(&tip);
            if s.distance_m > TIP_FREE_M {
                let unit = w / if f == hand.thumb { THUMB_TIP_M } else { TIP_M };
                view.push((s.distance_m - TIP_FREE_M) * unit, [(pad.tip.link, tip, s.gradient * unit)]);
            }
            let off = tip - self.goals[f];
            for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
                let unit = w / self.goal_unit_m;
                view.push(axis.dot(&off) * unit, [(pad.tip.link, tip, axis * unit)]);
            }
            view.gaps.push(gap);
            view.tip_gaps.push(s.distance_m);
            touch.push((link, point, n, w));
        }
        if wants {
            self.oppose(&touch, view);
        }
        let mut bounds = std::mem::take(&mut view.bounds);
        bounds.resize_with(hand.search.len(), Vec::new);
        for (link, (part, pose)) in hand.search.iter().zip(&posed.links).enumerate() {
            if let Some((point, s)) = part.deepest(pose, self.object, self.bounds, &mut bounds[link]) {
                view.deepest_m = view.deepest_m.max(-s.distance_m);
                view.push(s.distance_m / PENETRATION_M, [(link, point, s.gradient / PENETRATION_M)]);
            }
        }
        view.bounds = bounds;
        if self.joints_move {
            let mut close = std::mem::take(&mut view.close);
            hand.shapes.proximities(&posed.links, CLEARANCE_M, &mut close);
            for c in &close {
                let n = c.normal / COLLISION_M;
                view.deepest_m = view.deepest_m.max(-c.distance_m);
                view.push(
                    (c.distance_m - CLEARANCE_M) / COLLISION_M,
                    [(c.links.0, c.point, n), (c.links.1, c.point, -n)],
                );
            }
            view.close = close;
        }
        let tips: Vector3<f64> = hand.fingers.iter().map(|p| p.tip(&posed).coords).sum();
        view.pivot = Point3::from(tips / hand.fingers.len() as f64);
        let shift = state.object_from_base.translation.vector - self.reference.object_from_base.translation.vector;
        if shift.norm() > WRIST_FREE_M {
            let unit = shift.normalize() / WRIST_FAR_UNIT_M;
            let base = Point3::from(state.object_from_base.translation.vector);
            view.push((shift.norm() - WRIST_FREE_M) / WRIST_FAR_UNIT_M, [(0, base, unit)]);
        }
        view.posed = Some(posed);
        view.cost = 0.5 * view.rows.iter().map(|r| r.r * r.r).sum::<f64>() + self.closeness(state, view.pivot, None);
        view.cost
    }

    fn normal(&self, state: &HandState, view: &View, a: &mut DMatrix<f64>, g: &mut DVector<f64>) {
        a.fill(0.0);
        g.fill(0.0);
        let Some(posed) = &view.posed else { return };
        let n = g.len();
        let mut row = vec![0.0; n];
        let mut filled: Vec<usize> = Vec::with_capacity(n);
        for Row { r, moves } in &view.rows {
            filled.clear();
            filled.extend(0..6);
            for (link, point, v) in &view.moves[moves.clone()] {
                let turn = (point - view.pivot).cross(v);
                for k in 0..3 {
                    row[k] += turn[k];
                    row[3 + k] += v[k];
                }
                for &j in &self.hand.movers[*link] {
                    if row[6 + j] == 0.0 && !filled.contains(&(6 + j)) {
                        filled.push(6 + j);
                    }
                    row[6 + j] += v.dot(&self.hand.velocity(posed, j, point));
                }
            }
            for &i in &filled {
                g[i] += row[i] * r;
                for &k in &filled {
                    a[(k, i)] += row[i] * row[k];
                }
            }
            filled.iter().for_each(|&i| row[i] = 0.0);
        }
        self.closeness(state, view.pivot, Some((a, g)));
    }

    fn pivot(&self, view: &View) -> Point3<f64> {
        view.pivot
    }

    fn intervals(&self) -> &[(f64, f64)] {
        self.intervals
    }

    fn joints_move(&self) -> bool {
        self.joints_move
    }

    fn damped(&self, _: usize, entry: f64, damping: f64) -> f64 {
        entry * (1.0 + damping)
    }

    fn shorten(&self, step: &mut DVector<f64>) {
        let (turn, shift) = (step.rows(0, 3).norm(), step.rows(3, 3).norm());
        let joint = step.rows(6, step.len() - 6).amax();
        let most = (turn / MAX_TURN_RAD).max(shift / MAX_SHIFT_M).max(joint / MAX_TURN_RAD);
        if most > 1.0 {
            *step /= most;
        }
    }
}

impl View {
    fn push(&mut self, r: f64, moves: impl IntoIterator<Item = (usize, Point3<f64>, Vector3<f64>)>) {
        let start = self.moves.len();
        self.moves.extend(moves);
        self.rows.push(Row { r, moves: start..self.moves.len() });
    }
}
