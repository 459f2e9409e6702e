//! The rival: resident triangles, one draw per run, images by render targets.

use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DVec3};
use presight::{Environment, FramePlan, Geometry, Images, Mesh, Outputs};
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::Arc;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Corner {
    position: [f32; 3],
    normal: [f32; 3],
    polygon: u32,
}

#[derive(Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
struct Instance {
    linear_x: [f32; 3],
    first_slot: u32,
    /// xyz and padding.
    others: [[f32; 4]; 7],
}

/// Where a mesh's triangles begin in the vertex buffer, polygon by polygon.
struct Place {
    first_vertex: Vec<u32>,
}

/// The order in which runs are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Nearest first, a draw each.
    Front,
    /// By object, neighbours in one draw.
    Object,
}

/// Device, triangles and targets.
pub struct Pipeline {
    device: wgpu::Device,
    queue: wgpu::Queue,
    pub adapter: String,
    pipeline: wgpu::RenderPipeline,
    corners: wgpu::Buffer,
    places: HashMap<usize, Place>,
    instances: wgpu::Buffer,
    group: wgpu::BindGroup,
    targets: [wgpu::Texture; 3],
    views: [wgpu::TextureView; 3],
    readback: wgpu::Buffer,
    size: [u32; 2],
    scratch: Vec<Instance>,
    object_of_slot: Vec<u32>,
}

const NEAR: f32 = 1.0 / 1024.0;
const FORMATS: [wgpu::TextureFormat; 3] =
    [wgpu::TextureFormat::R32Uint, wgpu::TextureFormat::R32Float, wgpu::TextureFormat::Depth32Float];

fn buffer(device: &wgpu::Device, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false })
}

fn key(mesh: &Arc<Mesh>) -> usize {
    Arc::as_ptr(mesh) as usize
}

impl Pipeline {
    /// Uploads an environment; the plan gives the camera.
    pub fn new(plan: &FramePlan) -> Self {
        use wgpu::BufferUsages as U;
        let environment = plan.environment();
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::VULKAN;
        let instance = wgpu::Instance::new(descriptor);
        let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN));
        let rank = |a: &wgpu::Adapter| matches!(a.get_info().device_type, wgpu::DeviceType::Cpu);
        let adapter = adapters.into_iter().min_by_key(rank).expect("an adapter");
        let (device, queue) = pollster::block_on(
            adapter.request_device(&wgpu::DeviceDescriptor { required_limits: adapter.limits(), ..Default::default() }),
        )
        .expect("a device");
        let (triangles, places) = triangles(environment);
        let corners = buffer(&device, triangles.len() as u64 * 28, U::VERTEX | U::COPY_DST);
        queue.write_buffer(&corners, 0, bytemuck::cast_slice(&triangles));
        let instances = buffer(&device, environment.objects().len() as u64 * 128, U::STORAGE | U::COPY_DST);
        let Geometry::Camera(camera) = &plan.sensor.spec().geometry else { panic!("a camera") };
        let size = [camera.width, camera.height];
        let values = [camera.fx, camera.fy, camera.cx, camera.cy, f64::from(size[0]), f64::from(size[1])];
        let camera = buffer(&device, 24, U::UNIFORM | U::COPY_DST);
        queue.write_buffer(&camera, 0, bytemuck::cast_slice(&values.map(|x| x as f32)));
        let pipeline = pipeline(&device);
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[&camera, &instances]
                .map(|b| b.as_entire_binding())
                .into_iter()
                .enumerate()
                .map(|(i, resource)| wgpu::BindGroupEntry { binding: i as u32, resource })
                .collect::<Vec<_>>(),
        });
        let targets = FORMATS.map(|format| target(&device, size, format));
        let views = targets.each_ref().map(|t| t.create_view(&wgpu::TextureViewDescriptor::default()));
        let pixels = u64::from(size[0]) * u64::from(size[1]);
        let readback = buffer(&device, pixels * 12, U::MAP_READ | U::COPY_DST);
        let mut object_of_slot = vec![0; environment.slot_count() as usize];
        for (index, object) in environment.objects().iter().enumerate() {
            let first = object.first_slot as usize;
            object_of_slot[first..first + object.mesh.polygon_count()].fill(index as u32 + 1);
        }
        let info = adapter.get_info();
        let adapter = format!("{} ({})", info.name, info.driver_info);
        let scratch = Vec::new();
        Self {
            device,
            queue,
            adapter,
            pipeline,
            corners,
            places,
            instances,
            group,
            targets,
            views,
            readback,
            size,
            scratch,
            object_of_slot,
        }
    }

    /// All four default outputs, in memory.
    pub fn render(&mut self, plan: &FramePlan, order: Order, images: &mut Images) {
        self.scratch.clear();
        self.scratch.extend(plan.instances.iter().map(|i| {
            let object = &plan.environment().objects()[i.object as usize];
            instance(i.image_from_mesh, i.normal_from_mesh, i.center_in_mesh, object.first_slot)
        }));
        self.queue.write_buffer(&self.instances, 0, bytemuck::cast_slice(&self.scratch));
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.draw(&mut encoder, plan, order);
        let plane = u64::from(self.size[0]) * u64::from(self.size[1]) * 4;
        for (i, target) in self.targets.iter().enumerate() {
            let layout = wgpu::TexelCopyBufferLayout {
                offset: plane * i as u64,
                bytes_per_row: Some(self.size[0] * 4),
                rows_per_image: None,
            };
            let to = wgpu::TexelCopyBufferInfo { buffer: &self.readback, layout };
            encoder.copy_texture_to_buffer(target.as_image_copy(), to, target.size());
        }
        self.queue.submit([encoder.finish()]);
        self.readback.map_async(wgpu::MapMode::Read, .., |mapped| mapped.expect("the device answers"));
        self.device.poll(wgpu::PollType::wait_indefinitely()).expect("the device answers");
        {
            let view = self.readback.get_mapped_range(..).expect("mapped");
            let (ids, rest) = view.split_at(plane as usize);
            let (cosines, depths) = rest.split_at(plane as usize);
            let [ids, cosines, depths] = [ids, cosines, depths].map(bytemuck::cast_slice::<u8, u32>);
            self.resolve(plan, ids, cosines, depths, images);
        }
        self.readback.unmap();
    }

    fn draw(&self, encoder: &mut wgpu::CommandEncoder, plan: &FramePlan, order: Order) {
        let color = |view| {
            let ops =
                wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT), store: wgpu::StoreOp::Store };
            Some(wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops })
        };
        let depth_ops = Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[color(&self.views[0]), color(&self.views[1])],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.views[2],
                depth_ops,
                stencil_ops: None,
            }),
            ..Default::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        pass.set_vertex_buffer(0, self.corners.slice(..));
        let objects = plan.environment().objects();
        let mut runs: Vec<(u32, u32, u32)> = plan.runs.iter().map(|r| (r.instance, r.first, r.count)).collect();
        if order == Order::Object {
            runs.sort_unstable();
            runs.dedup_by(|next, run| {
                let joined = run.0 == next.0 && run.1 + run.2 == next.1;
                run.2 += if joined { next.2 } else { 0 };
                joined
            });
        }
        for (i, first, count) in runs {
            let place = &self.places[&key(&objects[plan.instances[i as usize].object as usize].mesh)];
            let vertices = place.first_vertex[first as usize]..place.first_vertex[(first + count) as usize];
            pass.draw(vertices, i..i + 1);
        }
    }

    fn resolve(&self, plan: &FramePlan, ids: &[u32], cosines: &[u32], depths: &[u32], images: &mut Images) {
        let [width, height] = self.size;
        images.prepare(width, height, Outputs::default());
        let spec = plan.sensor.spec();
        let Geometry::Camera(camera) = &spec.geometry else { panic!("a camera") };
        let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(|x| x as f32);
        let (least, most) = (spec.range_min as f32, spec.range_max as f32);
        let w = width as usize;
        let rows = images.range.par_chunks_mut(w).zip(images.polygon_id.par_chunks_mut(w));
        let rows = rows.zip(images.object_id.par_chunks_mut(w)).zip(images.cos_incidence.par_chunks_mut(w));
        rows.enumerate().with_min_len(8).for_each(|(row, (((range, polygon), object), cosine))| {
            let y = (row as f32 - cy) / fy;
            for column in 0..w {
                let at = row * w + column;
                let x = (column as f32 - cx) / fx;
                let distance = (1.0 + x * x + y * y).sqrt() / (f32::from_bits(depths[at]) * (1.0 / NEAR));
                let id = ids[at];
                if id == 0 || distance > most {
                    (range[column], polygon[column], object[column]) = (f32::INFINITY, 0, 0);
                    cosine[column] = f32::NAN;
                } else {
                    range[column] = if distance < least { f32::NEG_INFINITY } else { distance };
                    polygon[column] = id;
                    object[column] = self.object_of_slot[id as usize - 1];
                    cosine[column] = f32::from_bits(cosines[at]);
                }
            }
        });
        debug_assert_eq!(images.outputs(), Outputs::default());
    }
}

