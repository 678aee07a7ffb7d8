//! Colour: luminance, the sRGB transfer function and tone mapping for pictures that people look at.

use crate::Rgb;

/// Luminance weights of linear Rec. 709 primaries with the D65 white.
pub const LUMINANCE: Rgb = Rgb::new(0.2126, 0.7152, 0.0722);

/// Luminance of a linear Rec. 709 colour.
pub fn luminance(rgb: Rgb) -> f32 {
    rgb.dot(LUMINANCE)
}

/// sRGB's transfer function (IEC 61966-2-1), linear 0..1 to encoded 0..1; values outside are clamped.
pub fn srgb_encode(linear: f32) -> f32 {
    let x = linear.clamp(0.0, 1.0);
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// The inverse of [`srgb_encode`].
pub fn srgb_decode(encoded: f32) -> f32 {
    let x = encoded.clamp(0.0, 1.0);
    if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

/// Linear colour to 8-bit sRGB, clipped at 1. NaN becomes black.
pub fn to_srgb8(linear: Rgb) -> [u8; 3] {
    linear.to_array().map(|x| (srgb_encode(if x.is_nan() { 0.0 } else { x }) * 255.0 + 0.5) as u8)
}

/// Extended Reinhard tone mapping on luminance: maps `white` to 1 and keeps hue. Linear in, linear out.
pub fn tone_map(linear: Rgb, exposure: f32, white: f32) -> Rgb {
    let scaled = (linear * exposure).max(Rgb::ZERO);
    let y = luminance(scaled);
    if y <= 0.0 {
        return Rgb::ZERO;
    }
    let mapped = y * (1.0 + y / (white * white)) / (1.0 + y);
    scaled * (mapped / y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_encoding_and_decoding_are_inverse() {
        for i in 0..=1000 {
            let x = i as f32 / 1000.0;
            assert!((srgb_decode(srgb_encode(x)) - x).abs() < 2e-6);
        }
    }

    #[test]
    fn tone_mapping_takes_white_to_one_and_keeps_order() {
        assert!((luminance(tone_map(Rgb::splat(4.0), 1.0, 4.0)) - 1.0).abs() < 1e-6);
        assert!(luminance(tone_map(Rgb::splat(2.0), 1.0, 4.0)) < 1.0);
    }
}
