//! Parser of the Cornell `.brdf` text format. Line numbers start at 1, rows at 1.

use std::f64::consts::{FRAC_PI_2, TAU};

use super::{MeasuredTable, TableRow};
use crate::FormatError;

/// Most wavelengths that a table is believed to have; a larger count is a damaged or another file.
const MOST_WAVELENGTHS: usize = 10_000;

/// Values below this, sr⁻¹, are no measurement noise.
const MOST_NEGATIVE: f64 = -0.01;

/// Values above this, sr⁻¹, are no reflectance: a mirror seen under a thousandth of a degree has less.
const MOST_VALUE: f64 = 1e10;

/// Slack for angles printed with few digits, radians.
pub(super) const ANGLE_SLACK: f64 = 1e-4;

/// A number of the file with the line that it stands on.
struct Token<'a> {
    text: &'a str,
    line: usize,
}

impl Token<'_> {
    /// The finite number that the token spells; `what` names it in the error.
    fn number(&self, what: impl Fn() -> String) -> Result<f64, FormatError> {
        let Self { text, line } = self;
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            Ok(_) => Err(invalid(*line, format!("{} is {text}; remove the row or measure it again", what()))),
            Err(_) if text.contains([',', ';']) => Err(invalid(
                *line,
                format!(
                    "{} is `{text}`, which has a {}; write decimals with a point and put spaces between \
                     numbers",
                    what(),
                    if text.contains(';') { "semicolon" } else { "comma" }
                ),
            )),
            Err(_) => Err(invalid(*line, format!("{} is `{text}`, which is not a number", what()))),
        }
    }
}

pub(super) fn invalid(line: usize, message: impl std::fmt::Display) -> FormatError {
    FormatError::Invalid(format!("line {line}: {message}"))
}

/// All tokens outside comments.
fn tokens(text: &str) -> impl Iterator<Item = Token<'_>> {
    text.lines().enumerate().flat_map(|(index, line)| {
        let content = line.split('#').next().unwrap_or_default();
        content.split_whitespace().map(move |text| Token { text, line: index + 1 })
    })
}

pub(super) fn parse(text: &str) -> Result<MeasuredTable, FormatError> {
    let last_line = text.lines().count().max(1);
    let mut tokens = tokens(text);
    let wavelengths_nm = wavelengths(&mut tokens, last_line)?;
    let width = 4 + wavelengths_nm.len();
    let rest: Vec<Token<'_>> = tokens.collect();
    let mut rows = Vec::with_capacity(rest.len() / width);
    for (index, chunk) in rest.chunks(width).enumerate() {
        let number = index + 1;
        if chunk.len() < width {
            // A row whose numbers hang together seems cut short.
            chunk
                .iter()
                .try_for_each(|token| token.number(|| format!("row {number}: a number")).map(drop))?;
            let found = chunk.len();
            let message =
                format!("row {number} ends after {found} of {width} numbers; the file is cut short");
            return Err(invalid(chunk[found - 1].line, message));
        }
        rows.push(row(number, chunk, &wavelengths_nm)?);
    }
    if rows.is_empty() {
        return Err(invalid(last_line, "the table has no rows"));
    }
    Ok(MeasuredTable { wavelengths_nm, rows })
}

