//! The few messages that programs of any two versions understand: a host may always stop the rig, darken it,
//! and ask for its state. They need no session, do no harm when they are repeated, and renew no lease. Their
//! layout is fixed for ever; a later version may only append bytes, commands and bits.
//!
//! | byte | 0 | 1–4 | 5 | 6–7 | 8–11 | 12–27 |
//! |---|---|---|---|---|---|---|
//! | to the controller | kind 3 | `SAFE` | command | | | |
//! | to the host | kind 3 | `SAFE` | the same command | state | time since the start, s | positions in steps: pan, tilt, roll, light |
//!
//! Numbers are little-endian. A command that the controller does not know does nothing and is answered all
//! the same.

use crate::AXES;

const MAGIC: &[u8; 4] = b"SAFE";
/// First payload byte.
pub(crate) const KIND: u8 = 3;
const REQUEST: usize = 6;
const REPLY: usize = 28;

/// What any host may ask of any controller.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SafeCommand {
    /// 0: nothing but the answer.
    Ask,
    /// 1: axes come to rest by their ramps, the shutter closes, what waits is refused.
    Stop,
    /// 2: the lamp goes out and the shutter closes.
    Darken,
    /// A later version's.
    Unknown(u8),
}

impl SafeCommand {
    /// Its number.
    pub const fn number(self) -> u8 {
        match self {
            Self::Ask => 0,
            Self::Stop => 1,
            Self::Darken => 2,
            Self::Unknown(number) => number,
        }
    }

    const fn of(number: u8) -> Self {
        match number {
            0 => Self::Ask,
            1 => Self::Stop,
            2 => Self::Darken,
            _ => Self::Unknown(number),
        }
    }

    pub(crate) fn write(self) -> [u8; REQUEST] {
        let mut payload = [KIND, 0, 0, 0, 0, self.number()];
        payload[1..5].copy_from_slice(MAGIC);
        payload
    }

    pub(crate) fn read(payload: &[u8]) -> Option<Self> {
        let rest = payload.strip_prefix(&[KIND])?.strip_prefix(MAGIC)?;
        rest.first().map(|&number| Self::of(number))
    }
}

/// The state bits.
mod bit {
    pub(super) const MOVING: u16 = 1 << 0;
    pub(super) const BUSY: u16 = 1 << 1;
    pub(super) const LAMP: u16 = 1 << 2;
    pub(super) const SHUTTER: u16 = 1 << 3;
    pub(super) const PRESSED: u16 = 1 << 4;
    pub(super) const FAULT: u16 = 1 << 5;
    pub(super) const KNOWN: u16 = 1 << 6;
    pub(super) const CONFIGURED: u16 = 1 << 7;
}

/// How things stand, as any host understands it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SafeState {
    /// What it answers.
    pub command: SafeCommand,
    /// Bit 0: an axis is moving.
    pub moving: bool,
    /// Bit 1: something is being run.
    pub busy: bool,
    /// Bit 2: the lamp burns.
    pub lamp: bool,
    /// Bit 3: the shutter is open.
    pub shutter: bool,
    /// Bit 4: the emergency stop is pressed.
    pub emergency_stop: bool,
    /// Bit 5: a fault is set.
    pub fault: bool,
    /// Bit 6: the positions of all axes are known.
    pub known: bool,
    /// Bit 7: parameters are set.
    pub configured: bool,
    /// Time since the controller's start, s.
    pub uptime_s: u32,
    /// Positions in steps, which mean nothing unless they are known.
    pub positions: [i32; AXES],
}

impl SafeState {
    pub(crate) fn write(&self) -> [u8; REPLY] {
        let bits = [
            (self.moving, bit::MOVING),
            (self.busy, bit::BUSY),
            (self.lamp, bit::LAMP),
            (self.shutter, bit::SHUTTER),
            (self.emergency_stop, bit::PRESSED),
            (self.fault, bit::FAULT),
            (self.known, bit::KNOWN),
            (self.configured, bit::CONFIGURED),
        ];
        let state = bits.into_iter().fold(0, |state, (set, bit)| if set { state | bit } else { state });
        let mut payload = [0; REPLY];
        payload[..REQUEST].copy_from_slice(&self.command.write());
        payload[6..8].copy_from_slice(&state.to_le_bytes());
        payload[8..12].copy_from_slice(&self.uptime_s.to_le_bytes());
        for (into, position) in payload[12..].chunks_exact_mut(4).zip(self.positions) {
            into.copy_from_slice(&position.to_le_bytes());
        }
        payload
    }

    pub(crate) fn read(payload: &[u8]) -> Option<Self> {
        let command = SafeCommand::read(payload)?;
        let (state, rest) = payload.get(REQUEST..)?.split_first_chunk::<2>()?;
        let (uptime, rest) = rest.split_first_chunk::<4>()?;
        let state = u16::from_le_bytes(*state);
        let mut positions = [0; AXES];
        for (k, position) in positions.iter_mut().enumerate() {
            *position = i32::from_le_bytes(*rest.get(4 * k..)?.first_chunk::<4>()?);
        }
        let is = |bit: u16| state & bit != 0;
        Some(Self {
            command,
            moving: is(bit::MOVING),
            busy: is(bit::BUSY),
            lamp: is(bit::LAMP),
            shutter: is(bit::SHUTTER),
            emergency_stop: is(bit::PRESSED),
            fault: is(bit::FAULT),
            known: is(bit::KNOWN),
            configured: is(bit::CONFIGURED),
            uptime_s: u32::from_le_bytes(*uptime),
            positions,
        })
    }
}
