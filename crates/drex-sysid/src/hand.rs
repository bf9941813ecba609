//! Pushes of a logged hand: the mass from the moment of the fingertips about the edge that the object tips over.
//!
//! Joint angles alone weigh nothing; the efforts beside them do, as far as they stand out of the joint friction
//! ([`crate::calibrate`]). Frames and clocks are found in the track where they are not stated ([`crate::frames`]), and
//! [`crate::bound`] makes a mass of it, with its interval.

use std::path::Path;

use drex_core::Object;
use drex_recording::{Drive, HandPush, PushRecording};
use drex_robot::Robot;

use crate::answer::{HandReport, Identification, Sensitivity, Verdict};
use crate::bound::{self, Bound, BoundOptions, Topple};
use crate::calibrate::{self, CalibrateOptions, ExtraTorque, HandCalibration, HandRun, Touch};
use crate::frames::{self, FoundFrames, FrameOptions, HandPlacement, Standing};
use crate::parameters::Parameter;
use crate::{IdentifyOptions, Result, SysidError};

/// An interval with a larger ratio of its ends does not weigh an object.
const MOST_RATIO: f64 = 4.0;
/// Steps of the difference quotients of sensitivities: log of the torques, metres of the table.
const GAIN_STEP: f64 = 0.1;
const HEIGHT_STEP: f64 = 0.01;

/// What one push of a hand tells.
pub(crate) struct Finding {
    pub report: HandReport,
    pub notes: Vec<String>,
    /// The mass, or why there is none.
    outcome: std::result::Result<Weighed, String>,
}

struct Weighed {
    bound: Bound,
    sensitivities: Vec<Sensitivity>,
}

/// Looks at all pushes of hands among `recordings`; others give `None`.
///
/// # Errors
/// If a log is not of the hand that is named, a track shows no push, or track and log do not belong together.
pub(crate) fn look(
    recordings: &[PushRecording],
    object: &Object,
    options: &IdentifyOptions,
) -> Result<Vec<Option<Finding>>> {
    let pushes: Vec<(&PushRecording, &HandPush)> = recordings.iter().filter_map(|r| Some((r, hand_of(r)?))).collect();
    let Some((_, first)) = pushes.first() else { return Ok(recordings.iter().map(|_| None).collect()) };
    let solid = Standing::of(object)?;
    let robot = Robot::resolve(&first.robot, Path::new("."))?;
    if let Some((r, other)) = pushes.iter().find(|p| p.1.robot != first.robot) {
        return Err(SysidError::Recording {
            push: r.name.clone(),
            what: format!("it is of the hand `{}`, the first push of `{}`", other.robot, first.robot),
            remedy: "identify with the pushes of one hand at a time".into(),
        });
    }
    let runs: Vec<HandRun<'_>> = pushes.iter().filter_map(|(r, _)| HandRun::of(r)).collect();
    runs.iter().try_for_each(|r| if r.has_efforts() { calibrate::check(r, &robot) } else { r.check(&robot) })?;
    let calibration = calibrated(&runs, &robot, options)?;
    let look_at = |r: &PushRecording| -> Result<Option<Finding>> {
        let Some(run) = HandRun::of(r) else { return Ok(None) };
        Scene { recording: r, run, robot: &robot, solid: &solid, options }.find(&calibration).map(Some)
    };
    recordings.iter().map(look_at).collect()
}

/// The stated calibration, or one from the free motions of these pushes, or why there is none.
fn calibrated(
    runs: &[HandRun<'_>],
    robot: &Robot,
    options: &IdentifyOptions,
) -> Result<std::result::Result<HandCalibration, String>> {
    if let Some(stated) = &options.hand {
        stated.check(robot)?;
        return Ok(Ok(stated.clone()));
    }
    let with_efforts: Vec<HandRun<'_>> = runs.iter().filter(|r| r.has_efforts()).copied().collect();
    if with_efforts.is_empty() {
        return Ok(Err("no joint efforts were logged".into()));
    }
    let made = calibrate::hand(&with_efforts, robot, &CalibrateOptions::default());
    Ok(made.map_err(|e| format!("nothing in these logs calibrates the joint friction ({e})")))
}

fn hand_of(recording: &PushRecording) -> Option<&HandPush> {
    match &recording.drive {
        Drive::Hand(hand) => Some(hand),
        _ => None,
    }
}

/// One push and what is known of it.
struct Scene<'a> {
    recording: &'a PushRecording,
    run: HandRun<'a>,
    robot: &'a Robot,
    solid: &'a Standing,
    options: &'a IdentifyOptions,
}

