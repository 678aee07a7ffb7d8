//! Reader of the MERL tables (`.binary`, Matusik et al. 2003): 90 × 90 × 180 cells in (θ_h, θ_d, φ_d), three planes of f64.
//!
//! The header is three little-endian i32 counts. θ_h of cell i is (i / 90)² · 90°, θ_d and φ_d are even over 90° and 180°. The
//! stored values times 1/1500, 1.15/1500 and 1.66/1500 are red, green and blue in sr⁻¹; negative ones were not measured.
//!
//! Of the 1.5 million cells every 2nd in θ_h, 6th in θ_d and 15th in φ_d becomes a row: as many as tell lobes apart, and few enough to
//! search all starts on.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::DVec3;

use super::{MeasuredTable, TableRow, ascending};
use crate::FormatError;

const CELLS: [usize; 3] = [90, 90, 180];
const STEPS: [usize; 3] = [2, 6, 15];
const HEADER: usize = 12;
/// Factors of the stored red, green and blue, sr⁻¹.
const SCALE: [f64; 3] = [1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0];

pub(super) fn parse(bytes: &[u8]) -> Result<MeasuredTable, FormatError> {
    let invalid = |message: String| FormatError::Invalid(message);
    let count = |k: usize| {
        bytes.get(4 * k..4 * k + 4).and_then(|four| four.first_chunk::<4>()).map(|x| i32::from_le_bytes(*x))
    };
    let counts = [count(0), count(1), count(2)];
    if counts != CELLS.map(|cells| Some(cells as i32)) {
        return Err(invalid("not a MERL table: it does not begin with the counts 90, 90, 180".into()));
    }
    let plane: usize = CELLS.iter().product();
    let expected = HEADER + 3 * 8 * plane;
    if bytes.len() != expected {
        return Err(invalid(format!(
            "{} bytes where a MERL table has {expected}; the file is cut short",
            bytes.len()
        )));
    }
    let stored = |index: usize| {
        let place = HEADER + 8 * index;
        bytes[place..place + 8].first_chunk::<8>().map_or(f64::NAN, |eight| f64::from_le_bytes(*eight))
    };
    let mut rows = Vec::new();
    for i in (0..CELLS[0]).step_by(STEPS[0]) {
        for j in (0..CELLS[1]).step_by(STEPS[1]) {
            for k in (0..CELLS[2]).step_by(STEPS[2]) {
                let cell = (i * CELLS[1] + j) * CELLS[2] + k;
                let values: Vec<f64> = (0..3).map(|c| stored(c * plane + cell) * SCALE[c]).collect();
                if values.iter().any(|value| value.is_nan() || value.is_infinite()) {
                    return Err(invalid(format!("cell {cell} holds a value that is not finite")));
                }
                if values.iter().all(|&value| value >= 0.0)
                    && let Some(row) = row(middle(i, j, k), values)
                {
                    rows.push(row);
                }
            }
        }
    }
    if rows.is_empty() {
        return Err(invalid("the table has no cell with a measured value".into()));
    }
    Ok(ascending(rows))
}

/// θ_h, θ_d and φ_d at the middle of a cell, radians.
fn middle(i: usize, j: usize, k: usize) -> [f64; 3] {
    let at = |index: usize, axis: usize| (index as f64 + 0.5) / CELLS[axis] as f64;
    [at(i, 0).powi(2) * FRAC_PI_2, at(j, 1) * FRAC_PI_2, at(k, 2) * PI]
}

/// The directions of half and difference angles (Rusinkiewicz 1998); none where one is below the surface.
fn row([theta_h, theta_d, phi_d]: [f64; 3], values: Vec<f64>) -> Option<TableRow> {
    let (sin_h, cos_h) = theta_h.sin_cos();
    let (sin_d, cos_d) = theta_d.sin_cos();
    let difference = DVec3::new(sin_d * phi_d.cos(), sin_d * phi_d.sin(), cos_d);
    // Turned about y by θ_h, which takes z to the half vector at azimuth 0.
    let turn = |d: DVec3| DVec3::new(cos_h * d.x + sin_h * d.z, d.y, cos_h * d.z - sin_h * d.x);
    let (wi, wo) = (turn(difference), turn(DVec3::new(-difference.x, -difference.y, difference.z)));
    let angles = |d: DVec3| (d.z.clamp(-1.0, 1.0).acos(), d.y.atan2(d.x));
    let ((theta_i, phi_i), (theta_o, phi_o)) = (angles(wi), angles(wo));
    (wi.z > 0.0 && wo.z > 0.0).then_some(TableRow { theta_i, phi_i, theta_o, phi_o, values })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::RGB_WAVELENGTHS_NM;

    /// A table of a function of θ_h (red), θ_d (green) and φ_d (blue).
    fn bytes() -> Vec<u8> {
        let mut bytes: Vec<u8> = CELLS.iter().flat_map(|&cells| (cells as i32).to_le_bytes()).collect();
        for (c, scale) in SCALE.into_iter().enumerate() {
            for cell in 0..CELLS.iter().product::<usize>() {
                let (i, j, k) = (cell / (90 * 180), cell / 180 % 90, cell % 180);
                let stored = if i == 40 { -1.0 } else { middle(i, j, k)[c] / scale };
                bytes.extend(stored.to_le_bytes());
            }
        }
        bytes
    }

    #[test]
    fn rows_have_the_half_and_difference_angles_of_their_cells() {
        let table = parse(&bytes()).unwrap();
        assert!(table.rows.len() > 4000, "{}", table.rows.len());
        for (row, colour) in table.rows.iter().zip(table.rgb(RGB_WAVELENGTHS_NM).unwrap()) {
            let half = (row.wi() + row.wo()).normalize();
            assert!((half.z.acos() - f64::from(colour.x)).abs() < 1e-6);
            assert!((row.wi().dot(half).clamp(-1.0, 1.0).acos() - f64::from(colour.y)).abs() < 1e-6);
        }
    }

    #[test]
    fn other_files_and_short_ones_are_refused() {
        let refused = |bytes: &[u8]| parse(bytes).unwrap_err().to_string();
        assert!(refused(b"brdf").contains("not a MERL table"));
        let mut short = bytes();
        short.truncate(1000);
        assert!(refused(&short).contains("cut short"));
        let mut wrong = bytes();
        wrong[12..20].copy_from_slice(&f64::NAN.to_le_bytes());
        assert!(refused(&wrong).contains("not finite"));
    }
}
