//! The pushes that are tried.

use drex_recording::{PoseConfig, Support, SupportBox};
use nalgebra::{Point3, Vector3};

use super::{G, GuardedPush, PlanOptions, PushDrive, PushKind, RobotLimits, Standing};

/// Times in which a force doubles, seconds. Where an object tips, θ grows with the third power of time from then on; much faster, and
/// a usual reaction comes too late.
const DOUBLING_S: [f64; 2] = [0.8, 0.25];
/// Heights of tipping pushes, as a share of the object's.
const HEIGHTS: [f64; 2] = [0.95, 0.65];
/// Height of sliding pushes, as a share of that of the centre of mass.
const LOW: f64 = 0.4;
/// How far it is leant, radians, and as a share of the angle at which it falls.
const LEAN: (f64, f64) = (0.045, 0.2);
/// How far beyond the falling angle it is brought before letting go, radians.
const BEYOND: f64 = 0.12;
const RISE_M: f64 = 0.02;
const SLIDE_M: f64 = 0.05;
/// Speeds of a fingertip: a fast push at most, a slow one, slow and brisk tipping, m/s.
const SPEEDS_M_S: [f64; 4] = [0.4, 0.03, 0.04, 0.1];
/// How far behind an edge the centre of mass is placed, as a share of what reaches beyond it.
const OVERHANG: f64 = 0.45;
/// Least free end to press on, metres; and how far from its end one presses, as a share of it.
const LEAST_END_M: f64 = 0.01;
const FROM_END: f64 = 0.12;

/// All of them. `lightest_kg` sets the force to begin with.
pub(super) fn all(
    standing: &Standing,
    support: &Support,
    robot: &RobotLimits,
    options: &PlanOptions,
    friction: f64,
    lightest_kg: f64,
) -> Vec<GuardedPush> {
    let make = Maker { standing, lightest_kg, place: on_table(support, standing) };
    let mut out = Vec::new();
    let tipping = make.tipping(options.topple);
    let slide = make.slide(friction);
    let presses: Vec<GuardedPush> = support.boxes.iter().filter_map(|b| make.press(b)).collect();
    if let Some(force) = &robot.force {
        for doubling_s in DOUBLING_S {
            let with = |p: &GuardedPush| GuardedPush { doubling_s: Some(doubling_s), ..p.clone() };
            let brisk = doubling_s < DOUBLING_S[0];
            out.extend(force.lifts.then(|| with(&make.lift())));
            out.extend(slide.iter().map(with));
            out.extend(tipping.iter().take(if brisk { 1 } else { usize::MAX }).map(with));
            out.extend(presses.iter().map(with));
        }
    }
    if let Some(finger) = &robot.finger {
        let with = |p: &GuardedPush, speed: f64| GuardedPush {
            drive: PushDrive::Finger,
            first_force_n: None,
            speed_m_s: Some(speed.min(finger.max_speed_m_s)),
            ..p.clone()
        };
        let [fast, slow, lean, brisk] = SPEEDS_M_S;
        out.extend(slide.iter().flat_map(|p| [with(p, fast), with(p, slow)]));
        out.extend(tipping.iter().map(|p| with(p, lean)));
        out.extend(tipping.iter().take(1).map(|p| with(p, brisk)));
        out.extend(presses.iter().map(|p| with(p, lean)));
    }
    out
}

/// A place on the table away from every box.
fn on_table(support: &Support, standing: &Standing) -> Point3<f64> {
    let ends = support.boxes.iter().map(|b| b.center_m[0] + b.half_m[0]);
    let x = ends.reduce(f64::max).map_or(0.0, |end| end + standing.reach(&-Vector3::x()) + 0.5);
    Point3::new(x, 0.0, support.table_height_m)
}

struct Maker<'a> {
    standing: &'a Standing,
    lightest_kg: f64,
    place: Point3<f64>,
}

