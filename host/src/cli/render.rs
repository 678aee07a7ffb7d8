//! Stub.
use super::Context;
use crate::error::Result;
use clap::Args;
#[derive(Debug, Args)]
pub(super) struct RenderArgs {}
pub(super) fn run(_: &RenderArgs, _: &mut Context) -> Result<()> {
    Ok(())
}
