//! Any bytes as frames and packets: mutations of a corpus, each read by the decoder and by a second, plain
//! one.
//!
//! A loop on stable Rust, without the compiler's coverage: inputs that decode to a kind of message not met
//! before join the corpus.
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

mod samples;

use std::collections::HashSet;
use std::time::{Duration, Instant};

use lobelia_protocol::frame::{self, MAX_FRAME};
use lobelia_protocol::{FrameDecoder, FrameError, ToController, ToHost};

const CORPUS: &str = include_str!("corpus.txt");

/// How long a target runs.
enum Length {
    Inputs(u64),
    Time(Duration),
}

/// Numbers from a seed (splitmix64).
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % bound.max(1) as u64) as usize
    }
}

/// The payloads of the corpus: its lines are `name hexadecimal`.
fn corpus() -> Vec<Vec<u8>> {
    let bytes = |hex: &str| {
        let digits = hex.as_bytes().chunks(2);
        digits.map(|two| u8::from_str_radix(std::str::from_utf8(two).unwrap(), 16).unwrap()).collect()
    };
    CORPUS.lines().map(|line| bytes(line.split_once(' ').unwrap().1)).collect()
}

fn mutate(random: &mut Random, corpus: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = corpus[random.below(corpus.len())].clone();
    for _ in 0..1 + random.below(6) {
        let at = random.below(bytes.len() + 1);
        match random.below(7) {
            0 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            1 if at < bytes.len() => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][random.below(5)],
            2 => bytes.insert(at, random.below(256) as u8),
            3 if at < bytes.len() => drop(bytes.remove(at)),
            4 => bytes.truncate(at),
            5 => {
                let piece = bytes[at..(at + random.below(9)).min(bytes.len())].to_vec();
                bytes.splice(at..at, piece);
            }
            6 => {
                let other = &corpus[random.below(corpus.len())];
                bytes.truncate(at);
                bytes.extend(&other[random.below(other.len())..]);
            }
            _ => {}
        }
        bytes.truncate(3 * MAX_FRAME);
    }
    bytes
}

/// Runs a target, which gives what kind of input it was given.
fn fuzz(length: &Length, mut corpus: Vec<Vec<u8>>, target: impl Fn(&[u8]) -> String) {
    let seed = std::env::var("LOBELIA_FUZZ_SEED").map_or(1, |seed| seed.parse().unwrap());
    println!("LOBELIA_FUZZ_SEED={seed}");
    let mut random = Random(seed);
    let mut kinds: HashSet<String> = corpus.iter().map(|input| target(input)).collect();
    let began = Instant::now();
    let mut inputs = 0;
    while match length {
        Length::Inputs(count) => inputs < *count,
        Length::Time(time) => began.elapsed() < *time,
    } {
        inputs += 1;
        let input = mutate(&mut random, &corpus);
        if kinds.insert(target(&input)) {
            corpus.push(input);
        }
    }
    println!("{inputs} inputs, {} kinds", kinds.len());
}

/// The variants' names of something printed for debugging, without its numbers.
fn kind(debug: &str) -> String {
    debug.chars().filter(|letter| letter.is_alphabetic() || *letter == '(').collect()
}

/// A payload read as a packet either way: what is accepted must be written and read again as the same.
fn packets(payload: &[u8]) -> String {
    let mut kinds = String::new();
    if let Ok(packet) = ToController::decode(payload) {
        let frame = packet.encode().expect("what was read fits a frame");
        assert_eq!(ToController::decode(&plain(&frame)[0].clone().unwrap()), Ok(packet));
        kinds += &kind(&format!("{packet:?}"));
    }
    if let Ok(packet) = ToHost::decode(payload) {
        let frame = packet.encode().expect("what was read fits a frame");
        assert_eq!(ToHost::decode(&plain(&frame)[0].clone().unwrap()), Ok(packet));
        kinds += &kind(&format!("{packet:?}"));
    }
    kinds
}

