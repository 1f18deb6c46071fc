//! The task that owns a shared world. A tick is flown as soon as every pilot has given its action, or when
//! the deadline has passed; without a pilot in the air the world goes on in real time for a while, by the autopilot,
//! and ends if nobody joins.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crazyflie_env::action::ACTION;
use subtle::ConstantTimeEq;
use tokio::sync::mpsc::UnboundedReceiver;
use tokio::sync::oneshot;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;
use tracing::{error, info};

use super::budget::Share;
use super::metrics::SessionEnd;
use super::moment::Moment;
use super::pilot::{SlotKey, WorldCommand};
use super::session_registry::SessionSlot;
use super::settings::Limits;
use super::worlds::{WorldEntry, WorldState};
use super::{lock, random_secret};
use crate::protocol::{Code, Join, Numbers, ProtocolError, SlotInfo, TickResult, WorldRequest};
use crate::worlds::ActionSource;

struct PilotSlot {
    secret: [u8; 16],
    /// The last action that was obeyed.
    last: Option<[f32; ACTION]>,
    pending: Option<PendingAction>,
    /// When it last gave an action, or joined.
    heard: Moment,
}

struct PendingAction {
    action: [f32; ACTION],
    answer: oneshot::Sender<Result<TickResult<'static>, ProtocolError>>,
}

pub(crate) struct World {
    entry: Arc<WorldEntry>,
    slot: SessionSlot,
    /// Shares of the worlds and of their work; given back when the world is over.
    _shares: [Share; 2],
    inbox: UnboundedReceiver<WorldCommand>,
    /// By drone.
    pilot_slots: Vec<Option<PilotSlot>>,
    request: WorldRequest,
    limits: Limits,
    tick: Duration,
    begun: bool,
    /// When the tick began.
    since: Instant,
    founded: Moment,
    /// When there was last a pilot in the air.
    piloted: Moment,
}

impl World {
    pub(crate) fn new(
        entry: Arc<WorldEntry>,
        slot: SessionSlot,
        shares: [Share; 2],
        inbox: UnboundedReceiver<WorldCommand>,
        request: WorldRequest,
        limits: &Limits,
    ) -> World {
        let (drones, tick_s) = {
            let state = lock(&entry.state);
            (state.flight.drones(), state.flight.tick_s())
        };
        World {
            entry,
            slot,
            _shares: shares,
            inbox,
            pilot_slots: (0..drones).map(|_| None).collect(),
            request,
            limits: limits.clone(),
            tick: Duration::from_secs_f64(tick_s),
            begun: false,
            since: Instant::now(),
            founded: Moment::now(),
            piloted: Moment::now(),
        }
    }

    pub(crate) async fn run(mut self, stop: CancellationToken) {
        info!(world = self.entry.name, "world founded");
        let end = loop {
            if !self.is_ready() {
                let wake = self.wake();
                tokio::select! {
                    biased;
                    () = stop.cancelled() => break SessionEnd::Stopped,
                    command = self.inbox.recv() => {
                        match command {
                            Some(command) => self.execute(command),
                            None => break SessionEnd::Broken,
                        }
                        continue;
                    }
                    () = sleep_until(wake) => {}
                }
            }
            self.dismiss_silent_pilots();
            if self.flying_pilots().next().is_some() {
                self.piloted = Moment::now();
            }
            let is_forgotten = match self.begun {
                true => self.piloted.elapsed() > self.limits.world_unpiloted,
                false => self.founded.elapsed() >= self.limits.world_waits,
            };
            if is_forgotten {
                break SessionEnd::Expired;
            }
            if !self.begun {
                continue;
            }
            match self.fly() {
                Ok(true) => {}
                Ok(false) => break SessionEnd::Closed,
                Err(bug) => {
                    error!(world = self.entry.name, %bug, "the world broke");
                    break SessionEnd::Broken;
                }
            }
        };
        self.entry.over.store(true, Ordering::Release);
        self.slot.end = end;
        info!(world = self.entry.name, ?end, ticks = lock(&self.entry.state).flight.ticks, "world over");
    }

