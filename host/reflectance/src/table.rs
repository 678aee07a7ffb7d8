//! Measured BRDF tables: the Cornell `.brdf` text format, ALTA's text format, MERL's `.binary`, and a smooth
//! interpolation that is fast enough for a renderer.
//!
//! A table is a list of scattered direction pairs, each with a reflectance a wavelength. [`MeasuredTable`]
//! holds the rows as they were measured; [`InterpolatedBrdf`] fills a regular grid from them once and then
//! answers for any pair of directions.

mod alta;
mod interpolated;
mod merl;
mod parse;

use std::path::Path;

use glam::DVec3;

pub use interpolated::InterpolatedBrdf;

use crate::{FormatError, Rgb};

/// Wavelengths, nm, that stand for red, green and blue unless others are asked for.
pub const RGB_WAVELENGTHS_NM: [f64; 3] = [650.0, 550.0, 450.0];

/// One measured pair of directions.
#[derive(Debug, Clone, PartialEq)]
pub struct TableRow {
    /// Polar angle of the incident direction, radians.
    pub theta_i: f64,
    /// Azimuth of the incident direction, radians.
    pub phi_i: f64,
    /// Polar angle of the exitant direction, radians.
    pub theta_o: f64,
    /// Azimuth of the exitant direction, radians.
    pub phi_o: f64,
    /// Reflectance a wavelength, sr⁻¹; measurement noise can leave it slightly negative.
    pub values: Vec<f64>,
}

impl TableRow {
    /// Unit vector toward the light.
    pub fn wi(&self) -> DVec3 {
        direction(self.theta_i, self.phi_i)
    }

    /// Unit vector toward the viewer.
    pub fn wo(&self) -> DVec3 {
        direction(self.theta_o, self.phi_o)
    }
}

/// The unit vector of a polar angle and an azimuth, radians.
fn direction(theta: f64, phi: f64) -> DVec3 {
    let ((sin_theta, cos_theta), (sin_phi, cos_phi)) = (theta.sin_cos(), phi.sin_cos());
    DVec3::new(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta)
}

/// A measured table as it stands in its file.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredTable {
    /// Wavelengths, nm, ascending. A table of colours has those of [`RGB_WAVELENGTHS_NM`], one of a single
    /// value that names none 550 nm.
    pub wavelengths_nm: Vec<f64>,
    /// The rows in the order of the file.
    pub rows: Vec<TableRow>,
}

