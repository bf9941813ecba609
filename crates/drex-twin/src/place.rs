//! Where in a scan the object stands: the table, and the object's box on it.

use std::path::PathBuf;

use drex_core::Pose;
use drex_core::capture::{Capture, View};
use drex_core::stats::median;
use drex_mesh::{
    Click, KnownDistance, Scene, ScenePoint, SceneView, Silhouette, Similarity, SupportChoice, SupportOptions,
    TablePlane, UpPrior, find_objects, silhouette_base, support_plane,
};
use nalgebra::{Point2, Point3, Unit, Vector3};

use crate::Result;
use crate::error::refuse;
use crate::manifest::ObjectClick;
use crate::records::OtherPlane;

/// A support's normal may be this far from an up direction that is given, rad.
const UP_TOLERANCE_RAD: f64 = 0.26;
/// A table that a masked object stands on may be this many pixels off the lowest point of its silhouettes;
const MAX_TABLE_OFFSET_PX: f64 = 3.0;
/// or, where these do not tell, this much of the object's height off its lowest point.
const MAX_TABLE_OFFSET_SHARE: f64 = 0.1;
/// Up is the normal of a plane with this score, if nothing better is known.
const SURE: f64 = 0.3;
/// Where up is from if the object's lowest point is below the plane that was found.
pub(crate) const PARALLEL: &str = "a plane under the object";
/// Where it is from if cameras stand round a masked object and no plane is known.
pub(crate) const ALL_ROUND: &str = "the cameras all round";
/// Cameras look from all sides if their level directions cancel out but for this share; up is then good to as many of their tilts.
const MOST_ONE_SIDED: f64 = 0.1;
/// Why an up direction may be the wrong one.
const NO_PLANE: &str = "no plane of the sparse points has the up direction that was given; the object is taken to stand on the lowest of them: \
                        check --up, which is in the frame of the scan, or leave it out";
/// More points of the object say nothing new.
const MOST_OBJECT_POINTS: usize = 20_000;

/// What is known of the scan's frame besides its files.
#[derive(Debug, Clone, Default)]
pub struct FrameOptions {
    /// Metres per unit of the scan.
    pub scale: Option<f64>,
    /// Known distances between marks.
    pub distances: Vec<KnownDistance>,
    /// File of the marks instead of `SCAN/marks.json`.
    pub marks: Option<PathBuf>,
    /// Up in the scan's frame.
    pub up: Option<Vector3<f64>>,
    /// Lower and upper corner of the object's box, in the frame and unit of the scan.
    pub region: Option<[Point3<f64>; 2]>,
    /// A pixel that shows the object, where several things stand on the table.
    pub object: Option<ObjectClick>,
    /// Seed of the search for the table.
    pub seed: u64,
}

impl ObjectClick {
    /// The click among the views of a capture: by the photo's name, or by its file name if that is the only one.
    ///
    /// # Errors
    /// If no view, or more than one, has the name.
    fn among(&self, cameras: &Capture) -> Result<Click> {
        let file = |name: &str| name.rsplit('/').next().unwrap_or_default().to_owned();
        let exact = cameras.views.iter().position(|v| v.name == self.photo);
        let by_file: Vec<usize> =
            (0..cameras.views.len()).filter(|&i| file(&cameras.views[i].name) == file(&self.photo)).collect();
        match (exact, by_file.as_slice()) {
            (Some(view), _) | (None, &[view]) => Ok(Click { view, pixel: Point2::from(self.pixel) }),
            (None, []) => refuse!(
                "the object's click names the photo {}, which has no camera in {}: name one of its photos",
                self.photo,
                cameras.folder.display()
            ),
            (None, more) => refuse!(
                "the object's click names the photo {}, of which there are {}: name it with its folder",
                self.photo,
                more.len()
            ),
        }
    }
}

