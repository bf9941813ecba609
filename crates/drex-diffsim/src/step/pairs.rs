//! Which shapes may touch in a step, and where.

use nalgebra::{Point3, Vector3};

use super::Workspace;
use crate::articulation::Articulation;
use crate::collide::{self, Frame, Touch};
use crate::collider::Collider;
use crate::contact::{Contact, ContactKey};
use crate::material::Material;
use crate::math::lift_pose;
use crate::{Error, Model, Part, Result, Scalar, Scene, Shape};

/// Gap that always counts as closing, metres.
const NEAR_M: f64 = 1e-6;
/// A start deeper inside something than this part of the body's size is refused.
const START_DEPTH: f64 = 0.25;

/// One part as contact search sees it.
struct Side<'a, T: Scalar> {
    part: Part,
    collider: &'a Collider,
    frame: Frame<f64>,
    exact: Frame<T>,
    material: Material<T>,
    /// Bound on the speed of its points, m/s.
    speed: f64,
}

/// All contacts that are closed or may close within `dt`, by increasing key.
pub(crate) fn find<T: Scalar>(model: &Model<T>, scene: &Scene<T>, work: &mut Workspace<T>, dt: f64) {
    let mut contacts = std::mem::take(&mut work.contacts);
    let mut search = std::mem::take(&mut work.collide);
    let mut touches = std::mem::take(&mut work.touches);
    contacts.clear();
    visit(model, scene, work, |a, b| {
        touch(a, b, (a.speed + b.speed) * dt + NEAR_M, &mut search, &mut touches, &mut contacts, None);
    });
    (work.contacts, work.collide, work.touches) = (contacts, search, touches);
}

#[cfg(feature = "ablation")]
/// As [`find`], and the features of each contact, by which it is followed while its parts move.
pub(crate) fn find_features<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    work: &mut Workspace<T>,
    dt: f64,
    features: &mut Vec<Touch>,
) {
    let mut contacts = std::mem::take(&mut work.contacts);
    let mut search = std::mem::take(&mut work.collide);
    let mut touches = std::mem::take(&mut work.touches);
    contacts.clear();
    features.clear();
    visit(model, scene, work, |a, b| {
        let margin = (a.speed + b.speed) * dt + NEAR_M;
        touch(a, b, margin, &mut search, &mut touches, &mut contacts, Some(&mut *features));
    });
    (work.contacts, work.collide, work.touches) = (contacts, search, touches);
}

/// Refuses a start in which something is deep inside something else.
pub(crate) fn check_start<T: Scalar>(model: &Model<T>, scene: &Scene<T>, work: &mut Workspace<T>) -> Result<()> {
    let mut search = std::mem::take(&mut work.collide);
    let (mut touches, mut contacts) = (Vec::new(), Vec::new());
    let mut worst = Ok(());
    visit(model, scene, work, |a, b| {
        contacts.clear();
        touch(a, b, 0.0, &mut search, &mut touches, &mut contacts, None);
        let size = |s: &Side<'_, T>| 2.0 * s.collider.bounding_sphere().1;
        let depth_m = contacts.iter().map(|c| c.depth.value()).fold(0.0, f64::max);
        if depth_m > START_DEPTH * size(a).min(size(b)) && worst.is_ok() {
            worst = Err(Error::StartsInside { what: name(model, a.part), depth_m, support: name(model, b.part) });
        }
    });
    work.collide = search;
    worst
}

/// Refuses pairs of shapes that contact is not found between.
pub(crate) fn check_shapes<T: Scalar>(model: &Model<T>, scene: &Scene<T>, work: &Workspace<T>) -> Result<()> {
    let mut result = Ok(());
    visit_all(model, scene, work, |a, b| {
        for (i, x) in a.collider.geoms().iter().enumerate() {
            for (j, y) in b.collider.geoms().iter().enumerate() {
                if !collide::supported(&x.shape, &y.shape) && result.is_ok() {
                    result = Err(Error::Unsupported {
                        what: format!(
                            "shape {i} of {} against shape {j} of {}",
                            name(model, a.part),
                            name(model, b.part)
                        ),
                    });
                }
            }
        }
    });
    result
}

