//! The adapter and the device. Device faults become typed errors.

use presight_model::error::{Error, ErrorKind, Result};
use presight_render::plan::{Raster, Work};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// An adapter that an engine can use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Adapter {
    /// Name reported by the driver.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// `vulkan`, `metal`, `dx12`.
    pub api: String,
    /// A real GPU, not a software implementation such as lavapipe.
    pub hardware: bool,
}

/// Capabilities of an engine's device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Abilities {
    /// The nearest surface and its id fit one 64-bit atomic maximum; otherwise two 32-bit passes are needed.
    pub int64_atomics: bool,
    /// The device measures stage times.
    pub timestamps: bool,
    /// The hardware rasterizer can write the buffers that the compute stages write.
    pub render: bool,
    /// Maximum size of a bound buffer, bytes.
    pub largest_binding: u64,
}

impl std::fmt::Display for Adapter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({}, {})", self.name, self.driver, self.api)
    }
}

/// How to choose and use an adapter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceOptions {
    /// Accept real GPUs only.
    pub hardware_only: bool,
    /// Use this index into [`adapters`] instead of the most capable adapter.
    pub adapter: Option<usize>,
    /// Do not use 64-bit atomics, even if available: draw in two passes of 32 bits.
    pub without_int64: bool,
    /// The requested rasterizer; [`super::GpuEngine::raster`] returns the one in use, which depends on the adapter.
    pub raster: Raster,
}

/// Everything an engine allocated on its device since it was opened. In steady state the counts stay constant: only a
/// frame that needs more room, or a new kind of sensor, outputs or shaders, allocates.
///
/// Not counted: objects that wgpu creates for each submission (command buffer, resource tracking, mapping closures).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceAllocations {
    /// Buffers, and timestamp query sets.
    pub buffers: u64,
    /// Their size in bytes.
    pub bytes: u64,
    /// Bind groups.
    pub bind_groups: u64,
    /// Compute pipelines.
    pub pipelines: u64,
    /// Uploads for which wgpu allocates its own staging buffer.
    pub staged: u64,
}

/// Counter that is incremented through a shared reference.
#[derive(Default)]
pub(super) struct Counter(AtomicU64);

impl Counter {
    pub fn add(&self) {
        self.add_many(1);
    }

    pub fn add_many(&self, n: u64) {
        self.0.fetch_add(n, Ordering::Relaxed);
    }

    fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Running counts behind [`DeviceAllocations`].
#[derive(Default)]
pub(super) struct AllocationCounters {
    pub buffers: Counter,
    pub bytes: Counter,
    pub bind_groups: Counter,
    pub pipelines: Counter,
    pub staged: Counter,
}

impl AllocationCounters {
    pub fn so_far(&self) -> DeviceAllocations {
        DeviceAllocations {
            buffers: self.buffers.get(),
            bytes: self.bytes.get(),
            bind_groups: self.bind_groups.get(),
            pipelines: self.pipelines.get(),
            staged: self.staged.get(),
        }
    }
}

/// Running counts of the work submitted to the device.
#[derive(Default)]
pub(super) struct WorkCounters {
    pub passes: Counter,
    pub workgroups: Counter,
    pub bytes_written: Counter,
    pub bytes_read: Counter,
}

/// A device with its queue and capabilities.
pub(super) struct Gpu {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub adapter: Adapter,
    /// Nearest surface and id fit one 64-bit atomic maximum.
    pub int64: bool,
    /// Stage times can be measured.
    pub timestamps: bool,
    /// The hardware rasterizer is supported.
    pub can_render: bool,
    /// The rasterizer in use: as requested if supported.
    pub raster: Raster,
    pub made: AllocationCounters,
    pub done: WorkCounters,
    fault: Arc<Mutex<Option<(ErrorKind, String)>>>,
}

impl Gpu {
    pub fn open(options: DeviceOptions, largest_binding: Option<u64>) -> Result<Self> {
        let adapter = choose(options)?;
        let described = describe(&adapter);
        let has = adapter.features();
        let int64 = wgpu::Features::SHADER_INT64 | wgpu::Features::SHADER_INT64_ATOMIC_MIN_MAX;
        let mut features = wgpu::Features::empty();
        if has.contains(int64) && !options.without_int64 {
            features |= int64;
        }
        features |= has & wgpu::Features::TIMESTAMP_QUERY;
        let theirs = adapter.limits();
        let can_render = adapter.get_downlevel_capabilities().flags.contains(
            wgpu::DownlevelFlags::FRAGMENT_WRITABLE_STORAGE
                | wgpu::DownlevelFlags::VERTEX_STORAGE
                | wgpu::DownlevelFlags::INDIRECT_EXECUTION,
        );
        let raster = if can_render { options.raster } else { Raster::Compute };
        let textures = wgpu::Limits::downlevel_defaults().max_texture_dimension_2d;
        let required_limits = wgpu::Limits {
            max_texture_dimension_2d: if raster == Raster::Render { theirs.max_texture_dimension_2d } else { textures },
            // All other limits stay at the WebGPU defaults, which every device supports.
            max_storage_buffer_binding_size: theirs
                .max_storage_buffer_binding_size
                .min(largest_binding.unwrap_or(u64::MAX)),
            max_buffer_size: theirs.max_buffer_size,
            ..wgpu::Limits::downlevel_defaults()
        };
        let required_limits = wgpu::Limits {
            max_storage_buffers_per_shader_stage: 8,
            max_uniform_buffer_binding_size: 1 << 16,
            ..required_limits
        };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("presight"),
            required_features: features,
            required_limits,
            memory_hints: wgpu::MemoryHints::Performance,
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).map_err(|e| {
            Error::new(ErrorKind::NoDevice, format!("{described} cannot open a device: {e}"), "use `Backend::Cpu`")
        })?;
        let fault = Arc::new(Mutex::new(None));
        watch(&device, &fault);
        Ok(Self {
            device,
            queue,
            adapter: described,
            int64: features.contains(int64),
            timestamps: features.contains(wgpu::Features::TIMESTAMP_QUERY),
            can_render,
            raster,
            made: AllocationCounters::default(),
            done: WorkCounters::default(),
            fault,
        })
    }

    /// Work done and memory allocated so far.
    pub fn work(&self) -> Work {
        Work {
            gpu_passes: self.done.passes.get(),
            gpu_workgroups: self.done.workgroups.get(),
            gpu_bytes_made: self.made.bytes.get(),
            gpu_bytes_written: self.done.bytes_written.get(),
            gpu_bytes_read: self.done.bytes_read.get(),
            image_bytes: 0,
        }
    }

    /// Begins a compute pass.
    pub fn pass<'e>(
        &self,
        encoder: &'e mut wgpu::CommandEncoder,
        descriptor: &wgpu::ComputePassDescriptor<'_>,
    ) -> wgpu::ComputePass<'e> {
        self.done.passes.add();
        encoder.begin_compute_pass(descriptor)
    }

    /// Dispatches `x` times `y` workgroups.
    pub fn dispatch(&self, pass: &mut wgpu::ComputePass<'_>, [x, y]: [u32; 2]) {
        self.done.workgroups.add_many(u64::from(x) * u64::from(y));
        pass.dispatch_workgroups(x, y, 1);
    }

    /// Uploads data that stays the same from frame to frame.
    pub fn write(&self, buffer: &wgpu::Buffer, at: u64, bytes: &[u8]) {
        self.made.staged.add();
        self.done.bytes_written.add_many(bytes.len() as u64);
        self.queue.write_buffer(buffer, at, bytes);
    }

    /// Returns the first fault that the device reported, if any.
    pub fn check(&self) -> Result<()> {
        let fault = self.fault.lock().unwrap_or_else(PoisonError::into_inner).clone();
        fault.map_or(Ok(()), |(kind, what)| Err(self.error(kind, &what)))
    }

    /// Makes an error that names this device.
    pub fn error(&self, kind: ErrorKind, what: &str) -> Error {
        let remedy = match kind {
            ErrorKind::DeviceMemory => "use a smaller image or model, or `Backend::Cpu`",
            ErrorKind::DeviceLost => "build the engine again, or use `Backend::Cpu`",
            _ => "please report this",
        };
        Error::new(kind, format!("{}: {what}", self.adapter), remedy)
    }

    /// Blocks until everything submitted is done.
    pub fn wait(&self) -> Result<()> {
        let polled = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        polled.map(|_| ()).map_err(|e| self.error(ErrorKind::DeviceLost, &e.to_string()))
    }
}

