//! One connection that speaks `crazyflie.v1`: requests in, replies out, in order. A request is carried out where it is read.

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use tokio_util::sync::CancellationToken;
use tracing::{debug, info};

use super::contest::Contest;
use super::fault::{Code, Fault};
use super::listed::End;
use super::make;
use super::message::{self, Asked, Hello, Resume};
use super::pilot::Pilot;
use super::replies::Reply;
use super::requests::{refusal, say};
use super::server::{Peer, Server};
use super::server_message::ServerMessage;
use super::session::Session;
use super::shared::Join;
use super::socket::{Incoming, Parting, Socket};
use super::wire::{self, Request};
use super::worlds;

pub(crate) struct Connection {
    server: Arc<Server>,
    peer: Arc<Peer>,
    /// Cancelled when the server stops or another connection resumes the session.
    leave: CancellationToken,
    session: Option<Session>,
    /// In place of a session.
    contest: Option<Contest>,
    /// At the controls of one drone of a shared world; whoever is gone leaves it to the autopilot.
    pilot: Option<Pilot>,
}

/// Serves a connection to its end.
pub(crate) async fn talk(server: Arc<Server>, peer: Arc<Peer>, mut socket: Socket, leave: CancellationToken) {
    let mut connection = Connection { server, peer, leave, session: None, contest: None, pilot: None };
    let parting = loop {
        let reply = match socket.next().await {
            Ok(Incoming::Text(text)) => connection.text(&text).await,
            Ok(Incoming::Binary(bytes)) => connection.binary(&bytes),
            Err(parting) => break parting,
        };
        if let Err(parting) = socket.send(reply.into()).await {
            break parting;
        }
    };
    connection.part(socket, parting).await;
}

impl Connection {
    async fn part(mut self, socket: Socket, parting: Parting) {
        let stopping = self.server.stop.is_cancelled();
        info!(peer = %self.peer.address, ?parting, "connection ended");
        // the session first: a client that comes back at once finds it
        if let Some(session) = self.session.take() {
            match parting {
                Parting::Closed(Some(1000)) => session.finish(End::Closed),
                _ if stopping => session.finish(End::Stopped),
                _ => self.server.park(session),
            }
        }
        socket.goodbye(&parting, &self.server).await;
    }

    fn binary(&mut self, bytes: &Bytes) -> Reply {
        let began = Instant::now();
        let drones = self.session.as_ref().filter(|_| self.contest.is_none()).map_or(1, |session| session.layout.drones);
        let answer = Request::parse(bytes, drones).and_then(|request| match &mut self.contest {
            Some(contest) => contest.binary(&request),
            None => self.session.as_mut().ok_or_else(no_session)?.binary(&request),
        });
        self.answered(began, wire::id_of(bytes), answer)
    }

    async fn text(&mut self, text: &str) -> Reply {
        let began = Instant::now();
        let (id, asked) = message::parse(text);
        let answer = match (id, asked) {
            (Some(id), Ok(asked)) => self.carry_out(id, asked).await,
            (_, Ok(_)) => Err(Fault::new(Code::BadMessage, "a request needs an id")),
            (_, Err(fault)) => Err(fault),
        };
        self.answered(began, id, answer)
    }

    fn answered(&self, began: Instant, id: Option<u64>, answer: Result<Reply, Fault>) -> Reply {
        let metrics = &self.server.metrics;
        metrics.requests.inc();
        metrics.request_s.observe(began.elapsed().as_secs_f64());
        answer.unwrap_or_else(|fault| {
            metrics.faults.inc();
            debug!(peer = %self.peer.address, id, code = ?fault.code, "refused: {fault}");
            refusal(id, &fault)
        })
    }

