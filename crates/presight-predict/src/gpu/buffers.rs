//! Device buffers that grow geometrically and never shrink, and the staging buffer for a frame's uploads.

use super::device::Gpu;
use presight_model::error::{ErrorKind, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

/// A device buffer that is only ever replaced by a larger one.
pub(super) struct Growable {
    label: &'static str,
    usage: wgpu::BufferUsages,
    buffer: wgpu::Buffer,
    bound: bool,
}

/// Minimum size, bytes.
const LEAST: u64 = 1 << 12;

impl Growable {
    /// Creates a storage buffer.
    pub fn storage(gpu: &Gpu, label: &'static str) -> Self {
        use wgpu::BufferUsages as U;
        Self::new(gpu, label, U::STORAGE | U::COPY_DST | U::COPY_SRC, true)
    }

    /// Creates a buffer for any usage. `bound`: the whole buffer is bound, so the device's limit for bindings applies.
    pub fn new(gpu: &Gpu, label: &'static str, usage: wgpu::BufferUsages, bound: bool) -> Self {
        let buffer = create(gpu, label, usage, LEAST);
        Self { label, usage, buffer, bound }
    }

    /// Creates a uniform buffer of fixed size.
    pub fn uniform(gpu: &Gpu, label: &'static str, bytes: u64) -> Self {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        Self { label, usage, buffer: create(gpu, label, usage, bytes), bound: false }
    }

    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Makes room for this many bytes. Returns true if the buffer was replaced; its contents are then unspecified.
    ///
    /// # Errors
    /// [`ErrorKind::DeviceMemory`] if the size exceeds the limit of a binding or the device is out of memory.
    pub fn reserve(&mut self, gpu: &Gpu, bytes: u64) -> Result<bool> {
        if bytes <= self.buffer.size() {
            return Ok(false);
        }
        let limits = gpu.device.limits();
        let most = if self.bound { limits.max_storage_buffer_binding_size } else { limits.max_buffer_size };
        let most = most.min(limits.max_buffer_size) & !15;
        if bytes > most {
            let what = format!("{} of {bytes} bytes, where one binding holds {most}", self.label);
            return Err(gpu.error(ErrorKind::DeviceMemory, &what));
        }
        let scope = gpu.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let larger = create(gpu, self.label, self.usage, bytes.next_power_of_two().min(most));
        if let Some(e) = pollster::block_on(scope.pop()) {
            return Err(gpu.error(ErrorKind::DeviceMemory, &format!("{}: {e}", self.label)));
        }
        gpu.check()?;
        self.buffer = larger;
        Ok(true)
    }
}

/// Buffers that the host writes to are created mapped.
fn create(gpu: &Gpu, label: &str, usage: wgpu::BufferUsages, size: u64) -> wgpu::Buffer {
    gpu.made.buffers.add();
    gpu.made.bytes.add_many(size);
    let mapped_at_creation = usage.contains(wgpu::BufferUsages::MAP_WRITE);
    gpu.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation })
}

/// State of a requested mapping, set by the device's callback.
#[derive(Clone, Default)]
pub(super) struct Mapping(Arc<AtomicU8>);

const WAITING: u8 = 0;
const MAPPED: u8 = 1;
const REFUSED: u8 = 2;

impl Mapping {
    /// Requests the mapping; [`Mapping::check`] reports the result after [`Gpu::wait`].
    pub fn ask(&self, buffer: &wgpu::Buffer, mode: wgpu::MapMode, bytes: u64) {
        self.0.store(WAITING, Ordering::Release);
        let told = self.0.clone();
        buffer.map_async(mode, 0..bytes, move |mapped| {
            told.store(if mapped.is_ok() { MAPPED } else { REFUSED }, Ordering::Release);
        });
    }