/// Calls `f` for every pair of parts whose bounding balls come near each other, by increasing keys.
fn visit<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    work: &Workspace<T>,
    mut f: impl FnMut(&Side<'_, T>, &Side<'_, T>),
) {
    let dt = model.dt_s;
    visit_all(model, scene, work, |a, b| {
        let ((ca, ra), (cb, rb)) = (a.collider.bounding_sphere(), b.collider.bounding_sphere());
        let gap = if ra.is_finite() && rb.is_finite() {
            (a.frame.point(&ca) - b.frame.point(&cb)).norm() - ra - rb
        } else {
            0.0 // a plane; the search itself begins with the distance to it
        };
        if gap <= (a.speed + b.speed) * dt + NEAR_M {
            f(a, b);
        }
    });
}

fn visit_all<T: Scalar>(
    model: &Model<T>,
    scene: &Scene<T>,
    work: &Workspace<T>,
    mut f: impl FnMut(&Side<'_, T>, &Side<'_, T>),
) {
    let static_body = |i: usize| Side {
        part: Part::Static(i as u32),
        collider: &scene.static_bodies[i].collider,
        frame: Frame::of(&scene.static_bodies[i].world_from_body),
        exact: Frame::of(&lift_pose(&scene.static_bodies[i].world_from_body)),
        material: scene.static_bodies[i].material,
        speed: 0.0,
    };
    let kinematic_body = |i: usize| {
        let (m, motion) = (&scene.kinematic_bodies[i], &work.motions[i]);
        Side {
            part: Part::Kinematic(i as u32),
            collider: &m.collider,
            frame: Frame::of(&motion.pose),
            exact: Frame::of(&lift_pose(&motion.pose)),
            material: m.material,
            speed: motion.velocity.norm() + motion.angular_velocity.norm() * m.collider.reach_from(&Point3::origin()),
        }
    };
    let body = |i: usize| Side {
        part: Part::Body(i as u32),
        collider: &model.bodies[i].collider,
        frame: work.frames[i].plain,
        exact: work.frames[i].frame,
        material: model.bodies[i].material,
        speed: work.frames[i].speed,
    };
    for i in 0..model.bodies.len() {
        let a = body(i);
        (0..scene.static_bodies.len()).for_each(|k| f(&a, &static_body(k)));
        (0..scene.kinematic_bodies.len()).for_each(|k| f(&a, &kinematic_body(k)));
        (i + 1..model.bodies.len()).for_each(|k| f(&a, &body(k)));
        for (k, arm) in model.articulations.iter().enumerate() {
            links(model, k).for_each(|l| f(&a, &link(arm, work, k, l)));
        }
    }
    for (i, arm) in model.articulations.iter().enumerate() {
        for l in links(model, i) {
            let a = link(arm, work, i, l);
            (0..scene.static_bodies.len()).for_each(|k| f(&a, &static_body(k)));
            (0..scene.kinematic_bodies.len()).for_each(|k| f(&a, &kinematic_body(k)));
            if arm.self_collision {
                let later = links(model, i).filter(|&m| m > l && arm.robot.may_collide(l, m));
                later.for_each(|m| f(&a, &link(arm, work, i, m)));
            }
            for (k, other) in model.articulations.iter().enumerate().skip(i + 1) {
                links(model, k).for_each(|m| f(&a, &link(other, work, k, m)));
            }
        }
    }
}

/// Links of an articulation that have shapes.
fn links<T: Scalar>(model: &Model<T>, arm: usize) -> impl Iterator<Item = usize> {
    let colliders = &model.articulations[arm].colliders;
    (0..colliders.len()).filter(|&l| !colliders[l].geoms().is_empty())
}

