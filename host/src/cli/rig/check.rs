//! `lobelia rig conformance` and `replay`.

use std::path::PathBuf;

use clap::Args;

use super::{Connection, Session};
use crate::cli::Context;
use crate::error::{Error, Result};
use crate::progress;
use crate::rig::conformance::bring_up::{self, Act, Operator};
use crate::rig::conformance::{self, Finding};
use crate::rig::{replay, trace};

/// Arguments of `lobelia rig conformance`.
#[derive(Debug, Args)]
pub(super) struct ConformanceArgs {
    #[command(flatten)]
    connection: Connection,
    /// Leaves out the checks that switch the lamp on
    #[arg(long)]
    no_lamp: bool,
    /// Walks through the first hour with a board before: asks for what has to be done at it, one thing after
    /// the other
    #[arg(long)]
    bring_up: bool,
}

/// Somebody at the terminal.
struct AtTerminal;

impl Operator for AtTerminal {
    fn act(&mut self, act: Act) -> Result<bool> {
        println!("{act} [Enter, or n]");
        let mut line = String::new();
        match std::io::stdin().read_line(&mut line) {
            Ok(0) => Err(Error::input("--bring-up needs somebody at the terminal who answers")),
            Ok(_) => Ok(!line.trim_start().starts_with(['n', 'N'])),
            Err(error) => Err(Error::failure(format!("the terminal cannot be read: {error}"))),
        }
    }
}

/// Arguments of `lobelia rig replay`.
#[derive(Debug, Args)]
pub(super) struct ReplayArgs {
    /// The session, recorded with --record
    trace: PathBuf,
    #[command(flatten)]
    session: Session,
    /// Compares times and readings too, as between simulated rigs
    #[arg(long)]
    exact: bool,
}

/// Runs `lobelia rig conformance`.
pub(super) fn conformance(args: &ConformanceArgs, context: &mut Context) -> Result<()> {
    let config = super::rig_config(args.connection.rig.as_deref(), context)?;
    let configuration = config.configuration()?;
    if args.bring_up {
        let port = args.connection.open(&config)?;
        context.report.stage("bring-up", || bring_up::run(port, &configuration, &mut AtTerminal))?;
        println!("the first hour is done; the protocol's checks follow");
    }
    let port = args.connection.open(&config)?;
    let checks = context.report.stage("conformance", || {
        conformance::run(port, &configuration, !args.no_lamp, |check| match &check.outcome {
            Finding::Pass => println!("pass  {}", check.name),
            Finding::Fail(why) => println!("FAIL  {}: {why}", check.name),
            Finding::Skipped(why) => println!("skip  {}: {why}", check.name),
        })
    })?;
    let of = |wanted: fn(&Finding) -> bool| checks.iter().filter(|check| wanted(&check.outcome)).count();
    let passed = of(|outcome| *outcome == Finding::Pass);
    let failed = of(|outcome| matches!(outcome, Finding::Fail(_)));
    context.report.figure("passed", passed);
    context.report.figure("failed", failed);
    println!("{passed} passed, {failed} failed, {} left out", checks.len() - passed - failed);
    if failed > 0 {
        return Err(Error::failure(format!(
            "the controller on {} fails {failed} of {} checks; see the lines above",
            args.connection.port,
            checks.len()
        )));
    }
    Ok(())
}

/// Runs `lobelia rig replay`.
pub(super) fn replay(args: &ReplayArgs, context: &mut Context) -> Result<()> {
    let trace = trace::read(&args.trace)?;
    context.report.input(&args.trace);
    if args.session.record.as_deref() == Some(&args.trace) {
        return Err(Error::input("--record names the trace that is to be replayed; give it another name"));
    }
    let (_, mut client) = args.session.connect(context)?;
    let bar = progress::bar("replay", trace.len() as u64, "lines");
    let replayed =
        context.report.stage("replay", || replay::run(&mut client, &trace, args.exact, || bar.advance(1)))?;
    drop(bar);
    for difference in &replayed.differences {
        println!("line {}: {}", difference.line, difference.what);
    }
    let count = replayed.differences.len();
    context.report.figure("requests", replayed.requests);
    context.report.figure("differences", count);
    if count > 0 {
        return Err(Error::failure(format!(
            "answers differ from those recorded in {}: {count}",
            args.trace.display()
        )));
    }
    println!("{} requests, no difference", replayed.requests);
    if replayed.steps > 0 {
        println!("{} steps, times within {} µs", replayed.steps, replayed.most_us);
    }
    Ok(())
}