/// Every adapter on this machine, in the driver's order.
pub fn adapters() -> Vec<Adapter> {
    all().iter().map(describe).collect()
}

/// Index into [`adapters`] of the most capable one, among all or among real GPUs. Opening it may still fail.
pub fn preferred(hardware_only: bool) -> Option<usize> {
    place(&all(), DeviceOptions { hardware_only, ..DeviceOptions::default() })
}

fn all() -> Vec<wgpu::Adapter> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    // Indirect dispatch counts are clamped where shaders write them; wgpu's own check would cost a dispatch each.
    descriptor.flags = descriptor.flags.with_env() - wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL;
    let backends = descriptor.backends;
    let instance = wgpu::Instance::new(descriptor);
    pollster::block_on(instance.enumerate_adapters(backends))
}

fn describe(adapter: &wgpu::Adapter) -> Adapter {
    let info = adapter.get_info();
    Adapter {
        name: info.name,
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        api: info.backend.to_string(),
        hardware: info.device_type != wgpu::DeviceType::Cpu,
    }
}

/// Index of the most capable adapter: discrete before integrated before virtual before software.
fn place(all: &[wgpu::Adapter], options: DeviceOptions) -> Option<usize> {
    let rank = |a: &wgpu::Adapter| match a.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    };
    let able = |a: &wgpu::Adapter| {
        let limits = a.limits();
        limits.max_storage_buffers_per_shader_stage >= 8 && limits.max_uniform_buffer_binding_size >= 1 << 16
    };
    let wanted = |i: usize| options.adapter.is_none_or(|wanted| i == wanted);
    let found = all.iter().enumerate().filter(|(i, a)| wanted(*i) && able(a));
    let found = found.filter(|(_, a)| !options.hardware_only || rank(a) < 4);
    found.min_by_key(|(_, a)| rank(a)).map(|(i, _)| i)
}

fn choose(options: DeviceOptions) -> Result<wgpu::Adapter> {
    let DeviceOptions { hardware_only, adapter, .. } = options;
    let mut all = all();
    place(&all, options).map(|i| all.swap_remove(i)).ok_or_else(|| {
        if let Some(wanted) = adapter {
            let what = format!("adapter {wanted} does not exist, or can bind too few buffers");
            return Error::new(ErrorKind::NoDevice, what, "choose another adapter, or use `Backend::Cpu`");
        }
        let what =
            if hardware_only { "no hardware GPU was found" } else { "no Vulkan, Metal or DX12 adapter was found" };
        Error::new(ErrorKind::NoDevice, what, "install a driver (Mesa's lavapipe needs no GPU), or use `Backend::Cpu`")
    })
}

/// Records the first fault that the device reports asynchronously.
fn watch(device: &wgpu::Device, fault: &Arc<Mutex<Option<(ErrorKind, String)>>>) {
    let note = |fault: &Mutex<Option<(ErrorKind, String)>>, kind, what: String| {
        fault.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert((kind, what));
    };
    let lost = fault.clone();
    device.set_device_lost_callback(move |reason, message| {
        note(&lost, ErrorKind::DeviceLost, format!("device lost ({reason:?}): {message}"));
    });
    let uncaptured = fault.clone();
    device.on_uncaptured_error(Arc::new(move |error| {
        let kind = match &error {
            wgpu::Error::OutOfMemory { .. } => ErrorKind::DeviceMemory,
            wgpu::Error::Validation { .. } | wgpu::Error::Internal { .. } => ErrorKind::DeviceLost,
        };
        note(&uncaptured, kind, error.to_string());
    }));
}
