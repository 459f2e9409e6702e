//! Buffers that grow geometrically and otherwise stay, and the one through which all uploads of a frame go.

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

/// Smallest size, bytes.
const LEAST: u64 = 1 << 12;

impl Growable {
    /// A storage buffer.
    pub fn storage(gpu: &Gpu, label: &'static str) -> Self {
        use wgpu::BufferUsages as U;
        Self::new(gpu, label, U::STORAGE | U::COPY_DST | U::COPY_SRC, true)
    }

    /// A buffer of any use; `bound` says whether it is bound whole, so that the limit of a binding holds.
    pub fn new(gpu: &Gpu, label: &'static str, usage: wgpu::BufferUsages, bound: bool) -> Self {
        let buffer = create(gpu, label, usage, LEAST);
        Self { label, usage, buffer, bound }
    }

    /// A uniform buffer of a size that never changes.
    pub fn uniform(gpu: &Gpu, label: &'static str, bytes: u64) -> Self {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        Self { label, usage, buffer: create(gpu, label, usage, bytes), bound: false }
    }

    pub fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Makes room for so many bytes; true if the buffer is another one now, with unspecified contents.
    ///
    /// # Errors
    /// [`ErrorKind::DeviceMemory`] if one binding cannot hold it or the device has no room.
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

/// What the host writes to is mapped from the start.
fn create(gpu: &Gpu, label: &str, usage: wgpu::BufferUsages, size: u64) -> wgpu::Buffer {
    gpu.made.buffers.add();
    gpu.made.bytes.add_many(size);
    let mapped_at_creation = usage.contains(wgpu::BufferUsages::MAP_WRITE);
    gpu.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation })
}

/// How a mapping that was asked for went; the device's callback tells.
#[derive(Clone, Default)]
pub(super) struct Mapping(Arc<AtomicU8>);

const WAITING: u8 = 0;
const MAPPED: u8 = 1;
const REFUSED: u8 = 2;

impl Mapping {
    /// Asks for it; what comes of it is known after [`Gpu::wait`].
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
            _ => Err(gpu.error(ErrorKind::DeviceLost, &format!("{what} is not mapped in time"))),
        }
    }
}

/// All uploads of a frame: collected, then copied to the device from one buffer that is mapped again after each frame.
/// `Queue::write_buffer` would make a staging buffer inside wgpu every time.
pub(super) struct Uploads {
    staging: Growable,
    /// Of the staging buffer, from the second frame on.
    mapping: Option<Mapping>,
    bytes: Vec<u8>,
    copies: Vec<Copy>,
}

/// From the staging buffer at `from`.
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

    /// Begins a frame: forgets what one that failed has left.
    pub fn clear(&mut self) {
        self.bytes.clear();
        self.copies.clear();
    }

    /// Takes whole words that shall lie in a buffer from byte `at` on.
    pub fn put(&mut self, to: &Growable, at: u64, bytes: &[u8]) {
        debug_assert!(bytes.len().is_multiple_of(4), "whole words");
        if !bytes.is_empty() {
            let (from, to) = (self.bytes.len() as u64, to.buffer.clone());
            self.bytes.extend_from_slice(bytes);
            self.copies.push(Copy { from, to, at, bytes: bytes.len() as u64 });
        }
    }

    /// Copies that wait to be encoded.
    pub fn waiting(&self) -> usize {
        self.copies.len()
    }

    /// Writes what was taken to the staging buffer.
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

    /// Writes what was taken and encodes all copies.
    ///
    /// # Errors
    /// Those of [`Uploads::write`].
    pub fn encode(&mut self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder) -> Result<()> {
        self.write(gpu)?;
        self.encode_some(encoder, self.copies.len());
        Ok(())
    }

    /// Encodes the first of the copies that wait.
    pub fn encode_some(&mut self, encoder: &mut wgpu::CommandEncoder, count: usize) {
        for copy in self.copies.drain(..count) {
            encoder.copy_buffer_to_buffer(self.staging.buffer(), copy.from, &copy.to, copy.at, copy.bytes);
        }
    }

    /// Asks for the staging buffer again, after the copies were submitted.
    pub fn recall(&mut self) {
        self.mapping.get_or_insert_default().ask(
            self.staging.buffer(),
            wgpu::MapMode::Write,
            self.staging.buffer().size(),
        );
    }
}
