//! Numbers for people: sensible digits, units, true minus signs.

/// A value with this many significant digits; very small and very large ones as powers of ten, what is no
/// number as a dash.
pub fn significant(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    if value == 0.0 {
        return "0".into();
    }
    // The exponent after rounding: 9.996 to three digits is 10.0.
    let rounded = format!("{:.*e}", digits.saturating_sub(1), value.abs());
    let (mantissa, exponent) = rounded.split_once('e').unwrap_or((&rounded, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let sign = if value < 0.0 { "−" } else { "" };
    if !(-4..6).contains(&exponent) {
        return format!("{sign}{mantissa} × 10{}", superscript(exponent));
    }
    let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
    format!("{sign}{:.decimals$}", value.abs())
}

/// A value without trailing zeros, for the ticks of an axis.
pub fn tick(value: f64) -> String {
    let text = significant(value, 3);
    let (mantissa, power) = text.split_once(" × ").map_or((text.as_str(), None), |(m, p)| (m, Some(p)));
    let short =
        if mantissa.contains('.') { mantissa.trim_end_matches('0').trim_end_matches('.') } else { mantissa };
    match power {
        Some(power) if short == "1" => power.into(),
        Some(power) => format!("{short} × {power}"),
        None => short.into(),
    }
}

/// The ticks of one axis: positive values of about the same size with the same number of decimals.
pub fn ticks(values: &[f64]) -> Vec<String> {
    let texts: Vec<String> = values.iter().map(|&value| tick(value)).collect();
    let (low, high) = values.iter().fold((f64::MAX, 0f64), |(low, high), &v| (low.min(v), high.max(v)));
    let alike = high < 5.0 * low;
    let is_power = |text: &String| text.contains(SUPERSCRIPTS);
    if !alike || texts.iter().any(is_power) {
        return texts;
    }
    let decimals = |text: &String| text.split_once('.').map_or(0, |(_, digits)| digits.len());
    let most = texts.iter().map(decimals).max().unwrap_or(0);
    values.iter().map(|value| format!("{value:.most$}")).collect()
}

/// A whole number in groups of three, narrow spaces between.
pub fn count(value: usize) -> String {
    let digits = value.to_string();
    let mut grouped = String::new();
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            grouped.push('\u{202f}');
        }
        grouped.push(digit);
    }
    grouped
}

/// A duration in seconds, to a hundredth below ten.
pub fn seconds(value: f64) -> String {
    let decimals = if value < 9.995 { 2 } else { 1 };
    format!("{value:.decimals$}\u{202f}s")
}

/// Bytes in KiB, MiB or GiB; a dash when they are not known.
pub fn bytes(value: u64) -> String {
    let mib = value as f64 / (1 << 20) as f64;
    match value {
        0 => "–".into(),
        _ if mib < 1.0 => format!("{:.0}\u{202f}KiB", (1024.0 * mib).ceil()),
        _ if mib < 1000.0 => format!("{mib:.0}\u{202f}MiB"),
        _ => format!("{:.2}\u{202f}GiB", mib / 1024.0),
    }
}

/// A share in per cent.
pub fn percent(value: f64) -> String {
    if value.is_finite() { format!("{}\u{202f}%", significant(100.0 * value, 2)) } else { "–".into() }
}

/// An angle given in radians, in whole degrees.
pub fn degrees(radians: f64) -> String {
    let whole = radians.to_degrees().round();
    if whole < 0.0 { format!("−{:.0}°", -whole) } else { format!("{:.0}°", whole.abs()) }
}

const SUPERSCRIPTS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];

fn superscript(exponent: i32) -> String {
    let raise = |c: char| match c.to_digit(10) {
        Some(digit) => SUPERSCRIPTS[digit as usize],
        None => '⁻',
    };
    exponent.to_string().chars().map(raise).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_keep_their_significant_digits_and_nothing_more() {
        let written = [0.0, 0.004_880_2, 0.126_48, 9.996, 1234.6, -0.5, 1e-7, 2.5e9, f64::NAN]
            .map(|value| significant(value, 3));
        let wanted = ["0", "0.00488", "0.126", "10.0", "1235", "−0.500", "1.00 × 10⁻⁷", "2.50 × 10⁹", "–"];
        assert_eq!(written, wanted);
        assert_eq!([0.5, 20.0, 0.25, 100.0].map(tick), ["0.5", "20", "0.25", "100"]);
        assert_eq!([1e-7, 2e9, 1.5e6].map(tick), ["10⁻⁷", "2 × 10⁹", "1.5 × 10⁶"]);
        assert_eq!(ticks(&[0.058, 0.06, 0.062]), ["0.058", "0.060", "0.062"]);
        assert_eq!(ticks(&[0.01, 0.1, 1.0]), ["0.01", "0.1", "1"]);
        assert_eq!(ticks(&[1e-7]), ["10⁻⁷"]);
        assert_eq!(ticks(&[-1.0, -0.5, 0.0]), ["−1", "−0.5", "0"]);
    }

    #[test]
    fn counts_are_grouped_and_units_follow_the_size() {
        assert_eq!(
            [7, 999, 2304, 1_048_576].map(count),
            ["7", "999", "2\u{202f}304", "1\u{202f}048\u{202f}576"]
        );
        assert_eq!([0.126, 9.996, 61.04].map(seconds), ["0.13\u{202f}s", "10.0\u{202f}s", "61.0\u{202f}s"]);
        assert_eq!([0, 33_513_472, 1 << 31].map(bytes), ["–", "32\u{202f}MiB", "2.00\u{202f}GiB"]);
        assert_eq!([0.030_018, 0.5389].map(percent), ["3.0\u{202f}%", "54\u{202f}%"]);
        assert_eq!([-0.001, -1.0, 0.5].map(degrees), ["0°", "−57°", "29°"]);
    }
}
