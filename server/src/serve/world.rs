//! The task that owns a shared world. A tick is flown as soon as every pilot has given its action, or when the deadline has passed; without a
//! pilot in the air the world goes on in real time, by the autopilot.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crazyflie_env::observation::ACTION;
use subtle::ConstantTimeEq;
use tokio::sync::mpsc::UnboundedReceiver;
use tokio::sync::oneshot;
use tokio::time::{Instant, sleep_until};
use tokio_util::sync::CancellationToken;
use tracing::{error, info};

use super::fault::{Code, Fault};
use super::listed::{End, Place, lock};
use super::pilot::{Key, Order, Over, Taken};
use super::shared::Founding;
use super::worlds::{Flown, Known};
use crate::worlds::By;

struct Seat {
    secret: [u8; 16],
    /// The last action that was obeyed.
    last: Option<[f32; ACTION]>,
    given: Option<Given>,
}

struct Given {
    action: [f32; ACTION],
    answer: oneshot::Sender<Result<Over, Fault>>,
}

pub(crate) struct World {
    known: Arc<Known>,
    place: Place,
    inbox: UnboundedReceiver<Order>,
    /// By drone.
    seats: Vec<Option<Seat>>,
    /// So many must have joined before the first tick.
    pilots: usize,
    deadline: Duration,
    tick: Duration,
    begun: bool,
    /// When the tick began; until the first one, when the world was founded.
    since: Instant,
    waits: Duration,
}

impl World {
    pub(crate) fn new(known: Arc<Known>, place: Place, inbox: UnboundedReceiver<Order>, asked: &Founding, waits: Duration) -> World {
        let (drones, tick_s) = {
            let flown = lock(&known.flown);
            (flown.flight.drones(), flown.flight.tick_s())
        };
        World {
            known,
            place,
            inbox,
            seats: (0..drones).map(|_| None).collect(),
            pilots: asked.pilots,
            deadline: Duration::from_secs_f64(asked.deadline_s),
            tick: Duration::from_secs_f64(tick_s),
            begun: false,
            since: Instant::now(),
            waits,
        }
    }

    pub(crate) async fn run(mut self, stop: CancellationToken) {
        info!(world = self.known.name, "world founded");
        let end = loop {
            if !self.ready() {
                let wake = self.since + self.patience();
                tokio::select! {
                    biased;
                    () = stop.cancelled() => break End::Stopped,
                    order = self.inbox.recv() => {
                        match order {
                            Some(order) => self.obey(order),
                            None => break End::Broken,
                        }
                        continue;
                    }
                    () = sleep_until(wake) => {}
                }
            }
            if !self.begun {
                break End::Expired;
            }
            match self.fly() {
                Ok(true) => {}
                Ok(false) => break End::Closed,
                Err(bug) => {
                    error!(world = self.known.name, %bug, "the world broke");
                    break End::Broken;
                }
            }
        };
        self.known.over.store(true, Ordering::Release);
        self.place.end = end;
        info!(world = self.known.name, ?end, ticks = lock(&self.known.flown).flight.ticks, "world over");
    }

    /// How long the tick may last at most; before the first one, how long the world waits for it.
    fn patience(&self) -> Duration {
        match (self.begun, self.aloft().next()) {
            (false, _) => self.waits,
            (true, Some(_)) => self.deadline,
            (true, None) => self.tick,
        }
    }

    /// The pilots whose drones fly.
    fn aloft(&self) -> impl Iterator<Item = &Seat> {
        let flying: Vec<bool> = lock(&self.known.flown).flight.flying.clone();
        self.seats.iter().zip(flying).filter(|(_, flying)| *flying).filter_map(|(seat, _)| seat.as_ref())
    }

    /// Every pilot in the air has given its action.
    fn ready(&self) -> bool {
        self.begun && self.aloft().next().is_some() && self.aloft().all(|seat| seat.given.is_some())
    }

    fn obey(&mut self, order: Order) {
        // whoever has asked may be gone by now
        match order {
            Order::Join { drone, token, answer } => drop(answer.send(self.join(drone, token.as_deref()))),
            Order::Fly { seat, action, answer } => match self.seat(seat) {
                Ok(seat) => seat.given = Some(Given { action, answer }),
                Err(fault) => drop(answer.send(Err(fault))),
            },
            Order::Leave { seat: key } => {
                if self.seats[key.drone].as_ref().is_some_and(|seat| seat.secret == key.secret) {
                    self.seats[key.drone] = None;
                    let mut flown = lock(&self.known.flown);
                    flown.flight.take_over(key.drone);
                    flown.by[key.drone] = By::Autopilot;
                }
            }
        }
    }