impl Scene<'_> {
    fn find(&self, calibration: &std::result::Result<HandCalibration, String>) -> Result<Finding> {
        let found = frames::find(&self.recording.track, self.solid, &FrameOptions::of(self.recording))?;
        let mut notes = found.remarks.clone();
        notes.push(format!("the object begins to move at {:.2} s", found.motion_start_s));
        let mut report = HandReport::of(&found);
        let replayed = |why: &str| {
            format!(
                "the hand is replayed from its joint angles, and a prescribed pusher moves every mass the same way: {why}; log joint \
                 efforts and calibrate the hand with `drex calibrate-hand`"
            )
        };
        let calibration = match calibration {
            _ if !self.run.has_efforts() => {
                let outcome = Err(replayed("the log holds no joint efforts"));
                return Ok(Finding { report, notes, outcome });
            }
            Err(why) => return Ok(Finding { report, notes, outcome: Err(replayed(why)) }),
            Ok(calibration) => calibration,
        };
        let extra = calibration.extra_torque(&self.run, self.robot)?;
        let touches = extra.touches(self.robot);
        let table = self.recording.support.table_height_m;
        let placement = match self.place(&found, &extra, &touches, table) {
            Ok(placement) => Some(placement),
            // Whether the two belong together at all is no matter of degree.
            Err(e @ SysidError::Core(_)) => return Err(e),
            Err(e) => {
                notes.push(format!("{e}: clock and height of the hand are taken as stated"));
                None
            }
        };
        report.place(placement.as_ref());
        let outcome = match self.bound(&found, &extra, &touches, placement.as_ref(), table) {
            Err(e) => Err(e.to_string()),
            Ok(bound) => {
                report.fill(&bound);
                notes.push(budget(&bound));
                let sensitivities = self.sensitivities(&found, &extra, &touches, &bound, table);
                Ok(Weighed { bound, sensitivities })
            }
        };
        Ok(Finding { report, notes, outcome })
    }

    fn place(
        &self,
        found: &FoundFrames,
        extra: &ExtraTorque,
        touches: &[Touch],
        table_height_m: f64,
    ) -> Result<HandPlacement> {
        let tips = frames::tip_paths(self.robot, self.run.world_from_base, extra, touches, found.motion_start_s);
        frames::against_hand(found, &self.recording.track, self.solid, &tips, table_height_m)
    }

    fn bound(
        &self,
        found: &FoundFrames,
        extra: &ExtraTorque,
        touches: &[Touch],
        placement: Option<&HandPlacement>,
        table_height_m: f64,
    ) -> Result<Bound> {
        let topple = Topple {
            robot: self.robot,
            world_from_base: self.run.world_from_base,
            table_height_m,
            extra,
            touches,
            track: &self.recording.track,
            solid: self.solid,
            found,
            placement,
            gravity_m_s2: self.recording.gravity.norm(),
        };
        let options = BoundOptions { range_kg: self.options.scan_kg, ..BoundOptions::default() };
        bound::of_topple(&topple, &options)
    }

    /// Difference quotients: all of it again with other torques and with another table.
    fn sensitivities(
        &self,
        found: &FoundFrames,
        extra: &ExtraTorque,
        touches: &[Touch],
        bound: &Bound,
        table: f64,
    ) -> Vec<Sensitivity> {
        if !bound.seen {
            return Vec::new();
        }
        let log_mass = |log_gain: f64, lower_m: f64| {
            let mut extra = extra.clone();
            extra.torque_nm.iter_mut().flatten().for_each(|t| *t *= log_gain.exp());
            let placement = self.place(found, &extra, touches, table - lower_m).ok();
            let moved = self.bound(found, &extra, touches, placement.as_ref(), table - lower_m).ok()?;
            Some(moved.mass.median_kg().ln())
        };
        let gain = || Some((log_mass(GAIN_STEP, 0.0)? - log_mass(-GAIN_STEP, 0.0)?) / (2.0 * GAIN_STEP));
        // A lower table is a higher contact.
        let height = || Some((log_mass(0.0, HEIGHT_STEP)? - log_mass(0.0, -HEIGHT_STEP)?) / (2.0 * HEIGHT_STEP));
        [(Parameter::ForceGain, gain()), (Parameter::ContactHeight, height())]
            .into_iter()
            .filter_map(|(parameter, log_mass)| Some(Sensitivity { parameter, log_mass: log_mass? }))
            .collect()
    }
}

