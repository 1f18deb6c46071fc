//! Seasons: scenarios that are frozen for a while, with a secret of their own. Its hash is published at the beginning
//! and the secret at the end, so that anybody can fly every attempt again.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::error::{Error, Result};
use super::names::check_team;
use super::record::{AttemptRow, Document};
use super::scenario::{self, Scenario};
use super::secrets::{Secrets, canonical, random, sha256_hex};
use super::{BUILD, Bench, now_ms};

/// The document signed and published when a season begins.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SeasonDocument {
    /// Name that no other season has.
    pub name: String,
    /// Milliseconds since 1970, UTC.
    pub begun_ms: i64,
    /// From then on no attempt counts; none for a season that is closed by hand.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until_ms: Option<i64>,
    /// `name@version` and hash of each scenario.
    pub scenarios: Vec<(String, String)>,
    /// SHA-256 of the secret that seeds and hidden effects are drawn from.
    pub secret_sha256: String,
    /// Fingerprint of the program's sources.
    pub build: String,
}

/// A season as the database knows it.
#[derive(Clone)]
pub(super) struct StoredSeason {
    pub document: Vec<u8>,
    pub signature: Vec<u8>,
    pub secret: [u8; 32],
    pub closed_ms: Option<i64>,
}

impl StoredSeason {
    /// Reads the document that was signed at its beginning; does not check the signature.
    fn document(&self) -> Result<SeasonDocument> {
        serde_json::from_slice(&self.document).map_err(|e| Error::Damaged(format!("season: {e}")))
    }
}

/// A season with what follows from its secret.
pub(super) struct Season {
    pub document: SeasonDocument,
    pub secrets: Secrets,
    pub closed_ms: Option<i64>,
    /// Those of the season, as its secret makes them.
    pub scenarios: Vec<Scenario>,
}

/// A season as others may see it.
#[derive(Debug, Clone, Serialize)]
pub struct SeasonRow {
    /// The document that was signed at its beginning.
    #[serde(flatten)]
    pub document: SeasonDocument,
    /// When it was closed; none while it is open.
    pub closed_ms: Option<i64>,
    /// Attempts at it that are not over yet.
    pub under_way: usize,
    /// The secret, in hex, once it is closed and no attempt is under way.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub secret: Option<String>,
}

impl Season {
    fn read(stored: &StoredSeason, keys: &Secrets) -> Result<Season> {
        let damaged = |what: String| Error::Damaged(format!("season: {what}"));
        if !keys.is_signature_valid(&stored.document, &stored.signature) {
            return Err(damaged("the signature does not fit the document".into()));
        }
        let document = stored.document()?;
        if sha256_hex(&stored.secret) != document.secret_sha256 {
            return Err(damaged("the secret is not the one whose hash was published".into()));
        }
        let secrets = keys.with_secret(stored.secret);
        let is_member = |scenario: &Scenario| document.scenarios.iter().any(|(id, _)| *id == scenario.id());
        let scenarios = scenario::read_all(&secrets)?.into_iter().filter(is_member).collect();
        Ok(Season { document, secrets, closed_ms: stored.closed_ms, scenarios })
    }

    /// Returns whether an attempt at a scenario that begins now is part of it.
    pub(super) fn takes(&self, scenario: &str, now_ms: i64) -> bool {
        let is_open = self.closed_ms.is_none() && self.document.until_ms.is_none_or(|until| now_ms < until);
        is_open && self.scenarios.iter().any(|other| other.id() == scenario)
    }

    /// `running` are the attempts under way.
    fn row(&self, running: &[AttemptRow]) -> SeasonRow {
        let is_part = |row: &&AttemptRow| {
            let document: Option<Document> = serde_json::from_slice(&row.document).ok();
            document.is_some_and(|document| document.season.as_ref() == Some(&self.document.name))
        };
        let under_way = running.iter().filter(is_part).count();
        let secret = self.closed_ms.filter(|_| under_way == 0).map(|_| self.secrets.secret_hex());
        SeasonRow { document: self.document.clone(), closed_ms: self.closed_ms, under_way, secret }
    }
}

