//! Reader of ALTA's text format (Belcour, Barla, Pacanowski 2014): a header of `#KEY value` lines, then a sample a line.
//!
//! `#DIM N P` counts input and output columns, `#PARAM_IN` says what the inputs are, `#PARAM_OUT` the outputs; where `#VS` is not 0,
//! columns with the outputs' uncertainty follow, which are left out. Light and view directions by `#PARAM_IN`:
//!
//! - `ISOTROPIC_TL_TV_PROJ_DPHI`: θ_l, θ_v cosΔφ, θ_v sinΔφ, with the light at azimuth 0: a view on the light's side has a positive
//!   second column, so that is where retro-reflection shows.
//! - `SPHERICAL_TL_PL_TV_PV`: θ_l, φ_l, θ_v, φ_v.
//!
//! `INV_STERADIAN_COSINE_FACTOR` is reflectance times cosθ_v, which is divided out here; samples within 1° of the horizon are left out
//! then.

use std::f64::consts::FRAC_PI_2;

use super::parse::{ANGLE_SLACK, invalid};
use super::{MeasuredTable, TableRow, ascending};
use crate::FormatError;

/// Least cosθ_v that is divided out: that of 89°.
const LEAST_COSINE: f64 = 0.01745;

/// Whether a text is in this format: its first line that is not empty starts with `#` and a capital letter.
pub(super) fn is_alta(text: &str) -> bool {
    let first = text.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
    let mut letters = first.chars();
    letters.next() == Some('#') && letters.next().is_some_and(|letter| letter.is_ascii_uppercase())
}

#[derive(Clone, Copy, PartialEq)]
enum Angles {
    Projected,
    Spherical,
}

/// What the header says.
struct Header {
    angles: Angles,
    inputs: usize,
    outputs: usize,
    cosine: bool,
    /// Whether columns may follow the outputs.
    more: bool,
}

/// Looks a key up: the line's number and the rest of the line.
fn value<'a>(text: &'a str, key: &str) -> Option<(usize, &'a str)> {
    text.lines().enumerate().find_map(|(index, line)| {
        let rest = line.strip_prefix('#')?.strip_prefix(key)?;
        rest.starts_with(char::is_whitespace).then(|| (index + 1, rest.trim()))
    })
}

fn header(text: &str) -> Result<Header, FormatError> {
    let needed =
        |key: &str| value(text, key).ok_or_else(|| invalid(1, format!("the header has no #{key} line")));
    let (line, dimensions) = needed("DIM")?;
    let counts: Vec<usize> = dimensions.split_whitespace().filter_map(|count| count.parse().ok()).collect();
    let [inputs, outputs] = counts[..] else {
        return Err(invalid(line, format!("#DIM is `{dimensions}`; it must be two counts")));
    };
    let (line, name) = needed("PARAM_IN")?;
    let (angles, expected) = match name {
        "ISOTROPIC_TL_TV_PROJ_DPHI" => (Angles::Projected, 3),
        "SPHERICAL_TL_PL_TV_PV" => (Angles::Spherical, 4),
        _ => {
            return Err(invalid(
                line,
                format!(
                    "#PARAM_IN {name} is not read; convert it to ISOTROPIC_TL_TV_PROJ_DPHI or SPHERICAL_TL_PL_TV_PV"
                ),
            ));
        }
    };
    let (output_line, output) = needed("PARAM_OUT")?;
    let cosine = match output {
        "INV_STERADIAN" | "RGB_COLOR" => false,
        "INV_STERADIAN_COSINE_FACTOR" => true,
        _ => {
            let known = "INV_STERADIAN, INV_STERADIAN_COSINE_FACTOR or RGB_COLOR";
            return Err(invalid(output_line, format!("#PARAM_OUT {output} is not read; it must be {known}")));
        }
    };
    if inputs != expected || !matches!(outputs, 1 | 3) {
        let message =
            format!("#DIM {dimensions} does not go with {name}: {expected} inputs and 1 or 3 outputs");
        return Err(invalid(line, message));
    }
    let more = value(text, "VS").is_some_and(|(_, kinds)| kinds.split_whitespace().any(|kind| kind != "0"));
    Ok(Header { angles, inputs, outputs, cosine, more })
}

