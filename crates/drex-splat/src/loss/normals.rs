//! Normals of a depth map (2DGS, Huang et al. 2024, eq. 15), camera frame.
//!
//! With the depth d of pixel (x, y) and its ray ρ = ((x - cx)/fx, (y - cy)/fy, 1), the surface point is p = d ρ and
//!
//! ```text
//! a = p(x, y+1) - p(x, y-1)    b = p(x+1, y) - p(x-1, y)    c = a × b    n = c / |c|   (faces the camera)
//! ```
//!
//! a and b are taken as (d⁺ - d⁻) ρ + (d⁺ + d⁻) (0, 1/fy, 0) and the like, which keeps the digits that the difference of
//! two far points would lose.

use drex_core::camera::PinholeCamera;
use drex_core::simd::vectorised;
use rayon::prelude::*;

use super::check_image;
use crate::Result;

/// Unit normals of a depth map (z, row by row, 0 where unknown), camera frame, facing the camera; zero at the image's
/// border and where a neighbour's depth is unknown.
///
/// # Errors
/// If the map's size is not the camera's, or the camera is out of range.
pub fn depth_normals(depth: &[f32], camera: &PinholeCamera) -> Result<Vec<[f32; 3]>> {
    let (width, height) = (camera.width, camera.height);
    camera.check()?;
    check_image("a depth map", depth.len(), width, height)?;
    let rays = Rays::new(camera);
    let mut normals = vec![[0.0; 3]; depth.len()];
    let inner = normals.par_chunks_mut(width).enumerate().filter(|(row, _)| (1..height - 1).contains(row));
    inner.for_each(|(row, normals)| {
        let at = |row: usize| &depth[row * width..(row + 1) * width];
        vectorised(
            #[inline(always)]
            || {
                let neighbours = Neighbours::new(at(row - 1), at(row), at(row + 1), &rays, row);
                let n = neighbours.here.len();
                let normals = &mut inner_mut(normals)[..n];
                for i in 0..n {
                    let t = neighbours.tangents(i);
                    normals[i] = t.c.map(|c| c * t.per_length);
                }
            },
        );
    });
    Ok(normals)
}

/// The rays of the pixels' centres.
pub(super) struct Rays {
    /// (x - cx) / fx of every column.
    pub x: Vec<f32>,
    /// (y - cy) / fy of every row.
    pub y: Vec<f32>,
    pub per_fx: f32,
    pub per_fy: f32,
}

impl Rays {
    pub fn new(camera: &PinholeCamera) -> Self {
        Self {
            x: (0..camera.width).map(|x| ((x as f64 + 0.5 - camera.cx) / camera.fx) as f32).collect(),
            y: (0..camera.height).map(|y| ((y as f64 + 0.5 - camera.cy) / camera.fy) as f32).collect(),
            per_fx: (1.0 / camera.fx) as f32,
            per_fy: (1.0 / camera.fy) as f32,
        }
    }
}

/// The depths round the pixels of a row but its first and its last, and their rays; index 0 is the second pixel. All
/// slices have the same length.
pub(super) struct Neighbours<'a> {
    pub above: &'a [f32],
    pub left: &'a [f32],
    pub here: &'a [f32],
    pub right: &'a [f32],
    pub below: &'a [f32],
    pub ray_x: &'a [f32],
    pub ray_y: f32,
    pub per_fx: f32,
    pub per_fy: f32,
}

/// The ray of a pixel, the differences a and b of surface points, their cross product, and 1 / its length: 0 where
/// there is no normal.
pub(super) struct Tangents {
    pub ray: [f32; 3],
    pub a: [f32; 3],
    pub b: [f32; 3],
    pub c: [f32; 3],
    pub per_length: f32,
}

impl<'a> Neighbours<'a> {
    /// Of three rows of a depth map; there are none where the image is narrower than three pixels.
    #[inline(always)]
    pub fn new(above: &'a [f32], here: &'a [f32], below: &'a [f32], rays: &'a Rays, row: usize) -> Self {
        let n = here.len().saturating_sub(2);
        Self {
            above: from(above, 1, n),
            left: from(here, 0, n),
            here: from(here, 1, n),
            right: from(here, 2, n),
            below: from(below, 1, n),
            ray_x: from(&rays.x, 1, n),
            ray_y: rays.y[row],
            per_fx: rays.per_fx,
            per_fy: rays.per_fy,
        }
    }

    #[inline(always)]
    pub fn tangents(&self, i: usize) -> Tangents {
        let (below, above, right, left) = (self.below[i], self.above[i], self.right[i], self.left[i]);
        let ray = [self.ray_x[i], self.ray_y, 1.0];
        let (da, db) = (below - above, right - left);
        let a = [da * ray[0], da * ray[1] + (below + above) * self.per_fy, da];
        let b = [db * ray[0] + (right + left) * self.per_fx, db * ray[1], db];
        let c = cross(a, b);
        let squared = dot(c, c);
        let seen = (below > 0.0) & (above > 0.0) & (right > 0.0) & (left > 0.0) & (self.here[i] > 0.0);
        let per_length = if seen & (squared > 0.0) { 1.0 / squared.sqrt() } else { 0.0 };
        Tangents { ray, a, b, c, per_length }
    }
}

/// `n` entries of a row from number `first` on.
#[inline(always)]
fn from(row: &[f32], first: usize, n: usize) -> &[f32] {
    &row[first.min(row.len() - n)..][..n]
}

/// A row without its first and its last entry.
#[inline(always)]
pub(super) fn inner_mut<T>(row: &mut [T]) -> &mut [T] {
    match row {
        [_, inner @ .., _] => inner,
        _ => &mut [],
    }
}

#[inline(always)]
pub(super) fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub(super) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
