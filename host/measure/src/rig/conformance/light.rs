//! Checks of lamp and shutter.

use std::time::Duration;

use lobelia_protocol::{Answer, Command, EXPOSURE_US, Exposure, Field, Outcome, Refusal};

use super::Script;
use super::bench::{Bench, Result, Trouble, ensure, same};

/// How long the shutter of the checks is open, µs.
const OPEN_US: [u32; 3] = [1_000, 20_000, 250_000];
/// The shutter may be open longer or shorter by this, µs.
const TOLERANCE_US: u32 = 10;
/// The lease in the check of a long exposure.
const LEASE_MS: u32 = 1000;

pub(super) const CHECKS: &[(&str, Script)] = &[
    ("a dark exposure lasts as long as it was asked to, within 10 µs", dark),
    ("exposures follow each other on the controller's clock", in_order),
    ("exposures too short or too long are refused", out_of_range),
    ("an exposure longer than the lease goes on in silence", quiet),
    ("an exposure with the lamp off is refused", lamp_off),
    (STRIKES[0], lamp_cold),
    (STRIKES[1], lamp_level),
    (STRIKES[2], lamp_save),
];

/// The checks that switch the lamp on.
pub(super) const STRIKES: [&str; 3] = [
    "an exposure with a cold lamp is refused with the time that it needs",
    "the lamp's level and its being off are told by the status",
    "parameters are not saved while the lamp burns",
];

fn expose(bench: &mut Bench, duration_us: u32) -> Result<Exposure> {
    match bench.done(Command::Expose { duration_us, warm_lamp: false })? {
        Answer::Exposed(exposure) => Ok(exposure),
        other => Err(Trouble::Wrong(format!("an exposure was answered by {other:?}"))),
    }
}

fn lamp(bench: &mut Bench, on: bool, level: u16) -> Result<()> {
    same("the lamp's answer", &Answer::Nothing, &bench.done(Command::Lamp { on, level })?)
}

fn lamp_save(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    lamp(bench, true, 1)?;
    let refused = bench.refused(Command::SaveParameters, Refusal::NotAtRest);
    lamp(bench, false, 0)?;
    refused
}

fn dark(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    lamp(bench, false, 0)?;
    for duration_us in OPEN_US {
        let before_us = bench.status()?.uptime_us;
        let exposure = expose(bench, duration_us)?;
        let after_us = bench.status()?.uptime_us;
        ensure(exposure.open_us.abs_diff(duration_us) <= TOLERANCE_US, || {
            format!("{duration_us} µs were asked for, the shutter was open for {} µs", exposure.open_us)
        })?;
        let end_us = exposure.start_us + u64::from(exposure.open_us);
        ensure((before_us..=after_us).contains(&exposure.start_us) && end_us <= after_us, || {
            format!(
                "it is said to be from {} to {end_us} µs, but was asked for at {before_us} and answered \
                 before {after_us}",
                exposure.start_us
            )
        })?;
        ensure(exposure.readings > 0, || "the photodiode was not read".to_owned())?;
    }
    Ok(())
}

fn in_order(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    let mut end_us = 0;
    for _ in 0..5 {
        let exposure = expose(bench, OPEN_US[0])?;
        ensure(exposure.start_us + u64::from(TOLERANCE_US) >= end_us, || {
            format!("one began at {} µs, before the last had ended at {end_us} µs", exposure.start_us)
        })?;
        end_us = exposure.start_us + u64::from(exposure.open_us);
    }
    Ok(())
}

/// A host is quiet while the shutter is open, so as to disturb nothing.
fn quiet(bench: &mut Bench) -> Result<()> {
    bench.settle()?;
    let mut short = bench.configuration;
    short.settings.lease_ms = LEASE_MS;
    bench.configure(&short)?;
    bench.done(Command::Home)?;
    let duration_us = 3000 * LEASE_MS;
    let request = bench.begin(Command::Expose { duration_us, warm_lamp: false })?;
    bench.pause(Duration::from_millis((3 * LEASE_MS + LEASE_MS / 2).into()))?;
    let outcome = bench.outcome(&request)?;
    let done = matches!(outcome, Outcome::Done(Answer::Exposed(_)));
    ensure(done, || format!("3 leases of {LEASE_MS} ms in silence came to {outcome:?}"))?;
    bench.settle().map(|_| ())
}

fn out_of_range(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    for duration_us in [0, EXPOSURE_US.start() - 1, EXPOSURE_US.end() + 1, u32::MAX] {
        let why = Refusal::BadParameter { axis: None, field: Field::Duration };
        bench.refused(Command::Expose { duration_us, warm_lamp: false }, why)?;
    }
    Ok(())
}

fn lamp_off(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    lamp(bench, false, 0)?;
    let expose = Command::Expose { duration_us: OPEN_US[0], warm_lamp: true };
    bench.refused(expose, Refusal::LampNotWarm { remaining_s: None })
}

fn lamp_cold(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    lamp(bench, false, 0)?;
    lamp(bench, true, u16::MAX)?;
    let warm_up_s = bench.configuration.settings.lamp_warm_up_s;
    let expose = bench.ask(Command::Expose { duration_us: OPEN_US[0], warm_lamp: true });
    let status = bench.status()?.lamp;
    lamp(bench, false, 0)?;
    let expose = expose?;
    if warm_up_s == 0 {
        return ensure(status.warm, || "the lamp needs no time and isn't warm".to_owned());
    }
    let waiting = |s: u16| (1..=warm_up_s).contains(&s);
    let cold = matches!(
        expose,
        Outcome::Refused(Refusal::LampNotWarm { remaining_s: Some(s) }) if waiting(s)
    );
    ensure(cold, || format!("just switched on, with {warm_up_s} s to warm up, it came to {expose:?}"))?;
    ensure(status.on && !status.warm && waiting(status.remaining_s), || {
        format!("the status tells {status:?}")
    })
}

fn lamp_level(bench: &mut Bench) -> Result<()> {
    bench.homed()?;
    lamp(bench, true, 0x8000)?;
    let on = bench.status()?.lamp;
    lamp(bench, false, 0)?;
    let off = bench.status()?.lamp;
    ensure(on.on && on.level == 0x8000, || format!("at half level it tells {on:?}"))?;
    ensure(!off.on && !off.warm, || format!("switched off it tells {off:?}"))
}
