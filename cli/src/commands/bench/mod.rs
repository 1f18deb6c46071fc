//! `crazyflie bench`: the benchmark of controllers, and what a server offers of it.

mod attempts;
mod leaderboard;
mod remote_submit;
mod robustness;
mod scenarios;
mod season;
mod submit;
mod token;
mod verify;

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use crazyflie_bench::serve::Benchmark;
use crazyflie_bench::{Bench, Error};
use crazyflie_server::serve::Extension;
use jiff::Timestamp;

use super::{Failure, Outcome, Table, controllers, files, number, or_dash, quantity, write_json};

#[derive(Debug, clap::Subcommand)]
pub(super) enum Command {
    Submit(submit::Args),
    Leaderboard(leaderboard::Args),
    Attempts(attempts::Args),
    Verify(verify::Args),
    Scenarios(scenarios::Args),
    Robustness(robustness::Args),
    Token(token::Args),
    #[command(subcommand)]
    Season(season::Action),
}

pub(super) fn run(command: &Command, out: &mut dyn Write) -> Outcome {
    match command {
        Command::Submit(args) => submit::run(args, out),
        Command::Leaderboard(args) => leaderboard::run(args, out),
        Command::Attempts(args) => attempts::run(args, out),
        Command::Verify(args) => verify::run(args, out),
        Command::Scenarios(args) => scenarios::run(args, out),
        Command::Robustness(args) => robustness::run(args, out),
        Command::Token(args) => token::run(args, out),
        Command::Season(action) => season::run(action, out),
    }
}

/// The option that says where attempts are.
#[derive(Debug, clap::Args)]
pub(super) struct Database {
    /// Database of the benchmark: a file, created on first use, a season's archive, or a postgresql:// URL
    #[arg(long, global = true, default_value_os_t = crazyflie_bench::default_path(), value_name = "FILE")]
    data: PathBuf,
}

impl Database {
    fn open(&self) -> Outcome<Bench> {
        Ok(Bench::open(&self.data)?)
    }

    /// For a server.
    pub(super) fn extension(&self) -> Outcome<Arc<dyn Extension>> {
        let bench = Bench::open(&self.data).map_err(|e| Failure::about(self.data.display(), e))?;
        Ok(Benchmark::extension(bench))
    }

    /// The command that makes a team's token for it. A URL has a password in it.
    pub(super) fn token_command(&self) -> String {
        let data = match self.data.to_str() {
            Some(url) if url.contains("://") => "URL".into(),
            _ => self.data.display().to_string(),
        };
        format!("crazyflie bench token create TEAM --data {data}")
    }

    /// For those who only look.
    fn open_existing(&self) -> Outcome<Bench> {
        Ok(Bench::open_existing(&self.data)?)
    }
}

/// Options of most commands.
#[derive(Debug, clap::Args)]
struct Common {
    #[command(flatten)]
    database: Database,
    /// Print JSON
    #[arg(long, global = true)]
    json: bool,
}

/// Milliseconds since 1970 as a date.
fn moment(ms: i64) -> String {
    Timestamp::from_millisecond(ms).map_or_else(|_| ms.to_string(), |at| format!("{at:.0}"))
}

fn cm(distance_m: Option<f64>) -> String {
    or_dash(distance_m.map(|m| quantity(100.0 * m, 1, "cm")))
}

fn interval(low: f64, high: f64) -> String {
    format!("{} to {}", number(low, 1), number(high, 1))
}

fn settled(count: usize, flights: usize, median_s: Option<f64>) -> String {
    median_s.map_or("-".into(), |s| format!("{count} of {flights} in {} s", number(s, 1)))
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error {
            Error::Scenario { .. } | Error::Attempt(_) | Error::Name { .. } => {
                Failure::Usage(error.to_string())
            }
            other => Failure::Failed(other.to_string()),
        }
    }
}
