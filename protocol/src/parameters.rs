//! What a controller has to know of its rig. A change here changes what the bytes mean, as in
//! [`crate::message`].

use serde::{Deserialize, Serialize};

use crate::AXES;
use crate::axis::Axis;
use crate::wiring::{Alarm, Pins};

/// How long a lamp may burn at a stretch, s: a week at most, whatever anybody asks for.
pub const LAMP_LONGEST_S: core::ops::RangeInclusive<u32> = 1..=604_800;

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
    /// Steps of a full turn, on an axis that can turn round and round: a move then goes the shorter way, and
    /// the limits hold for the position within the turn. 0 on any other axis.
    pub full_turn_steps: u32,
    /// Length of the approach in the positive direction that ends each move, in steps; more than the
    /// backlash.
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
    /// How far the axis can go with its switch closed, from the edge to the hard stop, in steps. A switch
    /// that stays closed over this and the back-off is stuck, or its wire is broken.
    pub home_switch_steps: u32,
    /// Axes with a lower number are homed before those with a higher one; those with the same together.
    pub home_order: u8,
    /// Homing fails when the switch isn't found within this travel, in steps.
    pub home_travel: u32,
    /// The switch counts as closed or open once it has been so for this long, in µs.
    pub home_debounce_us: u16,
    /// A check of the position passes when the switch's edge is found this near to where it should be, in
    /// steps.
    pub index_tolerance: u16,
    /// How its driver is set up; nothing for one that is set up by its own pins.
    pub driver: Option<DriverParameters>,
    /// Those of its pins whose wiring is inverted against the board's table.
    pub inverted: Pins,
    /// What its alarm input means.
    pub alarm: Alarm,
    /// The alarm input counts once it has been active for this long, in µs; 0 takes the shortest pulse.
    pub alarm_debounce_us: u16,
    /// Whole turns that a full-turn axis may be wound up beyond its limits, either way, counted from where it
    /// was switched on: what its cables bear. A move goes the shorter way that keeps within them.
    pub most_turns: u8,
}

/// How an axis's TMC2209, whose address is the axis's number, is set up over the controller's wire to the
/// drivers.
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
    /// In an exposure that needs the warm lamp, a mean reading of the photodiode below this, for full level,
    /// means that the lamp has failed; counts, 0 to not look.
    pub lamp_least_reading: u16,
    /// Without a request for this long while something is being run, the controller stops smoothly, puts the
    /// lamp to its safe level and raises a fault; ms, 0 for never.
    pub lease_ms: u32,
    /// The same while the lamp burns, ms.
    pub lamp_lease_ms: u32,
    /// The lamp's level when the lease has run out, of 65535; at 0 it is switched off.
    pub lamp_safe_level: u16,
    /// The lamp is put out, with a fault, when it has burnt for this long, whoever asks for it; s,
    /// within [`LAMP_LONGEST_S`].
    pub lamp_longest_s: u32,
    /// How long the lamp's fan, where the board has an output for one, runs on when the lamp has gone out, s.
    pub fan_run_on_s: u16,
    /// How long an exposure waits for the camera to be ready, where the board has an input for that, in ms.
    pub camera_wait_ms: u16,
    /// Whether the axes of a move arrive all at once, each slowed down to the slowest one's time; or else
    /// each as soon as it can.
    pub coordinated: bool,
    /// Shortest time that a step pin stays high, and low between two steps, in µs: the longest that any of
    /// the drivers wants.
    pub pulse_us: u8,
    /// Shortest time from a change of an axis's direction pin to its next step, in µs.
    pub direction_setup_us: u8,
    /// Pins, of those that are no axis's, whose wiring is inverted against the board's table.
    pub inverted: Pins,
}

/// Where two axes must not be together: the first within one interval while the second is within another,
/// both with their ends, in steps.
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
