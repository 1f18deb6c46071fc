//! `/live`: a session watched as it runs. Header, then the newest row, at most thirty times a second; what a
//! slow watcher misses is gone.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;
use serde_json::json;
use tokio::time::{MissedTickBehavior, interval};
use tokio_tungstenite::tungstenite::Message;

use super::feed::WATCHABLE;
use super::replies::Reply;
use super::server::Server;
use super::session_registry::SessionEntry;
use super::session_requests::error_reply;
use super::socket::{Disconnect, Incoming, Socket};
use crate::protocol::fields::plain_words;
use crate::protocol::{Code, ProtocolError};

pub(crate) const PROTOCOL: &str = "crazyflie.live.v1";
const PERIOD: Duration = Duration::from_micros(33_334);

/// A request to watch a session.
#[derive(Debug, Deserialize)]
#[serde(rename = "Wish")]
pub(crate) struct WatchRequest {
    /// Null to watch nothing.
    watch: Option<String>,
    #[serde(default)]
    env: usize,
}

/// The session and the environment that a client watches, if any.
type Watched = Option<(Arc<SessionEntry>, usize)>;

/// # Errors
/// The way in which the connection ends.
pub(crate) async fn serve_socket(server: &Server, socket: &mut Socket) -> Result<Infallible, Disconnect> {
    let mut watched = None;
    loop {
        watched = match watched {
            None => {
                let incoming = socket.next().await?;
                next_watched(server, socket, incoming).await?
            }
            Some((entry, env)) => watch(server, socket, &entry, env).await?,
        };
    }
}

/// Returns the session that a message of the client names, if any.
async fn next_watched(
    server: &Server,
    socket: &mut Socket,
    incoming: Incoming,
) -> Result<Watched, Disconnect> {
    match requested(server, &incoming) {
        Ok(next) => Ok(next),
        Err(error) => {
            socket.send(error_reply(None, &error).into()).await?;
            Ok(None)
        }
    }
}

/// # Errors
/// Text that is no message.
pub(crate) fn parse(text: &str) -> Result<WatchRequest, ProtocolError> {
    serde_json::from_str(text).map_err(|e| {
        let code = if e.is_data() { Code::BadMessage } else { Code::BadJson };
        let problem = plain_words(&e.to_string());
        ProtocolError::new(code, format!("expected {{\"watch\": session, \"env\"?: number}}: {problem}"))
    })
}

fn requested(server: &Server, incoming: &Incoming) -> Result<Watched, ProtocolError> {
    let Incoming::Text(text) = incoming else {
        return Err(ProtocolError::new(Code::BadMessage, "expected {\"watch\": session}"));
    };
    let request = parse(text)?;
    let Some(name) = request.watch else { return Ok(None) };
    let unknown = || ProtocolError::new(Code::UnknownSession, format!("there is no session {name:?}"));
    let entry = server.sessions.find(&name).ok_or_else(unknown)?;
    let max = entry.batch().min(WATCHABLE);
    ProtocolError::unless(request.env < max, Code::BadMessage, || {
        format!("env is {}, of this session 0 to {} can be watched", request.env, max - 1)
    })?;
    Ok(Some((entry, request.env)))
}

/// Until the client wants something else or the session is over.
async fn watch(
    server: &Server,
    socket: &mut Socket,
    entry: &SessionEntry,
    env: usize,
) -> Result<Watched, Disconnect> {
    let _watching = entry.feed.watch();
    socket.send(Message::binary(header(entry, env))).await?;
    let mut seen = 0;
    let mut beat = interval(PERIOD);
    // rows that were missed are not made up for
    beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            incoming = socket.next() => return next_watched(server, socket, incoming?).await,
            _ = beat.tick() => {}
        }
        if let Some(row) = entry.feed.newer(env, &mut seen) {
            socket.send(Message::binary(bytemuck::cast_slice::<f32, u8>(&row).to_vec())).await?;
            socket.flush().await?;
        }
        if server.sessions.find(&entry.name()).is_none() {
            let ended = Reply::Text(json!({"type": "ended", "session": entry.name()}).to_string().into());
            socket.send(ended.into()).await?;
            return Ok(None);
        }
    }
}

/// Length and JSON, padded so that the rows that follow are aligned in a file.
fn header(entry: &SessionEntry, env: usize) -> Vec<u8> {
    let mut header = entry.feed.header.clone();
    header["session"] = entry.name().into();
    header["env"] = env.into();
    header["env_id"] = entry.env.clone().into();
    let text = header.to_string();
    let mut bytes = (text.len() as u32).to_le_bytes().to_vec();
    bytes.extend(text.as_bytes());
    bytes.resize(bytes.len().next_multiple_of(4), b' ');
    bytes
}
