//! Reader of ALTA's format (Belcour, Barla, Pacanowski 2014): a header of `#KEY value` lines, then a sample a
//! line, or binary.
//!
//! `#DIM N P` counts input and output columns, `#PARAM_IN` says what the inputs are ([`Angles`]),
//! `#PARAM_OUT` the outputs; where `#VS` is not 0, columns with the outputs' uncertainty follow, which are
//! left out. Other lines that begin with `#` are comments. After `#FORMAT binary` the samples follow the
//! header as numbers of eight bytes.
//!
//! `INV_STERADIAN_COSINE_FACTOR` is reflectance times cosθ_v, which is divided out here; samples within 1° of
//! the horizon are left out then.

mod angles;

use super::parse::invalid;
use super::{MeasuredTable, TableRow, ascending};
use crate::FormatError;
use crate::colour::Primaries;
use angles::Angles;

/// Least cosθ_v that is divided out: that of 89°.
const LEAST_COSINE: f64 = 0.01745;
/// What the outputs can be, for the error.
const OUTPUTS: &str =
    "INV_STERADIAN (sr⁻¹), INV_STERADIAN_COSINE_FACTOR (times cosθ_v), RGB_COLOR or XYZ_COLOR";

/// Whether a file is in this format: one of the lines that begin with `#` before the first others is of its
/// header.
pub(super) fn is_alta(bytes: &[u8]) -> bool {
    let marks = ["#ALTA_", "#DIM ", "#DIM\t", "#PARAM_IN", "#PARAM_OUT"];
    header_lines(bytes).any(|(_, line)| marks.iter().any(|mark| line.starts_with(mark)))
}

/// The lines of the header with their numbers: empty ones and those that begin with `#`, up to the end that
/// it may say.
fn header_lines(bytes: &[u8]) -> impl Iterator<Item = (usize, std::borrow::Cow<'_, str>)> {
    let lines = bytes.split(|&byte| byte == b'\n').enumerate();
    let mut ended = false;
    lines
        .map(|(index, line)| (index + 1, line.trim_ascii()))
        .take_while(move |(_, line)| {
            let within = !ended && (line.is_empty() || line.starts_with(b"#"));
            ended = is_end(line);
            within
        })
        .map(|(number, line)| (number, String::from_utf8_lossy(line)))
}

fn is_end(line: &[u8]) -> bool {
    line.starts_with(b"#ALTA_END_HEADER") || line.starts_with(b"#BEGIN_STREAM")
}

/// What the outputs are.
#[derive(Clone, Copy, PartialEq)]
enum Outputs {
    Reflectance,
    /// Reflectance times cosθ_v.
    Cosine,
    Xyz,
}

/// What the header says.
struct Header {
    angles: Angles,
    inputs: usize,
    outputs: usize,
    kind: Outputs,
    /// Columns of uncertainty: how many follow the outputs, none where that is not told.
    more: Option<usize>,
    /// Samples of a binary file, and whether their bytes begin with the lowest.
    binary: Option<(usize, bool)>,
}

/// The header's keys with the numbers of their lines.
struct Keys(Vec<(usize, String, String)>);

impl Keys {
    fn new(bytes: &[u8]) -> Self {
        let key = |(number, line): (usize, std::borrow::Cow<'_, str>)| {
            let rest = line.strip_prefix('#')?;
            let (key, value) = rest.split_once(char::is_whitespace)?;
            Some((number, key.to_string(), value.trim().to_string()))
        };
        Self(header_lines(bytes).filter_map(key).collect())
    }

    fn find(&self, wanted: &str) -> Option<(usize, &str)> {
        self.0.iter().find(|(_, key, _)| key == wanted).map(|(number, _, value)| (*number, value.as_str()))
    }
}

