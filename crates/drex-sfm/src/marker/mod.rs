//! A printed AprilTag of known size in the photos: where it is in each, and the scale, up and origin that it gives a scene.
//!
//! ```text
//! grey photo ─ pyramid ─ dark areas ─ quadrilaterals ─ cells ─ tag ─ edges of all its cells ─ corners     (detect)
//! corners + camera ─ the same with the lens                                                                (refine)
//! corners + cameras + poses ─ agreeing photos ─ one rigid square ─ scale, up, origin                       (metric)
//! ```
//!
//! Pixels: the centre of the first one is (0.5, 0.5). Corners: those of the black border's outer edge, clockwise as a viewer
//! sees them, from the top left of the upright tag. Upright is as the AprilTag authors' pictures are; OpenCV's generator draws
//! the family turned by 180 degrees, so that the corners begin at the other end of the same diagonal.

mod decode;
mod edges;
mod image;
mod metric;
mod quads;
mod square;
mod tag36h11;
mod warp;

use std::fmt;
use std::str::FromStr;

use drex_core::camera::Camera;
use drex_core::{Error, Pose, Result};
use nalgebra::{Point2, Vector2};

use self::decode::Read;
use self::image::Grey;
pub use self::metric::{MarkerFit, metric};
use self::warp::{Lens, Warp};

/// The marker in one photo whose camera and pose are known. A photo that shows the marker's id twice may give two of these.
#[derive(Debug, Clone)]
pub struct Sighting {
    /// The photo's lens.
    pub camera: Camera,
    /// The photo's pose in the scene, whose unit of length is the unknown.
    pub camera_from_world: Pose,
    /// Corners in pixels, in the order of [`Detection::corners`].
    pub corners: [[f64; 2]; 4],
}

/// Sides outside of this range, metres, are taken for another unit.
const SIDE_M: std::ops::RangeInclusive<f64> = 0.002..=5.0;

/// A set of tags that is told apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Family {
    /// AprilTag's family of 587 tags with 6 x 6 cells inside of a black border of one cell.
    Tag36h11,
}

impl Family {
    /// All families.
    pub const ALL: [Self; 1] = [Self::Tag36h11];

    /// The family's name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tag36h11 => "tag36h11",
        }
    }

    /// Number of tags; ids count from zero.
    pub fn tags(self) -> u32 {
        match self {
            Self::Tag36h11 => tag36h11::WHITE.len() as u32,
        }
    }
}

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A printed tag; on the command line `tag36h11:ID:SIDE_M`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Marker {
    /// The family.
    pub family: Family,
    /// The number of the tag in its family.
    pub id: u32,
    /// Length of the outer edge of the black border, metres.
    pub side_m: f64,
}

impl Marker {
    /// The tag `id` of a family with a black border of `side_m` metres, outside.
    ///
    /// # Errors
    /// If the family has no such tag, or the side is no length of a printed tag in metres.
    pub fn new(family: Family, id: u32, side_m: f64) -> Result<Self> {
        if id >= family.tags() {
            return Err(Error::value(
                format!("the family {family} has no tag {id}"),
                format!("give the number under the printed tag, 0 to {}", family.tags() - 1),
            ));
        }
        if !SIDE_M.contains(&side_m) {
            return Err(Error::value(
                format!("a tag with a side of {side_m} m"),
                "give the outer edge of its black border in metres, such as 0.06 for 60 mm",
            ));
        }
        Ok(Self { family, id, side_m })
    }

    /// Whether a cell of the upright tag is white: row and column from the top left, 0 to 7, of which the outermost are the black border. All
    /// cells outside are white, and have to be.
    #[must_use]
    pub fn is_white(&self, row: i32, column: i32) -> bool {
        match self.family {
            // Of the 587 tags that new() lets through.
            Family::Tag36h11 => self.id < self.family.tags() && tag36h11::is_white(self.id as usize, row, column),
        }
    }
}

impl FromStr for Marker {
    type Err = Error;

    fn from_str(s: &str) -> Result<Self> {
        let refuse = |what: String, remedy: &str| Error::value(format!("marker `{s}`: {what}"), remedy);
        let form = "write tag36h11:ID:SIDE_M, such as tag36h11:11:0.06 for tag 11 with a black border of 60 mm";
        let parts: Vec<&str> = s.split(':').map(str::trim).collect();
        let [family, id, side] = parts[..] else {
            return Err(refuse(format!("{} parts between colons instead of three", parts.len()), form));
        };
        let family = Family::ALL.into_iter().find(|f| f.name() == family).ok_or_else(|| {
            let known = Family::ALL.map(Family::name).join(", ");
            refuse(format!("family `{family}` is not known"), &format!("print a tag of {known}"))
        })?;
        let id = id.parse().map_err(|_| refuse(format!("the id `{id}` is not a whole number from zero"), form))?;
        let side = side.parse().map_err(|_| refuse(format!("the side `{side}` is not a number of metres"), form))?;
        Self::new(family, id, side).map_err(|error| match error {
            Error::Value { what, remedy } => refuse(what, &remedy),
            other => other,
        })
    }
}

