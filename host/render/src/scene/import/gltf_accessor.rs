//! Numbers of a glTF document's accessors, checked against its buffers before anything is read.

use super::gltf_json::{Accessor, Document};

/// Entries of an accessor without a buffer, whose numbers are 0 but where sparse ones are given, that any
/// file may have. More are as many as its buffers have bytes, which the vertices that they belong to take at
/// least.
const MOST_ZEROS: usize = 1 << 16;

/// The types of numbers.
#[derive(Clone, Copy)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn new(code: u32) -> Option<Self> {
        Some(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// The number at the begin of some bytes, of which there are enough.
    fn number(self, bytes: &[u8]) -> f64 {
        let four: [u8; 4] = std::array::from_fn(|k| bytes.get(k).copied().unwrap_or_default());
        let two = [four[0], four[1]];
        match self {
            Self::I8 => f64::from(four[0] as i8),
            Self::U8 => f64::from(four[0]),
            Self::I16 => f64::from(i16::from_le_bytes(two)),
            Self::U16 => f64::from(u16::from_le_bytes(two)),
            Self::U32 => f64::from(u32::from_le_bytes(four)),
            Self::F32 => f64::from(f32::from_le_bytes(four)),
        }
    }

    /// What a number stands for where it is normalised.
    fn normalised(self, number: f64) -> f64 {
        match self {
            Self::I8 => (number / 127.0).max(-1.0),
            Self::U8 => number / 255.0,
            Self::I16 => (number / 32767.0).max(-1.0),
            Self::U16 => number / 65535.0,
            Self::U32 | Self::F32 => number,
        }
    }
}

/// Numbers an entry has, and bytes from one column of a matrix to the next, which begins at a multiple of 4.
fn layout(dimensions: &str, component: Component) -> Option<(usize, usize, usize)> {
    let (columns, rows) = match dimensions {
        "SCALAR" => (1, 1),
        "VEC2" => (1, 2),
        "VEC3" => (1, 3),
        "VEC4" => (1, 4),
        "MAT2" => (2, 2),
        "MAT3" => (3, 3),
        "MAT4" => (4, 4),
        _ => return None,
    };
    let column = rows * component.bytes();
    Some((columns, rows, if columns > 1 { column.next_multiple_of(4) } else { column }))
}

/// Entries of N numbers each.
///
/// # Errors
/// A sentence that names the accessor, for one that is not there, has other numbers, or reaches beyond its
/// buffer.
pub(super) fn read<const N: usize>(
    document: &Document,
    buffers: &[Vec<u8>],
    index: usize,
) -> Result<Vec<[f64; N]>, String> {
    let place = |what: &str| format!("accessor {index} {what}");
    let accessor = document.accessors.get(index).ok_or_else(|| place("is not there"))?;
    let component =
        Component::new(accessor.component_type).ok_or_else(|| place("has an unknown type of numbers"))?;
    let (columns, rows, column_bytes) =
        layout(&accessor.dimensions, component).ok_or_else(|| place("has an unknown type"))?;
    if columns * rows != N {
        return Err(place(&format!("has {} numbers an entry where {N} are needed", columns * rows)));
    }
    let entry_bytes = (columns - 1) * column_bytes + rows * component.bytes();
    let decode = |bytes: &[u8]| -> [f64; N] {
        std::array::from_fn(|k| {
            let at = k / rows * column_bytes + k % rows * component.bytes();
            let number = component.number(&bytes[at..]);
            if accessor.normalized { component.normalised(number) } else { number }
        })
    };
    let mut entries = match accessor.buffer_view {
        Some(view) => {
            let part = Part { view, offset: accessor.byte_offset, count: accessor.count, bytes: entry_bytes };
            part.entries(document, buffers).map_err(|what| place(&what))?.map(decode).collect()
        }
        None if accessor.sparse.is_none() => {
            return Err(place("has no buffer view; its numbers are missing"));
        }
        None if accessor.count > buffers.iter().map(Vec::len).sum::<usize>().max(MOST_ZEROS) => {
            return Err(place("has too many entries for sparse ones"));
        }
        None => vec![[0.0; N]; accessor.count],
    };
    for (at, value) in sparse(document, buffers, accessor, entry_bytes).map_err(|what| place(&what))? {
        *entries.get_mut(at).ok_or_else(|| place("has a sparse index beyond its count"))? = decode(value);
    }
    Ok(entries)
}

/// Places and bytes of sparse entries.
fn sparse<'a>(
    document: &'a Document,
    buffers: &'a [Vec<u8>],
    accessor: &Accessor,
    entry_bytes: usize,
) -> Result<Vec<(usize, &'a [u8])>, String> {
    let Some(sparse) = &accessor.sparse else { return Ok(Vec::new()) };
    let component =
        Component::new(sparse.indices.component_type).ok_or("has sparse indices of an unknown type")?;
    let part = |part: &super::gltf_json::SparsePart, bytes| Part {
        view: part.buffer_view,
        offset: part.byte_offset,
        count: sparse.count,
        bytes,
    };
    let indices = part(&sparse.indices, component.bytes()).entries(document, buffers)?;
    let values = part(&sparse.values, entry_bytes).entries(document, buffers)?;
    Ok(indices.map(|bytes| component.number(bytes) as usize).zip(values).collect())
}

/// A run of entries in a buffer view.
struct Part {
    view: usize,
    offset: usize,
    count: usize,
    /// Bytes of an entry.
    bytes: usize,
}

impl Part {
    /// The bytes from each entry's begin on, at least as many as an entry has.
    fn entries<'a>(
        &self,
        document: &Document,
        buffers: &'a [Vec<u8>],
    ) -> Result<impl Iterator<Item = &'a [u8]> + use<'a>, String> {
        let Self { view, offset, count, bytes } = *self;
        let found = document.buffer_views.get(view).ok_or("refers to a buffer view that is not there")?;
        let buffer = buffers.get(found.buffer).ok_or("refers to a buffer that is not there")?;
        let end = found.byte_offset.checked_add(found.byte_length);
        let content = end.and_then(|end| buffer.get(found.byte_offset..end));
        let content = content
            .ok_or_else(|| format!("refers to buffer view {view}, which reaches beyond its buffer"))?;
        let stride = found.byte_stride.unwrap_or(bytes);
        if stride < bytes {
            return Err(format!(
                "has entries of {bytes} bytes in a buffer view whose byteStride is {stride}"
            ));
        }
        let needed = count
            .checked_sub(1)
            .map_or(Some(0), |gaps| gaps.checked_mul(stride)?.checked_add(bytes)?.checked_add(offset));
        if needed.is_none_or(|needed| needed > content.len()) {
            return Err(format!("reaches beyond its buffer view {view}"));
        }
        Ok((0..count).map(move |k| &content[offset + k * stride..]))
    }
}
