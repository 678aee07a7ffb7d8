//! Requests and responses. Positions are absolute motor steps, times µs of the controller's clock.
//!
//! A change here changes what the bytes mean: change [`crate::schema`] with it (a test insists).

use serde::{Deserialize, Serialize};

use crate::AXES;
use crate::axis::Axis;
use crate::event::Health;
use crate::fault::Faults;
use crate::parameters::{AxisParameters, Configuration, DriverTrouble, KEEP_OUTS, KeepOut, Settings};

/// How long a shutter may be open, µs.
pub const EXPOSURE_US: core::ops::RangeInclusive<u32> = 100..=60_000_000;

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
/// Requests are run one after the other, in the order of their ids: one that comes while another is being run
/// waits for its turn, together with at most three more, and is answered as running meanwhile. A request that
/// was sent before the host had seen that one before it was refused is skipped: it was meant for what did not
/// come to be. [`Self::Status`], [`Self::Stop`], [`Self::Lamp`], [`Self::ClearFaults`], [`Self::Retarget`],
/// [`Self::ReadAxis`], [`Self::ReadSettings`], [`Self::ReadKeepOuts`], [`Self::ReadHealth`] and
/// [`Self::Watch`] don't wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Command {
    /// Sets the rig's parameters: these, and of each axis those that were prepared in this session, or else
    /// those that it has. Positions become unknown if anything differs from what was set.
    Configure(Settings),
    /// Finds the home switches of all axes at once. Answered when done.
    Home,
    /// Moves all axes to absolute positions, in steps. Answered when all are there and settled.
    MoveTo([i32; AXES]),
    /// Decelerates all axes to rest and closes the shutter. Positions stay known. What waits is refused as
    /// stopped.
    Stop,
    /// Switches the lamp. It is only switched on once parameters are set: without them nothing would put it
    /// out again.
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
    /// Like [`Self::MoveTo`], but also while a move is being run, which is then answered as stopped, as is
    /// what waits: axes whose new target lies ahead go on to it, the others brake and turn.
    Retarget([i32; AXES]),
    /// Homes like [`Self::Home`], but approaches each switch slowly so many times, 1 to 100, and reports how
    /// the edges scatter.
    HomeRepeatedly {
        /// How many times.
        approaches: u8,
    },
    /// Looks for the home switches as homing does, but keeps the positions, and reports how many steps were
    /// lost since. More than the tolerance is a fault.
    CheckIndex,
    /// Stores the configuration, to be there after the next power-up. Refused while the lamp burns: writing
    /// holds the controller up for as long as a second.
    SaveParameters,
    /// Keeps an axis's parameters for the next [`Self::Configure`] of this session, if they are in range;
    /// changes nothing else.
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
    /// Homes like [`Self::HomeRepeatedly`], but only some axes; the others stay where they are and keep their
    /// positions.
    HomeAxes {
        /// Which axes.
        axes: [bool; AXES],
        /// How often each switch is approached slowly.
        approaches: u8,
    },
    /// Asks how well the controller keeps up.
    ReadHealth,
    /// Keeps the keep-outs for the next [`Self::Configure`] of this session, which judges them; changes
    /// nothing else.
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
    /// The answers to all requests up to this id have come to the host; less than `id`, and at least `id`
    /// − 8.
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
    /// A move beyond the limits; or a homing of an axis whose cables were wound up farther than they bear, by
    /// homings that found nothing.
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
    /// Too many requests are in flight: the id is too far ahead of the last one, or too many wait for their
    /// turn. Nothing came of it, not even a mark on its id: it may be sent again.
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
    /// These two axes would come where they must not be together: at the target, on the way, or while one of
    /// them is homed.
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
    /// `lamp_longest_s`: beyond [`LAMP_LONGEST_S`](crate::LAMP_LONGEST_S).
    LampTime,
    /// An axis's `alarm`: the board has no input for it.
    Alarm,
    /// `inverted`: pins that are not an axis's among an axis's, or the other way round.
    Wiring,
    /// `keep_outs`: of one axis twice, with an interval whose ends are in the wrong order, or where the axis
    /// that is homed first would stand in the other's way.
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
