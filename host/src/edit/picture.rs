//! Pictures that edits take: photographs as linear colour, masks as shares.

use std::path::Path;

use crate::error::{Error, Result};
use crate::reflectance::{Rgb, colour};
use crate::render::Picture;

/// A photograph in linear Rec. 709 colour, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Photo {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Colours.
    pub pixels: Vec<Rgb>,
}

impl Photo {
    /// Reads a PNG or JPEG, which is taken as sRGB, or an OpenEXR or a Radiance HDR, which are linear.
    ///
    /// # Errors
    /// Input errors for a file that is missing or of another kind.
    pub fn read(path: &Path) -> Result<Self> {
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr")) {
            let Picture { width, height, pixels } = Picture::read_exr(path)?;
            return Ok(Self { width, height, pixels: pixels.iter().map(|pixel| pixel.truncate()).collect() });
        }
        let image = decode(path)?;
        let linear = matches!(image.color(), image::ColorType::Rgb32F | image::ColorType::Rgba32F);
        let image = image.to_rgb32f();
        let colour = |pixel: &image::Rgb<f32>| {
            Rgb::from_array(if linear { pixel.0 } else { pixel.0.map(colour::srgb_decode) })
        };
        let (width, height) = (image.width() as usize, image.height() as usize);
        Ok(Self { width, height, pixels: image.pixels().map(colour).collect() })
    }
}

/// The share of the second map a texel: 0 black to 1 white.
#[derive(Debug, Clone, PartialEq)]
pub struct Mask {
    /// Texels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Shares.
    pub share: Vec<f32>,
}

impl Mask {
    /// Reads the grey values of a PNG or JPEG, 8 or 16 bits, as shares: middle grey is a half.
    ///
    /// # Errors
    /// Input errors for a file that is missing or of another kind.
    pub fn read(path: &Path) -> Result<Self> {
        let image = decode(path)?.to_luma16();
        let share = image.pixels().map(|pixel| f32::from(pixel.0[0]) / f32::from(u16::MAX)).collect();
        Ok(Self { width: image.width() as usize, height: image.height() as usize, share })
    }
}

/// Decodes a PNG, JPEG or Radiance HDR, whatever its name ends in.
///
/// # Errors
/// Input errors for a file that is missing or of another kind.
pub(super) fn decode(path: &Path) -> Result<image::DynamicImage> {
    image::ImageReader::open(path)
        .and_then(image::ImageReader::with_guessed_format)
        .map_err(|error| Error::reading(path, error))?
        .decode()
        .map_err(|error| Error::reading(path, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photographs_are_decoded_from_srgb_and_masks_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.png");
        image::RgbImage::from_pixel(3, 2, image::Rgb([188, 188, 188])).save(&path).unwrap();
        let photo = Photo::read(&path).unwrap();
        assert_eq!((photo.width, photo.height, photo.pixels.len()), (3, 2, 6));
        // sRGB 188 is half of the light.
        assert!((photo.pixels[5].y - 0.503).abs() < 1e-3);
        let mask = Mask::read(&path).unwrap();
        assert!((mask.share[0] - 188.0 / 255.0).abs() < 1e-4);
    }

    #[test]
    fn photographs_in_openexr_are_linear() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.exr");
        exr::prelude::write_rgb_file(&path, 3, 2, |x, y| (x as f32, 0.25, y as f32)).unwrap();
        let photo = Photo::read(&path).unwrap();
        assert_eq!((photo.width, photo.height), (3, 2));
        assert_eq!(photo.pixels[5], Rgb::new(2.0, 0.25, 1.0));
    }

    #[test]
    fn a_file_that_is_no_picture_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.png");
        std::fs::write(&path, "no picture").unwrap();
        let error = Photo::read(&path).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("p.png"), "{error}");
    }
}
