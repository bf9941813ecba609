//! The things on the table, and which of them is meant.

use std::collections::{BTreeMap, BTreeSet};

use drex_core::stats::quantile;
use nalgebra::{Point2, Point3, Vector3};

use super::Scene;
use super::free_space::FreeSpace;
use crate::{Error, Result, Similarity, TablePlane};

/// A point stands on the table if it is higher than this many standard deviations of the table's own points.
const ABOVE: f64 = 3.5;
/// Share of the views that must have a point in their picture for it to be in the common view.
const COMMON: f64 = 0.6;
/// Points further from the target are not looked at, in distances of the cameras.
const REACH: f64 = 0.8;
/// A point whose place is less sure than this for a pixel of noise is left out, in distances of the cameras.
const UNSURE: f64 = 0.03;
/// Side of a cell of the table's plan, in distances of the cameras.
const CELL: f64 = 0.02;
/// Points whose feet are this close belong together, whatever is between them, in cells.
const TOUCHING: f64 = 3.0;
/// The same where no point of the table is seen between them, in cells: if the table shows elsewhere, and if it does not.
const HIDDEN: (f64, f64) = (7.0, 4.0);
/// The table shows if this share of the cells round the target has a point of it.
const SHOWS: f64 = 0.7;
/// Neighbours in space that a point needs.
const NEIGHBOURS: usize = 3;
/// Smallest group: points, and share of all that stands.
const LEAST: (usize, f64) = (6, 0.01);
/// Reach of the weight that makes points near the target count, in distances of the cameras.
const NEAR: f64 = 0.15;
/// The box is larger than what is in it by this share of its largest side.
const MARGIN: f64 = 0.06;
/// An object may reach beyond its points by this share of their largest side, where no ray passes.
const BEYOND: f64 = 0.6;
/// Side of the cells in which that is asked, in distances of the cameras.
const FREE_CELL: f64 = 0.014;
/// It is taken to reach this far, as a share of the same, where rays do not tell.
const UNKNOWN_REACH: f64 = 0.25;
/// Share of a group's points on each side of each axis that is not trusted to be the object's.
const TRIMMED: f64 = 0.003;
/// Share of the best group's weight from which another one is a doubt.
const CLOSE: f64 = 0.4;
/// A click picks a group whose points appear within this share of the photo's diagonal.
const CLICK: f64 = 0.1;
/// Groups this much further off than the nearest, in shares of the photo's diagonal, are hit as well; the one in front counts.
const CLICK_TIE: f64 = 0.01;
/// A mask's share from which a point is the object's.
const OBJECT: f64 = 0.5;

/// A pixel of a photo that shows the object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Click {
    /// Index of the view.
    pub view: usize,
    /// The pixel; the centre of the first one is (0.5, 0.5).
    pub pixel: Point2<f64>,
}

/// Something that stands on the table.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ObjectGroup {
    /// Indices of its points in the scene.
    pub points: Vec<usize>,
    /// Lower corner of its box with a margin, in the table's frame; on the table.
    pub lo: Point3<f64>,
    /// Upper corner.
    pub hi: Point3<f64>,
    /// How much of it is where the cameras look: weight of its points.
    pub weight: f64,
}

impl ObjectGroup {
    /// Middle of its box, table's frame.
    pub fn middle(&self) -> Point3<f64> {
        nalgebra::center(&self.lo, &self.hi)
    }
}

/// How the object was chosen among the groups.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Choice {
    /// It is what the cameras look at.
    LookedAt,
    /// A click picked it.
    Clicked,
    /// It is what the masks show.
    Masked,
}

/// The object and the other things on the table.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Found {
    /// The object.
    pub object: ObjectGroup,
    /// The other groups, most looked at first.
    pub others: Vec<ObjectGroup>,
    /// How the object was chosen.
    pub choice: Choice,
    /// Why the choice may be wrong, as a sentence.
    pub doubt: Option<String>,
}