impl Maker<'_> {
    fn push(&self, kind: PushKind, at: &Point3<f64>, direction: Vector3<f64>, threshold: f64) -> GuardedPush {
        self.push_from(&self.place, kind, at, direction, threshold)
    }

    /// `at` in the frame of the standing object; `threshold` is the force over mass at which the object yields.
    fn push_from(
        &self,
        place: &Point3<f64>,
        kind: PushKind,
        at: &Point3<f64>,
        direction: Vector3<f64>,
        threshold: f64,
    ) -> GuardedPush {
        let s = self.standing;
        GuardedPush {
            kind,
            drive: PushDrive::Force,
            direction: direction.into(),
            point_in_object_m: s.from_mesh.inverse_transform_point(at).into(),
            height_m: at.z,
            threshold_n_per_kg: threshold,
            first_force_n: Some(0.5 * threshold * self.lightest_kg),
            doubling_s: None,
            speed_m_s: None,
            until_tilt_deg: None,
            until_travel_m: None,
            start: PoseConfig::from(&s.start(place)),
        }
    }

    fn lift(&self) -> GuardedPush {
        let push = self.push(PushKind::Lift, &self.standing.center, Vector3::z(), G);
        GuardedPush { until_travel_m: Some(RISE_M), ..push }
    }

    /// Low, in the direction in which it is hardest to tip.
    fn slide(&self, friction: f64) -> Option<GuardedPush> {
        let s = self.standing;
        let direction = horizontal().into_iter().max_by(|a, b| s.base_reach(a).total_cmp(&s.base_reach(b)))?;
        let at = s.side(&direction, LOW * s.center.z)?;
        let push = self.push(PushKind::Slide, &at, direction, G * friction);
        Some(GuardedPush { until_travel_m: Some(SLIDE_M), ..push })
    }

    /// High, over the nearer edge of each axis, the easiest first.
    fn tipping(&self, topple: bool) -> Vec<GuardedPush> {
        let s = self.standing;
        let mut directions: Vec<Vector3<f64>> = horizontal()
            .chunks(2)
            .filter_map(|pair| pair.iter().min_by(|a, b| s.base_reach(a).total_cmp(&s.base_reach(b))).copied())
            .collect();
        directions.sort_by(|a, b| s.base_reach(a).total_cmp(&s.base_reach(b)));
        let mut out = Vec::new();
        for direction in directions {
            let reach = s.base_reach(&direction);
            let falling = reach.atan2(s.center.z);
            for share in HEIGHTS {
                let Some(at) = s.side(&direction, share * s.height()) else { continue };
                let push = |kind| self.push(kind, &at, direction, G * reach / at.z);
                out.push(GuardedPush { until_tilt_deg: Some(lean(falling)), ..push(PushKind::Tilt) });
                if topple {
                    let fall = (falling + BEYOND).to_degrees();
                    out.push(GuardedPush { until_tilt_deg: Some(fall), ..push(PushKind::Topple) });
                }
            }
        }
        out
    }

    /// On the box, sticking out over its edge in the direction in which the object is longest.
    fn press(&self, b: &SupportBox) -> Option<GuardedPush> {
        let s = self.standing;
        let direction = horizontal().into_iter().max_by(|a, b| s.reach(a).total_cmp(&s.reach(b)))?;
        let behind = OVERHANG * s.reach(&direction);
        let end = s.reach(&direction) - behind;
        if end < LEAST_END_M {
            return None;
        }
        let at = s.top(&(s.center + direction * (behind + (1.0 - FROM_END) * end)))?;
        let edge = Vector3::from(b.half_m).component_mul(&direction).abs().sum();
        let top = Point3::from(b.center_m) + Vector3::z() * b.half_m[2];
        let place = top + direction * (edge - behind);
        let arm = (at - s.center).dot(&direction) - behind;
        let push = self.push_from(&place, PushKind::OverhangPress, &at, -Vector3::z(), G * behind / arm);
        Some(GuardedPush { until_tilt_deg: Some(lean(behind.atan2(s.center.z))), ..push })
    }
}

/// How far to lean what falls at an angle, degrees.
fn lean(falling: f64) -> f64 {
    LEAN.0.min(LEAN.1 * falling).to_degrees()
}

fn horizontal() -> [Vector3<f64>; 4] {
    [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_pushed_from_four_sides() {
        let sides = horizontal();
        for (i, a) in sides.iter().enumerate() {
            let along: Vec<f64> = sides.iter().map(|b| a.dot(b)).collect();
            assert_eq!(along.iter().filter(|x| **x == 0.0).count(), 2);
            assert!(along[i] == 1.0 && along.contains(&-1.0));
        }
    }
}
