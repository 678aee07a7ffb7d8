//! The shader's pipelines, the samples in the device's memory, and the dispatches.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use bytemuck::Zeroable;
use glam::{Vec3, Vec4};
use wgpu::BufferUsages;

use super::super::lm::Limits;
use super::super::model::{Model, ModelLobe};
use super::super::separable::layout::Family;
use super::super::separable::normal::Amplitudes;
use lobelia_base::error::Result;
use lobelia_gpu::Gpu;
use lobelia_gpu::fit::{Fit, Job, SHADER, Texel};

/// Sets a submission: drivers end work that takes seconds.
const SETS: u32 = 2048;
/// Directions of the bank of starts, as in the shader.
pub(super) const DIRECTIONS: usize = 24;
/// Exponents of the bank: 1, 2, 4, …
pub(super) const EXPONENTS: usize = 10;

/// The set without lobes.
pub(super) fn diffuse(texel: usize, at: &Amplitudes) -> Fit {
    Fit::diffuse(texel, at.cost as f32, Vec3::from_array(at.x.map(|x| x[0] as f32)))
}

/// The first `lobes` shapes of a set.
pub(super) fn model(fit: &Fit, lobes: usize) -> Model {
    let lobe = |lobe: &Vec4| ModelLobe::unit(lobe.truncate().as_dvec3(), f64::from(lobe.w));
    Model {
        beta: f64::from(fit.beta),
        lobes: fit.lobes[..lobes].iter().map(lobe).collect(),
        ..Model::default()
    }
}

/// The samples of a batch of texels.
#[derive(Debug, Default)]
pub(super) struct Samples {
    /// Products of directions (xx, yy, zz, xy), `poses` places a texel.
    pub(super) products: Vec<Vec4>,
    /// Roots of weights and goals.
    pub(super) aimed: Vec<Vec4>,
    /// Texels.
    pub(super) texels: Vec<Texel>,
    /// Places a texel.
    pub(super) poses: usize,
    /// Channels that are fitted together.
    pub(super) channels: usize,
    /// Whether ρ_d is an unknown.
    pub(super) diffuse: bool,
}

/// The same in the device's memory.
pub(super) struct Uploaded {
    buffers: [wgpu::Buffer; 3],
    job: Job,
}

/// What the shader does with every set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Entry {
    Minimise,
    Spread,
    Score,
}

/// The device with the pipelines that were needed so far.
pub(super) struct Kernels {
    pub(super) gpu: Gpu,
    layout: wgpu::BindGroupLayout,
    pipelines: Mutex<BTreeMap<(Entry, bool, usize), wgpu::ComputePipeline>>,
}

impl Kernels {
    /// Opens the GPU.
    ///
    /// # Errors
    /// A failure when there is none or it refuses.
    pub(super) fn open() -> Result<Self> {
        let gpu = Gpu::open()?;
        let layout = gpu.guarded(|| Ok(layout(&gpu.device)))?;
        Ok(Self { gpu, layout, pipelines: Mutex::default() })
    }