/// Finds the things on the table in the cameras' common view and the one that is meant.
///
/// A thing is a group of points above the table whose feet on it are close, or have none of the table's points between them:
/// what stands side by side on a table shows the table in between. Of several things the one with most points near where the cameras look is the object, or the one that `click` hits,
/// or what masks show. `table_from_scan` maps the scene into the frame of the boxes, whose z is the height above `table`.
///
/// # Errors
/// If nothing stands on the table in the common view, or nothing is where the click points.
pub fn find_objects(
    scene: &Scene,
    table: &TablePlane,
    table_from_scan: &Similarity,
    click: Option<&Click>,
) -> Result<Found> {
    let masked = click.is_none() && scene.points().iter().any(|p| p.object_share.is_some_and(|s| s > OBJECT));
    let standing = standing(scene, table, masked);
    let plan = Plan::new(scene, table, table_from_scan, &standing);
    let mut groups: Vec<ObjectGroup> = plan
        .groups(&standing)
        .into_iter()
        .filter(|g| g.len() >= LEAST.0.max((LEAST.1 * standing.len() as f64).ceil() as usize))
        .map(|points| group(scene, points, &standing, table_from_scan))
        .collect();
    groups.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    if groups.is_empty() {
        return Err(Error::value(
            format!("of {} sparse points none, or too few together, stand on the table", scene.points().len()),
            "give masks of the object, the box it is in, or a table plane that is right",
        ));
    }
    if masked {
        let points: Vec<usize> = groups.iter().flat_map(|g| &g.points).copied().collect();
        let object = group(scene, points, &[], table_from_scan);
        return Ok(Found { object, others: Vec::new(), choice: Choice::Masked, doubt: None });
    }
    let picked = click.map(|c| pick(scene, &groups, c)).transpose()?;
    let object = groups.remove(picked.unwrap_or(0));
    let choice = if picked.is_some() { Choice::Clicked } else { Choice::LookedAt };
    let second = groups.first().filter(|g| picked.is_none() && g.weight > CLOSE * object.weight);
    let doubt = second.map(|other| {
        let apart = (other.middle() - object.middle()).norm();
        format!(
            "{} things stand where the cameras look, the next one {apart:.3} from the one taken (middle to middle, in the \
             table's unit); click on the object with --object X,Y@PHOTO or give its box with --region",
            groups.len() + 1
        )
    });
    Ok(Found { object, others: groups, choice, doubt })
}

/// Indices of the points that stand on the table in the common view, or of those that masks show.
fn standing(scene: &Scene, table: &TablePlane, masked: bool) -> Vec<usize> {
    let noise_px = table.rms_px.max(0.5);
    let stands = |i: &usize| {
        let p = &scene.points()[*i];
        if masked {
            return p.object_share.is_some_and(|s| s > OBJECT);
        }
        let h = table.height(&p.position);
        let sigma = scene.sigma(*i, &table.up).max(table.rms / noise_px);
        h > ABOVE * noise_px * sigma
            && (p.position - scene.target()).norm() < REACH * scene.camera_distance()
            && scene.covariances[*i].trace().sqrt() < UNSURE * scene.camera_distance()
            && in_view(scene, &p.position) >= COMMON
    };
    let found: Vec<usize> = (0..scene.points().len()).filter(stands).collect();
    if masked { found } else { without_strays(scene, found) }
}

/// The points that have company.
fn without_strays(scene: &Scene, points: Vec<usize>) -> Vec<usize> {
    let side = 2.0 * CELL * scene.camera_distance();
    let cell = |i: usize| scene.points()[i].position.coords.map(|c| (c / side).floor() as i64);
    let mut count: BTreeMap<[i64; 3], usize> = BTreeMap::new();
    points.iter().for_each(|&i| *count.entry(cell(i).into()).or_default() += 1);
    let company = |&i: &usize| {
        let c = cell(i);
        let near = (0..27).filter_map(|n| count.get(&[c.x + n / 9 - 1, c.y + n / 3 % 3 - 1, c.z + n % 3 - 1]));
        near.sum::<usize>() > NEIGHBOURS
    };
    points.into_iter().filter(company).collect()
}

fn in_view(scene: &Scene, p: &Point3<f64>) -> f64 {
    scene.views().iter().filter(|v| v.pixel_of(p).is_some()).count() as f64 / scene.views().len() as f64
}

