//! Contact forces and the velocities they lead to, found together at the end of the step.
//!
//! The equations are solved by Newton's method on plain numbers; derivatives follow from one more step on dual numbers
//! with the converged matrix (implicit function theorem).

pub(crate) mod contact_model;
pub(crate) mod free;
pub(crate) mod island;
pub(crate) mod lu;
pub(crate) mod six;
pub(crate) mod soft;

use nalgebra::{UnitQuaternion, Vector3};

use crate::contact::Contact;
use crate::state::Anchor;
use crate::{ContactOptions, Scalar};
use contact_model::ContactModel;

/// Number of corners that carry a flat face at full stiffness.
const FACE_CORNERS: f64 = 4.0;

/// What a contact does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mode {
    Open,
    Sticks,
    Slips,
}

/// Appends the contact models of the contacts of one patch (one pair of parts), given the stiffness of the whole patch.
///
/// The stiffness is shared by those that carry, weighed by how evenly they carry (participation ratio), so that the
/// total does not grow with the number of points. Points of a sampled surface share all of it by their areas; corners
/// and edges take a fourth of it, unless more than four carry. `rotation` turns the frame of the support, in which the
/// springs are kept, to the world.
pub(crate) fn prepare_patch<T: Scalar>(
    contacts: &[Contact<T>],
    stiffness: T,
    options: &ContactOptions<T>,
    dt: f64,
    anchors: &[Anchor<T>],
    rotation: Option<&UnitQuaternion<T>>,
    out: &mut Vec<ContactModel<T>>,
) {
    let (mut sum, mut squares) = (T::zero(), T::zero());
    for c in contacts.iter().filter(|c| c.depth.value() > 0.0) {
        let carried = c.depth * T::lift(c.weight);
        sum += carried;
        squares += carried * c.depth;
    }
    let sampled = contacts.first().is_some_and(|c| c.sampled);
    let floor = if sampled { 0.0 } else { FACE_CORNERS };
    let participation = if squares.value() > 0.0 { sum * sum / squares } else { T::zero() };
    let shares = if participation.value() > floor {
        participation
    } else {
        T::lift(if sampled { contacts.iter().map(|c| c.weight).sum() } else { floor })
    };
    let h = T::lift(dt);
    let first = contacts.first().map_or(0, |c| anchors.partition_point(|a| a.key < c.key));
    let mut old = anchors[first..].iter().peekable();
    for c in contacts {
        while old.next_if(|a| a.key < c.key).is_some() {}
        let (kept, twist) = old.next_if(|a| a.key == c.key).map_or_else(
            || (Vector3::zeros(), T::zero()),
            |a| (rotation.map_or(a.stretch, |r| r * a.stretch), a.twist),
        );
        let share = T::lift(c.weight) / shares;
        let k_n = stiffness * share;
        let kappa_n = k_n * (h + options.relaxation_s);
        let k_t = k_n * options.tangential_ratio;
        let kappa_t = k_t * (h + options.tangential_relaxation_s);
        let squared = T::lift(c.lever * c.lever);
        out.push(ContactModel {
            normal: c.normal,
            friction: c.friction,
            share,
            // A gap may close by the end of the step, and no further.
            preload: if c.depth.value() > 0.0 { k_n * c.depth } else { kappa_n * c.depth / h },
            kappa_n,
            stretch: kept - c.normal * kept.dot(&c.normal),
            k_t,
            kappa_t,
            lever: c.lever,
            twist,
            k_r: k_t * squared,
            kappa_r: kappa_t * squared,
            lagged: None,
            soft: None,
        });
    }
}
