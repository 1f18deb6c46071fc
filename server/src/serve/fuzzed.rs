//! Fuzz targets of the messages to a server, with the conditions that every parsed message meets.

use super::wire::BinaryRequest;
use super::{live, openenv};
use crate::protocol::frame::FrameKind;
use crate::protocol::{self, MAX_ID};

pub(crate) fn control_message(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let (id, request) = protocol::parse(text, &[]);
    assert!(id.is_none_or(|id| id <= MAX_ID) && (id.is_some() || request.is_err()));
    request.map_err(|error| assert!(!error.message.is_empty())).is_ok()
}

pub(crate) fn step_frame(bytes: &[u8]) -> bool {
    let request = match BinaryRequest::parse(bytes, 1) {
        Ok(request) => request,
        Err(error) => {
            assert!(!error.message.is_empty());
            return false;
        }
    };
    let mut actions = vec![f32::NAN];
    request.actions(&mut actions);
    let step = request.kind == FrameKind::Step;
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
    live::parse(text).map_err(|error| assert!(!error.message.is_empty())).is_ok()
}
