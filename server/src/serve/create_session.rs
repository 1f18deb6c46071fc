//! Replies to `hello` and `make`: the server's offer, and a new session.

use std::sync::Arc;

use crazyflie_env::action::ACTION;
use crazyflie_env::config::Options;
use crazyflie_env::error::unknown;
use crazyflie_env::model::Model;
use crazyflie_env::task;
use crazyflie_env::vector::VectorEnv;
use serde_json::Value;

use super::budget::{Payer, Resource};
use super::feed::Feed;
use super::metrics::SessionEnd;
use super::server::Server;
use super::session::Session;
use crate::protocol::{Code, EnvInfo, Make, PROTOCOL, ProtocolError, ServerInfo, SessionInfo};

pub(crate) fn server_info(server: &Server, id: u64) -> ServerInfo {
    let (limits, extension) = (&server.settings.limits, server.settings.extension.as_ref());
    let env_info = |entry: &task::Entry| EnvInfo {
        env: entry.id.into(),
        task: entry.name.into(),
        max_episode_steps: entry.max_episode_steps,
        drones: entry.drones,
    };
    ServerInfo {
        id,
        protocol: PROTOCOL.into(),
        server: concat!("crazyflie ", env!("CARGO_PKG_VERSION")).into(),
        window: limits.window,
        window_bytes: limits.window_bytes,
        max_text_bytes: limits.control_bytes,
        max_binary_bytes: limits.batch_bytes,
        max_envs: limits.envs_per_session,
        resume_s: limits.resume_for.as_secs_f64(),
        ping_s: limits.ping_after.as_secs_f64(),
        idle_s: limits.idle_timeout.as_secs_f64(),
        envs: task::registry().iter().map(env_info).collect(),
        extension: extension.map(|extension| extension.welcome()).unwrap_or_default(),
    }
}

/// # Errors
/// For options and models that do not fit, and `too_many` for more than the server carries.
pub(crate) fn create_session(
    server: &Arc<Server>,
    payer: Payer,
    id: u64,
    request: &Make,
) -> Result<(Session, SessionInfo), ProtocolError> {
    let limits = &server.settings.limits;
    let (options, entry) = options(request)?;
    let drones = entry.drones(options.drones)?;
    let max = limits.envs_per_session / drones;
    ProtocolError::unless((1..=max).contains(&request.num_envs), Code::BadOptions, || {
        let drones_each = if drones == 1 { String::new() } else { format!(" of {drones} drones each") };
        format!("num_envs is {}, expected 1 to {max}{drones_each}", request.num_envs)
    })?;
    let model = request.model.as_deref().map_or_else(|| Ok(Model::thesis()), Model::parse)?;
    let share = server.sessions.reserve_envs(payer, request.num_envs * drones)?;
    let reply_room = server.budgets.buffer(Resource::ReplyBytes, payer, limits.free_bytes);
    let env = VectorEnv::new(std::slice::from_ref(&model), &options, request.num_envs)?;
    let (tick_s, interface) = (env.tick_s(), env.interfaces()[0]);
    let feed = if env.num_metrics() == 0 {
        Feed::new(&options, tick_s)
    } else {
        Feed::for_multi_drone(&options, tick_s, drones)
    };
    let slot = server.sessions.enter(entry.id.into(), share, request.num_envs * drones, feed)?;
    let num_envs = request.num_envs;
    let created = Session::new(env, options.autoreset, slot, reply_room, limits);
    if let Some(bytes) = created.too_large() {
        created.finish(SessionEnd::Closed);
        let problem =
            format!("a step of {num_envs} environments takes {bytes} bytes, more than one message may");
        return Err(ProtocolError::new(Code::TooLarge, problem));
    }
    let info = SessionInfo {
        id,
        session: created.slot.entry.name(),
        token: created.slot.entry.token(),
        env: entry.id.into(),
        task: entry.name.into(),
        num_envs,
        drones,
        observation: created.layout.width,
        action: ACTION,
        metrics: created.layout.metrics,
        autoreset: options.autoreset,
        max_episode_steps: options.max_episode_steps,
        max_steps: created.max_steps(),
        tick_s,
        interface,
    };
    Ok((created, info))
}

/// The options of the request. The server chooses the threads, the registry the default length of an episode.
pub(super) fn options(request: &Make) -> Result<(Options, &'static task::Entry), ProtocolError> {
    let mut map = request.options.clone();
    if let Some(id) = &request.env {
        let registry = task::registry();
        let entry = registry
            .iter()
            .find(|entry| entry.id == id)
            .ok_or_else(|| unknown("env", id, registry.iter().map(|entry| entry.id)))?;
        let task = map.entry("task").or_insert_with(|| entry.name.into());
        ProtocolError::unless(task == entry.name, Code::BadOptions, || {
            format!("the env {id} is the task {:?}, the options say {task}", entry.name)
        })?;
    }
    map.insert("threads".into(), 1.into());
    let has_own_length = map.contains_key("max_episode_steps");
    let mut options = Options::parse(&Value::Object(map).to_string())?;
    ProtocolError::unless(options.watch.is_empty(), Code::BadOptions, || {
        "watch: a server keeps no numbers for functions of a client; the observation may hold any field"
            .into()
    })?;
    ProtocolError::unless(options.cost.is_none(), Code::BadOptions, || {
        "cost: a server sends rewards alone".into()
    })?;
    let entry = task::find(&options.task)?;
    if !has_own_length {
        options.max_episode_steps = entry.max_episode_steps;
    }
    Ok((options, entry))
}