    /// # Errors
    /// [`ErrorKind::DeviceLost`] unless the buffer is mapped now.
    pub fn check(&self, gpu: &Gpu, what: &str) -> Result<()> {
        match self.0.load(Ordering::Acquire) {
            MAPPED => Ok(()),
            REFUSED => Err(gpu.error(ErrorKind::DeviceLost, &format!("{what} cannot be mapped"))),
            _ => Err(gpu.error(ErrorKind::DeviceLost, &format!("{what} was not mapped in time"))),
        }
    }
}

/// Collects a frame's uploads and copies them to the device from one staging buffer, which is mapped again after each
/// frame. `Queue::write_buffer` would allocate a staging buffer inside wgpu every time.
pub(super) struct Uploads {
    staging: Growable,
    /// Mapping of the staging buffer; `None` for the first frame, when the buffer is mapped by its creation.
    mapping: Option<Mapping>,
    bytes: Vec<u8>,
    copies: Vec<Copy>,
}

/// A copy from offset `from` of the staging buffer.
struct Copy {
    from: u64,
    to: wgpu::Buffer,
    at: u64,
    bytes: u64,
}

impl Uploads {
    pub fn new(gpu: &Gpu) -> Self {
        use wgpu::BufferUsages as U;
        let staging = Growable::new(gpu, "uploads", U::MAP_WRITE | U::COPY_SRC, false);
        Self { staging, mapping: None, bytes: Vec::new(), copies: Vec::new() }
    }

    /// Begins a frame: discards what a failed frame left behind.
    pub fn clear(&mut self) {
        self.bytes.clear();
        self.copies.clear();
    }

    /// Schedules whole words for upload to a buffer, from byte `at` on.
    pub fn put(&mut self, to: &Growable, at: u64, bytes: &[u8]) {
        debug_assert!(bytes.len().is_multiple_of(4), "whole words");
        if !bytes.is_empty() {
            let (from, to) = (self.bytes.len() as u64, to.buffer.clone());
            self.bytes.extend_from_slice(bytes);
            self.copies.push(Copy { from, to, at, bytes: bytes.len() as u64 });
        }
    }

    /// Number of copies not yet encoded.
    pub fn waiting(&self) -> usize {
        self.copies.len()
    }

    /// Writes the collected bytes to the staging buffer.
    ///
    /// # Errors
    /// [`ErrorKind::DeviceMemory`], [`ErrorKind::DeviceLost`].
    pub fn write(&mut self, gpu: &Gpu) -> Result<()> {
        let bytes = self.bytes.len() as u64;
        if self.staging.reserve(gpu, bytes)? {
            self.mapping = None;
        }
        if let Some(mapping) = &self.mapping {
            mapping.check(gpu, "the upload buffer")?;
        }
        let staging = self.staging.buffer();
        let view = staging.get_mapped_range_mut(0..bytes);
        let mut view = view.map_err(|e| gpu.error(ErrorKind::DeviceLost, &e.to_string()))?;
        view.copy_from_slice(&self.bytes);
        gpu.done.bytes_written.add_many(bytes);
        drop(view);
        staging.unmap();
        self.bytes.clear();
        Ok(())
    }

    /// Writes the collected bytes and encodes all copies.
    ///
    /// # Errors
    /// Same as [`Uploads::write`].
    pub fn encode(&mut self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder) -> Result<()> {
        self.write(gpu)?;
        self.encode_some(encoder, self.copies.len());
        Ok(())
    }

    /// Encodes the first `count` waiting copies.
    pub fn encode_some(&mut self, encoder: &mut wgpu::CommandEncoder, count: usize) {
        for copy in self.copies.drain(..count) {
            encoder.copy_buffer_to_buffer(self.staging.buffer(), copy.from, &copy.to, copy.at, copy.bytes);
        }
    }

    /// Requests the staging buffer again, after the copies were submitted.
    pub fn recall(&mut self) {
        self.mapping.get_or_insert_default().ask(
            self.staging.buffer(),
            wgpu::MapMode::Write,
            self.staging.buffer().size(),
        );
    }
}
