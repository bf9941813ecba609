//! Drawing on a GPU with compute shaders: Vulkan anywhere (Mesa's lavapipe where there is no GPU), Metal on Apple
//! computers. Every sum is made in a fixed order, so the same adapter gives the same bytes again.
//!
//! 1. `project`: one thread a Gaussian gives its footprint in the image and the tiles it touches.
//! 2. Gaussians are sorted by depth, their pairs with tiles are listed in that order and sorted by tile.
//! 3. `draw`: one thread a pixel goes through its tile's list.
//! 4. `draw_back`: one thread a pair goes through the tile's pixels and leaves a record of its sums.
//! 5. `project_back`: one thread a Gaussian adds its records in order and goes back to the parameters.

mod sort;
mod view;

use drex_core::camera::PinholeCamera;
use drex_core::gpu::{Buffer, Device, Grid, Kernel, Module, line};

use self::sort::Sorter;
use super::cpu::{bounded, check_geometry, check_gradients, check_options, check_shape};
use super::{GaussianGradients, Rasterizer, Render, RenderGradients, RenderOptions, TILE};
use crate::{Gaussians, Kind, Result};

/// The backend that draws on a GPU. Opening it compiles the shaders; clones share it.
#[derive(Debug, Clone)]
pub struct Gpu {
    device: Device,
    sorter: Sorter,
    find_ranges: Kernel,
    ellipsoids: Kernels,
    surfels: Kernels,
}

/// What [`Gpu`] keeps from `forward` for `backward`, on the GPU.
#[derive(Debug, Clone)]
pub struct GpuSaved {
    kind: Kind,
    /// Gaussians, image width and height: `backward` has to be given the same.
    shape: [usize; 3],
    view: Buffer,
    parameters: Buffer,
    footprints: Buffer,
    lists: Lists,
    /// What is left of every pixel, and how far it went.
    marks: Buffer,
    ends: Buffer,
}

/// The lists of splats of every tile.
#[derive(Debug, Clone)]
struct Lists {
    /// Gaussians by rank of depth, and where the pairs of a rank start.
    order: Buffer,
    offsets: Buffer,
    /// Number of pairs, and for each in order of tiles: where it stands in order of ranks, and its Gaussian.
    pairs: u64,
    pair_ids: Buffer,
    splats: Buffer,
    /// First and end of every tile.
    ranges: Buffer,
}

/// The kernels of one kind of Gaussian.
#[derive(Debug, Clone)]
struct Kernels {
    project: Kernel,
    count_pairs: Kernel,
    list_pairs: Kernel,
    draw: Kernel,
    draw_back: Kernel,
    project_back: Kernel,
    /// Words of a footprint and of a record.
    footprint: u64,
    record: u64,
}

/// Words a Gaussian has besides its coefficients: mean 3, quaternion 4, logarithms of scales 3, logit 1.
const SHAPE: u64 = 11;
/// Words of what densification and the camera get from a Gaussian: centre 2, absolute values 2, radius 1, twist 6.
const STATISTICS: u64 = 11;
/// Words of a pixel's images: colour 3, alpha, depth; normal 3, median depth, distortion as well; and the count.
const APPEARANCE: u64 = 5;
const IMAGES: u64 = 10;
const IMAGES_AND_COUNT: u64 = IMAGES + 1;

impl Gpu {
    /// Opens the fastest adapter and compiles the shaders.
    ///
    /// # Errors
    /// [`drex_core::Error::Gpu`] if there is no adapter, or it gives no device or refuses a shader.
    pub fn new() -> Result<Self> {
        let device = Device::new()?;
        let ranges = device.module("ranges", include_str!("shaders/ranges.wgsl"));
        let gpu = Self {
            sorter: Sorter::new(&device),
            find_ranges: device.kernel(&ranges, "find_ranges"),
            ellipsoids: Kernels::ellipsoids(&device),
            surfels: Kernels::surfels(&device),
            device,
        };
        gpu.device.check()?;
        Ok(gpu)
    }