impl fmt::Display for Marker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", self.family, self.id, self.side_m)
    }
}

/// Where a photo shows a tag.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    /// Corners of the black border's outer edge, pixels (the centre of the first pixel is (0.5, 0.5)), clockwise as seen, from
    /// the top left of the upright tag.
    pub corners: [[f64; 2]; 4],
}

impl Detection {
    fn points(&self) -> [Point2<f64>; 4] {
        self.corners.map(Point2::from)
    }

    fn middle(&self) -> Point2<f64> {
        Point2::from(self.points().iter().map(|p| p.coords).sum::<Vector2<f64>>() / 4.0)
    }

    /// The longest of its edges, pixels.
    fn longest_edge(&self) -> f64 {
        let p = self.points();
        (0..4).map(|i| (p[i] - p[(i + 1) % 4]).norm()).fold(0.0, f64::max)
    }
}

/// Where a photo shows the marker. `grey` holds width x height bytes of the usual sRGB curve, row by row.
///
/// `None` if it is not seen, if it is seen more than once (which one has the known size cannot be told; [`detect_all`] gives
/// them all, and [`metric`] takes those that agree), or if the bytes are not width x height.
///
/// The lens is taken to keep straight lines straight over the tag; [`refine`] does without that when the camera is known.
pub fn detect(grey: &[u8], width: usize, height: usize, marker: &Marker) -> Option<Detection> {
    let mut seen = detect_all(grey, width, height, marker.family).into_iter().filter(|(id, _)| *id == marker.id);
    let first = seen.next()?.1;
    seen.next().is_none().then_some(first)
}

/// All tags of a family that a photo shows, with their ids, in order of ids and then from the top: what to ask when the
/// marker is in no photo, or in one twice. Arguments as for [`detect`].
pub fn detect_all(grey: &[u8], width: usize, height: usize, family: Family) -> Vec<(u32, Detection)> {
    let Family::Tag36h11 = family;
    let Some(image) = Grey::new(grey, width, height) else { return Vec::new() };
    let levels = image.pyramid();
    let mut tags: Vec<(u32, Detection)> = Vec::new();
    for level in 0..levels.len() {
        let to_photo = f64::powi(2.0, level as i32);
        for quad in quads::quads(&levels[level]) {
            let known =
                |at: Point2<f64>| tags.iter().any(|(_, tag)| (tag.middle() - at).norm() < 0.25 * tag.longest_edge());
            let middle = quad.iter().map(|p| p.coords).sum::<Vector2<f64>>() / 4.0;
            if known((middle * to_photo).into()) {
                continue;
            }
            if let Some((id, detection)) = tag_in(&levels, level, &quad)
                && !known(detection.middle())
            {
                tags.push((id, detection));
            }
        }
    }
    tags.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.middle().y.total_cmp(&b.1.middle().y)));
    tags
}

/// The detection anew with the lens of the photo: edges that the lens bends are followed. `None` if the photo does not show
/// the marker there.
pub fn refine(
    grey: &[u8],
    width: usize,
    height: usize,
    marker: &Marker,
    found: &Detection,
    camera: &Camera,
) -> Option<Detection> {
    let image = Grey::new(grey, width, height)?;
    let warp = Warp::new(&found.points(), Lens::Known(camera))?;
    let warp = edges::fit(&image, &warp, &edges::pattern(usize::try_from(marker.id).ok()?), true)?;
    Some(Detection { corners: warp.corners()?.map(Into::into) })
}

/// The tag in a quadrilateral of a level, with corners in pixels of the photo itself.
fn tag_in(levels: &[Grey<'_>], level: usize, quad: &[Point2<f64>; 4]) -> Option<(u32, Detection)> {
    let image = &levels[level];
    let warp = Warp::new(quad, Lens::Unknown)?;
    let direct = decode::cells(image, &warp).and_then(decode::matching);
    let (warp, Read { id, turns }) = match direct {
        Some(read) => (warp, read),
        None => {
            let warp = edges::fit(image, &warp, &edges::border(), false)?;
            let read = decode::matching(decode::cells(image, &warp)?)?;
            (warp, read)
        }
    };
    let mut corners = warp.corners()?;
    corners.rotate_left(turns);
    let pattern = edges::pattern(id);
    let mut refined: Option<usize> = None;
    for k in (0..=level).rev() {
        // Corners of pixels are whole numbers: doubling an image doubles coordinates.
        let start = if k < level { corners.map(|c| c * 2.0) } else { corners };
        match Warp::new(&start, Lens::Unknown).and_then(|w| edges::fit(&levels[k], &w, &pattern, true)?.corners()) {
            Some(found) => (corners, refined) = (found, Some(k)),
            // Too blurred at this size: what the smaller picture shows is all there is.
            None => break,
        }
    }
    let to_photo = f64::powi(2.0, refined? as i32);
    Some((id as u32, Detection { corners: corners.map(|c| (c * to_photo).into()) }))
}
