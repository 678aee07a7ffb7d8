//! The draw pass of `lights`: targets, pipelines, bindings.

use std::ops::Range;
use std::time::Instant;

use glam::Vec4;
use wgpu::{BufferUsages, TextureFormat, TextureUsages};

use super::upload::{self, Shape, Uploads};
use super::{Distant, Filtering, Settings};
use crate::render::shading;
use crate::render::stage::Changes;
use crate::render::storage::Storage;
use crate::scene::{Camera, Scene};
use lobelia_base::error::{Error, Result};
use lobelia_base::report::cpu_seconds;
use lobelia_gpu::Gpu;
use lobelia_gpu::lights::{Material, NOT_DISTANT, SHADER, View};

/// Seconds that a round of frames may take.
const ROUND_SECONDS: f64 = 2.0;
const DEPTH: TextureFormat = TextureFormat::Depth32Float;
/// Numbers of samples that adapters may have, from the most down.
const SAMPLES: [u32; 5] = [16, 8, 4, 2, 1];

/// Everything of one scene on the device.
pub(super) struct Pass {
    /// For objects that are whole, and for those with a mask.
    pipelines: [wgpu::RenderPipeline; 2],
    layout: wgpu::BindGroupLayout,
    /// What light from afar reads, and how it is bound.
    distant: Option<(Distant, wgpu::BindGroupLayout, wgpu::BindGroup)>,
    /// What the shader reads, but for the view.
    buffers: [wgpu::Buffer; 8],
    /// Those of objects, then of rectangular lights.
    materials: Vec<Material>,
    shadows: bool,
    lamps: usize,
    offset: f32,
    /// Triangles of every object, and whether it has a mask.
    runs: Vec<(Range<u32>, bool)>,
    /// Distance of the near plane.
    near: f32,
    format: TextureFormat,
    samples: u32,
}

/// The textures that a view is drawn to.
struct Targets {
    picture: wgpu::Texture,
    /// Where there is more than one sample a pixel.
    samples: Option<wgpu::Texture>,
    depth: wgpu::Texture,
}

impl Pass {
    /// Uploads a scene and builds the pipelines for as many samples a pixel as wanted, or the most below that
    /// the adapter can.
    pub(super) fn new(
        gpu: &Gpu,
        uploads: &Uploads,
        near: f32,
        settings: &Settings,
        distant: Option<Distant>,
    ) -> Result<Self> {
        let wanted: Vec<_> = (SAMPLES.into_iter().filter(|&samples| samples <= settings.samples))
            .flat_map(|samples| {
                [(TextureFormat::Rgba32Float, samples), (TextureFormat::Rgba16Float, samples)]
            })
            .collect();
        let (format, samples) =
            gpu.target(&wanted).ok_or_else(|| Error::failure("GPU: it cannot draw to float textures"))?;
        let storage = BufferUsages::STORAGE;
        let mut layouts = vec![layout(gpu, 9)];
        layouts.extend(distant.iter().map(|distant| layout(gpu, distant.buffers.len() as u32)));
        let shader = distant.as_ref().map_or(NOT_DISTANT, |distant| distant.shader);
        let shape = &uploads.shape;
        Ok(Self {
            pipelines: pipelines(gpu, &layouts, (format, samples), settings, uploads.extended, shader),
            distant: distant.map(|distant| {
                let group = bind(gpu, &layouts[1], distant.buffers.iter());
                (distant, layouts[1].clone(), group)
            }),
            layout: layouts.swap_remove(0),
            buffers: [
                gpu.buffer("lamps", &uploads.lamps, storage)?,
                gpu.buffer("materials", &uploads.materials, storage)?,
                gpu.buffer("texels", &uploads.starts, storage)?,
                gpu.buffer("coefficients", &uploads.words, storage)?,
                gpu.buffer("vertices", shape.vertices(), storage)?,
                gpu.buffer("triangles", &shape.mesh.triangles, storage)?,
                gpu.buffer("tree", &shape.nodes, storage)?,
                gpu.buffer("leaves", &shape.leaves, storage)?,
            ],
            lamps: uploads.lamps.len(),
            offset: shape.offset,
            runs: shape.runs.iter().cloned().zip(uploads.materials.iter().map(|m| m.mask[1] > 0)).collect(),
            materials: uploads.materials.clone(),
            shadows: settings.shadows,
            near,
            format,
            samples,
        })
    }

