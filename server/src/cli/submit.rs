//! `crazyflie submit`: the controllers of the registry through the benchmark.

use std::io::Write;
use std::path::PathBuf;

use super::{Outcome, Table, controllers, number};
use crate::bench::baselines;
use crate::bench::{Bench, Document, Limits};

const EXAMPLES: &str = "\
Examples:
  crazyflie submit --controller thesis-pid
  crazyflie submit --controller stock-pid --scenario hover-aruco@1.0.0
  crazyflie submit --controller hover --scenario wind --repeat 3 --json";

/// Fly a built-in controller through the benchmark's scenarios, and store the attempts with their scores.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Args {
    /// Which one, as NAME or NAME:FILE (see `crazyflie controllers`)
    #[arg(long, value_name = "NAME")]
    controller: String,
    /// The controller's options, as JSON
    #[arg(long, value_name = "JSON")]
    controller_options: Option<String>,
    /// A scenario (see `crazyflie scenarios`), or all
    #[arg(long, default_value = "all", value_name = "ID")]
    scenario: String,
    /// So many attempts at each
    #[arg(long, default_value_t = 1, value_name = "N")]
    repeat: u32,
    /// The benchmark's database, made on first use
    #[arg(long, default_value_os_t = crate::bench::default_path(), value_name = "FILE")]
    data: PathBuf,
    /// One JSON object per attempt, as it was signed, once it is on the disk
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &Args, out: &mut dyn Write) -> Outcome {
    let controller = controllers::chosen(&args.controller, args.controller_options.as_deref())?;
    let bench = Bench::open(&args.data, Limits::default())?;
    let scenarios: Vec<String> = match args.scenario.as_str() {
        "all" => bench.scenarios().iter().map(|s| s.id()).collect(),
        name => vec![bench.scenario(name)?.id()],
    };
    let mut done = Vec::new();
    for scenario in &scenarios {
        for _ in 0..args.repeat {
            let document = baselines::submit(&bench, scenario, &controller)?;
            if args.json {
                // said at once: whoever reads it may rely on it
                serde_json::to_writer(&mut *out, &document)?;
                writeln!(out)?;
                out.flush()?;
            }
            done.push(document);
        }
    }
    if !args.json {
        write!(out, "{}", table(&done).plain())?;
    }
    Ok(())
}

fn table(documents: &[Document]) -> Table {
    let mut table = Table::new(&["scenario", "attempt", "score", "95 %", "failed", "RMS error", "settled", "overshoot"]).left(&[1]);
    for document in documents {
        let Some(result) = &document.result else { continue };
        let (score, metrics) = (&result.score, &result.metrics);
        let cm = |m: Option<f64>| m.map_or("-".into(), |m| format!("{} cm", number(100.0 * m, 1)));
        let settled = metrics.settling_s.map_or("-".into(), |s| format!("{} of {} in {} s", metrics.settled, score.episodes, number(s, 1)));
        table.row(vec![
            document.scenario.clone(),
            document.id.clone(),
            number(score.score, 1),
            format!("{} to {}", number(score.low, 1), number(score.high, 1)),
            format!("{} of {}", score.failed, score.episodes),
            cm(metrics.rmse_m),
            settled,
            cm(metrics.overshoot_m),
        ]);
    }
    table
}
