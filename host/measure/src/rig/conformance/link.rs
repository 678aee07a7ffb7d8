//! Checks of the link: repetition, rubbish, and being in step again.

use std::time::Duration;

use lobelia_protocol::{
    Axis, Command, Event, FrameDecoder, Happening, Outcome, Refusal, Request, ToController,
};

use super::Script;
use super::bench::{Bench, Result, ensure, same};

/// Long enough for a wrong answer to come or a wrong move to begin.
const WHILE: Duration = Duration::from_millis(200);
/// A controller keeps fewer answers than this.
const MANY: usize = 40;

pub(super) const CHECKS: &[(&str, Script)] = &[
    ("a request repeated after its answer is answered alike and not run again", repeated_after),
    ("a request repeated while it's run is run once", repeated_during),
    ("an old request is not run again", old),
    ("what was sent without knowing of a refusal is skipped", skipped),
    ("a request of id 0 is never run", id_zero),
    ("telemetry comes at its period and ends when it is told to", telemetry),
    ("log lines tell of a request's begin and end", log),
    ("a frame with a flipped bit is ignored", flipped),
    ("a frame that is cut short is ignored, and the next one understood", cut),
    ("a message with a byte too many or an unknown command is ignored", malformed),
    ("after rubbish the next frame is understood", rubbish),
];

const EXPOSE: Command = Command::Expose { duration_us: 30_000, warm_lamp: false };

/// Repeats a request and gives what comes new in answer.
fn repeat(bench: &mut Bench, request: &Request) -> Result<Outcome> {
    let before = bench.answers(request).len();
    bench.send(request)?;
    for _ in 0..50 {
        bench.pause(Duration::from_millis(10))?;
        if let Some(outcome) = bench.answers(request).get(before) {
            return Ok(*outcome);
        }
    }
    ensure(false, || "a repetition was not answered".to_owned())?;
    Ok(Outcome::Running)
}

fn repeated_after(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    let request = bench.begin(EXPOSE)?;
    let first = bench.outcome(&request)?;
    ensure(matches!(first, Outcome::Done(_)), || format!("the exposure came to {first:?}"))?;
    for _ in 0..3 {
        let again = repeat(bench, &request)?;
        same("the answer to its repetition", &first, &again)?;
    }
    ensure(!bench.status()?.busy, || "it's busy with the repetition".to_owned())
}

fn repeated_during(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    let request = bench.begin(EXPOSE)?;
    for _ in 0..3 {
        bench.send(&request)?;
    }
    let first = bench.outcome(&request)?;
    bench.pause(2 * WHILE)?;
    let answers = bench.answers(&request);
    let other = answers.iter().find(|outcome| **outcome != Outcome::Running && **outcome != first);
    match other {
        Some(other) => same("a second answer", &first, other),
        None => ensure(matches!(first, Outcome::Done(_)), || format!("the exposure came to {first:?}")),
    }
}

fn old(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    let request = bench.begin(EXPOSE)?;
    let first = bench.outcome(&request)?;
    for _ in 0..MANY {
        bench.status()?;
    }
    let again = repeat(bench, &request)?;
    ensure(again == first || again == Outcome::Refused(Refusal::Stale), || {
        format!("{first:?} or Stale was expected, {again:?} came")
    })
}

fn skipped(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    let mut beyond = bench.part_way(0.5);
    beyond[0] = i32::MAX;
    let refused = bench.begin(Command::MoveTo(beyond))?;
    // Its answer hasn't been looked at.
    let behind = bench.begin(EXPOSE)?;
    same(
        "the first one's outcome",
        &Outcome::Refused(Refusal::OutOfLimits(Axis::Pan)),
        &bench.outcome(&refused)?,
    )?;
    let after = refused.id;
    same("the one behind it", &Outcome::Refused(Refusal::Skipped { after }), &bench.outcome(&behind)?)?;
    // Now it's known.
    bench.done(EXPOSE).map(|_| ())
}

fn id_zero(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    bench.move_to(bench.part_way(0.5))?;
    let request =
        Request { session: bench.session, id: 0, seen: 0, command: Command::MoveTo(bench.part_way(0.25)) };
    same("its outcome", &Outcome::Refused(Refusal::Stale), &repeat(bench, &request)?)?;
    bench.pause(WHILE)?;
    same("positions", &bench.part_way(0.5), &bench.status()?.positions)
}

