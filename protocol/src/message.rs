//! Requests, responses and events. Positions are absolute motor steps, times µs of the controller's clock.
//!
//! A change here changes what the bytes mean: change [`crate::schema`] with it (a test insists).

use serde::{Deserialize, Serialize};

use crate::AXES;
use crate::fault::{FaultReport, Faults};
use crate::wiring::{Alarm, Pins};

/// How long a shutter may be open, µs.
pub const EXPOSURE_US: core::ops::RangeInclusive<u32> = 100..=60_000_000;

/// How long a lamp may burn at a stretch, s: a week at most, whatever anybody asks for.
pub const LAMP_LONGEST_S: core::ops::RangeInclusive<u32> = 1..=604_800;

/// The axes, in the order of every array of four.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Axis {
    /// The sample's pan.
    Pan,
    /// The sample's tilt.
    Tilt,
    /// The sample's roll about its normal.
    Roll,
    /// The light on its rail.
    Light,
}

impl Axis {
    /// The axes in order.
    pub const ALL: [Self; AXES] = [Self::Pan, Self::Tilt, Self::Roll, Self::Light];

    /// The axis's place in arrays of four.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The axis's name in lower case.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pan => "pan",
            Self::Tilt => "tilt",
            Self::Roll => "roll",
            Self::Light => "light",
        }
    }
}

/// Where the home switch is: toward which end of the travel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum HomeDirection {
    /// Toward lower steps.
    Negative,
    /// Toward higher steps.
    Positive,
}

/// How one axis moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct AxisParameters {
    /// Lowest position that a move may ask for, in steps. Take-up may pass it by `take_up_steps`.
    pub min_steps: i32,
    /// Highest position that a move may ask for, in steps.
    pub max_steps: i32,
    /// Highest speed, steps/s.
    pub max_speed: u32,
    /// Acceleration and deceleration, steps/s².
    pub acceleration: u32,
    /// Highest change of acceleration, steps/s³.
    pub jerk: u32,
    /// Steps of a full turn, on an axis that can turn round and round: a move then goes the shorter way, and the limits
    /// hold for the position within the turn. 0 on any other axis.
    pub full_turn_steps: u32,
    /// Length of the approach in the positive direction that ends each move, in steps; more than the backlash.
    pub take_up_steps: u32,
    /// Rest after a move before it counts as done, in ms.
    pub settle_ms: u16,
    /// Where the home switch is.
    pub home_direction: HomeDirection,
    /// The position of the home switch's edge when it is passed in the positive direction, in steps.
    pub home_position: i32,
    /// Speed of the first search for the switch, steps/s.
    pub home_speed: u32,
    /// Speed at which the switch's edge is measured, steps/s.
    pub home_slow_speed: u32,
    /// How far to back off from the switch before the slow search, in steps.
    pub home_back_off: u32,
    /// How far the axis can go with its switch closed, from the edge to the hard stop, in steps. A switch that stays closed over
    /// this and the back-off is stuck, or its wire is broken.
    pub home_switch_steps: u32,
    /// Axes with a lower number are homed before those with a higher one; those with the same together.
    pub home_order: u8,
    /// Homing fails when the switch isn't found within this travel, in steps.
    pub home_travel: u32,
    /// The switch counts as closed or open once it has been so for this long, in µs.
    pub home_debounce_us: u16,
    /// A check of the position passes when the switch's edge is found this near to where it should be, in steps.
    pub index_tolerance: u16,
    /// How its driver is set up; nothing for one that is set up by its own pins.
    pub driver: Option<DriverParameters>,
    /// Those of its pins whose wiring is inverted against the board's table.
    pub inverted: Pins,
    /// What its alarm input means.
    pub alarm: Alarm,
    /// The alarm input counts once it has been active for this long, in µs; 0 takes the shortest pulse.
    pub alarm_debounce_us: u16,
    /// Whole turns that a full-turn axis may be wound up beyond its limits, either way, counted from where it was switched on: what its
    /// cables bear. A move goes the shorter way that keeps within them.
    pub most_turns: u8,
}

/// How an axis's TMC2209, whose address is the axis's number, is set up over the controller's wire to the drivers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DriverParameters {
    /// Current of a phase while the motor turns, mA RMS.
    pub run_ma: u16,
    /// Current of a phase at rest, mA RMS.
    pub hold_ma: u16,
    /// Its sense resistors, mΩ.
    pub sense_mohm: u16,
    /// Microsteps a full step: a power of two up to 256. One of them is a step of the axis.
    pub microsteps: u16,
    /// Below twice this load reserve it reports a stall; 0 never. What is right has to be tried on the rig.
    pub stall_threshold: u8,
    /// Stalls are looked for above this speed only, steps/s.
    pub stall_above_speed: u32,
}

