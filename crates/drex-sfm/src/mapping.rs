//! From verified pairs to poses and points: openmvg's incremental engine.

use openmvg_sfm::model::{ImageMeta, PairGeometry, ViewRecord};
use openmvg_sfm::{
    Camera, FeatureId, FeatureMatch, Incremental, IntrinsicId, PoseId, Reconstruction, SfmOutput, ViewGraph,
    ViewGraphParts, ViewId, ViewPair,
};

use crate::features::Features;
use crate::matching::PairMatches;
use crate::verify::{Geometry, Pair};

/// What the engine starts from.
pub(crate) struct Scene<'a> {
    pub(crate) names: &'a [String],
    pub(crate) sizes: &'a [[u32; 2]],
    pub(crate) features: &'a [Features],
    pub(crate) cameras: &'a [Camera],
    pub(crate) camera_of: &'a [usize],
    pub(crate) calibrated: bool,
    pub(crate) seed: u64,
}

/// A model of some of the photos; indices are those of the scene.
pub(crate) struct Mapped {
    pub(crate) photos: Vec<usize>,
    pub(crate) output: SfmOutput,
}

impl Mapped {
    pub(crate) fn reconstruction(&self) -> &Reconstruction {
        self.output.reconstruction()
    }
}

/// Maps the photos `chosen` (sorted) by the pairs among them, whose matches are some of `matches`.
pub(crate) fn map(
    scene: &Scene<'_>,
    matches: &[PairMatches],
    pairs: &[&Pair],
    chosen: &[usize],
) -> Result<Mapped, String> {
    let index_of = |photo: usize| chosen.binary_search(&photo).ok();
    let mut used: Vec<usize> = chosen.iter().map(|&p| scene.camera_of[p]).collect();
    used.sort_unstable();
    used.dedup();
    let cameras: Vec<Camera> = used.iter().map(|&c| scene.cameras[c].clone()).collect();
    let views = chosen.iter().enumerate().map(|(k, &p)| {
        let [width, height] = scene.sizes[p];
        let camera = used.binary_search(&scene.camera_of[p]).unwrap_or(0);
        let meta = ImageMeta::external_id(scene.names[p].clone(), width, height);
        ViewRecord::new(ViewId::new(k), meta, IntrinsicId::new(camera), PoseId::new(k))
    });
    let keypoints = chosen.iter().map(|&p| scene.features[p].keypoints.clone()).collect();
    let mut parts = ViewGraphParts::new(scene.seed, cameras, views.collect(), keypoints)
        .with_calibrated_intrinsics(scene.calibrated);
    for pair in pairs {
        let [Some(i), Some(j)] = pair.views.map(index_of) else { continue };
        let geometry = match &pair.geometry {
            Geometry::Epipolar { essential, second_from_first } => {
                PairGeometry::Essential { matrix: *essential, relative_pose: Some(*second_from_first) }
            }
            Geometry::Plane { homography } => PairGeometry::Homography { matrix: *homography, relative_pose: None },
            Geometry::Turn { .. } => continue,
        };
        let own = &matches[pair.matched].matches;
        // A collection of results would not know its length and take up to twice the room.
        let mut with_ids = Vec::with_capacity(own.len());
        for m in own {
            let [first, second] = m.keypoints().map(FeatureId::new);
            let with_id = FeatureMatch::try_new(first, second, Some(m.distance));
            with_ids.push(with_id.map_err(|e| e.to_string())?);
        }
        let views = ViewPair::new(ViewId::new(i), ViewId::new(j));
        parts = parts.with_pair(views, with_ids, Some((geometry, pair.inliers.clone())));
    }
    let graph = ViewGraph::try_from_parts(parts).map_err(|e| e.to_string())?;
    let output = Incremental::default().run_prepared_owned(graph).map_err(|e| e.to_string())?;
    Ok(Mapped { photos: chosen.to_vec(), output })
}