/// The table and the box of the object on it.
pub(crate) struct Place {
    /// In the frame and unit of the scan.
    pub table: TablePlane,
    /// Where up is from.
    pub up_from: &'static str,
    /// Metres, z up, the table z = 0.
    pub table_from_scan: Similarity,
    /// Box of the object in that frame, where it was sought.
    pub object: Option<[Point3<f64>; 2]>,
    /// Where the object is from.
    pub object_from: &'static str,
    /// Boxes of the other things in that frame.
    pub others: Vec<[Point3<f64>; 2]>,
    /// Score of the table, where it was found.
    pub score: Option<f64>,
    /// What else the table could have been.
    pub runners_up: Vec<OtherPlane>,
    /// Why something may be wrong, in sentences.
    pub doubts: Vec<String>,
}

/// Finds table and object. `points` are the sparse points, `object` those of depth maps that masks cut out, and `masks` these masks, none if there
/// are none; all in the scan's frame and unit.
///
/// # Errors
/// If there is no table, no object on it, or the click names no photo.
pub(crate) fn find(
    cameras: &Capture,
    points: Vec<ScenePoint>,
    object: &[Point3<f64>],
    masks: &[Silhouette],
    metres_per_unit: f64,
    options: &FrameOptions,
) -> Result<Place> {
    let masked = !object.is_empty();
    let eyes: Vec<Pose> = cameras.views.iter().map(|v| v.camera_from_world.inverse()).collect();
    let click = options.object.as_ref().map(|c| c.among(cameras)).transpose()?;
    let near = |p: &Point3<f64>| options.region.is_none_or(|region| distance_from(&region, p) < size_of(&region));
    let there = points.len();
    let points: Vec<ScenePoint> = points.into_iter().filter(|p| near(&p.position)).collect();
    if points.is_empty() && there > 0 && !masked {
        refuse!("none of {there} points is near the region given; give it in the frame and unit of the scan");
    }
    let shown: Vec<Point3<f64>> = if masked { object.to_vec() } else { points.iter().map(|p| p.position).collect() };
    let scene = scene_of(cameras, &eyes, points, object, options.region.as_ref());
    let scene = match scene {
        Err(e) if !masked && (options.up.is_none() || options.region.is_none()) => return Err(e.into()),
        scene => scene.ok(),
    };
    let mut support = SupportOptions::default();
    support.seed = options.seed;
    support.up = options
        .up
        .and_then(|up| Unit::try_new(up, 0.0))
        .map(|direction| UpPrior { direction, tolerance_rad: UP_TOLERANCE_RAD });
    let choice = match scene.as_ref().map(|s| support_plane(s, &support)) {
        Some(Err(e)) if !masked && options.up.is_none() => return Err(e.into()),
        choice => choice.and_then(Result::ok),
    };
    // Masks may show more than what stands on the plane: the disc that it turns on, say.
    let parallel = choice.as_ref().filter(|c| masked && c.chosen.score >= SURE).map(|c| c.chosen.table.up.into_inner());
    let choice = choice.filter(|c| !masked || stands_on(object, masks, &c.chosen.table));
    let looked_at = scene.as_ref().map_or_else(|| mean(&shown), Scene::target);
    let towards = eyes.first().map_or(Vector3::x(), |e| e.translation.vector - looked_at.coords);
    let frame = |table: &TablePlane| Similarity::of_table(metres_per_unit, table, &looked_at, &towards);
    let mut place = match (choice, options.up) {
        (Some(choice), _) => Place::found(choice, &looked_at, metres_per_unit, frame)?,
        (None, Some(up)) => {
            let mut place = Place::assumed(lowest_plane(&shown, masks, up), "given", frame)?;
            if !masked {
                place.doubts.push(NO_PLANE.to_owned());
            }
            place
        }
        (None, None) => match parallel {
            Some(up) => Place::assumed(lowest_plane(&shown, masks, up), PARALLEL, frame)?,
            None => {
                let up = mean_up(&eyes);
                let up_from = if stand_all_round(&eyes, &up) { ALL_ROUND } else { "the cameras" };
                Place::assumed(lowest_plane(&shown, masks, up), up_from, frame)?
            }
        },
    };
    if options.region.is_some() {
        place.object_from = "the region given";
    } else if let Some(scene) = scene.filter(|_| !masked) {
        let found = find_objects(&scene, &place.table, &place.table_from_scan, click.as_ref())?;
        place.object = Some([found.object.lo, found.object.hi]);
        place.object_from = if click.is_some() { "the click" } else { "where the cameras look" };
        place.others = found.others.iter().map(|o| [o.lo, o.hi]).collect();
        place.doubts.extend(found.doubt);
    }
    Ok(place)
}

