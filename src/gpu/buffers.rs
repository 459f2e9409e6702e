//! Buffers that grow geometrically and otherwise stay.

use super::device::Gpu;
use crate::error::{ErrorKind, Result};

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

fn create(gpu: &Gpu, label: &str, usage: wgpu::BufferUsages, size: u64) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
}
