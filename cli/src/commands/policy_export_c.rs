//! `crazyflie policy export-c`: a trained policy as C for a microcontroller.

use std::io::Write;
use std::path::{Path, PathBuf};

use crazyflie_control::export_c;
use crazyflie_env::model::VerticalInput;

use serde_json::json;

use super::files::ModelArg;
use super::{Failure, Outcome, files};

/// Write a policy as C: single precision, constant tables, no allocation. FILE.h beside FILE.c has the fields
/// of an observation and their units.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The policy, as `crazyflie_gym.export_policy` or `python -m crazyflie_gym.ppo` writes it
    policy: PathBuf,
    /// File of the code; the header goes beside it
    #[arg(long, short, value_name = "FILE.c")]
    out: PathBuf,
    #[command(flatten)]
    model: ModelArg,
    /// Vertical form of the model that is commanded [default: the policy's, or else pwm]
    #[arg(long, value_parser = files::vertical, value_name = "FORM")]
    vertical: Option<VerticalInput>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let bytes = std::fs::read(&args.policy).map_err(|e| Failure::about(args.policy.display(), e))?;
    let model = args.model.read()?;
    let stem = args.out.file_stem().and_then(std::ffi::OsStr::to_str);
    let is_c = args.out.extension().is_some_and(|ending| ending == "c");
    let Some(stem) = stem.filter(|_| is_c) else {
        return Err(Failure::Usage(format!("{}: name a file that ends in .c", args.out.display())));
    };
    let code = export_c(&bytes, &model, args.vertical, stem)
        .map_err(|e| Failure::about(args.policy.display(), e))?;
    let header: &Path = &args.out.with_extension("h");
    files::write(&args.out, code.source.as_bytes())?;
    files::write(header, code.header.as_bytes())?;
    if args.json {
        return Ok(writeln!(out, "{}", json!({"source": &args.out, "header": header}))?);
    }
    Ok(writeln!(out, "wrote {} and {}", args.out.display(), header.display())?)
}
