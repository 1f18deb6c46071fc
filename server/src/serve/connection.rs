//! One connection that speaks `crazyflie.v1`: requests in, replies out, in order. A request is carried out
//! where it is read.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use tokio_util::sync::CancellationToken;
use tracing::{debug, info, warn};

use super::batch_session::BatchSession;
use super::create_session;
use super::create_world::create_world;
use super::metrics::SessionEnd;
use super::pilot::Pilot;
use super::replies::Reply;
use super::server::{Peer, Server};
use super::session::Session;
use super::session_requests::{SessionRequest, error_reply};
use super::socket::{Disconnect, Incoming, Socket};
use super::turns::is_long;
use super::wire::{self, BinaryRequest};
use crate::protocol::{self, Code, Fields, Hello, Join, Message, ProtocolError, Request, Response, Resume};

pub(crate) struct Connection {
    server: Arc<Server>,
    peer: Arc<Peer>,
    /// Cancelled when the server stops or another connection resumes the session.
    leave: CancellationToken,
    session: Option<Session>,
    /// A batch of an extension, in place of a session.
    batch: Option<BatchSession>,
    /// A drone of a shared world that this client flies. When the connection ends, the autopilot takes over.
    pilot: Option<Pilot>,
}

/// Serves a connection to its end.
///
/// # Errors
/// The way in which it ends.
pub(crate) async fn serve_socket(
    peer: Arc<Peer>,
    socket: &mut Socket,
    leave: CancellationToken,
) -> Result<Infallible, Disconnect> {
    let server = peer.server.clone();
    let mut connection = Connection { server, peer, leave, session: None, batch: None, pilot: None };
    let ended = connection.answer_all(socket).await;
    ended.inspect_err(|disconnect| connection.shut_down(disconnect))
}

impl Connection {
    async fn answer_all(&mut self, socket: &mut Socket) -> Result<Infallible, Disconnect> {
        loop {
            let reply = match socket.next().await? {
                Incoming::Text(text) => self.text(&text).await,
                Incoming::Binary(bytes) => self.binary(&bytes).await,
            };
            socket.send(reply.into()).await?;
        }
    }

    fn shut_down(&mut self, disconnect: &Disconnect) {
        if self.may_log("connection ended") {
            info!(peer = %self.peer.address, parting = ?disconnect, "connection ended");
        }
        let Some(session) = self.session.take() else { return };
        match disconnect {
            Disconnect::Closed(Some(1000)) => session.finish(SessionEnd::Closed),
            _ if self.server.stop.is_cancelled() => session.finish(SessionEnd::Stopped),
            _ => self.server.park(session),
        }
    }

    fn may_log(&self, about: &'static str) -> bool {
        self.server.metrics.may_log(about, self.peer.payer().address)
    }

    async fn binary(&mut self, bytes: &Bytes) -> Reply {
        let start = Instant::now();
        let answer = self.binary_answer(bytes).await;
        self.reply_or_error(start, wire::id_of(bytes), answer)
    }

    async fn binary_answer(&mut self, bytes: &Bytes) -> Result<Reply, ProtocolError> {
        if let Some(batch) = &mut self.batch {
            let request = BinaryRequest::parse(bytes, 1)?;
            let _turn = self.peer.queue.turn(false).await;
            return batch.binary(&request);
        }
        let drones = self.session.as_ref().map_or(1, |session| session.layout.drones);
        let request = BinaryRequest::parse(bytes, drones)?;
        self.session_request(request.id, SessionRequest::Binary(&request)).await
    }

    async fn session_request(
        &mut self,
        id: u64,
        request: SessionRequest<'_>,
    ) -> Result<Reply, ProtocolError> {
        let session = self.session.as_mut().ok_or_else(no_session)?;
        let mut turn = self.peer.queue.turn(is_long(session.layout.rows(), request.steps())).await;
        session.execute(id, request, &mut turn).await
    }

    async fn text(&mut self, text: &str) -> Reply {
        let start = Instant::now();
        let extension = self.server.settings.extension.as_ref();
        let (id, message) = protocol::parse(text, extension.map_or(&[], |extension| extension.requests()));
        let answer = match (id, message) {
            (Some(id), Ok(Message::Request(request))) => self.execute(id, request).await,
            (Some(id), Ok(Message::Extension(fields))) => self.extension_request(id, &fields).await,
            (_, Ok(_)) => Err(ProtocolError::new(Code::BadMessage, "a request needs an id")),
            (_, Err(error)) => Err(error),
        };
        self.reply_or_error(start, id, answer)
    }

    fn reply_or_error(&self, start: Instant, id: Option<u64>, answer: Result<Reply, ProtocolError>) -> Reply {
        let metrics = &self.server.metrics;
        metrics.requests.inc();
        metrics.request_s.observe(start.elapsed().as_secs_f64());
        answer.unwrap_or_else(|error| {
            metrics.faults.inc();
            debug!(peer = %self.peer.address, id, code = ?error.code, "refused: {error}");
            error_reply(id, &error)
        })
    }

