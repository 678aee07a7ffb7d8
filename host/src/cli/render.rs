//! Stub.
use clap::Args;
use super::Context;
use crate::error::Result;
#[derive(Debug, Args)]
pub(super) struct RenderArgs {}
pub(super) fn run(_: &RenderArgs, _: &mut Context) -> Result<()> { Ok(()) }
