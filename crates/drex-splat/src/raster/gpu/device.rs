//! One GPU: its adapter, its buffers, and the running of kernels on it. Nothing here knows what a Gaussian is.

use std::future::Future;
use std::pin::pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, Waker};

use wgpu::{Buffer, BufferUsages, ComputePass, ComputePipeline};

use crate::{Error, Result};

/// Threads of a workgroup of the kernels that run over a line of things.
const LINE: u64 = 256;
/// Workgroups in a row of such a dispatch; more go to further rows. Every adapter allows twice as many.
const ROW: u64 = 1 << 15;

/// A GPU that has been opened.
#[derive(Debug, Clone)]
pub(super) struct Device {
    device: wgpu::Device,
    queue: wgpu::Queue,
    name: String,
    /// First thing that went wrong outside the calls that report errors themselves.
    trouble: Arc<Mutex<Option<String>>>,
}

/// Size of a dispatch, workgroups.
pub(super) type Grid = [u32; 3];

/// A grid with one thread for each of `n` things, 256 a workgroup.
pub(super) fn line(n: u64) -> Grid {
    blocks(n.div_ceil(LINE))
}

/// A grid of `n` workgroups.
pub(super) fn blocks(n: u64) -> Grid {
    [n.clamp(1, ROW) as u32, n.div_ceil(ROW).max(1) as u32, 1]
}

impl Device {
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
            remedy: "install a Vulkan driver (Mesa's lavapipe needs no GPU), or draw with the processor".into(),
        })?;
        let description = wgpu::DeviceDescriptor { required_limits: adapter.limits(), ..Default::default() };
        let (device, queue) = wait(adapter.request_device(&description)).map_err(|e| Error::Gpu {
            what: format!("the GPU adapter {} gives no device: {e}", adapter.get_info().name),
            remedy: "update its driver, or draw with the processor".into(),
        })?;
        let trouble = Arc::new(Mutex::new(None));
        let kept = Arc::clone(&trouble);
        device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| {
            kept.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(|| e.to_string());
        }));
        Ok(Self { device, queue, name: adapter.get_info().name, trouble })
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn kernel(&self, module: &wgpu::ShaderModule, entry: &str) -> ComputePipeline {
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry),
            layout: None,
            module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        })
    }

    pub fn module(&self, label: &str, source: &str) -> wgpu::ShaderModule {
        self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(label),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        })
    }

    /// A storage buffer of `words` numbers of 32 bits, all zero.
    pub fn storage(&self, what: &str, words: u64) -> Result<Buffer> {
        let limits = self.device.limits();
        let limit = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let size = 4 * words.max(4);
        if size > limit {
            return Err(Error::Gpu {
                what: format!("{what} take {size} bytes; a buffer of {} holds at most {limit}", self.name),
                remedy: "use fewer Gaussians or a smaller image, or draw with the processor".into(),
            });
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        Ok(self.buffer(what, size, usage))
    }

    /// A uniform buffer with these words.
    pub fn uniform(&self, words: &[u32]) -> Buffer {
        let buffer = self.buffer("uniform", 4 * words.len() as u64, BufferUsages::UNIFORM | BufferUsages::COPY_DST);
        self.write(&buffer, 0, words);
        buffer
    }

    /// Writes numbers at an offset counted in words.
    pub fn write<T: bytemuck::NoUninit>(&self, buffer: &Buffer, offset: u64, data: &[T]) {
        self.queue.write_buffer(buffer, 4 * offset, bytemuck::cast_slice(data));
    }

    /// Records kernels and starts them. Each sees what those before it wrote.
    pub fn submit(&self, record: impl FnOnce(&mut ComputePass<'_>) -> Result<()>) -> Result<()> {
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let recorded = record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()));
        recorded?;
        self.queue.submit([encoder.finish()]);
        self.check()
    }

    /// Runs a kernel with buffers at the given bindings.
    pub fn run(&self, pass: &mut ComputePass<'_>, kernel: &ComputePipeline, buffers: &[(u32, &Buffer)], grid: Grid) {
        let entries: Vec<_> = buffers
            .iter()
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding: *binding, resource: buffer.as_entire_binding() })
            .collect();
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &kernel.get_bind_group_layout(0),
            entries: &entries,
        });
        pass.set_pipeline(kernel);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(grid[0], grid[1], grid[2]);
    }

    /// `count` numbers from the word `offset` on, after all that was submitted.
    pub fn read<T: bytemuck::AnyBitPattern + bytemuck::NoUninit>(
        &self,
        buffer: &Buffer,
        offset: u64,
        count: usize,
    ) -> Result<Vec<T>> {
        let size = (count * size_of::<T>()) as u64;
        if size == 0 {
            return Ok(Vec::new());
        }
        let staging = self.buffer("staging", size, BufferUsages::MAP_READ | BufferUsages::COPY_DST);
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(buffer, 4 * offset, &staging, 0, size);
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
        let mut out = vec![T::zeroed(); count];
        bytemuck::cast_slice_mut(&mut out).copy_from_slice(&mapped);
        Ok(out)
    }

    /// # Errors
    /// If anything went wrong on the GPU since the last call.
    pub fn check(&self) -> Result<()> {
        match self.trouble.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(trouble) => Err(self.failed(trouble)),
            None => Ok(()),
        }
    }

    fn buffer(&self, label: &str, size: u64, usage: BufferUsages) -> Buffer {
        let description = wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
        self.device.create_buffer(&description)
    }

    fn failed(&self, reason: impl std::fmt::Display) -> Error {
        Error::Gpu {
            what: format!("{} failed: {reason}", self.name),
            remedy: "use fewer Gaussians or a smaller image, update the driver, or draw with the processor".into(),
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
