//! From the parameters of a surfel to what the kernels read, and from their records back to its parameters.

use drex_core::camera::PinholeCamera;
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

use super::super::bounded;
use super::super::lanes::least_exponent;
use super::super::sh;
use super::Saved;
use super::backward::Record;
use super::bounds::Footprint;
use super::forward::{Projected, Rules, Splat};
use super::project::{Surfel, SurfelGradient, rotation, rotation_backward};
use crate::Gaussians;
use crate::raster::{DepthKind, GaussianGradients, RenderOptions, ScreenBox};

/// A plane that is met farther away than this many times the depth of the surfel's centre is seen edge-on: not drawn.
const MAX_DEPTH_RATIO: f64 = 1e6;
/// Coefficients beyond this leave the range of single precision on the way to a pixel; such a surfel is not drawn.
const MAX_COEFFICIENT: f32 = 1e15;

/// A camera with what is used of it for every surfel.
pub(super) struct View<'a> {
    camera: &'a PinholeCamera,
    pub options: &'a RenderOptions,
    /// Rotation of camera_from_world.
    w: Matrix3<f64>,
    centre: nalgebra::Point3<f64>,
}

impl<'a> View<'a> {
    pub fn new(camera: &'a PinholeCamera, options: &'a RenderOptions) -> Self {
        let w = camera.camera_from_world.rotation.to_rotation_matrix().into_inner();
        Self { camera, options, w, centre: camera.centre() }
    }

    pub fn rules(&self) -> Rules {
        Rules {
            max_alpha: self.options.max_alpha,
            max_inverse_depth: 1.0 / self.options.near,
            ray_depth: self.options.depth == DepthKind::Ray,
            geometry: self.options.geometry,
            smooth: self.options.smooth_cutoff,
        }
    }

    /// (m_i - m_j)² = κ² (1/z_i - 1/z_j)² with m = far / (far - near) (1 - near / z).
    pub fn kappa2(&self) -> f32 {
        let [near, far] = self.options.distortion_range;
        (far * near / (far - near)).powi(2)
    }

    fn surfel(&self, scene: &Gaussians, i: usize) -> Option<Surfel> {
        let r = self.w * rotation(scene.rotations[i])?;
        let mean = Vector3::from(scene.means[i].map(f64::from));
        let t = self.w * mean + self.camera.camera_from_world.translation.vector;
        let [log_u, log_v, _] = scene.log_scales[i].map(f64::from);
        let (near, c2) = (f64::from(self.options.near), f64::from(self.options.centre_cutoff));
        Surfel::new(self.camera, r, [log_u, log_v], t, near, c2)
    }

    /// None if the surfel is nowhere in the image.
    pub fn project(&self, scene: &Gaussians, i: usize) -> Option<(Projected, ScreenBox)> {
        let opacity = 1.0 / (1.0 + (-f64::from(scene.logit_opacities[i])).exp());
        let least = f64::from(least_exponent(self.options.smooth_cutoff));
        let radius2 = 2.0 * std::f64::consts::LN_2 * (opacity.log2() - least);
        let surfel = self.surfel(scene, i)?;
        let footprint = Footprint::new(&surfel, radius2, f64::from(self.options.near))?;
        let screen_box = self.screen_box(&footprint, surfel.t.z as f32);
        if screen_box.x0 >= screen_box.x1 || screen_box.y0 >= screen_box.y1 {
            return None;
        }
        let stride = scene.sh_stride();
        let (direction, _) = sh::direction(scene.means[i], &self.centre);
        // A floor beyond the camera's plane is put where no pixel is.
        let centre = surfel.centre.unwrap_or(Vector2::repeat(1e6)).map(|x| x.clamp(-1e6, 1e6) as f32);
        let splat = Splat {
            m: std::array::from_fn(|k| surfel.m[(k / 3, k % 3)] as f32),
            origin: surfel.origin.map(|x| x as f32),
            centre: centre.into(),
            log2_opacity: opacity.log2() as f32,
            radius2: radius2 as f32,
            min_inverse_depth: (1.0 / (MAX_DEPTH_RATIO * surfel.t.z)) as f32,
            colour: sh::colour(self.options.sh_degree, &scene.sh[i * stride..(i + 1) * stride], &direction),
            normal: surfel.normal().map(|x| x as f32).into(),
            depth: surfel.t.z as f32,
        };
        let sound = splat.m.iter().all(|m| m.abs() < MAX_COEFFICIENT) && splat.depth < MAX_COEFFICIENT;
        sound.then_some((Projected { splat, footprint }, screen_box))
    }

    fn screen_box(&self, footprint: &Footprint, depth: f32) -> ScreenBox {
        let pixels = |[lo, hi]: [f32; 2], side: usize| {
            let side = side as f32;
            [(lo - 0.5).ceil().clamp(0.0, side), ((hi - 0.5).floor() + 1.0).clamp(0.0, side)].map(|v| v as u16)
        };
        let [x0, x1] = pixels(footprint.x, self.camera.width);
        let [y0, y1] = pixels(footprint.y, self.camera.height);
        ScreenBox { x0, y0, x1, y1, depth }
    }

