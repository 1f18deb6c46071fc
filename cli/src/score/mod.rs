//! Explanations held against the truth. The truth of a case is read after its explanation is there.

mod folder;
mod oracle;
mod rates;
mod record;
mod results;
mod rows;
mod sensitivity;
mod truth;

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::explanation::{DeclaredModel, ExplainError, Run};
use crate::text::with_cause;

use folder::CaseFileError;
pub(crate) use folder::{CaseFile, find_cases};
pub(crate) use rates::{CRITERIA, EffectRow, Rate, Rates, Stratum, ValueStatistics};
pub(crate) use record::{Answer, CaseRecord, NamedEffect, WORST_RATIO};
pub(crate) use results::{Provenance, Results};
pub(crate) use rows::RowFile;
pub(crate) use sensitivity::{FACTORS, measure_sensitivity};
pub(crate) use truth::{Group, HiddenEffect};

/// Explains a case, then reads the truth beside it.
fn score(file: &CaseFile, with_oracle: bool, progress: &dyn Fn(&str)) -> Result<CaseRecord, CaseFileError> {
    let run = explain(file, progress);
    let truth = file.check()?;
    let (id, folder) = (file.id.clone(), file.folder.clone());
    Ok(match run {
        Err(problem) => CaseRecord::from_failure(id, folder, problem, truth),
        Ok(run) => {
            let oracle = with_oracle.then(|| {
                progress("the oracle");
                oracle::compare_with_oracle(&run, &truth)
            });
            CaseRecord::from_explanation(id, folder, &run.found, truth, oracle.flatten())
        }
    })
}

fn explain(file: &CaseFile, progress: &dyn Fn(&str)) -> Result<Run, String> {
    let explained = |e: ExplainError| with_cause(&e);
    let declared = DeclaredModel::read(&file.path).map_err(explained)?;
    let case = declared.case.ok_or_else(|| format!("{}: not a case file", file.path.display()))?;
    Run::explain_flights(declared.model, None, [&[case.identify_on], &[case.held_out]], progress)
        .map_err(explained)
}

/// Schedule of the cases that are scored side by side.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Schedule {
    pub jobs: usize,
    /// Threads within each case.
    pub threads: usize,
    pub with_oracle: bool,
}

/// Scores cases side by side, each job on threads of its own, so that the seconds of a case are its own.
/// `done` is told of each as it ends and may stop the run; the records are in the order of the cases.
pub(crate) fn score_all(
    cases: &[CaseFile],
    schedule: Schedule,
    progress: &(dyn Fn(&CaseFile, &str) + Sync),
    done: &(dyn Fn(&CaseRecord) -> Result<(), String> + Sync),
) -> Result<Vec<CaseRecord>, String> {
    let next = AtomicUsize::new(0);
    let results = Mutex::new(vec![None; cases.len()]);
    let run_job = || -> Result<(), String> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(schedule.threads).build();
        let pool = pool.map_err(|e| format!("no threads for a job: {e}"))?;
        while let Some((at, case)) =
            Some(next.fetch_add(1, Ordering::Relaxed)).and_then(|at| Some((at, cases.get(at)?)))
        {
            let record = pool.install(|| score(case, schedule.with_oracle, &|stage| progress(case, stage)));
            let record = record.map_err(|e| with_cause(&e))?;
            done(&record)?;
            results.lock().unwrap_or_else(std::sync::PoisonError::into_inner)[at] = Some(record);
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let jobs: Vec<_> = (0..schedule.jobs.max(1)).map(|_| scope.spawn(run_job)).collect();
        let ends = jobs.into_iter().map(|job| job.join().unwrap_or_else(|_| Err("a job panicked".into())));
        ends.collect::<Result<Vec<()>, String>>()
    })?;
    let results = results.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    Ok(results.into_iter().flatten().collect())
}