    /// Texels whose samples the device takes at once.
    pub(super) fn batch(&self, poses: usize) -> usize {
        let limits = self.gpu.device.limits();
        let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size).min(1 << 26);
        (most as usize / (size_of::<Vec4>() * poses.max(1))).clamp(1, 4096)
    }

    /// Brings samples to the device.
    ///
    /// # Errors
    /// A failure when they do not fit there.
    pub(super) fn upload(&self, samples: &Samples) -> Result<Uploaded> {
        let gpu = &self.gpu;
        gpu.guarded(|| {
            let buffers = [
                gpu.buffer("products", &samples.products, BufferUsages::STORAGE)?,
                gpu.buffer("samples", &samples.aimed, BufferUsages::STORAGE)?,
                gpu.buffer("texels", &samples.texels, BufferUsages::STORAGE)?,
            ];
            let job = Job {
                poses: samples.poses as u32,
                channels: samples.channels as u32,
                diffuse: samples.diffuse.into(),
                ..Job::zeroed()
            };
            Ok(Uploaded { buffers, job })
        })
    }

    /// Lowers the cost of sets of `lobes` lobes as far as the limits allow. Anisotropic sets whose lobes are
    /// still isotropic (`fresh`) first find their direction.
    ///
    /// # Errors
    /// A failure when the driver refuses.
    pub(super) fn minimise(
        &self,
        samples: &Uploaded,
        family: Family,
        lobes: usize,
        limits: Limits,
        fits: &mut Vec<Fit>,
        fresh: bool,
    ) -> Result<()> {
        let anisotropic = family == Family::Anisotropic;
        let mut steps = vec![(Entry::Minimise, anisotropic)];
        if anisotropic && fresh {
            steps = vec![(Entry::Minimise, false), (Entry::Spread, true), (Entry::Minimise, true)];
        }
        self.gpu.guarded(|| {
            let buffer = self.gpu.buffer("sets", fits, BufferUsages::STORAGE | BufferUsages::COPY_SRC)?;
            let job = Job {
                iterations: limits.iterations as u32,
                tolerance: limits.tolerance as f32,
                ..samples.job
            };
            let unused = self.gpu.buffer("scores", &[0f32], BufferUsages::STORAGE)?;
            for (entry, anisotropic) in steps {
                self.run((entry, anisotropic, lobes), samples, job, [&buffer, &unused], fits.len())?;
            }
            *fits = self
                .gpu
                .read_buffer(&buffer)?
                .chunks_exact(10)
                .map(|fit| bytemuck::must_cast(as_array(fit)))
                .collect();
            Ok(())
        })
    }

    /// How much each shape of the bank would lower the cost of sets of `lobes` lobes:
    /// [set][direction][exponent].
    ///
    /// # Errors
    /// A failure when the driver refuses.
    pub(super) fn scores(&self, samples: &Uploaded, lobes: usize, fits: &[Fit]) -> Result<Vec<f32>> {
        self.gpu.guarded(|| {
            let sets = self.gpu.buffer("sets", fits, BufferUsages::STORAGE)?;
            let zeros = vec![0f32; fits.len() * DIRECTIONS * EXPONENTS];
            let scores = self.gpu.buffer("scores", &zeros, BufferUsages::STORAGE | BufferUsages::COPY_SRC)?;
            self.run((Entry::Score, true, lobes), samples, samples.job, [&sets, &scores], fits.len())?;
            Ok(bytemuck::cast_slice(&self.gpu.read_buffer(&scores)?).to_vec())
        })
    }

    fn run(
        &self,
        key: (Entry, bool, usize),
        samples: &Uploaded,
        job: Job,
        [fits, scores]: [&wgpu::Buffer; 2],
        count: usize,
    ) -> Result<()> {
        let pipeline = self.pipeline(key);
        let device = &self.gpu.device;
        let (lobes, unknowns) = (key.2 as u32, unknowns(key) as u32);
        for first in (0..count as u32).step_by(SETS as usize) {
            let job = Job { lobes, unknowns, first, ..job };
            let job = self.gpu.buffer("job", &[job], BufferUsages::UNIFORM)?;
            let [products, aimed, texels] = &samples.buffers;
            let entries: Vec<_> = (0u32..)
                .zip([&job, products, aimed, texels, fits, scores])
                .map(|(binding, buffer)| wgpu::BindGroupEntry {
                    binding,
                    resource: buffer.as_entire_binding(),
                })
                .collect();
            let bindings = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("fit"),
                layout: &self.layout,
                entries: &entries,
            });
            let mut encoder = device.create_command_encoder(&Default::default());
            {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                pass.set_pipeline(&pipeline);
                pass.set_bind_group(0, &bindings, &[]);
                pass.dispatch_workgroups((count as u32 - first).min(SETS), 1, 1);
            }
            self.gpu.queue.submit([encoder.finish()]);
        }
        Ok(())
    }

    fn pipeline(&self, key: (Entry, bool, usize)) -> wgpu::ComputePipeline {
        let mut pipelines = self.pipelines.lock().unwrap_or_else(PoisonError::into_inner);
        pipelines.entry(key).or_insert_with(|| self.build(key)).clone()
    }

    fn build(&self, (entry, anisotropic, lobes): (Entry, bool, usize)) -> wgpu::ComputePipeline {
        // Families are numbered as in the shader.
        let (family, derivatives) = match (entry, anisotropic) {
            (Entry::Minimise, false) => (0, 2),
            (Entry::Minimise, true) => (1, 4),
            (Entry::Spread, _) => (2, 4),
            (Entry::Score, _) => (1, 0),
        };
        let unknowns = unknowns((entry, anisotropic, lobes));
        let constants = [
            ("LOBES", lobes),
            ("SLOTS", lobes.max(1)),
            ("FAMILY", family),
            ("DERIVATIVES", derivatives),
            ("FORMS", derivatives.max(1)),
            ("UNKNOWNS", unknowns),
            ("MOST", unknowns.max(lobes + 1)),
        ];
        let mut source: String =
            constants.iter().map(|(name, value)| format!("const {name} = {value}u;\n")).collect();
        source += SHADER;
        let device = &self.gpu.device;
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("fit.wgsl"),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("fit"),
            bind_group_layouts: &[Some(&self.layout)],
            ..Default::default()
        });
        device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("fit"),
            layout: Some(&layout),
            module: &module,
            entry_point: Some(match entry {
                Entry::Minimise => "minimise",
                Entry::Spread => "spread",
                Entry::Score => "score",
            }),
            compilation_options: Default::default(),
            cache: None,
        })
    }
}

/// Unknowns of the shapes, at least 1.
fn unknowns((entry, anisotropic, lobes): (Entry, bool, usize)) -> usize {
    let family = match (entry, anisotropic) {
        (Entry::Spread, _) => Family::Split,
        (_, true) => Family::Anisotropic,
        (_, false) => Family::Isotropic,
    };
    family.size(lobes).max(1)
}

/// A set's record.
fn as_array(record: &[Vec4]) -> [Vec4; 10] {
    std::array::from_fn(|k| record[k])
}

/// One uniform buffer, three lists that are read, two that are written.
fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    use wgpu::BufferBindingType::{Storage, Uniform};
    let (read, write) = (Storage { read_only: true }, Storage { read_only: false });
    let entries: Vec<_> = (0u32..)
        .zip([Uniform, read, read, read, write, write])
        .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
            count: None,
        })
        .collect();
    device
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("fit"), entries: &entries })
}