fn triangles(environment: &Environment) -> (Vec<Corner>, HashMap<usize, Place>) {
    let (mut all, mut places) = (Vec::new(), HashMap::new());
    for object in environment.objects() {
        let mesh = &object.mesh;
        if places.contains_key(&key(mesh)) {
            continue;
        }
        let mut first_vertex = Vec::with_capacity(mesh.polygon_count() + 1);
        for polygon in 0..mesh.polygon_count() as u32 {
            first_vertex.push(all.len() as u32);
            let normal = mesh.plane(polygon).normal.as_vec3().to_array();
            let corners = mesh.corner_indices(polygon);
            for k in 1..corners.len() - 1 {
                let corner = |c: u32| Corner { position: mesh.vertices()[c as usize].to_array(), normal, polygon };
                all.extend([corners[0], corners[k], corners[k + 1]].map(corner));
            }
        }
        first_vertex.push(all.len() as u32);
        places.insert(key(mesh), Place { first_vertex });
    }
    (all, places)
}

fn instance(linear: DMat3, normal: DMat3, center: DVec3, first_slot: u32) -> Instance {
    let padded = |v: DVec3| v.as_vec3().extend(0.0).to_array();
    let high = center.as_vec3();
    Instance {
        linear_x: linear.x_axis.as_vec3().to_array(),
        first_slot,
        others: [
            padded(linear.y_axis),
            padded(linear.z_axis),
            padded(normal.x_axis),
            padded(normal.y_axis),
            padded(normal.z_axis),
            high.extend(0.0).to_array(),
            padded(center - high.as_dvec3()),
        ],
    }
}

fn target(device: &wgpu::Device, [width, height]: [u32; 2], format: wgpu::TextureFormat) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}

fn pipeline(device: &wgpu::Device) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::include_wgsl!("raster.wgsl"));
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: None,
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("corner"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[Some(wgpu::VertexBufferLayout {
                array_stride: size_of::<Corner>() as u64,
                step_mode: wgpu::VertexStepMode::Vertex,
                attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Uint32],
            })],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: FORMATS[2],
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("pixel"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            targets: &[Some(FORMATS[0].into()), Some(FORMATS[1].into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
