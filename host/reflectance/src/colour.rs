//! Colour: luminance, the sRGB transfer function and tone mapping for pictures that people look at.

use glam::{DMat3, DVec3, Mat3};

use crate::Rgb;

/// Luminance weights of linear Rec. 709 primaries with the D65 white.
pub const LUMINANCE: Rgb = Rgb::new(0.2126, 0.7152, 0.0722);

/// Luminance of a linear Rec. 709 colour.
pub fn luminance(rgb: Rgb) -> f32 {
    rgb.dot(LUMINANCE)
}

/// The primaries and the white of an RGB colour space, CIE 1931 x and y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Primaries {
    /// Red.
    pub red: [f64; 2],
    /// Green.
    pub green: [f64; 2],
    /// Blue.
    pub blue: [f64; 2],
    /// White: R = G = B.
    pub white: [f64; 2],
}

impl Primaries {
    /// Those of Rec. 709 and sRGB with D65.
    pub const REC709: Self =
        Self { red: [0.64, 0.33], green: [0.30, 0.60], blue: [0.15, 0.06], white: [0.3127, 0.3290] };

    /// The matrix from linear colours of this space to linear Rec. 709; whites are adapted by Bradford's cone
    /// responses, so that white stays white. None for primaries that span no space, and the identity for
    /// those of Rec. 709 to the digits of a file.
    pub fn to_rec709(&self) -> Option<Mat3> {
        let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs() < 1e-4 && (a[1] - b[1]).abs() < 1e-4;
        let goal = Self::REC709;
        let pairs = [
            (self.red, goal.red),
            (self.green, goal.green),
            (self.blue, goal.blue),
            (self.white, goal.white),
        ];
        if pairs.iter().all(|&(a, b)| near(a, b)) {
            return Some(Mat3::IDENTITY);
        }
        let (from, to) = (self.to_xyz()?, goal.to_xyz()?);
        let adapted = adaptation(xyz(self.white)?, xyz(goal.white)?)?;
        let matrix = to.inverse() * adapted * from;
        matrix.is_finite().then(|| matrix.as_mat3())
    }

    /// Linear Rec. 709 of CIE XYZ with Y = 1 for its white.
    pub fn from_xyz(xyz: DVec3) -> DVec3 {
        Self::REC709.to_xyz().map_or(DVec3::ZERO, |matrix| matrix.inverse() * xyz)
    }

    /// The matrix to CIE XYZ with Y = 1 for white.
    fn to_xyz(self) -> Option<DMat3> {
        let columns = DMat3::from_cols(xyz(self.red)?, xyz(self.green)?, xyz(self.blue)?);
        if columns.determinant().abs() < 1e-9 {
            return None;
        }
        let scale = columns.inverse() * xyz(self.white)?;
        let matrix = columns * DMat3::from_diagonal(scale);
        (matrix.is_finite() && matrix.determinant().abs() > 1e-9).then_some(matrix)
    }
}

/// XYZ of a chromaticity with Y = 1; with X + Y + Z = 1 where y is 0, as some imaginary primaries have it.
fn xyz([x, y]: [f64; 2]) -> Option<DVec3> {
    let sum = DVec3::new(x, y, 1.0 - x - y);
    let scaled = if y.abs() < 1e-6 { sum } else { sum / y };
    scaled.is_finite().then_some(scaled)
}

/// The change of white of Bradford's model (Lam 1985), in XYZ.
fn adaptation(from: DVec3, to: DVec3) -> Option<DMat3> {
    let cones = DMat3::from_cols(
        DVec3::new(0.8951, -0.7502, 0.0389),
        DVec3::new(0.2664, 1.7135, -0.0685),
        DVec3::new(-0.1614, 0.0367, 1.0296),
    );
    let gain = (cones * to) / (cones * from);
    gain.is_finite().then(|| cones.inverse() * DMat3::from_diagonal(gain) * cones)
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
    fn aces_primaries_come_to_rec_709_by_the_published_matrix_and_white_stays_white() {
        // SMPTE ST 2065-1; the matrix with Bradford's adaptation from D60 to D65 as the Academy and
        // OpenColorIO print it.
        let aces = Primaries {
            red: [0.7347, 0.2653],
            green: [0.0, 1.0],
            blue: [0.0001, -0.0770],
            white: [0.32168, 0.33767],
        };
        let matrix = aces.to_rec709().unwrap();
        let published = Mat3::from_cols_array(&[
            2.52169, -0.27648, -0.01538, -1.13413, 1.37272, -0.15298, -0.38756, -0.09624, 1.16835,
        ]);
        assert!(matrix.abs_diff_eq(published, 2e-4), "{matrix}");
        assert!((matrix * Rgb::ONE - Rgb::ONE).abs().max_element() < 1e-5);
        assert_eq!(Primaries::REC709.to_rec709(), Some(Mat3::IDENTITY));
        let flat = Primaries { blue: Primaries::REC709.red, ..Primaries::REC709 };
        assert_eq!(flat.to_rec709(), None);
    }

    #[test]
    fn tone_mapping_takes_white_to_one_and_keeps_order() {
        assert!((luminance(tone_map(Rgb::splat(4.0), 1.0, 4.0)) - 1.0).abs() < 1e-6);
        assert!(luminance(tone_map(Rgb::splat(2.0), 1.0, 4.0)) < 1.0);
    }
}
