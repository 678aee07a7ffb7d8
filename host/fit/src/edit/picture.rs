//! Pictures that edits take: photographs as linear colour, masks as shares.

use std::path::Path;

use lobelia_base::error::{Error, Result};
use lobelia_reflectance::picture::Picture;
use lobelia_reflectance::picture_file;
use lobelia_reflectance::radiance_file::{self, Radiance};
use lobelia_reflectance::{Rgb, colour};

/// A photograph in linear Rec. 709 colour, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Photo {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Colours, none of them negative.
    pub pixels: Vec<Rgb>,
    /// Opacity a pixel, where the picture has transparency.
    pub alpha: Option<Vec<f32>>,
}

impl Photo {
    /// Reads a PNG or JPEG, which is taken as sRGB and turned upright as its EXIF says, or an OpenEXR or a
    /// Radiance HDR, which are linear. Negative values, which lossy compression and other primaries leave,
    /// are taken as 0.
    ///
    /// # Errors
    /// Input errors for a file that is missing or of another kind, has a colour profile other than sRGB's, or
    /// holds a value that is not finite (which pixel is named).
    pub fn read(path: &Path) -> Result<Self> {
        let mut photo = if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr")) {
            let Picture { width, height, pixels } = Picture::read_exr(path)?;
            let pixels = pixels.iter().map(|pixel| pixel.truncate()).collect();
            Self { width, height, pixels, alpha: None }
        } else if begins_as_radiance(path)? {
            let Radiance { width, height, pixels } = radiance_file::read(path)?;
            Self { width, height, pixels, alpha: None }
        } else {
            Self::encoded(path)?
        };
        if let Some(k) = photo.pixels.iter().position(|pixel| !pixel.is_finite()) {
            let (x, y) = (k % photo.width, k / photo.width);
            let message = format!("pixel ({x}, {y}) is {}, which is not finite", photo.pixels[k]);
            return Err(Error::input(message).at(path.display()));
        }
        photo.pixels.iter_mut().for_each(|pixel| *pixel = pixel.max(Rgb::ZERO));
        Ok(photo)
    }

    /// A PNG or JPEG.
    fn encoded(path: &Path) -> Result<Self> {
        let (image, profile) = picture_file::decode_with_profile(path)?;
        if profile.is_some_and(|profile| picture_file::is_srgb(&profile) == Some(false)) {
            let message = "its colour profile is not sRGB's; convert it to sRGB, or to linear OpenEXR";
            return Err(Error::reading(path, message));
        }
        if let Some(why) = picture_file::png_not_srgb(path) {
            return Err(Error::reading(path, format!("{why}; convert it to sRGB, or to linear OpenEXR")));
        }
        let alpha =
            image.color().has_alpha().then(|| image.to_rgba32f().pixels().map(|pixel| pixel[3]).collect());
        let image = image.to_rgb32f();
        let colour = |pixel: &image::Rgb<f32>| Rgb::from_array(pixel.0.map(colour::srgb_decode));
        let (width, height) = (image.width() as usize, image.height() as usize);
        Ok(Self { width, height, pixels: image.pixels().map(colour).collect(), alpha })
    }
}

/// Whether a file begins as a Radiance picture, whatever its name.
fn begins_as_radiance(path: &Path) -> Result<bool> {
    use std::io::Read as _;
    let mut begin = Vec::new();
    let file = std::fs::File::open(path).map_err(|error| Error::reading(path, error))?;
    file.take(2).read_to_end(&mut begin).map_err(|error| Error::reading(path, error))?;
    Ok(radiance_file::is_radiance(&begin))
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
        let image = picture_file::decode(path)?.to_luma16();
        let share = image.pixels().map(|pixel| f32::from(pixel.0[0]) / f32::from(u16::MAX)).collect();
        Ok(Self { width: image.width() as usize, height: image.height() as usize, share })
    }
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
    fn a_photograph_that_would_make_a_broken_map_is_refused_and_negative_values_are_black() {
        let cases = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases");
        let error = Photo::read(&cases.join("exr/nan.exr")).unwrap_err();
        let text = error.to_string();
        assert!(
            error.exit_code() == 2 && text.contains("nan.exr: pixel (") && text.contains("not finite"),
            "{text}"
        );
        let map = Photo::read(&cases.join("map/negative-n.exr")).unwrap_err().to_string();
        assert!(map.contains("no channels R, G and B") || map.contains("is an SBRDF map"), "{map}");
        // Saturated colours of other primaries lie outside Rec. 709.
        let aces = Photo::read(&cases.join("exr/ap0.exr")).unwrap();
        assert!(aces.pixels.iter().all(|pixel| pixel.min_element() >= 0.0));
        let plain = Photo::read(&cases.join("hdr/plain.hdr")).unwrap();
        let scaled = Photo::read(&cases.join("hdr/exposure.hdr")).unwrap();
        assert!(
            (plain.pixels[40] - scaled.pixels[40]).abs().max_element()
                < 0.01 * plain.pixels[40].max_element()
        );
    }

    #[test]
    fn a_map_is_no_photograph_though_it_has_a_view_in_r_g_and_b() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        lobelia_reflectance::SbrdfMap::new(2, 2, 1).write_exr(&path).unwrap();
        let text = Photo::read(&path).unwrap_err().to_string();
        assert!(text.contains("map.exr") && text.contains("is an SBRDF map and no picture"), "{text}");
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
