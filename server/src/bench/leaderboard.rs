//! The leaderboard. One row per team and controller, by the median of all its attempts at a scenario: trying
//! until luck comes does not help, and an attempt that was abandoned counts as 0, so that going away when it
//! goes badly does not help either.

use std::collections::BTreeMap;

use serde::Serialize;

use super::error::Result;
use super::metrics::Metrics;
use super::record::{Document, Status};
use super::score::Score;
use super::{Bench, Scenario};

/// A row of the leaderboard.
#[derive(Debug, Clone, Serialize)]
pub struct LeaderboardRow {
    /// Place, from 1 on; rows of the same score share it.
    pub rank: usize,
    /// The attempt that stands for all of them: the middle one, the worse of two.
    pub attempt: String,
    /// Name under which it was submitted.
    pub controller: String,
    /// Owner of the token, or "local".
    pub team: String,
    /// Score of the middle attempt, with its interval; 0 where that was abandoned.
    #[serde(flatten)]
    pub score: Score,
    /// None where the middle attempt was abandoned.
    #[serde(flatten)]
    pub metrics: Option<Metrics>,
    /// Count of the attempts that the row stands for, abandoned ones too.
    pub attempts: usize,
    pub(crate) abandoned: usize,
    /// When the attempt was begun, seconds since 1970.
    pub at: f64,
    /// Of the attempt's document, in hex.
    pub signature: String,
    pub(crate) build: String,
}

impl Bench {
    /// The best first; rows that were tampered with are left out.
    pub fn leaderboard(&self, scenario: &Scenario) -> Result<Vec<LeaderboardRow>> {
        let mut groups = BTreeMap::<(String, String), Vec<(Document, Vec<u8>)>>::new();
        for entry in self.attempts(Some(&scenario.id()))? {
            let Ok(document) = entry.document else { continue };
            if document.status != Status::Running && document.scenario_hash == scenario.hash() {
                groups
                    .entry((document.team.clone(), document.controller.clone()))
                    .or_default()
                    .push((document, entry.signature));
            }
        }
        let mut rows: Vec<LeaderboardRow> =
            groups.into_values().filter_map(|group| median_row(group, scenario)).collect();
        rows.sort_by(|a, b| b.score.score.total_cmp(&a.score.score));
        let scores: Vec<f64> = rows.iter().map(|row| row.score.score).collect();
        rows.iter_mut()
            .for_each(|row| row.rank = 1 + scores.iter().filter(|score| **score > row.score.score).count());
        Ok(rows)
    }
}

fn median_row(mut group: Vec<(Document, Vec<u8>)>, scenario: &Scenario) -> Option<LeaderboardRow> {
    let score = |document: &Document| document.result.as_ref().map_or(0.0, |result| result.score.score);
    group.sort_by(|(a, _), (b, _)| score(a).total_cmp(&score(b)));
    let attempts = group.len();
    let abandoned = group.iter().filter(|(document, _)| document.status == Status::Abandoned).count();
    let (document, signature) = group.into_iter().nth(attempts.checked_sub(1)? / 2)?;
    let nothing = Score {
        score: 0.0,
        low: 0.0,
        high: 0.0,
        median: 0.0,
        failed: scenario.episodes(),
        episodes: scenario.episodes(),
    };
    let (score, metrics) =
        document.result.map_or((nothing, None), |result| (result.score, Some(result.metrics)));
    Some(LeaderboardRow {
        rank: 0,
        attempt: document.id,
        controller: document.controller,
        team: document.team,
        score,
        metrics,
        attempts,
        abandoned,
        at: document.begun_ms as f64 / 1000.0,
        signature: hex::encode(signature),
        build: document.build,
    })
}
