//! Is a grasp any good? Without simulating it: where the hand is, what it touches, and what that holds at rest. It is a calculation, not a
//! success rate.

use drex_core::{Object, SdfSample, SignedDistance, SolidGeometry};
use drex_robot::Robot;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use crate::grip_force::describe;
use crate::{
    ClosureOptions, Contact, ContactOptions, Grasp, GraspContact, GraspError, GripForceError, GripForceProblem,
    GripForceSolution, HandSurface, Result, SelfCollision, TorqueLimits, force_closure, is_force_closed,
    minimum_grip_force, smallest_forces,
};

/// The limits that a grasp has to keep. A stage that needs another limit changes that field, and says why there.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct EvaluationOptions {
    /// What counts as a contact; the friction there is the object's, whatever this says. A link that is 2 mm off the surface touches: pads give by as much when they are pressed, and
    /// mesh and pose are no better known.
    pub contact: ContactOptions,
    /// Margin γ on the weight: 1 carries it at rest.
    pub gamma: f64,
    /// A finger touches if a point of it is at most this far from the surface, metres: 2 mm, as for a contact.
    pub touch_gap_m: f64,
    /// Deepest that the hand may be inside the object, metres: 2 mm, for the reason that 2 mm off touches; deeper a trial starts with a blow.
    pub max_penetration_m: f64,
    /// Deepest that two links may be inside each other, metres: 1 mm, since collision shapes are rounder than links.
    pub max_self_collision_m: f64,
    /// Least height of the hand above the table top, metres; minus infinity where there is no table. It may be 1 mm below: the table of a scan is no better known.
    pub min_table_clearance_m: f64,
    /// Fingers that have to touch besides the thumb: 2, since a pinch of two hard fingertips turns about the line between them.
    pub min_fingers: usize,
    /// Whether the thumb has to touch (if the model has one): the other fingers close towards it.
    pub thumb: bool,
    /// Soft fingers: torsional friction, metres.
    pub torsion_m: Option<f64>,
    /// Damage limit per contact, N.
    pub max_normal_n: Option<f64>,
    /// Whether joint torques are limited to what the motors give.
    pub motors: bool,
    /// Whether the contacts have to be in force closure and to carry the weight. A grasp that people demonstrated need not, as long as its fingers are at
    /// the surface: they close further.
    pub must_hold: bool,
    /// Whether all that is wrong is looked for, and qualities and margins are computed. A search asks for no more than whether a grasp passes, which does
    /// not depend on it.
    pub complete: bool,
}

impl Default for EvaluationOptions {
    fn default() -> Self {
        Self {
            contact: ContactOptions::default(),
            gamma: 1.0,
            touch_gap_m: 0.002,
            max_penetration_m: 0.002,
            max_self_collision_m: 0.001,
            min_table_clearance_m: -0.001,
            min_fingers: 2,
            thumb: true,
            torsion_m: None,
            max_normal_n: None,
            motors: true,
            must_hold: true,
            complete: true,
        }
    }
}

impl EvaluationOptions {
    /// The limits of a grasp that is yet to be tried: the dry run of its closing says which fingers bring what the motors can give to bear, so the thumb
    /// and one finger may do, and torques are left to it.
    pub fn candidate() -> Self {
        Self { min_fingers: 1, motors: false, complete: false, ..Self::default() }
    }

    /// Those of a candidate that was synthesised: no hand has been there yet, so it keeps 2 mm off the table, by which the object may stand elsewhere.
    pub fn synthesised() -> Self {
        Self { min_table_clearance_m: 0.002, ..Self::candidate() }
    }

    /// Those of a grasp that people demonstrated: its hand has been there, so it touches the table at most. What its motors can give and whether its
    /// contacts hold is measured and no limit, since its fingers close further.
    pub fn demonstrated() -> Self {
        Self { min_table_clearance_m: 0.0, motors: false, must_hold: false, complete: false, ..Self::default() }
    }
}

/// Contacts of one finger.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FingerContacts {
    /// Name of the finger, or `palm`.
    pub finger: String,
    /// Number of contacts.
    pub contacts: usize,
    /// Whether the finger touches, at [`EvaluationOptions::touch_gap_m`]; of no interest for the palm.
    #[serde(skip)]
    pub touches: bool,
    /// Sum of the normal forces in the minimum grip force, N; zero without one.
    pub normal_n: f64,
}

