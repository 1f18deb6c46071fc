//! `crazyflie bench season`: scenarios frozen for a while, with a secret that is published afterwards.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use indicatif::ProgressBar;
use jiff::Timestamp;
use serde_json::json;

use super::{Common, Failure, Outcome, Table, moment, or_dash, verify, write_json};
use crazyflie_bench::{Bench, LEVELS, SeasonRow, Verdict};

/// Begin, close and verify a season: a dated, frozen set of scenarios with a secret of its own.
#[derive(Debug, clap::Subcommand)]
pub(crate) enum Action {
    New(NewArgs),
    List(ListArgs),
    Close(CloseArgs),
    Verify(VerifyArgs),
}

/// Begin a season. Attempts at its scenarios are part of it until it is closed.
#[derive(Debug, clap::Args)]
pub(crate) struct NewArgs {
    /// A name that no other season has
    name: String,
    /// Scenarios, with commas between them
    #[arg(long, default_value = "all", value_name = "IDS")]
    scenarios: String,
    /// Their levels, 0 to 3, with commas between them (see `crazyflie bench scenarios --levels`)
    #[arg(long, default_value = "1", value_delimiter = ',', value_parser = clap::value_parser!(u8).range(0..=3), value_name = "LEVELS")]
    levels: Vec<u8>,
    /// Last moment, such as 2027-04-01T00:00:00Z
    #[arg(long, value_name = "TIME")]
    until: Option<Timestamp>,
    #[command(flatten)]
    common: Common,
}

/// List all seasons, or the leaderboards of one.
#[derive(Debug, clap::Args)]
pub(crate) struct ListArgs {
    /// Season whose leaderboards are shown
    name: Option<String>,
    #[command(flatten)]
    common: Common,
}

/// Close a season: it takes no new attempt, and running ones have 30 minutes; then its secret is published
/// and its archive written.
#[derive(Debug, clap::Args)]
pub(crate) struct CloseArgs {
    /// The season
    name: String,
    /// File of the archive; a season that is closed already can be archived again
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    common: Common,
}

