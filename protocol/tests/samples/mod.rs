//! One sample of each message.

use lobelia_protocol::{
    Alarm, Answer, Axis, AxisParameters, Command, CrashCause, CrashRecord, DriverParameters, DriverTrouble,
    Event, Exposure, Fault, FaultReport, Faults, Field, Happening, Health, Hello, HomeDirection,
    HomingReport, KEEP_OUTS, KeepOut, LampStatus, LogLine, Outcome, Pin, Pins, Refusal, Request, Response,
    Settings, Status, Telemetry, ToController, ToHost,
};

const SETTINGS: Settings = Settings {
    lamp_warm_up_s: 900,
    lamp_least_reading: 300,
    lease_ms: 2000,
    lamp_lease_ms: 60_000,
    lamp_safe_level: 9000,
    lamp_longest_s: 172_800,
    fan_run_on_s: 300,
    camera_wait_ms: 2000,
    coordinated: true,
    pulse_us: 3,
    direction_setup_us: 200,
    inverted: Pins::OF_RIG,
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
        home_switch_steps: 1 << 20,
        home_order: 2,
        home_travel: u32::MAX,
        home_debounce_us: 3000,
        index_tolerance: 4,
        driver: (base == 1).then_some(DriverParameters {
            run_ma: 800,
            hold_ma: 300,
            sense_mohm: 110,
            microsteps: 16,
            stall_threshold: 60,
            stall_above_speed: 4000,
        }),
        inverted: [Pin::Direction, Pin::Home].into_iter().filter(|_| base == 1).collect(),
        alarm: if base == 1 { Alarm::Edge } else { Alarm::None },
        alarm_debounce_us: 20,
        most_turns: 200,
    }
}

/// The longest that there can be.
fn keep_outs() -> [Option<KeepOut>; KEEP_OUTS] {
    let far = [i32::MIN, i32::MAX];
    let keep_out = KeepOut { first: Axis::Pan, first_steps: far, second: Axis::Light, second_steps: far };
    [Some(keep_out), None, Some(KeepOut { first: Axis::Tilt, ..keep_out }), Some(keep_out)]
}

const HEALTH: Health = Health {
    worst_late_us: u32::MAX,
    longest_poll_us: u32::MAX,
    stack: Some([u32::MAX; 2]),
    overruns: u32::MAX,
    supply_mv: Some(u16::MAX),
};

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
        Command::PrepareAxis { axis: Axis::Tilt, parameters: axis_parameters(1) },
        Command::ReadAxis(Axis::Light),
        Command::ReadSettings,
        Command::Watch { telemetry_ms: 100, log: true },
        Command::HomeAxes { axes: [true, false, false, true], approaches: 3 },
        Command::ReadHealth,
        Command::PrepareKeepOuts(keep_outs()),
        Command::ReadKeepOuts,
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
        alarms: [false, true, true, false],
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
        Answer::Health(HEALTH),
        Answer::KeepOuts(keep_outs()),
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
            Refusal::Driver { axis: Axis::Tilt, trouble: DriverTrouble::Garbled },
            Refusal::Skipped { after: 5 },
            Refusal::NotAtRest,
            Refusal::KeepOut { first: Axis::Tilt, second: Axis::Light },
        ]
        .map(Outcome::Refused),
    );
    all.push(Outcome::Running);
    all
}

pub(crate) fn to_controller() -> Vec<ToController> {
    let requests = commands().into_iter().map(|command| {
        ToController::Request(Request { session: u32::MAX, id: u32::MAX, seen: u32::MAX - 1, command })
    });
    std::iter::once(ToController::Hello(Hello::new(7))).chain(requests).collect()
}

pub(crate) fn to_host() -> Vec<ToHost> {
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
        health: HEALTH,
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
    let migrated = Event::Migrated { from: u32::MAX };
    let events = [Event::Fault(fault), Event::Crashed(crash), Event::Telemetry(telemetry), migrated];
    std::iter::once(ToHost::Hello(Hello::new(7).reply()))
        .chain(events.into_iter().chain(log).map(ToHost::Event))
        .chain(responses)
        .collect()
}
