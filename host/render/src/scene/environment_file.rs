//! Environments from OpenEXR and Radiance HDR files.

use std::path::Path;

use glam::{Vec2, Vec3};

use super::Environment;
use lobelia_base::error::{Error, Result};
use lobelia_reflectance::Rgb;
use lobelia_reflectance::picture::Picture;
use lobelia_reflectance::radiance_file::{self, Radiance};

impl Environment {
    /// Reads an equirectangular image or, where an OpenEXR file says so (`envmap`), the six faces of a cube:
    /// `.exr` or `.hdr` (Radiance RGBE). Other primaries than Rec. 709 are converted where the file names
    /// them, what lies outside the data window is black. Negative values, which lossy compression and
    /// resampling leave around lamps, are taken as 0.
    ///
    /// A cube shows what its conversion to an equirectangular image by OpenEXR's own tool shows: OpenEXR's +z
    /// is in the middle.
    ///
    /// # Errors
    /// Input errors for a file that is missing, of another kind, or holds radiance that is not finite.
    pub fn read(path: &Path) -> Result<Self> {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        let (width, height, mut pixels, cube) = match extension.as_str() {
            "exr" => {
                let (Picture { width, height, pixels }, cube) = Picture::read_exr_layer(path)?;
                (width, height, pixels.iter().map(|pixel| pixel.truncate()).collect(), cube)
            }
            "hdr" | "pic" | "rgbe" => {
                let Radiance { width, height, pixels } = radiance_file::read(path)?;
                (width, height, pixels, false)
            }
            _ => return Err(Error::reading(path, "an environment is a .exr or a .hdr file")),
        };
        for pixel in &mut pixels {
            // Not `max`, which would turn NaN into 0.
            *pixel = pixel.map(|value| if value < 0.0 { 0.0 } else { value });
        }
        // Checked before a cube is resampled, so that the pixel named is that of the file.
        let read = Self::new(width, height, pixels).map_err(|error| error.at(path.display()))?;
        if !cube {
            return Ok(read);
        }
        let face = width.min(height / 6);
        if face == 0 {
            return Err(Error::reading(
                path,
                format!("{width} × {height} pixels do not hold six faces of a cube"),
            ));
        }
        let faces = Cube { face, width, pixels: &read.pixels };
        Ok(Self::from_function(4 * face, 2 * face, |direction| faces.radiance(direction)))
    }
}

/// Six faces, one below the other, in OpenEXR's order (+x, −x, +y, −y, +z, −z), pixels on their edges
/// included.
struct Cube<'a> {
    face: usize,
    width: usize,
    pixels: &'a [Rgb],
}

impl Cube<'_> {
    /// Radiance from a direction of the environment's frame, bilinear in a face.
    fn radiance(&self, direction: Vec3) -> Rgb {
        let (face, place) = face_and_place(Vec3::new(-direction.x, direction.y, -direction.z));
        let last = (self.face - 1) as f32;
        let place = ((place + 1.0) / 2.0 * last).clamp(Vec2::ZERO, Vec2::splat(last));
        let (low, share) = (place.floor(), place.fract());
        let high = (low + 1.0).min(Vec2::splat(last));
        let at = |x: f32, y: f32| self.pixels[(face * self.face + y as usize) * self.width + x as usize];
        let (top, bottom) = (at(low.x, low.y).lerp(at(high.x, low.y), share.x), at(low.x, high.y));
        top.lerp(bottom.lerp(at(high.x, high.y), share.x), share.y)
    }
}

