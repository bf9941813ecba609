//! Grasps that several tests of forces share.
#![allow(dead_code)] // no test uses all of it

use drex_core::{ConvexPart, MassProperties, Object, Pose, Primitive, PrimitiveShape};
use drex_grasp::Contact;
use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use proptest::prelude::*;

pub const G: f64 = 9.81;

pub fn down() -> Vector3<f64> {
    Vector3::new(0.0, 0.0, -G)
}

/// A ball of which the table z = 0 is that of its own frame.
pub fn ball(radius_m: f64, center: Point3<f64>, mass_kg: f64) -> Object {
    let object_from_shape = Pose::translation(center.x, center.y, center.z);
    let shape = PrimitiveShape::Sphere { radius_m };
    let part = ConvexPart::of_primitive(Primitive { shape, object_from_shape }).unwrap();
    let inertia = Matrix3::identity() * (0.4 * mass_kg * radius_m * radius_m);
    Object::of_parts(vec![part], MassProperties { mass_kg, center_of_mass: center, inertia })
}

/// A thumb on the left against `fingers` fingers on the right, spread along y.
pub fn thumb_against(fingers: usize, mu: f64) -> Vec<Contact> {
    let mut contacts = vec![Contact::new(Point3::new(-0.03, 0.0, 0.0), Vector3::x(), mu).by_finger(3)];
    for i in 0..fingers {
        let y = 0.02 * (i as f64 - 0.5 * (fingers as f64 - 1.0));
        contacts.push(Contact::new(Point3::new(0.03, y, 0.0), -Vector3::x(), mu).by_finger(i));
    }
    contacts
}

prop_compose! {
    /// A thumb against two to four fingers, contact points and normals scattered.
    pub fn grasp()(n in 2..5usize, mu in 0.3..1.0f64, jitter in prop::collection::vec(-1.0..1.0f64, 30)) -> Vec<Contact> {
        let mut contacts = thumb_against(n, mu);
        for (i, c) in contacts.iter_mut().enumerate() {
            let j = &jitter[6 * i..6 * i + 6];
            c.point += Vector3::new(j[0], j[1], j[2]) * 0.005;
            c.normal = Rotation3::new(Vector3::new(j[3], j[4], j[5]) * 0.1) * c.normal;
        }
        contacts
    }
}
