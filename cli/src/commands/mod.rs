//! Commands, one file each. A command writes to `out` and returns what went wrong; only [`main_from`] talks
//! to the process.

mod actions;
#[cfg(feature = "bench")]
mod bench;
#[cfg(feature = "crazyflies")]
mod cf2;
mod controllers;
mod demo;
#[cfg(feature = "crazyflies")]
mod deploy;
mod diagnose;
mod effects;
mod explain;
mod explain_table;
#[cfg(feature = "jax")]
mod export;
pub(crate) mod files;
mod fly;
mod fly_multi_drone;
mod fly_table;
mod horizons;
mod identify;
mod identify_motors_table;
mod identify_table;
mod inspect;
mod inspect_table;
mod model;
pub(crate) mod open;
mod plot;
mod policy_export_c;
mod replay;
mod replay_table;
mod serve;
mod tasks;
mod tune;
mod vehicles;
mod world_found;
mod world_join;
mod world_replay;

use std::io::{self, Write};

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

#[cfg(feature = "crazyflies")]
pub use deploy::{Deployer, set_deployer};

use crate::failure::{Failure, Outcome};
use crate::text::{Table, listed, number, or_dash, percent, quantity, seconds, with_cause, write_json};

/// Commands by what they are for.
const GROUPS: [(&str, &[&str]); 5] = [
    ("fly", &["demo", "fly", "cf2", "deploy", "world"]),
    ("find what a model lacks", &["inspect", "replay", "identify", "explain", "diagnose", "horizons"]),
    ("design controllers", &["controllers", "tune", "plot", "policy", "bench"]),
    ("look up", &["tasks", "actions", "effects", "model", "vehicles"]),
    ("use from elsewhere", &["serve", "export"]),
];

/// Examples of each command, below its name in brackets; a star stands for the commands of a group.
const EXAMPLES: &str = include_str!("../../templates/examples.txt");

/// The end of a command's help.
fn examples(command: &str) -> Option<String> {
    let mut sections = EXAMPLES.trim_end().split("\n\n[").filter_map(|section| section.split_once("]\n"));
    let is_of =
        |name: &str| name.strip_suffix('*').map_or(name == command, |group| command.starts_with(group));
    sections
        .find(|(name, _)| is_of(name.trim_start_matches('[')))
        .map(|(_, text)| format!("Examples:\n{text}"))
}

/// Gives each subcommand its examples; `before` are the words before their names.
fn with_examples(command: clap::Command, before: &str) -> clap::Command {
    command.mut_subcommands(|sub| {
        let name = format!("{before}{}", sub.get_name());
        with_examples(sub, &format!("{name} ")).after_help(examples(&name).unwrap_or_default())
    })
}

/// The commands that are built in, in groups, and examples of them.
fn overview() -> String {
    let mut lines = vec!["Commands:".to_owned()];
    for (group, names) in GROUPS {
        let names: Vec<&str> = names.iter().copied().filter(|name| Command::has_subcommand(name)).collect();
        lines.push(format!("  {group:25}{}", names.join(", ")));
    }
    lines.push(String::new());
    let has = |line: &&str| {
        let name = line.strip_prefix("  crazyflie ").and_then(|rest| rest.split(' ').next());
        name.is_none_or(Command::has_subcommand)
    };
    lines.extend(examples("crazyflie").iter().flat_map(|text| text.lines()).filter(has).map(str::to_owned));
    lines.join("\n")
}

/// Columns of a help: those of the terminal, at most a hundred, unless `COLUMNS` says otherwise.
fn help_width() -> usize {
    std::env::var("COLUMNS").ok().and_then(|columns| columns.parse().ok()).unwrap_or(100)
}

/// Flies, replays, identifies and explains the Crazyflie that the TU Darmstadt thesis identified.
#[derive(Debug, Parser)]
#[command(
    name = "crazyflie",
    bin_name = "crazyflie",
    version,
    after_help = overview(),
    help_template = "{about}\n\n{usage-heading} {usage}{after-help}",
    max_term_width = help_width()
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Args),
    Fly(fly::Args),
    #[cfg(feature = "crazyflies")]
    Cf2(cf2::Args),
    #[cfg(feature = "crazyflies")]
    Deploy(deploy::Args),
    Replay(replay::Args),
    Identify(identify::Args),
    Inspect(inspect::Args),
    Explain(explain::Args),
    Diagnose(diagnose::Args),
    Horizons(horizons::Args),
    Tune(tune::Args),
    Plot(plot::Args),
    #[cfg(feature = "jax")]
    Export(export::Args),
    Effects(effects::Args),
    Tasks(tasks::Args),
    Actions(actions::Args),
    Controllers(controllers::Args),
    Model(model::Args),
    Vehicles(vehicles::Args),
    Serve(serve::Args),
    /// Create, join and replay worlds that several clients share
    #[command(subcommand)]
    World(World),
    /// Export trained policies
    #[command(subcommand)]
    Policy(Policy),
    /// The benchmark of controllers
    #[cfg(feature = "bench")]
    #[command(subcommand)]
    Bench(bench::Command),
}

