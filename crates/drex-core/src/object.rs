//! The object that is grasped, pushed and simulated: one type for all crates.

use std::sync::Arc;

use nalgebra::{Point3, Translation3, Unit, Vector3};

use crate::mesh::{farthest_points, sample_surface};
use crate::pose::upright;
use crate::{ConvexPart, MassProperties, Pose, SignedDistance, SurfacePoint, TriMesh};

/// Coefficient of friction of an object against hand and table where nobody states one; reports list it as an assumption.
pub const ASSUMED_FRICTION: f64 = 0.5;

/// Standard gravity, m/s².
const GRAVITY_M_S2: f64 = 9.81;

/// The geometry of a solid in two speeds.
///
/// Its own [`SignedDistance::signed_distance`] may interpolate a grid, which is what a search asks for; [`SolidGeometry::exact`]
/// is what an evaluation asks for.
pub trait SolidGeometry: SignedDistance {
    /// The exact signed distance to the boundary; often slower.
    fn exact(&self) -> &dyn SignedDistance;

    /// The most by which its own distance is off the exact one anywhere, metres.
    fn error_m(&self) -> f64 {
        0.0
    }

    /// Lower and upper corner of the axis-aligned bounding box, metres.
    fn bounding_box(&self) -> (Point3<f64>, Point3<f64>);
}

impl SolidGeometry for Vec<ConvexPart> {
    fn exact(&self) -> &dyn SignedDistance {
        self
    }

    fn bounding_box(&self) -> (Point3<f64>, Point3<f64>) {
        bounds_at(self, &Pose::identity()).unwrap_or_default()
    }
}

/// A rigid object that rests on a table.
///
/// Everything is in metres and in the frame of its mesh unless a name says otherwise. It is made once, by
/// `drex_mesh::Asset::to_object` or [`Object::of_parts`], and is cheap to clone: geometry is shared.
#[derive(Clone)]
pub struct Object {
    /// Name in reports and messages.
    pub name: String,
    /// Surface that is seen and drawn.
    pub mesh: Arc<TriMesh>,
    /// Convex parts of the solid, as collision shapes.
    pub convex_parts: Arc<Vec<ConvexPart>>,
    /// Mass, centre of mass and inertia.
    pub mass_properties: MassProperties,
    /// Signed distances.
    pub geometry: Arc<dyn SolidGeometry>,
    /// Coefficient of friction against hand and table.
    pub friction: f64,
    /// Largest normal force of one finger before the object is damaged, N; `None` if it bears any.
    pub max_finger_n: Option<f64>,
    /// Rest pose: where the object stands on the table z = 0 of the world.
    pub world_from_object: Pose,
}

impl Object {
    /// An object of convex parts, without a name, at [`ASSUMED_FRICTION`], its frame in the world's. Other fields may be set afterwards.
    pub fn of_parts(parts: Vec<ConvexPart>, mass_properties: MassProperties) -> Self {
        let mut mesh = TriMesh::default();
        parts.iter().for_each(|p| mesh.append(&p.hull));
        let parts = Arc::new(parts);
        Self {
            name: String::new(),
            mesh: Arc::new(mesh),
            convex_parts: parts.clone(),
            mass_properties,
            geometry: parts,
            friction: ASSUMED_FRICTION,
            max_finger_n: None,
            world_from_object: Pose::identity(),
        }
    }

    /// The corners of all convex parts.
    pub fn corners(&self) -> impl Iterator<Item = &Point3<f64>> + Clone {
        self.convex_parts.iter().flat_map(ConvexPart::corners)
    }

    /// Lowest and highest corner of the box around the convex parts, their frame placed at `pose`; `None` without parts.
    pub fn bounds_at(&self, pose: &Pose) -> Option<(Point3<f64>, Point3<f64>)> {
        bounds_at(&self.convex_parts, pose)
    }

    /// Diagonal of the box around the convex parts, metres.
    pub fn size_m(&self) -> f64 {
        self.bounds_at(&Pose::identity()).map_or(0.0, |(lo, hi)| (hi - lo).norm())
    }

