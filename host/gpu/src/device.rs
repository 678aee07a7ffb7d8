//! The GPU: finding one, uploading, drawing and reading back, with every fault of the driver as an [`Error`].

use bytemuck::Pod;
use glam::Vec4;
use wgpu::util::DeviceExt;

#[cfg(unix)]
use crate::noise;
use lobelia_base::error::{Error, Result};

/// A device that is ready for work.
pub struct Gpu {
    /// Makes resources.
    pub device: wgpu::Device,
    /// Takes work.
    pub queue: wgpu::Queue,
    adapter: wgpu::Adapter,
}

/// What is wrong with the GPU, as a failure that a caller can fall back on.
fn fault(what: &str, error: impl std::fmt::Display) -> Error {
    let text = error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    Error::failure(format!("GPU: {what}: {text}"))
}

impl Gpu {
    /// Opens the fastest adapter.
    ///
    /// # Errors
    /// A failure when there is no adapter or no driver.
    pub fn open() -> Result<Self> {
        #[cfg(unix)]
        return noise::kept_off(Self::open_fastest);
        #[cfg(not(unix))]
        Self::open_fastest()
    }

    fn open_fastest() -> Result<Self> {
        if wgpu::Instance::enabled_backend_features().is_empty() {
            return Err(Error::failure("GPU: this build has no graphics interface for this system"));
        }
        let mut description = wgpu::InstanceDescriptor::new_without_display_handle();
        description.backends = wgpu::Backends::PRIMARY;
        let instance = wgpu::Instance::new(description);
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..Default::default()
        };
        let adapter = pollster::block_on(instance.request_adapter(&options)).map_err(|_| {
            Error::failure(
                "GPU: no adapter found; install a Vulkan driver (mesa-vulkan-drivers draws on the CPU)",
            )
        })?;
        let description = wgpu::DeviceDescriptor {
            label: Some("lobelia"),
            // Multisampled float targets, where the adapter has them.
            required_features: adapter.features() & wgpu::Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES,
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&description))
            .map_err(|error| fault("the device does not open", error))?;
        Ok(Self { device, queue, adapter })
    }

    /// Name and driver.
    pub fn name(&self) -> String {
        let info = self.adapter.get_info();
        format!("{} ({}, {})", info.name, info.backend, info.driver_info.trim())
    }

    /// Whether the adapter computes on the CPU, as Mesa's lavapipe does.
    pub fn is_software(&self) -> bool {
        self.adapter.get_info().device_type == wgpu::DeviceType::Cpu
    }

    /// The first of `wanted` (a format and a number of samples) that can be drawn to, resolved and copied.
    pub fn target(&self, wanted: &[(wgpu::TextureFormat, u32)]) -> Option<(wgpu::TextureFormat, u32)> {
        let usages = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        wanted.iter().copied().find(|&(format, samples)| {
            let features = self.adapter.get_texture_format_features(format);
            let specific =
                self.device.features().contains(wgpu::Features::TEXTURE_ADAPTER_SPECIFIC_FORMAT_FEATURES);
            let resolves =
                samples == 1 || features.flags.contains(wgpu::TextureFormatFeatureFlags::MULTISAMPLE_RESOLVE);
            let guaranteed = specific || samples == 1 || format == wgpu::TextureFormat::Rgba16Float;
            features.allowed_usages.contains(usages)
                && features.flags.sample_count_supported(samples)
                && resolves
                && guaranteed
        })
    }

    /// Does work whose faults (validation, memory, driver) become errors instead of panics.
    ///
    /// # Errors
    /// The work's own, or a failure that quotes the driver.
    pub fn guarded<T>(&self, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let scopes =
            [wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::OutOfMemory, wgpu::ErrorFilter::Internal]
                .map(|filter| self.device.push_error_scope(filter));
        let done = work();
        let mut first = None;
        for scope in scopes.into_iter().rev() {
            first = first.or(pollster::block_on(scope.pop()));
        }
        match first {
            Some(error) => Err(fault("the driver refuses", error)),
            None => done,
        }
    }

    /// A buffer with the given content; an empty one gets one element of zeros, since bindings cannot be
    /// empty.
    ///
    /// # Errors
    /// A failure when the content is larger than the device can bind.
    pub fn buffer<T: Pod>(
        &self,
        label: &str,
        content: &[T],
        usage: wgpu::BufferUsages,
    ) -> Result<wgpu::Buffer> {
        let bytes: &[u8] = bytemuck::cast_slice(content);
        let limits = self.device.limits();
        let largest = if usage.contains(wgpu::BufferUsages::STORAGE) {
            limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
        } else {
            limits.max_buffer_size
        };
        if bytes.len() as u64 > largest {
            return Err(fault(label, format!("{} bytes are more than the {largest} it takes", bytes.len())));
        }
        let zeros = vec![0u8; size_of::<T>()];
        let contents = if bytes.is_empty() { &zeros } else { bytes };
        Ok(self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some(label),
            contents,
            usage,
        }))
    }

    /// Runs the encoder's work, then reads a four-channel float texture back, row by row.
    ///
    /// # Errors
    /// A failure when the device is lost or out of memory.
    pub fn read_texture(
        &self,
        mut encoder: wgpu::CommandEncoder,
        texture: &wgpu::Texture,
    ) -> Result<Vec<Vec4>> {
        let (width, height) = (texture.width(), texture.height());
        let half = texture.format() == wgpu::TextureFormat::Rgba16Float;
        let row_bytes = width * if half { 8 } else { 16 };
        let stride = row_bytes.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("picture"),
            size: u64::from(stride) * u64::from(height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(stride),
                    rows_per_image: None,
                },
            },
            texture.size(),
        );
        self.queue.submit([encoder.finish()]);
        let view = self.mapped(&buffer)?;
        let rows = view.chunks_exact(stride as usize).map(|row| &row[..row_bytes as usize]);
        Ok(rows
            .flat_map(|row| row.chunks_exact(if half { 8 } else { 16 }))
            .map(|pixel| {
                Vec4::from_array(std::array::from_fn(|k| {
                    if half {
                        half_to_f32(u16::from_le_bytes([pixel[2 * k], pixel[2 * k + 1]]))
                    } else {
                        f32::from_le_bytes([
                            pixel[4 * k],
                            pixel[4 * k + 1],
                            pixel[4 * k + 2],
                            pixel[4 * k + 3],
                        ])
                    }
                }))
            })
            .collect())
    }

    /// Reads a storage buffer of four-channel floats back, after all work that was submitted.
    ///
    /// # Errors
    /// A failure when the device is lost or out of memory.
    pub fn read_buffer(&self, source: &wgpu::Buffer) -> Result<Vec<Vec4>> {
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("values"),
            size: source.size(),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(source, 0, &buffer, 0, source.size());
        self.queue.submit([encoder.finish()]);
        let view = self.mapped(&buffer)?;
        Ok(view.chunks_exact(16).map(bytemuck::pod_read_unaligned).collect())
    }

    /// Waits until all work that was submitted is done.
    ///
    /// # Errors
    /// A failure when the device is lost.
    pub fn wait(&self) -> Result<()> {
        let done = self.device.poll(wgpu::PollType::wait_indefinitely());
        done.map(drop).map_err(|error| fault("its work cannot be waited for", error))
    }

    /// Waits for a buffer that is to be read.
    fn mapped(&self, buffer: &wgpu::Buffer) -> Result<wgpu::BufferView> {
        let (sender, receiver) = std::sync::mpsc::channel();
        buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver is gone only when the wait below has failed, which is told already.
            let _ = sender.send(result);
        });
        self.wait()?;
        // Another thread that waits for its own work may be the one that calls back.
        match receiver.recv() {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(fault("its work cannot be read back", error)),
            Err(_) => return Err(fault("its work cannot be read back", "the device does not answer")),
        }
        buffer.get_mapped_range(..).map_err(|error| fault("its work cannot be read back", error))
    }
}

