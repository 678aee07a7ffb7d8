//! Sizes of simulated measurements.

use lobelia_measure::rig::config::RigConfig;

/// How much to measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Size {
    /// 48 × 48 texels, 80 poses: seconds.
    Small,
    /// 128 × 128 texels, 200 poses: about half a minute.
    Medium,
    /// 256 × 256 texels, 400 poses: many minutes.
    Full,
}

impl Size {
    /// Texels across, poses, and the sensor's size relative to the default.
    pub fn numbers(self) -> (usize, usize, f64) {
        match self {
            Self::Small => (48, 80, 0.6),
            Self::Medium => (128, 200, 1.0),
            Self::Full => (256, 400, 2.0),
        }
    }

    /// Pixels and samples a pixel of the rendered pictures.
    pub fn picture(self) -> (u32, u32, u32) {
        match self {
            Self::Small => (400, 300, 16),
            Self::Medium => (640, 480, 32),
            Self::Full => (1280, 960, 64),
        }
    }

    /// The rig at this size.
    pub fn rig(self, seed: u64) -> RigConfig {
        let (texels, _, scale) = self.numbers();
        let mut rig = RigConfig::default();
        rig.carrier.texels_across = texels;
        let camera = &mut rig.camera;
        camera.width = (camera.width as f64 * scale) as usize;
        camera.height = (camera.height as f64 * scale) as usize;
        camera.focal_px = camera.focal_px.map(|f| f * scale);
        camera.principal_px = camera.principal_px.map(|c| (c + 0.5) * scale - 0.5);
        rig.simulator.seed = seed;
        rig
    }
}