    /// Name of the adapter that draws.
    pub fn adapter_name(&self) -> &str {
        self.device.name()
    }

    fn kernels(&self, kind: Kind) -> &Kernels {
        match kind {
            Kind::Ellipsoid => &self.ellipsoids,
            Kind::Surfel => &self.surfels,
        }
    }
}

macro_rules! shader {
    ($device:expr, $($file:literal),+) => {
        $device.module(concat!($($file, " "),+), concat!($(include_str!(concat!("shaders/", $file, ".wgsl"))),+))
    };
}

impl Kernels {
    fn ellipsoids(device: &Device) -> Self {
        let project = shader!(device, "view", "lists", "ellipsoid", "ellipsoid_project");
        let draw = shader!(device, "view", "draw", "ellipsoid_draw");
        let back = shader!(device, "view", "gradients", "ellipsoid", "ellipsoid_back");
        Self::new(device, [&project, &draw, &back], 12, 12)
    }

    fn surfels(device: &Device) -> Self {
        let project = shader!(device, "view", "lists", "surfel", "surfel_project");
        let draw = shader!(device, "view", "draw", "surfel_draw");
        let back = shader!(device, "view", "gradients", "surfel", "surfel_back");
        Self::new(device, [&project, &draw, &back], 28, 21)
    }

    fn new(device: &Device, [project, draw, back]: [&Module; 3], footprint: u64, record: u64) -> Self {
        Self {
            project: device.kernel(project, "project"),
            count_pairs: device.kernel(project, "count_pairs"),
            list_pairs: device.kernel(project, "list_pairs"),
            draw: device.kernel(draw, "draw"),
            draw_back: device.kernel(draw, "draw_back"),
            project_back: device.kernel(back, "project_back"),
            footprint,
            record,
        }
    }
}

impl Rasterizer for Gpu {
    type Saved = GpuSaved;

    fn forward(
        &self,
        scene: &Gaussians,
        camera: &PinholeCamera,
        options: &RenderOptions,
    ) -> Result<(Render, GpuSaved)> {
        scene.check()?;
        camera.check()?;
        check_options(options)?;
        let (device, kernels) = (&self.device, self.kernels(scene.kind));
        let (n, pixels) = (scene.len() as u64, (camera.width * camera.height) as u64);
        let tiles = camera.width.div_ceil(TILE) * camera.height.div_ceil(TILE);

        let view = device.uniform(&view::words(scene, camera, options));
        let parameters = self.upload(scene)?;
        let footprints = device.storage("footprints of Gaussians", kernels.footprint * n)?;
        let lists = self.lists(kernels, n, tiles as u64, (&view, &parameters, &footprints))?;
        let images = device.storage("images", IMAGES_AND_COUNT * pixels)?;
        let marks = device.storage("states of pixels", 4 * pixels)?;
        let ends = device.storage("ends of pixels", 2 * pixels)?;
        device.submit(|pass| {
            let buffers = [
                (0, &view),
                (2, &footprints),
                (3, &lists.ranges),
                (4, &lists.splats),
                (5, &images),
                (6, &marks),
                (7, &ends),
            ];
            device.run(pass, &kernels.draw, &buffers, tile_grid(camera.width, camera.height));
            Ok(())
        })?;
        let surface = scene.kind == Kind::Surfel && options.geometry;
        let render = self.download(&images, camera, surface, options.count)?;
        let shape = [scene.len(), camera.width, camera.height];
        Ok((render, GpuSaved { kind: scene.kind, shape, view, parameters, footprints, lists, marks, ends }))
    }

