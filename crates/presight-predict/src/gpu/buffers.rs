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
const MIN_BYTES: u64 = 1 << 12;

impl Growable {
    /// Creates a storage buffer.
    pub fn storage(gpu: &Gpu, label: &'static str) -> Self {
        use wgpu::BufferUsages as U;
        Self::new(gpu, label, U::STORAGE | U::COPY_DST | U::COPY_SRC, true)
    }

    /// Creates a buffer for any usage. `bound`: the whole buffer is bound, so the device's limit for bindings applies.
    pub fn new(gpu: &Gpu, label: &'static str, usage: wgpu::BufferUsages, bound: bool) -> Self {
        let buffer = create(gpu, label, usage, MIN_BYTES);
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
struct Mapping(Arc<AtomicU8>);

const WAITING: u8 = 0;
const MAPPED: u8 = 1;
const REFUSED: u8 = 2;

impl Mapping {
    /// Requests the mapping; [`Mapping::check`] reports the result after [`Gpu::wait`].
    fn ask(&self, buffer: &wgpu::Buffer, mode: wgpu::MapMode, bytes: u64) {
        self.0.store(WAITING, Ordering::Release);
        let state = self.0.clone();
        buffer.map_async(mode, 0..bytes, move |mapped| {
            state.store(if mapped.is_ok() { MAPPED } else { REFUSED }, Ordering::Release);
        });
    }

    /// # Errors
    /// [`ErrorKind::DeviceLost`] unless the buffer is mapped now.
    fn check(&self, gpu: &Gpu, what: &str) -> Result<()> {
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
    /// Number of copies before the end of each part.
    ends: Vec<usize>,
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
        Self { staging, mapping: None, bytes: Vec::new(), copies: Vec::new(), ends: Vec::new() }
    }

    /// Discards what a failed submission left behind.
    pub fn clear(&mut self) {
        self.bytes.clear();
        self.copies.clear();
        self.ends.clear();
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

    /// Ends a part of the uploads, whose copies [`Uploads::encode`] encodes together.
    pub fn end_part(&mut self) {
        self.ends.push(self.copies.len());
    }

    /// Encodes the copies of a part.
    pub fn encode(&self, encoder: &mut wgpu::CommandEncoder, part: usize) {
        let first = if part == 0 { 0 } else { self.ends[part - 1] };
        for copy in &self.copies[first..self.ends[part]] {
            encoder.copy_buffer_to_buffer(self.staging.buffer(), copy.from, &copy.to, copy.at, copy.bytes);
        }
    }

    /// Submits what `encode` encodes, with the collected uploads; `encode` must encode their copies.
    ///
    /// # Errors
    /// [`ErrorKind::DeviceMemory`], [`ErrorKind::DeviceLost`].
    pub fn submit(&mut self, gpu: &Gpu, encode: impl FnOnce(&Self, &mut wgpu::CommandEncoder)) -> Result<()> {
        let uploads = !self.bytes.is_empty();
        if uploads {
            self.write(gpu)?;
        }
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encode(self, &mut encoder);
        gpu.queue.submit([encoder.finish()]);
        if uploads {
            // Maps the staging buffer for the next submission.
            let staging = self.staging.buffer();
            self.mapping.get_or_insert_default().ask(staging, wgpu::MapMode::Write, staging.size());
        }
        self.clear();
        Ok(())
    }

    /// Writes the collected bytes to the staging buffer.
    fn write(&mut self, gpu: &Gpu) -> Result<()> {
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
        Ok(())
    }
}

/// A buffer for the device's answers.
pub(super) struct Answers {
    buffer: Growable,
    mapping: Mapping,
}

impl Answers {
    pub fn new(gpu: &Gpu, label: &'static str) -> Self {
        use wgpu::BufferUsages as U;
        Self { buffer: Growable::new(gpu, label, U::MAP_READ | U::COPY_DST, false), mapping: Mapping::default() }
    }

    pub fn buffer(&self) -> &wgpu::Buffer {
        self.buffer.buffer()
    }

    /// Makes room for this many bytes.
    ///
    /// # Errors
    /// [`ErrorKind::DeviceMemory`].
    pub fn reserve(&mut self, gpu: &Gpu, bytes: u64) -> Result<()> {
        self.buffer.reserve(gpu, bytes).map(drop)
    }

    /// Waits for the device and maps this many bytes.
    ///
    /// # Errors
    /// [`ErrorKind::DeviceLost`].
    pub fn wait(&self, gpu: &Gpu, bytes: u64) -> Result<Answer> {
        let buffer = self.buffer.buffer();
        self.mapping.ask(buffer, wgpu::MapMode::Read, bytes);
        gpu.wait()?;
        self.mapping.check(gpu, self.buffer.label)?;
        gpu.done.bytes_read.add_many(bytes);
        let view = buffer.get_mapped_range(0..bytes);
        let view = view.map_err(|e| gpu.error(ErrorKind::DeviceLost, &e.to_string()))?;
        Ok(Answer { view: Some(view), buffer: buffer.clone() })
    }
}

/// Bytes that the device delivered. The buffer stays mapped until this is dropped.
pub(super) struct Answer {
    view: Option<wgpu::BufferView>,
    buffer: wgpu::Buffer,
}

impl std::ops::Deref for Answer {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.view.as_deref().unwrap_or_default()
    }
}

impl Drop for Answer {
    fn drop(&mut self) {
        // A buffer cannot be unmapped while a view of it lives.
        self.view = None;
        self.buffer.unmap();
    }
}