    /// Hands the drones of pilots that have given no action for too long to the autopilot.
    fn dismiss_silent_pilots(&mut self) {
        let silent: Vec<usize> = self
            .pilot_slots
            .iter()
            .enumerate()
            .filter(|(_, slot)| {
                slot.as_ref().is_some_and(|slot| {
                    slot.pending.is_none() && slot.heard.elapsed() > self.limits.pilot_silence
                })
            })
            .map(|(drone, _)| drone)
            .collect();
        for drone in silent {
            info!(world = self.entry.name, drone, "the pilot is silent: the autopilot takes over");
            self.release(drone);
        }
    }

    /// Hands a drone to the autopilot.
    fn release(&mut self, drone: usize) {
        self.pilot_slots[drone] = None;
        let mut state = lock(&self.entry.state);
        state.flight.take_over(drone);
        state.by[drone] = ActionSource::Autopilot;
    }

    /// When the next tick is flown at the latest; before the first one, when the world has waited long enough for it.
    fn wake(&self) -> Instant {
        match (self.begun, self.flying_pilots().next()) {
            (false, _) => Instant::now() + self.limits.world_waits.saturating_sub(self.founded.elapsed()),
            (true, Some(_)) => self.since + Duration::from_secs_f64(self.request.deadline_s),
            (true, None) => self.since + self.tick,
        }
    }

    /// The slots of the pilots whose drones fly.
    fn flying_pilots(&self) -> impl Iterator<Item = &PilotSlot> {
        let flying: Vec<bool> = lock(&self.entry.state).flight.batch.flying.clone();
        self.pilot_slots
            .iter()
            .zip(flying)
            .filter(|(_, flying)| *flying)
            .filter_map(|(slot, _)| slot.as_ref())
    }

    /// Returns whether every pilot in the air has given its action.
    fn is_ready(&self) -> bool {
        self.begun
            && self.flying_pilots().next().is_some()
            && self.flying_pilots().all(|slot| slot.pending.is_some())
    }

    fn execute(&mut self, command: WorldCommand) {
        // the client may be gone by now, so a failed answer is ignored
        match command {
            WorldCommand::Join { id, request, answer } => drop(answer.send(self.join(id, &request))),
            WorldCommand::Fly { key, action, answer } => match self.pilot_slot(key) {
                Ok(slot) => {
                    slot.pending = Some(PendingAction { action, answer });
                    slot.heard = Moment::now();
                }
                Err(error) => drop(answer.send(Err(error))),
            },
            WorldCommand::Leave { key } => {
                if self.pilot_slots[key.drone].as_ref().is_some_and(|slot| slot.secret == key.secret) {
                    self.release(key.drone);
                }
            }
        }
    }

    /// The pilot slot that a key is for.
    fn pilot_slot(&mut self, key: SlotKey) -> Result<&mut PilotSlot, ProtocolError> {
        if !lock(&self.entry.state).flight.batch.flying[key.drone] {
            return Err(flight_ended(key.drone));
        }
        let slot = self.pilot_slots[key.drone].as_mut().filter(|slot| slot.secret == key.secret);
        slot.ok_or_else(|| slot_lost(key.drone))
    }

    fn check_invitation(&self, shown: Option<&str>) -> Result<(), ProtocolError> {
        let Some(invitation) = &self.request.invitation else { return Ok(()) };
        let fits = shown.is_some_and(|shown| shown.as_bytes().ct_eq(invitation.as_bytes()).into());
        ProtocolError::unless(fits, Code::NotInvited, || {
            let world = &self.entry.name;
            format!("the world {world:?} is joined by invitation: ask whoever founded it for the word")
        })
    }

