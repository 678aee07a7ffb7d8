//! A PLY file's header, and its body row by row: numbers of every type as f64.

/// The types of numbers and their bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number that bytes in little-endian order hold.
    fn value(self, bytes: [u8; 8]) -> f64 {
        let [a, b, c, d, ..] = bytes;
        match self {
            Self::I8 => f64::from(a as i8),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(bytes),
        }
    }
}

/// A property of an element.
struct Property {
    name: String,
    number: Number,
    /// The type of a list's length.
    length: Option<Number>,
}

/// An element: as many rows of the same properties.
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: usize,
    properties: Vec<Property>,
}

impl Element {
    /// The place of a property that is one number.
    pub(super) fn scalar(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|property| property.name == name && property.length.is_none())
    }

    /// The place of a property that is a list.
    pub(super) fn list(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|property| property.name == name && property.length.is_some())
    }
}

/// What the file has.
pub(super) struct Header {
    pub(super) elements: Vec<Element>,
}

#[derive(Clone, Copy, PartialEq)]
enum Format {
    Text,
    Little,
    Big,
}

impl Header {
    /// Reads the header; the source stands at the body then.
    pub(super) fn parse(bytes: &[u8]) -> Result<(Self, Source<'_>), String> {
        let mut rest = bytes;
        if next_line(&mut rest).as_deref() != Some("ply") {
            return Err("it is no PLY file, which begins with a line `ply`".into());
        }
        let mut format = None;
        let mut elements: Vec<Element> = Vec::new();
        loop {
            let line = next_line(&mut rest).ok_or("it ends in its header")?;
            let words: Vec<&str> = line.split_whitespace().collect();
            match &words[..] {
                ["end_header"] => break,
                [] | ["comment" | "obj_info", ..] => {}
                ["format", name, _] => {
                    format = Some(match *name {
                        "ascii" => Format::Text,
                        "binary_little_endian" => Format::Little,
                        "binary_big_endian" => Format::Big,
                        _ => return Err(format!("its format `{name}` is not known")),
                    });
                }
                ["element", name, count] => {
                    let count =
                        count.parse().map_err(|_| format!("its header's line `{line}` has no count"))?;
                    elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
                }
                ["property", words @ ..] => {
                    let property = property(words)
                        .ok_or_else(|| format!("its header's line `{line}` is no property"))?;
                    let element =
                        elements.last_mut().ok_or("its header has a property before any element")?;
                    element.properties.push(property);
                }
                _ => return Err(format!("its header's line `{line}` is not known")),
            }
        }
        let format = format.ok_or("its header has no format")?;
        if let Some(element) = elements.iter().find(|e| e.properties.is_empty() && e.count > 0) {
            return Err(format!("its element \"{}\" has no properties", element.name));
        }
        Ok((Self { elements }, Source { rest, format, values: Vec::new(), ends: Vec::new() }))
    }
}

fn property(words: &[&str]) -> Option<Property> {
    let (number, length, name) = match words {
        ["list", length, number, name] => (number, Some(Number::parse(length)?), name),
        [number, name] => (number, None, name),
        _ => return None,
    };
    Some(Property { name: (*name).into(), number: Number::parse(number)?, length })
}

/// The next line without its end, in any encoding.
fn next_line(rest: &mut &[u8]) -> Option<String> {
    let end = rest.iter().position(|&byte| byte == b'\n')?;
    let line = String::from_utf8_lossy(&rest[..end]).trim_end_matches('\r').trim().to_string();
    *rest = &rest[end + 1..];
    Some(line)
}

/// The body, and the row read last.
pub(super) struct Source<'a> {
    rest: &'a [u8],
    format: Format,
    /// Numbers of the row, property by property, and where each property ends.
    values: Vec<f64>,
    ends: Vec<usize>,
}

