//! The hardware rasterizer's stage: draws the shapes that setup made around polygons; fragments write keys.

use super::device::Gpu;
use super::frame_buffers::FrameBuffers;
use super::layout::GridKind;
use super::shaders;
use super::stage::{Binding, Bindings, make};
use super::variants::Constant;
use presight_model::error::Result;

/// The format of the target that a render pass requires, although no pass writes to it.
const TARGET: wgpu::TextureFormat = wgpu::TextureFormat::R8Unorm;

/// The stage's pipelines, bindings and target.
pub(super) struct Drawing {
    bindings: Bindings,
    /// Pipelines of the first and the second pass.
    pipelines: [Option<wgpu::RenderPipeline>; 2],
    target: Option<wgpu::TextureView>,
    /// Width and height of the target.
    size: [u32; 2],
}

impl Drawing {
    pub fn new(gpu: &Gpu) -> Self {
        use Binding::{Params, Read, Uniform, Write};
        let (vertex, fragment) = (wgpu::ShaderStages::VERTEX, wgpu::ShaderStages::FRAGMENT);
        let bindings = [
            (Params, vertex | fragment),
            (Read, fragment),
            (Read, vertex),
            (Read, fragment),
            (Read, vertex),
            (Write, fragment),
            (Uniform, fragment),
        ];
        let bindings = Bindings::new(gpu, "draw", &bindings);
        Self { bindings, pipelines: [None, None], target: None, size: [0; 2] }
    }

    /// Creates the pipelines, and a target of at least this size, unless they exist.
    ///
    /// # Errors
    /// The device's error if it rejects the shader.
    pub fn prepare(&mut self, gpu: &Gpu, size: [u32; 2], rays: Constant) -> Result<()> {
        let text = if gpu.int64 { shaders::DRAW_64 } else { shaders::DRAW_32 };
        for second in 0..if gpu.int64 { 1 } else { 2 } {
            if self.pipelines[second].is_none() {
                let all = [GridKind::Camera.constant(), rays, ("SECOND", second as f64)];
                let constants = if gpu.int64 { &all[..2] } else { &all[..] };
                self.pipelines[second] = Some(self.pipeline(gpu, text, constants)?);
            }
        }
        if self.target.is_none() || size[0] > self.size[0] || size[1] > self.size[1] {
            self.size = [size[0].max(self.size[0]), size[1].max(self.size[1])];
            self.target = Some(target(gpu, self.size));
            gpu.check()?;
        }
        Ok(())
    }

    fn pipeline(&self, gpu: &Gpu, text: &str, constants: &[(&str, f64)]) -> Result<wgpu::RenderPipeline> {
        let options = wgpu::PipelineCompilationOptions { constants, ..wgpu::PipelineCompilationOptions::default() };
        make(gpu, self.bindings.name, text, |module| {
            gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(self.bindings.name),
                layout: Some(&self.bindings.pipeline_layout),
                vertex: wgpu::VertexState {
                    module,
                    entry_point: Some("corner"),
                    compilation_options: options.clone(),
                    buffers: &[],
                },
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: None,
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module,
                    entry_point: Some("draw"),
                    compilation_options: options.clone(),
                    targets: &[Some(wgpu::ColorTargetState {
                        format: TARGET,
                        blend: None,
                        write_mask: wgpu::ColorWrites::empty(),
                    })],
                }),
                multiview_mask: None,
                cache: None,
            })
        })
    }

    /// Binds the current buffers.
    pub fn bind(&mut self, gpu: &Gpu, s: &FrameBuffers) {
        let buffers = [&s.params, &s.records, &s.survivors, &s.grid, &s.counters, &s.keys, &s.short_grid];
        self.bindings.bind(gpu, &buffers.map(|b| b.buffer()));
    }

    /// Encodes one pass over one wave's survivors or over all survivors, with the counts at `at`.
    pub fn encode(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        times: Option<wgpu::RenderPassTimestampWrites<'_>>,
        draw: &Draw<'_>,
    ) {
        let ready = (&self.target, &self.pipelines[usize::from(draw.second)], self.bindings.of_wave(draw.wave));
        let (Some(view), Some(pipeline), Some((group, offset))) = ready else {
            debug_assert!(false, "stage {} is not ready", self.bindings.name);
            return;
        };
        gpu.done.passes.add();
        let ops = wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Discard };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some(self.bindings.name),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops,
            })],
            timestamp_writes: times,
            ..Default::default()
        });
        let [width, height] = draw.size;
        pass.set_viewport(0.0, 0.0, width as f32, height as f32, 0.0, 1.0);
        pass.set_scissor_rect(0, 0, width, height);
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, group, offset.as_slice());
        pass.draw_indirect(draw.counts, draw.at);
    }
}

/// Arguments of one draw pass.
pub(super) struct Draw<'a> {
    pub wave: usize,
    pub second: bool,
    /// Width and height of the image.
    pub size: [u32; 2],
    pub counts: &'a wgpu::Buffer,
    /// Offset of the counts, bytes.
    pub at: u64,
}

fn target(gpu: &Gpu, [width, height]: [u32; 2]) -> wgpu::TextureView {
    gpu.made.buffers.add();
    gpu.made.bytes.add_many(u64::from(width) * u64::from(height));
    let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("target"),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: TARGET,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
        view_formats: &[],
    });
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}