    fn join(&mut self, id: u64, request: &Join) -> Result<(SlotKey, SlotInfo<'static>), ProtocolError> {
        self.check_invitation(request.invitation.as_deref())?;
        let drone = self.choose_drone(request.drone, request.token.as_deref())?;
        let secret = random_secret()?;
        let last = self.pilot_slots[drone].take().and_then(|before| {
            if let Some(pending) = before.pending {
                let _ = pending.answer.send(Err(slot_lost(drone)));
            }
            before.last
        });
        self.pilot_slots[drone] = Some(PilotSlot { secret, last, pending: None, heard: Moment::now() });
        if !self.begun && self.pilot_slots.iter().flatten().count() >= self.request.pilots {
            (self.begun, self.since) = (true, Instant::now());
            self.pilot_slots.iter_mut().flatten().for_each(|slot| slot.heard = Moment::now());
        }
        let mut state = lock(&self.entry.state);
        state.by[drone] = ActionSource::Pilot;
        let flight = &state.flight;
        let slot = SlotInfo {
            id,
            world: self.entry.name.clone().into(),
            drone,
            drones: flight.drones(),
            token: hex::encode(secret),
            tick: flight.ticks,
            tick_s: flight.tick_s(),
            deadline_s: self.request.deadline_s,
            interface: flight.batch.env.interfaces()[drone],
            observation: Numbers(flight.observation(drone).to_vec().into()),
        };
        Ok((SlotKey { drone, secret }, slot))
    }

    /// The drone that is requested if it can be taken, or the first that is free.
    fn choose_drone(&self, requested: Option<usize>, token: Option<&str>) -> Result<usize, ProtocolError> {
        let state = lock(&self.entry.state);
        let flying = &state.flight.batch.flying;
        let Some(drone) = requested else {
            let free =
                self.pilot_slots.iter().zip(flying).position(|(slot, flying)| slot.is_none() && *flying);
            return free
                .ok_or_else(|| ProtocolError::new(Code::NoFreeDrone, "every drone that flies has a pilot"));
        };
        let max = flying.len() - 1;
        let flies = flying.get(drone).ok_or_else(|| {
            ProtocolError::new(Code::UnknownDrone, format!("drone is {drone}, expected 0 to {max}"))
        })?;
        if !flies {
            return Err(flight_ended(drone));
        }
        let mine = |slot: &PilotSlot| {
            token.is_some_and(|token| hex::encode(slot.secret).as_bytes().ct_eq(token.as_bytes()).into())
        };
        ProtocolError::unless(self.pilot_slots[drone].as_ref().is_none_or(mine), Code::DroneTaken, || {
            format!("drone {drone} has a pilot; with its token it is yours")
        })?;
        Ok(drone)
    }

    /// Flies a tick. False if no drone flies any more.
    fn fly(&mut self) -> crazyflie_env::Result<bool> {
        let mut state = lock(&self.entry.state);
        let WorldState { flight, log, by } = &mut *state;
        let (mut pending, mut answers) = (vec![None; self.pilot_slots.len()], Vec::new());
        for (drone, slot) in self.pilot_slots.iter_mut().enumerate() {
            by[drone] = match (flight.batch.flying[drone], slot) {
                (false, _) => ActionSource::Nobody,
                (true, None) => ActionSource::Autopilot,
                (true, Some(slot)) => {
                    let now = slot.pending.take();
                    let late = now.is_none();
                    if let Some(now) = now {
                        slot.last = Some(now.action);
                        answers.push((drone, now.answer));
                    }
                    pending[drone] = slot.last;
                    if late { ActionSource::Late } else { ActionSource::Pilot }
                }
            };
        }
        flight.step(&pending)?;
        log.push(flight, by);
        self.slot.count_steps(1);
        self.slot.entry.feed.show_shared(flight);
        self.since = Instant::now();
        // the name is free before clients receive the last tick
        self.entry.over.store(flight.is_over(), Ordering::Release);
        for (drone, answer) in answers {
            let over = TickResult {
                tick: flight.ticks,
                observation: Numbers(flight.observation(drone).to_vec().into()),
                reward: flight.batch.rewards[drone].into(),
                terminated: flight.batch.terminated[drone],
                truncated: flight.batch.truncated[drone],
                flying: flight.batch.flying[drone],
                late: log.late[drone],
            };
            // a client that is gone hears nothing, and leaves by itself
            let _ = answer.send(Ok(over));
        }
        Ok(!flight.is_over())
    }
}

fn flight_ended(drone: usize) -> ProtocolError {
    ProtocolError::new(Code::DroneEnded, format!("the flight of drone {drone} has ended"))
}

fn slot_lost(drone: usize) -> ProtocolError {
    ProtocolError::new(Code::SeatLost, format!("drone {drone} was taken over by another connection"))
}