/// The table from above, in cells.
struct Plan<'a> {
    scene: &'a Scene,
    table_from_scan: &'a Similarity,
    side: f64,
    standing: BTreeSet<[i64; 2]>,
    /// Cells in which the table is seen and nothing stands.
    bare: BTreeSet<[i64; 2]>,
    /// Whether there is a point of the table in most cells that show it.
    shows: bool,
}

impl<'a> Plan<'a> {
    fn new(scene: &'a Scene, table: &TablePlane, table_from_scan: &'a Similarity, standing: &[usize]) -> Self {
        let side = CELL * scene.camera_distance() * table_from_scan.scale;
        let mut plan =
            Self { scene, table_from_scan, side, standing: BTreeSet::new(), bare: BTreeSet::new(), shows: false };
        plan.standing = standing.iter().map(|&i| plan.cell(i)).collect();
        let noise_px = table.rms_px.max(0.5);
        let on_table = |i: &usize| {
            let h = table.height(&scene.points()[*i].position).abs();
            h <= 3.0 * noise_px * scene.sigma(*i, &table.up)
        };
        plan.bare = (0..scene.points().len())
            .filter(on_table)
            .map(|i| plan.cell(i))
            .filter(|c| !plan.standing.contains(c))
            .collect();
        let middle = plan.cell_of(&table_from_scan.point(&scene.target()));
        let reach = (0.4 / CELL) as i64;
        let round = (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| [middle[0] + x, middle[1] + y]));
        let (mut free, mut bare) = (0, 0);
        for c in round.filter(|c| !plan.standing.contains(c)) {
            free += 1;
            bare += usize::from(plan.bare.contains(&c));
        }
        plan.shows = f64::from(bare as u32) >= SHOWS * f64::from(free);
        plan
    }

    fn cell_of(&self, p: &Point3<f64>) -> [i64; 2] {
        [0, 1].map(|k| (p[k] / self.side).floor() as i64)
    }

    fn cell(&self, i: usize) -> [i64; 2] {
        self.cell_of(&self.table_from_scan.point(&self.scene.points()[i].position))
    }

    /// Whether what stands in two cells is one thing.
    fn connected(&self, a: [i64; 2], b: [i64; 2]) -> bool {
        let off = [0, 1].map(|k| (b[k] - a[k]) as f64);
        let apart = off[0].hypot(off[1]);
        let most = if self.shows { HIDDEN.0 } else { HIDDEN.1 };
        if apart <= TOUCHING {
            return true;
        }
        if apart > most {
            return false;
        }
        let steps = (2.0 * apart).ceil();
        let bare = (1..steps as i64).filter(|&s| {
            let at = [0, 1].map(|k| (a[k] as f64 + off[k] * s as f64 / steps).round() as i64);
            self.bare.contains(&at)
        });
        bare.count() <= 1
    }

    /// Groups of points by connected cells, each as sorted indices, in the order of their first cells.
    fn groups(&self, standing: &[usize]) -> Vec<Vec<usize>> {
        let mut members: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
        standing.iter().for_each(|&i| members.entry(self.cell(i)).or_default().push(i));
        let reach = HIDDEN.0.ceil() as i64;
        let mut groups = Vec::new();
        while let Some((first, points)) = members.pop_first() {
            let (mut group, mut queue) = (points, vec![first]);
            while let Some(at) = queue.pop() {
                for x in -reach..=reach {
                    for y in -reach..=reach {
                        let next = [at[0] + x, at[1] + y];
                        if members.contains_key(&next)
                            && self.connected(at, next)
                            && let Some(points) = members.remove(&next)
                        {
                            group.extend(points);
                            queue.push(next);
                        }
                    }
                }
            }
            group.sort_unstable();
            groups.push(group);
        }
        groups
    }
}

