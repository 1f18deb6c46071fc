//! The place where another part of the program plugs into a server: requests, paths and counters of its own,
//! and batches of environments that it flies in place of a connection's session. The server knows nothing of
//! what they are about.

use std::sync::Arc;

use axum::Router;
use crazyflie_env::vector::StepBuffers;
use prometheus_client::registry::Registry;
use serde_json::{Map, Value};
use tokio::sync::Semaphore;

use super::replies::Reply;
use crate::protocol::{Fields, ProtocolError};

/// A part of the program that a server offers besides environments and worlds (see
/// [`super::Settings::extension`]).
pub trait Extension: Send + Sync {
    /// Its name in `/api/v1/extensions`.
    fn name(&self) -> &'static str;

    /// Types of its requests. The first one begins a batch; the others are about the batch that the
    /// connection has.
    fn requests(&self) -> &'static [&'static str];

    /// Returns whether it knows a token, so that whoever shows it has a share of its own.
    fn knows_token(&self, token: &str) -> bool;

    /// Fields that it adds to `welcome`.
    fn welcome(&self) -> Map<String, Value>;

    /// Returns its paths below `/api/v1`, which precede the server's own. A handler that simulates flights for an
    /// answer waits for one of `turns`, and keeps it meanwhile.
    fn routes(self: Arc<Self>, turns: Arc<Semaphore>) -> Router;

    /// Adds its counters to those of `/metrics`.
    fn register(&self, registry: &mut Registry);

    /// Begins a batch. It is called where a step may take long, within a runtime of several threads.
    ///
    /// # Errors
    /// The extension's own; the connection is as before.
    fn begin(&self, id: u64, fields: &Fields<'_>) -> Result<Begun, ProtocolError>;
}

/// A batch that has begun, and its reply.
pub struct Begun {
    /// The batch.
    pub batch: Box<dyn Batch>,
    /// Rows of actions and of observations.
    pub rows: usize,
    /// Numbers in a row of observations.
    pub width: usize,
    /// Reply to the request.
    pub reply: Reply,
}

/// Environments in lock-step that an extension flies for one connection. Dropped when the connection ends.
pub trait Batch: Send {
    /// Flies one tick of all of them: four numbers for each row of `actions`. Returns whether the last
    /// episode has ended.
    ///
    /// # Errors
    /// The extension's own, before anything moves.
    fn step(&mut self, actions: &[f32], out: StepBuffers<'_>) -> Result<bool, ProtocolError>;

    /// Carries out a request of the extension about this batch.
    ///
    /// # Errors
    /// The extension's own.
    fn request(&mut self, id: u64, fields: &Fields<'_>) -> Result<Reply, ProtocolError>;

    /// Returns whether there is nothing left to do, so that the connection can drop it.
    fn is_closed(&self) -> bool;
}
