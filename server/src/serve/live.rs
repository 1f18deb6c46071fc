//! `/live`: a session watched as it runs. Header, then the newest row, at most thirty times a second; what a slow watcher misses is gone.

use std::sync::Arc;
use std::time::Duration;

use serde::Deserialize;
use serde_json::json;
use tokio::time::{MissedTickBehavior, interval};
use tokio_tungstenite::tungstenite::Message;

use super::fault::{Code, Fault};
use super::feed::WATCHABLE;
use super::listed::Listed;
use super::replies::Reply;
use super::requests::refusal;
use super::server::Server;
use super::socket::{Incoming, Parting, Socket};

pub(crate) const PROTOCOL: &str = "crazyflie.live.v1";
const PERIOD: Duration = Duration::from_micros(33_334);

#[derive(Debug, Deserialize)]
pub(crate) struct Wish {
    /// Null to watch nothing.
    watch: Option<String>,
    #[serde(default)]
    env: usize,
}

/// What to do after a watch has come to its end.
enum Next {
    Watch(Arc<Listed>, usize),
    Nothing,
}

pub(crate) async fn talk(server: Arc<Server>, mut socket: Socket) {
    let mut next = Next::Nothing;
    let parting = loop {
        let turn = match next {
            Next::Nothing => match socket.next().await {
                Ok(incoming) => choose(&server, &mut socket, incoming).await,
                Err(parting) => Err(parting),
            },
            Next::Watch(listed, env) => watch(&server, &mut socket, &listed, env).await,
        };
        next = match turn {
            Ok(next) => next,
            Err(parting) => break parting,
        };
    };
    socket.goodbye(&parting, &server).await;
}

/// What the client wants to see.
async fn choose(server: &Server, socket: &mut Socket, incoming: Incoming) -> Result<Next, Parting> {
    match wish(server, &incoming) {
        Ok(next) => Ok(next),
        Err(fault) => {
            socket.send(refusal(None, &fault).into()).await?;
            Ok(Next::Nothing)
        }
    }
}

/// # Errors
/// What is not a message.
pub(crate) fn parse(text: &str) -> Result<Wish, Fault> {
    serde_json::from_str(text).map_err(|e| {
        let code = if e.is_data() { Code::BadMessage } else { Code::BadJson };
        Fault::new(code, format!("expected {{\"watch\": session, \"env\"?: number}}: {e}"))
    })
}

fn wish(server: &Server, incoming: &Incoming) -> Result<Next, Fault> {
    let Incoming::Text(text) = incoming else { return Err(Fault::new(Code::BadMessage, "expected {\"watch\": session}")) };
    let wish = parse(text)?;
    let Some(name) = wish.watch else { return Ok(Next::Nothing) };
    let unknown = || Fault::new(Code::UnknownSession, format!("there is no session {name:?}"));
    let listed = server.sessions.find(&name).ok_or_else(unknown)?;
    let most = listed.batch().min(WATCHABLE);
    if wish.env >= most {
        return Err(Fault::new(Code::BadMessage, format!("env is {}, of this session 0 to {} can be watched", wish.env, most - 1)));
    }
    Ok(Next::Watch(listed, wish.env))
}

/// Until the client wants something else or the session is over.
async fn watch(server: &Server, socket: &mut Socket, listed: &Listed, env: usize) -> Result<Next, Parting> {
    let _watching = listed.feed.watch();
    socket.send(Message::binary(header(listed, env))).await?;
    let mut seen = 0;
    let mut beat = interval(PERIOD);
    // rows that were missed are not made up for
    beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            incoming = socket.next() => return choose(server, socket, incoming?).await,
            _ = beat.tick() => {}
        }
        if let Some(row) = listed.feed.newer(env, &mut seen) {
            socket.send(Message::binary(bytemuck::cast_slice::<f32, u8>(&row).to_vec())).await?;
            socket.flush().await?;
        }
        if server.sessions.find(&listed.name()).is_none() {
            let ended = Reply::Text(json!({"type": "ended", "session": listed.name()}).to_string().into());
            socket.send(ended.into()).await?;
            return Ok(Next::Nothing);
        }
    }
}

/// Length and JSON, padded so that the rows that follow are aligned in a file.
fn header(listed: &Listed, env: usize) -> Vec<u8> {
    let mut about = listed.feed.header.clone();
    about["session"] = listed.name().into();
    about["env"] = env.into();
    about["env_id"] = listed.env.clone().into();
    let text = about.to_string();
    let mut bytes = (text.len() as u32).to_le_bytes().to_vec();
    bytes.extend(text.as_bytes());
    bytes.resize(bytes.len().next_multiple_of(4), b' ');
    bytes
}
