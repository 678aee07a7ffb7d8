//! Conformance: a scripted check of any controller against the protocol, for people who build their own.
//!
//! Each check states one thing that a host relies on. A check that fails says what came instead; the others
//! go on, unless the link itself is lost. The axes move to their limits and the lamp is struck once (unless
//! told not to).

mod bench;
pub mod bring_up;
mod endurance;
mod light;
mod link;
mod motion;
mod session;
mod wiring;

use lobelia_protocol::{Command, Configuration};

use crate::rig::port::Port;
use bench::{Bench, Trouble};
use lobelia_base::error::{Error, Result};

/// What came of a check.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Finding {
    /// It holds.
    Pass,
    /// It doesn't: why.
    Fail(String),
    /// It was left out: why.
    Skipped(&'static str),
}

/// One check and what came of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Check {
    /// What has to hold.
    pub name: &'static str,
    /// Whether it does.
    pub outcome: Finding,
}

/// A check: does its script and gives trouble when something is wrong.
type Script = fn(&mut Bench) -> std::result::Result<(), Trouble>;

/// All checks in order.
const SCRIPT: [&[(&str, Script)]; 6] =
    [session::CHECKS, wiring::CHECKS, motion::CHECKS, light::CHECKS, link::CHECKS, endurance::CHECKS];

/// Number of checks.
pub fn count() -> usize {
    SCRIPT.iter().map(|checks| checks.len()).sum()
}

/// Runs all checks on a controller; tells each as it ends. At the end the axes rest and the lamp is off. With
/// `strike_lamp` false the checks that switch the lamp on are left out.
///
/// # Errors
/// When the port fails, or no controller answers on it at all.
pub fn run(
    port: Box<dyn Port>,
    configuration: &Configuration,
    strike_lamp: bool,
    mut tell: impl FnMut(&Check),
) -> Result<Vec<Check>> {
    if configuration.keep_outs.iter().any(Option::is_some) {
        return Err(Error::input(
            "the checks move all axes at once from limit to limit, through what [[keep_out]] in the rig's \
             file forbids; take the arms off and give a file without it",
        ));
    }
    let mut bench = Bench::new(port, *configuration);
    bench.open().map_err(|trouble| match trouble {
        Trouble::Link(error) => error,
        Trouble::Wrong(why) => {
            Error::failure(format!("no controller answers a hello ({why}); check --port and its power"))
        }
    })?;
    let mut done = Vec::with_capacity(count());
    for (name, script) in SCRIPT.into_iter().flatten() {
        let outcome = if light::STRIKES.contains(name) && !strike_lamp {
            Finding::Skipped("the lamp is to stay off")
        } else {
            match script(&mut bench) {
                Ok(()) => Finding::Pass,
                Err(Trouble::Wrong(why)) => Finding::Fail(why),
                Err(Trouble::Link(error)) => return Err(error.at(name)),
            }
        };
        let check = Check { name, outcome };
        tell(&check);
        done.push(check);
    }
    // Whatever was wrong with it, it's left at rest and dark, if it still listens.
    let _ = bench.ask(Command::Stop);
    let _ = bench.ask(Command::Lamp { on: false, level: 0 });
    Ok(done)
}

#[cfg(test)]
mod tests;