/// The count of wavelengths and the wavelengths.
fn wavelengths<'a>(
    tokens: &mut impl Iterator<Item = Token<'a>>,
    last_line: usize,
) -> Result<Vec<f64>, FormatError> {
    let count = tokens.next().ok_or_else(|| invalid(last_line, "the table is empty"))?;
    if count.text == "analytic" {
        let message =
            "an analytic BRDF of BRDF Explorer, which has the same ending; only measured tables are read";
        return Err(invalid(count.line, message));
    }
    let number = count.number(|| "the number of wavelengths".into())?;
    if number.fract() != 0.0 || number < 1.0 || number > MOST_WAVELENGTHS as f64 {
        let message =
            format!("the number of wavelengths is {}; it must be 1 to {MOST_WAVELENGTHS}", count.text);
        return Err(invalid(count.line, message));
    }
    let mut wavelengths: Vec<f64> = Vec::with_capacity(number as usize);
    for index in 1..=number as usize {
        let Some(token) = tokens.next() else {
            let message = format!("the file ends after {} of {number} wavelengths", index - 1);
            return Err(invalid(last_line, message));
        };
        let wavelength = token.number(|| format!("wavelength {index}"))?;
        let previous = wavelengths.last().copied().unwrap_or(0.0);
        if wavelength <= previous {
            let message =
                format!("wavelength {index} is {wavelength} nm after {previous} nm; they must ascend");
            return Err(invalid(token.line, message));
        }
        wavelengths.push(wavelength);
    }
    Ok(wavelengths)
}

