//! How parameters were written before, so that saved ones outlive an update that adds some.
//!
//! A change of the parameters only ever appends fields to their structures, or structures to the
//! configuration. So what was written before is the beginning of what is written now, part by part, and the
//! rest is that of the defaults. Whoever changes the layout adds the one that was to [`OLDER`], and what is
//! new to [`axis_defaults`] or [`settings_defaults`]; a test insists.

use lobelia_protocol::{
    Alarm, AxisParameters, Configuration, DriverParameters, HomeDirection, KEEP_OUTS, Pins, Settings, packet,
};

/// Room for one written part.
const PART: usize = 128;

/// A field as postcard writes it.
#[derive(Debug, Clone, Copy)]
enum Field {
    /// A number of variable length, or what is one byte below 128: a flag, the number of a variant.
    Number,
    /// A byte.
    Byte,
    /// A byte that tells whether a driver follows, whose fields [`DRIVER`] are.
    Driver,
}

/// How the parts of a configuration were written.
pub(super) struct Layout {
    /// Low half of its identity.
    pub(super) identity: u32,
    axis: &'static [Field],
    settings: &'static [Field],
}

use Field::{Byte, Driver, Number};

/// Of a driver's fields, whether each is a byte; else it is a number.
const DRIVER: [bool; 6] = [false, false, false, false, true, false];

/// Layouts of earlier programs. None of these may ever change.
pub(super) const OLDER: [Layout; 2] = [
    // Schema version 4: without wiring, turns and keep-outs.
    Layout {
        identity: 0x4f24_018b,
        axis: &[
            Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number,
            Number, Number, Byte, Number, Number, Number, Driver,
        ],
        settings: &[Number, Number, Number, Number, Number, Number, Number, Number, Number, Byte, Byte],
    },
    // Schema version 5: with wiring, without turns and keep-outs.
    Layout {
        identity: 0xecad_2e74,
        axis: &[
            Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number,
            Number, Number, Byte, Number, Number, Number, Driver, Number, Number, Number,
        ],
        settings: &[
            Number, Number, Number, Number, Number, Number, Number, Number, Number, Byte, Byte, Number,
        ],
    },
];

/// Defaults of what some older program did not know; the rest is there for the fields' order.
fn axis_defaults() -> AxisParameters {
    AxisParameters {
        min_steps: 0,
        max_steps: 0,
        max_speed: 0,
        acceleration: 0,
        jerk: 0,
        full_turn_steps: 0,
        take_up_steps: 0,
        settle_ms: 0,
        home_direction: HomeDirection::Negative,
        home_position: 0,
        home_speed: 0,
        home_slow_speed: 0,
        home_back_off: 0,
        home_switch_steps: 0,
        home_order: 0,
        home_travel: 0,
        home_debounce_us: 0,
        index_tolerance: 0,
        driver: None::<DriverParameters>,
        inverted: Pins::NONE,
        alarm: Alarm::None,
        alarm_debounce_us: 50,
        most_turns: 1,
    }
}

/// The same of the settings.
fn settings_defaults() -> Settings {
    Settings {
        lamp_warm_up_s: 0,
        lamp_least_reading: 0,
        lease_ms: 0,
        lamp_lease_ms: 0,
        lamp_safe_level: 0,
        lamp_longest_s: 0,
        fan_run_on_s: 0,
        camera_wait_ms: 0,
        coordinated: false,
        pulse_us: 0,
        direction_setup_us: 0,
        inverted: Pins::NONE,
    }
}

/// How many bytes some fields take at the beginning of others.
fn length(bytes: &[u8], fields: &[Field]) -> Option<usize> {
    let number = |at: usize| Some(at + 1 + bytes.get(at..)?.iter().position(|byte| byte & 0x80 == 0)?);
    fields.iter().try_fold(0, |at, field| {
        Some(match field {
            Number => number(at)?,
            Byte => at + 1,
            Driver if *bytes.get(at)? == 0 => at + 1,
            Driver => {
                DRIVER.iter().try_fold(at + 1, |at, &byte| if byte { Some(at + 1) } else { number(at) })?
            }
        })
    })
}

/// Takes an old part, of the fields given, from the beginning of `bytes`: gives it with the end of the
/// `defaults` behind it, and its length.
fn completed(
    bytes: &[u8],
    fields: &[Field],
    defaults: &[u8],
    whole: &mut [u8; PART],
) -> Option<(usize, usize)> {
    let old = length(bytes, fields)?;
    let new = defaults.get(length(defaults, fields)?..)?;
    whole.get_mut(..old)?.copy_from_slice(bytes.get(..old)?);
    whole.get_mut(old..old + new.len())?.copy_from_slice(new);
    Some((old, old + new.len()))
}

/// Reads a configuration that was written in an older layout. Not inlined: its parts would take stack where
/// others are read too.
#[inline(never)]
pub(super) fn read(layout: &Layout, bytes: &[u8]) -> Option<Configuration> {
    let (mut defaults, mut whole) = ([0; PART], [0; PART]);
    let mut rest = bytes;
    let count = packet::write_part(&axis_defaults(), &mut defaults)?;
    let mut axis = || {
        let (old, end) = completed(rest, layout.axis, &defaults[..count], &mut whole)?;
        rest = rest.get(old..)?;
        packet::read_part::<AxisParameters>(whole.get(..end)?)
    };
    let axes = [axis()?, axis()?, axis()?, axis()?];
    let count = packet::write_part(&settings_defaults(), &mut defaults)?;
    let (old, end) = completed(rest, layout.settings, &defaults[..count], &mut whole)?;
    let settings = packet::read_part(whole.get(..end)?)?;
    (old == rest.len()).then_some(Configuration { axes, settings, keep_outs: [None; KEEP_OUTS] })
}

#[cfg(test)]
mod tests {
    use lobelia_protocol::schema;

    /// Saved parameters would be lost by an update.
    #[test]
    fn layout_changes_only_with_the_old_one_among_the_older() {
        assert_eq!(
            schema::PARAMETERS as u32,
            2_361_397_067,
            "add the layout with the identity that stands here to OLDER, its new fields to the defaults, \
             then pin"
        );
        assert!(super::OLDER.iter().all(|layout| layout.identity != schema::PARAMETERS as u32));
    }
}