/// Why a driver could not be set up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum DriverTrouble {
    /// The board has no wire to drivers.
    NoWire,
    /// The current is beyond what the driver and its sense resistors can do.
    Current,
    /// The microsteps are none that the driver can make.
    Microsteps,
    /// Bytes could not be sent, or nothing came back in time.
    Silent,
    /// What came back is no datagram, or its checksum is wrong.
    Garbled,
    /// The driver counted other writes than were made: one was lost.
    WriteLost,
}

/// What the controller has to know of the rig besides its axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// How long the lamp has to burn until it is warm, in s.
    pub lamp_warm_up_s: u16,
    /// In an exposure that needs the warm lamp, a mean reading of the photodiode below this, for full level, means that the lamp
    /// has failed; counts, 0 to not look.
    pub lamp_least_reading: u16,
    /// Without a request for this long while something is being run, the controller stops smoothly, puts the lamp to its safe
    /// level and raises a fault; ms, 0 for never.
    pub lease_ms: u32,
    /// The same while the lamp burns, ms.
    pub lamp_lease_ms: u32,
    /// The lamp's level when the lease has run out, of 65535; at 0 it is switched off.
    pub lamp_safe_level: u16,
    /// The lamp is put out, with a fault, when it has burnt for this long, whoever asks for it; s, at least 1.
    pub lamp_longest_s: u32,
    /// How long the lamp's fan, where the board has an output for one, runs on when the lamp has gone out, s.
    pub fan_run_on_s: u16,
    /// How long an exposure waits for the camera to be ready, where the board has an input for that, in ms.
    pub camera_wait_ms: u16,
    /// Whether the axes of a move arrive all at once, each slowed down to the slowest one's time; or else each as soon as it
    /// can.
    pub coordinated: bool,
    /// Shortest time that a step pin stays high, and low between two steps, in µs: the longest that any of the drivers wants.
    pub pulse_us: u8,
    /// Shortest time from a change of an axis's direction pin to its next step, in µs.
    pub direction_setup_us: u8,
    /// Pins, of those that are no axis's, whose wiring is inverted against the board's table.
    pub inverted: Pins,
}

/// Where two axes must not be together: the first within one interval while the second is within another, both with their ends, in steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeepOut {
    /// One axis.
    pub first: Axis,
    /// Its interval.
    pub first_steps: [i32; 2],
    /// Another axis.
    pub second: Axis,
    /// Its interval.
    pub second_steps: [i32; 2],
}

/// Most keep-outs of a rig.
pub const KEEP_OUTS: usize = 4;

/// All that the controller has to know of the rig. It is sent in parts, so that every frame is short.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Configuration {
    /// The axes: pan, tilt, roll, light.
    pub axes: [AxisParameters; AXES],
    /// The rest.
    pub settings: Settings,
    /// Where axes must not be together.
    pub keep_outs: [Option<KeepOut>; KEEP_OUTS],
}

impl Configuration {
    /// The commands that set it, in order.
    pub fn commands(&self) -> [Command; AXES + 2] {
        core::array::from_fn(|k| match Axis::ALL.get(k) {
            Some(&axis) => Command::PrepareAxis { axis, parameters: self.axes[k] },
            None if k == AXES => Command::PrepareKeepOuts(self.keep_outs),
            None => Command::Configure(self.settings),
        })
    }
}

