//! `lobelia rig safe`.

use clap::Args;
use lobelia_protocol::SafeCommand;

use super::Connection;
use crate::cli::Context;
use crate::error::Result;
use crate::rig::safe;

/// Arguments of `lobelia rig safe`.
#[derive(Debug, Args)]
pub(super) struct SafeArgs {
    #[command(flatten)]
    connection: Connection,
    /// Brakes the axes and closes the shutter
    #[arg(long)]
    stop: bool,
    /// Puts the lamp out and closes the shutter
    #[arg(long)]
    darken: bool,
}

/// Runs `lobelia rig safe`.
pub(super) fn safe(args: &SafeArgs, context: &mut Context) -> Result<()> {
    let config = super::rig_config(args.connection.rig.as_deref(), context)?;
    let chosen =
        [(args.stop, SafeCommand::Stop), (args.darken, SafeCommand::Darken), (true, SafeCommand::Ask)];
    let commands: Vec<_> = chosen.iter().filter(|(chosen, _)| *chosen).map(|(_, command)| *command).collect();
    if let Some(state) = safe::ask(args.connection.open(&config)?, &commands)? {
        println!("{}", safe::text(&state));
        context.report.figure("moving", state.moving);
        context.report.figure("lamp", state.lamp);
        context.report.figure("fault", state.fault);
    }
    Ok(())
}
