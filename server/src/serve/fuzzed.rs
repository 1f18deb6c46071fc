//! What is sent to a server, and what must hold of it once it is read.

use super::wire::{Kind, MAX_ID, Request};
use super::{live, message, openenv};

pub(crate) fn control_message(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let (id, asked) = message::parse(text);
    assert!(id.is_none_or(|id| id <= MAX_ID) && (id.is_some() || asked.is_err()));
    asked.map_err(|fault| assert!(!fault.message.is_empty())).is_ok()
}

pub(crate) fn step_frame(bytes: &[u8]) -> bool {
    let request = match Request::parse(bytes, 1) {
        Ok(request) => request,
        Err(fault) => {
            assert!(!fault.message.is_empty());
            return false;
        }
    };
    let mut actions = vec![f32::NAN];
    request.actions(&mut actions);
    let step = request.kind == Kind::Step;
    assert_eq!(actions.len(), if step { 4 * request.steps * request.envs } else { 0 });
    assert_eq!(request.steps > 0, step);
    assert!(request.id <= MAX_ID && request.seeds().is_none_or(|seeds| seeds.len() == request.envs));
    request.mask().map(|mask| assert!(mask.is_none_or(|mask| mask.len() == request.envs))).is_ok()
}

pub(crate) fn openenv_message(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    openenv::parse(text).map_err(|(_, words)| assert!(!words.is_empty())).is_ok()
}

pub(crate) fn live_message(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    live::parse(text).map_err(|fault| assert!(!fault.message.is_empty())).is_ok()
}