impl MeasuredTable {
    /// Reads a table: MERL's where the name ends in `.binary`, ALTA's, text or binary, where lines of its
    /// header begin the file, else Cornell's.
    ///
    /// # Errors
    /// When the file is missing, or as [`Self::parse`]; the sentence names the file.
    pub fn read(path: &Path) -> Result<Self, FormatError> {
        let named =
            |error: &dyn std::fmt::Display| FormatError::Invalid(format!("{}: {error}", path.display()));
        let bytes = std::fs::read(path).map_err(|error| FormatError::Unreadable {
            message: format!("{}: cannot be read: {error}", path.display()),
            source: error.into(),
        })?;
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("binary")) {
            return merl::parse(&bytes).map_err(|error| named(&error));
        }
        Self::parse_bytes(&bytes).map_err(|error| named(&error))
    }

    /// Parses the text of a `.brdf` file: the number of wavelengths, the wavelengths in nm, then rows
    /// `theta_i phi_i theta_s phi_s value…` in radians and sr⁻¹. `#` starts a comment; tokens can wrap over
    /// lines.
    ///
    /// # Errors
    /// A sentence with the line, and the row where there is one, for: no or too many wavelengths, something
    /// that is not a number, NaN or infinity, an angle outside the hemisphere, a value too negative for noise
    /// or too large for a reflectance, a last row cut short. A text that begins with lines of ALTA's header
    /// is taken for ALTA's format.
    pub fn parse(text: &str) -> Result<Self, FormatError> {
        Self::parse_bytes(text.as_bytes())
    }

    /// Parses the bytes of a file that is not MERL's.
    fn parse_bytes(bytes: &[u8]) -> Result<Self, FormatError> {
        // The mark that Windows' editors put before text in UTF-8.
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        if alta::is_alta(bytes) {
            return alta::parse(bytes);
        }
        let text = std::str::from_utf8(bytes).map_err(|error| {
            let line = 1 + bytes[..error.valid_up_to()].iter().filter(|&&byte| byte == b'\n').count();
            parse::invalid(
                line,
                "not text (only MERL tables, named .binary, and ALTA's with #FORMAT binary are not)",
            )
        })?;
        parse::parse(text)
    }

    /// The values of every row at one wavelength, interpolated linearly between the two nearest measured
    /// ones, sr⁻¹.
    ///
    /// # Errors
    /// When the wavelength lies outside the measured range.
    pub fn at_wavelength(&self, wavelength_nm: f64) -> Result<Vec<f64>, FormatError> {
        let (first, last) = (self.wavelengths_nm[0], self.wavelengths_nm[self.wavelengths_nm.len() - 1]);
        if !(first..=last).contains(&wavelength_nm) {
            let message = format!("{wavelength_nm} nm lies outside the measured {first} to {last} nm");
            return Err(FormatError::Invalid(message));
        }
        let above = self.wavelengths_nm.partition_point(|&x| x < wavelength_nm);
        let below = if self.wavelengths_nm[above] == wavelength_nm { above } else { above - 1 };
        let span = self.wavelengths_nm[above] - self.wavelengths_nm[below];
        let t = if span > 0.0 { (wavelength_nm - self.wavelengths_nm[below]) / span } else { 0.0 };
        Ok(self.rows.iter().map(|row| row.values[below] * (1.0 - t) + row.values[above] * t).collect())
    }

    /// Every row's colour at the wavelengths that stand for red, green and blue (see [`RGB_WAVELENGTHS_NM`]),
    /// sr⁻¹.
    ///
    /// # Errors
    /// As [`Self::at_wavelength`].
    pub fn rgb(&self, wavelengths_nm: [f64; 3]) -> Result<Vec<Rgb>, FormatError> {
        let [r, g, b] = wavelengths_nm.map(|wavelength| self.at_wavelength(wavelength));
        let (r, g, b) = (r?, g?, b?);
        Ok((0..r.len()).map(|k| Rgb::new(r[k] as f32, g[k] as f32, b[k] as f32)).collect())
    }
}

/// Unit vectors toward the light and toward the view by half and difference angles (Rusinkiewicz 1998): the
/// difference (θ_d, φ_d), turned with the half vector's (θ_h, φ_h).
fn half_angles(theta_h: f64, phi_h: f64, theta_d: f64, phi_d: f64) -> [DVec3; 2] {
    let difference = direction(theta_d, phi_d);
    // About y by θ_h, which takes z to the half vector at azimuth 0, then about z by φ_h.
    let turn = glam::DQuat::from_rotation_z(phi_h) * glam::DQuat::from_rotation_y(theta_h);
    [difference, DVec3::new(-difference.x, -difference.y, difference.z)].map(|d| turn * d)
}

/// A table of rows with one value, or with red, green and blue.
fn ascending(mut rows: Vec<TableRow>) -> MeasuredTable {
    let [red, green, blue] = RGB_WAVELENGTHS_NM;
    rows.iter_mut().for_each(|row| row.values.reverse());
    let colours = rows.first().is_some_and(|row| row.values.len() == 3);
    MeasuredTable { wavelengths_nm: if colours { vec![blue, green, red] } else { vec![green] }, rows }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wavelength_between_two_is_their_blend_and_outside_is_refused() {
        let table = MeasuredTable::parse("2 400 500  0.1 0 0.2 0  1.0 3.0").unwrap();
        assert!((table.at_wavelength(425.0).unwrap()[0] - 1.5).abs() < 1e-12);
        assert_eq!(table.at_wavelength(400.0).unwrap(), [1.0]);
        assert_eq!(table.at_wavelength(500.0).unwrap(), [3.0]);
        let error = table.at_wavelength(501.0).unwrap_err().to_string();
        assert!(error.contains("501 nm lies outside the measured 400 to 500 nm"), "{error}");
        assert!(table.rgb(RGB_WAVELENGTHS_NM).is_err());
    }

    #[test]
    fn a_missing_and_a_binary_file_are_named() {
        let missing = MeasuredTable::read(Path::new("/nowhere/paint.brdf")).unwrap_err().to_string();
        assert!(missing.contains("/nowhere/paint.brdf: cannot be read"), "{missing}");
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), b"2 400\n\xff\xfe").unwrap();
        let binary = MeasuredTable::read(file.path()).unwrap_err().to_string();
        assert!(binary.contains("line 2: not text"), "{binary}");
    }
}
