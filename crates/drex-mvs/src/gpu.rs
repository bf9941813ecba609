//! PatchMatch on a GPU: the buffers that `patchmatch.wgsl` reads, filled for one photo at a time.

use drex_core::Result;
use drex_core::gpu::{Buffer, Device, Kernel};
use rayon::prelude::*;

use crate::kernel::{LEAST_VARIANCE, Plane, Source, WORST, Window};
use crate::patchmatch::{
    COUNTED, EARLY_STOP_COST, Field, INDEPENDENT, LEAST_COSINE, LEAST_COST, MOST_PX, MOST_SOURCES, Matcher, PER_PIXEL,
    Pass, Peer, Scale, TWIN_PX,
};
use crate::picture::Area;

/// Stands for infinity, which shaders need not know.
const NEVER: f32 = 1e30;
/// Mark of a pixel that is searched, beside its grey.
const INSIDE: u32 = 256;
/// Sides of a workgroup.
const SIDE: usize = 16;
/// Words of the shader's `View`.
const VIEW: usize = 32;

/// A GPU with the kernels for one window.
pub(crate) struct Gpu {
    device: Device,
    improve: Kernel,
    deviate: Kernel,
    window: Buffer,
}

/// A photo on the GPU.
struct Loaded {
    size: [usize; 2],
    /// What `View` says of it.
    view: Vec<u32>,
    /// Those bound to 1, 2 and so on.
    buffers: Vec<Buffer>,
    field: Buffer,
}

impl Gpu {
    /// Opens the fastest adapter and compiles the kernels.
    ///
    /// # Errors
    /// If there is no adapter, or it refuses a kernel.
    pub fn new<const G: usize>(window: &Window<G>) -> Result<Self> {
        let device = Device::new()?;
        let source = constants(window.radius) + include_str!("patchmatch.wgsl");
        let module = device.module("patchmatch", &source);
        let [improve, deviate] = ["improve", "deviate"].map(|entry| device.kernel(&module, entry));
        let window = device.upload("weights of a window", &window.weights())?;
        device.check()?;
        Ok(Self { device, improve, deviate, window })
    }

    /// As [`Matcher::pass`], one after the other.
    ///
    /// # Errors
    /// If the GPU fails, or has no room for the photo and those that it is compared with.
    pub fn passes<const G: usize>(&self, matcher: &Matcher<'_, G>, field: &mut Field, passes: &[Pass]) -> Result<()> {
        let photo = self.load(matcher, field)?;
        let [width, height] = photo.size;
        for (pass, colour) in passes.iter().flat_map(|pass| [(pass, 0), (pass, 1)]) {
            let [far, restart, last] = [pass.far, pass.restart, pass.last].map(u32::from);
            let of_pass = [colour, pass.number as u32, far, restart, last, pass.step_px.to_bits()];
            self.run(&self.improve, &photo, &of_pass, [width.div_ceil(2), height])?;
        }
        let found: Vec<[f32; 4]> = self.device.read(&photo.field, 0, field.costs.len())?;
        for (at, [w, a, b, cost]) in found.into_iter().enumerate() {
            (field.planes[at], field.costs[at]) = (Plane { w, a, b }, known(cost));
        }
        Ok(())
    }

    /// As [`Matcher::deviations`].
    ///
    /// # Errors
    /// As [`Gpu::passes`].
    pub fn deviations<const G: usize>(&self, matcher: &Matcher<'_, G>, field: &Field) -> Result<Vec<f32>> {
        let mut photo = self.load(matcher, field)?;
        let deviations = self.device.storage("deviations", field.costs.len() as u64)?;
        photo.buffers.push(deviations.clone());
        self.run(&self.deviate, &photo, &[], photo.size)?;
        Ok(self.device.read(&deviations, 0, field.costs.len())?.into_iter().map(known).collect())
    }

    fn run(&self, kernel: &Kernel, photo: &Loaded, of_pass: &[u32], threads: [usize; 2]) -> Result<()> {
        let mut view = photo.view.clone();
        view.extend(of_pass);
        view.resize(VIEW, 0);
        let view = self.device.uniform(&view);
        let bound: Vec<(u32, &Buffer)> = (0..).zip([&view].into_iter().chain(&photo.buffers)).collect();
        let [x, y] = threads.map(|n| n.div_ceil(SIDE) as u32);
        self.device.submit(|pass| {
            self.device.run(pass, kernel, &bound, [x, y, 1]);
            Ok(())
        })
    }