/// A stream of bytes: the decoder finds what the plain one finds.
fn stream(bytes: &[u8]) -> String {
    let mut decoder = FrameDecoder::new();
    let found: Vec<_> =
        bytes.iter().filter_map(|&byte| Some(decoder.push(byte)?.map(<[u8]>::to_vec))).collect();
    assert_eq!(found, plain(bytes));
    found
        .iter()
        .take(4)
        .map(|frame| frame.as_ref().map_or_else(|error| format!("{error:?}"), |_| "+".into()))
        .collect()
}

/// Finds frames in bytes with nothing but the definitions of COBS and of CRC-32.
fn plain(bytes: &[u8]) -> Vec<Result<Vec<u8>, FrameError>> {
    let end = bytes.iter().rposition(|&byte| byte == 0).unwrap_or(0);
    let bodies = bytes[..end].split(|&byte| byte == 0).filter(|body| !body.is_empty());
    bodies
        .map(|body| {
            if body.len() > MAX_FRAME - 2 {
                return Err(FrameError::TooLong);
            }
            let mut checked = uncobs(body).ok_or(FrameError::Malformed)?;
            let length =
                checked.len().checked_sub(4).filter(|&left| left > 0).ok_or(FrameError::Malformed)?;
            let sum = checked.split_off(length);
            if sum == crc32(&checked).to_le_bytes() { Ok(checked) } else { Err(FrameError::Checksum) }
        })
        .collect()
}

fn uncobs(mut body: &[u8]) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    while let Some((&code, rest)) = body.split_first() {
        let (block, rest) = rest.split_at_checked(usize::from(code) - 1)?;
        bytes.extend(block);
        if code < 255 && !rest.is_empty() {
            bytes.push(0);
        }
        body = rest;
    }
    Some(bytes)
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |sum, &byte| {
        (0..8).fold(sum ^ u32::from(byte), |sum, _| (sum >> 1) ^ (0xedb8_8320 * (sum & 1)))
    })
}

fn framed(payloads: &[Vec<u8>]) -> Vec<Vec<u8>> {
    payloads.iter().map(|payload| frame::encode(payload).unwrap().to_vec()).collect()
}

const SHORT: Length = Length::Inputs(20_000);
const LONG: Length = Length::Time(Duration::from_secs(30));

#[test]
fn packets_survive_any_payload() {
    fuzz(&SHORT, corpus(), packets);
}

#[test]
fn frames_are_found_in_any_stream() {
    fuzz(&SHORT, framed(&corpus()), stream);
}

#[test]
#[ignore = "long: 30 s: cargo xtask long"]
fn packets_survive_any_payload_for_long() {
    fuzz(&LONG, corpus(), packets);
}

#[test]
#[ignore = "long: 30 s: cargo xtask long"]
fn frames_are_found_in_any_stream_for_long() {
    fuzz(&LONG, framed(&corpus()), stream);
}

/// `LOBELIA_RENEW=1` writes the corpus anew.
#[test]
fn the_corpus_holds_each_message_as_it_is_written_today() {
    let line = |direction: &str, name: String, frame: &[u8]| {
        let payload = plain(frame).remove(0).unwrap();
        let hex: String = payload.iter().map(|byte| format!("{byte:02x}")).collect();
        format!("{direction}.{name} {hex}\n")
    };
    let name = |debug: String| {
        let after = debug.split("command: ").nth(1).or(debug.split("outcome: ").nth(1)).unwrap_or(&debug);
        let words = after.split([' ', '(', '{']).take_while(|word| word.starts_with(char::is_uppercase));
        words.map(|word| word.trim_end_matches(|c: char| !c.is_alphabetic())).collect::<Vec<_>>().join(".")
    };
    let mut expected = String::new();
    for packet in samples::to_controller() {
        expected += &line("to_controller", name(format!("{packet:?}")), &packet.encode().unwrap());
    }
    for packet in samples::to_host() {
        expected += &line("to_host", name(format!("{packet:?}")), &packet.encode().unwrap());
    }
    if std::env::var_os("LOBELIA_RENEW").is_some() {
        std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/corpus.txt"), expected).unwrap();
        return;
    }
    assert!(CORPUS == expected, "renew it with LOBELIA_RENEW=1 cargo test -p lobelia-protocol");
}
