//! The adapter and device, and the small things that every stage needs of them.

use std::sync::{Arc, Mutex};

use wgpu::util::DeviceExt;

use crate::math::Rgb;
use crate::model::ViewError;

/// Why the GPU could not do its work.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    #[error("no usable GPU adapter{wanted}; found: {found}; install a Vulkan, Metal or DirectX 12 driver")]
    NoAdapter {
        /// " named …" where one was asked for.
        wanted: String,
        found: String,
    },
    #[error("GPU adapter {adapter}: no device: {reason}")]
    NoDevice { adapter: String, reason: String },
    #[error("{what} needs {needed} {unit}, more than this GPU's {limit}; {help}")]
    TooLarge { what: String, needed: u64, unit: &'static str, limit: u64, help: &'static str },
    #[error(transparent)]
    View(#[from] ViewError),
    #[error("the GPU failed: {0}")]
    Failed(String),
}

/// A device with its queue. Errors that WebGPU reports late are kept until [`Gpu::check`].
pub struct Gpu {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    /// The adapter's name, for reports.
    pub name: String,
    failure: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Opens the fastest adapter; `WGPU_ADAPTER_NAME` narrows the choice to adapters whose name it is part of, letter case
    /// ignored.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] and [`GpuError::NoDevice`], each with what was found instead.
    pub fn new() -> Result<Self, GpuError> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        let adapter = Self::best(pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all())))?;
        let name = adapter.get_info().name;
        let (device, queue) = pollster::block_on(adapter.request_device(&Self::descriptor(&adapter)))
            .map_err(|e| GpuError::NoDevice { adapter: name.clone(), reason: e.to_string() })?;
        Ok(Self::from_device(device, queue, name))
    }

    /// What is asked of an adapter's device.
    pub fn descriptor(adapter: &wgpu::Adapter) -> wgpu::DeviceDescriptor<'static> {
        let available = adapter.limits();
        // WebGPU's defaults, but for sizes: those that this adapter allows.
        let required_limits = wgpu::Limits {
            max_texture_dimension_2d: available.max_texture_dimension_2d,
            max_texture_array_layers: available.max_texture_array_layers,
            max_buffer_size: available.max_buffer_size,
            max_storage_buffer_binding_size: available.max_storage_buffer_binding_size,
            ..wgpu::Limits::default()
        };
        wgpu::DeviceDescriptor {
            label: Some("relight"),
            // Only for timing; everything works without.
            required_features: adapter.features() & wgpu::Features::TIMESTAMP_QUERY,
            required_limits,
            ..Default::default()
        }
    }

    /// The fastest kind of adapter that has all of WebGPU, among those whose name `WGPU_ADAPTER_NAME` is part of.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] with what there is instead.
    pub fn best(adapters: impl IntoIterator<Item = wgpu::Adapter>) -> Result<wgpu::Adapter, GpuError> {
        let wanted = std::env::var("WGPU_ADAPTER_NAME").unwrap_or_default().to_lowercase();
        let mut found = Vec::new();
        let mut usable = Vec::new();
        for adapter in adapters {
            let info = adapter.get_info();
            let complete = adapter.get_downlevel_capabilities().is_webgpu_compliant();
            let lacking = if complete { "" } else { ", which lacks parts of WebGPU" };
            found.push(format!("{} on {}{lacking}", info.name, info.backend));
            if complete && info.name.to_lowercase().contains(&wanted) {
                usable.push(adapter);
            }
        }
        usable.into_iter().min_by_key(|adapter| slowness(adapter.get_info().device_type)).ok_or_else(|| {
            GpuError::NoAdapter {
                wanted: if wanted.is_empty() {
                    String::new()
                } else {
                    format!(" named {wanted:?} (WGPU_ADAPTER_NAME)")
                },
                found: if found.is_empty() { "none at all".to_owned() } else { found.join("; ") },
            }
        })
    }

    /// Takes a host application's device and leaves its error handlers as they are: what goes wrong on it late goes to them,
    /// and [`Gpu::check`] knows nothing of it.
    pub fn of_host(device: &wgpu::Device, queue: &wgpu::Queue) -> Self {
        let name = device.adapter_info().name;
        Self { device: device.clone(), queue: queue.clone(), name, failure: Arc::default() }
    }

    /// Takes a device that a window already opened. Replaces its handlers of uncaptured errors and of loss.
    pub fn from_device(device: wgpu::Device, queue: wgpu::Queue, name: String) -> Self {
        let failure = Arc::new(Mutex::new(None));
        let keep = |failure: &Arc<Mutex<Option<String>>>, reason: String| {
            // The first failure is the cause, later ones its consequences.
            failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).get_or_insert(reason);
        };
        let of_errors = failure.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| keep(&of_errors, error.to_string())));
        let of_loss = failure.clone();
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                keep(&of_loss, format!("device lost: {message}"));
            }
        });
        Self { device, queue, name, failure }
    }

    /// Whether the device can time its passes.
    pub fn has_timestamps(&self) -> bool {
        self.device.features().contains(wgpu::Features::TIMESTAMP_QUERY)
    }

    /// The first failure since the device was opened, if there was one.
    pub fn check(&self) -> Result<(), GpuError> {
        let failure = self.failure.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        failure.as_ref().map_or(Ok(()), |reason| Err(GpuError::Failed(reason.clone())))
    }

    /// Blocks until the GPU has done all that it was given.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| GpuError::Failed(e.to_string()))?;
        self.check()
    }

    /// A read-only storage buffer of `contents`; one zeroed element where there are none.
    pub fn storage<T: bytemuck::Pod>(&self, what: &str, contents: &[T]) -> Result<wgpu::Buffer, GpuError> {
        let nothing = [T::zeroed()];
        let contents: &[u8] = bytemuck::cast_slice(if contents.is_empty() { &nothing } else { contents });
        self.check_binding(what, contents.len() as u64)?;
        Ok(self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some(what),
            contents,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        }))
    }

    /// Checks that a uniform buffer of this many bytes can be bound.
    pub fn check_uniform(&self, what: &str, needed: u64) -> Result<(), GpuError> {
        let limit = self.device.limits().max_uniform_buffer_binding_size;
        self.check_limit(what, needed, "bytes in one uniform buffer", limit, "use fewer elements")
    }

    /// A zeroed storage buffer that shaders write, of at least one element, which may be bound as uniform, too.
    pub fn written<T: bytemuck::Pod>(&self, what: &str, count: usize) -> Result<wgpu::Buffer, GpuError> {
        let size = (count.max(1) * size_of::<T>()) as u64;
        self.check_binding(what, size)?;
        Ok(self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(what),
            size,
            usage: wgpu::BufferUsages::STORAGE
                | wgpu::BufferUsages::UNIFORM
                | wgpu::BufferUsages::COPY_SRC
                | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        }))
    }

    pub fn uniform<T: bytemuck::Pod>(&self, what: &str, contents: &T) -> wgpu::Buffer {
        self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some(what),
            contents: bytemuck::bytes_of(contents),
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        })
    }

    fn check_binding(&self, what: &str, needed: u64) -> Result<(), GpuError> {
        let limits = self.device.limits();
        let limit = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        let help = "use a GPU with more, or a smaller asset";
        self.check_limit(what, needed, "bytes in one buffer", limit, help)
    }

    fn check_limit(
        &self,
        what: &str,
        needed: u64,
        unit: &'static str,
        limit: u64,
        help: &'static str,
    ) -> Result<(), GpuError> {
        if needed > limit {
            return Err(GpuError::TooLarge { what: what.to_owned(), needed, unit, limit, help });
        }
        Ok(())
    }

    /// An array texture to upload to.
    pub fn texture_array(
        &self,
        what: &str,
        size: wgpu::Extent3d,
        format: wgpu::TextureFormat,
    ) -> Result<wgpu::Texture, GpuError> {
        let limits = self.device.limits();
        let (side, layers) = (size.width.max(size.height) as u64, size.depth_or_array_layers as u64);
        let max_side = limits.max_texture_dimension_2d as u64;
        self.check_limit(what, side, "texels on a side", max_side, "make it smaller")?;
        let max_layers = limits.max_texture_array_layers as u64;
        self.check_limit(what, layers, "texture layers", max_layers, "use fewer elements or textures")?;
        Ok(self.texture(what, size, format, wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST))
    }

    /// Checks that a picture of this many samples fits a render target.
    pub fn check_target(&self, [width, height]: [u32; 2]) -> Result<(), GpuError> {
        let limit = self.device.limits().max_texture_dimension_2d as u64;
        let help = "take a smaller picture or fewer samples a pixel";
        self.check_limit("the picture", width.max(height) as u64, "samples on a side", limit, help)
    }

    pub fn texture(
        &self,
        what: &str,
        size: wgpu::Extent3d,
        format: wgpu::TextureFormat,
        usage: wgpu::TextureUsages,
    ) -> wgpu::Texture {
        self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(what),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        })
    }

    /// A buffer to copy results into and read them from.
    pub fn readback(&self, size: u64) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("readback"),
            size,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        })
    }

    /// Waits, then returns what a [`Gpu::readback`] buffer holds.
    pub fn read<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer) -> Result<Vec<T>, GpuError> {
        buffer.map_async(wgpu::MapMode::Read, .., |_| {});
        self.wait()?;
        let mapped = buffer.get_mapped_range(..).map_err(|e| GpuError::Failed(e.to_string()))?;
        Ok(bytemuck::pod_collect_to_vec(&mapped))
    }

    /// Waits, then returns what a texture of four f32 a texel holds, but for the fourth, `[y][x]`.
    pub fn read_texture(&self, texture: &wgpu::Texture) -> Result<Vec<Rgb>, GpuError> {
        // Rows of a copy are aligned to 256 bytes.
        let row_bytes = (texture.width() * 16).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let readback = self.readback(row_bytes as u64 * texture.height() as u64);
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &readback,
                layout: wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row_bytes), rows_per_image: None },
            },
            texture.size(),
        );
        self.queue.submit([encoder.finish()]);
        let texels: Vec<[f32; 4]> = self.read(&readback)?;
        let rows = texels.chunks_exact(row_bytes as usize / 16).flat_map(|row| &row[..texture.width() as usize]);
        Ok(rows.map(|&[r, g, b, _]| Rgb::new(r, g, b)).collect())
    }

    /// Copies a storage buffer's first `count` elements to this side.
    pub fn download<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, count: usize) -> Result<Vec<T>, GpuError> {
        if count == 0 {
            return Ok(Vec::new());
        }
        let readback = self.readback((count * size_of::<T>()) as u64);
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(buffer, 0, &readback, 0, readback.size());
        self.queue.submit([encoder.finish()]);
        self.read(&readback)
    }
}

fn slowness(kind: wgpu::DeviceType) -> u32 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}
