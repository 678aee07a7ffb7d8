//! The draw pass of `lights`: targets, pipeline, bindings.

use glam::Vec4;
use wgpu::{BufferUsages, TextureFormat, TextureUsages};

use super::{Distant, Uploads, View};
use crate::error::{Error, Result};
use crate::render::gpu::Gpu;
use crate::scene::{Camera, Vertex};

/// The shader, shared with the browser.
const SHADER: &str = include_str!("../../../../shaders/lights.wgsl");
/// Where there is no light from afar.
const NOT_DISTANT: &str = "fn distant(texel: u32, frame: mat3x3f, wo: vec3f) -> vec3f { return vec3f(0.0); }";
const DEPTH: TextureFormat = TextureFormat::Depth32Float;

/// Everything of one scene on the device.
pub(super) struct Pass {
    pipeline: wgpu::RenderPipeline,
    /// What the shader reads, but for the view.
    buffers: [wgpu::Buffer; 4],
    /// What light from afar reads.
    distant: Option<wgpu::BindGroup>,
    lamps: usize,
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    runs: Vec<std::ops::Range<u32>>,
    format: TextureFormat,
    samples: u32,
}

impl Pass {
    /// Uploads a scene and builds the pipeline for `samples` a pixel, or 1 where the adapter cannot.
    pub(super) fn new(gpu: &Gpu, uploads: &Uploads, samples: u32, distant: Option<Distant>) -> Result<Self> {
        let wanted = [
            (TextureFormat::Rgba32Float, samples),
            (TextureFormat::Rgba16Float, samples),
            (TextureFormat::Rgba32Float, 1),
            (TextureFormat::Rgba16Float, 1),
        ];
        let (format, samples) =
            gpu.target(&wanted).ok_or_else(|| Error::failure("GPU: it cannot draw to float textures"))?;
        let storage = BufferUsages::STORAGE;
        let shader = distant.as_ref().map_or(NOT_DISTANT, |distant| distant.shader);
        let pipeline = pipeline(gpu, format, samples, shader);
        Ok(Self {
            distant: distant.map(|distant| bind(gpu, &pipeline, 1, distant.buffers.iter())),
            pipeline,
            buffers: [
                gpu.buffer("lamps", &uploads.lamps, storage)?,
                gpu.buffer("materials", &uploads.materials.materials, storage)?,
                gpu.buffer("texels", &uploads.materials.texels, storage)?,
                gpu.buffer("lobes", &uploads.materials.lobes, storage)?,
            ],
            lamps: uploads.lamps.len(),
            vertices: gpu.buffer("vertices", &uploads.mesh.vertices, BufferUsages::VERTEX)?,
            indices: gpu.buffer("indices", &uploads.mesh.triangles, BufferUsages::INDEX)?,
            runs: uploads.runs.clone(),
            format,
            samples,
        })
    }

    /// Samples a pixel.
    pub(super) fn samples(&self) -> u32 {
        self.samples
    }

    /// Draw calls a view.
    pub(super) fn draws(&self) -> u32 {
        self.runs.len() as u32
    }

    /// Bytes of the textures that a view is drawn to.
    pub(super) fn target_bytes(&self, camera: &Camera) -> usize {
        let colour = if self.format == TextureFormat::Rgba16Float { 8 } else { 16 };
        let resolved = if self.samples > 1 { colour } else { 0 };
        (camera.width * camera.height) as usize * ((colour + 4) * self.samples as usize + resolved)
    }

    /// What the shader reads.
    fn bindings(&self, gpu: &Gpu, camera: &Camera) -> Result<wgpu::BindGroup> {
        let view =
            View { projection: super::projection(camera), eye: camera.position.extend(self.lamps as f32) };
        let view = gpu.buffer("view", &[view], BufferUsages::UNIFORM)?;
        Ok(bind(gpu, &self.pipeline, 0, std::iter::once(&view).chain(&self.buffers)))
    }

    /// Draws all objects and reads the picture back.
    pub(super) fn draw(&self, gpu: &Gpu, camera: &Camera) -> Result<Vec<Vec4>> {
        let texture = |label, format, samples, usage| {
            let size =
                wgpu::Extent3d { width: camera.width, height: camera.height, depth_or_array_layers: 1 };
            gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size,
                mip_level_count: 1,
                sample_count: samples,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let target = TextureUsages::RENDER_ATTACHMENT;
        let multisampled = self.samples > 1;
        let picture = texture("picture", self.format, 1, target | TextureUsages::COPY_SRC);
        let samples = multisampled.then(|| texture("samples", self.format, self.samples, target));
        let depth = texture("depth", DEPTH, self.samples, target);
        let view = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let (colour, depth, resolved) =
            (view(samples.as_ref().unwrap_or(&picture)), view(&depth), view(&picture));
        let bindings = self.bindings(gpu, camera)?;
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
            pass.set_bind_group(0, &bindings, &[]);
            if let Some(distant) = &self.distant {
                pass.set_bind_group(1, distant, &[]);
            }
            pass.set_vertex_buffer(0, self.vertices.slice(..));
            pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
            for (object, run) in (0u32..).zip(&self.runs) {
                // The instance's number tells the shader which material to take.
                pass.draw_indexed(3 * run.start..3 * run.end, 0, object..object + 1);
            }
        }
        gpu.read_texture(encoder, &picture)
    }
}

/// Whole buffers as a group, in the order of their bindings.
fn bind<'a>(
    gpu: &Gpu,
    pipeline: &wgpu::RenderPipeline,
    group: u32,
    buffers: impl Iterator<Item = &'a wgpu::Buffer>,
) -> wgpu::BindGroup {
    let entries: Vec<_> = (0u32..)
        .zip(buffers)
        .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
        .collect();
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("lights"),
        layout: &pipeline.get_bind_group_layout(group),
        entries: &entries,
    })
}

/// The pipeline for a target's format and samples, with the shader of light from afar.
fn pipeline(gpu: &Gpu, format: TextureFormat, samples: u32, distant: &str) -> wgpu::RenderPipeline {
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("lights.wgsl"),
        source: wgpu::ShaderSource::Wgsl(format!("{SHADER}\n{distant}").into()),
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
