//! A contact, and the map from contact forces to the wrench on the object.

use nalgebra::{Matrix3, Matrix6xX, Point3, Unit, Vector3};

use crate::{GraspError, Result};

/// One point where the hand touches the object.
#[derive(Debug, Clone, PartialEq)]
pub struct Contact {
    /// Where, on the object's surface, metres, object frame.
    pub point: Point3<f64>,
    /// Unit normal into the object: the direction in which the hand pushes. Object frame.
    pub normal: Vector3<f64>,
    /// Index of the robot's link.
    pub link: usize,
    /// Index of the finger the link belongs to; `None` for the palm.
    pub finger: Option<usize>,
    /// How deep the link is inside the object, metres; negative is a gap.
    pub depth_m: f64,
    /// Coulomb coefficient of friction.
    pub friction: f64,
}

impl Contact {
    /// A contact at `point` pushing along `normal` (made unit here) with friction `friction`; no link, no finger, no depth.
    pub fn new(point: Point3<f64>, normal: Vector3<f64>, friction: f64) -> Self {
        Self { point, normal: Unit::new_normalize(normal).into_inner(), link: 0, finger: None, depth_m: 0.0, friction }
    }

    /// The same contact made by finger `finger`.
    pub fn by_finger(mut self, finger: usize) -> Self {
        self.finger = Some(finger);
        self
    }

    /// The contact's own axes as columns, object frame: the normal and two tangents, right-handed.
    pub fn axes(&self) -> Matrix3<f64> {
        // The coordinate axis furthest from the normal gives the best conditioned tangent.
        let helper = Vector3::ith(self.normal.iamin(), 1.0);
        let t1 = self.normal.cross(&helper).normalize();
        Matrix3::from_columns(&[self.normal, t1, self.normal.cross(&t1)])
    }
}

/// The grasp map G, 6 × 3n: columns 3i..3i+3 turn the force of contact i, in its own [`Contact::axes`]
/// (normal, tangent, tangent), into force (rows 0-2, N) and torque about `origin` (rows 3-5, N m) on the object.
///
/// G_i = \[I; (p_i − origin)×\] R_i (Murray, Li, Sastry, *A Mathematical Introduction to Robotic Manipulation*, eq. 5.10).
pub fn grasp_map(contacts: &[Contact], origin: &Point3<f64>) -> Matrix6xX<f64> {
    let mut g = Matrix6xX::zeros(3 * contacts.len());
    for (i, contact) in contacts.iter().enumerate() {
        let axes = contact.axes();
        let arm = (contact.point - origin).cross_matrix();
        g.fixed_view_mut::<3, 3>(0, 3 * i).copy_from(&axes);
        g.fixed_view_mut::<3, 3>(3, 3 * i).copy_from(&(arm * axes));
    }
    g
}

/// The length that torques are divided by when forces and torques are compared: the largest distance of a contact from
/// `origin`, at least one millimetre.
pub fn characteristic_length_m(contacts: &[Contact], origin: &Point3<f64>) -> f64 {
    contacts.iter().map(|c| (c.point - origin).norm()).fold(1e-3, f64::max)
}

/// Refuses contacts that no formula here is defined for.
pub(crate) fn validate(contacts: &[Contact]) -> Result<()> {
    for (index, c) in contacts.iter().enumerate() {
        let fail = |what: String, remedy| Err(GraspError::Contact { index, what, remedy });
        if c.point.iter().chain(c.normal.iter()).any(|v| !v.is_finite()) {
            return fail("the point or the normal is not finite".into(), "check the poses and the mesh it came from");
        }
        if (c.normal.norm() - 1.0).abs() > 1e-6 {
            return fail(format!("the normal has length {:.6}", c.normal.norm()), "give unit normals, into the object");
        }
        if !(c.friction >= 0.0 && c.friction.is_finite()) {
            return fail(format!("the friction is {}", c.friction), "give a Coulomb coefficient of zero or more");
        }
    }
    Ok(())
}