/// The outcome of [`evaluate`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct GraspEvaluation {
    /// Whether nothing is in `failures`.
    pub passed: bool,
    /// What is wrong, one sentence each.
    pub failures: Vec<String>,
    /// Whether the thumb and the fingers that have to touch do.
    #[serde(skip)]
    pub fingers_touch: bool,
    /// Contacts per finger, the palm last.
    #[serde(rename = "contacts")]
    pub fingers: Vec<FingerContacts>,
    /// The contacts, object frame.
    #[serde(skip)]
    pub contacts: Vec<Contact>,
    /// Deepest point of the hand inside the object, mm; zero or more.
    pub penetration_mm: f64,
    /// Name of the link with that point; `None` if the hand is out of the object.
    #[serde(default)]
    pub deepest_link: Option<String>,
    /// Deepest point of the hand below the table top, mm; zero or more.
    pub table_penetration_mm: f64,
    /// Height of the hand's lowest point above the table top, mm; negative below it.
    #[serde(skip)]
    pub table_clearance_mm: f64,
    /// The deepest pair of links inside each other; not looked for where the grasp has failed and not all that is wrong was asked for.
    #[serde(default)]
    pub self_collision: Option<SelfCollision>,
    /// Whether the contacts are in force closure.
    pub force_closure: bool,
    /// Ferrari-Canny quality about the centre of mass; see [`crate::ForceClosure`]. `None` if it was not asked for.
    pub epsilon: Option<f64>,
    /// Min-weight quality; see [`crate::ForceClosure`]. `None` if it was not asked for.
    pub min_weight: Option<f64>,
    /// The minimum grip force, N: sum of the normal forces; `None` if there is none.
    #[serde(rename = "squeeze_n")]
    pub grip_force_n: Option<f64>,
    /// By which fraction friction may fall; `None` without a grip force, or if it was not asked for.
    pub friction_margin: Option<f64>,
    /// Least share of a motor's torque left; `None` without a grip force.
    pub torque_margin: Option<f64>,
    /// The mass that was carried, kg.
    pub mass_kg: f64,
    /// The friction that was assumed.
    pub friction: f64,
    /// The margin on the weight.
    pub gamma: f64,
}

/// Evaluates a grasp of `object` at rest on its table: contacts per finger, penetration of object and table, force closure, and the minimum
/// grip force that carries the object's weight.
///
/// # Errors
/// If the grasp is none of this hand, or an option is invalid. A bad grasp is not an error.
pub fn evaluate(grasp: &Grasp, object: &Object, robot: &Robot, options: &EvaluationOptions) -> Result<GraspEvaluation> {
    evaluate_with(&HandSurface::new(robot, options.contact.spacing_m)?, grasp, object, robot, options)
}

