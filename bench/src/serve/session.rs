//! An attempt over a connection: all its episodes in lock-step, and the signed row at the end. Score, clock
//! and seeds stay with the server. A connection that is lost before `finish` leaves an attempt that is listed
//! as abandoned.

use crazyflie_env::vector::StepBuffers;
use crazyflie_server::protocol::{Code, Fields, ProtocolError, Rows};
use crazyflie_server::serve::{Batch, Begun, Reply};
use tokio::task::block_in_place;
use tracing::error;

use super::Counters;
use super::protocol::{AttemptInfo, Benchmark, Finish, Response};
use crate::{Attempt, AttemptSpec, Bench, EntryName, Submitter, api};

struct AttemptSession {
    bench: Bench,
    counters: Counters,
    attempt: Attempt,
    is_finished: bool,
}

/// Begins an attempt. The reply has the action ranges and the first observations.
///
/// # Errors
/// Those of the benchmark: its scenario, its token, its limits.
pub(super) fn begin(
    bench: &Bench,
    counters: &Counters,
    id: u64,
    request: &Benchmark,
) -> Result<Begun, ProtocolError> {
    let entry = EntryName { controller: &request.controller, is_new: request.new_entry };
    let attempt = block_in_place(|| bench.begin(&request.scenario, Submitter::Token(&request.token), entry))?;
    let (rows, width, scenario) = (attempt.rows()?, attempt.width()?, attempt.scenario());
    let AttemptSpec { interface, tick_s, drones, .. } = attempt.spec()?;
    let reply = Reply::json(&Response::Begun(Box::new(AttemptInfo {
        id,
        attempt: attempt.id().into(),
        scenario: scenario.id(),
        scenario_hash: scenario.hash().into(),
        num_envs: rows,
        drones,
        width,
        tick_s,
        interface,
        phases: scenario.planned_phases().into(),
        observation: Rows { numbers: attempt.observations()?.into(), width },
    })));
    counters.begun.inc();
    let (bench, counters) = (bench.clone(), counters.clone());
    let batch = Box::new(AttemptSession { bench, counters, attempt, is_finished: false });
    Ok(Begun { batch, rows, width, reply })
}

impl Batch for AttemptSession {
    fn step(&mut self, actions: &[f32], out: StepBuffers<'_>) -> Result<bool, ProtocolError> {
        Ok(self.attempt.step(actions, out)?)
    }

    /// Handles `finish`: scores, signs and stores; the answer follows when the row is on the disk. If it cannot be
    /// stored, the request may be repeated.
    ///
    /// # Errors
    /// `attempt_under_way` before the last episode is over: the attempt is then abandoned.
    fn request(&mut self, id: u64, fields: &Fields<'_>) -> Result<Reply, ProtocolError> {
        let Finish {} = fields.read()?;
        let (bench, attempt) = (&self.bench, &mut self.attempt);
        let stored =
            block_in_place(|| attempt.finish().and_then(|document| api::attempt(bench, &document.id)));
        let stored = stored.inspect_err(|problem| {
            if problem.status() >= 500 {
                error!(attempt = self.attempt.id(), %problem, "the attempt cannot be stored; its client may try again");
            }
        })?;
        self.is_finished = true;
        self.counters.finished.inc();
        let attempt = serde_json::from_slice(&stored.bytes)
            .map_err(|e| ProtocolError::new(Code::Unavailable, e.to_string()))?;
        Ok(Reply::json(&Response::Finished { id, attempt }))
    }

    fn is_closed(&self) -> bool {
        self.is_finished || self.attempt.is_closed()
    }
}

impl Drop for AttemptSession {
    fn drop(&mut self) {
        if !self.is_finished {
            self.counters.abandoned.inc();
        }
    }
}
