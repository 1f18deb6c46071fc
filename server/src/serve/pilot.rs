//! A connection's seat in a shared world: what its client asks goes to the task that owns the world.

use std::sync::Arc;

use crazyflie_env::observation::{ACTION, Interface};
use tokio::sync::oneshot;

use super::fault::{Code, Fault};
use super::replies::Reply;
use super::requests::say;
use super::server_message::{Numbers, ServerMessage};
use super::shared::{Fly, Join, Joined};
use super::worlds::{Known, Worlds};

/// What a world's task is asked.
pub(crate) enum Order {
    Join { drone: Option<usize>, token: Option<String>, answer: oneshot::Sender<Result<Taken, Fault>> },
    Fly { seat: Key, action: [f32; ACTION], answer: oneshot::Sender<Result<Over, Fault>> },
    Leave { seat: Key },
}

/// Who sits where; a seat that was taken over has another secret.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Key {
    pub drone: usize,
    pub secret: [u8; 16],
}

/// A seat was taken.
pub(crate) struct Taken {
    pub key: Key,
    pub tick: u64,
    pub tick_s: f64,
    pub deadline_s: f64,
    pub drones: usize,
    pub interface: Interface,
    pub observation: Vec<f32>,
}

/// A tick is over.
pub(crate) struct Over {
    pub tick: u64,
    pub observation: Vec<f32>,
    pub reward: f32,
    pub terminated: bool,
    pub truncated: bool,
    pub flying: bool,
    pub late: u64,
}

/// A place at the controls of one drone, left when it is dropped.
pub(crate) struct Pilot {
    world: Arc<Known>,
    key: Key,
}

impl Drop for Pilot {
    fn drop(&mut self) {
        // a world that is over has no seats
        let _ = self.world.orders.send(Order::Leave { seat: self.key });
    }
}

impl Pilot {
    /// Takes a seat.
    ///
    /// # Errors
    /// `unknown_world`, `unknown_drone`, `no_free_drone`, `drone_taken`, `drone_ended`, `world_over`.
    pub(crate) async fn join(worlds: &Worlds, id: u64, asked: Join) -> Result<(Pilot, Reply), Fault> {
        let world = worlds.find(&asked.name)?;
        let taken = ask(&world, |answer| Order::Join { drone: asked.drone, token: asked.token, answer }).await?;
        let Taken { key, tick, tick_s, deadline_s, drones, interface, observation } = taken;
        let reply = say(&ServerMessage::Joined(Box::new(Joined {
            id,
            world: &world.name,
            drone: key.drone,
            drones,
            token: hex::encode(key.secret),
            tick,
            tick_s,
            deadline_s,
            interface,
            observation: Numbers(&observation),
        })));
        Ok((Pilot { world, key }, reply))
    }

    /// Gives the action of this tick; the answer comes when the tick is over.
    ///
    /// # Errors
    /// `wrong_length`, `bad_action`, `drone_ended`, `seat_lost`, `world_over`.
    pub(crate) async fn fly(&self, id: u64, asked: &Fly) -> Result<Reply, Fault> {
        let action = asked.action()?;
        let Over { tick, observation, reward, terminated, truncated, flying, late } =
            ask(&self.world, |answer| Order::Fly { seat: self.key, action, answer }).await?;
        let (observation, reward) = (Numbers(&observation), f64::from(reward));
        Ok(say(&ServerMessage::Flown { id, tick, observation, reward, terminated, truncated, flying, late }))
    }

    /// The world and the drone, in words.
    pub(crate) fn place(&self) -> String {
        format!("drone {} of {:?}", self.key.drone, self.world.name)
    }
}

async fn ask<T>(world: &Known, order: impl FnOnce(oneshot::Sender<Result<T, Fault>>) -> Order) -> Result<T, Fault> {
    let (answer, answered) = oneshot::channel();
    let over = || Fault::new(Code::WorldOver, format!("the world {:?} is over; its log can still be had", world.name));
    world.orders.send(order(answer)).map_err(|_| over())?;
    answered.await.map_err(|_| over())?
}
