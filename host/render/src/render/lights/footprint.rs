//! What of a texture a pixel sees, and the texels that stand for it. The shader has the same.

use glam::Vec2;

use super::{Filtering, Settings};
use crate::render::materials::PackedMaterial;

/// A pixel's footprint in texels of the finest level: samples along one or two axes, on a level or between
/// two.
pub(super) struct Footprint {
    centre: Vec2,
    along: Vec2,
    across: Vec2,
    counts: [u32; 2],
    level: f32,
    /// Whether a sample takes one texel of those around it, as there are many samples.
    one_each: bool,
}

/// Samples from which on one texel each is enough.
const MANY: u32 = 64;
/// The additive recurrence of the plane's plastic number, low in discrepancy (Roberts 2018).
const SPREAD: Vec2 = Vec2::new(0.754_877_7, 0.569_840_3);

impl Footprint {
    /// The footprint around texture coordinates that change by `dx` and `dy` from pixel to pixel.
    ///
    /// On MIP levels samples stand along the longer axis and the level follows from the distance between
    /// them, as OpenGL's EXT_texture_filter_anisotropic proposes.
    pub(super) fn new(settings: &Settings, material: &PackedMaterial, uv: Vec2, [dx, dy]: [Vec2; 2]) -> Self {
        let size = Vec2::new(material.width as f32, material.height as f32);
        let tiling = Vec2::from_array(material.tiling);
        let (x, y) = (dx * tiling * size, dy * tiling * size);
        let repeat = uv * tiling;
        let centre = (repeat - repeat.floor()) * size;
        let mut footprint = Self { centre, along: x, across: y, counts: [1; 2], level: 0.0, one_each: false };
        let most = settings.anisotropy as f32;
        if settings.filtering == Filtering::Shaded {
            if material.width * material.height > 1 {
                footprint.counts = [x, y].map(|axis| axis.length().ceil().clamp(1.0, most) as u32);
                footprint.one_each =
                    material.bilinear != 0 && footprint.counts[0] * footprint.counts[1] >= MANY;
            }
        } else if material.levels > 0 {
            let longer = x.length().max(y.length());
            let shorter = x.length().min(y.length()).max(1e-6);
            footprint.along = if x.length() >= y.length() { x } else { y };
            let count = (longer / shorter).min(longer).ceil().clamp(1.0, most);
            footprint.counts[0] = count as u32;
            footprint.level = (longer / count).max(1.0).log2().min(material.levels as f32);
        }
        footprint
    }

    /// Calls with the index and the weight of every texel that the footprint takes.
    pub(super) fn taps(&self, material: &PackedMaterial, mut tap: impl FnMut(u32, f32)) {
        let part = self.level.fract();
        let [columns, rows] = self.counts;
        let of_step = 1.0 / (columns * rows) as f32;
        for (level, of_level) in [(self.level as u32, 1.0 - part), (self.level as u32 + 1, part)] {
            if of_level == 0.0 {
                continue;
            }
            for (i, j) in (0..rows).flat_map(|j| (0..columns).map(move |i| (i, j))) {
                let step = |k: u32, count: u32| (k as f32 + 0.5) / count as f32 - 0.5;
                let place = self.centre + self.along * step(i, columns) + self.across * step(j, rows);
                if self.one_each {
                    // Spread over a texel, samples weigh their neighbours as interpolation does in the mean.
                    let sample = (i + j * columns) as f32;
                    let at = (place + (SPREAD * sample).fract() - 0.5).floor();
                    tap(material.index(0, at.x as i64, at.y as i64), of_step);
                    continue;
                }
                let place = place / (1u32 << level) as f32;
                material.around(level, place.x, place.y).into_iter().for_each(|(texel, weight)| {
                    if weight > 0.0 {
                        tap(texel, weight * of_level * of_step);
                    }
                });
            }
        }
    }
}
