//! `crazyflie bench token`: who may take part.

use std::io::Write;

use clap::Subcommand;

use super::{Common, Failure, Outcome, Table, moment, or_dash, write_json};
use crazyflie_bench::Bench;

/// Create, list and revoke tokens, by which a server knows the team of an attempt.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Create a token and print it once: the database keeps only its hash
    Create { team: String },
    /// List the teams' tokens by number and date
    List,
    /// Revoke all tokens of a team
    Revoke { team: String },
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let bench = match &args.command {
        Command::Create { .. } => args.common.database.open()?,
        Command::List | Command::Revoke { .. } => args.common.database.open_existing()?,
    };
    match &args.command {
        Command::Create { team } => {
            let token = bench.create_token(team)?;
            if args.common.json {
                return Ok(writeln!(out, "{}", serde_json::json!({"team": team, "token": token}))?);
            }
            writeln!(out, "{token}")?;
        }
        Command::List => return list(&bench, args.common.json, out),
        Command::Revoke { team } => match bench.revoke_tokens(team)? {
            0 => {
                let told = format!("team {team:?} has no tokens in force; see crazyflie bench token list");
                return Err(Failure::Failed(told));
            }
            n => writeln!(out, "{n} tokens of {team} revoked")?,
        },
    }
    Ok(())
}

fn list(bench: &Bench, json: bool, out: &mut dyn Write) -> Outcome {
    let tokens = bench.tokens()?;
    if json {
        return write_json(&tokens, out);
    }
    let table = Table::from_rows(&tokens)
        .words("number", |t| t.number)
        .words("team", |t| &t.team)
        .words("created", |t| moment(t.created_ms))
        .words("revoked", |t| or_dash(t.revoked_ms.map(moment)));
    Ok(write!(out, "{table}")?)
}