    async fn carry_out(&mut self, id: u64, asked: Asked) -> Result<Reply, Fault> {
        match asked {
            Asked::Hello(hello) => self.hello(id, hello),
            Asked::Make(make) => {
                let (session, made) = make::make(&self.server, id, &make)?;
                self.take(session);
                Ok(say(&ServerMessage::Made(Box::new(made))))
            }
            Asked::Resume(resume) => self.resume(id, &resume).await,
            Asked::Benchmark(asked) => {
                let bench = self.server.bench.as_ref();
                let bench = bench.ok_or_else(|| Fault::new(Code::Unavailable, "this server has no benchmark"))?;
                let (contest, reply) = Contest::begin(bench, id, &asked)?;
                if let Some(before) = self.session.take() {
                    before.finish(End::Closed);
                }
                self.contest = Some(contest);
                Ok(reply)
            }
            Asked::Finish => {
                let none = || Fault::new(Code::NoSession, "this connection has no attempt: send benchmark first");
                self.contest.take().ok_or_else(none)?.finish(id)
            }
            Asked::Close if self.contest.take().is_some() => Ok(say(&ServerMessage::Closed { id })),
            Asked::Close => {
                let session = self.session.take().ok_or_else(no_session)?;
                session.finish(End::Closed);
                Ok(say(&ServerMessage::Closed { id }))
            }
            Asked::Reset(reset) => self.session.as_mut().ok_or_else(no_session)?.reset(id, &reset),
            Asked::Step(step) if let Some(contest) = &mut self.contest => contest.step(id, &step),
            Asked::Step(step) => {
                let session = self.session.as_mut().ok_or_else(no_session)?;
                session.step(id, &step)
            }
            Asked::State => self.session.as_mut().ok_or_else(no_session)?.state(id),
            Asked::World(asked) => Ok(say(&ServerMessage::World(worlds::found(&self.server, id, &asked)?))),
            Asked::Join(join) => self.join(id, join).await,
            Asked::Fly(fly) => self.pilot.as_ref().ok_or_else(no_seat)?.fly(id, &fly).await,
            Asked::Leave => self.pilot.take().map(|_| say(&ServerMessage::Left { id })).ok_or_else(no_seat),
        }
    }

    async fn join(&mut self, id: u64, asked: Join) -> Result<Reply, Fault> {
        if let Some(pilot) = &self.pilot {
            return Err(Fault::new(Code::BadMessage, format!("this connection flies {}: leave it first", pilot.place())));
        }
        let (pilot, reply) = Pilot::join(&self.server.worlds, id, asked).await?;
        self.pilot = Some(pilot);
        Ok(reply)
    }

    fn hello(&self, id: u64, hello: Hello) -> Result<Reply, Fault> {
        if let Some(token) = &hello.token {
            self.peer.show(token)?;
        }
        info!(peer = %self.peer.address, client = ?hello.client.chars().take(80).collect::<String>(), "hello");
        Ok(say(&ServerMessage::Welcome(make::welcome(&self.server, id))))
    }

    /// A connection has one session: the one before ends.
    fn take(&mut self, session: Session) {
        session.listed().hold(&self.leave);
        self.contest = None;
        if let Some(before) = self.session.replace(session) {
            before.finish(End::Closed);
        }
    }

    async fn resume(&mut self, id: u64, asked: &Resume) -> Result<Reply, Fault> {
        if self.session.as_ref().is_some_and(|session| session.listed().name() == asked.session) {
            return Err(Fault::new(Code::BadMessage, "this connection has that session"));
        }
        let session = self.server.sessions.resume(&asked.session, &asked.token).await?;
        let (session_name, last_id, ticks) = (session.listed().name(), session.last_id(), session.ticks());
        info!(session = session_name, peer = %self.peer.address, "session resumed");
        self.take(session);
        Ok(say(&ServerMessage::Resumed { id, session: session_name, last_id, ticks }))
    }
}

fn no_session() -> Fault {
    Fault::new(Code::NoSession, "this connection has no session: send make (or resume) first")
}

fn no_seat() -> Fault {
    Fault::new(Code::NoSeat, "this connection flies no drone: send join first")
}
