//! `crazyflie bench submit`: controllers through the benchmark.

use std::io::Write;
use std::path::PathBuf;

use indicatif::ProgressBar;

use super::remote_submit::RemoteAttempts;
use super::{Common, Failure, Outcome, Table, cm, controllers, interval, number, settled};
use crazyflie_bench::{Document, Entrant, baselines};

/// Variable of the token, the same as in Python.
const TOKEN: &str = "CRAZYFLIE_TOKEN";

/// Fly a controller through the benchmark's scenarios, and store the attempts with their scores.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Controller, as NAME, NAME:FILE or python:FILE:NAME (see `crazyflie controllers`); for several drones
    /// one each, separated by commas, or one for all
    #[arg(long, value_name = "NAME")]
    controller: String,
    /// The controller's options, as JSON; a list for several
    #[arg(long, value_name = "JSON")]
    controller_options: Option<String>,
    /// Keep drones that share the air out of each other's way
    #[arg(long)]
    collision_avoidance: bool,
    /// A scenario (see `crazyflie bench scenarios`), or all
    #[arg(long, default_value = "all", value_name = "ID")]
    scenario: String,
    /// Number of attempts at each scenario
    #[arg(long, default_value_t = 1, value_name = "N")]
    repeat: u32,
    /// Fly on this server instead of here, as any client would: ws://host:port or wss://host:port
    #[arg(long, value_name = "URL", conflicts_with = "data")]
    server: Option<String>,
    /// The team's token for that server. The list of processes shows it to all users: prefer --token-file or
    /// CRAZYFLIE_TOKEN
    #[arg(long, value_name = "TOKEN", requires = "server", conflicts_with = "token_file", value_parser = |text: &str| Ok::<_, String>(Token(text.trim().into())))]
    token: Option<Token>,
    /// A file with the token
    #[arg(long, value_name = "FILE", requires = "server")]
    token_file: Option<PathBuf>,
    /// Replace the team's entry if it has another name; an earlier entry returns with its attempts
    #[arg(long, requires = "server")]
    new_entry: bool,
    #[command(flatten)]
    common: Common,
}

/// A team's token; `Debug` hides it.
#[derive(Clone)]
struct Token(String);

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token")
    }
}

/// Makes one attempt at a scenario, in the local database or on a remote server.
type Submit = Box<dyn FnMut(&str, &Entrant) -> Outcome<Document>>;

/// Ids of the scenarios of `--scenario`, and the submission of an attempt. A remote server resolves names to versions
/// itself.
fn target(args: &Args) -> Outcome<(Vec<String>, Submit)> {
    let name = args.scenario.as_str();
    let Some(url) = &args.server else {
        let bench = args.common.database.open()?;
        let ids = match name {
            "all" => bench.scenarios().iter().map(|s| s.id()).collect(),
            name => vec![bench.scenario(name)?.id()],
        };
        return Ok((ids, Box::new(move |id, entrant| Ok(baselines::submit(&bench, id, entrant)?))));
    };
    let mut remote = RemoteAttempts::open(url, &token(args)?, args.new_entry)?;
    let ids = if name == "all" { remote.scenarios().to_vec() } else { vec![name.to_owned()] };
    Ok((ids, Box::new(move |id, entrant| Ok(remote.submit(id, entrant)?))))
}

fn token(args: &Args) -> Outcome<String> {
    if let Some(Token(token)) = &args.token {
        return Ok(token.clone());
    }
    let missing = || {
        Failure::Usage(format!("--server wants a team's token: give --token-file or --token, or set {TOKEN}"))
    };
    let text = match &args.token_file {
        Some(path) => std::fs::read_to_string(path).map_err(|e| Failure::about(path.display(), e))?,
        None => std::env::var(TOKEN).map_err(|_| missing())?,
    };
    Some(text.trim().to_owned()).filter(|token| !token.is_empty()).ok_or_else(missing)
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let controllers = controllers::chosen_each(&args.controller, args.controller_options.as_deref())?;
    let entrant = Entrant { controllers, avoid: args.collision_avoidance };
    let (scenarios, mut submit) = target(args)?;
    let bar = ProgressBar::new(scenarios.len() as u64 * u64::from(args.repeat));
    bar.tick();
    let mut done = Vec::new();
    for scenario in scenarios {
        for _ in 0..args.repeat {
            let document = submit(&scenario, &entrant)?;
            if args.common.json {
                // written at once, so that a reader can rely on it
                bar.suspend(|| write_json(&document, out))?;
            }
            done.push(document);
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    if !args.common.json {
        write!(out, "{}", table(&done))?;
    }
    Ok(())
}

fn write_json(document: &Document, out: &mut dyn Write) -> Outcome {
    serde_json::to_writer(&mut *out, document)?;
    writeln!(out)?;
    Ok(out.flush()?)
}

fn table(documents: &[Document]) -> impl std::fmt::Display {
    Table::from_rows(documents.iter().filter_map(|document| Some((document, document.result.as_ref()?))))
        .words("scenario", |(document, _)| &document.scenario)
        .words("attempt", |(document, _)| &document.id)
        .values("score", |(_, r)| number(r.score.score, 1))
        .values("95 %", |(_, r)| interval(r.score.low, r.score.high))
        .values("failed", |(_, r)| format!("{} of {}", r.score.failed, r.score.episodes))
        .values("RMS error", |(_, r)| cm(r.metrics.rmse_m))
        .values("settled", |(_, r)| settled(r.metrics.settled, r.score.episodes, r.metrics.settling_s))
        .values("overshoot", |(_, r)| cm(r.metrics.overshoot_m))
}