    fn load<const G: usize>(&self, matcher: &Matcher<'_, G>, field: &Field) -> Result<Loaded> {
        let Area { width, height, inside } = matcher.searched;
        let mut view = vec![*width as u32, *height as u32, matcher.seed as u32, (matcher.seed >> 32) as u32];
        view.extend([matcher.focal, matcher.centre].as_flattened().iter().map(|v| v.to_bits()));
        let device = &self.device;
        let (mut greys, mut quads, mut planes, mut others) = (Vec::new(), Vec::<u32>::new(), Vec::new(), Vec::new());
        for Scale { picture, searched, least_variance, sources, .. } in &matcher.scales {
            view.extend([picture.width as u32, picture.height as u32, greys.len() as u32, least_variance.to_bits()]);
            let marked = picture.values.iter().zip(&searched.inside);
            greys.extend(marked.map(|(grey, inside)| u32::from(*grey) + INSIDE * u32::from(*inside)));
            for (Source { quads: its, turn, shift }, weight) in sources.iter().zip(&matcher.weights) {
                others.extend(other(turn, *shift, *weight, its.limit, [quads.len(), its.stride as usize]));
                quads.extend(&its.values);
            }
        }
        view.resize(16, 0);
        for Peer { field, turn, shift } in &matcher.peers {
            let limit = [field.width as f32, field.height as f32];
            others.extend(other(turn, *shift, 0.0, limit, [planes.len(), field.width]));
            planes.extend(pixels(field));
        }
        let noise = |k: usize| matcher.scales.get(k).map_or(0.0, |scale| scale.noise_variance);
        view.extend([noise(0), noise(1), matcher.disparity].map(f32::to_bits));
        let counts = [matcher.scales.len(), matcher.sources(), matcher.peers.len(), usize::from(matcher.masked)];
        view.extend(counts.map(|n| n as u32));
        let limits = inside.par_iter().enumerate().map(|(i, inside)| match inside {
            true => matcher.limits.inverse_depths(matcher.halvings, i % width, i / width),
            false => [0.0; 2],
        });
        let field = device.upload("planes", &pixels(field))?;
        let buffers = vec![
            self.window.clone(),
            device.upload("pixels", &greys)?,
            device.upload("limits of depth", &limits.collect::<Vec<_>>())?,
            device.upload("matrices of other photos", &others)?,
            device.upload("pixels of other photos", &quads)?,
            device.upload("planes of other photos", &planes)?,
            field.clone(),
        ];
        Ok(Loaded { size: [*width, *height], view, buffers, field })
    }
}

/// The constants that the shader shares with the processor's code.
fn constants(radius: i32) -> String {
    let whole = [("COUNTED", COUNTED), ("MOST_SOURCES", MOST_SOURCES), ("WORKGROUP", SIDE)];
    let real = [
        ("EARLY_STOP_COST", EARLY_STOP_COST),
        ("INDEPENDENT", INDEPENDENT),
        ("LEAST_COSINE", LEAST_COSINE),
        ("LEAST_COST", LEAST_COST),
        ("LEAST_VARIANCE", LEAST_VARIANCE),
        ("MOST_PX", MOST_PX),
        ("NEVER", NEVER),
        ("PER_PIXEL", PER_PIXEL),
        ("TWIN_PX", TWIN_PX),
        ("WORST", WORST),
    ];
    let whole = whole.map(|(name, value)| format!("const {name} = {value}u;\n")).concat();
    let real = real.map(|(name, value)| format!("const {name} = {value:e};\n")).concat();
    format!("const RADIUS = {radius};\nconst INSIDE = {INSIDE}u;\n{whole}{real}")
}

/// Planes and costs as the shader reads them.
fn pixels(field: &Field) -> Vec<[f32; 4]> {
    field.planes.iter().zip(&field.costs).map(|(p, cost)| [p.w, p.a, p.b, cost.min(NEVER)]).collect()
}

fn known(value: f32) -> f32 {
    if value < NEVER { value } else { f32::INFINITY }
}

/// Words of the shader's `Other`, of which columns of a matrix take four.
fn other(
    turn: &[[f32; 3]; 3],
    shift: [f32; 3],
    weight: f32,
    limit: [f32; 2],
    place: [usize; 2],
) -> impl Iterator<Item = u32> {
    let [a, b, c] = turn.map(|[x, y, z]| [x, y, z, 0.0]);
    let numbers = [a, b, c, [shift[0], shift[1], shift[2], weight]].concat().into_iter().chain(limit);
    numbers.map(f32::to_bits).chain(place.map(|v| v as u32))
}
