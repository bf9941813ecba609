//! Scenes that a reader can turn and play: meshes, Gaussians and poses over time as JSON with typed arrays in base64, which `viewer.js`
//! draws. World frame of a scene: metres, z up.

use crate::picture::surface::Surface;
use crate::{Error, Result};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use drex_core::{Pose, TriMesh};
use drex_mesh::{DecimateOptions, decimate};
use drex_splat::Gaussians;
use image::{ImageFormat, RgbImage};
use nalgebra::Point3;
use serde_json::{Value, json};

/// A mesh that has more than this many times the faces that were wanted, even simplified, is not embedded.
const TOLERATED: usize = 3;
/// Most faces of a mesh with a picture, which are embedded as they are: about 20 bytes each.
pub const MOST_TEXTURED: usize = 60_000;
/// Most Gaussians of a scene: 17 bytes each.
pub const MOST_SPLATS: usize = 25_000;
/// A Gaussian that is wider than this share of the box is haze rather than surface.
const HAZE: f64 = 0.25;
/// Least opacity that is worth its bytes.
const FAINT: f32 = 0.02;
/// The spherical harmonic of degree zero, 1 / (2 √π).
const SH0: f32 = 0.282_094_8;
/// Steps of a coordinate over the box that it lies in.
const STEPS: f64 = 65535.0;

/// How a part is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// Shaded faces.
    Solid,
    /// The edges between faces that meet at an angle; what is hidden shines through.
    Wire,
}

/// Where a part is in one frame: world_from_mesh, and how much larger it is than its mesh.
#[derive(Debug, Clone, Copy)]
pub struct Placed {
    /// world_from_mesh.
    pub pose: Pose,
    /// 1 for true size, 0 for what is not there in this frame.
    pub scale: f64,
}

impl From<Pose> for Placed {
    fn from(pose: Pose) -> Self {
        Self { pose, scale: 1.0 }
    }
}

/// A scene that is being put together.
#[derive(Clone)]
pub struct Scene {
    meshes: Vec<Value>,
    /// Lower and upper corner of each mesh.
    bounds: Vec<(Point3<f64>, Point3<f64>)>,
    parts: Vec<Value>,
    splats: Option<Value>,
    times_s: Vec<f64>,
    phases: Vec<(f64, String)>,
    start_s: Option<f64>,
    table_m: Option<f64>,
    link: Option<&'static str>,
    azimuth: f64,
    elevation: f64,
    /// Box around all that was placed.
    extent: Option<(Point3<f64>, Point3<f64>)>,
    fixed: bool,
    /// The part that the camera rises with.
    follow: Option<usize>,
}

impl Scene {
    /// An empty scene, seen from this azimuth and elevation, rad.
    pub fn new(azimuth: f64, elevation: f64) -> Self {
        Self {
            meshes: vec![],
            bounds: vec![],
            parts: vec![],
            splats: None,
            times_s: vec![],
            phases: vec![],
            start_s: None,
            table_m: None,
            link: None,
            azimuth,
            elevation,
            extent: None,
            fixed: false,
            follow: None,
        }
    }

    /// A table at this height, m.
    #[must_use]
    pub fn on_table(mut self, height_m: f64) -> Self {
        self.table_m = Some(height_m);
        self
    }

    /// Scenes with the same name are turned together.
    #[must_use]
    pub fn linked(mut self, name: &'static str) -> Self {
        self.link = Some(name);
        self
    }

    /// Frames at these times, s; a part then has one pose for each, or one for all.
    ///
    /// # Errors
    /// If they do not increase.
    pub fn timed(mut self, times_s: &[f64], start_s: Option<f64>) -> Result<Self> {
        if times_s.iter().any(|t| !t.is_finite()) || times_s.windows(2).any(|w| w[1] <= w[0]) {
            return Err(Error::Refused("the times of a scene must increase".into()));
        }
        self.times_s = times_s.to_vec();
        self.start_s = start_s;
        Ok(self)
    }

