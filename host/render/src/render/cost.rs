//! What rendering costs, in the same terms for every method.

/// What a rendering took. Seconds of a frame are those of what it redid.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Cost {
    /// Seconds of baking, on whatever machines; 0 for a method that bakes nothing.
    pub bake_seconds: f64,
    /// Rays cast by baking.
    pub bake_rays: u64,
    /// Bytes of what was baked, on disk where it is in a folder.
    pub baked_bytes: u64,
    /// Seconds for what is the same for every frame: trees, tables, uploads, pipelines, and reading what was
    /// baked.
    pub prepare_seconds: f64,
    /// Seconds for a change of the light, or of what it falls on.
    pub light_seconds: f64,
    /// Seconds for a change of the view, drawing aside.
    pub view_seconds: f64,
    /// Seconds for drawing.
    pub render_seconds: f64,
    /// Bytes that the method holds for the scene and the view, on the CPU and the GPU.
    pub memory_bytes: u64,
    /// Samples a pixel.
    pub samples: u32,
    /// Rays cast; 0 for a raster.
    pub rays: u64,
    /// Draw calls; 0 for rays.
    pub draws: u32,
}

impl Cost {
    /// The cost of this and another frame of the same scene made ready.
    #[must_use]
    pub fn and(&self, frame: &Self) -> Self {
        Self {
            light_seconds: self.light_seconds + frame.light_seconds,
            view_seconds: self.view_seconds + frame.view_seconds,
            render_seconds: self.render_seconds + frame.render_seconds,
            memory_bytes: self.memory_bytes.max(frame.memory_bytes),
            rays: self.rays + frame.rays,
            draws: self.draws + frame.draws,
            ..*frame
        }
    }

    /// Seconds from nothing to this frame.
    pub fn seconds(&self) -> f64 {
        self.bake_seconds
            + self.prepare_seconds
            + self.light_seconds
            + self.view_seconds
            + self.render_seconds
    }
}