fn header(bytes: &[u8]) -> Result<Header, FormatError> {
    let keys = Keys::new(bytes);
    let needed = |key: &str, what: &str| {
        keys.find(key).ok_or_else(|| invalid(1, format!("the header has no #{key} line; {what}")))
    };
    let (line, dimensions) = needed("DIM", "add the numbers of input and output columns, such as #DIM 3 1")?;
    let counts: Vec<usize> = dimensions.split_whitespace().filter_map(|count| count.parse().ok()).collect();
    let [inputs, outputs] = counts[..] else {
        return Err(invalid(line, format!("#DIM is `{dimensions}`; it must be two counts")));
    };
    let (line, name) = needed("PARAM_IN", &format!("add what the input columns are: {}", angles::names()))?;
    let Some((angles, expected)) = angles::find(name) else {
        return Err(invalid(
            line,
            format!("#PARAM_IN {name} is not read; convert it to one of {}", angles::names()),
        ));
    };
    let (output_line, output) = needed("PARAM_OUT", &format!("add what the output columns are: {OUTPUTS}"))?;
    let kind = match output {
        "INV_STERADIAN" | "RGB_COLOR" => Outputs::Reflectance,
        "INV_STERADIAN_COSINE_FACTOR" => Outputs::Cosine,
        "XYZ_COLOR" => Outputs::Xyz,
        _ => {
            return Err(invalid(
                output_line,
                format!("#PARAM_OUT {output} is not read; it must be {OUTPUTS}"),
            ));
        }
    };
    if inputs != expected || !matches!(outputs, 1 | 3) || (kind == Outputs::Xyz && outputs != 3) {
        let message = format!(
            "#DIM {dimensions} does not go with {name} and {output}: {expected} inputs and 1 or 3 outputs"
        );
        return Err(invalid(line, message));
    }
    let interval = |kind: &str| match kind {
        "0" => Some(0),
        "1" => Some(1),
        "2" => Some(2),
        _ => None,
    };
    let more = keys.find("VS").map_or(Some(0), |(_, kinds)| {
        let columns: Option<Vec<usize>> = kinds.split_whitespace().map(interval).collect();
        // One kind stands for all outputs.
        columns.map(|columns| if columns.len() == 1 { columns[0] * outputs } else { columns.iter().sum() })
    });
    let binary = match keys.find("FORMAT") {
        Some((_, "binary")) => Some(binary_layout(&keys)?),
        _ => None,
    };
    Ok(Header { angles, inputs, outputs, kind, more, binary })
}

/// Samples of a binary file, and whether their bytes begin with the lowest.
fn binary_layout(keys: &Keys) -> Result<(usize, bool), FormatError> {
    if let Some((line, precision)) = keys.find("PRECISION")
        && precision != "ieee754-double"
    {
        return Err(invalid(line, format!("#PRECISION {precision} is not read; it must be ieee754-double")));
    }
    let (line, count) = keys
        .find("SAMPLE_COUNT")
        .ok_or_else(|| invalid(1, "the header of a binary file has no #SAMPLE_COUNT line"))?;
    let count = count.parse().map_err(|_| invalid(line, format!("#SAMPLE_COUNT {count} is no count")))?;
    match keys.find("ENDIAN") {
        None | Some((_, "little")) => Ok((count, true)),
        Some((_, "big")) => Ok((count, false)),
        Some((line, other)) => {
            Err(invalid(line, format!("#ENDIAN {other} is not read; it must be little or big")))
        }
    }
}

pub(super) fn parse(bytes: &[u8]) -> Result<MeasuredTable, FormatError> {
    let header = header(bytes)?;
    let rows = match header.binary {
        Some((count, little)) => binary_rows(bytes, &header, count, little)?,
        None => text_rows(bytes, &header)?,
    };
    if rows.is_empty() {
        let lines = bytes.split(|&byte| byte == b'\n').count();
        return Err(invalid(lines, "the table has no rows of directions above the surface"));
    }
    Ok(ascending(rows))
}

fn text_rows(bytes: &[u8], header: &Header) -> Result<Vec<TableRow>, FormatError> {
    let width = header.inputs + header.outputs;
    let mut rows = Vec::new();
    let mut numbers = Vec::with_capacity(width);
    for (index, line) in bytes.split(|&byte| byte == b'\n').enumerate() {
        if line.starts_with(b"#") || line.trim_ascii().is_empty() {
            continue;
        }
        let line = std::str::from_utf8(line)
            .map_err(|_| invalid(index + 1, "not text; a binary file says #FORMAT binary"))?;
        numbers.clear();
        for token in line.split_whitespace() {
            match token.parse::<f64>() {
                Ok(number) if number.is_finite() => numbers.push(number),
                _ => return Err(invalid(index + 1, format!("`{token}` is no finite number"))),
            }
        }
        if numbers.len() < width || (numbers.len() > width && header.more == Some(0)) {
            return Err(invalid(index + 1, format!("{} numbers where {width} are expected", numbers.len())));
        }
        if let Some(row) = row(header, &numbers[..width]).map_err(|message| invalid(index + 1, message))? {
            rows.push(row);
        }
    }
    Ok(rows)
}