fn telemetry(bench: &mut Bench) -> Result<()> {
    const PERIOD_US: u64 = 50_000;
    let at_us = |bench: &mut Bench| {
        let at = |event| if let Event::Telemetry(told) = event { Some(told.at_us) } else { None };
        std::mem::take(&mut bench.events).into_iter().filter_map(at).collect::<Vec<_>>()
    };
    bench.settle()?;
    at_us(bench);
    bench.done(Command::Watch { telemetry_ms: (PERIOD_US / 1000) as u16, log: false })?;
    for _ in 0..100 {
        bench.pause(Duration::from_millis(10))?;
    }
    bench.done(Command::Watch { telemetry_ms: 0, log: false })?;
    bench.pause(WHILE)?;
    let told = at_us(bench);
    ensure(told.len() >= 5, || format!("{} events in 1 s, every {PERIOD_US} µs asked for", told.len()))?;
    let close = |pair: &[u64]| pair[1].saturating_sub(pair[0]) >= PERIOD_US * 9 / 10;
    ensure(told.windows(2).all(close), || format!("at {told:?} µs, every {PERIOD_US} µs asked for"))?;
    bench.pause(2 * WHILE)?;
    same("events after the watch", &Vec::new(), &at_us(bench))
}

fn log(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    bench.done(Command::Watch { telemetry_ms: 0, log: true })?;
    bench.events.clear();
    let request = bench.begin(EXPOSE)?;
    bench.outcome(&request)?;
    bench.pause(WHILE)?;
    bench.done(Command::Watch { telemetry_ms: 0, log: false })?;
    let what = |event: &Event| if let Event::Log(line) = event { Some(line.what) } else { None };
    let told: Vec<_> = bench.events.iter().filter_map(what).collect();
    let id = request.id;
    same("the log", &vec![Happening::Began { id }, Happening::Ended { id, done: true }], &told)
}

/// A move that must never be made, as bytes; its id is free again.
fn forbidden(bench: &mut Bench) -> Result<(Request, Vec<u8>)> {
    bench.homed()?;
    bench.move_to(bench.part_way(0.5))?;
    let request = bench.request(Command::MoveTo(bench.part_way(0.25)));
    bench.forget(&request);
    let frame = ToController::Request(request).encode();
    Ok((request, frame.map(|frame| frame.to_vec()).unwrap_or_default()))
}

/// Fails when something was answered or moved.
fn unmoved(bench: &mut Bench, request: &Request) -> Result<()> {
    bench.pause(WHILE)?;
    let answers = bench.answers(request);
    ensure(answers.is_empty(), || format!("it was answered by {answers:?}"))?;
    let status = bench.status()?;
    same("positions", &bench.part_way(0.5), &status.positions)?;
    ensure(!status.busy, || "it became busy".to_owned())
}

fn flipped(bench: &mut Bench) -> Result<()> {
    let (request, frame) = forbidden(bench)?;
    for place in 1..frame.len() - 1 {
        let mut bent = frame.clone();
        bent[place] ^= 1 << (place % 8);
        bench.send_bytes(&bent)?;
    }
    unmoved(bench, &request)
}

fn cut(bench: &mut Bench) -> Result<()> {
    let (request, frame) = forbidden(bench)?;
    // The delimiter before the next frame ends what is left over.
    bench.send_bytes(&frame[..frame.len() / 2])?;
    unmoved(bench, &request)
}

fn malformed(bench: &mut Bench) -> Result<()> {
    let (request, frame) = forbidden(bench)?;
    let longer = [payload(&frame), vec![0]].concat();
    let status = ToController::Request(Request { command: Command::Status, ..request }).encode();
    let mut unknown = status.map(|frame| payload(&frame)).unwrap_or_default();
    if let Some(command) = unknown.last_mut() {
        *command = 0x7f;
    }
    for payload in [&longer, &unknown, &vec![9, 9, 9], &vec![1]] {
        if let Some(frame) = lobelia_protocol::frame::encode(payload) {
            bench.send_bytes(&frame)?;
        }
    }
    unmoved(bench, &request)
}

/// What a frame carries.
fn payload(frame: &[u8]) -> Vec<u8> {
    let mut decoder = FrameDecoder::new();
    let mut payload = Vec::new();
    for byte in frame {
        if let Some(Ok(carried)) = decoder.push(*byte) {
            payload = carried.to_vec();
        }
    }
    payload
}

fn rubbish(bench: &mut Bench) -> Result<()> {
    let (request, _) = forbidden(bench)?;
    let bytes: Vec<u8> = (0..2000_u32).map(|k| (k.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    bench.send_bytes(&bytes)?;
    let long = vec![0x55; 3000];
    bench.send_bytes(&long)?;
    unmoved(bench, &request)
}