/// The face that a direction of OpenEXR's frame meets, and where on it: right and down, −1..1 (OpenEXR's
/// `ImfEnvmap.h`).
fn face_and_place(d: Vec3) -> (usize, Vec2) {
    let size = d.abs();
    if size.x >= size.y && size.x >= size.z {
        let d = d / size.x;
        if d.x > 0.0 { (0, Vec2::new(d.z, -d.y)) } else { (1, Vec2::new(-d.z, -d.y)) }
    } else if size.y >= size.z {
        let d = d / size.y;
        if d.y > 0.0 { (2, Vec2::new(d.x, -d.z)) } else { (3, Vec2::new(d.x, d.z)) }
    } else {
        let d = d / size.z;
        if d.z > 0.0 { (4, Vec2::new(-d.x, -d.y)) } else { (5, Vec2::new(d.x, -d.y)) }
    }
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

    fn case(name: &str) -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases/exr").join(name)
    }

    #[test]
    fn of_a_cube_only_the_face_that_shines_is_seen() {
        let environment = Environment::read(&case("cube-up.exr")).unwrap();
        for (direction, expected) in [
            (Vec3::Y, 1.0),
            (Vec3::new(0.5, 0.7, 0.3), 1.0),
            (Vec3::new(-0.4, 0.7, -0.5), 1.0),
            (Vec3::NEG_Y, 0.0),
            (Vec3::X, 0.0),
            (Vec3::new(0.0, 0.6, 0.8), 0.0),
        ] {
            let seen = environment.radiance(direction.normalize());
            assert!((seen - Rgb::splat(expected)).abs().max_element() < 1e-6, "{direction}: {seen}");
        }
    }

    #[test]
    fn faces_of_a_cube_lie_as_openexr_draws_them() {
        // ImfEnvmap.h gives the direction of a place in a face, and the pixel that shows it; the pixels here
        // hold their directions.
        const N: usize = 33;
        let mut pixels = vec![Rgb::ZERO; 6 * N * N];
        for face in 0..6 {
            for index in 0..N * N {
                let (i, j) = (index % N, index / N);
                let [p, q] = [i, j].map(|k| k as f32 / (N - 1) as f32 * 2.0 - 1.0);
                let sign = if face % 2 == 0 { 1.0 } else { -1.0 };
                let direction =
                    [Vec3::new(sign, p, q), Vec3::new(p, sign, q), Vec3::new(p, q, sign)][face / 2];
                let last = N - 1;
                let (x, y) = [
                    (j, last - i),
                    (last - j, last - i),
                    (i, last - j),
                    (i, j),
                    (last - i, last - j),
                    (i, last - j),
                ][face];
                pixels[(face * N + y) * N + x] = direction.normalize() * 0.5 + 0.5;
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cube.exr");
        let channels = exr::prelude::SpecificChannels::rgb(|at: exr::math::Vec2<usize>| {
            let pixel = pixels[at.y() * N + at.x()];
            (pixel.x, pixel.y, pixel.z)
        });
        let mut image = exr::prelude::Image::from_channels((N, 6 * N), channels);
        image.layer_data.attributes.environment_map = Some(exr::meta::attribute::EnvironmentMap::Cube);
        exr::prelude::WritableImage::write(&image).to_file(&path).unwrap();
        let environment = Environment::read(&path).unwrap();
        for direction in [
            Vec3::new(1.0, 0.3, 0.2),
            Vec3::new(-1.0, 0.3, 0.2),
            Vec3::new(0.3, 1.0, -0.2),
            Vec3::new(0.3, -1.0, -0.2),
            Vec3::new(0.3, -0.2, 1.0),
            Vec3::new(0.3, -0.2, -1.0),
        ] {
            let direction = direction.normalize();
            let seen = environment.radiance(direction) * 2.0 - 1.0;
            let expected = Vec3::new(-direction.x, direction.y, -direction.z);
            assert!((seen - expected).length() < 0.02, "{direction}: {seen}");
        }
    }

    #[test]
    fn colours_of_other_primaries_come_in_rec_709() {
        let [plain, aces] =
            ["rec709.exr", "ap0.exr"].map(|name| Environment::read(&case(name)).unwrap().pixels);
        // ACES 2065-1 to Rec. 709 as the Academy prints it; the two files hold the same numbers.
        let published = glam::Mat3::from_cols_array(&[
            2.52169, -0.27648, -0.01538, -1.13413, 1.37272, -0.15298, -0.38756, -0.09624, 1.16835,
        ]);
        for (aces, plain) in aces.iter().zip(plain.iter()) {
            let expected = (published * *plain).max(Rgb::ZERO);
            assert!((*aces - expected).abs().max_element() < 1e-3, "{aces} {expected}");
        }
    }

    #[test]
    fn pixels_stand_where_the_data_window_says() {
        // Half of the picture is data, to the right of its middle: the rest is black, nothing is stretched.
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("window.exr");
        let channels = exr::prelude::SpecificChannels::rgb(|_| (1.0f32, 2.0f32, 3.0f32));
        let mut image = exr::prelude::Image::from_channels((4, 2), channels);
        image.layer_data.attributes.layer_position = exr::math::Vec2(3, 1);
        image.attributes.display_window = exr::meta::attribute::IntegerBounds::from_dimensions((8, 4));
        exr::prelude::WritableImage::write(&image).to_file(&path).unwrap();
        let environment = Environment::read(&path).unwrap();
        assert_eq!((environment.width, environment.height), (8, 4));
        for (index, pixel) in environment.pixels.iter().enumerate() {
            let (x, y) = (index % 8, index / 8);
            let inside = (3..7).contains(&x) && (1..3).contains(&y);
            assert_eq!(*pixel, if inside { Rgb::new(1.0, 2.0, 3.0) } else { Rgb::ZERO }, "{x} {y}");
        }
    }

    #[test]
    fn files_that_cannot_be_an_environment_say_why() {
        for (name, part) in [
            ("blender-layers.exr", "its channels are ViewLayer.Combined.A, ViewLayer.Combined.B"),
            ("huge-window.exr", "cannot hold 1000000 × 1000000 pixels"),
            ("nan.exr", "not finite"),
        ] {
            let error = Environment::read(&case(name)).unwrap_err();
            let text = error.to_string();
            assert!(
                error.exit_code() == 2 && text.contains(part) && text.matches(name).count() == 1,
                "{text}"
            );
        }
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
