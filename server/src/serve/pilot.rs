//! A connection that flies a drone of a shared world. Its requests go to the task that owns the world.

use std::sync::Arc;

use crazyflie_env::action::ACTION;
use tokio::sync::oneshot;

use super::replies::Reply;
use super::worlds::{WorldEntry, WorldRegistry};
use crate::protocol::{Code, Fly, Join, ProtocolError, Response, SlotInfo, TickResult};

/// A command for the task that owns a world.
pub(crate) enum WorldCommand {
    Join {
        id: u64,
        request: Join,
        answer: oneshot::Sender<Result<(SlotKey, SlotInfo<'static>), ProtocolError>>,
    },
    Fly {
        key: SlotKey,
        action: [f32; ACTION],
        answer: oneshot::Sender<Result<TickResult<'static>, ProtocolError>>,
    },
    Leave {
        key: SlotKey,
    },
}

/// Identity of a pilot slot. A slot that was taken over gets a new secret.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SlotKey {
    pub drone: usize,
    pub secret: [u8; 16],
}

/// Control over one drone, given back when dropped.
pub(crate) struct Pilot {
    world: Arc<WorldEntry>,
    key: SlotKey,
}

impl Drop for Pilot {
    fn drop(&mut self) {
        // a world that is over has no pilot slots
        let _ = self.world.commands.send(WorldCommand::Leave { key: self.key });
    }
}

impl Pilot {
    /// Joins a world.
    ///
    /// # Errors
    /// `unknown_world`, `not_invited`, `unknown_drone`, `no_free_drone`, `drone_taken`, `drone_ended`, `world_over`.
    pub(crate) async fn join(
        worlds: &WorldRegistry,
        id: u64,
        request: Join,
    ) -> Result<(Pilot, Reply), ProtocolError> {
        let world = worlds.find(&request.name)?;
        let (key, slot) = send_command(&world, |answer| WorldCommand::Join { id, request, answer }).await?;
        Ok((Pilot { world, key }, Reply::json(&Response::Joined(Box::new(slot)))))
    }

    /// Gives the action of this tick; the answer follows when the tick is over.
    ///
    /// # Errors
    /// `wrong_length`, `bad_action`, `drone_ended`, `seat_lost`, `world_over`.
    pub(crate) async fn fly(&self, id: u64, request: &Fly) -> Result<Reply, ProtocolError> {
        let action = request.action()?;
        let result =
            send_command(&self.world, |answer| WorldCommand::Fly { key: self.key, action, answer }).await?;
        Ok(Reply::json(&Response::Flown { id, result }))
    }

    /// The world and the drone, in words.
    pub(crate) fn label(&self) -> String {
        format!("drone {} of {:?}", self.key.drone, self.world.name)
    }
}

/// Sends a command to the task of a world and waits for its answer.
async fn send_command<T>(
    world: &WorldEntry,
    command: impl FnOnce(oneshot::Sender<Result<T, ProtocolError>>) -> WorldCommand,
) -> Result<T, ProtocolError> {
    let (answer, answered) = oneshot::channel();
    let problem = || format!("the world {:?} is over; its log can still be had", world.name);
    let world_over = || ProtocolError::new(Code::WorldOver, problem());
    world.commands.send(command(answer)).map_err(|_| world_over())?;
    answered.await.map_err(|_| world_over())?
}