    /// Sums the records of every surfel and takes them back to its parameters.
    pub fn gather(&self, scene: &Gaussians, saved: &Saved, records: &[Record]) -> GaussianGradients {
        let stride = scene.sh_stride();
        let mut sh = vec![0.0; scene.sh.len()];
        let own: Vec<Own> = sh
            .par_chunks_mut(stride)
            .enumerate()
            .with_min_len(64)
            .map(|(i, d_sh)| self.of_one(scene, saved, records, i, d_sh))
            .collect();
        let mut twist = [0.0; 6];
        for one in &own {
            for k in 0..6 {
                twist[k] += one.twist[k];
            }
        }
        GaussianGradients {
            means: own.iter().map(|o| o.mean).collect(),
            rotations: own.iter().map(|o| o.rotation).collect(),
            log_scales: own.iter().map(|o| o.log_scale).collect(),
            logit_opacities: own.iter().map(|o| o.logit_opacity).collect(),
            sh,
            mean2d: own.iter().map(|o| o.mean2d).collect(),
            abs_mean2d: own.iter().map(|o| o.abs_mean2d).collect(),
            radius: own.iter().map(|o| o.radius).collect(),
            twist,
        }
    }

    fn of_one(&self, scene: &Gaussians, saved: &Saved, records: &[Record], i: usize, d_sh: &mut [f32]) -> Own {
        let slots = saved.tiles.slots_of(i);
        let surfel = if slots.is_empty() { None } else { self.surfel(scene, i) };
        let Some(surfel) = surfel else { return Own::default() };
        let sum = Sum::of(slots.iter().map(|&slot| &records[slot as usize]));
        let g = SurfelGradient { m: sum.m, centre: sum.centre, normal: sum.normal, depth: sum.depth };
        let frame = surfel.backward(&g, f64::from(self.options.centre_cutoff));

        let (direction, inverse_distance) = sh::direction(scene.means[i], &self.centre);
        let stride = scene.sh_stride();
        let by_direction = sh::colour_backward(
            self.options.sh_degree,
            &scene.sh[i * stride..(i + 1) * stride],
            (&direction, inverse_distance),
            saved.projected[i].splat.colour,
            sum.colour.map(|c| c as f32).into(),
            d_sh,
        )
        .map(f64::from);

        let by_rotation = rotation_backward(scene.rotations[i], &(self.w.transpose() * frame.r));
        let mean = self.w.transpose() * frame.t + by_direction;
        // Moving the camera by ρ moves every point by ρ in the camera frame. Turning it turns discs and points, but not
        // the directions that colours are seen from.
        let rho = self.w * mean;
        let phi = (0..3).fold(surfel.t.cross(&frame.t), |phi, k| phi + surfel.r.column(k).cross(&frame.r.column(k)));
        let opacity = 1.0 / (1.0 + (-f64::from(scene.logit_opacities[i])).exp());
        let last = sum.m.column(2);
        let mean2d: [f64; 2] = std::array::from_fn(|k| sum.centre[k] - surfel.m.column(k).dot(&last));
        Own {
            mean: mean.map(single).into(),
            rotation: by_rotation.map(single),
            log_scale: [single(frame.log_s[0]), single(frame.log_s[1]), 0.0],
            logit_opacity: single(sum.log_opacity * (1.0 - opacity)),
            mean2d: mean2d.map(single),
            abs_mean2d: sum.abs.map(single).into(),
            radius: saved.projected[i].footprint.radius,
            twist: [rho.x, rho.y, rho.z, phi.x, phi.y, phi.z].map(bounded),
        }
    }
}

/// In single precision; what is too large for it becomes its largest number.
fn single(x: f64) -> f32 {
    bounded(x) as f32
}

/// Derivatives by the parameters of one surfel.
#[derive(Debug, Clone, Copy, Default)]
struct Own {
    mean: [f32; 3],
    rotation: [f32; 4],
    log_scale: [f32; 3],
    logit_opacity: f32,
    mean2d: [f32; 2],
    abs_mean2d: [f32; 2],
    radius: f32,
    twist: [f64; 6],
}

/// The records of one surfel together.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    m: Matrix3<f64>,
    centre: Vector2<f64>,
    abs: Vector2<f64>,
    log_opacity: f64,
    colour: Vector3<f64>,
    normal: Vector3<f64>,
    depth: f64,
}

impl Sum {
    fn of<'r>(records: impl Iterator<Item = &'r Record>) -> Self {
        let mut sum = Self::default();
        for r in records {
            sum.m += Matrix3::from_row_slice(&r.m.map(f64::from));
            sum.centre += Vector2::from(r.centre.map(f64::from));
            sum.abs += Vector2::from(r.abs.map(f64::from));
            sum.log_opacity += f64::from(r.log_opacity);
            sum.colour += Vector3::from(r.colour.map(f64::from));
            sum.normal += Vector3::from(r.normal.map(f64::from));
            sum.depth += f64::from(r.depth);
        }
        sum
    }
}