    async fn execute(&mut self, id: u64, request: Request) -> Result<Reply, ProtocolError> {
        let peer = self.peer.clone();
        let turn = |long: bool| peer.queue.turn(long);
        match request {
            Request::Hello(hello) => self.hello(id, hello),
            Request::Make(make) => {
                let _turn = turn(is_long(make.num_envs, 1)).await;
                let (session, info) = create_session::create_session(&self.server, peer.payer(), id, &make)?;
                self.replace_session(session);
                Ok(Reply::json(&Response::Made(Box::new(info))))
            }
            Request::Resume(resume) => self.resume(id, &resume).await,
            Request::Close if self.batch.take().is_some() => Ok(Reply::json(&Response::Closed { id })),
            Request::Close => {
                let session = self.session.take().ok_or_else(no_session)?;
                session.finish(SessionEnd::Closed);
                Ok(Reply::json(&Response::Closed { id }))
            }
            Request::Reset(reset) => self.session_request(id, SessionRequest::Reset(&reset)).await,
            Request::Step(step) if let Some(batch) = &mut self.batch => {
                let _turn = turn(false).await;
                batch.step(id, &step)
            }
            Request::Step(step) => self.session_request(id, SessionRequest::Step(&step)).await,
            Request::State => self.session_request(id, SessionRequest::State).await,
            Request::World(request) => {
                let _turn = turn(false).await;
                let info = create_world(&self.server, peer.payer(), id, *request)?;
                Ok(Reply::json(&Response::World(info)))
            }
            Request::Join(join) => self.join(id, join).await,
            Request::Fly(fly) => self.pilot.as_ref().ok_or_else(no_pilot_slot)?.fly(id, &fly).await,
            Request::Leave => {
                self.pilot.take().map(|_| Reply::json(&Response::Left { id })).ok_or_else(no_pilot_slot)
            }
        }
    }

    /// Begins a batch of the extension, or carries out a request about the one that there is.
    async fn extension_request(&mut self, id: u64, fields: &Fields<'_>) -> Result<Reply, ProtocolError> {
        let begins = |kind: &&str| *kind == fields.kind();
        let extension = self.server.settings.extension.as_ref();
        if let Some(extension) = extension.filter(|e| e.requests().first().is_some_and(begins)) {
            let _turn = self.peer.queue.turn(false).await;
            let (batch, reply) = BatchSession::new(extension.begin(id, fields)?);
            if let Some(before) = self.session.take() {
                before.finish(SessionEnd::Closed);
            }
            self.batch = Some(batch);
            return Ok(reply);
        }
        let none = || {
            let problem = format!("{}: nothing has begun on this connection", fields.kind());
            ProtocolError::new(Code::NoSession, problem)
        };
        let batch = &mut self.batch.as_mut().ok_or_else(none)?.batch;
        let answer = batch.request(id, fields);
        if batch.is_closed() {
            self.batch = None;
        }
        answer
    }

    async fn join(&mut self, id: u64, request: Join) -> Result<Reply, ProtocolError> {
        if let Some(pilot) = &self.pilot {
            let problem = format!("this connection flies {}: leave it first", pilot.label());
            return Err(ProtocolError::new(Code::BadMessage, problem));
        }
        let guess = request.invitation.is_some();
        if guess {
            self.count_guess()?;
        }
        let joined = Pilot::join(&self.server.worlds, id, request).await;
        let wrong = joined.as_ref().err().is_some_and(|error| error.code == Code::NotInvited);
        if guess && !wrong {
            self.server.guesses.give_back(&self.peer.payer().address);
        } else if guess && self.may_log("invitation") {
            warn!(peer = %self.peer.address, "a wrong invitation");
        }
        let (pilot, reply) = joined?;
        self.pilot = Some(pilot);
        Ok(reply)
    }

    /// Counts an invitation that is shown; one that fits is given back.
    ///
    /// # Errors
    /// `too_many` if the address has shown too many wrong ones.
    fn count_guess(&self) -> Result<(), ProtocolError> {
        let address = self.peer.payer().address;
        if self.server.guesses.take(address) > 0 {
            return Ok(());
        }
        self.server.metrics.record_limit("too many wrong invitations", address);
        let problem = "too many wrong invitations from your address: expected at most 30 a minute";
        Err(ProtocolError::new(Code::TooMany, problem))
    }

    fn hello(&self, id: u64, hello: Hello) -> Result<Reply, ProtocolError> {
        if let Some(token) = &hello.token {
            self.peer.count_token(token)?;
        }
        if self.may_log("hello") {
            info!(peer = %self.peer.address, client = ?hello.client.chars().take(80).collect::<String>(), "hello");
        }
        Ok(Reply::json(&Response::Welcome(create_session::server_info(&self.server, id))))
    }

    /// Makes this the connection's session. The one before ends.
    fn replace_session(&mut self, session: Session) {
        session.slot.entry.hold(&self.leave);
        self.batch = None;
        if let Some(before) = self.session.replace(session) {
            before.finish(SessionEnd::Closed);
        }
    }

    async fn resume(&mut self, id: u64, request: &Resume) -> Result<Reply, ProtocolError> {
        if self.session.as_ref().is_some_and(|session| session.slot.entry.name() == request.session) {
            return Err(ProtocolError::new(Code::BadMessage, "this connection has that session"));
        }
        let session = self.server.sessions.resume(&request.session, &request.token).await?;
        let (session_name, last_id, ticks) =
            (session.slot.entry.name(), session.replies.last, session.ticks());
        if self.may_log("session resumed") {
            info!(session = session_name, peer = %self.peer.address, "session resumed");
        }
        self.replace_session(session);
        Ok(Reply::json(&Response::Resumed { id, session: session_name, last_id, ticks }))
    }
}

fn no_session() -> ProtocolError {
    ProtocolError::new(Code::NoSession, "this connection has no session: send make (or resume) first")
}

fn no_pilot_slot() -> ProtocolError {
    ProtocolError::new(Code::NoSeat, "this connection flies no drone: send join first")
}
