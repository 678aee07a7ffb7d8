//! Frames and messages survive the wire, and nothing that isn't one is taken for one.

use lobelia_protocol::frame::{self, MAX_PAYLOAD};
use lobelia_protocol::{
    Answer, Axis, AxisParameters, Command, CrashCause, CrashRecord, Event, Exposure, Fault, FaultReport,
    Faults, Field, FrameDecoder, FrameError, Happening, Hello, HelloReply, HomeDirection, HomingReport,
    LampStatus, LogLine, Outcome, Refusal, Request, Response, Settings, Status, Telemetry, ToController,
    ToHost, Verdict, schema,
};
use proptest::collection::vec;
use proptest::prelude::*;

/// The payloads that a decoder finds in the bytes.
fn payloads(bytes: &[u8]) -> Vec<Result<Vec<u8>, FrameError>> {
    let mut decoder = FrameDecoder::new();
    let mut found = Vec::new();
    for &byte in bytes {
        if let Some(frame) = decoder.push(byte) {
            found.push(frame.map(<[u8]>::to_vec));
        }
    }
    found
}

const SETTINGS: Settings = Settings {
    lamp_warm_up_s: 900,
    lamp_least_reading: 300,
    lease_ms: 2000,
    lamp_lease_ms: 60_000,
    lamp_safe_level: 9000,
    camera_wait_ms: 2000,
    coordinated: true,
};

fn axis_parameters(base: i32) -> AxisParameters {
    AxisParameters {
        min_steps: base - 100_000,
        max_steps: base + 100_000,
        max_speed: 4000,
        acceleration: 8000,
        jerk: 90_000,
        full_turn_steps: 27_907,
        take_up_steps: 40,
        settle_ms: 250,
        home_direction: HomeDirection::Negative,
        home_position: base - 101_000,
        home_speed: 1500,
        home_slow_speed: 100,
        home_back_off: 200,
        home_travel: u32::MAX,
        home_debounce_us: 3000,
        index_tolerance: 4,
    }
}

/// One sample of each command.
fn commands() -> Vec<Command> {
    vec![
        Command::Configure(SETTINGS),
        Command::Home,
        Command::MoveTo([0, -1, i32::MIN, i32::MAX]),
        Command::Stop,
        Command::Lamp { on: true, level: 65535 },
        Command::Expose { duration_us: 500_000, warm_lamp: true },
        Command::Status,
        Command::ClearFaults,
        Command::Retarget([1, -1, i32::MIN, i32::MAX]),
        Command::HomeRepeatedly { approaches: 5 },
        Command::CheckIndex,
        Command::SaveParameters,
        Command::PrepareAxis { axis: Axis::Roll, parameters: axis_parameters(-2) },
        Command::ReadAxis(Axis::Light),
        Command::ReadSettings,
        Command::Watch { telemetry_ms: 100, log: true },
    ]
}

fn status() -> Status {
    Status {
        positions: [i32::MIN; 4],
        known: [true, false, true, false],
        moving: [false, true, false, true],
        at_switch: [true, true, false, false],
        configured: true,
        busy: false,
        waiting: 3,
        lamp: LampStatus { on: true, level: 65535, warm: false, remaining_s: 65535 },
        faults: Fault::ALL.into_iter().collect(),
        emergency_stop: true,
        uptime_us: u64::MAX,
    }
}

