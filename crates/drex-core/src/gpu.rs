//! One GPU: its adapter, its buffers, and the running of WGSL kernels on it, over Vulkan or Metal (Mesa's lavapipe where there is no GPU).

use std::future::Future;
use std::pin::pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, Waker};

use wgpu::BufferUsages;

use crate::{Error, Result};

/// Threads of a workgroup of the kernels that run over a line of things.
const LINE: u64 = 256;
/// Workgroups in a row of such a dispatch; more go to further rows. Every adapter allows twice as many.
const ROW: u64 = 1 << 15;

/// A GPU that has been opened.
#[derive(Debug, Clone)]
pub struct Device {
    device: wgpu::Device,
    queue: wgpu::Queue,
    name: String,
    /// First thing that went wrong outside the calls that report errors themselves.
    trouble: Arc<Mutex<Option<String>>>,
}

/// Numbers in the memory of a GPU; clones share them.
#[derive(Debug, Clone)]
pub struct Buffer(wgpu::Buffer);

/// A WGSL source that has been read.
#[derive(Debug, Clone)]
pub struct Module(wgpu::ShaderModule);

/// An entry point of a [`Module`], compiled; clones share it.
#[derive(Debug, Clone)]
pub struct Kernel(wgpu::ComputePipeline);

/// Kernels that are being recorded, see [`Device::submit`].
#[derive(Debug)]
pub struct Pass<'a>(wgpu::ComputePass<'a>);

/// What a buffer holds: `u32`, `f32`, and arrays of two to four `f32`.
pub trait Word: sealed::Plain {}

impl<T: sealed::Plain> Word for T {}

mod sealed {
    pub trait Plain: bytemuck::Pod {}
    impl Plain for u32 {}
    impl Plain for f32 {}
    impl Plain for [f32; 2] {}
    impl Plain for [f32; 3] {}
    impl Plain for [f32; 4] {}
}

/// Size of a dispatch, workgroups.
pub type Grid = [u32; 3];

/// A grid with one thread for each of `n` things, 256 a workgroup.
pub fn line(n: u64) -> Grid {
    blocks(n.div_ceil(LINE))
}

/// A grid of `n` workgroups.
pub fn blocks(n: u64) -> Grid {
    [n.clamp(1, ROW) as u32, n.div_ceil(ROW).max(1) as u32, 1]
}

