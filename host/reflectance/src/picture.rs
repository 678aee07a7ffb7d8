//! Pictures: linear radiance with coverage, written as OpenEXR or as a tone-mapped PNG.

use std::path::Path;

use exr::prelude::{Blocks, Compression, Encoding, Image, LineOrder, SpecificChannels, WritableImage};
use glam::Vec4;

use crate::{Rgb, colour, exr_file};
use lobelia_base::error::{Error, Result};
use lobelia_base::files;

/// Luminance that tone mapping takes to full white.
const WHITE: f32 = 3.0;

/// Linear Rec. 709 radiance and coverage, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green, blue radiance, background included; alpha is the part of the pixel that objects cover.
    pub pixels: Vec<Vec4>,
}

impl Picture {
    /// The linear colour of a pixel.
    pub fn rgb(&self, x: usize, y: usize) -> Rgb {
        self.pixels[y * self.width + x].truncate()
    }

    /// 8-bit sRGB after extended Reinhard tone mapping with the exposure given.
    pub fn tone_mapped(&self, exposure: f32) -> Vec<u8> {
        let map = |p: &Vec4| colour::to_srgb8(colour::tone_map(p.truncate(), exposure, WHITE));
        self.pixels.iter().flat_map(map).collect()
    }

    /// The tone-mapped picture as the bytes of a PNG file.
    ///
    /// # Errors
    /// When the encoder refuses the size.
    pub fn png(&self, exposure: f32) -> Result<Vec<u8>> {
        use image::ImageEncoder;
        let mut bytes = Vec::new();
        image::codecs::png::PngEncoder::new(&mut bytes)
            .write_image(
                &self.tone_mapped(exposure),
                self.width as u32,
                self.height as u32,
                image::ExtendedColorType::Rgb8,
            )
            .map_err(|error| {
                Error::failure(format!("the picture cannot be encoded as PNG: {error}")).caused_by(error)
            })?;
        Ok(bytes)
    }

    /// Writes a linear `.exr` (f32 RGBA) or a tone-mapped `.png`, whole or not at all.
    ///
    /// # Errors
    /// Input errors for another extension, failures of the disk and for a pixel that is not a number, which
    /// is named.
    pub fn write(&self, path: &Path, exposure: f32) -> Result<()> {
        if let Some(k) = self.pixels.iter().position(|pixel| !pixel.is_finite()) {
            let (x, y) = (k % self.width, k / self.width);
            let message = format!(
                "{}: pixel ({x}, {y}) came out as {}; look for a light or a coefficient there that is far \
                 too large",
                path.display(),
                self.pixels[k].truncate()
            );
            return Err(Error::failure(message));
        }
        match picture_kind(path) {
            Some(PictureKind::Exr) => self.write_exr(path),
            Some(PictureKind::Png) => files::write_bytes(path, &self.png(exposure)?),
            None => Err(Error::input(format!("{}: a picture's name ends in .exr or .png", path.display()))),
        }
    }

    /// Reads an OpenEXR picture in Rec. 709; coverage is 1 where it has no alpha. What lies outside its data
    /// window is 0, and other primaries are converted where the file names them.
    ///
    /// # Errors
    /// Input errors for a file that is missing, has no channels R, G and B or Y, or is an SBRDF map.
    pub fn read_exr(path: &Path) -> Result<Self> {
        Ok(Self::read_exr_layer(path)?.0)
    }

