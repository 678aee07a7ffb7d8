//! Environments from OpenEXR and Radiance HDR files.

use std::path::Path;

use super::Environment;
use crate::error::{Error, Result};
use crate::reflectance::Rgb;

impl Environment {
    /// Reads an equirectangular image, `.exr` (RGB channels) or `.hdr` (Radiance RGBE). Negative values, which lossy
    /// compression and resampling leave around lamps, are taken as 0.
    ///
    /// # Errors
    /// Input errors for a file that is missing, of another kind, or holds radiance that is not finite.
    pub fn read(path: &Path) -> Result<Self> {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        let (width, height, mut pixels) = match extension.as_str() {
            "exr" => read_exr(path)?,
            "hdr" | "pic" => read_hdr(path)?,
            _ => return Err(Error::reading(path, "an environment is a .exr or a .hdr file")),
        };
        for pixel in &mut pixels {
            // Not `max`, which would turn NaN into 0.
            *pixel = pixel.map(|value| if value < 0.0 { 0.0 } else { value });
        }
        Self::new(width, height, pixels).map_err(|error| error.at(path.display()))
    }
}

/// Size and pixels of the first layer with R, G and B.
fn read_exr(path: &Path) -> Result<(usize, usize, Vec<Rgb>)> {
    let image = exr::prelude::read_first_rgba_layer_from_file(
        path,
        |size, _| (size.width(), vec![Rgb::ZERO; size.width() * size.height()]),
        |(width, pixels), position, (r, g, b, _): (f32, f32, f32, f32)| {
            pixels[position.y() * *width + position.x()] = Rgb::new(r, g, b);
        },
    )
    .map_err(|error| Error::reading(path, error))?;
    let size = image.layer_data.size;
    Ok((size.width(), size.height(), image.layer_data.channel_data.pixels.1))
}

/// Size and pixels of a Radiance picture.
fn read_hdr(path: &Path) -> Result<(usize, usize, Vec<Rgb>)> {
    let image = image::ImageReader::open(path)
        .map_err(|error| Error::reading(path, error))
        .and_then(|mut reader| {
            reader.set_format(image::ImageFormat::Hdr);
            reader.decode().map_err(|error| Error::reading(path, error))
        })?
        .to_rgb32f();
    let pixels = image.pixels().map(|pixel| Rgb::from_array(pixel.0)).collect();
    Ok((image.width() as usize, image.height() as usize, pixels))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radiance_pictures_are_read_to_their_precision() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sky.hdr");
        let mut file = std::fs::File::create(&path).unwrap();
        let pixels: Vec<_> = (0..32).map(|i| image::Rgb([i as f32, 2.5, 1000.0])).collect();
        image::codecs::hdr::HdrEncoder::new(&mut file).encode(&pixels, 8, 4).unwrap();
        let environment = Environment::read(&path).unwrap();
        assert_eq!((environment.width, environment.height), (8, 4));
        for (read, wrote) in environment.pixels.iter().zip(&pixels) {
            assert!((read.z - wrote.0[2]).abs() <= 8.0 && (read.x - wrote.0[0]).abs() <= 8.0);
        }
    }

    #[test]
    fn negative_values_of_a_file_are_taken_as_black_and_nan_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sky.exr");
        exr::prelude::write_rgb_file(&path, 4, 2, |x, _| (x as f32 - 1.0, 1.0, 2.0)).unwrap();
        assert_eq!(Environment::read(&path).unwrap().pixels[0], Rgb::new(0.0, 1.0, 2.0));
        exr::prelude::write_rgb_file(&path, 4, 2, |x, y| (f32::NAN, x as f32, y as f32)).unwrap();
        let error = Environment::read(&path).unwrap_err().to_string();
        assert!(error.contains("sky.exr") && error.contains("(0, 0)"), "{error}");
    }

    #[test]
    fn other_files_and_missing_files_are_refused_by_name() {
        for name in ["sky.png", "missing.exr", "missing.hdr"] {
            let error = Environment::read(Path::new(name)).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains(name), "{error}");
        }
    }
}