/// [`evaluate`] with the hand already sampled, for many grasps of one hand.
///
/// # Errors
/// As [`evaluate`].
pub fn evaluate_with(
    surface: &HandSurface,
    grasp: &Grasp,
    object: &Object,
    robot: &Robot,
    options: &EvaluationOptions,
) -> Result<GraspEvaluation> {
    let joints = grasp.joints_of(robot)?;
    let contact = ContactOptions { friction: object.friction, ..options.contact.clone() };
    contact.check()?;
    let (body, table) = (&object.mass_properties, object.table());
    let poses = robot.forward_kinematics(&joints, &grasp.object_from_base);
    let exact_within = |limit_m| Near { geometry: &*object.geometry, limit_m };
    let near = surface.near(&poses, &exact_within(contact.max_gap_m), contact.max_gap_m);
    let contacts = surface.contacts_among(&poses, &near, &contact);
    let depth_m =
        |points: &Vec<(usize, SdfSample)>| points.iter().map(|p| -p.1.distance_m).fold(f64::NEG_INFINITY, f64::max);
    let depths_m: Vec<f64> = near.iter().map(depth_m).collect();
    let (deepest, depth_m) = largest(&depths_m);
    let below_m: Vec<f64> = surface.lowest(&poses, &table.up).iter().map(|height| table.height_m - height).collect();
    let (lowest, below_m) = largest(&below_m);
    let link = |i: usize| &robot.links[i].name;

    let mut failures = Vec::new();
    let touch_gap_m = options.touch_gap_m;
    let reaches = |l: usize| surface.links[l].nearest(&poses[l], &exact_within(touch_gap_m), touch_gap_m).is_some();
    let touches = |finger: usize| {
        let links = &surface.fingers[finger].links;
        links.iter().any(|&l| -depths_m[l] <= touch_gap_m)
            || touch_gap_m > contact.max_gap_m && links.iter().any(|&l| reaches(l))
    };
    let touching: Vec<bool> = (0..surface.fingers.len()).map(touches).collect();
    // How far off the others are is of no interest to a search for grasps that hold, and takes as long as all else.
    let off_mm = |finger: usize| {
        if options.must_hold && !options.complete {
            return None;
        }
        let nearest = |best, &l: &usize| {
            surface.links[l]
                .nearest(&poses[l], object.geometry.exact(), best)
                .map_or(best, |(_, distance_m)| distance_m)
        };
        let gap_m = surface.fingers[finger].links.iter().fold(f64::INFINITY, nearest);
        Some(1e3 * gap_m).filter(|gap| gap.is_finite())
    };
    touching_fingers(surface, options, &touching, &off_mm, &mut failures);
    let fingers_touch = failures.is_empty();
    if depth_m > options.max_penetration_m {
        failures.push(format!("link \"{}\" is {:.1} mm inside the object", link(deepest), 1e3 * depth_m));
    }
    if -below_m < options.min_table_clearance_m {
        let (link, off_mm) = (link(lowest), -1e3 * below_m);
        failures.push(match off_mm < 0.0 {
            true => format!("link \"{link}\" is {:.1} mm below the table top", -off_mm),
            false => format!("link \"{link}\" is only {off_mm:.1} mm above the table top"),
        });
    }
    let self_collision = match options.complete || failures.is_empty() {
        true => surface.self_collision(robot, &poses),
        false => None,
    };
    if let Some(SelfCollision { links: (a, b), depth_mm }) = &self_collision
        && *depth_mm > 1e3 * options.max_self_collision_m
    {
        failures.push(format!("links \"{a}\" and \"{b}\" are {depth_mm:.1} mm inside each other"));
    }
    let goes_on = options.complete || failures.is_empty();

    let mut closure = ClosureOptions::about(body.center_of_mass);
    closure.torsion_m = options.torsion_m;
    let quality = match options.complete {
        true => unless_at_the_edge(force_closure(&contacts, &closure))?,
        false => None,
    };
    let closed = match &quality {
        Some(quality) => quality.closed,
        None => goes_on && is_closed(&contacts, body.center_of_mass, options)?,
    };
    if goes_on && options.must_hold && !closed {
        failures.push("the contacts are not in force closure".into());
    }
    let grip_force = match options.complete || failures.is_empty() {
        true => {
            let (grip_force, failure) = grip_force(robot, &joints, grasp, object, &contacts, options)?;
            failures.extend(failure.filter(|_| options.must_hold));
            grip_force
        }
        false => None,
    };

    let force = |finger: Option<usize>| {
        grip_force.as_ref().map_or(0.0, |s| match finger {
            Some(f) => s.per_finger_n.get(f).copied().unwrap_or(0.0),
            None => s.palm_n,
        })
    };
    let row = |name: &str, finger: Option<usize>| FingerContacts {
        finger: name.into(),
        contacts: contacts.iter().filter(|c| c.finger == finger).count(),
        touches: finger.is_some_and(|f| touching[f]),
        normal_n: force(finger),
    };
    let mut fingers: Vec<FingerContacts> =
        surface.fingers.iter().enumerate().map(|(i, f)| row(&f.name, Some(i))).collect();
    fingers.push(row("palm", None));
    Ok(GraspEvaluation {
        passed: failures.is_empty(),
        fingers_touch,
        failures,
        fingers,
        penetration_mm: 1e3 * depth_m.max(0.0),
        deepest_link: (depth_m > 0.0).then(|| link(deepest).clone()),
        table_penetration_mm: 1e3 * below_m.max(0.0),
        table_clearance_mm: -1e3 * below_m,
        self_collision,
        force_closure: closed,
        epsilon: quality.as_ref().map(|q| q.epsilon),
        min_weight: quality.as_ref().map(|q| q.min_weight),
        grip_force_n: grip_force.as_ref().map(|s| s.total_n),
        friction_margin: grip_force.as_ref().filter(|_| options.complete).map(|s| s.friction_margin),
        torque_margin: grip_force.as_ref().map(|s| s.torque_margin),
        mass_kg: body.mass_kg,
        friction: object.friction,
        gamma: options.gamma,
        contacts,
    })
}

/// The exact distance where it can be below a limit, and a fast one that is no less than the limit elsewhere.
struct Near<'a> {
    geometry: &'a dyn SolidGeometry,
    limit_m: f64,
}

impl SignedDistance for Near<'_> {
    fn signed_distance(&self, point: &Point3<f64>) -> SdfSample {
        let (fast, error_m) = (self.geometry.signed_distance(point), self.geometry.error_m());
        let least_m = fast.distance_m - error_m;
        match least_m > self.limit_m || error_m == 0.0 {
            true => SdfSample { distance_m: least_m, ..fast },
            false => self.geometry.exact().signed_distance(point),
        }
    }
}

