//! Explanations compared with the truth. The truth of a case is read after its explanation is there.

use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Result, anyhow};
use crazyflie_env::model::Model;
use crazyflie_identify::case::Case;
use crazyflie_identify::explain::logs::{ExplainedLogs, explain_logs};

use crate::case_file::CaseFile;
use crate::oracle::compare_with_oracle;
use crate::record::CaseRecord;
use crate::row_file::RowFile;

/// Schedule of the cases that are scored side by side.
#[derive(Debug, Clone, Copy)]
pub struct Schedule {
    pub jobs: usize,
    /// Threads within each case.
    pub threads: usize,
    pub with_oracle: bool,
}

/// Scores cases side by side, each job on threads of its own, so that the seconds of a case are its own. Rows in the
/// file are taken from it, others are added to it. The records are in the order of the cases.
pub fn score_all(cases: &[CaseFile], schedule: Schedule, rows: Option<&RowFile>) -> Result<Vec<CaseRecord>> {
    let next = AtomicUsize::new(0);
    let run_job = || -> Result<Vec<(usize, CaseRecord)>> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(schedule.threads).build()?;
        let mut scored = Vec::new();
        loop {
            let place = next.fetch_add(1, Ordering::Relaxed);
            let Some(case) = cases.get(place) else { return Ok(scored) };
            let record = match rows.and_then(|rows| rows.find(case)) {
                Some(kept) => kept.clone(),
                None => {
                    let record = pool.install(|| score(case, schedule.with_oracle))?;
                    rows.map_or(Ok(()), |rows| rows.push(&record))?;
                    record
                }
            };
            // a long run that is cut off has said what it found
            eprintln!("{}/{} {record}", place + 1, cases.len());
            scored.push((place, record));
        }
    };
    let mut scored = std::thread::scope(|scope| {
        let jobs: Vec<_> = (0..schedule.jobs).map(|_| scope.spawn(run_job)).collect();
        let ends = jobs.into_iter().map(|job| job.join().unwrap_or_else(|_| Err(anyhow!("a job panicked"))));
        ends.collect::<Result<Vec<_>>>()
    })?
    .concat();
    scored.sort_by_key(|(place, _)| *place);
    Ok(scored.into_iter().map(|(_, record)| record).collect())
}

/// Explains a case, then reads the truth beside it.
fn score(file: &CaseFile, with_oracle: bool) -> Result<CaseRecord> {
    let explained = explain(file);
    let truth = file.check()?;
    Ok(match explained {
        Err(problem) => CaseRecord::new(file, Err(format!("{problem:#}")), truth, None),
        Ok((model, logs)) => {
            let oracle = with_oracle.then(|| compare_with_oracle(&model, &logs, &truth)).flatten();
            CaseRecord::new(file, Ok(&logs.found), truth, oracle)
        }
    })
}

fn explain(file: &CaseFile) -> Result<(Model, ExplainedLogs)> {
    let case = Case::read(&file.path)?;
    let model = case.model()?;
    let logs = explain_logs(
        &model,
        None,
        [&[case.identify_on], &[case.held_out]],
        &crazyflie_identify::ReadOptions::default(),
        &|_| {},
    )?;
    Ok((model, logs))
}