    /// What happens from which time on, s.
    #[must_use]
    pub fn phases(mut self, phases: impl IntoIterator<Item = (f64, &'static str)>) -> Self {
        self.phases = phases.into_iter().map(|(t, name)| (t, name.to_owned())).collect();
        self
    }

    /// Looks at this box (lower and upper corner, m) whatever is placed.
    #[must_use]
    pub fn framed(mut self, extent: (Point3<f64>, Point3<f64>)) -> Self {
        (self.extent, self.fixed) = (Some(extent), true);
        self
    }

    /// Embeds a mesh, simplified to about `most_faces`, and gives its number; `None` if it is empty or cannot be made so small.
    pub fn mesh(&mut self, mesh: &TriMesh, most_faces: usize) -> Option<usize> {
        self.embed(&simplified(mesh, most_faces)?, None)
    }

    /// Embeds a surface with its picture as it is, and gives its number; `None` if it has no picture, is empty or has more than [`MOST_TEXTURED`]
    /// faces.
    pub fn textured(&mut self, surface: &Surface) -> Option<usize> {
        let (uv, picture) = surface.texture.as_ref()?;
        if surface.mesh.faces.is_empty() || surface.mesh.faces.len() > MOST_TEXTURED {
            return None;
        }
        let step = |c: &f32| (f64::from(c.clamp(0.0, 1.0)) * STEPS).round() as u16;
        let places = encode(uv.iter().flatten().flat_map(|c| step(c).to_le_bytes()));
        let picture = format!("data:image/jpeg;base64,{}", STANDARD.encode(jpeg(picture)?));
        self.embed(&surface.mesh, Some(json!({ "uv": places, "picture": picture })))
    }

    /// Embeds a mesh as it is.
    fn embed(&mut self, simpler: &TriMesh, looks: Option<Value>) -> Option<usize> {
        let (lo, hi) = simpler.bounds()?;
        let grid = Grid::over(&lo, &hi);
        let corners: Vec<u16> = simpler.vertices.iter().flat_map(|v| grid.cell(v)).collect();
        let wide = simpler.vertices.len() > usize::from(u16::MAX) + 1;
        let indices = simpler.faces.iter().flatten();
        let faces = if wide {
            encode(indices.flat_map(|i| i.to_le_bytes()))
        } else {
            // The number of vertices says that it fits.
            encode(indices.flat_map(|&i| (i as u16).to_le_bytes()))
        };
        let v = encode(corners.into_iter().flat_map(u16::to_le_bytes));
        self.meshes.push(json!({ "lo": grid.lo, "step": grid.step, "v": v, "f": faces, "wide": wide, "looks": looks }));
        self.bounds.push((lo, hi));
        Some(self.meshes.len() - 1)
    }

    /// Places an embedded mesh: one pose for all frames, or one for each. `color` is red, green, blue in [0, 1].
    ///
    /// # Errors
    /// If there are as many poses as neither, or one is not finite.
    pub fn part(&mut self, mesh: usize, look: Look, color: [f64; 3], placed: &[Placed]) -> Result<()> {
        let Some(&(lo, hi)) = self.bounds.get(mesh) else {
            return Err(Error::Refused(format!("the scene has no mesh {mesh}")));
        };
        if placed.len() != 1 && placed.len() != self.times_s.len() {
            return Err(Error::Refused(format!("{} poses for {} frames", placed.len(), self.times_s.len())));
        }
        let mut numbers = Vec::with_capacity(8 * placed.len());
        for Placed { pose, scale } in placed {
            let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
            let row = [t.x, t.y, t.z, q.w, q.i, q.j, q.k, *scale];
            if row.iter().any(|v| !v.is_finite()) {
                return Err(Error::Refused("a pose of a scene is not finite".into()));
            }
            numbers.extend(row.map(|v| v as f32));
            if !self.fixed && *scale > 0.0 {
                for k in 0..8 {
                    let corner = Point3::new([lo.x, hi.x][k & 1], [lo.y, hi.y][k >> 1 & 1], [lo.z, hi.z][k >> 2]);
                    let p = pose * (corner * *scale);
                    self.extent = Some(self.extent.map_or((p, p), |(a, b)| (a.inf(&p), b.sup(&p))));
                }
            }
        }
        let poses = encode(numbers.into_iter().flat_map(f32::to_le_bytes));
        let look = match look {
            Look::Solid => "solid",
            Look::Wire => "wire",
        };
        self.parts.push(json!({ "mesh": mesh, "look": look, "color": color, "poses": poses }));
        Ok(())
    }

    /// The camera rises and sinks with the part that was placed last.
    pub fn follow_last(&mut self) {
        self.follow = self.parts.len().checked_sub(1);
    }

    /// Embeds the strongest Gaussians whose centres are inside the box (lower and upper corner, m), in the world frame of the scene,
    /// with their mean colour over all directions. Gives how many there are in the box and how many of them were taken.
    pub fn splats(&mut self, gaussians: &Gaussians, (lo, hi): (Point3<f64>, Point3<f64>)) -> (usize, usize) {
        let widest = ((hi - lo).norm() * HAZE) as f32;
        let inside = |i: usize| {
            let p = gaussians.means[i].map(f64::from);
            (0..3).all(|k| (lo[k]..=hi[k]).contains(&p[k]))
        };
        let base = |i: usize| gaussians.sh.get(i * gaussians.sh_stride()..)?.first_chunk::<3>();
        let usable = |i: usize| {
            let (q, s) = (gaussians.rotations[i], gaussians.log_scales[i]);
            let mut numbers = q.iter().chain(&s).chain(base(i).into_iter().flatten());
            base(i).is_some() && numbers.all(|v| v.is_finite()) && q.iter().any(|v| *v != 0.0)
        };
        // What covers most of the picture: opacity times the area of the two longest axes.
        let cover = |i: usize| {
            let mut s = gaussians.log_scales[i];
            s.sort_by(|a, b| b.total_cmp(a));
            gaussians.opacity(i) * (s[0] + s[1]).exp()
        };
        let mut chosen: Vec<(f32, usize)> = (0..gaussians.len())
            .filter(|&i| inside(i) && usable(i) && gaussians.opacity(i) >= FAINT)
            .filter(|&i| gaussians.log_scales[i].iter().all(|s| s.exp() <= widest))
            .map(|i| (cover(i), i))
            .collect();
        let found = chosen.len();
        chosen.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        chosen.truncate(MOST_SPLATS);
        let chosen: Vec<usize> = chosen.into_iter().map(|c| c.1).collect();
        if chosen.is_empty() {
            return (found, 0);
        }
        let grid = Grid::over(&lo, &hi);
        let places = chosen.iter().flat_map(|&i| grid.cell(&Point3::from(gaussians.means[i].map(f64::from))));
        let surfel = gaussians.kind == drex_splat::Kind::Surfel;
        // A surfel is flat.
        let thin = (1e-4 * widest).ln();
        let sizes: Vec<f32> = chosen
            .iter()
            .flat_map(|&i| {
                let [a, b, c] = gaussians.log_scales[i];
                [a, b, if surfel { thin } else { c }].map(|s| s.max(thin))
            })
            .collect();
        let (least, most) = sizes.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), s| (a.min(*s), b.max(*s)));
        let step = ((most - least) / 255.0).max(1e-6);
        let turns = chosen.iter().flat_map(|&i| {
            let q = gaussians.rotations[i];
            let longest = q.iter().fold(0.0, |m: f32, v| m.max(v.abs()));
            q.map(|v| (127.0 * v / longest).round() as i8 as u8)
        });
        let byte = |v: f32| (255.0 * v.clamp(0.0, 1.0)).round() as u8;
        let colors = chosen.iter().flat_map(|&i| {
            let [r, g, b] = base(i).copied().unwrap_or_default().map(|c| byte(0.5 + SH0 * c));
            [r, g, b, byte(gaussians.opacity(i))]
        });
        self.splats = Some(json!({
            "n": chosen.len(), "lo": grid.lo, "step": grid.step, "size_lo": least, "size_step": step,
            "p": encode(places.flat_map(u16::to_le_bytes)),
            "s": encode(sizes.iter().map(|s| ((s - least) / step).round() as u8)),
            "q": encode(turns),
            "c": encode(colors),
        }));
        if !self.fixed {
            self.extent = Some(self.extent.map_or((lo, hi), |(a, b)| (a.inf(&lo), b.sup(&hi))));
        }
        (found, chosen.len())
    }

    /// The scene as JSON that may stand inside a `<script>`; `None` if there is nothing to see.
    pub fn to_json(&self) -> Option<String> {
        if self.parts.is_empty() && self.splats.is_none() {
            return None;
        }
        let (lo, hi) = self.extent?;
        let centre = nalgebra::center(&lo, &hi);
        let radius = (0.5 * (hi - lo).norm()).max(1e-6);
        let times =
            (self.times_s.len() > 1).then(|| encode(self.times_s.iter().flat_map(|t| (*t as f32).to_le_bytes())));
        let scene = json!({
            "centre": [centre.x, centre.y, centre.z], "radius": radius,
            "azimuth": self.azimuth, "elevation": self.elevation,
            "table": self.table_m, "link": self.link, "start": self.start_s, "follow": self.follow,
            "times": times, "phases": self.phases,
            "meshes": self.meshes, "parts": self.parts, "splats": self.splats,
        });
        // No text inside may end the script.
        Some(scene.to_string().replace('<', "\\u003c"))
    }
}