fn binary_rows(
    bytes: &[u8],
    header: &Header,
    count: usize,
    little: bool,
) -> Result<Vec<TableRow>, FormatError> {
    let after = header_lines(bytes).last().map_or(1, |(number, _)| number);
    let start: usize = bytes.split_inclusive(|&byte| byte == b'\n').take(after).map(<[u8]>::len).sum();
    let more = header.more.ok_or_else(|| invalid(1, "#VS has kinds of intervals other than 0, 1 and 2"))?;
    let width = header.inputs + header.outputs + more;
    let body = &bytes[start..];
    if count.checked_mul(8 * width) != Some(body.len()) {
        let message = format!(
            "{} bytes follow the header where {count} samples of {width} numbers have 8 each",
            body.len()
        );
        return Err(invalid(after, message));
    }
    let mut rows = Vec::new();
    for (index, sample) in body.chunks_exact(8 * width).enumerate() {
        let number = |eight: &[u8]| {
            let eight: [u8; 8] = std::array::from_fn(|k| eight[k]);
            if little { f64::from_le_bytes(eight) } else { f64::from_be_bytes(eight) }
        };
        let numbers: Vec<f64> = sample.chunks_exact(8).map(number).collect();
        let wrong = |message: String| FormatError::Invalid(format!("sample {index}: {message}"));
        if numbers.iter().any(|number| !number.is_finite()) {
            return Err(wrong("a number is not finite".into()));
        }
        rows.extend(row(header, &numbers[..header.inputs + header.outputs]).map_err(wrong)?);
    }
    Ok(rows)
}