/// One sample of each outcome.
fn outcomes() -> Vec<Outcome> {
    let mut all: Vec<_> = [
        Answer::Nothing,
        Answer::At([1, -2, 3, -4]),
        Answer::Exposed(Exposure {
            start_us: u64::MAX,
            open_us: 488,
            reference_q8: 1 << 20,
            readings: 64,
            flicker_ppm: 900,
        }),
        Answer::Status(status()),
        Answer::Homed(HomingReport { positions: [1, 2, 3, 4], spread_steps: [0, 1, 2, 3], approaches: 5 }),
        Answer::Checked([0, 1, -1, 900]),
        Answer::Axis(axis_parameters(i32::MAX - 100_000)),
        Answer::Settings(SETTINGS),
    ]
    .map(Outcome::Done)
    .to_vec();
    all.extend(
        [
            Refusal::NoSession,
            Refusal::Stale,
            Refusal::NotConfigured,
            Refusal::BadParameter { axis: Some(Axis::Roll), field: Field::Duration },
            Refusal::Busy,
            Refusal::PositionUnknown(Axis::Tilt),
            Refusal::OutOfLimits(Axis::Light),
            Refusal::LampNotWarm { remaining_s: Some(12) },
            Refusal::Faulted(Faults::from_iter([Fault::LimitHit, Fault::Hardware])),
            Refusal::EmergencyStopPressed,
            Refusal::Stopped,
            Refusal::CameraNotReady,
            Refusal::ShutterLate { late_us: 12 },
            Refusal::OutOfWindow,
            Refusal::NoStorage,
            Refusal::Skipped { after: 5 },
        ]
        .map(Outcome::Refused),
    );
    all.push(Outcome::Running);
    all
}

fn to_controller() -> Vec<ToController> {
    let requests = commands().into_iter().map(|command| {
        ToController::Request(Request { session: u32::MAX, id: u32::MAX, seen: u32::MAX - 1, command })
    });
    std::iter::once(ToController::Hello(Hello::new(7))).chain(requests).collect()
}

fn to_host() -> Vec<ToHost> {
    let responses = outcomes()
        .into_iter()
        .map(|outcome| ToHost::Response(Response { session: u32::MAX, id: u32::MAX, outcome }));
    let fault = FaultReport { fault: Fault::HomingFailed, axis: Some(Axis::Light), at_us: u64::MAX };
    let crash = CrashRecord { cause: CrashCause::Watchdog, place: 77 };
    let telemetry = Telemetry {
        at_us: u64::MAX,
        positions: [i32::MIN; 4],
        photodiode: Some(4095),
        frames: u32::MAX,
        bad_frames: u32::MAX,
        dropped: u32::MAX,
    };
    let log = [
        Happening::Began { id: 7 },
        Happening::Ended { id: 7, done: true },
        Happening::Lamp { on: true, level: 65535 },
        Happening::FaultsCleared,
        Happening::BadFrames { count: 300 },
        Happening::Dropped { count: 12 },
    ]
    .map(|what| Event::Log(LogLine { at_us: 1_000_000, what }));
    let events = [Event::Fault(fault), Event::Crashed(crash), Event::Telemetry(telemetry)];
    std::iter::once(ToHost::Hello(Hello::new(7).reply()))
        .chain(events.into_iter().chain(log).map(ToHost::Event))
        .chain(responses)
        .collect()
}

#[test]
fn every_message_is_read_as_it_was_written() {
    for message in to_controller() {
        let frame = message.encode().unwrap();
        let found = payloads(&frame);
        assert_eq!(found.len(), 1);
        assert_eq!(ToController::decode(found[0].as_ref().unwrap()), Ok(message));
    }
    for message in to_host() {
        let found = payloads(&message.encode().unwrap());
        assert_eq!(ToHost::decode(found[0].as_ref().unwrap()), Ok(message));
    }
}

#[test]
fn bytes_of_messages_change_only_together_with_the_schema_identity() {
    let mut bytes = String::new();
    for message in to_controller().into_iter().skip(1) {
        bytes.extend(message.encode().unwrap().iter().map(|byte| format!("{byte:02x}")));
    }
    for message in to_host().into_iter().skip(1) {
        bytes.extend(message.encode().unwrap().iter().map(|byte| format!("{byte:02x}")));
    }
    let pinned = (schema::VERSION, schema::IDENTITY, schema::identity(0, &bytes));
    assert_eq!(
        pinned,
        (3, 8_075_454_497_682_040_889, 6_947_572_830_510_960_165),
        "raise schema::VERSION, describe the change in schema::TEXT, then pin"
    );
}

#[test]
fn identity_tells_versions_and_texts_apart() {
    assert_ne!(schema::identity(1, schema::TEXT), schema::identity(2, schema::TEXT));
    assert_ne!(schema::identity(1, "a"), schema::identity(1, "b"));
}

