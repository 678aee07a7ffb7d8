//! Frames: a payload and its CRC-32, wrapped by COBS so that the zero byte occurs only between frames.
//!
//! Each frame has a zero byte before it too: whatever a disturbed line left in the receiver's buffer then
//! ends there as a frame of its own, and is refused, instead of spoiling the frame that follows.

use crc::{CRC_32_ISO_HDLC, Crc};

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
const CRC_BYTES: usize = 4;
const DELIMITER: u8 = 0;

/// Longest payload of a frame, in bytes.
pub const MAX_PAYLOAD: usize = 128;
/// Longest body between the delimiters: COBS adds a byte for each 254 begun.
const MAX_BODY: usize = cobs::max_encoding_length(MAX_PAYLOAD + CRC_BYTES);
/// Longest frame with both delimiters, in bytes.
pub const MAX_FRAME: usize = MAX_BODY + 2;

/// A frame ready to be sent, delimiters included.
pub type EncodedFrame = heapless::Vec<u8, MAX_FRAME>;

/// Why bytes between two delimiters are not a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameError {
    /// More bytes than a frame can have.
    TooLong,
    /// Not what COBS writes, or too short to hold a byte and its checksum.
    Malformed,
    /// The checksum is that of another payload.
    Checksum,
}

/// Wraps a payload; `None` when it is empty or longer than [`MAX_PAYLOAD`].
pub fn encode(payload: &[u8]) -> Option<EncodedFrame> {
    if payload.is_empty() || payload.len() > MAX_PAYLOAD {
        return None;
    }
    let mut checked = heapless::Vec::<u8, { MAX_PAYLOAD + CRC_BYTES }>::new();
    checked.extend_from_slice(payload).ok()?;
    checked.extend_from_slice(&CRC.checksum(payload).to_le_bytes()).ok()?;
    let mut body = [0; MAX_BODY];
    let length = cobs::encode(&checked, &mut body);
    let mut frame = EncodedFrame::new();
    frame.push(DELIMITER).ok()?;
    frame.extend_from_slice(&body[..length]).ok()?;
    frame.push(DELIMITER).ok()?;
    Some(frame)
}

/// Finds frames in a stream of bytes, in a buffer of fixed size; after any disturbance it is in step again at
/// the next delimiter.
#[derive(Debug, Clone)]
pub struct FrameDecoder {
    buffer: [u8; MAX_BODY],
    length: usize,
    too_long: bool,
}

impl Default for FrameDecoder {
    fn default() -> Self {
        Self::new()
    }
}

impl FrameDecoder {
    /// A decoder with nothing received.
    pub const fn new() -> Self {
        Self { buffer: [0; MAX_BODY], length: 0, too_long: false }
    }

    /// Takes one byte; at the end of a frame gives its payload, or why it has none.
    pub fn push(&mut self, byte: u8) -> Option<Result<&[u8], FrameError>> {
        if byte != DELIMITER {
            match self.buffer.get_mut(self.length) {
                Some(place) => {
                    *place = byte;
                    self.length += 1;
                }
                None => self.too_long = true,
            }
            return None;
        }
        let length = core::mem::take(&mut self.length);
        if core::mem::take(&mut self.too_long) {
            return Some(Err(FrameError::TooLong));
        }
        if length == 0 {
            return None;
        }
        Some(unwrap(&mut self.buffer[..length]))
    }
}

/// The checksum of frames: CRC-32 as in Ethernet and zip.
pub(crate) const fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}

/// Undoes COBS in place and checks the checksum.
fn unwrap(body: &mut [u8]) -> Result<&[u8], FrameError> {
    let length = cobs::decode_in_place(body).map_err(|_| FrameError::Malformed)?;
    let (payload, checksum) = body
        .get(..length)
        .and_then(|checked| checked.split_last_chunk::<CRC_BYTES>())
        // Nothing has the checksum 0: a piece of a frame that is all zeros would pass for it.
        .filter(|(payload, _)| !payload.is_empty())
        .ok_or(FrameError::Malformed)?;
    if CRC.checksum(payload) == u32::from_le_bytes(*checksum) {
        Ok(payload)
    } else {
        Err(FrameError::Checksum)
    }
}