impl Grasp {
    /// The grasp with its contacts and the grip force that the object takes, if it passes an [evaluation](evaluate_with).
    ///
    /// # Errors
    /// As [`evaluate_with`].
    pub fn screened(
        self,
        surface: &HandSurface,
        object: &Object,
        robot: &Robot,
        options: &EvaluationOptions,
    ) -> Result<Option<Self>> {
        let evaluation = evaluate_with(surface, &self, object, robot, options)?;
        let passed = evaluation.passed;
        Ok(passed.then(|| self.with_contacts(&evaluation, robot)))
    }

    /// The grasp with the contacts and the grip force that its evaluation found.
    #[must_use]
    pub fn with_contacts(mut self, evaluation: &GraspEvaluation, robot: &Robot) -> Self {
        let contact = |c: &Contact| GraspContact {
            link: robot.links[c.link].name.clone(),
            point_m: c.point.into(),
            normal: c.normal.into(),
        };
        self.contacts = evaluation.contacts.iter().map(contact).collect();
        self.grip_force_n = evaluation.grip_force_n;
        self
    }
}

/// The minimum grip force that carries the object, or what is in its way.
fn grip_force(
    robot: &Robot,
    joints: &[f64],
    grasp: &Grasp,
    object: &Object,
    contacts: &[Contact],
    options: &EvaluationOptions,
) -> Result<(Option<GripForceSolution>, Option<String>)> {
    let (body, gravity) = (&object.mass_properties, object.table().gravity());
    let mut problem =
        GripForceProblem::new(contacts.to_vec(), body.mass_kg, body.center_of_mass, gravity).with_gamma(options.gamma);
    problem.torsion_m = options.torsion_m;
    problem.max_normal_n = options.max_normal_n;
    if options.motors {
        problem.torques = Some(TorqueLimits::of_robot(robot, joints, &grasp.object_from_base, contacts, &gravity)?);
    }
    let solved = match options.complete {
        true => minimum_grip_force(&problem),
        false => smallest_forces(&problem).map(|f| describe(&problem, &f)),
    };
    Ok(match solved {
        Ok(grip_force) => (Some(grip_force), None),
        Err(GripForceError::Input(GraspError::Solver { .. })) => {
            (None, Some("the weight is at the very edge of what the contacts can carry".into()))
        }
        Err(GripForceError::Input(error)) => return Err(error),
        Err(GripForceError::Torque { joint, needed_nm, limit_nm }) => {
            let name = &robot.joints[joint].name;
            (None, Some(format!("joint \"{name}\" would need {needed_nm:.3} N m and has {limit_nm:.3} N m")))
        }
        Err(reason) => (None, Some(reason.to_string())),
    })
}

/// Whether the contacts are in force closure; at the very edge they are not.
fn is_closed(contacts: &[Contact], center_of_mass: Point3<f64>, options: &EvaluationOptions) -> Result<bool> {
    Ok(unless_at_the_edge(is_force_closed(contacts, &center_of_mass, options.torsion_m))?.unwrap_or(false))
}

/// At the very edge of what is possible a solver stops half-way: that is no error of the grasp's.
fn unless_at_the_edge<T>(answer: Result<T>) -> Result<Option<T>> {
    match answer {
        Err(GraspError::Solver { .. }) => Ok(None),
        answer => answer.map(Some),
    }
}

/// Whether enough fingers touch, the thumb among them; `off_mm` says how far off one is, if that is asked for.
fn touching_fingers(
    surface: &HandSurface,
    options: &EvaluationOptions,
    touching: &[bool],
    off_mm: &dyn Fn(usize) -> Option<f64>,
    failures: &mut Vec<String>,
) {
    let off = |f: usize| off_mm(f).map_or(String::new(), |mm| format!(": it is {mm:.1} mm off"));
    let thumb = surface.thumb();
    if options.thumb
        && let Some(t) = thumb
        && !touching[t]
    {
        failures.push(format!("the thumb does not touch the object{}", off(t)));
    }
    let others: Vec<usize> = (0..surface.fingers.len()).filter(|&f| Some(f) != thumb).collect();
    let missing: Vec<usize> = others.iter().copied().filter(|&f| !touching[f]).collect();
    let count = others.len() - missing.len();
    if count < options.min_fingers {
        let name = |&f: &usize| match off_mm(f) {
            Some(mm) => format!("{} by {mm:.1} mm", surface.fingers[f].name),
            None => surface.fingers[f].name.clone(),
        };
        failures.push(format!(
            "{count} of {} fingers touch the object, {} are asked for (not touching: {})",
            others.len(),
            options.min_fingers,
            missing.iter().map(name).collect::<Vec<_>>().join(", ")
        ));
    }
}

/// Index and value of the largest entry.
fn largest(values: &[f64]) -> (usize, f64) {
    values.iter().copied().enumerate().fold((0, f64::NEG_INFINITY), |best, v| if v.1 > best.1 { v } else { best })
}
