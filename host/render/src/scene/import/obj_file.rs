//! Wavefront OBJ: the faces of all objects and groups. Its v points up and is turned downwards here. Points,
//! lines, curves, materials and smoothing groups are passed over: none of them is a surface, and a scene
//! names its own materials.

use std::path::Path;

use glam::{DVec3, Vec2};

use super::polygon;
use crate::scene::mesh::{Corner, RawMesh};
use lobelia_base::error::{Error, Result};

/// Reads all faces.
pub(super) fn read(path: &Path) -> Result<RawMesh> {
    let bytes = std::fs::read(path).map_err(|error| Error::reading(path, error))?;
    // Names and comments may be in any encoding; what is read of the file is ASCII.
    // A byte-order mark would hide the first line's keyword.
    let bytes = bytes.strip_prefix(&[0xef, 0xbb, 0xbf]).unwrap_or(&bytes);
    let text = String::from_utf8_lossy(bytes);
    let others = lines(&text).filter(|(_, content)| {
        matches!(content.split_whitespace().next(), Some("l" | "p" | "curv" | "curv2" | "surf"))
    });
    super::left_out(
        path,
        others.count(),
        ["point, line or curved surface", "points, lines or curved surfaces"],
    );
    parse(&text)
        .map_err(|(line, message)| Error::input(format!("{}, line {line}: {message}", path.display())))
}

/// Parses the text; an error has its line.
fn parse(text: &str) -> std::result::Result<RawMesh, (usize, String)> {
    let mut raw = RawMesh::default();
    let mut corners = Vec::new();
    for (line, content) in lines(text) {
        let mut words = content.split_whitespace();
        let keyword = words.next().unwrap_or_default();
        let wrong = |message: String| (line, message);
        match keyword {
            "v" => raw.positions.push(DVec3::from_array(numbers(words).map_err(wrong)?)),
            "vn" => raw.normals.push(DVec3::from_array(numbers(words).map_err(wrong)?).as_vec3()),
            "vt" => {
                // One coordinate alone is allowed.
                let words: Vec<&str> = words.collect();
                let [u, v] = match words.len() {
                    1 => [numbers::<1>(words.into_iter()).map_err(wrong)?[0], 0.0],
                    _ => numbers(words.into_iter()).map_err(wrong)?,
                };
                raw.uvs.push(Vec2::new(u as f32, (1.0 - v) as f32));
            }
            "f" | "fo" => {
                corners.clear();
                for word in words {
                    corners.push(corner(word, &raw).map_err(wrong)?);
                }
                if corners.len() < 3 {
                    return Err(wrong(format!("a face of {} corners; it needs three", corners.len())));
                }
                let points: Vec<DVec3> =
                    corners.iter().map(|corner| raw.positions[corner.position as usize]).collect();
                let cut = polygon::triangles(&points);
                raw.triangles.extend(cut.into_iter().map(|triangle| triangle.map(|k| corners[k])));
            }
            _ => {}
        }
    }
    Ok(raw)
}

/// Lines with their numbers, without comments, those that end in a backslash joined with the next.
fn lines(text: &str) -> impl Iterator<Item = (usize, std::borrow::Cow<'_, str>)> {
    let mut rest = text.lines().enumerate();
    std::iter::from_fn(move || {
        let (index, line) = rest.next()?;
        let mut joined = std::borrow::Cow::Borrowed(without_comment(line));
        while let Some(begin) = joined.strip_suffix('\\') {
            let next = rest.next().map_or("", |(_, line)| without_comment(line));
            joined = std::borrow::Cow::Owned(format!("{begin} {next}"));
        }
        Some((index + 1, joined))
    })
}

fn without_comment(line: &str) -> &str {
    line.split('#').next().unwrap_or_default().trim()
}

/// The first N numbers; more may follow, such as weights and colours.
fn numbers<'a, const N: usize>(
    mut words: impl Iterator<Item = &'a str>,
) -> std::result::Result<[f64; N], String> {
    let mut numbers = [0.0; N];
    for (k, number) in numbers.iter_mut().enumerate() {
        let word = words.next().ok_or_else(|| format!("{k} numbers where {N} are expected"))?;
        *number = word.parse().map_err(|_| format!("`{word}` is no number"))?;
    }
    Ok(numbers)
}

/// A corner such as `3`, `3/1`, `3//2` or `-1/-1/-1`; what it refers to stands before it in the file.
fn corner(word: &str, raw: &RawMesh) -> std::result::Result<Corner, String> {
    let mut parts = word.split('/');
    let index = |part: Option<&str>, what: &str, count: usize| {
        let part = part.filter(|part| !part.is_empty());
        part.map(|part| {
            let number: i64 = part.parse().map_err(|_| format!("`{word}` is no corner of a face"))?;
            let index = if number < 0 { number.checked_add(count as i64) } else { number.checked_sub(1) };
            let index = index.and_then(|index| u32::try_from(index).ok());
            index
                .filter(|&index| (index as usize) < count)
                .ok_or_else(|| format!("the face refers to {what} {number}; there are {count} so far"))
        })
        .transpose()
    };
    let position = index(parts.next(), "vertex", raw.positions.len())?;
    let uv = index(parts.next(), "texture coordinate", raw.uvs.len())?;
    let normal = index(parts.next(), "normal", raw.normals.len())?;
    let position = position.ok_or_else(|| format!("`{word}` is no corner of a face"))?;
    Ok(Corner { position, normal, uv })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_from_the_end_and_lines_that_go_on_are_read() {
        let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.25\nf \\\n -3/1 -2/1 \\\n-1/1 # last\n";
        let raw = parse(text).unwrap();
        let corner = |position| Corner { position, normal: None, uv: Some(0) };
        assert_eq!(raw.triangles, [[corner(0), corner(1), corner(2)]]);
        assert_eq!(raw.uvs, [Vec2::new(0.25, 1.0)]);
    }

    #[test]
    fn faults_have_their_line() {
        for (text, line, part) in [
            ("v 0 0\n", 1, "2 numbers where 3"),
            ("v 0 0 zero\n", 1, "`zero` is no number"),
            ("v 0 0 0\nf 1 2 3\n", 2, "vertex 2; there are 1"),
            ("v 0 0 0\nf 1/1 1/1 1/1\n", 2, "texture coordinate 1; there are 0"),
            ("v 0 0 0\nf 1 1\n", 2, "a face of 2 corners"),
            ("v 0 0 0\n\nf 0 1 1\n", 3, "vertex 0"),
            ("v 0 0 0\nf 1 1 -9223372036854775808\n", 2, "vertex -9223372036854775808"),
            ("v 0 0 0\nf a b c\n", 2, "`a` is no corner"),
        ] {
            let (found, message) = parse(text).unwrap_err();
            assert!(found == line && message.contains(part), "{text}: {found}: {message}");
        }
    }
}