fn link<'a, T: Scalar>(arm: &'a Articulation<T>, work: &Workspace<T>, index: usize, l: usize) -> Side<'a, T> {
    let motion = &work.trees[index].links[l];
    let collider = &arm.colliders[l];
    let exact = Frame { r: motion.rotation, p: motion.world_from_link.translation.vector };
    let speed = |v: &Vector3<T>| v.map(|x| x.value()).norm();
    Side {
        part: Part::Link { articulation: index as u32, link: l as u32 },
        collider,
        frame: exact.value(),
        exact,
        material: arm.materials[l],
        speed: speed(&motion.velocity) + speed(&motion.angular_velocity) * collider.reach_from(&Point3::origin()),
    }
}

/// Contacts of all shapes of `a` with all shapes of `b`, and their features where they are asked for.
fn touch<T: Scalar>(
    a: &Side<'_, T>,
    b: &Side<'_, T>,
    margin: f64,
    search: &mut collide::CollideWork,
    touches: &mut Vec<Touch>,
    out: &mut Vec<Contact<T>>,
    mut features: Option<&mut Vec<Touch>>,
) {
    let material = a.material.paired(&b.material);
    for (i, x) in a.collider.prepared().iter().enumerate() {
        for (j, y) in b.collider.prepared().iter().enumerate() {
            let (corners, sampled) = carriage(&a.collider.geoms()[i].shape, &b.collider.geoms()[j].shape);
            touches.clear();
            collide::find(x, &a.frame, y, &b.frame, margin, search, touches);
            for t in touches.iter() {
                let place = t.evaluate(&a.exact, &b.exact);
                out.push(Contact {
                    key: ContactKey { a: a.part, b: b.part, geom_a: i as u16, geom_b: j as u16, site: t.site },
                    point: place.point,
                    normal: place.normal,
                    depth: place.depth,
                    weight: t.weight * corners,
                    sampled,
                    friction: material.friction,
                    lever: material.torsion_radius_m,
                });
            }
            if let Some(features) = &mut features {
                features.append(touches);
            }
        }
    }
}

/// How many corners of a face one point of contact between two shapes stands for, and whether it stands for an area
/// instead.
fn carriage(a: &Shape, b: &Shape) -> (f64, bool) {
    match (a, b) {
        (Shape::Points(_), _) | (_, Shape::Points(_)) => (1.0, true),
        (Shape::Sphere { .. }, _) | (_, Shape::Sphere { .. }) => (4.0, false),
        (Shape::Capsule { .. }, _) | (_, Shape::Capsule { .. }) => (2.0, false),
        _ => (1.0, false),
    }
}

/// Refuses a part that the model does not have, or that nothing can act on.
pub(crate) fn check_part<T: Scalar>(model: &Model<T>, part: Part, what: impl Fn() -> String) -> Result<()> {
    let known = match part {
        Part::Body(i) => (i as usize) < model.bodies.len(),
        Part::Link { articulation: arm, link } => {
            model.articulations.get(arm as usize).is_some_and(|a| (link as usize) < a.robot.links.len())
        }
        Part::Static(_) | Part::Kinematic(_) => false,
    };
    if known { Ok(()) } else { Err(Error::Part { what: what(), part: format!("{part:?}") }) }
}

/// What an error calls a part.
pub(crate) fn name<T: Scalar>(model: &Model<T>, part: Part) -> String {
    match part {
        Part::Static(i) => format!("static body {i}"),
        Part::Kinematic(i) => format!("kinematic body {i}"),
        Part::Body(i) => format!("body {i}"),
        Part::Link { articulation: arm, link } => {
            let links = model.articulations.get(arm as usize).map(|a| &a.robot.links);
            let name = links.and_then(|l| l.get(link as usize)).map_or("?", |l| l.name.as_str());
            format!("link \"{name}\" of articulation {arm}")
        }
    }
}
