//! The leaderboard. A team is ranked by its entry, the name that it used last, and an entry by the median of all
//! attempts under this name: repeating until one succeeds does not help. An abandoned attempt counts as 0, so that
//! leaving a bad flight does not help either. Another name does not help: an entry has no rank before it has
//! [`RANKED_FROM`] attempts, and removes the rank of the one before. Users at the server itself (the team "local")
//! have an entry for every name, to compare controllers.

use std::collections::BTreeMap;

use serde::Serialize;

use super::error::Result;
use super::metrics::Metrics;
use super::names::LOCAL;
use super::record::{Document, Status};
use super::score::Score;
use super::seasons::no_season;
use super::{Bench, Scenario};

/// Attempts from which a team's entry has a rank: the median of fewer is luck to a good part.
pub(crate) const RANKED_FROM: usize = 5;

/// A row of the leaderboard.
#[derive(Debug, Clone, Serialize)]
pub struct LeaderboardRow {
    /// Place, from 1 on; rows of the same score share it. None for an entry with too few attempts.
    pub rank: Option<usize>,
    /// The attempt that represents all of them: the middle one, the worse of two.
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
    /// Count of the attempts of the row, abandoned ones too.
    pub attempts: usize,
    pub(crate) abandoned: usize,
    /// The names that the team used before, which have no rank, the newest first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub former: Vec<FormerEntry>,
    /// When the attempt was begun, seconds since 1970.
    pub at: f64,
    /// Signature of the attempt's document, in hex.
    pub signature: String,
    pub(crate) build: String,
}

/// A name that a team used before its entry.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FormerEntry {
    /// Name under which it was submitted.
    pub controller: String,
    /// Count of its attempts.
    pub attempts: usize,
    /// Median of their scores.
    pub score: f64,
}

impl Bench {
    /// The best first, those without a rank last; rows that were tampered with are left out.
    pub fn leaderboard(&self, scenario: &Scenario) -> Result<Vec<LeaderboardRow>> {
        self.board(scenario, |_| true)
    }

    /// The leaderboards of a season, of each of its scenarios.
    ///
    /// # Errors
    /// [`super::Error::Season`] if there is none of this name.
    pub fn season_leaderboards(&self, name: &str) -> Result<Vec<(String, Vec<LeaderboardRow>)>> {
        let season = self.season(name)?.ok_or_else(|| no_season(name))?;
        let board = |scenario: &Scenario| {
            let is_part = |document: &Document| document.season.as_deref() == Some(name);
            Ok((scenario.id(), self.board(scenario, is_part)?))
        };
        season.scenarios.iter().map(board).collect()
    }

    fn board(&self, scenario: &Scenario, counts: impl Fn(&Document) -> bool) -> Result<Vec<LeaderboardRow>> {
        let mut groups = BTreeMap::<(String, String), Vec<(Document, Vec<u8>)>>::new();
        for entry in self.attempts(Some(&scenario.id()))? {
            let Ok(document) = entry.document else { continue };
            let is_over = document.status != Status::Running;
            if is_over && document.scenario_hash == scenario.hash() && counts(&document) {
                groups
                    .entry((document.team.clone(), document.controller.clone()))
                    .or_default()
                    .push((document, entry.signature));
            }
        }
        let newest = |group: &[(Document, Vec<u8>)]| group.iter().map(|(document, _)| document.number).max();
        let mut dated: Vec<_> = groups.into_values().map(|group| (newest(&group), group)).collect();
        dated.sort_by_key(|(number, _)| std::cmp::Reverse(*number));
        let mut rows: Vec<LeaderboardRow> = Vec::new();
        for row in dated.into_iter().filter_map(|(_, group)| median_row(group, scenario)) {
            match rows.iter_mut().find(|entry| entry.team == row.team && row.team != LOCAL) {
                Some(entry) => entry.former.push(FormerEntry {
                    controller: row.controller,
                    attempts: row.attempts,
                    score: row.score.score,
                }),
                None => rows.push(row),
            }
        }
        rank(&mut rows);
        Ok(rows)
    }
}

/// Sorts the rows and gives those their places that have one.
fn rank(rows: &mut [LeaderboardRow]) {
    let has_rank = |row: &LeaderboardRow| row.team == LOCAL || row.attempts >= RANKED_FROM;
    rows.sort_by(|a, b| has_rank(b).cmp(&has_rank(a)).then_with(|| b.score.score.total_cmp(&a.score.score)));
    let scores: Vec<f64> = rows.iter().filter(|row| has_rank(row)).map(|row| row.score.score).collect();
    for row in rows.iter_mut().filter(|row| has_rank(row)) {
        row.rank = Some(1 + scores.iter().filter(|score| **score > row.score.score).count());
    }
}

fn median_row(mut group: Vec<(Document, Vec<u8>)>, scenario: &Scenario) -> Option<LeaderboardRow> {
    let score = |document: &Document| document.result.as_ref().map_or(0.0, |result| result.score.score);
    group.sort_by(|(a, _), (b, _)| score(a).total_cmp(&score(b)));
    let attempts = group.len();
    let abandoned = group.iter().filter(|(document, _)| document.status == Status::Abandoned).count();
    let (document, signature) = group.into_iter().nth(attempts.checked_sub(1)? / 2)?;
    let nothing = Score { failed: scenario.episodes(), episodes: scenario.episodes(), ..Score::default() };
    let (score, metrics) =
        document.result.map_or((nothing, None), |result| (result.score, Some(result.metrics)));
    Some(LeaderboardRow {
        rank: None,
        attempt: document.id,
        controller: document.controller,
        team: document.team,
        score,
        metrics,
        attempts,
        abandoned,
        former: Vec::new(),
        at: document.begun_ms as f64 / 1000.0,
        signature: hex::encode(signature),
        build: document.build,
    })
}