/// One sample; none where a direction is below the surface, or its cosine cannot be divided out.
fn row(header: &Header, numbers: &[f64]) -> Result<Option<TableRow>, String> {
    let (columns, values) = numbers.split_at(header.inputs);
    let Some([wi, wo]) = header.angles.directions(columns)? else { return Ok(None) };
    let cosine = if header.kind == Outputs::Cosine { wo.z } else { 1.0 };
    if cosine < LEAST_COSINE {
        return Ok(None);
    }
    let mut values: Vec<f64> = values.iter().map(|value| value / cosine).collect();
    if header.kind == Outputs::Xyz {
        values = Primaries::from_xyz(glam::DVec3::from_slice(&values)).to_array().to_vec();
    }
    let angles = |d: glam::DVec3| (d.z.clamp(0.0, 1.0).acos(), d.y.atan2(d.x));
    let ((theta_i, phi_i), (theta_o, phi_o)) = (angles(wi), angles(wo));
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
        let text = "#DIM 4 3\n#PARAM_IN SPHERICAL_TL_PL_TV_PV\n#PARAM_OUT RGB_COLOR\n#VS 1 1 1\n0.1 0.2 0.3 \
             0.4 3 2 1 0.1 0.1 0.1\n";
        let table = MeasuredTable::parse(text).unwrap();
        assert_eq!(table.rgb(RGB_WAVELENGTHS_NM).unwrap()[0], crate::Rgb::new(3.0, 2.0, 1.0));
        assert!((table.rows[0].phi_i - 0.2).abs() < 1e-12 && (table.rows[0].phi_o - 0.4).abs() < 1e-12);
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
            ("0.5 0 0 1\n", "no #PARAM_OUT line; add what the output columns are: INV_STERADIAN (sr⁻¹)"),
        ] {
            let text = refused(&format!("{HEAD}{rows}"));
            assert!(text.contains(expected), "{text} lacks {expected}");
        }
        let text = refused("#DIM 3 1\n#PARAM_IN STARK_3D\n#PARAM_OUT INV_STERADIAN\n0 0 0 1\n");
        assert!(text.contains("line 2: #PARAM_IN STARK_3D is not read; convert it to one of ISO"), "{text}");
        let text =
            refused("#DIM 4 1\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n#PARAM_OUT INV_STERADIAN\n0 0 0 1\n");
        assert!(text.contains("does not go with"), "{text}");
    }

    /// The only row of a table.
    fn row_of(parameters: &str, row: &str) -> TableRow {
        let inputs = row.split_whitespace().count() - 1;
        let text = format!("#DIM {inputs} 1\n#PARAM_IN {parameters}\n#PARAM_OUT INV_STERADIAN\n{row}\n");
        MeasuredTable::parse(&text).unwrap().rows[0].clone()
    }

    #[test]
    fn every_parametrisation_gives_the_directions_of_its_definition() {
        let near = |a: glam::DVec3, b: glam::DVec3| (a - b).length() < 1e-9;
        let half = |row: &TableRow| (row.wi() + row.wo()).normalize();
        // View first, on the light's side at Δφ = 0; a negative polar angle is on the other side.
        let row = row_of("ISOTROPIC_TV_TL_DPHI", "0.7 0.7 0 1");
        assert!(near(row.wi(), row.wo()) && (row.theta_o - 0.7).abs() < 1e-12);
        let row = row_of("ISOTROPIC_TV_TL_DPHI", "-0.7 0.3 0 1");
        assert!(row.wi().x * row.wo().x < 0.0 && (row.theta_i - 0.3).abs() < 1e-12);
        for (parameters, columns) in [
            ("RUSIN_TH_TD_PD", "0.4 0.3 1.1 1"),
            ("RUSIN_TH_PH_TD_PD", "0.4 2.0 0.3 1.1 1"),
            ("RUSIN_TH_TD", "0.4 0.3 1"),
            ("COS_TH_TD", "0.921060994002885 0.955336489125606 1"),
        ] {
            let row = row_of(parameters, columns);
            assert!((half(&row).z.acos() - 0.4).abs() < 1e-9, "{parameters}");
            assert!((row.wi().dot(half(&row)).acos() - 0.3).abs() < 1e-9, "{parameters}");
        }
        let turned = row_of("RUSIN_TH_PH_TD_PD", "0.4 2.0 0.3 1.1 1");
        assert!((half(&turned).y.atan2(half(&turned).x) - 2.0).abs() < 1e-9);
        let row = row_of("COS_TH", "0.8 1");
        assert!(near(row.wi(), row.wo()) && (row.wi().z - 0.8).abs() < 1e-12);
        let row = row_of("CARTESIAN", "0.6 0 0.8 0 0.6 0.8 1");
        assert!(
            near(row.wo(), glam::DVec3::new(0.6, 0.0, 0.8))
                && near(row.wi(), glam::DVec3::new(0.0, 0.6, 0.8))
        );
    }

    #[test]
    fn a_binary_table_is_that_of_its_text() {
        let head =
            "#ALTA_BEGIN_HEADER\n#DIM 3 3\n#PARAM_IN ISOTROPIC_TV_TL_DPHI\n#PARAM_OUT RGB_COLOR\n#VS 0\n";
        let numbers = [[0.1, 0.2, 0.3, 3.0, 2.0, 1.0], [0.5, 1.2, 3.0, 0.3, 0.2, 0.1]];
        let line = |row: &[f64; 6]| row.map(|number| format!("{number:?} ")).concat() + "\n";
        let text = format!("{head}#ALTA_END_HEADER\n{}", numbers.iter().map(line).collect::<String>());
        let expected = MeasuredTable::parse(&text).unwrap();
        for (endian, bytes) in [("little", f64::to_le_bytes as fn(f64) -> [u8; 8]), ("big", f64::to_be_bytes)]
        {
            let head = format!(
                "{head}#VERSION 0\n#FORMAT binary\n#ENDIAN {endian}\n#PRECISION \
                 ieee754-double\n#SAMPLE_COUNT 2\n#ALTA_END_HEADER\n"
            );
            let mut file = head.into_bytes();
            file.extend(numbers.iter().flatten().flat_map(|&number| bytes(number)));
            assert_eq!(parse(&file).unwrap(), expected, "{endian}");
            file.pop();
            assert!(parse(&file).unwrap_err().to_string().contains("95 bytes follow the header"));
        }
    }

    #[test]
    fn colours_in_xyz_are_converted_and_white_is_white() {
        let white = "#DIM 1 3\n#PARAM_IN COS_TH\n#PARAM_OUT XYZ_COLOR\n0.5 0.95046 1 1.08906\n";
        let colour = MeasuredTable::parse(white).unwrap().rgb(RGB_WAVELENGTHS_NM).unwrap()[0];
        assert!((colour - crate::Rgb::ONE).abs().max_element() < 1e-3, "{colour}");
    }

    #[test]
    fn comments_may_come_first_and_missing_outputs_are_asked_for() {
        let cases = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases/text");
        assert!(MeasuredTable::read(&cases.join("comment-first.dat")).unwrap().rows.len() > 100);
        let text = MeasuredTable::read(&cases.join("no-param-out.dat")).unwrap_err().to_string();
        assert!(text.contains("INV_STERADIAN_COSINE_FACTOR (times cosθ_v), RGB_COLOR"), "{text}");
        assert!(!is_alta(b"#Paint measured in May\n1\n550\n0.1 0 0.2 0 1\n"));
    }

    #[test]
    fn the_files_of_alta_itself_are_read() {
        let folder = std::env::var("LOBELIA_DATA").unwrap_or_else(|_| "../../../shared/data".into());
        for (name, rows) in [
            ("brdf_small_simu_two_layers_txt.alta", 29),
            ("brdf_small_simu_two_layers_binary.alta", 29),
            ("pink-felt-1d.alta", 90),
        ] {
            let path = std::path::Path::new(&folder).join("tables").join(name);
            if !path.exists() {
                println!("skipped: {} is not there", path.display());
                continue;
            }
            let table = MeasuredTable::read(&path).unwrap();
            assert!(
                table.rows.len() >= rows - 1 && table.rgb(RGB_WAVELENGTHS_NM).is_ok(),
                "{name}: {}",
                table.rows.len()
            );
        }
    }

    /// Retro-reflecting sheet measured at three incidences: its highest value lies within 2° of light = view,
    /// or of the mirror direction that the sheet's smooth front adds, and Helmholtz reciprocity holds between
    /// incidences 15° and 30°.
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