    fn backward(
        &self,
        scene: &Gaussians,
        camera: &PinholeCamera,
        options: &RenderOptions,
        render: &Render,
        saved: &GpuSaved,
        gradients: &RenderGradients,
    ) -> Result<GaussianGradients> {
        check_shape(saved.shape, [scene.len(), camera.width, camera.height])?;
        check_shape(saved.shape, [scene.len(), render.width, render.height])?;
        check_gradients(render, gradients)?;
        if saved.kind == Kind::Surfel {
            check_geometry(options, gradients)?;
        }
        let (device, kernels) = (&self.device, self.kernels(saved.kind));
        let n = scene.len() as u64;
        let by_images = self.upload_gradients(gradients, (camera.width * camera.height) as u64)?;
        let records = device.storage("records of pairs", kernels.record * saved.lists.pairs)?;
        let by_parameters = device.storage("gradients", (SHAPE + scene.sh_stride() as u64 + STATISTICS) * n)?;
        let lists = &saved.lists;
        device.submit(|pass| {
            let buffers = [
                (0, &saved.view),
                (2, &saved.footprints),
                (3, &lists.ranges),
                (4, &lists.splats),
                (8, &saved.marks),
                (9, &saved.ends),
                (10, &lists.pair_ids),
                (11, &by_images),
                (12, &records),
            ];
            device.run(pass, &kernels.draw_back, &buffers, tile_grid(camera.width, camera.height));
            let buffers = [
                (0, &saved.view),
                (1, &saved.parameters),
                (2, &lists.order),
                (3, &lists.offsets),
                (4, &records),
                (5, &by_parameters),
            ];
            device.run(pass, &kernels.project_back, &buffers, line(n));
            Ok(())
        })?;
        self.download_gradients(&by_parameters, scene)
    }
}

fn tile_grid(width: usize, height: usize) -> Grid {
    [width.div_ceil(TILE) as u32, height.div_ceil(TILE) as u32, 1]
}

impl Gpu {
    fn upload(&self, scene: &Gaussians) -> Result<Buffer> {
        let n = scene.len() as u64;
        let parameters = self.device.storage("parameters of Gaussians", (SHAPE + scene.sh_stride() as u64) * n)?;
        self.device.write(&parameters, 0, &scene.means);
        self.device.write(&parameters, 3 * n, &scene.rotations);
        self.device.write(&parameters, 7 * n, &scene.log_scales);
        self.device.write(&parameters, 10 * n, &scene.logit_opacities);
        self.device.write(&parameters, SHAPE * n, &scene.sh);
        Ok(parameters)
    }

    /// Projects the Gaussians and lists them by tile.
    fn lists(
        &self,
        kernels: &Kernels,
        n: u64,
        tiles: u64,
        (view, parameters, footprints): (&Buffer, &Buffer, &Buffer),
    ) -> Result<Lists> {
        let device = &self.device;
        let boxes = device.storage("boxes of Gaussians", 2 * n)?;
        let touched = device.storage("counts of tiles", n)?;
        let depth_keys = device.storage("depths", n)?;
        let order = device.storage("order of Gaussians", n)?;
        let offsets = device.storage("offsets of pairs", n + 1)?;
        device.submit(|pass| {
            let buffers = [
                (0, view),
                (1, parameters),
                (2, footprints),
                (3, &boxes),
                (4, &touched),
                (5, &depth_keys),
                (6, &order),
            ];
            device.run(pass, &kernels.project, &buffers, line(n));
            self.sorter.sort(device, pass, (&depth_keys, &order), n, u32::BITS)?;
            let buffers = [(0, view), (4, &touched), (6, &order), (7, &offsets)];
            device.run(pass, &kernels.count_pairs, &buffers, line(n + 1));
            self.sorter.scan(device, pass, &offsets, n + 1)
        })?;
        let pairs = u64::from(device.read::<u32>(&offsets, n, 1)?[0]);

        let pair_tiles = device.storage("tiles of pairs", pairs)?;
        let pair_ids = device.storage("numbers of pairs", pairs)?;
        let owners = device.storage("Gaussians of pairs", pairs)?;
        let splats = device.storage("lists of tiles", pairs)?;
        let ranges = device.storage("ranges of tiles", 2 * tiles)?;
        let sizes = device.uniform(&[pairs as u32, tiles as u32, 0, 0]);
        device.submit(|pass| {
            let buffers = [
                (0, view),
                (2, footprints),
                (3, &boxes),
                (6, &order),
                (7, &offsets),
                (8, &pair_tiles),
                (9, &pair_ids),
                (10, &owners),
            ];
            device.run(pass, &kernels.list_pairs, &buffers, line(n));
            // A pair of no tile has the number after the last tile.
            let bits = u64::BITS - tiles.leading_zeros();
            self.sorter.sort(device, pass, (&pair_tiles, &pair_ids), pairs, bits)?;
            let buffers = [(0, &sizes), (1, &pair_tiles), (2, &pair_ids), (3, &owners), (4, &ranges), (5, &splats)];
            device.run(pass, &self.find_ranges, &buffers, line(pairs));
            Ok(())
        })?;
        Ok(Lists { order, offsets, pairs, pair_ids, splats, ranges })
    }