/// What the host asks for.
///
/// Requests are run one after the other, in the order of their ids: one that comes while another is being run waits for its
/// turn, together with at most three more, and is answered as running meanwhile. A request that was sent before the host had
/// seen that one before it was refused is skipped: it was meant for what did not come to be. [`Self::Status`], [`Self::Stop`], [`Self::Lamp`],
/// [`Self::ClearFaults`], [`Self::Retarget`], [`Self::ReadAxis`], [`Self::ReadSettings`], [`Self::ReadKeepOuts`], [`Self::ReadHealth`] and
/// [`Self::Watch`] don't wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Command {
    /// Sets the rig's parameters: these, and of each axis those that were prepared in this session, or else those that it has.
    /// Positions become unknown if anything differs from what was set.
    Configure(Settings),
    /// Finds the home switches of all axes at once. Answered when done.
    Home,
    /// Moves all axes to absolute positions, in steps. Answered when all are there and settled.
    MoveTo([i32; AXES]),
    /// Decelerates all axes to rest and closes the shutter. Positions stay known. What waits is refused as stopped.
    Stop,
    /// Switches the lamp. It is only switched on once parameters are set: without them nothing would put it out again.
    Lamp {
        /// Burning or not.
        on: bool,
        /// Level, of 65535.
        level: u16,
    },
    /// Fires the shutter, after a rest of 1 ms. Answered when it has closed.
    Expose {
        /// Open time, µs, within [`EXPOSURE_US`].
        duration_us: u32,
        /// Refuse unless the lamp is warm; false for dark frames.
        warm_lamp: bool,
    },
    /// Asks how things stand.
    Status,
    /// Forgets the faults; positions stay unknown until the next homing.
    ClearFaults,
    /// Like [`Self::MoveTo`], but also while a move is being run, which is then answered as stopped, as is what waits: axes whose
    /// new target lies ahead go on to it, the others brake and turn.
    Retarget([i32; AXES]),
    /// Homes like [`Self::Home`], but approaches each switch slowly so many times, 1 to 100, and reports how the edges scatter.
    HomeRepeatedly {
        /// How many times.
        approaches: u8,
    },
    /// Looks for the home switches as homing does, but keeps the positions, and reports how many steps were lost since. More
    /// than the tolerance is a fault.
    CheckIndex,
    /// Stores the configuration, to be there after the next power-up. Refused while the lamp burns: writing holds the controller
    /// up for as long as a second.
    SaveParameters,
    /// Keeps an axis's parameters for the next [`Self::Configure`] of this session, if they are in range; changes nothing else.
    PrepareAxis {
        /// Which axis.
        axis: Axis,
        /// Its parameters.
        parameters: AxisParameters,
    },
    /// Asks for the parameters that are set of an axis.
    ReadAxis(Axis),
    /// Asks for the settings that are set.
    ReadSettings,
    /// From now on to the session's end, or the next of these, tells how things go as events.
    Watch {
        /// Between two events of telemetry, in ms, 20 at least; 0 for none.
        telemetry_ms: u16,
        /// Whether to tell what happens as log lines.
        log: bool,
    },
    /// Homes like [`Self::HomeRepeatedly`], but only some axes; the others stay where they are and keep their positions.
    HomeAxes {
        /// Which axes.
        axes: [bool; AXES],
        /// How often each switch is approached slowly.
        approaches: u8,
    },
    /// Asks how well the controller keeps up.
    ReadHealth,
    /// Keeps the keep-outs for the next [`Self::Configure`] of this session, which judges them; changes nothing else.
    PrepareKeepOuts([Option<KeepOut>; KEEP_OUTS]),
    /// Asks for the keep-outs that are set.
    ReadKeepOuts,
}

impl Command {
    /// Whether it does more than to ask or to watch.
    pub const fn acts(&self) -> bool {
        !matches!(
            self,
            Self::Status
                | Self::ReadAxis(_)
                | Self::ReadSettings
                | Self::Watch { .. }
                | Self::ReadHealth
                | Self::ReadKeepOuts
        )
    }

    /// Whether it waits for its turn while another is being run.
    pub const fn waits(&self) -> bool {
        self.acts() && !matches!(self, Self::Stop | Self::Lamp { .. } | Self::ClearFaults | Self::Retarget(_))
    }
}

/// A command with the id by which a repetition is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Request {
    /// The session opened by the hello.
    pub session: u32,
    /// 1 for the session's first request, then one more for each; a repetition bears the same.
    pub id: u32,
    /// The answers to all requests up to this id have come to the host; less than `id`, and at least `id` − 8.
    pub seen: u32,
    /// What to do.
    pub command: Command,
}

/// What came of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Response {
    /// The request's session.
    pub session: u32,
    /// The request's id.
    pub id: u32,
    /// What came of it.
    pub outcome: Outcome,
}

/// What came of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Outcome {
    /// Done.
    Done(Answer),
    /// Not done, or given up.
    Refused(Refusal),
    /// It is being run, or waits for its turn or until those before it have come: its answer comes later.
    Running,
}

/// A result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Answer {
    /// Nothing to tell.
    Nothing,
    /// Positions after homing or a move, in steps.
    At([i32; AXES]),
    /// What an exposure was.
    Exposed(Exposure),
    /// How things stand.
    Status(Status),
    /// After repeated homing.
    Homed(HomingReport),
    /// Of each axis: by how many steps the position counted was above the true one.
    Checked([i32; AXES]),
    /// An axis's parameters.
    Axis(AxisParameters),
    /// The settings.
    Settings(Settings),
    /// How well the controller keeps up.
    Health(Health),
    /// The keep-outs.
    KeepOuts([Option<KeepOut>; KEEP_OUTS]),
}

