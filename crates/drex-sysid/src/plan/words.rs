//! A planned push in words.

use nalgebra::Vector3;

use super::rehearse::Stage;
use super::{GuardedPush, PlannedOutcome, PushDrive, PushKind};
use crate::Verdict;

/// The push and what to expect of it in one line.
pub(super) fn text(push: &GuardedPush, outcomes: &[PlannedOutcome], verdict: Verdict) -> String {
    let (height, towards) = (1e3 * push.height_m, heading(&push.direction.into()));
    let what = match push.kind {
        PushKind::Lift => "lift at the centre of mass".to_owned(),
        PushKind::Slide => format!("slide {towards} at height {height:.0} mm"),
        PushKind::Tilt => format!("tilt about the far edge {towards} at height {height:.0} mm"),
        PushKind::Topple => format!("topple over the far edge {towards} at height {height:.0} mm"),
        PushKind::OverhangPress => format!("press on the overhanging end at height {height:.0} mm"),
    };
    let how = match (push.drive, push.speed_m_s) {
        (PushDrive::Finger, Some(v)) => format!("with the fingertip at {:.0} mm/s", 1e3 * v),
        _ => format!("with a force that doubles every {:.2} s", push.doubling_s.unwrap_or_default()),
    };
    let until = match (push.until_tilt_deg, push.until_travel_m) {
        (Some(tilt), _) => format!("until it leans {tilt:.1} deg"),
        (_, Some(way)) => format!("until it has moved {:.0} mm", 1e3 * way),
        _ => String::new(),
    };
    let done: Vec<&PlannedOutcome> = outcomes.iter().filter(|o| o.refused.is_none()).collect();
    let force = match (done.first(), done.last()) {
        (Some(a), Some(b)) if done.len() > 1 => format!(
            " ({:.2} N at {:.0} g to {:.2} N at {:.0} g)",
            a.peak_force_n,
            1e3 * a.mass_kg,
            b.peak_force_n,
            1e3 * b.mass_kg
        ),
        (Some(a), _) => format!(" ({:.2} N at {:.0} g)", a.peak_force_n, 1e3 * a.mass_kg),
        _ => String::new(),
    };
    let weighed: Vec<&PlannedOutcome> = outcomes.iter().filter(|o| o.verdict == Verdict::Identified).collect();
    let sd = weighed.iter().filter_map(|o| o.sd_log_mass).sum::<f64>() / weighed.len().max(1) as f64;
    let result = match (verdict, weighed.first().zip(weighed.last())) {
        (Verdict::Identified, Some((a, b))) if weighed.len() < outcomes.len() => {
            format!("+-{:.1} % from {:.0} to {:.0} g only", 100.0 * half_width(sd), 1e3 * a.mass_kg, 1e3 * b.mass_kg)
        }
        (Verdict::Identified, _) => format!("+-{:.1} %", 100.0 * half_width(sd)),
        (Verdict::OnlyMuM, _) => "friction times mass only".into(),
        (Verdict::Fitted | Verdict::NotIdentifiable, _) => "no mass".into(),
    };
    format!("{what} {how} {until}{force}: {result}")
}

/// Half of a 95 % interval, relative, of a standard deviation of the logarithm.
pub(super) fn half_width(sd: f64) -> f64 {
    (1.96 * sd).exp() - 1.0
}

/// Why it tells what it tells.
pub(super) fn why(push: &GuardedPush, stage: &Stage<'_>, verdict: Verdict) -> String {
    let unknown = stage.support.friction.is_none();
    let finger = stage.robot.finger.filter(|_| push.drive == PushDrive::Finger);
    let source = match finger {
        None => "the measured force",
        Some(f) if f.encoder_m.is_some() => "the fingertip's spring, read by its encoder,",
        Some(_) => "the fingertip's spring, seen by the tracker alone,",
    };
    if verdict == Verdict::NotIdentifiable {
        return match finger {
            Some(_) => "the finger moves every mass in nearly the same way: its deflection is lost in the noise; a softer finger or \
                        an encoder would show it"
                .into(),
            None => "the motion is nearly the same for every mass".into(),
        };
    }
    match push.kind {
        PushKind::Lift => format!("{source} lifts the weight itself; friction plays no part"),
        PushKind::Tilt | PushKind::Topple => format!(
            "{source} times its height balances weight times lever; the edge sticks if friction is above {:.2}, and then \
             friction plays no part",
            push.threshold_n_per_kg / super::G
        ),
        PushKind::OverhangPress => {
            format!("{source} on the free end balances weight behind the edge; friction plays no part")
        }
        PushKind::Slide if verdict == Verdict::OnlyMuM => {
            format!("{source} balances friction, so only friction times mass shows; state the friction, tip or lift it")
        }
        PushKind::Slide if unknown => {
            format!("{source} fights friction times mass; only the coast after it tells friction by itself")
        }
        PushKind::Slide => {
            format!("{source} fights friction times mass: an error of the stated friction goes straight into the mass")
        }
    }
}

pub(super) fn too_weak(limit_n: f64) -> String {
    format!("it needs more than the {limit_n:.2} N or the way that there are")
}

pub(super) fn slides(friction: f64) -> String {
    format!("with friction {friction:.2} it slides before it tips")
}

pub(super) fn falls(tilt: f64) -> String {
    format!("it would lean {:.0} deg, or fall over", tilt.to_degrees())
}

pub(super) fn unmoved() -> String {
    "it does not move".into()
}

fn heading(d: &Vector3<f64>) -> String {
    let k = d.iamax();
    let sign = if d[k] < 0.0 { "-" } else { "+" };
    format!("towards {sign}{}", ["x", "y", "z"][k])
}
