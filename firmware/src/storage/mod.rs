//! Parameters that outlive a power cut: two slots, written in turn, each with a sequence number and a
//! checksum.
//!
//! | byte | 0–3 | 4–7 | 8–9 | 10… | last 4 |
//! |---|---|---|---|---|---|
//! | | identity of the parameters' schema, low half | sequence | length | parameters, postcard | CRC-32 of all before |
//!
//! Only the older slot is ever erased and written, its checksum last. So after a cut at any byte the newer
//! one still stands, or the new one does; never half of one. Numbers are little-endian. Parameters outlive an
//! update of the program that leaves them as they are, and one that adds some, which then have their defaults
//! (`layouts`).

mod layouts;

use lobelia_protocol::{Configuration, packet, schema};

/// Bytes that a slot needs.
pub const SLOT_BYTES: usize = 640;
const HEADER: usize = 10;
const CHECKSUM: usize = 4;

/// Two slots of flash, each of at least [`SLOT_BYTES`], erased apart.
pub trait Storage {
    /// Reads a slot from its beginning; false when it can't.
    fn read(&mut self, slot: usize, into: &mut [u8]) -> bool;
    /// Erases a slot.
    fn erase(&mut self, slot: usize) -> bool;
    /// Writes an erased slot from its beginning, bytes in order; false when it can't.
    fn write(&mut self, slot: usize, bytes: &[u8]) -> bool;
}

/// What a slot holds.
struct Record {
    sequence: u32,
    configuration: Configuration,
    /// Low half of the identity of an older layout, if it was written in one.
    older: Option<u32>,
}

#[inline(never)]
fn read_slot(storage: &mut dyn Storage, slot: usize) -> Option<Record> {
    let mut bytes = [0; SLOT_BYTES];
    if !storage.read(slot, &mut bytes) {
        return None;
    }
    let (identity, rest) = bytes.split_first_chunk::<4>()?;
    let (sequence, rest) = rest.split_first_chunk::<4>()?;
    let (length, _) = rest.split_first_chunk::<2>()?;
    let end = HEADER + usize::from(u16::from_le_bytes(*length));
    let (record, checksum) = (bytes.get(..end)?, bytes.get(end..end + CHECKSUM)?);
    if packet::checksum(record).to_le_bytes() != *checksum {
        return None;
    }
    let (identity, parameters) = (u32::from_le_bytes(*identity), &record[HEADER..]);
    let (configuration, older) = if identity == schema::PARAMETERS as u32 {
        (packet::read_configuration(parameters)?, None)
    } else {
        let layout = layouts::OLDER.iter().find(|layout| layout.identity == identity)?;
        (layouts::read(layout, parameters)?, Some(identity))
    };
    Some(Record { sequence: u32::from_le_bytes(*sequence), configuration, older })
}

/// The slot that holds what was saved last, and that record.
fn newest(storage: &mut dyn Storage) -> Option<(usize, Record)> {
    let first = read_slot(storage, 0);
    let second = read_slot(storage, 1);
    match (first, second) {
        (Some(first), Some(second)) => {
            // Sequence numbers may wrap.
            let second_newer = second.sequence.wrapping_sub(first.sequence) < u32::MAX / 2;
            Some(if second_newer { (1, second) } else { (0, first) })
        }
        (Some(record), None) => Some((0, record)),
        (None, Some(record)) => Some((1, record)),
        (None, None) => None,
    }
}

/// What was saved last.
pub fn load(storage: &mut dyn Storage) -> Option<Configuration> {
    load_any(storage).map(|(configuration, _)| configuration)
}

/// The same, and low half of the identity of the older layout that it was saved in, if it was.
#[inline(never)]
pub fn load_any(storage: &mut dyn Storage) -> Option<(Configuration, Option<u32>)> {
    newest(storage).map(|(_, record)| (record.configuration, record.older))
}

/// Saves; false when it failed, and what was saved before still stands.
pub fn save(storage: &mut dyn Storage, configuration: &Configuration) -> bool {
    let (slot, sequence) =
        newest(storage).map_or((0, 0), |(slot, record)| (1 - slot, record.sequence.wrapping_add(1)));
    let mut bytes = [0; SLOT_BYTES];
    let Some(length) = packet::write_configuration(configuration, &mut bytes[HEADER..SLOT_BYTES - CHECKSUM])
    else {
        return false;
    };
    bytes[..4].copy_from_slice(&(schema::PARAMETERS as u32).to_le_bytes());
    bytes[4..8].copy_from_slice(&sequence.to_le_bytes());
    bytes[8..HEADER].copy_from_slice(&(length as u16).to_le_bytes());
    let end = HEADER + length;
    let checksum = packet::checksum(&bytes[..end]);
    bytes[end..end + CHECKSUM].copy_from_slice(&checksum.to_le_bytes());
    storage.erase(slot)
        && storage.write(slot, &bytes[..end + CHECKSUM])
        && read_slot(storage, slot).is_some_and(|record| record.configuration == *configuration)
}
