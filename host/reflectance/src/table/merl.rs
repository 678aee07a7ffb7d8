//! Reader of the MERL tables (`.binary`, Matusik et al. 2003): 90 × 90 × 180 cells in (θ_h, θ_d, φ_d), three
//! planes of f64.
//!
//! The header is three little-endian i32 counts. θ_h of cell i is (i / 90)² · 90°, θ_d and φ_d are even over
//! 90° and 180°; tables with 360 cells in φ_d have them over 360°. The stored values times 1/1500, 1.15/1500
//! and 1.66/1500 are red, green and blue in sr⁻¹; negative ones were not measured.
//!
//! Of the 1.5 million cells every 2nd in θ_h, 6th in θ_d and 15th in φ_d becomes a row: as many as tell lobes
//! apart, and few enough to search all starts on.

use std::f64::consts::{FRAC_PI_2, PI};

use super::{MeasuredTable, TableRow, ascending, half_angles};
use crate::FormatError;

const CELLS: [usize; 3] = [90, 90, 180];
/// Cells in φ_d of tables that have it over 360°.
const WHOLE_TURN: usize = 360;
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
    let azimuths = if counts[2] == Some(WHOLE_TURN as i32) { WHOLE_TURN } else { CELLS[2] };
    let cells = [CELLS[0], CELLS[1], azimuths];
    if counts != cells.map(|cells| Some(cells as i32)) {
        return Err(invalid(
            "not a MERL table: it does not begin with the counts 90, 90, 180 (or 360 for a whole turn)"
                .into(),
        ));
    }
    let plane: usize = cells.iter().product();
    let expected = HEADER + 3 * 8 * plane;
    if bytes.len() != expected {
        return Err(invalid(format!(
            "{} bytes where a MERL table of {azimuths} azimuths has {expected}; the file is cut short",
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
            for k in (0..azimuths).step_by(STEPS[2]) {
                let cell = (i * CELLS[1] + j) * azimuths + k;
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

/// The row of half and difference angles; none where a direction is below the surface.
fn row([theta_h, theta_d, phi_d]: [f64; 3], values: Vec<f64>) -> Option<TableRow> {
    let [wi, wo] = half_angles(theta_h, 0.0, theta_d, phi_d);
    let angles = |d: glam::DVec3| (d.z.clamp(-1.0, 1.0).acos(), d.y.atan2(d.x));
    let ((theta_i, phi_i), (theta_o, phi_o)) = (angles(wi), angles(wo));
    (wi.z > 0.0 && wo.z > 0.0).then_some(TableRow { theta_i, phi_i, theta_o, phi_o, values })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::RGB_WAVELENGTHS_NM;

    /// A table of a function of θ_h (red), θ_d (green) and φ_d (blue).
    fn bytes(azimuths: usize) -> Vec<u8> {
        let cells = [90, 90, azimuths];
        let mut bytes: Vec<u8> = cells.iter().flat_map(|&cells| (cells as i32).to_le_bytes()).collect();
        for (c, scale) in SCALE.into_iter().enumerate() {
            for cell in 0..cells.iter().product::<usize>() {
                let (i, j, k) = (cell / (90 * azimuths), cell / azimuths % 90, cell % azimuths);
                let stored = if i == 40 { -1.0 } else { middle(i, j, k)[c] / scale };
                bytes.extend(stored.to_le_bytes());
            }
        }
        bytes
    }

    #[test]
    fn rows_have_the_half_and_difference_angles_of_their_cells() {
        for (azimuths, least) in [(180, 4000), (360, 8000)] {
            let table = parse(&bytes(azimuths)).unwrap();
            assert!(table.rows.len() > least, "{}", table.rows.len());
            let mut largest = 0.0f32;
            for (row, colour) in table.rows.iter().zip(table.rgb(RGB_WAVELENGTHS_NM).unwrap()) {
                let half = (row.wi() + row.wo()).normalize();
                assert!((half.z.acos() - f64::from(colour.x)).abs() < 1e-6);
                assert!((row.wi().dot(half).clamp(-1.0, 1.0).acos() - f64::from(colour.y)).abs() < 1e-6);
                largest = largest.max(colour.z);
            }
            // φ_d reaches the end of its range, a degree a cell.
            assert!((f64::from(largest).to_degrees() - azimuths as f64).abs() < 15.0, "{largest}");
        }
    }

    /// Gives the reader mutations, made in place and put right again: a file of 35 MB is not written ten
    /// thousand times.
    fn survives(goes_on: impl Fn(u32) -> bool) {
        let mut bytes = bytes(180);
        let length = bytes.len();
        // A generator of random numbers that is the same on every machine (xorshift64).
        let mut state = 1u64;
        let mut below = move |limit: usize| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state % limit as u64) as usize
        };
        let (mut made, mut refused) = (0, 0);
        while goes_on(made) {
            // Most damage is where it is seen at once: a table that is read takes a thousand times as long.
            let whole = made % 100 == 0;
            let end = if whole || made % 3 > 0 { length } else { below(length + 1) };
            let place = if whole { HEADER + 8 * below((length - HEADER) / 8) } else { below(HEADER) };
            let count = 1 + below(8);
            let kept: Vec<u8> = bytes[place..place + count].to_vec();
            bytes[place..place + count]
                .iter_mut()
                .for_each(|byte| *byte = [0, 0xff, below(256) as u8][below(3)]);
            match parse(&bytes[..end]) {
                Ok(table) => {
                    let sound =
                        |row: &TableRow| row.values.iter().all(|value| value.is_finite() && *value >= 0.0);
                    assert!(!table.rows.is_empty() && table.rows.iter().all(sound), "mutation {made}");
                }
                Err(error) => {
                    refused += 1;
                    assert!(!error.to_string().contains('\n'), "mutation {made}: {error}");
                }
            }
            bytes[place..place + count].copy_from_slice(&kept);
            made += 1;
        }
        assert!(2 * refused > made && refused < made, "{refused} of {made}");
    }

    #[test]
    fn damaged_tables_are_read_or_refused() {
        survives(|made| made < 10_000);
    }

    #[test]
    #[ignore = "30 s; cargo xtask long"]
    fn damaged_tables_for_long() {
        let start = std::time::Instant::now();
        survives(|_| start.elapsed().as_secs() < 30);
    }

    #[test]
    fn other_files_and_short_ones_are_refused() {
        let refused = |bytes: &[u8]| parse(bytes).unwrap_err().to_string();
        assert!(refused(b"brdf").contains("not a MERL table"));
        let mut short = bytes(180);
        short.truncate(1000);
        assert!(refused(&short).contains("cut short"));
        let mut wrong = bytes(180);
        wrong[12..20].copy_from_slice(&f64::NAN.to_le_bytes());
        assert!(refused(&wrong).contains("not finite"));
    }
}
