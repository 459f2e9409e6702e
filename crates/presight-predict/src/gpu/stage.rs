//! A stage: its bindings and, if it is a compute stage, its pipeline variants, which are created on demand and kept.

use super::device::Gpu;
use super::layout::{GridKind, Params, WAVE_BYTES};
use presight_model::error::{ErrorKind, Result};
use std::collections::HashMap;

/// The kind of a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Binding {
    /// The parameters of the wave that [`Stage::set`] selects.
    Params,
    Uniform,
    Read,
    Write,
}

/// Selects a pipeline of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Variant {
    pub kind: GridKind,
    /// The stage's own choices.
    pub bits: u32,
}

/// The bind group layout that a stage's pipelines share, with its buffers.
pub(super) struct Bindings {
    pub name: &'static str,
    layout: wgpu::BindGroupLayout,
    pub pipeline_layout: wgpu::PipelineLayout,
    group: Option<wgpu::BindGroup>,
    /// True if the first binding is [`Binding::Params`].
    of_waves: bool,
}

impl Bindings {
    /// Takes each binding with the shader stages that see it.
    pub fn new(gpu: &Gpu, name: &'static str, bindings: &[(Binding, wgpu::ShaderStages)]) -> Self {
        let entries: Vec<_> =
            bindings.iter().enumerate().map(|(i, (what, seen_by))| entry(i as u32, *what, *seen_by)).collect();
        let layout = gpu
            .device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(name), entries: &entries });
        let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(name),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let of_waves = bindings.first().is_some_and(|(binding, _)| *binding == Binding::Params);
        Self { name, layout, pipeline_layout, group: None, of_waves }
    }

    /// Binds these buffers.
    pub fn bind(&mut self, gpu: &Gpu, buffers: &[&wgpu::Buffer]) {
        let entries: Vec<_> = buffers
            .iter()
            .enumerate()
            .map(|(i, b)| wgpu::BindGroupEntry { binding: i as u32, resource: self.resource(i, b) })
            .collect();
        let descriptor = wgpu::BindGroupDescriptor { label: Some(self.name), layout: &self.layout, entries: &entries };
        gpu.made.bind_groups.add();
        self.group = Some(gpu.device.create_bind_group(&descriptor));
    }

    fn resource<'b>(&self, at: usize, buffer: &'b wgpu::Buffer) -> wgpu::BindingResource<'b> {
        if at == 0 && self.of_waves {
            let size = std::num::NonZeroU64::new(size_of::<Params>() as u64);
            return wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset: 0, size });
        }
        buffer.as_entire_binding()
    }

    /// Returns the bind group and offset for a wave; `None` before buffers are bound.
    pub fn of_wave(&self, wave: usize) -> Option<(&wgpu::BindGroup, Option<u32>)> {
        let offset = self.of_waves.then_some(wave as u32 * WAVE_BYTES as u32);
        self.group.as_ref().map(|group| (group, offset))
    }
}

/// Compute pipelines that share bindings.
pub(super) struct Stage {
    bindings: Bindings,
    pipelines: HashMap<Variant, wgpu::ComputePipeline>,
}

impl Stage {
    /// `name` is also the entry point.
    pub fn new(gpu: &Gpu, name: &'static str, bindings: &[Binding]) -> Self {
        let bindings: Vec<_> = bindings.iter().map(|b| (*b, wgpu::ShaderStages::COMPUTE)).collect();
        Self { bindings: Bindings::new(gpu, name, &bindings), pipelines: HashMap::new() }
    }

    /// Binds these buffers.
    pub fn bind(&mut self, gpu: &Gpu, buffers: &[&wgpu::Buffer]) {
        self.bindings.bind(gpu, buffers);
    }

    /// Creates a variant's pipeline unless it exists.
    ///
    /// # Errors
    /// The device's error if it rejects the shader.
    pub fn prepare(&mut self, gpu: &Gpu, variant: Variant, text: &str, constants: &[(&str, f64)]) -> Result<()> {
        if self.pipelines.contains_key(&variant) {
            return Ok(());
        }
        let name = Some(self.bindings.name);
        let pipeline = make(gpu, self.bindings.name, text, |module| {
            gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: name,
                layout: Some(&self.bindings.pipeline_layout),
                module,
                entry_point: name,
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants,
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            })
        })?;
        self.pipelines.insert(variant, pipeline);
        Ok(())
    }

    /// Sets a wave's pipeline and bindings. Returns false if the stage is not ready, which is a bug in the engine.
    pub fn set(&self, pass: &mut wgpu::ComputePass<'_>, variant: Variant, wave: usize) -> bool {
        let (Some(pipeline), Some((group, offset))) = (self.pipelines.get(&variant), self.bindings.of_wave(wave))
        else {
            debug_assert!(false, "stage {} is not ready", self.bindings.name);
            return false;
        };
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, group, offset.as_slice());
        true
    }
}

/// Compiles a shader and creates a pipeline from it.
///
/// # Errors
/// The device's error if it rejects the shader.
pub(super) fn make<P>(
    gpu: &Gpu,
    name: &'static str,
    text: &str,
    pipeline: impl FnOnce(&wgpu::ShaderModule) -> P,
) -> Result<P> {
    let scope = gpu.device.push_error_scope(wgpu::ErrorFilter::Validation);
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(name),
        source: wgpu::ShaderSource::Wgsl(text.into()),
    });
    let pipeline = pipeline(&module);
    if let Some(e) = pollster::block_on(scope.pop()) {
        return Err(gpu.error(ErrorKind::NoDevice, &format!("stage {name}: {e}")));
    }
    gpu.check()?;
    gpu.made.pipelines.add();
    Ok(pipeline)
}

fn entry(binding: u32, what: Binding, visibility: wgpu::ShaderStages) -> wgpu::BindGroupLayoutEntry {
    let ty = match what {
        Binding::Params | Binding::Uniform => wgpu::BufferBindingType::Uniform,
        Binding::Read => wgpu::BufferBindingType::Storage { read_only: true },
        Binding::Write => wgpu::BufferBindingType::Storage { read_only: false },
    };
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: what == Binding::Params, min_binding_size: None },
        count: None,
    }
}