impl Source<'_> {
    /// Reads the next row of an element. Lists are as long as the file has bytes for.
    pub(super) fn row(&mut self, element: &Element, row: usize) -> Result<(), String> {
        self.values.clear();
        self.ends.clear();
        let short = || format!("it ends in row {row} of element \"{}\", of {}", element.name, element.count);
        for property in &element.properties {
            let count = match property.length {
                None => 1,
                Some(length) => {
                    let count = self.number(length)?.ok_or_else(short)?;
                    if count < 0.0 || count.fract() != 0.0 {
                        return Err(format!(
                            "a list in row {row} of element \"{}\" has {count} entries",
                            element.name
                        ));
                    }
                    count as usize
                }
            };
            for _ in 0..count {
                let number = self.number(property.number)?.ok_or_else(short)?;
                self.values.push(number);
            }
            self.ends.push(self.values.len());
        }
        Ok(())
    }

    /// The numbers of a property of the row read last.
    pub(super) fn values(&self, property: usize) -> &[f64] {
        let begin = property.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.values[begin..self.ends[property]]
    }

    /// The next number; none at the end.
    fn number(&mut self, number: Number) -> Result<Option<f64>, String> {
        if self.format == Format::Text {
            self.rest = self.rest.trim_ascii_start();
            if self.rest.is_empty() {
                return Ok(None);
            }
            let end = self.rest.iter().position(u8::is_ascii_whitespace).unwrap_or(self.rest.len());
            let (word, rest) = self.rest.split_at(end);
            self.rest = rest;
            let word = String::from_utf8_lossy(word);
            return word.parse().map(Some).map_err(|_| format!("`{word}` is no number"));
        }
        let count = number.bytes();
        let Some((bytes, rest)) = self.rest.split_at_checked(count) else { return Ok(None) };
        self.rest = rest;
        let mut ordered = [0; 8];
        ordered[..count].copy_from_slice(bytes);
        if self.format == Format::Big {
            ordered[..count].reverse();
        }
        Ok(Some(number.value(ordered)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_every_type_and_byte_order_are_read() {
        let types = ["char", "uint8", "short", "uint16", "int32", "uint", "float", "double"];
        let properties: String =
            types.iter().enumerate().map(|(k, name)| format!("property {name} p{k}\n")).collect();
        let head = |format: &str| {
            format!(
                "ply\r\nformat {format} 1.0\ncomment Gr\u{f6}\u{df}e\nelement e 1\n{properties}end_header\n"
            )
        };
        let expected = [-2.0, 250.0, -300.0, 60000.0, -70000.0, 4e9, 0.5, -0.1];
        let mut little = Vec::new();
        little.extend((-2i8).to_le_bytes());
        little.extend(250u8.to_le_bytes());
        little.extend((-300i16).to_le_bytes());
        little.extend(60000u16.to_le_bytes());
        little.extend((-70000i32).to_le_bytes());
        little.extend(4_000_000_000u32.to_le_bytes());
        little.extend(0.5f32.to_le_bytes());
        little.extend((-0.1f64).to_le_bytes());
        let mut big = Vec::new();
        let mut place = 0;
        for count in [1, 1, 2, 2, 4, 4, 4, 8] {
            big.extend(little[place..place + count].iter().rev());
            place += count;
        }
        for (format, body) in [
            ("ascii", b"-2 250 -300 60000\n\n-70000 4000000000 0.5 -0.1".to_vec()),
            ("binary_little_endian", little),
            ("binary_big_endian", big),
        ] {
            let bytes = [head(format).into_bytes(), body].concat();
            let (header, mut source) = Header::parse(&bytes).unwrap();
            source.row(&header.elements[0], 0).unwrap();
            assert!((0..8).all(|k| source.values(k) == [expected[k]]), "{format}");
            assert!(source.row(&header.elements[0], 1).unwrap_err().contains("it ends in row 1"));
        }
    }

    #[test]
    fn headers_that_make_no_sense_are_refused() {
        for (text, part) in [
            ("obj\n", "begins with a line `ply`"),
            ("ply\nformat ascii 1.0\n", "ends in its header"),
            ("ply\nformat ebcdic 1.0\nend_header\n", "`ebcdic`"),
            ("ply\nend_header\n", "no format"),
            ("ply\nformat ascii 1.0\nproperty int x\nend_header\n", "before any element"),
            ("ply\nformat ascii 1.0\nelement e 2\nproperty text x\nend_header\n", "property text x"),
            ("ply\nformat ascii 1.0\nelement e 99999999\nend_header\n", "\"e\" has no properties"),
            ("ply\nformat ascii 1.0\nelement e many\nend_header\n", "has no count"),
        ] {
            let error = Header::parse(text.as_bytes()).err().unwrap();
            assert!(error.contains(part), "{error}");
        }
    }
}