/// Sixteen-bit places in a box.
struct Grid {
    lo: [f64; 3],
    step: [f64; 3],
}

impl Grid {
    fn over(lo: &Point3<f64>, hi: &Point3<f64>) -> Self {
        Self { lo: [lo.x, lo.y, lo.z], step: [0, 1, 2].map(|k| ((hi[k] - lo[k]) / STEPS).max(1e-12)) }
    }

    fn cell(&self, p: &Point3<f64>) -> [u16; 3] {
        [0, 1, 2].map(|k| ((p[k] - self.lo[k]) / self.step[k]).round().clamp(0.0, STEPS) as u16)
    }
}

/// The mesh with about this many faces; `None` if it is empty or keeps far more.
fn simplified(mesh: &TriMesh, most_faces: usize) -> Option<TriMesh> {
    if mesh.faces.len() <= most_faces {
        return (!mesh.faces.is_empty()).then(|| mesh.clone());
    }
    let mut options = DecimateOptions::default();
    options.target_faces = Some(most_faces);
    let simpler = decimate(mesh, &options).ok()?.0;
    (!simpler.faces.is_empty() && simpler.faces.len() <= TOLERATED * most_faces).then_some(simpler)
}

/// A picture as a JPEG file in memory; `None` if it is too large for one.
fn jpeg(picture: &RgbImage) -> Option<Vec<u8>> {
    let mut file = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut file, ImageFormat::Jpeg).ok()?;
    Some(file.into_inner())
}

fn encode(bytes: impl Iterator<Item = u8>) -> String {
    STANDARD.encode(bytes.collect::<Vec<u8>>())
}

#[cfg(test)]
#[path = "viewer_tests.rs"]
mod tests;