/// IEEE 754 binary16 to f32.
fn half_to_f32(half: u16) -> f32 {
    let sign = if half & 0x8000 == 0 { 1.0 } else { -1.0 };
    let (exponent, fraction) = (i32::from(half >> 10 & 0x1f), f32::from(half & 0x3ff));
    sign * match exponent {
        0 => fraction * 2f32.powi(-24),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1.0 + fraction / 1024.0) * 2f32.powi(exponent - 15),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_floats_are_read_exactly() {
        for (bits, value) in [
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x0001, 2f32.powi(-24)),
            (0x3555, 0.333_251_95),
        ] {
            assert_eq!(half_to_f32(bits), value);
        }
        assert_eq!(half_to_f32(0x7c00), f32::INFINITY);
        assert!(half_to_f32(0x7e00).is_nan());
    }

    #[test]
    fn faults_of_the_driver_are_errors_and_no_panics() {
        let gpu = match Gpu::open() {
            Ok(gpu) => gpu,
            Err(error) => return println!("skipped: {error}"),
        };
        let error = gpu
            .guarded(|| {
                let _module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
                    label: None,
                    source: wgpu::ShaderSource::Wgsl("this is no shader".into()),
                });
                Ok(())
            })
            .unwrap_err();
        assert_eq!(error.exit_code(), 1);
        assert!(error.to_string().starts_with("GPU: the driver refuses"), "{error}");
    }
}
