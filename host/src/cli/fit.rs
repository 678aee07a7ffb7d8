//! Stub.
use super::Context;
use crate::error::Result;
use clap::Args;
#[derive(Debug, Args)]
pub(super) struct FitArgs {}
pub(super) fn run(_: &FitArgs, _: &mut Context) -> Result<()> {
    Ok(())
}
