//! Controllers against scenarios: the leaderboards of all scenarios in one table.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::{Bench, LeaderboardRow, Result};

/// Rows that are shown, the best.
const MOST_ROWS: usize = 100;

/// Body of `GET /api/v1/overview`.
#[derive(Debug, Serialize)]
pub(super) struct Overview {
    /// In the order of the scores of each row.
    scenarios: Vec<ScenarioHead>,
    /// The largest sum of scores first; a scenario that was not flown counts as 0.
    rows: Vec<OverviewRow>,
    /// Rows beyond the most that are shown.
    left_out: usize,
}

#[derive(Debug, Serialize)]
struct ScenarioHead {
    id: String,
    title: String,
}

/// A controller of a team.
#[derive(Debug, Serialize)]
struct OverviewRow {
    controller: String,
    team: String,
    /// None where there is no attempt.
    scores: Vec<Option<OverviewScore>>,
}

/// A controller's score on the leaderboard of a scenario.
#[derive(Debug, Clone, Serialize)]
struct OverviewScore {
    /// None for an entry with too few attempts.
    rank: Option<usize>,
    attempt: String,
    score: f64,
    failed: usize,
    episodes: usize,
}

impl From<LeaderboardRow> for OverviewScore {
    fn from(row: LeaderboardRow) -> Self {
        let LeaderboardRow { rank, attempt, score, .. } = row;
        OverviewScore { rank, attempt, score: score.score, failed: score.failed, episodes: score.episodes }
    }
}

/// # Errors
/// The errors of the database.
pub(super) fn overview(bench: &Bench) -> Result<Overview> {
    let count = bench.scenarios().len();
    let mut rows = BTreeMap::<(String, String), Vec<Option<OverviewScore>>>::new();
    let mut scenarios = Vec::with_capacity(count);
    for (at, scenario) in bench.scenarios().iter().enumerate() {
        scenarios.push(ScenarioHead { id: scenario.id(), title: scenario.title().to_owned() });
        for row in bench.leaderboard(scenario)? {
            let scores = rows.entry((row.controller.clone(), row.team.clone()));
            scores.or_insert_with(|| vec![None; count])[at] = Some(row.into());
        }
    }
    let mut rows: Vec<OverviewRow> = rows
        .into_iter()
        .map(|((controller, team), scores)| OverviewRow { controller, team, scores })
        .collect();
    // the sort is stable: rows of equal sums stay in the order of their names
    rows.sort_by(|a, b| b.sum().total_cmp(&a.sum()));
    let left_out = rows.len().saturating_sub(MOST_ROWS);
    rows.truncate(MOST_ROWS);
    Ok(Overview { scenarios, rows, left_out })
}

impl OverviewRow {
    fn sum(&self) -> f64 {
        self.scores.iter().flatten().map(|cell| cell.score).sum()
    }
}
