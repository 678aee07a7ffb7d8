//! Regions of a sample from a picture: texels of one colour are one region.

use std::path::Path;

use crate::edit::palette;
use lobelia_base::error::{Error, Result};
use lobelia_reflectance::picture_file;

/// Most regions: as many as an indexed picture has colours.
pub const MOST_REGIONS: usize = 256;

/// Which region every texel is of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Regions {
    /// Texels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The region of every texel, row by row, an index into `colours`; none for texels outside all of them.
    pub of: Vec<Option<usize>>,
    /// Their colours, 8-bit sRGB, in the order in which they are met, row by row.
    pub colours: Vec<[u8; 3]>,
}

impl Regions {
    /// Regions of a picture's pixels, (colour, opacity) row by row; pixels that are transparent or of the
    /// colour `outside` are of none.
    ///
    /// # Errors
    /// A sentence when there are more than [`MOST_REGIONS`] or none.
    pub fn of_pixels(
        [width, height]: [usize; 2],
        pixels: impl Iterator<Item = ([u8; 3], u8)>,
        outside: Option<[u8; 3]>,
    ) -> std::result::Result<Self, String> {
        let mut regions = Self { width, height, of: Vec::with_capacity(width * height), colours: Vec::new() };
        let mut places = std::collections::BTreeMap::new();
        for (colour, opacity) in pixels {
            if opacity == 0 || Some(colour) == outside {
                regions.of.push(None);
                continue;
            }
            let place = *places.entry(colour).or_insert(regions.colours.len());
            if place == regions.colours.len() {
                regions.colours.push(colour);
            }
            regions.of.push(Some(place));
        }
        match regions.colours.len() {
            0 => Err("no pixel is of a region".into()),
            1..=MOST_REGIONS => Ok(regions),
            count => Err(format!(
                "{count} colours are more regions than {MOST_REGIONS}; it has to be an indexed picture, with \
                 one colour a region"
            )),
        }
    }

    /// Reads an index image, as `lobelia edit cluster --index` writes them: an indexed, grey or coloured PNG
    /// of 8 bits a channel at most and one pixel a texel.
    ///
    /// # Errors
    /// Input errors for a file that cannot be read, of 16 bits a channel, of another size than the sample, or
    /// without or with too many regions.
    pub fn read(path: &Path, size: [usize; 2], outside: Option<[u8; 3]>) -> Result<Self> {
        let image = picture_file::decode(path)?;
        let wrong = |what: String| Error::input(format!("{}: {what}", path.display()));
        // Cut to 8 bits, colours that differ in the low ones alone would become one region.
        if image.color().bytes_per_pixel() != image.color().channel_count() {
            return Err(wrong("the index image has 16 bits a channel; write it with 8".into()));
        }
        let image = image.to_rgba8();
        let found = [image.width() as usize, image.height() as usize];
        if found != size {
            return Err(wrong(format!(
                "{} × {} pixels do not fit {} × {} texels; the index image needs one pixel a texel",
                found[0], found[1], size[0], size[1]
            )));
        }
        let pixels = image.pixels().map(|&image::Rgba([r, g, b, a])| ([r, g, b], a));
        Self::of_pixels(size, pixels, outside).map_err(wrong)
    }

    /// A region's number, from 1, and colour, as it is called in reports.
    pub fn name(&self, region: usize) -> String {
        format!("{} {}", region + 1, palette::hex(self.colours[region]))
    }

    /// The texels of every region, in order.
    pub fn texels(&self) -> Vec<Vec<usize>> {
        let mut texels = vec![Vec::new(); self.colours.len()];
        for (texel, region) in self.of.iter().enumerate() {
            if let Some(region) = *region {
                texels[region].push(texel);
            }
        }
        texels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_regions_whatever_the_kind_of_png_and_what_is_transparent_or_named_is_outside() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("index.png");
        let size = [3, 1];
        let pixels = [[9, 9, 9, 255], [5, 5, 5, 255], [9, 9, 9, 0]];
        image::RgbaImage::from_fn(3, 1, |x, _| image::Rgba(pixels[x as usize])).save(&path).unwrap();
        let regions = Regions::read(&path, size, None).unwrap();
        assert_eq!(regions.of, [Some(0), Some(1), None]);
        assert_eq!((regions.name(1), regions.texels()), ("2 #050505".into(), vec![vec![0], vec![1]]));
        image::GrayImage::from_fn(3, 1, |x, _| image::Luma([[9, 5, 9][x as usize]])).save(&path).unwrap();
        let grey = Regions::read(&path, size, Some([5; 3])).unwrap();
        assert_eq!((grey.of, grey.colours), (vec![Some(0), None, Some(0)], vec![[9; 3]]));

        let clusters: Vec<palette::Entry> = [[1, 2, 3], [4, 5, 6]]
            .map(|swatch| palette::Entry { swatch, brdf: lobelia_reflectance::LobeBrdf::default() })
            .into();
        palette::write_index(&path, 3, 1, &[1, 0, 1], &clusters).unwrap();
        let indexed = Regions::read(&path, size, None).unwrap();
        assert_eq!(
            (indexed.of, indexed.colours),
            (vec![Some(0), Some(1), Some(0)], vec![[4, 5, 6], [1, 2, 3]])
        );
    }

    #[test]
    fn sixteen_bits_a_channel_are_refused_since_regions_could_become_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("index.png");
        let grey = image::ImageBuffer::from_fn(2, 1, |x, _| image::Luma([0x0100 + x as u16]));
        let colour = image::ImageBuffer::from_fn(2, 1, |x, _| image::Rgb([0x0100 + x as u16; 3]));
        for picture in [image::DynamicImage::ImageLuma16(grey), image::DynamicImage::ImageRgb16(colour)] {
            picture.save(&path).unwrap();
            let error = Regions::read(&path, [2, 1], None).unwrap_err();
            assert!(error.exit_code() == 2 && error.to_string().contains("16 bits a channel"), "{error}");
        }
    }

    #[test]
    fn a_picture_of_another_size_a_photograph_and_one_without_regions_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("index.png");
        image::RgbImage::from_fn(20, 20, |x, y| image::Rgb([x as u8, y as u8, 0])).save(&path).unwrap();
        let refused = |size, outside| {
            let error = Regions::read(&path, size, outside).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            error.to_string()
        };
        assert!(refused([20, 21], None).contains("20 × 20 pixels do not fit 20 × 21 texels"));
        assert!(refused([20, 20], None).contains("400 colours are more regions than 256"));
        image::RgbImage::new(20, 20).save(&path).unwrap();
        assert!(refused([20, 20], Some([0; 3])).contains("no pixel is of a region"));
    }
}