pub(super) fn parse(text: &str) -> Result<MeasuredTable, FormatError> {
    let header = header(text)?;
    let width = header.inputs + header.outputs;
    let mut rows = Vec::new();
    let mut numbers = Vec::with_capacity(width);
    for (index, line) in text.lines().enumerate() {
        if line.starts_with('#') || line.trim().is_empty() {
            continue;
        }
        numbers.clear();
        for token in line.split_whitespace() {
            match token.parse::<f64>() {
                Ok(number) if number.is_finite() => numbers.push(number),
                _ => return Err(invalid(index + 1, format!("`{token}` is no finite number"))),
            }
        }
        if numbers.len() < width || (numbers.len() > width && !header.more) {
            return Err(invalid(index + 1, format!("{} numbers where {width} are expected", numbers.len())));
        }
        if let Some(row) = row(&header, &numbers[..width]).map_err(|message| invalid(index + 1, message))? {
            rows.push(row);
        }
    }
    if rows.is_empty() {
        return Err(invalid(text.lines().count().max(1), "the table has no rows"));
    }
    Ok(ascending(rows))
}

/// One sample; none where its cosine cannot be divided out.
fn row(header: &Header, numbers: &[f64]) -> Result<Option<TableRow>, String> {
    let (angles, values) = numbers.split_at(header.inputs);
    let polar = |name: &str, angle: f64| match angle {
        _ if (-ANGLE_SLACK..=FRAC_PI_2 + ANGLE_SLACK).contains(&angle) => Ok(angle.clamp(0.0, FRAC_PI_2)),
        _ => Err(format!("{name} is {angle} rad; it must lie in 0 to {FRAC_PI_2:.4} rad")),
    };
    let (theta_i, phi_i, theta_o, phi_o) = match header.angles {
        Angles::Projected => (angles[0], 0.0, angles[1].hypot(angles[2]), angles[2].atan2(angles[1])),
        Angles::Spherical => (angles[0], angles[1], angles[2], angles[3]),
    };
    let (theta_i, theta_o) = (polar("the light's angle", theta_i)?, polar("the view's angle", theta_o)?);
    let cosine = if header.cosine { theta_o.cos() } else { 1.0 };
    if cosine < LEAST_COSINE {
        return Ok(None);
    }
    let values: Vec<f64> = values.iter().map(|value| value / cosine).collect();
    Ok(Some(TableRow { theta_i, phi_i, theta_o, phi_o, values }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::RGB_WAVELENGTHS_NM;

    const HEAD: &str = "#SAMPLE \"sheet\"\n#DIM 3 1\n#VS 0\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n";

    #[test]
    fn directions_are_the_light_s_side_and_the_cosine_is_divided_out() {
        let table = MeasuredTable::parse(&format!(
            "{HEAD}#PARAM_OUT INV_STERADIAN_COSINE_FACTOR\n0.5 0.5 0 2\n0.5 0 1.0 3\n"
        ))
        .unwrap();
        // View = light: retro.
        assert!((table.rows[0].wi() - table.rows[0].wo()).length() < 1e-12);
        assert!((table.rows[0].values[0] - 2.0 / 0.5f64.cos()).abs() < 1e-12);
        // A quarter turn from the light, at a polar angle of 1.
        let wo = table.rows[1].wo();
        assert!((wo - glam::DVec3::new(0.0, 1f64.sin(), 1f64.cos())).length() < 1e-12, "{wo}");
        assert!(table.rows[1].wi().y.abs() < 1e-12 && table.rows[1].wi().x > 0.4);
        assert_eq!(table.at_wavelength(550.0).unwrap().len(), 2);
    }

    #[test]
    fn colours_come_in_ascending_wavelengths_and_uncertainties_are_left_out() {
        let text = "#DIM 4 3\n#PARAM_IN SPHERICAL_TL_PL_TV_PV\n#PARAM_OUT RGB_COLOR\n#VS 1 1 1\n0.1 0.2 0.3 0.4 3 2 1 0.1 0.1 0.1\n";
        let table = MeasuredTable::parse(text).unwrap();
        assert_eq!(table.rgb(RGB_WAVELENGTHS_NM).unwrap()[0], crate::Rgb::new(3.0, 2.0, 1.0));
        assert_eq!((table.rows[0].phi_i, table.rows[0].phi_o), (0.2, 0.4));
    }

    #[test]
    fn grazing_samples_of_weighted_values_are_left_out() {
        let text = format!(
            "{HEAD}#PARAM_OUT INV_STERADIAN_COSINE_FACTOR\n0.5 -1.5707963267948967 0 1e-4\n0.5 0 0 1\n"
        );
        assert_eq!(MeasuredTable::parse(&text).unwrap().rows.len(), 1);
        let text = format!("{HEAD}#PARAM_OUT INV_STERADIAN\n0.5 -1.5707963267948967 0 1e-4\n");
        assert_eq!(MeasuredTable::parse(&text).unwrap().rows.len(), 1);
    }

    #[test]
    fn faults_are_named_with_their_line() {
        let refused = |text: &str| MeasuredTable::parse(text).unwrap_err().to_string();
        for (rows, expected) in [
            ("#PARAM_OUT INV_STERADIAN\n0.5 0 0 nan\n", "line 6: `nan`"),
            ("#PARAM_OUT INV_STERADIAN\n0.5 0 0\n", "line 6: 3 numbers where 4"),
            ("#PARAM_OUT INV_STERADIAN\n0.5 0 0 1 2\n", "line 6: 5 numbers where 4"),
            ("#PARAM_OUT INV_STERADIAN\n2.5 0 0 1\n", "line 6: the light's angle is 2.5 rad"),
            ("#PARAM_OUT INV_STERADIAN\n0.5 1.5 1.5 1\n", "line 6: the view's angle"),
            ("#PARAM_OUT INV_STERADIAN\n", "no rows"),
            ("#PARAM_OUT ENERGY\n0.5 0 0 1\n", "line 5: #PARAM_OUT ENERGY is not read"),
            ("0.5 0 0 1\n", "no #PARAM_OUT"),
        ] {
            let text = refused(&format!("{HEAD}{rows}"));
            assert!(text.contains(expected), "{text} lacks {expected}");
        }
        let text = refused("#DIM 3 1\n#PARAM_IN RUSIN_TH_TD_PD\n#PARAM_OUT INV_STERADIAN\n0 0 0 1\n");
        assert!(text.contains("line 2: #PARAM_IN RUSIN_TH_TD_PD is not read"), "{text}");
        let text =
            refused("#DIM 4 1\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n#PARAM_OUT INV_STERADIAN\n0 0 0 1\n");
        assert!(text.contains("does not go with"), "{text}");
    }

    /// Retro-reflecting sheet measured at three incidences: its highest value lies within 2° of light = view, or of the mirror
    /// direction that the sheet's smooth front adds, and Helmholtz reciprocity holds between incidences 15° and 30°.
    #[test]
    fn the_measured_retro_reflector_is_retro_and_reciprocal() {
        let folder = std::env::var("LOBELIA_DATA").unwrap_or_else(|_| "../../../shared/data".into());
        let path = std::path::Path::new(&folder).join("brdf/retro-3M-jaune.dat");
        if !path.exists() {
            println!("skipped: {} is not there", path.display());
            return;
        }
        let table = MeasuredTable::read(&path).unwrap();
        let near = |degrees: f64, side: f64| {
            let rows = table.rows.iter().filter(move |row| (row.theta_i.to_degrees() - degrees).abs() < 0.5);
            let towards = |row: &&TableRow| {
                let wi = row.wi();
                let target = glam::DVec3::new(side * wi.x, side * wi.y, wi.z);
                row.wo().dot(target) > 2f64.to_radians().cos()
            };
            rows.filter(towards).map(|row| row.values[0]).fold(0.0, f64::max)
        };
        let median = {
            let mut all: Vec<f64> = table.rows.iter().map(|row| row.values[0]).collect();
            all.sort_by(f64::total_cmp);
            all[all.len() / 2]
        };
        for incidence in [15.0, 30.0, 60.0] {
            assert!(near(incidence, 1.0) > 50.0 * median, "{incidence}°: {} {median}", near(incidence, 1.0));
        }
        // f(15°, 30°) = f(30°, 15°) in the plane of incidence, on either side.
        for side in [1.0, -1.0] {
            let at = |i: f64, o: f64| {
                let mut rows: Vec<&TableRow> =
                    table.rows.iter().filter(|row| (row.theta_i.to_degrees() - i).abs() < 0.5).collect();
                let goal = glam::DVec3::new(side * o.to_radians().sin(), 0.0, o.to_radians().cos());
                rows.sort_by(|a, b| a.wo().distance(goal).total_cmp(&b.wo().distance(goal)));
                rows[0].values[0]
            };
            let ratio = at(15.0, 30.0) / at(30.0, 15.0);
            println!("f(15°, 30°) / f(30°, 15°) = {ratio:.3} on side {side}");
            assert!((0.8..1.25).contains(&ratio), "{ratio}");
        }
    }
}