/// What repeated homing found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct HomingReport {
    /// Positions after homing, in steps.
    pub positions: [i32; AXES],
    /// Between the lowest and the highest position of the switch's edge over all approaches, in steps.
    pub spread_steps: [u32; AXES],
    /// How many approaches.
    pub approaches: u8,
}

/// An exposure as it happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Exposure {
    /// When the shutter opened, in the controller's time in µs.
    pub start_us: u64,
    /// How long it was open, µs.
    pub open_us: u32,
    /// Mean of the lamp's photodiode over the open time, in 1/256 of an ADC count.
    pub reference_q8: u32,
    /// Number of photodiode readings in that mean.
    pub readings: u32,
    /// How much the lamp flickered: standard deviation of the readings over their mean, in millionths.
    pub flicker_ppm: u32,
}

/// Why a request isn't done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// No hello opened this session: the controller was reset, or another host took over.
    NoSession,
    /// An older request, whose answer is no longer kept. It isn't run again.
    Stale,
    /// No configuration yet.
    NotConfigured,
    /// A parameter is out of its range.
    BadParameter {
        /// Of which axis, unless it is of none.
        axis: Option<Axis>,
        /// Which.
        field: Field,
    },
    /// What is being run is no move, so it can't be given another target.
    Busy,
    /// An axis hasn't been homed.
    PositionUnknown(Axis),
    /// A move beyond the limits; or a homing of an axis whose cables were wound up farther than they bear, by homings that found nothing.
    OutOfLimits(Axis),
    /// The lamp is off or not yet warm.
    LampNotWarm {
        /// How long it takes still, in s; `None` when it is off.
        remaining_s: Option<u16>,
    },
    /// A fault stopped it, or one is waiting to be cleared.
    Faulted(Faults),
    /// The emergency stop is still pressed.
    EmergencyStopPressed,
    /// Given up, or not begun, because of a stop.
    Stopped,
    /// The camera wasn't ready in time.
    CameraNotReady,
    /// The shutter closed so much later than asked for: the exposure has to be repeated.
    ShutterLate {
        /// By how much, µs.
        late_us: u32,
    },
    /// Too many requests are in flight: the id is too far ahead of the last one, or too many wait for their turn. Nothing came of
    /// it, not even a mark on its id: it may be sent again.
    OutOfWindow,
    /// The controller has no memory for parameters, or it can't be written.
    NoStorage,
    /// An axis's driver could not be set up.
    Driver {
        /// Whose.
        axis: Axis,
        /// Why.
        trouble: DriverTrouble,
    },
    /// Not begun, because a request before it was refused and the host did not know that yet.
    Skipped {
        /// The one refused.
        after: u32,
    },
    /// Parameters can only be saved at rest and with the lamp off.
    NotAtRest,
    /// These two axes would come where they must not be together: at the target, on the way, or while one of them is homed.
    KeepOut {
        /// One.
        first: Axis,
        /// The other.
        second: Axis,
    },
}

/// A parameter that can be out of range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Field {
    /// `min_steps` or `max_steps`.
    Limits,
    /// `max_speed`.
    MaxSpeed,
    /// `acceleration`: too high, or so low that reaching the highest speed takes over 1000 s.
    Acceleration,
    /// `take_up_steps`.
    TakeUp,
    /// `home_position`: not beyond the limits (and the take-up) on its side.
    HomePosition,
    /// `home_speed` or `home_slow_speed`.
    HomeSpeed,
    /// `home_back_off`, `home_switch_steps` or `home_travel`.
    HomeTravel,
    /// An exposure's `duration_us`.
    Duration,
    /// `jerk`.
    Jerk,
    /// `full_turn_steps`: less than the limits span, or not above twice the take-up.
    FullTurn,
    /// `approaches` of repeated homing.
    Approaches,
    /// A watch's `telemetry_ms`.
    TelemetryPeriod,
    /// `pulse_us`, or an axis's `max_speed` for which its pulses are too long.
    Pulse,
    /// The sum of all axes' `max_speed`: more steps than the board can make in time.
    StepRate,
    /// `axes` of a homing: none.
    Axes,
    /// `lamp_longest_s`: beyond [`LAMP_LONGEST_S`].
    LampTime,
    /// An axis's `alarm`: the board has no input for it.
    Alarm,
    /// `inverted`: pins that are not an axis's among an axis's, or the other way round.
    Wiring,
    /// `keep_outs`: of one axis twice, with an interval whose ends are in the wrong order, or where the axis that is homed first would
    /// stand in the other's way.
    KeepOut,
}