impl Device {
    /// Opens the fastest adapter.
    ///
    /// # Errors
    /// [`Error::Gpu`] if there is none, or it gives no device.
    pub fn new() -> Result<Self> {
        let mut description = wgpu::InstanceDescriptor::new_without_display_handle();
        description.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL;
        let instance = wgpu::Instance::new(description);
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..Default::default()
        };
        let adapter = wait(instance.request_adapter(&options)).map_err(|e| Error::Gpu {
            what: format!("no GPU adapter: {e}"),
            remedy: "install a Vulkan driver (Mesa's lavapipe needs no GPU), or use the processor".into(),
        })?;
        let description = wgpu::DeviceDescriptor { required_limits: adapter.limits(), ..Default::default() };
        let (device, queue) = wait(adapter.request_device(&description)).map_err(|e| Error::Gpu {
            what: format!("the GPU adapter {} gives no device: {e}", adapter.get_info().name),
            remedy: "update its driver, or use the processor".into(),
        })?;
        let trouble = Arc::new(Mutex::new(None));
        let kept = Arc::clone(&trouble);
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| {
            kept.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(|| e.to_string());
        }));
        Ok(Self { device, queue, name: adapter.get_info().name, trouble })
    }

    /// Name of the adapter.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Compiles an entry point; what is wrong with it, [`Device::check`] says.
    pub fn kernel(&self, module: &Module, entry: &str) -> Kernel {
        Kernel(self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry),
            layout: None,
            module: &module.0,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        }))
    }

    /// Reads a WGSL source; what is wrong with it, [`Device::check`] says.
    pub fn module(&self, label: &str, source: &str) -> Module {
        Module(self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(label),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        }))
    }

    /// A storage buffer of `words` numbers of 32 bits, all zero; `what` is in it, in the plural.
    ///
    /// # Errors
    /// [`Error::Gpu`] if the adapter has no buffers of that size.
    pub fn storage(&self, what: &str, words: u64) -> Result<Buffer> {
        let limits = self.device.limits();
        let limit = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let size = 4 * words.max(4);
        if size > limit {
            return Err(Error::Gpu {
                what: format!("{what} take {size} bytes; a buffer of {} holds at most {limit}", self.name),
                remedy: "use smaller pictures or fewer Gaussians, or use the processor".into(),
            });
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        Ok(self.buffer(what, size, usage))
    }

    /// A storage buffer with these numbers, see [`Device::storage`].
    ///
    /// # Errors
    /// As [`Device::storage`].
    pub fn upload<T: Word>(&self, what: &str, data: &[T]) -> Result<Buffer> {
        let buffer = self.storage(what, (size_of_val(data) / 4) as u64)?;
        self.write(&buffer, 0, data);
        Ok(buffer)
    }

    /// A uniform buffer with these words.
    pub fn uniform(&self, words: &[u32]) -> Buffer {
        let buffer = self.buffer("uniform", 4 * words.len() as u64, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        self.write(&buffer, 0, words);
        buffer
    }

    /// Writes numbers at an offset counted in words.
    pub fn write<T: Word>(&self, buffer: &Buffer, offset: u64, data: &[T]) {
        self.queue.write_buffer(&buffer.0, 4 * offset, bytemuck::cast_slice(data));
    }

    /// Records kernels and starts them. Each sees what those before it wrote.
    ///
    /// # Errors
    /// What `record` fails with; [`Error::Gpu`] if anything went wrong on the GPU.
    pub fn submit(&self, record: impl FnOnce(&mut Pass<'_>) -> Result<()>) -> Result<()> {
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let recorded = record(&mut Pass(encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default())));
        recorded?;
        self.queue.submit([encoder.finish()]);
        self.check()
    }

    /// Runs a kernel with buffers at the given bindings.
    pub fn run(&self, pass: &mut Pass<'_>, kernel: &Kernel, buffers: &[(u32, &Buffer)], grid: Grid) {
        let entries: Vec<_> = buffers
            .iter()
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding: *binding, resource: buffer.0.as_entire_binding() })
            .collect();
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &kernel.0.get_bind_group_layout(0),
            entries: &entries,
        });
        pass.0.set_pipeline(&kernel.0);
        pass.0.set_bind_group(0, &group, &[]);
        pass.0.dispatch_workgroups(grid[0], grid[1], grid[2]);
    }

    /// `count` numbers from the word `offset` on, after all that was submitted.
    ///
    /// # Errors
    /// [`Error::Gpu`] if anything went wrong on the GPU.
    pub fn read<T: Word>(&self, buffer: &Buffer, offset: u64, count: usize) -> Result<Vec<T>> {
        let size = (count * size_of::<T>()) as u64;
        if size == 0 {
            return Ok(Vec::new());
        }
        let Buffer(staging) = self.buffer("staging", size, BufferUsages::MAP_READ | BufferUsages::COPY_DST);
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&buffer.0, 4 * offset, &staging, 0, size);
        self.queue.submit([encoder.finish()]);
        let (sender, receiver) = std::sync::mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, .., move |mapped| {
            // The receiver is gone only where the error below has been returned.
            let _ = sender.send(mapped);
        });
        let polled = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        polled.map_err(|e| self.failed(e))?;
        receiver.recv().map_err(|e| self.failed(e))?.map_err(|e| self.failed(e))?;
        let mapped = staging.get_mapped_range(..).map_err(|e| self.failed(e))?;
        let mut out = vec![bytemuck::Zeroable::zeroed(); count];
        bytemuck::cast_slice_mut(&mut out).copy_from_slice(&mapped);
        Ok(out)
    }

    /// Whether all went well so far.
    ///
    /// # Errors
    /// [`Error::Gpu`] if anything went wrong on the GPU since the last call.
    pub fn check(&self) -> Result<()> {
        match self.trouble.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(trouble) => Err(self.failed(trouble)),
            None => Ok(()),
        }
    }

    fn buffer(&self, label: &str, size: u64, usage: BufferUsages) -> Buffer {
        let description = wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
        Buffer(self.device.create_buffer(&description))
    }

    fn failed(&self, reason: impl std::fmt::Display) -> Error {
        Error::Gpu {
            what: format!("{} failed: {reason}", self.name),
            remedy: "use smaller pictures or fewer Gaussians, update the driver, or use the processor".into(),
        }
    }
}

/// The value of a future. Those of wgpu are ready at once on native platforms.
fn wait<F: Future>(future: F) -> F::Output {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
        std::thread::yield_now();
    }
}