/// A group and its box; `standing` are the points of all groups.
fn group(scene: &Scene, points: Vec<usize>, standing: &[usize], table_from_scan: &Similarity) -> ObjectGroup {
    let place = |i: usize| table_from_scan.point(&scene.points()[i].position);
    let places: Vec<Point3<f64>> = points.iter().map(|&i| place(i)).collect();
    let own: BTreeSet<usize> = points.iter().copied().collect();
    let others: Vec<Point3<f64>> = standing.iter().filter(|i| !own.contains(i)).map(|&i| place(i)).collect();
    let end = |k: usize, share: f64| quantile(places.iter().map(|p| p[k]), share).unwrap_or(0.0);
    let lo = Point3::from([0, 1, 2].map(|k| end(k, TRIMMED)));
    let hi = Point3::from([0, 1, 2].map(|k| end(k, 1.0 - TRIMMED)));
    let (lo, hi) = reach(scene, [&places, &others], lo, hi, table_from_scan);
    let margin = (MARGIN * (hi - lo).max()).max(CELL * scene.camera_distance() * table_from_scan.scale);
    let (mut lo, hi) = (lo.map(|c| c - margin), hi.map(|c| c + margin));
    lo.z = 0.0;
    let near = NEAR * scene.camera_distance();
    let weight = |&i: &usize| (-((scene.points()[i].position - scene.target()).norm() / near).powi(2)).exp();
    let weight = points.iter().map(weight).sum();
    ObjectGroup { points, lo, hi, weight }
}

/// The box of points, extended to what no ray of sight passes through and where none of the others is.
fn reach(
    scene: &Scene,
    [places, others]: [&[Point3<f64>]; 2],
    lo: Point3<f64>,
    hi: Point3<f64>,
    table_from_scan: &Similarity,
) -> (Point3<f64>, Point3<f64>) {
    let size = (hi - lo).max();
    let lo = Point3::new(lo.x, lo.y, 0.0);
    let side = (FREE_CELL * scene.camera_distance() * table_from_scan.scale).max(size / 60.0);
    let beyond = Vector3::repeat(BEYOND * size);
    // Nothing reaches below the table, and the cells next to it are grazed by too few rays.
    let (mut from, to) = (lo - beyond, hi + beyond);
    from.z = 0.5 * side;
    let mut free = FreeSpace::new(scene, table_from_scan, from, to, side);
    free.block(others.iter().copied());
    let Some((least, most, ends)) = free.around(places) else { return (lo, hi) };
    let (mut out_lo, mut out_hi) = (lo, hi);
    for k in 0..2 {
        out_lo[k] = if ends[k] { lo[k] - UNKNOWN_REACH * size } else { lo[k].min(least[k]) };
    }
    for k in 0..3 {
        out_hi[k] = if ends[k + 3] { hi[k] + UNKNOWN_REACH * size } else { hi[k].max(most[k]) };
    }
    (out_lo, out_hi)
}

/// Which group a click hits: the one whose points appear nearest to it; among several that are hit, the one in front.
fn pick(scene: &Scene, groups: &[ObjectGroup], click: &Click) -> Result<usize> {
    let refuse = |what: String| Err(Error::value(what, "click on the object in a photo that shows it well"));
    let Some(view) = scene.views().get(click.view) else {
        return refuse(format!("there is no view {} among {}", click.view, scene.views().len()));
    };
    if !view.lens.contains(&click.pixel) {
        let (w, h) = (view.lens.width_px(), view.lens.height_px());
        return refuse(format!("pixel {}, {} is outside the photo of {w} x {h}", click.pixel.x, click.pixel.y));
    }
    let diagonal = f64::from(view.lens.width_px()).hypot(f64::from(view.lens.height_px()));
    let hits: Vec<Vec<(f64, f64)>> = groups
        .iter()
        .map(|g| {
            let seen = g.points.iter().filter_map(|&i| {
                let p = &scene.points()[i].position;
                let off = (view.pixel_of(p)? - click.pixel).norm() / diagonal;
                Some((off, (p - view.centre()).norm()))
            });
            seen.collect()
        })
        .collect();
    let nearest = hits.iter().flatten().map(|(off, _)| *off).fold(f64::INFINITY, f64::min);
    if nearest > CLICK {
        return refuse("nothing that stands on the table is where the click points".to_owned());
    }
    let depth = |hits: &[(f64, f64)]| {
        let hit = hits.iter().filter(|(off, _)| *off <= nearest + CLICK_TIE);
        hit.map(|(_, depth)| *depth).fold(f64::INFINITY, f64::min)
    };
    let depths: Vec<f64> = hits.iter().map(|h| depth(h)).collect();
    Ok((0..groups.len()).min_by(|&a, &b| depths[a].total_cmp(&depths[b])).unwrap_or(0))
}
