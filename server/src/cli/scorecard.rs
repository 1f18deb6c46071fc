use super::Outcome;
use std::io::Write;
/// x
#[derive(Debug, clap::Args)]
pub(super) struct Args {}
pub(super) fn run(_: &Args, _: &mut dyn Write) -> Outcome { Ok(()) }
