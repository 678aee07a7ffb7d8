//! Slices of a prefiltered environment on the GPU: the light's points summed under a lobe, a pixel an
//! invocation. In f32 a sum of points is exact where the harmonics of [`spectrum`](super::spectrum) would
//! drown a sky beside its sun.

use glam::{Vec3, Vec4};
use wgpu::BufferUsages;

use super::source::{Cap, Source};
use crate::scene::Environment;
use lobelia_base::error::Result;
use lobelia_gpu::Gpu;
use lobelia_gpu::environment::{PREFILTER, Task};

/// Invocations of a workgroup, as in the shader.
const GROUP: u32 = 64;
/// Lobe terms a submission: drivers end work that takes seconds.
const TERMS: u64 = 1 << 28;

/// The pipeline on its device.
pub(super) struct Prefilter<'a> {
    gpu: &'a Gpu,
    pipeline: wgpu::ComputePipeline,
}

impl<'a> Prefilter<'a> {
    /// Builds the pipeline.
    ///
    /// # Errors
    /// A failure when the driver refuses.
    pub(super) fn new(gpu: &'a Gpu) -> Result<Self> {
        let pipeline = gpu.guarded(|| {
            let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("prefilter.wgsl"),
                source: wgpu::ShaderSource::Wgsl(PREFILTER.into()),
            });
            Ok(gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some("prefilter"),
                layout: None,
                module: &module,
                entry_point: Some("prefilter"),
                compilation_options: Default::default(),
                cache: None,
            }))
        })?;
        Ok(Self { gpu, pipeline })
    }

    /// S^(1/n) for one exponent.
    ///
    /// # Errors
    /// A failure when the maps do not fit the device or the driver refuses.
    pub(super) fn slice(&self, source: &Source, cap: &Cap, height: usize) -> Result<Environment> {
        let width = 2 * height;
        let values = self.gpu.guarded(|| self.run(source, cap, [width as u32, height as u32]))?;
        let pixels: Vec<Vec3> = values.iter().map(|value| value.truncate()).collect();
        Ok(Environment { width, height, pixels: pixels.into(), rotation: 0.0 })
    }

    fn run(&self, source: &Source, cap: &Cap, map: [u32; 2]) -> Result<Vec<Vec4>> {
        let gpu = self.gpu;
        let points: (Vec<Vec4>, Vec<Vec4>) =
            source.points.iter().map(|(d, f)| (d.extend(0.0), f.extend(0.0))).unzip();
        let pixels = map[0] * map[1];
        let directions = gpu.buffer("directions", &points.0, BufferUsages::STORAGE)?;
        let flux = gpu.buffer("flux", &points.1, BufferUsages::STORAGE)?;
        let zeros = vec![Vec4::ZERO; pixels as usize];
        let out = gpu.buffer("map", &zeros, BufferUsages::STORAGE | BufferUsages::COPY_SRC)?;
        // Points of light within a lobe: its share of the sphere.
        let terms = (0.5 * f64::from(1.0 - cap.least_cosine) * points.1.len() as f64).max(1.0) as u64;
        let batch = ((TERMS / terms) as u32).min(pixels).next_multiple_of(GROUP).max(GROUP);
        let batch = batch.min(gpu.device.limits().max_compute_workgroups_per_dimension * GROUP);
        for first in (0..pixels).step_by(batch as usize) {
            let task = Task {
                source: [source.width as u32, source.height as u32],
                map,
                n: cap.n,
                least_cosine: cap.least_cosine,
                reach: cap.reach,
                first,
            };
            let task = gpu.buffer("task", &[task], BufferUsages::UNIFORM)?;
            let buffers = [&task, &directions, &flux, &out];
            let entries: Vec<_> = (0u32..)
                .zip(buffers)
                .map(|(binding, buffer)| wgpu::BindGroupEntry {
                    binding,
                    resource: buffer.as_entire_binding(),
                })
                .collect();
            let bindings = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("prefilter"),
                layout: &self.pipeline.get_bind_group_layout(0),
                entries: &entries,
            });
            let mut encoder = gpu.device.create_command_encoder(&Default::default());
            {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                pass.set_pipeline(&self.pipeline);
                pass.set_bind_group(0, &bindings, &[]);
                pass.dispatch_workgroups(batch.min(pixels - first).div_ceil(GROUP), 1, 1);
            }
            gpu.queue.submit([encoder.finish()]);
        }
        gpu.read_buffer(&out)
    }
}

#[cfg(test)]
mod tests {
    use super::super::accuracy::{self, Judge};
    use super::super::prefilter;
    use super::super::spectrum::Spectrum;
    use super::*;

    #[test]
    fn maps_of_the_gpu_and_of_the_cpu_agree_to_their_error() {
        let gpu = match Gpu::open() {
            Ok(gpu) => gpu,
            Err(error) => return println!("skipped: {error}"),
        };
        let prefilter = Prefilter::new(&gpu).unwrap();
        let environment = Environment::from_function(64, 32, |d| {
            let sun = if d.dot(Vec3::new(0.5, 0.6, 0.62)) > 0.99 { 1e5 } else { 0.0 };
            Vec3::new(0.5 + 0.4 * d.x, 0.3 + sun, 0.2 + 0.1 * d.z)
        });
        let judge = Judge::new(&environment);
        let error = 0.03;
        for n in [0.5, 1.0, 20.0, 150.0] {
            let (source, cap) = accuracy::gathered(&environment, n, error);
            let height = accuracy::map_height(n, error) / 2;
            let spectrum = Spectrum::new(&environment, &[n], error);
            let cpu = prefilter::slice(&spectrum, n, error, height);
            let gpu = prefilter.slice(&source, &cap, height).unwrap();
            let light = |root: &Vec3| root.map(|root| root.powf(n));
            let errors = cpu
                .pixels
                .iter()
                .zip(gpu.pixels.iter())
                .map(|(cpu, gpu)| f64::from(judge.relative(light(gpu), light(cpu), n)).powi(2));
            let rms = (errors.sum::<f64>() / cpu.pixels.len() as f64).sqrt();
            println!("n = {n}: {rms}");
            assert!(rms < f64::from(error) / 2.0, "{n}: {rms}");
        }
    }
}
