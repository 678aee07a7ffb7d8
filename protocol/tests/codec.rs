//! Frames and messages survive the wire, and nothing that isn't one is taken for one.

mod samples;

use lobelia_protocol::frame::{self, MAX_PAYLOAD};
use lobelia_protocol::{
    Alarm, Axis, AxisParameters, Command, DriverParameters, FrameDecoder, FrameError, Hello, HelloReply,
    HomeDirection, Pin, Pins, Request, SafeCommand, SafeState, ToController, ToHost, Verdict, schema,
};
use proptest::collection::vec;
use proptest::prelude::*;
use samples::{to_controller, to_host};

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
        (6, 8_512_431_961_182_849_700, 5_316_365_037_000_475_994),
        "raise schema::VERSION, describe the change in schema::TEXT, then pin"
    );
}

#[test]
fn axis_with_the_greatest_numbers_fits_into_a_frame() {
    let parameters = AxisParameters {
        min_steps: i32::MIN,
        max_steps: i32::MAX,
        max_speed: u32::MAX,
        acceleration: u32::MAX,
        jerk: u32::MAX,
        full_turn_steps: u32::MAX,
        take_up_steps: u32::MAX,
        settle_ms: u16::MAX,
        home_direction: HomeDirection::Positive,
        home_position: i32::MIN,
        home_speed: u32::MAX,
        home_slow_speed: u32::MAX,
        home_back_off: u32::MAX,
        home_switch_steps: u32::MAX,
        home_order: u8::MAX,
        home_travel: u32::MAX,
        home_debounce_us: u16::MAX,
        index_tolerance: u16::MAX,
        driver: Some(DriverParameters {
            run_ma: u16::MAX,
            hold_ma: u16::MAX,
            sense_mohm: u16::MAX,
            microsteps: u16::MAX,
            stall_threshold: u8::MAX,
            stall_above_speed: u32::MAX,
        }),
        inverted: Pins::OF_AXIS,
        alarm: Alarm::Edge,
        alarm_debounce_us: u16::MAX,
        most_turns: u8::MAX,
    };
    let command = Command::PrepareAxis { axis: Axis::Light, parameters };
    let request = Request { session: u32::MAX, id: u32::MAX, seen: u32::MAX, command };
    assert!(ToController::Request(request).encode().is_ok());
}

#[test]
fn pins_are_known_by_whose_they_are() {
    assert!(Pins::OF_AXIS.contains(Pin::Alarm) && !Pins::OF_AXIS.contains(Pin::Lamp));
    assert!(Pins::OF_RIG.contains(Pin::Lamp) && Pins::OF_RIG.contains(Pin::CameraReady));
    let home: Pins = [Pin::Home].into_iter().collect();
    assert!(home.are_among(Pins::OF_AXIS) && !home.are_among(Pins::OF_RIG) && Pins::NONE.are_among(home));
}

#[test]
fn identity_of_parameters_is_that_of_their_own_lines() {
    let begin = schema::TEXT.find("settings lamp").unwrap();
    let end = schema::TEXT.find("response session").unwrap();
    assert_eq!(schema::PARAMETERS, schema::identity(0, &schema::TEXT[begin..end]));
    assert!(
        schema::TEXT[begin..end].contains("\naxis_parameters ")
            && schema::TEXT[begin..end].contains("\npins ")
            && schema::TEXT[begin..end].contains("\nkeep_out ")
            && schema::TEXT[begin..end].contains("\ndriver_parameters ")
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

/// These bytes may never change: hosts and controllers of all versions rely on them.
#[test]
fn frozen_messages_are_these_bytes_for_ever() {
    let asked = [(SafeCommand::Ask, 0), (SafeCommand::Stop, 1), (SafeCommand::Darken, 2)];
    for (command, number) in asked {
        let bytes = [3, b'S', b'A', b'F', b'E', number];
        let written = payloads(&ToController::Safe(command).encode().unwrap()).remove(0).unwrap();
        assert_eq!(written, bytes);
        // What a later version may append changes nothing.
        let longer = [&bytes[..], b"more"].concat();
        assert_eq!(ToController::decode(&longer), Ok(ToController::Safe(command)));
    }
    assert_eq!(
        ToController::Safe(SafeCommand::Stop).encode().unwrap()[..],
        [0, 11, 3, 83, 65, 70, 69, 1, 234, 35, 83, 229, 0]
    );
    let none = SafeState {
        command: SafeCommand::Stop,
        moving: false,
        busy: false,
        lamp: false,
        shutter: false,
        emergency_stop: false,
        fault: false,
        known: false,
        configured: false,
        uptime_s: 0x0403_0201,
        positions: [1, -2, 0x7856_3412, i32::MIN],
    };
    let states = [
        (SafeState { moving: true, ..none }, 1 << 0),
        (SafeState { busy: true, ..none }, 1 << 1),
        (SafeState { lamp: true, ..none }, 1 << 2),
        (SafeState { shutter: true, ..none }, 1 << 3),
        (SafeState { emergency_stop: true, ..none }, 1 << 4),
        (SafeState { fault: true, ..none }, 1 << 5),
        (SafeState { known: true, ..none }, 1 << 6),
        (SafeState { configured: true, ..none }, 1 << 7),
    ];
    for (state, bits) in states {
        #[rustfmt::skip]
        let bytes = [
            3, b'S', b'A', b'F', b'E', 1, bits, 0, 1, 2, 3, 4,
            1, 0, 0, 0, 0xFE, 0xFF, 0xFF, 0xFF, 0x12, 0x34, 0x56, 0x78, 0, 0, 0, 0x80,
        ];
        let written = payloads(&ToHost::Safe(state).encode().unwrap()).remove(0).unwrap();
        assert_eq!(written, bytes);
        assert_eq!(ToHost::decode(&[&bytes[..], b"more"].concat()), Ok(ToHost::Safe(state)));
        assert!(ToHost::decode(&bytes[..27]).is_err());
    }
    let later = [3, b'S', b'A', b'F', b'E', 77];
    assert_eq!(ToController::decode(&later), Ok(ToController::Safe(SafeCommand::Unknown(77))));
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
fn zeros_from_the_middle_of_a_frame_are_no_frame() {
    // Four zeros in COBS: the checksum of nothing.
    assert_eq!(payloads(&[0, 1, 1, 1, 1, 1, 0]), [Err(FrameError::Malformed)]);
    assert!(frame::encode(&[]).is_none());
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
    fn any_payload_survives_a_frame(payload in vec(any::<u8>(), 1..=MAX_PAYLOAD)) {
        let frame = frame::encode(&payload).unwrap();
        prop_assert!(frame[1..frame.len() - 1].iter().all(|&byte| byte != 0));
        prop_assert_eq!(payloads(&frame), vec![Ok(payload)]);
    }

    #[test]
    fn any_request_survives(session in any::<u32>(), id in any::<u32>(), steps in any::<[i32; 4]>()) {
        let message = ToController::Request(Request { session, id, seen: !id,
            command: Command::MoveTo(steps) });
        let payload = payloads(&message.encode().unwrap()).remove(0).unwrap();
        prop_assert_eq!(ToController::decode(&payload), Ok(message));
    }

    #[test]
    fn frame_after_any_rubbish_is_found(rubbish in vec(any::<u8>(), 0..1200),
        payload in vec(any::<u8>(), 1..50)) {
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
