//! Templates: pieces of text with `{}` for each number that is wanted, `{*}` for a number that may be any,
//! and `{..}` for any words between. White space is as wide as it likes and may be a line's end.

use anyhow::{Result, bail};

use super::number::{self, Number};

/// The farthest that `{..}` reaches, bytes.
const FARTHEST: usize = 2000;

/// A template.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Template(Vec<Piece>);

#[derive(Debug, Clone, PartialEq)]
enum Piece {
    Literal(String),
    Space,
    Wanted,
    Any,
    Words,
}

impl Template {
    /// Reads a template.
    pub(super) fn parse(text: &str) -> Result<Self> {
        let mut pieces: Vec<Piece> = Vec::new();
        let mut rest = text;
        while let Some(next) = rest.chars().next() {
            let marks = [("{}", Piece::Wanted), ("{*}", Piece::Any), ("{..}", Piece::Words)];
            if let Some((mark, piece)) = marks.into_iter().find(|(mark, _)| rest.starts_with(mark)) {
                rest = &rest[mark.len()..];
                pieces.push(piece);
                continue;
            }
            rest = &rest[next.len_utf8()..];
            match (next.is_whitespace(), pieces.last_mut()) {
                (true, Some(Piece::Space)) => {}
                (true, _) => pieces.push(Piece::Space),
                (false, Some(Piece::Literal(literal))) => literal.push(next),
                (false, _) => pieces.push(Piece::Literal(next.into())),
            }
        }
        if !pieces.iter().any(|piece| matches!(piece, Piece::Literal(_))) {
            bail!("`{text}` has no words by which a place could be known");
        }
        Ok(Self(pieces))
    }

    /// How many numbers it wants.
    pub(super) fn wanted(&self) -> usize {
        self.0.iter().filter(|piece| **piece == Piece::Wanted).count()
    }

    /// The wanted numbers at every place of a text where it fits.
    pub(super) fn find(&self, text: &str) -> Vec<Vec<Number>> {
        let starts = text.char_indices().map(|(at, _)| at);
        // A number that a template begins with begins where its text's does.
        let inside = |at: usize| {
            let before = text[..at].chars().next_back();
            !matches!(self.0.first(), Some(Piece::Literal(_)))
                && before.is_some_and(|before| before.is_ascii_digit() || "-−.,".contains(before))
        };
        starts.filter(|at| !inside(*at)).filter_map(|at| fit(&self.0, text, at)).collect()
    }
}

/// The wanted numbers if the pieces fit at a byte of a text.
fn fit(pieces: &[Piece], text: &str, at: usize) -> Option<Vec<Number>> {
    let Some((piece, rest)) = pieces.split_first() else { return Some(Vec::new()) };
    match piece {
        Piece::Literal(literal) => {
            text[at..].starts_with(literal.as_str()).then(|| fit(rest, text, at + literal.len()))?
        }
        Piece::Space => {
            let after = text[at..].trim_start();
            (after.len() < text.len() - at).then(|| fit(rest, text, text.len() - after.len()))?
        }
        Piece::Wanted | Piece::Any => {
            let number = number::read(text, at)?;
            let mut found = fit(rest, text, number.span.end)?;
            if *piece == Piece::Wanted {
                found.insert(0, number);
            }
            Some(found)
        }
        Piece::Words => {
            let ends = text[at..].char_indices().map(|(far, _)| far).take_while(|far| *far <= FARTHEST);
            ends.map(|far| fit(rest, text, at + far)).find(Option::is_some)?
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(template: &str, text: &str) -> Vec<Vec<f64>> {
        let found = Template::parse(template).unwrap().find(text);
        found.iter().map(|numbers| numbers.iter().map(|number| number.value).collect()).collect()
    }

    #[test]
    fn numbers_are_found_wherever_lines_end() {
        let text =
            "a fit of 16,384 texels takes\n0.8 s, and of two lobes  1.5 s; a fit of 3 texels takes 1 s";
        assert_eq!(values("fit of {} texels takes {} s", text), [vec![16384.0, 0.8], vec![3.0, 1.0]]);
        assert_eq!(values("texels takes {*} s, and of two lobes {} s", text), [vec![1.5]]);
        assert_eq!(values("16,384 texels{..}lobes {} s;", text), [vec![1.5]]);
        assert_eq!(values("fit of {} lobes", text), Vec::<Vec<f64>>::new());
        // Not 384 as well.
        assert_eq!(values("{} texels takes {*} s, and", text), [vec![16384.0]]);
    }

    #[test]
    fn a_template_without_words_is_refused() {
        assert!(Template::parse("{} {}").is_err());
        assert_eq!(Template::parse("{} and {} of {*}").unwrap().wanted(), 2);
    }
}