/// One complete row.
fn row(number: usize, tokens: &[Token<'_>], wavelengths_nm: &[f64]) -> Result<TableRow, FormatError> {
    let angle = |index: usize, name: &str, low: f64, high: f64| {
        let token = &tokens[index];
        let angle = token.number(|| format!("row {number}: {name}"))?;
        if angle < low - ANGLE_SLACK || angle > high + ANGLE_SLACK {
            let message = format!(
                "row {number}: {name} is {angle} rad; it must lie in {low:.4} to {high:.4} rad (not degrees)"
            );
            return Err(invalid(token.line, message));
        }
        Ok(angle.clamp(low, high))
    };
    let (theta_i, phi_i) = (angle(0, "theta_i", 0.0, FRAC_PI_2)?, angle(1, "phi_i", -TAU, TAU)?);
    let (theta_o, phi_o) = (angle(2, "theta_s", 0.0, FRAC_PI_2)?, angle(3, "phi_s", -TAU, TAU)?);
    let mut values = Vec::with_capacity(wavelengths_nm.len());
    for (token, wavelength) in tokens[4..].iter().zip(wavelengths_nm) {
        let value = token.number(|| format!("row {number}: the value at {wavelength} nm"))?;
        if value < MOST_NEGATIVE {
            let message = format!(
                "row {number}: the value at {wavelength} nm is {value} sr⁻¹; below {MOST_NEGATIVE} it is no \
                 noise"
            );
            return Err(invalid(token.line, message));
        }
        if value > MOST_VALUE {
            let message = format!(
                "row {number}: the value at {wavelength} nm is {value:e} sr⁻¹; above {MOST_VALUE:e} it is no \
                 reflectance"
            );
            return Err(invalid(token.line, message));
        }
        values.push(value);
    }
    Ok(TableRow { theta_i, phi_i, theta_o, phi_o, values })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HEAD: &str = "# paint\n2\n450 550\n";

    fn error(rows: &str) -> String {
        parse(&format!("{HEAD}{rows}")).unwrap_err().to_string()
    }

    #[test]
    fn comments_and_wrapped_rows_are_read() {
        let table =
            parse("# paint\n2 # count\n450\n550\n0.1 0 0.2\n -3.1 1.5 # half\n2.5 0.2 0 0.3 0 -1e-4 4\n")
                .unwrap();
        assert_eq!(table.wavelengths_nm, [450.0, 550.0]);
        assert_eq!(table.rows.len(), 2);
        assert_eq!(table.rows[0].values, [1.5, 2.5]);
        assert_eq!(table.rows[0].phi_o, -3.1);
        assert_eq!(table.rows[1].values, [-1e-4, 4.0]);
    }

    #[test]
    fn faults_are_named_with_line_and_row() {
        let good = "0.1 0 0.2 0 1 2\n";
        for (rows, expected) in [
            (format!("{good}0.1 0 0.2 0 nan 2\n"), "line 5: row 2: the value at 450 nm is nan"),
            (format!("{good}0.1 0 0.2 0 1 inf\n"), "line 5: row 2: the value at 550 nm is inf"),
            (format!("{good}0.1 0 0.2 0 1\n"), "line 5: row 2 ends after 5 of 6 numbers"),
            ("1.9 0 0.2 0 1 2".into(), "line 4: row 1: theta_i is 1.9 rad"),
            ("0.1 0 0.2 9 1 2".into(), "line 4: row 1: phi_s is 9 rad"),
            ("0.1 0 -0.2 0 1 2".into(), "line 4: row 1: theta_s is -0.2 rad"),
            ("0.1 0 0.2 0 1 -2".into(), "line 4: row 1: the value at 550 nm is -2 sr⁻¹"),
            ("0.1 0 0.2 0 1 two".into(), "line 4: row 1: the value at 550 nm is `two`"),
            ("0.1,0,0.2,0,1,2".into(), "line 4: row 1: a number is `0.1,0,0.2,0,1,2`, which has a comma"),
            ("0.1;0;0.2;0;1;2".into(), "line 4: row 1: a number is `0.1;0;0.2;0;1;2`, which has a semicolon"),
            ("0,1 0 0,2 0 1 2".into(), "line 4: row 1: theta_i is `0,1`, which has a comma; write decimals"),
            ("0.1 0 0.2 0 1 1e301".into(), "line 4: row 1: the value at 550 nm is 1e301 sr⁻¹"),
            (
                "10 0 45 180 1 2".into(),
                "theta_i is 10 rad; it must lie in 0.0000 to 1.5708 rad (not degrees)",
            ),
            (String::new(), "the table has no rows"),
        ] {
            let text = error(&rows);
            assert!(text.contains(expected), "{text} lacks {expected}");
        }
    }

    #[test]
    fn bad_counts_and_wavelengths_are_refused() {
        for (text, expected) in [
            ("", "line 1: the table is empty"),
            ("-3 400", "line 1: the number of wavelengths is -3"),
            ("2.5 400", "the number of wavelengths is 2.5"),
            ("0", "the number of wavelengths is 0"),
            ("1e12 400", "the number of wavelengths is 1e12"),
            ("three", "the number of wavelengths is `three`"),
            ("analytic", "line 1: an analytic BRDF of BRDF Explorer"),
            ("2 550 550", "wavelength 2 is 550 nm after 550 nm"),
            ("3 400\n500", "line 2: the file ends after 2 of 3 wavelengths"),
            ("2 500\n400", "line 2: wavelength 2 is 400 nm after 500 nm"),
        ] {
            let message = parse(text).unwrap_err().to_string();
            assert!(message.contains(expected), "{message} lacks {expected}");
        }
    }

    proptest! {
        #[test]
        fn printed_tables_come_back_whatever_the_line_breaks(
            rows in prop::collection::vec(
                (0f64..1.57, -3.1f64..3.1, 0f64..1.57, -3.1f64..3.1, -0.009f64..700.0),
                1..20,
            ),
            breaks in prop::collection::vec(any::<bool>(), 100),
        ) {
            let mut text = String::from("1\n500\n");
            let mut place = 0;
            for &(a, b, c, d, e) in &rows {
                for number in [a, b, c, d, e] {
                    text += &format!("{number:?}{}", if breaks[place % 100] { "\n" } else { " " });
                    place += 1;
                }
            }
            let table = parse(&text).unwrap();
            prop_assert_eq!(table.rows.len(), rows.len());
            for (row, &(a, b, c, d, e)) in table.rows.iter().zip(&rows) {
                let read = (row.theta_i, row.phi_i, row.theta_o, row.phi_o, row.values[0]);
                prop_assert_eq!(read, (a, b, c, d, e));
            }
        }

        #[test]
        fn no_text_makes_the_parser_panic(text in "[0-9 .\\-+einfa#\n]{0,200}") {
            let _ = parse(&text);
        }
    }
}