#[derive(Debug, Subcommand)]
enum World {
    Found(world_found::Args),
    Join(world_join::Args),
    Replay(world_replay::Args),
}

#[derive(Debug, Subcommand)]
enum Policy {
    ExportC(policy_export_c::Args),
}

/// Names of version 0.1 that work for one release, with what they are called now.
const RENAMED: [(&str, &[&str]); 9] = [
    ("attempts", &["bench", "attempts"]),
    ("leaderboard", &["bench", "leaderboard"]),
    ("pilot", &["world", "join"]),
    ("replay-world", &["world", "replay"]),
    ("robustness", &["bench", "robustness"]),
    ("scenarios", &["bench", "scenarios"]),
    ("submit", &["bench", "submit"]),
    ("token", &["bench", "token"]),
    ("verify", &["bench", "verify"]),
];

/// Options of version 0.1 that work for one release.
const RENAMED_OPTIONS: [(&str, &str); 2] = [("--avoid", "--collision-avoidance"), ("--rig", "--sensors")];

/// Experiments that are scripts of the repository now, by what ran them.
const SCRIPTS: [(&str, &str); 5] = [
    ("identify --thesis", "examples/thesis/identify.py"),
    ("measured", "examples/thesis/recorded.py"),
    ("report recorded", "examples/thesis/recorded.py"),
    ("reproduce thesis", "examples/thesis/scorecard.py"),
    ("scorecard", "examples/thesis/scorecard.py"),
];

/// The experiment that these words would have run, and its script.
fn find_script(words: &[String]) -> Option<&'static (&'static str, &'static str)> {
    let (command, options) = words.get(1..)?.split_first()?;
    SCRIPTS.iter().find(|(old, _)| {
        let mut parts = old.split(' ');
        parts.next() == Some(command) && parts.all(|part| options.iter().any(|word| word == part))
    })
}

