//! The hello that opens a session. Its layout is fixed for ever, so programs of any two versions understand
//! it and can say which versions they are; a later version may only append bytes.
//!
//! | byte | 0 | 1–4 | 5–12 | 13–16 | 17–20 | 21 |
//! |---|---|---|---|---|---|---|
//! | | kind 0 | `LOBE` | schema identity | schema version | session | verdict (reply only) |
//!
//! Numbers are little-endian.

use crate::schema;

const MAGIC: &[u8; 4] = b"LOBE";
/// First payload byte of a hello.
pub(crate) const KIND: u8 = 0;
const LENGTH: usize = 21;

/// Which schema a program speaks, and the session that the host opens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hello {
    /// The sender's schema identity.
    pub schema: u64,
    /// The sender's schema version, for people.
    pub version: u32,
    /// Chosen by the host, new for each session: requests of another session are not run.
    pub session: u32,
}

/// The controller's decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// Same schema: the session is open.
    Accepted,
    /// Different schema: nothing but a hello will be understood.
    DifferentSchema,
}

/// The controller's reply to a hello, with its own schema and the host's session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HelloReply {
    /// The controller's schema, and the session that it replies to.
    pub hello: Hello,
    /// Whether the session is open.
    pub verdict: Verdict,
}

impl Hello {
    /// A hello of this very version.
    pub const fn new(session: u32) -> Self {
        Self { schema: schema::IDENTITY, version: schema::VERSION, session }
    }

    /// What a controller of this version replies.
    pub const fn reply(&self) -> HelloReply {
        let verdict =
            if self.schema == schema::IDENTITY { Verdict::Accepted } else { Verdict::DifferentSchema };
        HelloReply { hello: Self::new(self.session), verdict }
    }

    pub(crate) fn write(&self) -> [u8; LENGTH] {
        let mut payload = [0; LENGTH];
        payload[0] = KIND;
        payload[1..5].copy_from_slice(MAGIC);
        payload[5..13].copy_from_slice(&self.schema.to_le_bytes());
        payload[13..17].copy_from_slice(&self.version.to_le_bytes());
        payload[17..21].copy_from_slice(&self.session.to_le_bytes());
        payload
    }

    /// Reads the fixed part; gives also what follows it.
    pub(crate) fn read(payload: &[u8]) -> Option<(Self, &[u8])> {
        let rest = payload.strip_prefix(&[KIND])?.strip_prefix(MAGIC)?;
        let (schema, rest) = rest.split_first_chunk::<8>()?;
        let (version, rest) = rest.split_first_chunk::<4>()?;
        let (session, rest) = rest.split_first_chunk::<4>()?;
        let hello = Self {
            schema: u64::from_le_bytes(*schema),
            version: u32::from_le_bytes(*version),
            session: u32::from_le_bytes(*session),
        };
        Some((hello, rest))
    }
}

impl HelloReply {
    pub(crate) fn write(&self) -> [u8; LENGTH + 1] {
        let mut payload = [0; LENGTH + 1];
        payload[..LENGTH].copy_from_slice(&self.hello.write());
        payload[LENGTH] = match self.verdict {
            Verdict::Accepted => 1,
            Verdict::DifferentSchema => 0,
        };
        payload
    }

    pub(crate) fn read(payload: &[u8]) -> Option<Self> {
        let (hello, rest) = Hello::read(payload)?;
        let verdict = if *rest.first()? == 1 { Verdict::Accepted } else { Verdict::DifferentSchema };
        Some(Self { hello, verdict })
    }
}