fn scene_of(
    cameras: &Capture,
    eyes: &[Pose],
    mut points: Vec<ScenePoint>,
    object: &[Point3<f64>],
    region: Option<&[Point3<f64>; 2]>,
) -> drex_mesh::Result<Scene> {
    let some = object.iter().step_by(object.len().div_ceil(MOST_OBJECT_POINTS).max(1));
    points.extend(some.map(|p| ScenePoint { object_share: Some(1.0), ..ScenePoint::at(*p) }));
    let view = |(v, eye): (&View, &Pose)| SceneView { lens: v.lens.clone(), world_from_camera: *eye };
    let views = cameras.views.iter().zip(eyes).map(view).collect();
    match region {
        Some([lo, hi]) => Scene::around(points, views, nalgebra::center(lo, hi)),
        None => Scene::new(points, views),
    }
}

impl Place {
    fn found(
        choice: SupportChoice,
        looked_at: &Point3<f64>,
        metres_per_unit: f64,
        frame: impl Fn(&TablePlane) -> drex_mesh::Result<Similarity>,
    ) -> Result<Self> {
        let table = choice.chosen.table;
        let other = |c: &drex_mesh::PlaneCandidate| OtherPlane {
            tilt_deg: c.table.up.angle(&table.up).to_degrees(),
            above_m: (table.height(looked_at) - c.table.height(looked_at)) * metres_per_unit,
            score: c.score,
        };
        Ok(Self {
            table_from_scan: frame(&table)?,
            runners_up: choice.runners_up.iter().take(3).map(other).collect(),
            score: Some(choice.chosen.score),
            doubts: choice.doubt.into_iter().collect(),
            ..Self::assumed(table.clone(), "table", frame)?
        })
    }

    fn assumed(
        table: TablePlane,
        up_from: &'static str,
        frame: impl Fn(&TablePlane) -> drex_mesh::Result<Similarity>,
    ) -> Result<Self> {
        Ok(Self {
            table_from_scan: frame(&table)?,
            table,
            up_from,
            object: None,
            object_from: "the masks",
            others: Vec::new(),
            score: None,
            runners_up: Vec::new(),
            doubts: Vec::new(),
        })
    }
}

/// The sparse points with the views that see them.
pub(crate) fn sparse_points(cameras: &Capture) -> Vec<ScenePoint> {
    let seen = |track: &[(usize, usize)]| {
        let mut views: Vec<usize> = track.iter().map(|(view, _)| *view).collect();
        views.dedup();
        views
    };
    cameras.points.iter().map(|p| ScenePoint { views: seen(&p.track), ..ScenePoint::at(p.position.into()) }).collect()
}

/// Lower and upper corner of the box around a box that is mapped.
pub(crate) fn box_around(region: &[Point3<f64>; 2], a_from_b: &Similarity) -> (Point3<f64>, Point3<f64>) {
    let corner = |k: usize| Point3::new(region[k & 1].x, region[k >> 1 & 1].y, region[k >> 2].z);
    let corners = (0..8).map(|k| a_from_b.point(&corner(k)));
    let first = a_from_b.point(&region[0]);
    corners.fold((first, first), |(lo, hi), p| (lo.inf(&p), hi.sup(&p)))
}

fn distance_from([lo, hi]: &[Point3<f64>; 2], p: &Point3<f64>) -> f64 {
    (lo - p).sup(&(p - hi)).sup(&Vector3::zeros()).norm()
}

fn size_of([lo, hi]: &[Point3<f64>; 2]) -> f64 {
    (hi - lo).norm()
}

/// Whether the lowest part of the object is on the plane.
fn stands_on(object: &[Point3<f64>], masks: &[Silhouette], table: &TablePlane) -> bool {
    let Some(Extent { lowest, highest, base }) = Extent::of(object, masks, &table.up) else { return false };
    let offset = |height: f64| (height - table.point.coords.dot(&table.up)).abs();
    match base {
        Some(base) => offset(base) < MAX_TABLE_OFFSET_PX * pixel_at(&mean(object), masks),
        None => offset(lowest) < MAX_TABLE_OFFSET_SHARE * (highest - lowest),
    }
}