/// The words with old names replaced, and each old name with the new one.
fn with_new_names(words: Vec<String>) -> (Vec<String>, Vec<(&'static str, String)>) {
    let mut replacements = Vec::new();
    let mut renamed = Vec::new();
    for (place, word) in words.into_iter().enumerate() {
        let (name, value) =
            word.split_once('=').map_or((&word[..], None), |(name, value)| (name, Some(value)));
        if let Some((old, new)) = RENAMED.iter().find(|(old, _)| place == 1 && *old == word) {
            replacements.push((*old, new.join(" ")));
            renamed.extend(new.iter().map(|part| (*part).to_owned()));
        } else if let Some((old, new)) = RENAMED_OPTIONS.iter().find(|(old, _)| *old == name) {
            replacements.push((*old, (*new).to_owned()));
            renamed.push(value.map_or((*new).to_owned(), |value| format!("{new}={value}")));
        } else {
            renamed.push(word);
        }
    }
    (renamed, replacements)
}

/// Runs the command line; `args` begin with the program's name. Returns the exit code: 0, 2 for usage, 1 for
/// failures.
pub fn main_from(args: impl IntoIterator<Item = String>) -> i32 {
    let args: Vec<String> = args.into_iter().collect();
    if let Some((old, script)) = find_script(&args) {
        let _ =
            writeln!(io::stderr(), "crazyflie: `{old}` is a script of the repository now: python {script}");
        return 2;
    }
    let (args, renamed) = with_new_names(args);
    for (old, new) in renamed {
        let _ = writeln!(
            io::stderr(),
            "crazyflie: `{old}` is now called `{new}`; the old name works for one release"
        );
    }
    let matches = with_examples(Cli::command(), "").try_get_matches_from(args);
    let cli = match matches.and_then(|mut matches| Cli::from_arg_matches_mut(&mut matches)) {
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
        #[cfg(feature = "crazyflies")]
        Command::Cf2(args) => cf2::run(args, out),
        #[cfg(feature = "crazyflies")]
        Command::Deploy(args) => deploy::run(args),
        Command::Replay(args) => replay::run(args, out),
        Command::Identify(args) => identify::run(args, out),
        Command::Inspect(args) => inspect::run(args, out),
        Command::Explain(args) => explain::run(args, out),
        Command::Diagnose(args) => diagnose::run(args, out),
        Command::Horizons(args) => horizons::run(args, out),
        Command::Tune(args) => tune::run(args, out),
        Command::Plot(args) => plot::run(args, out),
        #[cfg(feature = "jax")]
        Command::Export(args) => export::run(args, out),
        Command::Effects(args) => effects::run(args, out),
        Command::Tasks(args) => tasks::run(args, out),
        Command::Actions(args) => actions::run(args, out),
        Command::Controllers(args) => controllers::run(args, out),
        Command::Model(args) => model::run(args, out),
        Command::Vehicles(args) => vehicles::run(args, out),
        Command::Demo(args) => demo::run(args, out),
        Command::Serve(args) => serve::run(args, out),
        Command::World(World::Found(args)) => world_found::run(args, out),
        Command::World(World::Join(args)) => world_join::run(args, out),
        Command::World(World::Replay(args)) => world_replay::run(args, out),
        Command::Policy(Policy::ExportC(args)) => policy_export_c::run(args, out),
        #[cfg(feature = "bench")]
        Command::Bench(command) => bench::run(command, out),
    }
}

#[cfg(test)]
mod tests {
    use clap::error::ErrorKind;

    use super::*;

    /// Words that lead to each option that names a picture, the option last.
    fn picture_options(command: &clap::Command, before: &[String]) -> Vec<Vec<String>> {
        let named = |arg: &clap::Arg| {
            arg.get_long().filter(|long| long.starts_with("picture")).map(|long| format!("--{long}"))
        };
        let own = command.get_arguments().filter_map(named).map(|option| [before, &[option]].concat());
        let below = command
            .get_subcommands()
            .flat_map(|sub| picture_options(sub, &[before, &[sub.get_name().to_owned()]].concat()));
        own.chain(below).collect()
    }

    #[test]
    fn every_command_that_draws_obeys_the_ending_and_lists_what_there_is() {
        let options = picture_options(&Cli::command(), &["crazyflie".to_owned()]);
        assert!(options.len() > 7, "{options:?}");
        for words in options {
            // clap reads the values before it misses other required options
            let kind = |file: &str| Cli::try_parse_from([&words[..], &[file.to_owned()]].concat()).err();
            for file in ["x.jpg", "x.svg.gz", "a.b/x.gif"] {
                let refused = kind(file).unwrap_or_else(|| panic!("{words:?} takes {file}"));
                assert_eq!(refused.kind(), ErrorKind::ValueValidation, "{words:?}");
                assert!(refused.to_string().contains(".svg, .png, .pdf"), "{words:?}: {refused}");
            }
            for fine in ["x.svg", "x.SVG", "x.png", "x.pdf"] {
                assert!(
                    kind(fine).is_none_or(|e| e.kind() != ErrorKind::ValueValidation),
                    "{words:?} refuses {fine}"
                );
            }
        }
    }

    #[test]
    fn every_command_is_in_one_group() {
        let cli = Cli::command();
        let mut built: Vec<&str> = cli.get_subcommands().map(clap::Command::get_name).collect();
        let grouped = GROUPS.iter().flat_map(|(_, names)| *names).copied();
        let mut grouped: Vec<&str> = grouped.filter(|name| Command::has_subcommand(name)).collect();
        built.sort_unstable();
        grouped.sort_unstable();
        assert_eq!(built, grouped);
        assert!(Cli::command().render_long_help().to_string().lines().count() <= 24);
    }

    #[cfg(all(feature = "bench", feature = "crazyflies", feature = "jax"))]
    #[test]
    fn every_section_of_examples_is_of_a_command() {
        let sections = EXAMPLES.lines().filter_map(|line| line.strip_prefix('[')?.strip_suffix(']'));
        for section in sections.filter(|section| *section != "crazyflie") {
            let mut words = section.split(' ').filter(|word| *word != "*");
            let command =
                words.try_fold(Cli::command(), |command, word| command.find_subcommand(word).cloned());
            assert!(command.is_some(), "{section}");
        }
    }
}