    /// Goes on to another state of the same scene, of which it uploads what differs.
    pub(super) fn follow(&mut self, gpu: &Gpu, scene: &Scene, changes: Changes, near: f32) -> Result<()> {
        let storage = BufferUsages::STORAGE;
        if changes.lights {
            self.buffers[0] = gpu.buffer("lamps", &shading::lamps(&scene.lights), storage)?;
            let shining: Vec<Material> = upload::shining(scene).collect();
            if !shining.is_empty() {
                self.materials.truncate(scene.objects.len());
                self.materials.extend(shining);
                self.buffers[1] = gpu.buffer("materials", &self.materials, storage)?;
            }
        }
        if changes.triangles {
            let shape = Shape::new(scene, self.shadows);
            self.buffers[4] = gpu.buffer("vertices", shape.vertices(), storage)?;
            self.buffers[5] = gpu.buffer("triangles", &shape.mesh.triangles, storage)?;
            self.buffers[6] = gpu.buffer("tree", &shape.nodes, storage)?;
            self.buffers[7] = gpu.buffer("leaves", &shape.leaves, storage)?;
            (self.offset, self.near) = (shape.offset, near);
        }
        Ok(())
    }

    /// Whether there is light from afar.
    pub(super) fn has_distant(&self) -> bool {
        self.distant.is_some()
    }

    /// Gives the shader of light from afar another uniform.
    pub(super) fn turn(&mut self, gpu: &Gpu, uniform: wgpu::Buffer) {
        if let Some((distant, layout, group)) = &mut self.distant {
            distant.buffers[0] = uniform;
            *group = bind(gpu, layout, distant.buffers.iter());
        }
    }

    /// What there is to say of the pictures.
    pub(super) fn note(&self) -> Option<String> {
        precision(self.format)
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
        let view = View {
            projection: super::projection(camera, self.near),
            eye: camera.position.extend(self.lamps as f32),
            offset: Vec4::splat(self.offset),
        };
        let view = gpu.buffer("view", &[view], BufferUsages::UNIFORM)?;
        Ok(bind(gpu, &self.layout, std::iter::once(&view).chain(&self.buffers)))
    }

    /// The textures for a view.
    fn targets(&self, gpu: &Gpu, camera: &Camera) -> Targets {
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
        Targets {
            picture: texture("picture", self.format, 1, target | TextureUsages::COPY_SRC),
            samples: (self.samples > 1).then(|| texture("samples", self.format, self.samples, target)),
            depth: texture("depth", DEPTH, self.samples, target),
        }
    }

    /// Draws all objects and reads the picture back.
    pub(super) fn draw(&self, gpu: &Gpu, camera: &Camera) -> Result<Vec<Vec4>> {
        let targets = self.targets(gpu, camera);
        let encoder = self.encode(gpu, &targets, &self.bindings(gpu, camera)?);
        gpu.read_texture(encoder, &targets.picture)
    }

    /// Seconds a frame, the least of `rounds` of `frames` each, of fewer where a frame takes long. Of a
    /// driver in software, seconds of CPU time, which other work on the machine changes little.
    pub(super) fn frame_seconds(&self, gpu: &Gpu, camera: &Camera, rounds: u32, frames: u32) -> Result<f64> {
        let (targets, bindings) = (self.targets(gpu, camera), self.bindings(gpu, camera)?);
        let timed = |frames: u32| -> Result<f64> {
            let clock = || gpu.is_software().then(cpu_seconds).flatten();
            let (start, cpu_start) = (Instant::now(), clock());
            gpu.queue.submit((0..frames).map(|_| self.encode(gpu, &targets, &bindings).finish()));
            gpu.wait()?;
            let cpu = clock().zip(cpu_start).map(|(end, start)| end - start).filter(|&seconds| seconds > 0.0);
            Ok(cpu.unwrap_or(start.elapsed().as_secs_f64()) / f64::from(frames))
        };
        // The first frame is slower: drivers compile with it.
        timed(1)?;
        let one = timed(1)?;
        let affordable = (ROUND_SECONDS / one) as u32;
        (0..rounds.min(affordable)).try_fold(one, |least, _| Ok(least.min(timed(frames.min(affordable))?)))
    }