    /// The same object at another mass, uniformly denser or lighter.
    #[must_use]
    pub fn with_mass(mut self, mass_kg: f64) -> Self {
        self.mass_properties = self.mass_properties.with_mass(mass_kg);
        self
    }

    /// The same object in another rest pose on the table z = 0.
    #[must_use]
    pub fn with_rest_pose(mut self, world_from_object: Pose) -> Self {
        self.world_from_object = world_from_object;
        self
    }

    /// The same object resting on this table (object frame), its origin above that of the world.
    #[must_use]
    pub fn with_table(self, table: &TablePlane) -> Self {
        self.with_rest_pose(Pose::from_parts(Translation3::new(0.0, 0.0, -table.height_m), upright(&table.up)))
    }

    /// The same object turned as it is, its origin above that of the world, on the table z = 0: where in its world it stood does not matter.
    #[must_use]
    pub fn at_world_origin(self) -> Self {
        let turned = Pose::from_parts(Translation3::identity(), self.world_from_object.rotation);
        let lowest_m = self.bounds_at(&turned).map_or(0.0, |(low, _)| low.z);
        self.with_rest_pose(Translation3::new(0.0, 0.0, -lowest_m) * turned)
    }

    /// The table top in the object's frame, while the object rests on it.
    pub fn table(&self) -> TablePlane {
        let up = Unit::new_normalize(self.world_from_object.rotation.inverse() * Vector3::z());
        TablePlane { up, height_m: -self.world_from_object.translation.z }
    }

    /// Mass, kg.
    pub fn mass_kg(&self) -> f64 {
        self.mass_properties.mass_kg
    }

    /// Weight, N.
    pub fn weight_n(&self) -> f64 {
        self.mass_kg() * GRAVITY_M_S2
    }

    /// Centre of mass, metres.
    pub fn center_of_mass(&self) -> Point3<f64> {
        self.mass_properties.center_of_mass
    }

    /// `count` points spread over the mesh uniformly by area, with outward normals. The same seed gives the same points.
    pub fn surface_points(&self, count: usize, seed: u64) -> Vec<SurfacePoint> {
        sample_surface(&self.mesh, count, seed)
    }

    /// `count` points that cover the mesh evenly: the farthest of eight times as many random ones.
    pub fn point_cloud(&self, count: usize, seed: u64) -> Vec<Point3<f64>> {
        let dense: Vec<_> = self.surface_points(8 * count, seed).into_iter().map(|s| s.point).collect();
        farthest_points(&dense, count).into_iter().map(|i| dense[i]).collect()
    }
}

fn bounds_at(parts: &[ConvexPart], pose: &Pose) -> Option<(Point3<f64>, Point3<f64>)> {
    let reach = |direction: Vector3<f64>| {
        let own = pose.inverse_transform_vector(&direction);
        parts.iter().map(|p| p.support(&own)).fold(f64::NEG_INFINITY, f64::max)
    };
    let highest = Vector3::from_fn(|i, _| reach(Vector3::ith(i, 1.0)));
    let lowest = Vector3::from_fn(|i, _| -reach(Vector3::ith(i, -1.0)));
    let at = pose.translation.vector;
    (!parts.is_empty()).then(|| ((lowest + at).into(), (highest + at).into()))
}

/// The table: the points x with up · x = height, in the object's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TablePlane {
    /// Direction against gravity.
    pub up: Unit<Vector3<f64>>,
    /// Height of the table top along `up` from the object's origin, metres.
    pub height_m: f64,
}

impl TablePlane {
    /// The table that a body with these `points` (object frame) stands on when `up` is up. `None` without points or direction.
    pub fn under<'a>(points: impl IntoIterator<Item = &'a Point3<f64>>, up: Vector3<f64>) -> Option<Self> {
        let up = Unit::try_new(up, 1e-9)?;
        let height_m = points.into_iter().map(|p| p.coords.dot(&up)).min_by(f64::total_cmp)?;
        Some(Self { up, height_m })
    }

    /// Gravity in the object's frame, m/s².
    pub fn gravity(&self) -> Vector3<f64> {
        self.up.into_inner() * -GRAVITY_M_S2
    }
}