/// "the standard deviation of log mass is 0.35, of which edge of the foot 0.24, …".
fn budget(b: &Bound) -> String {
    if !b.seen {
        return format!("{}: a heavier object would have shown, a lighter one not", b.limits());
    }
    let parts: Vec<String> = b.budget.iter().take(5).map(|(n, sd)| format!("{n} {:.2}", sd / b.per_kg.abs())).collect();
    format!(
        "moment of the fingertips about the edge of the foot over {} frames: standard deviation of log mass {:.2}; {}",
        b.frames[1],
        b.mass.sd_log(),
        parts.join(", ")
    )
}

/// Verdict and numbers from what the pushes tell; `false` if none of `found` is of a hand.
pub(crate) fn decide(answer: &mut Identification, found: &[Option<Finding>]) -> bool {
    let found: Vec<&Finding> = found.iter().flatten().collect();
    if found.is_empty() {
        return false;
    }
    let weighed: Vec<&Weighed> = found.iter().filter_map(|f| f.outcome.as_ref().ok()).collect();
    let refused: Vec<&str> = found.iter().filter_map(|f| Some(f.outcome.as_ref().err()?.as_str())).collect();
    let bounds: Vec<&Bound> = weighed.iter().map(|w| &w.bound).collect();
    let Some(mass) = bound::together(&bounds) else {
        answer.reason = refused.join(" ");
        return true;
    };
    let [lo, hi] = mass.ends_kg();
    answer.profile = mass.costs().collect();
    answer.sd_log_mass = Some(mass.sd_log());
    answer.sensitivities = weighed.iter().find(|w| w.bound.seen).map(|w| w.sensitivities.clone()).unwrap_or_default();
    let grams = format!("{:.0} to {:.0} g (upper end {:.1} times the lower)", 1e3 * lo, 1e3 * hi, hi / lo);
    let limit = bounds.iter().find(|b| b.seen).or(bounds.first()).map_or("nothing", |b| b.limits());
    let excluded = mass.bounds_kg().map(|end| end.is_some());
    answer.ci95_kg = excluded.contains(&true).then_some([lo, hi]);
    answer.reason = match excluded {
        [true, true] if hi / lo <= MOST_RATIO => {
            answer.verdict = Verdict::Identified;
            answer.mass_kg = Some(mass.median_kg());
            format!("the joint efforts of the hand while it tips the object over the edge of its foot tell {grams}")
        }
        [true, true] => format!(
            "the joint efforts bound the mass to {grams}, which is too wide to weigh it; the most is lost to: {limit}; a heavier \
             object, a slower push, or a force sensor would tell more"
        ),
        [false, true] => format!(
            "the joint efforts bound the mass from above only: at most {:.0} g; {limit}; push higher and with one finger, or use \
             a force sensor",
            1e3 * hi
        ),
        [true, false] => format!(
            "the joint efforts bound the mass from below only: at least {:.0} g; the most is lost to: {limit}; push more slowly, \
             or use a force sensor",
            1e3 * lo
        ),
        [false, false] => format!("the joint efforts exclude no mass from {grams}; {limit}; use a force sensor"),
    };
    if !refused.is_empty() {
        answer.reason = format!("{} {}", answer.reason, refused.join(" "));
    }
    true
}

/// What a weighing by joint efforts takes for granted.
pub(crate) fn assumptions(recordings: &[PushRecording], options: &IdentifyOptions) -> Vec<String> {
    if !recordings.iter().filter_map(HandRun::of).any(|r| r.has_efforts()) {
        return Vec::new();
    }
    let o = BoundOptions::default();
    vec![
        match &options.hand {
            Some(c) => format!("joint friction is as calibrated from {} run(s): {}", c.runs.len(), c.runs.join(", ")),
            None => "joint friction is as calibrated from the free motions of these same logs".into(),
        },
        "logged efforts are torques at the joints, and the masses of the hand's links are right to 10 %".into(),
        "the object tips about an edge of its foot that stays where it is, to 15 % of its weight's moment".into(),
        format!(
            "known to within (standard deviations): edge of the foot {:.0} %, height of the centre of mass {:.0} %, tracked lean {:.0} \
             %, friction of the tips {:.1} either way",
            100.0 * o.foot_sd,
            100.0 * o.density_sd,
            100.0 * o.lean_sd,
            o.tip_friction_sd
        ),
        format!("the mass is between {} and {} kg", options.scan_kg[0], options.scan_kg[1]),
    ]
}
