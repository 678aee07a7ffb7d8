//! Packets: the payload of a frame, which is a hello or a message written with postcard.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::event::Event;
use crate::frame::{self, EncodedFrame, MAX_PAYLOAD};
use crate::frozen::{self, SafeCommand, SafeState};
use crate::hello::{self, Hello, HelloReply};
use crate::message::{Request, Response};
use crate::parameters::Configuration;

const MESSAGE: u8 = 1;
const EVENT: u8 = 2;

/// Why a payload can't be written or read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CodecError {
    /// Longer than a frame may be.
    TooLong,
    /// Not a message of this schema.
    Malformed,
}

/// What the host sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ToController {
    /// Opens a session.
    Hello(Hello),
    /// Asks for something.
    Request(Request),
    /// Asks for something in the words of every version.
    Safe(SafeCommand),
}

/// What the controller sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ToHost {
    /// Answers a hello.
    Hello(HelloReply),
    /// Answers a request.
    Response(Response),
    /// Tells of something unasked.
    Event(Event),
    /// Answers what was asked in the words of every version.
    Safe(SafeState),
}

impl ToController {
    /// Writes it as a frame.
    pub fn encode(&self) -> Result<EncodedFrame, CodecError> {
        match self {
            Self::Hello(hello) => wrap(&hello.write()),
            Self::Request(request) => write(MESSAGE, request),
            Self::Safe(command) => wrap(&command.write()),
        }
    }

    /// Reads a frame's payload.
    pub fn decode(payload: &[u8]) -> Result<Self, CodecError> {
        match payload {
            [hello::KIND, ..] => {
                Hello::read(payload).map(|(hello, _)| Self::Hello(hello)).ok_or(CodecError::Malformed)
            }
            [MESSAGE, body @ ..] => read(body).map(Self::Request),
            [frozen::KIND, ..] => SafeCommand::read(payload).map(Self::Safe).ok_or(CodecError::Malformed),
            _ => Err(CodecError::Malformed),
        }
    }
}

impl ToHost {
    /// Writes it as a frame.
    pub fn encode(&self) -> Result<EncodedFrame, CodecError> {
        match self {
            Self::Hello(reply) => wrap(&reply.write()),
            Self::Response(response) => write(MESSAGE, response),
            Self::Event(event) => write(EVENT, event),
            Self::Safe(state) => wrap(&state.write()),
        }
    }

    /// Reads a frame's payload.
    pub fn decode(payload: &[u8]) -> Result<Self, CodecError> {
        match payload {
            [hello::KIND, ..] => HelloReply::read(payload).map(Self::Hello).ok_or(CodecError::Malformed),
            [MESSAGE, body @ ..] => read(body).map(Self::Response),
            [EVENT, body @ ..] => read(body).map(Self::Event),
            [frozen::KIND, ..] => SafeState::read(payload).map(Self::Safe).ok_or(CodecError::Malformed),
            _ => Err(CodecError::Malformed),
        }
    }
}

/// The CRC-32 that frames bear, for records that are stored instead of sent.
pub fn checksum(bytes: &[u8]) -> u32 {
    frame::checksum(bytes)
}

/// Writes a configuration as it is sent; gives its length, or nothing when it doesn't fit.
pub fn write_configuration(configuration: &Configuration, into: &mut [u8]) -> Option<usize> {
    write_part(configuration, into)
}

/// Writes a part of one, as its axes or its settings; gives its length, or nothing when it doesn't fit.
pub fn write_part(part: &impl Serialize, into: &mut [u8]) -> Option<usize> {
    postcard::to_slice(part, into).ok().map(|written| written.len())
}

/// Reads what [`write_part`] wrote.
pub fn read_part<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    read(bytes).ok()
}

/// Reads what [`write_configuration`] wrote.
pub fn read_configuration(bytes: &[u8]) -> Option<Configuration> {
    read(bytes).ok()
}

fn write(kind: u8, message: &impl Serialize) -> Result<EncodedFrame, CodecError> {
    let mut payload = [0; MAX_PAYLOAD];
    payload[0] = kind;
    let length = postcard::to_slice(message, &mut payload[1..]).map_err(|_| CodecError::TooLong)?.len();
    wrap(&payload[..=length])
}

fn wrap(payload: &[u8]) -> Result<EncodedFrame, CodecError> {
    frame::encode(payload).ok_or(CodecError::TooLong)
}

/// Bytes left over are an error: they belong to another schema.
fn read<T: DeserializeOwned>(body: &[u8]) -> Result<T, CodecError> {
    match postcard::take_from_bytes(body) {
        Ok((message, [])) => Ok(message),
        _ => Err(CodecError::Malformed),
    }
}
