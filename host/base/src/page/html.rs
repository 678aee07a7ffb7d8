//! Pieces of the page: escaped text, pictures as data URIs, figures, colour bars.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::colour_map::ColourMap;
use super::numbers;
use super::scale::Scale;
use crate::error::{Error, Result};

/// Text with the characters that HTML reserves written out.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A PNG file as an address that needs no other file.
pub fn data_uri(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", STANDARD.encode(png))
}

/// A picture; `class` decides how it is scaled.
pub fn picture(png: &[u8], alt: &str, class: &str) -> String {
    format!("<img class=\"{class}\" alt=\"{}\" src=\"{}\">", escape(alt), data_uri(png))
}

/// A figure of any content with a caption that is HTML already.
pub fn figure(content: &str, caption: &str) -> String {
    format!("<figure>{content}<figcaption>{caption}</figcaption></figure>\n")
}

/// A section with its heading and the sentence under it, which is HTML already.
pub fn section(id: &str, heading: &str, lead: &str, content: &str) -> String {
    format!(
        "<section id=\"{id}\">\n<h2>{}</h2>\n<p class=\"lead\">{lead}</p>\n{content}</section>\n",
        escape(heading)
    )
}

/// A colour bar with ticks and unit.
pub fn colour_bar(map: ColourMap, scale: &Scale, unit: &str, most_ticks: usize) -> String {
    let values = scale.ticks(most_ticks);
    let place = |(value, text): (&f64, String)| {
        format!("<span style=\"left:{:.1}%\">{text}</span>", 100.0 * scale.place(*value))
    };
    let ticks: String = values.iter().zip(numbers::ticks(&values)).map(place).collect();
    let unit = if unit.is_empty() { String::new() } else { format!("<i>{}</i>", escape(unit)) };
    format!(
        "<div class=\"bar\"><div class=\"ramp\" style=\"background:{}\"></div><div \
         class=\"ticks\">{ticks}</div>{unit}</div>",
        map.css()
    )
}

/// Pixels of a picture, red, green, blue and opacity.
pub struct Raster {
    /// Pixels a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row from the top.
    pub pixels: Vec<[u8; 4]>,
}

impl Raster {
    /// Opaque pixels, one for each index.
    pub fn opaque(width: usize, height: usize, colour: impl Fn(usize) -> [u8; 3]) -> Self {
        let opaque = |k: usize| {
            let [r, g, b] = colour(k);
            [r, g, b, 255]
        };
        Self { width, height, pixels: (0..width * height).map(opaque).collect() }
    }

    /// Values through a colour map; what is not finite stays transparent.
    pub fn mapped(width: usize, values: &[f32], scale: &Scale, map: ColourMap) -> Self {
        let pixel = |&value: &f32| {
            let [r, g, b] = map.at(scale.place(f64::from(value)));
            if value.is_finite() { [r, g, b, 255] } else { [0; 4] }
        };
        Self { width, height: values.len() / width.max(1), pixels: values.iter().map(pixel).collect() }
    }

    /// The bytes of a PNG file, without opacity where all is opaque and in grey where all is grey.
    ///
    /// # Errors
    /// When the encoder refuses the size.
    pub fn png(&self) -> Result<Vec<u8>> {
        use image::ExtendedColorType::{L8, Rgb8, Rgba8};
        let opaque = self.pixels.iter().all(|pixel| pixel[3] == 255);
        let grey = opaque && self.pixels.iter().all(|[r, g, b, _]| r == g && g == b);
        let (kind, parts) = match (opaque, grey) {
            (true, true) => (L8, 1),
            (true, false) => (Rgb8, 3),
            _ => (Rgba8, 4),
        };
        let data: Vec<u8> = self.pixels.iter().flat_map(|pixel| &pixel[..parts]).copied().collect();
        encode(&data, self.width, self.height, kind)
    }
}

/// Encodes a PNG file, slowly and small.
fn encode(data: &[u8], width: usize, height: usize, kind: image::ExtendedColorType) -> Result<Vec<u8>> {
    use image::ImageEncoder;
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::Adaptive)
        .write_image(data, width as u32, height as u32, kind)
        .map_err(|error| {
            Error::failure(format!("a picture of the page cannot be encoded: {error}")).caused_by(error)
        })?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_come_back_from_their_data_uri() {
        let raster = Raster::opaque(3, 2, |k| [k as u8, 10, 20]);
        let uri = data_uri(&raster.png().unwrap());
        let bytes = STANDARD.decode(uri.strip_prefix("data:image/png;base64,").unwrap()).unwrap();
        let read = image::load_from_memory(&bytes).unwrap().to_rgb8();
        assert_eq!((read.dimensions(), read.get_pixel(2, 1).0), ((3, 2), [5, 10, 20]));
    }

    #[test]
    fn text_cannot_break_out_of_the_page() {
        assert_eq!(escape("<b a=\"1\">&"), "&lt;b a=&quot;1&quot;&gt;&amp;");
    }

    #[test]
    fn values_that_are_not_finite_stay_transparent() {
        let raster = Raster::mapped(2, &[f32::NAN, 1.0], &Scale::linear(0.0, 1.0), ColourMap::Viridis);
        assert_eq!(raster.pixels, [[0, 0, 0, 0], [253, 231, 37, 255]]);
    }
}