    /// As [`Self::read_exr`], and whether the picture is the six faces of a cube.
    ///
    /// # Errors
    /// As [`Self::read_exr`].
    pub fn read_exr_layer(path: &Path) -> Result<(Self, bool)> {
        let layer = exr_file::read(path, "channels R, G and B", |names| {
            let has = |wanted: &[&str]| wanted.iter().all(|name| names.contains(name));
            // Of a map R, G and B are only a view.
            let map = has(&["rho_d.R"]).then(Vec::new);
            let colour = || has(&["R", "G", "B"]).then(|| vec!["R", "G", "B"]);
            let grey = || has(&["Y"]).then(|| vec!["Y"]);
            let found = map.or_else(colour).or_else(grey)?;
            let alpha = names.contains(&"A").then_some("A");
            Some(found.into_iter().chain(alpha).map(String::from).collect())
        })
        .map_err(Error::format)?;
        let plane = |name: &str| layer.channels.get(name);
        let planes = [("R", "Y"), ("G", "Y"), ("B", "Y")].map(|(colour, grey)| plane(colour).or(plane(grey)));
        let [Some(red), Some(green), Some(blue)] = planes else {
            return Err(Error::reading(
                path,
                "it is an SBRDF map and no picture; render a scene that names it",
            ));
        };
        let matrix = layer.primaries.map_or(Some(glam::Mat3::IDENTITY), |primaries| primaries.to_rec709());
        let matrix = matrix.ok_or_else(|| Error::reading(path, "its chromaticities span no colour space"))?;
        let pixel = |k: usize| {
            let colour = Rgb::new(red[k], green[k], blue[k]);
            let colour = if matrix == glam::Mat3::IDENTITY { colour } else { matrix * colour };
            colour.extend(plane("A").map_or(1.0, |alpha| alpha[k]))
        };
        let pixels = (0..red.len()).map(pixel).collect();
        Ok((Self { width: layer.width, height: layer.height, pixels }, layer.cube))
    }

    /// Linear OpenEXR.
    fn write_exr(&self, path: &Path) -> Result<()> {
        let channels = SpecificChannels::rgba(|at: exr::math::Vec2<usize>| {
            let pixel = self.pixels[at.y() * self.width + at.x()];
            (pixel.x, pixel.y, pixel.z, pixel.w)
        });
        // Deflated lines are what every program that shows pictures opens. In order: unordered ones are
        // written as the threads that compress them end, other bytes each time.
        let encoding = Encoding {
            compression: Compression::ZIP16,
            blocks: Blocks::ScanLines,
            line_order: LineOrder::Increasing,
        };
        let image = Image::from_encoded_channels((self.width, self.height), encoding, channels);
        let mut bytes = std::io::Cursor::new(Vec::new());
        image.write().to_buffered(&mut bytes).map_err(|error| Error::writing(path, error))?;
        files::write_bytes(path, bytes.get_ref())
    }
}

/// Formats that pictures are written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureKind {
    /// Linear OpenEXR.
    Exr,
    /// Tone-mapped 8-bit PNG.
    Png,
}

/// The format that a file's name asks for by its extension.
pub fn picture_kind(path: &Path) -> Option<PictureKind> {
    match path.extension()?.to_string_lossy().to_lowercase().as_str() {
        "exr" => Some(PictureKind::Exr),
        "png" => Some(PictureKind::Png),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn example() -> Picture {
        let pixels = (0..6).map(|i| Vec4::new(i as f32, 0.5, 1e-3, 1.0)).collect();
        Picture { width: 3, height: 2, pixels }
    }

    #[test]
    fn exr_keeps_linear_values_and_no_temporary_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("picture.exr");
        example().write(&path, 1.0).unwrap();
        let read = Picture::read_exr(&path).unwrap();
        assert_eq!(read.rgb(2, 1), Rgb::new(5.0, 0.5, 1e-3));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_pixel_that_is_not_a_number_is_named_and_nothing_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("picture.png");
        let mut picture = example();
        picture.pixels[4].y = f32::NAN;
        let error = picture.write(&path, 1.0).unwrap_err();
        assert!(error.exit_code() == 1 && error.to_string().contains("pixel (1, 1)"), "{error}");
        assert!(!path.exists());
    }

    #[test]
    fn png_is_tone_mapped_and_other_names_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("picture.png");
        example().write(&path, 1.0).unwrap();
        let read = image::open(&path).unwrap().to_rgb8();
        assert_eq!(read.dimensions(), (3, 2));
        assert_eq!(example().write(&folder.path().join("p.bmp"), 1.0).unwrap_err().exit_code(), 2);
        assert!(example().write(&path.join("p.exr"), 1.0).is_err());
    }
}