impl Bench {
    /// Begins a season of these scenarios. Attempts at them are part of it until it is closed.
    ///
    /// # Errors
    /// [`Error::Season`] if one is open or has had this name, [`Error::Name`], [`Error::Scenario`].
    pub fn begin_season(&self, name: &str, scenarios: &[String], until_ms: Option<i64>) -> Result<SeasonRow> {
        check_team(name).map_err(|_| Error::Name {
            what: "season",
            name: name.escape_debug().to_string(),
            want: "1 to 32 letters, digits, '-', '_' or '.'",
        })?;
        let refuse = |problem: String| Err(Error::Season { name: name.into(), problem });
        for season in self.seasons()? {
            if season.document.name == name {
                return refuse("there was one of this name".into());
            }
            if season.closed_ms.is_none() {
                return refuse(format!("the season {} is open: close it first", season.document.name));
            }
        }
        if until_ms.is_some_and(|until| until <= now_ms()) {
            return refuse("it would be over before it begins".into());
        }
        let ids = scenarios.iter().map(|name| Ok(self.scenario(name)?.id())).collect::<Result<Vec<_>>>()?;
        let secret = random::<32>()?;
        let own = scenario::read_all(&self.0.secrets.with_secret(secret))?;
        let hash =
            |id: &String| own.iter().find(|s| s.id() == *id).map(|s| (id.clone(), s.hash().to_owned()));
        let document = SeasonDocument {
            name: name.into(),
            begun_ms: now_ms(),
            until_ms,
            scenarios: ids.iter().filter_map(hash).collect(),
            secret_sha256: sha256_hex(&secret),
            build: BUILD.into(),
        };
        let bytes = canonical(&document)?;
        let signature = self.0.secrets.sign(&bytes)?.to_vec();
        let stored = StoredSeason { document: bytes, signature, secret, closed_ms: None };
        self.store().add_season(name, &stored)?;
        Ok(Season::read(&stored, &self.0.secrets)?.row(&[]))
    }

    /// Closes a season, unless it is closed already: no attempt begins as a part of it any more. Those under way end
    /// within 30 minutes, finished or abandoned; call it again to see how many are left. The secret is in the row
    /// once there are none.
    ///
    /// # Errors
    /// [`Error::Season`] if there is none of the name.
    pub fn close_season(&self, name: &str) -> Result<SeasonRow> {
        self.sweep()?;
        self.store().close_season(name, now_ms())?;
        self.season_row(name)
    }

    pub(super) fn season_row(&self, name: &str) -> Result<SeasonRow> {
        let season = self.season(name)?.ok_or_else(|| no_season(name))?;
        Ok(season.row(&self.running()?))
    }

    fn running(&self) -> Result<Vec<AttemptRow>> {
        self.store().running_since_before(i64::MAX)
    }

    /// Every season, in the order in which they were begun.
    pub fn seasons(&self) -> Result<Vec<SeasonRow>> {
        let stored = self.store().seasons()?;
        let running = self.running()?;
        stored.iter().map(|stored| Ok(Season::read(stored, &self.0.secrets)?.row(&running))).collect()
    }

    pub(super) fn season(&self, name: &str) -> Result<Option<Arc<Season>>> {
        let Some(stored) = self.stored_season(name)? else { return Ok(None) };
        // to read sixty scenarios takes a while, and a season changes once
        let mut cached = self.0.season.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let known =
            |season: &&Arc<Season>| season.document.name == name && season.closed_ms == stored.closed_ms;
        if let Some(season) = cached.as_ref().filter(known) {
            return Ok(Some(season.clone()));
        }
        Ok(Some(cached.insert(Arc::new(Season::read(&stored, &self.0.secrets)?)).clone()))
    }

    /// The newest season of this name, as the database knows it.
    pub(super) fn stored_season(&self, name: &str) -> Result<Option<StoredSeason>> {
        let mut season = None;
        for stored in self.store().seasons()? {
            if stored.document()?.name == name {
                season = Some(stored);
            }
        }
        Ok(season)
    }

    /// The season that is not closed.
    pub(super) fn open_season(&self) -> Result<Option<Arc<Season>>> {
        let stored = self.store().seasons()?;
        let Some(newest) = stored.last().filter(|season| season.closed_ms.is_none()) else { return Ok(None) };
        self.season(&newest.document()?.name)
    }

    /// The scenario of an attempt and the seeds of its episodes; none if this build does not have the scenario.
    pub(super) fn flown(&self, document: &Document) -> Result<Option<(Scenario, Vec<u64>)>> {
        let season = match &document.season {
            Some(name) => Some(self.season(name)?.ok_or_else(|| {
                Error::Damaged(format!("attempt {}: its season {name} is missing", document.id))
            })?),
            None => None,
        };
        let (scenarios, secrets) =
            season.as_ref().map_or((self.all_scenarios(), &self.0.secrets), |season| {
                (&season.scenarios[..], &season.secrets)
            });
        let same = |s: &&Scenario| s.id() == document.scenario && s.hash() == document.scenario_hash;
        let Some(scenario) = scenarios.iter().find(same) else { return Ok(None) };
        let seeds = secrets.seeds(&document.id, &document.scenario_hash, scenario.episodes())?;
        Ok(Some((scenario.clone(), seeds)))
    }
}

pub(super) fn no_season(name: &str) -> Error {
    Error::Season { name: name.into(), problem: "there is none of this name".into() }
}
