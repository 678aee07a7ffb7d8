//! Alpha cut-out: which part of a material's texture is there.

use std::path::Path;

use glam::Vec2;

use lobelia_base::error::Result;
use lobelia_reflectance::SbrdfMap;
use lobelia_reflectance::picture_file;

/// Alpha from which on the material is there.
const THRESHOLD: f32 = 0.5;

/// The part of a texture's repeat where the material is, texel by texel; elsewhere nothing is hit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mask {
    /// Texels a row.
    pub width: u32,
    /// Rows; row 0 is at v = 0.
    pub height: u32,
    /// A bit a texel, row by row, the lowest of a word first; 1 where the material is.
    pub bits: Vec<u32>,
}

impl Mask {
    /// The texels whose alpha is 0.5 or more, row by row.
    pub fn from_alpha(width: u32, height: u32, alpha: impl IntoIterator<Item = f32>) -> Self {
        let mut bits = vec![0; (width as usize * height as usize).div_ceil(32)];
        for (index, alpha) in alpha.into_iter().enumerate() {
            bits[index / 32] |= u32::from(alpha >= THRESHOLD) << (index % 32);
        }
        Self { width, height, bits }
    }

    /// The `alpha` channel of a map, where it has one.
    pub fn of_map(map: &SbrdfMap) -> Option<Self> {
        let alpha = map.extra.get("alpha")?;
        Some(Self::from_alpha(map.width as u32, map.height as u32, alpha.iter().copied()))
    }

    /// Reads a PNG or JPEG: its alpha, or its brightness where it has none.
    ///
    /// # Errors
    /// Input errors for a file that is missing or no picture.
    pub fn read(path: &Path) -> Result<Self> {
        let picture = picture_file::decode(path)?;
        let (width, height) = (picture.width(), picture.height());
        if picture.color().has_alpha() {
            let alpha = picture.to_rgba32f().pixels().map(|pixel| pixel[3]).collect::<Vec<_>>();
            return Ok(Self::from_alpha(width, height, alpha));
        }
        Ok(Self::from_alpha(width, height, picture.to_luma32f().into_raw()))
    }

    /// Whether the material is at a place of the texture, whose repeats are 1 apart.
    pub fn solid(&self, place: Vec2) -> bool {
        let texel = |x: f32, size: u32| (((x - x.floor()) * size as f32) as u32).min(size - 1);
        let index = texel(place.y, self.height) * self.width + texel(place.x, self.width);
        self.bits[index as usize / 32] >> (index % 32) & 1 == 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_repeats_and_holds_from_half_an_alpha_on() {
        let alpha = (0..7 * 9).map(|index| if index % 2 == 0 { 0.5 } else { 0.49 });
        let mask = Mask::from_alpha(7, 9, alpha);
        for (x, y) in [(0, 0), (3, 0), (6, 8), (1, 5)] {
            let place = Vec2::new((x as f32 + 0.5) / 7.0, (y as f32 + 0.5) / 9.0);
            let solid = (y * 7 + x) % 2 == 0;
            assert_eq!((mask.solid(place), mask.solid(place - 3.0)), (solid, solid), "{x} {y}");
        }
        assert!(mask.solid(Vec2::ONE) == mask.solid(Vec2::ZERO));
    }

    #[test]
    fn a_picture_masks_by_its_alpha_or_by_its_brightness() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mask.png");
        image::RgbaImage::from_fn(2, 1, |x, _| image::Rgba([255, 255, 255, 255 * x as u8]))
            .save(&path)
            .unwrap();
        assert_eq!(Mask::read(&path).unwrap().bits, [0b10]);
        image::GrayImage::from_fn(2, 1, |x, _| image::Luma([255 - 255 * x as u8])).save(&path).unwrap();
        assert_eq!(Mask::read(&path).unwrap().bits, [0b01]);
        assert_eq!(Mask::read(&folder.path().join("no.png")).unwrap_err().exit_code(), 2);
    }
}
