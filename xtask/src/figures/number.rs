//! Numbers as texts write them: with groups of three digits, true minus signs and powers, and written again
//! with the same digits.

use std::ops::Range;

/// A number in a text.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Number {
    /// Its value.
    pub(super) value: f64,
    /// The bytes that it takes.
    pub(super) span: Range<usize>,
    /// Digits that count: without leading zeros.
    digits: usize,
    /// Half of what its last digit stands for.
    pub(super) half_step: f64,
    /// What parts groups of three digits.
    group: Option<char>,
}

/// What may part groups of three digits: a comma, or a space of any width.
const GROUPS: [char; 4] = [',', ' ', '\u{202f}', '\u{a0}'];

/// Reads the number that begins at a byte of a text, a sign included.
pub(super) fn read(text: &str, start: usize) -> Option<Number> {
    let rest = text.get(start..)?;
    let sign: usize = match rest.chars().next()? {
        sign @ ('-' | '−' | '+') => sign.len_utf8(),
        _ => 0,
    };
    let negative = sign > 0 && !rest.starts_with('+');
    let mut plain = String::new();
    let mut end = start + sign;
    let mut group = None;
    loop {
        let count = digits_at(text, end);
        plain += &text[end..end + count];
        end += count;
        let Some(next) = text[end..].chars().next().filter(|next| GROUPS.contains(next)) else { break };
        let is_first = group.is_none() && (1..=3).contains(&count) && !plain.starts_with('0');
        let belongs = if is_first { true } else { count == 3 && group == Some(next) };
        if !belongs || digits_at(text, end + next.len_utf8()) != 3 {
            break;
        }
        group = Some(next);
        end += next.len_utf8();
    }
    if plain.is_empty() {
        return None;
    }
    let mut decimals = 0;
    if text[end..].starts_with('.') && digits_at(text, end + 1) > 0 {
        decimals = digits_at(text, end + 1);
        plain += &text[end..=end + decimals];
        end += 1 + decimals;
    }
    let digits = plain.chars().filter(char::is_ascii_digit).skip_while(|digit| *digit == '0').count().max(1);
    let (power, end) = power_at(text, end);
    let value: f64 = plain.parse::<f64>().ok()? * 10f64.powi(power);
    let half_step = 0.5 * 10f64.powi(power - decimals as i32);
    Some(Number { value: if negative { -value } else { value }, span: start..end, digits, half_step, group })
}

/// How many digits stand at a byte of a text.
fn digits_at(text: &str, at: usize) -> usize {
    text.as_bytes().get(at..).map_or(0, |rest| rest.iter().take_while(|byte| byte.is_ascii_digit()).count())
}

/// The power of ten of `e-5` that stands at a byte, and where it ends.
fn power_at(text: &str, at: usize) -> (i32, usize) {
    let found = || -> Option<(i32, usize)> {
        let rest = text[at..].strip_prefix(['e', 'E'])?;
        let sign = usize::from(rest.starts_with(['-', '+']));
        let count = digits_at(rest, sign);
        let power = rest[..sign + count].parse().ok()?;
        (count > 0).then_some((power, at + 1 + sign + count))
    };
    found().unwrap_or((0, at))
}

impl Number {
    /// Another value written as this number is: with as many digits that count, two at least where it has
    /// decimals.
    pub(super) fn written(&self, value: f64) -> String {
        let has_decimals = self.half_step < 0.5;
        let digits = if has_decimals { self.digits.max(2) } else { self.digits } as i32;
        let scientific = format!("{:.*e}", (digits - 1).max(0) as usize, value.abs());
        let exponent: i32 = scientific.split_once('e').and_then(|(_, power)| power.parse().ok()).unwrap_or(0);
        let decimals = if value == 0.0 { 0 } else { (digits - 1 - exponent).max(0) };
        let step = 10f64.powi(exponent + 1 - digits);
        let rounded = if exponent >= digits && value != 0.0 {
            (value.abs() / step).round() * step
        } else {
            value.abs()
        };
        let plain = format!("{rounded:.*}", decimals as usize);
        let sign = if value < 0.0 { "−" } else { "" };
        let (whole, fraction) = plain.split_at(plain.find('.').unwrap_or(plain.len()));
        let Some(group) = self.group.or_else(|| (whole.len() > 4).then_some(',')) else {
            return format!("{sign}{plain}");
        };
        let mut grouped = String::new();
        for (place, digit) in whole.chars().enumerate() {
            if place > 0 && (whole.len() - place).is_multiple_of(3) {
                grouped.push(group);
            }
            grouped.push(digit);
        }
        format!("{sign}{grouped}{fraction}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_with_groups_signs_and_powers() {
        for (text, value, end) in [
            ("16,384 texels", 16384.0, 6),
            ("93 092 bytes", 93092.0, 6),
            ("1, 2 and 3", 1.0, 1),
            ("25 154", 25154.0, 6),
            ("25 1542", 25.0, 2),
            ("0.46 %", 0.46, 4),
            ("−1.04,", -1.04, 7),
            ("1e-5.", 1e-5, 4),
            ("3.", 3.0, 1),
            ("2,304 × 5", 2304.0, 5),
            ("1.5e3x", 1500.0, 5),
        ] {
            let number = read(text, 0).unwrap();
            assert!((number.value - value).abs() <= 1e-12 * value.abs(), "{text}: {number:?}");
            assert_eq!(number.span, 0..end, "{text}");
        }
        for text in ["", "x", "-", ".5"] {
            assert_eq!(read(text, 0), None, "{text}");
        }
    }

    #[test]
    fn another_value_is_written_with_the_digits_of_the_first() {
        for (text, value, expected) in [
            ("0.46", 0.5213, "0.52"),
            ("0.9", 1.04, "1.0"),
            ("26", 31.4, "31"),
            ("16,384", 16000.0, "16,000"),
            ("43,000", 38_214.0, "38,214"),
            ("93 092", 101_300.0, "101 300"),
            ("0.08", 0.1131, "0.11"),
            ("7", 0.2, "0.2"),
            ("20", 137.0, "140"),
            ("1.0", -0.97, "−0.97"),
            ("394", 9_850_000.0, "9,850,000"),
        ] {
            assert_eq!(read(text, 0).unwrap().written(value), expected, "{text}");
        }
    }
}