#[test]
fn hello_of_a_later_version_is_understood_and_refused_with_both_versions() {
    let later = Hello { schema: 99, version: 12, session: 5 };
    let mut payload = payloads(&ToController::Hello(later).encode().unwrap()).remove(0).unwrap();
    payload.extend_from_slice(b"what later versions append");
    let Ok(ToController::Hello(read)) = ToController::decode(&payload) else { panic!("not a hello") };
    assert_eq!(read, later);
    let reply = read.reply();
    assert_eq!(reply.verdict, Verdict::DifferentSchema);
    assert_eq!(reply.hello, Hello { schema: schema::IDENTITY, version: schema::VERSION, session: 5 });
}

#[test]
fn reply_of_a_later_version_is_understood() {
    let reply =
        HelloReply { hello: Hello { schema: 1, version: 2, session: 3 }, verdict: Verdict::DifferentSchema };
    let mut payload = payloads(&ToHost::Hello(reply).encode().unwrap()).remove(0).unwrap();
    payload.extend_from_slice(&[9; 20]);
    assert_eq!(ToHost::decode(&payload), Ok(ToHost::Hello(reply)));
}

#[test]
fn too_long_a_payload_is_refused_and_too_long_a_frame_reported() {
    assert!(frame::encode(&[1; MAX_PAYLOAD]).is_some());
    assert!(frame::encode(&[1; MAX_PAYLOAD + 1]).is_none());
    let mut bytes = vec![1; 10_000];
    bytes.push(0);
    bytes.extend_from_slice(&frame::encode(b"next").unwrap());
    assert_eq!(payloads(&bytes), [Err(FrameError::TooLong), Ok(b"next".to_vec())]);
}

#[test]
fn message_with_bytes_left_over_is_refused() {
    let message = ToController::Request(Request { session: 1, id: 2, seen: 1, command: Command::Stop });
    let mut payload = payloads(&message.encode().unwrap()).remove(0).unwrap();
    payload.push(0);
    assert!(ToController::decode(&payload).is_err());
}

proptest! {
    #[test]
    fn any_payload_survives_a_frame(payload in vec(any::<u8>(), 0..=MAX_PAYLOAD)) {
        let frame = frame::encode(&payload).unwrap();
        prop_assert!(frame[1..frame.len() - 1].iter().all(|&byte| byte != 0));
        prop_assert_eq!(payloads(&frame), vec![Ok(payload)]);
    }

    #[test]
    fn any_request_survives(session in any::<u32>(), id in any::<u32>(), steps in any::<[i32; 4]>()) {
        let message = ToController::Request(Request { session, id, seen: !id, command: Command::MoveTo(steps) });
        let payload = payloads(&message.encode().unwrap()).remove(0).unwrap();
        prop_assert_eq!(ToController::decode(&payload), Ok(message));
    }

    #[test]
    fn frame_after_any_rubbish_is_found(rubbish in vec(any::<u8>(), 0..1200), payload in vec(any::<u8>(), 1..50)) {
        let mut bytes = rubbish;
        bytes.extend_from_slice(&frame::encode(&payload).unwrap());
        prop_assert_eq!(payloads(&bytes).pop(), Some(Ok(payload)));
    }

    #[test]
    fn damaged_frame_never_yields_another_payload(
        payload in vec(any::<u8>(), 1..100), at in any::<prop::sample::Index>(), flips in 1..=u32::MAX,
    ) {
        let frame = frame::encode(&payload).unwrap();
        let mut bytes = frame.to_vec();
        let at = at.index(bytes.len());
        for (byte, flip) in bytes[at..].iter_mut().zip(flips.to_le_bytes()) {
            *byte ^= flip;
        }
        bytes.push(0);
        for found in payloads(&bytes).into_iter().flatten() {
            prop_assert_eq!(&found, &payload);
        }
    }

    #[test]
    fn reading_any_bytes_never_panics(bytes in vec(any::<u8>(), 0..500)) {
        let _ = ToController::decode(&bytes);
        let _ = ToHost::decode(&bytes);
        let _ = payloads(&bytes);
    }
}
