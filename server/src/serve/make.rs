//! `hello` and `make`: what a server offers, and a session of what was asked for.

use std::sync::Arc;

use crazyflie_env::config::Options;
use crazyflie_env::error::unknown;
use crazyflie_env::model::Model;
use crazyflie_env::observation::ACTION;
use crazyflie_env::task;
use crazyflie_env::vector::VectorEnv;
use serde_json::Value;

use super::fault::{Code, Fault};
use super::feed::Feed;
use super::listed::End;
use super::message::Make;
use super::server::Server;
use super::server_message::{Known, Made, Welcome};
use super::session::Session;
use crate::bench::{Bench, Scenario};

pub(crate) const PROTOCOL: &str = "crazyflie.v1";

pub(crate) fn welcome(server: &Server, id: u64) -> Welcome {
    let limits = &server.settings.limits;
    let known =
        |entry: &task::Entry| Known { env: entry.id, task: entry.name, max_episode_steps: entry.max_episode_steps, drones: entry.drones };
    Welcome {
        id,
        protocol: PROTOCOL,
        server: concat!("crazyflie ", env!("CARGO_PKG_VERSION")).into(),
        window: limits.window,
        window_bytes: limits.window_bytes,
        max_text_bytes: limits.control_bytes,
        max_binary_bytes: limits.batch_bytes,
        max_envs: limits.envs_per_session,
        resume_s: limits.resume_for.as_secs_f64(),
        ping_s: limits.ping_after.as_secs_f64(),
        idle_s: limits.idle_timeout.as_secs_f64(),
        envs: task::registry().iter().map(known).collect(),
        scenarios: server.bench.iter().flat_map(Bench::scenarios).map(Scenario::id).collect(),
    }
}

/// # Errors
/// For what cannot be made, and `too_many` for more than the server carries.
pub(crate) fn make(server: &Arc<Server>, id: u64, asked: &Make) -> Result<(Session, Made), Fault> {
    let limits = &server.settings.limits;
    let (options, entry) = options(asked)?;
    let drones = entry.drones(options.drones)?;
    let most = limits.envs_per_session / drones;
    if !(1..=most).contains(&asked.num_envs) {
        let of = if drones == 1 { String::new() } else { format!(" of {drones} drones each") };
        return Err(Fault::new(Code::BadOptions, format!("num_envs is {}, expected 1 to {most}{of}", asked.num_envs)));
    }
    let model = asked.model.as_deref().map_or_else(|| Ok(Model::thesis()), Model::parse)?;
    let room = server.sessions.room(asked.num_envs * drones)?;
    let env = VectorEnv::new(std::slice::from_ref(&model), &options, asked.num_envs)?;
    let (tick_s, interface) = (env.tick_s(), env.interfaces()[0]);
    let feed = if env.num_metrics() == 0 { Feed::new(&options, tick_s) } else { Feed::several(&options, tick_s, drones) };
    let place = server.sessions.enter(entry.id.into(), room, feed)?;
    let (session, token) = (place.listed.name(), place.listed.token());
    let (autoreset, max_episode_steps, num_envs) = (options.autoreset, options.max_episode_steps, asked.num_envs);
    let made = Session::new(env, autoreset, place, limits);
    if let Some(bytes) = made.too_large() {
        made.finish(End::Closed);
        return Err(Fault::new(
            Code::TooLarge,
            format!("a step of {num_envs} environments takes {bytes} bytes, more than one message may"),
        ));
    }
    let max_steps = made.most_steps();
    let (env, task, action) = (entry.id.into(), entry.name.into(), ACTION);
    let (observation, metrics) = (made.layout.width, made.layout.metrics);
    let about = Made {
        id,
        session,
        token,
        env,
        task,
        num_envs,
        drones,
        observation,
        action,
        metrics,
        autoreset,
        max_episode_steps,
        max_steps,
        tick_s,
        interface,
    };
    Ok((made, about))
}

/// The options as asked for; threads are the server's to choose, and what an episode's length is by default the registry knows.
fn options(asked: &Make) -> Result<(Options, &'static task::Entry), Fault> {
    let mut map = asked.options.clone();
    if let Some(id) = &asked.env {
        let known = task::registry();
        let entry = known.iter().find(|entry| entry.id == id).ok_or_else(|| unknown("env", id, known.iter().map(|entry| entry.id)))?;
        let task = map.entry("task").or_insert_with(|| entry.name.into());
        if task != entry.name {
            return Err(Fault::new(Code::BadOptions, format!("the env {id} is the task {:?}, the options say {task}", entry.name)));
        }
    }
    map.insert("threads".into(), 1.into());
    let given = map.contains_key("max_episode_steps");
    let mut options = Options::parse(&Value::Object(map).to_string())?;
    let entry = task::find(&options.task)?;
    if !given {
        options.max_episode_steps = entry.max_episode_steps;
    }
    Ok((options, entry))
}