/// The plane with this normal through the lowest part of the object.
fn lowest_plane(object: &[Point3<f64>], masks: &[Silhouette], up: Vector3<f64>) -> TablePlane {
    let up = Unit::new_normalize(up);
    let height = Extent::of(object, masks, &up).map_or(0.0, |extent| extent.base.unwrap_or(extent.lowest));
    TablePlane::new(Point3::from(up.into_inner() * height), up)
}

/// How far an object reaches along a direction.
struct Extent {
    lowest: f64,
    highest: f64,
    /// Where its silhouettes end, if they tell: depth may be missing there.
    base: Option<f64>,
}

impl Extent {
    fn of(object: &[Point3<f64>], masks: &[Silhouette], up: &Unit<Vector3<f64>>) -> Option<Self> {
        let mut heights: Vec<f64> = object.iter().map(|p| p.coords.dot(up)).collect();
        heights.sort_by(f64::total_cmp);
        let (lowest, highest) = (*heights.get(heights.len() / 500)?, *heights.last()?);
        let margin = highest - lowest;
        Some(Self { lowest, highest, base: silhouette_base(masks, up, lowest - margin..highest + margin) })
    }
}

/// What a pixel of the masks covers at a point, in the median.
fn pixel_at(point: &Point3<f64>, masks: &[Silhouette]) -> f64 {
    let pixel = |m: &Silhouette| (point.coords - m.world_from_camera.translation.vector).norm() / m.camera.fx_px;
    median(masks.iter().map(pixel)).unwrap_or(0.0)
}

/// Whether the cameras look from all sides alike, so that what each one is tilted by cancels out.
fn stand_all_round(eyes: &[Pose], up: &Vector3<f64>) -> bool {
    let level = |e: &Pose| {
        let ahead = e.rotation * Vector3::z();
        ahead - up * ahead.dot(up)
    };
    let reach: f64 = eyes.iter().map(|e| level(e).norm()).sum();
    eyes.iter().map(level).sum::<Vector3<f64>>().norm() < MOST_ONE_SIDED * reach
}

/// Photos are mostly taken upright.
fn mean_up(eyes: &[Pose]) -> Vector3<f64> {
    eyes.iter().map(|e| e.rotation * -Vector3::y()).sum::<Vector3<f64>>().try_normalize(1e-9).unwrap_or(Vector3::z())
}

fn mean(points: &[Point3<f64>]) -> Point3<f64> {
    Point3::from(points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clicks_are_read() {
        let click: ObjectClick = " 512.5, 300@left/IMG 1@2.jpg ".trim().parse().unwrap();
        assert_eq!((click.pixel, click.photo.as_str()), ([512.5, 300.0], "left/IMG 1@2.jpg"));
        assert_eq!(click.to_string().parse::<ObjectClick>().unwrap(), click);
        for wrong in ["", "5,5", "5@a.jpg", "5,x@a.jpg", "-5,5@a.jpg", "nan,5@a.jpg", "5,5@", "5,5@ "] {
            assert!(wrong.parse::<ObjectClick>().unwrap_err().contains("512,300@"), "{wrong}");
        }
    }

    #[test]
    fn cameras_on_one_side_do_not_stand_all_round() {
        let up = Vector3::z();
        let eyes = |sides: usize| -> Vec<Pose> {
            (0..sides)
                .map(|k| {
                    let (sin, cos) = (k as f64 * std::f64::consts::TAU / 12.0).sin_cos();
                    Pose::face_towards(&Point3::new(0.4 * cos, 0.4 * sin, 0.2), &Point3::origin(), &-up)
                })
                .collect()
        };
        assert!(stand_all_round(&eyes(12), &mean_up(&eyes(12))) && mean_up(&eyes(12)).angle(&up) < 1e-9);
        assert!(!stand_all_round(&eyes(6), &mean_up(&eyes(6))) && mean_up(&eyes(6)).angle(&up) > 0.1);
    }
}