    /// The commands that draw all objects.
    fn encode(&self, gpu: &Gpu, targets: &Targets, bindings: &wgpu::BindGroup) -> wgpu::CommandEncoder {
        let view = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let (picture, depth) = (view(&targets.picture), view(&targets.depth));
        let samples = targets.samples.as_ref().map(view);
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("lights"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: samples.as_ref().unwrap_or(&picture),
                depth_slice: None,
                resolve_target: samples.is_some().then_some(&picture),
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: if samples.is_some() { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store },
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
        pass.set_bind_group(0, bindings, &[]);
        if let Some((.., distant)) = &self.distant {
            pass.set_bind_group(1, distant, &[]);
        }
        for (object, (run, masked)) in (0u32..).zip(&self.runs) {
            pass.set_pipeline(&self.pipelines[usize::from(*masked)]);
            // The instance's number tells the shader which material to take.
            pass.draw(3 * run.start..3 * run.end, object..object + 1);
        }
        drop(pass);
        encoder
    }
}

/// Whole buffers as a group, in the order of their bindings.
fn bind<'a>(
    gpu: &Gpu,
    layout: &wgpu::BindGroupLayout,
    buffers: impl Iterator<Item = &'a wgpu::Buffer>,
) -> wgpu::BindGroup {
    let entries: Vec<_> = (0u32..)
        .zip(buffers)
        .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
        .collect();
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("lights"),
        layout,
        entries: &entries,
    })
}

/// What there is to say of pictures that are drawn in a format.
fn precision(format: TextureFormat) -> Option<String> {
    let message = "this GPU draws in floating point of 16 bits alone: values have three digits, and none is \
         above 65,504; --samples 1 may get 32 bits";
    (format == TextureFormat::Rgba16Float).then(|| message.into())
}

/// A uniform, then storage to read, `count` in all.
fn layout(gpu: &Gpu, count: u32) -> wgpu::BindGroupLayout {
    let entry = |binding| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
        ty: wgpu::BindingType::Buffer {
            ty: match binding {
                0 => wgpu::BufferBindingType::Uniform,
                _ => wgpu::BufferBindingType::Storage { read_only: true },
            },
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    };
    gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("lights"),
        entries: &(0..count).map(entry).collect::<Vec<_>>(),
    })
}

/// The pipelines for a target's format and samples: for objects that are whole, and for those with a mask.
fn pipelines(
    gpu: &Gpu,
    layouts: &[wgpu::BindGroupLayout],
    (format, samples): (TextureFormat, u32),
    settings: &Settings,
    extended: bool,
    distant: &str,
) -> [wgpu::RenderPipeline; 2] {
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("lights.wgsl"),
        source: wgpu::ShaderSource::Wgsl(format!("{SHADER}\n{distant}").into()),
    });
    let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("lights"),
        bind_group_layouts: &layouts.iter().map(Some).collect::<Vec<_>>(),
        ..Default::default()
    });
    let flag = |value: bool| f64::from(u8::from(value));
    let constants = [
        ("GROUP", settings.storage.group() as f64),
        ("SCALED", flag(settings.storage == Storage::Bits8Scaled)),
        ("EXTENDED", flag(extended)),
        ("COEFFICIENTS", flag(settings.filtering == Filtering::Coefficients)),
        ("SHADED", flag(settings.filtering == Filtering::Shaded)),
        ("ANISOTROPY", f64::from(settings.anisotropy)),
        ("SHADOWS", flag(settings.shadows)),
        ("SAMPLES", f64::from(samples)),
        ("ACROSS", f64::from(settings.across())),
    ];
    let options = wgpu::PipelineCompilationOptions { constants: &constants, ..Default::default() };
    ["shade", "shade_cut_out"].map(|shade| {
        gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("lights"),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("place"),
                compilation_options: options.clone(),
                buffers: &[],
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
                entry_point: Some(shade),
                compilation_options: options.clone(),
                targets: &[Some(format.into())],
            }),
            multiview_mask: None,
            cache: None,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_in_16_bits_are_said_to_be() {
        assert!(precision(TextureFormat::Rgba16Float).unwrap().contains("16 bits"));
        assert_eq!(precision(TextureFormat::Rgba32Float), None);
    }
}