/// How things stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// Positions in steps; they mean nothing where `known` is false.
    pub positions: [i32; AXES],
    /// Whether the axis was homed and nothing has happened to it since.
    pub known: [bool; AXES],
    /// Whether the axis is moving.
    pub moving: [bool; AXES],
    /// Whether the axis's home switch is closed.
    pub at_switch: [bool; AXES],
    /// Whether a configuration was set.
    pub configured: bool,
    /// Whether a request is being run.
    pub busy: bool,
    /// How many requests wait for their turn.
    pub waiting: u8,
    /// The lamp.
    pub lamp: LampStatus,
    /// Faults not yet cleared.
    pub faults: Faults,
    /// Whether the emergency stop is pressed now.
    pub emergency_stop: bool,
    /// The controller's time, µs since it started.
    pub uptime_us: u64,
    /// Whether the axis's alarm input is active, where its parameters have one.
    pub alarms: [bool; AXES],
}

/// The lamp's state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LampStatus {
    /// Burning or not.
    pub on: bool,
    /// Level, of 65535.
    pub level: u16,
    /// Whether it has burnt as long as it needs to.
    pub warm: bool,
    /// How long it takes still, in s; 0 when warm or off.
    pub remaining_s: u16,
}

/// Why a controller crashed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum CrashCause {
    /// The program found itself in an impossible state.
    Panic,
    /// The stack grew over its end.
    StackOverflow,
    /// The processor met something that it can't run.
    HardFault,
    /// The watchdog wasn't fed.
    Watchdog,
}

/// What a crash left behind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct CrashRecord {
    /// Why.
    pub cause: CrashCause,
    /// Where: a source line for a panic, else an address, as the cause has it; 0 when unknown.
    pub place: u32,
}

/// How things go, told at a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Telemetry {
    /// When, in the controller's time in µs.
    pub at_us: u64,
    /// Positions in steps.
    pub positions: [i32; AXES],
    /// The photodiode's reading in counts; not while the shutter is open.
    pub photodiode: Option<u16>,
    /// Frames received whole since the start.
    pub frames: u32,
    /// Frames received damaged since the start, which were passed over.
    pub bad_frames: u32,
    /// Events that were left out since the start, because too many waited.
    pub dropped: u32,
    /// How well the controller keeps up.
    pub health: Health,
}

/// How well the controller keeps up: the worst since it started.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Health {
    /// How late the latest step was, but for the first of each run, µs.
    pub worst_late_us: u32,
    /// How long the longest turn of the main loop took while axes moved, µs; 0 where the board does not tell.
    pub longest_poll_us: u32,
    /// Bytes of the stack that were ever used, and that there are, where the board can tell.
    pub stack: Option<[u32; 2]>,
    /// Bytes received that were lost because nobody took them in time, each a damaged frame.
    pub overruns: u32,
    /// The processor's supply, mV, where the board can measure it.
    pub supply_mv: Option<u16>,
}

/// Something that happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Happening {
    /// A request was begun.
    Began {
        /// Which.
        id: u32,
    },
    /// What a request began has ended, or it was refused.
    Ended {
        /// Which.
        id: u32,
        /// Whether as asked for.
        done: bool,
    },
    /// The lamp was switched.
    Lamp {
        /// Burning or not.
        on: bool,
        /// Level, of 65535.
        level: u16,
    },
    /// The faults were cleared.
    FaultsCleared,
    /// Damaged frames were passed over.
    BadFrames {
        /// How many since the start.
        count: u32,
    },
    /// Log lines were left out here, because too many waited.
    Dropped {
        /// How many.
        count: u32,
    },
}

/// A line of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogLine {
    /// When, in the controller's time in µs.
    pub at_us: u64,
    /// What.
    pub what: Happening,
}

/// What the controller tells unasked. An event is sent only while no answer waits, and not before the last one has left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Event {
    /// A fault was raised.
    Fault(FaultReport),
    /// The controller crashed before it was started last. Told once, after a hello.
    Crashed(CrashRecord),
    /// How things go, if the host watches. One that is overtaken by the next before it could be sent is left out.
    Telemetry(Telemetry),
    /// What happened, if the host watches.
    Log(LogLine),
    /// The parameters that the controller started with were saved by an older program: those that it did not know have their defaults.
    /// Told once, after a hello.
    Migrated {
        /// Low half of the identity of what they were saved as.
        from: u32,
    },
}