    /// The seat that a key is for.
    fn seat(&mut self, key: Key) -> Result<&mut Seat, Fault> {
        if !lock(&self.known.flown).flight.flying[key.drone] {
            return Err(ended(key.drone));
        }
        let seat = self.seats[key.drone].as_mut().filter(|seat| seat.secret == key.secret);
        seat.ok_or_else(|| lost(key.drone))
    }

    fn join(&mut self, wish: Option<usize>, token: Option<&str>) -> Result<Taken, Fault> {
        let drone = self.choose(wish, token)?;
        let mut secret = [0; 16];
        getrandom::fill(&mut secret).map_err(|e| Fault::new(Code::Unavailable, format!("no randomness for a token: {e}")))?;
        let last = self.seats[drone].take().and_then(|before| {
            if let Some(given) = before.given {
                let _ = given.answer.send(Err(lost(drone)));
            }
            before.last
        });
        self.seats[drone] = Some(Seat { secret, last, given: None });
        if !self.begun && self.seats.iter().flatten().count() >= self.pilots {
            (self.begun, self.since) = (true, Instant::now());
        }
        let mut flown = lock(&self.known.flown);
        flown.by[drone] = By::Pilot;
        let flight = &flown.flight;
        Ok(Taken {
            key: Key { drone, secret },
            tick: flight.ticks,
            tick_s: flight.tick_s(),
            deadline_s: self.deadline.as_secs_f64(),
            drones: flight.drones(),
            interface: flight.interfaces()[drone],
            observation: flight.observation(drone).to_vec(),
        })
    }

    /// A drone that may be taken: the one that is wished for, or the first that is free.
    fn choose(&self, wish: Option<usize>, token: Option<&str>) -> Result<usize, Fault> {
        let flown = lock(&self.known.flown);
        let flying = &flown.flight.flying;
        let Some(drone) = wish else {
            let free = self.seats.iter().zip(flying).position(|(seat, flying)| seat.is_none() && *flying);
            return free.ok_or_else(|| Fault::new(Code::NoFreeDrone, "every drone that flies has a pilot"));
        };
        let most = flying.len() - 1;
        let flies = flying.get(drone).ok_or_else(|| Fault::new(Code::UnknownDrone, format!("drone is {drone}, expected 0 to {most}")))?;
        if !flies {
            return Err(ended(drone));
        }
        let mine = |seat: &Seat| token.is_some_and(|token| hex::encode(seat.secret).as_bytes().ct_eq(token.as_bytes()).into());
        match &self.seats[drone] {
            Some(seat) if !mine(seat) => {
                Err(Fault::new(Code::DroneTaken, format!("drone {drone} has a pilot; with its token it is yours")))
            }
            _ => Ok(drone),
        }
    }

    /// A tick; whether somebody flies on.
    fn fly(&mut self) -> crazyflie_env::Result<bool> {
        let mut flown = lock(&self.known.flown);
        let Flown { flight, log, by } = &mut *flown;
        let (mut given, mut answers) = (vec![None; self.seats.len()], Vec::new());
        for (drone, seat) in self.seats.iter_mut().enumerate() {
            by[drone] = match (flight.flying[drone], seat) {
                (false, _) => By::Nobody,
                (true, None) => By::Autopilot,
                (true, Some(seat)) => {
                    let now = seat.given.take();
                    let late = now.is_none();
                    if let Some(now) = now {
                        seat.last = Some(now.action);
                        answers.push((drone, now.answer));
                    }
                    given[drone] = seat.last;
                    if late { By::Late } else { By::Pilot }
                }
            };
        }
        flight.step(&given)?;
        log.push(flight, by);
        self.place.stepped(1);
        self.place.listed.feed.show_shared(flight);
        self.since = Instant::now();
        // who hears of the last tick finds the name free
        self.known.over.store(flight.over(), Ordering::Release);
        for (drone, answer) in answers {
            let over = Over {
                tick: flight.ticks,
                observation: flight.observation(drone).to_vec(),
                reward: flight.rewards[drone],
                terminated: flight.terminated[drone],
                truncated: flight.truncated[drone],
                flying: flight.flying[drone],
                late: log.late[drone],
            };
            // a client that is gone hears nothing, and leaves by itself
            let _ = answer.send(Ok(over));
        }
        Ok(!flight.over())
    }
}

fn ended(drone: usize) -> Fault {
    Fault::new(Code::DroneEnded, format!("the flight of drone {drone} has ended"))
}

fn lost(drone: usize) -> Fault {
    Fault::new(Code::SeatLost, format!("drone {drone} was taken over by another connection"))
}
