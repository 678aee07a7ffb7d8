//! The draw pass of `lights`: targets, pipeline, bindings.

use glam::Vec4;
use wgpu::{BufferUsages, TextureFormat, TextureUsages};

use super::{Settings, Uploads};
use crate::error::{Error, Result};
use crate::render::gpu::Gpu;
use crate::scene::{Scene, Vertex};

/// The shader, shared with the browser.
const SHADER: &str = include_str!("../../../../shaders/lights.wgsl");
const DEPTH: TextureFormat = TextureFormat::Depth32Float;

/// Everything of one scene on the device.
pub(super) struct Pass {
    pipeline: wgpu::RenderPipeline,
    bindings: wgpu::BindGroup,
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    /// Where samples go; the same as `resolved` with one sample a pixel.
    colour: wgpu::Texture,
    depth: wgpu::Texture,
    resolved: wgpu::Texture,
}

impl Pass {
    /// Uploads a scene and builds the pipeline.
    pub(super) fn new(gpu: &Gpu, uploads: &Uploads, scene: &Scene, settings: &Settings) -> Result<Self> {
        let wanted = [
            (TextureFormat::Rgba32Float, settings.samples),
            (TextureFormat::Rgba16Float, settings.samples),
            (TextureFormat::Rgba32Float, 1),
            (TextureFormat::Rgba16Float, 1),
        ];
        let (format, samples) =
            gpu.target(&wanted).ok_or_else(|| Error::failure("GPU: it cannot draw to float textures"))?;
        let texture = |label, format, samples, usage| {
            gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d {
                    width: scene.camera.width,
                    height: scene.camera.height,
                    depth_or_array_layers: 1,
                },
                mip_level_count: 1,
                sample_count: samples,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let resolved =
            texture("picture", format, 1, TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC);
        let colour = if samples == 1 {
            resolved.clone()
        } else {
            texture("samples", format, samples, TextureUsages::RENDER_ATTACHMENT)
        };
        let depth = texture("depth", DEPTH, samples, TextureUsages::RENDER_ATTACHMENT);

        let pipeline = pipeline(gpu, format, samples);
        let storage = BufferUsages::STORAGE;
        let buffers = [
            gpu.buffer("view", &[uploads.view], BufferUsages::UNIFORM)?,
            gpu.buffer("lights", &uploads.lights, storage)?,
            gpu.buffer("materials", &uploads.materials.materials, storage)?,
            gpu.buffer("texels", &uploads.materials.texels, storage)?,
            gpu.buffer("lobes", &uploads.materials.lobes, storage)?,
        ];
        let entries: Vec<_> = buffers
            .iter()
            .enumerate()
            .map(|(binding, buffer)| wgpu::BindGroupEntry {
                binding: binding as u32,
                resource: buffer.as_entire_binding(),
            })
            .collect();
        let bindings = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("lights"),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        Ok(Self {
            pipeline,
            bindings,
            vertices: gpu.buffer("vertices", &uploads.mesh.vertices, BufferUsages::VERTEX)?,
            indices: gpu.buffer("indices", &uploads.mesh.triangles, BufferUsages::INDEX)?,
            colour,
            depth,
            resolved,
        })
    }

    /// Draws all objects and reads the picture back.
    pub(super) fn draw(&self, gpu: &Gpu, uploads: &Uploads) -> Result<Vec<Vec4>> {
        let view = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let (colour, depth, resolved) = (view(&self.colour), view(&self.depth), view(&self.resolved));
        let multisampled = self.colour.sample_count() > 1;
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("lights"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &colour,
                    depth_slice: None,
                    resolve_target: multisampled.then_some(&resolved),
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: if multisampled { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store },
                    },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &depth,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(0.0),
                        store: wgpu::StoreOp::Discard,
                    }),
                    stencil_ops: None,
                }),
                ..Default::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.bindings, &[]);
            pass.set_vertex_buffer(0, self.vertices.slice(..));
            pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
            for (object, run) in (0u32..).zip(&uploads.runs) {
                // The instance's number tells the shader which material to take.
                pass.draw_indexed(run.clone(), 0, object..object + 1);
            }
        }
        gpu.read_texture(encoder, &self.resolved)
    }
}

/// The pipeline for a target's format and samples.
fn pipeline(gpu: &Gpu, format: TextureFormat, samples: u32) -> wgpu::RenderPipeline {
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("lights.wgsl"),
        source: wgpu::ShaderSource::Wgsl(SHADER.into()),
    });
    let attributes = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32x4, 3 => Float32x2];
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("lights"),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("place"),
            compilation_options: Default::default(),
            buffers: &[Some(wgpu::VertexBufferLayout {
                array_stride: size_of::<Vertex>() as u64,
                step_mode: wgpu::VertexStepMode::Vertex,
                attributes: &attributes,
            })],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: wgpu::MultisampleState { count: samples, ..Default::default() },
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("shade"),
            compilation_options: Default::default(),
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
