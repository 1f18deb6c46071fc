//! Commands, one file each. A command writes to `out` and returns what went wrong; only [`main_from`] talks to the process.

mod attempts;
mod controllers;
mod diagnose;
mod effects;
mod explain;
mod explain_table;
mod files;
mod fly;
mod fly_table;
mod fly_team;
mod horizons;
mod identify;
mod identify_picture;
mod identify_table;
mod identify_thesis;
mod inspect;
mod inspect_picture;
mod inspect_table;
mod leaderboard;
mod measured;
mod model;
mod pilot;
mod replay;
mod replay_table;
mod replay_world;
mod robustness;
mod scenarios;
mod score;
mod score_page;
mod score_table;
mod scorecard;
mod serve;
mod submit;
mod tasks;
mod token;
mod tune;
mod verify;

use std::io::{self, Write};

use clap::{Parser, Subcommand};

use crate::failure::{Failure, Outcome};
use crate::text::{Table, number, with_cause};

const EXAMPLES: &str = "\
Examples:
  crazyflie fly --task fly-80cm --picture flight.svg
  crazyflie inspect flight.csv
  crazyflie replay flight.csv
  crazyflie identify --fit flight.csv --out my.toml
  crazyflie explain my.toml --fit flight1.csv --test flight2.csv --out found/
  crazyflie diagnose --normal monday/ --suspect friday/
  crazyflie scorecard
  crazyflie effects
  crazyflie submit --controller thesis-pid
  crazyflie leaderboard --scenario hover-aruco
  crazyflie serve";

/// Flies, replays, identifies, explains and measures the Crazyflie that the TU Darmstadt thesis identified.
#[derive(Debug, Parser)]
#[command(name = "crazyflie", bin_name = "crazyflie", version, after_help = EXAMPLES, max_term_width = 110)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Fly(fly::Args),
    Replay(replay::Args),
    ReplayWorld(replay_world::Args),
    Identify(identify::Args),
    Inspect(inspect::Args),
    Explain(explain::Args),
    Diagnose(diagnose::Args),
    Horizons(horizons::Args),
    Score(score::Args),
    Scorecard(scorecard::Args),
    Serve(serve::Args),
    Measured(measured::Args),
    Effects(effects::Args),
    Tasks(tasks::Args),
    Controllers(controllers::Args),
    Model(model::Args),
    Pilot(pilot::Args),
    Scenarios(scenarios::Args),
    Submit(submit::Args),
    Tune(tune::Args),
    Robustness(robustness::Args),
    Leaderboard(leaderboard::Args),
    Attempts(attempts::Args),
    Verify(verify::Args),
    Token(token::Args),
}

/// Runs the command line; `args` begin with the program's name. Returns the exit code: 0, 2 for usage, 1 for failures.
pub fn main_from(args: impl IntoIterator<Item = String>) -> i32 {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(message) => {
            // nobody is left to be told that a pipe is closed
            let _ = message.print();
            return message.exit_code();
        }
    };
    let mut out = io::BufWriter::new(io::stdout().lock());
    let outcome = run(&cli.command, &mut out).and_then(|()| Ok(out.flush()?));
    match outcome {
        Ok(()) | Err(Failure::Closed) => 0,
        Err(failure) => {
            let _ = writeln!(io::stderr(), "crazyflie: {failure}");
            failure.exit_code()
        }
    }
}

fn run(command: &Command, out: &mut dyn Write) -> Outcome {
    match command {
        Command::Fly(args) => fly::run(args, out),
        Command::Replay(args) => replay::run(args, out),
        Command::ReplayWorld(args) => replay_world::run(args, out),
        Command::Identify(args) => identify::run(args, out),
        Command::Inspect(args) => inspect::run(args, out),
        Command::Explain(args) => explain::run(args, out),
        Command::Diagnose(args) => diagnose::run(args, out),
        Command::Horizons(args) => horizons::run(args, out),
        Command::Score(args) => score::run(args, out),
        Command::Scorecard(args) => scorecard::run(args, out),
        Command::Serve(args) => serve::run(args, out),
        Command::Measured(args) => measured::run(args, out),
        Command::Effects(args) => effects::run(args, out),
        Command::Tasks(args) => tasks::run(args, out),
        Command::Controllers(args) => controllers::run(args, out),
        Command::Model(args) => model::run(args, out),
        Command::Pilot(args) => pilot::run(args, out),
        Command::Scenarios(args) => scenarios::run(args, out),
        Command::Submit(args) => submit::run(args, out),
        Command::Tune(args) => tune::run(args, out),
        Command::Robustness(args) => robustness::run(args, out),
        Command::Leaderboard(args) => leaderboard::run(args, out),
        Command::Attempts(args) => attempts::run(args, out),
        Command::Verify(args) => verify::run(args, out),
        Command::Token(args) => token::run(args, out),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;
    use clap::error::ErrorKind;

    use super::*;

    /// Words that lead to each option that names a picture, the option last.
    fn picture_options(command: &clap::Command, before: &[String]) -> Vec<Vec<String>> {
        let named = |arg: &clap::Arg| arg.get_long().filter(|long| long.starts_with("picture")).map(|long| format!("--{long}"));
        let own = command.get_arguments().filter_map(named).map(|option| [before, &[option]].concat());
        let below = command.get_subcommands().flat_map(|sub| picture_options(sub, &[before, &[sub.get_name().to_owned()]].concat()));
        own.chain(below).collect()
    }

    #[test]
    fn every_command_that_draws_refuses_what_is_no_svg() {
        let options = picture_options(&Cli::command(), &["crazyflie".to_owned()]);
        assert!(options.len() > 7, "{options:?}");
        for words in options {
            // what else a command requires is missed only after the values are read
            let kind = |file: &str| Cli::try_parse_from([&words[..], &[file.to_owned()]].concat()).err();
            let refused = kind("x.png").unwrap_or_else(|| panic!("{words:?} takes x.png"));
            assert_eq!(refused.kind(), ErrorKind::ValueValidation, "{words:?}");
            assert!(refused.to_string().contains("name a file that ends in .svg"), "{words:?}: {refused}");
            for fine in ["x.svg", "x.SVG", "pictures/", "pictures"] {
                assert!(kind(fine).is_none_or(|e| e.kind() != ErrorKind::ValueValidation), "{words:?} refuses {fine}");
            }
        }
    }
}