/// Verify a season's archive: signatures, the published secret, that no attempt is missing, and every flight, bit by bit.
#[derive(Debug, clap::Args)]
pub(crate) struct VerifyArgs {
    /// The archive
    archive: PathBuf,
    /// The server's public key, from its /api/v1/key; by default the archive's own key
    #[arg(long, value_name = "HEX")]
    key: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(action: &Action, out: &mut dyn Write) -> Outcome {
    match action {
        Action::New(args) => begin(args, out),
        Action::List(args) => list(args, out),
        Action::Close(args) => close(args, out),
        Action::Verify(args) => check(args, out),
    }
}

fn begin(args: &NewArgs, out: &mut dyn Write) -> Outcome {
    let bench = args.common.database.open()?;
    let names: Vec<&str> = args.scenarios.split(',').map(str::trim).collect();
    let declared = match names[..] {
        ["all"] => bench.scenarios().iter().collect(),
        _ => names.iter().map(|name| bench.scenario(name)).collect::<Result<Vec<_>, _>>()?,
    };
    let levels: Vec<usize> = args.levels.iter().map(|level| usize::from(*level)).collect();
    let ids: Vec<String> = declared.iter().flat_map(|scenario| scenario.ids_at(&levels)).collect();
    Failure::unless(!ids.is_empty(), || {
        let known = LEVELS.map(|level| format!("{} {}", level.number, level.name)).join(", ");
        format!("--levels: none of the scenarios has such a level; there are {known}")
    })?;
    let until_ms = args.until.map(|until| until.as_millisecond());
    let season = bench.begin_season(&args.name, &ids, until_ms)?;
    if args.common.json {
        return write_json(&season, out);
    }
    let (name, count) = (&args.name, season.document.scenarios.len());
    writeln!(out, "season {name} has begun with {count} scenarios; publish this hash of its secret:")?;
    Ok(writeln!(out, "{}", season.document.secret_sha256)?)
}

fn list(args: &ListArgs, out: &mut dyn Write) -> Outcome {
    let bench = args.common.database.open_existing()?;
    let Some(name) = &args.name else {
        let seasons = bench.seasons()?;
        if args.common.json {
            return write_json(&seasons, out);
        }
        return Ok(write!(out, "{}", table(&seasons))?);
    };
    let boards = bench.season_leaderboards(name)?;
    if args.common.json {
        return write_json(&boards.into_iter().collect::<BTreeMap<_, _>>(), out);
    }
    for (id, rows) in boards {
        writeln!(out, "{id}\n{}", super::leaderboard::table(&rows))?;
    }
    Ok(())
}

fn close(args: &CloseArgs, out: &mut dyn Write) -> Outcome {
    let bench = args.common.database.open_existing()?;
    // a path that cannot be written must not close the season, nor a wrong name empty a file: it is written beside
    let failed = |e| Failure::about(args.out.display(), e);
    let beside = args.out.with_added_extension("partial");
    let mut file = std::io::BufWriter::new(std::fs::File::create(&beside).map_err(failed)?);
    let closed = (|| {
        wait_until_over(&bench, &args.name)?;
        let attempts = bench.write_season(&args.name, &mut file)?;
        file.into_inner().map_err(|e| failed(e.into_error()))?.sync_all().map_err(failed)?;
        std::fs::rename(&beside, &args.out).map_err(failed)?;
        Ok::<_, Failure>(attempts)
    })();
    let attempts = closed.inspect_err(|_| drop(std::fs::remove_file(&beside)))?;
    let (name, archive) = (&args.name, args.out.display());
    if args.common.json {
        return write_json(&json!({"season": name, "attempts": attempts, "archive": args.out}), out);
    }
    writeln!(out, "season {name} is closed; {attempts} attempts and its secret are in {archive}")?;
    Ok(())
}

/// Closes the season and waits for the attempts that are under way.
fn wait_until_over(bench: &Bench, name: &str) -> Outcome {
    let bar = ProgressBar::new_spinner();
    loop {
        let left = bench.close_season(name)?.under_way;
        if left == 0 {
            bar.finish_and_clear();
            return Ok(());
        }
        bar.set_message(format!(
            "season {name} takes no more attempts; {left} under way, which end within 30 minutes"
        ));
        bar.tick();
        std::thread::sleep(Duration::from_secs(1));
    }
}

fn check(args: &VerifyArgs, out: &mut dyn Write) -> Outcome {
    let bench = Bench::open_existing(&args.archive)?;
    let key = bench.public_key();
    if args.key.as_ref().is_some_and(|expected| !expected.eq_ignore_ascii_case(&key)) {
        return Err(Failure::Failed(format!("the archive is signed with another key, {key}")));
    }
    let seasons = bench.seasons()?;
    let season = seasons.first().ok_or_else(|| Failure::Failed("no season is in it".into()))?;
    let (found, _) = verify::all(&bench)?;
    if args.json {
        write_json(&json!({"season": season, "public_key": key, "attempts": found}), out)?;
    } else {
        let (name, count) = (&season.document.name, found.len());
        let table = verify::table(&found);
        writeln!(out, "{table}season {name}: {count} attempts, none missing, signed with {key}")?;
    }
    match found.iter().filter(|v| v.verdict == Verdict::Wrong).count() {
        0 => Ok(()),
        wrong => Err(Failure::Failed(format!("{wrong} of {} attempts are wrong", found.len()))),
    }
}

fn table(seasons: &[SeasonRow]) -> Table<&SeasonRow> {
    Table::from_rows(seasons)
        .words("season", |s| &s.document.name)
        .words("begun", |s| moment(s.document.begun_ms))
        .words("until", |s| or_dash(s.document.until_ms.map(moment)))
        .words("closed", |s| or_dash(s.closed_ms.map(moment)))
        .values("under way", |s| s.under_way)
        .values("scenarios", |s| s.document.scenarios.len())
        .words("SHA-256 of the secret", |s| &s.document.secret_sha256)
}