    /// All images in one transfer: waiting for the GPU costs more than the bytes.
    fn download(&self, images: &Buffer, camera: &PinholeCamera, surface: bool, count: bool) -> Result<Render> {
        let pixels = camera.width * camera.height;
        let sections = if surface || count { IMAGES_AND_COUNT } else { APPEARANCE };
        let all: Vec<f32> = self.device.read(images, 0, sections as usize * pixels)?;
        let mut rest = all.as_slice();
        let [rgb, alpha, depth, normal, median_depth, distortion, counts] =
            [3, 1, 1, 3, 1, 1, 1].map(|words| split(&mut rest, words * pixels));
        let surface = |image: &[f32]| if surface { image.to_vec() } else { Vec::new() };
        Ok(Render {
            width: camera.width,
            height: camera.height,
            rgb: rgb.as_chunks().0.to_vec(),
            alpha: alpha.to_vec(),
            depth: depth.to_vec(),
            normal: surface(normal).as_chunks().0.to_vec(),
            median_depth: surface(median_depth),
            distortion: surface(distortion),
            count: if count { counts.iter().map(|c| *c as u32).collect() } else { Vec::new() },
        })
    }

    fn upload_gradients(&self, gradients: &RenderGradients, pixels: u64) -> Result<Buffer> {
        let by_images = self.device.storage("gradients of images", IMAGES * pixels)?;
        self.device.write(&by_images, 0, &gradients.rgb);
        self.device.write(&by_images, 3 * pixels, &gradients.alpha);
        self.device.write(&by_images, 4 * pixels, &gradients.depth);
        self.device.write(&by_images, 5 * pixels, &gradients.normal);
        self.device.write(&by_images, 8 * pixels, &gradients.median_depth);
        self.device.write(&by_images, 9 * pixels, &gradients.distortion);
        Ok(by_images)
    }

    fn download_gradients(&self, gradients: &Buffer, scene: &Gaussians) -> Result<GaussianGradients> {
        let (n, stride) = (scene.len(), scene.sh_stride());
        let all: Vec<f32> = self.device.read(gradients, 0, n * ((SHAPE + STATISTICS) as usize + stride))?;
        let mut rest = all.as_slice();
        let [means, rotations, log_scales, logit_opacities, sh, mean2d, abs_mean2d, radius, motions] =
            [3, 4, 3, 1, stride, 2, 2, 1, 6].map(|words| split(&mut rest, words * n));
        let mut twist = [0.0; 6];
        for motion in motions.as_chunks::<6>().0 {
            for k in 0..6 {
                twist[k] += bounded(f64::from(motion[k]));
            }
        }
        Ok(GaussianGradients {
            means: means.as_chunks().0.to_vec(),
            rotations: rotations.as_chunks().0.to_vec(),
            log_scales: log_scales.as_chunks().0.to_vec(),
            logit_opacities: logit_opacities.to_vec(),
            sh: sh.to_vec(),
            mean2d: mean2d.as_chunks().0.to_vec(),
            abs_mean2d: abs_mean2d.as_chunks().0.to_vec(),
            radius: radius.to_vec(),
            twist,
        })
    }
}

/// The next `count` numbers, or as many as there are.
fn split<'a>(rest: &mut &'a [f32], count: usize) -> &'a [f32] {
    let (first, others) = rest.split_at(count.min(rest.len()));
    *rest = others;
    first
}
