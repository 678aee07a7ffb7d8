//! Which numbers of a text look measured: those with a unit of errors, sizes or times, those that share such
//! a unit (`3, 9 and 12 %`), and those that stand alone in a table's cells. Code, heads of tables and sizes
//! such as 48 × 48 are left out.

use std::ops::Range;

use super::number;

/// Units that measured figures have; longer ones before those that they begin with.
const UNITS: [&str; 29] = [
    "%",
    "°",
    "texels/s",
    "steps/s",
    "texels",
    "texel",
    "times",
    "ms",
    "µs",
    "ns",
    "min",
    "s",
    "h",
    "dB",
    "KiB",
    "MiB",
    "GiB",
    "kB",
    "MB",
    "GB",
    "bytes",
    "µm",
    "mm",
    "sr⁻¹",
    "cycles",
    "seconds",
    "minutes",
    "instructions",
    "pixels",
];

/// What may stand between numbers that share a unit.
const BETWEEN: [&str; 6] = [", ", " and ", " to ", ", and ", " / ", " or "];

/// The bytes of every number that looks measured.
pub(super) fn measured(text: &str) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    let mut start = 0;
    let mut in_code = false;
    let mut rows = 0;
    let mut prose: Option<Range<usize>> = None;
    for line in text.split_inclusive('\n') {
        let span = start..start + line.len();
        start = span.end;
        let fence = line.trim_start().starts_with("```");
        let is_row = line.trim_start().starts_with('|') && !in_code;
        if fence || in_code || is_row || line.trim().is_empty() {
            found.extend(prose.take().into_iter().flat_map(|prose| in_prose(text, prose)));
        }
        if fence {
            in_code = !in_code;
        } else if is_row {
            // The first two lines of a table are its head.
            rows += 1;
            if rows > 2 {
                found.extend(in_prose(text, span.clone()));
                found.extend(alone_in_cells(text, span));
            }
        } else if !in_code && !line.trim().is_empty() {
            prose = Some(prose.map_or(span.start, |prose| prose.start)..span.end);
        }
        if !is_row {
            rows = 0;
        }
    }
    found.extend(prose.into_iter().flat_map(|prose| in_prose(text, prose)));
    found.sort_by_key(|span| span.start);
    found.dedup();
    found
}

/// Numbers of a piece of text outside of code spans, addresses and comments.
fn numbers(text: &str, piece: Range<usize>) -> Vec<Range<usize>> {
    let mut found: Vec<Range<usize>> = Vec::new();
    let mut at = piece.start;
    let skip = |from: usize, end: &str| text[from..piece.end].find(end).map(|far| from + far + end.len());
    while at < piece.end {
        let rest = &text[at..piece.end];
        let Some(next) = rest.chars().next() else { break };
        let skipped = match next {
            '`' => skip(at + 1, "`"),
            '<' if rest.starts_with("<!--") => skip(at, "-->"),
            ']' if rest.starts_with("](") => skip(at, ")"),
            _ => None,
        };
        if let Some(after) = skipped {
            at = after;
            continue;
        }
        let before = text[piece.start..at].chars().next_back();
        let is_start = next.is_ascii_digit()
            && !before.is_some_and(|before| before.is_alphanumeric() || before == '_' || before == '.');
        match number::read(text, at).filter(|number| is_start && number.span.end <= piece.end) {
            Some(number) => {
                let is_size = text[piece.start..at].trim_end().ends_with('×')
                    || text[number.span.end..piece.end].trim_start().starts_with('×');
                at = number.span.end;
                found.extend((!is_size).then_some(number.span));
            }
            None => at += next.len_utf8(),
        }
    }
    found
}

/// Numbers with a unit, and those before them that share it.
fn in_prose(text: &str, piece: Range<usize>) -> Vec<Range<usize>> {
    let all = numbers(text, piece.clone());
    let mut found = Vec::new();
    let mut shares = false;
    for (k, span) in all.iter().enumerate().rev() {
        let between = all.get(k + 1).map(|next| &text[span.end..next.start]);
        let joined = between.is_some_and(|between| BETWEEN.contains(&between.replace('\n', " ").as_str()));
        shares = has_unit(&text[span.end..piece.end]) || (shares && joined);
        if shares {
            found.push(span.clone());
        }
    }
    found
}

/// Whether a unit stands here, after a space or none.
fn has_unit(rest: &str) -> bool {
    let rest = rest.trim_start_matches("**");
    let rest = rest.strip_prefix([' ', '\n', '\u{202f}', '\u{a0}']).unwrap_or(rest);
    UNITS.iter().any(|unit| {
        let after = rest.strip_prefix(unit).map(|after| after.chars().next());
        after.is_some_and(|after| !after.is_some_and(|after| after.is_alphanumeric() || after == '/'))
    })
}

/// Numbers of cells that have nothing but numbers, signs and units, the row's first cell apart.
fn alone_in_cells(text: &str, row: Range<usize>) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    let mut start = row.start;
    for (place, cell) in text[row].split('|').enumerate() {
        let span = start..start + cell.len();
        start = span.end + 1;
        let own = numbers(text, span.clone());
        let mut words = String::new();
        let mut from = span.start;
        for number in &own {
            words += &text[from..number.start];
            from = number.end;
        }
        words += &text[from..span.end];
        let is_word = |word: &str| {
            let word =
                word.trim_matches(|letter: char| !letter.is_alphanumeric() && letter != '°' && letter != '%');
            !word.is_empty()
                && !UNITS.contains(&word)
                && !["and", "to", "or", "below", "up", "at", "most"].contains(&word)
        };
        // Before the first bar there is nothing; the first cell names the row.
        if place > 1 && !words.split_whitespace().any(is_word) {
            found.extend(own);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(text: &str) -> Vec<&str> {
        measured(text).into_iter().map(|span| &text[span]).collect()
    }

    #[test]
    fn numbers_with_a_unit_and_those_that_share_it_look_measured() {
        let text = "In 3 runs 99, 95 and\n98.5 % of 1,600 texels (n = 30) took **0.8 s**, `lasting 5 s`, on \
             8 × 8 texels,\n12\n% [more](x-9%).";
        assert_eq!(found(text), ["99", "95", "98.5", "1,600", "0.8", "12"]);
    }

    #[test]
    fn cells_of_nothing_but_numbers_look_measured_and_heads_and_code_do_not() {
        let text = "| n | 10 s | 20 |\n|---|---|---|\n| 7 | 0.4 / 0.7 | GGX 3 |\n| b | 1.0 to 2.0 | **5** \
             |\n\n```\nrun 5 s\n```\n";
        assert_eq!(found(text), ["0.4", "0.7", "1.0", "2.0", "5"]);
    }

    #[test]
    fn a_unit_is_a_word_of_its_own() {
        assert_eq!(found("3 scenes, 4 s, 5 sr, 6 mm/s, 7 timesteps, 8 times"), ["4", "8"]);
    }
}
