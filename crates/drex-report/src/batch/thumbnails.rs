//! A small picture of each object.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_PI_2;
use std::path::{Path, PathBuf};

use drex_core::{Pose, PoseRecord, fsutil};
use drex_twin::batch::{Item, Task};
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{FilterType, resize};
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::Deserialize;

use crate::object::OBJECT_COLOR;
use crate::picture::raster::{View, render};
use crate::picture::surface::Surface;

/// Width of a picture, pixels.
pub const WIDTH: u32 = 160;
/// Height of a picture, pixels.
pub const HEIGHT: u32 = 128;
/// Drawn pixels for each of the picture, per axis, where there is a photo on the mesh: it is finer than the picture.
const FINER: u32 = 2;
/// Quality of the JPEG, of 100.
const QUALITY: u8 = 82;

/// Where an item's mesh is.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
enum Source {
    /// In a twin's folder, with the pose in which it rests.
    Twin(PathBuf),
    /// A file.
    Mesh(PathBuf),
}

impl Source {
    fn of(item: &Item) -> Self {
        match &item.task {
            Task::Twin(folder) => Self::Twin(folder.clone()),
            Task::Find(task) => Self::Mesh(task.mesh.clone()),
        }
    }
}

/// Pictures of meshes, each drawn once.
pub struct Thumbnails(BTreeMap<Source, Vec<u8>>);

impl Thumbnails {
    /// Draws the meshes of these items on all threads. One that is missing or cannot be read has no picture.
    pub fn draw<'a>(items: impl Iterator<Item = &'a Item>) -> Self {
        let sources: Vec<Source> = items.map(Source::of).collect::<BTreeSet<_>>().into_iter().collect();
        let drawn = sources.into_par_iter().filter_map(|source| Some((drawn(&source)?, source)));
        Self(drawn.map(|(picture, source)| (source, picture)).collect())
    }

    /// The picture of an item as a JPEG file.
    pub fn get(&self, item: &Item) -> Option<&[u8]> {
        self.0.get(&Source::of(item)).map(Vec::as_slice)
    }
}

fn drawn(source: &Source) -> Option<Vec<u8>> {
    let (mesh, world_from_mesh) = match source {
        Source::Twin(folder) => (folder.join("mesh/visual.obj"), rest_pose(&folder.join("mesh/report.json"))),
        Source::Mesh(mesh) => (mesh.clone(), upright(mesh)),
    };
    let surfaces = Surface::read(&mesh).ok()?;
    let parts: Vec<_> = surfaces.iter().map(|s| s.part(world_from_mesh, OBJECT_COLOR)).collect();
    let heights = surfaces.iter().flat_map(|s| &s.mesh.vertices).map(|v| (world_from_mesh * v).z);
    let table = heights.fold(f64::INFINITY, f64::min);
    let finer = if surfaces.iter().any(|s| s.texture.is_some()) { FINER } else { 1 };
    let view = View {
        width: finer * WIDTH,
        height: finer * HEIGHT,
        azimuth: -0.7,
        elevation: 0.35,
        table_height_m: table.is_finite().then_some(table),
    };
    let small = resize(&render(&parts, &view), WIDTH, HEIGHT, FilterType::Triangle);
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, QUALITY).encode_image(&small).ok()?;
    table.is_finite().then_some(jpeg)
}

/// How a twin's mesh rests on the table; as it is in its file where no report says.
fn rest_pose(report: &Path) -> Pose {
    #[derive(Deserialize)]
    struct Report {
        world_from_mesh_at_rest: PoseRecord,
    }
    let written = fsutil::read_text(report).and_then(|text| fsutil::from_json::<Report>(report, &text));
    written.and_then(|r| r.world_from_mesh_at_rest.to_pose()).unwrap_or_else(|_| Pose::identity())
}

/// What turns the up of a mesh file to the z axis: y in glTF, z in others.
fn upright(mesh: &Path) -> Pose {
    let gltf = mesh.extension().is_some_and(|e| ["glb", "gltf"].iter().any(|ending| e.eq_ignore_ascii_case(ending)));
    if gltf { Pose::rotation(Vector3::x() * FRAC_PI_2) } else { Pose::identity() }
}
